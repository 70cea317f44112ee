"""Benchmark of the messages: the time that encoding, recording and publishing add to a step of the node's real-time
loop."""

from __future__ import annotations

import gc
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.bags.recorder import StepRecorder
from mbd_sim_ros.batch import record, warm_up
from mbd_sim_ros.lab.benchmarks.machine import on_all_cores
from mbd_sim_ros.messages.encode import Messages
from mbd_sim_ros.messages.topics import Topic
from mbd_sim_ros.node.latch import Latch
from mbd_sim_ros.node.loop import Loop
from mbd_sim_ros.node.main import SWITCH
from solver import simulation_of
from solver.files.scene import load_scene
from solver.output.snapshot import Snapshot

# Measured part of a step -> its explanation in the report.
PIECES = {
    'step': 'advance(1) in the loop, every step',
    'encode': 'from the snapshot to the bytes of all messages, in the steps that publish',
    'publish': 'handing the bytes to rclpy (0 in a loop that only records), in the same steps',
    'record': 'handing the bytes to the recorder, in the same steps',
    'overhead': 'encode + publish + record, what the simulation thread pays for such a step',
}
# Figure of a report -> its explanation; times in us.
FIGURES = {
    **{
        f'{name}_{at}': f'{text}: {what}'
        for name, text in PIECES.items()
        for at, what in (('p50', 'median'), ('p99', '99th percentile'))
    },
    'overhead_max': 'the same: largest',
    'late': 'steps that ended, messages included, after the next one was due [%]',
    'other_threads': 'mean CPU time per step of all other threads: deliveries to the recording process, and middleware',
    'recording': 'mean CPU time per step of the recording process: writing, compression, the end of the file',
}
# real-time priority of the loop, the default of the node; without the permission the loop runs without it
PRIORITY = 10
DOMAIN = 101  # ROS domain of the benchmark, apart from the default 0: nothing else on the network listens to it
DISCOVERY_SECONDS = 10.0  # s to wait for the reader's subscriptions; topics without one by then are published unread
# the reader process
LISTEN = 'import sys; from mbd_sim_ros.lab.benchmarks.overhead import listen; listen(sys.argv[1:])'

Publishing = Iterator[tuple[Callable[[Sequence[bytes | None]], None], int]]


class Overhead:
    """Measures one case in the loop of the node, in real time: a step whenever one is due.

    publish_every: messages of all topics are made after every `publish_every`-th step. After the other steps only the
    inputs are recorded, which a replay needs of every step. publish: whether the messages are also published with
    rclpy, to a reader in another process. Raises SceneError, SpecError or ConsistencyError on construction (ImportError
    without rclpy), StepError or BagError from round().
    """

    def __init__(self, scene: str, overrides: Sequence[str], *, publish: bool, publish_every: int = 1) -> None:
        self._resources = ExitStack()
        self.simulation = simulation_of(load_scene(scene, overrides))
        warm_up(self.simulation)
        self._messages = Messages.of(self.simulation.scene, self.simulation)
        sample = self._messages.encode(self.simulation.snapshot(), whole=True)
        self._bytes = sum(len(data) for data in self._messages.encode(self.simulation.snapshot()) if data is not None)
        self._publish: Callable[[Sequence[bytes | None]], None] | None = None
        self._published = 0
        if publish:
            with on_all_cores():  # for the threads of the middleware: the core of the loop is for the loop
                self._publish, self._published = self._resources.enter_context(
                    publication(self._messages.topics, sample)
                )
        self._every = publish_every
        self._times: list[int] = []  # CPU time of advance(1) of every step [ns]
        self._pieces: list[tuple[int, ...]] = []  # (encode, publish, record, overhead) of each step with messages [ns]
        self._late = 0  # steps that ended after the next one was due
        self._others: list[float] = []  # CPU time per step of all other threads, of each round [us]
        self._recordings: list[float] = []  # CPU time per step of the recording process, of each round [us]

    def round(self, steps: int) -> None:
        """Run and measure `steps` steps with their messages, recorded into a temporary bag."""
        simulation = self.simulation
        if simulation.k + steps > simulation.scene.steps:
            simulation.reset()
        with tempfile.TemporaryDirectory(prefix='mbd-bench-') as scratch, like_the_node():
            recording = -children()
            with on_all_cores():
                messages, recorder = record(simulation, Path(scratch) / 'bag')
            # (~pid << 3) | 2 is the clock of the CPU time of a process (Linux): subtracted, the start does not count
            recording -= time.clock_gettime((~recorder.pid << 3) | 2)
            others = time.thread_time_ns() - time.process_time_ns()
            others -= self._pace(steps, messages, recorder)
            recorder.close()
            others += time.process_time_ns() - time.thread_time_ns()
            recording += children()
        self._others.append(others / steps * 1e-3)
        self._recordings.append(recording / steps * 1e6)

    def _pace(self, steps: int, messages: Messages, recorder: StepRecorder) -> int:
        """Run the loop of the node for `steps` steps; returns the CPU time of the thread of the loop [ns]."""
        simulation, clock = self.simulation, time.thread_time_ns
        first, rows = simulation.k, simulation.source.table(simulation.k, steps)
        begin = end = 0

        def inputs(_: tuple[float, ...]) -> np.ndarray:
            nonlocal begin
            row = rows[simulation.k - first]
            begin = clock()
            return row

        def emit(snapshot: Snapshot) -> None:
            nonlocal end
            end = t1 = clock()
            if snapshot.k == first:  # the state at the start, which the loop emits first
                return
            self._times.append(t1 - begin)
            recorder.note(snapshot.k, snapshot.inputs[None])
            if snapshot.k % self._every:
                end = clock()
                return
            encoded = messages.encode(snapshot)
            t2 = clock()
            if self._publish is not None:
                self._publish(encoded)
            t3 = clock()
            recorder.record(snapshot.t_ns, encoded)
            end = clock()
            self._pieces.append((t2 - t1, t3 - t2 if self._publish else 0, end - t3, end - t1))

        end_ns = simulation.t_ns + steps * simulation.h_ns
        loop = Loop(simulation, Latch(simulation), inputs=inputs, emit=emit, end_ns=end_ns)
        loop.start()
        loop.prefer(PRIORITY)
        loop.done.wait()
        loop.prefer(0)
        loop.stop('')
        if loop.error is not None:
            raise loop.error
        self._late += loop.overruns
        return end

    def close(self) -> None:
        """Stop the reader and the middleware."""
        self._resources.close()

    def figures(self) -> dict[str, Any]:
        """The part of the report that belongs to this case: sizes, and under 'figures' those of FIGURES, times in
        us."""
        samples = dict(zip(PIECES, (np.array(self._times), *np.array(self._pieces).T), strict=True))
        us = {f'{name}_p{q}': float(np.percentile(ns, q)) * 1e-3 for name, ns in samples.items() for q in (50, 99)}
        us['overhead_max'] = float(samples['overhead'].max()) * 1e-3
        us['late'] = 100.0 * self._late / len(self._times)
        us['other_threads'] = float(np.median(self._others))
        us['recording'] = float(np.median(self._recordings))
        return {
            'h': self.simulation.h,
            'rate': 1.0 / (self.simulation.h * self._every),
            'steps': len(self._times),
            'topics': len(self._messages.topics),
            'published_topics': self._published,
            'bytes_per_step': self._bytes,
            'figures': us,
        }


@contextmanager
def like_the_node() -> Iterator[None]:
    """Settings of the interpreter in the node: a short switch interval of threads, and no garbage collection of present
    objects."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH)
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before)


def children() -> float:
    """CPU time [s] of the child processes that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


@contextmanager
def publication(topics: Sequence[Topic], samples: Sequence[bytes | None]) -> Publishing:
    """Publishers of `topics`, and one process that reads them all; gives (publish, number of topics that are read).

    publish: takes the encoded messages in the order of `topics`, None for a topic without one. samples: one encoded
    message per topic. A topic whose type is not installed is left out. Raises ImportError without rclpy.
    """
    import rclpy
    from rclpy.context import Context
    from rclpy.logging import LoggingSeverity

    from mbd_sim_ros.node.publish import Publication, leave_sending_to_the_middleware

    with ExitStack() as resources:
        context = Context()
        rclpy.init(args=[], context=context, domain_id=DOMAIN)
        leave_sending_to_the_middleware()
        resources.callback(rclpy.shutdown, context=context)
        node = rclpy.create_node('mbd_bench', context=context, enable_rosout=False, start_parameter_services=False)
        node.get_logger().set_level(LoggingSeverity.WARN)
        resources.callback(node.destroy_node)
        made = Publication(node, topics, samples)
        read = [topic for topic in topics if installed(topic.type)]
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(DOMAIN)}
        reader = subprocess.Popen(
            [sys.executable, '-c', LISTEN, *(f'{topic.name}:{topic.type}' for topic in read)], env=environment
        )
        resources.callback(reader.wait)
        resources.callback(reader.terminate)
        limit = time.monotonic() + DISCOVERY_SECONDS
        while any(node.count_subscribers(topic.name) == 0 for topic in read) and time.monotonic() < limit:
            time.sleep(0.05)
        yield (
            lambda encoded: made.publish(encoded, made.channels),
            sum(node.count_subscribers(topic.name) > 0 for topic in read),
        )


def installed(message_type: str) -> bool:
    """True where ROS knows the message type."""
    from mbd_sim_ros.node.publish import message_class

    try:
        message_class(message_type)
    except ImportError:
        return False
    return True


def listen(topics: Sequence[str]) -> None:
    """Main function of the reader process: subscribe to the topics ('name:type') and drop their messages, until
    terminated."""
    import rclpy
    from rclpy.executors import ExternalShutdownException

    from mbd_sim_ros.node.publish import message_class

    os.sched_setaffinity(0, range(os.cpu_count() or 1))  # all cores: the parent process is bound to the measured one
    rclpy.init(args=[])
    node = rclpy.create_node('mbd_bench_reader', enable_rosout=False)
    for topic in topics:
        name, _, kind = topic.partition(':')
        node.create_subscription(message_class(kind), name, lambda _: None, 10, raw=True)
    with suppress(ExternalShutdownException):
        rclpy.spin(node)
