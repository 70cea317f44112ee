"""Range in which the forces and moments of slip of a tire mean something: friction, stiffness, relaxation, combined
slip, camber, moments.

Rules of tire_limits.py; equation numbers: see magic_formula.py.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from solver.elements.upright_law import LOADS, WIDE, Finding, UprightLaw, argument, small_tire

# [m] least relaxation length, of small tires less: a tenth makes steps of 1 ms too long, ten times is that of a car
SHORTEST = 0.03
ICE = 0.2  # friction of no tire on a road, however wet; ice is road.friction, and at 0.02 a car hardly stands
LEAN = math.radians(5.0)  # camber of a car in use, where the law must hold; up to CAMMAX what changes its sign is told
SLIPS = np.array([0.1, 0.2, 0.5, 1.0, 2.0, 5.0])  # tan(alpha), or |kappa|, up to the bound of slip
RELAXATION = {'x': ('LONGITUDINAL_STIFFNESS', 'PCFX', 'PTX1'), 'y': ('LATERAL_STIFFNESS', 'PCFY', 'PTY1')}


def force(law: UprightLaw, axis: str) -> Iterator[Finding]:
    """Friction, slip stiffness and shape of the curve of one direction."""
    d, A = law.data, axis.upper()
    stated = LOADS[(d['FZMAX'] or np.inf) >= LOADS * law.F0]
    loads = stated if len(stated) else np.array([1.0])
    wide = np.linspace(loads[-1], law.top / law.F0, 37) if law.top > loads[-1] * law.F0 else loads
    lean = law.camber(LEAN), law.camber(law.lean)
    shown = ', '.join(f'PD{A}{k} = {d[f"PD{A}{k}"]:g}' for k in (2, 3))
    names = {
        f'PD{A}1': f'with {shown}'
        + f', PP{A}3 = {d[f"PP{A}3"]:g}, PP{A}4 = {d[f"PP{A}4"]:g} at this pressure (INFLPRES, NOMPRES)'
        * (law.dpi != 0.0)
    }
    if axis == 'x':
        names['PKX1'] = f'with PKX2 = {d["PKX2"]:g}, PKX3 = {d["PKX3"]:g}'
        names['PKX1'] += f', PPX1 = {d["PPX1"]:g}, PPX2 = {d["PPX2"]:g} at this pressure (INFLPRES, NOMPRES)' * (
            law.dpi != 0.0
        )
        scales = f'LFZO = {d["LFZO"]:g}'
        slopes = {'PDX3': 1.0 - d['PDX3'] * np.square(lean)}
    else:
        names['PKY4'] = f'with PKY2 = {d["PKY2"]:g}'
        scales = f'LFZO = {d["LFZO"]:g}'
        bent = d['PKY2'] + d['PKY5'] * np.square(lean)
        slopes = {'PDY3': 1.0 - d['PDY3'] * np.square(lean), 'PKY3': 1.0 - d['PKY3'] * np.array(lean), 'PKY5': bent}
    for (key, name), function, what in zip(
        names.items(), (law.friction, law.stiffness), ('friction', 'slip stiffness'), strict=True
    ):
        inside, outside = function(axis, loads), function(axis, wide)
        sign = 1.0 if key != 'PDY1' or d[key] > 0.0 else -1.0
        for values, at, refused in ((inside, loads, True), (outside, wide, False)):
            bad = np.flatnonzero(~(np.isfinite(values) & (sign * values > 0.0)))
            if len(bad):
                where = f'at a load of {at[bad[0]] * law.F0:.4g} N ({at[bad[0]]:.3g} FNOMIN)'
                limit = f', FZMAX = {d["FZMAX"]:g}' if d['FZMAX'] > 0.0 else ''
                yield Finding(
                    key, refused, f'{name}, {scales}{limit} the {what} along {axis} ends or turns around {where}'
                )
                if refused:
                    return
                break
    for key, (small, large) in slopes.items():
        what = 'friction' if key[1] == 'D' else 'cornering stiffness'
        for factor, angle, refused in ((small, LEAN, True), (large, law.lean, False)):
            if factor <= 0.0:
                limits = '' if refused else f' (CAMMIN = {d["CAMMIN"]:g}, CAMMAX = {d["CAMMAX"]:g})'
                yield Finding(
                    key,
                    refused,
                    f'the {what} along {axis} ends below a camber of {math.degrees(angle):.3g} deg{limits}',
                )
                break
    if axis == 'y' and d['PDY1'] < 0.0:
        yield Finding('PDY1', False, 'negative: taken with the sign of PKY1 the curve is that of a positive friction')
    yield from _shape(law, axis)


def _shape(law: UprightLaw, axis: str) -> Iterator[Finding]:
    d, A = law.data, axis.upper()
    one = np.array([1.0])
    mu, K = abs(float(law.friction(axis, one)[0])), float(law.stiffness(axis, one)[0])
    C = d[f'PC{A}1'] * d[f'LC{A}']
    key, scale, level = f'PC{A}1', f'LC{A}', f'PD{A}1 = {d[f"PD{A}1"]:g}, LMU{A} = {d[f"LMU{A}"]:g}'
    if C >= 2.0:
        yield Finding(
            key,
            True,
            f'with {scale} = {d[scale]:g} the shape factor must be below 2: the force of a sliding tire would drive it',
        )
        return
    if C < 0.6:
        text = (
            f'with {scale} = {d[scale]:g} the force reaches {100.0 * math.sin(C * math.pi / 2.0):.2g} % of the '
            'friction only'
        )
        yield Finding(key, False, text)
    if not ICE <= mu <= 4.0:
        yield Finding(f'PD{A}1', False, f'with LMU{A} = {d[f"LMU{A}"]:g} the friction along {axis} is {mu:.3g}')
    steep = K / mu
    stiff = f'PK{A}1'
    if not steep < 2000.0:
        yield Finding(
            stiff, True, f'with {level} the slip stiffness is {steep:.4g} times the friction: it must be below 2000'
        )
    elif not 3.0 <= steep <= 120.0:
        yield Finding(stiff, False, f'with {level} the slip stiffness along {axis} is {steep:.3g} times the friction')
    swing = law.stiffness(axis, WIDE)
    if swing.max() > 50.0 * swing.min() > 0.0:
        names = (
            f'PKX2 = {d["PKX2"]:g}, PKX3 = {d["PKX3"]:g}'
            if axis == 'x'
            else f'PKY2 = {d["PKY2"]:g}, PKY4 = {d["PKY4"]:g}'
        )
        yield Finding(
            stiff,
            False,
            f'with {names} the slip stiffness over the load changes by more than 50 times between 0.2 and 2 FNOMIN',
        )
    forward, back = law.curve(axis, SLIPS), law.curve(axis, -SLIPS)
    zero = float(law.curve(axis, np.array([0.0]))[0]) / mu
    names = f'PH{A}2, PV{A}1 = {d[f"PV{A}1"]:g}, PV{A}2, LH{A}, LV{A}, PE{A}1 to PE{A}4, LFZO'
    if not (np.all(forward[:4] > 0.0) and np.all(back[:4] < 0.0)):
        yield Finding(
            f'PH{A}1', True, f'with {names} the force along {axis} does not turn around with the slip at FNOMIN'
        )
    elif abs(zero) > 0.1:
        text = f'with {names} the tire pulls along {axis} with {100.0 * abs(zero):.3g} % of the friction without slip'
        yield Finding(f'PH{A}1', False, text)
    elif min(forward[3], -back[3]) < 0.2 * mu:
        text = (
            f'with {names}, PC{A}1 = {d[f"PC{A}1"]:g} the force along {axis} falls to a fifth of the friction at a '
            'slip of 1'
        )
        yield Finding(f'PE{A}1', False, text)


def relaxation(law: UprightLaw, axis: str) -> Iterator[Finding]:
    """Relaxation lengths ([B] 17 to 19), or those of 5.2."""
    d, R0, F0 = law.data, law.R0, law.F0
    carcass, bend, table = RELAXATION[axis]
    dfz, K = law.dfz(WIDE), law.stiffness(axis, WIDE) * WIDE * F0
    if law.new and d[carcass] > 0.0:
        by_load = (1.0 + d[bend + '1'] * dfz + d[bend + '2'] * dfz * dfz) * (1.0 + d[bend + '3'] * law.dpi)
        if not np.all(by_load > 0.0):
            first = WIDE[np.flatnonzero(by_load <= 0.0)[0]]
            text = (
                f'with {bend}2 = {d[bend + "2"]:g}, {bend}3 = {d[bend + "3"]:g} the stiffness of the carcass ends '
                f'at {first:.3g} FNOMIN'
            )
            yield Finding(bend + '1', bool(first <= LOADS[-1]), f'{text} (FZMAX, LFZO)')
            return
        sigma, key, more = (
            K / (by_load * d[carcass]),
            carcass,
            f'with {bend}1 = {d[bend + "1"]:g}, {bend}2 = {d[bend + "2"]:g}, LFZO = {d["LFZO"]:g} ',
        )
    elif axis == 'x':
        with np.errstate(over='ignore'):
            sigma = WIDE * (d['PTX1'] + d['PTX2'] * dfz) * np.exp(-d['PTX3'] * dfz) * (R0 * d['LSGKP'])
        key, more = (
            table,
            f'with PTX2 = {d["PTX2"]:g}, PTX3 = {d["PTX3"]:g}, LSGKP = {d["LSGKP"]:g}, LFZO = {d["LFZO"]:g} ',
        )
    elif d['PTY2'] > 0.0:
        sigma = np.sin(2.0 * np.arctan(WIDE / (d['PTY2'] * d['LFZO']))) * (d['PTY1'] * R0 * d['LFZO'] * d['LSGAL'])
        key, more = table, f'with PTY2 = {d["PTY2"]:g}, LSGAL = {d["LSGAL"]:g}, LFZO = {d["LFZO"]:g} '
    else:
        return  # refused by TireData
    nominal = float(np.interp(1.0, WIDE, sigma))
    if not (np.all(np.isfinite(sigma)) and sigma.max() < 100.0 * R0):
        yield Finding(key, True, f'{more}a relaxation length along {axis} of {sigma.max():.3g} m cannot be')
    elif nominal > 5.0 * R0 or sigma.max() > 10.0 * R0:
        yield Finding(
            key,
            False,
            f'{more}the relaxation length along {axis} grows to {sigma.max() / R0:.3g} times UNLOADED_RADIUS',
        )
    elif nominal < (shortest := SHORTEST * small_tire(R0)):
        yield Finding(
            key,
            False,
            f'{more}the relaxation length along {axis} is {nominal:.3g} m at FNOMIN: held at {shortest:.3g} m',
        )


def combined(law: UprightLaw, axis: str) -> Iterator[Finding]:
    """Weight of combined slip (4.E53), (4.E59) and the side force of longitudinal slip (4.E66)."""
    d, A, scale = law.data, axis.upper(), {'x': 'LXAL', 'y': 'LYKA'}[axis]
    if not d.combines(axis):
        return  # told as such
    B, C = d[f'RB{A}1'] * d[scale], d[f'RC{A}1']
    slips = np.concatenate((-SLIPS[::-1], [0.0], SLIPS))
    keys = ('RBX1', 'RCX1', 'REX1', 'REX2', 'RHX1') if axis == 'x' else ('RBY1', 'RCY1', 'REY1', 'REY2', 'RHY1', 'RHY2')
    names = 'with ' + ', '.join(f'{key} = {d[key]:g}' for key in (*keys, scale))
    for dfz in law.dfz(np.array([0.5, 1.0, 2.0])):
        E = d[f'RE{A}1'] + d[f'RE{A}2'] * dfz
        shift = d['RHX1'] if axis == 'x' else d['RHY1'] + d['RHY2'] * dfz
        base = float(np.cos(argument(np.array(B * shift), C, E)))
        if base < 0.2:
            yield Finding(
                f'RH{A}1',
                True,
                f'{names} the weight of combined slip, by which forces are divided, is {base:.3g} without slip',
            )
            return
        weight = np.cos(argument(B * (slips + shift), C, E)) / base
        if weight.min() < -0.5 or weight.max() > 2.0:
            worst = weight.min() if weight.min() < -0.5 else weight.max()
            yield Finding(f'RC{A}1', True, f'{names} combined slip multiplies F{axis} by {worst:.3g}')
            return
        if weight.min() < -0.25 or weight.max() > 1.3:
            worst = weight.min() if weight.min() < -0.25 else weight.max()
            yield Finding(f'RC{A}1', False, f'{names} combined slip multiplies F{axis} by {worst:.3g}')
            break
        if min(weight[0], weight[-1]) > 0.7:
            text = f'{names} combined slip takes at most {100.0 * (1.0 - min(weight[0], weight[-1])):.2g} % of F{axis}'
            yield Finding(f'RC{A}1', False, text)
            break
    if axis == 'y':
        push = max(abs(d['RVY1'] + d['RVY2'] * dfz) for dfz in law.dfz(np.array([0.5, 1.0, 2.0]))) * abs(d['LVYKA'])
        names = (
            f'with RVY2 = {d["RVY2"]:g}, LVYKA = {d["LVYKA"]:g} longitudinal slip pushes to the side with up to '
            f'{push:.3g} of the friction'
        )
        if push > 2.0 and d['RVY5'] * d['RVY6'] != 0.0:
            yield Finding('RVY1', True, names)
        elif push > 0.5 and d['RVY5'] * d['RVY6'] != 0.0:
            yield Finding('RVY1', False, names)
        leaning = abs(d['RVY3'] * law.camber(LEAN) * d['LVYKA'])
        if leaning > 0.5 and d['RVY5'] * d['RVY6'] != 0.0:
            text = (
                f'longitudinal slip of a leaning tire pushes to the side with up to {leaning:.3g} of the friction '
                'at 5 deg'
            )
            yield Finding('RVY3', leaning > 2.0, text)


def camber(law: UprightLaw) -> Iterator[Finding]:
    d = law.data
    limit = max(abs(d['CAMMIN']), abs(d['CAMMAX']))
    key = 'CAMMAX' if abs(d['CAMMAX']) >= abs(d['CAMMIN']) else 'CAMMIN'
    if limit > math.pi / 2.0 + 0.01:
        yield Finding(key, False, f'{math.degrees(limit):.4g} deg is no camber: is [UNITS] ANGLE right?')
    elif 0.0 < limit < 0.02:
        yield Finding(key, False, f'camber is held within {math.degrees(limit):.2g} deg')
    if d['CAMMIN'] > d['CAMMAX'] != 0.0:
        yield Finding('CAMMIN', False, f'is above CAMMAX = {d["CAMMAX"]:g}')
    for load in (1.0, 2.0):
        at = np.array([load])
        dfz, K = float(law.dfz(at)[0]), float(law.stiffness('y', at)[0])
        side = d['PVY3'] + d['PVY4'] * dfz
        if law.new:  # (4.E27), (4.E30): the shift by SVyg cancels its force
            thrust = (d['PKY6'] + d['PKY7'] * dfz) * (1.0 + d['PPY5'] * law.dpi) * d['LKYC']
            key, names = 'PKY6', f'with PKY7 = {d["PKY7"]:g}, PPY5 = {d["PPY5"]:g}'
        else:
            thrust = side - K * d['PHY3']
            key, names = 'PHY3', f'with PVY3 = {d["PVY3"]:g}, PVY4 = {d["PVY4"]:g}'
        if thrust > 1e-9:
            yield Finding(key, False, f'{names} a leaning tire pushes against its lean at {load:g} FNOMIN')
            break
        if thrust < -6.0:
            yield Finding(
                key, False, f'{names} the camber stiffness is {-thrust:.3g} times the load at {load:g} FNOMIN'
            )
            break
    if law.new and abs(side) > 6.0:
        yield Finding(
            'PVY3',
            False,
            f'with PVY4 = {d["PVY4"]:g} camber shifts the curve by {abs(side):.3g} times the load per rad',
        )


def moments(law: UprightLaw) -> Iterator[Finding]:
    """Pneumatic trail and residual moment (4.E31) to (4.E49), overturning couple (4.E69), length of the contact
    patch."""
    d, R0 = law.data, law.R0
    dfz = law.dfz(WIDE)
    at = int(np.argmin(np.abs(WIDE - 1.0)))
    by_pressure = 1.0 - d['PPZ1'] * law.dpi
    trail = (d['QDZ1'] + d['QDZ2'] * dfz) * by_pressure * d['LTR'] * WIDE  # over the radius
    names = f'with QDZ2 = {d["QDZ2"]:g}, LTR = {d["LTR"]:g}' + f', PPZ1 = {d["PPZ1"]:g} at this pressure' * (
        law.dpi != 0.0
    )
    if np.all(trail == 0.0):
        yield Finding('QDZ1', False, f'{names} the tire has no pneumatic trail, so slip does not align it')
    elif trail.min() < 0.0:
        yield Finding(
            'QDZ1', False, f'{names} the pneumatic trail is negative at some load up to 2 FNOMIN: the tire turns out'
        )
    elif trail[at] > 0.5:
        yield Finding('QDZ1', False, f'{names} the pneumatic trail is {trail[at]:.3g} times UNLOADED_RADIUS')
    slope = (d['QBZ1'] + d['QBZ2'] * dfz + d['QBZ3'] * dfz * dfz) * d['LKY'] / d['LMUY']
    lean = np.array([-1.0, 1.0]) * min(law.camber(law.lean), 1.0)
    bent = 1.0 + d['QBZ4'] * lean + d['QBZ5'] * np.abs(lean)
    held = 1.0 + d['QDZ3'] * (np.abs(lean) if law.new else lean) + d['QDZ4'] * lean * lean
    if trail[at] != 0.0:
        names = f'with QBZ2 = {d["QBZ2"]:g}, QBZ3 = {d["QBZ3"]:g} the pneumatic trail'
        if slope.min() * slope.max() <= 0.0:
            yield Finding('QBZ1', False, f'{names} does not fall with the slip at some load up to 2 FNOMIN')
        elif not 1.0 <= abs(slope[at]) <= 60.0:
            yield Finding('QBZ1', False, f'{names} falls off with a slope of {abs(slope[at]):.3g} per rad')
        if not 0.3 <= abs(d['QCZ1']) < 1.7:
            yield Finding(
                'QCZ1', abs(d['QCZ1']) > 3.0, 'the pneumatic trail falls to cos(QCZ1 pi/2) of itself in sliding'
            )
        if bent.min() <= 0.0 or bent.max() > 5.0:
            yield Finding(
                'QBZ4',
                False,
                f'with QBZ5 = {d["QBZ5"]:g} the slope of the trail changes by {bent.min():.3g} to {bent.max():.3g} '
                'with camber',
            )
        if held.min() <= 0.0 or held.max() > 5.0:
            yield Finding(
                'QDZ3',
                False,
                f'with QDZ4 = {d["QDZ4"]:g} the trail changes by {held.min():.3g} to {held.max():.3g} times with '
                'camber',
            )
    rest = max(abs((d['QDZ6'] + d['QDZ7'] * x) * d['LRES'] * d['LMUY']) for x in dfz)
    if rest > 0.1:
        yield Finding(
            'QDZ6',
            False,
            f'with QDZ7 = {d["QDZ7"]:g} a residual moment of up to {rest:.3g} of load times radius without slip',
        )
    scale = d['LKZC'] if law.new else d['LGAZ']
    turn = max(abs((d['QDZ8'] + d['QDZ9'] * x) * (1.0 + d['PPZ2'] * law.dpi)) * LEAN for x in dfz) * scale
    turn = max(turn, max(abs(d['QDZ10'] + d['QDZ11'] * x) for x in dfz) * LEAN * LEAN * scale)
    if turn > 0.1:
        text = f'with QDZ9, QDZ10, QDZ11 camber of 5 deg turns the tire with {turn:.3g} of load times radius'
        yield Finding('QDZ8', False, text)
    over = (abs(d['QSX1'] * d['LVMX']) + abs(d['QSX2']) * LEAN + abs(d['QSX3'])) * R0 * d['LMX']
    if over > 0.5 * law.width:
        names = f'with QSX2 = {d["QSX2"]:g}, QSX3 = {d["QSX3"]:g}, LMX = {d["LMX"]:g}'
        yield Finding('QSX1', False, f'{names} the load moves {over:.3g} m sideways: held within the width')
    if abs(d['SSZ1'] * d['LS']) * R0 > 0.5 * law.width:
        yield Finding('SSZ1', False, 'the arm of Fx is held within the width')
    pressed = math.sqrt(law.F0 / (law.c_z * R0))
    length = d['Q_RA1'] * pressed + d['Q_RA2'] * pressed * pressed
    breadth = d['Q_RB1'] * pressed ** (2.0 / 3.0) + d['Q_RB2'] * pressed * pressed
    if any(k in d.values for k in ('Q_RA1', 'Q_RA2')) and not 0.03 < length < 1.0:
        text = (
            f'with Q_RA2 = {d["Q_RA2"]:g} half the contact patch of short obstacles is {length:.3g} times '
            'UNLOADED_RADIUS long'
        )
        yield Finding('Q_RA1', False, text)
    if any(k in d.values for k in ('Q_RB1', 'Q_RB2')) and not 0.1 < breadth < 1.0:
        text = (
            f'with Q_RB2 = {d["Q_RB2"]:g} half the contact patch of short obstacles is {breadth:.3g} times WIDTH wide'
        )
        yield Finding('Q_RB1', False, text)
