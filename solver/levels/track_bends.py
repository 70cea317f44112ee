"""Identification by runs in bends: the characteristics of its axles, roll, what the steering wheel feels, and where it
all holds."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from solver.analysis.figures import standing
from solver.analysis.modes import named_modes
from solver.compiled.by_reference import Ref
from solver.errors import ConsistencyError, SpecError
from solver.inputs.maneuver import Maneuver
from solver.inputs.signals import Ramp, Step
from solver.levels.fitting import PRIOR, fitted
from solver.levels.single_track_engine import AXLES, COMMANDS, new_frame, new_scratch, rolling, tables_of
from solver.levels.track_runs import EVERY, SPEED, Drive, IdentificationRun, driven, pitch_of, roll_of
from solver.levels.track_step import advance
from solver.levels.track_straight import characteristic
from solver.levels.track_tables import DRIVE, FY, ROLL, SATURATION, SHIFT
from solver.model.spec import ModelSpec
from solver.scene import Scene
from solver.vehicle.size import size_of

# speeds, times and the lengths in limits() are those of a passenger car and grow with the vehicle (solver.vehicle.size)
FAST = 33.0  # m/s
FASTER = (45.0, 60.0)  # m/s, where what was found is looked at beside the vehicle
# m/s in reverse, where it is looked at too: trails are others there, and so is what they turn elastically
BACKWARDS = (5.0, 10.0)
GENTLE, GENTLEST = 2.0, 0.2  # m/s^2 there, at most [1/s] times the speed
LATERAL = 4.0  # m/s^2 that the steps are meant for
RAMP = 12.0  # m/s^2 that the ramp would end at if nothing saturated
COMBINED = 3.0  # m/s^2, along and across
SATURATED = 7.0  # m/s^2: what is beyond weighs less and less
UNDERSTEER = 0.003  # rad s^2/m that runs in bends are laid out with
# of unknowns that may start at zero; the others are relative to their start
SCALES = {'curvature_y': 1.0, 'roll_steer': 0.1, 'axis': 0.1}
SHORTEST = 0.1  # relaxation length, of that of the tires
ERROR = 0.05  # of the peak: what the level is meant to keep, and its limits follow from


class Lateral:
    """The search for what the runs in bends tell; its unknowns are relative to their start, one each."""

    NAMES = (
        *(
            (axle, name)
            for axle in AXLES
            for name in ('stiffness_y', 'stiffness_load', 'peak_y', 'shape_y', 'curvature_y')
        ),
        *((axle, name) for axle in AXLES for name in ('length_y', 'roll_steer')),
        *(('body', name) for name in ('coupling', 'roll_stiffness', 'roll_damping')),
        ('mounting', 'axis'),
    )

    def __init__(
        self,
        scene: Scene,
        start: dict[str, dict[str, float]],
        inertia: np.ndarray,
        runs: list[tuple[Drive, IdentificationRun]],
    ) -> None:
        self.scene, self.given, self.inertia, self.runs = scene, start, inertia, runs
        lengths = {'axis': SCALES['axis'] * size_of(scene.model).length}
        self.scales = [{**SCALES, **lengths}.get(name, 0.0) or start[part][name] for part, name in self.NAMES]
        self.weights = []
        for _, run in runs:
            lateral = np.abs(run.vx * run.yaw_rate)
            less = 1.0 / np.sqrt(1.0 + (lateral / SATURATED) ** 8)
            shown = (run.yaw_rate, run.vy, roll_of(run))
            self.weights.append([(y, less / (np.abs(y).max() * math.sqrt(len(y)))) for y in shown])

    def parameters(self, x: np.ndarray) -> dict[str, dict[str, float]]:
        """All parameters at the unknowns x."""
        found = {part: dict(values) for part, values in self.given.items()}
        for (part, name), scale, value in zip(self.NAMES, self.scales, x.tolist(), strict=True):
            found[part][name] = self.given[part][name] + scale * value
        for axle in AXLES:  # where steering by its own forces outruns the tires, an axle answers as fast as one may
            found[axle]['length_y'] = max(found[axle]['length_y'], SHORTEST * self.given[axle]['length_y'])
        S, m = found['body']['coupling'], found['body']['mass']
        found['body']['roll_inertia'] = float(self.inertia[0, 0]) + S * S / m  # about the axis of roll
        return found

    def residual(self, x: np.ndarray) -> np.ndarray:
        """Errors of yaw rate, lateral velocity and roll, relative to their peaks, root mean square over each run; and
        the prior."""
        tables = Ref(tables_of(self.parameters(x), self.scene))
        parts = [PRIOR * x]
        for (drive, run), weights in zip(self.runs, self.weights, strict=True):
            shown = replay(tables, drive, run)
            parts += [(ours - theirs) * weight for ours, (theirs, weight) in zip(shown[:3], weights, strict=True)]
        return np.concatenate(parts)


def replay(tables: Ref, drive: Drive, run: IdentificationRun) -> tuple[np.ndarray, ...]:
    """(yaw rate, lateral velocity, roll; lateral force and saturation of the front axle; pitch by load that moved and
    by the drive) of the level, its tables by reference, under the inputs of a run, at its samples.
    """
    y, w = rolling(tables.value, drive.speed), new_scratch()
    frame = Ref(new_frame(len(run.names)))
    index = np.array([run.names.index(name) for name in COMMANDS])
    inputs, u = run.inputs, run.inputs[0].copy()
    twist, told = frame.value.twist[0], w.value.told
    rows, m = np.empty((6, len(run.time))), tables.value.mounting
    for k in range(len(run.time)):
        advance(tables, y, inputs, index, u, k * EVERY, EVERY, False, run.h, 1, w, frame)
        rows[:, k] = (
            twist[5],
            twist[1],
            y[ROLL],
            told[FY],
            told[SATURATION],
            m.pitch_by_shift * y[SHIFT] + m.pitch_by_drive * y[DRIVE],
        )
    return tuple(rows)


def feel(found: dict[str, dict[str, float]], scene: Scene, runs: list[tuple[Drive, IdentificationRun]]) -> None:
    """Add what the steering wheel feels, inertia, damping and the trail of the front axle, and the pitch that comes
    with roll, by least squares of torque and pitch.
    """
    columns: list[list[np.ndarray]] = [[], [], [], []]
    torque, rolled, pitched = [], [], []
    body, mounting = found['body'], found['mounting']
    for drive, run in runs:
        _, _, roll, force, saturation, lengthwise = replay(Ref(tables_of(found, scene)), drive, run)
        rolled.append(roll * roll)
        pitched.append(pitch_of(run) - mounting['pitch'] - lengthwise)
        angle, rate, acceleration = (run.inputs[EVERY - 1 :: EVERY, run.names.index(name)] for name in COMMANDS[:3])
        lever = (body['ratio'] + 3.0 * body['ratio_3'] * angle * angle) * force
        for column, values in zip(columns, (acceleration, rate, lever, -lever * saturation), strict=True):
            column.append(values)
        torque.append(run.effort)
    inertia, damping, trail, lost = fitted([np.concatenate(c) for c in columns], np.concatenate(torque)).tolist()
    body |= {'steering_inertia': max(inertia, 0.0), 'steering_damping': max(damping, 0.0)}
    found['front'] |= {'trail': trail, 'trail_lost': lost}
    mounting['pitch_by_roll'] = float(fitted([np.concatenate(rolled)], np.concatenate(pitched))[0])


def limits(
    found: dict[str, dict[str, float]],
    scene: Scene,
    runs: list[tuple[Drive, IdentificationRun]],
    lock: IdentificationRun,
    model: ModelSpec,
) -> list[dict[str, Any]]:
    """Limits of the level, as fields of Limit: as far as it follows the ramp and the braking to ERROR, and those of
    effects that it leaves out."""
    size = size_of(model)
    drive, run = runs[0]
    shown_ = replay(Ref(tables_of(found, scene)), drive, run)
    lateral = run.vx * run.yaw_rate
    wrong = (np.abs(shown_[0] - run.yaw_rate) > ERROR * np.abs(run.yaw_rate)) & (lateral > 1.0)
    last = int(np.argmax(wrong)) if wrong.any() else len(wrong) - 1
    last = max(0, min(last, int(np.argmax(lateral))) - 1)
    braked_drive, braked = runs[-1]
    error = np.abs(replay(Ref(tables_of(found, scene)), braked_drive, braked)[0] - braked.yaw_rate)
    wrong = error > ERROR * np.abs(braked.yaw_rate).max()
    end = int(np.argmax(wrong)) if wrong.any() else len(wrong)
    both = np.sqrt(
        np.abs((np.gradient(braked.vx, braked.time) - braked.vy * braked.yaw_rate) * braked.vx * braked.yaw_rate)
    )
    slips = []
    for i, axle in enumerate(AXLES):
        a = found[axle]
        share = np.maximum(lock.axle('fz')[:, i] / a['load'], 0.05)
        kappa = np.abs(0.5 * lock.axle('kappa')[:, i])
        wanted = a['peak_x'] * characteristic(
            kappa * a['stiffness_x'] / (a['peak_x'] * share), a['shape_x'], a['curvature_x']
        )
        error = np.abs(-lock.axle('fx')[:, i] / share - wanted)
        wrong = error > ERROR * a['peak_x']
        slips.append(float(kappa[: int(np.argmax(wrong))].max(initial=0.0)) if wrong.any() else float(kappa.max()))
    fastest, backwards = followed(found, scene, runs, model)
    hop = min(
        mode.frequency
        for name, mode in named_modes(standing(dataclasses.replace(scene, model=model))).items()
        if 'hop' in name
    )
    identified_ = f'the runs it was identified from are followed to {100 * ERROR:g} % up to there'
    rows = (
        ('lateral acceleration', 'm/s^2', float(np.abs(lateral[: last + 1]).max()), identified_),
        ('slip angle', 'rad', float(np.abs(0.5 * run.axle('alpha')[last]).max()), identified_),
        ('slip', '', min(slips), identified_),
        (
            'combined acceleration',
            'm/s^2',
            float(both[:end].max(initial=0.0)),
            f'root of the product of both; {identified_}',
        ),
        (
            'frequency',
            'Hz',
            math.sqrt(ERROR) * hop,
            f'wheels hop at {hop:.3g} Hz: what follows them at once is {100 * ERROR:g} % wrong',
        ),
        ('friction difference', '', 0.1, 'both wheels of an axle are one'),
        ('road height', 'm', 0.005 * size.length, 'it drives on a plane'),
        ('road slope', '', 0.005, 'it drives on the level'),
    )
    why = f'gentle bends of the vehicle are followed to {100 * ERROR:g} % up to there'
    weight, speed_of_loads = -found['body']['mass'] * model.gravity[2], SPEED * size.speed
    slowest = slowest_pressed(sum(found[axle]['load'] for axle in AXLES), weight, speed_of_loads)
    low = 0.0 - backwards
    if slowest is not None:
        low, why = (
            slowest,
            f'{why}; slower, wings press down less by more than {100 * ERROR:g} % of the loads, which are those of '
            f'{speed_of_loads:g} m/s',
        )
    speed = {'quantity': 'longitudinal_velocity', 'unit': 'm/s', 'low': low, 'high': fastest, 'why': why}
    return [
        speed,
        *(
            {'quantity': quantity, 'unit': unit, 'high': float(f'{high:.3g}'), 'why': why}
            for quantity, unit, high, why in rows
        ),
    ]


def slowest_pressed(loaded: float, weight: float, speed: float = SPEED) -> float | None:
    """The speed [m/s] below which a car that wings press down, with the square of the speed, carries less by ERROR than
    what its axles are loaded with at a speed, SPEED of its size, [N]; None for one that they hardly press."""
    pressed = loaded - weight
    return speed * math.sqrt(1.0 - ERROR * loaded / pressed) if pressed > ERROR * loaded else None


def followed(
    found: dict[str, dict[str, float]], scene: Scene, runs: list[tuple[Drive, IdentificationRun]], model: ModelSpec
) -> tuple[float, float]:
    """The speeds [m/s], forward and in reverse, up to which the level follows a gentle step: FAST, where it is
    identified, or one of FASTER, since a car next to neutral, or with wings, is soon another one; one of BACKWARDS, or
    none.
    """
    ratio, wheelbase = steered(found), found['front']['x'] - found['rear']['x']
    _, run = runs[2]
    turned = run.inputs[-1, run.names.index(COMMANDS[0])]
    understeer = (ratio * turned / float(run.yaw_rate[-1]) - wheelbase / float(run.vx[-1])) / float(run.vx[-1])
    reached, t = [], size_of(model).time
    for sign, least, speeds in ((1.0, FAST * t, FASTER), (-1.0, 0.0, BACKWARDS)):
        for speed in (t * usual for usual in speeds):
            value = min(GENTLE, GENTLEST / t * speed) * (wheelbase / speed**2 + sign * understeer) / ratio
            # none above the critical speed of a car that oversteers
            if not value > 0.0 or not follows(found, scene, model, sign * speed, value):
                break
            least = speed
        reached.append(least)
    return reached[0], reached[1]


def follows(found: dict[str, dict[str, float]], scene: Scene, model: ModelSpec, speed: float, value: float) -> bool:
    """True where the level follows a step of the steering wheel to `value` [rad] at a speed [m/s] to ERROR: root mean
    square of the yaw rate over its peak."""
    t = size_of(model).time
    steering = Step(value=value, start=0.5 * t, rise=0.15 * t)
    maneuver = Maneuver(steering=steering, drive_torque=math.copysign(1.0, speed) * holding(found, speed))
    drive = Drive(speed=speed, maneuver=maneuver, duration=3.0 * t)
    try:
        theirs = driven(model, drive)
    except (SpecError, ConsistencyError):
        return False
    error = replay(Ref(tables_of(found, scene)), drive, theirs)[0] - theirs.yaw_rate
    peak = float(np.abs(theirs.yaw_rate).max())
    return bool(theirs.time[-1] >= 2.5 * t and math.sqrt(float(np.mean(error * error))) <= ERROR * peak)


def steered(parameters: dict[str, dict[str, float]]) -> float:
    """Angle between both axles per turn of the steering wheel [rad/rad]."""
    return parameters['body']['ratio'] * (parameters['front']['steered'] - parameters['rear']['steered'])


def holding(parameters: dict[str, dict[str, float]], speed: float) -> float:
    """The drive torque [N m] that keeps a speed [m/s] straight on."""
    shares = sum(parameters[axle]['drive'] / parameters[axle]['radius'] for axle in AXLES)
    rolling_ = sum(parameters[axle]['resistance'] * parameters[axle]['load'] for axle in AXLES)
    return (parameters['body']['drag'] * speed**2 + rolling_) / shares if shares > 0.0 else 0.0


def bends(start: dict[str, dict[str, float]], wheelbase: float, t: float = 1.0) -> list[Drive]:
    """A ramp and a step at SPEED and a step at FAST, with the torque that keeps the speed straight on, and a step that
    is braked then; t: time of the vehicle's size."""
    body, ratio = start['body'], steered(start)

    def wheel(lateral: float, speed: float) -> float:
        return lateral * (wheelbase / speed**2 + UNDERSTEER) / ratio

    usual, fast = SPEED * t, FAST * t
    end = wheel(RAMP, usual)
    ramp = Ramp(slope=end / (6.0 * t), start=0.5 * t, final=end)
    drives = [
        Drive(speed=usual, maneuver=Maneuver(steering=ramp, drive_torque=holding(start, usual)), duration=7.0 * t)
    ]
    for speed in (usual, fast):
        step = Step(value=wheel(LATERAL, speed), start=0.5 * t, rise=0.15 * t)
        drives.append(
            Drive(speed=speed, maneuver=Maneuver(steering=step, drive_torque=holding(start, speed)), duration=3.0 * t)
        )
    brake = Step(value=COMBINED * body['mass'] * start['front']['radius'], start=2.0 * t, rise=0.2 * t)
    step = Step(value=wheel(COMBINED, usual), start=0.5 * t, rise=0.15 * t)
    return [*drives, Drive(speed=usual, maneuver=Maneuver(steering=step, brake_torque=brake), duration=4.0 * t)]
