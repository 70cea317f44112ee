"""A scene linearised about any state: d(dx)/dt = A dx + B du, dy = C dx + D du, about the motion through that state.

Coordinates of the state are those of a chart at it. With Z a basis of the variations of position that keep the
holonomic constraints, and Zv one of the twists that keep all of them, and L, Lv their inverses from the left, both in
the metric of the masses,

    x = (L log(q0^-1 q), Lv v, z)

over the manifold of the constraints: q and v in f(x, u) are those with these coordinates that satisfy the constraints
under the inputs u. f is the equations of motion of solver.reference.dense. They are differentiated by central
differences of fourth order, with steps far above rounding; a law with a kink within a step (a table, a stop, dry
friction) has the mean of both sides there. The state may move: A then belongs to that instant and to this chart, which
is flat where the manifold of the constraints is curved; only at an equilibrium are its eigenvalues those of any other
coordinates.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.linalg

from solver.errors import SpecError
from solver.reference.dense import RANK_TOLERANCE, Equations, MotionState
from solver.simulation import Simulation
from solver.start.newton import move

# Steps of differences: largest variation of a body [m or rad]; of a twist [m/s or rad/s]; of internal states and
# inputs, relative to their size and to 1. Ten times as much meets ten times as many kinks of tables and leaves 1e4
# times the error of fourth order, a tenth ten times the rounding.
PLACE, RATE, OTHER = 1e-4, 1e-3, 1e-4
WEIGHTS = ((-2.0, 1.0 / 12.0), (-1.0, -2.0 / 3.0), (1.0, 2.0 / 3.0), (2.0, -1.0 / 12.0))
ROUNDS = 4  # corrections of a chart; the first is of second order in the step
OUTPUTS = ('x', 'y', 'z', 'rx', 'ry', 'rz')


class LinearModel(NamedTuple):
    """A (n, n), B (n, nu), C (ny, n), D (ny, nu); f (n,) and y (ny,) at the state itself, where f is zero of an
    equilibrium. x is `positions` independent variations of place, `rates` of twist, then internal states.

    inputs, outputs: names of the columns of B and D and of the rows of C and D: every joint coordinate [m or rad],
    chassis/v* [m/s, rad/s] and chassis/a* [m/s^2, rad/s^2], the twist of the chassis (or the first body) and its
    derivative, as docs/conventions.md defines them. Z (6 nb, positions), Zv (6 nb, rates): variations and twists of the
    bodies that belong to x.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    f: np.ndarray
    y: np.ndarray
    positions: int
    rates: int
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    Z: np.ndarray
    Zv: np.ndarray

    @property
    def is_moving(self) -> bool:
        """True where the state is no equilibrium: eigenvalues of A are no modes of vibration then."""
        scale = max(1.0, float(np.abs(self.A).max(initial=0.0)))
        return bool(np.abs(self.f).max(initial=0.0) > 1e-6 * scale)


def linear_model(simulation: Simulation, inputs: np.ndarray | None = None) -> LinearModel:
    """A simulation linearised about its state now; see the module.

    inputs: (nu,) in the order of `channels.inputs`; None: those of the last step. Raises SpecError for a level of
    detail that has no bodies.
    """
    model = simulation.model
    u = np.array(simulation.inputs if inputs is None else inputs, float)
    if u.shape != (len(model.spec.inputs),):
        raise SpecError(f'inputs: {u.shape} numbers are given, and the scene has {len(model.spec.inputs)} inputs')
    return _Chart(simulation, u).model()


class _Chart:
    """Coordinates about the state of a simulation, and the equations of motion in them."""

    def __init__(self, simulation: Simulation, u: np.ndarray) -> None:
        self.simulation, model, state = simulation, simulation.model, simulation.state
        self.u0, self.instant = u, 0.0
        self.equations = Equations(model, model.new_outputs(), lambda _: self.u, state.angle)
        self.u = u
        at = self.equations.project(0.0, MotionState(state.q.copy(), state.v.copy(), state.z.copy()))
        self.q0, self.v0, self.z0 = at.q, at.v[:-1].ravel(), at.z
        self.equations.move_to(at.q, at.v)
        rows = self.equations.constraints(self._now())
        B, _ = self.equations.scaled(rows.A)
        root = self.equations.root
        inverse = np.linalg.inv(root)

        def basis(some: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            N = scipy.linalg.null_space(some, rcond=RANK_TOLERANCE) if len(some) else np.eye(len(root))
            return root @ N, N.T @ inverse

        self.Z, self.L = basis(B[self.equations.holonomic])
        self.Zv, self.Lv = basis(B)
        chassis = model.spec.chassis or model.body_names[0]
        self.chassis = 6 * model.body_names.index(chassis)
        self.joints = simulation.channels.joints

    def _now(self) -> float:
        """Another instant each time: Equations keeps the inputs of one."""
        self.instant += 1.0
        return self.instant

    def _placed(self, xi: np.ndarray) -> np.ndarray:
        """q with these coordinates that satisfies the holonomic constraints."""
        q = self.q0.copy()
        self._move(q, self.Z @ xi)
        still = np.zeros((len(q), 6))
        for _ in range(ROUNDS):
            q = self.equations.project(self._now(), MotionState(q, still.copy(), self.z0)).q
            left = xi - self.L @ self._variation(q)
            if np.abs(left).max(initial=0.0) < 1e-14 * max(1.0, np.abs(xi).max(initial=0.0)):
                break
            self._move(q, self.Z @ left)
        return self.equations.project(self._now(), MotionState(q, still, self.z0)).q

    def _move(self, q: np.ndarray, variation: np.ndarray) -> None:
        move(q, np.vstack([variation.reshape(-1, 6), np.zeros((1, 6))]))

    def _variation(self, q: np.ndarray) -> np.ndarray:
        """log(q0^-1 q) (6 nb,): differences of places, rotation vectors in the body."""
        out = np.zeros((len(q) - 1, 6))
        out[:, :3] = q[:-1, :3] - self.q0[:-1, :3]
        a, b = self.q0[:-1, 3:], q[:-1, 3:]
        vector = a[:, 3:] * b[:, :3] - b[:, 3:] * a[:, :3] - np.cross(a[:, :3], b[:, :3])
        scalar = np.einsum('ij,ij->i', a, b)
        sign = np.where(scalar < 0.0, -1.0, 1.0)[:, None]
        size = np.linalg.norm(vector, axis=1)
        angle = 2.0 * np.arctan2(size, np.abs(scalar))
        out[:, 3:] = sign * vector * np.where(size > 1e-12, angle / np.maximum(size, 1e-300), 2.0)[:, None]
        return out.ravel()

    def _rate(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Derivative of _variation() with the twist v: that of a rotation vector with the angular velocity."""
        turn, out = self._variation(q).reshape(-1, 6)[:, 3:], v.reshape(-1, 6).copy()
        w, size = out[:, 3:].copy(), np.linalg.norm(turn, axis=1)
        half = 0.5 * size
        # 1 / size^2 - (1 + cos) / (2 size sin), by its series below 0.1 rad
        series = 1.0 / 12.0 + size**2 / 720.0 + size**4 / 30240.0
        with np.errstate(divide='ignore', invalid='ignore'):
            exact = (1.0 - half / np.tan(half)) / size**2
        factor = np.where(size < 0.1, series, exact)
        once = np.cross(turn, w)
        out[:, 3:] = w + 0.5 * once + factor[:, None] * np.cross(turn, once)
        return out.ravel()

    def f(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(dx/dt, outputs)."""
        self.u = u
        n, m = self.Z.shape[1], self.Zv.shape[1]
        q = self._placed(x[:n])
        e = self.equations
        e.move_to(q, np.zeros((len(q), 6)))
        rows = e.constraints(self._now())
        B, factor = e.scaled(rows.A)
        # the twist with the coordinates that keeps the constraints, in the metric of the masses
        system = np.vstack([B, self.Lv @ e.root])
        wanted = np.concatenate([-factor * rows.phi_t, x[n : n + m]])
        v = e.root @ np.linalg.lstsq(system, wanted, rcond=None)[0]
        motion = MotionState(q, np.vstack([v.reshape(-1, 6), np.zeros((1, 6))]), x[n + m :])
        e.accept(motion)
        a, _, zd = e.acceleration(self._now(), motion)
        angles = e.angle[: len(self.joints)].copy()
        c = slice(self.chassis, self.chassis + 6)
        return np.concatenate([self.L @ self._rate(q, v), self.Lv @ a, zd]), np.concatenate([angles, v[c], a[c]])

    def model(self) -> LinearModel:
        """The derivatives of f and outputs."""
        n, m = self.Z.shape[1], self.Zv.shape[1]
        x0 = np.concatenate([np.zeros(n), self.Lv @ self.v0, self.z0])
        f0, y0 = self.f(x0, self.u0)
        largest = [np.abs(Z).max(axis=0, initial=1e-300) for Z in (self.Z, self.Zv)]
        sizes = [np.maximum(1.0, np.abs(values)) for values in (self.z0, self.u0)]
        steps = np.concatenate([PLACE / largest[0], RATE / largest[1], OTHER * sizes[0], OTHER * sizes[1]])
        k = len(x0)
        F, Y = np.zeros((k, len(steps))), np.zeros((len(y0), len(steps)))
        for j, step in enumerate(steps):
            for s, weight in WEIGHTS:
                at = np.concatenate([x0, self.u0])
                at[j] += s * step
                f, y = self.f(at[:k], at[k:])
                F[:, j] += weight / step * f
                Y[:, j] += weight / step * y
        spec = self.simulation.model.spec
        outputs = (*self.joints, *(f'chassis/{of}{way}' for of in ('v', 'a') for way in OUTPUTS))
        return LinearModel(
            F[:, :k], F[:, k:], Y[:, :k], Y[:, k:], f0, y0, n, m, tuple(spec.inputs), outputs, self.Z, self.Zv
        )
