"""Reading bags, ours and others: every topic at its own instants, only what is asked for, and no topic spoils the
rest."""

from __future__ import annotations

import platform
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer
from scalars import write_mcap, write_scalars

from mbd_sim_ros.bags import columns
from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.bags.writer import CHUNK_BYTES
from mbd_sim_ros.messages import cdr
from mbd_sim_ros.messages.topics import JOINT_STATE
from solver.errors import BagError

MS = 1_000_000
CLOUD = 'float64 x\nuint8[] data\n'
NAMELESS = 'string text\n'


def two_rates(directory: Path, **options) -> Path:
    fast, slow = np.arange(101) * 10 * MS, np.arange(11) * 100 * MS + 3 * MS
    return write_scalars(
        directory,
        {'fast': (fast, {'a': fast * 1e-9, 'b': -fast * 1e-9}), 'slow': (slow, {'c': slow * 2e-9})},
        **options,
    )


def scalar(t: int, value: float, stamp: int | None = None) -> tuple[int, bytes]:
    stamp = t if stamp is None else stamp
    header = {'stamp': {'sec': stamp // 10**9, 'nanosec': stamp % 10**9}, 'frame_id': ''}
    return t, cdr.encode(
        JOINT_STATE, cdr.schema_text(JOINT_STATE), {'header': header, 'name': ['v'], 'position': [value]}
    )[0]


def scalars(topic: str, *messages: tuple[int, bytes]) -> tuple[str, str, str, list[tuple[int, bytes]]]:
    return topic, JOINT_STATE, cdr.schema_text(JOINT_STATE), list(messages)


def test_every_topic_keeps_its_own_instants(tmp_path: Path) -> None:
    run = bag.read(two_rates(tmp_path / 'bag'))
    assert run.series['fast'].time_ns.size == 101
    np.testing.assert_array_equal(run.series['slow'].time_ns, np.arange(11) * 100 * MS + 3 * MS)
    assert not np.any(np.isnan(run.series['slow'].columns['slow/c']))
    assert run.time_ns.size == 112  # the common grid of both
    assert np.count_nonzero(np.isnan(run['slow/c'])) == 101
    np.testing.assert_array_equal(run['slow/c'][~np.isnan(run['slow/c'])], run.series['slow'].time_ns * 2e-9)


def test_only_what_is_asked_for_is_kept_and_the_rest_is_known(tmp_path: Path) -> None:
    run = bag.read(two_rates(tmp_path / 'bag'), ['fast/b'])
    assert list(run.columns) == ['fast/b']
    assert run.names == ('fast/a', 'fast/b', 'slow/c')
    np.testing.assert_array_equal(run['fast/b'], -np.arange(101) * 10 * MS * 1e-9)
    assert bag.read(tmp_path / 'bag', ['none']).columns == {}


@pytest.mark.slow
def test_reading_takes_the_memory_of_the_columns_that_are_asked_for(tmp_path: Path) -> None:
    n, width = 4000, 400
    t = np.arange(n) * MS
    wide = {f'w{k}': np.full(n, float(k)) for k in range(width)}
    directory = write_scalars(tmp_path / 'bag', {'wide': (t, wide), 'narrow': (t, {'x': t * 1e-9})})

    def peak(*channels: str) -> int:
        tracemalloc.start()
        bag.read(directory, channels)
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    numbers = 8 * n * width
    assert peak() < numbers + 6 * columns.BLOCK_BYTES  # messages of a block, their bytes in one piece, their numbers
    assert peak('narrow/*') < 0.3 * numbers


@pytest.mark.skipif(platform.libc_ver()[0] != 'glibc', reason='what the C library keeps')
def test_reading_asks_the_system_for_memory_once(tmp_path: Path) -> None:
    """Not for every chunk anew: in a process of its own, for what was freed once is kept."""
    t = np.arange(3000) * MS
    wide = {f'w{k}': np.sin(k + t * 1e-9) for k in range(400)}
    directory = write_scalars(tmp_path / 'bag', {'wide': (t, wide)})
    code = """
import resource, sys
from mbd_sim_ros.bags import reader
import zstandard
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
reader.read(sys.argv[1])
print((resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before) * resource.getpagesize())
"""
    said = subprocess.run(
        [sys.executable, '-c', code, str(directory)], check=True, capture_output=True, text=True
    ).stdout
    assert int(said) < 8 * t.size * len(wide) + 8 * CHUNK_BYTES, f'{int(said) / 1e6:.1f} MB were mapped'


def test_strings_that_change_are_no_obstacle(tmp_path: Path) -> None:
    """The frame changes from message to message: each is decoded for itself, to the same numbers."""
    plain = bag.read(two_rates(tmp_path / 'plain'))
    other = bag.read(two_rates(tmp_path / 'other', frame=lambda k: 'x' * (k % 7)))
    for name, values in plain.columns.items():
        np.testing.assert_array_equal(other[name], values)


def test_a_topic_that_is_no_set_of_channels_is_left_out_with_its_reason(tmp_path: Path) -> None:
    cloud = [(k, cdr.encode('x/msg/Cloud', CLOUD, {'x': 1.0, 'data': np.zeros(k + 1)})[0]) for k in range(3)]
    huge = [(0, cdr.encode('x/msg/Cloud', CLOUD, {'x': 1.0, 'data': np.zeros(columns.COLUMNS_MAX)})[0])]
    broken = [(0, b'\x00\x01\x00\x00\x01')]
    text = [
        (0, cdr.encode('x/msg/Text', NAMELESS, {'text': 'hello'})[0]),
        (1, cdr.encode('x/msg/Text', NAMELESS, {'text': 'you'})[0]),
    ]
    channels = [
        scalars('/good', scalar(5, 1.0), scalar(6, 2.0)),
        ('/cloud', 'x/msg/Cloud', CLOUD, cloud),
        ('/huge', 'x/msg/Cloud', CLOUD, huge),
        ('/broken', 'x/msg/Cloud', CLOUD, broken),
        ('/text', 'x/msg/Text', NAMELESS, text),
    ]
    run = bag.read(write_mcap(tmp_path / 'a.mcap', channels))
    assert run['good/v'].tolist() == [1.0, 2.0]
    assert set(run.columns) == {'good/v'}
    assert 'change their names or sizes' in run.left_out['cloud']
    assert 'more than 4096' in run.left_out['huge']
    assert 'shorter than its schema' in run.left_out['broken']
    with pytest.raises(BagError, match=r'holds nothing that can be read: topic cloud: its messages change'):
        bag.read(write_mcap(tmp_path / 'b.mcap', channels[1:2]))


def test_stamps_that_are_not_set_give_way_to_the_times_of_recording(tmp_path: Path) -> None:
    unset = bag.read(
        write_mcap(tmp_path / 'a.mcap', [scalars('/s', *(scalar(k, float(k), stamp=0) for k in (10, 20, 30)))])
    )
    assert unset.time_ns.tolist() == [10, 20, 30]
    given = bag.read(
        write_mcap(tmp_path / 'b.mcap', [scalars('/s', *(scalar(k, float(k), stamp=k + 7) for k in (10, 20, 30)))])
    )
    assert given.time_ns.tolist() == [17, 27, 37]


@pytest.mark.parametrize('log', [1_700_000_000, None])  # of the time of day, or of the clock that is simulated
def test_runs_behind_each_other_are_not_mixed_where_the_clock_begins_anew(log: int | None, tmp_path: Path) -> None:
    seconds = [*range(20), *range(15)]
    stamps = [k * 1000 * MS + 500 * MS * (i >= 20) for i, k in enumerate(seconds)]
    logs = stamps if log is None else [log * 1000 * MS + i * 1000 * MS for i in range(len(seconds))]
    again = scalars('/again', *(scalar(t, float(i), stamp) for i, (t, stamp) in enumerate(zip(logs, stamps))))
    steady = scalars('/steady', *(scalar(k * MS, float(k)) for k in range(3)))
    run = bag.read(write_mcap(tmp_path / 'a.mcap', [again, steady]))
    assert set(run.columns) == {'steady/v'}
    more = '' if log is None else ', or take the log times (--log-times)'
    assert run.left_out == {
        'again': 'its times go back by 18.5 s, as of a clock that was set back or began anew; cut the recording '
        f'there{more}'
    }


def test_messages_that_overtook_each_other_are_put_in_order(tmp_path: Path) -> None:
    stamps = [k * 100 * MS for k in range(1, 100)]
    stamps[49] = stamps[40] + 50 * MS  # of message 50, which came 0.85 s late
    run = bag.read(
        write_mcap(
            tmp_path / 'a.mcap', [scalars('/s', *(scalar(k * 100 * MS, float(k), s) for k, s in enumerate(stamps, 1)))]
        )
    )
    assert not run.left_out and np.all(np.diff(run.time_ns) > 0)
    assert run['s/v'].tolist() == [*range(1, 42), 50, *range(42, 50), *range(51, 100)]


def test_stamps_with_the_time_of_day_keep_their_nanoseconds(tmp_path: Path) -> None:
    t = 1_700_000_000_123_456_789 + np.arange(5) * 10 * MS
    run = bag.read(write_scalars(tmp_path / 'bag', {'s': (t, {'v': np.arange(5.0)})}))
    np.testing.assert_array_equal(run.time_ns, t)


def test_several_publishers_of_one_topic_are_one_series_in_order(tmp_path: Path) -> None:
    file = tmp_path / 'a.mcap'
    text = cdr.schema_text(JOINT_STATE)
    with file.open('wb') as stream:
        writer = Writer(stream)
        writer.start(profile='ros2', library='test')
        schema = writer.register_schema(JOINT_STATE, 'ros2msg', text.encode())
        for times in ((30, 10), (20, 40)):
            channel = writer.register_channel('/s', 'cdr', schema)
            for t in times:
                writer.add_message(channel, *scalar(t, float(t)), t)
        writer.finish()
    run = bag.read(file)
    assert run.time_ns.tolist() == [10, 20, 30, 40]
    assert run['s/v'].tolist() == [10.0, 20.0, 30.0, 40.0]


@pytest.mark.parametrize(
    'options', [{'use_chunking': False}, {'use_statistics': False}, {'use_summary_offsets': False, 'chunk_size': 300}]
)
def test_files_without_chunks_or_summary_are_read_alike(options: dict, tmp_path: Path) -> None:
    messages = [scalar(k, float(k)) for k in range(100)]
    run = bag.read(write_mcap(tmp_path / 'a.mcap', [scalars('/s', *messages)], **options))
    np.testing.assert_array_equal(run['s/v'], np.arange(100.0))


def test_no_damaged_byte_is_read_for_a_number(tmp_path: Path) -> None:
    """One to three bytes changed anywhere, or the end cut off: the same numbers under the same names, or one
    sentence."""
    rng = np.random.default_rng(0)
    good = bag.read(two_rates(tmp_path / 'bag'))
    raw = (tmp_path / 'bag' / 'bag_0.mcap').read_bytes()
    file, refused = tmp_path / 'x.mcap', 0
    for k in range(600):
        data = bytearray(raw if k % 3 else raw[: rng.integers(1, len(raw))])
        for at in rng.integers(len(data), size=rng.integers(1, 4)):
            data[at] ^= rng.integers(1, 256)
        file.write_bytes(data)
        try:
            run = bag.read(file)
        except BagError as error:
            assert '\n' not in str(error)
            refused += 1
            continue
        for name, values in run.columns.items():
            np.testing.assert_array_equal(values, good[name], err_msg=f'{k}: {name}')
    assert refused > 300
