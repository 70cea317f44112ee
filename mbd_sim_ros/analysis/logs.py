"""Measurements in MDF files and logs of a CAN bus, by asammdf and python-can (the extra `loggers`).

Every group of an MDF file is a topic, its master the time since the start of the measurement. Frames of a bus (.blf,
.asc, .log, .trc, MDF files of bus logging) become signals by a database (.dbc, .arxml): a message is a topic, its
columns are MESSAGE/SIGNAL.
"""

from __future__ import annotations

import gc
import logging
import sys
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.analysis.cells import spelled
from mbd_sim_ros.analysis.stamps import LATEST, rising
from mbd_sim_ros.analysis.tables import LEAST_SHARE, Table
from mbd_sim_ros.bags.columns import Series
from solver.errors import BagError

MDF = ('.mf4', '.mdf')
CAN = ('.blf', '.asc', '.log', '.trc')
SUFFIXES = (*MDF, *CAN)
BUS_EVENT = 2  # flag of a group of an MDF 4 file: its records are frames of a bus (ASAM MDF 4.1, CG block, cg_flags)
MISSING = "asammdf or python-can is missing: pip install 'mbd_sim_ros[loggers]'"


def read_log(file: Path, databases: Sequence[Path] = ()) -> Table:
    """A measurement as a table. databases: of the frames of a CAN bus. Raises BagError."""
    if not file.is_file():
        raise BagError(f'cannot read {file}: no such file')
    try:
        import asammdf  # noqa: F401
        import can  # noqa: F401
    except ImportError:
        raise BagError(f'{file}: {MISSING}') from None
    table = Table()
    frames = file.suffix.lower() in CAN
    if not frames:
        frames = _read_mdf(file, table)
    if frames and databases:
        _read_frames(file, databases, table)
    elif frames:
        text = 'it holds frames of a CAN bus; a database says which signals are in them: --dbc FILE'
        if not table.series:
            raise BagError(f'{file}: {text}')
        table.left_out['CAN'] = text
    if not table.series:
        why = next(iter(table.left_out.items()), None)
        raise BagError(f'{file} holds no signal of numbers' + (f': {why[0]}: {why[1]}' if why else ''))
    return table


@contextmanager
def _one_sentence(what: str) -> Iterator[None]:
    """Whatever a library raises of a damaged file, as one sentence; what it says when it deletes the half of an object
    is not shown."""
    hook = sys.unraisablehook
    sys.unraisablehook = lambda _: None
    try:
        yield
    except BagError:
        raise
    except Exception as error:
        traceback.clear_frames(error.__traceback__)
        gc.collect()  # what refers to itself would be deleted later, and said then
        raise BagError(f'{what}: {" ".join(str(error).split())[:200] or type(error).__name__}') from None
    finally:
        sys.unraisablehook = hook


@contextmanager
def _told(table: Table) -> Iterator[None]:
    """Collector of messages that the library logs of a file that it reads all the same: they are told with the table,
    once, and not printed."""

    class Told(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            text = ' '.join(record.getMessage().split())[:200]
            if record.levelno >= logging.ERROR and text not in table.told:
                table.told.append(text)

    logger = logging.getLogger('asammdf')
    before, logger.handlers = logger.handlers, [Told()]
    try:
        yield
    finally:
        logger.handlers = before


def _read_mdf(file: Path, table: Table) -> bool:
    """The groups of an MDF file that are no frames; whether there are frames too. Raises BagError."""
    from asammdf import MDF as File

    with _one_sentence(f'cannot read {file}'), _told(table), File(file) as mdf:
        groups: list[tuple[int, Any]] = list(enumerate(mdf.groups))
        bus = {k for k, group in groups if getattr(group.channel_group, 'flags', 0) & BUS_EVENT}
        names = [
            c.name
            for k, group in groups
            if k not in bus
            for i, c in enumerate(group.channels)
            if mdf.masters_db.get(k) != i
        ]
        for k, group in groups:
            if k in bus:
                continue
            columns: dict[str, np.ndarray] = {}
            time = np.empty(0)
            for i, channel in enumerate(group.channels):
                if mdf.masters_db.get(k) == i:
                    continue
                name = channel.name if names.count(channel.name) == 1 else f'group_{k}/{channel.name}'
                name = f'{name}[{i}]' if name in columns else name  # twice in one group
                signal = mdf.get(group=k, index=i, raw=True, ignore_invalidation_bits=True)
                valid = None if signal.invalidation_bits is None else ~np.asarray(signal.invalidation_bits, bool)
                values = signal.physical(copy=False, ignore_value2text_conversions=True).samples
                why = _put(columns, name, values, valid)
                if why:
                    table.left_out[name] = why
                    continue
                time = signal.timestamps
                if signal.unit:
                    table.stated[name] = spelled(signal.unit)
            _add(table, f'group_{k}', file, time, columns)
    return bool(bus)


def _put(columns: dict[str, np.ndarray], name: str, values: np.ndarray, valid: np.ndarray | None = None) -> str:
    """Add a column of numbers, NaN where it is not valid; why it is none, or ''."""
    if values.ndim != 1 or values.dtype.kind not in 'biuf':
        return 'it holds text' if values.dtype.kind in 'SUO' else 'it holds no numbers, or several in a sample'
    columns[name] = values.astype(float)
    if valid is not None:
        columns[name][~valid] = np.nan
    return ''


def _read_frames(file: Path, databases: Sequence[Path], table: Table) -> None:
    """The signals in the frames of a bus. Raises BagError."""
    import can
    from asammdf.blocks.bus_logging_utils import extract_mux

    messages: dict[tuple[int, bool], Any] = {}
    for place in databases:
        for frame in _database(place):
            messages.setdefault((frame.arbitration_id.id, bool(frame.arbitration_id.extended)), frame)
    stamps: dict[tuple[int, bool], list[float]] = {}
    payloads: dict[tuple[int, bool], list[bytes]] = {}
    count = unknown = short = other = 0
    with _one_sentence(f'cannot read {file}'), can.LogReader(file) as reader:
        for one in reader:
            count += 1
            key = (one.arbitration_id, one.is_extended_id)
            message = messages.get(key)
            if one.is_error_frame or one.is_remote_frame:
                other += 1
            elif message is None:
                unknown += 1
            elif len(one.data) < message.size:
                short += 1
            else:
                stamps.setdefault(key, []).append(one.timestamp)
                payloads.setdefault(key, []).append(bytes(one.data[: message.size]))
    lost = (
        (unknown, 'have an identifier that no database has'),
        (short, 'are shorter than their message'),
        (other, 'are errors or requests'),
    )
    table.told += [f'{n} of {count} frames {text}' for n, text in lost if n]
    for key, times in stamps.items():
        payload = np.frombuffer(b''.join(payloads[key]), np.uint8).reshape(len(times), -1)
        alike = sum(message.name == messages[key].name for message in messages.values())
        name = messages[key].name if alike == 1 else f'{messages[key].name}_{key[0]:X}'
        found = extract_mux(payload, messages[key], key[0], 0, np.array(times))
        for number, signals in enumerate(s for s in found.values() if s):
            columns: dict[str, np.ndarray] = {}
            for signal in signals.values():
                column = f'{name}/{signal["name"]}'
                why = _put(columns, column, np.asarray(signal['samples']))
                if why:
                    table.left_out[column] = why
                elif signal['unit']:
                    table.stated[column] = spelled(signal['unit'])
            time = next(iter(signals.values()))['t']
            # multiplexed ones have their own instants
            _add(table, name if number == 0 else f'{name}-{number}', file, time, columns)


def _database(place: Path) -> Any:
    """The messages of a database. Raises BagError."""
    from asammdf.blocks.utils import load_can_database

    if not Path(place).is_file():
        raise BagError(f'--dbc {place}: no such file')
    with _one_sentence(f'--dbc {place}'):
        found = load_can_database(place, load_flat=True)
    if found is None or not found.frames:
        raise BagError(f'--dbc {place}: no message is defined in it; give a .dbc or .arxml file')
    return found.frames


def _add(table: Table, topic: str, file: Path, time: np.ndarray, columns: dict[str, np.ndarray]) -> None:
    """Columns as a topic, at the instants that rise. Raises BagError where most do not."""
    if not columns or not time.size:
        return
    seconds = np.asarray(time, float)
    known = np.abs(seconds) < LATEST  # NaN is not
    if lost := int(seconds.size - np.count_nonzero(known)):
        if lost > (1.0 - LEAST_SHARE) * seconds.size:
            raise BagError(
                f'{file}: {lost} of {seconds.size} times of {topic} are no numbers of seconds below {LATEST:.3g}'
            )
        table.told.append(
            f'{lost} of {seconds.size} samples of {topic} have a time that is no number below {LATEST:.3g} s, and are '
            'dropped'
        )
        seconds, columns = seconds[known], {name: values[known] for name, values in columns.items()}
    time_ns = np.round(seconds * 1e9).astype(np.int64)
    kept = rising(time_ns)
    if kept.size < LEAST_SHARE * time_ns.size:
        raise BagError(
            f'{file}: the times of {topic} stand still or go back in {time_ns.size - kept.size} of {time_ns.size} '
            'samples'
        )
    if kept.size < time_ns.size:
        table.told.append(
            f'{time_ns.size - kept.size} of {time_ns.size} samples of {topic} repeat a stamp or are out of order'
        )
    for name, values in columns.items():
        lacking = int(np.sum(~np.isfinite(values[kept])))
        if lacking:
            table.told.append(f'{name}: {lacking} of {kept.size} samples without a valid number')
    table.series[topic] = Series(time_ns[kept], {name: values[kept] for name, values in columns.items()})
