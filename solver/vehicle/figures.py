"""Figures of a vehicle, computed from its own model: masses, modes of vibration, kinematics and compliance, understeer.

They work on any vehicle model with tires whose corners are called front_left ... and that has the coordinates wheel_<corner> and
travel_<corner> (docs/vehicle.md). Angles in rad, SI units; signs:

    toe      positive: toe-in            camber   negative: top inwards
    steer    road-wheel angle, positive to the left

The rig holds the chassis in its design position, takes the tires off, locks the wheels to their carriers, and prescribes the wheel travels
and the steering wheel, as a test bench for kinematics and compliance does. Every point of a sweep is a static equilibrium.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.linalg

from solver.audit import dense_jacobian
from solver.channels import new_outputs
from solver.consistent import Start
from solver.dynamics import add_constraint_stiffness, evaluate_forces, prepare
from solver.elements.applied_force import AppliedForceSpec
from solver.elements.coupler import CouplerSpec
from solver.elements.joint import JointSpec
from solver.elements.marker import WORLD, Marker
from solver.integrators.settings import IntegratorSettings
from solver.maneuver import ACCELERATION, RATE, Maneuver
from solver.mechanism import matrix
from solver.model.spec import ModelSpec
from solver.model.state import State, new_state
from solver.model.tables import Model
from solver.scene import Scene
from solver.scene import Start as SceneStart
from solver.signals import Ramp
from solver.simulation import Simulation

AXLES = ('front', 'rear')
SIDES = {'left': 1.0, 'right': -1.0}
CORNERS = tuple(f'{axle}_{side}' for axle in AXLES for side in SIDES)
LOADS = {'fx': ('force', (1.0, 0.0, 0.0)), 'fy': ('force', (0.0, 1.0, 0.0)), 'mz': ('torque', (0.0, 0.0, 1.0))}
GOOD_PART = 0.3  # of the kinetic energy of a mode
STEPS = {'travel': 0.03, 'steering': 0.5}  # largest change of an input of the rig at once [m or rad]
LONG = 1e3  # s; internal states at rest move in proportion to it


class Linear(NamedTuple):
    """M a + C v + K x = A^T lam, A x = 0 about an equilibrium, dense, in the variations of docs/conventions.md (6 per body)."""

    M: np.ndarray
    C: np.ndarray
    K: np.ndarray
    A: np.ndarray


@dataclass(frozen=True)
class Mode:
    """A mode of vibration: undamped natural frequency [Hz], damping ratio [-], share of the kinetic energy by (body, direction x y z or
    rx ry rz), largest first."""

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
    """The model linearised about a state of rest; contact patches of standing tires are springs and dampers."""
    start = Start(model, new_outputs(model))
    at_rest = np.zeros_like(state.v)
    _, lam = start.acceleration(state.q, at_rest, state.z, state.angle, u)
    kin = start._constraints(state.q, at_rest, state.angle, u)
    evaluate_forces(model.tables, kin, state.angle, state.z, LONG, u, True, start.f, start.Kq, start.Kv, start.z, start.outputs)
    with_contact = start.Kv.copy()
    evaluate_forces(model.tables, kin, state.angle, state.z, 0.0, u, True, start.f, start.Kq, start.Kv, start.z, start.outputs)
    C = -_dense(model, start.Kv)
    contact = -_dense(model, with_contact - start.Kv) / LONG
    add_constraint_stiffness(model.tables, kin, lam, start.Kq, start.Kv)
    K = -_dense(model, start.Kq) + contact
    bodies = model.tables.bodies
    M = scipy.linalg.block_diag(*(block for m, J in zip(bodies.mass, bodies.inertia, strict=True) for block in (m * np.eye(3), J)))
    return Linear(M, C, K, dense_jacobian(model, start.J))


def eigenvalues(linear: Linear) -> tuple[np.ndarray, np.ndarray]:
    """(eigenvalues s (2 n,), shapes (6 nb, 2 n)) of motions x exp(s t) that keep the constraints; n degrees of freedom."""
    Z = scipy.linalg.null_space(linear.A) if len(linear.A) else np.eye(len(linear.M))
    M, C, K = (Z.T @ X @ Z for X in (linear.M, linear.C, linear.K))
    n = len(M)
    upper = np.hstack([np.zeros((n, n)), np.eye(n)])
    s, X = scipy.linalg.eig(np.vstack([upper, -scipy.linalg.solve(M, np.hstack([K, C]), assume_a='pos')]))
    return s, Z @ X[:n]


def modes(simulation: Simulation) -> list[Mode]:
    """Oscillating modes of a simulation at rest at its start, by frequency."""
    model, state = simulation.model, simulation.state
    linear = linearised(model, state, np.zeros(len(model.spec.inputs)))
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
    """The modes a vehicle is known by: the lowest one with a good part of its kinetic energy in the motion that names it."""
    chassis = simulation.model.spec.chassis or simulation.model.body_names[0]
    wheels = {axle: [f'{part}_{axle}_{side}' for part in ('wheel', 'upright', 'knuckle') for side in SIDES] for axle in AXLES}
    wanted = {
        'bounce': ([chassis], ['z']),
        'pitch': ([chassis], ['ry']),
        'roll': ([chassis], ['rx']),
        **{f'wheel hop {axle}': (wheels[axle], ['z']) for axle in AXLES},
        'engine bounce': (['engine'], ['z']),
    }
    found = modes(simulation)
    first = {name: next((mode for mode in found if mode.share(*where) > GOOD_PART), None) for name, where in wanted.items()}
    return {name: mode for name, mode in first.items() if mode is not None}


def mass_figures(spec: ModelSpec) -> dict[str, float]:
    """Mass [kg], centre of mass [m], principal directions' inertia about it [kg m^2], wheelbase, tracks [m], share of the front axle."""
    placed = [(b, np.array(b.position) + matrix(b.orientation) @ np.array(b.com)) for b in spec.bodies]
    mass = sum(b.mass for b, _ in placed)
    com = sum(b.mass * p for b, p in placed) / mass
    inertia = np.zeros((3, 3))
    for b, p in placed:
        R, d = matrix(b.orientation), p - com
        inertia += R @ b.inertia_matrix() @ R.T + b.mass * (d @ d * np.eye(3) - np.outer(d, d))
    at = wheel_centers(spec)
    x = {axle: 0.5 * (at[f'{axle}_left'][0] + at[f'{axle}_right'][0]) for axle in AXLES}
    track = {axle: at[f'{axle}_left'][1] - at[f'{axle}_right'][1] for axle in AXLES}
    wheelbase = x['front'] - x['rear']
    return {
        'mass': float(mass),
        'com_x': float(com[0]), 'com_y': float(com[1]), 'com_z': float(com[2]),
        'roll_inertia': float(inertia[0, 0]), 'pitch_inertia': float(inertia[1, 1]), 'yaw_inertia': float(inertia[2, 2]),
        'wheelbase': float(wheelbase), 'track_front': float(track['front']), 'track_rear': float(track['rear']),
        'front_share': float((com[0] - x['rear']) / wheelbase),
    }  # fmt: skip


def wheel_centers(spec: ModelSpec) -> dict[str, np.ndarray]:
    """Corner -> centre of the wheel in the design position (3,) [m]."""
    bodies = {b.name: b for b in spec.bodies}
    return {
        t.name: np.array(bodies[t.marker.body].position) + matrix(bodies[t.marker.body].orientation) @ np.array(t.marker.position)
        for t in spec.tires
    }


class Rig:
    """A kinematics and compliance test bench for a vehicle model; see the module."""

    def __init__(self, spec: ModelSpec) -> None:
        self.spec = spec
        self.centers = wheel_centers(spec)
        bodies = {b.name: b for b in spec.bodies}
        chassis = bodies[spec.chassis or spec.bodies[0].name]
        carrier = {}
        for joint in spec.joints:
            for tire in spec.tires:
                if joint.name == f'wheel_{tire.name}':
                    carrier[tire.name] = joint.i.body if joint.j.body == tire.marker.body else joint.j.body
        rows = [CouplerSpec(name=f'hold_{c}', terms=((f'wheel_{c}', 1.0),)) for c in CORNERS]
        rows += [CouplerSpec(name=f'travel_{c}', terms=((f'travel_{c}', 1.0),), offset=0.0, input=f'travel_{c}') for c in CORNERS]
        loads = []
        for c in CORNERS:
            b = bodies[carrier[c]]
            ground = np.array([*self.centers[c][:2], 0.0])
            x, y, z = (float(v) for v in matrix(b.orientation).T @ (ground - np.array(b.position)))
            marker = Marker(body=b.name, position=(x, y, z))
            for n, (kind, direction) in LOADS.items():
                loads.append(AppliedForceSpec(name=f'{n}_{c}', marker=marker, input=f'{n}_{c}', **{kind: direction}))  # type: ignore[arg-type]
        names = [n + end for n in (*(f'travel_{c}' for c in CORNERS),) for end in ('', RATE, ACCELERATION)] + [f.name for f in loads]
        fixed = JointSpec(
            name='rig',
            kind='fixed',
            i=Marker(body=WORLD, position=chassis.position, orientation=chassis.orientation),
            j=Marker(body=chassis.name),
        )
        self.inputs = (*spec.inputs, *names)
        model = ModelSpec(
            **{
                **spec.__dict__,
                'joints': (*spec.joints, fixed),
                'couplers': (*spec.couplers, *rows),
                'applied_forces': (*spec.applied_forces, *loads),
                'tires': (),
                'inputs': self.inputs,
            }
        )
        self.model = prepare(model)
        self.start = Start(self.model, new_outputs(self.model))
        self.state = new_state(self.model)
        self._u = np.zeros(len(self.inputs))
        self.settle({})

    def settle(self, inputs: Mapping[str, float]) -> dict[str, dict[str, float]]:
        """Equilibrium under the given inputs (travel_<corner> [m], steering [rad], fx_, fy_ [N] or mz_<corner> [N m] at the contact
        patch); returns by corner toe, camber, steer [rad], x, y of wheel centre and contact patch relative to the design [m],
        load: vertical force at the wheel [N]."""
        before, u = self._u, np.array([inputs.get(name, 0.0) for name in self.inputs])
        limits = np.array([STEPS.get(name.partition('_')[0], np.inf) for name in self.inputs])
        count = max(1, int(np.ceil(np.max(np.abs(u - before) / limits))))
        for k in range(1, count + 1):
            self.start.assemble(self.state, before + (u - before) * (k / count))
        self.start.equilibrium(self.state, u)
        self._u = u
        return {c: self._corner(c) for c in CORNERS}

    def _corner(self, corner: str) -> dict[str, float]:
        tire = next(t for t in self.spec.tires if t.name == corner)
        b = self.model.body_names.index(tire.marker.body)
        side = SIDES[corner.partition('_')[2]]
        R = matrix(tuple(self.state.q[b, 3:]))
        center = self.state.q[b, :3] + R @ np.subtract(tire.marker.position, self.spec.bodies[b].com)
        s = R @ matrix(tire.marker.orientation)[:, 1]
        up = np.array([0.0, 0.0, 1.0]) - s[2] * s
        contact = center - self.centers[corner][2] * up / np.linalg.norm(up)
        at = self.centers[corner]
        row = self.model.row_names.index(f'travel_{corner}')
        return {
            'toe': side * float(np.arctan2(s[0], s[1])),
            'steer': float(np.arctan2(-s[0], s[1])),
            'camber': -side * float(np.arcsin(s[2])),
            'center_x': float(center[0] - at[0]),
            'center_y': float(center[1] - at[1]),
            'contact_x': float(contact[0] - at[0]),
            'contact_y': float(contact[1] - at[1]),
            'load': float(self.state.lam[row]),
        }

    def travel(self, values: Sequence[float], *, opposite: bool = False) -> dict[str, dict[str, np.ndarray]]:
        """Sweep of all wheels in parallel, or left and right opposite (left in bump); curves over the left travel by corner."""
        return self._sweep([{f'travel_{c}': z * (SIDES[c.partition('_')[2]] if opposite else 1.0) for c in CORNERS} for z in values])

    def steering(self, values: Sequence[float]) -> dict[str, dict[str, np.ndarray]]:
        """Sweep of the steering wheel [rad]."""
        return self._sweep([{'steering': angle} for angle in values])

    def loading(self, load: str, values: Sequence[float], *, opposite: bool = False) -> dict[str, dict[str, np.ndarray]]:
        """Sweep of one load at all wheels (see LOADS), equal or of opposite sign left and right."""
        return self._sweep([{f'{load}_{c}': f * (SIDES[c.partition('_')[2]] if opposite else 1.0) for c in CORNERS} for f in values])

    def _sweep(self, points: Sequence[Mapping[str, float]]) -> dict[str, dict[str, np.ndarray]]:
        results = [self.settle(point) for point in points]
        self.settle({})
        return {c: {key: np.array([r[c][key] for r in results]) for key in results[0][c]} for c in CORNERS}


def kinematic_figures(rig: Rig, step: float = 0.01) -> dict[str, float]:
    """Slopes at the design position from central differences over +- step [m]: per axle wheel rate [N/m], roll stiffness [N m/rad],
    roll-centre height [m], toe and camber change [rad/m], and the ratio of steering wheel to mean road wheel [-]; compliances: toe by
    lateral force, both to the left (left wheel, [rad/N], positive: towards the force) and by aligning moment [rad/(N m)],
    longitudinal displacement by braking force [m/N]."""
    both, roll = rig.travel([-step, step]), rig.travel([-step, step], opposite=True)
    side, brake, align = rig.loading('fy', [-1000.0, 1000.0]), rig.loading('fx', [-1000.0, 1000.0]), rig.loading('mz', [-50.0, 50.0])
    steer = rig.steering([-0.2, 0.2])
    figures: dict[str, float] = {}
    for axle in AXLES:
        c = f'{axle}_left'
        track = rig.centers[c][1] - rig.centers[f'{axle}_right'][1]

        def slope(curves: dict[str, dict[str, np.ndarray]], key: str, width: float, c: str = c) -> float:
            low, high = curves[c][key]
            return float((high - low) / (2.0 * width))

        figures |= {
            f'wheel_rate_{axle}': slope(both, 'load', step),
            f'roll_stiffness_{axle}': 0.5 * slope(roll, 'load', step) * track * track,
            f'roll_center_{axle}': 0.5 * track * slope(both, 'contact_y', step),
            f'bump_toe_{axle}': slope(both, 'toe', step),
            f'bump_camber_{axle}': slope(both, 'camber', step),
            f'lateral_steer_{axle}': slope(side, 'steer', 1000.0),
            f'lateral_compliance_{axle}': slope(side, 'contact_y', 1000.0),
            f'longitudinal_compliance_{axle}': slope(brake, 'center_x', 1000.0),
            f'aligning_steer_{axle}': slope(align, 'steer', 50.0),
        }
    mean = 0.5 * (steer['front_left']['steer'] + steer['front_right']['steer'])
    figures['steering_ratio'] = float(0.4 / (mean[1] - mean[0]))
    return figures


def understeer_gradient(spec: ModelSpec, ratio: float, *, speed: float = 22.0, h: float = 2e-3) -> dict[str, float]:
    """Slow ramp of the steering wheel at nearly constant speed (ISO 4138, method 2): understeer gradient [rad s^2/m] and roll gradient
    [rad s^2/m] by a straight line through lateral accelerations up to 3.5 m/s^2. ratio: of the steering."""
    figures = mass_figures(spec)
    maneuver = Maneuver(steering=Ramp(slope=0.2, start=0.5, blend=0.4), drive_torque=Ramp(slope=20.0, initial=150.0, start=0.5, blend=0.2))
    scene = Scene(
        name='understeer', model=spec, start=SceneStart(kind='equilibrium', speed=speed), maneuver=maneuver,
        integrator=IntegratorSettings(h=h, penalty=1e6),
    )  # fmt: skip
    simulation = Simulation(scene)
    chassis = simulation.channels.chassis or 0
    rows = []
    for _ in range(400):
        s = simulation.advance(round(0.02 / h))
        v, r = np.hypot(*s.twist[chassis, :2]), s.twist[chassis, 5]
        x, y, z, w = s.pose[chassis, 3:]
        rows.append(
            (v * r, s.inputs[spec.inputs.index('steering')] / ratio - figures['wheelbase'] * r / v, np.arcsin(2.0 * (z * y + w * x)))
        )
        if v * r > 3.5:
            break
    a, understeer, roll = np.array(rows).T
    used = a > 0.5
    return {
        'understeer_gradient': float(np.polyfit(a[used], understeer[used], 1)[0]),
        'roll_gradient': float(np.polyfit(a[used], roll[used], 1)[0]),
    }


def figures(simulation: Simulation) -> dict[str, float]:
    """All figures of a vehicle whose simulation stands at its start (speed 0, equilibrium); see the functions of this module."""
    spec = simulation.model.spec
    found = mass_figures(spec)
    for name, mode in named_modes(simulation).items():
        key = name.replace(' ', '_')
        found |= {f'{key}_frequency': mode.frequency, f'{key}_damping': mode.damping}
    found |= kinematic_figures(Rig(spec))
    return found | understeer_gradient(spec, found['steering_ratio'])
