"""Hands and feet of a driver at a page: keys and axes that are held become commands, step by step.

Keys turn the steering wheel at a rate and let it return at another one, and move the pedals at rates. An axis of a
gamepad says where wheel and pedals shall be. Both are kept where the car still follows: the angle of the wheel is at
most the one at which a neutral car of this wheelbase corners at CORNERING, and SLIDING beyond it for a car that slides:

    road wheels = L CORNERING / v^2 + SLIDING.

Pedals. A car without a powertrain of its own gets a torque at the differential, with the acceleration DRIVE at most and
with POWER per mass; a car with an engine gets the accelerator. The brake pedal decelerates by BRAKE at most, the
handbrake brakes the rear wheels alone. A gearbox that nobody works gets its clutch from the shift and from the start.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from mbd_sim_ros.node.gearbox import gears_of
from mbd_sim_ros.node.speed_control import Car
from solver.errors import SceneError, SpecError
from solver.inputs.command_filter import BY_WHEEL
from solver.inputs.shifting import Shifting
from solver.scene import Scene

LET_GO = 0.5  # s without a word of the page, after which nothing is held; ten times as much is a car without a driver
STEERING = 4.0  # rad/s of the steering wheel while a key is held; with ten times as much a tap is a full lock
RETURN = 8.0  # rad/s at which it goes back when nothing is held
AXIS = 15.0  # rad/s at which it follows an axis, as fast as hands turn it
CORNERING = 10.0  # m/s^2, about what tires carry; ten times as much would be no limit at any speed
SLIDING = 0.06  # rad of the road wheels beyond it, for the slip angles of a car that slides
LOCK = 8.0  # rad of the steering wheel, of a car without end stops
DRIVE = 4.5  # m/s^2 of drive with the pedal down, before POWER limits it
POWER = 100.0  # W/kg, of a car with 150 kW and 1.5 t
BRAKE = 11.0  # m/s^2 of the brake with the pedal down: just beyond dry grip
HAND = 5.0  # m/s^2 of the handbrake: locks the rear wheels
PEDALS = {'gas': (2.5, 6.0), 'brake': (4.0, 10.0), 'hand': (8.0, 8.0), 'clutch': (8.0, 4.0)}  # 1/s down, up
SHIFTING = Shifting.duration  # s for which the clutch is open behind a shift: fully in the first half
LAUNCH, BITE = Shifting.launch, Shifting.bite  # m/s below which the clutch slips, and how far it is closed at rest


class Held(NamedTuple):
    """Keys and axes that a page holds: pedals and keys from 0 to 1, wheel from -1 (right) to 1 (left) where an axis
    steers.

    number: of what the page sent, by which it measures when that reaches a picture.
    """

    number: int = 0
    left: float = 0.0
    right: float = 0.0
    gas: float = 0.0
    brake: float = 0.0
    hand: float = 0.0
    clutch: float = 0.0
    wheel: float | None = None


NOTHING = Held()


def in_force(said: tuple[Held, float] | None) -> Held:
    """Keys and axes that count now, of what a page said and when (time.monotonic()); None: nobody is at the wheel."""
    if said is None:
        return NOTHING
    held, when = said
    return held if time.monotonic() - when <= LET_GO else NOTHING._replace(number=held.number)


def held_of(said: Mapping[str, Any]) -> Held:
    """The keys and axes that a message of a page names. Raises ValueError for what is no number in its range."""
    found: dict[str, Any] = {}
    for name, value in said.items():
        if name not in Held._fields or (name == 'wheel' and value is None):
            continue
        low, high = (0, 2**53) if name == 'number' else (-1.0 if name == 'wheel' else 0.0, 1.0)
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise ValueError(f'{name} = {value!r}: must be a number from {low:g} to {high:g}')
        found[name] = value
    return Held(**found)


@dataclass(frozen=True, kw_only=True)
class Seat:
    """Limits of a car to the one who drives it.

    wheelbase [m]; ratio: of the steering wheel to the road wheels [-]; lock: of the steering wheel [rad]. inertia:
    torque at the differential, and braking: of all brakes, per acceleration [N m s^2/m]. rear: names of the commands
    that brake the rear wheels. gears: lowest and highest one of its gearbox, None without one; works: a gearbox that
    shifts by itself, whose lever `gear` is then. engine: the accelerator drives.
    """

    wheelbase: float
    ratio: float
    lock: float
    inertia: float
    braking: float
    rear: tuple[str, ...]
    engine: bool
    gears: tuple[int, int] | None
    automatic: bool

    @classmethod
    def of(cls, scene: Scene, names: tuple[str, ...]) -> Seat:
        """Seat in the car of a scene; names: of the commands that it takes. Raises SceneError where there is none."""
        model = scene.model
        if not getattr(model, 'tires', ()) or getattr(model, 'chassis', None) is None or names[0] != 'steering':
            raise SceneError(
                f'scene {scene.name!r} has no car to drive: it needs wheels with tires and a steering wheel that is '
                'turned by its angle; mbd list scenes names others, e.g. handling_course'
            )
        try:
            car = Car.of(scene)
        except SpecError as error:
            raise SceneError(f'scene {scene.name!r} cannot be driven here: {error}') from None
        places = {body.name: body.position for body in model.bodies}
        radius = sum(places[tire.marker.body][2] for tire in model.tires) / len(model.tires)
        engine = 'accelerator' in names
        return cls(
            wheelbase=car.wheelbase,
            ratio=abs(car.steering_wheel(0.02)) / 0.02,
            lock=model.lock or LOCK,
            inertia=car.inertia,
            braking=radius * sum(body.mass for body in model.bodies),
            rear=tuple(name for name in names if name.startswith(f'{BY_WHEEL[1]}rear_')),
            engine=engine,
            gears=gears_of(model) if engine else None,
            automatic=scene.assistance.shift is not None,
        )

    @property
    def levers(self) -> tuple[int, int]:
        """Lowest and highest position of the lever: reverse, neutral and drive, or the gears."""
        if self.gears is None:
            return -1, 1
        return (self.gears[0], 1) if self.automatic else self.gears


class Hands:
    """The wheel, the pedals and the lever as they stand. steering [rad]; steering_rate and return_rate of keys
    [rad/s]."""

    def __init__(self, seat: Seat, *, steering_rate: float = STEERING, return_rate: float = RETURN) -> None:
        self.seat, self.steering_rate, self.return_rate = seat, steering_rate, return_rate
        self.begin()

    def begin(self, steering: float = 0.0) -> None:
        """As at the start of a run, with the wheel at an angle [rad]."""
        self.steering = steering
        self.pedals = dict.fromkeys(PEDALS, 0.0)
        self.gear = 1
        self._since = math.inf  # s since the last shift

    def shift(self, by: int) -> None:
        """Move the lever by one."""
        low, high = self.seat.levers
        gear = min(max(self.gear + (1 if by > 0 else -1), low), high)
        if gear != self.gear:
            self.gear, self._since = gear, 0.0

    def reach(self, speed: float) -> float:
        """Largest angle [rad] to which the wheel is turned at a speed [m/s]."""
        seat = self.seat
        road = seat.wheelbase * CORNERING / max(speed * speed, 1e-3) + SLIDING
        return min(seat.lock, seat.ratio * road)

    def advance(self, held: Held, speed: float, h: float) -> dict[str, float]:
        """Commands by name after h seconds in which this was held, at a speed along the car [m/s]."""
        self._steer(held, speed, h)
        for name, (down, up) in PEDALS.items():
            now, wanted = self.pedals[name], getattr(held, name)
            self.pedals[name] = min(wanted, now + down * h) if wanted > now else max(wanted, now - up * h)
        self._since += h
        seat, gas, brake = self.seat, self.pedals['gas'], self.pedals['brake']
        commands = {'steering': self.steering, 'brake_torque': brake * BRAKE * seat.braking}
        hand = self.pedals['hand'] * HAND * seat.braking / max(len(seat.rear), 1)
        commands |= dict.fromkeys(seat.rear, hand)
        if seat.engine:
            return commands | {'accelerator': gas, 'gear': float(self.gear)} | self._clutch(speed)
        most = seat.inertia * min(DRIVE, POWER / max(abs(speed), 1e-3))
        return commands | {'drive_torque': gas * most * (self.gear > 0) - gas * most * (self.gear < 0)}

    def _steer(self, held: Held, speed: float, h: float) -> None:
        reach = self.reach(speed)
        if held.wheel is not None:
            wanted, rate = held.wheel * reach, AXIS
        else:
            wanted = (held.left - held.right) * reach
            rate = self.steering_rate if wanted * self.steering >= 0.0 and wanted else self.return_rate
        self.steering += min(max(wanted - self.steering, -rate * h), rate * h)

    def _clutch(self, speed: float) -> dict[str, float]:
        if self.seat.automatic:
            return {'clutch': self.pedals['clutch']}
        v, opened = abs(speed), min(max(2.0 - 2.0 * self._since / SHIFTING, 0.0), 1.0)
        if self.gear and v < LAUNCH:
            opened = max(opened, (1.0 - BITE) * (1.0 - v / LAUNCH) if self.pedals['gas'] > 0.0 else 1.0)
        return {'clutch': max(self.pedals['clutch'], opened)}
