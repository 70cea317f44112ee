"""Stage and end of a step: their configurations and velocities for an end acceleration, and the momentum residual."""

from __future__ import annotations

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.so3 import (
    matrix_of_quaternion,
    quaternion_corrected,
    quaternion_exp,
    quaternion_product,
    right_jacobian,
)
from solver.compiled.vec import load33, mv, scale, store33

AT_END, BOTH, WITH_TANGENTS = map(np.int64, range(3))  # what place assigns; not literals, for one compilation


@kernel(inner=True)
def copy_rows(source, target):
    """target <- source, (n, 6); borrowing kernels cannot assign array to array."""
    for b in range(source.shape[0]):
        for i in range(source.shape[1]):
            target[b, i] = source[b, i]


@kernel(inner=True)
def copy_blocks(source, target):
    """target <- source, (n, 6, 6)."""
    for b in range(source.shape[0]):
        for i in range(6):
            for j in range(6):
                target[b, i, j] = source[b, i, j]


@kernel(inline=True)
def largest(x, b):
    """The largest magnitude in row b of x (n, 6)."""
    first = max(abs(x[b, 0]), abs(x[b, 1]))
    second = max(abs(x[b, 2]), abs(x[b, 3]))
    third = max(abs(x[b, 4]), abs(x[b, 5]))
    return max(first, second, third)


@kernel(inline=True)
def largest_by_length(x, b, length):
    """The largest magnitude in row b of x (n, 6), of angular numbers times a length."""
    furthest = max(abs(x[b, 0]), abs(x[b, 1]), abs(x[b, 2]))
    return max(furthest, length * largest_turn(x, b))


@kernel(inline=True)
def largest_turn(x, b):
    """The largest magnitude among the angular numbers in row b of x (n, 6)."""
    return max(abs(x[b, 3]), abs(x[b, 4]), abs(x[b, 5]))


@kernel(inner=True)
def fastest_turn(s, n):
    """Largest angular velocity [rad/s] of the first n bodies."""
    most = 0.0
    for b in range(n):
        x, y, z = s.v[b, 3], s.v[b, 4], s.v[b, 5]
        most = max(most, x * x + y * y + z * z)
    return most**0.5


@kernel(inline=True)
def is_row_finite(x, b):
    """True where row b of x (n, 6) is finite."""
    return np.isfinite((x[b, 0] + x[b, 1]) + (x[b, 2] + x[b, 3]) + (x[b, 4] + x[b, 5]))


@kernel(borrow=True)
def place(tables, c, s0, a1, q1, what, work):
    """Assign q1 and the kinematics of the end for the end acceleration a1; those of the stage unless `what` is AT_END,
    and both rotation tangents when it is WITH_TANGENTS.
    """
    h = c.h
    s = 1.0 - c.af
    for b in range(tables.bodies.mass.shape[0]):
        k0 = h * h * (0.5 - c.beta)
        k1 = h * h * c.beta
        for i in range(3):
            d = h * s0.v[b, i] + k0 * s0.a[b, i] + k1 * a1[b, i]
            q1[b, i] = s0.q[b, i] + d
            work.kin_end.p[b, i] = q1[b, i]
            if what != AT_END:
                work.kin_stage.p[b, i] = s0.q[b, i] + s * d
        x = (
            h * s0.v[b, 3] + k0 * s0.a[b, 3] + k1 * a1[b, 3],
            h * s0.v[b, 4] + k0 * s0.a[b, 4] + k1 * a1[b, 4],
            h * s0.v[b, 5] + k0 * s0.a[b, 5] + k1 * a1[b, 5],
        )
        xs = scale(s, x)
        quaternion = (s0.q[b, 3], s0.q[b, 4], s0.q[b, 5], s0.q[b, 6])
        end = quaternion_corrected(quaternion_product(quaternion, quaternion_exp(x)))
        q1[b, 3] = end[0]
        q1[b, 4] = end[1]
        q1[b, 5] = end[2]
        q1[b, 6] = end[3]
        store33(work.kin_end.R, b, matrix_of_quaternion(end))
        if what != AT_END:
            stage = quaternion_corrected(quaternion_product(quaternion, quaternion_exp(xs)))
            store33(work.kin_stage.R, b, matrix_of_quaternion(stage))
        if what == WITH_TANGENTS:
            store33(work.T_end, b, right_jacobian(x))
            store33(work.T_stage, b, right_jacobian(xs))
        for i in range(6):
            v1 = s0.v[b, i] + h * ((1.0 - c.gamma) * s0.a[b, i] + c.gamma * a1[b, i])
            work.kin_end.v[b, i] = v1
            if what != AT_END:
                work.kin_stage.v[b, i] = s * v1 + c.af * s0.v[b, i]


@kernel(inner=True)
def momentum_residual(tables, c, a0, a1, f, r):
    """r = M ((1 - am) a1 + am a0) - f."""
    bodies = tables.bodies
    late = 1.0 - c.am
    for b in range(bodies.mass.shape[0]):
        mass = bodies.mass[b]
        J = load33(bodies.inertia, b)
        change = mv(
            J, (late * a1[b, 3] + c.am * a0[b, 3], late * a1[b, 4] + c.am * a0[b, 4], late * a1[b, 5] + c.am * a0[b, 5])
        )
        force = (f[b, 0], f[b, 1], f[b, 2])
        torque = (f[b, 3], f[b, 4], f[b, 5])
        momentum = (
            late * a1[b, 0] + c.am * a0[b, 0],
            late * a1[b, 1] + c.am * a0[b, 1],
            late * a1[b, 2] + c.am * a0[b, 2],
        )
        for i in range(3):
            r[b, i] = mass * momentum[i] - force[i]
            r[b, 3 + i] = change[i] - torque[i]
