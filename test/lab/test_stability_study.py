"""Parts of the study of stability: what they call right, told and silently wrong, on problems whose answer is known."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from mbd_sim_ros.lab.mechanisms.judgement import RIGHT, TOLD, WRONG
from mbd_sim_ros.lab.studies import stability, stability_cars, stability_maps, stability_passages
from mbd_sim_ros.lab.studies.neighbours import silent, within
from mbd_sim_ros.lab.studies.stability_maps import (
    Line,
    Problem,
    moved,
    oscillator,
    pendulum,
    run_line,
    slider_crank,
    top,
)

STEPS = (1e-3, 2e-3, 5e-3)


def judgements(line: Line, steps: tuple[float, ...] = STEPS) -> list[str]:
    return [run['judgement'] for run in run_line(line, steps)['runs']]


@pytest.mark.parametrize('problem', [oscillator, pendulum, top], ids=lambda p: p.__name__)
def test_motions_that_steps_resolve_are_right(problem) -> None:
    assert judgements(Line(problem, 1.0)) == [RIGHT] * 3


def test_a_stiff_spring_is_told_at_every_step() -> None:
    assert judgements(Line(partial(oscillator, 1e9), 1e6)) == [TOLD] * 3


def test_another_motion_that_is_called_exact_makes_runs_silently_wrong() -> None:
    """Steps that agree with each other on another motion: errors stay, what steps do not see of it falls with their
    square."""

    def off() -> Problem:
        right = oscillator()
        return right._replace(exact=lambda: right.exact() * np.array([1.001, 1, 1, 1, 1, 1, 1]))

    assert judgements(Line(off, 1.0), (1e-3, 5e-4, 2e-4, 1e-4))[-1] == WRONG


def test_a_problem_moved_is_the_same_one_elsewhere() -> None:
    problem = moved(pendulum, 100.0)
    there, here = problem.scene(h=1e-3).model, pendulum().scene(h=1e-3).model
    offsets = [np.array(a.position) - b.position for a, b in zip(there.bodies, here.bodies, strict=True)]
    np.testing.assert_allclose(offsets, [[60.0, -64.0, 48.0]] * 2, rtol=0, atol=1e-12)
    assert judgements(Line(partial(moved, pendulum, 100.0), 100.0)) == [RIGHT] * 3


def test_rounding_far_from_the_origin_is_told_before_it_chooses_how_a_linkage_passes_its_singular_positions() -> None:
    """At 1e7 m the motion of 1 ms is that at the origin to 1e-5 m, that of 0.5 ms to 3e-4."""
    far = Line(partial(moved, slider_crank, 1e7), 1e7, {}, stability_maps.EPS * 1e7)
    assert judgements(far, (5e-4, 1e-3, 2e-3)) == [TOLD, RIGHT, RIGHT]


def test_passages_are_counted_and_on_their_branch() -> None:
    found = stability_passages.passages(0.01, stability_passages.PHASES)
    assert found['passages'] >= stability_passages.PHASES
    assert (found['lost'], found['wrong_branch']) == (0, 0)


def test_a_car_that_stands_is_right_and_one_that_slides_is_not() -> None:
    task = stability_cars.TASKS['standstill']._replace(duration=0.4)
    assert [run['judgement'] for run in stability_cars.staying('light', task, (4e-3,))['runs']] == [RIGHT]
    sliding = task._replace(overrides=(*task.overrides, 'start.speed=1'))
    assert [run['judgement'] for run in stability_cars.staying('light', sliding, (4e-3,))['runs']] == [WRONG]


@pytest.mark.parametrize(('right', 'shown'), [
    ([True, True, True, True], 'all'),
    ([False, True, True, False], '2 to 3'),
    ([True, False, False, False], '1 to 1'),
    ([False] * 4, 'none'),
])  # fmt: skip
def test_limits_are_the_longest_run_of_what_is_right(right: list[bool], shown: str) -> None:
    assert stability._span(list(zip((1.0, 2.0, 3.0, 4.0), right, strict=True))) == shown


def test_every_map_of_the_full_study_has_its_lines() -> None:
    """Spans that the study is for: steps of 0.05 to 50 ms, penalties, stiffness, masses, distance."""
    maps = stability_maps.maps(quick=False)
    spans = {name: [line.ordinate for line in next(iter(m.panels.values()))] for name, m in maps.items()}
    assert (min(stability_maps.STEPS), max(stability_maps.STEPS)) == (0.05e-3, 50e-3)
    assert (stability_maps.PENALTIES[0], stability_maps.PENALTIES[-1]) == (1e1, 1e13)
    assert (spans['step_rho'][0], spans['step_rho'][-1]) == (0.0, 1.0)
    assert (spans['step_stiffness'][0], spans['step_stiffness'][-1]) == (1e-3, 1e6)
    assert (spans['step_mass_ratio'][0], spans['step_mass_ratio'][-1]) == (1e-12, 1e12)
    assert spans['step_distance'][-1] == 1e7


@pytest.mark.parametrize(
    ('errors', 'allowed'),
    [
        ((4e-4, 1e-4, 2.5e-5), True),  # second order
        ((4e-4, 1e-4, 1e-6), True),  # the finer step is better than predicted, the coarser one as predicted
        ((1e-5, 1e-4, 2.5e-5), False),  # grows with a smaller step
        ((1.05e-4, 1e-4, 1e-4), False),  # does not converge
        ((1e-9, 5e-10, 1e-12), True),
        ((None, 1e-3, 1e-6), False),  # 250 times what the finer step predicts, and the coarser one did not arrive
        ((None, 1e-3, None), False),
    ],
)
def test_neighbouring_steps_allow_ten_times_what_second_order_predicts(errors, allowed) -> None:
    runs = [{'h': h, 'error': error, 'judgement': RIGHT} for h, error in zip((2e-3, 1e-3, 5e-4), errors, strict=True)]
    assert within(runs, 1) == allowed
    runs[1]['judgement'] = WRONG
    assert silent([{'runs': runs}]) == (1, int(not allowed))
