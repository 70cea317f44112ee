"""Faults of recordings, each told by one sentence, the right one; and none where there is none."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mbd_sim_ros.fitting.recordings import Window
from mbd_sim_ros.fitting.screen import _look, seen
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
        ({'factor': -1.0, 'only': 'yaw_rate'}, 'yaw_rate is turned'),
        ({'factor': -1.0}, 'all signals are turned against the steering'),
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
