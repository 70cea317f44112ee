"""mbd compare: compares a run with a reference, which may be a recording of another simulator or of a car, or repeats
of a test.

The file is long by what the command offers: a third of it declares options, and a third writes the report as text and
JSON. What compares is in mbd_sim_ros.analysis.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbd_sim_ros.bags.patterns import fits_any
from mbd_sim_ros.commands import Result, add_log_times, declare, table
from solver.errors import BagError, SpecError

if TYPE_CHECKING:
    from mbd_sim_ros.analysis.alignment import Offset
    from mbd_sim_ros.analysis.comparison import Comparison
    from mbd_sim_ros.analysis.difference import Difference
    from mbd_sim_ros.analysis.mapping import ChannelMap
    from mbd_sim_ros.bags.reader import Run

EQUAL = '1e-06'  # part of their peak that recordings may be apart and count as equal, as Tolerance() has it
SHOWN = 12  # channels in the table of the report, those that differ most
EXAMPLE = """mbd compare bags/heavy bags/light
  mbd compare bags/coarse bags/fine --rtol 1e-3 --atol 1e-6 --html out/compare.html
  mbd compare bags/first bags/again --exact
  mbd compare measured/lap_1.csv --look > car.yaml
  mbd compare bags/run measured/lap_1 measured/lap_2 measured/lap_3 --mapping car.yaml --align imu/wz --tolerances limits.yaml
mapping file (THEIRS in deg/s becomes OURS in rad/s; axes: theirs are turned by roll, pitch, yaw):
  channels:
    imu/wz: {channel: vehicle/imu/yaw_rate, unit: deg/s, sign: -1, offset: 0.0}
    'tire/*/force/fz': {channel: 'wheels/*/load', unit: kN}
  axes:
    - {channels: [imu/ax, imu/ay, imu/az], rpy_deg: [180, 0, 0]}
tolerance file (the first pattern that fits counts; rms, peak: relative; shift: s; rating: ISO/TS 18571, 0 to 1):
  tolerances:
    'imu/w*': {rtol: 0.05, atol: 0.01, rms: 0.02, rating: 0.8, shift: 0.05}
  default: {rtol: 0.1}"""  # noqa: E501


class _Alone(argparse.Action):
    """A flag that makes another argument optional. Without the flag that argument is required."""

    def __init__(self, option_strings: Sequence[str], dest: str, *, other: argparse.Action, help: str) -> None:
        super().__init__(option_strings, dest, nargs=0, default=False, help=help)
        self.other = other

    def __call__(self, parser: Any, namespace: argparse.Namespace, *_: Any) -> None:
        setattr(namespace, self.dest, True)
        self.other.required = False


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(
        parsers,
        'compare',
        run,
        'compare a run with a reference: how far apart, or within given tolerances; exit code 0 only where they agree',
        EXAMPLE,
    )
    source = (
        'bag directory, .mcap file, table (.csv, .tsv, .txt), .mf4, CAN log (.blf, .asc) or directory of .csv files'
    )
    parser.add_argument('run_', metavar='RUN', type=Path, help=source)
    reference = parser.add_argument(
        'reference', metavar='REFERENCE', type=Path, help='the same; differences are RUN - REFERENCE'
    )
    parser.add_argument(
        'repeats',
        metavar='REPEAT',
        type=Path,
        nargs='*',
        default=[],
        help='more references: repeats of a test; their mean is the reference, their 95 %% confidence band is allowed',
    )
    parser.add_argument(
        '--look',
        action=_Alone,
        other=reference,
        help='look at RUN alone: propose quantity, unit and sign of its columns, as a mapping file to confirm',
    )
    judged = parser.add_argument_group(
        'what is allowed',
        'Without a limit the differences are listed in percent of the peak, and recordings agree that are equal to '
        '1e-06 of it.',
    )
    judged.add_argument(
        '--rtol',
        type=float,
        help='allowed difference relative to the largest value of the channel in REFERENCE (1e-06)',
    )
    judged.add_argument('--atol', type=float, help='allowed absolute difference, added to the relative one (1e-09)')
    judged.add_argument(
        '--tolerances',
        metavar='FILE',
        type=Path,
        help='limits per channel, see below; --rtol and --atol for the others',
    )
    judged.add_argument('--exact', action='store_true', help='same instants, same channels, same bits')
    judged.add_argument('--allow-missing', action='store_true', help='accept channels and times that one lacks')
    judged.add_argument(
        '--overlap',
        metavar='PART',
        type=float,
        help='fraction of the longer recording that both must cover (default 1; 0.95 when times are moved)',
    )
    chosen = parser.add_argument_group('channels')
    chosen.add_argument(
        '--channel', metavar='PATTERN', action='append', default=[], help="only channels like 'odom/*' (repeatable)"
    )
    chosen.add_argument(
        '--map',
        metavar='THEIRS=OURS',
        action='append',
        default=[],
        help="a channel of REFERENCE and its name in RUN, also as patterns: 'vehicle/imu/*=imu/*' (repeatable)",
    )
    chosen.add_argument(
        '--mapping',
        metavar='FILE',
        type=Path,
        help='names, units, signs, offsets, axes of REFERENCE, see below; only these are compared',
    )
    chosen.add_argument(
        '--dbc',
        metavar='FILE',
        type=Path,
        action='append',
        default=[],
        help='database of the frames in a CAN log (repeatable)',
    )
    times = parser.add_argument_group('times')
    times.add_argument('--offset', metavar='SECONDS', type=float, default=0.0, help='added to the times of REFERENCE')
    add_log_times(times)
    times.add_argument(
        '--align',
        metavar='CHANNEL',
        help='find the time offset of REFERENCE by cross-correlation of this channel of RUN, with either sign',
    )
    shown = parser.add_argument_group('pictures')
    shown.add_argument(
        '--html', metavar='FILE', type=Path, help='report with all figures and curves to zoom into, in one file'
    )
    shown.add_argument('--plot', metavar='PNG', type=Path, help='draw the channels that differ most')
    shown.add_argument('--no-rating', action='store_true', help='no ISO/TS 18571 rating where no tolerance asks for it')


def run(args: argparse.Namespace) -> Result:
    """Run the command: read the recordings, compare them, write reports and pictures. Raises BagError and SpecError."""
    if args.look:
        return _look(args)
    import numpy as np

    from mbd_sim_ros import interrupts
    from mbd_sim_ros.analysis import mapping, runs
    from mbd_sim_ros.analysis.comparison import compare
    from mbd_sim_ros.analysis.pairing import of_one_clock, with_doubts_of
    from mbd_sim_ros.analysis.stamps import LATEST
    from mbd_sim_ros.analysis.tolerances import Tolerances, load_tolerances

    given = {name: getattr(args, name) for name in ('rtol', 'atol') if getattr(args, name) is not None}
    for name, value in given.items():
        if not 0.0 <= value < math.inf:
            raise BagError(f'--{name} {value:g}: must be a number that is not negative')
    if not abs(args.offset) < LATEST:
        raise BagError(f'--offset {args.offset:g}: must be a number of seconds below {LATEST:.3g}')
    if args.overlap is not None and not 0.0 <= args.overlap <= 1.0:
        raise BagError(f'--overlap {args.overlap:g}: must be a fraction from 0 to 1')
    limits = Tolerances() if args.tolerances is None else load_tolerances(args.tolerances)
    limits = dataclasses.replace(limits, default=dataclasses.replace(limits.default, **given))
    pairs = mapping.pairs(args.map)
    file = None if args.mapping is None else mapping.load_mapping(args.mapping)
    interrupts.now(f'comparing {args.run_} with {args.reference}')
    ours, references, held = _read(args, pairs, file)
    channels: list[str] = args.channel
    aside: tuple[str, ...] = ()
    if file is None and not channels:
        (ours, *references), aside = of_one_clock((ours, *references))
    if file is not None:
        listed = [
            mapping.literal(name)
            for name in (*file.channels, *pairs, *(axis for turn in file.axes for axis in turn.channels))
        ]
        keep = {name for r in (ours, *references) for one in r.series.values() for name in one.columns}
        channels = sorted(
            name for name in keep if fits_any(name, listed) and (not channels or fits_any(name, channels))
        )
        common = keep.intersection(
            *({n for one in r.series.values() for n in one.columns} for r in (ours, *references))
        )
        lacking = sorted(set(channels) - common)
        channels = [mapping.literal(name) for name in channels if name in common]
        if not channels:
            instead = ours.instead_of(lacking[0]) if lacking and lacking[0] not in ours.names else ''
            some = f'{", ".join(lacking[:3])} are in some of them'
            raise BagError(f'{args.mapping}: none of its channels is in all recordings ({some}){instead}')
    judged = bool(given) or args.tolerances is not None
    # of recordings without tolerances the text shows no rating, which is half of the time and needs the compiler
    rated = not args.no_rating and bool(judged or args.exact or args.repeats or args.json or args.html)
    with np.errstate(over='ignore', invalid='ignore'):  # a recording may hold any numbers
        found = compare(
            ours,
            *references,
            tolerances=limits,
            exact=args.exact,
            channels=channels,
            offset=args.offset,
            align=args.align,
            overlap=0.0 if args.allow_missing else args.overlap,
            held=held,
            rated=rated,
        )
    if file is not None:
        in_run = {n for one in ours.series.values() for n in one.columns}
        found = dataclasses.replace(
            found,
            only_in_run=tuple(n for n in lacking if n in in_run),
            only_in_reference=tuple(n for n in lacking if n not in in_run),
        )
    unknown = [
        ours_ for ours_ in ((file.channels.keys() if file is not None else set()) | pairs.keys()) if '*' not in ours_
    ]
    misspelt = [
        f'mapping: {args.run_} has no channel {n!r}{ours.instead_of(n)}' for n in sorted(unknown) if n not in ours.names
    ]
    found = dataclasses.replace(found, notes=(*found.notes, *aside, *misspelt))
    names = _labels([args.run_, args.reference, *args.repeats])
    left_out = {
        f'{name}: {topic}': why for name, r in zip(names, (ours, *references)) for topic, why in r.left_out.items()
    }
    unused = limits.unused(d.channel for d in found.differences)
    compared = set.intersection(*({n for one in r.series.values() for n in one.columns} for r in (ours, *references)))
    doubts = {
        name: list(told)
        for name, r in zip(names, (ours, *references))
        if (told := runs.suspicion(with_doubts_of(r, compared)))
    }
    result = report(
        found,
        judged=judged,
        allow_missing=args.allow_missing,
        names=names,
        left_out=left_out,
        unused=unused,
        doubts=doubts,
        plot=args.plot,
        html=args.html,
    )
    if args.plot is not None:
        from mbd_sim_ros.analysis.plots import plot_comparison

        plot_comparison(found, args.plot, names=(names[0], names[1] if len(names) == 2 else 'mean of repeats'))
    if args.html is not None:
        from mbd_sim_ros.analysis.html import write_report
        from mbd_sim_ros.analysis.provenance import facts_of_runs

        verdict = result.text.splitlines()[-1]
        write_report(
            found,
            args.html,
            names=names,
            about=about(found, names, left_out, unused, doubts),
            verdict=(result.code == 0, verdict),
            facts=[*_given(args), *facts_of_runs((ours, *references), names)],
        )
    return result


def _given(args: argparse.Namespace) -> list[tuple[str, str]]:
    """The tolerances, as facts of the page."""
    if args.exact:
        return [('tolerances', 'none: the same bits')]
    said = [f'{name} {value:g}' for name, value in (('rtol', args.rtol), ('atol', args.atol)) if value is not None]
    said += [] if args.tolerances is None else [f'by {args.tolerances}']
    return [('tolerances', ', '.join(said) or 'none given: rtol 1e-6, atol 1e-9 of runs that should be the same')]


def _look(args: argparse.Namespace) -> Result:
    """mbd compare --look: the first look at one recording. Raises BagError and SpecError."""
    from mbd_sim_ros import interrupts
    from mbd_sim_ros.analysis import mapping, runs
    from mbd_sim_ros.analysis.look.first import look
    from mbd_sim_ros.analysis.look.report import as_data, as_yaml

    if args.reference is not None:
        raise SpecError(f'mbd compare --look looks at one recording; leave {args.reference} out')
    interrupts.now(f'looking at {args.run_}')
    time = mapping.load_mapping(args.mapping).time if args.mapping is not None else None
    run = runs.read(args.run_, args.channel, time=time, databases=args.dbc, log_times=args.log_times)
    runs.must_match(run, args.channel, args.run_)
    found = look(run)
    return Result(data=as_data(found, run), text=as_yaml(found, run, str(args.run_)))


def _read(args: argparse.Namespace, pairs: dict, file: ChannelMap | None) -> tuple[Run, list[Run], frozenset[str]]:
    """(run, references with the channel names of the run, channels that hold their value between samples).

    pairs: from --map, name in the run -> its source. file: the mapping file. Only the channels that are needed are
    decoded. The recordings are read one after the other: two threads wait for each other at every chunk, and took
    longer than one.
    """
    from mbd_sim_ros.analysis import mapping, runs

    def read(place: Path, patterns: Sequence[str], *before: Run, beside: Sequence[str] = ()) -> Run:
        one = runs.read(place, patterns, beside=beside, databases=args.dbc, log_times=args.log_times)
        try:
            return mapping.in_si(one, runs.units(*before, one))
        except BagError as error:
            raise BagError(f'{place}: {error}') from None

    also = [mapping.literal(args.align)] if args.align is not None else []
    oriented = [p for p in args.channel if p.endswith('orientation')]
    quaternions = [q for p in oriented for q in (p.removesuffix('orientation') + 'q[xyzw]', p + '/[xyzw]')]
    wanted = [*args.channel, *quaternions, *also] if args.channel else []
    places = [args.reference, *args.repeats]
    if file is None and not pairs:
        ours = read(args.run_, wanted)
        others = [read(place, wanted, ours, beside=ours.names) for place in places]
        if not set(ours.names).intersection(*(one.names for one in others)):  # a table beside bags
            ours = read(args.run_, wanted, beside=others[0].names)
        return ours, others, frozenset()
    axes = [mapping.literal(name) for turn in file.axes for name in turn.channels] if file is not None else []
    sources = {**(file.channels if file is not None else {}), **pairs}
    listed = [*(mapping.literal(s.channel) for s in sources.values()), *axes, *also] if file is not None else []
    ours = read(args.run_, [*map(mapping.literal, sources), *axes, *also] if file is not None else wanted)
    mapped = [source.channel for source in sources.values()]
    time = file.time if file is not None else None
    others = [
        runs.read(place, listed, beside=mapped, time=time, databases=args.dbc, log_times=args.log_times)
        for place in places
    ]
    unit_of = runs.units(ours)
    held: frozenset[str] = frozenset()
    references = []
    for place, theirs in zip(places, others, strict=True):
        try:
            renamed, holding = mapping.apply(theirs, sources, file.axes if file is not None else (), unit_of)
        except BagError as error:
            raise BagError(f'{place}: {error}') from None
        references.append(renamed)
        held |= holding
    return ours, references, held


def _labels(places: list[Path]) -> list[str]:
    """Names of the recordings, all different: the last part of the path if that is enough, else the path."""
    short = [place.name or str(place) for place in places]
    return short if len(set(short)) == len(short) else [str(place) for place in places]


def about(
    found: Comparison,
    names: list[str],
    left_out: dict[str, str],
    unused: Sequence[str] = (),
    doubts: Mapping[str, Sequence[str]] | None = None,
) -> list[str]:
    """Lines above the table: doubts about the recordings, offsets that were added to times, channels that are not
    compared."""
    lines = [f'{name}: {text}' for name, texts in (doubts or {}).items() for text in texts]
    if any(found.origins):
        lines += [f'times of {name} count from {origin:.9f} s' for name, origin in zip(names, found.origins) if origin]
    for k, name in enumerate(names[1:]):
        if k < len(found.found):
            one = found.found[k]
            again = '' if one.again is None else f'; {one.again:.6g} s fits nearly as well'
            again += '' if one.opposed is None else f'; {one.opposed:.6g} s fits nearly as well with the other sign'
            lines.append(
                f'{found.offsets[k]:.6f} s added to the times of {name} (correlation {one.correlation:.4f}{again})'
            )
        elif k < len(found.offsets) and found.offsets[k]:
            lines.append(f'{found.offsets[k]:.6f} s added to the times of {name}')
    for side, channels in ((names[0], found.only_in_run), ('reference', found.only_in_reference)):
        if channels:
            more = f' and {len(channels) - 6} more' if len(channels) > 6 else ''
            lines.append(f'in {side} only: {", ".join(channels[:6])}{more}')
    lines += (*(() if found.exact else found.problems), *found.notes)
    lines += [f'tolerances of {pattern}: no channel is judged by them' for pattern in unused]
    lines += [f'not read: {topic}: {why}' for topic, why in left_out.items()]
    return lines


def report(
    found: Comparison,
    *,
    judged: bool = True,
    allow_missing: bool = False,
    names: list[str] | None = None,
    left_out: dict[str, str] | None = None,
    unused: Sequence[str] = (),
    doubts: Mapping[str, Sequence[str]] | None = None,
    plot: Path | None = None,
    html: Path | None = None,
) -> Result:
    """A comparison as a Result. The exit code is 0 if every channel is in all recordings and within its tolerance, else
    1.

    judged: somebody said what is allowed. Where nobody did, the text tells how far apart the recordings are.
    """
    outside = [d for d in found.differences if not d.ok]
    missing = () if allow_missing else found.left_out
    good = found.ok and not missing
    data = {
        'status': 'same' if good else 'different',
        'judged': judged or found.exact,
        'instants': found.instants,
        'interpolated': found.interpolated,
        'offsets': [
            {
                'seconds': s,
                **(_found(f) if f else {}),
            }
            for s, f in zip(found.offsets, [*found.found, *[None] * len(found.offsets)])
        ],
        'channels': {d.channel: _channel(d) for d in found.differences},
        'outside': [d.channel for d in outside],
        'left_out': list(found.left_out),
        'only_in_run': list(found.only_in_run),
        'only_in_reference': list(found.only_in_reference),
        'not_read': left_out or {},
        'unused_tolerances': list(unused),
        'doubts': dict(doubts or {}),
        'problems': list(found.problems),
        'notes': list(found.notes),
        'plot': None if plot is None else str(plot),
        'html': None if html is None else str(html),
    }
    said = about(found, names or ['run', 'reference'], left_out or {}, unused, doubts)
    if not (judged or found.exact or any(d.band is not None for d in found.differences)):
        return Result(data=data, text='\n'.join([*said, *_apart(found, missing)]), code=0 if good else 1)
    rated = any(d.rating is not None for d in found.differences)
    band = any(d.band is not None for d in found.differences)
    extra = (*(['rating'] if rated else []), *(['in band'] if band else []))
    rows: list[tuple[str, ...]] = [('channel', 'unit', 'max', 'at [s]', 'rms', 'scale', 'max/scale', *extra, '')]
    for d in found.differences[:SHOWN]:
        cells = [
            d.channel,
            d.unit,
            f'{d.max:.3g}',
            f'{d.time:.6g}',
            f'{d.rms:.3g}',
            f'{d.scale:.3g}',
            f'{d.normalised:.3g}',
        ]
        cells += ['' if d.rating is None else f'{d.rating.overall:.3f}'] if rated else []
        cells += ['' if d.band is None else f'{100.0 * d.band.inside:.1f} %'] if band else []
        rows.append((*cells, '' if d.ok else f'OUTSIDE: {"; ".join(d.reasons)}'))
    lines = [*said, table(rows)]
    if len(found.differences) > SHOWN:
        lines.append(f'... and {len(found.differences) - SHOWN} channels that differ less')
    verdict = (
        f'{len(outside)} of {len(found.differences)} channels outside'
        if outside
        else f'{len(found.differences)} channels within'
    )
    lines.append(f'{verdict} tolerance{_at(found, missing)}')
    return Result(data=data, text='\n'.join(lines), code=0 if good else 1)


def _at(found: Comparison, missing: Sequence[str]) -> str:
    """The end of a verdict."""
    alone = f'; {len(missing)} channels are in one recording only' if missing else ''
    return f' at {found.instants} instants{" (interpolated)" if found.interpolated else ""}{alone}'


def _apart(found: Comparison, missing: Sequence[str]) -> list[str]:
    """The lines of a comparison whose tolerances nobody gave: how far apart, and a verdict."""
    from mbd_sim_ros.analysis.apart import most, rows

    if all(d.ok for d in found.differences):
        agreed = f'{len(found.differences)} channels agree, to {EQUAL} of their peaks{_at(found, missing)}'
        return [f'{agreed}; problems: {len(found.problems)}, see above' if found.problems else agreed]
    verdict = f'the recordings differ: {most(found.differences)}'
    more = (
        'all channels: --html FILE, or --json; what is allowed: --rtol 0.05 (5 % of the peak), --tolerances FILE; '
        'equal bits: --exact'
    )
    return [table(rows(found.differences)), more, f'{verdict}{_at(found, missing)}']


def _found(offset: Offset) -> dict[str, Any]:
    """A time offset that --align found, for JSON."""
    return {
        'correlation': offset.correlation,
        'again': offset.again,
        'turned': offset.correlation < 0.0,
        'opposed': offset.opposed,
    }


def _channel(d: Difference) -> dict[str, Any]:
    """Differences of one channel, for JSON: times in s, scores and relative values without a unit, all else in its
    unit."""
    data = {
        'unit': d.unit,
        'max': d.max,
        'rms': d.rms,
        'time_of_max': d.time,
        'scale': d.scale,
        'normalised': d.normalised,
        'rms_normalised': d.rms_normalised,
        'limit': d.limit,
        'peak_run': d.peak[0],
        'peak_reference': d.peak[1],
        'peak_difference': d.peak_difference,
        'peak_later_by': d.peak_time[0] - d.peak_time[1],
        'overlap': d.overlap,
        'instants': d.instants,
        'ok': d.ok,
        'reasons': list(d.reasons),
    }
    if d.first is not None:
        data['first'] = d.first
    if d.rating is not None:
        data |= {'rating': d.rating.overall, 'shift': d.rating.shift}
        data['scores'] = {name: getattr(d.rating, name) for name in ('corridor', 'phase', 'magnitude', 'slope')}
    if d.band is not None:
        data['band'] = dataclasses.asdict(d.band)
    return data
