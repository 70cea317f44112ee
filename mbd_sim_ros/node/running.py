"""A scene that runs in a node: its loop, and what goes in and out at every step. It paces and publishes; it never integrates."""

from __future__ import annotations

import math
import time
import traceback
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock as ClockMessage
from std_msgs.msg import String

from mbd_sim_ros.bags.recorder import file_stem
from mbd_sim_ros.messages.encode import Messages
from mbd_sim_ros.node.commands import Commands
from mbd_sim_ros.node.loop import Loop
from mbd_sim_ros.node.publish import Publication
from mbd_sim_ros.node.recording import Recording
from solver.analysis.envelope import Envelope
from solver.errors import BagError, MbdError, SpecError
from solver.inputs.maneuver import COMMANDS, CommandSource
from solver.model.state import fitting, load_arrays
from solver.output.snapshot import Snapshot

CLOCK_SECONDS = 0.01  # /clock is published at most at 100 Hz


class Running:
    """Connects a simulation (solver.simulation.Simulation or alike) with the topics of a node; `start` starts it, `close` ends it.

    Raises MbdError.
    """

    def __init__(self, node: Node, scene: Any, simulation: Any) -> None:
        self.node, self.scene, self.simulation = node, scene, simulation
        self._priority = 0
        self._source = self._new_source()
        if self.value('restore'):
            self.restore(Path(self.value('restore')))
        self._messages = Messages.of(scene, simulation, self.value('frame_prefix'))
        self.envelope = Envelope(simulation)
        self.publish_every = self.value('publish_every')
        silent = () if self.value('publish_elements') else ('element_states', 'reactions')
        self._publication = Publication(
            node, self._messages.topics, self._messages.encode(simulation.snapshot(), whole=True), silent=silent
        )
        best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._ticks = node.create_publisher(ClockMessage, '/clock', best_effort) if self.value('publish_clock') else None
        self._ticked = (-math.inf, -math.inf)
        self._describe()
        self.recording = Recording(node, scene, simulation, self._messages, self.envelope, self._urdf)
        self.commands = Commands(node, deaf=self.value('commands') != 'topics')
        duration = self.value('duration') if self.value('duration') >= 0.0 else scene.duration
        self.loop = self.commands.loop = self.recording.loop = Loop(
            simulation,
            inputs=self._inputs,
            emit=self._emit,
            poll=self.commands.poll,
            repeat=lambda: self._publication.publish(self._messages.encode(simulation.snapshot())),
            mode=self.value('mode'),
            rate_factor=self.value('rate_factor'),
            end_ns=round(duration * 1e9) if duration > 0.0 else None,
            command_timeout=self.value('command_timeout'),
            lockstep_commands=tuple(COMMANDS.index(name) for name in self.value('lockstep_commands')),
        )
        self.loop.latched = self.loop.latched._replace(values=(float(self._source.state[0]), 0.0, 0.0))
        if self.value('record'):
            self.begin_recording(self.value('out'))

    def value(self, name: str) -> Any:
        """Return the value of a parameter."""
        return self.node.get_parameter(name).value

    def start(self) -> None:
        """Start the simulation thread."""
        self.loop.start()
        self.prefer()

    def prefer(self) -> None:
        """Real-time priority, but not for a loop that never waits: it would keep the processor for itself."""
        priority = self.value('realtime_priority') if self.loop.mode == 'realtime' else 0
        if priority != self._priority:
            if self.loop.prefer(priority):
                self._priority = priority
            else:
                self.node.get_logger().info(
                    'no permission for real-time priority (ulimit -r): beside other busy processes steps will be late'
                )

    def close(self, outcome: str) -> int:
        """End the simulation thread, finish the recording and return the exit code."""
        code = 0
        log = self.node.get_logger()
        self.loop.stop(outcome)
        self.commands.close()
        error = self.loop.error
        if isinstance(error, MbdError):
            log.error(str(error))
            code = error.exit_code
        elif error is not None:
            log.error('the simulation thread failed:\n' + ''.join(traceback.format_exception(error)))
            code = 1
        outcome = self.loop.outcome
        if error is None:
            self.recording.take_last()
        try:
            directory = self.recording.end(outcome)
            if directory:
                log.info(f'recorded {directory}')
        except BagError as failure:
            self.recording.failed = failure
            log.error(str(failure))
        seconds, reason = self.simulation.t_ns * 1e-9, 'failed' if error else outcome
        log.info(f'{reason}: t = {seconds:.3f} s, {self.loop.steps} steps, {self.loop.overruns} overruns')
        return code or (self.recording.failed.exit_code if self.recording.failed else 0)

    def _new_source(self) -> CommandSource:
        channels = self.simulation.channels
        at_start = dict(zip(channels.inputs, self.simulation.snapshot().inputs))
        return CommandSource(
            channels.inputs,
            self.simulation.h_ns,
            bandwidth=self.value('steering_bandwidth'),
            rate_limit=self.value('steering_rate_limit'),
            steering=float(at_start.get('steering', 0.0)),
        )

    def _describe(self) -> None:
        self._urdf = self.value('robot_description') or self.simulation.urdf()
        latched = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._description = self.node.create_publisher(String, 'robot_description', latched)
        self._description.publish(String(data=self._urdf))

    # -- on the simulation thread --------------------------------------------------------------------------------------

    def _inputs(self, values: tuple[float, float, float]) -> np.ndarray | None:
        return None if self.commands.deaf else self._source.advance(*values)

    def _emit(self, snapshot: Snapshot) -> None:
        self.envelope.look(snapshot)
        publish = snapshot.k % self.publish_every == 0
        record = self.recording.wants(snapshot)
        if publish or record:
            messages = self._messages.encode(snapshot)
            if publish:
                self._publication.publish(messages)
            if record:
                self.recording.take(snapshot, messages)
        if self._ticks is not None:
            self._publish_clock(self._ticks, snapshot.t_ns)

    def _publish_clock(self, publisher: Publisher, t_ns: int) -> None:
        now = time.monotonic()
        wall, simulated = self._ticked
        due = now - wall >= CLOCK_SECONDS and abs(t_ns * 1e-9 - simulated) >= CLOCK_SECONDS * 0.999
        if due or self.loop.mode == 'lockstep':  # in lockstep the others wait for every tick
            self._ticked = (now, t_ns * 1e-9)
            message = ClockMessage()
            message.clock.sec, message.clock.nanosec = divmod(t_ns, 1_000_000_000)
            publisher.publish(message)

    def begin_recording(self, out: str = '') -> Path:
        """Begin a recording; see Recording.begin."""
        directory = self.recording.begin(out)
        if self._priority:
            self.loop.prefer(self._priority)  # its thread has the priority of the one that made it
        return directory

    def reset(self) -> None:
        """Back to the start, bit for bit; a recording goes on in a new directory."""
        recording = self.recording.recorder is not None
        self.recording.end('reset')  # time starts anew: one recording is one run
        self.simulation.reset()
        self._source = self._new_source()
        if recording:
            self.begin_recording()
        self._ticked = (-math.inf, -math.inf)
        self.commands.poll()  # what was said before is of the past
        self.loop.restart()
        self.loop.latched = self.loop.latched._replace(values=(float(self._source.state[0]), 0.0, 0.0))

    def save(self) -> Path:
        """Write the state into a file in the current directory, and return that."""
        path = Path(f'{file_stem(self.scene.name)}-step{self.simulation.k}-{time.strftime("%Y%m%d-%H%M%S")}.state.npz')
        np.savez(path, simulation=np.frombuffer(self.simulation.save(), np.uint8), steering=self._source.state, scene=self.scene.hash)
        return path.resolve()

    def restore(self, path: Path) -> None:
        """Go on from a state file. Raises SpecError for one that is none, or of another scene."""
        try:
            saved = load_arrays(path.read_bytes() if path.is_file() else b'')
            data, steering, scene = saved['simulation'].tobytes(), saved['steering'], str(saved['scene'])
        except (OSError, KeyError, SpecError) as error:
            raise SpecError(f'parameter restore: {path} is not a state file of ~/save_state ({error})') from error
        if scene != self.scene.hash:
            raise SpecError(f'parameter restore: {path} belongs to another scene (hash {scene}, this one has {self.scene.hash})')
        self.simulation.restore(data)
        self._source.state = fitting('steering', steering, self._source.state)
