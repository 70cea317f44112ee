"""The rating after ISO/TS 18571: each score on signals whose score follows from its formula by hand, and against plain
recursion."""

from __future__ import annotations

import numpy as np
import pytest

from mbd_sim_ros.analysis.rating import RATE, rate, rate_sampled, sampling, shift_of
from mbd_sim_ros.analysis.warping import warped
from solver.compiled.cache import KernelCache

T = np.linspace(0.0, 1.0, 401)


def pulse(t: np.ndarray, at: float = 0.5) -> np.ndarray:
    return np.exp(-0.5 * ((t - at) / 0.06) ** 2)


def test_the_same_signal_is_rated_one() -> None:
    found = rate_sampled(pulse(T), pulse(T), 0.01)
    assert (found.corridor, found.phase, found.magnitude, found.slope, found.shift) == (1.0, 1.0, 1.0, 1.0, 0.0)
    assert found.overall == pytest.approx(1.0, rel=1e-15)


@pytest.mark.parametrize(
    ('gap', 'score'), [(0.04, 1.0), (0.05, 1.0), (0.275, 0.25), (0.4, (0.1 / 0.45) ** 2), (0.5, 0.0), (0.8, 0.0)]
)
def test_corridor(gap: float, score: float) -> None:
    """A constant difference, as part of the peak of the reference."""
    reference = 3.0 * np.sin(6.0 * T)
    reference /= np.max(np.abs(reference)) / 3.0
    assert rate_sampled(reference + 3.0 * gap, reference, 0.01).corridor == pytest.approx(score, abs=1e-12)


@pytest.mark.parametrize(('samples', 'score'), [(0, 1.0), (20, 0.75), (-20, 0.75), (60, 0.25), (80, 0.0)])
def test_phase_and_shift(samples: int, score: float) -> None:
    """400 samples moved by some: 20 % of them is the most. The pulse stays inside; shape and size are the same after
    the shift."""
    t = T[:400]
    found = rate_sampled(pulse(t, 0.5 + samples * (T[1] - T[0])), pulse(t), 0.02)
    assert found.phase == pytest.approx(score, abs=1e-12)
    assert found.shift == pytest.approx(samples * 0.02)  # later is positive
    assert found.magnitude == pytest.approx(1.0, abs=1e-12)
    assert found.slope == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize('late', [0.0, 0.3, 1.45, -2.6])
def test_a_shift_is_known_better_than_to_a_sample(late: float) -> None:
    """Sines of periods of 50 and 17 samples, 20 % larger and moved by parts of a sample. Slopes are central
    differences, which of the shorter one are (2 pi / 17)^2 / 6 = 2 % too small, so that of up to half a sample 0.01 are
    not known."""

    def waves(k: np.ndarray) -> np.ndarray:
        return np.sin(k * 2.0 * np.pi / 50.0) + 0.5 * np.sin(k * 2.0 * np.pi / 17.0 + 1.0)

    k = np.arange(300.0)
    found = rate_sampled(1.2 * waves(k - late) + 3.0, waves(k), 0.02)
    assert found.shift == pytest.approx(0.02 * late, abs=0.02 * 0.01)
    assert found.phase == pytest.approx(1.0 - abs(round(late)) / 60.0)  # the score counts samples


@pytest.mark.parametrize(('factor', 'score'), [(1.1, 0.8), (0.8, 0.6), (1.5, 0.0), (2.0, 0.0)])
def test_magnitude(factor: float, score: float) -> None:
    """Of constant signals warping changes nothing: e = |factor - 1|, of which 0.5 is the most."""
    assert rate_sampled(np.full(100, factor), np.ones(100), 0.01).magnitude == pytest.approx(score, abs=1e-12)


@pytest.mark.parametrize(('factor', 'score'), [(1.5, 0.75), (0.0, 0.5), (-1.0, 0.0), (4.0, 0.0)])
def test_slope(factor: float, score: float) -> None:
    """Straight lines: e = |factor - 1|, of which 2 is the most."""
    assert rate_sampled(factor * T, T, 0.01).slope == pytest.approx(score, abs=1e-12)


def test_warping_forgives_what_comes_later_in_one_place_and_earlier_in_another() -> None:
    """No shift helps both pulses, but warping pairs each: what is left is how they lie between the samples."""
    step = T[1] - T[0]
    reference, other = pulse(T, 0.3) + pulse(T, 0.7), pulse(T, 0.3 - 4 * step) + pulse(T, 0.7 + 4 * step)
    found = rate_sampled(other, reference, 0.01)
    assert found.shift == 0.0
    assert found.magnitude > 0.995
    assert np.sum(np.abs(other - reference)) / np.sum(reference) > 0.1  # what the score would lose 0.2 for


def by_recursion(values: np.ndarray, reference: np.ndarray) -> float:
    """Relative error on the warping path, from a full table of costs."""
    n = values.size
    band = int(np.ceil(0.1 * n))
    total = np.full((n, n), np.inf)
    origin = np.zeros((n, n, 2), int)
    for i in range(n):
        for j in range(max(0, i - band + 1), min(n, i + band)):
            ways = [(total[k, m], k, m) for k, m in ((i - 1, j), (i, j - 1), (i - 1, j - 1)) if k >= 0 and m >= 0]
            least = min(ways, key=lambda way: way[0]) if ways else (0.0, 0, 0)
            total[i, j] = least[0] + (values[i] - reference[j]) ** 2
            origin[i, j] = least[1:]
    i = j = n - 1
    error, size = abs(values[i] - reference[j]), abs(reference[j])
    while (i, j) != (0, 0):
        i, j = origin[i, j]
        error, size = error + abs(values[i] - reference[j]), size + abs(reference[j])
    return error / size


@pytest.mark.parametrize('n', [11, 40, 133])
def test_warping_is_the_cheapest_path(n: int, rng) -> None:
    for _ in range(3):
        reference = np.cumsum(rng.standard_normal(n)) + 8.0
        values = reference + 0.4 * rng.standard_normal(n)
        k = shift_of(values, reference)
        a, b = (values[k:], reference[: n - k]) if k >= 0 else (values[:k], reference[-k:])
        assert rate_sampled(values, reference, 1.0).magnitude == pytest.approx(
            max(0.0, 1.0 - by_recursion(a, b) / 0.5), abs=1e-12
        )


# Corridor, phase, magnitude, slope, overall by objective_rating_metrics 1.3 of TU Graz, unrounded: (run, reference) at
# 201 instants.
PUBLISHED = {
    'smaller': (0.948551221, 1.000000000, 0.940218879, 0.950000000, 0.957464264),
    'later': (0.499962743, 0.701492537, 1.000000000, 1.000000000, 0.740283605),
    'rippled': (0.845079766, 1.000000000, 0.940657793, 0.643055695, 0.854774604),
    'other': (0.284548408, 0.353233831, 0.000000000, 0.792835031, 0.343033136),
    'drifting': (0.712897477, 1.000000000, 0.875557584, 0.898016803, 0.839873868),
    'step': (0.822101670, 0.751243781, 0.991835262, 0.787715935, 0.834999663),
}


@pytest.mark.parametrize('name', PUBLISHED)
def test_scores_are_those_of_the_published_implementation(name: str) -> None:
    t = np.linspace(0.0, 1.0, 201)
    wave = np.sin(2 * np.pi * t) * np.exp(-t)
    values, reference = {
        'smaller': (0.9 * wave, wave),
        'later': (np.sin(2 * np.pi * (t - 0.06)) * np.exp(-(t - 0.06)), wave),
        'rippled': (wave + 0.1 * np.sin(31.0 * t), wave),
        'other': (0.5 * np.cos(5.0 * t) - 0.2, wave),
        'drifting': (1.2 * wave + 0.15 * t, wave),
        'step': (np.tanh(12.0 * (t - 0.45)), np.tanh(20.0 * (t - 0.4))),
    }[name]
    found = rate_sampled(values, reference, 0.005)
    scores = (found.corridor, found.phase, found.magnitude, found.slope, found.overall)
    np.testing.assert_allclose(scores, PUBLISHED[name], atol=1e-9)


def test_shift_is_that_of_the_largest_correlation(rng) -> None:
    for _ in range(5):
        values, reference = np.cumsum(rng.standard_normal((2, 120)), axis=1)
        best = {
            m: np.corrcoef(values[max(m, 0) : 120 + min(m, 0)], reference[max(-m, 0) : 120 - max(m, 0)])[0, 1]
            for m in range(-24, 25)
        }
        assert shift_of(values, reference) == max(best, key=best.__getitem__)


def test_of_shifts_that_fit_alike_the_smallest_counts() -> None:
    """Two lines correlate fully at every shift."""
    assert shift_of(2.0 * T, T) == 0


def test_weights_are_those_of_the_specification() -> None:
    found = rate_sampled(1.5 * T, T, 0.01)
    assert found.overall == pytest.approx(
        0.4 * found.corridor + 0.2 * (found.phase + found.magnitude + found.slope), rel=1e-15
    )


def test_sampling_for_the_rating() -> None:
    assert np.diff(sampling(np.arange(60_001) * 1e-3))[0] == pytest.approx(1.0 / RATE)
    assert sampling(np.arange(8001) * 1e-3).size == 1001
    assert sampling(np.arange(101) * 1e-2).size == 101  # not finer than recorded
    assert sampling(np.arange(10**6) * 1e-3).size == 10_001


def test_signals_with_gaps_or_without_length_are_not_rated() -> None:
    t = np.arange(20.0)
    assert rate(t[:10], t[:10], t[:10]) is None
    assert rate(t, np.where(t == 3.0, np.nan, t), t) is None
    assert rate(t, t, t) is not None


def test_a_reference_of_zeros_is_met_by_zeros_only() -> None:
    zero = np.zeros(50)
    assert rate_sampled(zero, zero, 0.1).overall == pytest.approx(1.0)
    other = rate_sampled(np.sin(np.arange(50.0)), zero, 0.1)
    assert (other.magnitude, other.slope) == (0.0, 0.0)
    assert other.corridor < 0.1


def test_the_compiled_warping_is_kept_on_disk() -> None:
    """Compiling it takes longer than rating 500 channels."""
    assert isinstance(warped._cache, KernelCache)
