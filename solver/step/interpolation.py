"""Inputs inside an interval of the grid: prescribed motions by the quintic through both ends, all others as they are in
the interval."""

from __future__ import annotations

from solver.compiled.kernel import kernel


@kernel(borrow=True)
def inputs_inside(motion, T, before, now, x, u):
    """Assign u (nu,), the inputs at the fraction x of an interval of T [s]; before, now (nu,): those of the interval
    before and of this.

    motion (n, 3): value, rate and acceleration of the prescribed motions among the inputs.
    """
    for i in range(now.shape[0]):
        u[i] = now[i]
    for k in range(motion.shape[0]):
        value, rate, acceleration = motion[k, 0], motion[k, 1], motion[k, 2]
        p0, v0, a0 = before[value], T * before[rate], T * T * before[acceleration]
        p1, v1, a1 = now[value], T * now[rate], T * T * now[acceleration]
        d, dv, da = p1 - p0 - v0 - 0.5 * a0, v1 - v0 - a0, a1 - a0
        c3, c4, c5 = 10.0 * d - 4.0 * dv + 0.5 * da, -15.0 * d + 7.0 * dv - da, 6.0 * d - 3.0 * dv + 0.5 * da
        u[value] = p0 + x * (v0 + x * (0.5 * a0 + x * (c3 + x * (c4 + x * c5))))
        u[rate] = (v0 + x * (a0 + x * (3.0 * c3 + x * (4.0 * c4 + x * 5.0 * c5)))) / T
        u[acceleration] = (a0 + x * (6.0 * c3 + x * (12.0 * c4 + x * 20.0 * c5))) / (T * T)
