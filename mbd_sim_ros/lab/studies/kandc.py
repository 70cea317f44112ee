"""Study of kinematics and compliance: the sheet a test bench gives, for every delivered car."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbd_sim_ros.lab.studies.report import COLOURS, Report, figure
from solver.analysis.kinematics_and_compliance import Rig, ackermann, ackermann_share, kinematic_figures
from solver.analysis.modes import AXLES
from solver.analysis.typical_values import DEG
from solver.analysis.typical_values import typical_values as usual_ranges
from solver.files.scene import load_scene

SUMMARY = 'kinematics and compliance of every delivered car: wheel travel, roll, forces at the tires, steering'


class Range(NamedTuple):
    """Range in which a car is moved: wheel travel [m], steering wheel [rad], forces [N] and moments [N m] at the
    tires."""

    travel: float = 0.06
    steering: float = 8.0
    force: float = 3000.0
    moment: float = 120.0


CARS = {
    'full_car': Range(), 'light_car': Range(), 'compact_fwd': Range(), 'pickup_awd': Range(), 'electric_4wd': Range(),
    'formula_student': Range(travel=0.025, steering=2.0, force=1000.0, moment=30.0),
}  # fmt: skip
# rad, left against right: the column on one side turns with the subframe on its mounts
ALIKE = {'toe': 5e-5, 'camber': 5e-5}

Curves = dict[str, dict[str, np.ndarray]]


def study(out: Path, *, quick: bool, progress: Callable[[str, float], None]) -> dict:
    """See mbd_sim_ros.lab.studies."""
    count = 7 if quick else 25
    report = Report(out, 'Kinematics and compliance')
    report.text(
        'The chassis is held in its design position, the tires are off, the wheels are locked to their carriers; '
        'travels, loads at the contact points and the steering wheel are imposed, and every point is a static '
        'equilibrium (`solver.analysis.kinematics_and_compliance`). Signs: toe-in positive, camber negative with the '
        'top inwards, steer positive to the left, travel positive in bump. Curves are of left wheels; that the right '
        'ones mirror them is checked. A car without bushings has no compliance and gets no picture of it but lines at '
        'rest.'
    )
    data: dict[str, Any] = {}
    for k, (name, far) in enumerate(CARS.items()):
        car = name.replace('_', ' ')
        progress(car, k / len(CARS))
        rig = Rig(load_scene('car_swept_steer', [f'vehicle=vehicles/{name}.yaml']).model)
        sweeps = {
            'travel': (x := np.linspace(-far.travel, far.travel, count), rig.travel(x.tolist())),
            'roll': (
                x := np.linspace(-0.75 * far.travel, 0.75 * far.travel, count),
                rig.travel(x.tolist(), opposite=True),
            ),
            'lateral': (x := np.linspace(-far.force, far.force, count), rig.loading('fy', x.tolist())),
            'aligning': (x := np.linspace(-far.moment, far.moment, count), rig.loading('mz', x.tolist())),
            'steering': (x := np.linspace(-far.steering, far.steering, count), rig.steering(x.tolist())),
        }
        data[car] = _sheet(report, car, rig, sweeps)
        _tables(report, car, sweeps)
        _pictures(report, car, rig, sweeps)
        _judge(report, car, sweeps)
    report.write()
    return {**data, 'checks': report.checks}


def _sheet(report: Report, car: str, rig: Rig, sweeps: dict[str, tuple[np.ndarray, Curves]]) -> dict[str, float]:
    """Slopes at the design position, and what the steering does at its stops."""
    found, ranges = kinematic_figures(rig), usual_ranges(rig.spec)
    rows = []
    for name, value in found.items():
        usual = ranges.get(name)
        if usual is None:
            rows.append({'figure': name.replace('_', ' '), 'value': value, 'unit': 'SI', 'usual': '', 'within': ''})
            continue
        low, high = (f'{x * usual.factor:.3g}' for x in (usual.low, usual.high))
        within = 'yes' if usual.low <= value <= usual.high else 'NO'
        rows.append(
            {
                'figure': usual.text,
                'value': value * usual.factor,
                'unit': usual.unit,
                'usual': f'{low} to {high}',
                'within': within,
            }
        )
    inner, outer = sweeps['steering'][1]['front_left']['steer'][-1], sweeps['steering'][1]['front_right']['steer'][-1]
    found |= {
        'inner_at_stop': float(inner),
        'outer_at_stop': float(outer),
        'ackermann_at_stop': float(ackermann_share(rig, inner, outer)),
    }
    report.text(f'## {car.capitalize()}')
    report.table(f'{car.replace(" ", "_")}_figures', rows)
    report.text(
        f'At {sweeps["steering"][0][-1]:g} rad of the steering wheel the inner wheel stands at {DEG * inner:.1f} deg, '
        f'the outer at {DEG * outer:.1f} deg; '
        f'{100 * found["ackermann_at_stop"]:.0f} % of the difference that rolling without slip asks for (Ackermann).'
    )
    return found


def roll_centers(sweep: tuple[np.ndarray, Curves], axle: str, track: float) -> np.ndarray:
    """Height [m] of the roll centre over opposite travel, from the path of the contact point: half the track times
    dy/dz."""
    z, curves = sweep
    return 0.5 * track * np.gradient(curves[f'{axle}_left']['contact_y'], z, edge_order=2)


def _tables(report: Report, car: str, sweeps: dict[str, tuple[np.ndarray, Curves]]) -> None:
    for sweep, (x, curves) in sweeps.items():
        rows = [
            {sweep: float(value)}
            | {f'{corner}/{key}': float(curve[k]) for corner, c in curves.items() for key, curve in c.items()}
            for k, value in enumerate(x)
        ]
        report.table(f'{car.replace(" ", "_")}_{sweep}', rows, shown=False)


def _pictures(report: Report, car: str, rig: Rig, sweeps: dict[str, tuple[np.ndarray, Curves]]) -> None:
    picture, axes = figure(10.0, 5.6, 2, 4)
    for k, axle in enumerate(AXLES):
        colour, c = COLOURS[k], f'{axle}_left'
        track = rig.centers[c][1] - rig.centers[f'{axle}_right'][1]
        (z, bump), (roll, opposite), (fy, lateral), (mz, align) = (
            sweeps[s] for s in ('travel', 'roll', 'lateral', 'aligning')
        )
        lines = [
            (1e3 * z, DEG * bump[c]['toe']),
            (1e3 * z, DEG * bump[c]['camber']),
            (1e3 * z, 2e3 * (bump[c]['contact_y'] - np.interp(0.0, z, bump[c]['contact_y']))),
            (DEG * 2.0 * roll / track, 1e3 * roll_centers((roll, opposite), axle, track)),
            (DEG * 2.0 * roll / track, DEG * opposite[c]['steer']),
            (DEG * 2.0 * roll / track, 0.5 * track * (opposite[c]['load'] - opposite[f'{axle}_right']['load'])),
            (1e-3 * fy, DEG * lateral[c]['steer']),
            (mz, DEG * align[c]['steer']),
        ]
        for ax, (x, y) in zip(axes.flat, lines, strict=True):
            ax.plot(x, y, color=colour, label=axle)
    names = [
        ('travel [mm]', 'toe [deg]'), ('travel [mm]', 'camber [deg]'), ('travel [mm]', 'change of track [mm]'),
        ('roll [deg]', 'roll centre [mm]'),
        ('roll [deg]', 'roll steer [deg]'), ('roll [deg]', 'roll moment [N m]'), ('lateral force [kN]', 'steer [deg]'),
        ('aligning moment [N m]', 'steer [deg]'),
    ]  # fmt: skip
    for ax, (x, y) in zip(axes.flat, names, strict=True):
        ax.set(xlabel=x, ylabel=y)
    axes[0, 0].legend()
    report.figure(
        f'{car.replace(" ", "_")}_travel',
        picture,
        f'{car}: wheel travel, roll (left wheel in bump), lateral force and aligning moment',
    )

    picture, axes = figure(10.0, 3.0, 1, 3)
    wheel, curves = sweeps['steering']
    left, right = curves['front_left']['steer'], curves['front_right']['steer']
    for k, (name, angle) in enumerate((('left', left), ('right', right))):
        axes[0, 0].plot(DEG * wheel, DEG * angle, color=COLOURS[k], label=name)
    axes[0, 1].plot(DEG * wheel, 1.0 / np.gradient(0.5 * (left + right), wheel), color=COLOURS[0])
    inner = np.linspace(0.02, max(left.max(), 0.05), 40)
    axes[0, 2].plot(DEG * left[left > 0.0], DEG * (left - right)[left > 0.0], color=COLOURS[0], label='car')
    axes[0, 2].plot(
        DEG * inner,
        DEG * np.array([a - ackermann(rig, a) for a in inner]),
        color=COLOURS[5],
        ls='--',
        label='Ackermann',
    )
    axes[0, 0].set(xlabel='steering wheel [deg]', ylabel='road wheel [deg]')
    axes[0, 1].set(xlabel='steering wheel [deg]', ylabel='ratio, local')
    axes[0, 2].set(xlabel='inner wheel [deg]', ylabel='inner less outer [deg]')
    axes[0, 0].legend()
    axes[0, 2].legend()
    report.figure(f'{car.replace(" ", "_")}_steering', picture, f'{car}: steering')


def _judge(report: Report, car: str, sweeps: dict[str, tuple[np.ndarray, Curves]]) -> None:
    bump, (wheel, steer) = sweeps['travel'][1], sweeps['steering']
    for key, limit in ALIKE.items():
        worst = max(float(np.abs(bump[f'{axle}_left'][key] - bump[f'{axle}_right'][key]).max()) for axle in AXLES)
        report.check(f'{car}: {key} of left and right differ over travel [rad]', worst, limit)
    # a steering to the left moves the right wheel as one to the right moves the left
    uneven = float(np.abs(steer['front_left']['steer'] + steer['front_right']['steer'][::-1]).max())
    report.check(f'{car}: steering to both sides differs [rad]', uneven, 1e-4)
    for axle in AXLES:
        stiffest = float(np.diff(bump[f'{axle}_left']['load']).min())
        report.check(
            f'{car}: load of the {axle} wheel grows with travel [N per point, least]', stiffest, 0.0, least=True
        )
    ratio = float(
        (1.0 / np.gradient(0.5 * (steer['front_left']['steer'] + steer['front_right']['steer']), wheel)).min()
    )
    middle = float(
        1.0 / np.gradient(0.5 * (steer['front_left']['steer'] + steer['front_right']['steer']), wheel)[len(wheel) // 2]
    )
    report.check(f'{car}: least local ratio of the steering, of that in the middle', ratio / middle, 0.6, least=True)
