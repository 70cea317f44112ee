"""What encoding, recording and publishing add to a step of a loop that is paced like the node's."""

from __future__ import annotations

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

from mbd_sim_ros.batch import record, warm_up
from mbd_sim_ros.messages import Messages, Topic
from solver.scene import load_scene
from solver.simulation import Simulation
from solver.snapshot import Snapshot

FIGURES = {
    'step': 'advance(1) in the paced loop: median',
    'encode': 'from the snapshot to the bytes of all messages: median',
    'publish': 'handing the bytes to rclpy: median (0 in a loop that only records)',
    'record': 'handing the bytes to the recorder: median',
    'overhead_p50': 'encode + publish + record, what the simulation thread pays: median',
    'overhead_p99': '99th percentile of the same',
    'overhead_max': 'largest of the same',
    'other_threads': 'mean CPU time per step of all other threads: deliveries to the recording process, and middleware',
    'recording': 'mean CPU time per step of the recording process: writing, compression, the end of the file',
}
DOMAIN = 101  # ROS domain of its own: nothing on the network listens to a benchmark
DISCOVERY_SECONDS = 10.0
LISTEN = 'import sys; from mbd_sim_ros.benchmark.overhead import listen; listen(sys.argv[1:])'


class Overhead:
    """Measures one case, some steps per round in real time at the step of the scene.

    publish: also with rclpy, to one reader in a process of its own. Raises SceneError, SpecError or ConsistencyError on
    construction (ImportError without rclpy), StepError or BagError from round().
    """

    def __init__(self, scene: str, overrides: Sequence[str], *, publish: bool) -> None:
        self._resources = ExitStack()
        self.simulation = Simulation(load_scene(scene, overrides))
        warm_up(self.simulation)
        record_ = self.simulation.scene.record
        self._messages = Messages(self.simulation.channels, element_states=record_.elements, reactions=record_.reactions)
        sample = self._messages.encode(self.simulation.snapshot())
        self._bytes = sum(map(len, sample))
        self._publish: Callable[[Sequence[bytes]], None] | None = None
        self._published = 0
        if publish:
            self._publish, self._published = self._resources.enter_context(publication(self._messages.topics, sample))
        self._times: list[tuple[float, ...]] = []
        self._others: list[float] = []
        self._recordings: list[float] = []

    def round(self, steps: int) -> None:
        """Step, encode, publish and record, `steps` times."""
        simulation = self.simulation
        if simulation.k + steps > simulation.scene.steps:
            simulation.reset()
        inputs = simulation.source.table(simulation.k, steps)
        clock = time.thread_time_ns
        with tempfile.TemporaryDirectory(prefix='mbd-bench-') as scratch:
            recording = -children()
            messages, recorder = record(simulation, Path(scratch) / 'bag')
            recording -= time.clock_gettime((~recorder.pid << 3) | 2)  # its CPU clock: the start does not count
            others = clock() - time.process_time_ns()
            anchor = time.perf_counter()
            for k, row in enumerate(inputs):
                time.sleep(max(0.0, anchor + (k + 1) * simulation.h - time.perf_counter()))
                t0 = clock()
                snapshot: Snapshot = simulation.advance(1, row)
                t1 = clock()
                encoded = messages.encode(snapshot)
                t2 = clock()
                if self._publish is not None:
                    self._publish(encoded)
                t3 = clock()
                recorder.write(snapshot.t_ns, encoded)
                t4 = clock()
                self._times.append((t1 - t0, t2 - t1, t3 - t2 if self._publish else 0, t4 - t3, t4 - t1))
            recorder.close()
            others += time.process_time_ns() - clock()
            recording += children()
        self._others.append(others / steps * 1e-3)
        self._recordings.append(recording / steps * 1e6)

    def close(self) -> None:
        """Stop the reader and the middleware."""
        self._resources.close()

    def figures(self) -> dict[str, Any]:
        """The part of the report that belongs to this case: sizes and times [us]."""
        times = np.array(self._times) * 1e-3
        middle = np.median(times, axis=0)
        us = dict(zip(('step', 'encode', 'publish', 'record', 'overhead_p50'), map(float, middle), strict=True))
        us['overhead_p99'] = float(np.percentile(times[:, 4], 99.0))
        us['overhead_max'] = float(times[:, 4].max())
        us['other_threads'] = float(np.median(self._others))
        us['recording'] = float(np.median(self._recordings))
        return {
            'h': self.simulation.h,
            'rate': 1.0 / self.simulation.h,
            'steps': len(times),
            'topics': len(self._messages.topics),
            'published_topics': self._published,
            'bytes_per_step': self._bytes,
            'figures': us,
        }


def children() -> float:
    """CPU time of the processes started from here that have ended [s]."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


@contextmanager
def publication(topics: Sequence[Topic], samples: Sequence[bytes]) -> Iterator[tuple[Callable[[Sequence[bytes]], None], int]]:
    """Publishers of `topics`, each with one reader in another process; gives (publish, number of topics that have their reader).

    Topics of types that are not installed are left out. Raises ImportError without rclpy.
    """
    import rclpy
    from rclpy.context import Context
    from rclpy.logging import LoggingSeverity

    from mbd_sim_ros.publish import Publication, leave_sending_to_the_middleware

    with ExitStack() as resources:
        context = Context()
        rclpy.init(args=[], context=context, domain_id=DOMAIN)
        leave_sending_to_the_middleware()
        resources.callback(rclpy.shutdown, context=context)
        node = rclpy.create_node('mbd_bench', context=context, enable_rosout=False, start_parameter_services=False)
        node.get_logger().set_level(LoggingSeverity.WARN)
        resources.callback(node.destroy_node)
        publish = Publication(node, topics, samples).publish
        read = [topic for topic in topics if installed(topic.type)]
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(DOMAIN)}
        reader = subprocess.Popen([sys.executable, '-c', LISTEN, *(f'{topic.name}:{topic.type}' for topic in read)], env=environment)
        resources.callback(reader.wait)
        resources.callback(reader.terminate)
        limit = time.monotonic() + DISCOVERY_SECONDS
        while any(node.count_subscribers(topic.name) == 0 for topic in read) and time.monotonic() < limit:
            time.sleep(0.05)
        yield publish, sum(node.count_subscribers(topic.name) > 0 for topic in read)


def installed(message_type: str) -> bool:
    """Whether ROS knows the message type."""
    from mbd_sim_ros.publish import message_class

    try:
        message_class(message_type)
    except ImportError:
        return False
    return True


def listen(topics: Sequence[str]) -> None:
    """Read the topics (name:type) and throw away what comes, until the process is terminated."""
    import rclpy
    from rclpy.executors import ExternalShutdownException

    from mbd_sim_ros.publish import message_class

    os.sched_setaffinity(0, range(os.cpu_count() or 1))  # not on the core that is measured alone
    rclpy.init(args=[])
    node = rclpy.create_node('mbd_bench_reader', enable_rosout=False)
    for topic in topics:
        name, _, kind = topic.partition(':')
        node.create_subscription(message_class(kind), name, lambda _: None, 10, raw=True)
    with suppress(ExternalShutdownException):
        rclpy.spin(node)
