"""Maps: a law over one quantity at each of several values of another one, linear between these and constant beyond them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from solver.compiled.kernel import kernel
from solver.elements.laws import evaluate_law
from solver.validate import finite, require


def require_rising(where: str, field: str, values: Sequence[float], count: int = 1) -> None:
    """Check that there are at least so many finite numbers, each greater than the one before it. Raises SpecError."""
    require(len(values) >= count, where, field, values, f'needs at least {count} number{"s" if count > 1 else ""}')
    for k, value in enumerate(values):
        finite(where, f'{field}[{k}]', value)
    for k, (a, b) in enumerate(pairwise(values), start=1):
        require(b > a, where, f'{field}[{k}]', b, f'must be greater than the one before it ({a:g})')


def require_grid(where: str, field: str, rows: Sequence[Sequence[float]], of: tuple[str, int], per: tuple[str, int]) -> None:
    """Check that a table has a row for each of so many things and in it a finite number for each of others. Raises SpecError."""
    require(len(rows) == of[1], where, field, len(rows), f'must have one row for each of the {of[1]} {of[0]}')
    for k, row in enumerate(rows):
        require(len(row) == per[1], where, f'{field}[{k}]', len(row), f'must have one value for each of the {per[1]} {per[0]}')
        for m, value in enumerate(row):
            finite(where, f'{field}[{k}][{m}]', value)


@kernel(inner=True)
def evaluate_map(laws, start, at, law, e, x, v):
    """(y, its slope over x, its slope over v) of map e, whose laws over x are law[start[e]:start[e + 1]] at the values `at` of v."""
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
