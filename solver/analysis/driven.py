"""Figures of a vehicle that come out of driving it: a slow ramp of the steering wheel, a step, and turning it while the
vehicle stands.

Speeds, times and torques are those of passenger cars and grow with the vehicle (solver.vehicle.size). SI units, angles
in rad. Other figures of vehicles: solver.analysis.figures.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from solver.analysis.kinematics_and_compliance import wheel_centers
from solver.elements.road import RoadSpec
from solver.errors import SpecError
from solver.inputs.driver import SpeedControl
from solver.inputs.maneuver import Maneuver
from solver.inputs.signals import Ramp, Step
from solver.model.frames import matrix
from solver.model.spec import ModelSpec
from solver.output.snapshot import Snapshot
from solver.scene import Scene, StartSettings
from solver.simulation import Simulation
from solver.step.settings import IntegratorSettings
from solver.units import STANDARD_GRAVITY
from solver.vehicle.size import Size, size_of

H = 2e-3  # s; step of these runs
EVERY = 0.02  # s; between two looks
LEAST, FEWEST = 0.5, 5  # m/s^2 and samples; of a straight line for the gradients
GENTLE = 3.5  # m/s^2; up to which lateral acceleration gradients are taken
MODERATE = 0.33 * STANDARD_GRAVITY  # m/s^2, lateral acceleration at which the torque of the hand is given
FAST = 100.0 / 3.6  # m/s; of the sensitivity
STEP_SPEED, STEP_TO = 80.0 / 3.6, 4.0  # m/s and m/s^2: the step of ISO 7401
RISE = 0.15  # s; of the step
DIRECT = 3.0  # ratio of the steering below which the ramp is slower in proportion; racing cars have 3.5 and more
RAMP_SPEED = 22.0  # m/s; of the slow ramp
PARKED_TO, PARKING = 0.45, 2.5  # rad of the road wheels, and in which time [s]


def wheelbase(spec: ModelSpec) -> float:
    """From the rear to the front wheel centres of the left side [m]."""
    at = wheel_centers(spec)
    return float(at['front_left'][0] - at['rear_left'][0])


def rigid_gear(spec: ModelSpec) -> bool:
    """True where the rack follows the steering wheel by a constraint: without any assistance the torque of the hand is
    not that of a car."""
    return any({'rack', 'steering_wheel'} <= {name for name, _ in coupler.terms} for coupler in spec.couplers)


def speed_control(size: Size) -> SpeedControl:
    """Who keeps the speed of a vehicle of a size as the usual one does that of a passenger car."""
    usual = SpeedControl()
    torques = {name: getattr(usual, name) * size.torque for name in ('inertia', 'first', 'most', 'least', 'brakes')}
    return dataclasses.replace(
        usual, bandwidth=usual.bandwidth / size.time, release=usual.release * size.time, **torques
    )


class _Drive:
    """A vehicle on a flat road."""

    def __init__(self, spec: ModelSpec, maneuver: Maneuver, speed: float) -> None:
        time = size_of(spec).time
        start = StartSettings(kind='equilibrium', speed=speed)
        model = dataclasses.replace(spec, road=RoadSpec())
        self.simulation = Simulation(
            Scene(
                name='figures',
                model=model,
                start=start,
                maneuver=maneuver,
                integrator=IntegratorSettings(h=round(H * time, 9), penalty=1e6),
            )
        )
        self.every = round(EVERY / H)  # steps
        self.chassis = self.simulation.channels.chassis or 0
        self.steering = spec.inputs.index('steering')

    def looks(self, duration: float) -> list[Snapshot]:
        """Snapshots over a duration [s] of a passenger car, EVERY of its time."""
        return [self.simulation.advance(self.every) for _ in range(round(duration / EVERY))]

    def effort(self, s: Snapshot, joint: str) -> float:
        """Generalized force of a joint coordinate, NaN for one that the vehicle does not have."""
        names = self.simulation.channels.joints
        return float(s.joint_effort[names.index(joint)]) if joint in names else np.nan

    def to_the_left(self, s: Snapshot) -> float:
        """Horizontal acceleration of the chassis' centre of mass at right angles to its heading [m/s^2]."""
        R = matrix(tuple(s.pose[self.chassis, 3:]))
        ax, ay, _ = R @ s.imu[:3]  # a specific force: gravity has no part in the horizontal
        heading = np.arctan2(R[1, 0], R[0, 0])
        return float(np.cos(heading) * ay - np.sin(heading) * ax)

    def lateral(self, s: Snapshot) -> tuple[float, float]:
        """(speed, speed times yaw rate)."""
        v = float(np.hypot(*s.twist[self.chassis, :2]))
        return v, v * float(s.twist[self.chassis, 5])


def steady_figures(spec: ModelSpec, ratio: float, *, speed: float = RAMP_SPEED) -> dict[str, float]:
    """Slow ramp of the steering wheel at nearly constant speed (ISO 4138, method 2): understeer gradient [rad s^2/m]
    and roll gradient [rad s^2/m] by a straight line through lateral accelerations from 0.5 to 3.5 m/s^2, the
    sensitivity at 100 km/h that belongs to them, 1/(ratio (wheelbase/v^2 + gradient)) [m/s^2 per rad of the steering
    wheel], and, where the ramp reaches it and the gear is not rigid, the torque of the hand at 0.33 g [N m]. ratio: of
    the steering."""
    size = size_of(spec)
    t, torque, turned = size.time, size.torque, min(1.0, ratio / DIRECT)  # a direct gear is turned slowly
    push = Ramp(slope=20.0 * torque / t, initial=150.0 * torque, start=0.5 * t, blend=0.2 * t)
    maneuver = Maneuver(steering=Ramp(slope=0.2 * turned / t, start=0.5 * t, blend=0.4 * t), drive_torque=push)
    drive, length = _Drive(spec, maneuver, speed * size.speed), wheelbase(spec)
    rows = []
    for _ in range(400):
        s = drive.simulation.advance(drive.every)
        v, a = drive.lateral(s)
        x, y, z, w = s.pose[drive.chassis, 3:]
        angle = s.inputs[drive.steering] / ratio - length * a / (v * v)
        rows.append((a, angle, np.arcsin(2.0 * (z * y + w * x)), drive.effort(s, 'steering_wheel')))
        if a > GENTLE:
            break
    a, angle, roll, hand = np.array(rows).T
    used = a > LEAST
    if np.count_nonzero(used) < FEWEST:
        ramp = f'a slow ramp of the steering wheel to {drive.simulation.snapshot().inputs[drive.steering]:.3g} rad'
        raise SpecError(
            f'{ramp} at {speed * size.speed:.3g} m/s reaches {a.max():.3g} m/s^2 across; gradients need {GENTLE:g} '
            'm/s^2'
        )
    gradient, roll_gradient = (float(np.polyfit(a[used], y[used], 1)[0]) for y in (angle, roll))
    found = {
        'understeer_gradient': gradient,
        'roll_gradient': roll_gradient,
        'steering_sensitivity': 1.0 / (ratio * (length / (FAST * size.speed) ** 2 + gradient)),
    }
    if rigid_gear(spec) or a.max() < MODERATE:
        return found
    return found | {'hand_torque': float(np.interp(MODERATE, a, hand))}


def step_figures(spec: ModelSpec, ratio: float, gradient: float) -> dict[str, float]:
    """A step of the steering wheel to 4 m/s^2 at 80 km/h (ISO 7401): response_time, from half of the steering to 90 %
    of the steady lateral acceleration of the chassis' centre of mass [s]; nothing where there is none by far."""
    size = size_of(spec)
    t, speed = size.time, STEP_SPEED * size.speed
    angle = ratio * (wheelbase(spec) / speed**2 + gradient) * STEP_TO
    drive = _Drive(
        spec, Maneuver(steering=Step(value=angle, start=0.2 * t, rise=RISE * t), speed=speed_control(size)), speed
    )
    a = np.array([drive.to_the_left(s) for s in drive.looks(3.0)])
    wanted = 0.9 * float(a[-50:].mean())
    if wanted < 0.5 * STEP_TO:
        return {}
    k = int(np.argmax(a > wanted))
    return {'response_time': t * (float(EVERY * (k + 1 - (a[k] - wanted) / (a[k] - a[k - 1]))) - 0.2 - 0.5 * RISE)}


def parking_figures(spec: ModelSpec, ratio: float) -> dict[str, float]:
    """Turning the road wheels by 26 degrees while the vehicle stands: the largest force of the rack [N]. ratio: of the
    steering."""
    if rigid_gear(spec):
        return {}
    t = size_of(spec).time
    drive = _Drive(
        spec, Maneuver(steering=Ramp(slope=ratio * PARKED_TO / (PARKING * t), start=0.1 * t, blend=0.2 * t)), 0.0
    )
    forces = np.abs([drive.effort(s, 'rack') for s in drive.looks(PARKING)])
    return {} if np.isnan(forces).any() else {'parking_rack_force': float(forces.max())}
