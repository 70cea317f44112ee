"""Hands and feet: what is held becomes angles and torques, at the rates and within the limits that the module names."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest

from mbd_sim_ros.drive.hands import (
    AXIS,
    BITE,
    BRAKE,
    CORNERING,
    DRIVE,
    HAND,
    LAUNCH,
    NOTHING,
    PEDALS,
    POWER,
    RETURN,
    SHIFTING,
    SLIDING,
    STEERING,
    Hands,
    Held,
    Seat,
    held_of,
)
from solver import load_scene
from solver.errors import SceneError

SEAT = Seat(
    wheelbase=2.5, ratio=16.0, lock=7.0, inertia=400.0, braking=450.0, engine=False, gears=None, automatic=False,
    rear=('brake_torque_rear_left', 'brake_torque_rear_right'),
)  # fmt: skip
H = 0.001


def after(hands: Hands, held: Held, seconds: float, speed: float) -> dict[str, float]:
    commands: dict[str, float] = {}
    for _ in range(round(seconds / H)):
        commands = hands.advance(held, speed, H)
    return commands


def test_a_key_turns_the_wheel_at_its_rate_up_to_the_reach_and_it_returns_at_the_other_one() -> None:
    hands, v = Hands(SEAT), 20.0
    left, reach = Held(left=1.0), 16.0 * (2.5 * CORNERING / 400.0 + SLIDING)
    assert after(hands, left, 0.2, v)['steering'] == pytest.approx(0.2 * STEERING)
    assert after(hands, left, 2.0, v)['steering'] == pytest.approx(reach)
    assert after(hands, NOTHING, 0.1, v)['steering'] == pytest.approx(reach - 0.1 * RETURN)
    assert after(hands, NOTHING, 2.0, v)['steering'] == 0.0
    assert after(hands, Held(right=1.0), 0.2, v)['steering'] == pytest.approx(-0.2 * STEERING)
    # the other key first brings it back, at the rate of the return
    assert after(hands, left, 0.1, v)['steering'] == pytest.approx(-0.2 * STEERING + 0.1 * RETURN)


def test_the_reach_ends_at_the_lock_and_shrinks_with_the_speed() -> None:
    hands = Hands(SEAT, steering_rate=20.0)
    assert hands.reach(0.0) == SEAT.lock
    assert hands.reach(-30.0) == hands.reach(30.0) == pytest.approx(16.0 * (2.5 * CORNERING / 900.0 + SLIDING))
    assert after(hands, Held(left=1.0), 3.0, 0.0)['steering'] == SEAT.lock
    assert after(hands, Held(left=1.0), 3.0, 30.0)['steering'] == pytest.approx(hands.reach(30.0))
    assert after(hands, Held(left=1.0, right=1.0), 3.0, 30.0)['steering'] == 0.0


def test_an_axis_says_where_the_wheel_shall_be() -> None:
    hands = Hands(SEAT)
    assert after(hands, Held(wheel=-0.5), 0.02, 20.0)['steering'] == pytest.approx(-0.02 * AXIS)
    assert after(hands, Held(wheel=-0.5), 2.0, 20.0)['steering'] == pytest.approx(-0.5 * hands.reach(20.0))
    assert after(hands, Held(wheel=0.0), 2.0, 20.0)['steering'] == 0.0


@pytest.mark.parametrize('name', [*PEDALS])
def test_pedals_move_at_their_rates(name: str) -> None:
    hands, (down, up) = Hands(SEAT), PEDALS[name]
    after(hands, Held(**{name: 1.0}), 0.05, 0.0)
    assert hands.pedals[name] == pytest.approx(0.05 * down)
    after(hands, Held(**{name: 1.0}), 2.0, 0.0)
    assert hands.pedals[name] == 1.0
    after(hands, NOTHING, 0.05, 0.0)
    assert hands.pedals[name] == pytest.approx(1.0 - 0.05 * up)
    after(hands, NOTHING, 2.0, 0.0)
    assert hands.pedals[name] == 0.0


@pytest.mark.parametrize(('speed', 'acceleration'), [(0.0, DRIVE), (10.0, DRIVE), (50.0, POWER / 50.0), (-50.0, 2.0)])
def test_torques_are_accelerations_of_the_car_and_end_with_its_power(speed: float, acceleration: float) -> None:
    hands = Hands(SEAT)
    assert after(hands, Held(gas=1.0), 2.0, speed)['drive_torque'] == pytest.approx(400.0 * acceleration)
    hands.shift(-1)
    assert after(hands, Held(gas=1.0), H, speed)['drive_torque'] == 0.0  # neutral
    hands.shift(-1)
    assert after(hands, Held(gas=1.0), H, speed)['drive_torque'] == pytest.approx(-400.0 * acceleration)
    hands.shift(-1)
    assert hands.gear == -1  # there is no further position
    commands = after(hands, Held(brake=1.0, hand=0.5), 2.0, speed)
    assert commands['brake_torque'] == pytest.approx(450.0 * BRAKE)
    assert [commands[name] for name in SEAT.rear] == pytest.approx([450.0 * HAND / 4.0] * 2)


def test_a_gearbox_that_nobody_works_gets_its_clutch() -> None:
    hands = Hands(dataclasses.replace(SEAT, engine=True, gears=(-1, 5)))
    assert after(hands, NOTHING, 1.0, 0.0)['clutch'] == 1.0  # stands in gear
    assert after(hands, Held(gas=1.0), 1.0, 1.0)['clutch'] == pytest.approx((1.0 - BITE) * (1.0 - 1.0 / LAUNCH))
    assert after(hands, Held(gas=1.0), 1.0, 10.0) | {'steering': 0.0} == {
        'steering': 0.0, 'brake_torque': 0.0, **dict.fromkeys(SEAT.rear, 0.0), 'accelerator': 1.0, 'gear': 1.0,
        'clutch': 0.0,
    }  # fmt: skip
    hands.shift(1)
    assert after(hands, NOTHING, 0.5 * SHIFTING - H, 10.0)['clutch'] == 1.0
    assert after(hands, NOTHING, 0.25 * SHIFTING + H, 10.0)['clutch'] == pytest.approx(0.5)
    assert after(hands, Held(clutch=1.0), 1.0, 10.0)['clutch'] == 1.0
    for _ in range(9):
        hands.shift(1)
    assert hands.gear == 5
    for _ in range(9):
        hands.shift(-1)
    assert after(hands, NOTHING, 1.0, 0.0)['gear'] == -1.0
    automatic = Hands(dataclasses.replace(SEAT, engine=True, gears=(-1, 5), automatic=True))
    automatic.shift(1)
    assert after(automatic, NOTHING, H, 0.0)['clutch'] == 0.0 and automatic.gear == 1  # the lever: it works them itself


def test_a_page_that_says_no_numbers_is_not_believed() -> None:
    said: dict[str, Any] = {'number': 7, 'seen': 3, 'left': 1, 'gas': 0.25, 'wheel': None, 'other': 'x'}
    assert held_of(said) == Held(number=7, left=1, gas=0.25)
    assert held_of({'wheel': -1.0}).wheel == -1.0
    for name, value in (
        ('gas', math.nan), ('gas', 1.01), ('gas', -0.01), ('brake', math.inf), ('left', True), ('right', '1'),
        ('hand', None), ('clutch', [1]), ('wheel', 1.5), ('number', -1), ('number', 1e300), ('number', None),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=name):
            held_of({name: value})


@pytest.mark.parametrize('scene', ['slider_crank', 'torque_free_top', 'rolling_disc'])
def test_what_has_no_car_is_refused(scene: str) -> None:
    with pytest.raises(SceneError, match=r'has no car to drive.*handling_course'):
        Seat.of(load_scene(scene), ('steering', 'drive_torque', 'brake_torque'))


def test_a_car_that_is_turned_by_a_torque_is_refused() -> None:
    scene = load_scene('car_step_steer', ['maneuver={name: none}', 'actuation.steering=torque'])
    with pytest.raises(SceneError, match='turned by its angle'):
        Seat.of(scene, ('steering_torque', 'drive_torque', 'brake_torque'))


def test_the_seat_of_the_full_car_has_its_mass_and_its_steering() -> None:
    """1.5 t on wheels of 0.31 m; 17 turns of the steering wheel to one of the road wheels, as its scenes tell their
    drivers."""
    scene = load_scene('handling_course')
    seat = Seat.of(scene, ('steering', 'drive_torque', 'brake_torque', 'brake_torque_rear_left'))
    mass = sum(body.mass for body in scene.model.bodies)
    assert seat.braking / mass == pytest.approx(0.31, abs=0.02)
    assert seat.inertia == pytest.approx(seat.braking)
    assert seat.ratio == pytest.approx(scene.maneuver.driver.ratio, rel=0.05)
    assert seat.wheelbase == pytest.approx(scene.maneuver.driver.wheelbase, rel=0.01)
    assert seat.rear == ('brake_torque_rear_left',)


@pytest.mark.parametrize('vehicle', ['light_car', 'pickup_awd', 'electric_4wd', 'compact_fwd'])
def test_torque_per_acceleration_counts_all_axles_and_motors(vehicle: str) -> None:
    """A torque that is commanded reaches the wheels whole, whatever its shares are: mass times radius of the wheels."""
    scene = load_scene('handling_course', [f'vehicle=vehicles/{vehicle}.yaml'])
    seat = Seat.of(scene, ('steering', 'drive_torque', 'brake_torque'))
    assert seat.inertia == pytest.approx(seat.braking, rel=1e-12)
