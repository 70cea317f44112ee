"""Which topics share a chunk, and what that means for those who read one topic, read in order, or read what a dead
process left."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import ChunkIndex
from mcap.summary import Summary
from synthetic import channels, snapshot

from mbd_sim_ros.bags import records
from mbd_sim_ros.bags.inputs import content
from mbd_sim_ros.bags.poses import read_poses
from mbd_sim_ros.bags.reader import read
from mbd_sim_ros.bags.recovery import recover
from mbd_sim_ros.bags.writer import RECORD, BagWriter
from mbd_sim_ros.messages.encode import Messages

STEPS, FLUSHED = 500, 50  # steps of a recording, and of those between two flushes
LIGHT = {
    '/odom',
    '/imu',
    '/cmd_applied',
    *(f'/tire/{wheel}/force' for wheel in ('front_left', 'front_right', 'rear_left', 'rear_right')),
}
WIDE = {'/joint_states', '/tire_states', '/tf'}
HEAVY = {'/element_states'}


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A car with its elements, flushed every FLUSHED steps of 2 ms."""
    messages = Messages(channels(), element_states=True)
    writer = BagWriter(tmp_path_factory.mktemp('bags') / 'run', messages.topics, {RECORD: {'scene': 's'}})
    for k in range(STEPS):
        shot = snapshot(channels(), k)
        writer.write(shot.t_ns, list(enumerate(messages.encode(shot))))
        if k % FLUSHED == FLUSHED - 1:
            writer.flush()
    return next(writer.finish().glob('*.mcap'))


def summary_of(bag: Path) -> Summary:
    with bag.open('rb') as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    return summary


def topics_in(chunk: ChunkIndex, summary: Summary) -> set[str]:
    return {summary.channels[channel].topic for channel in chunk.message_index_offsets}


def test_a_flush_writes_a_chunk_for_each_weight_the_lightest_first_of_the_same_steps(bag: Path) -> None:
    summary = summary_of(bag)
    chunks = sorted(summary.chunk_indexes, key=lambda one: one.chunk_start_offset)
    assert [topics_in(one, summary) for one in chunks] == [LIGHT, WIDE, HEAVY] * (STEPS // FLUSHED)
    for k, one in enumerate(chunks):
        begin = k // 3 * FLUSHED
        assert (one.message_start_time, one.message_end_time) == (begin * 2_000_000, (begin + FLUSHED - 1) * 2_000_000)


@pytest.mark.parametrize(
    ('asked', 'held'),
    [
        (['odom/*'], LIGHT),
        (['joint_states/*'], WIDE),
        (['element_states/*'], HEAVY),
        (['odom/*', 'tire_states/*'], LIGHT | WIDE),
    ],
)
def test_only_chunks_that_hold_what_is_asked_for_are_unpacked(
    asked: list[str], held: set[str], bag: Path, monkeypatch
) -> None:
    whole, unpacked = read(bag), counted(monkeypatch)
    some = read(bag, asked)
    assert some.columns and all((some[name] == whole[name]).all() for name in some.columns)
    summary = summary_of(bag)
    wanted = [one for one in summary.chunk_indexes if topics_in(one, summary) & held]
    others = 3 - len(wanted) * FLUSHED // STEPS
    assert len(unpacked) == len(wanted) + others  # of each other weight the first, which tells what the columns are


def test_poses_are_read_from_the_chunks_that_hold_them(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    unpacked = counted(monkeypatch)
    assert read_poses(bag).time_ns.size == STEPS
    assert len(unpacked) == STEPS // FLUSHED + 1  # and the first, where the channels are declared


def counted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The sizes of the chunks that are unpacked from here on."""
    sizes: list[int] = []
    inflate = records._inflate

    def noted(compression: str, data: bytes, size: int) -> bytes:
        sizes.append(size)
        return inflate(compression, data, size)

    monkeypatch.setattr(records, '_inflate', noted)
    return sizes


def test_readers_find_all_in_the_order_of_time_and_every_topic_in_the_order_of_the_file(bag: Path) -> None:
    with bag.open('rb') as stream:
        in_time = [
            (m.log_time, c.topic, m.sequence) for _, c, m in make_reader(stream, validate_crcs=True).iter_messages()
        ]
        stream.seek(0)
        as_written = [
            (m.log_time, c.topic, m.sequence) for _, c, m in make_reader(stream).iter_messages(log_time_order=False)
        ]
    assert [t for t, *_ in in_time] == sorted(t for t, *_ in as_written)
    assert sorted(in_time) == sorted(as_written) and len(in_time) == STEPS * len(LIGHT | WIDE | HEAVY)
    for topic in LIGHT | WIDE | HEAVY:
        assert [(t, n) for t, name, n in as_written if name == topic] == [(2_000_000 * k, k) for k in range(STEPS)]
    latest = 0
    for t, *_ in as_written:
        # whoever reads the file from front to back is never further behind than a flush
        assert latest - t < FLUSHED * 2_000_000
        latest = max(latest, t)


def test_wherever_a_file_is_cut_off_every_topic_goes_to_the_last_flush_at_least(bag: Path, tmp_path: Path) -> None:
    chunks = sorted(summary_of(bag).chunk_indexes, key=lambda one: one.chunk_start_offset)
    data = bag.read_bytes()
    for k in range(3, 9):
        end = chunks[k].chunk_start_offset + chunks[k].chunk_length
        for name, cut in (('in', end - 1), ('behind', end)):
            (tmp_path / f'{name}{k}.mcap').write_bytes(data[:cut])
            saved = content(recover(tmp_path / f'{name}{k}.mcap', tmp_path / f'{name}{k}').directory)
            complete = k + (name == 'behind')
            for weight, topics in enumerate((LIGHT, WIDE, HEAVY)):
                steps = FLUSHED * ((complete + 2 - weight) // 3)
                assert steps >= FLUSHED * (complete // 3)
                assert all(
                    list(saved.topics[topic.strip('/')]) == [2_000_000 * i for i in range(steps)] for topic in topics
                )
