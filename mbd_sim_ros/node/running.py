"""A scene that runs in a node: its loop, and what goes in and out at every step. It paces and publishes; it never integrates."""

from __future__ import annotations

import math
import time
import traceback
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock as ClockMessage
from std_msgs.msg import String

from mbd_sim_ros.bags.published import tell
from mbd_sim_ros.messages.cdr import ENCAPSULATION
from mbd_sim_ros.messages.encode import STAMP, Messages, require_finite
from mbd_sim_ros.messages.topics import ELEMENTS, MOTIONS
from mbd_sim_ros.node.commands import Commands, gears_of
from mbd_sim_ros.node.diagnostics import judged
from mbd_sim_ros.node.driving import Driving
from mbd_sim_ros.node.graph import SAID_HERE
from mbd_sim_ros.node.loop import Loop
from mbd_sim_ros.node.parameters import RATES
from mbd_sim_ros.node.publish import Publication
from mbd_sim_ros.node.recording import Recording
from solver.analysis.envelope import Envelope
from solver.errors import BagError, MbdError, SpecError
from solver.findings import Finding
from solver.inputs.hands import place_of
from solver.output.snapshot import Snapshot

if TYPE_CHECKING:
    from solver.scene import Scene
    from solver.simulation import Simulation

MIXED = 'who listens hears both, mixed; give one of the two a namespace (-r __ns:=/car2)'
JUMPS = (
    'time jumps back and forth for everybody with use_sim_time; set publish_clock to false in all simulators but one, or give each a '
    'ROS_DOMAIN_ID of its own'
)
CLOCK_SECONDS = 0.01  # between two messages on /clock at least, of elapsed and of simulated time


def heading_of(orientation: Sequence[float]) -> float:
    """Heading [rad] of a quaternion xyzw. Raises SpecError for one that is none."""
    x, y, z, w = orientation
    length = math.sqrt(x * x + y * y + z * z + w * w)
    if not 0.5 < length < 2.0:
        raise SpecError(f'orientation ({x}, {y}, {z}, {w}): must be a quaternion of length 1')
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def thinned(rate: float, h: float, of: int) -> int:
    """Steps of h [s] between messages at a rate of at most `rate` [Hz] (0: all of them), of which there is one every `of` steps."""
    return of * max(1, math.ceil(round(1.0 / (rate * of * h), 6))) if rate > 0.0 else 1


class Running:
    """Connects a simulation (solver.simulation.Simulation or alike) with the topics of a node; `start` starts it, `close` ends it.

    Raises MbdError.
    """

    def __init__(self, node: Node, scene: Scene, simulation: Simulation, *, first: bool = True) -> None:
        """first: of the node; others do not restore the state, nor record into the directory, that its parameters name."""
        self.node, self.scene, self.simulation = node, scene, simulation
        self._priority = 0
        self.driving = Driving(scene, simulation, self.value)
        lockstep = tuple(place_of(name, self.driving.names, scene.name) for name in self.value('lockstep_commands'))
        if first and self.value('restore') and (text := self.driving.restore(Path(self.value('restore')))):
            node.get_logger().warning(text)
        self._messages = Messages.of(scene, simulation, self.value('frame_prefix'))
        self.envelope = Envelope(simulation)
        self._urdf = self.value('robot_description') or simulation.urdf()
        with ExitStack() as refused:  # whatever does not start leaves nothing in the graph
            self._connect(lockstep, self.value('out') if first else '', refused)
            refused.pop_all()

    def _connect(self, lockstep: tuple[int, ...], out: str, refused: ExitStack) -> None:
        """Make what publishes, listens and records, in this order; the description, which is kept for who comes later, is the last."""
        node, scene, simulation = self.node, self.scene, self.simulation
        silent = () if self.value('publish_elements') else ('element_states', 'reactions')
        self._publication = Publication(
            node, self._messages.topics, self._messages.encode(simulation.snapshot(), whole=True), silent=silent
        )
        refused.callback(self._publication.close, node)
        self.look_at_rates()
        best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._ticks = node.create_publisher(ClockMessage, '/clock', best_effort, **SAID_HERE) if self.value('publish_clock') else None
        if self._ticks is not None:
            refused.callback(node.destroy_publisher, self._ticks)
        self._ticked = -math.inf  # clock reading [s] of the last
        self._tick = 0.0, 1  # seconds of simulated time and steps between two
        self.recording = Recording(node, scene, simulation, self._messages, self.envelope, self._urdf)
        self.commands = Commands(node, self.driving.names, ends=self.driving.ends, gears=gears_of(scene.model), deaf=self.driving.deaf)
        refused.callback(self.commands.close)
        duration = self.value('duration') if self.value('duration') >= 0.0 else scene.duration
        self.loop = self.commands.loop = self.recording.loop = self.driving.loop = Loop(
            simulation,
            inputs=self.driving.inputs,
            emit=self._emit,
            poll=self.commands.poll,
            hidden=self._hidden,
            passed=self._passed,
            repeat=self._repeat,
            mode=self.value('mode'),
            rate_factor=self.value('rate_factor'),
            end_ns=round(duration * 1e9) if duration > 0.0 else None,
            command_timeout=self.value('command_timeout'),
            commands=self.driving.names,
            lockstep_commands=lockstep,
            lockstep_every=self.value('lockstep_every'),
        )
        self.driving.latch()
        if self.value('record'):
            self.begin_recording(out)
        self._describe()

    def value(self, name: str) -> Any:
        """Return the value of a parameter."""
        return self.node.get_parameter(name).value

    def look_at_rates(self, changed: Mapping[str, Any] | None = None) -> None:
        """Take steps, rates and budget of publishing from the parameters, of which some are about to change.

        Of the steps that are published, and that have such a message, every so many are taken: the rate next to the one that is wanted.
        """
        names = ('publish_every', 'publish_budget', *(f'rate_{topic}' for topic in RATES))
        values = {name: self.value(name) for name in names} | dict(changed or {})
        self.publish_every = of = values['publish_every']
        self._budget = 1e-3 * values['publish_budget']
        h = self.simulation.h_ns * 1e-9
        record = self.scene.record
        apart = {ELEMENTS: record.elements_every(h), MOTIONS: record.motions_every(h) or 1}
        there = {topic: math.lcm(of, steps) for topic, steps in apart.items()}  # steps between messages
        every = {topic: thinned(values[f'rate_{topic}'], h, there.get(topic, of)) for topic in RATES}
        self._publication.every(every, self._messages.poses_every)

    def alone(self) -> Mapping[str, str]:
        """Full names of the topics that nobody else should publish, with what follows where somebody does."""
        clock = [] if self._ticks is None else [self._ticks.topic_name]
        return dict.fromkeys(self._publication.names(), MIXED) | dict.fromkeys(clock, JUMPS)

    @property
    def dropped(self) -> Mapping[str, int]:
        """Topic -> messages for which the budget of a step had no time."""
        return dict(self._publication.dropped)

    def start(self) -> None:
        """Start the simulation thread."""
        self.loop.start()
        self.prefer()
        self.warn_of_lockstep()
        if self.driving.uncommanded and not self.driving.deaf:
            held = f'no command is for {", ".join(self.driving.uncommanded)}: held as at the start'
            self.node.get_logger().warning(f'{held}; with the parameter commands = maneuver the maneuver of the scene drives')

    def warn_of_lockstep(self) -> None:
        """Say where nothing but ~/step will make a step, or where what drives ends before the answer that commands it."""
        loop = self.loop
        if loop.mode != 'lockstep':
            return
        if self.driving.deaf:
            self.node.get_logger().warning(
                "mode lockstep waits for commands, and the parameter commands = 'maneuver' has the node listen to none: only ~/step makes "
                'steps; use commands:=topics and the node maneuver, or another mode'
            )
        held = loop.lockstep_every * self.simulation.h_ns * 1e-9
        if loop.lockstep_every > 1 and 0.0 < loop.command_timeout < held:
            self.node.get_logger().warning(
                f'lockstep_every = {loop.lockstep_every} steps are {held:g} s, and after command_timeout = {loop.command_timeout:g} s '
                'drive torque and accelerator count as zero: answer more often, or set command_timeout to 0'
            )

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
        for finding in judged(self.simulation, self.envelope, ended=True):
            log.warning(f'suspect: {finding}')
        try:
            directory = self.recording.end(outcome)
            if directory:
                log.info(f'recorded {directory}')
        except BagError as failed:
            log.error(str(failed))
        seconds, reason = self.simulation.t_ns * 1e-9, 'failed' if error else outcome
        log.info(f'{reason}: t = {seconds:.3f} s, {self.loop.steps} steps, {self.loop.overruns} overruns')
        failure = self.recording.first_failure
        return code or (failure.exit_code if failure else 0)

    def disconnect(self) -> None:
        """Publish no more."""
        self._publication.close(self.node)
        for publisher in (self._ticks, *self._descriptions):
            if publisher is not None:
                self.node.destroy_publisher(publisher)

    def _describe(self) -> None:
        """Say once, also to who comes later, what runs: the spanning tree as URDF, and the whole scene as text."""
        latched = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        told = {'robot_description': self._urdf, '~/scene': tell(self.scene, self.simulation)}
        self._descriptions = [self.node.create_publisher(String, topic, latched, **SAID_HERE) for topic in told]
        for publisher, text in zip(self._descriptions, told.values(), strict=True):
            publisher.publish(String(data=text))

    # -- on the simulation thread --------------------------------------------------------------------------------------

    def _hidden(self, most: int) -> int:
        """How many of the next steps, at most so many, nobody sees: not published, not recorded, while nobody commands or assists."""
        lockstep = self.loop.mode == 'lockstep'  # which does not look for commands in these steps
        if self.driving.assistant is not None or (self.commands.commanded and not lockstep):
            return 0
        k = self.simulation.k
        seen = self._publication.next_awaited(k, most + 1, of=self.publish_every, lockstep=lockstep)
        seen = min(seen, self.recording.next_wanted(k, most + 1))
        if self._ticks is not None and self._ticks.get_subscription_count():
            every = self._tick_every()
            seen = min(seen, k - k % every + every)
        return seen - k - 1

    def _passed(self) -> None:
        applied = self.simulation.applied
        assert applied is not None  # a node steps with engines that take inputs
        self.recording.note(self.simulation.k, applied)

    def _emit(self, snapshot: Snapshot) -> None:
        self.envelope.look(snapshot)
        mode, of = self.loop.mode, self.publish_every
        waits = self.loop.waits if mode == 'lockstep' else None
        publish = self._publication.awaited(snapshot.k, of=of, waits=waits) if waits or snapshot.k % of == 0 else ()
        record = self.recording.wants(snapshot)
        if publish or record:
            messages = self._messages.encode(snapshot, only=None if record else publish)
            if publish:
                self._publication.publish(messages, snapshot.k, self._budget if mode == 'realtime' else 0.0, of=of, waits=waits)
            if record:
                self.recording.take(snapshot, messages)
        else:
            require_finite(snapshot, self._messages.channels)
        if self._ticks is not None:
            self._publish_clock(self._ticks, snapshot, anyway=bool(waits))

    def _repeat(self) -> None:
        """Publish the present state, all of it, whoever hears it and whatever the rates."""
        snapshot = self.simulation.snapshot()
        self._publication.publish(self._messages.encode(snapshot, whole=True), waits=True)
        if self._ticks is not None:
            self._publish_clock(self._ticks, snapshot, anyway=True)

    def _tick_every(self) -> int:
        """Steps between two messages on /clock, from step 0: they are due with other topics, for waking costs more than steps."""
        seconds = CLOCK_SECONDS * (max(1.0, self.loop.rate_factor) if self.loop.mode == 'realtime' else 1.0)
        if self._tick[0] != seconds:
            self._tick = seconds, max(1, math.ceil(round(seconds * 1e9 / self.simulation.h_ns, 6)))
        return self._tick[1]

    def _publish_clock(self, publisher: Publisher, snapshot: Snapshot, *, anyway: bool = False) -> None:
        mode = self.loop.mode
        # at the start whatever its step; in lockstep the others wait for the tick of every state that waits
        anyway = anyway or self._ticked == -math.inf
        if not anyway and (snapshot.k % self._tick_every() or not publisher.get_subscription_count()):
            return
        now = time.monotonic()
        if anyway or mode != 'fast' or now - self._ticked >= CLOCK_SECONDS:
            self._ticked = now
            publisher.publish(ENCAPSULATION + STAMP.pack(*divmod(snapshot.t_ns, 1_000_000_000)))

    def begin_recording(self, out: str = '') -> Path:
        """Begin a recording; see Recording.begin. Raises BagError."""
        directory = self.recording.begin(out)
        if self._priority:
            self.loop.prefer(self._priority)  # its thread has the priority of the one that made it
        return directory

    def reset(self, *, time: bool = True, state: bool = True) -> str:
        """Back to the start, bit for bit; a recording goes on in a new directory. time, state: only that of the two."""
        recording, simulation = self.recording.recorder is not None, self.simulation
        said = self._end_recording('reset')  # time starts anew: one recording is one run
        k = simulation.k
        if state:
            simulation.reset()
            self.driving.begin_anew()
        if not (time and state):
            simulation.renumber(0 if time else k)
        if recording:
            said += self._go_on_recording()
        self._ticked = -math.inf
        self.envelope.restart()
        self.commands.poll()  # what was said before is of the past
        self.driving.go_on(moving=not state)
        self.loop.restart()
        self.driving.latch()
        return f'back at t = {simulation.t_ns * 1e-9:g}' + ('' if state else ', in motion as it was') + said

    def _end_recording(self, outcome: str, found: list[Finding] | None = None, last: Snapshot | None = None) -> str:
        """End a recording for another; what an answer has to say of it. found, last: see Recording.end."""
        try:
            self.recording.end(outcome, found, last)
        except BagError as error:
            self.node.get_logger().error(str(error))
            return f'; what was recorded is not whole: {error}'
        return ''

    def _go_on_recording(self) -> str:
        """Begin a recording behind another; what an answer has to say of it."""
        try:
            self.begin_recording()
        except BagError as error:
            self.node.get_logger().error(str(error))
            return f'; nothing is recorded any more: {error}'
        return ''

    def place(self, x: float, y: float, orientation: Sequence[float], frame: str = '') -> str:
        """Move the vehicle to x, y [m] and the heading of a quaternion xyzw, and show it; a recording goes on in a new directory.

        frame: in which they are given: none, map, or odom with its prefix, which are all the world. Raises SpecError.
        """
        odom = self.value('frame_prefix') + 'odom'
        if frame not in ('', 'map', odom):
            raise SpecError(f'frame {frame!r}: a place is taken in map or {odom} only; set the fixed frame of who sends it')
        heading = heading_of(orientation)
        if not (math.isfinite(x) and math.isfinite(y)):
            raise SpecError(f'x = {x}, y = {y}: a place must be two numbers')
        found, last = self.recording.found(), self.simulation.snapshot()  # behind the placing both are others
        self.simulation.place(x, y, heading)
        said = ''
        if self.recording.recorder is not None:
            said = self._end_recording('placed elsewhere', found, last) + self._go_on_recording()
        snapshot = self.simulation.snapshot()
        if self.recording.wants(snapshot):
            self.recording.take(snapshot)
        self._repeat()  # paused, or with few messages, it would be seen late
        return f'placed at x = {x:.3f} m, y = {y:.3f} m, heading {math.degrees(heading):.2f} deg{said}'
