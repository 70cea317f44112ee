"""Recordings of others under our names: names, units, signs, offsets and axes, from a file or from THEIRS=OURS on the
command line.

    channels:                                    # ours: what it is made from
      imu/wz: {channel: vehicle/imu/yaw_rate, unit: deg/s}
      'tire/*/force/fz': {channel: 'wheels/*/load', unit: kN, sign: -1, offset: 12.0}
    axes:                                        # vectors that are given along other axes
      - {channels: [imu/ax, imu/ay, imu/az], rpy_deg: [180, 0, 0]}      # x forward, y right, z down
    time: {column: 'elapsed', unit: ms}          # of a table in which the name of no column, or of several, is one of
                                                 time

A `*` in a name stands for the same text on both sides.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mbd_sim_ros.analysis.tables import TimeColumn
from mbd_sim_ros.bags.patterns import nearest
from mbd_sim_ros.bags.reader import Run, Series
from solver.dimensions import Angle
from solver.errors import BagError, suggestion
from solver.files.schema import Builder
from solver.files.yaml_tree import read
from solver.units import UNITS
from solver.validate import require


@dataclass(frozen=True, kw_only=True)
class ChannelSource:
    """Source of a channel: sign * value * (unit in SI) + offset.

    channel: its name in the other recording. unit: of the values there ('': the one in the header of a table, else as
    ours). offset: in SI units, added last. hold: the last value holds until the next comes, as of commands.
    """

    channel: str
    unit: str = ''
    sign: float = 1.0
    offset: float = 0.0
    hold: bool = False

    def __post_init__(self) -> None:
        require(self.unit in ('', *UNITS), 'mapping', 'unit', self.unit, 'no such unit' + suggestion(self.unit, UNITS))
        require(self.sign in (1.0, -1.0), 'mapping', 'sign', self.sign, 'must be 1 or -1')


@dataclass(frozen=True, kw_only=True)
class Axes:
    """Three channels, ours, that came along other axes: v_ours = Rz(yaw) Ry(pitch) Rx(roll) v_theirs
    (docs/conventions.md)."""

    channels: tuple[str, ...]
    rpy: tuple[Angle, ...]

    def __post_init__(self) -> None:
        require(
            len(set(self.channels)) == len(self.channels) == 3,
            'mapping',
            'axes.channels',
            self.channels,
            'must be three channels: x, y, z',
        )
        require(len(self.rpy) == 3, 'mapping', 'axes.rpy', self.rpy, 'must be three angles: roll, pitch, yaw')


@dataclass(frozen=True, kw_only=True)
class ChannelMap:
    """All of a mapping file. channels: ours (patterns) -> what it is made from. time: the column of a table that tells
    the time."""

    channels: dict[str, ChannelSource]
    axes: tuple[Axes, ...] = field(default_factory=tuple)
    time: TimeColumn | None = None

    def __post_init__(self) -> None:
        require(bool(self.channels), 'mapping', 'channels', {}, 'must name at least one channel')


def load_mapping(file: str | Path) -> ChannelMap:
    """Read a mapping file. Raises SceneError (file, line, remedy)."""
    return Builder().build(ChannelMap, read(Path(file), ()))


def pairs(texts: Sequence[str]) -> dict[str, ChannelSource]:
    """THEIRS=OURS from the command line. Raises BagError."""
    result = {}
    for text in texts:
        theirs, equals, ours = text.partition('=')
        if not (equals and theirs and ours):
            raise BagError(f'--map {text!r}: write it as THEIRS=OURS')
        result[ours] = ChannelSource(channel=theirs)
    return result


def literal(name: str) -> str:
    """A shell pattern for a name of a mapping, in which * alone stands for something: names of fields of messages hold
    brackets."""
    return name.replace('[', '[[]').replace('?', '[?]')


def resolve(
    channels: Mapping[str, ChannelSource], known: Sequence[str], instead_of: Callable[[str], str] | None = None
) -> dict[str, tuple[str, ChannelSource]]:
    """Ours -> (theirs, source) for every channel of `known` that is mapped, to one of ours or to several. One that is
    mapped by its own name is not mapped by patterns. instead_of: what is said of a name that is not there, the nearest
    ones otherwise.

    Raises BagError for names that are not there and for two sources of one channel.
    """
    found: dict[str, tuple[str, ChannelSource]] = {}
    named = {source.channel for source in channels.values()}
    for ours, source in channels.items():
        theirs = source.channel
        if ours.count('*') != theirs.count('*'):
            raise BagError(f'mapping {theirs}={ours}: both names need the same number of *')
        pattern = re.compile('(.*?)'.join(re.escape(part) for part in theirs.split('*')))
        matches = [(name, match) for name in known if (match := pattern.fullmatch(name))]
        if not matches:
            instead = nearest(theirs, known) if instead_of is None else instead_of(theirs)
            raise BagError(f'mapping {theirs}={ours}: the other recording has no column {theirs!r}{instead}')
        for name, match in matches:
            if name != theirs and name in named:
                continue
            parts = ours.split('*')
            new = parts[0] + ''.join(text + part for text, part in zip(match.groups(), parts[1:]))
            if new in found and found[new][0] != name:
                raise BagError(f'mapping {theirs}={ours}: {new} is made from both {found[new][0]} and {name}')
            found[new] = (name, source)
    return found


def apply(
    run: Run, channels: Mapping[str, ChannelSource], axes: Sequence[Axes], unit: Callable[[str], str]
) -> tuple[Run, frozenset[str]]:
    """The run under our names and in SI units, and which of its channels are held. unit: of our channels, '' where it
    is not known.

    Channels that are not mapped keep their names, unless a mapped one takes it. Columns of a table in other units are
    brought to SI. Raises BagError.
    """
    found = resolve(channels, run.names, run.instead_of)
    made: dict[str, list[tuple[str, ChannelSource]]] = {}  # theirs -> what of ours
    for new, (name, source) in found.items():
        made.setdefault(name, []).append((new, source))
    series = {}
    stated: dict[str, str] = {}
    for topic, one in run.series.items():
        columns = {}
        for name, values in one.columns.items():
            kept = [] if name in found else [(name, ChannelSource(channel=name))]
            for new, source in made.get(name, kept):
                told = source.unit or run.stated.get(name, '')
                columns[new] = _converted(new, values, source, told, unit(new))
                if told:
                    stated[new] = UNITS.get(told, (told,))[0]
        if columns:
            series[topic] = Series(one.time_ns, columns)
    for turn in axes:
        _rotate(series, turn)
    known = {
        topic: tuple(
            new
            for name in names
            for new in ([n for n, _ in made[name]] if name in made else [] if name in found else [name])
        )
        for topic, names in run.known.items()
    }
    held = frozenset(new for new, (_, source) in found.items() if source.hold)
    return replace(run, series=series, known=known, stated=stated), held


def in_si(run: Run, unit: Callable[[str], str]) -> Run:
    """A run with the columns of its tables in SI. Raises BagError."""
    return apply(run, {}, (), unit)[0] if run.stated else run


def _converted(name: str, values: np.ndarray, source: ChannelSource, told: str, wanted: str) -> np.ndarray:
    """Values in the unit `told` as ours. wanted: our unit, '' where it is not known. A unit that is not known is as it
    is where ours is the same, or not known."""
    if told not in UNITS and told and wanted and told != wanted:
        raise BagError(
            f'mapping of {name}: it is in {wanted}, and {told!r} is no unit that is known '
            f'here{suggestion(told, UNITS)}; correct the header of the table, or give `unit` in a mapping file'
        )
    base, factor = UNITS.get(told, ('', 1.0))
    if base and wanted and base != wanted:
        raise BagError(f'mapping of {name}: it is in {wanted}, which {told!r} does not measure')
    if source.sign == 1.0 and factor == 1.0 and source.offset == 0.0:
        return values
    return source.sign * factor * values + source.offset


def _rotate(series: Mapping[str, Series], turn: Axes) -> None:
    home = next((one for one in series.values() if turn.channels[0] in one.columns), None)
    missing = [name for name in turn.channels if home is None or name not in home.columns]
    if home is None or missing:
        there = [name for one in series.values() for name in one.columns]
        why = f', or not in one topic with {turn.channels[0]}' if missing[0] in there else nearest(missing[0], there)
        raise BagError(f'mapping of axes: {missing[0]} is not in the recording{why}')
    (sr, sp, sy), (cr, cp, cy) = np.sin(turn.rpy), np.cos(turn.rpy)
    x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    vectors = z @ y @ x @ np.stack([home.columns[name] for name in turn.channels])
    home.columns.update(zip(turn.channels, vectors))
