"""The road: a plane, height grids on it, friction patches and friction maps.

height(x, y) = plane + sum of grids. A grid is interpolated by the uniform cubic B-spline through its nodes, so height,
normal and curvature are continuous; beyond its border it continues with constant height. Friction is a factor on the
peak friction of the tire: the product of the factors of all patches, each blended in smoothly over a strip of finite
width, and of all maps.

`road_at` runs on float64, complex128 and Dual (solver.compiled.dual), so slope and curvature enter every tangent
exactly.

The file is long because specification, table and kernels of one concept stand together (docs/contributing.md). What can
stand alone has its own file: road_grids.py (kinds of grids), curved_grid.py (reference lines), enveloping.py (the road
that a tire feels).
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from solver.compiled.by_reference import Ref
from solver.compiled.dual import sqrt
from solver.compiled.kernel import kernel
from solver.compiled.portable import norm, solve_tridiagonal
from solver.dimensions import Angle, Length, Place, Point
from solver.elements.curved_grid import MOST_NODES as MOST_CURVED
from solver.elements.curved_grid import NUMBERS, CurvedGrid, curve_of, on_line, weights
from solver.elements.enveloping import Edge, Footprint, Heights, effective, sharpest, too_fine
from solver.elements.marker import Spec
from solver.elements.road_grids import MOST_NODES, FrictionMap, HeightGrid, RandomRoad, RasterGrid
from solver.validate import Vector, finite, require, vector


@dataclass(frozen=True, kw_only=True)
class FrictionPatch:
    """A rectangle with another friction.

    center: (x, y) [m] in W. size: (length, width) [m] along the patch axes. yaw: of these axes [rad]. factor: on the
    peak friction of the tire [-]. blend: width of the strip, centred on the edge, over which the factor changes [m].
    The default follows from the length of the contact patch: over a sharp edge the friction of a tire changes by the
    share of its patch that is beyond the edge, over 106 mm ([Pacejka2012] table 9.1, 205/60 R15). A strip of 0.2 m has
    the same steepest slope.
    """

    center: Place
    size: Place
    factor: float
    yaw: Angle = 0.0
    blend: Length = 0.2

    def __post_init__(self) -> None:
        where = 'friction patch'
        object.__setattr__(self, 'center', vector(where, 'center', self.center, 2))
        object.__setattr__(self, 'size', vector(where, 'size', self.size, 2))
        for name, low in (('factor', 1e-3), ('blend', 1e-6), ('yaw', -np.inf)):
            object.__setattr__(self, name, finite(where, name, getattr(self, name), low=low))
        require(
            min(self.size) >= self.blend,
            where,
            'size',
            self.size,
            f'both sides must be at least the blend width {self.blend:g}',
        )


@dataclass(frozen=True, kw_only=True)
class RoadSpec(Spec):
    """The ground under the tires.

    point [m], normal: of the base plane, in W; the normal is normalised and must point upwards. friction: factor on the
    peak friction of the tires away from patches [-]. contact: how tires touch the grids. 'point': in the tangent plane
    below the wheel centre. 'enveloping': on an effective road, computed from the grid and the size of the tire
    (docs/tire.md), for wheels that roll along the x axis of the grid. 'auto': enveloping for grids with edges, i.e.
    with curvature above that of the wheels, else point. A grid that is too large to be enveloped is touched at a point
    too, and the run says so.
    """

    name: str = 'road'
    point: Point = (0.0, 0.0, 0.0)
    normal: Vector = (0.0, 0.0, 1.0)
    friction: float = 1.0
    patches: tuple[FrictionPatch, ...] = ()
    maps: tuple[FrictionMap, ...] = ()
    grids: tuple[HeightGrid | RasterGrid | CurvedGrid | RandomRoad, ...] = ()
    contact: Literal['auto', 'point', 'enveloping'] = 'auto'

    def __post_init__(self) -> None:
        self.set('point', vector(self.where, 'point', self.point))
        n = np.array(vector(self.where, 'normal', self.normal))
        length = norm(n)
        upwards = length > 0.0 and n[2] > 0.1 * length
        require(upwards, self.where, 'normal', self.normal, 'must point upwards (z component above 0.1 of its length)')
        self.set('normal', tuple(float(c) for c in n / length))
        self.set('friction', finite(self.where, 'friction', self.friction, low=1e-3))
        choices = ('auto', 'point', 'enveloping')
        require(self.contact in choices, self.where, 'contact', self.contact, f'must be one of {", ".join(choices)}')
        self.set('patches', tuple(self.patches))
        self.set('maps', tuple(self.maps))
        self.set('grids', tuple(self.grids))
        curved = [grid for grid in self.grids if isinstance(grid, CurvedGrid)]
        others = [grid for grid in (*self.grids, *self.maps) if not isinstance(grid, CurvedGrid)]
        for nodes, most in ((sum(g.nodes for g in others), MOST_NODES), (sum(g.nodes for g in curved), MOST_CURVED)):
            require(
                nodes <= most,
                self.where,
                'grids',
                f'{nodes:.3g} heights',
                f'must have {most} at most, all of them together',
            )


class RoadTable(NamedTuple):
    """The compiled road. Grids are concatenated: node (i, j) of grid g is spline[start[g] + i * shape[g, 1] + j].

    The first `heights` grids are heights, each with one node more on every side than in the RoadSpec. The others are
    friction factors. np: number of patches, ng: of grids, nl: of reference lines.
    """

    plane: np.ndarray  # (3,) height = plane[0] + plane[1] x + plane[2] y
    friction: np.ndarray  # (1,) factor away from patches [-]
    patch: np.ndarray  # (np, 8): x, y [m], cos yaw, sin yaw, half length, half width [m], factor [-], blend [m]
    grid: np.ndarray  # (ng, 6): x, y of node (0, 0) [m], cos yaw, sin yaw, distances dx, dy of the nodes [m]
    shape: np.ndarray  # (ng, 2) numbers of nodes
    start: np.ndarray  # (ng,) index of node (0, 0) in spline
    spline: np.ndarray  # (sum of nodes,) B-spline coefficients [m] of heights, [-] of friction factors
    heights: np.ndarray  # (1,) number of grids that are heights
    line: np.ndarray  # (ng,) index of the reference line of a grid, -1 for a grid with straight axes
    line_start: np.ndarray  # (nl + 1,) index in line_spline of the first place of each line
    line_spline: np.ndarray  # (places of all lines, 4) coefficients of p and m (solver.elements.curved_grid)
    line_numbers: np.ndarray  # (nl, NUMBERS) Curve.numbers
    # (nl, 3) index of the first cell of each line in `cells`, numbers of its cells along x and y
    line_cells: np.ndarray
    cells: np.ndarray  # (cells of all lines,) Curve.cells
    enveloping: np.ndarray  # (1,) 1: some grid is an effective road. 0: all grids are touched at a point


def interpolating(grid: Heights) -> Heights:
    """Coefficients of the uniform cubic B-spline through all nodes, with one node more on every side.

    The additional nodes have the height of the border, so that the surface continues with constant height.
    """
    c = grid.height
    for axis in (0, 1):
        c = np.moveaxis(c, axis, 0)
        n = c.shape[0]
        known = c.copy()
        # the coefficients outside of the border are its heights: known, with weight 1/6 in the first and the last
        # equation
        known[[0, -1]] -= c[[0, -1]] / 6.0
        beside, diagonal = np.full(n, 1.0 / 6.0), np.full(n, 4.0 / 6.0)
        inside = solve_tridiagonal(beside, diagonal, beside, known)
        c = np.moveaxis(np.concatenate([c[:1], inside, c[-1:]]), 0, axis)
    (dx, dy), s, k = grid.step, math.sin(grid.yaw), math.cos(grid.yaw)
    return grid._replace(origin=(grid.origin[0] - k * dx + s * dy, grid.origin[1] - s * dx - k * dy), height=c)


@functools.lru_cache(maxsize=16)  # every verdict on a run asks for it
def edge(grid: HeightGrid | RasterGrid | CurvedGrid) -> Edge:
    """Place where a grid bends upwards most, and its curvature there."""
    found = sharpest(grid.heights)
    return (
        found._replace(place=grid.place(*found.place))
        if isinstance(grid, CurvedGrid) and grid.line is not None
        else found
    )


@functools.lru_cache(maxsize=16)
def too_large(grid: HeightGrid | RasterGrid | CurvedGrid, tire: Footprint) -> str:
    """Sentence on why a grid is too large for a tire to envelop it, '' where it is not too large."""
    return too_fine(grid.heights, tire)


def envelops(spec: RoadSpec, tire: Footprint) -> tuple[bool, ...]:
    """Flag for each grid of a road: whether the tire envelops it (see RoadSpec.contact).

    'auto' never envelops a random road, which has no waves shorter than `shortest` (a tire envelops those), and no grid
    that is too_large().
    """
    if spec.contact != 'auto':
        return (spec.contact == 'enveloping',) * len(spec.grids)
    return tuple(
        not isinstance(g, RandomRoad) and edge(g).curvature > 1.0 / tire.radius and not too_large(g, tire)
        for g in spec.grids
    )


def within(grid: HeightGrid | RasterGrid | CurvedGrid | RandomRoad, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(n,) True for the places x, y (n,) [m] in W that are on a grid, within its border."""
    if isinstance(grid, RandomRoad):
        size = grid.length, grid.width
    else:
        h = grid.heights
        size = (h.height.shape[0] - 1) * h.step[0], (h.height.shape[1] - 1) * h.step[1]
    u, v = _own(grid, x, y)
    return (u >= 0.0) & (u <= size[0]) & (v >= 0.0) & (v <= size[1])


def nodes_at(grid: HeightGrid | RasterGrid | CurvedGrid, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(n,) heights [m] of a grid at places x, y (n,) [m] in W, bilinear between its nodes; outside the height of the
    border."""
    h = grid.heights
    found = np.zeros(len(x))
    first, part = zip(
        *(_cell(c / step, n) for c, step, n in zip(_own(grid, x, y), h.step, h.height.shape, strict=True)), strict=True
    )
    for i, p in ((first[0], 1.0 - part[0]), (first[0] + 1, part[0])):
        for j, q in ((first[1], 1.0 - part[1]), (first[1] + 1, part[1])):
            found += p * q * h.height[i, j]
    return found


def _cell(c: np.ndarray, nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """(index of the node before each place, fraction of the cell from there to the place); c: (n,) places in units of
    cells."""
    c = np.clip(c, 0.0, nodes - 1.0)
    first = np.minimum(c.astype(np.int64), nodes - 2)
    return first, c - first


def _own(
    grid: HeightGrid | RasterGrid | CurvedGrid | RandomRoad, x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates (n,), (n,) [m] along and across a grid, from its node (0, 0) on, of places x, y (n,) [m] in W."""
    origin, yaw = (grid.origin, grid.yaw) if isinstance(grid, RandomRoad) else (grid.heights.origin, grid.heights.yaw)
    if isinstance(grid, CurvedGrid) and grid.line is not None:
        u, v = np.zeros(len(x)), np.zeros(len(x))
        coordinates_at(
            Ref(compile_road(RoadSpec(grids=(grid,)))),
            0,
            np.ascontiguousarray(x, float),
            np.ascontiguousarray(y, float),
            u,
            v,
        )
        u, v = u - origin[0], v - origin[1]
    else:
        forward, aside = math.cos(yaw), math.sin(yaw)
        dx, dy = x - origin[0], y - origin[1]
        u, v = forward * dx + aside * dy, forward * dy - aside * dx
    return u, v


@functools.lru_cache(maxsize=2)  # the start of a scene compiles its model more than once
def compile_road(spec: RoadSpec, tire: Footprint | None = None) -> RoadTable:
    """The table of a road. Random roads become grids, and grids that a tire envelops become effective roads.

    tire: size of the tire that envelops obstacles; without one every grid is touched at a point. Raises SpecError for
    an effective road that has too many nodes.
    """
    p, n = spec.point, spec.normal
    enveloped = envelops(spec, tire) if tire is not None else (False,) * len(spec.grids)
    grids: list[Heights] = []
    for g, envelope in zip(spec.grids, enveloped, strict=True):
        heights = g.expand().heights if isinstance(g, RandomRoad) else g.heights
        grids.append(effective(heights, tire, spec.where) if tire is not None and envelope else heights)
    splines = [interpolating(g) for g in grids]
    # the numbers themselves are the coefficients: a spline through them could go beyond them
    splines += [m.heights for m in spec.maps]
    sizes = [c.height.size for c in splines]
    curved = [k for k, g in enumerate(spec.grids) if isinstance(g, CurvedGrid) and g.line is not None]
    curves = [curve_of(spec.grids[k]) for k in curved]  # type: ignore[arg-type]
    line = np.full(len(splines), -1, np.int64)
    line[curved] = np.arange(len(curves))
    begins = np.cumsum([0, *(c.cells.size for c in curves)])
    return RoadTable(
        plane=np.array([p[2] + (n[0] * p[0] + n[1] * p[1]) / n[2], -n[0] / n[2], -n[1] / n[2]]),
        friction=np.array([spec.friction]),
        patch=np.array(
            [
                [*f.center, math.cos(f.yaw), math.sin(f.yaw), f.size[0] / 2, f.size[1] / 2, f.factor, f.blend]
                for f in spec.patches
            ],
            float,
        ).reshape(-1, 8),
        grid=np.array([[*g.origin, math.cos(g.yaw), math.sin(g.yaw), *g.step] for g in splines], float).reshape(-1, 6),
        shape=np.array([g.height.shape for g in splines], np.int64).reshape(-1, 2),
        start=np.array([0, *np.cumsum(sizes)[:-1]], np.int64) if sizes else np.zeros(0, np.int64),
        spline=np.concatenate([c.height.ravel() for c in splines]) if sizes else np.zeros(0),
        heights=np.array([len(spec.grids)], np.int64),
        line=line,
        line_start=np.cumsum([0, *(len(c.spline) for c in curves)]).astype(np.int64),
        line_spline=np.concatenate([np.zeros((0, 4)), *(c.spline for c in curves)]),
        line_numbers=np.array([c.numbers for c in curves], float).reshape(-1, NUMBERS),
        line_cells=np.array([[b, *c.cells.shape] for b, c in zip(begins[:-1], curves, strict=True)], np.int64).reshape(
            -1, 3
        ),
        cells=np.concatenate([np.zeros(0, np.int64), *(c.cells.ravel() for c in curves)]),
        enveloping=np.array([float(any(enveloped))]),
    )


@kernel(borrow=True)
def _step(s):
    """0 below -1/2, 1 above 1/2, twice continuously differentiable between."""
    if s.real <= -0.5:
        return 0.0 * s
    if s.real >= 0.5:
        return 0.0 * s + 1.0
    t = s + 0.5
    return t * t * t * (10.0 + t * (6.0 * t - 15.0))


@kernel(inner=True)
def _dot4(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]


@kernel(inner=True)
def _row4(road, g, i, j, w):
    """Sum of four nodes of grid row i around column j with weights w (indices clamped to the grid)."""
    n_i = road.shape[g, 0]
    n_j = road.shape[g, 1]
    row = road.start[g] + min(max(i, 0), n_i - 1) * n_j
    return (
        road.spline[row + min(max(j - 1, 0), n_j - 1)] * w[0]
        + road.spline[row + min(max(j, 0), n_j - 1)] * w[1]
        + road.spline[row + min(max(j + 1, 0), n_j - 1)] * w[2]
        + road.spline[row + min(max(j + 2, 0), n_j - 1)] * w[3]
    )


@kernel(inner=True)
def _grid_at(road, g, x, y):
    """(h, h_x, h_y, h_xx, h_xy, h_yy) of grid g in W."""
    c = road.grid[g, 2]
    s = road.grid[g, 3]
    a = ((x - road.grid[g, 0]) * c + (y - road.grid[g, 1]) * s) / road.grid[g, 4]
    b = ((y - road.grid[g, 1]) * c - (x - road.grid[g, 0]) * s) / road.grid[g, 5]
    # two cells beyond the border the surface is constant; clamp before the conversion to integer
    i = int(np.floor(min(max(a.real, -4.0), road.shape[g, 0] + 4.0)))
    j = int(np.floor(min(max(b.real, -4.0), road.shape[g, 1] + 4.0)))
    if i < -3 or j < -3 or i > road.shape[g, 0] + 2 or j > road.shape[g, 1] + 2:
        # beyond: keep the coordinate inside the constant strip, where all weights of one axis meet equal nodes
        if i < -3:
            i = -3
            a = 0.0 * a - 2.5
        if i > road.shape[g, 0] + 2:
            i = road.shape[g, 0] + 2
            a = 0.0 * a + (i + 0.5)
        if j < -3:
            j = -3
            b = 0.0 * b - 2.5
        if j > road.shape[g, 1] + 2:
            j = road.shape[g, 1] + 2
            b = 0.0 * b + (j + 0.5)
    u, du, ddu = weights(a - i)
    w, dw, ddw = weights(b - j)
    f = (_row4(road, g, i - 1, j, w), _row4(road, g, i, j, w), _row4(road, g, i + 1, j, w), _row4(road, g, i + 2, j, w))
    f_b = (
        _row4(road, g, i - 1, j, dw),
        _row4(road, g, i, j, dw),
        _row4(road, g, i + 1, j, dw),
        _row4(road, g, i + 2, j, dw),
    )
    f_bb = (
        _row4(road, g, i - 1, j, ddw),
        _row4(road, g, i, j, ddw),
        _row4(road, g, i + 1, j, ddw),
        _row4(road, g, i + 2, j, ddw),
    )
    ka = 1.0 / road.grid[g, 4]
    kb = 1.0 / road.grid[g, 5]
    h_a = ka * _dot4(du, f)
    h_b = kb * _dot4(u, f_b)
    h_aa = ka * ka * _dot4(ddu, f)
    h_ab = ka * kb * _dot4(du, f_b)
    h_bb = kb * kb * _dot4(u, f_bb)
    return (
        _dot4(u, f),
        c * h_a - s * h_b,
        s * h_a + c * h_b,
        c * c * h_aa - 2.0 * c * s * h_ab + s * s * h_bb,
        c * s * (h_aa - h_bb) + (c * c - s * s) * h_ab,
        s * s * h_aa + 2.0 * c * s * h_ab + c * c * h_bb,
    )


@kernel(borrow=True)
def _curved_at(road, g, x, y):
    """_grid_at of a grid along a reference line."""
    u, v, first, second, sign_u, sign_v = on_line(road, road.line[g], x, y)
    h, h_u, h_v, h_uu, h_uv, h_vv = _grid_at(road, g, u, v)
    h_u = sign_u * h_u
    h_v = sign_v * h_v
    h_uv = sign_u * sign_v * h_uv
    u_x, u_y, v_x, v_y = first
    return (
        h,
        h_u * u_x + h_v * v_x,
        h_u * u_y + h_v * v_y,
        h_uu * u_x * u_x + 2.0 * h_uv * u_x * v_x + h_vv * v_x * v_x + h_u * second[0] + h_v * second[3],
        h_uu * u_x * u_y + h_uv * (u_x * v_y + u_y * v_x) + h_vv * v_x * v_y + h_u * second[1] + h_v * second[4],
        h_uu * u_y * u_y + 2.0 * h_uv * u_y * v_y + h_vv * v_y * v_y + h_u * second[2] + h_v * second[5],
    )


@kernel(borrow=True)
def surface_at(road, x, y):
    """(h, h_x, h_y, h_xx, h_xy, h_yy): height [m], slopes [-] and second derivatives [1/m] of the road at (x, y) [m] in
    W."""
    zero = 0.0 * x
    h = road.plane[0] + road.plane[1] * x + road.plane[2] * y
    h_x = zero + road.plane[1]
    h_y = zero + road.plane[2]
    h_xx = zero
    h_xy = zero
    h_yy = zero
    for g in range(road.heights[0]):
        a = _grid_at(road, g, x, y) if road.line[g] < 0 else _curved_at(road, g, x, y)
        h = h + a[0]
        h_x = h_x + a[1]
        h_y = h_y + a[2]
        h_xx = h_xx + a[3]
        h_xy = h_xy + a[4]
        h_yy = h_yy + a[5]
    return h, h_x, h_y, h_xx, h_xy, h_yy


@kernel(inner=True)
def plane_at(road, x, y):
    """surface_at of a road without grids: slopes and second derivatives are real numbers, whatever x and y are."""
    return road.plane[0] + road.plane[1] * x + road.plane[2] * y, road.plane[1], road.plane[2], 0.0, 0.0, 0.0


@kernel(inner=True)
def friction_at(road, x, y):
    """Friction factor [-] at (x, y) [m] in W."""
    mu = 0.0 * x + road.friction[0]
    for k in range(road.patch.shape[0]):
        p = road.patch[k]
        a = (x - p[0]) * p[2] + (y - p[1]) * p[3]
        b = (y - p[1]) * p[2] - (x - p[0]) * p[3]
        inside = (
            _step((p[4] + a) / p[7]) * _step((p[4] - a) / p[7]) * _step((p[5] + b) / p[7]) * _step((p[5] - b) / p[7])
        )
        mu = mu * (1.0 + (p[6] - 1.0) * inside)
    for g in range(road.heights[0], road.start.shape[0]):
        mu = mu * _grid_at(road, g, x, y)[0]
    return mu


@kernel(inner=True)
def normal_of_slopes(h_x, h_y):
    """Unit normal (upwards) of a surface with these slopes."""
    k = 1.0 / sqrt(1.0 + h_x * h_x + h_y * h_y)
    return (-h_x * k, -h_y * k, k)


@kernel(borrow=True)
def road_at(road, x, y):
    """(height [m], unit normal in W, friction factor [-]) at (x, y) [m] in W."""
    h, h_x, h_y, _, _, _ = surface_at(road, x, y)
    return h, normal_of_slopes(h_x, h_y), friction_at(road, x, y)


@kernel(borrow=True)
def heights_at(road, x, y, z):
    """Write the heights z (n,) [m] of the road at places x, y (n,) [m] in W."""
    for k in range(x.size):
        z[k] = surface_at(road, x[k], y[k])[0]


@kernel(borrow=True)
def coordinates_at(road, g, x, y, u, v):
    """Write u, v (n,) [m] along the reference line of grid g, which has one, at places x, y (n,) [m] in W."""
    for k in range(x.size):
        u[k], v[k] = on_line(road, road.line[g], x[k], y[k])[:2]
