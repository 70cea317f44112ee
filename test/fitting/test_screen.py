"""Faults of recordings, each told by one sentence, the right one; and none where there is none."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mbd_sim_ros.fitting.recordings import Window
from mbd_sim_ros.fitting.screen import Seen, _look, seen
from mbd_sim_ros.fitting.unknowns import Unknown
from solver.errors import BagError

DT = 0.04


def problem(windows: int = 6) -> SimpleNamespace:
    unknowns = [
        Unknown(f'{name}.delay', name, 'delay', 0.0, 0.02, 0.02, unit='s')
        for name in ('steering', 'yaw_rate', 'lateral_acceleration')
    ]
    return SimpleNamespace(
        dt=DT, unknowns=unknowns, car=SimpleNamespace(size=SimpleNamespace(time=1.0)),
        windows=[Window('drive', 'fit', 12.0 * k, 12.0 * k + 2.0, 12.0 * k + 12.0) for k in range(windows)],
    )  # fmt: skip


def signal(t: np.ndarray, k: int = 0) -> np.ndarray:
    return np.sin(1.1 * t + k) + 0.6 * np.sin(2.9 * t) + 0.3 * np.sin(5.3 * t + 2.0 * k)


def looked(*, delay=lambda t: 0.0, factor=1.0, only: str = '', noise: float = 0.05) -> None:
    """Look at a drive with two signals; the fault is in both, or in one."""
    given, random = problem(), np.random.default_rng(1)
    own: dict[str, list] = {}
    for k, name in enumerate(('yaw_rate', 'lateral_acceleration')):
        for w, window in enumerate(given.windows):
            t = np.arange(2.0, 12.0, DT)
            at = window.begin + t
            bad = not only or name == only
            y = (factor if bad else 1.0) * signal(at - (delay(at) if bad else 0.0), k)
            y = y + noise * random.standard_normal(t.size)
            own.setdefault(name, []).append(seen(given, t, y, signal(at, k), w))
    _look(given, 'drive', own, 1.0)


def test_nothing_is_told_of_a_good_drive() -> None:
    """Also not of one with the delay and the noise of usual sensors, or a car that turns a third more."""
    looked()
    looked(delay=lambda t: 0.04, noise=0.2)
    looked(factor=1.3)


@pytest.mark.parametrize(
    ('fault', 'sentence'),
    [
        ({'factor': -1.0, 'only': 'yaw_rate'}, 'yaw_rate has the wrong sign'),
        ({'factor': -1.0}, 'all signals have the wrong sign for this steering'),
        ({'delay': lambda t: 0.3, 'only': 'yaw_rate'}, 'yaw_rate is 0.30 s late'),
        ({'delay': lambda t: -0.3, 'only': 'yaw_rate'}, 'yaw_rate is 0.30 s early'),
        ({'delay': lambda t: 0.3}, 'all signals come 0.30 s after the steering'),
        ({'delay': lambda t: 0.004 * t, 'only': 'yaw_rate'}, 'the clock of yaw_rate drifts by 4 ms a second'),
        ({'delay': lambda t: -0.004 * t}, 'drifts by -4 ms a second'),
        ({'factor': 9.81, 'only': 'lateral_acceleration'}, 'lateral_acceleration is 9.8'),
        ({'factor': 0.4}, 'all signals are 0.4 times those of the vehicle'),
    ],
)
def test_faults(fault: dict, sentence: str) -> None:
    """Every fault by its own sentence."""
    with pytest.raises(BagError) as error:
        looked(**fault)
    assert sentence in str(error.value)
    assert '\n' not in str(error.value)


def test_another_drive() -> None:
    """Signals that have nothing to do with the steering."""
    given, random = problem(), np.random.default_rng(1)
    t = np.arange(2.0, 12.0, DT)
    smooth = np.convolve(random.standard_normal(t.size + 40), np.ones(41) / 41.0, 'valid')
    own = {'yaw_rate': [seen(given, t, signal(t) + 12.0 * smooth, np.cos(7.0 * t), w) for w in range(6)]}
    with pytest.raises(BagError, match='no signal goes with the steering'):
        _look(given, 'drive', own, 1.0)


def told(delays: list[float], factors: list[float], name: str = 'yaw_rate') -> None:
    """Look at windows of a signal with these delays and factors, correlated well."""
    given = problem(len(delays))
    own = [Seen(d, 0.98, 0.95, f, 12.0 * k + 7.0, 1.0) for k, (d, f) in enumerate(zip(delays, factors, strict=True))]
    _look(given, 'drive', {name: own}, 1.0)


def test_windows_that_disagree_are_no_late_clock() -> None:
    """A vehicle that is far from the car leads in some windows; a sensor that is late is late in all of them."""
    one = [1.0] * 5
    told([-0.6, -0.05, -0.55, 0.0, -0.3], one)
    told([0.5, 0.0, 0.5, -0.2, 0.3], one)
    for late in ([0.28, 0.3, 0.31, 0.29, 0.3], [0.3, 0.3], [0.2, 0.3, 0.4, 0.3, 0.2]):
        with pytest.raises(BagError, match=r'yaw_rate is 0.* s late'):
            told(late, [1.0] * len(late))


def test_delays_that_scatter_are_no_drift() -> None:
    """Three windows nearly on a line, and more with a slope below their scatter, are chance; a slope beyond it is
    none."""
    told([0.0, 0.055, 0.1], [1.0] * 3)
    told([0.06, -0.06, 0.04, -0.05, 0.09, 0.02], [1.0] * 6)
    told([0.0, 0.05, 0.02, 0.07, 0.04, 0.1], [1.0] * 6)
    with pytest.raises(BagError, match=r'drifts by 2.5 ms a second'):
        told([0.0, 0.031, 0.06, 0.089, 0.12, 0.15], [1.0] * 6)


def test_a_sideslip_of_other_tires_is_no_unit() -> None:
    """Sideslip is a difference of geometry and tires: half and three times of it are no unit; degrees are one."""
    for factor in (0.5, 0.3, 3.0):
        told([0.0] * 3, [factor] * 3, 'sideslip')
        told([0.0] * 3, [factor] * 3, 'lateral_velocity.second')
    for name in ('sideslip', 'lateral_velocity'):
        with pytest.raises(BagError, match='is its unit right'):
            told([0.0] * 3, [57.3] * 3, name)
    with pytest.raises(BagError, match='is its unit right'):
        told([0.0] * 3, [0.5] * 3)
