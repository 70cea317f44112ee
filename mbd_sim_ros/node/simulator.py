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
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger

from mbd_sim_ros.bags.recorder import Recorder, about, describe, new_directory
from mbd_sim_ros.messages.encode import Messages
from mbd_sim_ros.node.diagnostics import diagnosis
from mbd_sim_ros.node.loop import Loop
from mbd_sim_ros.node.parameters import PARAMETERS, declare, refusal
from mbd_sim_ros.node.publish import Publication
from solver.errors import BagError, MbdError, SpecError
from solver.inputs.maneuver import COMMANDS, CommandSource
from solver.output.snapshot import Snapshot

CLOCK_SECONDS = 0.01  # /clock is published at most at 100 Hz
WARN_SECONDS = 2.0  # a repeated warning about a command is said this often
REPLY_SECONDS = 30.0


class Simulator(Node):
    """Declares the parameters; `open` takes a simulation and connects it; `close` ends everything."""

    loop: Loop

    def __init__(self) -> None:
        # The node makes time; it must not wait for it.
        super().__init__('simulator', parameter_overrides=[Parameter('use_sim_time', value=False)])
        self.recorder: Recorder | None = None
        self.failed_recording: BagError | None = None
        declare(self)
        self._priority = 0
        self._ears: Node | None = None
        self._warned: dict[str, float] = {}

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
        channels = simulation.channels
        self._source = self._new_source()
        if self.value('restore'):
            self._restore(Path(self.value('restore')))
        self._messages = Messages(
            channels,
            frame_prefix=self.value('frame_prefix'),
            element_states=scene.record.elements,
            reactions=scene.record.reactions,
        )
        self._record_every = scene.record.every
        self._publish_every = self.value('publish_every')
        silent = () if self.value('publish_elements') else ('element_states', 'reactions')
        self._publication = Publication(self, self._messages.topics, self._messages.encode(simulation.snapshot()), silent=silent)
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
        publish = snapshot.k % self._publish_every == 0
        record = self.recorder is not None and snapshot.k % self._record_every == 0
        messages: Sequence[bytes | None] = ()
        if publish or record:
            full = self._messages.encode(snapshot)
            messages = full
            if publish:
                self._publication.publish(full)
        if self.recorder is not None:
            # What was applied is recorded in every step, or the run could not be replayed.
            self._record(snapshot.t_ns, messages if record else self._messages.encode_inputs(snapshot))
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

    def _record(self, t_ns: int, messages: Sequence[bytes | None]) -> None:
        assert self.recorder is not None
        try:
            self.recorder.write(t_ns, messages)
        except BagError as error:  # the simulation goes on; the exit code tells
            self.get_logger().error(str(error))
            self.failed_recording, self.recorder = error, None

    # -- recording -----------------------------------------------------------------------------------------------------

    def _new_recorder(self, out: str) -> Recorder:
        directory = Path(out) if out else new_directory(self.scene.name)
        metadata = describe(
            scene=self.scene.name,
            resolved_yaml=self.scene.resolved,
            seed=self.scene.seed,
            parameters={name: self.value(name) for name in PARAMETERS if name != 'robot_description'},
            namespace=self.get_namespace(),
            robot_description=self._urdf,
        ) | about(self.simulation, reactions=self.scene.record.reactions)
        namespace = self.get_namespace().rstrip('/')
        topics = [t if t.name.startswith('/') else t._replace(name=f'{namespace}/{t.name}') for t in self._messages.topics]
        recorder = Recorder(directory, topics, metadata, wait=False)
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
        return recorder.close({'end': outcome, **{key: str(value) for key, value in figures.items()}, 'event_list': events})

    # -- commands ------------------------------------------------------------------------------------------------------

    def _subscribe(self) -> None:
        """Subscribe to the commands on a node of their own, which no executor spins: the simulation thread takes the newest itself.

        An executor takes about 1 ms per message for its wait set, with the interpreter lock held; looking into the three
        subscriptions takes 20 us, and the command is used in the very next step.
        """
        self.value_commands = self.value('commands') == 'topics'
        self._inbox: list[tuple[Subscription, Callable[[Float64], None]]] = []
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
        names = ('steering_cmd', 'torque_cmd', 'brake_cmd')
        for index, (topic, limit) in enumerate(zip(names, ('max_steering', 'max_drive_torque', 'max_brake_torque'))):
            receive = self._command(index, topic, limit)
            full = self.resolve_topic_name(f'~/{topic}')
            self._inbox.append((self._ears.create_subscription(Float64, full, receive, newest), receive))

    def _poll(self) -> None:
        for subscription, receive in self._inbox:
            with subscription.handle:
                taken = subscription.handle.take_message(Float64, False)
            if taken is not None:
                receive(taken[0])

    def _command(self, index: int, topic: str, limit: str) -> Callable[[Float64], None]:
        def receive(message: Float64) -> None:
            if not math.isfinite(message.data):
                self._warn(f'{topic} not finite', f'{topic}: {message.data} is not a number; the command before it stays')
                return
            high = self.value(limit)
            value = min(max(message.data, 0.0 if topic == 'brake_cmd' else -high), high)
            if value != message.data:
                self._warn(topic, f'{topic}: {message.data:g} is beyond the limit; {value:g} is applied (parameter {limit})')
            self.loop.command(index, value)

        return receive

    def _warn(self, about: str, text: str) -> None:
        now = time.monotonic()
        if now - self._warned.get(about, -math.inf) >= WARN_SECONDS:
            self._warned[about] = now
            self.get_logger().warning(text)

    # -- services ------------------------------------------------------------------------------------------------------

    def _serve(self) -> None:
        services: dict[str, Callable[[], str]] = {
            'pause': self._pause,
            'resume': self._resume,
            'reset': self._reset,
            'step': self._step,
            'save_state': self._save,
            'start_recording': self._start_recording,
            'stop_recording': self._stop_recording,
        }
        for name, action in services.items():
            self.create_service(Trigger, f'~/{name}', self._service(action))

    def _service(self, action: Callable[[], str]) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
        def call(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                response.message = self.loop.ask(action).result(REPLY_SECONDS)
                response.success = True
            except TimeoutError:
                response.message = f'no answer from the simulation within {REPLY_SECONDS:g} s'
            except (MbdError, RuntimeError, OSError) as error:
                response.message = str(error)
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
        count = self.value('step_count')
        self.loop.step(count)
        return f'{count} steps from step {self.simulation.k}'

    def _save(self) -> str:
        path = Path(f'{self.scene.name}-step{self.simulation.k}-{time.strftime("%Y%m%d-%H%M%S")}.state.npz')
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
        if self.loop.stale:
            self._warn('stale', f'no torque_cmd for {self.loop.command_timeout:g} s: the drive torque is zero until one comes')
        status = diagnosis(self.loop, self.recorder, self.failed_recording)
        status.name = f'{self.get_fully_qualified_name()}: simulation'
        status.hardware_id = self.scene.name
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)
