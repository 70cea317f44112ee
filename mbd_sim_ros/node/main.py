"""Executable `simulator`: runs a scene as a ROS 2 node (see simulator.py) from the first import to the last file.

SIGINT and SIGTERM at any moment end it with exit code 0 and a finished recording; whatever else goes wrong ends it with one
sentence and the exit code of the error. The module imports nothing heavy before the signals are taken care of.
"""

from __future__ import annotations

import gc
import signal
import sys
import threading
from collections.abc import Callable
from types import FrameType
from typing import Any

from solver.compiled import interruption

SWITCH = 2e-5  # s; with 2e-4 a step in a second came late, the one beside the diagnostics
LOOK = 0.25  # s between looks for the end and for signals; every one costs the simulation some of the interpreter lock
MISSING = (
    'rclpy is missing: source a ROS 2 Jazzy installation (source /opt/ros/jazzy/setup.bash), or, where there is none, '
    "install the wheels with: pip install 'mbd_sim_ros[ros]'"
)


class Stopped(BaseException):
    """A signal came while nothing needed finishing."""


class Signals:
    """SIGINT and SIGTERM: an exception while preparing (between two kernels while compiling), a flag from then on; the flag survives any
    number of signals.
    """

    def __init__(self) -> None:
        self.received = ''
        self.raising = True
        self.event = threading.Event()
        interruption.forget()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)

    def ignore(self) -> None:
        """SIGINT and SIGTERM mean nothing any more."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)

    def _handle(self, number: int, _: FrameType | None) -> None:
        first = not self.received
        self.received = signal.Signals(number).name
        self.event.set()
        if self.raising and first:
            interruption.interrupt(Stopped())


def prepare(scene: str, overrides: list[str]) -> tuple[Any, Any]:
    """Load a scene and return it with its simulation, compiled and at its start. Raises MbdError."""
    from solver.files.scene import load_scene
    from solver.simulation import Simulation

    loaded = load_scene(scene, overrides)
    simulation = Simulation(loaded)
    simulation.advance(1, inputs=simulation.snapshot().inputs)  # compiles what a step needs before pacing starts
    simulation.reset()
    return loaded, simulation


def run(body: Callable[[Signals], int], args: list[str] | None) -> int:
    """Run `body` inside rclpy.init and shutdown and return its exit code, or that of the error, which is printed as one sentence."""
    signals = Signals()
    try:
        try:
            import rclpy
            from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
            from rclpy.signals import SignalHandlerOptions
        except ImportError:
            print(MISSING, file=sys.stderr)
            return 1
        from solver.errors import MbdError

        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        try:
            return body(signals)
        except (MbdError, InvalidParameterTypeException, InvalidParameterValueException) as error:
            print(error, file=sys.stderr)
            return getattr(error, 'exit_code', 2)
        finally:
            signals.raising = False
            rclpy.try_shutdown()
    except Stopped:
        return 0
    finally:
        if args is None:  # the process ends, with this exit code, whatever still comes
            signals.ignore()


def _simulate(signals: Signals) -> int:
    from rclpy.executors import SingleThreadedExecutor

    from mbd_sim_ros.node.publish import leave_sending_to_the_middleware
    from mbd_sim_ros.node.simulator import Simulator
    from solver.errors import SceneError
    from solver.files.scene import known_names

    leave_sending_to_the_middleware()
    node = Simulator()
    name = node.value('scene')
    if not name:
        raise SceneError('parameter scene is empty: give one with --ros-args -p scene:=NAME; known: ' + ', '.join(known_names()))
    node.get_logger().info(f'preparing {name} (the first time this compiles, which takes about a minute)')
    scene, simulation = prepare(name, [text for text in node.value('overrides') if text])
    # The threads share one interpreter. The simulation gives the lock up a dozen times a step (compiled code, publishing) and has to wait
    # this long for it whenever the executor or the recorder computes; and what is here to stay is not to be collected.
    sys.setswitchinterval(SWITCH)
    gc.collect()
    gc.freeze()
    signals.raising = False
    executor = SingleThreadedExecutor()
    code = 0
    try:
        if not signals.received:
            node.open(scene, simulation)
            node.get_logger().info(f'running {scene.name}: step {simulation.h_ns * 1e-6:g} ms, mode {node.value("mode")}')
            executor.add_node(node)
            while not signals.event.is_set() and not node.loop.done.is_set():
                executor.spin_once(timeout_sec=LOOK)
    finally:
        code = node.close(f'stopped by {signals.received}')
        executor.shutdown()
        node.destroy_node()
    return code


def main(args: list[str] | None = None) -> int:
    """Run the simulator node; returns the exit code."""
    return run(_simulate, args)


if __name__ == '__main__':
    sys.exit(main())
