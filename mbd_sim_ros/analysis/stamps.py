"""The column of time of a table, as nanoseconds: numbers in any unit of time, epoch stamps, ISO dates, times of day.

A unit that nobody tells is taken for seconds only where the interval between the rows is one that a logger has in
seconds, or where the numbers are stamps since 1970; else the column is refused, for 10, 20, 30 may be seconds or
milliseconds.
"""

from __future__ import annotations

import re
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import date
from decimal import Decimal

import numpy as np

from solver.errors import BagError

SECOND_NS = 1_000_000_000
DAY_NS = 86_400 * SECOND_NS
LATEST = 2.0**62 * 1e-9  # s: so many nanoseconds, and differences of them, are whole numbers of 64 bits
UNITS_NS = {
    's': SECOND_NS,
    'ms': 1_000_000,
    'us': 1_000,
    'ns': 1,
    'min': 60 * SECOND_NS,
    'h': 3600 * SECOND_NS,
    'd': DAY_NS,
}
SPELLED = {
    'sec': 's', 'secs': 's', 'second': 's', 'seconds': 's', 'sekunden': 's', 'msec': 'ms', 'millis': 'ms',
    'milliseconds': 'ms',
    'usec': 'us', 'µs': 'us', 'μs': 'us', 'micros': 'us', 'microseconds': 'us', 'nsec': 'ns', 'nsecs': 'ns',
    'nanos': 'ns', 'nanosec': 'ns',
    'nanoseconds': 'ns', 'minutes': 'min', 'hours': 'h', 'hr': 'h', 'days': 'd',
}  # fmt: skip
# names of time
EXACT = {'time', 't', 'timestamp', 'timestamps', 'stamp', 'zeit', 'ts', 'datetime', 'utc', 'uhrzeit', 'zeitstempel'}
EXACT |= UNITS_NS.keys() - {'h', 'd'} | SPELLED.keys() - {'hr', 'days', 'hours'}
# in a name of time
WORDS = {'time', 'timestamp', 'zeit', 'stamp', 'elapsed', 'datetime', 'uhrzeit', 'zeitstempel', 'utc'}
OTHERS = {
    'lap',
    'best',
    'split',
    'rise',
    'reaction',
    'response',
    'constant',
    'delta',
    'diff',
    'gap',
    'headway',
    'collision',
    'step',
    'in',
}
EPOCH_S = (1e8, LATEST)  # s since 1970: from 1973 to 2116; smaller numbers count from the start of a measurement
# s from row to row of what counts from a start, without a unit; ten times as much may be milliseconds
INTERVAL_S = (1e-5, 1.0)
EPOCH_INTERVAL_S = (1e-5, 60.0)  # the same of stamps since 1970, whose size tells the unit
NUMBERS_LEAST = 0.5  # part of the rows that must have a time
ISO = re.compile(
    r'(\d{4})[-/](\d\d)[-/](\d\d)(?:[T ]+(\d\d):(\d\d)(?::(\d\d)(?:[.,](\d+))?)?)?\s*(Z|UTC|[+-]\d\d:?(?:\d\d)?)?',
    re.IGNORECASE,
)
DOTTED = re.compile(r'(\d\d?)\.(\d\d?)\.(\d{4})(.*)')  # day, month, year: with dots in no other order
CLOCK = re.compile(r'(?:(\d{1,2}):)?(\d{1,2}):(\d\d)(?:[.,](\d+))?')  # h:min:s or min:s
SLASHED = re.compile(r'\d\d?/\d\d?/\d{2,4}\b')


@dataclass(frozen=True)
class Stamps:
    """The instants [ns] of the rows, which rows have one, and what was assumed (a sentence, or none)."""

    time_ns: np.ndarray
    known: np.ndarray
    told: str = ''


def words(name: str) -> list[str]:
    """The words of a name in small letters: 'TimeUS', 'time_us' and '# time(us)' are the same two."""
    apart = re.sub(r'(?<=[a-zäöü])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])', ' ', name)
    return re.findall(r'[^\W\d_]+|\d+', apart.lower())


def is_time(name: str) -> tuple[int, str]:
    """(how surely a name is that of a column of time: 2, 1 or 0, the unit that ends it or '')."""
    parts = words(name)
    unit = SPELLED.get(parts[-1], parts[-1]) if parts else ''
    unit = unit if unit in UNITS_NS else ''
    rest = parts[:-1] if unit and len(parts) > 1 else parts
    if len(rest) == 1 and rest[0] in EXACT:
        return 2, unit
    return (1, unit) if WORDS.intersection(rest) and not OTHERS.intersection(rest) else (0, '')


def stamps_of(cells: Sequence[str], unit: str, place: str, remedy: str, number: Callable[[str], float]) -> Stamps:
    """The instants of a column. unit: as told, '' where it is not. number: a cell as a number, NaN where it is none.
    Raises BagError that names the place."""
    values = np.array([number(cell) for cell in cells])
    known = np.isfinite(values)
    if known.sum() >= NUMBERS_LEAST * len(cells):
        return _counted(cells, values, known, unit, place, remedy)
    return _dated(cells, place, remedy)


def _counted(cells: Sequence[str], values: np.ndarray, known: np.ndarray, unit: str, place: str, remedy: str) -> Stamps:
    wanted = SPELLED.get(unit.lower(), unit) if unit not in UNITS_NS else unit
    numbers = values[known]
    if unit and wanted not in UNITS_NS:
        raise BagError(f'{place} is in {unit!r}, which is no unit of time; one of {", ".join(UNITS_NS)}: {remedy}')
    if not unit:
        wanted = _guessed(numbers, place, remedy)
    factor = UNITS_NS[wanted]
    latest = float(np.abs(numbers).max()) * factor * 1e-9
    if latest >= LATEST:
        raise BagError(
            f'{place}: a time of {latest:.6g} s is too large to be one in {wanted}; it must be below {LATEST:.6g} s: '
            f'{remedy}'
        )
    time_ns = np.zeros(values.size, np.int64)
    if latest < 2.0**53 * 1e-9:  # a float holds nanoseconds up to a hundred days
        time_ns[known] = np.round(numbers * factor)
    else:
        time_ns[known] = [
            round(Decimal(cells[k].strip().replace(',', '.')) * factor) for k in np.flatnonzero(known).tolist()
        ]
    return Stamps(time_ns, known)


def _guessed(numbers: np.ndarray, place: str, remedy: str) -> str:
    """The unit of a column of time that has none. Raises BagError where two are as likely."""
    rising = np.diff(numbers)
    rising = rising[rising > 0.0]
    interval, size = (float(np.median(rising)) if rising.size else 0.0), float(np.median(np.abs(numbers)))
    for unit in ('s', 'ms', 'us', 'ns'):
        seconds = UNITS_NS[unit] * 1e-9
        if EPOCH_S[0] <= size * seconds < EPOCH_S[1] and (
            not rising.size or EPOCH_INTERVAL_S[0] <= interval * seconds <= EPOCH_INTERVAL_S[1]
        ):
            return unit
    if rising.size and not INTERVAL_S[0] <= interval < INTERVAL_S[1]:
        raise BagError(
            f'{place} has no unit, and {interval:.6g} from row to row may be seconds, milliseconds or else: {remedy}'
        )
    return 's'


def _dated(cells: Sequence[str], place: str, remedy: str) -> Stamps:
    first = next((cell for cell in cells if cell.strip()), '')
    parsed = [_instant(cell.strip()) for cell in cells]
    known = np.array([one is not None for one in parsed])
    if not known.sum() >= NUMBERS_LEAST * len(cells):
        why = ' may be day/month or month/day' if SLASHED.match(first.strip()) else ' is no time'
        raise BagError(f'{place}: {first[:40]!r}{why}; write seconds, or dates as 2024-01-31T12:00:00.5: {remedy}')
    time_ns = np.array([one[0] if one else 0 for one in parsed], np.int64)
    zones = [one[1] for one in parsed if one]
    if zones.count('clock') == len(zones):  # the day begins anew at midnight
        rows = np.flatnonzero(known)
        back = np.cumsum(np.diff(time_ns[rows]) < -DAY_NS // 2)
        time_ns[rows[1:]] += back * DAY_NS
        return Stamps(
            time_ns, known, 'the times of day pass midnight: a day is added there' if back.size and back[-1] else ''
        )
    if 'clock' in zones:
        raise BagError(f'{place}: some rows have a date and some have none: {remedy}')
    if len({*zones}) > 1 and '' in zones:
        raise BagError(f'{place}: some dates have a time zone and some have none: {remedy}')
    return Stamps(time_ns, known, 'its dates have no time zone and are taken as UTC' if '' in zones else '')


def _instant(text: str) -> tuple[int, str] | None:
    """([ns], 'zone', '' without a zone, or 'clock' of a time of day) or None."""
    if (dotted := DOTTED.fullmatch(text)) is not None:
        text = f'{dotted[3]}-{int(dotted[2]):02d}-{int(dotted[1]):02d}{dotted[4]}'
    found = ISO.fullmatch(text)
    if found is not None:
        try:
            days = date(int(found[1]), int(found[2]), int(found[3])).toordinal() - date(1970, 1, 1).toordinal()
        except ValueError:
            return None
        ns = days * DAY_NS + _of_day(found[4], found[5], found[6], found[7])
        zone = found[8] or ''
        if zone[:1] in ('+', '-'):
            ns -= (1 if zone[0] == '+' else -1) * _of_day(zone[1:3], zone[3:].strip(':'), '', '')
        return ns, 'zone' if zone else ''
    clock = CLOCK.fullmatch(text)
    return (_of_day(clock[1], clock[2], clock[3], clock[4]), 'clock') if clock is not None else None


def _of_day(hours: str | None, minutes: str | None, seconds: str | None, part: str | None) -> int:
    whole = int(hours or 0) * 3600 + int(minutes or 0) * 60 + int(seconds or 0)
    return whole * SECOND_NS + int((part or '')[:9].ljust(9, '0'))


def rising(time_ns: np.ndarray) -> np.ndarray:
    """The rows to keep so that the instants rise, as many as can be (a longest increasing subsequence, patience
    sorting), and of those that could replace each other the first ones: of a stamp that leaps ahead and comes back only
    that one is lost."""
    if time_ns.size < 2 or np.all(np.diff(time_ns) > 0):
        return np.arange(time_ns.size)
    least: list[int] = []  # the smallest end of a rising series of every length
    # length -> rows that end the longest series before them, and the same times negated, ascending
    ends: list[list[int]] = []
    times: list[list[int]] = []
    for k, t in enumerate(time_ns.tolist()):
        at = bisect_left(least, t)
        if at == len(least):
            least.append(t)
            ends.append([k])
            times.append([-t])
        else:
            least[at] = t
            ends[at].append(k)
            times[at].append(-t)
    kept = [ends[-1][0]]
    for rows, negated in zip(ends[-2::-1], times[-2::-1]):
        kept.append(rows[bisect_right(negated, -int(time_ns[kept[-1]]))])
    return np.array(kept[::-1])


def parted(whole: Stamps, part: Stamps) -> Stamps | None:
    """Whole seconds and what is to be added to them, as the two fields of a ROS stamp; None where the columns are not
    that."""
    known = whole.known & part.known
    seconds, rest = whole.time_ns[known], part.time_ns[known]
    if not known.any() or np.any(seconds % SECOND_NS) or np.any((rest < 0) | (rest >= SECOND_NS)):
        return None
    return Stamps(whole.time_ns + part.time_ns, known)
