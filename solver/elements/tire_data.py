"""The data of a tire: Magic Formula coefficients by name, their defaults, and the row of numbers that compiled code
reads.

Equation numbers: see magic_formula.py. One row of coefficients is a flat array; `I.PCX1` is the place of PCX1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import partial
from types import MappingProxyType, ModuleType
from typing import Literal

import numpy as np

from solver.elements.tire_limits import check
from solver.elements.upright_law import small_tire
from solver.errors import SpecError, suggestion
from solver.validate import finite, require

# What a coefficient is when the file does not have it; None: the file must have it.
DEFAULTS: dict[str, float | None] = {
    **dict.fromkeys(('FNOMIN', 'UNLOADED_RADIUS', 'VERTICAL_STIFFNESS'), None),
    **{'LONGVL': 16.7, 'NOMPRES': 0.0, 'INFLPRES': 0.0, 'RIM_RADIUS': 0.0, 'WIDTH': 0.0},
    **{'VERTICAL_DAMPING': 50.0, 'BREFF': 8.4, 'DREFF': 0.27, 'FREFF': 0.07, 'BOTTOM_OFFST': 0.0, 'BOTTOM_STIFF': 0.0},
    **{'Q_RE0': 1.0, 'Q_V1': 0.0, 'Q_V2': 0.0, 'Q_FZ1': 0.0, 'Q_FZ2': 0.0, 'PFZ1': 0.0},
    **{'FZMAX': 0.0, 'CAMMIN': 0.0, 'CAMMAX': 0.0},
    **{'LONGITUDINAL_STIFFNESS': 0.0, 'LATERAL_STIFFNESS': 0.0},
    **dict.fromkeys(('PCFX1', 'PCFX2', 'PCFX3', 'PCFY1', 'PCFY2', 'PCFY3'), 0.0),
    **dict.fromkeys(('PTX1', 'PTX2', 'PTX3', 'PTY1', 'PTY2'), 0.0),
    **dict.fromkeys(
        ('LFZO', 'LCX', 'LMUX', 'LEX', 'LKX', 'LHX', 'LVX', 'LCY', 'LMUY', 'LEY', 'LKY', 'LHY', 'LVY', 'LKYC', 'LKZC'),
        1.0,
    ),
    **dict.fromkeys(
        ('LGAX', 'LGAY', 'LGAZ', 'LTR', 'LRES', 'LXAL', 'LYKA', 'LVYKA', 'LS', 'LMX', 'LVMX', 'LMY', 'LSGKP', 'LSGAL'),
        1.0,
    ),
    **dict.fromkeys(('PCX1', 'PDX1', 'PKX1'), None),
    **dict.fromkeys(
        ('PDX2', 'PDX3', 'PEX1', 'PEX2', 'PEX3', 'PEX4', 'PKX2', 'PKX3', 'PHX1', 'PHX2', 'PVX1', 'PVX2'), 0.0
    ),
    **dict.fromkeys(('PPX1', 'PPX2', 'PPX3', 'PPX4', 'RBX1', 'RBX2', 'RBX3', 'RCX1', 'REX1', 'REX2', 'RHX1'), 0.0),
    **dict.fromkeys(('PCY1', 'PDY1', 'PKY1', 'PKY2'), None),
    **dict.fromkeys(('PDY2', 'PDY3', 'PEY1', 'PEY2', 'PEY3', 'PEY4', 'PEY5', 'PKY3', 'PKY5', 'PKY6', 'PKY7'), 0.0),
    **dict.fromkeys(
        ('PHY1', 'PHY2', 'PHY3', 'PVY1', 'PVY2', 'PVY3', 'PVY4', 'PPY1', 'PPY2', 'PPY3', 'PPY4', 'PPY5'), 0.0
    ),
    **{'PKY4': 2.0},
    **dict.fromkeys(('RBY1', 'RBY2', 'RBY3', 'RBY4', 'RCY1', 'REY1', 'REY2', 'RHY1', 'RHY2'), 0.0),
    **dict.fromkeys(('RVY1', 'RVY2', 'RVY3', 'RVY4', 'RVY5', 'RVY6'), 0.0),
    **dict.fromkeys(tuple(f'QSX{k}' for k in range(1, 15)), 0.0),
    **{'PPMX1': 0.0},
    **dict.fromkeys(('QSY1', 'QSY2', 'QSY3', 'QSY4', 'QSY5', 'QSY6', 'QSY8'), 0.0),
    **{'QSY7': 1.0},
    **dict.fromkeys(('QBZ1', 'QBZ2', 'QBZ3', 'QBZ4', 'QBZ5', 'QBZ9', 'QBZ10', 'QCZ1'), 0.0),
    **dict.fromkeys(('QDZ1', 'QDZ2', 'QDZ3', 'QDZ4', 'QDZ6', 'QDZ7', 'QDZ8', 'QDZ9', 'QDZ10', 'QDZ11'), 0.0),
    **dict.fromkeys(('QEZ1', 'QEZ2', 'QEZ3', 'QEZ4', 'QEZ5', 'QHZ1', 'QHZ2', 'QHZ3', 'QHZ4', 'PPZ1', 'PPZ2'), 0.0),
    **dict.fromkeys(('SSZ1', 'SSZ2', 'SSZ3', 'SSZ4'), 0.0),
    # enveloping of short obstacles ([Schmeitz2004]): the values of the sample file of MF-Tyre 6.1, lengths over
    # UNLOADED_RADIUS
    **{'ELLIPS_SHIFT': 0.8, 'ELLIPS_LENGTH': 1.0, 'ELLIPS_HEIGHT': 1.0, 'ELLIPS_ORDER': 1.8},
    **{'Q_RA1': 0.60147, 'Q_RA2': 0.81974, 'Q_RB1': 1.2648, 'Q_RB2': -1.4057},
    # turn slip, all of it used when TireSpec.turn_slip asks for it: the values that files without measurements of it
    # commonly have
    **{
        'LMP': 1.0,
        'PDXP1': 0.4,
        'PDXP2': 0.0,
        'PDXP3': 0.0,
        'PKYP1': 1.0,
        'PDYP1': 0.4,
        'PDYP2': 0.0,
        'PDYP3': 0.0,
        'PDYP4': 0.0,
    },
    **{'PHYP1': 1.0, 'PHYP2': 0.15, 'PHYP3': 0.0, 'PHYP4': -4.0, 'PECP1': 0.5, 'PECP2': 0.0, 'QDTP1': 10.0},
    **{'QCRP1': 0.2, 'QCRP2': 0.1, 'QBRP1': 0.1, 'QDRP1': 1.0, 'QDRP2': 0.0},
}
# Derived numbers that stand in the same row: relative pressure change, 1 for 6.1 and 0 for 5.2, A_mu of (4.E8), camber
# limit, ..., 1 with turn slip and 0 without, 1 where only the moment against turning on the spot acts; and by what
# lengths and speeds that are meant for tires of vehicles are smaller for a tire of a model
DERIVED = (
    'DPI',
    'IS_61',
    'A_MU',
    'GAMMA_MAX',
    'PRESSURE_MY',
    'HALF_WIDTH',
    'TURN_SLIP',
    'PARKING',
    'SMALL',
    'SMALL_SPEED',
)
ROW = len(DEFAULTS) + len(DERIVED)
I = ModuleType('I')  # noqa: E741  (a module, because compiled code turns its attributes into constants)
vars(I).update({name: k for k, name in enumerate((*DEFAULTS, *DERIVED))})

DEFAULT_GAMMA_MAX = np.deg2rad(15.0)  # camber range when the file gives none
# speeds over ground up to which the moment against turning on the spot acts fully, and at all [m/s]
PARKING_FULL, PARKING_ENDS = 2.5, 5.0
PARKING_LOAD = 3.0  # over FNOMIN: up to this load data must resist turning on the spot
# coefficients and scalars that say what inflation pressure does, beside NOMPRES
OF_PRESSURE = (
    *('INFLPRES', 'PFZ1', 'PPX1', 'PPX2', 'PPX3', 'PPX4', 'PPY1', 'PPY2', 'PPY3', 'PPY4', 'PPY5', 'PPZ1', 'PPZ2'),
    *('PPMX1', 'QSY8'),
)
DEFAULT_WIDTH = 0.65  # width over radius when the file gives none: that of passenger car tires


def pack(
    values: Mapping[str, float],
    version: int,
    pressure: float | None = None,
    *,
    turn_slip: bool = False,
    parking: bool = False,
) -> np.ndarray:
    """Return the row of coefficients of a tire.

    values: by MF name, SI units; missing ones take DEFAULTS. version: 52 or 61. pressure: inflation pressure [Pa], None
    for the file's INFLPRES. Pressure acts only when the file has a NOMPRES. turn_slip: whether turn slip acts (6.1);
    parking: whether only its moment against turning on the spot does. Raises KeyError for a missing required name.
    """
    row = np.array([values[n] if d is None else values.get(n, d) for n, d in DEFAULTS.items()] + [0.0] * len(DERIVED))
    nominal = row[I.NOMPRES]
    p = row[I.INFLPRES] if pressure is None else pressure
    if nominal > 0.0 and p > 0.0:
        row[I.DPI] = (p - nominal) / nominal  # (4.E2b)
    row[I.IS_61] = float(version == 61)
    row[I.TURN_SLIP] = float(turn_slip)
    row[I.PARKING] = float(parking)
    row[I.SMALL] = small_tire(row[I.UNLOADED_RADIUS])
    row[I.SMALL_SPEED] = np.sqrt(row[I.SMALL])
    row[I.A_MU] = 10.0 if version == 61 else 1.0
    limit = max(abs(row[I.CAMMIN]), abs(row[I.CAMMAX]))
    row[I.GAMMA_MAX] = limit if limit > 0.0 else DEFAULT_GAMMA_MAX
    if row[I.QSY7] == 0.0:
        row[I.QSY7] = 1.0  # not fitted: resistance proportional to load, as in MF 5.2
    row[I.PRESSURE_MY] = (1.0 + row[I.DPI]) ** row[I.QSY8]
    row[I.HALF_WIDTH] = 0.5 * (row[I.WIDTH] if row[I.WIDTH] > 0.0 else DEFAULT_WIDTH * row[I.UNLOADED_RADIUS])
    # the camber scale factors of one edition do not exist in the other
    row[[I.LGAX, I.LGAY, I.LGAZ] if version == 61 else [I.LKYC, I.LKZC]] = 1.0
    if version == 52:
        row[[I.PKY6, I.PKY7]] = 0.0
    else:
        row[I.PHY3] = 0.0
    if row[I.Q_FZ1] == 0.0:  # [B] (4): the slope at nominal load is VERTICAL_STIFFNESS
        k = row[I.VERTICAL_STIFFNESS] * row[I.UNLOADED_RADIUS] / row[I.FNOMIN]
        row[I.Q_FZ1] = np.sqrt(max(k * k - 4.0 * row[I.Q_FZ2], 0.0))
    return row


def absent(values: Mapping[str, float]) -> list[str]:
    """Names of the coefficients that have no default and are not there."""
    return [key for key, default in DEFAULTS.items() if default is None and key not in values]


@dataclass(frozen=True, kw_only=True)
class TireData:
    """Scheme of one tire, by their Magic Formula names, SI units, as the file has them (sign and side included).

    version: 52 or 61. values: known coefficients; missing ones take those of DEFAULTS. extra: keys this
    model does not use. side: side of the vehicle or test bench the data belong to. source: where they come from.
    notes: what the reader of a file made of a key (solver.files.tire_receipt). places: file and line of a coefficient.
    """

    name: str
    version: Literal[52, 61]
    values: Mapping[str, float]
    side: Literal['left', 'right', 'symmetric'] = 'left'
    source: str = ''
    extra: Mapping[str, float | str] = field(default_factory=dict)
    notes: Mapping[str, str] = field(default_factory=dict)
    places: Mapping[str, str] = field(default_factory=dict, compare=False)

    def __post_init__(self) -> None:
        where = f'TireData {self.name!r}'
        require(self.version in (52, 61), where, 'version', self.version, 'must be 52 or 61')
        require(
            self.side in ('left', 'right', 'symmetric'), where, 'side', self.side, 'must be left, right or symmetric'
        )
        for key in (k for k in self.values if k not in DEFAULTS):
            require(
                False, where, key, self.values[key], 'is not a coefficient of this model' + suggestion(key, DEFAULTS)
            )
        values = {k: finite(where, k, v) for k, v in self.values.items()}
        if missing := absent(values):
            raise SpecError(f'{where}: missing, and without a default: {", ".join(missing)}')
        object.__setattr__(self, 'values', MappingProxyType(values))
        object.__setattr__(self, 'extra', MappingProxyType(dict(self.extra)))
        object.__setattr__(self, 'notes', MappingProxyType(dict(self.notes)))
        object.__setattr__(self, 'places', MappingProxyType(dict(self.places)))
        check(where, self)
        for axis, stiffness, table in (
            ('kappa', 'LONGITUDINAL_STIFFNESS', ('PTX1',)),
            ('alpha', 'LATERAL_STIFFNESS', ('PTY1', 'PTY2')),
        ):
            known = self.version == 61 and values.get(stiffness, 0.0) > 0.0
            known = known or all(values.get(k, 0.0) > 0.0 for k in table)
            require(
                known,
                where,
                ' and '.join(table),
                None,
                f'no relaxation length for {axis}: give them, or {stiffness} (6.1)',
            )

    def __getitem__(self, key: str) -> float:
        """Value of a coefficient, the default where the data have none."""
        return self.values[key] if key in self.values else DEFAULTS[key]  # type: ignore[return-value]

    def __reduce__(self) -> tuple:
        """Read-only views do not travel to other processes; what they show does."""
        plain = {name: dict(getattr(self, name)) for name in ('values', 'extra', 'notes', 'places')}
        return partial(TireData, **{field.name: getattr(self, field.name) for field in fields(self)} | plain), ()

    def combines(self, axis: str) -> bool:
        """True where combined slip weakens the force along 'x' or 'y' (4.E50), (4.E58)."""
        slopes = ('RBX1', 'RBX3') if axis == 'x' else ('RBY1', 'RBY4')
        return any(self[key] != 0.0 for key in slopes) and self['RCX1' if axis == 'x' else 'RCY1'] != 0.0

    def require_turn_slip(self, where: str) -> None:
        """Refuse data without turn slip, and coefficients with which it would not resist the turning of the wheel.
        Raises SpecError."""
        require(self.version == 61, where, 'turn_slip', True, 'needs data of the Magic Formula 6.1: leave it out')
        for key in ('PHYP1', 'PHYP2', 'QCRP1', 'QDRP1', 'LMP'):
            require(self[key] > 0.0, where, key, self[key], 'must be positive for turn slip')
        require(
            self['QDRP1'] < 2.0,
            where,
            'QDRP1',
            self['QDRP1'],
            'must be below 2: the shape factor of a moment that keeps its sign',
        )
        require(self['PECP1'] < 1.0, where, 'PECP1', self['PECP1'], 'must be below 1: camber is a part of the spin')
        for key in ('PKY6', 'QDZ8'):
            require(
                self[key] < 0.0,
                where,
                key,
                self[key],
                'must be negative for turn slip: side force and moment against the spin',
            )

    def lacks_turn_slip(self) -> str:
        """Why these data have no moment against turning on the spot that may act unasked, as a sentence; '' where they
        have."""
        if self.version != 61:
            return 'the data are not of the Magic Formula 6.1'
        try:
            self.require_turn_slip(f'TireData {self.name!r}')
        except SpecError as error:
            return str(error)
        for dfz in (-1.0, PARKING_LOAD - 1.0):  # all three are linear in the load
            slope, peak = self['QDZ8'] + self['QDZ9'] * dfz, self['PDY1'] + self['PDY2'] * dfz
            if slope > 0.0 or peak < 0.0 or self['PECP1'] * (1.0 + self['PECP2'] * dfz) >= 1.0:
                return f'QDZ9, PDY2 or PECP2 let the moment drive at a load of {1.0 + dfz:g} FNOMIN'
        return ''
