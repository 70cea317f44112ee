"""The records of an MCAP file, one after the other: a broken file gives every complete chunk. Nothing is decoded here."""

from __future__ import annotations

import os
import struct
from collections.abc import Collection, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, Footer, Metadata, Schema, Statistics
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream

from mbd_sim_ros.bags.writer import PART
from solver.errors import BagError

MAGIC = b'\x89MCAP0\r\n'
KINDS: dict[int, Any] = {2: Footer, 3: Schema, 4: Channel, 11: Statistics, 12: Metadata}  # by opcode
MESSAGE, CHUNK = 5, 6
_HEAD = struct.Struct('<BQ')  # opcode, length
_CHUNK = struct.Struct('<QQQII')  # first and last log time, size, checksum, length of the name of the compression
_MESSAGE = struct.Struct('<BQHIQQ')  # opcode, length, channel, sequence, log time, publish time
_TAIL = struct.Struct('<BQQQI8s')  # the footer (opcode, length, begin of the summary, of its offsets, checksum) and the magic
_BROKEN = (McapError, CRCValidationError, ValueError, IndexError, KeyError, struct.error, EOFError, MemoryError)


class Messages(NamedTuple):
    """The messages of one channel in one chunk, as they were recorded."""

    channel: int
    log_times: list[int]  # [ns]
    data: list[bytes]


Record = Messages | Schema | Channel | Metadata | Statistics | Footer


def find_file(path: str | Path, *, unfinished: bool = False) -> Path:
    """Return the MCAP file of a bag directory (or `path` itself, if it is a file); `unfinished` admits `.part` files.

    Raises BagError if there is none.
    """
    path = Path(path)
    if path.is_file():
        return path
    if not path.is_dir():
        raise BagError(f'{path} is not there: neither a bag directory nor an .mcap file')
    found = sorted(path.glob('*.mcap'))
    parts = sorted(path.glob('*.mcap' + PART))
    if not found and parts and unfinished:
        found = parts
    if not found:
        if parts:
            raise BagError(f'{path} was not finished: the recording process died; `mbd recover {path} NEW` saves every complete chunk')
        other = ' (storage sqlite3 is not read; convert it with `ros2 bag convert`)' if list(path.glob('*.db3')) else ''
        raise BagError(f'{path} is not a recording: it holds no .mcap file{other}')
    if len(found) > 1:
        raise BagError(f'{path} holds {len(found)} .mcap files; name one of them')
    return found[0]


def records(path: Path, *, skip: Collection[int] = ()) -> Iterator[Record]:
    """Yield the records of a file that matter here, and the messages of every complete chunk whose checksum is right.

    skip: channels whose messages are passed over; it may grow while the file is read. A record that is cut off or damaged ends the
    stream: whoever wants to know whether it was whole looks for the Footer.
    Raises BagError if the file is not MCAP or cannot be opened.
    """
    try:
        stream = path.open('rb', buffering=1 << 20)
    except OSError as error:
        raise BagError(f'cannot read {path}: {error.strerror}') from error
    with stream:
        size = os.fstat(stream.fileno()).st_size
        if size == 0:
            raise BagError(f'{path} is empty: nothing was recorded')
        if stream.read(len(MAGIC)) != MAGIC:
            raise BagError(f'{path} is not a recording: it is not an MCAP file')
        at, chunks = len(MAGIC), 0
        try:
            while len(head := stream.read(_HEAD.size)) == _HEAD.size:
                opcode, length = _HEAD.unpack(head)
                at += _HEAD.size + length
                if at > size:
                    return
                body = stream.read(length)
                if opcode == CHUNK:
                    begin, end, inflated, checksum, n = _CHUNK.unpack_from(body)
                    at_data = _CHUNK.size + n + 8
                    compression = body[_CHUNK.size : at_data - 8].decode()
                    chunk = Chunk(compression, body[at_data:], end, begin, checksum, inflated)
                    content, length = get_chunk_data_stream(chunk, validate_crc=True)
                    if length != inflated:
                        return
                    chunks += 1
                    yield from _inside(content.read(length), skip)
                elif opcode == MESSAGE:  # of a file without chunks
                    yield from _inside(head + body, skip)
                elif opcode in KINDS:
                    record = KINDS[opcode].read(ReadDataStream(BytesIO(body)))
                    if isinstance(record, Statistics) and record.chunk_count != chunks:
                        return  # what should be a chunk was not
                    yield record
                    if opcode == 2:
                        return
        except _BROKEN:
            return
        except Exception as error:  # decompression errors of zstandard and lz4 have no common base
            if type(error).__module__.split('.')[0] in ('zstandard', 'zstd', 'backports', 'compression', 'lz4', 'builtins'):
                return
            raise


def _inside(body: bytes, skip: Collection[int]) -> Iterator[Record]:
    """Yield the records of a decompressed chunk, its messages gathered by channel: the loop runs once per message of a recording."""
    at, end = 0, len(body) - _HEAD.size
    head, whole = _HEAD.size, _MESSAGE.size
    unpack = _MESSAGE.unpack_from
    found: dict[int, Messages] = {}
    while at <= end:
        if body[at] == MESSAGE:
            _, length, channel, _, log_time, _ = unpack(body, at)
            behind = at + head + length
            if channel in found:
                one = found[channel]
            elif channel in skip:
                at = behind
                continue
            else:
                one = found[channel] = Messages(channel, [], [])
            one[1].append(log_time)
            one[2].append(body[at + whole : behind])
            at = behind
            continue
        opcode, length = _HEAD.unpack_from(body, at)
        at += head
        if opcode in (3, 4):
            yield KINDS[opcode].read(ReadDataStream(BytesIO(body[at : at + length])))
        at += length
    yield from found.values()


def message_counts(path: Path) -> dict[int, int]:
    """How many messages each channel has, by the summary at the end of the file; empty where there is none."""
    with path.open('rb') as stream:
        size = os.fstat(stream.fileno()).st_size
        stream.seek(max(0, size - _TAIL.size))
        tail = stream.read()
        if len(tail) < _TAIL.size:
            return {}
        opcode, _, begin, _, _, magic = _TAIL.unpack(tail)
        if opcode != 2 or magic != MAGIC or not 0 < begin < size:
            return {}
        stream.seek(begin)
        summary = stream.read()
    at = 0
    while at + _HEAD.size <= len(summary):
        opcode, length = _HEAD.unpack_from(summary, at)
        at += _HEAD.size
        if opcode == 11 and at + length <= len(summary):
            found = Statistics.read(ReadDataStream(BytesIO(summary[at : at + length])))
            return {channel: min(count, size) for channel, count in found.channel_message_counts.items()}
        at += length
    return {}
