"""Receipt of a tire file, the use of every key: used, ignored (why) or defaulted (value).

The receipt follows from the data alone, so that of a recording is that of the scene in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from solver.elements.tire_data import DEFAULT_WIDTH, DEFAULTS, OF_PRESSURE, PARKING_ENDS, TireData
from solver.elements.tire_limits import oddities

if TYPE_CHECKING:
    from solver.elements.tire_pacejka import TireSpec

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
    **dict.fromkeys(
        ('Q_FCX', 'QFCX', 'Q_FCY', 'QFCY', 'Q_FCY2', 'Q_FZ3', 'QFZ3', 'QFCG', 'Q_CAM*', 'QCAM*', 'Q_FYS*', 'QFYS*'),
        LOAD,
    ),
    **dict.fromkeys(('MC_CONTOUR_*',), 'the tread is flat across: no round contour'),
    **dict.fromkeys(('DYNAMIC_STIFFNESS', 'DYNAMIC_DAMPING'), 'the vertical spring does not depend on frequency'),
    **dict.fromkeys(
        ('Q_A1', 'Q_A2', 'QA*', 'ELLIPS_*'), 'the enveloping contact has its own rows and steps (road.contact)'
    ),
    **dict.fromkeys(('KPUMIN', 'KPUMAX', 'ALPMIN', 'ALPMAX', 'FZMIN', 'PRESMIN', 'PRESMAX'), RANGE),
    **dict.fromkeys(
        ('PTX4', 'PTY3', 'VXLOW'), 'standstill and low speed are those of the element (low_speed, standstill_damping)'
    ),
    **dict.fromkeys(('ASPECT_RATIO', 'RIM_WIDTH', 'SHAPE/table'), 'measures that no equation of the model has'),
    **dict.fromkeys(('ENV_C1', 'ENV_C2'), 'the effective height and slope are not attenuated'),
    **dict.fromkeys(('BOTTOMING_RADIUS',), 'there is no BOTTOMING_CURVE'),
    **dict.fromkeys(('LKG',), 'no scale factor of the camber stiffness in 5.2'),
    **dict.fromkeys(('FE_METHOD',), 'combined slip by the coefficients RB*, RC*, not by a friction ellipse'),
    **dict.fromkeys(('line *',), 'no KEY = value, row or section: passed over as a comment'),
    **dict.fromkeys(
        ('USE_MODE', 'USER_SUB_ID', 'N_TIRE_STATES', 'HMAX_LOCAL', 'TIME_SWITCH_INTEG', 'LOCAL_SOLVER*', 'MESSAGES'),
        PROGRAM,
    ),
    **dict.fromkeys(
        ('ROAD_*', 'CONTACT_MODEL', 'BELT_DYNAMICS', 'MFSAFE*', 'SWITCH_INTEG', 'TYPE', 'FUNCTION_NAME'), PROGRAM
    ),
    **dict.fromkeys(
        ('FILE_TYPE', 'FILE_VERSION', 'FILE_FORMAT', 'TIRE_VERSION', 'COMMENT*', 'GOODYEAR/*'), 'describes the file'
    ),
}
CONSUMED = (
    'FITTYP',
    'PROPERTY_FILE_FORMAT',
    'TYRESIDE',
    'LCZ',
    'LIP',
    'DEFLECTION_LOAD_CURVE/table',
    'BOTTOMING_CURVE/table',
)


def receipt(data: TireData, *, turn_slip: bool | None = None) -> list[Entry]:
    """Every key that the file has or the model needs, in the order of the file. turn_slip: that of the tire
    (TireSpec)."""
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
                Entry(
                    key=place,
                    fate='used',
                    value=kept,
                    why=data.notes.get(key if key != 'table' else place.rpartition('/')[0], ''),
                )
            )
        else:
            found.append(
                Entry(key=place, fate='ignored', value=kept, why=data.notes[key] if key in DEFAULTS else _reason(place))
            )
    if 'TYRESIDE' in data.notes and not any(place.endswith('/TYRESIDE') for place in data.extra):
        found.append(Entry(key='TYRESIDE', fate='defaulted', value='LEFT'))
    foreign = {place.rpartition('/')[2] for place in data.extra}
    for key, default in DEFAULTS.items():
        if key not in data.values and key not in foreign and default is not None and not _unread(data, key, turn_slip):
            taken, why = _in_place_of(data, key, default)
            found.append(Entry(key=key, fate='defaulted', value=taken, why=why or data.notes.get(key, '')))
    return found


def turn_slip_of(data: TireData, turn_slip: bool | None) -> str:
    """Effect of turn slip at a tire in a word, and the reason where it has none. turn_slip: that of the tire
    (TireSpec)."""
    if turn_slip is not None:
        return 'acts' if turn_slip else 'off'
    lacking = data.lacks_turn_slip()
    return f'none: {lacking}' if lacking else f'against parking alone, below {PARKING_ENDS:g} m/s'


# USE_MODE, last digit
MODES = {0: 'the load alone', 1: 'Fx and My alone', 2: 'Fy, Mx and Mz alone', 3: 'forces without combined slip'}


def warnings(data: TireData, pressure: float | None = None) -> list[str]:
    """Sentences on data that are used otherwise than the file has them, or are odd, where it can be felt. pressure: of
    the tire, None for that of the data."""
    said = [f'{key}: {text}' for key, text in data.notes.items() if 'given twice' in text]
    for reason, keys in _grouped(data, ('no relaxation length', 'no longitudinal force', 'no side force')).items():
        said.append(f'{", ".join(keys)}: {reason}')
    said += _of_other_versions(data)
    lines = [place.rpartition('/line ')[2] for place in data.extra if '/line ' in place]
    if lines:
        count = f'{len(lines)} lines' if len(lines) > 1 else 'a line'
        said.append(f'{count} without data passed over as a comment: {", ".join(lines)}')
    said += _of_mode(data)
    for axis, name in (('x', 'RBX1'), ('y', 'RBY1')):
        if not data.combines(axis):
            said.append(f'{name}: the file has no combined slip of F{axis}, which is that of pure slip then')
    for key in ('Q_FCX', 'QFCX', 'Q_FCY', 'QFCY'):
        value = next((v for place, v in data.extra.items() if place.endswith('/' + key)), 0.0)
        if isinstance(value, float) and value != 0.0:
            axis = 'Fx' if key.endswith('X') else 'Fy'
            said.append(
                f'{key} = {value:g}: ignored; the load would be {100.0 * value * value:.2g} % smaller at {axis} = '
                'FNOMIN'
            )
    return said + oddities(data, pressure)


def _grouped(data: TireData, reasons: tuple[str, ...]) -> dict[str, list[str]]:
    """Keys by the note that they share."""
    found: dict[str, list[str]] = {}
    for key, text in data.notes.items():
        if any(reason in text for reason in reasons):
            found.setdefault(text, []).append(key)
    return found


def _of_other_versions(data: TireData) -> list[str]:
    """Coefficients that the stated version does not have and that would do something in the one they are of."""
    kept = {place.rpartition('/')[2]: value for place, value in data.extra.items()}
    foreign: dict[str, list[str]] = {}
    for key in DEFAULTS:
        if (
            key in kept
            and kept[key] not in (DEFAULTS[key], 0.0, '')
            and 'not in the equations' in data.notes.get(key, '')
        ):
            foreign.setdefault(data.notes[key], []).append(key)
    names = OF_52 if data.version == 61 else ()
    foreign['not in the equations of 6.1'] = [
        key for key in names if key in data.values and data.values[key] != DEFAULTS[key]
    ]
    return [f'{", ".join(keys)}: ignored, {reason}' for reason, keys in foreign.items() if keys]


def _of_mode(data: TireData) -> list[str]:
    """Sentences on requests of USE_MODE that this model handles otherwise."""
    mode = next((value for place, value in data.extra.items() if place == 'MODEL/USE_MODE'), 4.0)
    if not isinstance(mode, float) or not mode.is_integer():
        return []
    said = []
    if abs(int(mode)) % 10 in MODES:
        said.append(
            f'USE_MODE = {mode:g}: ignored; it asks for {MODES[abs(int(mode)) % 10]}, and all forces act, with '
            'combined slip'
        )
    if mode < 0.0:
        said.append(
            f'USE_MODE = {mode:g}: ignored; it asks for mirrored data, and tires are mirrored by the side of the '
            'vehicle'
        )
    return said


def _in_place_of(data: TireData, key: str, default: float) -> tuple[float, str]:
    """Value that is taken where a key is missing, and its origin."""
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
    if key in (*OF_PRESSURE, 'PCFX3', 'PCFY3') and not data['NOMPRES'] > 0.0:
        return 'no NOMPRES: pressure has no effect'
    if key in ('BOTTOM_OFFST', 'RIM_RADIUS') and not data['BOTTOM_STIFF'] > 0.0:
        return 'no BOTTOM_STIFF: the rim does not touch'
    return ''


def _reason(place: str) -> str:
    """Why a key that is no coefficient is ignored."""
    key = place.rpartition('/')[2]
    for pattern, why in REASONS.items():
        begins = pattern.removesuffix('*')
        if (
            place.startswith(begins)
            if '/' in pattern
            else (key.startswith(begins) if pattern.endswith('*') else key == pattern)
        ):
            return why
    return 'not known to this model'


def told_of_tires(tires: Sequence[TireSpec]) -> list[str]:
    """warnings() of every tire file of a model once, each with the name of the file."""
    distinct = {(tire.data.source or tire.data.name, tire.pressure): tire for tire in tires}
    return [
        f'{name}: {sentence}' for (name, _), tire in distinct.items() for sentence in warnings(tire.data, tire.pressure)
    ]
