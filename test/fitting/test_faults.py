"""Faults of whole recordings, as a fit meets them: one sentence each, before anything is fitted."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from mbd_sim_ros.fitting.estimation import fit
from mbd_sim_ros.fitting.problem import Problem
from mbd_sim_ros.fitting.recordings import Data, Track
from mbd_sim_ros.lab.studies import fit_coverage
from solver.errors import MbdError

Fault = Callable[[Track], Track]


@pytest.fixture(scope='module')
def good() -> Iterator[Problem]:
    """Drives of a single track, with the delays, offsets and noise of usual sensors, at the samples of a car."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fit_coverage, 'H', 0.004)
        yield fit_coverage.drives(0, fit_coverage.SWINGS['below the limit'])[0]


def times(factor: float) -> Fault:
    return lambda one: Track(one.t, factor * one.y)


def late(seconds: float) -> Fault:
    return lambda one: Track(one.t, np.interp(one.t - seconds, one.t, one.y))


def drifting(rate: float) -> Fault:
    return lambda one: Track(one.t, np.interp(one.t * (1.0 - rate), one.t, one.y))


def frozen(one: Track) -> Track:
    return Track(one.t, np.where(one.t > 5.0, one.y[0], one.y))


def shuffled(one: Track) -> Track:
    return Track(one.t, one.y[::-1].copy())


def short(one: Track) -> Track:
    return Track(one.t[one.t < 10.0], one.y[one.t < 10.0])


@pytest.mark.slow
@pytest.mark.parametrize(
    ('names', 'fault', 'sentence'),
    [
        ('r', times(-1.0), 'yaw_rate has the wrong sign'),
        ('ay', times(-1.0), 'lateral_acceleration has the wrong sign'),
        ('angle', times(-1.0), 'all signals have the wrong sign for this steering'),
        ('ay', late(0.3), 'lateral_acceleration is 0.[23]. s late'),
        ('r', late(-0.3), 'yaw_rate is 0.[23]. s early'),
        ('angle', late(-0.3), 'all signals come 0.[23]. s after the steering'),
        ('r', drifting(4e-3), 'the clock of yaw_rate drifts by'),
        ('r ay', drifting(4e-3), 'drifts by .* against that of the steering'),
        ('ay', times(1.0 / 9.80665), 'lateral_acceleration is 0\\.[01].* is its unit right'),
        ('r', times(57.3), 'yaw_rate is [4-7]\\d.* is its unit right'),
        ('angle', times(2.2), 'those of the vehicle: the recording is of another car'),
        ('angle', times(57.3), 'vehicle'),
        ('r ay', shuffled, 'no signal goes with the steering'),
        ('r', frozen, 's are left to fit'),
        ('angle speed r ay', short, 's are left to fit'),
    ],
)  # fmt: skip
def test_one_sentence_each(good: Problem, names: str, fault: Fault, sentence: str) -> None:
    """The right one, without a line break, and nothing is fitted."""
    given = [
        Data(one.name, one.use, {k: fault(track) if k in names.split() else track for k, track in one.tracks.items()})
        for one in good.data.values()
    ]
    with pytest.raises(MbdError, match=sentence) as error:
        fit(Problem(good.file, Path(), data=given, car=good.car))
    assert '\n' not in str(error.value)
