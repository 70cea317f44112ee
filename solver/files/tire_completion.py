"""Completion of tire data: converts entries that the model has in another form, and estimates coefficients that are
missing.

Scale factors and load curves (PAC2002) become coefficients of the vertical spring of the tire. Missing relaxation
lengths follow from the slip stiffness and a carcass stiffness in proportion to the vertical stiffness. A note tells of
every change.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from solver.compiled.portable import inverse, product
from solver.errors import SpecError

# Carcass stiffness over vertical stiffness of the passenger car tire 225/50 R17 of test/data (358 and 103 kN/m of 210
# kN/m)
CARCASS_X, CARCASS_Y = 1.71, 0.49
# Load with the largest cornering stiffness where no side force was measured, relative to FNOMIN. Ten times as much
# makes the cornering stiffness proportional to the load.
PEAK_LOAD = 1.8
CURVE_ERROR = 0.1  # largest difference of the fitted parabola to a load curve, relative to FNOMIN
RANGE = 2.0  # load up to which the parabola is fitted, relative to FNOMIN


def complete(
    values: dict[str, float],
    extra: Mapping[str, float | str],
    notes: dict[str, str],
    curves: Mapping[str, list[tuple[float, float]]],
    version: int,
    length: float,
    given: frozenset[str] = frozenset(),
) -> None:
    """Complete coefficients (name -> value in SI units) in place, and note how.

    extra: keys of the file that are no coefficients of the model. notes: coefficient -> note. curves: section ->
    (deflection [m], force [N]) of DEFLECTION_LOAD_CURVE and BOTTOMING_CURVE. version: of the file, e.g. 61. length:
    unit of length of the file [m]. given: coefficients that stay as they are. Raises SpecError.
    """
    fixed = {key: (values[key], notes[key]) for key in given}
    if 'DEFLECTION_LOAD_CURVE' in curves:
        _load_curve(values, notes, curves['DEFLECTION_LOAD_CURVE'])
    if 'BOTTOMING_CURVE' in curves:
        _bottoming_curve(values, notes, curves['BOTTOMING_CURVE'], _number(extra, 'BOTTOMING_RADIUS', 0.0) * length)
    _scale_factors(values, extra, notes)
    for key, (value, note) in fixed.items():
        values[key], notes[key] = value, note
    if {'VERTICAL_STIFFNESS', 'FNOMIN', 'UNLOADED_RADIUS', 'PKX1', 'PKY1', 'PKY2'} <= values.keys():
        _relaxation(values, notes, version)


def directions(values: dict[str, float], notes: dict[str, str]) -> None:
    """Fill in the curve of a direction that was not measured (its coefficients C, D, K are 0 or absent), in place.

    The force over kappa is then that over tan(alpha) at zero camber, or the other way round, as of an isotropic tread
    ([Pacejka2012] 3.2).
    """
    for axis, other, measured in (('X', 'Y', 'side'), ('Y', 'X', 'longitudinal')):
        own = [f'P{group}{axis}1' for group in 'CDK']
        of = [f'P{group}{other}1' for group in 'CDK']
        if any(values.get(key, 0.0) != 0.0 for key in own) or not all(values.get(key, 0.0) != 0.0 for key in of):
            continue
        if axis == 'X' and not values.get('PKY2', 0.0) > 0.0:
            continue  # TireData refuses the file by this coefficient
        found = {
            f'P{group}{axis}{k}': values.get(f'P{group}{other}{k}', 0.0)
            for group, k in ('C1', 'D1', 'D2', 'D3', 'E1', 'E2')
        }
        found[f'PD{axis}1'] = abs(found[f'PD{axis}1'])
        if axis == 'X':  # the same stiffness and change of it with the load, at FNOMIN
            angle = values.get('PKY4', 2.0) * math.atan(1.0 / values['PKY2'])
            # d(angle)/d(load over FNOMIN)
            turn = values.get('PKY4', 2.0) * values['PKY2'] / (values['PKY2'] ** 2 + 1.0)
            found |= {'PKX1': -values['PKY1'] * math.sin(angle), 'PKX2': 0.0, 'PKX3': turn / math.tan(angle) - 1.0}
        else:
            found |= {
                'PKY2': PEAK_LOAD,
                'PKY4': 2.0,
                'PKY1': -values['PKX1'] / math.sin(2.0 * math.atan(1.0 / PEAK_LOAD)),
            }
        if values.get(f'PD{other}1', 0.0) < 0.0:
            found[f'PD{axis}2'] = -found[f'PD{axis}2']
        values |= dict.fromkeys((f'P{rest}{axis}{k}' for rest, k in ('E3', 'E4', 'H1', 'H2', 'V1', 'V2')), 0.0) | found
        for key in found:
            _note(
                notes,
                key,
                f'no {"longitudinal" if axis == "X" else "side"} force in the file: that of the {measured} force',
            )


def _number(extra: Mapping[str, float | str], key: str, default: float) -> float:
    """Number of a key that is no coefficient, in whatever section it stands; `default` without it."""
    value = next((v for name, v in extra.items() if name.rpartition('/')[2] == key), default)
    return value if isinstance(value, float) else default


def _note(notes: dict[str, str], key: str, text: str) -> None:
    """Add a text to the note on a coefficient."""
    notes[key] = f'{notes[key]}; {text}' if key in notes else text


def _load_curve(values: dict[str, float], notes: dict[str, str], curve: list[tuple[float, float]]) -> None:
    """Set Q_FZ1 and Q_FZ2 to the parabola through zero that fits the load curve best, up to RANGE FNOMIN."""
    R0, F0 = values.get('UNLOADED_RADIUS', 0.0), values.get('FNOMIN', 0.0)
    if not (R0 > 0.0 and F0 > 0.0):
        return  # TireData refuses the file by the missing coefficient
    points = np.array([p for p in curve if p[0] > 0.0])
    inside = points[: max(int(np.searchsorted(points[:, 1], RANGE * F0)) + 1, 2)] if len(points) else points
    if len({x for x, _ in inside.tolist()}) < 2:
        raise SpecError(
            f'DEFLECTION_LOAD_CURVE: {len(points)} rows with a deflection are too few: give two different ones, or '
            'remove the section'
        )
    x, force = inside[:, 0] / R0, inside[:, 1] / F0
    A = np.column_stack((x, x * x))
    q1, q2 = product(inverse(product(A.T, A)[None])[0], product(A.T, force)).tolist()
    error = float(np.abs(q1 * x + q2 * x * x - force).max())
    if error > CURVE_ERROR or q1 <= 0.0 or q1 + 2.0 * q2 * float(x[-1]) <= 0.0:
        raise SpecError(
            f'DEFLECTION_LOAD_CURVE: no parabola fits it (off by {100.0 * error:.0f} % of FNOMIN up to {RANGE:g} '
            'FNOMIN): remove the section, or give Q_FZ1 and Q_FZ2'
        )
    values['Q_FZ1'], values['Q_FZ2'] = float(q1), float(q2)
    text = (
        f'of the parabola nearest to DEFLECTION_LOAD_CURVE, which it misses by at most {100.0 * error:.2g} % of FNOMIN'
    )
    for key in ('Q_FZ1', 'Q_FZ2'):
        _note(notes, key, text)
    if 'VERTICAL_STIFFNESS' not in values:
        values['VERTICAL_STIFFNESS'] = math.sqrt(max(float(q1 * q1 + 4.0 * q2), 0.0)) * F0 / R0
        _note(notes, 'VERTICAL_STIFFNESS', 'slope of DEFLECTION_LOAD_CURVE at FNOMIN')


def _bottoming_curve(
    values: dict[str, float], notes: dict[str, str], curve: list[tuple[float, float]], radius: float
) -> None:
    """Set BOTTOM_STIFF and BOTTOM_OFFST to the straight line that fits the curve best, from the point where it begins
    to rise.

    radius: BOTTOMING_RADIUS [m], from which the deflections of the curve count; 0: they are deflections of the tire.
    """
    rise = [k for k, (_, force) in enumerate(curve) if force > 0.0]
    if not rise:
        return
    first = curve[rise[0] - 1] if rise[0] > 0 else (0.0, 0.0)
    x = np.array([p[0] - first[0] for p in curve[rise[0] :]])
    force = np.array([p[1] - first[1] for p in curve[rise[0] :]])
    square = float(product(x, x))
    stiffness = float(product(x, force)) / square if square > 0.0 else math.inf
    if not math.isfinite(stiffness) or stiffness <= 0.0:
        raise SpecError('BOTTOMING_CURVE: the force must rise with the deflection')
    R0, rim = values.get('UNLOADED_RADIUS', 0.0), values.get('RIM_RADIUS', 0.0)
    # distance of the wheel centre from the road at which the rim touches
    begin = R0 - first[0] if radius == 0.0 else radius - first[0]
    values['BOTTOM_STIFF'], values['BOTTOM_OFFST'] = stiffness, begin - rim
    error = float(np.abs(stiffness * x - force).max())
    text = f'of the straight line nearest to BOTTOMING_CURVE, which it misses by at most {error:.3g} N'
    for key in ('BOTTOM_STIFF', 'BOTTOM_OFFST'):
        _note(notes, key, text)


def _scale_factors(values: dict[str, float], extra: Mapping[str, float | str], notes: dict[str, str]) -> None:
    """Apply the scale factors LCZ of the vertical stiffness and LIP of the pressure."""
    stiffer = _number(extra, 'LCZ', 1.0)
    if stiffer != 1.0:
        if stiffer <= 0.0:
            raise SpecError(f'LCZ = {stiffer:g}: must be positive')
        R0, F0 = values.get('UNLOADED_RADIUS', 0.0), values.get('FNOMIN', 1.0)
        if values.get('Q_FZ2', 0.0) != 0.0 and values.get('Q_FZ1', 0.0) == 0.0:
            k = values.get('VERTICAL_STIFFNESS', 0.0) * R0 / F0
            values['Q_FZ1'] = math.sqrt(max(k * k - 4.0 * values['Q_FZ2'], 0.0))
            _note(notes, 'Q_FZ1', 'from VERTICAL_STIFFNESS')
        for key in ('VERTICAL_STIFFNESS', 'Q_FZ1', 'Q_FZ2'):
            if key in values:
                values[key] *= stiffer
                _note(notes, key, f'times LCZ = {stiffer:g}')
    pressure = _number(extra, 'LIP', 1.0)
    if pressure <= 0.0:
        raise SpecError(f'LIP = {pressure:g}: must be positive')
    if pressure != 1.0 and 'INFLPRES' in values:
        values['INFLPRES'] *= pressure
        _note(notes, 'INFLPRES', f'times LIP = {pressure:g}')


def _relaxation(values: dict[str, float], notes: dict[str, str], version: int) -> None:
    """Set missing relaxation lengths: slip stiffness over carcass stiffness ([Pacejka2012] 7.2), in version 5.2 at all
    loads."""
    R0, F0, c_z = values['UNLOADED_RADIUS'], values['FNOMIN'], values['VERTICAL_STIFFNESS']
    if not (R0 > 0.0 and F0 > 0.0 and c_z > 0.0):
        return
    for axis, carcass, ratio, names in (
        ('x', 'LONGITUDINAL_STIFFNESS', CARCASS_X, ('PTX1',)),
        ('y', 'LATERAL_STIFFNESS', CARCASS_Y, ('PTY1', 'PTY2')),
    ):
        known = version == 61 and values.get(carcass, 0.0) > 0.0
        if known or all(values.get(name, 0.0) > 0.0 for name in names):
            continue
        stiffness = ratio * c_z
        why = f'no relaxation length in the file: from a carcass of {ratio:g} VERTICAL_STIFFNESS'
        if version == 61:
            found = {carcass: stiffness}
        elif axis == 'x':
            found = {'PTX1': values['PKX1'] * F0 / (stiffness * R0)}
        else:
            found = {'PTY1': abs(values['PKY1']) * F0 / (stiffness * R0), 'PTY2': values['PKY2']}
        for key, value in found.items():
            values[key] = value
            _note(notes, key, why)
