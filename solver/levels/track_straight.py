"""Identification by runs straight on: gear of the steering, rolling radii, resistance, forces along, load moved and its
lag, pitch."""

from __future__ import annotations

import math

import numpy as np

from solver.analysis.kinematics_and_compliance import Rig
from solver.inputs.maneuver import Maneuver
from solver.inputs.signals import Ramp, Step
from solver.levels.fitting import PRIOR, each, fitted, least_squares
from solver.levels.single_track_engine import AXLES
from solver.levels.track_bulk import top_spin, turning
from solver.levels.track_runs import EVERY, SPEED, Drive, IdentificationRun, driven, heading, pitch_of
from solver.levels.track_step import LIMITER_FROM
from solver.model.spec import ModelSpec
from solver.vehicle.size import size_of

# times and speeds are those of a passenger car and grow with the vehicle (solver.vehicle.size)
BRAKING = 5.0  # m/s^2
DRIVING = 1.5  # m/s^2
SLOW = 3.0  # m/s: runs straight on are looked at above
SLIP = 0.15  # of the brakes: up to there the characteristic along is fitted
LEAST_SHARE = 0.02  # of the drive torque: less is none
CREPT, NEAR = 0.12, 1e-3  # rad/s, of the road wheels at least while creeping; rad, of the steering wheel for its gear
# rad of the front wheels up to which the gear of the steering is fitted: next to its stops a linkage gains on it
TURNED = 0.45
# of the angle of the front wheels: creeping, forces turn the rear ones by less than a hundredth of that
LEAST_STEERED = 0.02
PULL = 2.5  # s of the run that is driven, up to ROOM of the speed where a limiter begins
ROOM = 0.95
LAGS = tuple(0.02 * 1.05**k for k in range(60))  # s


def gear(model: ModelSpec) -> tuple[float, float, float]:
    """(ratio, ratio_3, behind): mean angle of the front wheels = ratio s + ratio_3 s^3 of the steering wheel, creeping;
    that of the rear wheels over it, straight ahead, 0 where nothing but forces turns these."""
    t, turned_by = size_of(model).time, gear_of(model)
    slope = min(1.0, turned_by * CREPT) / t
    run = driven(
        model, Drive(speed=2.0 * t, maneuver=Maneuver(steering=Ramp(slope=slope, start=0.5 * t)), duration=6.0 * t)
    )
    q = [run.tire[name] for name in ('qx', 'qy', 'qz', 'qw')]
    # headings jump where a car looks back
    chassis, whole_turn = heading(*run.pose.T), np.full(len(run.time), 2.0 * math.pi)
    turned = [each(math.remainder, heading(*(c[:, k] for c in q)) - chassis, whole_turn) for k in range(4)]
    ahead, behind = (0.5 * (turned[k] + turned[k + 1]) for k in (0, 2))
    s = run.inputs[EVERY - 1 :: EVERY, run.names.index('steering')]
    used = np.logical_and.accumulate(np.abs(ahead) < TURNED)
    s, ahead, behind = s[used], ahead[used], behind[used]
    ratio, ratio_3 = fitted([s, s * s * s], ahead)
    follows = float(fitted([s, s * s * s], behind)[0] / ratio)
    return float(ratio), float(ratio_3), follows if abs(follows) > LEAST_STEERED else 0.0


def gear_of(model: ModelSpec) -> float:
    """Angle of the steering wheel over that of the road wheels in the design position, of a vehicle that is no
    passenger car in size; infinite for one: its gear lets it turn as far as these runs do."""
    if size_of(model).ordinary:
        return math.inf
    steers = Rig(model).steering([-NEAR, NEAR])
    mean = 0.5 * (steers['front_left']['steer'] + steers['front_right']['steer'])
    return 2.0 * NEAR / abs(float(mean[1] - mean[0]))


def straight(model: ModelSpec, mass: float) -> tuple[dict[str, dict[str, float]], dict[str, float], IdentificationRun]:
    """(parameters of both axles, of body and mounting) that runs straight on tell, and the run that ended with locked
    wheels."""
    t = size_of(model).time
    wheels, rest = turning(model, SPEED * t)
    R0 = {t.name.partition('_')[0]: t.data.values['UNLOADED_RADIUS'] for t in model.tires}
    torque = 0.5 * mass * (R0['front'] + R0['rear'])  # N m per m/s^2
    pull, begin = below(fastest(model, R0), t)
    steps = {
        'push': Drive(
            speed=begin,
            maneuver=Maneuver(drive_torque=Step(value=pull * torque, start=0.5 * t, rise=0.1 * t)),
            duration=(0.5 + PULL) * t,
        ),
        'stop': Drive(
            speed=SPEED * t,
            maneuver=Maneuver(brake_torque=Step(value=BRAKING * torque, start=0.5 * t, rise=0.1 * t)),
            duration=4.0 * t,
        ),
        'lock': Drive(
            speed=35.0 * t,
            maneuver=Maneuver(brake_torque=Ramp(slope=4.0 * torque / t, start=0.2 * t)),
            duration=5.0 * t,
        ),
    }
    free = driven(model, Drive(speed=SPEED * t, maneuver=Maneuver(), duration=0.6 * t))
    slower = free if begin == SPEED * t else driven(model, Drive(speed=begin, maneuver=Maneuver(), duration=0.6 * t))
    push, stop, lock = (driven(model, drive) for drive in steps.values())
    # Coasting it is slowed down, so its loads and its pitch are not those that no force leaves.
    coasting, rolling = (
        float(np.mean(free.axle('fx').sum(axis=1))),
        [float(np.mean(free.axle('fz')[:, i])) for i in range(2)],
    )
    steady = (stop.time > 1.0 * t) & (stop.vx > SLOW * t)
    moved, force = stop.axle('fz')[:, 1] - rolling[1], stop.axle('fx').sum(axis=1) - coasting
    height = float(fitted([force[steady]], moved[steady])[0])
    loads = rolling[0] + height * coasting, rolling[1] - height * coasting
    axles = {}
    for i, axle in enumerate(AXLES):
        load = loads[i]
        lever = R0[axle] - 0.5 * float(np.mean(free.axle('deflection')[:, i]))
        stiffness, peak, shape = along(lock, i, load, t)
        axles[axle] = {
            'load': load,
            'radius': lever,
            'rolling_radius': float(np.mean((1.0 + 0.5 * free.axle('kappa')[:, i]) * free.vx / free.spin[:, i])),
            'resistance': -float(np.mean(free.axle('my')[:, i])) / (rolling[i] * lever),
            'half_track': 0.5 * float(np.mean(free.tire['py'][:, 2 * i] - free.tire['py'][:, 2 * i + 1])),
            'inertia': wheels[axle],
            'stiffness_x': stiffness,
            'peak_x': peak,
            'shape_x': shape,
            'brake': share(stop, 'brake_torque', i, lever, -wheels[axle], t),
            'drive': share(push, 'drive_torque', i, lever, wheels[axle], t),
        }
    driving = {axle: found['drive'] for axle, found in axles.items()}
    for i, axle in enumerate(AXLES):
        whole_ = sum(max(d, 0.0) for d in driving.values())
        part = max(driving[axle], 0.0) / whole_ if whole_ > LEAST_SHARE else 0.0
        if part < LEAST_SHARE:
            axles[axle]['drive'] = 0.0
            continue
        axles[axle]['inertia'] += part * rest
        lever, inertia = axles[axle]['radius'], axles[axle]['inertia']
        axles[axle]['drive'] = share(push, 'drive_torque', i, lever, inertia, t)
        # which slow down rotors and shafts too
        axles[axle]['brake'] = share(stop, 'brake_torque', i, lever, -inertia, t)
    level = float(np.mean(pitch_of(free)))
    by_shift = float(fitted([moved[steady]], (pitch_of(stop) - level)[steady])[0])
    return (
        axles,
        {
            'height': height,
            'lag': lag(height * force, moved, stop.h * EVERY, t),
            'pitch': level - by_shift * height * coasting,
            'pitch_by_shift': by_shift,
            'pitch_by_drive': by_drive(push, slower, by_shift, t),
            'z': float(np.mean(free.height)),
        },
        lock,
    )


def fastest(model: ModelSpec, R0: dict[str, float]) -> float:
    """The speed [m/s] up to which no limiter takes anything of the drive torque; R0: unloaded radii of the axles
    [m]."""
    return min((LIMITER_FROM * top * R0[axle] for axle in AXLES if (top := top_spin(model, axle))), default=math.inf)


def below(limit: float, t: float = 1.0) -> tuple[float, float]:
    """(acceleration [m/s^2], speed [m/s] at its start) of a run for PULL that stays below ROOM of a speed `limit`
    [m/s]: DRIVING and SPEED, or less where a limiter is in the way; t: time of the vehicle's size."""
    pull = min(DRIVING, 0.5 * ROOM * limit / (PULL * t))
    return pull, min(SPEED * t, ROOM * limit - PULL * t * pull)


def by_drive(push: IdentificationRun, free: IdentificationRun, by_shift: float, t: float) -> float:
    """Pitch of a vehicle by a drive torque, besides that by the load that moves to the rear axle [rad/(N m)]; free: a
    run without it, at the speed where it begins."""
    load, level = float(np.mean(free.axle('fz')[:, 1])), float(np.mean(pitch_of(free)))
    u = push.inputs[EVERY - 1 :: EVERY, push.names.index('drive_torque')]
    late = push.time > 1.0 * t
    more = pitch_of(push) - level - by_shift * (push.axle('fz')[:, 1] - load)
    return float(np.mean(more[late] / u[late]))


def along(run: IdentificationRun, i: int, load: float, t: float) -> tuple[float, float, float]:
    """(stiffness [N], peak [N], shape) of an axle's force against slip, from a run that brakes more and more, up to
    SLIP."""
    slip = -0.5 * run.axle('kappa')[:, i]
    used = (slip > 0.0) & (slip < SLIP) & (run.vx > SLOW * t)
    share = np.maximum(run.axle('fz')[:, i] / load, 0.05)[used]
    slip, force = slip[used], -run.axle('fx')[:, i][used] / load
    if len(slip) < 10:  # nothing brakes this axle
        return 20.0 * load, load, 1.5

    def residual(x: np.ndarray) -> np.ndarray:
        K, D, C = 20.0 * (1.0 + x[0]), 1.0 + x[1], 1.5 + x[2]
        wanted = D * characteristic(K * slip / (D * share), C, 0.0) * share
        return np.concatenate([(wanted - force) / math.sqrt(len(force)), PRIOR * x])

    x = least_squares(residual, np.zeros(3)).tolist()
    return 20.0 * load * (1.0 + x[0]), load * (1.0 + x[1]), 1.5 + x[2]


def characteristic(s: np.ndarray, C: float, E: float) -> np.ndarray:
    """Force over its peak at the slip s, relative to peak over stiffness (solver.levels.track_step)."""
    x = s / C
    return each(math.sin, C * each(math.atan, x - E * (x - each(math.atan, x))))


def share(run: IdentificationRun, given: str, i: int, lever: float, inertia: float, t: float) -> float:
    """Share of the torque `given` that the balance of an axle's spin shows; the inertia counts with the sign of the
    torque."""
    u = run.inputs[EVERY - 1 :: EVERY, run.names.index(given)]
    late = (run.time > 1.0 * t) & (run.vx > min(SLOW * t, float(run.vx[0]))) & (u > 0.0)
    spinning = np.gradient(run.spin[:, i], run.time)
    balance = lever * run.axle('fx')[:, i] - run.axle('my')[:, i]
    sign = 1.0 if inertia > 0.0 else -1.0
    return float(np.mean((sign * balance + inertia * spinning)[late] / u[late]))


def lag(wanted: np.ndarray, found: np.ndarray, h: float, t: float = 1.0) -> float:
    """Time constant [s] with which `found` follows `wanted` best, of a table of them."""
    best, smallest = LAGS[0] * t, math.inf
    for tau in (t * usual for usual in LAGS):
        x, error, decay = 0.0, 0.0, math.exp(-h / tau)
        for w, y in zip(wanted.tolist(), found.tolist(), strict=True):
            x = w + (x - w) * decay
            error += (x - y) * (x - y)
        if error < smallest:
            best, smallest = tau, error
    return best
