"""The loop of the adapter on a car that is a mass: speeds are reached and kept, it turns back through rest, gears and
reports are those."""

from __future__ import annotations

import itertools
import math
from types import SimpleNamespace

import pytest

from mbd_sim_ros.node.demand_messages import ackermann, control, gear, twist
from mbd_sim_ros.node.speed_control import DRIVE, NEUTRAL, PARK, REVERSE, Car, Demand, Loop
from solver.files.scene import load_scene, load_scene_text
from solver.inputs.driver import SpeedControl

MASS, RADIUS = 1400.0, 0.3
CAR = Car(wheelbase=2.6, inertia=MASS * RADIUS, steering=16.0)
CONTROL = SpeedControl(bandwidth=0.5, most=2000.0, least=-300.0, brakes=6000.0)


class Mass:
    """A car that goes straight on: torques over radius and mass, rolling resistance; brakes hold it at rest."""

    def __init__(self, speed: float = 0.0) -> None:
        self.speed, self.loop, self.h = speed, Loop(CAR, CONTROL, 0.5), 0.01
        self.brake = 0.0

    def run(self, demand: Demand | None, seconds: float, gear: str | None = DRIVE) -> list[float]:
        speeds = []
        for _ in range(round(seconds / self.h)):
            self.wheel, drive, self.brake = self.loop.commands(demand, gear, self.speed, self.h)
            free = self.speed + self.h * drive / (MASS * RADIUS)
            resistance = self.h * (self.brake / (MASS * RADIUS) + 0.1)
            self.speed = math.copysign(max(abs(free) - resistance, 0.0), free)
            speeds.append(self.speed)
        return speeds


def test_a_speed_is_reached_and_kept_against_resistance():
    car = Mass()
    car.run(Demand(speed=8.0), 20.0)
    assert car.speed == pytest.approx(8.0, abs=0.02)
    car.run(Demand(speed=3.0), 10.0)
    assert car.speed == pytest.approx(3.0, abs=0.02)


def test_the_wanted_speed_changes_by_its_ramp():
    car = Mass(5.0)
    speeds = car.run(Demand(speed=10.0, ramp=0.5), 6.0)
    assert speeds[-1] - speeds[199] == pytest.approx(0.5 * 4.0, abs=0.1)


def test_a_car_that_shall_go_back_comes_to_rest_first_and_stands_when_it_shall_stand():
    car = Mass(5.0)
    speeds = car.run(Demand(speed=-2.0), 20.0, gear=REVERSE)
    assert car.speed == pytest.approx(-2.0, abs=0.05)
    assert all(b <= a + 0.05 for a, b in itertools.pairwise(speeds))
    car.run(Demand(speed=0.0), 5.0)
    assert (car.speed, car.brake) == (0.0, CONTROL.brakes)


@pytest.mark.parametrize(('gear', 'speed'), [(DRIVE, 0.0), (PARK, 0.0), (REVERSE, -2.0), (None, -2.0)])
def test_a_gear_has_the_last_word_on_the_direction(gear, speed):
    car = Mass()
    car.run(Demand(speed=-2.0), 15.0, gear=gear)
    assert car.speed == pytest.approx(speed, abs=0.05)


@pytest.mark.parametrize('gear', [DRIVE, REVERSE, NEUTRAL])
def test_neutral_rolls_and_silence_brakes_with_the_wheels_where_they_are(gear):
    car = Mass(10.0)
    car.run(Demand(speed=20.0, steering=0.1), 2.0, gear=NEUTRAL)
    assert car.speed == pytest.approx(10.0 - 0.2)
    car.run(None, 6.0, gear=gear)
    assert (car.speed, car.wheel) == (0.0, pytest.approx(1.6))


def test_yaw_rates_become_angles_of_the_road_wheels():
    """tan(angle) = L r / v; backwards the wheels turn the other way; at rest to the end that turns so."""
    loop = Loop(CAR, CONTROL, 0.5)
    for speed, rate in ((5.0, 0.4), (-3.0, 0.2)):
        loop.commands(Demand(speed=speed, steering=None, yaw_rate=rate), DRIVE, speed, 0.01)
        assert math.tan(loop.road_wheel) == pytest.approx(2.6 * rate / speed)
    loop.commands(Demand(speed=0.0, steering=None, yaw_rate=0.3), DRIVE, 0.0, 0.01)
    assert loop.road_wheel == 0.5
    loop.reset()
    for _ in range(10):
        loop.commands(Demand(speed=5.0, steering=0.4, steering_rate=0.5), DRIVE, 5.0, 0.01)
    assert loop.road_wheel == pytest.approx(0.05)


def test_a_car_that_goes_backwards_when_the_loop_begins_goes_on():
    car = Mass(-2.0)
    assert max(car.run(Demand(speed=-2.0), 2.0, gear=None)) < -1.9
    assert car.brake == 0.0


@pytest.mark.parametrize('way', [1.0, -1.0])
def test_at_rest_a_yaw_rate_turns_the_wheels_to_one_side_however_the_car_swings_in_its_springs(way):
    """A swing of 0.1 m/s changes the sign of the speed; the angle fits the way that it went, or the one that it shall
    go."""
    loop = Loop(CAR, CONTROL, 0.5)
    stand, creep = Demand(speed=0.0, steering=None, yaw_rate=0.3), Demand(speed=0.2 * way, steering=None, yaw_rate=0.02)
    loop.commands(Demand(speed=3.0 * way, steering=None, yaw_rate=0.3), None, 3.0 * way, 0.01)
    for wanted, angle in ((stand, 0.5), (creep, math.atan2(2.6 * 0.02, 0.2))):
        for speed in (0.29 * way, 0.1, -0.1, 1e-6, -1e-6, 0.0):
            loop.commands(wanted, None, speed, 0.01)
            assert loop.road_wheel == pytest.approx(way * angle)


def test_a_car_that_shall_turn_back_yaws_to_the_side_that_is_wanted_until_it_stands():
    loop = Loop(CAR, CONTROL, 0.5)
    for speed in (5.0, 1.0):
        loop.commands(Demand(speed=-2.0, steering=None, yaw_rate=0.1), None, speed, 0.01)
        assert math.tan(loop.road_wheel) == pytest.approx(2.6 * 0.1 / speed)
    loop.commands(Demand(speed=-2.0, steering=None, yaw_rate=0.1), None, 0.1, 0.01)
    assert math.tan(loop.road_wheel) == pytest.approx(2.6 * 0.1 / -2.0)


def test_messages_of_others_are_demands():
    drive = SimpleNamespace(steering_angle=0.1, steering_angle_velocity=0.0, speed=4.0, acceleration=1.5, jerk=0.0)
    assert ackermann(drive) == Demand(speed=4.0, steering=0.1, ramp=1.5)
    lateral = SimpleNamespace(
        steering_tire_angle=-0.2, steering_tire_rotation_rate=0.3, is_defined_steering_tire_rotation_rate=False
    )
    longitudinal = SimpleNamespace(velocity=6.0, acceleration=-1.0, is_defined_acceleration=True)
    assert control(SimpleNamespace(lateral=lateral, longitudinal=longitudinal)) == Demand(
        speed=6.0, steering=-0.2, acceleration=-1.0
    )
    message = SimpleNamespace(linear=SimpleNamespace(x=2.0), angular=SimpleNamespace(z=0.1))
    assert twist(message) == Demand(speed=2.0, steering=None, yaw_rate=0.1)
    assert not Demand(speed=math.nan).is_finite and Demand(steering=None).is_finite
    assert [gear(n) for n in (0, 1, 2, 19, 20, 21, 22, 23, 99)] == [
        NEUTRAL,
        NEUTRAL,
        DRIVE,
        DRIVE,
        REVERSE,
        REVERSE,
        PARK,
        DRIVE,
        NEUTRAL,
    ]


def test_a_car_is_known_by_its_scene():
    scene = load_scene('light_car_straight')
    car = Car.of(scene, ratio=15.0)
    assert car.wheelbase == pytest.approx(2.6, abs=0.2) and car.steering_wheel(0.1) == pytest.approx(1.5)
    assert car.road_wheel(1.5) == pytest.approx(0.1)
    by_map = Car.of(scene)
    assert [by_map.road_wheel(by_map.steering_wheel(angle)) for angle in (-0.3, 0.0, 0.2)] == pytest.approx(
        [-0.3, 0.0, 0.2], abs=1e-5
    )
    assert by_map.road_wheel(100.0) == pytest.approx(by_map.steering.points[-1][0])  # no further than the map goes
    assert car.inertia == pytest.approx(sum(b.mass for b in scene.model.bodies) * 0.3, rel=0.05)


def test_motors_of_several_wheels_push_the_car_together():
    """Of a commanded torque each front motor of the car gives 0.2 and each rear one 0.3: together all of it."""
    text = 'vehicle: vehicles/electric_4wd.yaml\nstart: {kind: equilibrium}\nduration: 1\n'
    scene = load_scene_text(text, 'electric_4wd')
    mass = sum(b.mass for b in scene.model.bodies)
    # its front wheels are at 0.298 m, its rear ones at 0.299 m
    assert Car.of(scene, ratio=15.0).inertia == pytest.approx(mass * 0.2985)
