"""The price of a plan: what its runs are made for, counted; what ends it; and what plans of one vehicle share."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import solver
from solver import simulation_of
from solver.levels import derive, integrator_of
from solver.trade import allowance as allowances
from solver.trade import bench as benches
from solver.trade import cost, elsewhere, knowledge, ledger
from solver.trade.allowance import Allowance
from solver.trade.bench import FULL, Bench, converging, limit_of, simulation
from solver.trade.certificate import plan
from solver.trade.cost import PerStep
from solver.trade.errors import Requirement
from solver.trade.first import EARLIER
from solver.trade.judging import Check
from solver.trade.ledger import Spent
from solver.trade.runs import Stopped
from solver.trade.search import Search, falls
from solver.trade.setting import Setting
from solver.trade.variations import AS_GIVEN, CORNERS, inside, varied

GUIDE = 'joint_states/guide/position'
PRICE = PerStep(14e-6, 5e-6, 1.0, 3.0)
SHORT = ['duration=0.4', 'maneuver.steering.start=0.1']


def guided(*settings: str, **more: Any) -> Search:
    scene = solver.load_scene('spring_mass', ['duration=0.3', f'require={{{GUIDE}: {{rms: 5 %}}}}', *settings])
    return Search(scene, workers=1, longest=600.0, levels=(), **more)


@pytest.fixture
def priced(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Costs as on a quiet machine; the models that were timed."""
    timed: list[str] = []
    monkeypatch.setattr(cost, 'per_step', lambda scene, setting, **_: timed.append(str(setting)) or PRICE)
    return timed


def test_runs_are_counted_by_what_they_are_made_for(priced: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """The reference takes three steps, and one run on each corner; its second formulation two; an unseen maneuver one
    run of the reference and one of the setting, from a start each of its model."""
    sought: list[Setting] = []
    plain = benches.simulation_of
    monkeypatch.setattr(benches, 'simulation_of', lambda scene: sought.append(scene.fidelity) or plain(scene))
    search = guided(unseen=3)
    assert plan(search)['status'] == 'ok'
    runs = {purpose: spent.runs for purpose, spent in search.ledger.spent.items()}
    corners, checks = len(search.bench.seen) - 1, len(search.checks)
    assert (len(search.bench.steps), len(search.bench.apart), checks) == (3, 1, 3)
    assert runs[ledger.FIRST] == 2
    assert runs[ledger.SECOND] == 2
    assert runs[ledger.UNSEEN] == 2 * checks
    assert runs[ledger.REFERENCE] <= 3 + 2 + corners  # one or two that were tried as reference for other maneuvers
    starts = sum(spent.starts for spent in search.ledger.spent.values())
    assert starts == len(sought) == 1 + corners + checks  # one for each maneuver, whatever the step
    assert sum(spent.cpu for spent in search.ledger.spent.values()) > 0.0


@pytest.mark.parametrize(
    'way', [Setting(h=4e-3), Setting(h=2e-3, iterations=2, rho_inf=0.5), Setting(h=8e-3, iterations=1)]
)
@pytest.mark.parametrize('v', [AS_GIVEN, CORNERS[0]])
def test_a_shared_start_changes_no_bit(way: Setting, v: Any) -> None:
    scene = solver.load_scene('light_car_step_steer', SHORT)
    alone = simulation_of(way.of(scene if v == AS_GIVEN else varied(scene, v)))
    shared = simulation(Bench(scene, ('yaw_rate',), (4e-3, 2e-3, 1e-3)), v, way)
    steps = round(0.2 / way.h)
    np.testing.assert_array_equal(alone.advance(steps).numbers, shared.advance(steps).numbers)


@pytest.mark.parametrize('level', ['full', 'condensed', 'kc'])
@pytest.mark.parametrize('way', [{'h': 2e-3, 'iterations': 2}, {'h': 5e-3, 'iterations': 3}, {'h': 1e-3}])
def test_settings_of_a_level_are_those_that_it_is_derived_with(level: Any, way: dict[str, Any]) -> None:
    """A level without loops of joints makes one iteration in short steps."""
    scene = solver.load_scene('light_car_step_steer', SHORT)
    setting = Setting(level=level, **way)
    given = dataclasses.replace(scene.integrator, **setting.integrator(scene))
    assert derive(setting.of(scene)).scene.integrator == integrator_of(level, given)


def test_a_setting_of_the_full_vehicle_is_not_held_against_itself() -> None:
    """With limits as wide as these the run with 16 ms would do as reference for what a level does, and for 4 ms it
    would not."""
    search = guided()
    assert elsewhere.chosen(search.bench, Setting(level='kc', h=1e-3))[-1].h > 2e-3
    for h in (0.02, 8e-3, 4e-3):
        assert all(one.h <= 0.5 * h for one in elsewhere.chosen(search.bench, Setting(h=h, iterations=1)))
    # the limit of the two finest steps, as far as it goes
    assert elsewhere.chosen(search.bench, Setting(h=1e-3, iterations=1)) == ()


def test_references_are_tried_cheapest_first() -> None:
    found = [[1e3 * one.h for one in option] for option in elsewhere.options((8e-3, 4e-3, 2e-3))]
    assert found == [[8.0], [4.0], [8.0, 4.0], [2.0], [4.0, 2.0]]


def clocked(monkeypatch: pytest.MonkeyPatch, **more: Any) -> tuple[Allowance, Callable[[float, float], None]]:
    """An allowance whose wall time and CPU time are set by hand."""
    now = SimpleNamespace(wall=0.0, cpu=0.0)
    monkeypatch.setattr(allowances, 'clock', lambda: now.wall)
    monkeypatch.setattr(allowances, 'time', SimpleNamespace(process_time=lambda: now.cpu))

    def at(wall: float, cpu: float) -> None:
        now.wall, now.cpu = wall, cpu

    found = Allowance(**more)
    found.begin_again()
    return found, at


def test_ten_full_runs_end_a_plan_and_time_does(monkeypatch: pytest.MonkeyPatch) -> None:
    found, at = clocked(monkeypatch, longest=100.0, times=10.0, startup=1.0, once=lambda: 7.0)
    at(50.0, 30.0)
    assert (found.spent, found.late()) == (0.5, False)  # what the full run takes is not known
    found.full_run = 3.0
    # start of the program in, what is kept for the vehicle out
    assert found.spent == pytest.approx((1.0 + 30.0 - 7.0) / 30.0)
    found.until = 0.7
    assert found.late() and 'times the CPU time of the full run' in found.why_ended()
    at(101.0, 8.0)
    found.until = 1.0
    assert found.late() and 'the time was up after 101 s (mbd plan --time)' in found.why_ended()
    found.ended = lambda: True
    assert 'interrupted' in found.why_ended()


def test_what_does_not_fit_into_ten_full_runs_is_not_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 30 s 27 are gone: 2.9 s more fit, 3.1 do not, and of what is kept back nothing is begun."""
    found, at = clocked(monkeypatch, longest=100.0, times=10.0)
    found.full_run = 3.0
    at(1.0, 27.0)
    assert found.fits(2.9) and not found.fits(3.1)
    found.until = 0.95
    assert not found.late(1.4) and found.late(1.6)
    at(97.0, 1.0)
    assert found.fits(2.9) and not found.fits(3.1)
    found.ended = lambda: True
    assert not found.fits(0.0)


def test_a_start_for_which_no_time_is_left_is_not_sought() -> None:
    asked: list[float] = []

    def stop(ahead: float) -> bool:
        asked.append(ahead)
        return ahead > 0.1

    scene = solver.load_scene('car_step_steer')
    bench = Bench(scene, ('yaw_rate',), (0.004, 0.002, 0.001), stop=stop, made={('start time', FULL.model): 0.2})
    with pytest.raises(Stopped):
        simulation(bench, AS_GIVEN, FULL)
    assert asked == [0.2]


def test_a_plan_ends_at_ten_full_runs_and_says_what_it_knows(priced: list[str]) -> None:
    """Of a program that takes no time to start a full run of 0.3 s takes some 10 ms: a plan cannot be made of ten of
    those."""
    search = guided(times=1.0)
    data = plan(search)
    assert data['status'] == 'incomplete' and data['price']['full_runs'] >= 0.85
    assert any('times the CPU time of the full run' in note for note in data['notes'])
    assert data['settings'] is not None and data['basis'] != 'certified'


def test_what_somebody_ends_ends_at_once(priced: list[str]) -> None:
    """Asked for behind the first run, no other run is made."""
    ended: list[bool] = []
    search = guided(ended=lambda: bool(ended))
    plain = search.find_reference

    def asked() -> bool:
        ended.append(True)
        return plain()

    search.find_reference = asked  # type: ignore[method-assign]
    data = plan(search)
    assert (data['status'], data['interrupted'], data['basis']) == ('incomplete', True, 'coarse twin')
    assert search.ledger.spent.get(ledger.REFERENCE, Spent()).runs == 0
    assert 'nothing of it is checked' in data['give'][0]


def test_another_scene_of_the_vehicle_begins_with_what_was_learned(priced: list[str], tmp_path: Path) -> None:
    first = guided(unseen=1, knowledge=tmp_path)
    assert plan(first)['status'] == 'ok'
    first.learn()
    assert priced  # its steps were timed
    priced.clear()
    other = guided('duration=0.25', f'require={{{GUIDE}: {{rms: 8 %}}}}', unseen=1, knowledge=tmp_path)
    data = plan(other)
    assert data['status'] == 'ok' and not priced
    assert (data['first'][0]['basis'], other.knowledge.plans) == (EARLIER, 1)


@pytest.mark.parametrize('what', ['vehicle', 'program', 'method'])
def test_nothing_stale_is_learned_from(
    what: str, priced: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = guided(unseen=1, knowledge=tmp_path)
    plan(first)
    first.learn()
    change = {'vehicle': ['mechanism.bodies.mass.mass=1.5'], 'method': ['integrator.penalty=1e7'], 'program': []}[what]
    if what == 'program':
        monkeypatch.setattr(knowledge, 'sources', lambda: 'other sources')
    other = guided(*change, knowledge=tmp_path)
    assert other.knowledge.plans == 0 and not other.knowledge.prices() and not other.knowledge.derived


def test_costs_of_another_processor_are_not_taken(
    priced: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = guided(unseen=1, knowledge=tmp_path)
    plan(first)
    first.learn()
    monkeypatch.setattr(knowledge, 'processor', lambda: 'another one')
    other = guided(knowledge=tmp_path)
    assert other.knowledge.plans == 1 and not other.knowledge.prices()


def test_runs_are_shared_whatever_is_required_of_the_scene(priced: list[str], tmp_path: Path) -> None:
    plan(guided(unseen=1, keep_in=tmp_path))
    other = guided(f'require={{{GUIDE}: {{rms: 4 %, max: 10 %}}}}', unseen=1, keep_in=tmp_path)
    plan(other)
    assert other.kept.found > 5
    assert other.ledger.spent.get(ledger.SECOND, Spent()).runs == 0
    assert other.ledger.spent.get(ledger.FIRST, Spent()).runs == 0
    longer = guided('duration=0.4', unseen=1, keep_in=tmp_path)
    plan(longer)
    assert longer.kept.found == 0


def test_what_counts_of_a_band_is_the_next_one_of_a_falling_sequence() -> None:
    """Bands of 1, 0.125 and 0.016 of a limit fall by eight: a quarter of the last one counts, where half as much is
    left to doubt. What is rounding, and the first band, say nothing."""
    r, other = Requirement(GUIDE, 'rms', 0.01, True), Requirement(GUIDE, 'max', 0.01, True)
    assert falls({r: 0.125}, {r: 1.0}) == 0.25
    # the slowest one counts, and what it says is nothing
    assert falls({r: 0.125, other: 0.05}, {r: 1.0, other: 0.1}) == 1.0
    assert falls({r: 0.125, other: 1e-6}, {r: 1.0, other: 1e-6}) == 0.25
    assert falls({r: 0.125}, {}) == falls({r: 2.0}, {r: 1.0}) == 1.0


@pytest.mark.slow
def test_the_limit_of_a_car_is_nearer_to_that_of_shorter_steps_than_what_counts_of_its_band() -> None:
    """With steps of 8, 4 and 2 ms, beside those of a quarter."""
    scene = solver.load_scene('light_car_step_steer', ['duration=1', 'maneuver.steering.start=0.2'])
    bench = Bench(scene, ('yaw_rate', 'sideslip_velocity', 'wheel_load.front_left'), (8e-3, 4e-3, 2e-3))
    coarse, finest = (
        limit_of(bench, AS_GIVEN, converging(FULL, steps)) for steps in ((1.6e-2, 8e-3, 4e-3), (2e-3, 1e-3, 5e-4))
    )
    found = limit_of(bench, AS_GIVEN, converging(FULL, bench.steps))
    for name, error in finest.errors(found.as_run).items():
        one = Requirement(name, 'rms', 1.0, False)
        shares = [{one: of.band[name].rms / (0.01 * of.peaks[name])} for of in (found, coarse)]
        assert error.rms <= falls(*shares) * found.band[name].rms, name


@pytest.mark.parametrize(
    ('asked', 'passed', 'status'), [(None, 2, 'incomplete'), (None, 7, 'incomplete'), (None, 8, 'ok'), (2, 2, 'ok')]
)
def test_a_certificate_rests_on_eight_passes_at_least(
    asked: int | None, passed: int, status: str, priced: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Braking on split friction with 4 ms passed two other maneuvers and failed on the fourth."""
    monkeypatch.setattr(
        Search, 'check_unseen', lambda self, setting: [Check(inside(k), 0.5, '', '') for k in range(passed)]
    )
    data = plan(guided(unseen=asked))
    assert (data['status'], data['unseen']['passed']) == (status, passed)
    if status != 'ok':
        assert data['give'][0].endswith(f'it passed {passed} others, too few for a certificate, which takes 8')
