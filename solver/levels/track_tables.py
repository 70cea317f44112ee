"""Parameters, state and scratch of a single-track model (solver.levels.track_step)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.elements.road import RoadTable
from solver.output.account import Account

# State
X, Y, YAW, ROLL, TURN_F, TURN_R = range(6)
VX, VY, YAW_RATE, ROLL_RATE = range(6, 10)
SPIN, LONG, LATERAL, WIND = 10, 12, 14, 16  # of the front axle, the rear axle follows
SHIFT, DRIVE, LOSS, GROSS = 18, 19, 20, 21  # load moved to the rear [N] and drive torque [N m] by which it pitches;
# integrals of dissipated less supplied power and of all magnitudes [J]
GIVE = 22  # of the treads of the front axle, the rear axle follows (solver.elements.tread)
SIZE = 24

# What evaluate() tells beside the rates: of each axle AXLE_COLUMNS, then these
AXLE_COLUMNS = ('fx', 'fy', 'fz', 'slip', 'slip_angle', 'brake_torque')
FX, FY, FZ, KAPPA, ALPHA, BRAKE = range(6)
WHEEL_TORQUE, ENERGY, KINETIC, FRICTION_GAP, DRAG, SATURATION, SUPPLIED = range(12, 19)
TOLD = 19

# What was largest so far: value and time of each
REACHED = ('lateral acceleration', 'slip angle', 'slip', 'friction difference', 'combined acceleration')


class TrackAxle(NamedTuple):
    """An axle: both its wheels as one."""

    x: float  # from the centre of mass [m]
    half_track: float  # [m]
    load: float  # at rest [N]
    shifted: float  # load per load moved to the rear: -1 in front, 1 behind
    stiffness_x: float  # [N]
    stiffness_y: float  # at rest [N/rad]
    stiffness_load: float  # its growth over that of the load, both relative to rest [-]
    peak_x: float  # at rest, on a road of friction 1 [N]
    peak_y: float
    shape_x: float  # C
    shape_y: float
    curvature_x: float  # E
    curvature_y: float
    length_x: float  # of relaxation [m]
    length_y: float
    steered: float  # its angle over that of the front wheels, 1 of these
    roll_steer: float  # [rad/rad]
    trail: float  # behind the axis of steering at small slip [m]
    trail_lost: float  # of it at large slip [m]
    radius: float  # lever of the longitudinal force [m]
    rolling_radius: float  # speed over spin of a wheel that rolls freely [m]
    inertia: float  # of all that turns with it [kg m^2]
    resistance: float  # rolling resistance over load [-]
    give: float  # way that its treads give before it rolls [m]
    give_damping: float  # of it [s]
    drive: float  # share of the drive torque
    top_spin: float  # where that ends [rad/s]; 0: never
    brake: float  # share of the brake torque
    brake_stiffness: float  # [N m/rad]
    brake_damping: float  # [N m s/rad]


class Body(NamedTuple):
    """Body that the axles carry, and the whole vehicle."""

    mass: float  # [kg]
    yaw_inertia: float  # about the centre of mass [kg m^2]
    roll_inertia: float  # about the axis of roll [kg m^2]
    coupling: float  # S [kg m]
    product: float  # J [kg m^2]
    roll_stiffness: float  # net of gravity [N m/rad]
    roll_damping: float  # [N m s/rad]
    drag: float  # over the square of the speed [kg/m]
    height: float  # load moved to the rear over longitudinal force [-]
    lag: float  # of it [s]
    ratio: float  # road wheels over steering wheel, straight ahead
    ratio_3: float  # and its growth: angle = ratio s + ratio_3 s^3
    steering_inertia: float  # [kg m^2]
    steering_damping: float  # [N m s/rad]
    low_speed: float  # of the contact at rest [m/s]
    contact_time: float  # damping of the contact at rest [s]


class Mounting(NamedTuple):
    """Places of the frame of the chassis and of its centre of mass, in the outputs."""

    x: float  # of the origin of the chassis from the centre of mass of all [m]
    axis: float  # height of the axis of roll over that origin [m]
    height: float  # of the origin at rest [m]
    pitch: float  # at rest [rad]
    pitch_by_shift: float  # under brakes [rad/N]
    pitch_by_drive: float  # what the drive torque does besides [rad/(N m)]
    pitch_by_roll: float  # over the square of the roll [1/rad]
    com_x: float  # centre of mass of the chassis in its frame [m]
    com_y: float
    com_z: float
    yaw: float  # at the start, where the wheels stand at zero [rad]
    gravity: float  # [m/s^2]


class SingleTrackTables(NamedTuple):
    """All parameters of a single-track model."""

    mounting: Mounting
    body: Body
    front: TrackAxle
    rear: TrackAxle
    road: RoadTable


class SingleTrackWork(NamedTuple):
    """Scratch of a step, and what it tells."""

    rates: np.ndarray  # (SIZE,) at the end of the last step
    start: np.ndarray  # (SIZE,) state before the step
    k1: np.ndarray
    k2: np.ndarray
    between: np.ndarray
    stiff: np.ndarray  # (2, 8) matrix A of both axles
    stiff_2: np.ndarray
    told: np.ndarray  # (TOLD,)
    reached: np.ndarray  # (len(REACHED), 2)
    steered: np.ndarray  # (2,) integrals of the squares of angle [rad^2 s] and rate [rad^2/s] of the steering wheel
    account: Account  # the running account, of no bodies


class Steered(NamedTuple):
    """The steering wheel at an instant [rad, rad/s, rad/s^2]."""

    angle: float
    rate: float
    acceleration: float
