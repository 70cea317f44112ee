"""Lockstep without ROS: which states are waited for, and what an answer makes, when one makes several steps."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest
from synthetic import INPUTS, Synthetic

from mbd_sim_ros.node.latch import Latch
from mbd_sim_ros.node.loop import Loop
from mbd_sim_ros.node.pace import Pace

EVERY, H = 10, 2_000_000  # steps an answer, step [ns]


class Controlled:
    """A loop in lockstep that is answered by a script: answer(stamp) is tried once, at the next look."""

    def __init__(self, *, every: int = EVERY, hidden: Callable[[int], int] = lambda most: 0) -> None:
        self.simulation = Synthetic()
        self.used: list[float] = []  # drive torque of every step
        self.waited: list[int] = []  # states that were shown as waiting
        self.shown: list[int] = []
        self.asked: list[tuple[int, float]] = []
        self.taken: list[bool] = []
        self.latch = Latch(self.simulation, Pace(mode='lockstep', lockstep_every=every))
        self.loop = Loop(
            self.simulation, self.latch, inputs=self._inputs, emit=self._emit, poll=self._poll, hidden=hidden
        )  # fmt: skip

    def _inputs(self, values: tuple[float, ...]) -> np.ndarray:
        self.used.append(values[1])
        return np.zeros(len(INPUTS))

    def _emit(self, snapshot) -> None:
        self.shown.append(snapshot.k)
        if self.latch.waits:
            self.waited.append(snapshot.k)

    def _poll(self) -> None:
        for stamp, torque in self.asked:
            self.taken.append(self.latch.answer(stamp, {1: torque}))
        self.asked = []

    def answer(self, k: int, torque: float = 0.0) -> bool:
        """Answer the state of step k; whether that was the one that is waiting."""
        count = len(self.taken)
        self.asked = [(k * H, torque)]
        self.until(lambda: len(self.taken) > count)
        return self.taken[-1]

    def until(self, condition: Callable[[], bool]) -> None:
        end = time.monotonic() + 10.0
        while not condition():
            assert time.monotonic() < end and self.loop.error is None, self.loop.error
            time.sleep(1e-3)

    def at(self, k: int) -> None:
        """Wait for the state of step k, and see that it stays."""
        self.until(lambda: self.simulation.k == k and self.latch.waits and k in self.shown)
        time.sleep(0.02)
        assert self.simulation.k == k

    def ask(self, action: Callable[[], object]) -> object:
        return self.loop.ask(action).result(5.0)


@pytest.fixture
def controlled():
    made: list[Controlled] = []

    def controlled(**options) -> Controlled:
        made.append(Controlled(**options))
        made[-1].loop.start()
        made[-1].at(0)
        return made[-1]

    yield controlled
    for one in made:
        one.loop.stop('done')
        assert one.loop.error is None


@pytest.mark.parametrize('every', [1, 2, 7, 10, 1000])
def test_an_answer_holds_for_its_steps_and_no_state_between_is_waited_for(controlled, every: int) -> None:
    one = controlled(every=every)
    for count in (1, 2, 3):
        assert one.answer((count - 1) * every, 10.0 * count)
        one.at(count * every)
    assert one.used == [10.0] * every + [20.0] * every + [30.0] * every
    assert one.waited == [0, every, 2 * every, 3 * every]
    assert one.shown == list(range(3 * every + 1))
    assert one.latch.answers == (3, 0, 0)


@pytest.mark.parametrize('k', [-1, 1, 9, 11, 20])
def test_an_answer_to_a_state_that_is_not_waited_for_is_refused_and_counted(controlled, k: int) -> None:
    one = controlled()
    assert one.answer(0)
    one.at(10)
    assert not one.answer(k, 5.0)
    one.at(10)
    assert one.latch.answers == (1, 1, 0)
    assert one.answer(10)
    one.at(20)
    assert not one.answer(10)  # once more
    assert 5.0 not in one.used


def test_steps_that_are_asked_for_are_so_many_and_the_next_answer_counts_from_there(controlled) -> None:
    one = controlled()
    one.ask(lambda: one.loop.step(3))
    one.at(3)
    assert not one.answer(0) and one.answer(3, 1.0)
    one.at(13)
    assert one.used == [0.0] * 3 + [1.0] * 10


def test_a_pause_within_an_answer_changes_nothing_of_it(controlled) -> None:
    """The seven steps behind the pause are those of the answer to 0; one to the state of the pause, or of the steps
    made there, is none."""
    one = controlled(every=1)
    one.ask(one.loop.pause)
    one.latch.pace.lockstep_every = 10
    one.latch._until = 10  # the state of an answer is reached, at 0, with ten steps to make
    assert one.ask(lambda: one.latch.waiting_ns) == 10 * H
    one.asked = [(0, 4.0)]
    one.ask(lambda: one.loop.step(3))
    one.until(lambda: one.simulation.k == 3)
    assert one.taken == [False]
    one.ask(one.loop.resume)
    one.at(10)
    assert one.used == [0.0] * 10
    assert one.answer(10, 4.0)
    one.at(20)


def test_plain_commands_make_as_many_steps(controlled) -> None:
    one = controlled(every=4)
    one.ask(lambda: [one.latch.command(i, 2.0) for i in (0, 1)])
    one.at(0)  # the brake is missing
    one.ask(lambda: one.latch.command(2, 2.0))
    one.at(4)
    assert one.used == [2.0] * 4


def test_a_reset_forgets_the_rest_of_an_answer_and_another_number_counts_from_the_next_one_on(controlled) -> None:
    one = controlled(every=1000)
    one.ask(one.loop.pause)
    one.latch._until = 1000
    one.ask(lambda: (one.simulation.reset(), one.loop.restart()))
    one.latch.pace.lockstep_every = 5
    one.ask(one.loop.resume)
    one.at(0)
    assert one.answer(0)
    one.at(5)


def test_states_that_nobody_sees_are_made_at_once_and_never_beyond_the_one_that_waits(controlled) -> None:
    """Five steps of 2 ms are 0.01 s, the most that is made at once; the first is made alone, where answers are looked
    for."""
    calls: list[int] = []

    def hidden(most: int) -> int:
        calls.append(most)
        return most

    one = controlled(every=12, hidden=hidden)
    for k in (0, 12, 24):
        assert one.answer(k, float(k))
        one.at(k + 12)
    assert one.shown == [0, 1, 6, 11, 12, 13, 18, 23, 24, 25, 30, 35, 36]
    assert max(calls) == 4
