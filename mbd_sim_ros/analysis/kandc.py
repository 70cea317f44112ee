"""Curves of kinematics and compliance of a vehicle, on the bench of solver.analysis.kinematics_and_compliance.

Every sweep goes from the design position outwards to both sides, and ends where the bench finds no equilibrium: a stop,
or the end of a joint. That is told.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mbd_sim_ros.analysis import pages
from mbd_sim_ros.analysis.evaluation.figures import DEG
from mbd_sim_ros.analysis.pages import Page, write_text
from solver.analysis.figures import is_vehicle
from solver.analysis.kinematics_and_compliance import CORNERS, Rig, kinematic_figures
from solver.analysis.modes import AXLES
from solver.analysis.typical_values import TEXTS
from solver.errors import MbdError, SpecError
from solver.scene import Scene
from solver.vehicle.hardpoints import SIDES

# Ranges of a passenger car; they grow with the vehicle (solver.vehicle.size).
TRAVEL = 0.06  # m of wheel travel to either side; ten times as much lies behind every bump stop
STEERING = 0.5  # rad of the road wheels to either side; ten times as much is more than a turn
FORCE = 3000.0  # N at the contact patch; ten times as much is more than any tire transmits
MOMENT = 100.0  # N m about the vertical; ten times as much is beyond any tire
POINTS = 41  # of a sweep; ten times as many take half a minute and look the same
DECIMALS = 9  # of numbers in SI that are drawn; with ten times as many the rounding of the bench, 1e-13 m, is a curve
FEWEST, MOST = 3, 1001  # points
QUANTITIES = {  # quantity of a corner -> (SI unit, text)
    'toe': ('rad', 'toe (in: positive)'),
    'camber': ('rad', 'camber (top inwards: negative)'),
    'steer': ('rad', 'angle of the road wheel (left: positive)'),
    'load': ('N', 'vertical force at the wheel'),
    'contact_x': ('m', 'contact patch, forward of the design wheel centre'),
    'contact_y': ('m', 'contact patch, to the left of the design wheel centre'),
    'center_x': ('m', 'wheel centre, forward of its design place'),
    'center_y': ('m', 'wheel centre, to the left of its design place'),
}
# SI unit -> (unit for people, factor to it)
PEOPLE = {'rad': ('deg', DEG), 'm': ('mm', 1e3), 'N m/rad': ('N m/deg', 1.0 / DEG), 'N/m': ('N/mm', 1e-3)}
DRAWN = {  # sweep -> quantities of corners that are drawn; all are in its table
    'bump': ('toe', 'camber', 'load', 'contact_y', 'center_x'),
    'roll': ('toe', 'camber', 'steer', 'load', 'contact_y'),
    'steering': ('steer', 'camber', 'load', 'contact_x'),
    'fx': ('steer', 'center_x', 'toe'),
    'fy': ('steer', 'camber', 'contact_y'),
    'mz': ('steer', 'toe'),
}


class Sweep(NamedTuple):
    """One sweep. title: its input, for people. x: (n,) input [unit]. corners: corner -> quantity of QUANTITIES -> (n,).
    axles: axle -> quantity -> (SI unit, text, (n,)), of both wheels. notes: sentences on where it ended."""

    name: str
    title: str
    label: str
    unit: str
    x: np.ndarray
    corners: dict[str, dict[str, np.ndarray]]
    axles: dict[str, dict[str, tuple[str, str, np.ndarray]]]
    notes: tuple[str, ...]

    def columns(self) -> Iterator[tuple[str, np.ndarray]]:
        """Columns of its table, with their units: the input first."""
        yield f'{self.label} [{self.unit}]', self.x
        for corner, found in self.corners.items():
            for name, values in found.items():
                yield f'{corner} {name} [{QUANTITIES[name][0]}]', values
        for axle, of in self.axles.items():
            for name, (unit, _, values) in of.items():
                yield f'{axle} {name} [{unit}]', values


class Bench(NamedTuple):
    """All sweeps of a vehicle, and its figures at the design position (kinematic_figures())."""

    sweeps: tuple[Sweep, ...]
    figures: dict[str, float]


def measure(scene: Scene, *, travel: float | None = None, steering: float | None = None, points: int = POINTS) -> Bench:
    """Sweeps of the vehicle of a scene: both wheels of an axle in bump together, opposite (roll), the steering wheel,
    and forces and moments at the contact patches, equal and opposite left and right.

    travel: to either side [m]. steering: of the steering wheel to either side [rad]. Both None: as of a passenger car,
    by the size of the vehicle. Raises SpecError for what is no car with tires at four corners.
    """
    if not is_vehicle(scene.model):
        raise SpecError(
            f'{scene.name}: the bench of mbd kandc needs a vehicle with the four wheels front_left, front_right, '
            'rear_left and rear_right; mbd list vehicles names some'
        )
    rig = Rig(scene.model)
    figures = kinematic_figures(rig)
    size = rig.size
    half = TRAVEL * size.length if travel is None else travel
    turned = STEERING * figures['steering_ratio'] if steering is None else steering
    force, moment = FORCE * size.mass, MOMENT * size.torque

    def both(name: str) -> Callable[[float], dict[str, float]]:
        return lambda value: {f'{name}_{corner}': value for corner in CORNERS}

    def opposite(name: str) -> Callable[[float], dict[str, float]]:
        return lambda value: {f'{name}_{c}': value * SIDES[c.partition('_')[2]] for c in CORNERS}

    asked: list[tuple[str, str, str, str, float, Callable[[float], dict[str, float]]]] = [
        ('bump', 'Bump: all wheels up together', 'wheel travel', 'm', half, both('travel')),
        ('roll', 'Roll: left wheels up, right wheels down', 'wheel travel, left', 'm', half, opposite('travel')),
        ('steering', 'Steering wheel', 'steering wheel', 'rad', abs(turned), lambda value: {'steering': value}),
    ]
    for load, text, unit, most in (
        ('fx', 'Longitudinal force at the contact patches', 'N', force),
        ('fy', 'Lateral force at the contact patches', 'N', force),
        ('mz', 'Aligning moment at the contact patches', 'N m', moment),
    ):
        label = f'{load} of a wheel'
        asked.append((f'{load}_equal', f'{text}, equal left and right', label, unit, most, both(load)))
        asked.append((f'{load}_opposite', f'{text}, opposite', f'{label}, left', unit, most, opposite(load)))
    sweeps = []
    for name, title, label, unit, most, of in asked:
        x, rows, notes = _outwards(rig, most, unit, points, of)
        corners = {c: {key: np.array([row[c][key] for row in rows]) for key in QUANTITIES} for c in CORNERS}
        axles = _of_axles(rig, name, x, corners)
        sweeps.append(Sweep(name, title, label, unit, x, corners, axles, notes))
    return Bench(tuple(sweeps), figures)


def _outwards(
    rig: Rig, most: float, unit: str, points: int, of: Callable[[float], dict[str, float]]
) -> tuple[np.ndarray, list[dict[str, dict[str, float]]], tuple[str, ...]]:
    """(inputs in rising order, what the bench finds at each, sentences on the ends that it does not reach)."""
    x = np.linspace(-most, most, points if points % 2 else points + 1)
    middle = len(x) // 2
    found: dict[int, dict[str, dict[str, float]]] = {}
    notes = []
    for way in (range(middle, len(x)), range(middle - 1, -1, -1)):
        for k in way:
            try:
                found[k] = rig.settle(of(float(x[k])))
            except MbdError as error:
                if k == middle:
                    raise
                last = x[k - 1 if k > middle else k + 1]
                notes.append(f'ends at {last:.4g} {unit}: {str(error).partition(";")[0]}')
                break
        rig.reset()
    kept = sorted(found)
    return x[kept], [found[k] for k in kept], tuple(notes)


def _of_axles(
    rig: Rig, sweep: str, x: np.ndarray, corners: Mapping[str, Mapping[str, np.ndarray]]
) -> dict[str, dict[str, tuple[str, str, np.ndarray]]]:
    """Quantities of both wheels of an axle: wheel rate in bump, roll stiffness and height of the roll centre in roll
    (as kinematic_figures() has them at the design position), share of Ackermann's condition when steered."""
    found: dict[str, dict[str, tuple[str, str, np.ndarray]]] = {axle: {} for axle in AXLES}
    if len(x) < FEWEST:
        return found
    for axle in AXLES:
        left = corners[f'{axle}_left']
        track = rig.centers[f'{axle}_left'][1] - rig.centers[f'{axle}_right'][1]
        if sweep == 'bump':
            found[axle]['wheel_rate'] = ('N/m', 'wheel rate', np.gradient(left['load'], x))
        if sweep == 'roll':
            rate = 0.5 * np.gradient(left['load'], x) * track * track
            found[axle]['roll_stiffness'] = ('N m/rad', 'roll stiffness', rate)
            height = 0.5 * track * np.gradient(left['contact_y'], x)
            found[axle]['roll_center'] = ('m', 'height of the roll centre', height)
    return found


def write_tables(bench: Bench, directory: Path) -> list[Path]:
    """One CSV file for each sweep, the unit in every header. Raises BagError."""
    files = []
    for sweep in bench.sweeps:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator='\n')
        columns = dict(sweep.columns())
        writer.writerow(columns)
        writer.writerows([f'{value:.9g}' for value in row] for row in zip(*columns.values(), strict=True))
        files.append(directory / f'{sweep.name}.csv')
        write_text(files[-1], text.getvalue())
    return files


def figure_rows(bench: Bench) -> list[tuple[str, str]]:
    """The figures at the design position for people, a head first."""
    rows = [('figure at the design position', 'value')]
    for name, value in bench.figures.items():
        if name in TEXTS:
            text, unit, factor = TEXTS[name]
            rows.append((text, f'{value * factor:.4g} {unit}'.rstrip()))
    return rows


def write_page(bench: Bench, file: Path, title: str, facts: Sequence[tuple[str, str]]) -> None:
    """The page of a bench: a chart for each quantity of each sweep, with a curve for each wheel or axle. Raises
    BagError."""
    blocks = [pages.table(figure_rows(bench))]
    blocks.append(pages.text('Toe-in is positive, camber with the top inwards negative, steer to the left positive.'))
    for sweep in bench.sweeps:
        blocks.append(pages.heading(sweep.title))
        if sweep.notes:
            blocks.append(pages.text(*(f'Note: {note}' for note in sweep.notes)))
        x_label, fx = _people(sweep.label, sweep.unit)
        drawn = []  # right wheels are dashed, for they often lie upon the left ones
        for name in DRAWN[sweep.name.partition('_')[0]]:
            unit, text = QUANTITIES[name]
            y_label, fy = _people(name.replace('_', ' '), unit)
            curves = [
                pages.curve(
                    c.replace('_', ' '), fx * sweep.x, fy * np.round(found[name], DECIMALS), colour=k, dash=k % 2
                )
                for k, (c, found) in enumerate(sweep.corners.items())
            ]
            drawn.append(pages.chart(text, x_label, y_label, curves, linked=sweep.name))
        for name in dict.fromkeys(name for of in sweep.axles.values() for name in of):
            unit, text, _ = next(of[name] for of in sweep.axles.values() if name in of)
            y_label, fy = _people(text, unit)
            curves = [
                pages.curve(axle, fx * sweep.x, fy * np.round(of[name][2], DECIMALS), colour=2 * k)
                for k, (axle, of) in enumerate(sweep.axles.items())
                if name in of
            ]
            drawn.append(pages.chart(text, x_label, y_label, curves, linked=sweep.name))
        blocks.append(pages.charts(drawn))
    Page(title=title, facts=facts, blocks=blocks).write(file)


def _people(label: str, unit: str) -> tuple[str, float]:
    shown, factor = PEOPLE.get(unit, (unit, 1.0))
    return f'{label} [{shown}]', factor
