"""Turn slip of the Magic Formula 6.1: what the rotation of the contact patch about the road normal does to forces and
moments.

[P] = [Pacejka2012] 4.3.3, equations (4.75) to (4.106), in the axes of the .tir files (z up). With the turn slip phi_t =
yaw rate/V and the part of the camber that acts like it, the spin is

    R0 phi = R0 phi_t + (1 - eps_gamma) sin(gamma)

(4.76) for a freely rolling wheel, with R0 for the effective radius: a tire that leans and does not turn has the camber
stiffnesses that it has without turn slip. In reverse the tire is its mirror image turned half round, so forces take phi
with the sign of the speed and the spin moment without it; `twist` is R0 phi_t for forward rolling, and `forward` the
smooth sign of the speed.

Without turn slip `parking_moment` is left of all this: what resists a wheel that is turned on the spot.
"""

from __future__ import annotations

import numpy as np

from solver.compiled.dual import arctan, sin, sqrt
from solver.compiled.kernel import kernel
from solver.elements.smooth import SMOOTH_CAMBER, at_most_one, cos_arctan, curve, held, smooth_abs
from solver.elements.tire_data import I

SMALL_SPIN = 1e-3  # |R0 phi| is rounded below this [-]
SMALL_MOMENT = 0.01  # and |D_r phi| below this fraction of M_z phi infinity
LARGEST_RATIO = 0.99  # bound of the argument of the arc cosine in (4.103)
TWO_OVER_PI = 2.0 / np.pi


@kernel(inner=True)
def camber_reduction(c, dfz):
    """eps_gamma (4.90): how much less camber does than turn slip."""
    return c[I.PECP1] * (1.0 + c[I.PECP2] * dfz)


@kernel(borrow=True)
def spins(c, twist, forward, gamma, dfz):
    """(R0 phi about the road normal, for moments and for all even factors; R0 phi for side forces)."""
    lean = (1.0 - camber_reduction(c, dfz)) * gamma
    return twist + forward * lean, forward * twist + lean


@kernel(inner=True)
def peak_factor_x(c, kappa, spin, dfz):
    """zeta_1 (4.105), (4.106)."""
    return cos_arctan(c[I.PDXP1] * (1.0 + c[I.PDXP2] * dfz) * cos_arctan(c[I.PDXP3] * kappa) * spin)


@kernel(inner=True)
def peak_factor_y(c, tan_alpha, spin, dfz):
    """zeta_2 (4.77), (4.78)."""
    x = 1.0 * spin
    if c[I.PDYP4] != 0.0:
        root = sqrt(sqrt(spin * spin + SMALL_SPIN * SMALL_SPIN)) - np.sqrt(SMALL_SPIN)
        x = smooth_abs(spin, SMALL_SPIN) + c[I.PDYP4] * root
    return cos_arctan(c[I.PDYP1] * (1.0 + c[I.PDYP2] * dfz) * cos_arctan(c[I.PDYP3] * tan_alpha) * x)


@kernel(inner=True)
def stiffness_factor(c, spin):
    """zeta_3 (4.79)."""
    return cos_arctan(c[I.PKYP1] * spin * spin)


@kernel(inner=True)
def side_shift(c, spin, camber_stiffness, cornering_stiffness, dfz):
    """S_Hy phi (4.80), (4.85) to (4.89). Stiffnesses K_y gamma 0, K_y alpha 0 [N/rad]: those at zero camber and
    spin."""
    C = c[I.PHYP1]
    D = c[I.PHYP2] + c[I.PHYP3] * dfz
    B = camber_stiffness / ((1.0 - camber_reduction(c, dfz)) * C * D * cornering_stiffness)
    return D * sin(curve(B * spin, C, at_most_one(0.0 * dfz + c[I.PHYP4])))


@kernel(inner=True)
def trail_factor(c, spin):
    """zeta_5 (4.91)."""
    return cos_arctan(c[I.QDTP1] * spin)


@kernel(inner=True)
def residual_factor(c, spin):
    """zeta_6 (4.102)."""
    return cos_arctan(c[I.QBRP1] * spin)


@kernel(borrow=True)
def saturated_moment(c, D, Fz):
    """M_z phi infinity (4.95) [N m], the moment of a wheel turned on the spot; D: peak side force mu_y Fz."""
    peak = D if c[I.PDY1] > 0.0 else -D
    return peak * sqrt(Fz / (c[I.FNOMIN] * c[I.LFZO])) * (c[I.QCRP1] * c[I.LMP] * c[I.UNLOADED_RADIUS])


@kernel(borrow=True)
def spin_slope(c, gamma, Fz, dfz):
    """K_z gamma r 0/(1 - eps_gamma) (4.98), (4.99): slope of the spin moment over R0 phi at zero [N m]."""
    lean = c[I.QDZ10] + c[I.QDZ11] * dfz
    stiffness = (c[I.QDZ8] + c[I.QDZ9] * dfz) * (1.0 + c[I.PPZ2] * c[I.DPI]) + lean * smooth_abs(gamma, SMOOTH_CAMBER)
    return Fz * stiffness * (c[I.UNLOADED_RADIUS] * c[I.LKZC]) / (1.0 - camber_reduction(c, dfz))


@kernel(inner=True)
def _without_side_slip(c, spin, gamma, D, Fz, dfz):
    """(D_r phi = zeta_8 - 1, M_z phi infinity) [N m]: spin moment without side slip (4.92) to (4.99)."""
    limit = saturated_moment(c, D, Fz)
    C = c[I.QDRP1]
    top = limit / np.sin(0.5 * np.pi * C)
    B = spin_slope(c, gamma, Fz, dfz) / (C * top)
    return top * sin(curve(B * spin, C, at_most_one(0.0 * dfz + c[I.QDRP2]))), limit


@kernel(borrow=True)
def parking_moment(c, twist, Fz, dfz, mu):
    """D_r phi (4.92) to (4.99) [N m] of the twist R0 phi_t alone: no camber, no slip. mu: friction factor of the road
    [-]."""
    dpi = c[I.DPI]
    # (4.E23)
    D = (c[I.PDY1] + c[I.PDY2] * dfz) * (1.0 + c[I.PPY3] * dpi + c[I.PPY4] * dpi * dpi) * (c[I.LMUY] * mu) * Fz
    return _without_side_slip(c, twist, 0.0, D, Fz, dfz)[0]


@kernel(inner=True)
def spin_moment(c, spin, twist, gamma, D, Gyk, Fz, dfz):
    """(D_r phi [N m], C_r = zeta_7): spin moment without side slip, its decay with it (4.103), (4.104)."""
    moment, limit = _without_side_slip(c, spin, gamma, D, Fz, dfz)
    sliding = limit * TWO_OVER_PI * arctan(c[I.QCRP2] * smooth_abs(twist, SMALL_SPIN)) * Gyk  # at alpha = 90 degrees
    small = SMALL_MOMENT * limit
    ratio = held(sliding / sqrt(moment * moment + small * small), LARGEST_RATIO)
    return moment, 1.0 - TWO_OVER_PI * arctan(ratio / sqrt(1.0 - ratio * ratio))  # 2/pi arccos(ratio)
