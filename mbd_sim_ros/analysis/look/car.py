"""The first look at what belongs to a car: wheel speeds, steering, and to which side is positive."""

from __future__ import annotations

import math

import numpy as np

from mbd_sim_ros.analysis.look.grid import MOVING, Column, Fit
from mbd_sim_ros.analysis.look.relations import CORRELATION, TEXTS, Looking
from solver.units import UNITS

BIG = 8.0  # m/s: what drives faster is no model car
# m, of road vehicles and model cars, with what understeer adds to them at speed
WHEELBASES = {True: (1.2, 16.0), False: (0.1, 16.0)}
RADII = {True: (0.2, 0.65), False: (0.02, 0.65)}  # m, of their wheels
RATIOS = (8.0, 25.0)  # steering wheel to road wheels
# m: 100 % of the lock of a lorry with 6 m between the axles are 1500 for a curvature of 1/m, or 26 taken as degrees
SHARE_MOST = 30.0
TRACKS = {True: (0.8, 3.0), False: (0.05, 3.0)}  # m


def wheels(found: Looking) -> None:
    """Wheel speeds by that of the car, and the side by left and right."""
    g, v, r = found.grid, found.first('speed'), found.first('yaw_rate')
    wheels = found.by_role.get('wheel', [])
    for c in wheels:
        if v is None:
            c.why.append('wheel speed by its name; there is no speed of the car to check it against')
            continue
        fit = g.ratio(g.of(v.name), g.of(c.name))
        if abs(fit.correlation) < CORRELATION:
            c.why.append(f'wheel speed by its name, but it is not {v.name} times a constant')
            continue
        c.why.append(f'it follows {v.name}: {fit.text}')
        speeds = [v.unit] if v.unit else list(found.options(v))
        fits = {
            (s, u): k
            for s in speeds
            for u in found.options(c)
            if (k := _wheel(found, abs(fit.factor), s, u, v)) is not None
        }
        if len({u for _, u in fits}) == 1 and v.unit:
            c.unit, c.sign = next(u for _, u in fits), 1 if fit.factor * (v.sign or 1) > 0 else -1
        elif fits:
            ways = [
                f'{unit}{how}' + ('' if v.unit else f' if {v.name} is in {speed}')
                for (speed, unit), how in fits.items()
            ]
            c.why.append(f'its unit is not told: {" or ".join(ways)}')
        else:
            c.why.append(f'its factor fits no unit{" that is stated" if c.stated else ""}')
    if r is None:
        return
    for end in ('front', 'rear'):
        sides = [next((c for c in wheels if c.role.corner == f'{end}_{side}'), None) for side in ('left', 'right')]
        if sides[0] is None or sides[1] is None:
            continue
        left, right = (np.abs(g.of(c.name)) for c in sides if c is not None)
        moving = (left + right) > MOVING * np.nanmax(left + right)
        apart = np.where(moving, (right - left), np.nan)
        turn = np.where(moving, g.of(r.name), np.nan)
        fit = g.fit(turn, apart)
        if abs(fit.correlation) >= CORRELATION and _track(found, fit, sides[0], v, r):
            _anchor(
                found, 1 if fit.factor > 0 else -1, f'in a turn {sides[0].name} and {sides[1].name} differ ({fit.text})'
            )


def _track(found: Looking, fit: Fit, wheel: Column, v: Column | None, r: Column) -> bool:
    """True where the difference of the wheels is that of a track, as far as units are known."""
    if v is None or not (v.unit and r.unit):
        return True
    big = _big(found, v)
    speed = found.grid.ratio(found.grid.of(v.name), found.grid.of(wheel.name))  # wheel units per speed
    low, high = TRACKS[big]
    return low <= abs(fit.factor / speed.factor) * UNITS[v.unit][1] / UNITS[r.unit][1] <= high


def _big(found: Looking, v: Column) -> bool:
    return bool(np.nanmax(np.abs(found.grid.of(v.name))) * UNITS[v.unit or 'm/s'][1] > BIG)


def _wheel(found: Looking, factor: float, speed: str, unit: str, v: Column) -> str | None:
    """Fit of a wheel speed in a unit: '' or the radius; None where it does not fit."""
    base, size = UNITS[unit]
    ratio = factor * size / UNITS[speed][1]  # SI of the wheel per m/s
    if base == 'm/s':
        return '' if abs(math.log(ratio)) < 0.1 else None
    low, high = RADII[bool(np.nanmax(np.abs(found.grid.of(v.name))) * UNITS[speed][1] > BIG)]
    return f' of a wheel that rolls at {1.0 / ratio:.3g} m' if low <= 1.0 / ratio <= high else None


def steering(found: Looking) -> None:
    """Steering by the curvature, yaw rate over speed."""
    g, v, r = found.grid, found.first('speed'), found.first('yaw_rate')
    for c in (*found.by_role.get('steering', []), *found.by_role.get('road_angle', [])):
        text = TEXTS[c.role.what]
        if v is None or r is None or not (v.unit and r.unit):
            c.why.append(
                f'{text} by its name; {"the units of yaw rate and speed" if v and r else "yaw rate or speed"} to check '
                'it are missing'
            )
            continue
        speed = UNITS[v.unit][1] * (v.sign or 1) * g.of(v.name)
        moving = speed > MOVING * np.nanmax(speed)
        bend = np.full(speed.size, np.nan)
        bend[moving] = UNITS[r.unit][1] * g.of(r.name)[moving] / speed[moving]
        fit = g.fit(bend, g.of(c.name))
        if abs(fit.correlation) < CORRELATION:
            c.why.append(f'{text} by its name, but {r.name} over {v.name} does not follow it ({fit.text})')
            continue
        found.signs[c.name] = 1 if fit.factor > 0 else -1
        found.signs.setdefault(r.name, 1)
        c.why.append(
            f'{r.name} over {v.name} follows it: {abs(fit.factor):.3g} for a curvature of 1/m, correlation '
            f'{abs(fit.correlation):.3f}'
        )
        fits = _angles(found, c, abs(fit.factor), _big(found, v))
        sure = c.stated or c.role.unit or (c.role.what == 'road_angle' and c.role.corner)
        if len(fits) == 1 and (sure or _is_no_share(*next(iter(fits)), abs(fit.factor))):
            (unit, where), size = next(iter(fits.items()))
            c.unit = unit
            c.why.append(f'an angle of the {where} in {unit}, {size}')
            if where == 'road wheels' and c.role.what == 'steering':
                found.chosen.discard(c.name)
        else:
            left = (
                ' or '.join(f'{u} of the {where} ({size})' for (u, where), size in fits.items())
                or 'no angle of a car of any size'
            )
            c.why.append(
                f'its unit is not told: {left}' + ('' if c.stated or c.role.unit else ', or a share of the lock')
            )


def _is_no_share(unit: str, where: str, factor: float) -> bool:
    """True where steering without a stated unit is an angle of the steering wheel: a share of the lock, of 1 or 100, is
    less."""
    return where == 'steering wheel' and factor * UNITS[unit][1] > SHARE_MOST


def _angles(found: Looking, c: Column, factor: float, big: bool) -> dict[tuple[str, str], str]:
    """(unit, place) -> the size of the car for which the angle per curvature is right."""
    low, high = WHEELBASES[big]
    fits: dict[tuple[str, str], str] = {}
    largest = float(np.nanmax(np.abs(found.grid.values[c.name])))
    for unit in found.options(c):
        base = factor * UNITS[unit][1]
        if not c.role.hand and low <= base <= high and largest * UNITS[unit][1] < 1.5:
            fits[unit, 'road wheels'] = f'wheelbase and understeer {base:.3g} m'
        if (
            c.role.what == 'steering'
            and low * RATIOS[0] <= base <= high * RATIOS[1]
            and largest * UNITS[unit][1] < 20.0
        ):
            fits[unit, 'steering wheel'] = f'wheelbase and understeer times ratio {base:.3g} m'
    return fits


def sides(found: Looking, ours: bool) -> None:
    """To which side the lateral columns are positive."""
    g = found.grid
    road = {c.role.corner: c for c in found.by_role.get('road_angle', []) if c.name in found.signs}
    if not found.side and 'front_left' in road and 'front_right' in road:
        left, right = g.of(road['front_left'].name), g.of(road['front_right'].name)
        more = np.abs(left) - np.abs(right)
        sure = np.abs(left + right) > np.nanmax(np.abs(left + right)) / 2.0
        turn = np.sign(left + right) * np.sign(more)
        share = float(np.nanmean(turn[sure])) if sure.any() else 0.0
        if abs(share) > 0.9:
            sign = (1 if share > 0 else -1) * found.signs[road['front_left'].name]
            _anchor(
                found,
                sign,
                f'the inner wheel is steered more ({road["front_left"].name} and {road["front_right"].name})',
            )
    az = found.first('az')
    if az is not None:
        mean = float(np.nanmean(g.values[az.name]))
        fits = [u for u in found.options(az) if abs(abs(mean) * UNITS[u][1] / UNITS['g'][1] - 1.0) < 0.1]
        if len(fits) == 1:
            az.unit, az.sign = fits[0], 1 if mean > 0 else -1
            az.why.append(f'its mean is {mean:.4g}, the acceleration of gravity in {fits[0]}')
            if not found.side:
                _anchor(
                    found,
                    az.sign,
                    f'{az.name} says that z is {"up" if mean > 0 else "down"}, and axes are right-handed',
                )
        else:
            az.why.append(f'vertical acceleration by its name, but its mean, {mean:.4g}, is not that of gravity')
    if ours and not found.side:
        _anchor(found, 1, 'it is a recording of this program')
    for name, sign in found.signs.items():
        c = next(c for group in found.by_role.values() for c in group if c.name == name)
        c.sign = sign * found.left
    for group in found.by_role.values():
        for c in group:
            if not c.why and not c.against:
                c.why.append(f'{TEXTS[c.role.what]} by its name; nothing to check it against')


def _anchor(found: Looking, sign: int, why: str) -> None:
    """Note the evidence that tells left from right. sign: the one that makes the column of the yaw rate positive to the
    left."""
    if not found.side:
        found.left, found.side = sign, why
    elif found.left != sign:
        found.notes.append(f'{why}, which speaks for the other side than: {found.side}')
