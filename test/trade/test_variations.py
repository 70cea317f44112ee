"""Maneuvers beside the given one: what is scaled, mirrored and kept, and that the points fill their ranges."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

import solver
from solver.elements.road import RandomRoad
from solver.inputs.maneuver import Maneuver
from solver.inputs.signals import Constant, Mapped, Ramp, Sine, SineWithDwell, Step, Sum, Sweep, Table, signal
from solver.trade.variations import AS_GIVEN, CORNERS, RANGES, Variation, effective, inside, ranges_of, scaled, varied

T = np.linspace(0.0, 10.0, 1001)
SIGNALS = (
    Constant(value=0.3),
    Ramp(slope=0.2, start=1.0, initial=-0.1, final=0.4),
    Step(value=0.9, initial=0.1),
    Sine(amplitude=0.5, frequency=0.7, offset=0.2, cycles=2),
    SineWithDwell(amplitude=1.5),
    Sweep(amplitude=0.4, final_amplitude=1.2, frequency=0.2, final_frequency=1.0, duration=6.0),
    Table(points=((0.0, 0.1), (1.0, 0.5), (3.0, -0.2))),
    Sum(terms=(0.25, Step(value=1.0))),
    Mapped(of=Step(value=0.3), points=((-0.5, -7.0), (0.0, 0.2), (0.5, 8.0))),
)


@pytest.mark.parametrize('given', SIGNALS, ids=lambda s: s.kind)
@pytest.mark.parametrize('factor', [1.05, -0.8])
def test_a_scaled_signal_is_the_factor_times_the_signal_with_its_derivatives(given, factor: float) -> None:
    for found, expected in zip(scaled(given, factor).jet(T), given.jet(T), strict=True):
        np.testing.assert_allclose(found, factor * expected, rtol=1e-12, atol=1e-14)


def test_every_kind_of_signal_is_among_those_tested() -> None:
    from typing import get_args

    from solver.inputs.signals import Signal

    assert {type(s) for s in SIGNALS} == set(get_args(Signal))


def test_a_steered_scene_is_scaled_mirrored_and_driven_at_another_speed() -> None:
    scene = solver.load_scene('light_car_step_steer')
    found = varied(scene, Variation(amplitude=0.9, speed=1.05, friction=0.95, direction=-1))
    assert signal(found.maneuver.steering).jet(T).value[-1] == pytest.approx(-0.9 * 0.9)
    assert found.maneuver.drive_torque == scene.maneuver.drive_torque
    assert found.start.speed == pytest.approx(1.05 * scene.start.speed)
    assert found.model.road.friction == pytest.approx(0.95 * scene.model.road.friction)
    assert varied(scene, AS_GIVEN).maneuver.channels == scene.maneuver.channels


def test_brakes_are_scaled_where_nobody_steers_and_the_slippery_strip_changes_sides() -> None:
    scene = solver.load_scene('car_split_mu_brake')
    found = varied(scene, Variation(amplitude=0.8, direction=-1))
    assert signal(found.maneuver.brake_torque).jet(T).value[-1] == pytest.approx(0.8 * 2200.0)
    assert [p.center[1] for p in found.model.road.patches] == [-p.center[1] for p in scene.model.road.patches]


def test_a_torque_at_the_steering_wheel_is_scaled_and_mirrored_and_the_drive_stays() -> None:
    """Its amplitude is what the ranges of a certificate speak of, not that of the drive."""
    more = [
        'actuation={steering: torque}',
        'maneuver={drive_torque: 100, signals: {steering_torque: {kind: step, value: 3}}}',
    ]
    scene = solver.load_scene('light_car_step_steer', more)
    found = varied(scene, Variation(amplitude=0.9, direction=-1))
    assert signal(found.maneuver.signals['steering_torque']).jet(T).value[-1] == pytest.approx(-0.9 * 3.0)
    assert found.maneuver.drive_torque == 100


def test_torques_of_single_wheels_are_scaled_where_nobody_steers() -> None:
    more = ['actuation={wheels: true}', 'maneuver={signals: {brake_torque_front_left: {kind: step, value: 300}}}']
    found = varied(solver.load_scene('light_car_straight', more), Variation(amplitude=0.8))
    assert signal(found.maneuver.signals['brake_torque_front_left']).jet(T).value[-1] == pytest.approx(0.8 * 300.0)


def test_a_random_road_is_another_one_of_its_class_and_a_driver_keeps_his_path() -> None:
    rough, lane = solver.load_scene('car_rough_road'), solver.load_scene('light_car_lane_change')
    grid, new = rough.model.road.grids[0], varied(rough, inside(0)).model.road.grids[0]
    assert isinstance(grid, RandomRoad)
    assert isinstance(new, RandomRoad)
    assert (new.quality, new.seed == grid.seed) == (grid.quality, False)
    assert varied(lane, CORNERS[1]).maneuver.driver == lane.maneuver.driver


def test_points_lie_inside_the_ranges_differ_and_come_to_both_sides() -> None:
    points = [inside(k) for k in range(30)]
    for name, (low, high) in RANGES.items():
        values = np.array([getattr(p, name) for p in points])
        assert low < values.min() < low + 0.1 * (high - low)
        assert high > values.max() > high - 0.1 * (high - low)
    assert len(set(points)) == 30
    assert 10 <= sum(p.direction > 0 for p in points) <= 20
    assert not set(points) & {AS_GIVEN, *CORNERS}


def test_a_circle_is_driven_the_other_way_round_and_a_kept_speed_is_another_one() -> None:
    scene = solver.load_scene(
        'light_car_straight',
        [
            'maneuver={driver: {path: {kind: circle, radius: 80}}, speed: {target: {kind: ramp, initial: 8, slope: '
            '0.5}}}'
        ],
    )
    found = varied(scene, Variation(speed=1.05, direction=-1)).maneuver
    assert found.driver.path.radius == -80.0
    assert found.speed.target.initial == pytest.approx(8.4)
    assert found.speed.target.slope == pytest.approx(0.525)


@pytest.mark.parametrize(
    ('scene', 'kept', 'ranges'),
    [
        ('light_car_step_steer', {'road': 0}, {'amplitude', 'speed', 'friction'}),  # on a plane
        ('car_split_mu_brake', {'road': 0}, {'amplitude', 'speed', 'friction'}),
        # a driver keeps his path
        ('light_car_lane_change', {'amplitude': 1.0, 'direction': 1, 'road': 0}, {'speed', 'friction'}),
        ('slider_crank', AS_GIVEN._replace(speed=0.95)._asdict(), {'speed'}),
        ('andrews', AS_GIVEN._asdict(), set()),  # a torque of its mechanism turns it
    ],
)
def test_what_changes_nothing_in_a_scene_is_not_counted_as_varied(scene: str, kept: dict, ranges: set[str]) -> None:
    loaded = solver.load_scene(scene)
    v = Variation(amplitude=0.9, speed=0.95, friction=0.96, direction=-1, road=7)
    assert effective(loaded, v) == v._replace(**kept)
    assert set(ranges_of(loaded)) == ranges


def test_the_seed_of_a_random_road_is_varied_and_nothing_else_of_a_standing_car_but_the_friction() -> None:
    rough = solver.load_scene('car_rough_road')
    assert effective(rough, inside(0)).road == 3
    standing = solver.load_scene('light_car_straight', ['start.speed=0', 'maneuver={}'])
    assert set(ranges_of(standing)) == {'friction'}


def test_a_mechanism_begins_faster_or_is_driven_further_and_one_at_rest_falls_faster() -> None:
    crank = solver.load_scene('slider_crank')
    found = varied(crank, Variation(amplitude=0.8, speed=0.9, friction=0.9, direction=-1))
    assert found.start.coordinates['slide'].rate == pytest.approx(0.9 * -4.0)
    assert found.model == crank.model
    top = solver.load_scene('torque_free_top')
    turning = [b.angular_velocity for b in varied(top, Variation(speed=0.9)).model.bodies]
    assert turning == [pytest.approx(0.9 * np.array(b.angular_velocity)) for b in top.model.bodies]
    four_bar = solver.load_scene('four_bar')
    assert varied(four_bar, Variation(amplitude=0.8, speed=0.9)).maneuver.channels['motor'].slope == pytest.approx(
        0.8 * math.tau
    )
    assert ranges_of(four_bar) == {'amplitude': RANGES['amplitude']}
    pendulum = solver.load_scene('pendulum')  # its motion is the same in 1 / 0.9 of the time
    assert varied(pendulum, Variation(speed=0.9)).model.gravity == (0.0, pytest.approx(-9.81 * 0.81), 0.0)
    assert ranges_of(pendulum) == {'speed': RANGES['speed']}


def test_an_input_that_places_a_mechanism_at_the_start_is_not_varied() -> None:
    """A crank that a motor holds at 0.3 rad would be placed at 0.24 rad, where its links do not fit."""
    given = ['maneuver.signals.motor={kind: ramp, slope: 6.0, initial: 0.3, start: 0.25}']
    scene = solver.load_scene('four_bar', given)
    assert varied(scene, Variation(amplitude=0.8)).maneuver.channels == scene.maneuver.channels
    assert ranges_of(scene) == {}


def test_the_speed_that_a_mechanism_starts_with_is_varied() -> None:
    scene = solver.load_scene('torque_free_top', ['start.speed=2.0'])
    assert varied(scene, Variation(speed=0.9)).start.speed == pytest.approx(1.8)
    assert ranges_of(scene) == {'speed': RANGES['speed']}


def test_a_mechanism_under_a_recorded_maneuver_keeps_its_gravity() -> None:
    """What was recorded was so under the gravity there was: nothing else of a pendulum at rest could be varied."""
    scene = solver.load_scene('pendulum')
    recorded = dataclasses.replace(scene, maneuver=Maneuver(bag='recorded.mcap'))
    assert varied(recorded, Variation(speed=0.9)).model.gravity == scene.model.gravity
    assert ranges_of(recorded) == {}
