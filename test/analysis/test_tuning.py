"""The search behind mbd tune, on functions whose solutions are known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from mbd_sim_ros.analysis.tuning import Found, Key, Target, Tuning
from solver.errors import SpecError


def search(
    keys: list[Key], targets: list[Target], of: Callable[..., dict[str, float]], start: dict[str, float] | None = None
) -> Found:
    def figures(values: dict[str, float]) -> dict[str, float]:
        return of(**values)

    given = figures(start or {key.name: float(key.start if key.start is not None else key.low) for key in keys})
    return Tuning(keys, targets, figures, given).run()


def test_a_straight_line_takes_two_steps() -> None:
    """f = 2 x + 1 is 7 at x = 3: the given car, a difference there, the step of Newton, a difference there."""
    found = search([Key('x', 0.0, 10.0, 1.0)], [Target('f', 7.0, 0.01)], lambda x: {'f': 2.0 * x + 1.0})
    assert found.reached and found.values['x'] == pytest.approx(3.0, abs=0.0051)
    assert found.sensitivity[0, 0] == pytest.approx(2.0)
    assert found.evaluations == 4 and found.holding == {}


def test_two_figures_by_two_keys() -> None:
    """x y = 6 and x + y = 5 at (2, 3) or (3, 2), both curved."""
    keys = [Key('x', 0.0, 4.0, 1.0), Key('y', 0.0, 4.0, 3.5)]
    found = search(keys, [Target('p', 6.0, 0.02), Target('s', 5.0, 0.02)], lambda x, y: {'p': x * y, 's': x + y})
    assert found.reached
    assert sorted(found.values.values()) == pytest.approx([2.0, 3.0], abs=0.05)
    x, y = found.values.values()
    assert found.sensitivity == pytest.approx(np.array([[y, x], [1.0, 1.0]]), rel=0.01)


def test_more_keys_than_figures_are_enough() -> None:
    keys = [Key(name, 0.0, 1.0, 0.5) for name in 'abc']
    found = search(keys, [Target('f', 2.4, 0.001)], lambda a, b, c: {'f': a + b + c})
    assert found.reached and found.figures['f'] == pytest.approx(2.4, abs=0.001)


def test_the_bound_that_holds_is_named() -> None:
    """The best is at the bound itself, not near it."""
    found = search([Key('x', 0.0, 10.0, 1.0)], [Target('f', 30.0, 0.1)], lambda x: {'f': 2.0 * x + 1.0})
    assert not found.reached and found.values == {'x': 10.0} and found.holding == {'x': 'high'}
    assert found.figures == {'f': 21.0}
    found = search([Key('x', 2.0, 10.0, 5.0)], [Target('f', 0.0, 0.1)], lambda x: {'f': x * x})
    assert not found.reached and found.values == {'x': 2.0} and found.holding == {'x': 'low'}


def test_a_figure_that_turns_is_followed_from_both_ends() -> None:
    """(x - 1)^2 = 3.24 only at 2.8 of 0 to 3; from 0.2 the way up ends at the lower bound, where it is 1."""
    found = search([Key('x', 0.0, 3.0, 0.2)], [Target('f', 3.24, 0.01)], lambda x: {'f': (x - 1.0) ** 2})
    assert found.reached and found.values['x'] == pytest.approx(2.8, abs=0.01)


def test_an_extreme_within_the_bounds_is_not_a_bound() -> None:
    """1 - (x - 1)^2 is 1 at most."""
    found = search([Key('x', 0.0, 3.0, 0.2)], [Target('f', 2.0, 0.01)], lambda x: {'f': 1.0 - (x - 1.0) ** 2})
    assert not found.reached and found.holding == {}
    assert found.figures['f'] == pytest.approx(1.0, abs=0.02)


def test_targets_that_contradict_each_other_are_met_half_way() -> None:
    """x = 1 and x = 2 with the same tolerance: least squares are at 1.5."""
    found = search(
        [Key('x', 0.0, 3.0, 0.2)], [Target('f', 1.0, 0.1), Target('g', 2.0, 0.1)], lambda x: {'f': x, 'g': x}
    )
    assert not found.reached and found.holding == {} and found.values['x'] == pytest.approx(1.5, abs=0.03)


def test_a_key_without_effect_holds_nothing() -> None:
    found = search([Key('x', 0.0, 1.0, None)], [Target('f', 2.0, 0.1)], lambda x: {'f': 1.0})
    assert not found.reached and found.holding == {} and not found.sensitivity.any()


def test_where_there_are_no_figures_the_search_goes_on_elsewhere() -> None:
    """No figures above x = 6: a target behind it is not reached, one before it is; both say why."""

    def of(x: float) -> dict[str, float]:
        if x > 6.0:
            raise SpecError('it tips over')
        return {'f': x}

    found = search([Key('x', 0.0, 10.0, 1.0)], [Target('f', 5.0, 0.01)], of)
    assert found.reached and found.values['x'] == pytest.approx(5.0, abs=0.01)
    found = search([Key('x', 0.0, 10.0, 1.0)], [Target('f', 9.0, 0.01)], of)
    assert not found.reached and found.failures == ('it tips over',) and found.figures['f'] <= 6.0
    with pytest.raises(SpecError, match='it tips over'):
        search([Key('x', 7.0, 10.0, None)], [Target('f', 9.0, 0.01)], of, {'x': 1.0})


def test_found_values_have_few_digits() -> None:
    found = search([Key('x', 0.0, 1000.0, 100.0)], [Target('f', 3.0, 0.1)], lambda x: {'f': x ** (1 / 3)})
    assert found.reached and found.values['x'] == round(found.values['x'], 1)
