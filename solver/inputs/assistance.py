"""Assistance at the brakes of single wheels: reference implementations of anti-lock and stability control, off unless a
scene has them; and the automatic gearbox of solver.inputs.shifting.

They see what a car can measure or estimate well (Feel), act on the inputs brake_torque_<wheel> of `actuation: {wheels:
true}`, and come before the actuators, whose lag is that of the hydraulics. Their effects are part of the recorded
inputs.

Anti-lock: the share m of its torque that a wheel gets follows, between 0 and 1,

    dm/dt = clip(gain (slip - lambda), -release, apply)        lambda = 1 - omega R / v

with the speed v of the wheel's place along the car, below 0 in reverse as omega is; both rear wheels get the smaller
share of the two (select low), which keeps the rear axle's side force on split friction. A locked wheel is released
within 1 / release seconds, and its slip settles about `slip`, near the peak of the tire, as far as the hydraulics let
it.

Stability: the yaw rate that the steering asks for is that of the steady single-track model ([Gillespie1992] 6.5), as
much of it as friction allows,

    r_wanted = v delta / (L + K v^2),    |r_wanted| <= 0.85 mu g / v

and where the yaw rate is off by e beyond a threshold, one wheel is braked on the side that turns the car back: the
front wheel where the car turns too much, the rear one where it turns too little, with gain (|e| - threshold), at most
`torque`. Commands that drive are taken back in the same measure: the drive torque, those of single wheels and the
accelerator, where they are above 0. It is off in reverse: the steady motion is v delta / (L - K v^2) there, a car that
understeers forward oversteers, and the wheel that turns it back is another one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.dimensions import Length, PerSecond, Speed, Torque, TurnDamping, Understeer, YawRate
from solver.errors import SpecError
from solver.inputs.shifting import Shifter, Shifting
from solver.units import MODEL_GRAVITY
from solver.validate import finite

USED = 0.85  # of the friction


@dataclass(frozen=True, kw_only=True)
class AntiLock:
    """Anti-lock control; see the module. slip: that is kept [-]; gain [1/s], release and apply [1/s]; slowest: speed,
    forward or in reverse, below which it lets wheels lock [m/s]."""

    slip: float = 0.10
    gain: PerSecond = 60.0
    release: PerSecond = 20.0
    apply: PerSecond = 4.0
    slowest: Speed = 2.0

    def __post_init__(self) -> None:
        finite('anti-lock', 'slip', self.slip, low=0.0, high=1.0, strict=True)
        for name in ('gain', 'release', 'apply', 'slowest'):
            finite('anti-lock', name, getattr(self, name), low=0.0, strict=True)


@dataclass(frozen=True, kw_only=True)
class StabilityControl:
    """Stability control; see the module. wheelbase [m], ratio of the steering, understeer gradient [rad s^2/m],
    friction that it counts on [-]; threshold of the yaw rate [rad/s]; gain [N m s/rad] and torque, the largest one [N
    m]; slowest: speed forward below which it is off, as it is in reverse [m/s]."""

    wheelbase: Length = 2.7
    ratio: float = 15.0
    understeer: Understeer = 0.003
    friction: float = 0.9
    threshold: YawRate = 0.04
    gain: TurnDamping = 12000.0
    torque: Torque = 2500.0
    slowest: Speed = 5.0

    def __post_init__(self) -> None:
        for name in ('wheelbase', 'friction', 'gain', 'torque', 'slowest'):
            finite('stability', name, getattr(self, name), low=0.0, strict=True)
        for name in ('understeer', 'threshold'):
            finite('stability', name, getattr(self, name), low=0.0)
        if self.ratio == 0.0 or not math.isfinite(self.ratio):
            raise SpecError(f'stability: ratio = {self.ratio!r}: must be a finite number other than 0')


@dataclass(frozen=True, kw_only=True)
class Assistance:
    """Assistances of the driver; none is off. anti_lock, stability: at the brakes; shift: an automatic gearbox
    (solver.inputs.shifting)."""

    anti_lock: AntiLock | None = None
    stability: StabilityControl | None = None
    shift: Shifting | None = None

    @property
    def brakes(self) -> bool:
        """True where it acts on the brakes of single wheels."""
        return self.anti_lock is not None or self.stability is not None

    def __bool__(self) -> bool:
        return self.brakes or self.shift is not None


class Feel(NamedTuple):
    """Measurements at the beginning of a step: speed along the chassis at its reference frame [m/s], yaw rate [rad/s],
    and by wheel in the order of the model's tires the rate of its spin [rad/s]."""

    speed: float
    yaw_rate: float
    spins: tuple[float, ...]


class AssistedWheel(NamedTuple):
    """A wheel: its name, its share of the brake torque [-], its rolling radius [m], how far to the left of the middle
    of the car it stands [m], the index of its body and its spin axis in that (positive when rolling forward)."""

    name: str
    share: float
    radius: float
    left: float
    body: int
    axis: np.ndarray


class Assistant:
    """The assistance of a simulation with inputs of these names and with these wheels, in steps of h [s].

    state: share of its brake torque that each wheel gets, and that of an automatic gearbox; assign it to restore.
    Raises SpecError for a model without the inputs that it acts on.
    """

    def __init__(
        self, assistance: Assistance, input_names: Sequence[str], wheels: Sequence[AssistedWheel], h: float
    ) -> None:
        self.assistance, self.h = assistance, h
        names = list(input_names)
        self._shifter = None if assistance.shift is None else Shifter(assistance.shift, names, h)
        wheels = wheels if assistance.brakes else ()
        for wheel in wheels:
            if f'brake_torque_{wheel.name}' not in names:
                raise SpecError(
                    f'assistance: the model has no input brake_torque_{wheel.name}: set actuation: {{wheels: true}}'
                )
        self._wheels = [(wheel, names.index(f'brake_torque_{wheel.name}')) for wheel in wheels]
        rear = [k for k, wheel in enumerate(wheels) if wheel.name.startswith('rear_')]
        self._together = [rear if k in rear else [k] for k in range(len(wheels))]
        self._brake = names.index('brake_torque') if 'brake_torque' in names else None
        driving = {'drive_torque', 'accelerator', *(f'drive_torque_{wheel.name}' for wheel in wheels)}
        self._drives = [place for place, name in enumerate(names) if name in driving]
        self._steering = names.index('steering') if 'steering' in names else None
        if assistance.stability is not None:
            if self._steering is None:
                raise SpecError(
                    'assistance: stability: the model has no input steering, the angle of the steering wheel'
                )
            if not {f'{axle}_{side}' for axle in ('front', 'rear') for side in ('left', 'right')} <= {
                wheel.name for wheel in wheels
            }:
                raise SpecError(
                    'assistance: stability: the model has not the wheels front_left, front_right, rear_left and '
                    'rear_right'
                )
        self._shares = np.ones(len(self._wheels))

    def start(self, commands: np.ndarray, speed: float) -> np.ndarray:
        """Back to t = 0 at a speed along the car [m/s], with commands (nu,): (nu,) inputs there. Every wheel has its
        torque, the gearbox the gear of that speed."""
        row = commands.copy()
        self._shares = np.ones(len(self._wheels))
        if self._shifter is not None:
            self._shifter.start(row, speed)
        return row

    def begin(self, inputs: np.ndarray, memory: np.ndarray | None) -> None:
        """Begin in the middle of a motion: from the memory of another scene where that is like the state of this one,
        else with inputs (nu,), whose gear stays in."""
        self._shares = np.ones(len(self._wheels))
        if memory is not None and memory.shape == self.state.shape and memory.dtype == float:
            self.state = memory
        elif self._shifter is not None:
            self._shifter.begin(inputs)

    @property
    def state(self) -> np.ndarray:
        """Shares of the wheels, then gear and time of the gearbox."""
        return self._shares if self._shifter is None else np.concatenate([self._shares, self._shifter.state])

    @state.setter
    def state(self, value: np.ndarray) -> None:
        if value.shape != self.state.shape:
            raise SpecError(
                f'restore: the assistance has {self.state.size} states here, {value.size} are saved: other scene'
            )
        self._shares = value[: len(self._wheels)].copy()
        if self._shifter is not None:
            self._shifter.state = value[len(self._wheels) :].copy()

    def act(self, commands: np.ndarray, feel: Feel) -> np.ndarray:
        """(nu,) inputs of a step with commands (nu,); advances by that step."""
        row = commands.copy()
        if self._shifter is not None:
            self._shifter.act(row, feel.speed)
        if self.assistance.stability is not None:
            self._stabilise(row, feel, self.assistance.stability)
        if self.assistance.anti_lock is not None:
            self._unlock(row, feel, self.assistance.anti_lock)
        return row

    def _stabilise(self, row: np.ndarray, feel: Feel, control: StabilityControl) -> None:
        v = feel.speed
        if v < control.slowest or self._steering is None:
            return
        wanted = v * float(row[self._steering]) / control.ratio / (control.wheelbase + control.understeer * v * v)
        most = USED * control.friction * MODEL_GRAVITY / v
        wanted = min(max(wanted, -most), most)
        error = feel.yaw_rate - wanted
        torque = min(control.gain * (abs(error) - control.threshold), control.torque)
        if torque <= 0.0:
            return
        side = 'right' if error > 0.0 else 'left'
        axle = 'front' if error * wanted >= 0.0 else 'rear'
        for wheel, place in self._wheels:
            if wheel.name == f'{axle}_{side}':
                row[place] += torque
        for place in self._drives:
            if row[place] > 0.0:
                row[place] *= 1.0 - torque / control.torque

    def _unlock(self, row: np.ndarray, feel: Feel, control: AntiLock) -> None:
        shares = self._shares.tolist()
        total = 0.0 if self._brake is None else float(row[self._brake])
        for k, (wheel, _) in enumerate(self._wheels):
            v = feel.speed - feel.yaw_rate * wheel.left
            slip = 1.0 - feel.spins[k] * wheel.radius / v if abs(v) > control.slowest else 0.0
            change = min(max(control.gain * (control.slip - slip), -control.release), control.apply)
            shares[k] = min(max(shares[k] + self.h * change, 0.0), 1.0)
        for k, (wheel, place) in enumerate(self._wheels):
            share = min(shares[i] for i in self._together[k])
            asked = max(wheel.share * total + float(row[place]), 0.0)
            row[place] -= (1.0 - share) * asked
        self._shares = np.array(shares)


def feel_of(speed: float, v: np.ndarray, chassis: int, wheels: Sequence[AssistedWheel]) -> Feel:
    """Measurements at a forward speed [m/s] and the twists v (nb + 1, 6), angular in the bodies [rad/s]."""
    spins = tuple(float(np.add.reduce(wheel.axis * v[wheel.body, 3:])) for wheel in wheels)
    return Feel(speed, float(v[chassis, 5]), spins)
