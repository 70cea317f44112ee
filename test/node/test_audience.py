"""Which steps are seen: what is hidden is exactly what nobody would have been shown."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from synthetic import Synthetic

from mbd_sim_ros.node.latch import Latch
from mbd_sim_ros.node.pace import Pace
from mbd_sim_ros.node.periods import before_next, due

H_NS = 1_000_000


@pytest.mark.parametrize('periods', [(), (1,), (3,), (4, 6), (7, 5, 100)])
def test_the_steps_before_the_next_one_are_those_that_are_not_due(periods: tuple[int, ...]) -> None:
    for k in range(40):
        for most in (0, 1, 9):
            count = before_next(k, most, periods)
            assert not any(due(step, periods) for step in range(k + 1, k + 1 + count))
            assert count == most or due(k + 1 + count, periods)


class Shown:
    """An audience of stand-ins. seen: steps with a message, a record or a tick; topics: (name, periods, whether it is
    heard)."""

    def __init__(self, topics=(), *, recorded: int = 0, ticks: int = 0, commanded: bool = False, **pace) -> None:
        pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
        from mbd_sim_ros.messages.topics import JOINT_STATE, Topic
        from mbd_sim_ros.node.audience import Audience
        from mbd_sim_ros.node.publish import Channel, Publication

        self.seen: list[int] = []
        self.simulation = Synthetic(h_ns=H_NS)
        self.latch = Latch(self.simulation, Pace(**pace))
        publication = object.__new__(Publication)
        publication._look_again = math.inf
        publication.channels = [
            Channel(i, Topic(name, JOINT_STATE), None, None, periods, heard)
            for i, (name, periods, heard) in enumerate(topics)
        ]
        publication._note_heard()
        publication.publish = lambda messages, channels, budget=0.0: self._see(bool(channels))
        recording = SimpleNamespace(
            periods=(recorded,) if recorded else (), take=lambda snapshot, messages: self._see(True)
        )
        clock = SimpleNamespace(began=True, heard=True, every=ticks, publish=lambda snapshot, anyway: self._see(True))
        self.audience = Audience(
            self.simulation, SimpleNamespace(encode=lambda snapshot, only: [], channels=self.simulation.channels),
            self.latch,
            publication=publication, recording=recording, ticks=clock if ticks else None,
            envelope=SimpleNamespace(look=lambda snapshot: None), commands=SimpleNamespace(commanded=commanded),
            assisted=False,
        )  # fmt: skip

    def _see(self, anything: bool) -> None:
        if anything:
            self.seen.append(self.simulation.k)

    def steps(self, count: int) -> list[int]:
        """Make steps one by one; those that were seen, each once."""
        for _ in range(count):
            self.audience.show(self.simulation.advance())
        return sorted(set(self.seen))

    def jumps(self, count: int, most: int = 1000) -> list[int]:
        """Make them as the loop does, hidden ones at once; those that were shown."""
        shown = []
        while self.simulation.k < count:
            n = min(self.audience.hidden(most), count - self.simulation.k - 1) + 1
            self.audience.show(self.simulation.advance(n))
            shown.append(self.simulation.k)
        return shown


AUDIENCES = {
    'nobody': {},
    'one topic': {'topics': [('imu', (10,), True)]},
    'a topic without a subscriber': {'topics': [('imu', (10,), False), ('tf', (20, 14), True)]},
    'a recording': {'recorded': 7},
    'the clock': {'ticks': 12},
    'all of them': {'topics': [('imu', (9,), True), ('tf', (20, 14), True)], 'recorded': 25, 'ticks': 10},
    'every step': {'topics': [('odom', (1,), True)]},
}


@pytest.mark.parametrize('mode', ['realtime', 'fast'])
@pytest.mark.parametrize('who', AUDIENCES)
def test_a_step_is_hidden_exactly_where_it_would_be_shown_to_nobody(who: str, mode: str) -> None:
    seen = Shown(**AUDIENCES[who], mode=mode).steps(100)
    assert Shown(**AUDIENCES[who], mode=mode).jumps(100) == sorted({*seen, 100})  # the last one ends the loop


def test_no_more_are_hidden_than_may_be_made_at_once() -> None:
    assert Shown(recorded=50).jumps(12, most=4) == [5, 10, 12]


def test_where_somebody_commands_or_assists_every_step_is_shown_but_in_lockstep() -> None:
    assert Shown(recorded=50, commanded=True).jumps(3) == [1, 2, 3]
    assisted = Shown(recorded=50)
    assisted.audience._assisted = True
    assert assisted.jumps(3) == [1, 2, 3]
    assert Shown(recorded=50, commanded=True, mode='lockstep').jumps(100) == [50, 100]


def test_in_lockstep_what_is_answered_has_a_message_of_the_states_that_wait_and_of_no_others() -> None:
    """cmd_applied, every step of which is wanted, and imu at every third: only imu makes a step between two answers
    seen."""
    one = Shown([('cmd_applied', (1,), True), ('imu', (3,), True)], mode='lockstep', lockstep_every=10)
    assert one.latch.waits and one.latch.answer(0, {}) and one.latch.is_answered()
    assert one.steps(10) == [3, 6, 9, 10]
    other = Shown([('cmd_applied', (1,), False), ('imu', (3,), False)], mode='lockstep', lockstep_every=10)
    other.latch.answer(0, {})
    other.latch.is_answered()
    assert other.steps(10) == [10]  # shown to whoever may come: it waits


def test_a_number_that_is_not_finite_ends_the_run_whether_anybody_sees_it_or_not() -> None:
    from solver.errors import StepError

    one = Shown(recorded=50)
    snapshot = one.simulation.advance()
    snapshot.pose[0, 0] = np.nan
    with pytest.raises(StepError, match='not finite'):
        one.audience.show(snapshot)
