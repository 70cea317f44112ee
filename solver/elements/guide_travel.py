"""Springs and dampers of a guide: forces over the travels of its wheels (solver.elements.guide)."""

from __future__ import annotations

from solver.compiled.kernel import kernel
from solver.elements.laws import evaluate_law

# N: from a change of the force of a damper on its mount as small as this on, Newton leaves rounding alone
YIELDING = 1e-4


@kernel(inner=True)
def coupling(c, s, o):
    """(energy, by s, by o, by s s, by s o, by o o) of the coupling of both travels."""
    sum_, square, prod = s + o, s * s + o * o, s * o
    g = c[0] + c[1] * sum_ + c[2] * square + c[3] * prod
    g_s, g_o = c[1] + 2.0 * c[2] * s + c[3] * o, c[1] + 2.0 * c[2] * o + c[3] * s
    g_2 = 2.0 * c[2]
    return (
        prod * g, o * g + prod * g_s, s * g + prod * g_o,
        2.0 * o * g_s + prod * g_2, g + s * g_s + o * g_o + prod * c[3], 2.0 * s * g_o + prod * g_2,
    )  # fmt: skip


@kernel(inline=True)
def cubic(a, s):
    """(value, slope, curvature) of a[0] s + a[1] s^2 + a[2] s^3."""
    return s * (a[0] + s * (a[1] + s * a[2])), a[0] + s * (2.0 * a[1] + s * (3.0 * a[2])), 2.0 * a[1] + s * (6.0 * a[2])


@kernel(inner=True)
def _yielding(laws, k, rate, zp, cz, law):
    """(w, force, its slope over the rate, rate of the damper) on a mount k: w = zp + cz (rate - law(k w)), by Newton's
    iteration."""
    w = zp + 0.0 * rate
    x, slope, _ = evaluate_law(laws, law, k * w)
    if cz > 0.0:
        for _ in range(8):
            change = (w + cz * (x - rate) - zp) / (1.0 + cz * k * slope)
            w = w - change
            if k * abs(change.real) < YIELDING:
                x = x - slope * (k * change)  # as good as the law itself over so small a change
                break
            x, slope, _ = evaluate_law(laws, law, k * w)
    return w, k * w, k * cz / (1.0 + cz * k * slope), x


@kernel(inner=True)
def damper_on_travel(table, laws, side, s, rate, other_rate, zp, cz):
    """(force on the travel, on that of the other wheel, its own by s, rise of the force over the rate of length, slope
    of the length over the travel, dissipation, energy, internal state)."""
    c, crossing = table.ratio[side], table.crossing[side]
    ratio = c[0] + s * (c[1] + s * (c[2] + s * (c[3] + s * c[4])))
    slope = c[1] + s * (2.0 * c[2] + s * (3.0 * c[3] + s * 4.0 * c[4]))
    way = ratio * rate + crossing * other_rate
    k = table.mount[side]
    if k > 0.0:
        w, force, rise, own = _yielding(laws, k, way, zp, cz, table.law[side, 2])
        heat, stored = force * own, 0.5 * k * w * w
    else:
        force, rise, _ = evaluate_law(laws, table.law[side, 1], way)
        w, heat = zp + 0.0 * rate, force * way
        stored = 0.0 * heat
    return -ratio * force, -crossing * force, -slope * (force + ratio * rate * rise), rise, ratio, heat, stored, w
