"""Chunks that are like one before are taken apart at once; what they give, and what is wrong with them, is what record
by record gives."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from scalars import write_scalars

from mbd_sim_ros.bags import layouts, reader, records
from mbd_sim_ros.bags.records import Messages, Reading

Chunk = list[tuple[int, int]]  # channel, bytes of its message

STEP: Chunk = [(1, 40), (2, 64), (3, 8)]


def chunk(messages: Chunk, time: int, opcode: int = records.MESSAGE, log_time: int | None = None) -> bytes:
    """The records of a chunk that begins with step `time`; the opcode is that of its last record, log_time that of
    all."""
    body = b''
    for k, (channel, size) in enumerate(messages):
        kind = opcode if k == len(messages) - 1 else records.MESSAGE
        at = time + k if log_time is None else log_time
        body += struct.pack('<BQHIQQ', kind, 22 + size, channel, k, at, 0) + bytes([(time + k) % 256]) * size
    return body


def read(file: Path, bodies: list[bytes], skip: set[int]) -> tuple[list[Messages], list[str]]:
    """What a file of these chunks gives, tuples as lists, and what is said to be wrong with it."""
    packed = [struct.pack('<QQQII', 0, 0, len(body), 0, 0) + struct.pack('<Q', len(body)) + body for body in bodies]
    file.write_bytes(records.MAGIC + b''.join(struct.pack('<BQ', records.CHUNK, len(one)) + one for one in packed))
    reading, found = Reading(file, skip=skip), []
    for record in reading:
        assert isinstance(record, Messages)
        found.append(Messages(record.channel, list(record.times), list(record.data)))
        if record.channel == 3 and len(found) > 6:
            skip.add(3)
    return found, reading.damage


CASES = {
    'steps that are all alike': [chunk(STEP * 3, t) for t in (0, 9, 18, 27, 36)],
    'another order': [chunk(STEP, 0), chunk(STEP, 3), chunk(STEP[::-1], 6), chunk(STEP, 9)],
    'other sizes in as many bytes': [chunk(STEP, 0), chunk([(1, 64), (2, 40), (3, 8)], 3), chunk(STEP, 6)],
    'another channel': [chunk(STEP, 0), chunk([(1, 40), (4, 64), (3, 8)], 3), chunk(STEP, 6)],
    'one channel twice in a step': [chunk([(1, 8), (2, 8), (2, 8)] * 2, t) for t in (0, 6, 12)],
    'a step that is cut': [chunk(STEP * 2 + STEP[:1], t) for t in (0, 7, 14)],
    'a record of another kind': [chunk(STEP, 0), chunk(STEP, 3), chunk(STEP, 6, opcode=9), chunk(STEP, 9)],
    'a message shorter than its head': [chunk(STEP, 0), chunk(STEP, 3)[:-9] + b'x' * 9, chunk([(1, 120), (2, -1)], 6)],
    'a date beyond 63 bits': [chunk(STEP, 0), chunk(STEP, 3), chunk(STEP, 6, log_time=1 << 63)],
    'nothing but a message without data': [chunk([(1, 0)], t) for t in range(4)],
    'an empty chunk': [b'', b'', chunk(STEP, 0)],
}  # fmt: skip


@pytest.mark.parametrize('skip', [set(), {2}])
@pytest.mark.parametrize('name', CASES)
def test_chunks_give_what_their_records_give_one_by_one(
    name: str, skip: set[int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = read(tmp_path / 'a.mcap', CASES[name], set(skip))
    monkeypatch.setattr(layouts, 'LAYOUTS_MOST', 0)
    assert found == read(tmp_path / 'b.mcap', CASES[name], set(skip))


@pytest.fixture
def walked(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The sizes of the chunks that are taken apart record by record."""
    sizes: list[int] = []
    walk = Reading._one_by_one

    def counted(self: Reading, body: bytes, most: int) -> object:
        sizes.append(len(body))
        return walk(self, body, most)

    monkeypatch.setattr(Reading, '_one_by_one', counted)
    return sizes


def test_chunks_that_are_like_the_first_are_not_walked(tmp_path: Path, walked: list[int]) -> None:
    found, _ = read(tmp_path / 'a.mcap', CASES['steps that are all alike'], {2})
    assert len(walked) == 2  # the first, and one when channel 3 is no longer wanted
    assert [one.log_times for one in found[:2]] == [[0, 3, 6], [2, 5, 8]]
    assert [one.channel for one in found] == [1, 3] * 4 + [1]


def test_of_our_recordings_of_small_messages_the_first_chunk_is_walked_and_the_last(
    tmp_path: Path, walked: list[int]
) -> None:
    """As many of them as there are in a chunk."""
    t = np.arange(50_000) * 1_000_000
    run = reader.read(write_scalars(tmp_path / 'bag', {'s': (t, {'v': np.sin(t * 1e-9)})}))
    np.testing.assert_array_equal(run['s/v'], np.sin(t * 1e-9))
    assert len(walked) <= 3  # the first holds the channels as well
    assert sum(walked) < 0.6 * 50_000 * 100  # there are more
