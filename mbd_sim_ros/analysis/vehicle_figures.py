"""Figures of a vehicle as outputs of sweeps and targets of a search: by the names and units of `mbd info`."""

from __future__ import annotations

import math
from collections.abc import Collection

from solver.analysis.figures import Figures, all_figures, is_vehicle, standing
from solver.analysis.typical_values import TEXTS
from solver.errors import MbdError, SpecError, suggestion
from solver.scene import Scene
from solver.units import SPELLED, UNITS, WITH_UNIT

# Unit of mbd info -> SI unit; the factor is that of TEXTS. What is not here is SI already.
SI = {
    'deg': 'rad', 'mm': 'm', 'kN/m': 'N/m', 'N m/deg': 'N m/rad', 'deg/m': 'rad/m', 'deg/deg': '1', 'deg/kN': 'rad/N',
    'mm/kN': 'm/N', 'deg/(100 N m)': 'rad/(N m)', '%': '1', 'deg/g': 'rad s^2/m', 'g/(100 deg)': 'm/s^2/rad',
    'kN': 'N', '': '1',
}  # fmt: skip


def unit_of(name: str) -> str:
    """SI unit of a figure of `mbd info`. Raises SpecError for a name that it does not have."""
    if name not in TEXTS:
        raise SpecError(f'mbd info has no figure {name!r}{suggestion(name, TEXTS)}')
    unit = TEXTS[name][1]
    return SI.get(unit, unit)


def vehicle_figures(scene: Scene, names: Collection[str]) -> Figures:
    """The figures of these names [SI] of the vehicle of a scene, standing on a flat road, and the reason for each that
    is missing. Raises SpecError for a name that no vehicle has."""
    for name in names:
        unit_of(name)
    if not is_vehicle(scene.model):
        why = f'{scene.name} is no vehicle with tires at four corners'
        return Figures({}, dict.fromkeys(names, why))
    try:
        found, failed = all_figures(standing(scene), names)
    except MbdError as error:  # it does not stand
        return Figures({}, dict.fromkeys(names, str(error)))
    missing = {name: failed.get(name) or 'it is none of the figures of this vehicle' for name in names}
    return Figures(
        {name: found[name] for name in names if name in found},
        {name: why for name, why in missing.items() if name not in found},
    )


def in_si(name: str, text: str, unit: str, shown: str, factor: float) -> float:
    """Value [SI] of a text like '2.5 deg/g' for the figure `name`.

    unit: SI unit of the figure. shown: its unit for people, and factor: from SI to that one. A number alone is taken
    only where both are the same and none: 2.5 for 2.5 deg/g would be another car. Raises SpecError.
    """
    match = WITH_UNIT.fullmatch(text)
    try:
        number = float(match[1]) if match else math.nan
    except ValueError:
        number = math.nan
    units = [one for one in dict.fromkeys((shown, '' if unit == '1' else unit)) if one]
    if match is None or not math.isfinite(number):
        raise SpecError(f'{name}={text}: must be a number{" with its unit, " + " or ".join(units) if units else ""}')
    given = ' '.join(SPELLED.get(match[2], match[2]).split())
    compact = {one.replace(' ', ''): one for one in (shown, unit)}
    given = compact.get(given.replace(' ', ''), given)
    if given == shown:
        return number / factor
    if given == unit or (not given and unit == '1' and factor == 1.0):
        return number
    if UNITS.get(given, ('', 0.0))[0] == unit:
        return number * UNITS[given][1]
    said = f'{given!r} is no unit of it' if given else 'its unit is missing'
    raise SpecError(f'{name}={text}: {said}; write it in {" or ".join(units) or "no unit"}')
