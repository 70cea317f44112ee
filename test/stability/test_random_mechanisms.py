"""Random mechanisms of every family: they are what their families say, and the default neither fails nor lies on them.

`mbd study mechanisms` is the full study. Limits, and what is compared with what: mbd_sim_ros.lab.mechanisms.judgement.
"""

from __future__ import annotations

import numpy as np
import pytest

from mbd_sim_ros.lab.mechanisms.draft import Mechanism
from mbd_sim_ros.lab.mechanisms.families import FAMILIES, draw, drawn
from mbd_sim_ros.lab.mechanisms.judgement import RIGHT, STEPS, TOLD, UNDECIDED, WRONG, classify, judge
from mbd_sim_ros.lab.mechanisms.references import jumps
from solver.files.scene import load_scene_text
from solver.simulation import Simulation

JUDGED = 42  # three of each family


@pytest.mark.parametrize('family', FAMILIES)
def test_a_draw_can_be_repeated_and_differs_from_the_next(family: str) -> None:
    mechanism = draw(family, 3)
    assert mechanism.text == draw(family, 3).text != draw(family, 4).text
    assert load_scene_text(mechanism.text, mechanism.name).model == mechanism.scene.model


def test_a_series_goes_through_all_families() -> None:
    assert [drawn(k, 5).family for k in range(len(FAMILIES))] == list(FAMILIES)
    assert drawn(0, 5).text != drawn(len(FAMILIES), 5).text != drawn(0, 6).text


def described(mechanism: Mechanism) -> dict:
    return Simulation(mechanism.at(1.0, h=1e-3)).describe()


@pytest.mark.parametrize('seed', range(3))
def test_overconstrained_linkages_move_although_a_count_forbids_it(seed: int) -> None:
    """Bennett's and Sarrus' linkage have one freedom; 4 hinges on 3 bodies leave -2, k legs with 3 hinges 6 - 3 k."""
    assert described(draw('bennett', seed))['dof'] == 1
    sarrus = draw('sarrus', seed)
    found = described(sarrus)
    legs = (len(sarrus.scene.model.bodies) - 1) // 2
    assert found['dof'] == 1
    assert found['redundant_constraints'] == 15 * legs - (12 * legs + 5)


def test_families_have_what_they_are_named_after() -> None:
    for seed in range(5):
        assert described(draw('plane_loop', seed))['redundant_constraints'] >= 3
        assert described(draw('duplicates', seed))['redundant_constraints'] >= 1
        assert draw('springs', seed).scene.model.spring_dampers
        assert draw('bushings', seed).scene.model.bushings
        assert draw('drivers', seed).scene.maneuver.channels
        assert draw('rolling', seed).scene.model.contacts


def second_order(
    error: float, *, off: dict[float, float] | None = None, fast: float = 0.0
) -> list[tuple[float, str, str, float, float]]:
    """Runs with an error of second order, but for those in `off`; fast: amplitude of a vibration that no step
    resolves."""
    d = {h: max(h * h, fast) for h in STEPS}
    return [(h, 'ok', '', (off or {}).get(h, error * d[h]), d[h]) for h in STEPS]


def judgements(
    found: list[tuple[float, str, str, float, float]], spread: float = 1e-12, *, smooth: bool = True
) -> list[str]:
    return [run.judgement for run in classify(found, spread, 1.0, smooth=smooth)]


def test_second_order_is_right_and_so_is_what_no_step_resolves() -> None:
    assert judgements(second_order(0.3)) == [RIGHT] * 5
    assert judgements(second_order(0.3, fast=1e-3)) == [RIGHT] * 5


def test_what_departs_from_second_order_is_told_or_wrong() -> None:
    """One step that is off, two beside each other that agree, and a limit that is another motion."""
    off = {h: 0.3 * h * h for h in STEPS}
    assert judgements(second_order(0.3, off={2e-3: 20 * off[2e-3]})) == [RIGHT, RIGHT, WRONG, RIGHT, RIGHT]
    assert judgements(second_order(0.3, off={2e-3: 2.8e-5, 1e-3: 2.8e-5})) == [RIGHT, RIGHT, WRONG, WRONG, RIGHT]
    assert judgements(second_order(0.3, off=dict.fromkeys(STEPS, 0.01)))[1:] == [WRONG] * 4
    told = second_order(0.3, off={2e-3: 1.0})
    told[2] = (2e-3, 'suspect', 'because', 1.0, told[2][4])
    assert judgements(told) == [RIGHT, RIGHT, TOLD, RIGHT, RIGHT]


def test_a_velocity_that_changes_at_once_is_seen() -> None:
    """A body that is hit between two samples, beside one that swings 50 times a second."""
    t = np.arange(0.0, 0.5, 5e-4)
    y = np.zeros((len(t), 1, 7))
    y[:, 0, 0] = 0.1 * np.sin(2 * np.pi * 50.0 * t)
    assert not jumps(y)
    y[:, 0, 1] = 2.0 * np.maximum(0.0, t - 0.30012)
    assert not jumps(y)  # 2 m/s are what the vibration adds in 20 samples
    y[:, 0, 0] /= 50.0
    assert jumps(y)


def test_who_agrees_with_a_reference_whose_steps_collapse_is_right_and_who_does_not_is_undecided() -> None:
    """On another branch runs disagree alike at every step: by each other some of them would be right."""
    assert judgements(second_order(0.3), smooth=False) == [RIGHT] * 5
    assert judgements(second_order(0.3, off=dict.fromkeys(STEPS, 0.5)), smooth=False) == [UNDECIDED] * 5


def test_a_run_beside_none_that_is_ok_is_held_against_the_next_coarser_one() -> None:
    """A vibration that loses its phase: errors of second order, a hundred times what a step does not see. Only the
    finest is ok."""
    for off, judgement in ((100.0, RIGHT), (900.0, WRONG)):
        found = second_order(100.0, off={STEPS[-1]: off * STEPS[-1] ** 2})
        found[:-1] = [(h, 'suspect', 'because', error, d) for h, _, _, error, d in found[:-1]]
        assert judgements(found) == [TOLD] * 4 + [judgement]


def test_a_run_whose_steps_were_divided_is_no_witness_of_its_step() -> None:
    found = second_order(0.3, off=dict.fromkeys((1e-2, 5e-3, 2e-3), 0.3e-7))
    assert judgements(found)[-2:] == [WRONG, WRONG]
    assert [run.judgement for run in classify(found, 1e-12, 1.0, (), {1e-2, 5e-3, 2e-3})] == [RIGHT] * 5


def test_what_no_reference_resolves_is_undecided() -> None:
    found = second_order(0.3, off={2e-3: 1e-3})
    assert judgements(found, spread=1e-3)[2] == UNDECIDED
    assert judgements(found, spread=np.nan) == [UNDECIDED] * 5


@pytest.mark.long
@pytest.mark.slow
def test_a_reference_that_leaves_its_branch_decides_nothing() -> None:
    """A constant-velocity joint folds over by 180 degrees. The default goes on as before; the reference turns the body
    by half a turn about itself within a microsecond, at both tolerances alike and with the same energy."""
    judged = judge(
        next(m for m in (drawn(k, 1) for k in range(1000)) if m.name == 'tree_1000010'), (STEPS[-1], 0.5 * STEPS[-1])
    )
    assert [run.judgement for run in judged.runs] == [TOLD, UNDECIDED]


# one of a family, whose references take least; two more of each take three minutes
QUICK = (*range(1, 7), 8, 9, 12, 13, 14)
SLOW = {
    'parallelogram',
    'springs',
    'bushings',
}  # families whose references take longer than those of all others together: by `pytest -m long`


def test_one_of_a_family_is_judged_always() -> None:
    assert sorted(drawn(k, 2026).family for k in QUICK) == sorted(set(FAMILIES) - SLOW)


@pytest.mark.slow
@pytest.mark.parametrize(
    'number', [pytest.param(k, marks=() if k in QUICK else pytest.mark.long) for k in range(JUDGED)]
)
def test_the_default_neither_fails_nor_lies(number: int) -> None:
    mechanism = drawn(number, 2026)
    judged = judge(mechanism)
    bad = [run for run in judged.runs if run.judgement == WRONG or run.status in ('error', 'refused')]
    assert not bad, f'{mechanism.name}: {bad[0]}\n{mechanism.text}'
