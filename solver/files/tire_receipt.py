"""What became of every key of a tire: used, ignored (why) or defaulted (value).

The receipt follows from the data alone, so that of a recording is that of the scene in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from solver.elements.tire_data import DEFAULT_WIDTH, DEFAULTS, PARKING_ENDS, TireData

Fate = Literal['used', 'ignored', 'defaulted']


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One key. value: of the file, or the one that is taken. why: why it is ignored, or what was made of it."""

    key: str
    fate: Fate
    value: float | str
    why: str = ''


TURN_SLIP = ('LMP', 'PDXP', 'PKYP', 'PDYP', 'PHYP', 'PECP', 'QDTP', 'QCRP', 'QBRP', 'QDRP')
OF_PARKING = ('LMP', 'PECP', 'QCRP1', 'QDRP')  # those of the moment against turning on the spot
PRESSURE = ('PPX1', 'PPX2', 'PPX3', 'PPX4', 'PPY1', 'PPY2', 'PPY3', 'PPY4', 'PPY5', 'PPZ1', 'PPZ2', 'PPMX1', 'PFZ1', 'QSY8', 'INFLPRES')
OF_61 = ('LKYC', 'LKZC', 'PKY6', 'PKY7', 'PPY5')
OF_52 = ('LGAX', 'LGAY', 'LGAZ', 'PHY3')
CARCASS = ('LONGITUDINAL_STIFFNESS', 'LATERAL_STIFFNESS', 'PCFX1', 'PCFX2', 'PCFX3', 'PCFY1', 'PCFY2', 'PCFY3')
BELT = 'the belt is not a body of its own: no belt dynamics'
LOAD = 'the load follows from the deflection alone, not from Fx, Fy and camber'
RANGE = 'range of the measurement: forces go on beyond it as the formula says'
PROGRAM = 'setting of another program'
REASONS = {  # by key, or by what keys begin with where there is a *
    **dict.fromkeys(('MASS', 'IXX', 'IYY', 'GRAVITY'), 'masses are those of the bodies of the model'),
    **dict.fromkeys(('BELT_*', 'FREQ_*', 'DAMP_*', 'YAW_STIFFNESS', 'Q_BVX', 'Q_BVT', 'PCMZ1'), BELT),
    **dict.fromkeys(('MBELT', 'QTZ1', 'LGYR'), 'no gyroscopic moment of the belt'),
    **dict.fromkeys(('Q_FCX', 'QFCX', 'Q_FCY', 'QFCY', 'Q_FCY2', 'Q_FZ3', 'QFZ3', 'QFCG', 'Q_CAM*', 'QCAM*', 'Q_FYS*', 'QFYS*'), LOAD),
    **dict.fromkeys(('MC_CONTOUR_*',), 'the tread is flat across: no round contour'),
    **dict.fromkeys(('DYNAMIC_STIFFNESS', 'DYNAMIC_DAMPING'), 'the vertical spring does not depend on frequency'),
    **dict.fromkeys(('Q_A1', 'Q_A2', 'QA*', 'ELLIPS_*'), 'the enveloping contact has its own rows and steps (road.contact)'),
    **dict.fromkeys(('KPUMIN', 'KPUMAX', 'ALPMIN', 'ALPMAX', 'FZMIN', 'PRESMIN', 'PRESMAX'), RANGE),
    **dict.fromkeys(('PTX4', 'PTY3', 'VXLOW'), 'standstill and low speed are those of the element (low_speed, standstill_damping)'),
    **dict.fromkeys(('ASPECT_RATIO', 'RIM_WIDTH', 'SHAPE/table'), 'measures that no equation of the model has'),
    **dict.fromkeys(('ENV_C1', 'ENV_C2'), 'the effective height and slope are not attenuated'),
    **dict.fromkeys(('BOTTOMING_RADIUS',), 'there is no BOTTOMING_CURVE'),
    **dict.fromkeys(('LKG',), 'no scale factor of the camber stiffness in 5.2'),
    **dict.fromkeys(('FE_METHOD',), 'combined slip by the coefficients RB*, RC*, not by a friction ellipse'),
    **dict.fromkeys(('USE_MODE', 'USER_SUB_ID', 'N_TIRE_STATES', 'HMAX_LOCAL', 'TIME_SWITCH_INTEG', 'LOCAL_SOLVER*', 'MESSAGES'), PROGRAM),
    **dict.fromkeys(('ROAD_*', 'CONTACT_MODEL', 'BELT_DYNAMICS', 'MFSAFE*', 'SWITCH_INTEG', 'TYPE', 'FUNCTION_NAME'), PROGRAM),
    **dict.fromkeys(('FILE_TYPE', 'FILE_VERSION', 'FILE_FORMAT', 'TIRE_VERSION', 'COMMENT*', 'GOODYEAR/*'), 'describes the file'),
}
CONSUMED = ('FITTYP', 'PROPERTY_FILE_FORMAT', 'TYRESIDE', 'LCZ', 'LIP', 'DEFLECTION_LOAD_CURVE/table', 'BOTTOMING_CURVE/table')


def receipt(data: TireData, *, turn_slip: bool | None = None) -> list[Entry]:
    """Every key that the file has or the model needs, in the order of the file. turn_slip: that of the tire (TireSpec)."""
    found: list[Entry] = []
    for key, value in data.values.items():
        why = _unread(data, key, turn_slip)
        if key == 'QSY7' and value == 0.0:
            found.append(Entry(key=key, fate='used', value=value, why='0 stands for not fitted and is taken as 1'))
            continue
        found.append(Entry(key=key, fate='ignored' if why else 'used', value=value, why=why or data.notes.get(key, '')))
    for place, kept in data.extra.items():
        key = place.rpartition('/')[2]
        used = key in CONSUMED or place in CONSUMED
        if used or (key == 'BOTTOMING_RADIUS' and 'BOTTOMING_CURVE/table' in data.extra):
            found.append(
                Entry(key=place, fate='used', value=kept, why=data.notes.get(key if key != 'table' else place.rpartition('/')[0], ''))
            )
        else:
            found.append(Entry(key=place, fate='ignored', value=kept, why=_reason(place)))
    if 'TYRESIDE' in data.notes and not any(place.endswith('/TYRESIDE') for place in data.extra):
        found.append(Entry(key='TYRESIDE', fate='defaulted', value='LEFT'))
    for key, default in DEFAULTS.items():
        if key not in data.values and default is not None and not _unread(data, key, turn_slip):
            taken, why = _in_place_of(data, key, default)
            found.append(Entry(key=key, fate='defaulted', value=taken, why=why or data.notes.get(key, '')))
    return found


def turn_slip_of(data: TireData, turn_slip: bool | None) -> str:
    """What of turn slip acts at a tire, in a word, and why nothing does. turn_slip: that of the tire (TireSpec)."""
    if turn_slip is not None:
        return 'acts' if turn_slip else 'off'
    lacking = data.lacks_turn_slip()
    return f'none: {lacking}' if lacking else f'against parking alone, below {PARKING_ENDS:g} m/s'


def warnings(data: TireData) -> list[str]:
    """What is not as the file would have it and can be felt, as sentences."""
    said = [f'{key}: {text}' for key, text in data.notes.items() if 'given twice' in text or 'no relaxation length' in text]
    for names, direction in ((('RBX1', 'RBX2'), 'Fx'), (('RBY1', 'RBY2'), 'Fy')):
        if not any(data[name] for name in names):
            said.append(f'{names[0]}: the file has no combined slip of {direction}, which is that of pure slip then')
    for key in ('Q_FCX', 'QFCX', 'Q_FCY', 'QFCY'):
        value = next((v for place, v in data.extra.items() if place.endswith('/' + key)), 0.0)
        if isinstance(value, float) and value != 0.0:
            axis = 'Fx' if key.endswith('X') else 'Fy'
            said.append(f'{key} = {value:g}: ignored; the load would be {100.0 * value * value:.2g} % smaller at {axis} = FNOMIN')
    return said


def _in_place_of(data: TireData, key: str, default: float) -> tuple[float, str]:
    """What is taken where a key is missing."""
    if key == 'Q_FZ1':
        return default, 'from VERTICAL_STIFFNESS and Q_FZ2'
    if key == 'WIDTH':
        return DEFAULT_WIDTH * data['UNLOADED_RADIUS'], ''
    if key in ('CAMMIN', 'CAMMAX'):
        return default, '15 degrees'
    if key == 'FZMAX':
        return default, 'no limit'
    return default, ''


def _unread(data: TireData, key: str, turn_slip: bool | None) -> str:
    """Why the equations of this tire do not read a coefficient; '' where they do."""
    if key.startswith(TURN_SLIP):
        if turn_slip is None and not data.lacks_turn_slip():
            return '' if key.startswith(OF_PARKING) else 'of turn slip only the moment against turning on the spot acts'
        return '' if turn_slip and data.version == 61 else 'turn slip does not act'
    if key in (OF_52 if data.version == 61 else OF_61):
        return f'not in the equations of {"6.1" if data.version == 61 else "5.2"}'
    if key in CARCASS and data.version == 52:
        return 'the relaxation lengths of 5.2 are those of PTX and PTY'
    if key in ('PTX1', 'PTX2', 'PTX3', 'LSGKP') and data.version == 61 and data['LONGITUDINAL_STIFFNESS'] > 0.0:
        return 'the relaxation length follows from LONGITUDINAL_STIFFNESS'
    if key in ('PTY1', 'PTY2', 'LSGAL') and data.version == 61 and data['LATERAL_STIFFNESS'] > 0.0:
        return 'the relaxation length follows from LATERAL_STIFFNESS'
    if key in (*PRESSURE, 'PCFX3', 'PCFY3') and not data['NOMPRES'] > 0.0:
        return 'no NOMPRES: pressure has no effect'
    if key in ('BOTTOM_OFFST', 'RIM_RADIUS') and not data['BOTTOM_STIFF'] > 0.0:
        return 'no BOTTOM_STIFF: the rim does not touch'
    return ''


def _reason(place: str) -> str:
    """Why a key that is no coefficient is ignored."""
    key = place.rpartition('/')[2]
    for pattern, why in REASONS.items():
        begins = pattern.removesuffix('*')
        if place.startswith(begins) if '/' in pattern else (key.startswith(begins) if pattern.endswith('*') else key == pattern):
            return why
    return 'not known to this model'
