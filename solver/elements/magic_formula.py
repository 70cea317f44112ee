"""The Magic Formula 5.2 and 6.1 for combined slip: a pure law from slip, camber and load to forces and moments.

Equation numbers are those of [P] = [Pacejka2012], section 4.3.2 and appendix 3, and [B] = [Besselink2010]
(docs/references.md). MF 5.2 is the 2002 edition of [P] and the MF-Tyre 5.2 manual.

Axes are those of the .tir files (ISO-W): kappa = -Vsx/|Vx|, tan(alpha) = +Vsy/|Vx|, so a tire has a negative PKY1;
gamma about +x. The element (tire_pacejka.py) converts to the signs of docs/conventions.md. Turn slip (the factors zeta)
is in turn_slip.py and acts where the row of coefficients says so.

Everything runs on float64, complex128 and Dual.
"""

from __future__ import annotations

import numpy as np

from solver.compiled.dual import arctan, cos, exp, log, sin, sqrt
from solver.compiled.kernel import NO, kernel
from solver.elements.smooth import (
    SMOOTH_CAMBER,
    at_most_one,
    cos_arctan,
    curve,
    held,
    ramp,
    sin_twice_arctan,
    smooth_abs,
)
from solver.elements.tire_data import I
from solver.elements.turn_slip import (
    peak_factor_x,
    peak_factor_y,
    residual_factor,
    side_shift,
    spin_moment,
    spins,
    stiffness_factor,
    trail_factor,
)

SLOWEST = 0.5  # speed above which sign(V) is exactly 1 [m/s]
TWO_OVER_PI = 2.0 / np.pi


@kernel(inline=True, inner=False)
def camber_variable(c, sin_gamma, cos_gamma):
    """sin gamma (6.1, 4.E4) or gamma (5.2), held smoothly inside the range of the fit: beyond it the polynomials are
    meaningless."""
    m = c[I.GAMMA_MAX]
    gamma = 1.0 * sin_gamma if c[I.IS_61] > 0.0 else arctan(sin_gamma / cos_gamma)
    return held(gamma, m)


@kernel(inline=True, inner=False)
def load_increment(c, Fz):
    """dfz (4.E2a), held smoothly at FZMAX where the file states one."""
    F0 = c[I.FNOMIN] * c[I.LFZO]
    top = c[I.FZMAX]
    if top > 0.0:
        return (top - ramp(top - Fz, 0.05 * top) - F0) / F0
    return (Fz - F0) / F0


@kernel(inline=True, inner=False)
def slip_stiffness(c, gamma, Fz, dfz):
    """(Kxk, Kya): slip stiffness (4.E15) [N] and cornering stiffness (4.E25) [N/rad] at camber variable gamma."""
    dpi = c[I.DPI]
    F0 = c[I.FNOMIN] * c[I.LFZO]
    g = gamma * c[I.LGAY]
    Kxk = (
        Fz
        * (c[I.PKX1] + c[I.PKX2] * dfz)
        * exp(c[I.PKX3] * dfz)
        * (c[I.LKX] * (1.0 + c[I.PPX1] * dpi + c[I.PPX2] * dpi * dpi))
    )
    peak = (c[I.PKY2] + c[I.PKY5] * g * g) * (F0 * (1.0 + c[I.PPY2] * dpi))
    crest = sin_twice_arctan(Fz / peak) if c[I.PKY4] == 2.0 else sin(c[I.PKY4] * arctan(Fz / peak))
    Kya = (1.0 - c[I.PKY3] * smooth_abs(g, SMOOTH_CAMBER)) * crest
    return Kxk, Kya * (c[I.PKY1] * F0 * (1.0 + c[I.PPY1] * dpi) * c[I.LKY])


@kernel(inner=True)
def _camber_stiffness(c, Fz, dfz):
    """Kyg0 [N/rad] at zero camber and spin (4.E30)."""
    return Fz * (c[I.PKY6] + c[I.PKY7] * dfz) * ((1.0 + c[I.PPY5] * c[I.DPI]) * c[I.LKYC])


@kernel(inline=True, inner=False)
def relaxation_lengths(c, gamma, Fz, dfz, Kxk, Kya):
    """(sigma_kappa, sigma_alpha) [m]: slip stiffness over carcass stiffness ([B] 17-19), or the PTX, PTY formulas of MF
    5.2."""
    dpi = c[I.DPI]
    R0 = c[I.UNLOADED_RADIUS]
    F0 = c[I.FNOMIN]
    if c[I.LONGITUDINAL_STIFFNESS] > 0.0 and c[I.IS_61] > 0.0:
        sigma_x = Kxk / (
            (1.0 + c[I.PCFX1] * dfz + c[I.PCFX2] * dfz * dfz) * (c[I.LONGITUDINAL_STIFFNESS] * (1.0 + c[I.PCFX3] * dpi))
        )
    else:
        sigma_x = Fz * (c[I.PTX1] + c[I.PTX2] * dfz) * exp(-c[I.PTX3] * dfz) * (R0 / F0 * c[I.LSGKP])
    if c[I.LATERAL_STIFFNESS] > 0.0 and c[I.IS_61] > 0.0:
        sigma_y = -Kya / (
            (1.0 + c[I.PCFY1] * dfz + c[I.PCFY2] * dfz * dfz) * (c[I.LATERAL_STIFFNESS] * (1.0 + c[I.PCFY3] * dpi))
        )
    else:
        crest = sin_twice_arctan(Fz / (c[I.PTY2] * F0 * c[I.LFZO]))
        sigma_y = (
            crest
            * (1.0 - c[I.PKY3] * smooth_abs(gamma * c[I.LGAY], SMOOTH_CAMBER))
            * (c[I.PTY1] * R0 * c[I.LFZO] * c[I.LSGAL])
        )
    return sigma_x, sigma_y


@kernel(inline=True)
def _longitudinal(c, kappa, a, gamma, Fz, dfz, mu, Kxk, spin):
    """Fx (4.E50) at combined slip; spin: R0 phi."""
    dpi = c[I.DPI]
    g = gamma * c[I.LGAX]
    scale = c[I.LMUX] * mu
    shift_scale = c[I.A_MU] * scale / (1.0 + (c[I.A_MU] - 1.0) * scale)  # (4.E8)
    # (4.E13)
    mux = (
        (c[I.PDX1] + c[I.PDX2] * dfz)
        * (1.0 - c[I.PDX3] * g * g)
        * (1.0 + c[I.PPX3] * dpi + c[I.PPX4] * dpi * dpi)
        * scale
    )
    k = kappa + (c[I.PHX1] + c[I.PHX2] * dfz) * c[I.LHX]  # (4.E10), (4.E17)
    side = 1.0 if k.real >= 0.0 else -1.0
    # (4.E14)
    E = at_most_one((c[I.PEX1] + dfz * (c[I.PEX2] + dfz * c[I.PEX3])) * ((1.0 - c[I.PEX4] * side) * c[I.LEX]))
    C = c[I.PCX1] * c[I.LCX]
    D = mux * Fz
    SV = Fz * (c[I.PVX1] + c[I.PVX2] * dfz) * shift_scale * c[I.LVX]  # (4.E18)
    if c[I.TURN_SLIP] > 0.0:
        zeta = peak_factor_x(c, kappa, spin, dfz)
        D = D * zeta
        SV = SV * zeta
    Fx0 = D * sin(curve(Kxk / (C * D) * k, C, E)) + SV  # (4.E9)
    if c[I.RBX1] == 0.0 and c[I.RBX3] == 0.0:
        return Fx0
    B = (c[I.RBX1] + c[I.RBX3] * g * g) * c[I.LXAL] * cos_arctan(c[I.RBX2] * kappa)  # (4.E54)
    E = at_most_one(c[I.REX1] + c[I.REX2] * dfz)
    C = c[I.RCX1]
    SH = c[I.RHX1]
    G = cos(curve(B * (a + SH), C, E))
    if SH != 0.0:
        G = G / cos(curve(B * SH, C, E))
    return Fx0 * G  # (4.E51) to (4.E53)


@kernel(inline=True)
def _lateral(c, a, gamma, Fz, dfz, mu, Kya, turning, zeta, shift):
    """(Fy0, Dy, By Cy, SHy + SVy/Kya) at pure side slip. turning: whether turn slip acts, with zeta_2 and the shift
    S_Hy phi."""
    dpi = c[I.DPI]
    g = gamma * c[I.LGAY]
    scale = c[I.LMUY] * mu
    shift_scale = c[I.A_MU] * scale / (1.0 + (c[I.A_MU] - 1.0) * scale)
    # (4.E23)
    muy = (
        (c[I.PDY1] + c[I.PDY2] * dfz)
        * (1.0 - c[I.PDY3] * g * g)
        * (1.0 + c[I.PPY3] * dpi + c[I.PPY4] * dpi * dpi)
        * scale
    )
    D = muy * Fz
    SVg = Fz * (c[I.PVY3] + c[I.PVY4] * dfz) * g * shift_scale * c[I.LKYC]  # (4.E28)
    SV = Fz * (c[I.PVY1] + c[I.PVY2] * dfz) * shift_scale * c[I.LVY] + SVg  # (4.E29)
    SH = (c[I.PHY1] + c[I.PHY2] * dfz) * c[I.LHY] + c[I.PHY3] * g  # (4.E27); PHY3 in 5.2 only
    if turning:  # (4.83), (4.84)
        D = D * zeta
        SV = SV * zeta
        SH = SH + shift - SVg * zeta / Kya
    elif c[I.IS_61] > 0.0:
        SH = SH + (_camber_stiffness(c, Fz, dfz) * g - SVg) / Kya
    x = a + SH
    side = 1.0 if x.real >= 0.0 else -1.0
    # (4.E24)
    E = (c[I.PEY1] + c[I.PEY2] * dfz) * (1.0 + c[I.PEY5] * g * g - (c[I.PEY3] + c[I.PEY4] * g) * side) * c[I.LEY]
    C = c[I.PCY1] * c[I.LCY]
    BC = Kya / D
    return D * sin(curve(BC / C * x, C, at_most_one(E))) + SV, D, BC, SH + SV / Kya


@kernel(inline=True)
def _lateral_weight(c, kappa, a, gamma, dfz, D):
    """(Gyk, SVyk): reduction (4.E59) and ply-steer force (4.E66) due to longitudinal slip."""
    if c[I.RBY1] == 0.0 and c[I.RBY4] == 0.0:
        return 0.0 * kappa + 1.0, 0.0 * kappa
    g = gamma * c[I.LGAY]
    B = (c[I.RBY1] + c[I.RBY4] * g * g) * c[I.LYKA] * cos_arctan(c[I.RBY2] * (a - c[I.RBY3]))  # (4.E62)
    E = at_most_one(c[I.REY1] + c[I.REY2] * dfz)
    C = c[I.RCY1]
    SH = c[I.RHY1] + c[I.RHY2] * dfz
    G = cos(curve(B * (kappa + SH), C, E))
    if c[I.RHY1] != 0.0 or c[I.RHY2] != 0.0:
        G = G / cos(curve(B * SH, C, E))
    if c[I.RVY1] == 0.0 and c[I.RVY2] == 0.0 and c[I.RVY3] == 0.0:
        return G, 0.0 * kappa
    DV = D * (c[I.RVY1] + c[I.RVY2] * dfz + c[I.RVY3] * g) * cos_arctan(c[I.RVY4] * a)  # (4.E67)
    return G, DV * sin(c[I.RVY5] * arctan(c[I.RVY6] * kappa)) * c[I.LVYKA]


@kernel(inner=True)
def _reference_load(c):
    """Load of the moment's arms: F'z0 (4.E42, 4.E76), in 5.2 Fz0 without LFZO (MF-Tyre 5.2 manual)."""
    return c[I.FNOMIN] * c[I.LFZO] if c[I.IS_61] > 0.0 else 1.0 * c[I.FNOMIN]


@kernel(inner=True)
def _equivalent(c, slip, q):
    """Size of the equivalent slip: (4.E77), (4.E78), or in 5.2 the angle whose tangent it is (MF-Tyre 5.2 manual)."""
    if c[I.IS_61] > 0.0:
        return sqrt(slip * slip + q + 1e-16)
    t = sin(slip) / cos(slip)
    return arctan(sqrt(t * t + q + 1e-16))


@kernel(inline=True)
def _aligning(c, kappa, a, gamma, Fz, dfz, mu, Kxk, Kya, BC, shift, cos_alpha, spin, twist, zeta_2, D_side, Gyk):
    """(trail t for forward rolling, part of Mzr that turns with the sign of rolling, part that does not) at combined
    slip.

    With turn slip spin is R0 phi, twist R0 phi_t, D_side the peak side force without it.
    """
    dpi = c[I.DPI]
    R0 = c[I.UNLOADED_RADIUS]
    F0 = _reference_load(c)
    g = gamma * c[I.LGAZ]
    size = smooth_abs(g, SMOOTH_CAMBER)
    at = a + (c[I.QHZ1] + c[I.QHZ2] * dfz + (c[I.QHZ3] + c[I.QHZ4] * dfz) * g)  # (4.E34)
    scale = c[I.LMUY] * mu
    # (4.E40)
    B = (c[I.QBZ1] + dfz * (c[I.QBZ2] + dfz * c[I.QBZ3])) * (1.0 + c[I.QBZ4] * g + c[I.QBZ5] * size) * c[I.LKY] / scale
    C = c[I.QCZ1]
    if c[I.IS_61] > 0.0:
        camber = 1.0 + c[I.QDZ3] * size + c[I.QDZ4] * g * g  # (4.E43)
    else:
        camber = 1.0 + c[I.QDZ3] * g + c[I.QDZ4] * g * g
    D = Fz * (c[I.QDZ1] + c[I.QDZ2] * dfz) * camber * ((1.0 - c[I.PPZ1] * dpi) * (R0 / F0 * c[I.LTR]))  # (4.E42)
    E = c[I.QEZ1] + dfz * (c[I.QEZ2] + dfz * c[I.QEZ3])
    if c[I.QEZ4] != 0.0 or c[I.QEZ5] != 0.0:
        E = E * (1.0 + (c[I.QEZ4] + c[I.QEZ5] * g) * TWO_OVER_PI * arctan(B * C * at))
    # equivalent slip (4.E77), (4.E78); the trail and the residual moment are even in it, so its sign is not needed
    q = Kxk / Kya * kappa
    q = q * q
    x = B * _equivalent(c, at, q)
    t = D * cos(curve(x, C, at_most_one(E))) * cos_alpha  # (4.E73)
    Br = c[I.QBZ9] * c[I.LKY] / scale + c[I.QBZ10] * BC  # (4.E45)
    ar = a + shift
    if c[I.TURN_SLIP] > 0.0:
        moment, Cr = spin_moment(c, spin, twist, gamma, D_side, Gyk, Fz, dfz)
        Dr = Fz * (c[I.QDZ6] + c[I.QDZ7] * dfz) * zeta_2 * (scale * R0 * c[I.LRES]) * cos_alpha
        G = cos(Cr * arctan(residual_factor(c, spin) * Br * sqrt(ar * ar + q + 1e-16)))
        return t * trail_factor(c, spin), Dr * G, moment * G
    camber = (
        ((c[I.QDZ8] + c[I.QDZ9] * dfz) * (1.0 + c[I.PPZ2] * dpi) + (c[I.QDZ10] + c[I.QDZ11] * dfz) * size)
        * g
        * c[I.LKZC]
    )
    Dr = Fz * ((c[I.QDZ6] + c[I.QDZ7] * dfz) * c[I.LRES] + camber) * (scale * R0) * cos_alpha  # (4.E47)
    if c[I.IS_61] > 0.0:
        return t, Dr / sqrt(1.0 + Br * Br * (ar * ar + q)), 0.0 * Fz  # (4.E75), cos(arctan x) written out
    er = _equivalent(c, ar, q)
    return t, Dr / sqrt(1.0 + Br * Br * er * er), 0.0 * Fz


@kernel(inner=True)
def patch_forces(c, kappa, tan_alpha, gamma, Fz, dfz, mu, Kxk, Kya, twist, forward):
    """(Fx, Fy, Mx, A, B) in the axes of the .tir file [N, N m], with Mz = forward A + B. Arguments as in
    magic_formula."""
    R0 = c[I.UNLOADED_RADIUS]
    F0 = c[I.FNOMIN]
    Fn = _reference_load(c)
    cos_alpha = 1.0 / sqrt(1.0 + tan_alpha * tan_alpha)
    if c[I.IS_61] > 0.0:
        a = 1.0 * tan_alpha  # (4.E3)
    else:
        a = arctan(tan_alpha)
    turning = c[I.TURN_SLIP] > 0.0
    zero = 0.0 * Fz
    spin, shift, zeta_2, Ky = zero, zero, zero, 1.0 * Kya
    lean = 1.0 - c[I.PKY3] * smooth_abs(gamma * c[I.LGAY], SMOOTH_CAMBER)
    if c[I.PKY5] == 0.0 and lean.real > 0.5:  # Kya at zero camber (4.E25), without its sine and arctan
        Ky0 = Kya / lean
    else:
        Ky0 = slip_stiffness(c, 0.0 * gamma, Fz, dfz)[1]
    if turning:
        spin, side_spin = spins(c, twist, forward, gamma, dfz)
        zeta_2 = peak_factor_y(c, tan_alpha, spin, dfz)
        shift = side_shift(c, side_spin, _camber_stiffness(c, Fz, dfz), Ky0, dfz)
        Ky = Kya * stiffness_factor(c, spin)
    Fx = _longitudinal(c, kappa, a, gamma, Fz, dfz, mu, Kxk, spin)
    Fy0, D, BC, shift = _lateral(c, a, gamma, Fz, dfz, mu, Ky, turning, zeta_2, shift)
    G, SV = _lateral_weight(c, kappa, a, gamma, dfz, D)
    Fy = G * Fy0 + SV  # (4.E58)

    D_side = D / zeta_2 if turning else zero
    t, Mzr, spin_part = _aligning(
        c, kappa, a, gamma, Fz, dfz, mu, Kxk, Ky, BC, shift, cos_alpha, spin, twist, zeta_2, D_side, G
    )
    if c[I.IS_61] > 0.0:  # (4.E74): the trail acts on the side force at zero camber and spin
        Fy0 = _lateral(c, a, 0.0 * gamma, Fz, dfz, mu, Ky0, NO, zero, zero)[0]
    s = R0 * (c[I.SSZ1] + c[I.SSZ2] * Fy / Fn + (c[I.SSZ3] + c[I.SSZ4] * dfz) * gamma) * c[I.LS]  # (4.E76)
    turns, stays = Mzr - t * G * Fy0, held(s, c[I.HALF_WIDTH]) * Fx  # (4.E71), (4.E72)
    if turning:
        stays = stays + spin_part

    f = Fy / F0
    q = Fz / F0
    Mx = c[I.QSX1] * c[I.LVMX] - c[I.QSX2] * (1.0 + c[I.PPMX1] * c[I.DPI]) * gamma + c[I.QSX3] * f  # (4.E69)
    if c[I.QSX4] != 0.0:
        w = arctan(c[I.QSX6] * q)
        Mx = Mx + c[I.QSX4] * cos(c[I.QSX5] * w * w) * sin(c[I.QSX7] * gamma + c[I.QSX8] * arctan(c[I.QSX9] * f))
    if c[I.QSX10] != 0.0:
        Mx = Mx + c[I.QSX10] * arctan(c[I.QSX11] * q) * gamma
    size = smooth_abs(gamma, SMOOTH_CAMBER)
    Mx = (Fz * (Mx - c[I.QSX12] * gamma * size) + Fy * (c[I.QSX13] + c[I.QSX14] * size)) * (R0 * c[I.LMX])
    # neither resultant leaves the contact patch: the polynomials, squares of the forces, would take it a metre away in
    # a hard landing
    Mx = Fz * held(Mx / Fz, c[I.HALF_WIDTH])
    return Fx, Fy, Mx, turns, stays


@kernel(inline=True)
def rolling_resistance(c, Fx, Fz, gamma, Vx, rolling):
    """My [N m] ([B] A48); rolling: smooth sign of the wheel spin, which also turns Fx to the direction of rolling."""
    F0 = c[I.FNOMIN]
    q = Fz / F0
    v = Vx / c[I.LONGVL]
    v2 = v * v
    resistance = c[I.QSY1] + c[I.QSY2] * (rolling * Fx) / F0 + c[I.QSY3] * smooth_abs(v, 1e-3) + c[I.QSY4] * v2 * v2
    resistance = resistance + (c[I.QSY5] + c[I.QSY6] * q) * gamma * gamma
    load = 1.0 * q if c[I.QSY7] == 1.0 else exp(c[I.QSY7] * log(q))
    return -rolling * resistance * load * (c[I.UNLOADED_RADIUS] * F0 * c[I.LMY] * c[I.PRESSURE_MY])


@kernel(borrow=True)
def magic_formula(c, kappa, tan_alpha, gamma, Fz, dfz, mu, Vx, Kxk, Kya, forward, rolling, twist=0.0):
    """Forces and moments on the wheel in the axes of the .tir file: (Fx, Fy, Mx, My, Mz) [N, N m].

    c: row of coefficients. kappa, tan_alpha: slip [-]. gamma: from camber_variable. Fz: load > 0 [N]. dfz, Kxk, Kya:
    from load_increment and slip_stiffness. mu: friction factor of the road [-]. Vx: forward speed [m/s]. forward,
    rolling: smooth signs of Vx and of the wheel spin; the former turns the trail, the latter the rolling resistance.
    twist: R0 times yaw rate over speed, positive to the left [-], read where turn slip acts.
    """
    Fx, Fy, Mx, turns, stays = patch_forces(c, kappa, tan_alpha, gamma, Fz, dfz, mu, Kxk, Kya, twist, forward)
    return Fx, Fy, Mx, rolling_resistance(c, Fx, Fz, gamma, Vx, rolling), forward * turns + stays
