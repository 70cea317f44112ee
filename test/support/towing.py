"""A linear single-track car with a trailer, on its own paper, and what its data are in a model: masses, levers,
cornering stiffnesses.

Three degrees of freedom at constant speed u ([Pacejka2012] 1.3.4): lateral velocity v and yaw rate r of the car at its
centre of mass, and the articulation g, yaw of the trailer against the car. Lengths along x, all positive: from the
centre of mass of the car to the front axle a (ahead), to the rear axle b and the ball h (behind); from the ball
backwards to centre of mass e, axle l and centre of pressure p of the trailer. Accelerations

    a1 = v' + u r          a2 = a1 - h r' - e (r' + g'')

and by virtual displacements y, yaw of both, articulation

    m1 a1 + m2 a2                          = Ff + Fr + Ft
    I1 r' + I2 (r' + g'') - (h + e) m2 a2  = (a - tf) Ff - (b + tr) Fr - (h + l + tt) Ft
    I2 (r' + g'') - e m2 a2                = -(l + tt) Ft - damping g'

with side forces F behind a first-order lag of their relaxation length, sigma / u F' + F = C (angle of the wheel - angle
of its velocity), at a pneumatic trail t behind the axle. Air drag D of the trailer acts against the velocity of its
centre of pressure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.optimize

from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.files.scene import load_scene_text
from solver.levels.road_wheel import steering_map, steering_wheel_at
from solver.model.frames import matrix
from solver.model.spec import ModelSpec
from solver.scene import Scene
from solver.simulation import Simulation
from solver.vehicle.trailer import without_trailer

FX, FY, MZ = (TIRE_COLUMNS.index(name) for name in ('fx', 'fy', 'mz'))
CARAVAN = 'vehicle.trailer=vehicles/trailers/caravan.yaml'
AMPLITUDE = 0.03  # rad of the steering wheel: linear
RHO = 1.2  # kg/m^3, as in solver.elements.aero_drag


def towing(car: str, *changes: str, speed: float = 0.0, h: float = 2e-3, steering: str = '0') -> Scene:
    """A car with the caravan that keeps its speed."""
    text = (
        f'vehicle: vehicles/{car}.yaml\nstart: {{kind: equilibrium, speed: {speed}}}\nintegrator: {{h: {h}}}\n'
        f'maneuver: {{steering: {steering}{", speed: {}" if speed else ""}}}\n'
    )
    return load_scene_text(text, 'towing', (CARAVAN, *changes))


def bodies_of_trailer(model: ModelSpec) -> set[str]:
    """Names of the bodies of the trailer."""
    return {body.name for body in model.bodies} - {body.name for body in without_trailer(model).bodies}


def mass_figures(model: ModelSpec, names: set[str]) -> tuple[float, np.ndarray, float]:
    """(mass [kg], centre of mass (3,) [m], yaw inertia about it [kg m^2]) of some bodies in the design position."""
    own = [body for body in model.bodies if body.name in names]
    at = [np.array(body.position) + matrix(body.orientation) @ body.com for body in own]
    mass = float(sum(body.mass for body in own))
    com = np.sum([body.mass * p for body, p in zip(own, at, strict=True)], axis=0) / mass
    yaw = 0.0
    for body, p in zip(own, at, strict=True):
        R = matrix(body.orientation)
        yaw += (R @ body.inertia_matrix() @ R.T)[2, 2] + body.mass * float((p - com)[:2] @ (p - com)[:2])
    return mass, com, yaw


@dataclass(frozen=True, kw_only=True)
class SingleTrack:
    """Masses [kg], yaw inertias [kg m^2] and levers [m] of the module; x: centre of mass of the car in its design frame
    [m]; tracks [m] of the three axles; stiffness [N/rad], trail [m] and relaxation length [m] of the three axles;
    drag_area [m^2] of the trailer."""

    m1: float
    m2: float
    I1: float
    I2: float
    a: float
    b: float
    h: float
    e: float
    l: float  # noqa: E741
    p: float
    x: float
    half_tracks: np.ndarray
    drag_area: float
    stiffness: np.ndarray
    trail: np.ndarray
    relaxation: np.ndarray

    def matrices(self, u: float, damping: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(mass matrix M (4, 4), A (4, 4), levers of the three side forces (4, 3)): M z' = A z + levers F, z = (v, r,
        g, g')."""
        a2 = np.array([1.0, -self.h - self.e, 0.0, -self.e])
        turned = np.array([0.0, 1.0, 0.0, 1.0])
        M = np.array(
            [
                self.m1 * np.array([1.0, 0.0, 0.0, 0.0]) + self.m2 * a2,
                self.I1 * np.array([0.0, 1.0, 0.0, 0.0]) + self.I2 * turned - (self.h + self.e) * self.m2 * a2,
                self.I2 * turned - self.e * self.m2 * a2,
                [0.0, 0.0, 1.0, 0.0],
            ]
        )
        A = np.zeros((4, 4))
        A[:3, 1] = -u * np.array([self.m1 + self.m2, -(self.h + self.e) * self.m2, -self.e * self.m2])
        A[2, 3], A[3, 3] = -damping, 1.0
        drag = 0.5 * RHO * self.drag_area * u * u
        sideways = np.array([1.0, -self.h - self.p, 0.0, -self.p]) / u
        pendulum = self.p * np.array([0.0, 0.0, 1.0, 0.0])  # the drag acts beside the ball where the trailer is turned
        A[0] -= drag * sideways
        A[1] += drag * ((self.h + self.p) * sideways - pendulum)
        A[2] += drag * (self.p * sideways - pendulum)
        tf, tr, tt = self.trail
        levers = np.array(
            [
                [1.0, 1.0, 1.0],
                [self.a - tf, -self.b - tr, -self.h - self.l - tt],
                [0.0, 0.0, -self.l - tt],
                [0.0, 0.0, 0.0],
            ]
        )
        return M, A, levers

    def slip(self, u: float) -> np.ndarray:
        """(3, 4) angles of the wheels less those of their velocities, without steering, over z."""
        return -np.array([[1.0, self.a, 0.0, 0.0], [1.0, -self.b, 0.0, 0.0], [1.0, -self.h - self.l, -u, -self.l]]) / u

    def steady(self, u: float, angle: float) -> np.ndarray:
        """(4,) z in the steady turn with an angle of the front wheels [rad]."""
        _, A, levers = self.matrices(u)
        K = A + levers @ (self.stiffness[:, None] * self.slip(u))
        return np.linalg.solve(K, -levers[:, 0] * self.stiffness[0] * angle)

    def snaking(self, u: float, damping: float = 0.0) -> tuple[float, float]:
        """(undamped frequency [Hz], damping ratio [-]) of the oscillation with the least damping."""
        M, A, levers = self.matrices(u, damping)
        inverse, lag = np.linalg.inv(M), u / self.relaxation
        s = np.linalg.eigvals(
            np.block([[inverse @ A, inverse @ levers], [(lag * self.stiffness)[:, None] * self.slip(u), -np.diag(lag)]])
        )
        least = max((one for one in s if one.imag > 1e-3), key=lambda one: one.real / abs(one))
        return abs(least) / (2.0 * np.pi), -least.real / abs(least)

    def critical_speed(self, low: float, high: float) -> float:
        """Speed [m/s] between two others at which the damping is zero."""
        return float(scipy.optimize.brentq(lambda u: self.snaking(u)[1], low, high, xtol=1e-3))


def single_track(car: str, u: float, *changes: str) -> SingleTrack:
    """The linear model of a car with the caravan: masses from the specification; stiffnesses and trails from the side
    forces and moments in steady turns to both sides at u [m/s]; relaxation lengths are tire stiffness over carcass
    stiffness ([Besselink2010] 17-19)."""
    scene = towing(car, *changes, speed=u)
    model = scene.model
    trailer = bodies_of_trailer(model)
    m1, com1, I1 = mass_figures(model, {body.name for body in model.bodies} - trailer)
    m2, com2, I2 = mass_figures(model, trailer)
    ball = next(joint.i.position[0] for joint in model.joints if joint.name == 'hitch')
    at = {tire.name: next(b.position for b in model.bodies if b.name == tire.marker.body) for tire in model.tires}
    half_tracks = np.array([at[f'{axle}_left'][1] for axle in ('front', 'rear', 'trailer')])
    drag = next((one for one in model.aero_drags if one.name == 'aero_trailer'), None)
    origin = next(body.position[0] for body in model.bodies if body.name == 'trailer')
    geometry = dict(
        m1=m1, m2=m2, I1=I1, I2=I2, a=at['front_left'][0] - com1[0], b=com1[0] - at['rear_left'][0], h=com1[0] - ball,
        e=ball - com2[0],
        l=ball - at['trailer_left'][0], p=0.0 if drag is None else ball - origin - drag.marker.position[0], x=com1[0],
        half_tracks=half_tracks, drag_area=0.0 if drag is None else drag.drag_area,
    )  # fmt: skip
    unknown = SingleTrack(**geometry, stiffness=np.ones(3), trail=np.zeros(3), relaxation=np.ones(3))
    left, right = (
        turning(unknown, towing(car, *changes, speed=u, steering=steered(s * AMPLITUDE))) for s in (1.0, -1.0)
    )
    forces, moments, slips = ((x - y) / 2.0 for x, y in zip(left, right, strict=True))
    stiffness = forces / (slips + np.array([front_angle(scene), 0.0, 0.0]))
    carcass = np.array([model.tires[k].data['LATERAL_STIFFNESS'] for k in (0, 2, 4)])
    return SingleTrack(**geometry, stiffness=stiffness, trail=-moments / forces, relaxation=stiffness / 2.0 / carcass)


def steered(angle: float) -> str:
    """A step of the steering wheel [rad]."""
    return f'{{kind: step, value: {angle}, start: 0.5, rise: 0.5}}'


def front_angle(scene: Scene, angle: float = AMPLITUDE) -> float:
    """Mean angle of the front wheels [rad] at an angle of the steering wheel [rad], without forces."""
    steering = steering_map(scene.model)
    return float(scipy.optimize.brentq(lambda x: steering_wheel_at(steering, x) - angle, -0.1, 0.1))


def turning(track: SingleTrack, scene: Scene, seconds: float = 12.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(side forces [N], moments about the vertical at the axles [N m], angles of the velocities of the wheels against
    them [rad], with the sign of a force) of the three axles at the end of a run."""
    simulation = Simulation(scene)
    shot = simulation.advance(round(seconds / simulation.h))
    u, v, r = shot.twist[simulation.channels.chassis or 0][[0, 1, 5]]
    g = shot.joint_position[simulation.channels.joints.index('articulation')]
    z = np.array([v + track.x * r, r, g, 0.0])
    of_axles = shot.tire.reshape(3, 2, -1)
    arms = np.stack([track.half_tracks, -track.half_tracks], axis=1)
    return of_axles[..., FY].sum(axis=1), (of_axles[..., MZ] - arms * of_axles[..., FX]).sum(axis=1), track.slip(u) @ z


def ring_down(scene: Scene, begin: float, seconds: float = 6.0) -> tuple[float, float]:
    """(undamped frequency [Hz], damping ratio [-]) of the articulation from `begin` [s] on: a damped oscillation about
    a line, fitted."""
    simulation = Simulation(scene)
    place = simulation.channels.joints.index('articulation')
    every = round(0.02 / simulation.h)
    simulation.advance(round(begin / simulation.h))
    y = np.array([simulation.advance(every).joint_position[place] for _ in range(round(seconds / 0.02))])
    t = 0.02 * np.arange(len(y))

    def rest(x: np.ndarray) -> np.ndarray:
        wave = np.exp((1j * x[1] - x[0]) * t)
        columns = np.column_stack([wave.real, wave.imag, np.ones_like(t), t])
        return columns @ np.linalg.lstsq(columns, y, rcond=None)[0] - y

    found = min((scipy.optimize.least_squares(rest, [0.5, w]) for w in (3.0, 4.5, 6.0)), key=lambda one: one.cost)
    size = float(np.hypot(*found.x))
    return size / (2.0 * np.pi), float(found.x[0]) / size


def snaking(car: str, u: float, *changes: str) -> tuple[float, float]:
    """The same after a small sine of the steering wheel at a speed [m/s]."""
    sine = '{kind: sine, amplitude: 0.05, frequency: 1.0, start: 0.5, cycles: 1}'
    return ring_down(towing(car, *changes, speed=u, steering=sine), begin=3.0)
