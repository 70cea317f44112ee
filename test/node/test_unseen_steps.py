"""Steps that nobody sees and nobody commands are made at once: the same bits, the same inputs, the same end."""

from __future__ import annotations

import math
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from processes import DOMAIN
from real_node import simulator
from synthetic import INPUTS, Synthetic

from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.commands.main import main
from mbd_sim_ros.node import loop as loop_module
from mbd_sim_ros.node.latch import Latch
from mbd_sim_ros.node.loop import AT_ONCE, LATELY, Loop
from mbd_sim_ros.node.pace import Pace
from solver.files.scene import load_scene
from solver.inputs.command_filter import CommandSource
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
            simulation, Latch(simulation, Pace(mode='fast')), inputs=lambda values: np.zeros(len(INPUTS)),
            emit=lambda s: seen.append(s.k), end_ns=200_000_000,
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
            simulation, Latch(simulation, Pace(mode='fast', command_timeout=0.1)),
            inputs=lambda values, source=source: source.advance(*values), emit=lambda snapshot: None,
            end_ns=300_000_000, hidden=lambda most, wanted=wanted: min(wanted, most),
        )  # fmt: skip
        loop.latch.command(0, 0.5)
        loop.latch.command(1, 200.0)
        finished(loop)
        assert loop.steps == simulation.k == 300_000_000 // simulation.h_ns
        states.append(simulation.save())
    assert states[0] == states[1]


class Timed(Synthetic):
    """Stands in for the clock of a loop too, so that nothing waits: a call takes `call` s, `cold` s more after a sleep,
    `step` s each step; every twentieth call stalls."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, *, call: float, cold: float, step: float, stall: float = 0.0
    ) -> None:
        super().__init__(h_ns=1_000_000)
        self.call, self.cold, self.step, self.stall = call, cold, step, stall
        self.now, self.slept, self.calls = 0.0, False, 0
        monkeypatch.setattr(loop_module, 'time', self)

    def perf_counter(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now, self.slept = self.now + seconds, True

    def advance(self, n: int = 1, inputs: np.ndarray | None = None):
        self.calls += 1
        self.now += self.call + self.cold * self.slept + n * self.step + self.stall * (self.calls % 20 == 0)
        self.slept = False
        return super().advance(n, inputs)


class Watched:
    """A run in real time. at_once: steps of each call; k: those that were seen; behind: how long after each was due it
    was shown [s]; late: the same without what a step takes [s]."""

    def __init__(self, simulation: Timed, seconds: float, hidden=lambda most: most) -> None:
        seen, behind, late = [0], [], []

        def emit(snapshot) -> None:
            if snapshot.k:
                seen.append(snapshot.k)
                clock, k0, _ = loop._anchor or (math.nan, 0, 1.0)
                behind.append(simulation.now - clock - (snapshot.k - 1 - k0) * 1e-3)
                late.append(behind[-1] - simulation.step)

        loop = Loop(
            simulation, Latch(simulation), inputs=lambda values: np.zeros(len(INPUTS)), emit=emit,
            end_ns=simulation.t_ns + round(seconds * 1e9), hidden=hidden,
        )  # fmt: skip
        finished(loop)
        self.slips, self.at_once, self.k = loop.slips, np.diff(seen), np.array(seen[1:])
        self.behind, self.late = np.array(behind), np.array(late)


@pytest.mark.parametrize(
    ('call', 'cold', 'step'),
    [(5e-5, 1e-4, 3e-5), (5e-5, 8e-4, 3e-5), (2e-4, 1e-4, 2e-5), (5e-5, 1e-4, 1.4e-4), (5e-5, 1e-4, 6e-4)],
)
def test_in_real_time_a_call_begins_so_that_what_is_seen_begins_when_it_is_due(
    monkeypatch: pytest.MonkeyPatch, call: float, cold: float, step: float
) -> None:
    """What the call and waking take counts as if each step took a part: that of the last makes it late."""
    run = Watched(Timed(monkeypatch, call=call, cold=cold, step=step), 1.0)
    assert run.slips == 0
    assert (run.at_once[1:-1] == 10).all()
    np.testing.assert_allclose(run.late[LATELY + 1 : -1], (call + cold) / 10, atol=1e-9)
    assert (run.behind > -1e-9).all()


@pytest.mark.parametrize(('step', 'rate'), [(1e-4, 1.0), (2e-3, 0.5), (4e-3, 0.25)])
def test_the_rate_that_is_reported_is_time_simulated_per_time_passed(
    monkeypatch: pytest.MonkeyPatch, step: float, rate: float
) -> None:
    simulation = Timed(monkeypatch, call=0.0, cold=0.0, step=step)
    still = np.zeros(len(INPUTS))
    loop = Loop(
        simulation, Latch(simulation), inputs=lambda values: still, emit=lambda snapshot: None, end_ns=1_000_000_000
    )
    assert loop.health().steps == 0
    finished(loop)
    health = loop.health()
    assert health.steps == 1000
    assert health.rate == pytest.approx(rate, rel=2e-3)  # the last step may begin and end within its own ms
    assert loop.health().rate == 0.0  # nothing since


def test_the_step_times_that_are_reported_are_those_of_their_ranks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 1, 2, ..., 101 ms in any order half are below 51 ms and 99 of 100 below 100 ms."""
    simulation = Timed(monkeypatch, call=0.0, cold=0.0, step=1e-4)
    loop = Loop(simulation, Latch(simulation), inputs=lambda values: np.zeros(len(INPUTS)), emit=lambda snapshot: None)
    loop._times.extend(1e-3 * (37 * k % 101 + 1) for k in range(101))
    health = loop.health()
    assert (health.step_p50, health.step_p99, health.step_max) == pytest.approx((0.051, 0.1, 0.101))
    assert loop.health().step_max == 0.0  # nothing since


def test_steps_that_take_longer_than_they_last_are_made_at_once_for_as_long_as_a_call_may_take(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """8 of 1.2 ms are 9.6 ms."""
    run = Watched(Timed(monkeypatch, call=5e-5, cold=1e-4, step=1.2e-3), 2.0)
    assert run.slips > 0
    assert np.median(run.at_once) == 8
    assert run.at_once.max() == 8


def test_what_is_seen_is_late_while_steps_become_dearer_and_never_early(monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = Timed(monkeypatch, call=5e-5, cold=1e-4, step=3e-5)
    dear = 1000, 2000  # steps

    def hidden(most: int) -> int:
        simulation.step = 2e-4 if dear[0] <= simulation.k < dear[1] else 3e-5
        return most

    run = Watched(simulation, 3.0, hidden)
    assert (run.at_once[1:-1] == 10).all()
    late = np.flatnonzero(run.late[1:-1] > 1e-4) + 1
    assert len(late) == LATELY  # as many as remember the cheap ones
    assert dear[0] < run.k[late[0]] <= dear[0] + 11
    np.testing.assert_allclose(run.late[late], 9 * (2e-4 - 3e-5) + 1.5e-5, atol=1e-9)
    assert (run.behind > -1e-9).all()
    again = np.flatnonzero(run.k > dear[1] + 2)[0]
    assert run.behind[again] == pytest.approx(0.0, abs=1e-9)  # it had to wait
    np.testing.assert_allclose(run.late[again + 1 : -1], 1.5e-5, atol=1e-9)


def test_in_slow_motion_no_more_of_the_clock_passes_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A step lasts 50 ms of the clock. Who begins to look after 1 s does not find them waiting, which the schedule
    would give up."""
    simulation = Timed(monkeypatch, call=5e-5, cold=1e-4, step=3e-5)
    seen: list[float] = []
    loop = Loop(
        simulation, Latch(simulation, Pace(rate_factor=0.02)), inputs=lambda values: np.zeros(len(INPUTS)),
        emit=lambda snapshot: seen.append(simulation.now),
        end_ns=40_000_000, hidden=lambda most: 0 if simulation.now > 1.02 else most,
    )  # fmt: skip
    monkeypatch.setattr(loop, '_wake', SimpleNamespace(wait=simulation.sleep, clear=lambda: None, set=lambda: None))
    finished(loop)
    assert loop.slips == 0
    np.testing.assert_allclose(np.diff(seen)[1:], 0.05, atol=1e-3)


def test_real_time_goes_on_at_once_after_steps_that_did_not_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    """The schedule from before would have it wait until the clock comes to where the simulation is."""
    simulation = Timed(monkeypatch, call=5e-5, cold=1e-4, step=3e-5)

    def emit(snapshot) -> None:
        loop.pace.mode = 'fast' if 100 <= snapshot.k < 10_000 else 'realtime'

    loop = Loop(
        simulation, Latch(simulation), inputs=lambda values: np.zeros(len(INPUTS)), emit=emit, end_ns=10_100_000_000,
        hidden=lambda most: most,
    )  # fmt: skip
    monkeypatch.setattr(loop, '_wake', SimpleNamespace(wait=simulation.sleep, clear=lambda: None, set=lambda: None))
    finished(loop)
    assert loop.slips == 0
    assert simulation.now < 0.1 + 9900 * (3e-5 + 5e-6) + 0.1 + 0.02


def test_stalls_do_not_make_others_early(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every twentieth call stalls for 5 ms; the call behind it begins at once."""
    run = Watched(Timed(monkeypatch, call=5e-5, cold=1e-4, step=3e-5, stall=5e-3), 2.0)
    assert (run.at_once[1:-1] == 10).all()
    usual = np.isclose(run.late, 1.5e-5, atol=1e-9)
    assert np.mean(usual) > 0.9
    assert (run.behind > -1e-9).all()


def test_a_step_that_is_seen_alone_is_one_call(monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = Timed(monkeypatch, call=5e-5, cold=1e-4, step=3e-5)
    assert Watched(simulation, 1.0, lambda most: 0).at_once.max() == 1
    assert simulation.calls == simulation.k


def test_inputs_that_stay_are_not_made_anew_and_have_the_same_bits() -> None:
    """Of a command on its way through the filter, one that has the same value but another sign of zero, and none for a
    long time."""
    pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    from mbd_sim_ros.node.driving import Driving

    made = 0

    class Counted(CommandSource):
        def advance(self, *commands: float) -> np.ndarray:
            nonlocal made
            made += 1
            return super().advance(*commands)

    sources = [kind(INPUTS, 1_000_000, bandwidth=50.0, steering=0.25) for kind in (Counted, CommandSource)]
    driving = SimpleNamespace(deaf=False, _source=sources[0], _asked=(), assistant=None, _actuators=None)
    commands = [((0.25, 0.0, 0.0), 100), ((0.0, 0.0, 0.0), 4000), ((-0.0, -0.0, 0.0), 100), ((-0.0, 0.0, -0.0), 100)]
    for values, count in commands:
        before = made
        for _ in range(count):
            assert Driving.inputs(driving, values).tobytes() == sources[1].advance(*values).tobytes()  # type: ignore[arg-type]
        assert made - before < max(5, 0.7 * count)
        assert sources[0].state.tobytes() == sources[1].state.tobytes()
    assert made > 100  # while the angle comes to rest
    sources[0].state = np.array([0.0, 1.0, 0.0])
    assert sources[0].settled is None


def test_inputs_that_stay_are_asked_for_twice_a_call_unless_a_command_becomes_too_old() -> None:
    asked: list[tuple[float, ...]] = []
    rows = {value: np.full(len(INPUTS), value) for value in (0.0, 7.0)}

    class Kept(Synthetic):
        def advance(self, n: int = 1, inputs: np.ndarray | None = None):
            assert inputs is not None
            applied.extend(np.broadcast_to(inputs, (n, len(INPUTS)))[:, 0].tolist())  # one row is held
            return super().advance(n, inputs)

    applied: list[float] = []
    simulation = Kept(h_ns=1_000_000)
    loop = Loop(
        simulation, Latch(simulation, Pace(mode='fast', command_timeout=0.1035)),
        inputs=lambda values: asked.append(values) or rows[values[1]], emit=lambda s: None, end_ns=200_000_000,
        hidden=lambda most: most,
    )  # fmt: skip
    loop.latch.command(1, 7.0)
    finished(loop)
    assert applied == [7.0] * 104 + [0.0] * 96
    assert len(asked) == 10 * 2 + 10 + 9 * 10  # all of them while one is too old: it is looked at every time


@pytest.mark.realtime
@pytest.mark.slow
def test_a_run_that_nobody_watches_can_be_replayed(simulator, tmp_path: Path) -> None:
    """Who publishes commands is looked for once a second, so most of this run was made so. The inputs of every step are
    recorded."""
    process = simulator(
        scene='light_car_straight',
        duration=2.5,
        record=True,
        out='run',
        overrides=['record.every=7'],
        commands='topics',
    )
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


def test_in_lockstep_a_state_is_not_repeated_as_soon_as_it_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever answers every state would answer the first one twice, and with plain commands be a step behind from then
    on."""
    monkeypatch.setattr(loop_module, 'REPEAT', 0.2)
    shown, repeated = [], []
    simulation = Synthetic()
    loop = Loop(
        simulation, Latch(simulation, Pace(mode='lockstep')), inputs=lambda values: np.zeros(len(INPUTS)),
        emit=lambda s: shown.append(time.perf_counter()), repeat=lambda: repeated.append(time.perf_counter()),
    )  # fmt: skip
    loop.start()
    for states in (1, 2):  # of the start, and of a reset after a pause
        while not repeated or repeated[-1] < shown[-1]:
            time.sleep(0.01)
        assert repeated[-1] - shown[-1] > 0.2
        if states == 1:
            loop.ask(loop.pause).result(1.0)
            time.sleep(0.3)
            loop.ask(loop.restart).result(1.0)
            loop.ask(loop.resume).result(1.0)
    loop.stop('done')
    assert len(shown) == 2
