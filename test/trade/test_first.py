"""First answers: the rule of thumb is that of its page, and what is answered costs next to nothing."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import pytest

import solver
from solver.trade import cost, first
from solver.trade.bench import FULL, limit_of, run_of
from solver.trade.cost import PerStep
from solver.trade.errors import Requirement
from solver.trade.first import RULE, RULES, TWIN, Answer, before_runs, by_twin, rule_for
from solver.trade.knowledge import Knowledge
from solver.trade.search import Search
from solver.trade.setting import Setting
from solver.trade.variations import AS_GIVEN

PAGE = Path(__file__).parents[2] / 'docs' / 'accuracy.md'
QUANTITIES = {
    'yaw rate': 'yaw_rate',
    'lateral velocity': 'sideslip_velocity',
    'roll': 'roll',
    'wheel load': 'wheel_load',
    'place': 'position',
}
GUIDE = 'joint_states/guide/position'


def of_page() -> set[tuple[str, float, str, float]]:
    """(quantity, limit, the dearest setting of the line, its cost) of all lines that have a setting for every scene."""
    found = set()
    for line in PAGE.read_text(encoding='utf-8').splitlines():
        wish, *cells = [cell.strip() for cell in line.strip('| ').split(' | ')]
        match = re.fullmatch(r'(.*) within ([\d.]+) (%|m|mm)', wish)
        if match and len(cells) == 5 and '-' not in cells:
            settings = [cell.rsplit(': ', 1) for cell in cells]
            text, price = max(settings, key=lambda each: float(each[1]))
            scale = {'%': 0.01, 'm': 1.0, 'mm': 1e-3}[match[3]]
            found.add((QUANTITIES[match[1]], round(float(match[2]) * scale, 9), text, float(price)))
    return found


def test_the_rule_of_thumb_is_that_of_its_page() -> None:
    assert {(r.quantity, r.limit, str(r.setting), r.cost) for r in RULES} == of_page()


def test_the_loosest_line_that_is_no_looser_than_the_wish_is_taken() -> None:
    found = {value: rule_for(Requirement('yaw_rate', 'rms', value, True)) for value in (0.2, 0.05, 0.02, 0.01, 0.005)}
    assert [None if rule is None else rule.limit for rule in found.values()] == [0.05, 0.05, 0.01, 0.01, None]
    assert rule_for(Requirement('wheel_load.rear_left', 'rms', 0.01, True)) is not None
    assert rule_for(Requirement('yaw_rate', 'max', 0.05, True)) is None  # nothing is said of largest errors
    assert rule_for(Requirement('yaw_rate', 'rms', 0.05, False)) is None  # nor of rad/s


@pytest.mark.parametrize(
    ('wishes', 'level', 'h'),
    [
        ('{yaw_rate: {rms: 5 %}}', 'condensed', 8e-3),
        ('{yaw_rate: {rms: 5 %}, wheel_load.front_left: {rms: 0.1 %}}', 'full', 2e-3),  # the dearer of both
        ('{yaw_rate: {rms: 0.2 %}}', 'full', 1e-3),
        ('{yaw_rate: {rms: 5 %}, pitch: {rms: 5 %}}', 'full', 1e-3),  # of pitch the page says nothing
    ],
)
def test_what_no_line_says_is_the_full_vehicle(wishes: str, level: str, h: float) -> None:
    search = Search(solver.load_scene('light_car_step_steer', [f'require={wishes}']))
    answer = before_runs(search.bench, search.knowledge)
    assert (answer.setting.level, answer.setting.h, answer.basis) == (level, h, RULE)
    assert not search.ledger.spent


def answered(scene: str, *settings: str) -> tuple[Search, list[tuple[Answer, int, int]]]:
    """A search, and its first answers with the runs and steps that had been made by then."""
    told: list[tuple[Answer, int, int]] = []

    def answer(one: Answer) -> None:
        spent = search.ledger.spent.values()
        told.append((one, sum(s.runs for s in spent), sum(s.steps for s in spent)))

    search = Search(solver.load_scene(scene, settings), workers=1, longest=600.0, levels=(), unseen=1, answer=answer)
    search.find_reference = lambda: False  # type: ignore[method-assign]
    assert search.find() is None
    return search, told


def test_two_answers_come_before_any_long_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cost, 'per_step', lambda scene, setting, **_: PerStep(14e-6, 5e-6, 1.0, 3.0))
    search, told = answered(
        'light_car_step_steer', 'duration=0.8', 'maneuver.steering.start=0.1', 'require={yaw_rate: {rms: 2 %}}'
    )
    (rule, runs, steps), (twin, more_runs, more) = told
    assert (rule.basis, runs, steps) == (RULE, 0, 0)
    assert (twin.basis, more_runs) == (TWIN, 2)  # the full vehicle with a step and with twice that
    assert 0 < more <= 0.4 * search.scene.duration / search.scene.integrator.h
    assert set(search.ledger.spent) <= {'first answer', 'cost of steps'}


def test_the_error_that_a_twin_estimates_is_that_of_its_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """The estimate from 8 and 4 ms, beside the limit of steps four times as short: within a factor of two at the step
    that is answered."""
    monkeypatch.setattr(cost, 'per_step', lambda scene, setting, **_: PerStep(14e-6, 5e-6, 1.0, 3.0))
    search = Search(
        solver.load_scene('spring_mass', ['duration=1', f'require={{{GUIDE}: {{rms: 0.2 %}}}}']), workers=1, levels=()
    )
    answer = by_twin(search.bench, (), lambda text: None)
    assert answer is not None and answer.basis == TWIN and 0.0 < answer.used <= first.KEPT
    truth = limit_of(search.bench, AS_GIVEN, tuple(dataclasses.replace(FULL, h=h) for h in (2e-3, 1e-3)))
    error = truth.errors(run_of(search.bench, AS_GIVEN, answer.setting))[GUIDE]
    assert 0.5 < answer.used / (error.share('rms') / 0.002) < 2.0


def test_what_kept_the_limits_before_is_answered_first(tmp_path: Path) -> None:
    search = Search(solver.load_scene('light_car_step_steer', ['require={yaw_rate: {rms: 2 %}}']), knowledge=tmp_path)
    errors = {'yaw_rate': {'max': 0.01, 'rms': 0.004, 'peak': 0.3}}
    search.knowledge._data['errors'] = [
        {'maneuver': kind, 'setting': dataclasses.asdict(Setting(level=level, h=h)), 'cost': price, 'errors': errors}
        for kind, level, h, price in (
            ('Step', 'kc', 1e-2, 0.03),
            ('Sine', 'single_track', 2e-2, 0.004),
            ('Step', 'full', 4e-3, 0.2),
        )
    ]
    answer = before_runs(search.bench, search.knowledge)
    # of maneuvers of this kind the cheapest
    assert (answer.basis, answer.setting.level, answer.cost) == (first.EARLIER, 'kc', 0.03)
    # 0.004 is 0.89 of it
    tighter = Search(solver.load_scene('light_car_step_steer', ['require={yaw_rate: {rms: 1.5 %}}']))
    tighter.knowledge = search.knowledge
    assert before_runs(tighter.bench, tighter.knowledge).basis == RULE
    assert Knowledge(None, search.scene).plans == 0
