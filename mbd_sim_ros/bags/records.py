"""Reader of the records of an MCAP file, one after the other, that also checks whether the file is whole.

Messages are not decoded here. A file is whole if it ends with a footer and the magic bytes, if every checksum in it is
right (of each chunk, of the data before `DataEnd`, of the summary), and if its statistics count as many messages and
chunks as were found. Files of other programs may lack checksums and statistics; ours have all of them.

A file may be crafted to hurt its reader. So its claims are bounded before memory is reserved: CHUNK_MOST bytes in a
chunk, and in the whole file no more bytes (INFLATED) and messages (MESSAGES) than a file of its size can hold.

The file is long because a Reading is one pass: all kinds of records share its counters and checksums.
"""

from __future__ import annotations

import os
import struct
import threading
import zlib
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Channel, Metadata, Schema, Statistics

from mbd_sim_ros.bags.layouts import Layouts
from mbd_sim_ros.bags.source import ENTRY, MESSAGE_INDEX, ChecksummedStream
from mbd_sim_ros.bags.writer import ARRAYS, FORMAT, RECORD
from solver import stored
from solver.errors import BagError, SpecError

MAGIC = b'\x89MCAP0\r\n'
FOOTER, MESSAGE, CHUNK, ATTACHMENT, DATA_END = 2, 5, 6, 9, 15  # opcodes of records (MCAP specification)
# Bytes before the data of an attachment with arrays: times, hash, media type, length.
_ARRAYS_HEAD = 16 + 4 + 64 + 4 + len(ARRAYS) + 8
KINDS: dict[int, Any] = {3: Schema, 4: Channel, 11: Statistics, 12: Metadata}  # opcode -> record that is read
SIZES = {FOOTER: 20, DATA_END: 4, 14: 17}  # opcode -> size [bytes] of a record that always has the same size
# the opcodes between are not assigned; from FIRST_PRIVATE on they are free for users
LAST_OPCODE, FIRST_PRIVATE = 15, 128
# first bytes of a message that ros2 bag has compressed by itself (compression mode MESSAGE)
ZSTD = bytes.fromhex('28b52ffd')
CHUNK_MOST = 1 << 27  # bytes in a chunk at most: 128 MB; ten times as much would not fit into small computers
INFLATED = (1 << 28, 2000)  # unpacked bytes in a file at most: a constant, and a factor on its bytes on disk
MESSAGES = (1_000_000, 0.5)  # messages in a file at most: a constant, and a factor on its bytes on disk
TIME_MOST = (1 << 63) - 1  # latest time [ns]
_OWN = threading.local()  # decompressor of each thread
_HEAD = struct.Struct('<BQ')  # of a record: opcode, length
_CHUNK = struct.Struct('<QQQII')  # first and last log time, size, checksum, length of the name of the compression
_MESSAGE = struct.Struct('<BQHI16s')  # opcode, length, channel, sequence, log time and publish time
_INDEX = struct.Struct('<HI')  # channel, length of its entries
_FOOTER = struct.Struct('<QQI')  # begin of the summary, begin of the summary offsets, checksum
_TAIL = struct.Struct('<BQQQI8s')  # opcode and length of the footer, the footer, the magic
# Errors that damaged bytes can raise while they are read.
_BROKEN = (McapError, ValueError, IndexError, KeyError, struct.error, EOFError, MemoryError, OverflowError)


class Messages(NamedTuple):
    """The messages of one channel in one chunk, as they were recorded."""

    channel: int
    times: Sequence[bytes]  # log time and publish time [ns] of each, as they lie in the file
    data: Sequence[bytes]

    @property
    def log_times(self) -> list[int]:
        """When they were recorded [ns]."""
        return instants(self.times)[:, 0].tolist()


def instants(times: Sequence[bytes]) -> np.ndarray:
    """(n, 2) log times and publish times [ns] of messages. A publish time beyond 63 bits appears as a negative
    number."""
    return np.frombuffer(b''.join(times), '<i8').reshape(-1, 2)


Record = Messages | Schema | Channel | Metadata


class Reading:
    """One pass over a file. It is iterated once, and gives schemas, channels, metadata, and the messages of every whole
    chunk.

    skip: channels whose messages are passed over; it may grow while the file is read. channels: all channels of the
    file by its summary (message_counts). Once all of them are declared, a chunk is not unpacked if its indexes list
    channels of `skip` only. onwards: go on behind a damaged record, to save the rest; otherwise the first damage ends
    the pass. called: name of the file in sentences, where `path` is an unpacked copy of it.

    Afterwards `damage` has a sentence for each fault of the file (none: it is whole), `lost` is the number of messages
    that are known to be missing, and `counts` the number of messages of each channel, skipped ones included. Iterating
    raises BagError if the file is not MCAP or cannot be opened.
    """

    def __init__(
        self,
        path: Path,
        *,
        skip: Collection[int] = (),
        channels: Collection[int] = (),
        onwards: bool = False,
        called: Path | None = None,
    ) -> None:
        self.path, self.file = called or path, path
        self.damage: list[str] = []
        self.attachments: list[str] = []  # hashes of the arrays that came by
        self.lost = 0
        # ((channel, its messages), ...) in a chunk -> chunks
        self._tallies: Counter[tuple[tuple[int, int], ...]] = Counter()
        self._skip, self._onwards = skip, onwards
        self._layouts = Layouts()
        self._undeclared = set(channels)
        self._may_skip = bool(channels)
        self._chunks = self._messages = self._inflated = self._at = 0
        self._counted = self._checked = False
        self._chunk_read: tuple[int, bytes] | None = None  # (begin, body) of a chunk whose indexes are not read yet
        self._indexed: dict[int, int] = {}  # channel -> its messages in that chunk, by the indexes
        self._private = -1  # first byte of the last record with a private opcode, -1: there is none

    def require_whole(self) -> None:
        """Raise BagError if the file is not whole."""
        if self.damage:
            path = self.path
            raise BagError(
                f'{path} is cut off or damaged ({self.damage[0]}); `mbd recover {path} NEW` saves every complete chunk'
            )

    @property
    def counts(self) -> Counter[int]:
        """Channel -> number of messages that were found."""
        found: Counter[int] = Counter()
        for counts, chunks in self._tallies.items():
            for channel, count in counts:
                found[channel] += chunks * count
        return found

    def __iter__(self) -> Iterator[Record]:
        try:
            stream = self.file.open('rb')
        except OSError as error:
            raise BagError(f'cannot read {self.path}: {error.strerror}') from error
        with stream:
            size = os.fstat(stream.fileno()).st_size
            if size == 0:
                raise BagError(f'{self.path} is empty: nothing was recorded')
            source = ChecksummedStream(stream)
            try:
                if source.take(len(MAGIC)) != MAGIC:
                    raise BagError(f'{self.path} is not a recording: it is not an MCAP file')
                for record in self._records(source, size):
                    if isinstance(record, Channel):
                        self._undeclared.discard(record.id)
                    yield record
            except OSError as error:
                raise BagError(f'cannot read {self.path}: {error.strerror}') from error

    def _records(self, source: ChecksummedStream, size: int) -> Iterator[Record]:
        self._at = len(MAGIC)
        while not self.damage or self._onwards:
            head = source.take(_HEAD.size)
            if len(head) < _HEAD.size:
                yield from self._waiting_chunk()
                self.damage.append('its end is missing')
                return
            opcode, length = _HEAD.unpack(head)
            begin, self._at = self._at, self._at + _HEAD.size + length
            if opcode != MESSAGE_INDEX or self._at > size:
                yield from self._waiting_chunk()
            if self._at > size:
                self.damage.append(f'its end is missing behind byte {begin}')
                return
            if length != SIZES.get(opcode, length) or opcode == 0 or LAST_OPCODE < opcode < FIRST_PRIVATE:
                self.damage.append(f'the record at byte {begin} has a type or a size that MCAP does not know')
                source.skip(length)
                continue
            if opcode == FOOTER:
                self._end(source, size, head)
                return
            if opcode == MESSAGE_INDEX and self._chunk_read and _INDEX.size <= length:
                channel, entries = _INDEX.unpack(source.take(_INDEX.size))
                self._indexed[channel] = entries // ENTRY
                source.skip(length - _INDEX.size)
                continue
            if opcode == CHUNK:
                self._chunk_read = (begin, source.take(length))
                self._indexed, passed = source.indexes()
                self._at += passed
                continue
            if opcode == ATTACHMENT:
                self._attachment(source, length, begin)
                continue
            if opcode not in KINDS and opcode not in (MESSAGE, DATA_END):
                self._private = begin if opcode >= FIRST_PRIVATE else self._private
                source.skip(length)
                continue
            if opcode == DATA_END:
                checksum = source.checksum(_HEAD.size)
                (told,) = struct.unpack('<I', source.take(length))
                self._checked = told != 0
                if self._checked and told != checksum:
                    self.damage.append('the checksum of its data is wrong')
                source.begin()  # from here on the checksum is that of the summary
                continue
            body = source.take(length)
            try:
                yield from self._record(opcode, head, body)
            except _BROKEN as error:
                self._cannot_read('record', begin, error)

    def _attachment(self, source: ChecksummedStream, length: int, begin: int) -> None:
        """Read an attachment: arrays of a scene are stored where the text of the scene finds them (solver.stored)."""
        head = source.take(min(length, _ARRAYS_HEAD))
        body = b''
        try:
            name, media, size = _arrays(head)
            known = media == ARRAYS and stored.DIGEST.fullmatch(name) is not None
            if known and stored.find(name) is None and size + len(head) + 4 == length:
                body = source.take(length - len(head))
                stored.accept(body[:size], name)
            if known:
                self.attachments.append(name)
        except (*_BROKEN, SpecError) as error:
            self._cannot_read('attachment', begin, error)
        source.skip(length - len(head) - len(body))

    def _cannot_read(self, what: str, begin: int, error: Exception) -> None:
        why = f': {error}' if type(error) is _Crafted else ''
        self.damage.append(f'the {what} at byte {begin} cannot be read{why}')

    def _waiting_chunk(self) -> Iterator[Record]:
        """Records in the chunk that was read last, now that its indexes are known; nothing if all its messages are
        skipped.

        The checksum of the data (`DataEnd`) also covers a chunk that is not unpacked.
        """
        if self._chunk_read is None:
            return
        (begin, body), self._chunk_read = self._chunk_read, None
        if self._may_skip and not self._undeclared and self._indexed and self._indexed.keys() <= set(self._skip):
            self._messages += sum(self._indexed.values())
            self._tallies[tuple(self._indexed.items())] += 1
            self._chunks += 1
            return
        try:
            yield from self._inside(self._chunk(body))
            self._chunks += 1
        except _BROKEN as error:
            self._cannot_read('chunk', begin, error)

    def _record(self, opcode: int, head: bytes, body: bytes) -> Iterator[Record]:
        if opcode == MESSAGE:  # of a file without chunks
            yield from self._inside(head + body)
        else:
            stream = ReadDataStream(BytesIO(body))
            record = KINDS[opcode].read(stream)
            if stream.count != len(body):
                raise ValueError
            if isinstance(record, Statistics):
                self._compare(record)
                return
            if isinstance(record, Metadata) and record.name == RECORD:
                self._require_format(record.metadata)
            yield record

    def _require_format(self, about: Mapping[str, str]) -> None:
        """Raise BagError for a format of a later version, whose numbers might mean something else. Without one it is
        format 1."""
        text = about.get('format', '1')
        if not (text.isascii() and text.isdigit() and len(text) < 10):
            raise BagError(
                f'{self.path} is damaged: its metadata say format = {text[:40]!r}, which is not a whole number'
            )
        if int(text) > FORMAT:
            version = about.get('code_version', '').partition('+')[0][:40] or 'a later version'
            raise BagError(
                f'{self.path} has format {int(text)}, and this version of mbd_sim_ros reads formats up to {FORMAT}: '
                f'update mbd_sim_ros (the recording was made by {version})'
            )

    def _chunk(self, body: bytes) -> bytes:
        """Unpacked bytes of the records in a chunk. Raises one of _BROKEN if the chunk is damaged."""
        _, _, inflated, checksum, n = _CHUNK.unpack_from(body)
        compression = body[_CHUNK.size : _CHUNK.size + n].decode()
        (length,) = struct.unpack_from('<Q', body, _CHUNK.size + n)
        data = body[_CHUNK.size + n + 8 :]
        self._inflated += inflated
        if inflated > CHUNK_MOST or self._inflated > INFLATED[0] + INFLATED[1] * self._at:
            raise _Crafted(f'it claims to hold {inflated} bytes')
        content = _inflate(compression, data, inflated) if len(data) == length else b''
        if len(content) != inflated or (checksum and zlib.crc32(content) != checksum):
            raise ValueError
        return content

    def _inside(self, body: bytes) -> Iterator[Record]:
        """Records of an unpacked chunk; its messages are gathered by channel."""
        most = int(MESSAGES[0] + MESSAGES[1] * self._at) - self._messages
        layout = self._layouts.find(len(body), self._skip)
        alike = layout.messages(body) if layout is not None and len(layout.heads) <= most else None
        others: list[Record] = []
        if layout is not None and alike is not None:
            found = [Messages(*one) for one in alike]
            counts = layout.counts
        else:
            counts, others, found = self._one_by_one(body, most)
            if counts and not others:
                self._layouts.learn(body, self._skip)
        log_times = instants([times for one in found for times in one.times])[:, 0]
        if log_times.min(initial=0) < 0:
            latest = int(log_times.astype(np.uint64).max())
            raise _Crafted(f'a message is dated {latest} ns, beyond what 63 bits hold')
        self._messages += sum(count for _, count in counts)
        self._tallies[counts] += 1
        yield from others
        for one in found:
            if one.data[0].startswith(ZSTD):
                one = one._replace(data=[unpacked(data) for data in one.data])
                self._inflated += sum(map(len, one.data))
                if self._inflated > INFLATED[0] + INFLATED[1] * self._at:
                    raise _Crafted(f'it claims to hold {self._inflated} bytes')
            yield one

    def _one_by_one(self, body: bytes, most: int) -> tuple[tuple[tuple[int, int], ...], list[Record], list[Messages]]:
        """(channel and number of its messages, ...), other records, and messages that are not skipped, of an unpacked
        chunk.

        The loop runs once for each message. most: messages that the file may still have. Raises one of _BROKEN if the
        chunk is damaged.
        """
        at, end = 0, len(body) - _HEAD.size
        head, whole = _HEAD.size, _MESSAGE.size
        least = whole - head
        unpack, skip = _MESSAGE.unpack_from, self._skip
        found: dict[int, tuple[list[bytes], list[bytes]]] = {}
        passed: Counter[int] = Counter()
        others: list[Record] = []
        count = 0
        while at <= end:
            if body[at] == MESSAGE:
                _, length, channel, _, times = unpack(body, at)
                behind = at + head + length
                count += 1
                if length < least or count > most:
                    raise _Crafted(f'it holds {count} messages and more') if count > most else ValueError
                if channel in found:
                    one = found[channel]
                elif channel in skip:
                    passed[channel] += 1
                    at = behind
                    continue
                else:
                    one = found[channel] = ([], [])
                one[0].append(times)
                one[1].append(body[at + whole : behind])
                at = behind
                continue
            opcode, length = _HEAD.unpack_from(body, at)
            at += head
            if opcode not in (3, 4) or len(others) > 0xFFFF:
                raise ValueError
            others.append(KINDS[opcode].read(ReadDataStream(BytesIO(body[at : at + length]))))
            at += length
        if at != len(body):
            raise ValueError
        passed.update({channel: len(data) for channel, (_, data) in found.items()})
        return tuple(passed.items()), others, [Messages(channel, *one) for channel, one in found.items()]

    def _compare(self, told: Statistics) -> None:
        """Compare the numbers of messages and chunks that were found with the statistics in the file."""
        self._counted = True
        if (told.message_count, told.chunk_count) != (self._messages, self._chunks):
            self.lost = max(0, told.message_count - self._messages)
            says = f'it says that it holds {told.message_count} messages in {told.chunk_count} chunks'
            self.damage.insert(0, f'{says}, and {self._messages} in {self._chunks} were found')

    def _end(self, source: ChecksummedStream, size: int, head: bytes) -> None:
        """Read the footer, the last record before the magic, and check the end of the file."""
        checksum = source.checksum(_HEAD.size)
        body = source.take(_FOOTER.size)
        begin, _, told = _FOOTER.unpack(body)
        if source.take(len(MAGIC)) != MAGIC or self._at + len(MAGIC) != size:
            self.damage.append('it does not end with its footer')
        elif told and told != zlib.crc32(body[:16], zlib.crc32(head, checksum)):
            self.damage.append('the checksum of its summary is wrong')
        elif self._checked and begin and not told:
            self.damage.append('the checksum of its summary is missing')
        elif self._private >= 0 and not (self._counted or self._checked):
            # a chunk whose opcode is damaged looks like it
            self.damage.append(f'the record at byte {self._private} has an unknown type: it may be a damaged chunk')


class _Crafted(ValueError):
    """A file claims more than it can hold; the message says what."""


def unpacked(data: bytes) -> bytes:
    """A message that ros2 bag has compressed by itself, decompressed. Raises ValueError."""
    import zstandard

    try:
        size = zstandard.frame_content_size(data)
    except zstandard.ZstdError as error:
        raise ValueError('not readable as zstd') from error
    if size > CHUNK_MOST:
        raise _Crafted(f'a message in it claims to hold {size} bytes')
    return _inflate('zstd', data, size)


def _inflate(compression: str, data: bytes, size: int) -> bytes:
    """Decompressed data, never more than size + 1 bytes. Raises ValueError for damaged data and for an unknown
    compression."""
    try:
        if compression == '':
            return data
        if compression == 'zstd':
            import zstandard

            if zstandard.frame_content_size(data) == size:
                return _decompressor().decompress(data, max_output_size=size)
            return zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True).read(size + 1)
        if compression == 'lz4':
            from lz4.frame import LZ4FrameDecompressor

            return LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    except Exception as error:  # those of zstandard and lz4 have no common base
        raise ValueError(f'not readable as {compression}') from error
    raise _Crafted(f'it is packed with {compression!r}, which is not read here')


def _decompressor() -> Any:
    """Decompressor of zstandard of this thread, made once: a file has many chunks."""
    if not hasattr(_OWN, 'zstd'):
        import zstandard

        _OWN.zstd = zstandard.ZstdDecompressor()
    return _OWN.zstd


def message_counts(path: Path) -> dict[int, int]:
    """Channel -> number of its messages, by the summary at the end of the file; empty without a summary. It may be
    wrong."""
    with path.open('rb') as stream:
        size = os.fstat(stream.fileno()).st_size
        stream.seek(max(0, size - _TAIL.size))
        tail = stream.read()
        if len(tail) < _TAIL.size:
            return {}
        opcode, _, begin, _, _, magic = _TAIL.unpack(tail)
        if opcode != FOOTER or magic != MAGIC or not 0 < begin < size:
            return {}
        stream.seek(begin)
        summary = stream.read()
    at = 0
    while at + _HEAD.size <= len(summary):
        opcode, length = _HEAD.unpack_from(summary, at)
        at += _HEAD.size
        if opcode == 11 and at + length <= len(summary):
            try:
                return Statistics.read(ReadDataStream(BytesIO(summary[at : at + length]))).channel_message_counts
            except _BROKEN:
                return {}
        at += length
    return {}


def _arrays(head: bytes) -> tuple[str, str, int]:
    """(name, media type, length of the data) of an attachment of ours; of one of another program the texts make no
    sense."""
    if len(head) < _ARRAYS_HEAD:
        return '', '', 0
    media = head[16 + 4 + 64 + 4 : -8].decode('latin-1')
    return head[16 + 4 : 16 + 4 + 64].decode('latin-1'), media, int.from_bytes(head[-8:], 'little')
