"""Functions of the tire laws: differentiable stand-ins for |x|, sign, max and clipping, and the arguments of the Magic
Formula.

On float64, complex128 and Dual; once continuously differentiable where nothing else is said.
"""

from __future__ import annotations

import numpy as np

from solver.compiled.dual import arctan, sqrt
from solver.compiled.kernel import kernel

SMOOTH_CAMBER = 1e-3  # |gamma| is gamma^2/sqrt(gamma^2 + SMOOTH_CAMBER^2) [rad]


@kernel(borrow=True)
def ramp(x, width):
    """max(x, 0), replaced by a parabola for |x| < width: once continuously differentiable."""
    if x.real <= -width:
        return 0.0 * x
    if x.real >= width:
        return 1.0 * x
    s = x + width
    return s * s / (4.0 * width)


@kernel(inner=True)
def smooth_abs(x, width):
    """|x| made smooth on the scale of width; exactly 0 at 0."""
    return x * x / sqrt(x * x + width * width)


@kernel(inner=True)
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


@kernel(inner=True)
def held_slope(x, limit):
    """Slope of held(x, limit), piecewise linear."""
    beyond = np.abs(x) / limit
    if beyond <= 0.9:
        return 1.0
    if beyond >= 1.1:
        return 0.0
    return (1.1 - beyond) / 0.2


@kernel(borrow=True)
def smooth_step(s):
    """0 for s <= 0, 1 for s >= 1, a cubic between."""
    if s.real <= 0.0:
        return 0.0 * s
    if s.real >= 1.0:
        return 0.0 * s + 1.0
    return s * s * (3.0 - 2.0 * s)


@kernel(borrow=True)
def smoother_step(s):
    """0 for s <= 0, 1 for s >= 1, a polynomial of the fifth degree between: twice continuously differentiable."""
    if s.real <= 0.0:
        return 0.0 * s
    if s.real >= 1.0:
        return 0.0 * s + 1.0
    return s * s * s * (10.0 - s * (15.0 - 6.0 * s))


@kernel(inner=True)
def at_most_one(E):
    """Curvature factors must not exceed 1 ([P], remark below 4.E14)."""
    if E.real > 1.0:
        return 0.0 * E + 1.0
    return 1.0 * E


@kernel(inner=True)
def cos_arctan(x):
    return 1.0 / sqrt(1.0 + x * x)


@kernel(inner=True)
def sin_twice_arctan(x):
    return 2.0 * x / (1.0 + x * x)


@kernel(borrow=True)
def curve(x, C, E):
    """C arctan(x - E (x - arctan x)): the argument of every sine and cosine of the Magic Formula."""
    return C * arctan(x - E * (x - arctan(x)))
