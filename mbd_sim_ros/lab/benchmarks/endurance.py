"""The real node at work: paced, commanded over topics, everything published and recorded, for as long as one likes.

Commands have no time stamp of their own. The commander therefore adds a number of its own below 1e-3 N m to every brake
command and looks for it in `cmd_applied`: what it measures is the way there, the wait for the next step, the step, and
the way back.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader

from mbd_sim_ros.bags.files import find_file
from mbd_sim_ros.bags.writer import RESULT
from mbd_sim_ros.batch import warm_up
from mbd_sim_ros.lab.benchmarks.idle import Memory, late_when_busy, late_when_idle
from mbd_sim_ros.lab.benchmarks.machine import on_all_cores
from mbd_sim_ros.lab.benchmarks.overhead import LISTEN, installed
from mbd_sim_ros.lab.benchmarks.start import parameters
from mbd_sim_ros.messages.encode import Messages
from solver import simulation_of
from solver.errors import MbdError
from solver.files.scene import load_scene

DOMAIN = '103'  # ROS domain of its own
PERIOD = 0.01  # s between commands
MARK = 1e-6  # N m
MARKS = 1000
LOST = 0.1  # s after which a command is given up
GONE = 1.0  # s without a message and without a subscription after which the simulator has ended
START = 120.0  # s that it may take to start
IDLE = 0.25, 60.0  # of the run, and at most so long [s]: the loops that do nothing
BUSY = 0.1, 30.0  # the same: those that count
ODOM = 'odom'
# messages that wait for a subscriber: with 10, a hundredth of a second, two cores at work lose some in a thousand
DEPTH = 100
COUNT = (
    'import sys; from mbd_sim_ros.lab.benchmarks.endurance import count; count(float(sys.argv[1]), float(sys.argv[2]))'
)
COMMAND = 'import sys; from mbd_sim_ros.lab.benchmarks.endurance import command; command(sys.argv[1], sys.argv[2:])'
FIGURES = {
    'real_time_factor': 'simulated over elapsed time, up to the last step',
    'late': 'steps that ended after their deadline [%]',
    'idle_before': 'steps of a loop that does nothing that came late by themselves, before the run [%]',
    'idle_after': 'the same behind it [%]',
    'late_more': 'late beyond the mean of these two [%]',
    'busy': 'late by itself, before and after: a loop that counts for 0.4 of each step, measured alone, while all '
    'other cores count [%]',
    'slips': 'times the schedule was given up, 0.2 s behind',
    'latency_p50': 'from publishing a command to receiving the inputs of the step that used it [ms]: median',
    'latency_p99': '99th percentile of the same',
    'latency_max': 'largest of the same',
    'lost': f'commands not seen in a step within {LOST:g} s',
    'missed': f'messages of odom, one of every step, that a plain subscriber with room for {DEPTH} did not get, from '
    'its first one on',
    'recorded': 'size of the recording [MB]',
    'memory': 'of the simulator, at most [MB]',
    'memory_growth': 'in its second half [MB per minute]',
}


class Endurance:
    """Measures one case for `seconds` of simulated time. with_reader: every topic is read by another process.

    Raises what simulation_of does (ImportError without rclpy), MbdError from round().
    """

    def __init__(self, scene: str, overrides: Sequence[str], seconds: float, *, with_reader: bool) -> None:
        import rclpy  # noqa: F401

        # also fills the cache, so that the node starts at once
        simulation = simulation_of(load_scene(scene, overrides))
        warm_up(simulation)
        topics = Messages.of(simulation.scene, simulation).topics
        self._read = [f'{topic.name}:{topic.type}' for topic in topics if installed(topic.type)] if with_reader else []
        self._counts = any(topic.name == ODOM for topic in topics)
        self._scene, self._overrides, self._seconds, self._h = scene, list(overrides), seconds, simulation.h
        self._result: dict[str, str] = {}
        self._latencies: dict[str, Any] = {}
        self._missed: int | None = None
        self._bytes = 0
        self._idle, self._busy = [float('nan')] * 2, [float('nan')] * 2
        self._memory = float('nan'), float('nan')

    def round(self, _: int) -> None:
        """One run of the node, between two of loops that do nothing, and that count."""
        self._disturbed(0)
        self._run()
        self._disturbed(1)

    def _disturbed(self, i: int) -> None:
        idle, busy = (min(share * self._seconds, most) for share, most in (IDLE, BUSY))
        with on_all_cores():
            self._idle[i], self._busy[i] = late_when_idle(self._h, idle), late_when_busy(self._h, busy)

    def _run(self) -> None:
        with on_all_cores(), tempfile.TemporaryDirectory(prefix='mbd-bench-') as scratch, ExitStack() as running:
            environment = {**os.environ, 'ROS_DOMAIN_ID': DOMAIN}
            directory = Path(scratch) / 'bag'

            def start(*command: str, **options: Any) -> subprocess.Popen:
                process = subprocess.Popen([sys.executable, *command], env=environment, **options)
                running.callback(process.wait)
                running.callback(process.terminate)
                return process

            if self._read:
                start('-c', LISTEN, *self._read)
            if self._counts:
                counter = start('-c', COUNT, str(self._seconds), str(self._h), stdout=subprocess.PIPE, text=True)
            commander = start('-c', COMMAND, self._scene, *self._overrides, stdout=subprocess.PIPE, text=True)
            values = {'duration': float(self._seconds), 'record': True, 'out': str(directory), 'publish_elements': True}
            values |= {'rate_tf': 0.0, 'rate_element_states': 0.0, 'rate_reactions': 0.0}  # every step
            given = parameters(self._scene, self._overrides, **values)
            node = start('-m', 'mbd_sim_ros.node.main', '--ros-args', '--log-level', 'warn', *given)
            memory = Memory(node.pid)
            failed = node.wait()
            self._memory = memory.figures()
            if failed:
                raise MbdError(f'the simulator ended with exit code {node.returncode}')
            answer = commander.communicate(timeout=START)[0]
            if commander.returncode or not answer:
                raise MbdError(f'the commander ended with exit code {commander.returncode}')
            self._latencies = json.loads(answer.splitlines()[-1])
            if self._counts:
                answer = counter.communicate(timeout=START)[0]
                if counter.returncode or not answer:
                    raise MbdError(f'the subscriber to {ODOM} ended with exit code {counter.returncode}')
                self._missed = json.loads(answer.splitlines()[-1])
            file = find_file(directory)
            self._bytes = file.stat().st_size
            with file.open('rb') as stream:
                records = {record.name: record.metadata for record in make_reader(stream).iter_metadata()}
            self._result = records[RESULT]

    def close(self) -> None:
        """Nothing to end."""

    def figures(self) -> dict[str, Any]:
        """The part of the report that belongs to this case."""
        steps, ms = int(self._result['steps']), np.array(self._latencies['ms'] or [np.nan])
        values = {
            'real_time_factor': steps * self._h / float(self._result['wall_time']),
            'late': 100.0 * int(self._result['overruns']) / steps,
            'idle_before': self._idle[0],
            'idle_after': self._idle[1],
            'late_more': 100.0 * int(self._result['overruns']) / steps - sum(self._idle) / 2.0,
            'busy': sum(self._busy) / 2.0,
            'slips': int(self._result['schedule_slips']),
            'latency_p50': float(np.median(ms)),
            'latency_p99': float(np.percentile(ms, 99.0)),
            'latency_max': float(ms.max()),
            'lost': self._latencies['lost'],
            'missed': self._missed,
            'recorded': self._bytes * 1e-6,
            'memory': self._memory[0],
            'memory_growth': self._memory[1],
        }
        return {
            'h': self._h,
            'steps': steps,
            'commands': len(self._latencies['ms']),
            'figures': {name: values[name] for name in FIGURES},
        }


def count(duration: float, h: float) -> None:
    """Subscribe to the odometry of a simulator as anybody would, until its last step, at `duration` [s]; print how many
    steps of h [s] were missing from the first message on.
    """
    import rclpy
    from nav_msgs.msg import Odometry

    rclpy.init(args=[])
    node = rclpy.create_node('mbd_bench_odom', enable_rosout=False, start_parameter_services=False)
    steps: list[int] = []
    last = round(duration / h)

    def take(message: Odometry) -> None:
        stamp = message.header.stamp
        steps.append(round((stamp.sec + stamp.nanosec * 1e-9) / h))

    node.create_subscription(Odometry, ODOM, take, DEPTH)
    end = time.monotonic() + START
    while time.monotonic() < end and (not steps or steps[-1] < last):
        seen = len(steps)
        rclpy.spin_once(node, timeout_sec=GONE)
        if len(steps) > seen:
            end = time.monotonic() + GONE
    print(json.dumps(last + 1 - steps[0] - len(set(steps)) if steps else last), flush=True)
    rclpy.shutdown()


def command(scene: str, overrides: Sequence[str]) -> None:
    """Play the maneuver of a scene, again and again, until the simulator ends; print the latencies [ms] as JSON.

    The subscription is looked into directly: an executor would add a millisecond of its own to every message.
    """
    import rclpy
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64

    rclpy.init(args=[])
    node = rclpy.create_node('mbd_bench_commander', enable_rosout=False, start_parameter_services=False)
    newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
    publishers = [
        node.create_publisher(Float64, f'simulator/{name}', newest)
        for name in ('steering_cmd', 'torque_cmd', 'brake_cmd')
    ]
    applied = node.create_subscription(JointState, 'cmd_applied', lambda _: None, newest)
    loaded = load_scene(scene, overrides)

    def take(seconds: float) -> Any:
        """The newest message, waiting for it; None when none comes."""
        end = time.perf_counter() + seconds
        while True:
            with applied.handle:
                taken = applied.handle.take_message(JointState, False)
            if taken is not None or time.perf_counter() > end:
                return None if taken is None else taken[0]
            time.sleep(5e-5)

    latencies: list[float] = []
    lost = count = 0
    message = take(START)
    while message is not None:
        t = (message.header.stamp.sec + message.header.stamp.nanosec * 1e-9) % loaded.duration
        steering, drive, brake = loaded.maneuver.commands(t)
        brake += (count % MARKS + 1) * MARK
        count += 1
        sent = time.perf_counter()
        for publisher, value in zip(publishers, (steering, drive, brake), strict=True):
            publisher.publish(Float64(data=value))
        brake_at = message.name.index('brake_torque')
        while message is not None and message.position[brake_at] != brake and time.perf_counter() < sent + LOST:
            message = take(GONE)
        if message is None:
            break
        if message.position[brake_at] == brake:
            latencies.append((time.perf_counter() - sent) * 1e3)
        else:
            lost += 1
        # in every phase of the step: multiples of the golden ratio fall evenly over its length
        time.sleep(max(0.0, sent + PERIOD * (0.9 + 0.2 * (count * 0.6180339887 % 1.0)) - time.perf_counter()))
        message = take(GONE)
    print(json.dumps({'ms': latencies, 'lost': lost}), flush=True)
    rclpy.shutdown()
