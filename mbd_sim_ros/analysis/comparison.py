"""A run beside a reference: per channel the differences at common instants, judged by tolerances.

The reference may be several repeats of one test. Then the run is compared with their mean and may leave it by the
confidence band of that mean besides the tolerance: mean +- t_{0.975, n-1} s / sqrt(n) at every instant (Student's t,
two-sided 95 %). The standards [ISOValidation2016] compare a simulation with at least three measured repeats; which band
they ask for is not confirmed.

Grids: where the instants of the coarsest signal all exist in the others, those are compared and nothing is
interpolated; otherwise the finer ones are interpolated, each kind of channel in its own way (alignment.py).
Orientations are one channel, whose difference is the angle of the rotation between them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mbd_sim_ros.analysis.alignment import Common, Offset, Signal, common, find_offset, is_wrapped, same_turn
from mbd_sim_ros.analysis.difference import Curves, Difference, curves_of, difference_of
from mbd_sim_ros.analysis.exact import exact_curves, exact_difference
from mbd_sim_ros.analysis.pairing import HEADINGS, Item, items_of, least_scales, shared_names, signal_of
from mbd_sim_ros.analysis.runs import units
from mbd_sim_ros.analysis.tolerances import Tolerances
from mbd_sim_ros.bags.clocks import EPOCH_NS
from mbd_sim_ros.bags.patterns import nearest
from mbd_sim_ros.bags.reader import NOT_DETERMINED, Run, Series
from solver.errors import BagError

COUNTERS = ('cmd_applied/step',)  # compared bit by bit only: another step size counts differently
HALF_A_TURN_DEG = 180.0
OVERLAP_MOVED = 0.95  # of recordings that were not started together, least part of the time that both have


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Outcome of compare(): one Difference per channel, the worst relative to its limits first.

    only_in_run, only_in_reference: channels that the other side lacks. offsets: per reference what was added to its
    stamps [s]. found: the offsets that were sought. origins: what the stamps of each recording count from [s], run
    first. problems: what else is not as it should be, a sentence each. notes: what was assumed, likewise.
    """

    differences: tuple[Difference, ...]
    only_in_run: tuple[str, ...] = ()
    only_in_reference: tuple[str, ...] = ()
    offsets: tuple[float, ...] = ()
    found: tuple[Offset, ...] = ()
    origins: tuple[float, ...] = ()
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    exact: bool = False
    curves: Callable[[str], Curves] = field(repr=False, compare=False)

    @property
    def instants(self) -> int:
        """Largest number of instants compared of a channel."""
        return max(d.instants for d in self.differences)

    @property
    def interpolated(self) -> bool:
        """True where any signal was interpolated."""
        return any(d.interpolated for d in self.differences)

    @property
    def left_out(self) -> tuple[str, ...]:
        """Channels that are in one recording only."""
        return tuple(sorted((*self.only_in_run, *self.only_in_reference)))

    @property
    def ok(self) -> bool:
        """True where every channel is within its tolerance; missing channels are judged by the caller (see
        left_out)."""
        return not self.problems and all(d.ok for d in self.differences)


def compare(
    run: Run,
    *references: Run,
    tolerances: Tolerances | None = None,
    exact: bool = False,
    channels: Sequence[str] = (),
    offset: float = 0.0,
    align: str | None = None,
    overlap: float | None = None,
    held: frozenset[str] = frozenset(),
    rated: bool = True,
) -> Comparison:
    """Compare a run with a reference, or with repeats of one.

    exact: the same instants, the same channels and the same bits. channels: shell patterns that choose channels.
    offset: added to the stamps of the references [s]. align: channel by which a further offset is found, of each
    reference. overlap: part of the longer recording's time that must be shared; None: all of it, OVERLAP_MOVED where
    the stamps are moved. held: channels besides cmd_applied that hold their value. rated: also after ISO/TS 18571.
    Recordings that share no time, with or without the offset, and are stamped with the time of day count from their
    first stamp. Raises BagError when nothing is common.
    """
    limits = tolerances or Tolerances()
    homes = [{name: one for one in r.series.values() for name in one.columns} for r in (run, *references)]
    names, only_in_run, only_in_reference = shared_names(
        homes, channels, [name for r in (run, *references) for name in r.names]
    )
    if exact:
        if len(references) != 1 or offset != 0.0 or align is not None:
            raise BagError(
                '--exact compares two recordings as they are: give two of them, without --offset and --align'
            )
        unit_of = units(run, *references)
        alone = len(only_in_run) + len(only_in_reference)
        exactly = [exact_difference(name, homes[0][name], homes[1][name], unit_of(name)) for name in names]
        return Comparison(
            differences=tuple(sorted(exactly, key=lambda d: (d.ok, -d.normalised))),
            only_in_run=only_in_run,
            only_in_reference=only_in_reference,
            offsets=(0.0,),
            problems=(f'{alone} channels are in one recording only',) if alone and overlap != 0.0 else (),
            exact=True,
            curves=lambda name: exact_curves(name, homes[0][name], homes[1][name]),
        )
    counted = [name for name in names if name in COUNTERS]
    names = [name for name in names if name not in COUNTERS]
    if counted and not names:
        raise BagError(
            f'{counted[0]} counts steps, and their number depends on the step size; only --exact compares it'
        )
    origins, shifts, found = _clocks(homes, offset, align)
    unit_of = units(run, *references)
    items = items_of(names, homes, unit_of, held)
    least = overlap if overlap is not None else OVERLAP_MOVED if any(shifts) else 1.0

    def brought(item: Item) -> Common:
        signals = [signal_of(item, home, shift) for home, shift in zip(homes, shifts)]
        try:
            result = common(signals, item.kind)
        except BagError as error:
            raise BagError(f'{item.name}: {error}') from None
        wrapped = item.kind == 'angle' and any(is_wrapped(s.values) for s in signals)
        if wrapped or (item.kind == 'angle' and item.name.rpartition('/')[2] in HEADINGS):
            first, *others = result.values
            moved = tuple(same_turn(other, first) for other in others)
            if not unit_of(item.name) and (wrapped or _turned(signals, others, moved)):
                assumed[item.name] = (
                    f'{item.name} has no unit and is taken as an angle in rad, of which full turns mean nothing; '
                    f'where it is in another unit, the header of a table or a mapping file must say so'
                )
            result = result._replace(values=(first, *moved))
        if any(r.leaves_open(item.name.partition('/')[0]) for r in (run, *references)):
            known = ~np.any([np.isnan(values) for values in result.values], axis=0)
            if known.any() and not known.all():
                open_[item.name] = int(np.count_nonzero(~known))
                values = tuple(one[known] for one in result.values)
                result = result._replace(time_ns=result.time_ns[known], values=values)
        return result

    assumed: dict[str, str] = {}
    open_: dict[str, int] = {}  # channel -> instants at which one of the runs does not determine it
    scales = least_scales(items, homes[1:], unit_of, limits.floor)
    differences, apart = [], []
    for item in items:
        try:
            at = brought(item)
        except BagError as error:
            apart.append(str(error))
            continue
        differences.append(
            difference_of(item, at, limits.of(item.name), scales[item.name], least, rated or limits.rated, unit_of)
        )
    if not differences:
        raise BagError(apart[0])
    by_name = {item.name: item for item in items}
    turned = [
        f'{align} of {"the reference" if len(found) == 1 else f"reference {k}"} fits with its sign turned (correlation '
        f'{one.correlation:.4f}): it is compared as it is; give sign: -1 in a mapping file where it is wrong'
        for k, one in enumerate(found, 1)
        if one.correlation < 0.0
    ]
    return Comparison(
        differences=tuple(sorted(differences, key=lambda d: (-d.badness, -d.normalised))),
        only_in_run=only_in_run,
        only_in_reference=only_in_reference,
        offsets=tuple((shift - origin) * 1e-9 for shift, origin in zip(shifts[1:], origins[1:])),
        found=tuple(found),
        origins=tuple(-origin * 1e-9 for origin in origins),
        problems=(*turned, *(apart if least > 0.0 else ())),
        notes=(*assumed.values(), *_left_open(open_), *(apart if least == 0.0 else ())),
        curves=lambda name: curves_of(by_name[name].kind, brought(by_name[name])),
    )


def _left_open(instants: Mapping[str, int]) -> tuple[str, ...]:
    """Sentence on channels that are not compared at so many instants, if there are any."""
    if not instants:
        return ()
    shown = ', '.join(f'{name} ({count})' for name, count in list(instants.items())[:3])
    more = f' and {len(instants) - 3} more channels' if len(instants) > 3 else ''
    return (f'instants that are not compared, of {NOT_DETERMINED}: {shown}{more}',)


def _turned(signals: Sequence[Signal], before: Sequence[np.ndarray], after: Sequence[np.ndarray]) -> bool:
    """True where full turns were taken from an angle, or it jumps like one in degrees."""
    jumps = any(bool(np.any(np.abs(np.diff(s.values)) > HALF_A_TURN_DEG)) for s in signals)
    return jumps or not all(np.array_equal(a, b, equal_nan=True) for a, b in zip(before, after, strict=True))


def _clocks(
    homes: Sequence[Mapping[str, Series]], offset: float, align: str | None
) -> tuple[list[int], list[int], list[Offset]]:
    """Per recording what is added to its stamps [ns] so that they count alike, the same with the offset, and the
    offsets found."""
    spans = []
    for home in homes:
        grids = [one.time_ns for one in home.values()]
        spans.append((min(int(t[0]) for t in grids), max(int(t[-1]) for t in grids)))
    ours, moved = spans[0], round(offset * 1e9)

    def meets(by: int) -> bool:
        return all(max(ours[0], first + by) <= min(ours[1], last + by) for first, last in spans[1:])

    share = meets(0) or meets(moved)
    origins = [0 if share or first < EPOCH_NS else -first for first, _ in spans]
    shifts = [origins[0], *(origin + moved for origin in origins[1:])]
    found: list[Offset] = []
    if align is not None:
        for k, home in enumerate(homes[1:], 1):
            for side in (homes[0], home):
                if align not in side:
                    raise BagError(
                        f'--align {align}: no such channel in both '
                        f'recordings{nearest(align, sorted(homes[0].keys() & home.keys()))}'
                    )
            item = Item(align, (align,), 'linear')
            found.append(find_offset(signal_of(item, homes[0], shifts[0]), signal_of(item, home, shifts[k])))
            shifts[k] += found[-1].nanoseconds
    return origins, shifts, found
