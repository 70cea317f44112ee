"""One spin of the executor: a request that cannot be handled is reported and ends no simulation."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rclpy.executors import Executor
    from rclpy.node import Node


def spin_once(executor: Executor, node: Node, seconds: float) -> None:
    """Handle one event of a node, waiting for it `seconds` at most.

    rclpy raises from here where a request is malformed, such as parameters of an unknown type. That request stays
    unanswered and is reported in the log.
    """
    try:
        executor.spin_once(timeout_sec=seconds)
    except (ValueError, TypeError) as error:
        node.get_logger().error(f'a request cannot be handled and is left unanswered: {" ".join(str(error).split())}')
