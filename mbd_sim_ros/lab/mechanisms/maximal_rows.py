"""Rows of constraints in maximal coordinates: value, rate, second derivative without accelerations, and gradient of
each.

Every row is made of points and vectors of bodies, each with its first and second derivative where no body accelerates
(w x r, w x (w x r)), and is derived by the rules of products. The gradient is that of the rate, by the velocity of a
centre and the angular velocity of a body, both along the world. The world is the body behind the last, at rest.
"""

from __future__ import annotations

import math

import numba
import numpy as np

# codes of rows, with what stands in their numbers
DOT = 0  # a . b: vector of the first body, of the second
ALONG = 1  # u . (G - F): vector of the first body, points of the second and the third
APART = 2  # |G - F| - length
COUPLED = 3  # sum of factor * coordinate - offset - signal
HEIGHT = 4  # of the lowest point of a disc above a plane
SLIP = 5  # of the disc at this point, along a vector of the plane; not holonomic
BLADE = 6  # velocity of a point sideways; not holonomic
TWIST = 7  # a . b - c . d
WIDTH = 16  # numbers of a row

compiled = numba.njit(cache=True)


@compiled
def cross(a, b):
    out = np.empty(3)
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
    return out


@compiled
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def matrices(q):
    """Rotation matrices of unit quaternions xyzw, and the unit matrix of the world."""
    n = len(q)
    out = np.empty((n + 1, 3, 3))
    for b in range(n):
        x, y, z, w = q[b]
        out[b] = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
    out[n] = np.eye(3)
    return out


@compiled
def turn(R, local):
    """A vector of a body along the world."""
    out = np.empty(3)
    for i in range(3):
        out[i] = R[i, 0] * local[0] + R[i, 1] * local[1] + R[i, 2] * local[2]
    return out


@compiled
def vector(state, b, local):
    """A vector of a body and its two derivatives."""
    u = turn(state[0][b], local)
    du = cross(state[3][b], u)
    return u, du, cross(state[3][b], du)


@compiled
def point(state, b, local):
    """A point of a body, its two derivatives, and its arm from the centre of mass."""
    r, dr, ddr = vector(state, b, local)
    return state[1][b] + r, state[2][b] + dr, ddr, r


@compiled
def product(a, da, dda, b, db, ddb):
    """a . b and its two derivatives."""
    return dot(a, b), dot(da, b) + dot(a, db), dot(dda, b) + 2.0 * dot(da, db) + dot(a, ddb)


@compiled
def push(row, b, u, r, factor):
    """Add factor times the gradient of u . velocity of a point with the arm r."""
    row[b, :3] += factor * u
    row[b, 3:] += factor * cross(r, u)


@compiled
def push_dot(row, first, a, second, b, factor):
    """Add factor times the gradient of the rate of a . b."""
    t = factor * cross(a, b)
    row[first, 3:] += t
    row[second, 3:] -= t


@compiled
def along(state, row, u_body, u_local, F, rF, G, rG, factor):
    """u . (G - F), its derivatives, and factor times its gradient into the row."""
    u, du, ddu = vector(state, u_body, u_local)
    pF, vF, aF, armF = point(state, F, rF)
    pG, vG, aG, armG = point(state, G, rG)
    push(row, G, u, armG, factor)
    push(row, F, u, armF, -factor)
    row[u_body, 3:] += factor * cross(u, pG - pF)
    return product(u, du, ddu, pG - pF, vG - vF, aG - aF)


@compiled
def angle(state, row, F, G, frame, before, factor):
    """The turn of G about z of F, continued from `before`, its derivatives, and factor times its gradient."""
    x, y = turn(state[0][F], frame[0:3]), turn(state[0][F], frame[3:6])
    z, dz, _ = vector(state, F, frame[6:9])
    xG = turn(state[0][G], frame[9:12])
    value = math.atan2(dot(y, xG), dot(x, xG))
    value += 2.0 * math.pi * round((before - value) / (2.0 * math.pi))
    spin = state[3][G] - state[3][F]
    row[G, 3:] += factor * z
    row[F, 3:] -= factor * z
    return value, dot(z, spin), dot(dz, spin)


@compiled
def coordinate(state, row, which, frame, before, factor):
    """A joint coordinate (which: 0 rotation or 1 translation, bodies F and G), its derivatives, and its gradient."""
    if which[0] == 0:
        return angle(state, row, which[1], which[2], frame, before, factor)
    return along(state, row, which[1], frame[6:9], which[1], frame[12:15], which[2], frame[15:18], factor)


@compiled
def lowest(state, row, F, G, d):
    """Height of a disc over its plane with its derivatives and gradient; the direction to its lowest point and its
    rate."""
    n, dn, ddn = vector(state, F, d[0:3])
    a, da, dda = vector(state, G, d[3:6])
    c, dc, ddc = product(n, dn, ddn, a, da, dda)
    s = math.sqrt(1.0 - c * c)
    ds = -c * dc / s
    dds = -(dc * dc + c * ddc + ds * ds) / s
    push_dot(row, F, n, G, a, d[12] * c / s)
    h, dh, ddh = along(state, row, F, d[0:3], F, d[9:12], G, d[6:9], 1.0)
    w = n - c * a
    e = w / s
    de = (dn - dc * a - c * da) / s - w * (ds / (s * s))
    return h - d[12] * s, dh - d[12] * ds, ddh - d[12] * dds, -d[12] * e, -d[12] * de


@compiled
def slip(state, row, F, G, d):
    """Velocity of the disc over the plane at its lowest point along a vector of the plane, and its derivative."""
    spare = np.zeros_like(row)
    _, _, _, r, dr = lowest(state, spare, F, G, d)
    u, du, _ = vector(state, F, d[13:16])
    centre, dcentre, ddcentre, arm = point(state, G, d[6:9])
    wF, wG = state[3][F], state[3][G]
    from_F, dfrom_F = centre + r - state[1][F], dcentre + dr - state[2][F]
    V = dcentre + cross(wG, r) - state[2][F] - cross(wF, from_F)
    dV = ddcentre + cross(wG, dr) - cross(wF, dfrom_F)
    push(row, G, u, arm + r, 1.0)
    push(row, F, u, from_F, -1.0)
    return dot(u, V), dot(du, V) + dot(u, dV)


@compiled
def blade(state, row, F, G, d):
    """Velocity of a point of G over F along a vector of G, and its derivative."""
    u, du, _ = vector(state, G, d[0:3])
    p, dp, ddp, arm = point(state, G, d[3:6])
    wF = state[3][F]
    from_F = p - state[1][F]
    V = dp - state[2][F] - cross(wF, from_F)
    dV = ddp - cross(wF, dp - state[2][F])
    push(row, G, u, arm, 1.0)
    push(row, F, u, from_F, -1.0)
    return dot(u, V), dot(du, V) + dot(u, dV)


@compiled
def all_rows(state, codes, numbers, which, frames, before, signals):
    """Values (those of rows that are not holonomic are 0), rates, second derivatives, and gradients (rows, nb + 1, 6).

    before: values of the coordinates near which their angles are continued. signals: (n, 3) value, rate and
    acceleration.
    """
    m = len(codes)
    gradient = np.zeros((m, len(state[1]), 6))
    out = np.zeros((3, m))
    for k in range(m):
        code, F, G, d, row = codes[k, 0], codes[k, 1], codes[k, 2], numbers[k], gradient[k]
        if code in (DOT, TWIST):
            for part in range(2 if code == TWIST else 1):
                factor = 1.0 - 2.0 * part
                a, da, dda = vector(state, F, d[6 * part : 6 * part + 3])
                b, db, ddb = vector(state, G, d[6 * part + 3 : 6 * part + 6])
                push_dot(row, F, a, G, b, factor)
                value, rate, second = product(a, da, dda, b, db, ddb)
                out[0, k] += factor * value
                out[1, k] += factor * rate
                out[2, k] += factor * second
        elif code == ALONG:
            out[0, k], out[1, k], out[2, k] = along(state, row, F, d[0:3], G, d[3:6], codes[k, 3], d[6:9], 1.0)
        elif code == APART:
            pF, vF, aF, armF = point(state, F, d[0:3])
            pG, vG, aG, armG = point(state, G, d[3:6])
            x, v = pG - pF, vG - vF
            length = math.sqrt(dot(x, x))
            n = x / length
            push(row, G, n, armG, 1.0)
            push(row, F, n, armF, -1.0)
            rate = dot(n, v)
            out[0, k], out[1, k], out[2, k] = length - d[6], rate, (dot(v, v) - rate * rate) / length + dot(n, aG - aF)
        elif code == COUPLED:
            out[0, k] = -d[4]
            for term in range(3):
                c = codes[k, 1 + term]
                if c >= 0:
                    value, rate, second = coordinate(state, row, which[c], frames[c], before[c], d[term])
                    out[0, k] += d[term] * value
                    out[1, k] += d[term] * rate
                    out[2, k] += d[term] * second
            if codes[k, 4] >= 0:
                out[:, k] -= signals[codes[k, 4]]
        elif code == HEIGHT:
            out[0, k], out[1, k], out[2, k], _, _ = lowest(state, row, F, G, d)
        elif code == SLIP:
            out[1, k], out[2, k] = slip(state, row, F, G, d)
        else:
            out[1, k], out[2, k] = blade(state, row, F, G, d)
    return out[0], out[1], out[2], gradient
