"""SIGKILL at any moment: of the simulating process, of everything, of the recording process alone.

At most FLUSH_SECONDS of what was recorded are lost, and what is left is what was recorded, byte for byte.
"""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest
from faults import UNWANTED, Victim, finished, mbd, simulator, times, trials
from processes import DOMAIN, SCRIPT
from synthetic import channels, snapshot

from mbd_sim_ros.bags.inputs import Content, content
from mbd_sim_ros.bags.process import FLUSH_SECONDS
from mbd_sim_ros.bags.recovery import recover
from mbd_sim_ros.commands.main import main
from mbd_sim_ros.messages.encode import Messages
from solver.errors import BagError

pytestmark = pytest.mark.realtime

SCENE = ('light_car_lane_change', '--set', 'record.every=1')
LATE = 0.15  # s between the clock of the test and what a busy machine does


@pytest.fixture(scope='module')
def reference(tmp_path_factory: pytest.TempPathFactory) -> Content:
    directory = tmp_path_factory.mktemp('bags') / 'reference'
    assert main(['run', *SCENE, '--duration', '6', '--out', str(directory), '--json']) == 0
    return content(directory)


def children(pid: int) -> list[int]:
    return [
        int(child) for task in Path(f'/proc/{pid}/task').iterdir() for child in (task / 'children').read_text().split()
    ]


def gone(pid: int) -> None:
    """Wait until a process has ended."""
    end = time.monotonic() + 10.0
    while Path(f'/proc/{pid}').exists() and 'State:\tZ' not in Path(f'/proc/{pid}/status').read_text():
        assert time.monotonic() < end
        time.sleep(0.01)


def rescued(directory: Path, new: Path) -> Content:
    """What `mbd recover` saves of a recording."""
    assert main(['recover', str(directory), str(new), '--json']) == 0
    return content(new)


@pytest.mark.slow
@pytest.mark.parametrize('trial', trials(3, 1))
def test_a_killed_run_leaves_the_beginning_of_the_same_recording(
    trial: int, reference: Content, tmp_path: Path
) -> None:
    whom = ('process', 'group', 'recorder')[trial % 3]
    random = times('kills', trial)
    victim = Victim(tmp_path, mbd('run', *SCENE, '--duration', '100000', '--out', 'out'))
    try:
        begun = time.monotonic() + 120.0
        while not list(tmp_path.glob('out/*.part')):
            assert victim.process.poll() is None and time.monotonic() < begun, victim.said()
            time.sleep(0.005)
        (recorder,) = children(victim.pid)
        delay = 2.0 * random.random()
        time.sleep(delay)
        assert victim.process.poll() is None or whom == 'recorder'
        if whom == 'group':  # both: the recording process is in a session of its own
            os.kill(recorder, signal.SIGKILL)
        if whom == 'recorder':
            os.kill(recorder, signal.SIGKILL)
            ended = victim.end(time.monotonic())
            assert ended.code == BagError.exit_code, ended.err
            assert len(ended.lines) == 1 and 'mbd recover' in ended.lines[0]
        else:
            victim.strike(signal.SIGKILL, group=whom == 'group')
            ended = victim.end(time.monotonic())
            assert ended.code == -signal.SIGKILL
        assert not UNWANTED.search(ended.out + ended.err)
        gone(recorder)
    finally:
        victim.kill()
    if whom == 'process':
        run = finished(tmp_path / 'out')
        assert run is None or run.metadata['end'] == 'the simulating process died'
    files = list(tmp_path.glob('out/*.mcap*'))
    if files and not _chunks(files[0]):
        assert delay < FLUSH_SECONDS + LATE
        # killed before the first step was there
        assert main(['recover', str(tmp_path / 'out'), str(tmp_path / 'saved'), '--json']) == 5
        return
    saved = rescued(tmp_path / 'out', tmp_path / 'saved')
    for name, messages in saved.outputs.items():
        known = reference.outputs[name]
        common = messages.keys() & known.keys()
        assert all(messages[t] == known[t] for t in common), name
        assert common == {t for t in known if t <= max(messages)}, name  # nothing is missing before its end


def _chunks(path: Path) -> bool:
    try:
        recover(path, path.parent.parent / 'probe')
    except BagError:
        return False
    return True


@pytest.mark.slow
@pytest.mark.parametrize('trial', trials(3, 1))
def test_a_killed_node_loses_at_most_a_quarter_of_a_second(trial: int, tmp_path: Path) -> None:
    """In real time, where the time of the simulation tells how much is missing."""
    pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    whom = ('group', 'process', 'recorder')[trial % 3]
    random = times('nodes', trial)
    parameters = {'record': True, 'out': 'out', 'commands': 'maneuver'}
    victim = Victim(
        tmp_path, simulator(SCRIPT, '{}', '0', **parameters), ROS_DOMAIN_ID=DOMAIN, ROS_LOG_DIR=str(tmp_path / 'log')
    )
    try:
        assert victim.ready('running synthetic')
        begin = time.monotonic()
        (recorder,) = children(victim.pid)
        time.sleep(0.6 + 1.5 * random.random())
        lived = time.monotonic() - begin
        if whom in ('group', 'recorder'):
            os.kill(recorder, signal.SIGKILL)
        if whom == 'recorder':  # the simulation goes on; the exit code tells
            time.sleep(0.5)
            assert victim.process.poll() is None
            clock = victim.strike(signal.SIGTERM)
            ended = victim.end(clock)
            assert ended.code == BagError.exit_code and 'mbd recover' in ended.err
        else:
            victim.strike(signal.SIGKILL, group=whom == 'group')
            ended = victim.end(time.monotonic())
        assert not UNWANTED.search(ended.out + ended.err)
        gone(recorder)
    finally:
        victim.kill()
    if whom == 'process':
        assert finished(tmp_path / 'out') is not None
    saved = rescued(tmp_path / 'out', tmp_path / 'saved')
    encode = Messages(channels(), element_states=True)
    messages = saved.outputs['odom']
    last = max(messages)
    assert all(lived - max(of_topic) * 1e-9 < FLUSH_SECONDS + LATE for of_topic in saved.outputs.values())
    assert sorted(messages) == list(range(0, last + 1, 2_000_000))
    place = [topic.name for topic in encode.topics].index('odom')
    for k in (0, 7, last // 2_000_000):
        assert messages[2_000_000 * k] == encode.encode(snapshot(channels(), k))[place]
