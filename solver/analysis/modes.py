"""Modes of vibration of a vehicle (or any model) about a state of rest."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.linalg

from solver.compiled.by_reference import Ref
from solver.elements.servo import SERVOS
from solver.elements.tire_pacejka import TIRES, rolling_tires
from solver.errors import SpecError
from solver.model.evaluate import add_constraint_stiffness, evaluate_forces
from solver.model.state import State
from solver.model.tables import Model
from solver.output.dependence import dense_jacobian
from solver.simulation import Simulation
from solver.start.newton import ConsistentState
from solver.vehicle.hardpoints import SIDES

AXLES = ('front', 'rear')
GOOD_PART = 0.3  # of the kinetic energy of a mode
LONG = 1e3  # s; internal states at rest move in proportion to it
AT_REST = 1e-6  # m/s or rad/s; ten times as much is still below what an equilibrium leaves
SLACK = 1e-6  # N/m or N m/rad, or of ones on the diagonal: below it nothing holds a part in some direction


class Linear(NamedTuple):
    """M a + C v + K x = A^T lam, A x = 0 about an equilibrium, dense, in the variations of docs/conventions.md (6 per
    body)."""

    M: np.ndarray
    C: np.ndarray
    K: np.ndarray
    A: np.ndarray


@dataclass(frozen=True)
class Mode:
    """A mode of vibration: undamped natural frequency [Hz], damping ratio [-], share of the kinetic energy by (body,
    direction x y z or rx ry rz), largest first."""

    frequency: float
    damping: float
    shares: tuple[tuple[str, str, float], ...]

    def share(self, bodies: Sequence[str], directions: Sequence[str]) -> float:
        """Part of the kinetic energy in some directions of some bodies."""
        return sum(s for body, direction, s in self.shares if body in bodies and direction in directions)


def _dense(model: Model, K: np.ndarray) -> np.ndarray:
    nb, t = model.n_bodies, model.tables
    D = np.zeros((nb, 6, nb, 6))
    for s in range(1, model.n_slots + 1):
        D[t.block_row[s], :, t.block_col[s], :] += K[s]
    return D.reshape(6 * nb, 6 * nb)


def linearised(model: Model, state: State, u: np.ndarray) -> Linear:
    """The model linearised about a state of rest; contact patches of standing tires are springs and dampers, servos
    follow at once.

    Wheels roll against the resistance that they have when they turn: a tread that holds a standing wheel
    (solver.elements.tread) is dry friction, which has no modes, and a vehicle is asked for those that it has on the
    road.

    Raises SpecError for a model with struts, whose mounts move besides the bodies.
    """
    if model.spec.struts:
        raise SpecError(
            f'strut {model.spec.struts[0].name!r}: its mount has modes of its own, which those of bodies leave out; '
            'take fidelity: full for modes'
        )
    start = ConsistentState(model)
    tables, kept = model.with_tables(
        {TIRES.name: rolling_tires(model.elements[TIRES.name].value)} if model.spec.tires else {}
    )
    at_rest = np.zeros_like(state.v)
    _, lam = start.acceleration(state.q, at_rest, state.z, state.angle, u)
    kin = start._constraints(state.q, at_rest, state.angle, u)
    rates = []
    for time in (
        2.0 * LONG,
        LONG,
        0.0,
    ):  # tangents over velocities are -C - K time for the states of standing tires, -C for those of dampers
        evaluate_forces(
            tables, kin, state.angle, state.z, time, u, True, start.f, start.Kq, start.Kv, start.z, start.outputs
        )
        rates.append(_dense(model, start.Kv))
    del kept
    contact = (rates[1] - rates[0]) / LONG
    C = -rates[1] - LONG * contact
    add_constraint_stiffness(model.tables, kin, lam, start.Kq, start.Kv)
    K = -_dense(model, start.Kq) + contact
    if model.spec.servos:
        K -= _servos(model, start, kin, state, u)
    bodies = model.tables.bodies
    M = scipy.linalg.block_diag(
        *(block for m, J in zip(bodies.mass, bodies.inertia, strict=True) for block in (m * np.eye(3), J))
    )
    return Linear(M, C, K, dense_jacobian(model, start.J))


def _servos(model: Model, start: ConsistentState, kin: Ref, state: State, u: np.ndarray) -> np.ndarray:
    """(6 nb, 6 nb) by which the forces of servos change with the places when they have settled, beyond what they change
    at once."""
    tables, sides = model.only(SERVOS.name), []
    for time in (LONG, 0.0):
        evaluate_forces(
            tables, kin, state.angle, state.z, time, u, True, start.f, start.Kq, start.Kv, start.z, start.outputs
        )
        sides.append(_dense(model, start.Kq))
    return sides[0] - sides[1]


def eigenvalues(linear: Linear) -> tuple[np.ndarray, np.ndarray]:
    """(eigenvalues s (2 n,), shapes (6 nb, 2 n)) of motions x exp(s t) that keep the constraints; n degrees of
    freedom."""
    Z = scipy.linalg.null_space(linear.A) if len(linear.A) else np.eye(len(linear.M))
    M, C, K = (Z.T @ X @ Z for X in (linear.M, linear.C, linear.K))
    n = len(M)
    upper = np.hstack([np.zeros((n, n)), np.eye(n)])
    s, X = scipy.linalg.eig(np.vstack([upper, -scipy.linalg.solve(M, np.hstack([K, C]), assume_a='pos')]))
    return s, Z @ X[:n]


def matrices_at_rest(simulation: Simulation) -> Linear:
    """M, C, K and A of a simulation in its place now, at rest there and without inputs, in SI units; 6 rows of each
    body in the order of `channels.bodies`: place in W [m], turn in the body [rad].

    Velocities are left out, of which a warning tells where there are some; solver.linear_model() takes them. Raises
    SpecError for a level of detail that has no bodies, and for struts.
    """
    return _at_rest(simulation, stacklevel=3)


def _at_rest(simulation: Simulation, stacklevel: int) -> Linear:
    model, state = simulation.model, simulation.state
    fastest = float(np.abs(state.v).max(initial=0.0))
    if fastest > AT_REST:
        warnings.warn(
            f'modes are those of a state of rest, and bodies move by {fastest:.3g} m/s or rad/s, which is left out; '
            'solver.linear_model() linearises about the motion',
            stacklevel=stacklevel,
        )
    return linearised(model, state, np.zeros(len(model.spec.inputs)))


def modes(simulation: Simulation) -> list[Mode]:
    """Oscillating modes of a simulation in its place now, at rest there, by frequency. Velocities are left out, of
    which a warning tells where there are some; solver.linear_model() takes them. Raises SpecError, as
    matrices_at_rest() does."""
    model = simulation.model
    linear = _at_rest(simulation, stacklevel=3)
    s, X = eigenvalues(linear)
    directions = ('x', 'y', 'z', 'rx', 'ry', 'rz')
    found = []
    for k in np.flatnonzero(s.imag > 1e-6):
        shape = X[:, k]
        energy = (shape.conj() * (linear.M @ shape)).real
        order = np.argsort(-energy)
        shares = tuple((model.body_names[i // 6], directions[i % 6], float(energy[i] / energy.sum())) for i in order)
        found.append(Mode(float(abs(s[k]) / (2 * np.pi)), float(-s[k].real / abs(s[k])), shares))
    return sorted(found, key=lambda mode: mode.frequency)


def named_modes(simulation: Simulation) -> dict[str, Mode]:
    """The modes a vehicle is known by. Bounce and pitch of the body are the two with the largest parts of their kinetic
    energy in these motions, together: they are two also where each has much of both. Roll is a swaying and turning
    about an axis below the body, on standing tires often more of the former: the second mode of these two motions, with
    the axis above, is far higher. It and the others are the lowest ones with a good part in what names them."""
    chassis = simulation.model.spec.chassis or simulation.model.body_names[0]
    sides = {
        axle: [f'{part}_{axle}_{side}' for part in ('wheel', 'upright', 'knuckle', 'beam') for side in SIDES]
        for axle in AXLES
    }
    found = modes(simulation)
    named: dict[str, Mode] = {}

    def good(bodies: list[str], directions: list[str]) -> list[Mode]:
        return [mode for mode in found if mode.share(bodies, directions) > GOOD_PART]

    def name_it(name: str, bodies: list[str], directions: list[str]) -> None:
        if candidates := good(bodies, directions):
            named[name] = candidates[0]

    heaving, pitching = (
        [(mode, mode.share([chassis], [way])) for mode in good([chassis], [way])] for way in ('z', 'ry')
    )
    pairs = [(z + ry, bounce, pitch) for bounce, z in heaving for pitch, ry in pitching if bounce is not pitch]
    if pairs:
        _, named['bounce'], named['pitch'] = max(pairs, key=lambda pair: pair[0])
    elif heaving:
        named['bounce'], _ = max(heaving, key=lambda candidate: candidate[1])
    elif pitching:
        named['pitch'], _ = max(pitching, key=lambda candidate: candidate[1])
    name_it('roll', [chassis], ['y', 'rx'])
    for axle in AXLES:
        name_it(f'wheel hop {axle}', [f'axle_{axle}', *sides[axle]], ['z'])
    name_it('engine bounce', ['engine'], ['z'])
    return named


def smallest_eigenvalue(K: np.ndarray, M: np.ndarray) -> float:
    """Smallest eigenvalue of K x = lambda M x, both positive semidefinite; only to be compared with a threshold.
    Infinite without any mass that can vibrate."""
    # the reciprocals of lambda are finite then, unless something without mass is not held either
    if not (np.diag(M) > 0.0).all():
        if not (np.diag(K) > SLACK).all():
            return 0.0
        held = np.sqrt(np.diag(K))
        stiffness, share = np.linalg.eigh(K / held[:, None] / held[None, :])
        if stiffness[0] < SLACK:
            return 0.0
        half = share / held[:, None] / np.sqrt(stiffness)
        slowest = float(np.linalg.eigvalsh(half.T @ M @ half)[-1])
        return 1.0 / slowest if slowest > 0.0 else np.inf
    scale = np.sqrt(np.diag(M))
    scaled = K / scale[:, None] / scale[None, :]
    weight = M / scale[:, None] / scale[None, :]
    values = np.linalg.eigvals(np.linalg.solve(weight, scaled))
    return float(values.real.min())
