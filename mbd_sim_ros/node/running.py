"""A scene that runs in a node: its loop, and what goes in and out at every step. It paces and publishes; it never
integrates."""

from __future__ import annotations

import math
import traceback
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

from mbd_sim_ros.bags.published import tell
from mbd_sim_ros.messages.encode import Messages
from mbd_sim_ros.messages.topics import ELEMENTS, ENERGY, MOTIONS
from mbd_sim_ros.node.audience import Audience
from mbd_sim_ros.node.commands import Commands
from mbd_sim_ros.node.diagnostics import judged
from mbd_sim_ros.node.driving import Driving
from mbd_sim_ros.node.gearbox import gears_of
from mbd_sim_ros.node.graph import SAID_HERE
from mbd_sim_ros.node.latch import Latch
from mbd_sim_ros.node.loop import Loop
from mbd_sim_ros.node.pace import Pace
from mbd_sim_ros.node.parameters import PACING, RATES
from mbd_sim_ros.node.publish import Publication
from mbd_sim_ros.node.recording import Recording
from mbd_sim_ros.node.ticks import Ticks
from solver.analysis.envelope import Envelope
from solver.analysis.kept_errors import NONE, kept
from solver.errors import BagError, MbdError, SpecError
from solver.findings import Finding
from solver.inputs.command_filter import commands_of, place_of
from solver.output.snapshot import Snapshot

if TYPE_CHECKING:
    from solver.scene import Scene
    from solver.simulation import Simulation

MIXED = 'who listens hears both, mixed; give one of the two a namespace (-r __ns:=/car2)'
JUMPS = (
    'time jumps back and forth for everybody with use_sim_time; set publish_clock to false in all simulators but one, '
    'or give each a ROS_DOMAIN_ID of its own'
)


def heading_of(orientation: Sequence[float]) -> float:
    """Heading [rad] of a quaternion xyzw. Raises SpecError for one that is none."""
    x, y, z, w = orientation
    length = math.sqrt(x * x + y * y + z * z + w * w)
    if not 0.5 < length < 2.0:
        raise SpecError(f'orientation ({x}, {y}, {z}, {w}): must be a quaternion of length 1')
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def thinned(rate: float, h: float, of: int) -> int:
    """Steps of h [s] between messages at a rate of at most `rate` [Hz] (0: all of them), of which there is one every
    `of` steps."""
    return of * max(1, math.ceil(round(1.0 / (rate * of * h), 6))) if rate > 0.0 else 1


class Running:
    """Connects a simulation (solver.simulation.Simulation or alike) with the topics of a node; `start` starts it,
    `close` ends it.

    Raises MbdError.
    """

    def __init__(self, node: Node, scene: Scene, simulation: Simulation, *, first: bool = True) -> None:
        """first: of the node; others do not restore the state, nor record into the directory, that its parameters
        name."""
        self.node, self.scene, self.simulation = node, scene, simulation
        self._priority = 0
        names = commands_of(simulation.channels.inputs, scene.actuation.steering)
        lockstep = tuple(place_of(name, names, scene.name) for name in self.value('lockstep_commands'))
        live = {name: self.value(name) for name in PACING}
        self.latch = Latch(simulation, Pace(lockstep_commands=lockstep, **live), names)
        self.driving = Driving(scene, simulation, self.latch, self.value)
        if first and self.value('restore') and (text := self.driving.restore(Path(self.value('restore')))):
            node.get_logger().warning(text)
        self.envelope = Envelope(simulation)
        # a stand-in has no scene of its own
        self.error = kept(simulation.scene) if hasattr(simulation, 'engine') else NONE
        self._urdf = self.value('robot_description') or simulation.urdf()
        with ExitStack() as refused:  # whatever does not start leaves nothing in the graph
            self._connect(self.value('out') if first else '', refused)
            refused.pop_all()

    def _connect(self, out: str, refused: ExitStack) -> None:
        """Make what publishes, listens and records, in this order; the description, which is kept for who comes later,
        is the last."""
        node, scene, simulation, driving = self.node, self.scene, self.simulation, self.driving
        self._messages = messages = Messages.of(scene, simulation, self.value('frame_prefix'))
        silent = () if self.value('publish_elements') else ('element_states', 'reactions')
        samples = messages.encode(simulation.snapshot(), whole=True)
        self._publication = Publication(node, messages.topics, samples, silent=silent)
        refused.callback(self._publication.close, node)
        self._ticks = Ticks(node, self.latch.pace, simulation.h_ns) if self.value('publish_clock') else None
        if self._ticks is not None:
            refused.callback(node.destroy_publisher, self._ticks.publisher)
        self.recording = Recording(node, scene, simulation, messages, self.envelope, self._urdf)
        self.commands = Commands(node, self.latch, ends=driving.ends, gears=gears_of(scene.model), deaf=driving.deaf)
        refused.callback(self.commands.close)
        self.audience = Audience(
            simulation,
            messages,
            self.latch,
            publication=self._publication,
            recording=self.recording,
            ticks=self._ticks,
            envelope=self.envelope,
            commands=self.commands,
            assisted=driving.assistant is not None,
        )
        self.look_at_rates()
        duration = self.value('duration') if self.value('duration') >= 0.0 else scene.duration
        self.loop = Loop(
            simulation,
            self.latch,
            inputs=driving.inputs,
            emit=self.audience.show,
            poll=self.commands.poll,
            hidden=self.audience.hidden,
            passed=self.audience.passed,
            repeat=self.audience.repeat,
            end_ns=round(duration * 1e9) if duration > 0.0 else None,
        )
        driving.hold()
        if self.value('record'):
            self.begin_recording(out)
        self._describe()

    def value(self, name: str) -> Any:
        """Return the value of a parameter."""
        return self.node.get_parameter(name).value

    def look_at_rates(self, changed: Mapping[str, Any] | None = None) -> None:
        """Take steps, rates and budget of publishing from the parameters, of which some are about to change.

        Every so many of the steps that are published, and that have such a message, are taken: the rate next to the one
        that is wanted.
        """
        names = ('publish_every', 'publish_budget', *(f'rate_{topic}' for topic in RATES))
        values = {name: self.value(name) for name in names} | dict(changed or {})
        of = values['publish_every']
        self.audience.budget = 1e-3 * values['publish_budget']
        h = self.simulation.h_ns * 1e-9
        record = self.scene.record
        apart = {ELEMENTS: record.elements_every(h), MOTIONS: record.motions_every(h) or 1}
        apart[ENERGY] = record.energies_every(h) or 1
        there = {topic: math.lcm(of, steps) for topic, steps in apart.items()}  # steps between messages
        every = {topic: thinned(values[f'rate_{topic}'], h, there.get(topic, of)) for topic in RATES}
        self._publication.every(every, self._messages.poses_every, of)

    def alone(self) -> Mapping[str, str]:
        """Full names of the topics that nobody else should publish, with what follows where somebody does."""
        clock = [] if self._ticks is None else [self._ticks.publisher.topic_name]
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
            self.node.get_logger().warning(
                f'{held}; with the parameter commands = maneuver the maneuver of the scene drives'
            )

    def warn_of_lockstep(self) -> None:
        """Say where nothing but ~/step will make a step, or where what drives ends before the answer that commands
        it."""
        pace = self.latch.pace
        if not pace.lockstep:
            return
        if self.driving.deaf:
            self.node.get_logger().warning(
                "mode lockstep waits for commands, and the parameter commands = 'maneuver' has the node listen to "
                'none: only ~/step makes steps; use commands:=topics and the node maneuver, or another mode'
            )
        held = pace.lockstep_every * self.simulation.h_ns * 1e-9
        if pace.lockstep_every > 1 and 0.0 < pace.command_timeout < held:
            self.node.get_logger().warning(
                f'lockstep_every = {pace.lockstep_every} steps are {held:g} s, and after command_timeout = '
                f'{pace.command_timeout:g} s drive torque and accelerator count as zero: answer more often, or set '
                'command_timeout to 0'
            )

    def prefer(self) -> None:
        """Real-time priority, but not for a loop that never waits: it would keep the processor for itself."""
        priority = self.value('realtime_priority') if self.latch.pace.mode == 'realtime' else 0
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
            directory = self.recording.end(self.loop, outcome)
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
        for publisher in (*([] if self._ticks is None else [self._ticks.publisher]), *self._descriptions):
            self.node.destroy_publisher(publisher)

    def _describe(self) -> None:
        """Say once, also to who comes later, what runs: the spanning tree as URDF, and the whole scene as text."""
        latched = QoSProfile(
            depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
        )
        told = {'robot_description': self._urdf, '~/scene': tell(self.scene, self.simulation)}
        self._descriptions = [self.node.create_publisher(String, topic, latched, **SAID_HERE) for topic in told]
        for publisher, text in zip(self._descriptions, told.values(), strict=True):
            publisher.publish(String(data=text))

    # -- on the simulation thread -------------------------------------------------------------------------------------

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
        self.audience.restart()
        self.commands.poll()  # what was said before is of the past
        self.driving.go_on(moving=not state)
        self.loop.restart()
        self.driving.hold()
        return f'back at t = {simulation.t_ns * 1e-9:g}' + ('' if state else ', in motion as it was') + said

    def _end_recording(self, outcome: str, found: list[Finding] | None = None, last: Snapshot | None = None) -> str:
        """End a recording for another; what an answer has to say of it. found, last: see Recording.end."""
        try:
            self.recording.end(self.loop, outcome, found, last)
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
        """Move the vehicle to x, y [m] and the heading of a quaternion xyzw, and show it; a recording goes on in a new
        directory.

        frame: in which they are given: none, map, or odom with its prefix, which are all the world. Raises SpecError.
        """
        odom = self.value('frame_prefix') + 'odom'
        if frame not in ('', 'map', odom):
            raise SpecError(
                f'frame {frame!r}: a pose must be given in map or {odom}; set the fixed frame of its sender'
            )
        heading = heading_of(orientation)
        if not (math.isfinite(x) and math.isfinite(y)):
            raise SpecError(f'x = {x}, y = {y}: must be two finite numbers')
        found, last = self.recording.found(), self.simulation.snapshot()  # behind the placing both are others
        self.simulation.place(x, y, heading)
        said = ''
        if self.recording.recorder is not None:
            said = self._end_recording('placed elsewhere', found, last) + self._go_on_recording()
        self.audience.record()
        self.audience.repeat()  # paused, or with few messages, it would be seen late
        return f'placed at x = {x:.3f} m, y = {y:.3f} m, heading {math.degrees(heading):.2f} deg{said}'
