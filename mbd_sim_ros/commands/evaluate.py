"""mbd evaluate: the figures of a maneuver of a norm, from recordings."""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbd_sim_ros.commands import Result, add_log_times, declare, evaluations, offer, table
from solver.errors import MbdError, SpecError

if TYPE_CHECKING:
    from mbd_sim_ros.analysis.evaluation import figures
    from mbd_sim_ros.analysis.evaluation.variants import Variant
    from solver.scene import Scene

SHOWN = 3  # results whose figures are printed
NOTES = 8  # different ones of a series that are printed
FACTS = 40  # lines on recordings in the head of a page; ten times as many are no head
NUMBER = re.compile(r'\d[\d.]*(?:e[-+]?\d+)?')
EXAMPLE = """mbd evaluate bags/run --html out/evaluation.html
  mbd evaluate out/soft out/stiff --html out/both.html       # variants side by side: recordings, or what mbd maneuver made
  mbd evaluate measured.mcap --as iso7401_step --mapping car.yaml --json
mapping file (THEIRS in deg/s becomes OURS in rad/s; any signal of docs/evaluating.md by its name, or channels of our recordings):
  channels:
    yaw_rate: {channel: vehicle/imu/yaw_rate, unit: deg/s}
    lateral_acceleration: {channel: vehicle/imu/lateral, unit: g, sign: -1}
    speed: {channel: vehicle/speed, unit: km/h}
    steering: {channel: vehicle/steering, unit: deg}"""  # noqa: E501


def add(parsers: Any) -> None:
    """Declare the command."""
    help_ = 'judge maneuvers of norms in recordings: figures, limits, pass or fail'
    parser = declare(parsers, 'evaluate', run, help_, EXAMPLE)
    source = (
        'bag directory, .mcap file, table (.csv, .tsv, .txt), .mf4, CAN log (.blf, .asc), directory of .csv files, '
        'or a directory of mbd maneuver; several are variants, the first one the base, or a series of one vehicle '
        'where the norm asks for a series'
    )
    parser.add_argument('bags', metavar='BAG', type=Path, nargs='*', help=source)
    offer(
        parser.add_argument(
            '--as',
            metavar='NAME',
            dest='name',
            default='',
            help='the evaluation, where the recording does not state it',
        ),
        evaluations,
    )
    parser.add_argument('--list', action='store_true', help='list the evaluations and their parameters')
    parser.add_argument(
        '--set',
        '--with',
        metavar='KEY=NUMBER',
        action='append',
        default=[],
        dest='overrides',
        help='a parameter of the evaluation, in SI units (repeatable)',
    )
    parser.add_argument(
        '--map', metavar='THEIRS=OURS', action='append', default=[], help='a channel and its name here (repeatable)'
    )
    parser.add_argument(
        '--mapping', metavar='FILE', type=Path, help='names, units, signs, offsets and axes of the channels, see below'
    )
    add_log_times(parser)
    parser.add_argument(
        '--dbc',
        metavar='FILE',
        type=Path,
        action='append',
        default=[],
        help='database of the frames in a CAN log (repeatable)',
    )
    parser.add_argument(
        '--html', metavar='FILE', type=Path, help='page with all figures and curves to zoom into, in one file'
    )
    parser.add_argument(
        '--errors',
        action='store_true',
        help='numerical errors of the figures of our own recordings: simulates each again, with the double step',
    )
    parser.add_argument('--strict', action='store_true', help='exit code 1 where a limit of the norm is not kept')


def run(args: argparse.Namespace) -> Result:
    """Read, judge, report."""
    from mbd_sim_ros import interrupts
    from mbd_sim_ros.analysis import mapping
    from mbd_sim_ros.analysis.evaluation import judging, variants
    from mbd_sim_ros.analysis.evaluation.intervals import with_intervals
    from mbd_sim_ros.analysis.provenance import facts_of_difference, facts_of_run

    if args.list:
        return listed()
    if not args.bags:
        raise SpecError('mbd evaluate: the recording is missing; give a BAG, or --list')
    sources = mapping.pairs(args.map)
    axes: tuple[mapping.Axes, ...] = ()
    time = None
    if args.mapping is not None:
        file = mapping.load_mapping(args.mapping)
        sources, axes, time = {**file.channels, **sources}, file.axes, file.time
    given = judging.assignments(args.overrides)
    if args.name:
        judging.called(args.name)  # a wrong name is told before anything is read
    about: list[str] = []
    facts: list[tuple[str, str]] = []
    bases: dict[str, tuple[str, Mapping[str, str]]] = {}  # scene -> the first variant of it, metadata of its recording

    def judged(place: Path, variant: str) -> tuple[figures.Result, Scene | None]:
        interrupts.now(f'judging {place}')
        recording, held, scene = judging.read(place, sources, axes, time, args.dbc, log_times=args.log_times)
        evaluation = judging.meant(scene, args.name, str(place))
        if args.html is not None and len(facts) < FACTS:
            facts.extend(facts_of_run(recording, str(place)))
        known = recording.metadata
        of_base, base = bases.setdefault(known.get('scene', ''), (variant, known))
        if of_base != variant:
            about.extend(f'{variant} {how}: {keys}' for how, keys in facts_of_difference(base, of_base, known))
        result = judging.judge(
            evaluation, recording, str(place), given, held=held, scene=scene, mapped=bool(sources or axes)
        )
        return with_intervals(evaluation, result, place, given) if args.errors else result, scene

    of: list[tuple[str, list[figures.Result], Scene | None]] = []
    for place, name in zip(args.bags, variants.names(args.bags), strict=True):
        if (found := variants.recordings(place)) is None:
            result, scene = judged(place, name)
            of.append((name, [result], scene))
            continue
        about += [f'{place}: {text}' for text in found.refused]
        of.append((name, [judged(one, name)[0] for one in found.places], None))
    return report(variants.grouped(of), html=args.html, strict=args.strict, about=about, facts=facts)


def report(
    of: Sequence[Variant],
    *,
    html: Path | None,
    strict: bool,
    about: Sequence[str] = (),
    facts: Sequence[tuple[str, str]] = (),
    data: Mapping[str, Any] | None = None,
    refused: Mapping[str, MbdError] | None = None,
) -> Result:
    """The object, the text, the page and the exit code of some variants. facts: of the page, what it is of. refused:
    evaluations that belong to them and have no result."""
    from mbd_sim_ros.analysis.evaluation import figures, variants
    from mbd_sim_ros.analysis.evaluation.html import write_page

    results = [r for variant in of for r in variant.results]
    having = {
        name: [variant for variant in of if variant.of(name)] for name in dict.fromkeys(r.evaluation for r in results)
    }
    together = {name: some[0].figures(name) for name, some in having.items() if len(some) == 1 and some[0].serial(name)}
    missing = {name: str(error) for name, error in (refused or {}).items()}
    passed = figures.verdict(r.passed for r in results)
    if missing and passed:
        passed = None  # nobody knows
    about = [*about, *(f'{name}: REFUSED: {why}' for name, why in missing.items())]
    beside = {name: variants.rows(some, name) for name, some in having.items() if len(some) > 1}
    found: dict[str, Any] = {
        'status': 'error' if missing else 'ok',
        'passed': passed,
        'refused': missing,
        'results': [r.data() for r in results],
        'together': {
            name: {f.name: {'value': f.value, 'unit': f.unit, 'limit': f.limit, 'verdict': f.verdict} for f in fs}
            for name, fs in together.items()
        },
        'variants': [variants.data(having[name], name) for name in beside],
        'html': None if html is None else str(html),
        **(data or {}),
    }
    lines = [*about]
    for name, rows in beside.items():
        some = [r for r in results if r.evaluation == name]
        lines += ['', f'{some[0].title} ({some[0].norm})', table(rows), *_notes(some)]
    single = [r for r in results if r.evaluation not in together and r.evaluation not in beside]
    for r in single[:SHOWN]:
        lines += [
            '',
            f'{r.title} ({r.norm}): {r.source}',
            table(figures.rows([r])),
            *(f'note: {note}' for note in r.notes),
        ]
    if len(single) > SHOWN:
        lines.append(f'... and {len(single) - SHOWN} more; --json or --html has all')
    for name, fs in together.items():
        rows = [
            ('figure', 'value', 'unit', 'limit', ''),
            *((f.text, *f.shown(), f.limit, f.verdict if f.ok is not None else '') for f in fs),
        ]
        of_it = [r for r in results if r.evaluation == name]
        lines += ['', f'{name}, {len(of_it)} runs', table(rows), *_notes(of_it)]
    lines += ['', figures.sentence(results) + (f'; refused, see above: {", ".join(missing)}' if missing else '')]
    if html is not None:
        title = ', '.join(dict.fromkeys(r.title for r in results))
        write_page(
            of,
            html,
            title=title,
            about=about,
            facts=facts,
            passed=passed,
            together={f'{name}: all runs': fs for name, fs in together.items()},
        )
        lines.append(f'page: {html}')
    code = next((error.exit_code for error in (refused or {}).values()), 1 if strict and passed is False else 0)
    return Result(data=found, text='\n'.join(lines).lstrip('\n'), code=code)


def _notes(results: Sequence[figures.Result]) -> list[str]:
    """The notes of a series, each once, whatever numbers are in it, with the runs that it is of: how many, or the one
    by its name."""
    of: dict[str, dict[str, str]] = {}  # text without numbers -> run -> note
    for r in results:
        for note in r.notes:
            of.setdefault(NUMBER.sub('#', note), {}).setdefault(r.source, note)
    lines = []
    for at in of.values():
        name = Path(next(iter(at))).name
        one = (
            name
            if len(at) == 1
            else f'{len(at)} of {len(results)} runs' + (f', this of {name}' if len({*at.values()}) > 1 else '')
        )
        lines.append(f'note ({one}): {next(iter(at.values()))}')
    return (
        lines
        if len(lines) <= NOTES
        else [*lines[:NOTES], f'... and {len(lines) - NOTES} more notes; --json or --html has all']
    )


def listed() -> Result:
    """List of all evaluations."""
    import dataclasses

    from mbd_sim_ros.analysis.evaluation.registry import EVALUATIONS

    rows: list[tuple[str, ...]] = [('name', '', 'norm', 'parameters')]
    data = []
    for e in EVALUATIONS:
        parameters = {f.name: f.default for f in dataclasses.fields(e.parameters)}
        rows.append((e.name, e.title, e.norm.partition(' [')[0], ', '.join(parameters)))
        data.append(
            {
                'name': e.name,
                'title': e.title,
                'norm': e.norm,
                'aliases': e.aliases,
                'needs': e.needs,
                'parameters': parameters,
            }
        )
    return Result(data={'status': 'ok', 'evaluations': data}, text=table(rows))
