"""Nodes beside a simulator (adapter, maneuver): they wait for it, answer its newest state, and end when it ends."""

from __future__ import annotations

import time
from typing import Any, Protocol

from mbd_sim_ros import interrupts
from solver.errors import MbdError, SpecError

LOOK = 0.1  # s of waiting for a message, between looks for signals and for the simulator
LOST = 0.3  # s without a newer state after which the answer to a repeated one is sent again

# of all of them: default, description with unit
COMMON: dict[str, tuple[Any, str]] = {
    'simulator': ('simulator', 'name of the simulator node'),
    'rate': (100.0, 'answers per second of wall time, at most; 0: every state (for lockstep)'),
    'timeout': (20.0, 'time to wait for the simulator [s]'),
}


class NoSimulator(MbdError):
    """There is no simulator to accompany."""

    exit_code = 6


class Companion(Protocol):
    """A node beside a simulator. answered: stamp of the newest state that was answered [ns]; -1: none."""

    answered: int

    def value(self, name: str) -> Any: ...
    def get_logger(self) -> Any: ...
    def destroy_node(self) -> None: ...

    def look(self, executor: Any) -> bool:
        """Take what comes, for LOOK at most; whether the simulator has been found. Raises MbdError."""

    def missing(self) -> str:
        """Reason why the simulator has not been found yet."""

    def ended(self) -> str:
        """Why there is nothing more to do; '' while there is."""


def accompany(node: Companion, doing: str) -> int:
    """Answer until the simulator ends or a signal comes; returns the exit code. Raises NoSimulator where there is none,
    and MbdError."""
    from rclpy.executors import SingleThreadedExecutor

    name, rate, timeout = (node.value(key) for key in ('simulator', 'rate', 'timeout'))
    if not (rate >= 0.0 and timeout >= 0.0):
        raise SpecError(f'parameters rate = {rate:g}, timeout = {timeout:g}: must not be negative')
    executor = SingleThreadedExecutor()
    executor.add_node(node)  # type: ignore[arg-type]  # a Node, which cannot be said without importing rclpy
    interrupts.now(doing)
    begin = time.monotonic()
    node.get_logger().info(f'waiting for {name}')
    while not interrupts.event.is_set():
        answered = node.answered
        if not node.look(executor) and time.monotonic() - begin > timeout:
            raise NoSimulator(
                f'the simulator {name!r} {node.missing()}: nothing came within {timeout:g} s; see the parameters '
                'simulator and timeout'
            )
        if rate > 0.0 and node.answered != answered:
            time.sleep(1.0 / rate)  # meanwhile the queue of depth one keeps the newest
        reason = node.ended()
        if reason:
            node.get_logger().info(reason)
            break
    executor.shutdown()
    node.destroy_node()
    interrupts.check()
    return 0
