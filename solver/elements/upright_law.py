"""The law of a tire without slip and camber, in plain numpy over the load: what its limits look at.

Equation numbers: see magic_formula.py.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np

from solver.units import MODEL_GRAVITY

# of FNOMIN: loads of any use, where the law must hold; ten times is beyond any measurement
LOADS = np.linspace(0.2, 1.2, 21)
WIDE = np.linspace(0.2, 2.0, 37)  # of FNOMIN: loads of hard use, where what is odd is told
BEYOND = 3.0  # of FNOMIN: loads up to which what changes its sign is told where the file states no FZMAX
# Froude number of the reference speed, v over sqrt(g R0): 28 m/s of a wheel of 0.3 m; ten times is no road speed
FASTEST = 16.0
# radius [m] below which lengths that smooth or bound the contact, and speeds of standstill (Froude), shrink with the
# tire
SMALL_TIRE = 0.2


def small_tire(radius: float) -> float:
    """Factor of lengths that are meant for tires of vehicles, for a tire of this unloaded radius [m]: 1 from SMALL_TIRE
    on."""
    return min(1.0, float(radius) / SMALL_TIRE)


class Coefficients(Protocol):
    """Coefficients of a tire by name, in SI units (solver.elements.tire_data.TireData)."""

    @property
    def version(self) -> int:
        """61 of the Magic Formula 6.1, 52 of 5.2."""

    @property
    def values(self) -> Mapping[str, float]:
        """Those that were given."""

    def combines(self, axis: str) -> bool:
        """True where combined slip lessens the force along an axis."""

    def __getitem__(self, name: str) -> float:
        """A coefficient, or its default."""


class Finding(NamedTuple):
    """Finding on a coefficient: wrong (refused) or odd (told)."""

    key: str
    refused: bool
    text: str


class UprightLaw:
    """The law of a tire without slip: arrays over LOADS where nothing else is said, SI units."""

    def __init__(self, data: Coefficients, pressure: float | None) -> None:
        self.data = data
        self.new = data.version == 61
        self.R0, self.F0, self.c_z = data['UNLOADED_RADIUS'], data['FNOMIN'], data['VERTICAL_STIFFNESS']
        p, nominal = data['INFLPRES'] if pressure is None else pressure, data['NOMPRES']
        self.dpi = (p - nominal) / nominal if nominal > 0.0 and p > 0.0 else 0.0
        self.width = data['WIDTH'] or 0.65 * self.R0
        limit = max(abs(data['CAMMIN']), abs(data['CAMMAX'])) or math.radians(15.0)
        self.lean = min(limit, math.pi / 2.0)
        self.speed = FASTEST * math.sqrt(MODEL_GRAVITY * self.R0) / data['LONGVL']  # reference speed over LONGVL
        self.top = data['FZMAX'] or BEYOND * self.F0

    def dfz(self, load: np.ndarray) -> np.ndarray:
        """Increment of the load (4.E2a), held at FZMAX. load: over FNOMIN."""
        d = self.data
        held = np.minimum(load * self.F0, d['FZMAX'] or np.inf)
        return held / (self.F0 * d['LFZO']) - 1.0

    def camber(self, angle: float) -> float:
        """Camber variable of the side force: sin(gamma), or gamma LGAY in 5.2."""
        return math.sin(angle) if self.new else angle * self.data['LGAY']

    def friction(self, axis: str, load: np.ndarray) -> np.ndarray:
        """Upright (4.E13), (4.E23); load over FNOMIN."""
        d, A = self.data, axis.upper()
        by_pressure = 1.0 + d[f'PP{A}3'] * self.dpi + d[f'PP{A}4'] * self.dpi**2
        return (d[f'PD{A}1'] + d[f'PD{A}2'] * self.dfz(load)) * by_pressure * d[f'LMU{A}']

    def stiffness(self, axis: str, load: np.ndarray) -> np.ndarray:
        """Upright slip stiffness over load, positive in a tire (4.E15), (4.E25)."""
        d, dfz = self.data, self.dfz(load)
        if axis == 'x':
            by_pressure = 1.0 + d['PPX1'] * self.dpi + d['PPX2'] * self.dpi**2
            with np.errstate(over='ignore'):
                return (d['PKX1'] + d['PKX2'] * dfz) * np.exp(d['PKX3'] * dfz) * (d['LKX'] * by_pressure)
        peak = d['PKY2'] * d['LFZO'] * (1.0 + d['PPY2'] * self.dpi)
        crest = np.sin(d['PKY4'] * np.arctan(load / peak)) if peak > 0.0 else 0.0 * load
        return -d['PKY1'] * d['LFZO'] * (1.0 + d['PPY1'] * self.dpi) * d['LKY'] * crest / load

    def curve(self, axis: str, slip: np.ndarray) -> np.ndarray:
        """Force over load at FNOMIN, upright, against the slip as it drives: positive for positive slip (4.E9),
        (4.E19)."""
        d, A = self.data, axis.upper()
        one = np.array([1.0])
        dfz, mu, K = (float(f[0]) for f in (self.dfz(one), self.friction(axis, one), self.stiffness(axis, one)))
        sign = 1.0 if axis == 'x' else -1.0  # of Fy against alpha
        shift = (d[f'PH{A}1'] + d[f'PH{A}2'] * dfz) * d[f'LH{A}']
        offset = (d[f'PV{A}1'] + d[f'PV{A}2'] * dfz) * d[f'LV{A}'] * sign
        x = slip + sign * shift
        C, E = d[f'PC{A}1'] * d[f'LC{A}'], d[f'PE{A}1'] + d[f'PE{A}2'] * dfz
        E = E + d['PEX3'] * dfz * dfz if axis == 'x' else E
        skew = d['PEX4'] if axis == 'x' else -d['PEY3']
        return mu * np.sin(argument(K / (C * mu) * x, C, E * (1.0 - skew * np.sign(x)) * d[f'LE{A}'])) + offset

    def deflection(self, load: float) -> float:
        """Deflection of the spring over UNLOADED_RADIUS under a load over FNOMIN; nan where it cannot carry it."""
        q1, q2, f = self.data['Q_FZ1'], self.data['Q_FZ2'], load / (1.0 + self.data['PFZ1'] * self.dpi)
        if q1 == 0.0:
            q1 = math.sqrt(max((self.c_z * self.R0 / self.F0) ** 2 - 4.0 * q2, 0.0))
        root = q1 * q1 + 4.0 * q2 * f
        return 2.0 * f / (q1 + math.sqrt(root)) if root > 0.0 else math.nan


def argument(x, C, E):
    """Argument of every sine and cosine of the Magic Formula."""
    return C * np.arctan(x - np.minimum(E, 1.0) * (x - np.arctan(x)))
