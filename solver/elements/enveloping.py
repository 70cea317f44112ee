"""The road that a tire makes of obstacles shorter than its contact patch: tandem elliptical cams on a grid of heights.

A rigid cam with the outline of the tire rolls over the profile and traces its basic curve; the tire feels the basic
curve through a patch of finite length and width, whose two ends follow it [Schmeitz2004], [Zegelaar1998]. All cams of a
patch, one behind the other and side by side, together make the effective road

    w(x, y) = mean of E over the base,    E(x, y) = max over s of h(x + s, y) - (b - b (1 - |s/a|^c)^(1/c)),

so that dw/dx is the slope between the front and the rear cam (the two-point follower), and dw/dy that between the outer
rows. It is computed once, when a model is compiled, and the step reads it like any other grid. The vertical spring
stands on w along the normal of the base plane: its force along the normal of w is then the gradient of a potential, and
an obstacle that is crossed gives back what it took. The base has the length and width at nominal load; the wheel rolls
along the x axis of the grid.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from solver.errors import SpecError

NODES_ALONG, NODES_ACROSS = 12, 6  # nodes of the effective road per length and width of the base
# nodes of an effective road, half a gigabyte as of MOST_NODES in curved_grid; ten times as many fit into no memory
LARGEST = 64_000_000
BLOCK = 4_000_000  # nodes that are computed at once, which takes ten times their memory
END = 0.98  # of half the length of a cam: its end is vertical


class Heights(NamedTuple):
    """Heights on a grid: origin (x, y) [m] and yaw [rad] in W, step (dx, dy) [m], height (n_x, n_y) [m]."""

    origin: tuple[float, float]
    step: tuple[float, float]
    yaw: float
    height: np.ndarray


class Footprint(NamedTuple):
    """Dimensions of a tire that envelops a road: its radius, length and width of the base, half axes and order of the
    cams; all lengths [m]."""

    radius: float
    length: float
    width: float
    cam_length: float
    cam_height: float
    order: float


class Edge(NamedTuple):
    """Place where a grid bends upwards most: curvature of the hollow [1/m], its node and place in W [m]."""

    curvature: float
    node: tuple[int, int]
    place: tuple[float, float]


def sharpest(grid: Heights) -> Edge:
    """The roundest hollow of a grid that is level beyond its border, by second differences; curvature 0 where there is
    none."""
    worst, node = 0.0, (0, 0)
    for axis, step in enumerate(grid.step):
        beside = [(1, 1) if k == axis else (0, 0) for k in range(2)]
        hollow = np.diff(np.pad(grid.height, beside, mode='edge'), 2, axis=axis) / step**2  # at every node
        if hollow.max() > worst:
            i, j = (int(k) for k in np.unravel_index(int(np.argmax(hollow)), hollow.shape))
            worst, node = float(hollow.max()), (i, j)
    a, b = node[0] * grid.step[0], node[1] * grid.step[1]
    c, s = math.cos(grid.yaw), math.sin(grid.yaw)
    return Edge(worst, node, (grid.origin[0] + a * c - b * s, grid.origin[1] + a * s + b * c))


def effective(grid: Heights, tire: Footprint, where: str) -> Heights:
    """The effective road of a grid, on a finer grid that reaches as far as an obstacle at its border does.

    Between its nodes the road is linear. where: what error sentences call it. Raises SpecError for more than LARGEST
    nodes.
    """
    raster = _raster(grid, tire)
    if raster.nodes > LARGEST:
        remedy = f'take a smaller grid, or contact: point ({_of(raster)})'
        raise SpecError(f'{where}: grids: the road that the tires make of it has {raster.nodes} nodes: {remedy}')
    n, m, fine, fine_y, along, across = raster
    columns = max(BLOCK // n, 1)
    if m <= columns:
        mean = _columns(grid, tire, raster, 0, m)
    else:
        mean = np.empty((n, m))
        # columns that the mean across a base reaches
        beside = math.ceil(0.5 * tire.width / fine_y) + 2 if across else 0
        for first in range(0, m, columns):
            last = min(first + columns, m)
            low = max(first - beside, 0)
            mean[:, first:last] = _columns(grid, tire, raster, low, min(last + beside, m))[:, first - low : last - low]
    c, s = math.cos(grid.yaw), math.sin(grid.yaw)
    a, b = along * fine, across * fine_y
    return Heights((grid.origin[0] - a * c + b * s, grid.origin[1] - a * s - b * c), (fine, fine_y), grid.yaw, mean)


class _Raster(NamedTuple):
    """Raster of an effective road: nodes along and across, steps [m], nodes before and beside the grid."""

    n: int
    m: int
    step: float
    step_across: float
    along: int
    across: int

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return self.n * self.m


def _raster(grid: Heights, tire: Footprint) -> _Raster:
    (rows, columns), (dx, dy) = grid.height.shape, grid.step
    fine = dx / math.ceil(dx * NODES_ALONG / tire.length)
    along = math.ceil((END * tire.cam_length + 0.5 * tire.length) / fine) + 2
    varies = bool(np.ptp(grid.height, axis=1).any())
    fine_y = dy / math.ceil(dy * NODES_ACROSS / tire.width) if varies else dy
    across = math.ceil(0.5 * tire.width / fine_y) + 2 if varies else 0
    n, m = round((rows - 1) * dx / fine) + 1 + 2 * along, round((columns - 1) * dy / fine_y) + 1 + 2 * across
    return _Raster(n, m, fine, fine_y, along, across)


def too_fine(grid: Heights, tire: Footprint) -> str:
    """Why the effective road of a grid is too large, as a sentence; '' where it is not."""
    raster = _raster(grid, tire)
    return (
        f'the road that the tires make of it would have {raster.nodes} nodes ({_of(raster)})'
        if raster.nodes > LARGEST
        else ''
    )


def _of(raster: _Raster) -> str:
    return f'at most {LARGEST} nodes of {1e3 * raster.step:.0f} mm x {1e3 * raster.step_across:.0f} mm'


def _columns(grid: Heights, tire: Footprint, raster: _Raster, first: int, last: int) -> np.ndarray:
    """(n, last - first) some columns of the effective road; those at the ends as if there were no more beyond them."""
    (dx, dy), count = grid.step, last - first
    height = grid.height
    if count == raster.m:
        height = _linear(height, raster.n, raster.along, raster.step / dx, 0)
        road = _linear(height, count, raster.across, raster.step_across / dy, 1)
    else:  # columns first: all of them along the road would be most of the memory
        height = _linear(height, count, raster.across - first, raster.step_across / dy, 1)
        road = _linear(height, raster.n, raster.along, raster.step / dx, 0)
    mean = _mean(_rolled(road, raster.step, tire), 0.5 * tire.length / raster.step, 0)
    return _mean(mean, 0.5 * tire.width / raster.step_across, 1) if raster.across else mean


def _linear(height: np.ndarray, count: int, before: int, ratio: float, axis: int) -> np.ndarray:
    """`count` values at (k - before) ratio along an axis, linear between the given ones and constant beyond them."""
    at = np.clip((np.arange(count) - before) * ratio, 0.0, height.shape[axis] - 1.0)
    low = np.minimum(at.astype(np.int64), height.shape[axis] - 2)
    part = np.expand_dims(at - low, 1 - axis)
    return np.take(height, low, axis) * (1.0 - part) + np.take(height, low + 1, axis) * part


def _rolled(road: np.ndarray, step: float, tire: Footprint) -> np.ndarray:
    """The basic curve along axis 0: how high the lowest point of a cam is that touches the road with its centre
    there."""
    reach = int(END * tire.cam_length / step)
    ends = [abs(k) * step / tire.cam_length for k in range(-reach, reach + 1)]
    drop = [tire.cam_height * (1.0 - math.pow(1.0 - math.pow(x, tire.order), 1.0 / tire.order)) for x in ends]
    count, rise = road.shape[0], float(np.ptp(road))
    padded = np.pad(road, ((reach, reach), (0, 0)), mode='edge')
    curve = road.copy()
    for k, fall in enumerate(drop):
        if fall < rise:
            np.maximum(curve, padded[k : k + count] - fall, out=curve)
    return curve


def _mean(values: np.ndarray, half: float, axis: int) -> np.ndarray:
    """Mean over `half` cells to either side along an axis, exact for values that are linear between the nodes."""
    v = np.moveaxis(values, axis, 0)
    whole, part = int(half), half - int(half)
    pad = whole + 2
    v = np.concatenate((np.repeat(v[:1], pad, 0), v, np.repeat(v[-1:], pad, 0)))
    cells = 0.5 * (v[1:] + v[:-1])
    total = np.concatenate((np.zeros_like(v[:1]), np.cumsum(cells, axis=0)))
    count = values.shape[axis]
    at = np.arange(pad, pad + count)
    right, left = at + whole, at - whole
    upper = total[right] + part * (v[right] + 0.5 * part * (v[right + 1] - v[right]))
    lower = total[left] - part * (v[left] + 0.5 * part * (v[left - 1] - v[left]))
    return np.moveaxis((upper - lower) / (2.0 * half), 0, axis)
