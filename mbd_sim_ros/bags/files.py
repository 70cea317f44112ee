"""Recordings on disk: which files they are, and how each kind is read.

MCAP, and what `ros2 bag record` wrote until Humble: SQLite (.db3), packed as a whole (.zstd) or message by message.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from mcap.records import Channel, Schema

from mbd_sim_ros.bags import rosbag2
from mbd_sim_ros.bags.records import INFLATED, Reading, Record, message_counts
from mbd_sim_ros.bags.writer import PART
from solver.errors import BagError

PACKED = '.zstd'  # what names of files end in that ros2 bag has packed as a whole
PIECE = 1 << 20  # bytes that are unpacked at once


class RecordSource(Protocol):
    """A recording that is read once, record by record. size: bytes on disk. expected: messages of each channel, as it
    says itself; a hint."""

    size: int
    expected: dict[int, int]

    @property
    def counts(self) -> Counter[int]:
        """Channel -> messages that were found."""

    def __iter__(self) -> Iterator[Record]: ...

    def require_whole(self) -> None:
        """Raise BagError if it is not as it was written."""


class McapFile(Reading):
    """An MCAP file as a source."""

    def __init__(self, path: Path, skip: set[int], called: Path | None = None) -> None:
        self.expected, self.size = message_counts(path), path.stat().st_size
        super().__init__(path, skip=skip, channels=self.expected, called=called)


class Unpacked:
    """Files that were packed as a whole, unpacked while they are read."""

    def __init__(self, packed: list[Path], skip: set[int]) -> None:
        self.expected: dict[int, int] = {}
        self.size, self._packed, self._skip = sum(map(_size_of, packed)), packed, skip
        self._inner: RecordSource | None = None

    @property
    def counts(self) -> Counter[int]:
        """Counts of the messages in them."""
        return self._inner.counts if self._inner is not None else Counter()

    def __iter__(self) -> Iterator[Record]:
        import tempfile

        with tempfile.TemporaryDirectory(prefix='mbd-unpacked-') as scratch:
            files = [Path(scratch) / f'{k}{path.with_suffix("").suffix}' for k, path in enumerate(self._packed)]
            for path, file in zip(self._packed, files, strict=True):
                _unpack(path, file)
            if files[0].suffix == rosbag2.SUFFIX:
                self._inner = rosbag2.Database(files, self._packed)
            else:
                self._inner = McapFile(files[0], self._skip, self._packed[0])
            yield from self._inner

    def require_whole(self) -> None:
        """Raise BagError if it is not as it was written."""
        if self._inner is not None:
            self._inner.require_whole()


def open_recording(path: str | Path, *, skip: set[int]) -> RecordSource:
    """A bag directory, an .mcap or .db3 file, or one of these that is packed (.zstd), to be read once.

    skip: channels whose messages are not wanted; it may grow. Raises BagError if there is none, or several.
    """
    path = Path(path)
    found = _of_rosbag2(path)
    if not found:
        return McapFile(find_file(path), skip)
    if found[0].suffix == PACKED:
        return Unpacked(found, skip)
    return rosbag2.Database(found, found)


def holds_recording(directory: Path) -> bool:
    """True where a directory holds a recording, whole or not."""
    return any(any(directory.glob(pattern)) for pattern in ('*.mcap*', f'*{rosbag2.SUFFIX}*'))


def _of_rosbag2(path: Path) -> list[Path]:
    """The files of a recording that is no plain MCAP file: databases in their order, or packed ones."""
    try:
        if path.is_file():
            return [path] if path.suffix in (rosbag2.SUFFIX, PACKED) else []
        if not path.is_dir() or list(path.glob('*.mcap')) or list(path.glob('*.mcap' + PART)):
            return []
        for kind in (rosbag2.SUFFIX, rosbag2.SUFFIX + PACKED, '.mcap' + PACKED):
            if found := sorted(path.glob('*' + kind), key=_numbered):
                break
        else:
            return []
    except (OSError, ValueError) as error:  # a name that no file can have
        raise BagError(f'cannot read {str(path)!r}: {getattr(error, "strerror", None) or error}') from None
    if len(found) > 1 and kind == '.mcap' + PACKED:
        raise BagError(
            f'{path} holds {len(found)} packed .mcap files; name one of them, or unpack them (zstd -d) and join them: '
            'mbd recover'
        )
    return found


def _unpack(path: Path, file: Path) -> None:
    """Write what is in a packed file. Raises BagError."""
    import zstandard

    size, most = 0, INFLATED[0] + INFLATED[1] * _size_of(path)
    try:
        with path.open('rb') as packed, file.open('wb') as out:
            reader = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
            while piece := reader.read(PIECE):
                size += len(piece)
                if size > most:
                    raise BagError(f'{path} claims to hold more than {most} bytes')
                out.write(piece)
    except zstandard.ZstdError:
        raise BagError(f'{path} is cut off or damaged: it cannot be unpacked') from None
    except OSError as error:
        raise BagError(f'cannot unpack {path}: {error.strerror or error}') from None
    if not size:
        raise BagError(f'{path} is cut off or damaged: nothing is in it')


def _size_of(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError as error:
        raise BagError(f'cannot read {path}: {error.strerror}') from None


def readable(channel: Channel, schema: Schema | None) -> tuple[Schema | None, str]:
    """The type of a channel, defined in ros2msg; None, and why, where its messages cannot be decoded here."""
    if channel.message_encoding != 'cdr':
        return None, f'its messages are encoded as {channel.message_encoding!r}, not as cdr'
    if schema is None:
        return None, 'its type is not defined'
    if schema.encoding == 'ros2idl':
        return rosbag2.from_idl(schema)
    return (
        (schema, '')
        if schema.encoding == 'ros2msg'
        else (None, f'its type is defined in {schema.encoding!r}, not in ros2msg or ros2idl')
    )


def find_file(path: str | Path) -> Path:
    """Return the MCAP file of a bag directory (or `path` itself, if it is a file). Raises BagError if there is none, or
    several."""
    found = find_files(path)
    if len(found) > 1:
        joined = f'if they are the parts of one recording, `mbd recover {path} NEW` makes one file of them'
        raise BagError(f'{path} holds {len(found)} .mcap files; name one of them, or, {joined}')
    return found[0]


def find_files(path: str | Path, *, unfinished: bool = False) -> list[Path]:
    """Return the MCAP files of a bag directory (or `path` itself, if it is a file), those of a recording that was split
    in their order; `unfinished` admits `.part` files where there are no others.

    Raises BagError if there is none.
    """
    path = Path(path)
    try:
        if path.is_file() and path.suffix not in (PACKED, rosbag2.SUFFIX):
            return [path]
        if not path.is_dir():
            if path.is_file():
                raise _packed(path)
            if path.exists():
                raise BagError(f'{path} is a pipe or a device; copy what comes from it into a file')
            raise BagError(f'{path} is not there: neither a bag directory nor an .mcap file')
        found = sorted(path.glob('*.mcap'), key=_numbered)
        parts = sorted(path.glob('*.mcap' + PART))
    except (OSError, ValueError) as error:  # a name that no file can have
        raise BagError(f'cannot read {str(path)!r}: {getattr(error, "strerror", None) or error}') from None
    if not found and parts and unfinished:
        found = parts
    if not found:
        if parts:
            raise BagError(
                f'{path} was not finished: the recording process died; `mbd recover {path} NEW` saves every complete '
                'chunk'
            )
        if packed := _of_rosbag2(path):
            raise _packed(packed[0])
        raise BagError(f'{path} is not a recording: it holds no .mcap file, and no .db3 file')
    return found


def _packed(path: Path) -> BagError:
    """For those that take MCAP files alone."""
    if rosbag2.SUFFIX in path.suffixes:
        return BagError(
            f'{path} is a database of ros2 bag (SQLite), and recovered are MCAP files alone; {rosbag2.salvage(path)}'
        )
    return BagError(
        f'{path} is packed as a whole (compression mode FILE of ros2 bag); unpack it: zstd -d {path} -o '
        f'{path.with_suffix("")}'
    )


def _numbered(path: Path) -> list[tuple[int, str]]:
    """Sorts by the numbers in a name: 2 before 10."""
    return [(int(word), '') if word.isdecimal() else (0, word) for word in re.split('([0-9]+)', path.name)]
