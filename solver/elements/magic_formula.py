"""The Magic Formula 5.2 and 6.1 for combined slip: a pure law from slip, camber and load to forces and moments.

Equation numbers are those of [P] H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed. (2012), section 4.3.2 and appendix 3, and
[B] I. J. M. Besselink, A. J. C. Schmeitz, H. B. Pacejka, An improved Magic Formula/Swift tyre model that can handle inflation
pressure changes, Vehicle System Dynamics 48 (2010) S337-S352. MF 5.2 is the 2002 edition of [P] and the MF-Tyre 5.2 manual.

Axes are those of the .tir files (ISO-W): kappa = -Vsx/|Vx|, tan(alpha) = +Vsy/|Vx|, so a tire has a negative PKY1; gamma about +x.
The element (tire_pacejka.py) converts to the signs of docs/conventions.md. Turn slip is absent (all zeta = 1).

Everything runs on float64, complex128 and Dual. One row of coefficients is a flat array; `I.PCX1` is the place of PCX1.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import ModuleType

import numpy as np

from solver.jit import kernel
from solver.lie.dual import arctan, cos, exp, log, sin, sqrt

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
    **dict.fromkeys(('LFZO', 'LCX', 'LMUX', 'LEX', 'LKX', 'LHX', 'LVX', 'LCY', 'LMUY', 'LEY', 'LKY', 'LHY', 'LVY', 'LKYC', 'LKZC'), 1.0),
    **dict.fromkeys(('LGAX', 'LGAY', 'LGAZ', 'LTR', 'LRES', 'LXAL', 'LYKA', 'LVYKA', 'LS', 'LMX', 'LVMX', 'LMY', 'LSGKP', 'LSGAL'), 1.0),
    **dict.fromkeys(('PCX1', 'PDX1', 'PKX1'), None),
    **dict.fromkeys(('PDX2', 'PDX3', 'PEX1', 'PEX2', 'PEX3', 'PEX4', 'PKX2', 'PKX3', 'PHX1', 'PHX2', 'PVX1', 'PVX2'), 0.0),
    **dict.fromkeys(('PPX1', 'PPX2', 'PPX3', 'PPX4', 'RBX1', 'RBX2', 'RBX3', 'RCX1', 'REX1', 'REX2', 'RHX1'), 0.0),
    **dict.fromkeys(('PCY1', 'PDY1', 'PKY1', 'PKY2'), None),
    **dict.fromkeys(('PDY2', 'PDY3', 'PEY1', 'PEY2', 'PEY3', 'PEY4', 'PEY5', 'PKY3', 'PKY5', 'PKY6', 'PKY7'), 0.0),
    **dict.fromkeys(('PHY1', 'PHY2', 'PHY3', 'PVY1', 'PVY2', 'PVY3', 'PVY4', 'PPY1', 'PPY2', 'PPY3', 'PPY4', 'PPY5'), 0.0),
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
}
# Derived numbers that stand in the same row: relative pressure change, 1 for 6.1 and 0 for 5.2, A_mu of (4.E8), camber limit, ...
DERIVED = ('DPI', 'IS_61', 'A_MU', 'GAMMA_MAX', 'PRESSURE_MY', 'HALF_WIDTH')
ROW = len(DEFAULTS) + len(DERIVED)
I = ModuleType('I')  # noqa: E741  (a module, because compiled code turns its attributes into constants)
vars(I).update({name: k for k, name in enumerate((*DEFAULTS, *DERIVED))})

SMOOTH_CAMBER = 1e-3  # |gamma| is gamma^2/sqrt(gamma^2 + SMOOTH_CAMBER^2) [rad]
SLOWEST = 0.5  # speed above which sign(V) is exactly 1 [m/s]
DEFAULT_GAMMA_MAX = np.deg2rad(15.0)  # camber range when the file gives none
DEFAULT_WIDTH = 0.65  # width over radius when the file gives none: that of passenger car tires
TWO_OVER_PI = 2.0 / np.pi


def pack(values: Mapping[str, float], version: int, pressure: float | None = None) -> np.ndarray:
    """Return the row of coefficients of a tire.

    values: by MF name, SI units; missing ones take DEFAULTS. version: 52 or 61. pressure: inflation pressure [Pa], None for the
    file's INFLPRES. Pressure acts only when the file has a NOMPRES. Raises KeyError for a missing required name.
    """
    row = np.array([values[n] if d is None else values.get(n, d) for n, d in DEFAULTS.items()] + [0.0] * len(DERIVED))
    nominal = row[I.NOMPRES]
    p = row[I.INFLPRES] if pressure is None else pressure
    if nominal > 0.0 and p > 0.0:
        row[I.DPI] = (p - nominal) / nominal  # (4.E2b)
    row[I.IS_61] = float(version == 61)
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


@kernel(borrow=True)
def ramp(x, width):
    """max(x, 0), replaced by a parabola for |x| < width: once continuously differentiable."""
    if x.real <= -width:
        return 0.0 * x
    if x.real >= width:
        return 1.0 * x
    s = x + width
    return s * s / (4.0 * width)


@kernel(borrow=True)
def smooth_abs(x, width):
    """|x| made smooth on the scale of width; exactly 0 at 0."""
    return x * x / sqrt(x * x + width * width)


@kernel(borrow=True)
def smooth_sign(x, width):
    """sign(x), replaced by a cubic for |x| < width: once continuously differentiable."""
    if x.real >= width:
        return 0.0 * x + 1.0
    if x.real <= -width:
        return 0.0 * x - 1.0
    s = x / width
    return s * (1.5 - 0.5 * s * s)


@kernel(borrow=True)
def held(x, limit):
    """x, held smoothly between -limit and limit; unchanged up to 0.9 of it."""
    return x - ramp(x - limit, 0.1 * limit) + ramp(-x - limit, 0.1 * limit)


@kernel(borrow=True)
def _at_most_one(E):
    """Curvature factors must not exceed 1 ([P], remark below 4.E14)."""
    if E.real > 1.0:
        return 0.0 * E + 1.0
    return 1.0 * E


@kernel(borrow=True)
def _cos_arctan(x):
    return 1.0 / sqrt(1.0 + x * x)


@kernel(borrow=True)
def _curve(x, C, E):
    """C arctan(x - E (x - arctan x)): the argument of every sine and cosine of the Magic Formula."""
    return C * arctan(x - E * (x - arctan(x)))


@kernel(borrow=True)
def camber_variable(c, sin_gamma, cos_gamma):
    """sin gamma (6.1, 4.E4) or gamma (5.2), held smoothly inside the range of the fit: beyond it the polynomials are meaningless."""
    m = c[I.GAMMA_MAX]
    gamma = 1.0 * sin_gamma if c[I.IS_61] > 0.0 else arctan(sin_gamma / cos_gamma)
    return held(gamma, m)


@kernel(borrow=True)
def load_increment(c, Fz):
    """dfz (4.E2a), held smoothly at FZMAX where the file states one."""
    F0 = c[I.FNOMIN] * c[I.LFZO]
    top = c[I.FZMAX]
    if top > 0.0:
        return (top - ramp(top - Fz, 0.05 * top) - F0) / F0
    return (Fz - F0) / F0


@kernel(borrow=True)
def slip_stiffness(c, gamma, Fz, dfz):
    """(Kxk, Kya): slip stiffness (4.E15) [N] and cornering stiffness (4.E25) [N/rad] at camber variable gamma."""
    dpi = c[I.DPI]
    F0 = c[I.FNOMIN] * c[I.LFZO]
    g = gamma * c[I.LGAY]
    Kxk = Fz * (c[I.PKX1] + c[I.PKX2] * dfz) * exp(c[I.PKX3] * dfz) * (c[I.LKX] * (1.0 + c[I.PPX1] * dpi + c[I.PPX2] * dpi * dpi))
    peak = (c[I.PKY2] + c[I.PKY5] * g * g) * (F0 * (1.0 + c[I.PPY2] * dpi))
    Kya = (1.0 - c[I.PKY3] * smooth_abs(g, SMOOTH_CAMBER)) * sin(c[I.PKY4] * arctan(Fz / peak))
    return Kxk, Kya * (c[I.PKY1] * F0 * (1.0 + c[I.PPY1] * dpi) * c[I.LKY])


@kernel(borrow=True)
def relaxation_lengths(c, gamma, Fz, dfz, Kxk, Kya):
    """(sigma_kappa, sigma_alpha) [m]: slip stiffness over carcass stiffness ([B] 17-19), or the PTX, PTY formulas of MF 5.2."""
    dpi = c[I.DPI]
    R0 = c[I.UNLOADED_RADIUS]
    F0 = c[I.FNOMIN]
    if c[I.LONGITUDINAL_STIFFNESS] > 0.0 and c[I.IS_61] > 0.0:
        sigma_x = Kxk / ((1.0 + c[I.PCFX1] * dfz + c[I.PCFX2] * dfz * dfz) * (c[I.LONGITUDINAL_STIFFNESS] * (1.0 + c[I.PCFX3] * dpi)))
    else:
        sigma_x = Fz * (c[I.PTX1] + c[I.PTX2] * dfz) * exp(-c[I.PTX3] * dfz) * (R0 / F0 * c[I.LSGKP])
    if c[I.LATERAL_STIFFNESS] > 0.0 and c[I.IS_61] > 0.0:
        sigma_y = -Kya / ((1.0 + c[I.PCFY1] * dfz + c[I.PCFY2] * dfz * dfz) * (c[I.LATERAL_STIFFNESS] * (1.0 + c[I.PCFY3] * dpi)))
    else:
        crest = sin(2.0 * arctan(Fz / (c[I.PTY2] * F0 * c[I.LFZO])))
        sigma_y = crest * (1.0 - c[I.PKY3] * smooth_abs(gamma * c[I.LGAY], SMOOTH_CAMBER)) * (c[I.PTY1] * R0 * c[I.LFZO] * c[I.LSGAL])
    return sigma_x, sigma_y


@kernel(borrow=True)
def _longitudinal(c, kappa, a, gamma, Fz, dfz, mu, Kxk):
    """Fx (4.E50) at combined slip."""
    dpi = c[I.DPI]
    g = gamma * c[I.LGAX]
    scale = c[I.LMUX] * mu
    shift_scale = c[I.A_MU] * scale / (1.0 + (c[I.A_MU] - 1.0) * scale)  # (4.E8)
    mux = (c[I.PDX1] + c[I.PDX2] * dfz) * (1.0 - c[I.PDX3] * g * g) * (1.0 + c[I.PPX3] * dpi + c[I.PPX4] * dpi * dpi) * scale  # (4.E13)
    k = kappa + (c[I.PHX1] + c[I.PHX2] * dfz) * c[I.LHX]  # (4.E10), (4.E17)
    side = 1.0 if k.real >= 0.0 else -1.0
    E = _at_most_one((c[I.PEX1] + dfz * (c[I.PEX2] + dfz * c[I.PEX3])) * ((1.0 - c[I.PEX4] * side) * c[I.LEX]))  # (4.E14)
    C = c[I.PCX1] * c[I.LCX]
    D = mux * Fz
    SV = Fz * (c[I.PVX1] + c[I.PVX2] * dfz) * shift_scale * c[I.LVX]  # (4.E18)
    Fx0 = D * sin(_curve(Kxk / (C * D) * k, C, E)) + SV  # (4.E9)
    if c[I.RBX1] == 0.0:
        return Fx0
    B = (c[I.RBX1] + c[I.RBX3] * g * g) * c[I.LXAL] * _cos_arctan(c[I.RBX2] * kappa)  # (4.E54)
    E = _at_most_one(c[I.REX1] + c[I.REX2] * dfz)
    C = c[I.RCX1]
    SH = c[I.RHX1]
    return Fx0 * (cos(_curve(B * (a + SH), C, E)) / cos(_curve(B * SH, C, E)))  # (4.E51) to (4.E53)


@kernel(borrow=True)
def _lateral(c, a, gamma, Fz, dfz, mu, Kya):
    """(Fy0, Dy, By Cy, SHy + SVy/Kya) at pure side slip."""
    dpi = c[I.DPI]
    g = gamma * c[I.LGAY]
    scale = c[I.LMUY] * mu
    shift_scale = c[I.A_MU] * scale / (1.0 + (c[I.A_MU] - 1.0) * scale)
    muy = (c[I.PDY1] + c[I.PDY2] * dfz) * (1.0 - c[I.PDY3] * g * g) * (1.0 + c[I.PPY3] * dpi + c[I.PPY4] * dpi * dpi) * scale  # (4.E23)
    SVg = Fz * (c[I.PVY3] + c[I.PVY4] * dfz) * g * shift_scale * c[I.LKYC]  # (4.E28)
    SV = Fz * (c[I.PVY1] + c[I.PVY2] * dfz) * shift_scale * c[I.LVY] + SVg  # (4.E29)
    SH = (c[I.PHY1] + c[I.PHY2] * dfz) * c[I.LHY] + c[I.PHY3] * g  # (4.E27); PHY3 in 5.2 only
    if c[I.IS_61] > 0.0:
        Kyg = Fz * (c[I.PKY6] + c[I.PKY7] * dfz) * ((1.0 + c[I.PPY5] * dpi) * c[I.LKYC])  # (4.E30)
        SH = SH + (Kyg * g - SVg) / Kya
    x = a + SH
    side = 1.0 if x.real >= 0.0 else -1.0
    E = (c[I.PEY1] + c[I.PEY2] * dfz) * (1.0 + c[I.PEY5] * g * g - (c[I.PEY3] + c[I.PEY4] * g) * side) * c[I.LEY]  # (4.E24)
    C = c[I.PCY1] * c[I.LCY]
    D = muy * Fz
    BC = Kya / D
    return D * sin(_curve(BC / C * x, C, _at_most_one(E))) + SV, D, BC, SH + SV / Kya


@kernel(borrow=True)
def _lateral_weight(c, kappa, a, gamma, dfz, D):
    """(Gyk, SVyk): reduction (4.E59) and ply-steer force (4.E66) due to longitudinal slip."""
    if c[I.RBY1] == 0.0:
        return 0.0 * kappa + 1.0, 0.0 * kappa
    g = gamma * c[I.LGAY]
    B = (c[I.RBY1] + c[I.RBY4] * g * g) * c[I.LYKA] * _cos_arctan(c[I.RBY2] * (a - c[I.RBY3]))  # (4.E62)
    E = _at_most_one(c[I.REY1] + c[I.REY2] * dfz)
    C = c[I.RCY1]
    SH = c[I.RHY1] + c[I.RHY2] * dfz
    G = cos(_curve(B * (kappa + SH), C, E)) / cos(_curve(B * SH, C, E))
    DV = D * (c[I.RVY1] + c[I.RVY2] * dfz + c[I.RVY3] * g) * _cos_arctan(c[I.RVY4] * a)  # (4.E67)
    return G, DV * sin(c[I.RVY5] * arctan(c[I.RVY6] * kappa)) * c[I.LVYKA]


@kernel(borrow=True)
def _aligning(c, kappa, a, gamma, Fz, dfz, mu, Kxk, Kya, BC, shift, cos_alpha):
    """(trail t, residual moment Mzr) at combined slip, for forward rolling."""
    dpi = c[I.DPI]
    R0 = c[I.UNLOADED_RADIUS]
    F0 = c[I.FNOMIN] * c[I.LFZO]
    g = gamma * c[I.LGAZ]
    size = smooth_abs(g, SMOOTH_CAMBER)
    at = a + (c[I.QHZ1] + c[I.QHZ2] * dfz + (c[I.QHZ3] + c[I.QHZ4] * dfz) * g)  # (4.E34)
    scale = c[I.LMUY] * mu
    B = (c[I.QBZ1] + dfz * (c[I.QBZ2] + dfz * c[I.QBZ3])) * (1.0 + c[I.QBZ4] * g + c[I.QBZ5] * size) * c[I.LKY] / scale  # (4.E40)
    C = c[I.QCZ1]
    if c[I.IS_61] > 0.0:
        camber = 1.0 + c[I.QDZ3] * size + c[I.QDZ4] * g * g  # (4.E43)
    else:
        camber = 1.0 + c[I.QDZ3] * g + c[I.QDZ4] * g * g
    D = Fz * (c[I.QDZ1] + c[I.QDZ2] * dfz) * camber * ((1.0 - c[I.PPZ1] * dpi) * (R0 / F0 * c[I.LTR]))  # (4.E42)
    E = (c[I.QEZ1] + dfz * (c[I.QEZ2] + dfz * c[I.QEZ3])) * (1.0 + (c[I.QEZ4] + c[I.QEZ5] * g) * TWO_OVER_PI * arctan(B * C * at))
    # equivalent slip (4.E77), (4.E78); the trail and the residual moment are even in it, so its sign is not needed
    q = Kxk / Kya * kappa
    q = q * q
    x = B * sqrt(at * at + q + 1e-16)
    t = D * cos(_curve(x, C, _at_most_one(E))) * cos_alpha  # (4.E73)
    Br = c[I.QBZ9] * c[I.LKY] / scale + c[I.QBZ10] * BC  # (4.E45)
    ar = a + shift
    camber = ((c[I.QDZ8] + c[I.QDZ9] * dfz) * (1.0 + c[I.PPZ2] * dpi) + (c[I.QDZ10] + c[I.QDZ11] * dfz) * size) * g * c[I.LKZC]
    Dr = Fz * ((c[I.QDZ6] + c[I.QDZ7] * dfz) * c[I.LRES] + camber) * (scale * R0) * cos_alpha  # (4.E47)
    return t, Dr / sqrt(1.0 + Br * Br * (ar * ar + q))  # (4.E75), cos(arctan x) written out


@kernel(borrow=True)
def magic_formula(c, kappa, tan_alpha, gamma, Fz, dfz, mu, Vx, Kxk, Kya, forward, rolling):
    """Forces and moments on the wheel in the axes of the .tir file: (Fx, Fy, Mx, My, Mz) [N, N m].

    c: row of coefficients. kappa, tan_alpha: slip [-]. gamma: from camber_variable. Fz: load > 0 [N]. dfz, Kxk, Kya:
    from load_increment and slip_stiffness. mu: friction factor of the road [-]. Vx: forward speed [m/s]. forward, rolling:
    smooth signs of Vx and of the wheel spin; the former turns the trail, the latter the rolling resistance.
    """
    R0 = c[I.UNLOADED_RADIUS]
    F0 = c[I.FNOMIN]
    Fn = F0 * c[I.LFZO]
    cos_alpha = 1.0 / sqrt(1.0 + tan_alpha * tan_alpha)
    if c[I.IS_61] > 0.0:
        a = 1.0 * tan_alpha  # (4.E3)
    else:
        a = arctan(tan_alpha)
    Fx = _longitudinal(c, kappa, a, gamma, Fz, dfz, mu, Kxk)
    Fy0, D, BC, shift = _lateral(c, a, gamma, Fz, dfz, mu, Kya)
    G, SV = _lateral_weight(c, kappa, a, gamma, dfz, D)
    Fy = G * Fy0 + SV  # (4.E58)

    t, Mzr = _aligning(c, kappa, a, gamma, Fz, dfz, mu, Kxk, Kya, BC, shift, cos_alpha)
    if c[I.IS_61] > 0.0:  # (4.E74): the trail acts on the side force at zero camber
        upright = 0.0 * gamma
        Ky0 = slip_stiffness(c, upright, Fz, dfz)[1]
        Fy0 = _lateral(c, a, upright, Fz, dfz, mu, Ky0)[0]
    s = R0 * (c[I.SSZ1] + c[I.SSZ2] * Fy / Fn + (c[I.SSZ3] + c[I.SSZ4] * dfz) * gamma) * c[I.LS]  # (4.E76)
    Mz = forward * (Mzr - t * G * Fy0) + held(s, c[I.HALF_WIDTH]) * Fx  # (4.E71), (4.E72)

    f = Fy / F0
    q = Fz / F0
    Mx = c[I.QSX1] * c[I.LVMX] - c[I.QSX2] * (1.0 + c[I.PPMX1] * c[I.DPI]) * gamma + c[I.QSX3] * f  # (4.E69)
    if c[I.QSX4] != 0.0:
        w = arctan(c[I.QSX6] * q)
        Mx = Mx + c[I.QSX4] * cos(c[I.QSX5] * w * w) * sin(c[I.QSX7] * gamma + c[I.QSX8] * arctan(c[I.QSX9] * f))
    Mx = Mx + c[I.QSX10] * arctan(c[I.QSX11] * q) * gamma
    size = smooth_abs(gamma, SMOOTH_CAMBER)
    Mx = (Fz * (Mx - c[I.QSX12] * gamma * size) + Fy * (c[I.QSX13] + c[I.QSX14] * size)) * (R0 * c[I.LMX])
    # neither resultant leaves the contact patch: the polynomials, squares of the forces, would take it a metre away in a hard landing
    Mx = Fz * held(Mx / Fz, c[I.HALF_WIDTH])

    v = Vx / c[I.LONGVL]
    v2 = v * v
    resistance = c[I.QSY1] + c[I.QSY2] * Fx / F0 + c[I.QSY3] * smooth_abs(v, 1e-3) + c[I.QSY4] * v2 * v2
    resistance = resistance + (c[I.QSY5] + c[I.QSY6] * q) * gamma * gamma
    load = 1.0 * q if c[I.QSY7] == 1.0 else exp(c[I.QSY7] * log(q))
    My = -rolling * resistance * load * (R0 * F0 * c[I.LMY] * c[I.PRESSURE_MY])  # [B] (A48)
    return Fx, Fy, Mx, My, Mz
