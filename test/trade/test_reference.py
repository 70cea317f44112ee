"""Runs seen through quantities of interest, and their converged limit, against independent solutions."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import solver
from solver.errors import StepError
from solver.scene import Scene
from solver.trade.bench import Bench, second_of, truth_of
from solver.trade.reference import STEPS, Reference, of_runs, order, with_step
from solver.trade.runs import Stopped, at, run
from solver.trade.setting import Setting, baseline
from solver.trade.variations import AS_GIVEN

ANGLE = 'joint_states/pivot/position'


def converged(scene: Scene, base: Setting, names: list[str]) -> Reference:
    return of_runs(scene, [run(scene, with_step(base, h), names) for h in STEPS])


def test_the_limit_of_a_pendulum_is_that_of_an_independent_integrator() -> None:
    """Steps of 4, 2 and 1 ms extrapolated, beside an explicit method on dense equations to 1e-12; the band bounds the
    difference.

    The extrapolation leaves errors of the fourth power of the step; the band is that of the pair before, sixteen times
    as large.
    """
    scene = solver.load_scene('pendulum', ['duration=1'])
    found = converged(scene, Setting(rho_inf=0.9, tolerance=1e-12), [ANGLE])
    integrator = dataclasses.replace(scene.integrator, kind='reference_kkt', h=4e-3, tolerance=1e-12)
    simulation = solver.simulation_of(dataclasses.replace(scene, integrator=integrator))
    column = simulation.channels.joints.index('pivot')
    exact = np.array([simulation.advance(1).joint_position[column] for _ in range(250)])
    values = at(4e-3 * np.arange(1, 251), found.time, found.curves[ANGLE])[:, 0]
    difference = float(np.abs(values - exact).max())
    assert difference < found.band[ANGLE].max < 1e-3 * float(np.abs(exact).max())
    coarse = run(scene, Setting(h=4e-3, rho_inf=0.9, tolerance=1e-12), [ANGLE])
    assert difference < 1e-3 * found.errors(coarse)[ANGLE].max


@pytest.mark.slow
def test_the_limit_of_a_car_is_confirmed_by_another_formulation_and_errors_fall_with_the_square_of_the_step() -> None:
    scene = solver.load_scene('light_car_step_steer', ['duration=1.5', 'maneuver.steering.start=0.3'])
    names = ('yaw_rate', 'sideslip_velocity', 'wheel_load.front_left', 'position')
    bench = Bench(scene, names, STEPS)
    found, other = truth_of(bench, AS_GIVEN), second_of(bench)
    errors = {h: found.errors(run(scene, Setting(h=h), names)) for h in (8e-3, 4e-3)}
    for name in names:
        assert other[name].rms < 0.02 * errors[4e-3][name].rms
        assert found.band[name].rms < 0.1 * errors[4e-3][name].rms
        assert 3.0 < errors[8e-3][name].rms / errors[4e-3][name].rms < 5.5


def test_a_driver_who_looks_once_a_step_makes_the_first_power_of_it() -> None:
    assert order(solver.load_scene('light_car_lane_change')) == 1
    assert order(solver.load_scene('light_car_step_steer')) == 2


def test_a_failure_is_kept_and_a_reference_does_without_it() -> None:
    scene = solver.load_scene('light_car_step_steer', ['duration=0.2'])
    missing = run(scene, Setting(level='auto', h=0.3), ['yaw_rate'])
    assert missing.failure
    assert missing.curves == {}
    with pytest.raises(StepError, match='auto'):
        of_runs(scene, [missing, missing])
    with pytest.raises(Stopped):
        run(scene, Setting(), ['yaw_rate'], stop=lambda: True)


def test_a_setting_is_what_it_says_in_a_scene() -> None:
    scene = solver.load_scene('car_step_steer', ['integrator.penalty=1e7'])
    found = Setting(level='kc', off=('drag',), h=5e-3, iterations=2, rho_inf=0.5).of(scene)
    assert (found.fidelity, found.switches) == ('kc', {'drag': 'off'})
    assert (found.integrator.h, found.integrator.mode, found.integrator.iterations, found.integrator.rho_inf) == (
        5e-3,
        'fixed',
        2,
        0.5,
    )
    assert found.integrator.penalty == 1e7
    assert Setting().of(scene).integrator.mode == 'tolerance'
    assert str(baseline(scene)) == 'full, 1 ms, 2 iterations, rho 0.8'


@pytest.mark.slow
def test_a_reference_iterates_as_often_as_it_takes() -> None:
    """A scene that allows one iteration would be its own reference, and the error of its iteration nothing."""
    few, many = (
        run(
            solver.load_scene('light_car_step_steer', ['duration=0.4', 'maneuver.steering.start=0.1', *more]),
            Setting(h=4e-3),
            ['yaw_rate'],
        )
        for more in (['integrator.max_iterations=1'], [])
    )
    assert few.counters == many.counters
    np.testing.assert_array_equal(few.curves['yaw_rate'], many.curves['yaw_rate'])


def test_values_between_samples_are_those_of_a_spline() -> None:
    """Of a cubic on 21 points nothing is lost anywhere; instants that are there give back the same bits."""
    t = np.linspace(0.0, 1.0, 21)
    values = np.column_stack([t**3, 1.0 - t])
    between = np.array([0.013, 0.5, 0.777])
    np.testing.assert_allclose(at(between, t, values), np.column_stack([between**3, 1.0 - between]), atol=1e-14)
    assert np.array_equal(at(t[::4], t, values), values[::4])
