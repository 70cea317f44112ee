"""Steps that nobody sees and nobody commands are made at once: the same bits, the same inputs, the same end."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np
import pytest
from processes import DOMAIN
from real_node import simulator
from synthetic import INPUTS, Synthetic

from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.commands.main import main
from mbd_sim_ros.node.loop import AT_ONCE, Loop
from solver.files.scene import load_scene
from solver.inputs.hands import CommandSource
from solver.simulation import Simulation

__all__ = ['simulator']  # a fixture


def finished(loop: Loop) -> Loop:
    loop.start()
    assert loop.done.wait(30.0)
    assert loop.error is None, loop.error
    return loop


@pytest.mark.parametrize('wanted', [0, 3, 1000])
def test_the_run_ends_at_its_end_and_what_is_wanted_is_seen(wanted: int) -> None:
    """At most AT_ONCE of simulated time passes in one call."""
    simulation, seen = Synthetic(), []
    passed: list[int] = []
    finished(
        Loop(
            simulation, inputs=lambda values: np.zeros(len(INPUTS)), emit=lambda s: seen.append(s.k), mode='fast', end_ns=200_000_000,
            hidden=lambda most: min(wanted, most), passed=lambda: passed.append(simulation.k),
        )
    )  # fmt: skip
    at_once = min(wanted + 1, round(AT_ONCE / 2e-3))
    assert seen == list(range(0, 101, at_once))
    assert passed == seen[1:]


def test_they_have_the_bits_of_single_steps() -> None:
    """A steering command on its way through the filter, and a drive torque that becomes too old in between."""
    states = []
    for wanted in (0, 7):
        simulation = Simulation(load_scene('light_car_straight'))
        source = CommandSource(simulation.channels.inputs, simulation.h_ns)
        loop = Loop(
            simulation, inputs=lambda values, source=source: source.advance(*values), emit=lambda snapshot: None, mode='fast',
            end_ns=300_000_000, command_timeout=0.1, hidden=lambda most, wanted=wanted: min(wanted, most),
        )  # fmt: skip
        loop.command(0, 0.5)
        loop.command(1, 200.0)
        finished(loop)
        assert loop.steps == simulation.k == 300_000_000 // simulation.h_ns
        states.append(simulation.save())
    assert states[0] == states[1]


def test_in_real_time_they_are_not_ahead_of_the_clock() -> None:
    """Those before the one that is due take at most half of the length of a step, and nothing happens before its time."""
    simulation, early, begin = Synthetic(h_ns=1_000_000), [], threading.Event()

    def seen(snapshot) -> None:
        if begin.is_set():
            early.append((snapshot.k - 1) * 1e-3 - loop.wall_time)
        begin.set()

    loop = Loop(simulation, inputs=lambda values: np.zeros(len(INPUTS)), emit=seen, end_ns=300_000_000, hidden=lambda most: most)
    finished(loop)
    assert len(early) < 150
    assert max(early) < 1e-3  # the schedule begins with the first wait, a little behind the start


def test_what_a_call_costs_does_not_count_for_every_step() -> None:
    """A call that takes 0.1 ms, with steps of 10 us: nine of them fit into half a step however long one takes that is made alone."""

    class Waking(Synthetic):
        def advance(self, n: int = 1, inputs: np.ndarray | None = None):
            end = time.perf_counter() + 1e-4 + n * 1e-5
            while time.perf_counter() < end:
                pass
            return super().advance(n, inputs)

    seen: list[int] = []
    finished(
        Loop(
            Waking(h_ns=1_000_000), inputs=lambda values: np.zeros(len(INPUTS)), emit=lambda s: seen.append(s.k), end_ns=1_000_000_000,
            hidden=lambda most: most,
        )
    )  # fmt: skip
    assert np.median(np.diff(seen[len(seen) // 2 :])) == AT_ONCE / 1e-3


@pytest.mark.realtime
@pytest.mark.slow
def test_a_run_that_nobody_watches_can_be_replayed(simulator, tmp_path: Path) -> None:
    """Who publishes commands is looked for once a second, so most of this run was made so. The inputs of every step are recorded."""
    process = simulator(scene='light_car_straight', duration=2.5, record=True, out='run', overrides=['record.every=7'], commands='topics')
    assert process.end() == 0, process.output
    run = bag.read(tmp_path / 'run')
    assert run['cmd_applied/step'][-1] == 2.5 / load_scene('light_car_straight').integrator.h
    assert main(['replay', str(tmp_path / 'run'), '--json']) == 0


@pytest.mark.realtime
def test_the_clock_ticks_a_hundred_times_a_second_although_nobody_hears_the_rest(simulator) -> None:
    rclpy = pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from rosgraph_msgs.msg import Clock

    ticks: list[float] = []
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=int(DOMAIN))
    node = rclpy.create_node('listener', context=context)
    try:
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        best = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
        node.create_subscription(Clock, '/clock', lambda m: ticks.append(m.clock.sec + 1e-9 * m.clock.nanosec), best)
        process = simulator(scene='light_car_straight', duration=3.0, commands='maneuver')
        end = time.monotonic() + 20.0
        while len(ticks) < 150 and time.monotonic() < end:
            executor.spin_once(timeout_sec=0.05)
        assert process.end() == 0, process.output
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)
    assert np.median(np.diff(ticks)) == pytest.approx(0.01, abs=1e-6)
