"""The numbers that a fit estimates, with what is known of them before: parameters of the vehicle, constants that are
uncertain, and delay, gain, offset ... of the steering and of every sensor."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from mbd_sim_ros.fitting import sensors
from mbd_sim_ros.fitting.car import CONSTANTS, Car
from mbd_sim_ros.fitting.file import CLASS, FitFile, Known, number_of, sd_of
from mbd_sim_ros.fitting.sensors import KINDS
from solver.errors import SpecError

EXACT, OF_CLASS = Known(sd='none'), Known(sd=CLASS)
# Standard deviations of what nothing is said of, of a passenger car. Ten times as much would leave a fit to find what
# nobody doubts; a tenth would forbid what is usual.
OFFSET = math.radians(2.0)  # rad of the steering wheel
ROAD_OFFSET = math.radians(0.15)  # rad of a road wheel
LEVER = 0.05  # m, place of a sensor
MOUNTING = 0.02  # rad, its direction
# sd of what is known before, from which recordings are those of another car; ten times as many refuse none
FARTHEST = 4.0
LEAST, MOST = 0.02, 10.0  # bounds of a positive number, of its value; those of ten times as much are no bounds


@dataclasses.dataclass(frozen=True)
class Unknown:
    """A number that is estimated. name: as in the file and the results. of: 'vehicle', 'steering' or a channel. part:
    which one of it. centre, sd: what is known of it before, an infinite sd where nothing is. width: its scale. sought:
    a parameter of the file; others are there because they are uncertain."""

    name: str
    of: str
    part: str
    centre: float
    sd: float
    width: float
    low: float = -math.inf
    high: float = math.inf
    unit: str = ''
    sought: bool = False

    @property
    def runs(self) -> bool:
        """True where another value needs other runs."""
        return self.of in ('vehicle', 'steering')


class Unknowns(NamedTuple):
    """estimated: in the order of a vector. steering: part -> value where it is not estimated. sensors: channel -> the
    same."""

    estimated: list[Unknown]
    steering: dict[str, float]
    sensors: dict[str, dict[str, float]]

    def lead(self, channel: str, most: float) -> float:
        """Time [s], up to `most`, by which a sensor may show a motion before it happens, as stamps go."""
        for u in self.estimated:
            if (u.of, u.part) == (channel, 'delay'):
                return min(max(FARTHEST * u.sd - u.centre, 0.0), most)
        return max(-self.sensors[channel]['delay'], 0.0)


def unknowns_of(file: FitFile, car: Any, kinds: Mapping[str, str]) -> Unknowns:
    """All unknowns of a fit. car: as a Car is. kinds: channel -> kind of its sensor. Raises SpecError."""
    found, taken = [], dict[str, str]()
    for name, known in file.parameters.items():
        for key in car.number(name).keys:
            if key in taken:
                raise SpecError(f'parameters: {name} and {taken[key]} are both {key} of the vehicle; keep one of them')
            taken[key] = name
        found.append(_number(file, car, name, known, sought=True))
    constants: dict[str, Known] = {}
    if isinstance(file.constants, Mapping):
        constants = dict(file.constants) or dict.fromkeys(CONSTANTS, OF_CLASS)
    for name, known in constants.items():
        if file.loads is not None and name in ('mass', 'center_x'):
            continue
        if not any(key in taken for key in car.number(name).keys) and known.sd is not None:
            unknown = _number(file, car, name, known, sought=False)
            found += [unknown] if unknown.sd > 0.0 else []
    steering, fixed = _steering(file, car)
    parts = {name: _sensor(file, car, name, kinds[name]) for name in file.channels}
    for more in (steering, *(estimated for estimated, _ in parts.values())):
        found += more
    return Unknowns(found, fixed, {name: values for name, (_, values) in parts.items()})


def _number(file: FitFile, car: Any, name: str, known: Known, *, sought: bool) -> Unknown:
    number, own, of_class = car.number(name), car.value(name), car.class_sd(name)
    if file.loads is not None and set(number.keys) & {'chassis.mass', 'chassis.com.0'}:
        raise SpecError(
            f'parameters: {name}: the axle masses under loads already determine it; remove it from parameters, or '
            'remove loads'
        )
    unit = number.unit or ''
    centre = own if known.value is None else number_of(known.value, f'parameters: {name}: value', unit)
    sd = sd_of(known, f'parameters: {name}', centre, unit, of_class)
    low = -math.inf if known.low is None else known.low
    high = math.inf if known.high is None else known.high
    if own > 0.0 and number.relative:
        low, high = max(low, LEAST * own), min(high, MOST * own)
    if not low < centre < high:
        raise SpecError(
            f'parameters: {name}: the known value {centre:g} lies outside of its bounds {low:g} and {high:g}'
        )
    return Unknown(name, 'vehicle', name, centre, sd, of_class, low, high, unit, sought)


class _Part(NamedTuple):
    """known: what the file says. centre, sd: where it says nothing. low: bound."""

    known: Known
    centre: float
    sd: float
    unit: str
    low: float = -math.inf


def _steering(file: FitFile, car: Any) -> tuple[list[Unknown], dict[str, float]]:
    given, delay = file.drive, sensors.DELAY * car.size.time
    parts = {
        'delay': _Part(given.delay or OF_CLASS, 0.0, delay, 's'),
        'gain': _Part(given.gain or OF_CLASS, 1.0, sensors.GAIN, '1', low=0.2),
        'offset': _Part(given.offset or OF_CLASS, 0.0, ROAD_OFFSET if given.road_wheel else OFFSET, 'rad'),
        'lag': _Part(given.lag or EXACT, 0.0, delay, 's', low=0.0),
        # a delay that is common to all is told by the speed alone, of which drives at a steady speed tell nothing
        'speed_delay': _Part(given.speed_delay or EXACT, 0.0, delay, 's'),
    }
    found, centres = _estimated('steering', 'drive', parts)
    named = [dataclasses.replace(u, name='speed.delay') if u.part == 'speed_delay' else u for u in found]
    return named, centres


def _sensor(file: FitFile, car: Any, name: str, kind: str) -> tuple[list[Unknown], dict[str, float]]:
    channel, of = file.channels[name], KINDS[kind]
    lever = LEVER * car.size.length
    parts = {
        'delay': _Part(channel.delay or OF_CLASS, 0.0, sensors.DELAY * car.size.time, 's'),
        'gain': _Part(channel.gain or OF_CLASS, 1.0, sensors.GAIN, '1'),
        'offset': _Part(channel.offset or OF_CLASS, 0.0, of.offset * grown(of.unit, car), of.unit),
        'lever_x': _Part(channel.lever or EXACT, 0.0, lever, 'm'),
        'lever_y': _Part(channel.lever or EXACT, 0.0, lever, 'm'),
        'mounting': _Part(channel.mounting or EXACT, 0.0, MOUNTING, 'rad'),
    }
    return _estimated(name, f'channels.{name}', parts)


def _estimated(of: str, where: str, parts: Mapping[str, _Part]) -> tuple[list[Unknown], dict[str, float]]:
    """The unknowns among parts, and the centres of all. where: the place in the file."""
    found, centres = [], {}
    for part, one in parts.items():
        known = one.known
        centre = one.centre if known.value is None else number_of(known.value, f'{where}: {part}', one.unit)
        sd = sd_of(known, f'{where}: {part}', centre, one.unit, one.sd)
        centres[part] = centre
        if sd > 0.0:
            found.append(Unknown(f'{of}.{part}', of, part, centre, sd, one.sd, low=one.low, unit=one.unit))
    return found, centres


def grown(unit: str, car: Car) -> float:
    """Factor by which noise and offsets of a sensor grow with the size of the vehicle."""
    if unit == 'rad/s':
        return 1.0 / car.size.time
    return car.size.speed if unit == 'm/s' else 1.0


def with_unit(number: str, unit: str) -> str:
    """A number for people: 1 is no unit."""
    return number if unit in ('', '1') else f'{number} {unit}'
