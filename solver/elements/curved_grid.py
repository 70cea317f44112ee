"""A grid of heights along a reference line, as ASAM OpenCRG has it: u along the line, v to its left.

The line is the cubic spline p(u) through the given places, the rows of the grid lie along the spline m(u) through their
normals, and a place in the plane is p(u) + v m(u): every node is where the file has it, and u and v are smooth
functions of x and y. Beyond its ends the line is straight. Heights are those of any other grid (solver.elements.road),
over (u, v) in place of (x, y).
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver import stored
from solver.compiled.kernel import kernel
from solver.compiled.portable import solve_tridiagonal
from solver.elements.enveloping import Heights
from solver.errors import SpecError
from solver.validate import require

MOST_NODES = 64_000_000  # of all curved grids of a road: half a gigabyte; ten times as much does not fit into memory
BEYOND = 12  # places added to the line at either end: what the spline feels of its end is 0.27^12 there
STRAIGHT = 4  # of them that are on the straight line to the last bit
# in which the search for the nearest place of a line begins; ten times as many are searched no faster
MOST_CELLS = 200_000
SMALLEST_CELL = 0.25  # [m]
MARGIN = 5.0  # [m] beside a road where the search still begins at the nearest place
FOLDS = {'keep': 0.0, 'repeat': 1.0, 'reflect': 2.0}  # what a road is beyond its border
FIELDS = ('u', 'du', 'v', 'dv', 'x', 'y', 'yaw', 'fold_u', 'fold_v', 'u_first', 'u_last', 'v_first', 'v_last')


class Frame(NamedTuple):
    """Numbers of a curved grid: row 0 and distance of rows along the line, column 0 and distance of columns to its left
    [m]; x, y [m] and yaw [rad] where u = v = 0 of a straight line; what is beyond the borders (FOLDS), and these
    [m]."""

    u: float
    du: float
    v: float
    dv: float
    x: float
    y: float
    yaw: float
    fold_u: float
    fold_v: float
    u_first: float
    u_last: float
    v_first: float
    v_last: float


class Curve(NamedTuple):
    """A reference line as kernels take it: coefficients (n, 4) of the splines p and m, the first numbers of `numbers`,
    its cells."""

    spline: np.ndarray
    numbers: tuple[
        float, ...
    ]  # u of spline[0], distance of places; x, y, size of the cells; fold_u, u_first, u_last, fold_v, v_first, v_last
    cells: np.ndarray  # (n_x, n_y) place that is nearest to the middle of a cell


NUMBERS = 11


@dataclass(frozen=True, kw_only=True)
class CurvedGrid:
    """Heights above the plane on a grid along a reference line: a road from an OpenCRG file (.crg), which stands in
    place of it.

    sha256: of the arrays with its numbers, which a recording has as an attachment. file: where they came from. notes:
    what was made of the options and modifiers of the file.
    """

    sha256: str
    file: str = ''
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        where = 'curved grid'
        require(
            stored.DIGEST.fullmatch(self.sha256) is not None,
            where,
            'sha256',
            self.sha256,
            'must be 64 hexadecimal digits',
        )
        remedy = (
            f'its numbers are not on this machine: name {self.file or "the .crg file"} itself in the scene, or '
            'read the recording'
        )
        require(stored.find(self.sha256) is not None, where, 'sha256', self.sha256, remedy)
        object.__setattr__(self, 'notes', tuple(self.notes))
        try:
            self.frame  # noqa: B018
            heights = self.heights.height
        except (KeyError, ValueError, TypeError, IndexError, SpecError):
            heights = np.zeros((0, 0))
        require(min(heights.shape) >= 2, where, 'sha256', self.sha256, 'are not the numbers of a road')

    @property
    def frame(self) -> Frame:
        """Its numbers."""
        return Frame(*stored.find(self.sha256)['frame'].tolist())  # type: ignore[index]

    @property
    def nodes(self) -> int:
        """Number of heights."""
        return self.heights.height.size

    @property
    def line(self) -> np.ndarray | None:
        """(n, 4) places p and normals m of the rows, first u_first; None of a straight road."""
        return stored.find(self.sha256).get('line')  # type: ignore[union-attr]

    @property
    def heights(self) -> Heights:
        """Its heights; over (u, v) where it has a line."""
        return heights_of(self.sha256)

    def place(self, u: float, v: float) -> tuple[float, float]:
        """(x, y) [m] in W of the node nearest to u, v [m]."""
        line, frame = self.line, self.frame
        if line is None:
            c, s = math.cos(frame.yaw), math.sin(frame.yaw)
            return frame.x + u * c - v * s, frame.y + u * s + v * c
        x, y, left, up = line[min(max(round((u - frame.u_first) / frame.du), 0), len(line) - 1)].tolist()
        return x + v * left, y + v * up


@functools.lru_cache(maxsize=2)  # a large road takes half a second
def heights_of(sha256: str) -> Heights:
    """The heights of arrays with this hash, over (u, v) where they have a line. Raises SpecError for too many."""
    arrays = stored.find(sha256)
    assert arrays is not None
    f = Frame(*arrays['frame'].tolist())
    v = arrays['v']
    given = arrays['z'][:, None] + arrays['height']
    columns = round((v[-1] - v[0]) / f.dv) + 1
    if columns * len(given) > MOST_NODES:
        raise SpecError(
            f'curved grid: {columns * len(given)} heights are too many (at most {MOST_NODES}): take a part of the road'
        )
    if columns != len(v):  # linear between the sections of a file
        at = np.minimum(v[0] + f.dv * np.arange(columns), v[-1])
        low = np.clip(np.searchsorted(v, at + 1e-9 * f.dv, side='right') - 1, 0, len(v) - 2)
        part = np.clip((at - v[low]) / (v[low + 1] - v[low]), 0.0, 1.0)
        given = given[:, low] * (1.0 - part) + given[:, low + 1] * part
    given.setflags(write=False)
    if 'line' in arrays:
        return Heights((f.u, f.v), (f.du, f.dv), 0.0, given)
    c, s = math.cos(f.yaw), math.sin(f.yaw)
    return Heights((f.x + f.u * c - f.v * s, f.y + f.u * s + f.v * c), (f.du, f.dv), f.yaw, given)


def curve_of(grid: CurvedGrid) -> Curve:
    """The line of a grid that has one."""
    line, f = grid.line, grid.frame
    assert line is not None
    before = line[0] + np.arange(-BEYOND, 0)[:, None] * np.array([*(line[1, :2] - line[0, :2]), 0.0, 0.0])
    behind = line[-1] + np.arange(1, BEYOND + 1)[:, None] * np.array([*(line[-1, :2] - line[-2, :2]), 0.0, 0.0])
    c = np.concatenate([before, line, behind])
    inside = c[STRAIGHT:-STRAIGHT].copy()
    inside[0] -= c[STRAIGHT - 1] / 6.0
    inside[-1] -= c[-STRAIGHT] / 6.0
    beside = np.full(len(inside), 1.0 / 6.0)
    c[STRAIGHT:-STRAIGHT] = solve_tridiagonal(beside, np.full(len(inside), 4.0 / 6.0), beside, inside)
    low, size, cells = _cells(line, max(abs(f.v_first), abs(f.v_last)) + MARGIN)
    beyond = (f.fold_u, f.u_first, f.u_last, f.fold_v, f.v_first, f.v_last)
    return Curve(c, (f.u_first - BEYOND * f.du, f.du, *low, size, *beyond), cells)


def _cells(line: np.ndarray, reach: float) -> tuple[tuple[float, float], float, np.ndarray]:
    """Corner [m], size [m] and (n_x, n_y) nearest places of squares that cover a line and what is within reach of
    it."""
    from scipy.spatial import cKDTree

    places = line[:, :2]
    low, high = places.min(axis=0) - reach, places.max(axis=0) + reach
    size = max(math.sqrt(float(np.prod(high - low)) / MOST_CELLS), SMALLEST_CELL)
    n_x, n_y = (math.ceil(float(side) / size) for side in high - low)
    middles = np.meshgrid(low[0] + size * (np.arange(n_x) + 0.5), low[1] + size * (np.arange(n_y) + 0.5), indexing='ij')
    nearest = cKDTree(places).query(np.stack(middles, axis=-1).reshape(-1, 2))[1]
    return (float(low[0]), float(low[1])), size, (nearest.reshape(n_x, n_y) + BEYOND).astype(np.int64)


@kernel(inner=True)
def weights(t):
    """Cubic B-spline weights of nodes -1, 0, 1, 2 at t in [0, 1], their first and second derivatives."""
    r = 1.0 - t
    s = t * t
    w = (r * r * r / 6.0, (4.0 - 3.0 * s * (2.0 - t)) / 6.0, (4.0 - 3.0 * r * r * (1.0 + t)) / 6.0, s * t / 6.0)
    d = (-0.5 * r * r, t * (1.5 * t - 2.0), r * (2.0 - 1.5 * r), 0.5 * s)
    return w, d, (r, 3.0 * t - 2.0, 1.0 - 3.0 * t, t)


@kernel(inner=True)
def _column(spline, i, j, w):
    return spline[i - 1, j] * w[0] + spline[i, j] * w[1] + spline[i + 1, j] * w[2] + spline[i + 2, j] * w[3]


@kernel(inner=True)
def _curve(road, k, a):
    """p and m of line k at a, the number of a place, (p_x, p_y, m_x, m_y), their first and second derivatives by a."""
    start = road.line_start[k]
    end = road.line_start[k + 1]
    i = int(np.floor(min(max(a.real, 0.0), end - start - 1.0)))
    zero = 0.0 * a
    if i < 1 or i > end - start - 3:  # straight
        j = start if i < 1 else end - 2
        t = a - (j - start)
        dx = road.line_spline[j + 1, 0] - road.line_spline[j, 0]
        dy = road.line_spline[j + 1, 1] - road.line_spline[j, 1]
        c = road.line_spline
        p = (c[j, 0] + t * dx, c[j, 1] + t * dy, zero + c[j, 2], zero + c[j, 3])
        return p, (zero + dx, zero + dy, zero, zero), (zero, zero, zero, zero)
    w, d, dd = weights(a - i)
    c = road.line_spline
    j = start + i
    return (
        (_column(c, j, 0, w), _column(c, j, 1, w), _column(c, j, 2, w), _column(c, j, 3, w)),
        (_column(c, j, 0, d), _column(c, j, 1, d), _column(c, j, 2, d), _column(c, j, 3, d)),
        (_column(c, j, 0, dd), _column(c, j, 1, dd), _column(c, j, 2, dd), _column(c, j, 3, dd)),
    )


@kernel(inner=True)
def _miss(x, y, p, d):
    """Distance of x, y [m] ahead of the row through p, and its derivative by the number of the place; real numbers."""
    ex = x - p[0]
    ey = y - p[1]
    ahead = d[0] * p[3] - d[1] * p[2]
    # inside of the centre of curvature, which is off the road, the derivative changes its sign
    slope = min(ex * d[3] - ey * d[2] - ahead, -0.1 * ahead)
    return ex * p[3] - ey * p[2], slope


@kernel(borrow=True)
def _nearest(road, k, x, y):
    """Number of the place of line k whose row goes through x, y [m], real numbers: Newton's iteration from the middle
    of a cell."""
    n = road.line_numbers[k]
    n_x = road.line_cells[k, 1]
    n_y = road.line_cells[k, 2]
    i = int(min(max((x - n[2]) / n[4], 0.0), n_x - 1.0))
    j = int(min(max((y - n[3]) / n[4], 0.0), n_y - 1.0))
    a = float(road.cells[road.line_cells[k, 0] + i * n_y + j])
    for _ in range(40):
        p, d, _dd = _curve(road, k, a)
        miss, slope = _miss(x, y, p, d)
        step = -min(max(miss / slope, -32.0), 32.0)
        a += step
        if abs(step) < 1e-11:
            break
    return a


@kernel(inner=True)
def _folded(u, fold, first, last):
    """u, or v, within the borders of a road that is repeated or reflected beyond them, and the sign of its
    derivative."""
    if fold > 0.5 and (u.real < first or u.real > last):
        times = np.floor((u.real - first) / (last - first))
        if fold > 1.5 and times % 2.0 == 1.0:
            return -u + (2.0 * first + (times + 1.0) * (last - first)), -1.0
        return u - times * (last - first), 1.0
    return u + 0.0, 1.0


@kernel(inner=True)
def on_line(road, k, x, y):
    """(u, v) [m] of x, y [m] along line k, first derivatives (u_x, u_y, v_x, v_y), second ones (u_xx, u_xy, u_yy, v_xx,
    v_xy, v_yy) [1/m], and the signs of u and v where the road is reflected. Inside of the centre of curvature u is
    taken as constant."""
    near = _nearest(road, k, x.real, y.real)
    p, d, _ = _curve(road, k, near)
    slope = _miss(x.real, y.real, p, d)[1]
    a = near - ((x - p[0]) * p[3] - (y - p[1]) * p[2]) / slope
    p, d, dd = _curve(road, k, a)
    square = p[2] * p[2] + p[3] * p[3]
    v = ((x - p[0]) * p[2] + (y - p[1]) * p[3]) / square
    ax = d[0] + v * d[2]
    ay = d[1] + v * d[3]
    det = ax * p[3] - ay * p[2]
    du = road.line_numbers[k, 1]
    zero = 0.0 * v
    if det.real < 0.05 * (d[0] * p[3] - d[1] * p[2]).real:
        first = (zero, zero, p[2] / square, p[3] / square)
        second = (zero, zero, zero, zero, zero, zero)
    else:
        r = 1.0 / det
        a_x = p[3] * r
        a_y = -p[2] * r
        v_x = -ay * r
        v_y = ax * r
        sx = dd[0] + v * dd[2]
        sy = dd[1] + v * dd[3]
        # x_i = p_i + v m_i, differentiated twice: of every pair of directions what the second derivatives of u and v
        # make up for
        qx = sx * a_x * a_x + 2.0 * d[2] * a_x * v_x
        qy = sy * a_x * a_x + 2.0 * d[3] * a_x * v_x
        rx = sx * a_x * a_y + d[2] * (a_x * v_y + a_y * v_x)
        ry = sy * a_x * a_y + d[3] * (a_x * v_y + a_y * v_x)
        tx = sx * a_y * a_y + 2.0 * d[2] * a_y * v_y
        ty = sy * a_y * a_y + 2.0 * d[3] * a_y * v_y
        first = (du * a_x, du * a_y, v_x, v_y)
        second = (
            -du * (a_x * qx + a_y * qy), -du * (a_x * rx + a_y * ry), -du * (a_x * tx + a_y * ty),
            -(v_x * qx + v_y * qy), -(v_x * rx + v_y * ry), -(v_x * tx + v_y * ty),
        )  # fmt: skip
    n = road.line_numbers[k]
    u, sign_u = _folded(n[0] + du * a, n[5], n[6], n[7])
    v, sign_v = _folded(v, n[8], n[9], n[10])
    return u, v, first, second, sign_u, sign_v
