"""The records of an MCAP file, one after the other, and whether all of them are as they were written. Nothing is decoded here.

Whole is what ends with a footer and the magic, where every checksum that was written is right (of each chunk, of the data before
`DataEnd`, of the summary) and where the statistics count as many messages and chunks as were found. Files of others may lack any of
these; ours have all.

A file may be made to hurt its reader, so what it claims is bounded before anything is reserved for it: CHUNK_MOST bytes in a chunk,
and in all no more bytes and messages than its size can hold even when the messages hardly differ.
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
FOOTER, MESSAGE, CHUNK, ATTACHMENT, DATA_END = 2, 5, 6, 9, 15
_ARRAYS_HEAD = 16 + 4 + 64 + 4 + len(ARRAYS) + 8  # bytes before the data of an attachment with arrays: times, hash, media type, length
KINDS: dict[int, Any] = {3: Schema, 4: Channel, 11: Statistics, 12: Metadata}  # by opcode
SIZES = {FOOTER: 20, DATA_END: 4, 14: 17}  # of records that are always of one size [bytes]
LAST_OPCODE, FIRST_PRIVATE = 15, 128  # those between are none
ZSTD = bytes.fromhex('28b52ffd')  # what a message begins with that ros2 bag has packed by itself (compression mode MESSAGE)
CHUNK_MOST = 1 << 27  # bytes in a chunk
INFLATED = (1 << 28, 2000)  # bytes in a file: so many, and so many for every byte on disk
MESSAGES = (1_000_000, 0.5)  # messages in a file, likewise
TIME_MOST = (1 << 63) - 1  # ns
_OWN = threading.local()
_HEAD = struct.Struct('<BQ')  # opcode, length
_CHUNK = struct.Struct('<QQQII')  # first and last log time, size, checksum, length of the name of the compression
_MESSAGE = struct.Struct('<BQHI16s')  # opcode, length, channel, sequence, log time and publish time
_INDEX = struct.Struct('<HI')  # channel, length of its entries
_FOOTER = struct.Struct('<QQI')  # begin of the summary, of its offsets, checksum
_TAIL = struct.Struct('<BQQQI8s')  # the footer (opcode, length, begin of the summary, of its offsets, checksum) and the magic
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
    """(n, 2) log times and publish times [ns] of messages. The latter may be beyond what 63 bits hold, and are negative then."""
    return np.frombuffer(b''.join(times), '<i8').reshape(-1, 2)


Record = Messages | Schema | Channel | Metadata


class Reading:
    """One pass over a file: iterated once, it gives the records that matter here and the messages of every complete chunk.

    skip: channels whose messages are passed over; it may grow while the file is read. channels: those that the file is said to have
    (message_counts); when all are declared, chunks are not unpacked that by their indexes hold nothing but what is passed over. onwards: go
    on behind a damaged record, to save what there is; otherwise the first damage ends the pass. called: the name of
    the file in sentences, where it is an unpacked copy.
    Afterwards `damage` says what is wrong with the file (empty: it is whole), `lost` how many messages are known to be
    missing, and `counts` how many each channel has, also of those that were passed over.
    Iterating raises BagError if the file is not MCAP or cannot be opened.
    """

    def __init__(
        self, path: Path, *, skip: Collection[int] = (), channels: Collection[int] = (), onwards: bool = False, called: Path | None = None
    ) -> None:
        self.path, self.file = called or path, path
        self.damage: list[str] = []
        self.attachments: list[str] = []  # hashes of the arrays that came by
        self.lost = 0
        self._tallies: Counter[tuple[tuple[int, int], ...]] = Counter()  # messages of each channel in a chunk, of all chunks
        self._skip, self._onwards = skip, onwards
        self._layouts = Layouts()
        self._undeclared = set(channels)
        self._may_skip = bool(channels)
        self._chunks = self._messages = self._inflated = self._at = 0
        self._counted = self._checked = False
        self._chunk_read: tuple[int, bytes] | None = None  # begin and body of a chunk that waits for what its indexes say
        self._indexed: dict[int, int] = {}  # messages of every channel in it
        self._private = -1  # where a record of a kind of somebody's own begins

    def require_whole(self) -> None:
        """Raise BagError if the file is not as it was written."""
        if self.damage:
            path = self.path
            raise BagError(f'{path} is cut off or damaged ({self.damage[0]}); `mbd recover {path} NEW` saves every complete chunk')

    @property
    def counts(self) -> Counter[int]:
        """Channel -> messages that were found."""
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
                self.damage.append(f'the record at byte {begin} is of no kind there is')
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
                source.begin()  # what is summed from here on is the summary
                continue
            body = source.take(length)
            try:
                yield from self._record(opcode, head, body)
            except _BROKEN as error:
                self._cannot_read('record', begin, error)

    def _attachment(self, source: ChecksummedStream, length: int, begin: int) -> None:
        """Put arrays of a scene where its text finds them, unless they are there already."""
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
        """The records in the chunk read last, now that its indexes are known. The checksum of the data of one that is
        not unpacked tells if it is as it was written.
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
        """Raise BagError for a recording of a later version, whose numbers might mean something else. One without a format is older."""
        text = about.get('format', '1')
        if not (text.isascii() and text.isdigit() and len(text) < 10):
            raise BagError(f'{self.path} is damaged: its metadata say format = {text[:40]!r}, which is not a whole number')
        if int(text) > FORMAT:
            version = about.get('code_version', '').partition('+')[0][:40] or 'a later version'
            raise BagError(
                f'{self.path} has format {int(text)}, and this version of mbd_sim_ros reads formats up to {FORMAT}: update mbd_sim_ros '
                f'(the recording was made by {version})'
            )

    def _chunk(self, body: bytes) -> bytes:
        """The records in a chunk. Raises what says that it is damaged."""
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
        """Yield the records of a decompressed chunk, its messages gathered by channel."""
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
        """(numbers of messages of every channel in a chunk, its other records, messages that are not passed over). The
        loop runs once per message. Raises on a damaged chunk."""
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
        """Hold what was found against the statistics."""
        self._counted = True
        if (told.message_count, told.chunk_count) != (self._messages, self._chunks):
            self.lost = max(0, told.message_count - self._messages)
            says = f'it says that it holds {told.message_count} messages in {told.chunk_count} chunks'
            self.damage.insert(0, f'{says}, and {self._messages} in {self._chunks} were found')

    def _end(self, source: ChecksummedStream, size: int, head: bytes) -> None:
        """The footer: the last record, before the magic."""
        checksum = source.checksum(_HEAD.size)
        body = source.take(_FOOTER.size)
        begin, _, told = _FOOTER.unpack(body)
        if source.take(len(MAGIC)) != MAGIC or self._at + len(MAGIC) != size:
            self.damage.append('it does not end with its footer')
        elif told and told != zlib.crc32(body[:16], zlib.crc32(head, checksum)):
            self.damage.append('the checksum of its summary is wrong')
        elif self._checked and begin and not told:
            self.damage.append('the checksum of its summary is missing')
        elif self._private >= 0 and not (self._counted or self._checked):  # a chunk whose opcode is damaged looks like it
            self.damage.append(f'the record at byte {self._private} is of no kind that is known, and nothing tells that it may be left out')


class _Crafted(ValueError):
    """More is claimed than a recording holds."""


def unpacked(data: bytes) -> bytes:
    """A message that ros2 bag has packed by itself. Raises ValueError."""
    import zstandard

    try:
        size = zstandard.frame_content_size(data)
    except zstandard.ZstdError as error:
        raise ValueError('not readable as zstd') from error
    if size > CHUNK_MOST:
        raise _Crafted(f'a message of it claims to hold {size} bytes')
    return _inflate('zstd', data, size)


def _inflate(compression: str, data: bytes, size: int) -> bytes:
    """Decompress; never more than size + 1 bytes. Raises ValueError when it is damaged, or packed in a way that is not known here."""
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
    """Decompressor of zstandard, one for each thread: a file has many chunks."""
    if not hasattr(_OWN, 'zstd'):
        import zstandard

        _OWN.zstd = zstandard.ZstdDecompressor()
    return _OWN.zstd


def message_counts(path: Path) -> dict[int, int]:
    """Number of messages of each channel, by the summary at the end of the file; empty where there is none. A hint: it
    may be wrong."""
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
    """Name, media type and length of the data of an attachment; of one with another head than ours, whatever stands there."""
    if len(head) < _ARRAYS_HEAD:
        return '', '', 0
    media = head[16 + 4 + 64 + 4 : -8].decode('latin-1')
    return head[16 + 4 : 16 + 4 + 64].decode('latin-1'), media, int.from_bytes(head[-8:], 'little')
