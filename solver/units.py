"""Units that files and command lines may use, and what they are in SI."""

from __future__ import annotations

import math
import re

# The two values of gravity stand here and nowhere else in the program; they differ by 0.03 %. Standard gravity [m/s^2]
# (3rd General Conference on Weights and Measures, 1901): the unit g. Accelerations and gradients that people read in g,
# forces in kgf, and limits that norms state in g use it.
STANDARD_GRAVITY = 9.80665
# Gravity [m/s^2] of models that state none, such as the delivered vehicles, and of what is laid out for them: the
# damping of a tire at rest, the speed that anti-lock control takes as safe, the maneuvers of an error sheet. Another
# value changes the bits of their runs.
MODEL_GRAVITY = 9.81
_DEG = math.pi / 180.0
# Unit -> (SI unit, factor)
UNITS = {
    'deg': ('rad', _DEG), 'deg/s': ('rad/s', _DEG), 'deg/s^2': ('rad/s^2', _DEG), 'rpm': ('rad/s', math.pi / 30.0),
    'turn': ('rad', 2.0 * math.pi),
    'km/h': ('m/s', 1.0 / 3.6), 'mph': ('m/s', 0.44704), 'kn': ('m/s', 1852.0 / 3600.0), 'mm/s': ('m/s', 1e-3),
    'g': ('m/s^2', STANDARD_GRAVITY),
    'mm': ('m', 1e-3), 'cm': ('m', 1e-2), 'km': ('m', 1e3), 'in': ('m', 0.0254), 'ft': ('m', 0.3048),
    'kN': ('N', 1e3), 'daN': ('N', 10.0), 'kgf': ('N', STANDARD_GRAVITY),
    'lbf': ('N', 4.4482216152605), 'kN m': ('N m', 1e3), 'N mm': ('N m', 1e-3),
    'kJ': ('J', 1e3), 'kW': ('W', 1e3), 'ms': ('s', 1e-3), 'us': ('s', 1e-6), 'ns': ('s', 1e-9), '%': ('1', 1e-2),
}  # fmt: skip
SI = ('1', 'rad', 'rad/s', 'rad/s^2', 'm', 'm/s', 'm/s^2', 'N', 'N m', 'J', 'W', 's')
UNITS |= {name: (name, 1.0) for name in SI}
# what a key in a file may end in -> the unit that its value has
SUFFIXES = {'deg': 'deg', 'mm': 'mm', 'kmh': 'km/h', 'rpm': 'rpm'}
WITH_UNIT = re.compile(r'\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*(.*?)\s*')
SPELLED = {
    'm/s2': 'm/s^2', 'rad/s2': 'rad/s^2', 'deg/s2': 'deg/s^2', 'm/s²': 'm/s^2', 'rad/s²': 'rad/s^2',
    'deg/s²': 'deg/s^2',
    'Nm': 'N m', 'kNm': 'kN m', 'Nmm': 'N mm', 'kph': 'km/h', 'kmh': 'km/h', 'kmph': 'km/h', 'km/hr': 'km/h',
    'mi/h': 'mph', 'knots': 'kn',
    'kt': 'kn', 'm/s/s': 'm/s^2', 'm/s**2': 'm/s^2', 'm/sec': 'm/s', 'm/sec^2': 'm/s^2', 'm/sec2': 'm/s^2',
    'deg/sec': 'deg/s',
    'degree': 'deg', 'degrees': 'deg', 'degrees/s': 'deg/s', 'deg/sec^2': 'deg/s^2', 'rad/sec': 'rad/s',
    'radians': 'rad', 'rev/min': 'rpm',
    '1/min': 'rpm', 'sec': 's', 'seconds': 's', 'µs': 'us', 'μs': 'us', 'percent': '%', '°': 'deg', '-': '1',
}  # fmt: skip


def measured(text: str) -> tuple[float, str]:
    """(value in SI, SI unit) of a text like '2 %', '0.1 m' or '3'; a number alone has the unit ''. Raises ValueError
    that says why."""
    match = WITH_UNIT.fullmatch(text)
    try:
        number = float(match[1]) if match else math.nan
    except ValueError:
        number = math.nan
    if match is None or not math.isfinite(number):
        raise ValueError('must be a number with its unit, e.g. 2 % or 0.1 m')
    unit = SPELLED.get(match[2], match[2])
    if not unit:
        return number, ''
    if unit not in UNITS:
        raise ValueError(f'no such unit {unit!r}; one of {", ".join(sorted(UNITS, key=str.lower))}')
    si, factor = UNITS[unit]
    return number * factor, '%' if unit == '%' else si


def shown(value: float, unit: str) -> str:
    """A value in SI for people: angles in degrees, short lengths and times in thousandths."""
    name, factor = {'rad': ('deg', 1.0 / _DEG), 'rad/s': ('deg/s', 1.0 / _DEG), 'rad/s^2': ('deg/s^2', 1.0 / _DEG)}.get(
        unit, (unit, 1.0)
    )
    if unit in ('m', 's') and 0.0 < abs(value) < 0.1:
        name, factor = f'm{unit}', 1e3
    return f'{value * factor:.3g} {"" if name == "1" else name}'.rstrip()
