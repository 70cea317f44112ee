"""The topic /clock: simulation time for everybody with use_sim_time."""

from __future__ import annotations

import math
import time

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from mbd_sim_ros.messages.cdr import ENCAPSULATION
from mbd_sim_ros.messages.encode import STAMP
from mbd_sim_ros.node.graph import SAID_HERE
from mbd_sim_ros.node.pace import Pace
from solver.output.snapshot import Snapshot

SECONDS = 0.01  # between two messages at least, of elapsed and of simulated time


class Ticks:
    """Publishes /clock, at steps of h_ns [ns]."""

    def __init__(self, node: Node, pace: Pace, h_ns: int) -> None:
        best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.publisher = node.create_publisher(Clock, '/clock', best_effort, **SAID_HERE)
        self._pace, self._h_ns = pace, h_ns
        self._last = -math.inf  # clock reading [s] of the last
        self._every = 0.0, 1  # seconds of simulated time and steps between two

    @property
    def heard(self) -> bool:
        """True where somebody follows."""
        return self.publisher.get_subscription_count() > 0

    @property
    def every(self) -> int:
        """Steps between two messages, from step 0: they are due with other topics, for waking costs more than steps."""
        seconds = SECONDS * (max(1.0, self._pace.rate_factor) if self._pace.mode == 'realtime' else 1.0)
        if self._every[0] != seconds:
            self._every = seconds, max(1, math.ceil(round(seconds * 1e9 / self._h_ns, 6)))
        return self._every[1]

    @property
    def began(self) -> bool:
        """True where there was a message since the start, or since the last restart."""
        return self._last > -math.inf

    def restart(self) -> None:
        """Time begins anew: it is told whatever the step, and whoever hears it."""
        self._last = -math.inf

    def publish(self, snapshot: Snapshot, *, anyway: bool) -> None:
        """Publish the time of a snapshot; in mode fast, unless `anyway`, only SECONDS after the last."""
        now = time.monotonic()
        if anyway or self._pace.mode != 'fast' or now - self._last >= SECONDS:
            self._last = now
            self.publisher.publish(ENCAPSULATION + STAMP.pack(*divmod(snapshot.t_ns, 1_000_000_000)))
