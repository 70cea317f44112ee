"""The road as it is drawn: a grid of metres that lies on it."""

from __future__ import annotations

import math

import numpy as np

from solver.compiled.by_reference import Ref
from solver.elements.curved_grid import CurvedGrid
from solver.elements.enveloping import Heights
from solver.elements.road import RoadSpec, compile_road, heights_at, interpolating
from solver.elements.road_grids import RandomRoad

BESIDE = 2  # nodes beyond the border to which a cubic spline feels what is inside


class Ground:
    """Heights of a road. flat: whether it is its base plane everywhere. plane: (z at the origin, slope along x, slope
    along y) of that."""

    def __init__(self, spec: RoadSpec) -> None:
        p, n = spec.point, spec.normal
        self.plane = (p[2] + (n[0] * p[0] + n[1] * p[1]) / n[2], -n[0] / n[2], -n[1] / n[2])
        self.flat = not spec.grids
        curved = [g for g in spec.grids if isinstance(g, CurvedGrid) and g.line is not None]
        others = [g for g in spec.grids if not any(g is one for one in curved)]
        splines = [interpolating((g.expand() if isinstance(g, RandomRoad) else g).heights) for g in others]
        self._splines = [(grid, np.pad(grid.height, BESIDE + 1, mode='edge')) for grid in splines]
        self._curved = Ref(compile_road(RoadSpec(grids=tuple(curved)))) if curved else None

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Heights [m] at places x, y [m] in the world: those of the solver (road_at), as wheels that touch them at a
        point feel them."""
        z = self.plane[0] + self.plane[1] * np.asarray(x, float) + self.plane[2] * np.asarray(y, float)
        for grid, coefficients in self._splines:
            z = z + _height(grid, coefficients, x, y)
        if self._curved is not None:
            across, along = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
            height = np.zeros(across.size)
            heights_at(self._curved, across.ravel(), along.ravel(), height)
            z = z + height.reshape(across.shape)
        return z

    def around(self, x: float, y: float, reach: int) -> np.ndarray:
        """(2, 2 reach + 1, 2 reach + 1, 3) points of the lines along x, and of those along y, at whole metres around a
        place [m]."""
        i, j = round(x) + np.arange(-reach, reach + 1), round(y) + np.arange(-reach, reach + 1)
        X, Y = np.meshgrid(i.astype(float), j.astype(float), indexing='ij')
        points = np.stack([X, Y, self.at(X, Y)], axis=-1)
        return np.stack([points.swapaxes(0, 1), points])

    def along(self, x: np.ndarray, y: np.ndarray, reach: int) -> np.ndarray:
        """(n, 3) all points at whole metres that are so near to a way through places x, y [m]."""
        way = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
        every = np.linspace(0.0, way[-1], math.ceil(way[-1]) + 1)  # instants may lie further apart
        cells = np.unique(
            np.round(np.column_stack([np.interp(every, way, x), np.interp(every, way, y)])).astype(int), axis=0
        )
        near = np.array([(i, j) for i in range(-reach, reach + 1) for j in range(-reach, reach + 1)])
        nodes = np.unique(np.concatenate([cells + one for one in near]), axis=0).astype(float)
        return np.column_stack([nodes, self.at(*nodes.T)])


def _height(grid: Heights, coefficients: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The spline whose coefficients stand at the nodes of a grid, continued by those of its border."""
    from scipy.ndimage import map_coordinates

    c, s = math.cos(grid.yaw), math.sin(grid.yaw)
    dx, dy = np.asarray(x, float) - grid.origin[0], np.asarray(y, float) - grid.origin[1]
    at = (c * dx + s * dy) / grid.step[0], (c * dy - s * dx) / grid.step[1]
    inside = [np.clip(u, -BESIDE, n - 1 + BESIDE) + BESIDE + 1 for u, n in zip(at, grid.height.shape, strict=True)]
    return map_coordinates(coefficients, inside, order=3, prefilter=False)
