"""Recordings in SQLite, which `ros2 bag record` made until Humble, and definitions of types in IDL, by the library
rosbags."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from mcap.records import Channel, Schema

from mbd_sim_ros.bags.records import TIME_MOST, ZSTD, Messages, Record, unpacked
from solver.errors import BagError

SUFFIX = '.db3'
MISSING = "needs the library rosbags: pip install 'mbd_sim_ros[rosbag2]'"
GATHERED = 1 << 19  # bytes of messages that are handed on at once
_TIMES = struct.Struct('<qq')  # log time, publish time
_RULE = '=' * 80


class Database:
    """A recording in one file, or several in their order, as records (records.py). A database holds one time of every
    message, when it was recorded, and no checksum; what `metadata.yaml` beside it says of the number of messages is
    compared.

    files: the databases. called: their names in sentences.
    """

    def __init__(self, files: Sequence[Path], called: Sequence[Path]) -> None:
        self.expected: dict[int, int] = {}
        self.counts: Counter[int] = Counter()
        self._files, self._called = files, called
        try:
            self.size = sum(file.stat().st_size for file in files)
        except OSError as error:
            raise BagError(f'cannot read {called[0]}: {error.strerror}') from None

    def __iter__(self) -> Iterator[Record]:
        try:
            from rosbags.rosbag2 import Reader
        except ImportError:
            raise BagError(f'{self._called[0]} is a database of ros2 bag, whose reader {MISSING}') from None
        channels: dict[tuple[str, str], int] = {}
        for file, called in zip(self._files, self._called, strict=True):
            if not file.stat().st_size:
                raise BagError(f'{called} is empty: nothing was recorded')
            try:
                with Reader(file) as reader:
                    yield from self._records(reader, channels)
            except BagError:
                raise
            except Exception as error:  # those of rosbags and apsw have no common base
                why = ' '.join(str(error).split()) or type(error).__name__
                raise BagError(f'{called} is cut off or damaged ({why}); {salvage(called)}') from None

    def _records(self, reader: Any, channels: dict[tuple[str, str], int]) -> Iterator[Record]:
        """Those of one database. channels: by topic and type, of the files before too."""
        for one in reader.connections:
            if (one.topic, one.msgtype) in channels:
                continue
            number = channels[one.topic, one.msgtype] = len(channels) + 1
            yield _schema(number, one)
            encoding = getattr(one.ext, 'serialization_format', 'cdr')
            yield Channel(id=number, schema_id=number, topic=one.topic, message_encoding=encoding, metadata={})
        waiting: dict[int, tuple[list[bytes], list[bytes]]] = {}
        gathered = 0
        for one, t_ns, data in reader.messages():
            number = channels[one.topic, one.msgtype]
            if not 0 <= t_ns <= TIME_MOST or not isinstance(data, bytes):
                raise ValueError(f'a message of {one.topic} is dated {t_ns} ns, or holds no bytes')
            times, messages = waiting.setdefault(number, ([], []))
            times.append(_TIMES.pack(t_ns, 0))
            messages.append(unpacked(data) if data.startswith(ZSTD) else data)
            self.counts[number] += 1
            gathered += len(messages[-1])
            if gathered > GATHERED:
                yield from (Messages(channel, *found) for channel, found in waiting.items())
                waiting, gathered = {}, 0
        yield from (Messages(channel, *found) for channel, found in waiting.items())

    def require_whole(self) -> None:
        """Raise BagError if files or messages are missing that metadata.yaml speaks of."""
        import yaml

        place = self._called[0].parent
        try:
            said = yaml.safe_load((place / 'metadata.yaml').read_text(encoding='utf-8'))['rosbag2_bagfile_information']
            names, count = [Path(name).name for name in said['relative_file_paths']], int(said['message_count'])
        except (OSError, ValueError, LookupError, TypeError, yaml.YAMLError):  # there is none, or a broken one
            return
        ours = {path.name for path in self._called}
        if not ours & {*names, *(f'{name}.zstd' for name in names)}:
            return
        if lacking := [name for name in names if not {name, f'{name}.zstd'} & ours and not (place / name).exists()]:
            raise BagError(f'{place}: its metadata.yaml speaks of {lacking[0]}, which is not there')
        found = sum(self.counts.values())
        if len(ours) == len(names) and found != count:
            raise BagError(
                f'{place} is cut off or damaged (its metadata.yaml says that it holds {count} messages, and {found} '
                'were found)'
            )


def salvage(path: Path) -> str:
    """Remedy that saves the rows of a damaged database."""
    file = path if path.suffix == SUFFIX else path.with_suffix('')
    first = '' if file == path else f'unpack it (zstd -d {path}); '
    return (
        f'{first}`sqlite3 {file} .recover | sqlite3 {file.with_name("saved" + SUFFIX)}` saves the rows that can be read'
    )


def _schema(number: int, one: Any) -> Schema:
    """The type of a connection of rosbags. Until Humble databases had no definitions: those of Humble hold then."""
    from rosbags.interfaces import MessageDefinitionFormat
    from rosbags.typesys import Stores, get_typestore

    known = {MessageDefinitionFormat.MSG: 'ros2msg', MessageDefinitionFormat.IDL: 'ros2idl'}
    if one.msgdef.format in known:
        return Schema(id=number, name=one.msgtype, encoding=known[one.msgdef.format], data=one.msgdef.data.encode())
    store = get_typestore(Stores.ROS2_HUMBLE)
    if one.msgtype not in store.types:
        return Schema(
            id=number,
            name=one.msgtype,
            encoding='nothing (it is no type of ROS 2 Humble, and the database defines none)',
            data=b'',
        )
    return Schema(
        id=number,
        name=one.msgtype,
        encoding='ros2msg',
        data=store.generate_msgdef(one.msgtype, ros_version=2)[0].encode(),
    )


def from_idl(schema: Schema) -> tuple[Schema | None, str]:
    """A type that is defined in IDL, defined in ros2msg; None, and why, where that cannot be."""
    try:
        from rosbags.typesys import Stores, get_types_from_idl, get_typestore
    except ImportError:
        return None, f"its type is defined in 'ros2idl', which {MISSING}"
    try:
        store = get_typestore(Stores.EMPTY)
        for part in schema.data.decode().replace('\r\n', '\n').split(_RULE + '\n'):
            text = part.partition('\n')[2] if part.startswith('IDL:') else part
            if text.strip():
                store.register({name: of for name, of in get_types_from_idl(text).items() if name not in store.types})
        text, _ = store.generate_msgdef(schema.name, ros_version=2)
    except Exception as error:  # whatever a definition may hold
        why = (' '.join(str(error).split()) or type(error).__name__)[:80]
        return None, f"its definition in 'ros2idl' cannot be read: {why}"
    return Schema(id=schema.id, name=schema.name, encoding='ros2msg', data=text.encode()), ''
