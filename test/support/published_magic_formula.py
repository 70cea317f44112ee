"""The Magic Formula as published, in plain numpy and independent of the program: forces and moments of a tire at given
slip and load.

6.1 and 6.2: [Pacejka2012] (4.E1) to (4.E78) and, for pressure, [Besselink2010] (A1) to (A63); 6.2 differs from 6.1 in
the load only. 5.2: MF-Tyre 5.2 user manual (TNO 2001), as the PAC2002 pages of the Adams/Tire manual print it; pressure
terms of PAC2002. Axes of the .tir files (ISO-W). Coefficients are read by name, absent ones are 0 (scale factors 1). No
rounding of any kind: |x| and sign(x) are those of numpy.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy import abs, arctan, cos, exp, sin, sqrt, tan


class State(NamedTuple):
    """Arrays: slip kappa [-], slip angle alpha and camber gamma [rad], load [N], speed > 0 [m/s], pressure [Pa]."""

    kappa: np.ndarray
    alpha: np.ndarray
    gamma: np.ndarray
    Fz: np.ndarray
    Vx: np.ndarray
    pressure: np.ndarray


class Coefficients:
    """p.PCX1 is the coefficient of that name."""

    def __init__(self, values: Mapping[str, float]) -> None:
        self.values = values

    def __getattr__(self, name: str) -> float:
        return self.values.get(name, {'PKY4': 2.0, 'QSY7': 1.0}.get(name, 1.0 if name.startswith('L') else 0.0))


def _formula(B, C, D, E, x):
    """D sin(C arctan(B x - E (B x - arctan(B x))))."""
    return D * sin(C * arctan(B * x - np.minimum(E, 1.0) * (B * x - arctan(B * x))))


def _cosine(B, C, E, x):
    return cos(C * arctan(B * x - np.minimum(E, 1.0) * (B * x - arctan(B * x))))


def _sign(x):
    return np.where(x >= 0.0, 1.0, -1.0)


def forces(values: Mapping[str, float], version: int, state: State) -> dict[str, np.ndarray]:
    """fx, fy [N], mx, my, mz [N m] of MF `version` (52 or 61)."""
    p, new = Coefficients(values), version == 61
    kappa, alpha, gamma, Fz, Vx, pressure = state
    R0, Fz0 = p.UNLOADED_RADIUS, p.FNOMIN
    Fz0s = p.LFZO * Fz0  # (4.E1)
    dfz = (Fz - Fz0s) / Fz0s
    dpi = (pressure - p.NOMPRES) / p.NOMPRES if p.NOMPRES else 0.0 * Fz
    a = tan(alpha) if new else alpha  # (4.E3)
    g = sin(gamma) if new else gamma  # (4.E4)
    gx, gy, gz = (g, g, g) if new else (g * p.LGAX, g * p.LGAY, g * p.LGAZ)
    LKYC, LKZC = (p.LKYC, p.LKZC) if new else (1.0, 1.0)
    A = 10.0 if new else 1.0
    LMUXp, LMUYp = (A * m / (1.0 + (A - 1.0) * m) for m in (p.LMUX, p.LMUY))  # (4.E8)

    # longitudinal force, pure slip: (4.E9) to (4.E18)
    mux = (p.PDX1 + p.PDX2 * dfz) * (1.0 + p.PPX3 * dpi + p.PPX4 * dpi**2) * (1.0 - p.PDX3 * gx**2) * p.LMUX
    Kxk = Fz * (p.PKX1 + p.PKX2 * dfz) * exp(p.PKX3 * dfz) * (1.0 + p.PPX1 * dpi + p.PPX2 * dpi**2) * p.LKX
    kx = kappa + (p.PHX1 + p.PHX2 * dfz) * p.LHX
    Cx, Dx = p.PCX1 * p.LCX, mux * Fz
    Ex = (p.PEX1 + p.PEX2 * dfz + p.PEX3 * dfz**2) * (1.0 - p.PEX4 * _sign(kx)) * p.LEX
    SVx = Fz * (p.PVX1 + p.PVX2 * dfz) * p.LVX * LMUXp
    Fx0 = _formula(Kxk / (Cx * Dx), Cx, Dx, Ex, kx) + SVx

    # lateral force, pure slip: (4.E19) to (4.E30)
    def stiffness(g):
        load = arctan(Fz / ((p.PKY2 + p.PKY5 * g**2) * (1.0 + p.PPY2 * dpi) * Fz0s))
        return p.PKY1 * Fz0s * (1.0 + p.PPY1 * dpi) * (1.0 - p.PKY3 * abs(g)) * sin(p.PKY4 * load) * p.LKY

    def lateral(g):
        Kya = stiffness(g)
        muy = (p.PDY1 + p.PDY2 * dfz) * (1.0 + p.PPY3 * dpi + p.PPY4 * dpi**2) * (1.0 - p.PDY3 * g**2) * p.LMUY
        SVyg = Fz * (p.PVY3 + p.PVY4 * dfz) * g * LKYC * LMUYp
        SVy = Fz * (p.PVY1 + p.PVY2 * dfz) * p.LVY * LMUYp + SVyg
        SHy = (p.PHY1 + p.PHY2 * dfz) * p.LHY
        if new:
            Kyg0 = Fz * (p.PKY6 + p.PKY7 * dfz) * (1.0 + p.PPY5 * dpi) * LKYC
            SHy = SHy + (Kyg0 * g - SVyg) / Kya
        else:
            SHy = SHy + p.PHY3 * g
        ay = a + SHy
        Cy, Dy = p.PCY1 * p.LCY, muy * Fz
        Ey = (p.PEY1 + p.PEY2 * dfz) * (1.0 + p.PEY5 * g**2 - (p.PEY3 + p.PEY4 * g) * _sign(ay)) * p.LEY
        By = Kya / (Cy * Dy)
        return _formula(By, Cy, Dy, Ey, ay) + SVy, Dy, By * Cy, SHy + SVy / Kya

    Kya = stiffness(gy)
    Fy0, Dy, ByCy, SHf = lateral(gy)

    # combined slip: (4.E50) to (4.E67)
    Bxa = (p.RBX1 + p.RBX3 * gx**2) * cos(arctan(p.RBX2 * kappa)) * p.LXAL
    Exa = p.REX1 + p.REX2 * dfz
    Gxa = _cosine(Bxa, p.RCX1, Exa, a + p.RHX1) / _cosine(Bxa, p.RCX1, Exa, p.RHX1)
    Fx = Gxa * Fx0
    Byk = (p.RBY1 + p.RBY4 * gy**2) * cos(arctan(p.RBY2 * (a - p.RBY3))) * p.LYKA
    Eyk = p.REY1 + p.REY2 * dfz
    SHyk = p.RHY1 + p.RHY2 * dfz
    Gyk = _cosine(Byk, p.RCY1, Eyk, kappa + SHyk) / _cosine(Byk, p.RCY1, Eyk, SHyk)
    DVyk = Dy * (p.RVY1 + p.RVY2 * dfz + p.RVY3 * gy) * cos(arctan(p.RVY4 * a))
    SVyk = DVyk * sin(p.RVY5 * arctan(p.RVY6 * kappa)) * p.LVYKA
    Fy = Gyk * Fy0 + SVyk

    # overturning couple: (4.E69)
    bump = p.QSX4 * cos(p.QSX5 * arctan(p.QSX6 * Fz / Fz0) ** 2) * sin(p.QSX7 * g + p.QSX8 * arctan(p.QSX9 * Fy / Fz0))
    Mx = (
        p.QSX1 * p.LVMX
        - p.QSX2 * (1.0 + p.PPMX1 * dpi) * g
        + p.QSX3 * Fy / Fz0
        + bump
        + p.QSX10 * arctan(p.QSX11 * Fz / Fz0) * g
    )
    Mx = R0 * p.LMX * (Fz * Mx + Fy * (p.QSX13 + p.QSX14 * abs(g)) - Fz * p.QSX12 * g * abs(g))

    # rolling resistance, forward: (4.E70) with load and pressure of [Besselink2010] (A48)
    speed = abs(Vx / p.LONGVL)
    My = p.QSY1 + p.QSY2 * Fx / Fz0 + p.QSY3 * speed + p.QSY4 * speed**4 + (p.QSY5 + p.QSY6 * Fz / Fz0) * g**2
    My = -R0 * Fz0 * My * (Fz / Fz0) ** p.QSY7 * (1.0 + dpi) ** p.QSY8 * p.LMY

    # aligning torque at combined slip: (4.E31) to (4.E49), (4.E71) to (4.E78)
    at = a + p.QHZ1 + p.QHZ2 * dfz + (p.QHZ3 + p.QHZ4 * dfz) * gz
    Bt = (p.QBZ1 + p.QBZ2 * dfz + p.QBZ3 * dfz**2) * (1.0 + p.QBZ4 * gz + p.QBZ5 * abs(gz)) * p.LKY / p.LMUY
    lean = 1.0 + p.QDZ3 * (abs(gz) if new else gz) + p.QDZ4 * gz**2
    Dt = Fz * (p.QDZ1 + p.QDZ2 * dfz) * (1.0 - p.PPZ1 * dpi) * lean * (R0 / (Fz0s if new else Fz0)) * p.LTR
    Et = (p.QEZ1 + p.QEZ2 * dfz + p.QEZ3 * dfz**2) * (
        1.0 + (p.QEZ4 + p.QEZ5 * gz) * 2.0 / np.pi * arctan(Bt * p.QCZ1 * at)
    )
    ar = a + SHf
    Br = p.QBZ9 * p.LKY / p.LMUY + p.QBZ10 * ByCy
    by_camber = ((p.QDZ8 + p.QDZ9 * dfz) * (1.0 + p.PPZ2 * dpi) + (p.QDZ10 + p.QDZ11 * dfz) * abs(gz)) * gz * LKZC
    Dr = Fz * R0 * ((p.QDZ6 + p.QDZ7 * dfz) * p.LRES + by_camber) * p.LMUY * cos(alpha)
    q = (Kxk / Kya * kappa) ** 2
    if new:
        ateq, areq = (sqrt(x**2 + q) * _sign(x) for x in (at, ar))
    else:
        ateq, areq = (arctan(sqrt(tan(x) ** 2 + q)) * _sign(x) for x in (at, ar))
    t = Dt * _cosine(Bt, p.QCZ1, Et, ateq) * cos(alpha)
    Mzr = Dr * cos(arctan(Br * areq))
    side = Gyk * (lateral(0.0 * gy)[0] if new else Fy0)
    s = R0 * (p.SSZ1 + p.SSZ2 * Fy / (Fz0s if new else Fz0) + (p.SSZ3 + p.SSZ4 * dfz) * g) * p.LS
    return {'fx': Fx, 'fy': Fy, 'mx': Mx, 'my': My, 'mz': -t * side + Mzr + s * Fx}
