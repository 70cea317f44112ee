"""Maps: a law over one quantity at each of several values of another one, linear between these and constant beyond
them."""

from __future__ import annotations

from solver.compiled.kernel import kernel
from solver.elements.laws import evaluate_law


@kernel(inner=True)
def evaluate_map(laws, start, at, law, e, x, v):
    """(y, its slope over x, its slope over v) of map e, whose laws over x are law[start[e]:start[e + 1]] at the values
    `at` of v."""
    a = start[e]
    last = start[e + 1] - 1
    while a < last and v.real >= at[a + 1]:
        a += 1
    low, low_slope, _ = evaluate_law(laws, law[a], x)
    if a == last or v.real <= at[a]:
        return low, low_slope, 0.0 * v
    high, high_slope, _ = evaluate_law(laws, law[a + 1], x)
    width = at[a + 1] - at[a]
    t = (v - at[a]) / width
    return low + t * (high - low), low_slope + t * (high_slope - low_slope), (high - low) / width
