"""The node `simulator` over real topics, as a process: pace, commands, services, and every way to end."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from client import client
from processes import ROOT, SCRIPT, Process, start

from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.bags.recovery import recover
from solver.errors import BagError

pytestmark = pytest.mark.realtime

__all__ = ['client', 'start']  # fixtures


def test_a_run_of_given_duration_ends_by_itself_and_is_recorded_whole(start, tmp_path):
    process = start({'duration': 1.0, 'record': True, 'out': 'run'})
    assert process.end() == 0, process.output
    assert 'Traceback' not in process.output
    run = bag.read(tmp_path / 'run')
    np.testing.assert_array_equal(run['cmd_applied/step'], np.arange(501.0))
    assert run.metadata['end'] == 'duration reached'
    assert yaml.safe_load(run.metadata['parameters'])['duration'] == 1.0
    assert run.metadata['seed'] == '7'


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_running_finishes_the_file(start, tmp_path, number):
    process = start({'record': True, 'out': 'run'})
    process.wait_for('running synthetic')
    time.sleep(0.5)
    process.process.send_signal(number)
    process.process.send_signal(number)  # delivered twice, as terminals and launch tools do: one gesture
    assert process.end() == 0, process.output
    assert 'Traceback' not in process.output
    run = bag.read(tmp_path / 'run')
    np.testing.assert_array_equal(np.diff(run['cmd_applied/step']), 1.0)
    assert run.metadata['end'] == f'stopped by {signal.Signals(number).name}'


def priorities(pid: int) -> list[int]:
    """Real-time priorities of the threads of a process; 0: ordinary scheduling."""
    threads = [int(task.name) for task in Path(f'/proc/{pid}/task').iterdir()]
    return [os.sched_getparam(t).sched_priority if os.sched_getscheduler(t) == os.SCHED_FIFO else 0 for t in threads]


def children(pid: int) -> list[int]:
    return [
        int(child) for task in Path(f'/proc/{pid}/task').iterdir() for child in (task / 'children').read_text().split()
    ]


def test_in_real_time_the_simulation_stands_above_all_other_threads(start, client):
    try:
        before = os.sched_getscheduler(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        os.sched_setscheduler(0, before, os.sched_param(0))
    except (AttributeError, OSError):
        pytest.skip('needs Linux and the permission to use real-time priorities')
    process = start({'realtime_priority': 7})
    client.until(lambda: client.applied)
    # by the thread of the simulation: its process must not have the priority
    assert client.call('start_recording').success
    client.until(lambda: children(process.process.pid))
    (recording,) = children(process.process.pid)
    client.until(lambda: os.sched_getscheduler(recording) == os.SCHED_OTHER)
    found = sorted(priorities(process.process.pid))
    assert found[-1] == 7 and set(found[:-1]) == {6} and len(found) > 3


def test_a_signal_while_preparing_ends_at_once(start, tmp_path):
    process = start({'record': True, 'out': 'run'}, preparing=30.0)
    process.wait_for('PREPARING')
    process.process.send_signal(signal.SIGINT)
    begin = time.monotonic()
    assert process.end(10.0) == 0, process.output
    assert time.monotonic() - begin < 1.0
    assert process.output.splitlines()[-1] == 'interrupted while preparing synthetic'
    assert not (tmp_path / 'run').exists()


def test_a_failing_step_ends_the_run_with_its_sentence(start, tmp_path):
    process = start({'record': True, 'out': 'run', 'mode': 'fast'}, fails_at=300)
    assert process.end() == 4
    assert 'no convergence at constraint hinge' in process.output
    assert 'Traceback' not in process.output
    run = bag.read(tmp_path / 'run')
    assert run['cmd_applied/step'][-1] == 299.0
    assert 'no convergence' in run.metadata['end']


def test_a_failing_step_is_told_in_the_diagnostics(start, client):
    """Long after the report of the second before it and long before the next."""
    from diagnostic_msgs.msg import DiagnosticStatus

    process = start({}, fails_at=1250)
    client.until(lambda: client.diagnostics and client.diagnostics[-1].status[0].level == DiagnosticStatus.ERROR)
    assert 'no convergence at constraint hinge' in client.diagnostics[-1].status[0].message
    assert process.end() == 4


def test_a_state_that_is_not_finite_is_never_let_out(start, tmp_path):
    process = start({'record': True, 'out': 'run', 'mode': 'fast'}, bad_at=250)
    assert process.end() == 4
    assert "pose of body 'chassis' is not finite at t = 0.500000 s" in process.output
    run = bag.read(tmp_path / 'run')
    assert run['cmd_applied/step'][-1] == 249.0
    assert all(np.isfinite(column).all() for column in run.columns.values())


def test_a_recording_that_cannot_be_made_is_one_sentence(start, tmp_path):
    (tmp_path / 'run').mkdir()
    (tmp_path / 'run' / 'mine').touch()
    process = start({'record': True, 'out': 'run'})
    assert process.end() == 5
    assert 'it is not empty' in process.output
    assert 'Traceback' not in process.output


@pytest.mark.parametrize(
    ('parameters', 'sentence'),
    [
        ({'mode': 'quick'}, "parameter mode = 'quick': must be one of realtime, fast, lockstep"),
        ({'duration': 'long'}, 'duration'),
        pytest.param({'rate_factor': -1.0}, 'rate_factor', marks=pytest.mark.long),
        pytest.param({'scene': ''}, 'parameter scene is empty', marks=pytest.mark.long),
        ({'restore': 'nowhere.npz'}, 'nowhere.npz is not a state file'),
    ],
)
def test_wrong_parameters_are_refused_in_one_sentence(start, parameters, sentence):
    process = start(parameters)
    assert process.end() == 2, process.output
    assert sentence in process.output
    assert 'Traceback' not in process.output


def test_without_rclpy_it_says_how_to_get_it(tmp_path):
    code = "import sys; sys.modules['rclpy'] = None; from mbd_sim_ros.node.main import main; sys.exit(main([]))"
    done = subprocess.run(
        [sys.executable, '-c', code],
        cwd=ROOT,
        env=dict(os.environ),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr.startswith('simulator: rclpy is missing') and done.stderr.count('\n') == 1


def test_recording_and_reading_do_not_need_rclpy():
    code = (
        "import sys; sys.modules['rclpy'] = None\n"
        'import mbd_sim_ros.messages.encode, mbd_sim_ros.bags.recorder, mbd_sim_ros.bags.reader, '
        'mbd_sim_ros.node.loop\n'
        "assert not any(name.startswith(('sensor_msgs', 'rosidl')) for name in sys.modules)"
    )
    subprocess.run([sys.executable, '-c', code], cwd=ROOT, env=dict(os.environ), timeout=60, check=True)


def test_commands_are_latched_clamped_refused_and_watched(start, client):
    process = start(
        {
            'command_timeout': 0.3,
            'max_steering': 2.0,
            'max_drive_torque': 100.0,
            'robot_description': '<robot name="r"/>',
        }
    )
    client.ready()
    client.until(lambda: client.applied)
    assert client.applied[-1]['drive_torque'] == 0.0
    for index, value in ((0, 5.0), (1, -500.0), (2, 30.0)):
        client.send(index, value)
    client.until(lambda: client.applied[-1]['drive_torque'] == -100.0 and client.applied[-1]['brake_torque'] == 30.0)
    client.send(2, math.nan)
    client.send(1, math.inf)
    client.until(lambda: abs(client.applied[-1]['steering'] - 2.0) < 1e-3)  # clamped, behind its filter
    client.until(lambda: client.applied[-1]['drive_torque'] == 0.0)  # too old: the torque goes
    last = client.applied[-1]
    assert last['brake_torque'] == 30.0 and abs(last['steering'] - 2.0) < 1e-3  # the rest holds
    client.until(
        lambda: any(a.status[0].message.startswith('drive torque command is too old') for a in client.diagnostics)
    )
    client.send(1, 40.0)
    client.until(lambda: client.applied[-1]['drive_torque'] == 40.0)  # and recovers
    client.send(2, -1.0)
    client.until(lambda: client.applied[-1]['brake_torque'] == 0.0)  # there is no negative braking
    process.process.send_signal(signal.SIGTERM)
    assert process.end() == 0
    for text in (
        'steering_cmd: 5 is beyond the limit',
        'brake_cmd: nan is not a number',
        'torque_cmd: inf is not a number',
    ):
        assert text in process.output
    steps = [a['step'] for a in client.applied]
    assert np.all(np.diff(steps) >= 1.0)
    values = {v.key: v.value for v in client.diagnostics[-1].status[0].values}
    assert {
        'real-time factor',
        'overruns',
        'step time p99 [ms]',
        'residual',
        'command age [s]',
        'recorder lag [steps]',
    } <= values.keys()
    assert 'mbd run' in values['numerical error']  # measured on this machine, or how it is
    # a machine that is busy elsewhere makes it slower, and then it says so
    from mbd_sim_ros.node.diagnostics import SLOW

    slow, factor = (
        'slower than real time' in client.diagnostics[-1].status[0].message,
        float(values['real-time factor']),
    )
    assert 0.0 < factor <= SLOW if slow else SLOW <= factor < 1.5
    stamp = client.diagnostics[-1].header.stamp  # the time of day: a node that has fallen silent is told by it
    assert abs(stamp.sec - time.time()) < 60.0
    assert client.description[0].data == '<robot name="r"/>'
    assert client.odom[-1].child_frame_id == 'base_link'
    assert 2 <= len(client.clock) <= 110 * (steps[-1] - steps[0]) * 0.002 + 10  # at most 100 Hz
    assert np.all(np.diff(client.clock) > 0.0)


def test_services_act_between_steps(start, client, tmp_path):
    process = start({'mode': 'realtime', 'step_count': 5})
    client.ready()
    assert client.call('pause').success
    paused = client.call('pause').message
    time.sleep(0.2)
    assert client.call('pause').message == paused  # time stands still
    k = int(paused.split('step ')[1])
    client.applied.clear()
    assert client.call('step').success
    client.until(lambda: client.applied and client.applied[-1]['step'] == k + 5)
    started = client.call('start_recording')
    assert started.success, started.message
    assert not client.call('start_recording').success  # already
    saved = client.call('save_state')
    assert saved.success and Path(saved.message).is_file()
    client.call('resume')
    client.until(lambda: client.applied[-1]['step'] > k + 100)
    stopped = client.call('stop_recording')
    assert stopped.success and not client.call('stop_recording').success
    run = bag.read(tmp_path / stopped.message)
    assert run['cmd_applied/step'][0] == k + 6.0
    for text in (client.description[0].data, run.metadata['robot_description']):
        assert text == '<robot name="of the model"/>'  # no parameter given: that of the model
    told, _, text = client.scene[0].data.partition('\n')
    assert told.startswith('# mbd_sim_ros {') and text == run.metadata['resolved_scene']
    assert client.call('reset').success
    client.until(lambda: client.applied[-1]['step'] < k)
    process.process.send_signal(signal.SIGINT)
    assert process.end() == 0, process.output
    again = start(
        {'restore': saved.message, 'mode': 'fast', 'duration': (k + 50) * 0.002, 'record': True, 'out': 'again'}
    )
    assert again.end() == 0, again.output
    assert bag.read(tmp_path / 'again')['cmd_applied/step'][0] == k + 5.0


def test_lockstep_steps_once_for_each_set_of_newer_commands(start, client):
    process = start({'mode': 'lockstep'})
    client.ready()
    client.until(lambda: client.applied)  # the state at the start
    assert client.applied[-1]['step'] == 0.0
    for k in range(1, 21):
        for index, value in ((0, 0.01 * k), (1, 10.0 * k), (2, float(k))):
            if index == 2:
                time.sleep(0.002)
                assert client.applied[-1]['step'] == k - 1  # two of three are not enough
            client.send(index, value)
        client.until(lambda k=k: client.applied[-1]['step'] == k)
        assert client.applied[-1]['drive_torque'] == 10.0 * k
        assert client.applied[-1]['brake_torque'] == k
    client.call('step')
    client.until(lambda: client.applied[-1]['step'] == 21)
    process.process.send_signal(signal.SIGTERM)
    assert process.end() == 0


def test_parameters_are_described_guarded_and_load_again(start, client, tmp_path):
    from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
    from rclpy.parameter import Parameter, parameter_value_to_python

    process = start({'command_timeout': 0.25})
    client.ready()

    def ask(kind, name, **fields):
        service = client.node.create_client(kind, f'simulator/{name}')
        client.until(service.service_is_ready)
        future = service.call_async(kind.Request(**fields))
        client.until(future.done)
        return future.result()

    names = list(ask(ListParameters, 'list_parameters').result.names)
    described = {d.name: d for d in ask(DescribeParameters, 'describe_parameters', names=names).descriptors}
    assert '[s]' in described['command_timeout'].description
    assert described['rate_factor'].floating_point_range[0].to_value == 1000.0

    def put(name, value):
        return ask(
            SetParameters, 'set_parameters', parameters=[Parameter(name, value=value).to_parameter_msg()]
        ).results[0]

    assert put('rate_factor', 2.0).successful
    assert 'fixed while the node runs' in put('frame_prefix', 'other/').reason
    assert 'must be one of realtime' in put('mode', 'quick').reason
    assert not put('publish_every', 0).successful
    nobody_knows = Parameter('rate_factor', value=1.0).to_parameter_msg()
    nobody_knows.value.type = 77
    service = client.node.create_client(SetParameters, 'simulator/set_parameters')
    client.until(service.service_is_ready)
    service.call_async(SetParameters.Request(parameters=[nobody_knows]))
    client.until(
        lambda: 'a request cannot be handled and is left unanswered: 77 is not a valid Parameter.Type' in process.output
    )
    assert put('rate_factor', 1.5).successful  # the simulation goes on
    values = [parameter_value_to_python(v) for v in ask(GetParameters, 'get_parameters', names=names).values]
    dump = {n: list(v) if isinstance(v, (list, tuple)) else v for n, v in zip(names, values, strict=True)}
    process.process.send_signal(signal.SIGTERM)
    assert process.end() == 0
    file = tmp_path / 'dump.yaml'  # what `ros2 param dump` writes
    file.write_text(yaml.safe_dump({'/simulator': {'ros__parameters': {**dump, 'duration': 0.2, 'mode': 'fast'}}}))
    command = [sys.executable, '-c', SCRIPT, '{}', '0', '--ros-args', '--params-file', str(file)]
    again = Process(tmp_path, command)
    try:
        assert again.end() == 0, again.output
        assert 'duration reached: t = 0.200 s' in again.output
    finally:
        again.kill()


def test_a_full_disk_while_running_stops_the_recording_not_the_simulation(start, tmp_path):
    """The size of files is limited, which the kernel reports in write() as it does a full disk."""
    import resource

    old = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, old[1]))
        # Shared memory of the middleware is a file too: loopback only for this process.
        os.environ['FASTDDS_BUILTIN_TRANSPORTS'] = 'UDPv4'
        process = start({'record': True, 'out': 'run', 'mode': 'fast', 'duration': 40.0}, forked=False)
    finally:
        os.environ.pop('FASTDDS_BUILTIN_TRANSPORTS', None)
        resource.setrlimit(resource.RLIMIT_FSIZE, old)
        signal.signal(signal.SIGXFSZ, ignored)
    assert process.end() == BagError.exit_code, process.output
    assert 'File too large' in process.output
    assert 'duration reached: t = 40.000 s' in process.output
    assert 'Traceback' not in process.output
    assert recover(tmp_path / 'run', tmp_path / 'saved').messages > 100


def test_a_parameter_that_is_not_known_is_named(start):
    process = start({'scnee': 'x', 'qos_overrides./odom.publisher.depth': 5, 'duration': 0.1, 'mode': 'fast'})
    assert process.end() == 0, process.output
    assert "parameter 'qos_overrides./odom.publisher.depth' is unknown and ignored" in process.output
    assert "parameter 'scnee' is unknown and ignored; did you mean 'scene'?" in process.output


def test_a_parameter_file_that_is_missing_or_broken_is_one_sentence(tmp_path):
    pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    (tmp_path / 'broken.yaml').write_text('a: [1\n  b')
    for name, words in (('missing.yaml', 'is not there'), ('broken.yaml', 'broken.yaml')):
        process = Process(
            tmp_path,
            [sys.executable, '-m', 'mbd_sim_ros.node.main', '--ros-args', '--params-file', str(tmp_path / name)],
        )
        assert process.end() == 2, process.output
        said = [line for line in process.output.splitlines() if not line.startswith('[')]  # rcl logs on its own
        assert len(said) == 1 and words in said[0], process.output
        assert 'Traceback' not in process.output


@pytest.mark.parametrize('out', [pytest.param('/dev/full', marks=pytest.mark.long), '/proc/nothing/here'])
def test_a_place_where_nothing_can_be_recorded_is_one_sentence(start, out):
    process = start({'record': True, 'out': out})
    assert process.end() == 5, process.output
    assert f'cannot record into {out}' in process.output
    assert 'Traceback' not in process.output


def test_service_calls_are_logged_and_steps_need_a_pause(start, client):
    """Steps may be asked for a thousand times a second: one that was made is logged at DEBUG, and one that is refused
    as a warning."""
    process = start()
    client.ready()
    refused = client.call('step')
    assert (
        not refused.success
        and 'the simulation is running (mode realtime): call ~/pause before ~/step' in refused.message
    )
    assert client.call('pause').success and client.call('step').success
    process.process.terminate()
    assert process.end() == 0
    for text in ('[WARN]', 'step refused: the simulation is running', '[INFO]', 'pause: paused at t = '):
        assert text in process.output
    assert 'step: 1 steps from step ' not in process.output


def test_a_missing_torque_command_is_said_once(start, client):
    process = start({'command_timeout': 0.2})
    client.ready()
    client.until(lambda: client.applied)
    client.send(1, 40.0)
    client.until(lambda: client.applied[-1]['drive_torque'] == 40.0)
    client.until(lambda: client.applied[-1]['drive_torque'] == 0.0)
    client.diagnostics.clear()
    client.until(lambda: len(client.diagnostics) > 2)  # 1 Hz
    process.process.terminate()
    assert process.end() == 0
    assert process.output.count('no torque_cmd for 0.2 s') == 1


def test_every_parameter_is_in_the_parameter_file_and_in_its_page():
    parameters = pytest.importorskip(
        'mbd_sim_ros.node.parameters', reason='needs ROS: source Jazzy, or pip install .[ros]'
    )
    page = (ROOT / 'docs' / 'ros.md').read_text()
    text = (ROOT / 'config' / 'node.yaml').read_text()
    given = yaml.safe_load(text)['/**']['ros__parameters']
    for name, spec in parameters.PARAMETERS.items():
        assert f'`{name}`' in page, name
        assert name in given or f'    # {name}: ' in text, name
        if name in given:
            assert given[name] == spec.default and type(given[name]) is type(spec.default), name
    assert given.keys() <= parameters.PARAMETERS.keys()
