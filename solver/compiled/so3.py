"""Rotations: exponential, logarithm, right-trivialised tangent operator; quaternions are xyzw.

Formulas: [Sola2018], eqs. 131-146. Smooth in the argument and valid for complex arguments (complex-step derivatives),
so series are chosen by the real part.
"""

from __future__ import annotations

import numpy as np
from numba import types
from numba.extending import overload

from solver.compiled.by_reference import FieldType
from solver.compiled.kernel import kernel
from solver.compiled.vec import add, cross, cross_cross, dot, madd, mscale, scale, skew

_IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
_SERIES_BELOW = 1e-2  # x^2 below which the power series (four terms) are exact to double precision


@kernel(inline=True)
def _coefficients(x):
    """Return sin(t)/t, (1-cos t)/t^2, (t - sin t)/t^3 with t = |x|."""
    s = dot(x, x)
    if s.real < _SERIES_BELOW:
        a = 1.0 + s * (-1.0 / 6.0 + s * (1.0 / 120.0 + s * (-1.0 / 5040.0 + s * (1.0 / 362880.0))))
        b = 0.5 + s * (-1.0 / 24.0 + s * (1.0 / 720.0 + s * (-1.0 / 40320.0 + s * (1.0 / 3628800.0))))
        c = 1.0 / 6.0 + s * (-1.0 / 120.0 + s * (1.0 / 5040.0 + s * (-1.0 / 362880.0 + s * (1.0 / 39916800.0))))
    else:
        t = np.sqrt(s)
        a = np.sin(t) / t
        b = (1.0 - np.cos(t)) / s
        c = (1.0 - a) / s
    return a, b, c


@kernel(inline=True, inner=False)
def exp(x):
    """Rotation matrix of the rotation vector x [rad]."""
    a, b, _ = _coefficients(x)
    return madd(_IDENTITY, madd(mscale(a, skew(x)), mscale(b, cross_cross(x, x))))


@kernel(inline=True, inner=False)
def right_jacobian(x):
    """T(x) with exp(x + dx) = exp(x) exp(T(x) dx) to first order."""
    _, b, c = _coefficients(x)
    return madd(_IDENTITY, madd(mscale(-b, skew(x)), mscale(c, cross_cross(x, x))))


@kernel(inline=True, inner=False)
def inverse_jacobian_coefficients(s):
    """Return e and de/ds of the inverse right Jacobian 1 + skew(x)/2 + e skew(x)^2, where s = |x|^2 < (2 pi)^2.

    With t = |x| and c = t/2 cot(t/2): e = (1 - c)/s and s dc/ds = (c - c^2 - s/4)/2. Series: e = sum |B_2n|
    s^(n-1)/(2n)!
    """
    if s.real < 0.25:
        b1, b2, b3, b4 = 1.0 / 12.0, 1.0 / 720.0, 1.0 / 30240.0, 1.0 / 1209600.0
        b5, b6, b7, b8 = 1.0 / 47900160.0, 691.0 / 1307674368000.0, 1.0 / 74724249600.0, 3617.0 / 10670622842880000.0
        return (
            b1 + s * (b2 + s * (b3 + s * (b4 + s * (b5 + s * (b6 + s * (b7 + s * b8)))))),
            b2 + s * (2.0 * b3 + s * (3.0 * b4 + s * (4.0 * b5 + s * (5.0 * b6 + s * (6.0 * b7 + s * 7.0 * b8))))),
        )
    t = np.sqrt(s)
    c = 0.5 * t / np.tan(0.5 * t)
    return (1.0 - c) / s, (0.5 * c * (1.0 + c) + 0.125 * s - 1.0) / (s * s)


@kernel(borrow=True)
def right_jacobian_inverse(x):
    """Inverse of right_jacobian(x); its transpose is the inverse left Jacobian."""
    e, _ = inverse_jacobian_coefficients(dot(x, x))
    return madd(_IDENTITY, madd(mscale(0.5, skew(x)), mscale(e, cross_cross(x, x))))


@kernel(borrow=True)
def log(m):
    """Rotation vector [rad] of a rotation matrix, shortest turn; smooth up to |angle| < pi."""
    return log_quaternion(quaternion_of_matrix(m))


@kernel(borrow=True)
def log_quaternion(q):
    """Rotation vector [rad] of a unit quaternion xyzw, shortest turn (|angle| <= pi)."""
    w = q[3]
    u = (q[0], q[1], q[2])
    if w.real < 0.0:
        w = -w
        u = scale(-1.0, u)
    s2 = dot(u, u)
    if s2.real < 1e-3:
        # 2 atan2(s, w)/s = 2/w (1 - r/3 + r^2/5 - ...) with r = s^2/w^2: to double precision, and without roots and
        # arctan
        r = s2 / (w * w)
        rr = r * r
        k = 2.0 / w * ((1.0 - r / 3.0) + rr * ((0.2 - r / 7.0) + rr * (1.0 / 9.0 - r / 11.0)))
    else:
        s = np.sqrt(s2)
        k = 4.0 * np.arctan(s / (w + np.sqrt(w * w + s2))) / s
    return scale(k, u)


@kernel(borrow=True)
def quaternion_exp(x):
    """Unit quaternion xyzw of the rotation vector x [rad]."""
    s = dot(x, x)
    if s.real < _SERIES_BELOW:
        h = 0.25 * s
        k = 0.5 + h * (-1.0 / 12.0 + h * (1.0 / 240.0 + h * (-1.0 / 10080.0 + h * (1.0 / 725760.0))))
        w = 1.0 + h * (-0.5 + h * (1.0 / 24.0 + h * (-1.0 / 720.0 + h * (1.0 / 40320.0 + h * (-1.0 / 3628800.0)))))
    else:
        t = np.sqrt(s)
        k = np.sin(0.5 * t) / t
        w = np.cos(0.5 * t)
    return (k * x[0], k * x[1], k * x[2], w)


@kernel(inline=True, inner=False)
def quaternion_product(a, b):
    """Hamilton product a b of quaternions xyzw: rotation b first, then a."""
    u = (a[0], a[1], a[2])
    w = (b[0], b[1], b[2])
    r = add(add(scale(a[3], w), scale(b[3], u)), cross(u, w))
    return (r[0], r[1], r[2], a[3] * b[3] - dot(u, w))


@kernel(inline=True, inner=False)
def quaternion_normalized(q):
    """q at unit length."""
    n = 1.0 / np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return (n * q[0], n * q[1], n * q[2], n * q[3])


@kernel(inline=True, inner=False)
def quaternion_corrected(q):
    """q back at unit length after rounding alone has moved it, 1/|q| to first order (without the latency of a root and
    a division)."""
    n = 1.5 - 0.5 * ((q[0] * q[0] + q[1] * q[1]) + (q[2] * q[2] + q[3] * q[3]))
    return (n * q[0], n * q[1], n * q[2], n * q[3])


@kernel(inline=True, inner=False)
def matrix_of_quaternion(q):
    """Rotation matrix of a unit quaternion xyzw."""
    x, y, z, w = q
    return (
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w),
        2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w),
        2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y),
    )  # fmt: skip


@kernel(borrow=True)
def quaternion_of_matrix(m):
    """Unit quaternion xyzw (w >= 0) of a rotation matrix, by Shepperd's largest-pivot rule."""
    t = m[0] + m[4] + m[8]
    if t.real > 0.0:
        s = 2.0 * np.sqrt(1.0 + t)
        return ((m[7] - m[5]) / s, (m[2] - m[6]) / s, (m[3] - m[1]) / s, 0.25 * s)
    if m[0].real >= m[4].real and m[0].real >= m[8].real:
        s = 2.0 * np.sqrt(1.0 + m[0] - m[4] - m[8])
        q = (0.25 * s, (m[1] + m[3]) / s, (m[2] + m[6]) / s, (m[7] - m[5]) / s)
    elif m[4].real >= m[8].real:
        s = 2.0 * np.sqrt(1.0 + m[4] - m[0] - m[8])
        q = ((m[1] + m[3]) / s, 0.25 * s, (m[5] + m[7]) / s, (m[2] - m[6]) / s)
    else:
        s = 2.0 * np.sqrt(1.0 + m[8] - m[0] - m[4])
        q = ((m[2] + m[6]) / s, (m[5] + m[7]) / s, 0.25 * s, (m[3] - m[1]) / s)
    if q[3].real < 0.0:
        return (-q[0], -q[1], -q[2], -q[3])
    return q


def arctan2(s, c):
    """Angle [rad] of the direction (c, s); of complex numbers exact to first order in the imaginary part."""
    raw = np.arctan2(s.real, c.real)
    ca, sa = np.cos(raw), np.sin(raw)
    return raw + (s * ca - c * sa) / (c * ca + s * sa)


@overload(arctan2)
def _arctan2_of_type(s, c):
    return (lambda s, c: np.arctan2(s, c)) if s is types.float64 or isinstance(s, FieldType) else arctan2  # noqa: PLW0108
