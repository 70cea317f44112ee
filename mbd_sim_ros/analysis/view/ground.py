"""The road as it is drawn: a grid of metres that lies on it."""

from __future__ import annotations

import math

import numpy as np

from solver.elements.road import Heights, RoadSpec
from solver.elements.road_grids import RandomRoad


class Ground:
    """Heights of a road. flat: whether it is its base plane everywhere. plane: (z at the origin, slope along x, slope along y) of that."""

    def __init__(self, spec: RoadSpec) -> None:
        p, n = spec.point, spec.normal
        self.plane = (p[2] + (n[0] * p[0] + n[1] * p[1]) / n[2], -n[0] / n[2], -n[1] / n[2])
        self.flat = not spec.grids
        self._grids = [(g.expand() if isinstance(g, RandomRoad) else g).heights for g in spec.grids]

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Heights [m] at places x, y [m] in the world: between the nodes of a grid on straight lines, beyond it as at its border."""
        z = self.plane[0] + self.plane[1] * np.asarray(x, float) + self.plane[2] * np.asarray(y, float)
        for grid in self._grids:
            z = z + _height(grid, x, y)
        return z

    def around(self, x: float, y: float, reach: int) -> np.ndarray:
        """(2, 2 reach + 1, 2 reach + 1, 3) points of the lines along x, and of those along y, at whole metres around a place [m]."""
        i, j = round(x) + np.arange(-reach, reach + 1), round(y) + np.arange(-reach, reach + 1)
        X, Y = np.meshgrid(i.astype(float), j.astype(float), indexing='ij')
        points = np.stack([X, Y, self.at(X, Y)], axis=-1)
        return np.stack([points.swapaxes(0, 1), points])

    def along(self, x: np.ndarray, y: np.ndarray, reach: int) -> np.ndarray:
        """(n, 3) all points at whole metres that are so near to a way through places x, y [m]."""
        way = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
        every = np.linspace(0.0, way[-1], math.ceil(way[-1]) + 1)  # instants may lie further apart
        cells = np.unique(np.round(np.column_stack([np.interp(every, way, x), np.interp(every, way, y)])).astype(int), axis=0)
        near = np.array([(i, j) for i in range(-reach, reach + 1) for j in range(-reach, reach + 1)])
        nodes = np.unique(np.concatenate([cells + one for one in near]), axis=0).astype(float)
        return np.column_stack([nodes, self.at(*nodes.T)])


def _height(grid: Heights, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    c, s = math.cos(grid.yaw), math.sin(grid.yaw)
    dx, dy = np.asarray(x, float) - grid.origin[0], np.asarray(y, float) - grid.origin[1]
    parts = []
    for along, step, n in ((c * dx + s * dy, grid.step[0], grid.height.shape[0]), (c * dy - s * dx, grid.step[1], grid.height.shape[1])):
        u = np.clip(along / step, 0.0, n - 1.0)
        k = np.minimum(u.astype(int), n - 2)
        parts.append((k, u - k))
    (i, u), (j, w) = parts
    h = grid.height
    return (1.0 - u) * ((1.0 - w) * h[i, j] + w * h[i, j + 1]) + u * ((1.0 - w) * h[i + 1, j] + w * h[i + 1, j + 1])
