"""A turn of the executor: what cannot be handled ends no simulation."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rclpy.executors import Executor
    from rclpy.node import Node


def turn(executor: Executor, node: Node, seconds: float) -> None:
    """Do one thing that came for a node, or wait for it, so long at most.

    rclpy raises what it cannot make out of a request, such as parameters of a type that there is not, from here: that request stays
    unanswered and is told.
    """
    try:
        executor.spin_once(timeout_sec=seconds)
    except (ValueError, TypeError) as error:
        node.get_logger().error(f'a request cannot be handled and is left unanswered: {" ".join(str(error).split())}')
