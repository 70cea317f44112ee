"""Elementary functions of arrays with the bits of the C library on every processor.

numpy computes sin, cos, exp, log, power and others of arrays with vector instructions where a processor has them, and
their last bits are not those of the C library. Numbers that enter a run are therefore computed here, number by number,
by the functions that the compiled kernels call too (docs/decisions/0008-same-bits-on-every-processor.md). For a single
number take those of `math`.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np


def sin(x: np.ndarray) -> np.ndarray:
    """sin of every number of x [rad]."""
    return _each(math.sin, x)


def cos(x: np.ndarray) -> np.ndarray:
    """cos of every number of x [rad]."""
    return _each(math.cos, x)


def exp(x: np.ndarray) -> np.ndarray:
    """exp of every number of x."""
    return _each(math.exp, x)


def _each(function: Callable[[float], float], x: np.ndarray) -> np.ndarray:
    x = np.asarray(x, float)
    return np.fromiter(map(function, x.ravel().tolist()), float, x.size).reshape(x.shape)
