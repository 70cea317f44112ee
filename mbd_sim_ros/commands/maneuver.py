"""mbd maneuver: drives the maneuver of a norm with a vehicle, and judges it."""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbd_sim_ros.commands import Result, add_settings, declare, evaluations, names_of, offer, table
from solver.disk import alone
from solver.errors import MbdError, SpecError

if TYPE_CHECKING:
    from mbd_sim_ros.analysis.evaluation.driving import Driving
    from mbd_sim_ros.analysis.evaluation.kinds import Evaluation

# Result of the runs before a maneuver -> its words in the report.
SAID: dict[str, Callable[[float], str]] = {
    'reference': lambda value: f'reference {math.degrees(value):.4g} deg at the steering wheel',
    'amplitude': lambda value: f'amplitude {math.degrees(value):.4g} deg at the steering wheel',
    'brake_torque': lambda value: f'{value:.4g} N m on all wheels together',
    'preview': lambda value: f'the driver looks {value:.3g} s ahead',
    'understeer': lambda value: f'the driver allows for {value:.3g} rad s^2/m of understeer',
}


def add(parsers: Any) -> None:
    """Declare the command."""
    help_ = 'drive the maneuver of a norm with a vehicle and judge it; without a name list them'
    example = (
        'mbd maneuver iso4138 light_car --out out/iso4138\n  mbd maneuver fmvss126 full_car --set '
        'integrator.h=0.002 --json'
    )
    parser = declare(parsers, 'maneuver', run, help_, example)
    name = parser.add_argument(
        'name', metavar='NAME', nargs='?', help='an evaluation (mbd evaluate --list), or a norm: all of its maneuvers'
    )
    offer(name, evaluations)
    vehicle = parser.add_argument(
        'vehicle', metavar='VEHICLE', nargs='?', help='path of a vehicle file, or a name in config/vehicles'
    )
    offer(vehicle, names_of('vehicles'), files=True)
    parser.add_argument(
        '--out',
        metavar='DIR',
        type=Path,
        help='for recordings and report.html (default: bags/NAME-VEHICLE); complete recordings there are used again',
    )
    what = (
        'change one value of the scene (integrator.h=0.002), or a parameter of the evaluation in SI units '
        '(low=0.5); repeatable'
    )
    add_settings(parser, what, '--with')
    parser.add_argument(
        '--no-error',
        action='store_true',
        help='do not measure the numerical errors of the figures, which simulates runs again with the double step',
    )
    parser.add_argument('--strict', action='store_true', help='exit code 1 where a limit of the norm is not kept')


def run(args: argparse.Namespace) -> Result:
    """Run the command: drive the maneuvers, judge them, write the report."""
    if args.name is None:
        return _listed()
    from mbd_sim_ros.analysis.evaluation import judging
    from mbd_sim_ros.analysis.evaluation.driving import Driving

    evaluations = judging.called(args.name)
    for evaluation in evaluations:
        evaluation.driven  # noqa: B018  what is not driven is refused before anything is made
    if args.vehicle is None:
        raise SpecError(f'mbd maneuver {args.name}: the VEHICLE is missing; e.g. mbd maneuver {args.name} light_car')
    settings, given = judging.divided(args.overrides, evaluations)
    for evaluation in evaluations:
        judging.parameters_of(evaluation, given)
    directory = args.out or Path('bags') / f'{args.name}-{Path(args.vehicle).stem}'
    driving = Driving(args.vehicle, directory, settings, say=not args.json)
    with alone(directory):
        return _driven(args, driving, evaluations, given)


def _driven(
    args: argparse.Namespace, driving: Driving, evaluations: Sequence[Evaluation], given: dict[str, float]
) -> Result:
    """Drive the maneuvers that are not recorded yet, judge all, write the report. Raises the error of the first if all
    fail."""
    from mbd_sim_ros.analysis.evaluation import judging
    from mbd_sim_ros.analysis.evaluation.intervals import with_intervals
    from mbd_sim_ros.analysis.evaluation.variants import Variant
    from mbd_sim_ros.analysis.pages import write_text
    from mbd_sim_ros.analysis.provenance import facts_of_run
    from mbd_sim_ros.commands.evaluate import report
    from solver.disk import plain

    directory, results, found, facts = driving.directory, [], {}, list[tuple[str, str]]()
    refused: dict[str, MbdError] = {}  # maneuver -> error; a car may be unable to drive one maneuver of a norm
    for evaluation in evaluations:
        try:
            places, before = driving.drive(evaluation)
            read = [(place, *judging.read(place)) for place in places]
            judged = [
                judging.judge(evaluation, run, str(place), given, held=held, scene=scene)
                for place, run, held, scene in read
            ]
            ends = () if args.no_error else {0, len(judged) - 1}  # of a series the first and the last run
            judged = [
                with_intervals(evaluation, one, places[k], given) if k in ends else one for k, one in enumerate(judged)
            ]
            said = driving.speed_note(evaluation)
            results += [dataclasses.replace(one, notes=(*one.notes, said)) for one in judged] if said else judged
        except MbdError as error:
            refused[evaluation.name] = error
        else:
            found[evaluation.name] = before
            facts = facts or facts_of_run(read[0][1], str(read[0][0]))
    first = next(iter(refused.values()), None)
    if first is not None and not results:
        raise first
    about = [f'{driving.vehicle.stem}: runs driven now {driving.driven}, there already {driving.kept}']
    about += [f'{name}: {SAID[key](value)}' for name, before in found.items() for key, value in before.items()]
    data = {
        'vehicle': str(driving.vehicle),
        'out': str(directory),
        'driven': driving.driven,
        'kept': driving.kept,
        'found': found,
    }
    of = [Variant(driving.vehicle.stem, tuple(results))]
    page = directory / 'report.html'
    result = report(of, html=page, strict=args.strict, about=about, facts=facts, data=data, refused=refused)
    write_text(directory / 'report.json', json.dumps(plain(result.data), indent=1))
    return result


def _listed() -> Result:
    """The table of all maneuvers."""
    from mbd_sim_ros.analysis.evaluation.registry import EVALUATIONS

    rows: list[tuple[str, ...]] = [('maneuver', '', 'speed', 'norm')]
    rows += [
        (e.name, e.title, f'{3.6 * e.drive.speed:.4g} km/h', e.norm.partition(' [')[0]) for e in EVALUATIONS if e.drive
    ]
    data = [
        {'name': e.name, 'title': e.title, 'norm': e.norm, 'maneuver': e.drive.maneuver, 'speed': e.drive.speed}
        for e in EVALUATIONS
        if e.drive
    ]
    return Result(data={'status': 'ok', 'maneuvers': data}, text=table(rows))
