"""Contact of a tire with the road: its place, its motion there, and its load.

The contact frame C and all signs are those of docs/conventions.md; sections 1 and 2 of docs/tire.md describe the model.
Source: [B] = [Besselink2010], load and effective radius.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.compiled.dual import arctan, seeded, sqrt, value, variable
from solver.compiled.kernel import kernel
from solver.compiled.vec import add, cross, dot, load3, load33, mv, scale
from solver.elements.road import plane_at, surface_at
from solver.elements.smooth import ramp, smooth_abs, smooth_step
from solver.elements.tire_data import I

# half width of the parabola with which the load begins at touch-down [m], of small tires in proportion less (I.SMALL)
TOUCH = 0.5e-3
RIM_TOUCH = 3e-3  # the same for the rim [m]
NEVER_PULL = 0.1  # and with which it ends in fast rebound [-]
# cosine of camber between which the tread leaves the road (60 to 78 degrees): no friction beyond
FLAT_FROM, FLAT_TO = 0.5, 0.2
TINY = 1e-18


class WheelBodyMotion(NamedTuple):
    """Motion of the wheel body as the contact needs it, numbers of one type, vectors in W."""

    com: tuple  # centre of mass [m]
    centre: tuple  # wheel centre [m]
    axis: tuple  # spin axis
    velocity: tuple  # of the wheel centre [m/s]
    turning: tuple  # angular velocity [rad/s]
    spin: float  # rotation about the spin axis [rad/s]


@kernel(inner=True)
def motion_of(R, p, twist, r, a):
    """Motion of a wheel with its centre at r and its spin axis a (both in B) on a body, from its placement and
    twist."""
    v, w = (twist[0], twist[1], twist[2]), (twist[3], twist[4], twist[5])
    return WheelBodyMotion(p, add(p, mv(R, r)), mv(R, a), add(v, mv(R, cross(w, r))), mv(R, w), dot(a, w))


@kernel(inner=True)
def real_kinematics(kin, i):
    """(R, p, twist) of body i as real numbers, which they are where tangents are wanted."""
    M, p, v = load33(kin.R, i), load3(kin.p, i), kin.v
    R = (M[0].real, M[1].real, M[2].real, M[3].real, M[4].real, M[5].real, M[6].real, M[7].real, M[8].real)
    twist = (v[i, 0].real, v[i, 1].real, v[i, 2].real, v[i, 3].real, v[i, 4].real, v[i, 5].real)
    return R, (p[0].real, p[1].real, p[2].real), twist


@kernel(inline=True)
def seeded_motion_of(R, p, twist, r, a):
    """The same as wide Duals: derivatives with respect to p + dp, R exp(dtheta), v + dv, w + dw."""
    v, w = (twist[0], twist[1], twist[2]), (twist[3], twist[4], twist[5])
    x, y, z = (R[0], R[1], R[2]), (R[3], R[4], R[5]), (R[6], R[7], R[8])  # the world's axes in B
    c = cross(w, r)
    centre, axis, velocity, turning = add(p, mv(R, r)), mv(R, a), add(v, mv(R, c)), mv(R, w)
    ex, ey, ez, o = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)
    # x . (dtheta x b) = dtheta . (b x x) for a vector b fixed in the body
    return WheelBodyMotion(
        (variable(p[0], 0), variable(p[1], 1), variable(p[2], 2)),
        (
            seeded(centre[0], ex + cross(r, x) + o + o),
            seeded(centre[1], ey + cross(r, y) + o + o),
            seeded(centre[2], ez + cross(r, z) + o + o),
        ),
        (
            seeded(axis[0], o + cross(a, x) + o + o),
            seeded(axis[1], o + cross(a, y) + o + o),
            seeded(axis[2], o + cross(a, z) + o + o),
        ),
        (
            seeded(velocity[0], o + cross(c, x) + ex + cross(r, x)),
            seeded(velocity[1], o + cross(c, y) + ey + cross(r, y)),
            seeded(velocity[2], o + cross(c, z) + ez + cross(r, z)),
        ),
        (
            seeded(turning[0], o + cross(w, x) + o + x),
            seeded(turning[1], o + cross(w, y) + o + y),
            seeded(turning[2], o + cross(w, z) + o + z),
        ),
        seeded(dot(a, w), o + o + o + a),
    )


class Contact(NamedTuple):
    """The contact frame, the motion in it and the load; numbers of one type."""

    point: tuple  # contact point [m] in W
    e_x: tuple  # heading in the road plane
    e_y: tuple
    n: tuple  # road normal
    sin_camber: float
    cos_camber: float
    upright: float  # 1, falling to 0 where the tread leaves the road
    Vx: float  # of the wheel centre along e_x [m/s]
    Vsy: float  # of the contact point along e_y [m/s]
    loaded_rate: float  # d(loaded radius)/dt [m/s]
    deflection: float  # [m]
    Fz: float  # load along n [N]
    rolling_radius: float  # effective [m]
    static: float  # load of the spring alone, without growth and stiffening [N]
    energy: float  # of that spring [J]


@kernel(inner=True)
def _spring(c, rho):
    """Force [N] of the tire spring at deflection rho [m]: [B] (4) with a parabolic beginning, and the rim."""
    R0 = c[I.UNLOADED_RADIUS]
    k1 = (1.0 + c[I.PFZ1] * c[I.DPI]) * c[I.FNOMIN] / R0 * c[I.Q_FZ1]
    k2 = (1.0 + c[I.PFZ1] * c[I.DPI]) * c[I.FNOMIN] / (R0 * R0) * c[I.Q_FZ2]
    x = ramp(rho, TOUCH * c[I.SMALL])
    force = x * (k1 + k2 * x)
    if c[I.BOTTOM_STIFF] > 0.0 and c[I.RIM_RADIUS] > 0.0:
        y = rho - (R0 - c[I.RIM_RADIUS] - c[I.BOTTOM_OFFST])
        force = force + c[I.BOTTOM_STIFF] * ramp(y, RIM_TOUCH * c[I.SMALL])
    return force


@kernel(inner=True)
def _spring_energy(c, rho):
    """Integral of _spring [J]."""
    R0 = c[I.UNLOADED_RADIUS]
    k1 = (1.0 + c[I.PFZ1] * c[I.DPI]) * c[I.FNOMIN] / R0 * c[I.Q_FZ1]
    k2 = (1.0 + c[I.PFZ1] * c[I.DPI]) * c[I.FNOMIN] / (R0 * R0) * c[I.Q_FZ2]
    e = TOUCH * c[I.SMALL]
    if rho.real < e:  # x = s^2/(4 e), s = rho + e
        s = ramp(rho + e, 0.0)
        energy = s * s * s * (k1 / (12.0 * e) + k2 * s * s / (80.0 * e * e))
    else:
        energy = k1 * (0.5 * rho * rho + e * e / 6.0) + k2 * (rho * rho * rho / 3.0 + e * e * e / 15.0)
    if c[I.BOTTOM_STIFF] > 0.0 and c[I.RIM_RADIUS] > 0.0:
        b = RIM_TOUCH * c[I.SMALL]
        y = rho - (R0 - c[I.RIM_RADIUS] - c[I.BOTTOM_OFFST])
        s = ramp(y + b, 0.0)
        energy = energy + c[I.BOTTOM_STIFF] * (s * s * s / (12.0 * b) if y.real < b else 0.5 * y * y + b * b / 6.0)
    return energy


@kernel(inline=True)
def contact_of(c, damping, road, motion):
    """The contact of a wheel. c: row of coefficients; damping: vertical damping over nominal load [s/m]."""
    x, y = motion.centre[0], motion.centre[1]
    if road.heights[0] > 0:
        return _contact(c, damping, road, motion, surface_at(road, x, y))
    return _contact(c, damping, road, motion, plane_at(road, x, y))


@kernel(inline=True)
def _contact(c, damping, road, motion, surface):
    """The same on a surface, of surface_at or plane_at: the slopes of a plane have no derivatives, which halves the
    work on its normal."""
    R0 = c[I.UNLOADED_RADIUS]
    F0 = c[I.FNOMIN]
    centre, s, v_c = motion.centre, motion.axis, motion.velocity

    # contact frame: n road normal, e_x = s x n heading, e_y = n x e_x
    h, h_x, h_y, h_xx, h_xy, h_yy = surface
    slope = sqrt(1.0 + h_x * h_x + h_y * h_y)
    n = (-h_x / slope, -h_y / slope, 1.0 / slope)
    sin_g = dot(s, n)
    x = cross(s, n)
    cos_g = sqrt(dot(x, x) + TINY)
    e_x = scale(1.0 / cos_g, x)
    e_y = cross(n, e_x)
    height = centre[2] - h
    envelops = road.enveloping[0] > 0.0
    level = 1.0 / np.sqrt(1.0 + road.plane[1] * road.plane[1] + road.plane[2] * road.plane[2])
    # from the centre to the road's tangent plane, or to the effective road along the normal of the base plane
    # (solver.elements.enveloping)
    below = level * height if envelops else n[2] * height
    # loaded radius: along the wheel plane to the road, below = loaded cos(gamma). Towards a wheel that lies flat the
    # cosine is held at half the width over the radius: the sidewall carries it. The contact point follows from the same
    # function (virtual work). A tire that is wider than its radius is held at half of it, so that an upright wheel
    # stands on its radius.
    flat = min(c[I.HALF_WIDTH] / R0, 0.5)
    support = flat + ramp(cos_g - flat, flat)
    lean = 1.0 / cos_g if cos_g.real > 2.0 * flat else 0.0 * cos_g + 0.5 / flat  # (d support / d cos_g) / cos_g
    loaded = below / support
    reach = loaded * lean
    point = add(centre, add(scale(-reach, cross(x, s)), scale(reach * cos_g * cos_g - below, n)))

    Vx = dot(e_x, v_c)
    w_x = dot(motion.turning, e_x)  # rate of camber
    Vsy = dot(e_y, v_c) + below * w_x
    # rate of the loaded radius, with the turning of the normal as the wheel moves over a curved road
    sin_rate = cos_g * w_x
    rise = dot(n, v_c)
    if road.heights[0] > 0:
        m = (-(h_xx * v_c[0] + h_xy * v_c[1]), -(h_xy * v_c[0] + h_yy * v_c[1]), 0.0 * height)
        n_dot = scale(1.0 / slope, add(m, scale(-dot(m, n), n)))
        sin_rate = sin_rate + dot(n_dot, s)
        if envelops:
            rise = rise * slope * level
        else:
            rise = rise + n_dot[2] * height
    loaded_rate = (rise + reach * sin_g * sin_rate) / support

    # load
    turn = motion.spin * (R0 / c[I.LONGVL])
    growth = R0 * c[I.Q_V1] * turn * turn
    rho = R0 * c[I.Q_RE0] - loaded
    deflection = rho + growth
    spring = _spring(c, deflection)
    stiffening = 1.0 + c[I.Q_V2] * smooth_abs(turn, 1e-3)
    Fz = spring * stiffening / support * ramp(1.0 - damping * loaded_rate, NEVER_PULL)
    if envelops:
        # the spring acts along the base normal; along n it is this much larger, and conservative
        Fz = Fz * slope * level
    upright = smooth_step((cos_g - FLAT_TO) / (FLAT_FROM - FLAT_TO))

    # effective rolling radius [B] (7); load without damper, so that it follows the deflection
    q = spring / F0
    c_z = (1.0 + c[I.PFZ1] * c[I.DPI]) * c[I.VERTICAL_STIFFNESS]
    radius = R0 * c[I.Q_RE0] + growth - F0 / c_z * (c[I.DREFF] * arctan(c[I.BREFF] * q) + c[I.FREFF] * q)
    at_rest = value(rho)
    normal = (n[0] + 0.0 * height, n[1] + 0.0 * height, n[2] + 0.0 * height)  # of one type, whatever the surface
    return Contact(
        point, e_x, e_y, normal, sin_g, cos_g, upright, Vx, Vsy, loaded_rate, deflection, Fz, radius,
        _spring(c, at_rest), _spring_energy(c, at_rest),
    )  # fmt: skip
