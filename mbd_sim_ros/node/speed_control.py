"""Speed control: a demand of another program becomes commands of the simulator: speed by torques, road wheels by the
steering wheel.

No ROS here: messages of every package become a Demand in `demand_messages.py`, and adapter.py carries both.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from solver.errors import SpecError
from solver.inputs.driver import SpeedControl
from solver.inputs.signals import Jet, Mapped
from solver.levels.road_wheel import steering_map, steering_wheel_at
from solver.scene import Scene

REST = 0.3  # m/s; slower than this a car may change its direction
HOLD = 0.05  # m/s wanted; below it a car that has come to rest is held by its brakes
DRAWN = 301  # points of the map of a steering, read the other way round: to 1e-6 rad
DRIVE, NEUTRAL, REVERSE, PARK = 'drive', 'neutral', 'reverse', 'park'


@dataclass(frozen=True, kw_only=True)
class Demand:
    """Wanted motion of a car. A value of None is left to the control loop.

    steering: mean angle of the front road wheels [rad], or yaw_rate [rad/s] instead; steering_rate [rad/s]: of the road
    wheels, at most. speed: along the car, below zero backwards [m/s]. acceleration: of the speed that is wanted, for
    the torque to lead [m/s^2]; ramp: the largest change of the wanted speed [m/s^2].
    """

    speed: float = 0.0
    steering: float | None = 0.0
    yaw_rate: float = 0.0
    steering_rate: float | None = None
    acceleration: float | None = None
    ramp: float | None = None

    @property
    def is_finite(self) -> bool:
        """True where every value that is given is a finite number."""
        return all(math.isfinite(value) for value in dataclasses.astuple(self) if value is not None)


@dataclass(frozen=True, kw_only=True)
class Car:
    """Data of a car that the control loop needs. inertia: torque of the drive per acceleration [N m s^2/m]; steering:
    its map, or a ratio."""

    wheelbase: float
    inertia: float
    steering: Mapped | float

    @classmethod
    def of(cls, scene: Scene, ratio: float | None = None) -> Car:
        """Car of the vehicle of a scene. ratio: of its steering; None: the ratio is measured, which raises SpecError
        where it cannot be."""
        model = scene.model
        places = {b.name: b.position for b in model.bodies}
        wheels = {t.name: places[t.marker.body] for t in model.tires}
        if not {'front', 'rear'} <= {name.partition('_')[0] for name in wheels}:
            raise SpecError(
                f'scene {scene.name!r} has no car: an adapter needs wheels called front_left ... rear_right'
            )
        x = {
            axle: float(np.mean([p[0] for name, p in wheels.items() if name.startswith(axle)]))
            for axle in ('front', 'rear')
        }
        radius = float(np.mean([p[2] for p in wheels.values()]))
        # torque of all wheels together per torque that is commanded: several axles or motors have a share each
        driven = [f for f in model.coordinate_forces if f.input == 'drive_torque']
        gain = sum(abs(f.input_gain * factor) for f in driven for _, factor in f.terms) or 1.0
        mass = sum(b.mass for b in model.bodies)
        return cls(
            wheelbase=x['front'] - x['rear'],
            inertia=mass * radius / gain,
            steering=steering_map(model) if ratio is None else ratio,
        )

    def steering_wheel(self, road_wheel: float) -> float:
        """Angle of the steering wheel [rad] for an angle of the road wheels [rad]."""
        return (
            self.steering * road_wheel
            if isinstance(self.steering, float)
            else steering_wheel_at(self.steering, road_wheel)
        )

    def road_wheel(self, steering_wheel: float) -> float:
        """Angle of the road wheels [rad] at an angle of the steering wheel [rad], without what forces twist."""
        if isinstance(self.steering, float):
            return steering_wheel / self.steering
        return float(np.interp(steering_wheel, *self._drawn))

    @cached_property
    def _drawn(self) -> tuple[np.ndarray, np.ndarray]:
        """Angles of the steering wheel and of the road wheels, so close that a line is drawn between them."""
        assert not isinstance(self.steering, float)
        road_wheels, zero = np.linspace(self.steering.points[0][0], self.steering.points[-1][0], DRAWN), np.zeros(DRAWN)
        return self.steering.of_jet(Jet(road_wheels, zero, zero)).value, road_wheels


def _target(demand: Demand, gear: str | None) -> float:
    """Speed [m/s] that is wanted in a gear: forwards in drive, backwards in reverse, and either way where none is
    said."""
    if gear == REVERSE:
        return -abs(demand.speed)
    return max(demand.speed, 0.0) if gear == DRIVE else demand.speed


class Loop:
    """Turns demands into commands, step by step of simulation time. largest: angle of the road wheels [rad]."""

    def __init__(self, car: Car, control: SpeedControl, largest: float) -> None:
        self.car, self.largest = car, largest
        self.control = dataclasses.replace(control, inertia=car.inertia)
        self.reset()

    def reset(self) -> None:
        """As if it had just begun."""
        self.road_wheel = 0.0
        self.direction = 1.0
        self._wanted: float | None = None
        self._kept = 0.0

    def commands(self, demand: Demand | None, gear: str | None, speed: float, h: float) -> tuple[float, float, float]:
        """(steering wheel [rad], drive torque [N m], brake torque [N m]) for a car at `speed` [m/s]; h [s] since the
        last call.

        demand: None where nothing is wanted any more: the car is braked to rest with the wheels as they are, in neutral
        too. gear: None where nobody says one: the sign of the wanted speed does.
        """
        if demand is not None:
            self._steer(demand, gear, speed, h)
        elif gear == NEUTRAL:
            gear = DRIVE
        drive, brake = self._torques(demand or Demand(), gear, speed, h)
        return self.car.steering_wheel(self.road_wheel), drive, brake

    def _turning(self, target: float, speed: float) -> float:
        """Speed [m/s], with its sign, at which a yaw rate is wanted.

        That is the one which the car is to reach, or has as long as it is to stop or to turn back. At rest the sign of
        its speed is that of what swings in its springs: there the way that it shall go counts, or went.
        """
        if abs(speed) > REST and (abs(target) <= REST or target * speed < 0.0):
            return speed
        return math.copysign(max(abs(target), HOLD), target or self.direction)

    def _steer(self, demand: Demand, gear: str | None, speed: float, h: float) -> None:
        wanted = demand.steering
        if wanted is None:
            moving = self._turning(_target(demand, gear), speed)
            wanted = math.atan2(self.car.wheelbase * demand.yaw_rate * math.copysign(1.0, moving), abs(moving))
        wanted = min(max(wanted, -self.largest), self.largest)
        if demand.steering_rate:
            most = abs(demand.steering_rate) * h
            wanted = min(max(wanted, self.road_wheel - most), self.road_wheel + most)
        self.road_wheel = wanted

    def _torques(self, demand: Demand, gear: str | None, speed: float, h: float) -> tuple[float, float]:
        if self._wanted is None and abs(speed) > REST:
            self.direction = math.copysign(1.0, speed)  # it begins with a car that moves
        if gear == PARK:
            self._wanted, self._kept = 0.0, 0.0
            return 0.0, self.control.brakes
        target = _target(demand, gear)
        if gear == NEUTRAL:
            self._wanted, self._kept = speed, 0.0
            return 0.0, 0.0
        if target * self.direction < 0.0:
            if abs(speed) < REST:
                self.direction, self._kept = math.copysign(1.0, target), 0.0
            else:
                target = 0.0
        forwards, target = self.direction * speed, self.direction * target
        if target < HOLD and abs(forwards) < REST:
            self._wanted, self._kept = 0.0, 0.0
            return 0.0, self.control.brakes
        if self._wanted is None:
            self._wanted = forwards
        slope = self.direction * demand.acceleration if demand.acceleration is not None else 0.0
        if demand.ramp:
            before, most = self._wanted, abs(demand.ramp) * h
            self._wanted = min(max(target, before - most), before + most)
            slope = (self._wanted - before) / h if h > 0.0 else 0.0
        else:
            self._wanted = target
        drive, brake, self._kept = self.control.torques(0.0, self._wanted, slope, forwards, self._kept, h)
        return self.direction * drive, brake
