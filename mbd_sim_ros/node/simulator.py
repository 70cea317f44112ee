"""The ROS node `simulator`: topics, services, parameters and diagnostics around a Loop. It paces and publishes; it never integrates."""

from __future__ import annotations

import json
import math
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger

from mbd_sim_ros.bags.applied import begin_of
from mbd_sim_ros.bags.recorder import StepRecorder, about, describe, file_stem, new_directory
from mbd_sim_ros.messages.encode import Messages
from mbd_sim_ros.node.diagnostics import diagnosis, judged
from mbd_sim_ros.node.loop import Loop
from mbd_sim_ros.node.parameters import PARAMETERS, declare, refusal, unknown
from mbd_sim_ros.node.publish import Publication
from solver.analysis.envelope import Envelope
from solver.analysis.verdict import OK, SUSPECT, report
from solver.errors import BagError, MbdError, SpecError, suggestion
from solver.inputs.maneuver import COMMANDS, CommandSource
from solver.output.snapshot import Snapshot

CLOCK_SECONDS = 0.01  # /clock is published at most at 100 Hz
WARN_SECONDS = 2.0  # a repeated warning about a command is said this often
REPLY_SECONDS = 30.0
PLAIN = ('steering_cmd', 'torque_cmd', 'brake_cmd')  # topics of the COMMANDS
LIMITS = ('max_steering', 'max_drive_torque', 'max_brake_torque')  # parameters that limit them
SERVICES = {
    'pause': 'hold the simulation',
    'resume': 'go on',
    'reset': 'back to the start, bit for bit; a recording goes on in a new directory',
    'step': 'do `step_count` steps while paused or in lockstep',
    'save_state': 'write the state into a file in the current directory, for the parameter `restore`',
    'start_recording': 'record into a new directory',
    'stop_recording': 'finish the recording',
}


class Simulator(Node):
    """Declares the parameters; `open` takes a simulation and connects it; `close` ends everything."""

    loop: Loop

    def __init__(self) -> None:
        # The node makes time; it must not wait for it.
        super().__init__('simulator', parameter_overrides=[Parameter('use_sim_time', value=False)])
        self.recorder: StepRecorder | None = None
        self.failed_recording: BagError | None = None
        declare(self)
        for sentence in unknown(self):
            self.get_logger().warning(sentence)
        self._priority = 0
        self._ears: Node | None = None
        self._warned: dict[str, float] = {}
        self._refused = 0  # commands that were no numbers, or named no input
        self._stale_said = False
        self._namesakes = 0
        self._stamps = False  # somebody publishes stamped commands
        self._written = -1  # step whose messages were recorded last

    # -- parameters ----------------------------------------------------------------------------------------------------

    def value(self, name: str) -> Any:
        """Return the value of a parameter."""
        return self.get_parameter(name).value

    def _on_set(self, parameters: list[Parameter]) -> SetParametersResult:
        reason = refusal(parameters)
        if reason:
            return SetParametersResult(successful=False, reason=reason)
        for parameter in parameters:
            if parameter.name in ('mode', 'rate_factor', 'command_timeout'):
                setattr(self.loop, parameter.name, parameter.value)
                self._prefer()
            elif parameter.name == 'publish_every':
                self._publish_every = parameter.value
        return SetParametersResult(successful=True)

    # -- start and end -------------------------------------------------------------------------------------------------

    def open(self, scene: Any, simulation: Any) -> None:
        """Connect a simulation (solver.simulation.Simulation or alike) and start it. Raises MbdError."""
        self.scene, self.simulation = scene, simulation
        self._source = self._new_source()
        if self.value('restore'):
            self._restore(Path(self.value('restore')))
        self._messages = Messages.of(scene, simulation, self.value('frame_prefix'))
        self._record_every = scene.record.every
        self._envelope = Envelope(simulation)
        self._publish_every = self.value('publish_every')
        silent = () if self.value('publish_elements') else ('element_states', 'reactions')
        self._publication = Publication(
            self, self._messages.topics, self._messages.encode(simulation.snapshot(), whole=True), silent=silent
        )
        best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._ticks = self.create_publisher(ClockMessage, '/clock', best_effort) if self.value('publish_clock') else None
        self._ticked = (-math.inf, -math.inf)
        self._describe()
        duration = self.value('duration') if self.value('duration') >= 0.0 else scene.duration
        self.loop = Loop(
            simulation,
            inputs=self._inputs,
            emit=self._emit,
            poll=self._poll,
            repeat=lambda: self._publication.publish(self._messages.encode(simulation.snapshot())),
            mode=self.value('mode'),
            rate_factor=self.value('rate_factor'),
            end_ns=round(duration * 1e9) if duration > 0.0 else None,
            command_timeout=self.value('command_timeout'),
            lockstep_commands=tuple(COMMANDS.index(name) for name in self.value('lockstep_commands')),
        )
        self.loop.latched = self.loop.latched._replace(values=(float(self._source.state[0]), 0.0, 0.0))
        if self.value('record'):
            self.recorder = self._new_recorder(self.value('out'))
        self.add_on_set_parameters_callback(self._on_set)
        self._subscribe()
        self._serve()
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self.create_timer(1.0, self._diagnose, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.loop.start()
        self._prefer()

    def _prefer(self) -> None:
        """Real-time priority, but not for a loop that never waits: it would keep the processor for itself."""
        priority = self.value('realtime_priority') if self.loop.mode == 'realtime' else 0
        if priority != self._priority:
            if self.loop.prefer(priority):
                self._priority = priority
            else:
                self.get_logger().info('no permission for real-time priority (ulimit -r): beside other busy processes steps will be late')

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
        self._description = self.create_publisher(String, 'robot_description', latched)
        self._description.publish(String(data=self._urdf))

    def close(self, outcome: str) -> int:
        """End the simulation thread, finish the recording and return the exit code. May be called when `open` failed or never ran."""
        code = 0
        if hasattr(self, 'loop'):
            self.loop.stop(outcome)
            if self._ears is not None:
                self._ears.destroy_node()
            error = self.loop.error
            if isinstance(error, MbdError):
                self.get_logger().error(str(error))
                code = error.exit_code
            elif error is not None:
                self.get_logger().error('the simulation thread failed:\n' + ''.join(traceback.format_exception(error)))
                code = 1
            outcome = self.loop.outcome
            if self.recorder is not None and error is None and self._written != self.simulation.k:
                self._record_step(self.simulation.snapshot())
        try:
            directory = self._end_recording(outcome)
            if directory:
                self.get_logger().info(f'recorded {directory}')
        except BagError as failure:
            self.failed_recording = failure
            self.get_logger().error(str(failure))
        if hasattr(self, 'loop'):
            loop, seconds = self.loop, self.simulation.t_ns * 1e-9
            reason = 'failed' if loop.error else outcome
            self.get_logger().info(f'{reason}: t = {seconds:.3f} s, {loop.steps} steps, {loop.overruns} overruns')
        return code or (self.failed_recording.exit_code if self.failed_recording else 0)

    # -- on the simulation thread --------------------------------------------------------------------------------------

    def _inputs(self, values: tuple[float, float, float]) -> np.ndarray | None:
        return self._source.advance(*values) if self.value_commands else None

    def _emit(self, snapshot: Snapshot) -> None:
        self._envelope.look(snapshot)
        publish = snapshot.k % self._publish_every == 0
        record = self.recorder is not None and snapshot.k % self._record_every == 0
        if self.recorder is not None:
            self.recorder.note(snapshot.k, snapshot.inputs[None])  # of every step, or the run could not be replayed
        if publish or record:
            messages = self._messages.encode(snapshot)
            if publish:
                self._publication.publish(messages)
            if record:
                self._record_step(snapshot, messages)
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

    def _record_step(self, snapshot: Snapshot, messages: Sequence[bytes | None] | None = None) -> None:
        assert self.recorder is not None
        self._written = snapshot.k
        try:
            self.recorder.record(snapshot.t_ns, messages or self._messages.encode(snapshot))
        except BagError as error:  # the simulation goes on; the exit code tells
            self.get_logger().error(str(error))
            self.failed_recording, self.recorder = error, None

    # -- recording -----------------------------------------------------------------------------------------------------

    def _new_recorder(self, out: str) -> StepRecorder:
        """Begin a recording with the state of now; for the simulation thread, or before there is one."""
        directory = Path(out) if out else new_directory(self.scene.name)
        metadata = describe(
            scene=self.scene.name,
            resolved_yaml=self.scene.resolved,
            seed=self.scene.seed,
            parameters={name: self.value(name) for name in PARAMETERS if name != 'robot_description'},
            namespace=self.get_namespace(),
            robot_description=self._urdf,
        )
        metadata |= about(self.simulation, reactions=self.scene.record.reactions) | begin_of(self.simulation)
        recorder = StepRecorder(
            directory, self._messages.topics, self.simulation.channels.inputs, self.simulation.k, metadata,
            namespace=self.get_namespace(), wait=False,
        )  # fmt: skip
        if self._priority:
            self.loop.prefer(self._priority)  # its thread has the priority of the one that made it
        self.get_logger().info(f'recording into {directory}')
        return recorder

    def _end_recording(self, outcome: str) -> Path | None:
        recorder, self.recorder = self.recorder, None
        if recorder is None:
            return None
        loop = self.loop
        figures = {'steps': loop.steps, 'overruns': loop.overruns, 'schedule_slips': loop.slips, 'wall_time': f'{loop.wall_time:.3f}'}
        events = json.dumps([event._asdict() for event in self.simulation.events])
        found = judged(self.simulation, self._envelope)
        status = 'error' if loop.error else SUSPECT if found else OK
        verdict = {'end': outcome, 'status': status, 'findings': json.dumps(report(found))}
        return recorder.close({**verdict, **{key: str(value) for key, value in figures.items()}, 'event_list': events})

    # -- commands ------------------------------------------------------------------------------------------------------

    def _subscribe(self) -> None:
        """Subscribe to the commands on a node of their own, which no executor spins: the simulation thread takes the newest itself.

        An executor takes about 1 ms per message for its wait set, with the interpreter lock held; looking into the three
        subscriptions takes 20 us, and the command is used in the very next step.
        """
        self.value_commands = self.value('commands') == 'topics'
        self._inbox: list[tuple[Subscription, type, Callable[[Any], None]]] = []
        if not self.value_commands:
            return
        self._ears = Node(
            f'{self.get_name()}_commands',
            namespace=self.get_namespace(),
            use_global_arguments=False,
            start_parameter_services=False,
            enable_rosout=False,
        )
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
        for index, name in enumerate(PLAIN):
            receive = self._plain(index, name)
            full = self.resolve_topic_name(f'~/{name}')
            self._inbox.append((self._ears.create_subscription(Float64, full, receive, newest), Float64, receive))
        several = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)  # an old answer must not push the right one out
        full = self.resolve_topic_name('~/lockstep_cmd')
        self._answers = self._ears.create_subscription(JointState, full, self._stamped, several)

    def _poll(self) -> None:
        for subscription, kind, receive in self._inbox:
            message = _take(subscription, kind)
            if message is not None:
                receive(message)
        if self.value_commands and (self._stamps or self.loop.mode == 'lockstep'):
            for _ in range(10):
                message = _take(self._answers, JointState)
                if message is None:
                    return
                self._stamped(message)

    def _plain(self, index: int, topic: str) -> Callable[[Float64], None]:
        def receive(message: Float64) -> None:
            value = self._accepted(index, topic, message.data)
            if value is not None:
                self.loop.command(index, value)

        return receive

    def _stamped(self, message: JointState) -> None:
        """Commands by the names of the inputs, that answer the state of header.stamp."""
        values: dict[int, float] = {}
        if len(message.name) != len(message.position) or not message.name:
            self._refuse('lockstep_cmd', f'lockstep_cmd: {len(message.name)} names, {len(message.position)} positions; give one for each')
            return
        for name, number in zip(message.name, message.position):
            if name not in COMMANDS:
                self._refuse('lockstep_cmd', f'lockstep_cmd: {name!r} is no command{suggestion(name, COMMANDS)}')
                return
            index = COMMANDS.index(name)
            value = self._accepted(index, f'lockstep_cmd: {name}', number)
            if value is None:
                return
            values[index] = value
        t_ns = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        if not self.loop.answer(t_ns, values):
            now = self.simulation.t_ns
            self._warn('answer', f'lockstep_cmd answers t = {t_ns * 1e-9:.6f} s, the state that is waiting is that of {now * 1e-9:.6f} s')

    def _accepted(self, index: int, what: str, number: float) -> float | None:
        """The command within its limits; None for one that is not a number."""
        if not math.isfinite(number):
            self._refuse(f'{what} not finite', f'{what}: {number} is not a number; the command before it stays')
            return None
        limit = LIMITS[index]
        high = self.value(limit)
        value = min(max(number, 0.0 if COMMANDS[index] == 'brake_torque' else -high), high)
        if value != number:
            self._warn(what, f'{what}: {number:g} is beyond the limit; {value:g} is applied (parameter {limit})')
        return value

    def _refuse(self, about: str, text: str) -> None:
        self._refused += 1
        self._warn(about, text)

    def _warn(self, about: str, text: str) -> None:
        now = time.monotonic()
        if now - self._warned.get(about, -math.inf) >= WARN_SECONDS:
            self._warned[about] = now
            self.get_logger().warning(text)

    # -- services ------------------------------------------------------------------------------------------------------

    def _serve(self) -> None:
        actions: dict[str, Callable[[], str]] = {
            'pause': self._pause,
            'resume': self._resume,
            'reset': self._reset,
            'step': self._step,
            'save_state': self._save,
            'start_recording': self._start_recording,
            'stop_recording': self._stop_recording,
        }
        for name in SERVICES:
            self.create_service(Trigger, f'~/{name}', self._service(name, actions[name]))

    def _service(self, name: str, action: Callable[[], str]) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
        def call(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                response.message = self.loop.ask(action).result(REPLY_SECONDS)
                response.success = True
                self.get_logger().info(f'{name}: {response.message}')
            except TimeoutError:
                response.message = f'no answer from the simulation within {REPLY_SECONDS:g} s'
            except (MbdError, RuntimeError, OSError) as error:
                response.message = str(error)
            if not response.success:
                self.get_logger().warning(f'{name} refused: {response.message}')
            return response

        return call

    def _pause(self) -> str:
        self.loop.pause()
        return f'paused at t = {self.simulation.t_ns * 1e-9:.6f} s, step {self.simulation.k}'

    def _resume(self) -> str:
        self.loop.resume()
        return 'running'

    def _reset(self) -> str:
        recording = self.recorder is not None
        self._end_recording('reset')  # time starts anew: one recording is one run
        self.simulation.reset()
        self._source = self._new_source()
        if recording:
            self.recorder = self._new_recorder('')
        self._ticked = (-math.inf, -math.inf)
        self._poll()  # what was said before is of the past
        self.loop.restart()
        self.loop.latched = self.loop.latched._replace(values=(float(self._source.state[0]), 0.0, 0.0))
        return 'back at t = 0'

    def _step(self) -> str:
        if not self.loop.paused and self.loop.mode != 'lockstep':
            raise SpecError(f'the simulation is running (mode {self.loop.mode}): call ~/pause before ~/step, or use mode lockstep')
        count = self.value('step_count')
        self.loop.step(count)
        return f'{count} steps from step {self.simulation.k}'

    def _save(self) -> str:
        path = Path(f'{file_stem(self.scene.name)}-step{self.simulation.k}-{time.strftime("%Y%m%d-%H%M%S")}.state.npz')
        np.savez(path, simulation=np.frombuffer(self.simulation.save(), np.uint8), steering=self._source.state, scene=self.scene.hash)
        return str(path.resolve())

    def _restore(self, path: Path) -> None:
        try:
            with np.load(path) as saved:
                data, steering, scene = saved['simulation'].tobytes(), saved['steering'], str(saved['scene'])
        except (OSError, KeyError, ValueError) as error:
            raise SpecError(f'parameter restore: {path} is not a state file of ~/save_state ({error})') from error
        if scene != self.scene.hash:
            raise SpecError(f'parameter restore: {path} belongs to another scene (hash {scene}, this one has {self.scene.hash})')
        self.simulation.restore(data)
        self._source.state = steering

    def _start_recording(self) -> str:
        if self.recorder is not None:
            raise BagError(f'already recording into {self.recorder.directory}')
        recorder = self._new_recorder('')
        self.recorder = recorder
        return str(recorder.directory)

    def _stop_recording(self) -> str:
        directory = self._end_recording('stopped by request')
        if directory is None:
            raise BagError('nothing is being recorded')
        return str(directory)

    # -- diagnostics ---------------------------------------------------------------------------------------------------

    def _diagnose(self) -> None:
        if self.loop.stale and not self._stale_said:
            self.get_logger().warning(f'no torque_cmd for {self.loop.command_timeout:g} s: the drive torque is zero until one comes')
        self._stale_said = self.loop.stale
        self._stamps = self.count_publishers(self.resolve_topic_name('~/lockstep_cmd')) > 0
        full = self.get_fully_qualified_name()
        namesakes = [f'{space.rstrip("/")}/{name}' for name, space in self.get_node_names_and_namespaces()].count(full) - 1
        if namesakes > self._namesakes:
            self.get_logger().warning(f'another node is called {full}: both take the commands and publish the same topics; rename one')
        self._namesakes = max(namesakes, 0)
        status = diagnosis(
            self.loop, self.recorder, self.failed_recording, refused=self._refused, namesakes=self._namesakes, envelope=self._envelope
        )
        status.name = f'{self.get_fully_qualified_name()}: simulation'
        status.hardware_id = self.scene.name
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)


def _take(subscription: Subscription, kind: type) -> Any:
    """The next message of a subscription that no executor spins, or None."""
    with subscription.handle:
        taken = subscription.handle.take_message(kind, False)
    return None if taken is None else taken[0]
