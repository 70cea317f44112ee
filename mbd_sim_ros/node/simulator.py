"""The ROS node `simulator`: parameters, services and diagnostics of a scene that runs."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, wait
from contextlib import suppress
from threading import Thread
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from rcl_interfaces.msg import SetParametersResult
from rclpy._rclpy_pybind11 import RCLError
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter

from mbd_sim_ros import interrupts
from mbd_sim_ros.node import PREPARING
from mbd_sim_ros.node.commands import Commanded, commanded
from mbd_sim_ros.node.diagnostics import diagnosis
from mbd_sim_ros.node.graph import SAID_HERE, Ear, Graph, follow
from mbd_sim_ros.node.interfaces import Interfaces
from mbd_sim_ros.node.loop import Loop
from mbd_sim_ros.node.parameters import PACING, RATES, declare, refusal, unknown
from mbd_sim_ros.node.running import Running
from mbd_sim_ros.node.services import asked, serve
from solver.compiled import interruption
from solver.errors import SpecError

if TYPE_CHECKING:
    from solver.scene import Scene
    from solver.simulation import Simulation

LOOK = 0.05  # s between looks for signals while a scene is prepared
TOLD = Duration(seconds=0.2)  # what subscribers may take for the last message


class Simulator(Node):
    """Declares the parameters; `open` takes a simulation and connects it; `close` ends everything."""

    running: Running

    def __init__(self, prepare: Callable[[str, list[str]], tuple[Any, Any]]) -> None:
        """prepare: makes (scene, simulation) of the name of a scene and overrides."""
        # The node makes time; it must not wait for it.
        super().__init__('simulator', parameter_overrides=[Parameter('use_sim_time', value=False)])
        declare(self)
        for sentence in unknown(self):
            self.get_logger().warning(sentence)
        self._prepare = prepare
        self.stopped = False
        self._stale_said: set[Commanded] = set()
        self._namesakes = 0
        self._code = 0  # exit code of the scenes that ran before this one

    @property
    def loop(self) -> Loop:
        """The loop of the scene that runs."""
        return self.running.loop

    def value(self, name: str) -> Any:
        """Return the value of a parameter."""
        return self.get_parameter(name).value

    def _on_set(self, parameters: list[Parameter]) -> SetParametersResult:
        reason = refusal(parameters)
        if reason:
            return SetParametersResult(successful=False, reason=reason)
        for parameter in parameters:
            if parameter.name in PACING:
                setattr(self.running.latch.pace, parameter.name, parameter.value)
                self.loop.judge_anew()
                self.running.prefer()
                if parameter.name != 'rate_factor':
                    self.running.warn_of_lockstep()
        publishing = ('publish_every', 'publish_budget')
        rates = {p.name: p.value for p in parameters if p.name.removeprefix('rate_') in RATES or p.name in publishing}
        if rates:
            self.running.look_at_rates(rates)
        return SetParametersResult(successful=True)

    def open(self, scene: Scene, simulation: Simulation) -> None:
        """Connect a simulation (solver.simulation.Simulation or alike) and start it. Raises MbdError."""
        self.running = Running(self, scene, simulation)
        self.add_on_set_parameters_callback(self._on_set)
        serve(self, self)
        Interfaces(self, self)
        self._poses = Ear(self, 'initialpose', {PoseWithCovarianceStamped: self._place}, depth=1)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10, **SAID_HERE)
        self._graph = Graph(self, lambda topic: self.running.alone().get(topic, ''))
        self.create_timer(1.0, self._diagnose, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.running.start()

    def load(self, name: str, overrides: list[str]) -> str:
        """Take another scene, which stands at its start, paused; the one that runs goes on until that is ready. Raises
        MbdError."""
        self.get_logger().info(f'preparing {name}')
        scene, simulation = self._prepared(name, overrides)
        old, new = self.running, Running(self, scene, simulation, first=False)
        new.loop.pause()
        self.running, self.stopped = new, True
        code = old.close(f'{scene.name} was loaded')
        self._code = self._code or code
        old.disconnect()  # nobody publishes any more
        new.start()
        return f'{scene.name} stands at its start' + (f'; the scene before ended with code {code}' if code else '')

    def _prepared(self, name: str, overrides: list[str]) -> tuple[Any, Any]:
        """Have a scene prepared by a thread of its own, for that may take minutes, and look for signals meanwhile.
        Raises MbdError."""
        found: Future = Future()

        def prepare() -> None:
            try:
                found.set_result(self._prepare(name, overrides))
            except BaseException as error:  # the one who waits gets it
                found.set_exception(error)

        Thread(target=prepare, name=PREPARING, daemon=True).start()
        while not wait((found,), LOOK).done:
            if interrupts.event.is_set():
                interruption.note(KeyboardInterrupt(f'preparing {name}'))  # the compiler is left between two passes
                raise SpecError(f'interrupted while preparing {name}')
        return found.result()

    def _place(self, message: PoseWithCovarianceStamped) -> None:
        p, q = message.pose.pose.position, message.pose.pose.orientation
        done, text = asked(
            self.running, lambda running: running.place(p.x, p.y, (q.x, q.y, q.z, q.w), message.header.frame_id)
        )
        if done:
            self.get_logger().info(f'initialpose: {text}')
        else:
            self.get_logger().warning(f'initialpose refused: {text}')

    def close(self, outcome: str) -> int:
        """End the simulation thread, finish the recording and return the exit code: that of the first thing that went
        wrong since `open`.

        May be called when `open` failed or never ran. A simulation that failed is told in the diagnostics before they
        fall silent.
        """
        if hasattr(self, '_diagnostics') and self.loop.error is not None:
            self._diagnose()
            with suppress(RCLError):  # not every middleware can wait
                self._diagnostics.wait_for_all_acked(TOLD)
        code = self.running.close(outcome) if hasattr(self, 'running') else 0
        return self._code or code

    def _diagnose(self) -> None:
        stale = {commanded(name) for name in self.running.latch.stale}
        for one in stale - self._stale_said:
            self.get_logger().warning(
                f'no {one.topic} for {self.running.latch.pace.command_timeout:g} s: the {one.called} is zero until one '
                'comes'
            )
        self._stale_said = stale
        running = self.running
        running.commands.look_around()
        full = self.get_fully_qualified_name()
        namesakes = [f'{space.rstrip("/")}/{name}' for name, space in self.get_node_names_and_namespaces()].count(
            full
        ) - 1
        if namesakes > self._namesakes:
            self.get_logger().warning(
                f'another node is called {full}: both take the commands and publish the same topics; rename one'
            )
        self._namesakes = max(namesakes, 0)
        follow(self, (self._poses,))
        listening = running.commands.node
        unmatched = self._graph.look(self, *([listening] if listening else []))
        recording = running.recording
        status = diagnosis(
            self.loop, recording.recorder, recording.failed,
            refused=running.commands.refused, namesakes=self._namesakes, envelope=running.envelope,
            unpublished=running.dropped,
            unmatched=unmatched, error=running.error,
        )  # fmt: skip
        status.name = f'{full}: simulation'
        status.hardware_id = running.scene.name
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)
