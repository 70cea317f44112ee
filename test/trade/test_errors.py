"""Errors by origin, on curves whose differences are known."""

from __future__ import annotations

import math
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import solver
from solver.analysis.departures import FAILED
from solver.quantities import Quantity
from solver.trade import bench as benches
from solver.trade.bench import Bench, run_of
from solver.trade.errors import ORIGINS, Bound, Requirement, by_origin, without
from solver.trade.reference import Reference
from solver.trade.runs import Run
from solver.trade.setting import Setting
from solver.trade.variations import AS_GIVEN

T = 0.01 * np.arange(101)  # s
NAME, OTHER, PEAK = 'yaw_rate', 'roll', 2.0
YAW = Quantity(NAME, 'rad/s', 0.01, np.array([0]), lambda rows: rows, False)


def curve(offset: float) -> dict[str, np.ndarray]:
    return {NAME: PEAK * np.sin(T)[:, None] + offset}


def limit(offset: float) -> Reference:
    return Reference(T, curve(offset), {NAME: YAW}, {NAME: PEAK}, {}, (2e-3, 1e-3), (made(offset),))


def made(offset: float, failure: str = '') -> Run:
    return Run(Setting(), T, curve(offset), {}, failure)


def test_every_part_is_the_difference_of_its_own_two_solutions_also_where_they_cancel() -> None:
    """The level is off by 1, its step by 2 more, the iteration by 3 the other way: nothing is left of it in the
    whole."""
    error = by_origin(limit(0.0), limit(1.0), made(3.0), made(0.0))[NAME]
    assert [getattr(error, o).rms for o in ORIGINS[:3]] == pytest.approx([1.0, 2.0, 3.0])
    assert error.whole.max == 0.0
    for value, share, allowed in ((0.5, False, 0.5), (25.0, True, 50.0)):
        b = Bound.of(Requirement(NAME, 'rms', value, share), error, 0.125, allowed)
        assert b.used == pytest.approx(6.125 / allowed) and b.itself == pytest.approx(0.125 / allowed)


def test_the_full_vehicle_has_no_error_of_the_model_and_a_run_to_tolerance_none_of_the_iteration() -> None:
    truth, found = limit(0.0), made(0.25)
    error = by_origin(truth, truth, found, found)[NAME]
    assert (error.model.max, error.iteration.max) == (0.0, 0.0)
    assert error.whole == error.step and error.step.max == pytest.approx(0.25)
    for measure in ('max', 'rms', 'delay'):
        assert Requirement(NAME, measure, 1.0, False).error(error.model) == 0.0


def test_what_failed_or_is_not_modelled_is_infinitely_far_and_no_part_of_it_is_told() -> None:
    truth = limit(0.0)
    for settled, found in ((made(0.0, 'it fell'), made(0.5)), (made(0.0), made(0.5, 'it fell'))):
        error = by_origin(truth, truth, settled, found)[NAME]
        assert error.iteration == FAILED
        assert math.isinf(Bound.of(Requirement(NAME, 'rms', 1.0, False), error, 0.0, 1.0).used)
    more = {'quantities': YAW, 'peaks': PEAK, 'curves': curve(0.0)[NAME]}
    whole = truth._replace(**{field: {NAME: one, OTHER: one} for field, one in more.items()})
    errors = by_origin(whole, limit(1.0), made(1.0), made(1.0, ''))
    assert errors[OTHER].whole == errors[OTHER].model == errors[OTHER].step == FAILED
    assert errors[NAME].model.rms == pytest.approx(1.0)


def test_threads_that_want_the_same_run_wait_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def slow(scene: object, setting: Setting, *_: object, **__: object) -> Run:
        calls.append(setting)
        time.sleep(0.05)
        return made(0.0)

    monkeypatch.setattr(benches, 'run', slow)
    bench = Bench(solver.load_scene('spring_mass'), (NAME,), (2e-3, 1e-3))
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda h: run_of(bench, AS_GIVEN, Setting(h=h)), [1e-3, 1e-3, 2e-3, 1e-3]))
    assert sorted(one.h for one in calls) == [1e-3, 2e-3]
    assert found[0] is found[1] is found[3]


def test_without_a_subsystem_what_it_changes_counts_to_the_model_and_the_sum_is_no_less_than_the_whole() -> None:
    """The level is off by 1, its step by 2 and its iterations by 3 more; without a subsystem the setting is off by 0.5
    more, or back."""
    truth, own, with_all = limit(0.0), limit(1.0), made(6.0)
    errors = by_origin(truth, own, made(3.0), with_all)
    for change in (0.5, -0.5, -6.0):
        error = without(truth, errors, with_all, made(6.0 + change))[NAME]
        assert error.model.rms == pytest.approx(1.0 + abs(change))
        assert (error.step.rms, error.iteration.rms) == pytest.approx((2.0, 3.0))
        assert error.whole.rms == pytest.approx(abs(6.0 + change))
        assert error.model.rms + error.step.rms + error.iteration.rms >= error.whole.rms
    assert math.isinf(without(truth, errors, with_all, made(6.0, 'it fell'))[NAME].model.rms)
