"""Crossings, peaks, lines and filters on signals known in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from drives import even

from mbd_sim_ros.analysis.evaluation.measures import crossing, fundamental, line, low_passed, peak


def test_crossings_and_peaks_lie_between_samples() -> None:
    t = even(2.0, 50.0)
    assert crossing(t, 3.0 * t, 1.0) == pytest.approx(1.0 / 3.0, abs=1e-12)
    assert math.isnan(crossing(t, t, 5.0))
    when, top = peak(t, 2.0 - (t - 0.777) ** 2)  # a parabola is met exactly
    assert (when, top) == pytest.approx((0.777, 2.0), abs=1e-12)
    assert line(t, 3.0 - 2.0 * t) == pytest.approx((-2.0, 3.0))
    c = fundamental(t, 1.5 + 2.0 * np.cos(2.0 * np.pi * t - 0.3), 1.0)
    assert abs(c) == pytest.approx(2.0)
    assert np.angle(c) == pytest.approx(-0.3)


def test_the_low_pass_has_the_gain_of_twelve_poles_and_no_phase() -> None:
    """|H| of two passes of order 6 is 1/(1 + (f/f_c)^12); the bilinear transform bends frequencies by (pi f/rate)^2/3
    at most."""
    t = even(20.0, 500.0)
    middle = (t > 8.0) & (t < 12.0)
    for f in (3.0, 6.0, 9.0):
        c = fundamental(t[middle], low_passed(np.cos(2.0 * np.pi * f * t), 500.0, 6.0)[middle], f)
        assert abs(c) == pytest.approx(1.0 / (1.0 + (f / 6.0) ** 12), rel=0.05)
        assert abs(np.angle(c)) < 1e-3
