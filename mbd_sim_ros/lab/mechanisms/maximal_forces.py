"""Forces in maximal coordinates: springs, bushings, forces of coordinates, applied forces; compiled, on plain
arrays."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mbd_sim_ros.lab.mechanisms.maximal_reader import Law, Mechanism
from mbd_sim_ros.lab.mechanisms.maximal_rows import compiled, coordinate, cross, dot, point, turn


def tables(mechanism: Mechanism) -> tuple[np.ndarray, ...]:
    """The arrays that forces() takes, of a mechanism that was read."""
    springs, bushings, own, applied = (
        mechanism.springs,
        mechanism.bushings,
        mechanism.coordinate_forces,
        mechanism.applied,
    )
    laws: list[Law] = [law for s in springs for law in s[4:]] + [law for f in own for law in f[3:]]
    longest = max((len(x) for x, _, _ in laws), default=2)
    table = np.zeros((len(laws), 3, longest))
    for k, law in enumerate(laws):
        for part, values in enumerate(law):
            table[k, part, : len(values)] = values
    return (
        _whole([(F.body, G.body) for F, G, *_ in springs], 2),
        _real([(*F.r, *G.r, free, preload) for F, G, free, preload, *_ in springs], 8),
        _whole([(F.body, G.body) for F, G, *_ in bushings], 2),
        _real([(*F.r, *G.r, *F.R.ravel(), *G.R.ravel(), *data) for F, G, data in bushings], 42),
        _whole([[c for c, _ in f[0]] + [-1] * (3 - len(f[0])) for f in own], 3),
        _real([[x for _, x in f[0]] + [0.0] * (3 - len(f[0])) + [f[1], f[2]] for f in own], 5),
        _whole([(marker.body, int(body)) for marker, body, *_ in applied], 2),
        _real([_of_applied(*a) for a in applied], 9),
        table,
        np.array([len(x) for x, _, _ in laws], np.int64),
    )


def _of_applied(marker, body, force, torque) -> Sequence[float]:
    if body:
        force, torque = marker.R @ force, marker.R @ torque
    return (*marker.r, *force, *torque)


def _whole(rows: Sequence[Sequence[int]], width: int) -> np.ndarray:
    return np.array(rows, np.int64).reshape(-1, width)


def _real(rows: Sequence[Sequence[float]], width: int) -> np.ndarray:
    return np.array(rows, float).reshape(-1, width)


@compiled
def of_law(table, n, x):
    """Value of a law at x: Hermite cubics between its points, straight lines beyond."""
    xs, ys, slopes = table[0], table[1], table[2]
    if x <= xs[0]:
        return ys[0] + slopes[0] * (x - xs[0])
    if x >= xs[n - 1]:
        return ys[n - 1] + slopes[n - 1] * (x - xs[n - 1])
    k = 0
    while x > xs[k + 1]:
        k += 1
    h = xs[k + 1] - xs[k]
    s = (x - xs[k]) / h
    a, b = (1 + 2 * s) * (1 - s) ** 2, s * (1 - s) ** 2
    return a * ys[k] + b * h * slopes[k] + (1 - a) * ys[k + 1] - s * s * (1 - s) * h * slopes[k + 1]


@compiled
def rotation_vector(R):
    """Rotation vector of a matrix, below half a turn."""
    w = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2.0
    s = math.sqrt(dot(w, w))
    c = (R[0, 0] + R[1, 1] + R[2, 2] - 1.0) / 2.0
    if s < 1e-9:
        return w
    return w * (math.atan2(s, c) / s)


@compiled
def moment(theta, m):
    """Inverse of the right Jacobian at a rotation vector, times m: m + theta x m / 2 + f theta x (theta x m)."""
    size = math.sqrt(dot(theta, theta))
    f = 1.0 / 12.0 + size * size / 720.0
    if size > 1e-3:
        f = 1.0 / size**2 - (1.0 + math.cos(size)) / (2.0 * size * math.sin(size))
    t = cross(theta, m)
    return m + 0.5 * t + f * cross(theta, t)


@compiled
def between(f, state, i, j, place, force, torque):
    """A force at a place and a torque, on j, and their opposites on i."""
    f[j, :3] += force
    f[j, 3:] += cross(place - state[1][j], force) + torque
    f[i, :3] -= force
    f[i, 3:] -= cross(place - state[1][i], force) + torque


@compiled
def forces(state, which, frames, before, tables):
    """Forces on centres of mass and torques (nb + 1, 6) along the world, without gravity."""
    s_bodies, s, b_bodies, b, c_terms, c, a_bodies, a, laws, counts = tables
    f = np.zeros((len(state[1]), 6))
    for k in range(len(s)):
        i, j = s_bodies[k]
        pF, vF, _, _ = point(state, i, s[k, 0:3])
        pG, vG, _, _ = point(state, j, s[k, 3:6])
        x = pG - pF
        length = math.sqrt(dot(x, x))
        n = x / length
        tension = of_law(laws[2 * k], counts[2 * k], length - s[k, 6]) + of_law(
            laws[2 * k + 1], counts[2 * k + 1], dot(n, vG - vF)
        )
        between(f, state, i, j, pG, -(tension + s[k, 7]) * n, np.zeros(3))
    for k in range(len(b)):
        i, j = b_bodies[k]
        pF, vF, _, _ = point(state, i, b[k, 0:3])
        pG, vG, _, _ = point(state, j, b[k, 3:6])
        R_WF = state[0][i] @ b[k, 6:15].copy().reshape(3, 3)
        R_WG = state[0][j] @ b[k, 15:24].copy().reshape(3, 3)
        to_F = R_WF.T.copy()
        d = turn(to_F, pG - pF)
        rate = turn(to_F, vG - vF - cross(state[3][i], pG - pF))
        spin = turn(to_F, state[3][j] - state[3][i])
        theta = rotation_vector(to_F @ R_WG)
        force = -(b[k, 24:27] * d + b[k, 30:33] * rate + b[k, 36:39])
        torque = -(moment(theta, b[k, 27:30] * theta + b[k, 39:42]) + b[k, 33:36] * spin)
        between(f, state, i, j, pG, turn(R_WF, force), turn(R_WF, torque))
    for k in range(len(c)):
        row = np.zeros((len(state[1]), 6))
        value, rate = -c[k, 3], 0.0
        for term in range(3):
            q = c_terms[k, term]
            if q >= 0:
                x, dx, _ = coordinate(state, row, which[q], frames[q], before[q], c[k, term])
                value += c[k, term] * x
                rate += c[k, term] * dx
        of = 2 * (len(s) + k)
        f += row * -(of_law(laws[of], counts[of], value) + of_law(laws[of + 1], counts[of + 1], rate) + c[k, 4])
    for k in range(len(a)):
        body, along_body = a_bodies[k]
        place, _, _, _ = point(state, body, a[k, 0:3])
        force, torque = a[k, 3:6], a[k, 6:9]
        if along_body:
            force, torque = turn(state[0][body], force), turn(state[0][body], torque)
        f[body, :3] += force
        f[body, 3:] += cross(place - state[1][body], force) + torque
    return f
