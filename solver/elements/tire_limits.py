"""Range in which the coefficients of a tire mean something: refusals and remarks.

Every rule follows from the published equations ([P] 4.3.2, [B], docs/references.md): a divisor that vanishes, a
stiffness or friction that changes its sign at loads the tire carries, a spring that cannot carry the nominal load, a
curve that turns around. Rules look at the law as a whole, at the inflation pressure of the tire, so several
coefficients may be the reason; the sentence names them all.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from solver.elements.slip_limits import camber, combined, force, moments, relaxation
from solver.elements.upright_law import Coefficients, Finding, UprightLaw
from solver.errors import SpecError

POSITIVE = ('FNOMIN', 'UNLOADED_RADIUS', 'VERTICAL_STIFFNESS', 'LONGVL', 'PCX1', 'PDX1', 'PKX1', 'PCY1', 'PKY2', 'PKY4')
DIVISORS = ('LFZO', 'LCX', 'LMUX', 'LKX', 'LCY', 'LMUY', 'LKY')
# relative change of pressure beyond which the quadratic terms of pressure are no longer those of the measurement
DPI = 0.5
NOT_NEGATIVE = (
    *(
        'VERTICAL_DAMPING',
        'NOMPRES',
        'INFLPRES',
        'FZMAX',
        'BOTTOM_STIFF',
        'LONGITUDINAL_STIFFNESS',
        'LATERAL_STIFFNESS',
    ),
    *(
        'WIDTH',
        'RIM_RADIUS',
        'Q_FZ1',
        'LEX',
        'LEY',
        'LKYC',
        'LKZC',
        'LGAX',
        'LGAY',
        'LGAZ',
        'LTR',
        'LXAL',
        'LYKA',
        'LMX',
        'LMY',
    ),
    *('LSGKP', 'LSGAL'),
)
OFFSETS = ('LHX', 'LHY', 'LVX', 'LVY', 'LRES', 'LVYKA', 'LS', 'LVMX')  # scale factors that may turn an asymmetry around
HOLDS = ('PDX1', 'PDY1', 'PKX1', 'PKY1', 'VERTICAL_STIFFNESS')
RANGES = {  # (lowest, highest, what it is)
    'Q_RE0': (0.9, 1.1, 'it is the free radius over UNLOADED_RADIUS'),
    'ELLIPS_SHIFT': (0.1, 3.0, ''),
    'ELLIPS_LENGTH': (0.1, 3.0, ''),
    'ELLIPS_HEIGHT': (0.1, 3.0, ''),
    'ELLIPS_ORDER': (1.0, 10.0, ''),
}


def check(where: str, data: Coefficients, pressure: float | None = None) -> None:
    """Refuse a tire that the equations do not describe. pressure: inflation pressure [Pa], None for that of the data.
    Raises SpecError."""
    for found in _findings(data, pressure):
        if found.refused:
            raise SpecError(f'{where}: {found.key} = {data[found.key]:g}: {found.text}')


def oddities(data: Coefficients, pressure: float | None = None) -> list[str]:
    """Sentences on coefficients that are odd but can be computed. pressure: see check()."""
    return [
        f'{found.key} = {data[found.key]:g}: {found.text}' for found in _findings(data, pressure) if not found.refused
    ]


def oddest(data: Coefficients, pressure: float | None = None) -> str:
    """The first of oddities() of what a tire holds a vehicle with: scale factors, friction, slip stiffness, spring;
    with its file and line, or ''. For what fails in a start, and would be blamed on a body."""
    for found in _findings(data, pressure):
        if found.key in (*DIVISORS, *HOLDS) and not found.refused:
            place = getattr(data, 'places', {}).get(found.key, '')
            return f'{place}: ' * bool(place) + f'{found.key} = {data[found.key]:g}: {found.text}'
    return ''


def _findings(data: Coefficients, pressure: float | None) -> Iterator[Finding]:
    yield from _ranges(data)
    law = UprightLaw(data, pressure)
    yield from _pressure(law)
    yield from _spring(law)
    yield from _speed(law)
    for axis in ('x', 'y'):
        yield from force(law, axis)
        yield from relaxation(law, axis)
        yield from combined(law, axis)
    yield from camber(law)
    yield from moments(law)


def _ranges(data: Mapping[str, float] | Coefficients) -> Iterator[Finding]:
    """Limits of single numbers."""
    for key in (*POSITIVE, *DIVISORS):
        if not data[key] > 0.0:
            yield Finding(key, True, 'must be positive' + ': forces are divided by it' * (key in DIVISORS))
    if not data['PKY1'] < 0.0:
        yield Finding('PKY1', True, 'must be negative: these are ISO-W axes, where Fy is positive for negative alpha')
    if data['PDY1'] == 0.0:
        yield Finding('PDY1', True, 'must not be 0: forces are divided by it')
    for key in NOT_NEGATIVE:
        if data[key] < 0.0:
            yield Finding(key, True, 'must not be negative')
    if data['QSY7'] < 0.0:
        yield Finding('QSY7', True, 'must be positive')
    for key, (low, high, meaning) in RANGES.items():
        if not low <= data[key] <= high:
            yield Finding(key, True, f'must be in [{low:g}, {high:g}]' + f': {meaning}' * bool(meaning))
    for key in (*DIVISORS, *(k for k in NOT_NEGATIVE if k[0] == 'L' and k[1] != 'A' and 'STIFF' not in k), *OFFSETS):
        if data[key] != 0.0 and not 0.2 <= abs(data[key]) <= 5.0:
            yield Finding(key, False, 'a scale factor that is far from 1')
        if data[key] < 0.0:
            yield Finding(key, False, 'a negative scale factor turns what it scales around')
    if 0.0 < data['FZMAX'] < data['FNOMIN']:
        yield Finding(
            'FZMAX', False, f'is below FNOMIN = {data["FNOMIN"]:g}: what depends on the load is held at FZMAX'
        )


def _pressure(law: UprightLaw) -> Iterator[Finding]:
    d = law.data
    if d.version == 61 and d['NOMPRES'] > 0.0 and d.values.get('INFLPRES') == 0.0:  # 5.2 knows no pressure
        text = (
            'must be positive: a tire without pressure is none that the Magic Formula describes; leave it out for '
            'NOMPRES'
        )
        yield Finding('INFLPRES', True, text)
    if abs(law.dpi) > DPI:
        ratio = f'the pressure is {1.0 + law.dpi:.3g} times NOMPRES = {d["NOMPRES"]:g}'
        yield Finding('INFLPRES', False, f'{ratio}: the terms of pressure are those of a measurement near it')
    for key, factor in {
        'PFZ1': 1.0 + d['PFZ1'] * law.dpi,
        'PPY2': 1.0 + d['PPY2'] * law.dpi,
        'PPY1': 1.0 + d['PPY1'] * law.dpi,
    }.items():
        if factor <= 0.0:
            pressures = f'{1.0 + law.dpi:.3g} times NOMPRES (INFLPRES, NOMPRES)'
            yield Finding(key, True, f'the stiffness ends at the pressure of this tire, {pressures}')


def _spring(law: UprightLaw) -> Iterator[Finding]:
    """Load, radii and rim ([B] 4, 7)."""
    d, R0, F0 = law.data, law.R0, law.F0
    k = law.c_z * R0 / F0
    of = f'FNOMIN = {F0:g} and UNLOADED_RADIUS = {R0:g}'
    if d['Q_FZ1'] == 0.0 and k * k <= 4.0 * d['Q_FZ2']:
        least = 2.0 * math.sqrt(d['Q_FZ2']) * F0 / R0
        text = f'with Q_FZ2 = {d["Q_FZ2"]:g}, {of} no spring has this slope at FNOMIN, whose least is {least:.4g} N/m'
        yield Finding('VERTICAL_STIFFNESS', True, text)
        return
    most = max(1.0, min(2.0, (d['FZMAX'] or math.inf) / F0))
    rest, low = law.deflection(1.0), law.deflection(most)
    if not low < 1.0:
        carried = (
            f'the spring softens with Q_FZ1 = {d["Q_FZ1"]:g} and VERTICAL_STIFFNESS = {law.c_z:g} until it does '
            'not carry'
        )
        yield Finding('Q_FZ2', True, f'{carried} {most * F0:g} N ({of})')
        return
    rim = d['RIM_RADIUS']
    if rim >= R0:
        yield Finding('RIM_RADIUS', True, f'must be below UNLOADED_RADIUS = {R0:g}')
    if rest > (1.0 - rim / R0 if 0.0 < rim < R0 else 0.5):
        room = f'the rim of RIM_RADIUS = {rim:g}' if rim > 0.0 else 'half the radius'
        spring = f'Q_FZ1 = {d["Q_FZ1"]:g}' if d['Q_FZ1'] > 0.0 else 'this spring'
        yield Finding(
            'VERTICAL_STIFFNESS', True, f'on {spring} a tire of {of} is pressed in by {rest * R0:.3g} m, beyond {room}'
        )
    elif not 0.01 <= rest <= 0.25:
        yield Finding(
            'VERTICAL_STIFFNESS', False, f'a tire of {of} is pressed in by {100.0 * rest:.3g} % of its radius at rest'
        )
    if d['Q_FZ1'] > 0.0:
        slope = math.sqrt(d['Q_FZ1'] ** 2 + 4.0 * d['Q_FZ2']) * F0 / R0
        if not 0.7 < slope / law.c_z < 1.4:
            text = f'Q_FZ1 = {d["Q_FZ1"]:g}, Q_FZ2 = {d["Q_FZ2"]:g} have the slope {slope:.4g} N/m at {of}'
            yield Finding(
                'VERTICAL_STIFFNESS', False, f'{text}: the load follows from these, the rolling radius from that'
            )
    if law.width > 2.0 * R0:
        yield Finding('WIDTH', False, f'is more than twice UNLOADED_RADIUS = {R0:g}')
    if d.values.get('WIDTH') == 0.0:
        yield Finding('WIDTH', False, 'taken as 0.65 UNLOADED_RADIUS')
    if d['BOTTOM_STIFF'] > 0.0 and 0.0 < rim < R0:
        gap = (R0 - rim - d['BOTTOM_OFFST']) / R0
        sizes = f'with RIM_RADIUS = {rim:g} and UNLOADED_RADIUS = {R0:g} the rim touches the road'
        if gap <= 0.0:
            yield Finding('BOTTOM_OFFST', True, f'{sizes} before the tire does')
        elif gap < rest:
            yield Finding('BOTTOM_OFFST', False, f'{sizes} at less than FNOMIN')
        elif d['BOTTOM_OFFST'] < 0.0:
            yield Finding('BOTTOM_OFFST', False, f'{sizes} when it is below the road')
    if d['VERTICAL_DAMPING'] > 0.05 * law.c_z:
        text = (
            f'with VERTICAL_STIFFNESS = {law.c_z:g} the tire takes {d["VERTICAL_DAMPING"] / law.c_z:.3g} s to '
            'spring back'
        )
        yield Finding('VERTICAL_DAMPING', False, text)
    for load in (0.5, 1.0, 2.0):
        c_z = law.c_z * (1.0 + d['PFZ1'] * law.dpi)
        q = load * d['BREFF']
        radius = R0 * d['Q_RE0'] - F0 / c_z * (d['DREFF'] * math.atan(q) + d['FREFF'] * load)
        loaded = R0 * (d['Q_RE0'] - law.deflection(min(load, most)))
        names = f'with BREFF = {d["BREFF"]:g}, FREFF = {d["FREFF"]:g}, VERTICAL_STIFFNESS = {law.c_z:g} and {of}'
        text = f'{names} the effective rolling radius is {radius:.4g} m at {load:g} FNOMIN'
        if not 0.5 * R0 < radius < 1.2 * R0:
            yield Finding('DREFF', True, f'{text}: it must be near UNLOADED_RADIUS')
            return
        if load == 1.0 and not loaded - 0.005 * R0 <= radius <= (d['Q_RE0'] + 0.005) * R0:
            yield Finding('DREFF', False, f'{text}, not between the loaded radius {loaded:.4g} m and the free one')


def _speed(law: UprightLaw) -> Iterator[Finding]:
    """Growth, stiffening ([B] 2, 4) and rolling resistance (4.E70) at the reference speed."""
    d, v = law.data, law.speed
    at = f'at {v * d["LONGVL"]:.3g} m/s with LONGVL = {d["LONGVL"]:g}'
    growth = d['Q_V1'] * v * v
    if not -0.1 < growth < 0.3:
        yield Finding('Q_V1', True, f'{at} the radius would be {1.0 + growth:.3g} times UNLOADED_RADIUS')
    elif not -0.01 <= growth <= 0.05:
        yield Finding('Q_V1', False, f'{at} the radius is {1.0 + growth:.3g} times UNLOADED_RADIUS')
    stiffer = 1.0 + d['Q_V2'] * v
    if 1.0 + 3.0 * d['Q_V2'] * v <= 0.0 or stiffer > 10.0:
        yield Finding('Q_V2', True, f'{at} the load of the spring would be {stiffer:.3g} times that at rest')
    elif not 0.7 <= stiffer <= 1.5:
        yield Finding('Q_V2', False, f'{at} the load of the spring is {stiffer:.3g} times that at rest')
    names = f'with QSY3 = {d["QSY3"]:g}, QSY4 = {d["QSY4"]:g}, LMY = {d["LMY"]:g}'
    with np.errstate(over='ignore'):
        scale = d['LMY'] * float(np.float64(1.0 + law.dpi) ** d['QSY8'])
    for speed in (0.1 * v, v):
        share = scale * (d['QSY1'] + d['QSY3'] * speed + d['QSY4'] * speed**4)
        text = (
            f'{names} the rolling resistance is {share:.3g} of the load at {speed * d["LONGVL"]:.3g} m/s (LONGVL = '
            f'{d["LONGVL"]:g})'
        )
        if abs(share) > 1.0:
            yield Finding('QSY1', True, text)
            return
        if share < 0.0:
            yield Finding('QSY1', False, f'{text}: it drives')
        elif share > 0.1:
            yield Finding('QSY1', False, text)
        if not -1e-9 <= share <= 0.1:
            break
    leaning = scale * (d['QSY1'] + (d['QSY5'] + d['QSY6']) * law.lean**2)
    if not -1e-9 <= leaning <= 0.2:
        text = (
            f'with QSY6 = {d["QSY6"]:g} the rolling resistance at a camber of {math.degrees(law.lean):.3g} deg is '
            f'{leaning:.3g} of the load'
        )
        yield Finding('QSY5', False, text)
    if d['QSY7'] > 3.0:
        yield Finding('QSY7', False, 'the rolling resistance grows with more than the third power of the load')
