"""Errors of a signal against its reference, on curves whose departures are known."""

from __future__ import annotations

import numpy as np
import pytest

from solver.analysis.departures import departure
from solver.quantities import Quantity
from solver.trade.errors import Requirement

T = 0.01 * np.arange(1001)  # s
W = 2.0 * np.pi * 0.5  # rad/s; ten seconds are five periods


def made(least: float = 1e-3, from_start: bool = False) -> Quantity:
    return Quantity('made', 'm', least, np.zeros(1, int), lambda rows: rows, from_start)


def test_an_error_of_a_known_size_is_found_with_its_share_of_the_peak() -> None:
    """A sine of amplitude 0.02 beside one of 2: largest 0.02, root mean square over whole periods 0.02/sqrt(2), shares
    of the peak of 2.

    The largest value on the grid misses the crest by less than (w dt)^2/2 = 5e-4 of it, the mean over 1001 instead of
    1000 points by 1e-3.
    """
    found = departure(made(), T, (2.02 * np.sin(W * T))[:, None], (2.0 * np.sin(W * T))[:, None])
    assert found.max == pytest.approx(0.02, rel=1e-3)
    assert found.rms == pytest.approx(0.02 / np.sqrt(2.0), rel=2e-3)
    assert found.share('max') == pytest.approx(0.01, rel=1e-3)


@pytest.mark.parametrize('late', [0.0, 0.004, 0.05, -0.03])
def test_the_delay_of_a_sine_is_found_between_its_samples(late: float) -> None:
    """Piecewise linear interpolation misses a sine by (w dt)^2/8 = 1.2e-4; over the slope w that is 4e-5 s."""
    found = departure(made(), T, np.sin(W * (T - late))[:, None], np.sin(W * T)[:, None])
    assert found.delay == pytest.approx(late, abs=2e-4)


def test_an_offset_is_no_delay_and_noise_has_none() -> None:
    noise = np.random.default_rng(1).normal(size=(T.size, 1))
    assert departure(made(), T, 3.0 + np.sin(W * T)[:, None], np.sin(W * T)[:, None]).delay == pytest.approx(
        0.0, abs=1e-9
    )
    assert np.isinf(departure(made(), T, noise, np.sin(W * T)[:, None]).delay)
    assert np.isnan(departure(made(least=0.1), T, np.zeros((T.size, 1)), 1e-3 * np.sin(W * T)[:, None]).delay)


@pytest.mark.parametrize('other', [0.0 * T, np.sin(1.3 * W * T), -np.sin(W * T)])
def test_a_small_change_of_something_large_that_is_missed_is_no_short_delay(other: np.ndarray) -> None:
    """A wheel load of 5000 N that swings by 200 N, in another run not at all, at another frequency, or the other way:
    within 5 % of its peak, and late without end."""
    of = Requirement('wheel_load.front_left', 'delay', 5e-3, False)
    quantity = made(least=100.0)
    assert (
        of.error(departure(quantity, T, 5000.0 + 200.0 * other[:, None], 5000.0 + 200.0 * np.sin(W * T)[:, None]))
        == np.inf
    )
    assert (
        of.error(departure(quantity, T, 5000.0 + 20.0 * other[:, None], 5000.0 + 20.0 * np.sin(W * T)[:, None])) == 0.0
    )


def test_a_straight_line_has_no_delay_that_an_offset_has_not() -> None:
    of = Requirement('position', 'delay', 5e-3, False)
    assert of.error(departure(made(), T, 20.0 * T[:, None] + 0.1, 20.0 * T[:, None])) == pytest.approx(0.0, abs=1e-2)


def test_the_error_of_a_place_is_a_distance_and_its_peak_the_way() -> None:
    """3 m beside and 4 m behind is 5 m off; after 100 m from a start at (50, 0) that is 5 %."""
    way = np.column_stack([50.0 + 10.0 * T, np.zeros_like(T)])
    found = departure(made(from_start=True), T, way + [-4.0, 3.0], way)
    assert (found.max, found.rms) == (pytest.approx(5.0), pytest.approx(5.0))
    assert found.share('max') == pytest.approx(0.05)


def test_percentages_of_next_to_nothing_refer_to_the_least_peak() -> None:
    found = departure(made(least=0.01), T, np.full((T.size, 1), 2e-6), np.full((T.size, 1), 1e-6))
    assert found.share('max') == pytest.approx(1e-4)


def test_a_curve_that_is_not_finite_is_infinitely_far() -> None:
    broken = np.sin(W * T)[:, None]
    broken[-1] = np.nan
    found = departure(made(), T, broken, np.sin(W * T)[:, None])
    assert found.max == found.rms == np.inf
