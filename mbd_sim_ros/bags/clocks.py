"""Which of its clocks tells the time of a topic, and which clocks in one recording do not meet.

A message has up to three times: the stamp in its header, when it was published, and when it was recorded. The first
is nearest to what was measured, the last may come in bursts. Stamps count where they are set and tell messages apart;
of messages without, the publish time counts where it is set and, where other topics have stamps, meets these; the log
time is the last choice.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mbd_sim_ros.bags.accounts import CLOCKS, HEADER, LOG, PUBLISH, Account, Clock
from mbd_sim_ros.bags.columns import Collector

SLACK = 1_000_000_000  # ns that topics of one clock may miss each other by, for a message is on its way meanwhile
# times from here on are those of day (ns since 1970); no simulation lasts three years
EPOCH_NS = 100_000_000 * 1_000_000_000
SHOWN = 4  # topics of one clock that are named
Span = tuple[int, int]


def choose(collectors: Sequence[Collector], log_times: bool) -> list[Clock]:
    """The clock of every topic. log_times: that of the recorder for all."""
    chosen: list[Clock] = ['log time'] * len(collectors)
    if log_times:
        return chosen
    stamps = [one.stamps for one in collectors]
    headers = [_span(times[HEADER], 0) for times in stamps]
    stamped = [span for span in headers if span is not None]
    for k, times in enumerate(stamps):
        if headers[k] is not None:
            chosen[k] = CLOCKS[HEADER]
        elif (published := _span(times[PUBLISH], 1)) is not None:
            recorded = int(times[LOG].min()), int(times[LOG].max())
            apart = (
                stamped
                and not any(_meet(published, span) for span in stamped)
                and any(_meet(recorded, span) for span in stamped)
            )
            chosen[k] = CLOCKS[LOG if apart else PUBLISH]
    return chosen


def _span(times: np.ndarray, least: int) -> Span | None:
    """First and last of some times [ns]; None where they are not set, or all the same."""
    if not times.size or times.min() < least or (times.size > 1 and np.all(times == times[0])):
        return None
    return int(times.min()), int(times.max())


def _meet(a: Span, b: Span) -> bool:
    return max(a[0], b[0]) <= min(a[1], b[1]) + SLACK


def apart(accounts: Mapping[str, Account]) -> str:
    """A sentence that names the clocks of a recording that do not meet, topic by topic; '' where they do."""
    groups = _groups(accounts)
    if len(groups) < 2:
        return ''
    return 'its clocks do not meet: ' + '; '.join(map(_described, groups)) + '; take the log times of all (--log-times)'


def in_time_of_day(accounts: Mapping[str, Account]) -> frozenset[str]:
    """Topics in the time of day, where others count from a start, as a simulation does: of two runs they share no
    time."""
    groups = _groups(accounts)
    of_day = [group for group in groups if min(one.span[0] for one in group.values()) >= EPOCH_NS]
    return frozenset(name for group in of_day for name in group) if len(of_day) < len(groups) else frozenset()


def _groups(accounts: Mapping[str, Account]) -> list[dict[str, Account]]:
    """The topics of each clock.

    Topics that were recorded at the same time and are further apart than either of them lasts have different clocks. So
    have topics whose stamps are later than their recording, as no message can be, from others, whose are not. Single
    messages tell nothing: one that is kept for late subscribers may be old.
    """
    groups: list[dict[str, Account]] = []
    for name, one in sorted(accounts.items(), key=lambda item: item[1].span):
        if one.messages < 2:
            continue
        begin, end = one.span
        last = groups[-1].values() if groups else ()
        until = max((other.span[1] for other in last), default=0)
        longest = max((other.span[1] - other.span[0] for other in last), default=0)
        beside = any(_meet(one.log, other.log) for other in last)
        if not groups or (begin - until > max(longest, end - begin, SLACK) and beside):
            groups.append({})
        groups[-1][name] = one
    return [part for group in groups for part in _parted(group)]


def _parted(group: dict[str, Account]) -> list[dict[str, Account]]:
    """Topics of a group that are stamped later than they were recorded, by more than SLACK from begin to end, and the
    others."""
    ahead = {
        name: one for name, one in group.items() if all(stamp - log > SLACK for stamp, log in zip(one.span, one.log))
    }
    others = {name: one for name, one in group.items() if name not in ahead}
    return [part for part in (others, ahead) if part]


def _described(group: Mapping[str, Account]) -> str:
    """The topics of one clock and their times."""
    names = [f'{name} ({one.clock})' for name, one in group.items()]
    more = f' and {len(names) - SHOWN} more' if len(names) > SHOWN else ''
    begin, end = min(one.span[0] for one in group.values()), max(one.span[1] for one in group.values())
    ahead = min(one.span[0] - one.log[0] for one in group.values())
    late = f', {ahead * 1e-9:.6g} s later than they were recorded' if ahead > SLACK else ''
    return f'{", ".join(names[:SHOWN])}{more} from {begin * 1e-9:.12g} to {end * 1e-9:.12g} s{late}'
