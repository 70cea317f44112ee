"""Checks that a specification makes of its own values: each refuses with one sentence that names element, field, value
and limit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from solver.compiled.portable import norm
from solver.errors import SpecError

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


def require(condition: bool, where: str, field: str, value: object, remedy: str) -> None:
    """Raise SpecError 'element X: field = value: remedy' unless the condition holds."""
    if not condition:
        raise SpecError(f'{where}: {field} = {value!r}: {remedy}')


def finite(
    where: str, field: str, value: object, *, low: float = -math.inf, high: float = math.inf, strict: bool = False
) -> float:
    """Return value as float after checking that it is a finite number in [low, high] (open at low when strict)."""
    ok = (
        isinstance(value, int | float | np.floating | np.integer)
        and not isinstance(value, bool)
        and math.isfinite(value)
    )
    require(ok, where, field, value, 'must be a finite number')
    number = float(value)  # type: ignore[arg-type]
    inside = (number > low if strict else number >= low) and number <= high
    limit = (
        f'{">" if strict else ">="} {low:g}' if math.isinf(high) else f'in {"(" if strict else "["}{low:g}, {high:g}]'
    )
    limit = f'at most {high:g}' if math.isinf(low) else limit
    require(inside, where, field, value, f'must be {limit}')
    return number


def vector(where: str, field: str, value: Sequence[float], length: int = 3) -> tuple[float, ...]:
    """Return value as a tuple of `length` finite floats."""
    require(
        isinstance(value, list | tuple | np.ndarray) and len(value) == length,
        where,
        field,
        value,
        f'must be a list of {length} numbers',
    )
    return tuple(finite(where, f'{field}[{i}]', x) for i, x in enumerate(value))


def require_rising(where: str, field: str, values: Sequence[float], count: int = 1) -> None:
    """Check that there are at least so many finite numbers, each greater than the one before it. Raises SpecError."""
    require(len(values) >= count, where, field, values, f'needs at least {count} number{"s" if count > 1 else ""}')
    for k, value in enumerate(values):
        finite(where, f'{field}[{k}]', value)
    for k, (a, b) in enumerate(pairwise(values), start=1):
        require(b > a, where, f'{field}[{k}]', b, f'must be greater than the one before it ({a:g})')


def require_positions(where: str, pedals: Sequence[float]) -> None:
    """Check that positions of a pedal are between 0 and 1, as its input is. Raises SpecError."""
    for k, pedal in enumerate(pedals):
        require(
            0.0 <= pedal <= 1.0,
            where,
            f'pedals[{k}]',
            pedal,
            'must be in [0, 1]: a position of the pedal, not per cent',
        )


def require_grid(
    where: str, field: str, rows: Sequence[Sequence[float]], of: tuple[str, int], per: tuple[str, int]
) -> None:
    """Check that a table has a row for each of so many things and in it a finite number for each of others. Raises
    SpecError."""
    require(len(rows) == of[1], where, field, len(rows), f'must have one row for each of the {of[1]} {of[0]}')
    for k, row in enumerate(rows):
        require(
            len(row) == per[1],
            where,
            f'{field}[{k}]',
            len(row),
            f'must have one value for each of the {per[1]} {per[0]}',
        )
        for m, value in enumerate(row):
            finite(where, f'{field}[{k}][{m}]', value)


def unit_quaternion(where: str, field: str, value: Sequence[float]) -> Quaternion:
    """Return value normalised; refuses a norm further than 1e-3 from one."""
    q = np.array(vector(where, field, value, 4))
    n = norm(q)
    require(abs(n - 1.0) < 1e-3, where, field, value, 'must be a unit quaternion x y z w')
    x, y, z, w = q / n
    return (float(x), float(y), float(z), float(w))
