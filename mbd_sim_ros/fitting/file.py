"""The file of a fit (docs/fitting.md): recordings, how they drive the vehicle, what is sought and what is known of it.

vehicle: vehicles/light_car.yaml
level: full
mapping: car.yaml                                     # names and units of the recordings (docs/comparing.md)
recordings:
  lap_1: {file: lap_1.csv}
  lap_2: {file: lap_2.csv, use: held_out}
drive: {steering_wheel: cmd_applied/steering, speed: odom/twist/vx}
channels:
  yaw_rate: {channel: imu/wz}
  lateral_acceleration: {channel: imu/ay, at: [0.3, 0, 0.6], delay: {sd: 50 ms}}
parameters:
  mass: {sd: 2 %}
  cornering_stiffness_front: {}
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from solver.dimensions import Angle, Length, Point, Time
from solver.errors import SpecError, suggestion
from solver.files.schema import Builder
from solver.files.yaml_tree import MappingNode, ScalarNode, displayed, parse, read_text
from solver.units import measured
from solver.validate import finite, require

CLASS = 'class'
LEVELS = ('full', 'condensed', 'kc', 'single_track')


@dataclass(frozen=True, kw_only=True)
class Known:
    """Knowledge of a number before the fit: its value and the standard deviation of that. sd: a number, or words: '2 %'
    of the value, '0.01 m', 'class' for that of its class (docs/fitting.md), 'none' for a number that is exact; left
    out: nothing is known. value: the centre; left out: that of the vehicle. low, high: bounds that hold always."""

    value: float | str | None = None
    sd: float | str | None = None
    low: float | None = None
    high: float | None = None

    def __post_init__(self) -> None:
        if self.low is not None and self.high is not None:
            require(self.low < self.high, 'fit', 'low', self.low, f'must be below high = {self.high:g}')


@dataclass(frozen=True, kw_only=True)
class Channel:
    """A measured signal. channel: its name in the recording. noise: standard deviation of its noise between samples,
    for the preflight (left out: by the recording). at: place of the sensor in the design frame [m]; left out: the
    centre of mass of the chassis. yaw: angle by which its x axis is mounted to the left [rad]. delay [s], gain, offset:
    what is known of them; left out: as sensors of their kind are. lever: of the place along x and y. horizontal: an
    acceleration is that in the plane of the road, as inertial navigation gives it, and not that of a sensor which rolls
    and pitches with the body and feels its weight."""

    channel: str
    noise: float | str | None = None
    at: Point | None = None
    yaw: Angle = 0.0
    delay: Known | None = None
    gain: Known | None = None
    offset: Known | None = None
    lever: Known | None = None
    mounting: Known | None = None
    horizontal: bool = False


@dataclass(frozen=True, kw_only=True)
class Recording:
    """A recording: a file, or for a preflight a maneuver that is only planned (docs/fitting.md).

    use: it is fitted, or held out: the result is judged by it. start, end: of what is taken, in
    seconds from its first stamp. mapping: another one than that of the fit."""

    file: str = ''
    maneuver: str = ''
    use: Literal['fit', 'held_out'] = 'fit'
    start: Time = 0.0
    end: Time | None = None
    mapping: str = ''

    def __post_init__(self) -> None:
        one = bool(self.file) != bool(self.maneuver)
        require(one, 'recording', 'file', self.file, 'give this or maneuver, and not both')


@dataclass(frozen=True, kw_only=True)
class Windows:
    """Windows that are driven open loop. length: of what is compared [s]. run_in: time before it, in which the vehicle
    comes into the motion of its inputs from straight ahead, so that the state at the begin of a window is that of the
    model. slowest: windows with a speed below it are left out [m/s]; left out: 3 m/s of a passenger car."""

    length: Time = 10.0
    run_in: Time = 2.0
    slowest: float | None = None

    def __post_init__(self) -> None:
        require(self.length > 0.0, 'windows', 'length', self.length, 'must be > 0')
        require(self.run_in > 0.0, 'windows', 'run_in', self.run_in, 'must be > 0')


@dataclass(frozen=True, kw_only=True)
class Drive:
    """Measured inputs. steering_wheel: channel of the angle at the steering wheel [rad], or road_wheel: that of the
    road wheels, of which several are averaged. scale: of that angle over the channel; or curve: pairs of both, between
    which it is linear, as of a servo that has only a command. speed: channel of the speed along
    x that is followed [m/s], or drive_torque and brake_torque [N m]; both torques need the speed at the start of a
    window. sign of brake_torque: >= 0. delay, gain, offset: what is known of the steering. lag: time constant of the
    steering behind its command [s]. speed_delay: what is known of the delay of a speed that is followed."""

    steering_wheel: str = ''
    road_wheel: tuple[str, ...] = ()
    scale: float = 1.0
    curve: tuple[tuple[float, float], ...] = ()
    speed: str
    drive_torque: str = ''
    brake_torque: str = ''
    delay: Known | None = None
    gain: Known | None = None
    offset: Known | None = None
    lag: Known | None = None
    speed_delay: Known | None = None

    def __post_init__(self) -> None:
        one = bool(self.steering_wheel) != bool(self.road_wheel)
        require(one, 'drive', 'steering_wheel', self.steering_wheel, 'give this or road_wheel, and not both')
        if self.curve:
            require(self.scale == 1.0, 'drive', 'scale', self.scale, 'give this or curve, and not both')
            of, angles = np.diff(np.array(self.curve), axis=0).T if len(self.curve) > 1 else np.zeros((2, 1))
            rising = bool((of > 0.0).all() and ((angles > 0.0).all() or (angles < 0.0).all()))
            require(
                rising,
                'drive',
                'curve',
                [list(pair) for pair in self.curve],
                'must be at least two pairs [channel, angle] with rising channel and rising (or falling) angle',
            )

    def angle(self, values: np.ndarray) -> np.ndarray:
        """Angles [rad] of values of the channel. Raises SpecError for those beyond the curve."""
        if not self.curve:
            return np.asarray(self.scale * values)
        of, angles = np.array(self.curve).T
        far = values[np.argmax(np.maximum(of[0] - values, values - of[-1]))] if values.size else of[0]
        if not of[0] <= far <= of[-1]:
            raise SpecError(
                f'drive.curve: {(self.road_wheel or (self.steering_wheel,))[0]} reaches {far:g}, and the curve ends at '
                f'{of[0]:g} and {of[-1]:g}: is the unit of the channel right? otherwise give pairs farther out'
            )
        return np.interp(values, of, angles)

    def channel(self, angles: np.ndarray) -> np.ndarray:
        """Values of the channel of angles [rad], those of the ends of the curve beyond it."""
        if not self.curve:
            return np.asarray(angles / self.scale)
        pairs = sorted(self.curve, key=lambda pair: pair[1])
        return np.interp(angles, *np.array(pairs).T[::-1])

    @property
    def torques(self) -> tuple[str, ...]:
        """Channels of torques; without one the speed is followed."""
        return tuple(name for name in (self.drive_torque, self.brake_torque) if name)

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that it needs."""
        steering = self.road_wheel or (self.steering_wheel,)
        return (*steering, self.speed, *self.torques)


@dataclass(frozen=True, kw_only=True)
class Like:
    """A vehicle made from a delivered one by similarity (mbd_sim_ros.fitting.similar): wheelbase, track [m], mass [kg],
    share of the weight in front, height of the centre of mass [m], radius of the wheels [m], driven axle, mean angle of
    the road wheels at full lock over which the linkage steers stays that of the original."""

    vehicle: str
    wheelbase: Length
    mass: float
    front_share: float | None = None
    height: Length | None = None
    driven: str = ''


@dataclass(frozen=True, kw_only=True)
class Loads:
    """Measured masses on both axles [kg], which hold exactly: chassis mass and centre of mass follow from them."""

    front: float
    rear: float


@dataclass(frozen=True, kw_only=True)
class FitFile:
    """A fit. step: of the integrator [s]; rate: samples of a second that are compared [1/s]; left out: 4 ms and 25 1/s
    of a passenger car. set: KEY=VALUE of the scene. seed: of starts and samples; starts: how many. constants:
    what is known of numbers of the vehicle that are not sought: their uncertainty is part of every interval; {} for
    those of docs/fitting.md, 'exact' for none."""

    vehicle: str = ''
    like: Like | None = None
    level: Literal['full', 'condensed', 'kc', 'single_track'] = 'full'
    mapping: str = ''
    recordings: dict[str, Recording]
    drive: Drive
    channels: dict[str, Channel]
    parameters: dict[str, Known]
    constants: dict[str, Known] | str = field(default_factory=dict)
    windows: Windows = field(default_factory=Windows)
    loads: Loads | None = None
    set: tuple[str, ...] = ()
    step: Time | None = None
    rate: float | None = None
    starts: int = 1
    seed: int = 1

    def __post_init__(self) -> None:
        one = bool(self.vehicle) != (self.like is not None)
        require(one, 'fit', 'vehicle', self.vehicle, 'give this or like, and not both')
        require(bool(self.recordings), 'fit', 'recordings', {}, 'must name at least one recording')
        require(bool(self.channels), 'fit', 'channels', {}, 'must name at least one measured signal')
        require(bool(self.parameters), 'fit', 'parameters', {}, 'must name at least one parameter')
        finite('fit', 'starts', self.starts, low=1, high=100)
        exact = self.constants == 'exact' or not isinstance(self.constants, str)
        require(exact, 'fit', 'constants', self.constants, 'must be a mapping, or the word exact')


def load_file(file: Path) -> FitFile:
    """Read the file of a fit. Raises SceneError (file, line, remedy)."""
    root = parse(read_text(file), displayed(file))
    if isinstance(root, MappingNode):
        for _, value in root.value:
            _quoted(value)
    return Builder().build(FitFile, root)


def _quoted(node: object) -> None:
    """Names of files stay text: what reads them looks them up beside the fit."""
    if isinstance(node, ScalarNode) and node.style is None and node.value.endswith(('.yaml', '.csv', '.tir', '.mcap')):
        node.style = "'"
    for child in getattr(node, 'value', ()) if not isinstance(node, ScalarNode) else ():
        for part in child if isinstance(child, tuple) else (child,):
            _quoted(part)


def _measured(text: str, unit: str) -> tuple[float, str]:
    """As solver.units.measured, which does not know all units of the data of vehicles."""
    number = text.strip().removesuffix(unit).strip() if unit not in ('', '1') else ''  # the end of 1.1 is no unit
    try:
        return float(number), unit
    except ValueError:
        return measured(text)


def sd_of(known: Known, name: str, value: float, unit: str, of_class: float) -> float:
    """Standard deviation of a number in its unit; infinite where nothing is known, 0 where it is exact. of_class: that
    of its class. Raises SpecError."""
    words = known.sd
    if words is None:
        return math.inf
    if words == CLASS:
        return of_class
    if words == 'none':
        return 0.0
    try:
        number, told = _measured(str(words), unit)
    except ValueError as error:
        known_words = suggestion(str(words), (CLASS, 'none'))
        raise SpecError(f'{name}: sd = {words!r}: {error}, or one of the words class, none{known_words}') from None
    if told == '%':
        number, told = number * (abs(value) if unit != '1' or value else 1.0), unit
        if number == 0.0:
            raise SpecError(f'{name}: sd = {words!r}: the value is 0, of which a percentage is nothing; give a number')
    if told not in ('', unit):
        raise SpecError(f'{name}: sd = {words!r}: is in {told}, and the value is in {unit}')
    if not number > 0.0:
        raise SpecError(f'{name}: sd = {words!r}: must be > 0; write none for a number that is exact')
    return number


def number_of(words: float | str, name: str, unit: str) -> float:
    """A number that may have its unit with it. Raises SpecError."""
    try:
        number, told = _measured(str(words), unit)
    except ValueError as error:
        raise SpecError(f'{name} = {words!r}: {error}') from None
    if told not in ('', unit):
        raise SpecError(f'{name} = {words!r}: is in {told}; {unit} is wanted')
    return number
