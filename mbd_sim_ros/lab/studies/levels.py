"""Study of the levels of detail: how far each is from the whole vehicle in six maneuvers."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mbd_sim_ros.lab.studies.report import Report
from solver.errors import MbdError
from solver.files.scene import load_scene_text
from solver.levels import LEVELS
from solver.levels.error_sheet import error_sheet
from solver.scene import Fidelity

SUMMARY = 'levels of detail of three cars: errors against the whole vehicle in six maneuvers'
VEHICLES = {'full car': 'full_car', 'wishbone car': 'wishbone_car', 'light car': 'light_car'}
HANDLING = ('yaw_rate', 'sideslip_velocity', 'roll', 'wheel_load')
JUDGED: dict[Fidelity, tuple[float, tuple[str, ...]]] = {  # level: error allowed, quantities
    'condensed': (0.005, HANDLING),
    'kc': (0.02, HANDLING),
    'single_track': (0.05, ('yaw_rate',)),
}
JUDGED_COURSES = (
    'step steer 0.4 g',
    'sine with dwell 3 A',
    'swept sine 0.3 g',
    'braking 0.5 g',
    'pulling 0.2 g',
    'road of 2 m',
)
BELOW_HALF_G = 'step steer 0.4 g', 'swept sine 0.3 g', 'braking 0.5 g', 'pulling 0.2 g'  # where single_track is judged


def study(out: Path, *, quick: bool, progress: Callable[[str, float], None]) -> dict:
    """See mbd_sim_ros.lab.studies."""
    report = Report(out, 'Levels of detail')
    report.text(
        'Every level of a vehicle drives the six maneuvers of `solver.levels.error_sheet` beside the whole vehicle, '
        'both with steps of 1 ms. Errors are root mean squares over the run in parts of the peak of the whole '
        'vehicle, of the wheels that with the largest. What a level does not publish has no figure. What a step costs '
        'is measured by `mbd bench --cases car_levels`.'
    )
    data: dict[str, Any] = {}
    levels = [level for level in JUDGED if level in LEVELS]
    pieces = len(VEHICLES) * len(levels)
    for c, (car, vehicle) in enumerate(VEHICLES.items()):
        report.text(f'## {car.capitalize()}')
        model = load_scene_text(f'vehicle: vehicles/{vehicle}.yaml', car).model
        errors: list[dict[str, Any]] = []
        for n, level in enumerate(levels):
            progress(f'{car}: {level}', (c * len(levels) + n) / pieces)
            try:
                figures = error_sheet(model, level)
            except MbdError as error:
                report.text(f'`{level}`: {error}.')
                continue
            errors += [
                {
                    'level': level, 'maneuver': f.maneuver, 'quantity': f.quantity, 'RMS [%]': 100.0 * f.rms,
                    'largest [%]': 100.0 * f.largest, 'peak': f.peak, 'unit': f.unit,
                }
                for f in figures
            ]  # fmt: skip
            allowed, quantities = JUDGED[level]
            judged = BELOW_HALF_G if level == 'single_track' else JUDGED_COURSES
            for name in quantities:
                worst = max(
                    (f.rms for f in figures if f.quantity == name and f.maneuver in judged), default=float('nan')
                )
                report.check(f'{car}, {level}: {name.replace("_", " ")}, RMS error of the peak', worst, allowed)
            data.setdefault(car, {})[level] = [dataclasses.asdict(f) for f in figures]
        if errors:
            report.table(f'{car.replace(" ", "_")}_errors', errors)
    report.write()
    return {**data, 'checks': report.checks}
