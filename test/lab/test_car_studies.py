"""Studies of the cars: quick variants judge themselves and hold numbers that can be checked by hand; their tools on
known curves."""

from __future__ import annotations

import csv
from types import SimpleNamespace

import numpy as np
import pytest

from mbd_sim_ros.lab.studies import car, car_cost, kandc
from mbd_sim_ros.lab.studies.car_runs import GRID, CarRun, converged, departures, growth, orders, run
from solver.analysis.kinematics_and_compliance import ackermann


def made(h: float, heading_error: float = 0.0, n: int = 501) -> CarRun:
    """A drive at 20 m/s in an arc of 0.2 rad/s, with errors 3 h^2 and h^4 in every curve and a heading that is off."""
    t = GRID * np.arange(n)
    wrong = 3.0 * h**2 + h**4
    heading = 0.2 * t + heading_error
    place = (
        100.0 * np.column_stack([np.sin(heading) - np.sin(heading_error), np.cos(heading_error) - np.cos(heading)])
        + wrong
    )
    forces = np.full((n, 4, 3), 1000.0) + wrong
    velocity = np.tile([20.0, 0.0], (n, 1))
    return CarRun(f'ALF {h}', t, place, heading, velocity, np.full(n, 0.2) + wrong, forces, np.zeros((1, 2)), {}, '')


def test_extrapolation_removes_the_second_order_and_knows_what_it_leaves() -> None:
    """Of 3 h^2 + h^4 the finest pair leaves (4 h^4 - 16 h^4)/3 = -4 h^4, the pair before 16 times that: the band is 60
    h^4."""
    levels = [made(h) for h in (0.4, 0.2, 0.1)]
    found, exact = converged(levels), made(0.0)
    assert found.run.yaw_rate - exact.yaw_rate == pytest.approx(-4.0 * 0.1**4, rel=1e-6)
    assert found.band['yaw_rate'] == pytest.approx(60.0 * 0.1**4, rel=1e-6)
    expected = pytest.approx(np.log2((3 * 0.12 + 0.024) / (3 * 0.03 + 0.0015)))
    assert orders(levels, 5.0)[0] == dict.fromkeys(('trajectory', 'yaw_rate', 'tire_forces'), expected)
    assert departures(levels[2], exact, 5.0)['tire_force'] == pytest.approx(0.0301e-3, rel=1e-6)


def test_a_constant_error_of_the_heading_grows_linearly_and_is_found_to_be_the_cause() -> None:
    found = growth(made(0.0, heading_error=1e-4), made(0.0), 0.0)
    assert found.power == pytest.approx(1.0, abs=0.05)
    assert found.power_misfit < found.rate_misfit
    assert found.heading_share == pytest.approx(1.0, abs=0.01)
    assert found.rest < 0.01


def test_a_run_that_fails_is_a_result() -> None:
    found = run('car_swept_steer', 'broken', ['integrator.kind=m_alf', 'integrator.penalty=1000'], 0.2)
    assert found.message
    assert len(found.t) < 21
    assert 'whole part of the common grid' in run('light_car_straight', 'odd', ['integrator.h=0.003'], 0.1).message


@pytest.mark.slow
def test_quick_study_of_the_car_meets_its_limits(tmp_path) -> None:
    found = car.study(tmp_path, quick=True, progress=lambda text, done: None)
    assert {check['name']: check['met'] for check in found['checks']} == {
        check['name']: True for check in found['checks']
    }
    assert len(found['checks']) >= 9
    # twice the step, four times the departure, and a little more: the motor of the power steering has a lag of 3 ms
    assert found['methods']['ALF 2 ms']['tire_force'] == pytest.approx(
        4.8 * found['methods']['ALF 1 ms']['tire_force'], rel=0.25
    )
    assert found['methods']['ALF 5 ms']['position'] > found['methods']['ALF 1 ms']['position']
    assert found['band']['tire_force'] < found['methods']['ALF 1 ms']['tire_force']
    assert {'maneuver.png', 'departures.png', 'dampers.png', 'methods.csv'} <= {
        path.name for path in tmp_path.iterdir()
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    'cars', [('full_car', 'light_car'), pytest.param(tuple(kandc.CARS), marks=pytest.mark.long)], ids=['two', 'all']
)
def test_quick_study_of_kinematics_and_compliance(
    cars: tuple[str, ...], tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kandc, 'CARS', {name: kandc.CARS[name] for name in cars})
    found = kandc.study(tmp_path, quick=True, progress=lambda text, done: None)
    assert all(check['met'] for check in found['checks'])
    full, light = found['full car'], found['light car']
    assert 'lateral_steer_front' in full
    assert 'lateral_steer_front' not in light  # ideal joints give way to nothing
    assert full['inner_at_stop'] > full['outer_at_stop'] > 0.4
    with (tmp_path / 'full_car_travel.csv').open() as file:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]
    z, load = (np.array([row[key] for row in rows]) for key in ('travel', 'front_left/load'))
    # the wheel rate of the sheet is the slope of the curve, whose next points are 20 mm away
    assert np.interp(0.02, z, load) - np.interp(-0.02, z, load) == pytest.approx(
        0.04 * full['wheel_rate_front'], rel=0.05
    )


def test_ackermann_is_the_angle_about_a_common_point() -> None:
    """Wheelbase 2.5 m, track 1.5 m, inner wheel turning about a point 4 m beside it: the outer one turns about 5.5
    m."""

    places = {'front_left': (1.25, 0.75), 'front_right': (1.25, -0.75), 'rear_left': (-1.25, 0.75)}
    stand = SimpleNamespace(centers={name: np.array(place) for name, place in places.items()})
    assert ackermann(stand, np.arctan(2.5 / 4.0)) == pytest.approx(np.arctan(2.5 / 5.5))  # type: ignore[arg-type]


def test_the_front_is_what_no_other_setting_beats() -> None:
    def point(h: float, error: float, cost: float, message: str = '') -> car_cost.Point:
        return car_cost.Point(car_cost.Setting(h, 2, 0.8), error, error, cost, 1e3 * cost, message)

    points = [point(1, 1e-2, 5.0), point(2, 1e-1, 1.0), point(3, 2e-2, 6.0), point(4, 1e-3, 9.0), point(5, 2e-1, 1.0)]
    points.append(point(6, 1e-9, 0.1, 'no convergence'))
    for cost in car_cost.COSTS:
        assert [p.setting.h for p in car_cost.front(points, 'position', cost)] == [2, 1, 4]


@pytest.mark.slow
@pytest.mark.long
def test_quick_study_of_error_against_cost(tmp_path) -> None:
    found = car_cost.study(tmp_path, quick=True, progress=lambda text, done: None)
    errors = {(p['h'], p['iterations'], p['rho']): p['position'] for p in found['points'] if not p['other']}
    assert len(errors) == 8
    # second order would be 25, what three iterations leave is more
    assert errors[5e-3, 3, 0.8] > 10.0 * errors[1e-3, 3, 0.8]
    # damping is no worse than what it damps: all begin in the same state
    assert errors[1e-3, 3, 0.0] < 0.1 * errors[5e-3, 1, 0.8]
    work = {(p['h'], p['iterations'], p['rho']): p['evaluations'] for p in found['points'] if not p['other']}
    assert work[1e-3, 3, 0.8] > 4.0 * work[5e-3, 3, 0.8]
    assert all(p['cpu'] > 0.0 for p in found['points'] if not p['message'])
    with (tmp_path / 'front_position_evaluations.csv').open() as file:
        front = list(csv.DictReader(file))
    assert len(front) >= 2
    assert {'front.png', 'points.csv', 'report.md'} <= {path.name for path in tmp_path.iterdir()}
