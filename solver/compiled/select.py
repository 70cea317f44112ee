"""Choices without a branch: for kernels that step several simulations at once, in which lanes may choose otherwise.

`where(condition, a, b)` is `a if condition else b`, with both computed. `some(condition)` guards what is only worth its
time if a condition is true: of a single number the condition itself, of lanes true where one of them says so. Behind it
the others have to be right too, so `where` follows.
"""

from __future__ import annotations

from numba import types
from numba.extending import overload


def where(condition, a, b):
    """a where the condition is true, else b; lane by lane."""
    return a if condition else b


@overload(where)
def _where_overload(condition, a, b):
    return (lambda condition, a, b: a if condition else b) if isinstance(condition, types.Boolean) else None


def some(condition):
    """The condition; of lanes, true where it is so in one of them."""
    return condition


@overload(some)
def _some_overload(condition):
    return (lambda condition: condition) if isinstance(condition, types.Boolean) else None
