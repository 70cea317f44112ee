"""Checks that a specification makes of its own values: each refuses with one sentence that names element, field, value and limit."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from solver.compiled.portable import norm
from solver.errors import SpecError

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


def require(condition: bool, where: str, field: str, value: object, remedy: str) -> None:
    """Raise SpecError 'element X: field = value: remedy' unless the condition holds."""
    if not condition:
        raise SpecError(f'{where}: {field} = {value!r}: {remedy}')


def finite(where: str, field: str, value: object, *, low: float = -math.inf, high: float = math.inf, strict: bool = False) -> float:
    """Return value as float after checking that it is a finite number in [low, high] (open at low when strict)."""
    ok = isinstance(value, int | float | np.floating | np.integer) and not isinstance(value, bool) and math.isfinite(value)
    require(ok, where, field, value, 'must be a finite number')
    number = float(value)  # type: ignore[arg-type]
    inside = (number > low if strict else number >= low) and number <= high
    limit = f'{">" if strict else ">="} {low:g}' if math.isinf(high) else f'in {"(" if strict else "["}{low:g}, {high:g}]'
    require(inside, where, field, value, f'must be {limit}')
    return number


def vector(where: str, field: str, value: Sequence[float], length: int = 3) -> tuple[float, ...]:
    """Return value as a tuple of `length` finite floats."""
    require(
        isinstance(value, list | tuple | np.ndarray) and len(value) == length, where, field, value, f'must be a list of {length} numbers'
    )
    return tuple(finite(where, f'{field}[{i}]', x) for i, x in enumerate(value))


def unit_quaternion(where: str, field: str, value: Sequence[float]) -> Quaternion:
    """Return value normalised; refuses a norm further than 1e-3 from one."""
    q = np.array(vector(where, field, value, 4))
    n = norm(q)
    require(abs(n - 1.0) < 1e-3, where, field, value, 'must be a unit quaternion x y z w')
    x, y, z, w = q / n
    return (float(x), float(y), float(z), float(w))
