"""The cars of the study of stability in what they are not made for.

Short runs are judged by convergence: the chassis frame (place [m] and twice the quaternion) against a run of FINEST,
whose distance to one of twice that step says how far it can be trusted: where an impact or a tumbling car makes
neighbours part, nothing is decided. Long ones at rest are judged by what must be: a braked car stays where it is.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mbd_sim_ros.lab.mechanisms.judgement import RIGHT, TOLD, UNDECIDED, WORSE, WRONG
from solver import simulation_of
from solver.analysis.verdict import findings, status_of
from solver.errors import MbdError, StepError
from solver.files.scene import load_scene
from solver.simulation import Simulation

CARS = {'light': 'vehicles/light_car.yaml', 'full': 'vehicles/full_car.yaml'}
STEPS = (4e-3, 2e-3, 1e-3, 0.5e-3)  # s
FINEST = 0.25e-3  # s
SAMPLE = 0.02  # s
# of an error: what two references may differ by, that of twice the step has itself a quarter of the error of four times
TRUSTED = 0.3
KNOWN = 0.1  # m or rad: where two references differ by more, the motion is not known (a car that tumbles)
STAYS = 1e-3  # m that a standing car may have moved
NEGLIGIBLE = 1e-5  # m or rad


class Task(NamedTuple):
    """A scene by its overrides. duration [s]; at_rest: the car must stay where it is, which is judged at one step
    instead."""

    title: str
    overrides: tuple[str, ...]
    duration: float
    at_rest: bool = False


def _hill(height: float, length: float) -> str:
    """A road with one hump, a whole period of a raised cosine, 20 m ahead."""
    n = 40
    z = [0.5 * height * (1.0 - np.cos(2.0 * np.pi * k / n)) for k in range(n + 1)]
    rows = ', '.join(f'[{x:.9g}, {x:.9g}]' for x in z)
    return f'road={{grids: [{{kind: height_grid, origin: [20, -10], step: [{length / n:.9g}, 20], height: [{rows}]}}]}}'


def _road_of_patches() -> str:
    """Ice and asphalt, 2 m each, sides out of step."""
    patches = [
        f'{{center: [{6 + 2 * k}, {y}], size: [2, 4], factor: 0.1}}'
        for k in range(30)
        for y in ((2.0,), (-2.0,))[k % 2]
    ]
    return f'road={{patches: [{", ".join(patches)}]}}'


STRAIGHT = 'maneuver={drive_torque: 100}'
SLOPE = 'road={normal: [-0.28734788556, 0, 0.95782628522]}'  # 30 %
EQUILIBRIUM = 'start={kind: equilibrium}'


def at_speed(speed_kmh: float) -> str:
    """A start that rolls."""
    return f'start={{kind: equilibrium, speed_kmh: {speed_kmh:g}}}'


TASKS: dict[str, Task] = {
    'standstill': Task('standstill, 60 s', (EQUILIBRIUM, 'maneuver={brake_torque: 1000}'), 60.0, True),
    'slope': Task('30 % slope, braked, 10 min', (EQUILIBRIUM, SLOPE, 'maneuver={brake_torque: 12000}'), 600.0, True),
    'to_rest': Task(
        'braked to rest, through zero',
        (at_speed(20), 'maneuver={brake_torque: {kind: step, value: 4500, start: 0.2, rise: 0.2}}'),
        4.0,
    ),
    'back_and_forth': Task(
        'driven back and forth through zero speed',
        (at_speed(5), 'maneuver={drive_torque: {kind: sine, amplitude: 1500, frequency: 0.4, phase: 3.14159265}}'),
        5.0,
    ),
    'reverse': Task(
        'reverse at 30 km/h, steering',
        (at_speed(-30), 'maneuver={steering: {kind: step, value: 2, start: 0.3, rise: 0.5}}'),
        3.0,
    ),
    'ice': Task(
        'friction 0.001, the least there is, steering and braking',
        (at_speed(60), 'road={friction: 0.001}', 'maneuver={steering: 1, brake_torque: 1000}'),
        3.0,
    ),
    'sticky': Task(
        'friction 2, hard braking in a curve',
        (
            at_speed(80),
            'road={friction: 2}',
            'maneuver={brake_torque: {kind: step, value: 9000, start: 0.5, rise: 0.2}, steering: 0.5}',
        ),
        2.5,
    ),
    'patches': Task(
        'friction jumps 0.1 to 1 every 2 m, braking',
        (at_speed(80), _road_of_patches(), 'maneuver={brake_torque: {kind: step, value: 3000, start: 0.3, rise: 0.2}}'),
        3.0,
    ),
    'locked': Task(
        'locked wheels from 100 km/h',
        (at_speed(100), 'maneuver={brake_torque: {kind: step, value: 30000, start: 0.3, rise: 0.1}}'),
        3.0,
    ),
    'free': Task('free wheels, coasting at 50 km/h', (at_speed(50), 'maneuver={steering: 0.5}'), 3.0),
    'lift_off': Task(
        'lift-off over a hump of 0.5 m in 12 m at 90 km/h', (at_speed(90), _hill(0.5, 12.0), STRAIGHT), 3.0
    ),
    'landing': Task(
        'landing from 1 m at 15 m/s', ('start={kind: as_placed, speed: 15}', 'road={point: [0, 0, -1]}', STRAIGHT), 3.0
    ),
    'rollover': Task(
        'rollover: step steer at 110 km/h on friction 2.5',
        (at_speed(110), 'road={friction: 2.5}', 'maneuver={steering: {kind: step, value: 5, start: 0.2, rise: 0.3}}'),
        5.0,
    ),
    'fast': Task(
        '300 km/h, slalom',
        (at_speed(300), 'maneuver={steering: {kind: sine, amplitude: 0.1, frequency: 0.5, start: 0.3}}'),
        3.0,
    ),
    'whipped': Task(
        'steering wheel turned with 2000 deg/s',
        (at_speed(60), 'maneuver={steering: {kind: sine, amplitude: 2, frequency: 2.7778, start: 0.2, blend: 0.1}}'),
        2.0,
    ),
    'torque': Task(
        'drive torque of 1e5 N m',
        (at_speed(30), 'maneuver={drive_torque: {kind: step, value: 1.0e5, start: 0.3, rise: 0.2}}'),
        2.0,
    ),
}


def simulation(car: str, task: Task, h: float) -> Simulation:
    """A task of a car at a step, with default settings. Raises MbdError."""
    scene = 'light_car_straight' if car == 'light' else 'car_step_steer'
    return simulation_of(
        load_scene(scene, [*task.overrides, f'integrator={{h: {h}}}', 'require={}', f'duration={task.duration}'])
    )


def motion(car: str, task: Task, h: float) -> tuple[str, str, np.ndarray]:
    """(status, text, chassis (n, 7) every SAMPLE as far as it came)."""
    rows: list[np.ndarray] = []
    try:
        s = simulation(car, task, h)
        rows.append(s.snapshot().pose[0].copy())
        for _ in range(round(task.duration / SAMPLE)):
            rows.append(s.advance(round(SAMPLE / h)).pose[0].copy())
    except StepError as error:
        return 'error', str(error), np.array(rows)
    except MbdError as error:
        return 'refused', str(error), np.zeros((0, 7))
    found = findings(s)
    return status_of(found), '; '.join(map(str, found)), np.array(rows)


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """Largest difference of two motions of a chassis, as far as both came."""
    n = min(len(one), len(other))
    if not n:
        return np.nan
    sign = np.where((one[:n, 3:] * other[:n, 3:]).sum(1) < 0.0, -1.0, 1.0)[:, None]
    return float(max(np.abs(one[:n, :3] - other[:n, :3]).max(), 2.0 * np.abs(one[:n, 3:] - sign * other[:n, 3:]).max()))


def converging(car: str, task: Task, steps: tuple[float, ...] = STEPS) -> dict[str, Any]:
    """Runs at all steps, judged by the finest."""
    finest = motion(car, task, FINEST)
    spread = apart(finest[2], motion(car, task, 2 * FINEST)[2])
    found = [(h, *motion(car, task, h)) for h in steps]
    errors = {h: apart(q, finest[2]) for h, *_, q in found if len(q) == len(finest[2])}
    ok = {h for h, status, *_ in found if status == 'ok'}
    runs = []
    for h, status, text, _ in found:
        error = errors.get(h, np.nan)
        others = [errors[other] / other**2 for other in ok - {h} if other in errors]
        allowed = max(NEGLIGIBLE, WORSE * h * h * float(np.median(others))) if others else np.nan
        if status != 'ok':
            judgement = TOLD
        elif finest[0] in ('error', 'refused') or not others or spread > KNOWN:
            judgement = UNDECIDED
        elif error <= allowed:
            judgement = RIGHT
        else:
            judgement = UNDECIDED if spread >= TRUSTED * error else WRONG
        runs.append(
            {'h': h, 'status': status, 'text': text, 'error': error, 'allowed': allowed, 'judgement': judgement}
        )
    return {'car': car, 'title': task.title, 'spread': spread, 'finest': finest[0], 'runs': runs}


def staying(car: str, task: Task, steps: tuple[float, ...] = (4e-3, 1e-3)) -> dict[str, Any]:
    """Runs of a car that must stay where it is."""
    runs = []
    for h in steps:
        status, text, q = motion(car, task, h)
        error = apart(q, np.broadcast_to(q[0], q.shape)) if len(q) else np.nan
        judgement = TOLD if status != 'ok' else RIGHT if error <= STAYS else WRONG
        runs.append({'h': h, 'status': status, 'text': text, 'error': error, 'allowed': STAYS, 'judgement': judgement})
    return {'car': car, 'title': task.title, 'spread': 0.0, 'finest': '', 'runs': runs}


def cell(car: str, name: str, quick: bool) -> dict[str, Any]:
    """A task of a car, judged; quick: a tenth of the time and two steps."""
    task = TASKS[name]
    if quick:
        task = task._replace(duration=max(SAMPLE, round(task.duration / 10 / SAMPLE) * SAMPLE))
    if task.at_rest:
        return staying(car, task, (4e-3,) if quick else (4e-3, 1e-3))
    return converging(car, task)
