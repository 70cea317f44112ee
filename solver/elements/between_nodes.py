"""Distance of the smooth surface of a road from the one that is bilinear between its nodes, as ASAM's OpenCRG library
has it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.elements.enveloping import BLOCK, Heights
from solver.elements.road import interpolating

ALIKE = 24  # nodes beyond a place that its spline still depends on, by 0.27^24 = 2e-14 of their height


class Departure(NamedTuple):
    """Largest departure of the surface of a grid from the one that is bilinear between its nodes: distance [m], and the
    node behind which it is."""

    distance: float
    node: tuple[int, int]


def _middle(c: np.ndarray) -> np.ndarray:
    """The spline with coefficients c (n + 2, m) in the middle between its n nodes, along axis 0."""
    return (c[:-3] + 23.0 * c[1:-2] + 23.0 * c[2:-1] + c[3:]) / 48.0


def _at_nodes(c: np.ndarray) -> np.ndarray:
    """The same at the nodes."""
    return (c[:-2] + 4.0 * c[1:-1] + c[2:]) / 6.0


def from_bilinear(grid: Heights) -> Departure:
    """Looked for in the middle of the cells and of their edges, some rows at a time."""
    worst, (rows, columns) = Departure(0.0, (0, 0)), grid.height.shape
    block = max(BLOCK // columns, 1)
    for first in range(0, rows - 1, block):
        low, last = max(first - ALIKE, 0), min(first + block, rows - 1)
        h = grid.height[low : min(last + 1 + ALIKE, rows)].astype(float)
        c = interpolating(grid._replace(height=h)).height
        along, across = 0.5 * (h[1:] + h[:-1]), 0.5 * (h[:, 1:] + h[:, :-1])
        middles = _middle(c)
        apart = (
            _at_nodes(middles.T).T - along,
            _middle(_at_nodes(c).T).T - across,
            _middle(middles.T).T - 0.5 * (along[:, 1:] + along[:, :-1]),
        )
        for found in apart:
            part = np.abs(found[first - low : last - low])
            i, j = (int(k) for k in np.unravel_index(int(np.argmax(part)), part.shape))
            if part[i, j] > worst.distance:
                worst = Departure(float(part[i, j]), (first + i, j))
    return worst
