"""Recordings: what goes in comes out, other readers agree, and a broken or impossible recording ends in one
sentence."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from synthetic import WHEELS, channels, snapshot

from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.bags.recorder import QUEUE_STEPS, Recorder, describe, new_directory
from mbd_sim_ros.bags.recovery import recover
from mbd_sim_ros.bags.writer import PART, RECORD, BagWriter
from mbd_sim_ros.messages.composition import TIRE_STATES
from mbd_sim_ros.messages.encode import Messages
from mbd_sim_ros.messages.topics import STRING, Topic
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.errors import BagError

STEPS = 400
ROOT = Path(__file__).parents[2]


def record(directory: Path, steps: int = STEPS, **more: str) -> list:
    """Record the synthetic snapshots 0 ... steps and return them."""
    names = channels()
    messages = Messages(names, element_states=True)
    shots = [snapshot(names, k) for k in range(steps + 1)]
    with Recorder(
        directory, messages.topics, describe(scene='synthetic', resolved_yaml='a: 1\n', parameters={'x': 2}, **more)
    ) as recorder:
        for shot in shots:
            recorder.write(shot.t_ns, messages.encode(shot))
    return shots


@pytest.fixture(scope='module')
def recorded(tmp_path_factory):
    directory = tmp_path_factory.mktemp('bags') / 'run'
    return directory, record(directory, robot_description='<robot name="x"/>')


def test_every_number_comes_back_bit_for_bit(recorded):
    directory, shots = recorded
    run = bag.read(directory)
    np.testing.assert_array_equal(run.time_ns, [shot.t_ns for shot in shots])
    expected = {
        'joint_states/joint_3/velocity': [s.joint_velocity[3] for s in shots],
        'joint_states/joint_4/effort': [s.joint_effort[4] for s in shots],
        'odom/pose/y': [s.pose[1, 1] for s in shots],
        'odom/pose/qw': [s.pose[1, 6] for s in shots],
        'odom/twist/wz': [s.twist[1, 5] for s in shots],
        'imu/ax': [s.imu[0] for s in shots],
        'imu/wy': [s.imu[4] for s in shots],
        'tire/rear_left/force/fy': [s.tire[2, 1] for s in shots],
        'tire/front_right/force/mz': [s.tire[1, 5] for s in shots],
        'cmd_applied/steering_rate': [s.inputs[1] for s in shots],
        'cmd_applied/step': [float(s.k) for s in shots],
        'element_states/damper/force': [s.elements[2] for s in shots],
    }
    for i, wheel in enumerate(WHEELS):
        expected |= {f'tire_states/{wheel}/{n}': [s.tire[i, TIRE_COLUMNS.index(n)] for s in shots] for n in TIRE_STATES}
    for name, values in expected.items():
        assert run[name].dtype == np.float64
        np.testing.assert_array_equal(run[name], values, err_msg=name)


@pytest.mark.parametrize('left_out', [None, 5])
def test_elements_of_all_kinds_are_one_series_as_in_recordings_that_have_them_in_one_topic(left_out, tmp_path):
    """left_out: an instant at which the topic of one kind has no message."""
    names = channels()
    shots = [snapshot(names, k) for k in range(8)]
    for place, kinds in (('one', {}), ('kinds', {'spring': 'springs', 'damper': 'dampers'})):
        messages = Messages(names, element_states=True, kinds=kinds)
        writer = BagWriter(tmp_path / place, messages.topics, {})
        seldom = messages.topics.index(next(t for t in messages.topics if t.name.startswith('element_states')))
        for shot in shots:
            encoded = list(enumerate(messages.encode(shot)))
            if kinds and shot.k == left_out:
                del encoded[seldom]
            writer.write(shot.t_ns, encoded)
        writer.finish()
    one, kinds = (bag.read(tmp_path / place, ['element_states/*']) for place in ('one', 'kinds'))
    assert list(kinds.series) == ['element_states'] and kinds.names == one.names
    assert list(kinds.columns) == list(one.columns) == [f'element_states/{name}' for name in names.elements]
    np.testing.assert_array_equal(kinds.time_ns, one.time_ns)
    for i, (name, values) in enumerate(one.columns.items()):
        expected = [np.nan if s.k == left_out and i < 2 else s.elements[i] for s in shots]
        np.testing.assert_array_equal(kinds[name], expected)
        np.testing.assert_array_equal(values, [s.elements[i] for s in shots])


def test_a_recording_describes_itself(recorded):
    about = bag.read(recorded[0]).metadata
    assert about['resolved_scene'] == 'a: 1\n'
    assert yaml.safe_load(about['parameters']) == {'x': 2}
    assert 'numpy' in yaml.safe_load(about['packages'])
    assert about['robot_description'] == '<robot name="x"/>'
    assert about['dropped_steps'] == '0'
    assert {'scene_hash', 'code_version', 'source_hash', 'seed', 'created'} <= about.keys()


def test_an_unknown_column_is_refused_with_the_nearest_name(recorded):
    with pytest.raises(BagError, match=r"did you mean 'odom/twist/wz'"):
        bag.read(recorded[0])['odom/twst/wz']


def test_the_mcap_reader_agrees(recorded):
    from mcap.reader import make_reader

    directory, shots = recorded
    with open(directory / 'run_0.mcap', 'rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == 'ros2'
        summary = reader.get_summary()
        assert summary.statistics.message_count == len(shots) * 11 + 1  # and the robot description
        assert summary.statistics.message_end_time == shots[-1].t_ns
        schemas = {
            summary.schemas[c.schema_id].name: summary.schemas[c.schema_id].encoding for c in summary.channels.values()
        }
        assert schemas['nav_msgs/msg/Odometry'] == 'ros2msg'
        for channel in summary.channels.values():
            assert channel.message_encoding == 'cdr'
            assert channel.metadata['topic_type_hash'].startswith('RIHS01_')
            assert yaml.safe_load(channel.metadata['offered_qos_profiles'])[0]['reliability'] == 'reliable'
        for _, channel, message in reader.iter_messages(topics=['/odom']):
            assert message.log_time == message.publish_time
            assert channel.topic == '/odom'


def test_rosbags_opens_the_directory_and_reads_the_same(recorded):
    from rosbags import rosbag2
    from rosbags.typesys import Stores, get_typestore

    directory, shots = recorded
    store = get_typestore(Stores.ROS2_JAZZY)
    with rosbag2.Reader(directory) as reader:
        assert reader.message_count == len(shots) * 11 + 1
        assert reader.start_time == 0
        assert {c.msgtype for c in reader.connections} >= {'tf2_msgs/msg/TFMessage', 'sensor_msgs/msg/Imu'}
        for connection in reader.connections:
            hashed = store.hash_rihs01(connection.msgtype)
            assert connection.digest == hashed
        wanted = [c for c in reader.connections if c.topic in ('/odom', '/tf')]
        seen = {'/odom': 0, '/tf': 0}
        for connection, t_ns, data in reader.messages(connections=wanted):
            message = store.deserialize_cdr(data, connection.msgtype)
            shot = shots[t_ns // 2_000_000]
            pose = (
                message.pose.pose.position
                if connection.topic == '/odom'
                else message.transforms[0].transform.translation
            )
            np.testing.assert_array_equal((pose.x, pose.y, pose.z), shot.pose[1, :3])
            seen[connection.topic] += 1
        assert seen == {'/odom': len(shots), '/tf': len(shots)}


@pytest.mark.parametrize('fraction', [0.3, 0.75, 0.98])
def test_a_truncated_recording_gives_back_every_complete_chunk(recorded, tmp_path, fraction):
    from mcap.reader import make_reader

    directory, shots = recorded
    data = (directory / 'run_0.mcap').read_bytes()
    with open(directory / 'run_0.mcap', 'rb') as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    assert len(chunks) >= 8
    size = round(fraction * chunks[-1].chunk_start_offset)
    complete = [c for c in chunks if c.chunk_start_offset + c.chunk_length <= size]
    cut = tmp_path / 'cut.mcap'
    cut.write_bytes(data[:size])
    with pytest.raises(BagError, match=r'cut off.*mbd recover'):
        bag.read(cut)
    saved = recover(cut, tmp_path / 'saved')
    assert not saved.complete
    assert saved.end_ns == complete[-1].message_end_time
    run = bag.read(tmp_path / 'saved')
    assert run.time_ns[-1] == complete[-1].message_end_time
    assert run.metadata['resolved_scene'] == 'a: 1\n'
    n = run.time_ns.size - 1  # the last step may be split between chunks
    np.testing.assert_array_equal(run['odom/pose/x'][:n], [s.pose[1, 0] for s in shots[:n]])


def test_all_but_the_chunk_that_is_damaged_is_recovered_and_what_is_lost_is_said(recorded, tmp_path):
    from mcap.reader import make_reader

    with open(recorded[0] / 'run_0.mcap', 'rb') as stream:
        summary = make_reader(stream).get_summary()
    (applied,) = [channel for channel, about in summary.channels.items() if about.topic == '/cmd_applied']
    bad = [one for one in summary.chunk_indexes if applied in one.message_index_offsets][2]
    data = bytearray((recorded[0] / 'run_0.mcap').read_bytes())
    middle = bad.chunk_start_offset + bad.chunk_length // 2
    data[middle : middle + 8] = bytes(8 * [0x5A])
    (tmp_path / 'bad.mcap').write_bytes(data)
    saved = recover(tmp_path / 'bad.mcap', tmp_path / 'saved')
    assert saved.end_ns == summary.chunk_indexes[-1].message_end_time
    assert not saved.complete and 'the chunk at byte' in saved.damage[1]
    whole = recover(recorded[0], tmp_path / 'whole')
    assert whole.complete and saved.lost > 0 and saved.messages + saved.lost == whole.messages
    assert bag.read(saved.directory).metadata['lost_messages'] == str(saved.lost)
    steps = bag.read(saved.directory)['cmd_applied/step']
    inside = [c / 2_000_000 for c in (bad.message_start_time, bad.message_end_time)]
    assert not np.any((steps > inside[0]) & (steps < inside[1])) and steps[-1] > inside[1]


def test_what_is_no_recording_is_refused_in_one_sentence(tmp_path):
    (tmp_path / 'empty.mcap').touch()
    (tmp_path / 'text.mcap').write_text('hello, this is text and no recording')
    (tmp_path / 'nothing').mkdir()
    (tmp_path / 'old').mkdir()
    (tmp_path / 'old' / 'x.db3').touch()
    for name, match in [
        ('absent', 'is not there'),
        ('empty.mcap', 'is empty'),
        ('text.mcap', 'not an MCAP file'),
        ('nothing', 'holds no .mcap file'),
        ('old', r'x\.db3 is empty'),
    ]:
        with pytest.raises(BagError, match=match) as caught:
            bag.read(tmp_path / name)
        assert '\n' not in str(caught.value)
        with pytest.raises(BagError):
            recover(tmp_path / name, tmp_path / 'saved')


@pytest.mark.slow
def test_recordings_are_never_overwritten(tmp_path):
    record(tmp_path / 'run', steps=3)
    before = (tmp_path / 'run' / 'run_0.mcap').read_bytes()
    with pytest.raises(BagError, match='never overwritten; choose another place'):
        record(tmp_path / 'run', steps=3)
    assert (tmp_path / 'run' / 'run_0.mcap').read_bytes() == before
    assert len({new_directory('x', tmp_path / 'bags') for _ in range(3)}) == 3


@pytest.mark.slow
def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / 'file').touch()
    with pytest.raises(BagError, match='cannot record'):
        record(tmp_path / 'file' / 'run', steps=1)
    with pytest.raises(BagError, match='Not a directory'):
        new_directory('x', tmp_path / 'file')
    with pytest.raises(BagError, match='cannot record into /proc/none'):
        record(Path('/proc/none/run'), steps=1)


def test_a_full_disk_is_one_sentence_and_the_rest_can_be_recovered(tmp_path):
    """The file is limited to half of what the run needs: the kernel refuses the rest as it does on a full disk."""
    import resource

    names = channels()
    messages = Messages(names)
    limit = 600_000
    old = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # then write() fails with EFBIG
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, old[1]))
        recorder = Recorder(tmp_path / 'run', messages.topics, describe(scene='s', resolved_yaml=''))
        with pytest.raises(BagError, match=r'recording to .* failed: File too large') as caught:
            for k in range(100_000):
                recorder.write(k * 2_000_000, messages.encode(snapshot(names, k)))
        with pytest.raises(BagError) as closed:
            recorder.close()
        assert closed.value is caught.value
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)
        signal.signal(signal.SIGXFSZ, ignored)
    assert list((tmp_path / 'run').iterdir()) == [tmp_path / 'run' / f'run_0.mcap{PART}']
    with pytest.raises(BagError, match='was not finished'):
        bag.read(tmp_path / 'run')
    saved = recover(tmp_path / 'run', tmp_path / 'saved')
    assert saved.messages > 100


@pytest.mark.skipif(
    not os.path.exists('/dev/full'), reason='/dev/full, a device that is always full, exists on Linux alone'
)
def test_a_disk_that_is_full_from_the_start_is_one_sentence(tmp_path, monkeypatch):
    import builtins

    original = builtins.open
    monkeypatch.setattr(
        builtins,
        'open',
        lambda name, mode='r', *a, **k: (
            original('/dev/full', 'wb') if str(name).endswith(PART) else original(name, mode, *a, **k)
        ),
    )
    writer = BagWriter(tmp_path / 'run', Messages(channels()).topics, {RECORD: describe(scene='s', resolved_yaml='')})
    encoded = Messages(channels()).encode(snapshot(channels(), 0))
    writer.write(0, enumerate(encoded))
    with pytest.raises(BagError, match='No space left on device'):
        writer.finish()


@pytest.mark.realtime
def test_a_slow_disk_never_blocks_a_real_time_run(tmp_path):
    """With the recording process at a standstill the queue fills to its bound; from then on steps are dropped and
    counted."""
    names = channels(vehicle=False)
    messages = Messages(names)
    recorder = Recorder(tmp_path / 'run', messages.topics, describe(scene='s', resolved_yaml=''), wait=False)
    os.kill(recorder.pid, signal.SIGSTOP)
    longest, steps = 0.0, 0
    while recorder.dropped < 100:
        one = messages.encode(snapshot(names, steps))
        start = time.perf_counter()
        recorder.write(steps, one)
        longest = max(longest, time.perf_counter() - start)
        steps += 1
        assert steps < 100 * QUEUE_STEPS  # no queue without a bound
    assert recorder.lag == QUEUE_STEPS
    assert longest < 1.0  # a waiting queue would hold for ever
    os.kill(recorder.pid, signal.SIGCONT)
    recorder.close()
    run = bag.read(tmp_path / 'run')
    assert run.metadata['dropped_steps'] == '100'
    assert run.time.size == steps - 100


KILLED = """
import sys, time
from synthetic import Synthetic
from mbd_sim_ros.messages.encode import Messages
from mbd_sim_ros.bags.recorder import Recorder, describe
simulation = Synthetic()
messages = Messages(simulation.channels)
recorder = Recorder(sys.argv[1], messages.topics, describe(scene='killed', resolved_yaml='b: 2'))
print(recorder.pid, flush=True)
while True:
    shot = simulation.advance()
    recorder.write(shot.t_ns, messages.encode(shot))
    print(shot.k, flush=True)
    time.sleep(0.002)
"""


def killed(directory: Path, *, also_the_recording: bool) -> int:
    """Kill a process that records (and the recording process with it) after 1.5 s; return its last step."""
    environment = {**os.environ, 'PYTHONPATH': f'{ROOT}:{ROOT}/test/support'}
    command = [sys.executable, '-c', KILLED, str(directory)]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, env=environment, cwd=ROOT, start_new_session=True
    )
    pid = int(process.stdout.readline())
    begin, last = None, 0
    for line in process.stdout:
        begin = begin or time.monotonic()
        last = int(line)
        if time.monotonic() - begin > 1.5:
            break
    if also_the_recording:
        os.kill(pid, signal.SIGKILL)
    process.kill()
    process.wait(10)
    assert process.returncode == -signal.SIGKILL
    return last


@pytest.mark.realtime
def test_a_killed_run_loses_nothing_but_the_last_delivery(tmp_path):
    """The recording process outlives the simulation and finishes the bag."""
    last = killed(tmp_path / 'run', also_the_recording=False)
    limit = time.monotonic() + 20.0
    while not (tmp_path / 'run' / 'metadata.yaml').exists():
        assert time.monotonic() < limit
        time.sleep(0.01)
    run = bag.read(tmp_path / 'run')
    assert run.metadata['end'] == 'the simulating process died'
    assert run['cmd_applied/step'][-1] >= 0.8 * last  # a delivery is 10 steps; the rest is a busy machine's hiccup
    np.testing.assert_array_equal(np.diff(run['cmd_applied/step']), 1.0)


@pytest.mark.realtime
def test_a_killed_recording_loses_at_most_the_last_flush(tmp_path):
    last = killed(tmp_path / 'run', also_the_recording=True)
    with pytest.raises(BagError, match='the recording process died; `mbd recover'):
        bag.read(tmp_path / 'run')
    saved = recover(tmp_path / 'run', tmp_path / 'saved')
    assert saved.end_ns >= 0.5 * last * 2_000_000  # of 1.5 s at most 0.25 s and a busy machine's hiccup are gone
    run = bag.read(tmp_path / 'saved')
    assert run.metadata['scene'] == 'killed'
    np.testing.assert_array_equal(np.diff(run['cmd_applied/step'][:-1]), 1.0)


def test_the_death_of_the_recording_process_is_one_sentence(tmp_path):
    names = channels()
    messages = Messages(names)
    one = messages.encode(snapshot(names))
    recorder = Recorder(tmp_path / 'run', messages.topics, describe(scene='s', resolved_yaml=''))
    os.kill(recorder.pid, signal.SIGKILL)
    with pytest.raises(BagError, match='the recording process died; `mbd recover'):
        for k in range(100_000):
            recorder.write(k, one)
    with pytest.raises(BagError, match='the recording process died'):
        recorder.close()


def test_topics_at_different_rates_share_one_grid(tmp_path):
    names = channels()
    messages = Messages(names)
    with Recorder(tmp_path / 'run', messages.topics, describe(scene='s', resolved_yaml='')) as recorder:
        for k in range(10):
            shot = snapshot(names, k)
            full = messages.encode(shot)
            named = zip(messages.topics, full)
            recorder.write(
                shot.t_ns, [data if k % 5 == 0 or topic.name == 'cmd_applied' else None for topic, data in named]
            )
    run = bag.read(tmp_path / 'run')
    np.testing.assert_array_equal(run['cmd_applied/step'], np.arange(10.0))
    assert np.flatnonzero(np.isfinite(run['odom/pose/x'])).tolist() == [0, 5]


def test_a_library_that_is_too_old_is_one_sentence_before_anything_is_written(monkeypatch, tmp_path):
    """It is imported, and has no flush(): the recording process ended in a traceback."""
    monkeypatch.delattr('mcap.writer.Writer.flush')
    with pytest.raises(BagError, match=r"mcap [\d.]+ writes no recordings.*pip install 'mcap>=1.5"):
        BagWriter(tmp_path / 'run', [Topic('a', STRING)], {})
    assert not (tmp_path / 'run').exists()
