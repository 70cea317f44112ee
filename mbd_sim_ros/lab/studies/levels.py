"""Study of the levels of detail: what each costs, and how far it is from the whole vehicle in five maneuvers."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mbd_sim_ros.lab.studies.report import Report
from solver.errors import MbdError
from solver.files.scene import load_scene_text
from solver.levels import LEVELS
from solver.levels.error_sheet import cost, courses, error_sheet
from solver.scene import Fidelity

SUMMARY = 'levels of detail of three cars: CPU per step and errors against the whole vehicle in five maneuvers'
VEHICLES = {'full car': 'full_car', 'wishbone car': 'wishbone_car', 'light car': 'light_car'}
DETAILED = 'full car'  # whose CPU time the levels are measured by
HANDLING = ('yaw_rate', 'sideslip_velocity', 'roll', 'wheel_load')
JUDGED: dict[Fidelity, tuple[float, float, tuple[str, ...]]] = {  # level: error allowed, share of the CPU time, quantities
    'condensed': (0.005, 0.5, HANDLING),
    'kc': (0.02, 0.2, HANDLING),
    'single_track': (0.05, 0.03, ('yaw_rate',)),
}
JUDGED_COURSES = 'step steer 0.4 g', 'sine with dwell 3 A', 'swept sine 0.3 g', 'braking 0.5 g', 'road of 2 m'
BELOW_HALF_G = 'step steer 0.4 g', 'swept sine 0.3 g', 'braking 0.5 g'  # where single_track is judged


def study(out: Path, *, quick: bool, progress: Callable[[str, float], None]) -> dict:
    """See mbd_sim_ros.lab.studies."""
    report = Report(out, 'Levels of detail')
    report.text(
        'Every level of a vehicle drives the five maneuvers of `solver.levels.error_sheet` beside the whole vehicle, both with steps of '
        '1 ms. Errors are root mean squares over the run in parts of the peak of the whole vehicle, of the wheels that with the largest. '
        'CPU time is that of the thread per step in the step steer, 100 steps per call, the best of three rounds; it is the one figure '
        'that depends on the machine. What a level does not publish has no figure.'
    )
    data: dict[str, Any] = {}
    levels = [level for level in JUDGED if level in LEVELS]
    pieces = len(VEHICLES) * (len(levels) + 1)
    for c, (car, vehicle) in enumerate(VEHICLES.items()):
        report.text(f'## {car.capitalize()}')
        model = load_scene_text(f'vehicle: vehicles/{vehicle}.yaml', car).model
        first = c * (len(levels) + 1)
        progress(f'{car}: whole', first / pieces)
        step_steer = courses(model)[0]
        whole = cost(model, 'full', step_steer)
        costs: list[dict[str, Any]] = [{'level': 'full', 'CPU per step [us]': whole * 1e6, 'of the whole': 1.0}]
        errors: list[dict[str, Any]] = []
        for n, level in enumerate(levels):
            progress(f'{car}: {level}', (first + 1 + n) / pieces)
            try:
                figures = error_sheet(model, level)
                took = cost(model, level, step_steer)
            except MbdError as error:
                report.text(f'`{level}`: {error}.')
                continue
            costs.append({'level': level, 'CPU per step [us]': took * 1e6, 'of the whole': took / whole})
            errors += [
                {
                    'level': level, 'maneuver': f.maneuver, 'quantity': f.quantity, 'RMS [%]': 100.0 * f.rms,
                    'largest [%]': 100.0 * f.largest, 'peak': f.peak, 'unit': f.unit,
                }
                for f in figures
            ]  # fmt: skip
            allowed, share, quantities = JUDGED[level]
            if car == DETAILED:  # a light car has less to leave out
                report.check(f'{car}, {level}: CPU time of a step, of the whole', took / whole, share)
            judged = BELOW_HALF_G if level == 'single_track' else JUDGED_COURSES
            for name in quantities:
                worst = max((f.rms for f in figures if f.quantity == name and f.maneuver in judged), default=float('nan'))
                report.check(f'{car}, {level}: {name.replace("_", " ")}, RMS error of the peak', worst, allowed)
            data.setdefault(car, {})[level] = {'cost': took, 'errors': [dataclasses.asdict(f) for f in figures]}
        report.table(f'{car.replace(" ", "_")}_cost', costs)
        if errors:
            report.table(f'{car.replace(" ", "_")}_errors', errors)
    report.write()
    return {**data, 'checks': report.checks}
