"""Scalar laws."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from solver.elements.laws import Law, compile_laws, evaluate_law, geared, sum_of
from solver.errors import SpecError

POINTS = [[-2.0, -9.0], [-0.5, -1.0], [0.4, 0.0], [1.0, 2.0], [3.0, 12.0]]
STEP = 1e-40


def evaluate(law, x):
    """(value, slope, integral) at the points x; the law is not the first in its table."""
    table = compile_laws([Law.linear(5.0), law, Law.linear(-1.0)])
    return np.array([evaluate_law(table, 1, s) for s in np.atleast_1d(x)]).T


def test_linear_law():
    x = np.array([-3.0, 0.0, 0.5])
    np.testing.assert_allclose(evaluate(Law.linear(4.0), x), [4 * x, [4, 4, 4], 2 * x * x], rtol=1e-15)


def test_absent_law_is_zero():
    assert evaluate_law(compile_laws([]), -1, 2.0) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    'points',
    [POINTS, [[0, 0], [1, 0], [1.1, 5], [2, 5], [3, 5.1], [4, -2]], [[0, 0], [1, 1], [1.5, -4]], [[0, 1], [2, 5]]],
    ids=['rising', 'plateaus and steps', 'steep ends', 'two points'],
)
def test_table_is_the_monotone_cubic_through_its_points(points):
    """Inside the table the law is scipy's PCHIP; at the points it is exact."""
    law = Law.table(points)
    x = np.linspace(points[0][0], points[-1][0], 101)
    points = np.array(points, float)
    np.testing.assert_allclose(evaluate(law, x)[0], PchipInterpolator(*points.T)(x), rtol=0, atol=1e-13)
    np.testing.assert_allclose(evaluate(law, points[:, 0])[0], points[:, 1], rtol=0, atol=1e-14)


def test_table_does_not_overshoot():
    """Between two neighbouring points the values stay between theirs, in a sequence with steps and plateaus."""
    points = np.array([[0, 0], [1, 0], [1.1, 5], [2, 5], [3, 5.1], [4, -2]], float)
    law = Law.table(points.tolist())
    for a, b in pairwise(points):
        y = evaluate(law, np.linspace(a[0], b[0], 50))[0]
        assert y.min() >= min(a[1], b[1]) - 1e-12
        assert y.max() <= max(a[1], b[1]) + 1e-12


@pytest.mark.parametrize(
    'law', [Law.linear(3.0), Law.table(POINTS), Law.table(POINTS[:2])], ids=['linear', 'table', 'two points']
)
def test_slope_and_integral_belong_to_the_value(law):
    """Slope is the complex-step derivative of the value, the value that of the integral, which vanishes at 0."""
    table = compile_laws([law])
    for x in [-7.0, -2.0, -1.3, -0.5, 0.0, 0.2, 0.4, 0.7, 2.9, 3.0, 8.0]:
        value, slope, area = evaluate_law(table, 0, complex(x, STEP))
        assert value.imag / STEP == pytest.approx(slope.real, rel=1e-13, abs=1e-13)
        assert area.imag / STEP == pytest.approx(value.real, rel=1e-13, abs=1e-13)
    assert evaluate_law(table, 0, 0.0)[2] == pytest.approx(0.0, abs=1e-15)


def test_law_is_once_continuously_differentiable():
    """Value, slope and integral have no jump at any knot: 1e-9 beside it they differ by the next derivative times
    2e-9."""
    law = Law.table(POINTS)
    for knot in np.array(POINTS)[:, 0]:
        left, right = evaluate(law, [knot - 1e-9, knot + 1e-9]).T
        np.testing.assert_allclose(left, right, rtol=0, atol=1e-7)


def test_table_continues_with_its_end_slopes():
    law = Law.table(POINTS)
    (y0, s0, _), (y1, s1, _) = evaluate(law, [-2.0, 3.0]).T
    (ya, sa, _), (yb, sb, _) = evaluate(law, [-12.0, 13.0]).T
    np.testing.assert_allclose([ya, yb, sa, sb], [y0 - 10 * s0, y1 + 10 * s1, s0, s1], rtol=1e-14)


@pytest.mark.parametrize(
    ('points', 'message'),
    [
        ([[0, 0]], 'at least two'),
        ([[0, 0], [0, 1]], r'points\[1\]\[0\] = 0.0: must be greater than the x before it \(0\)'),
        ([[0, 0], [1, float('inf')]], r'points\[1\]\[1\]'),
        ([[0, 0], [1]], r'points\[1\] .* must be \[x, y\]'),
    ],
)
def test_refusals_name_the_point_and_the_remedy(points, message):
    with pytest.raises(SpecError, match=message):
        Law.table(points)


@pytest.mark.parametrize('factor', [0.3, -2.0])
def test_a_geared_law_is_felt_by_its_lever(factor):
    """Of energy W(factor x): factor times the value, factor^2 times the slope, the same integral."""
    law = Law.table(POINTS)
    x = np.linspace(-4.0, 4.0, 41)
    y, slope, area = evaluate(law, factor * x)
    np.testing.assert_allclose(
        evaluate(geared(law, factor), x), [factor * y, factor * factor * slope, area], rtol=0, atol=1e-12
    )


def test_a_sum_of_laws_is_exact():
    """Tables on other knots, one of them a straight line: value, slope and integral are the sums, inside and beyond all
    knots."""
    laws = [Law.table(POINTS), Law.linear(-0.7), Law.table([[-1.0, 2.0], [0.1, 2.5], [4.0, 3.0]])]
    x = np.linspace(-4.0, 6.0, 101)
    np.testing.assert_allclose(evaluate(sum_of(laws), x), sum(evaluate(law, x) for law in laws), rtol=0, atol=1e-12)
