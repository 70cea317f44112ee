"""The road surface that an OpenCRG file describes, as the arrays of a curved grid (solver.elements.curved_grid).

The file (solver.files.crg) has a reference line, heights over it in rows and long sections, modifiers that change them,
and options for what lies beyond the borders. u is the length along the line, v the distance to its left. The heights
and places of the nodes are those of ASAM's library (crgLoader.c, crgMgr.c, crgEvalz.c, crgEvaluv2xy.c) [ASAM2020],
whose functions are named in the docstrings. Between the nodes the library is bilinear, and the solver goes smoothly
through the same heights.

The file is long because it follows the library step by step and in its order, so that the two can be read side by side.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solver import stored
from solver.compiled.elementary import cos, sin
from solver.elements.between_nodes import from_bilinear
from solver.elements.curved_grid import BEYOND, FOLDS, MOST_NODES, Frame, heights_of
from solver.errors import SceneError, SpecError
from solver.files.crg import Crg, parsed, sections_of, table_of

# Values of BORDER_MODE_U and BORDER_MODE_V: beyond the border the height stays, is zero, repeats, is reflected. 0:
# none.
KEEP, ZERO, REPEAT, REFLECT = 2, 1, 3, 4
# Modifiers of a file without a section of modifiers, as in ASAM's library (crgOptionSetDefaultModifiers).
DEFAULTS = {'grid_nan_mode': 2.0, 'refpoint_x': 0.0, 'refpoint_y': 0.0, 'refpoint_z': 0.0, 'refpoint_phi': 0.0}
CURVATURE_LENGTH = 0.5  # distance [m] from the ends of a line within which the library takes the heading of the end
# Distance of two rows at the border of the road, relative to their distance on the line, at least. Rows that meet at
# the border have no places between them; ten times as much would refuse ordinary curves.
LEAST_PROGRESS = 0.05
COMMENSURABLE = 1e-6  # distance [m] of a section from a column of an even grid up to which it lies on that column
MOST_PARTS = 1000  # parts into which the least distance of two sections is divided to find such a grid
SINGLE = 8.0  # height over the line [m] below which heights are kept in single precision, with an error of 2.4e-7 m
STEP = 1e-6  # difference of heights [m] from which on a note tells it


@dataclass(kw_only=True)
class _Surface:
    """A road after its modifiers, with n rows and m long sections.

    first, du: u of the first row and distance of the rows [m]. heading: of the line at its start, as the file says
    [rad]. phi: (n,) heading of the piece of the line before each row [rad], None of a straight line. z: (n,) height of
    the line [m]. bank: (n,) cross slope [-], None without banking. v: (m,) of the sections [m]. grid: (n, m) heights
    over the line [m]. places: (n, 2) x, y of the line [m]. has_z: whether the file gives heights of the line. mean:
    added to all heights [m].
    """

    crg: Crg
    first: float
    du: float
    heading: float
    phi: np.ndarray | None
    z: np.ndarray
    bank: np.ndarray | None
    v: np.ndarray
    grid: np.ndarray
    options: dict[str, float]
    places: np.ndarray
    has_z: bool
    mean: float = 0.0

    @property
    def last(self) -> float:
        """u of the last row [m]."""
        return self.first + self.du * (len(self.grid) - 1)


def read_crg(path: Path) -> dict[str, Any]:
    """Fields of the CurvedGrid (solver.elements.curved_grid) that an OpenCRG file describes, and its `kind`. Raises
    SceneError."""
    crg = parsed(path)
    return fields_of(crg, table_of(crg))


def fields_of(crg: Crg, table: np.ndarray) -> dict[str, Any]:
    """Fields of the CurvedGrid of a parsed file and its table of numbers. Raises SceneError."""
    modifiers = DEFAULTS if crg.modifiers is None else crg.modifiers
    s = _surface(crg, table, modifiers)
    if crg.modifiers is None and (abs(s.heading) > 1e-12 or np.abs(s.places[0]).max() > 1e-12):
        x, y = s.places[0]
        start = f'x = {x:.12g} m, y = {y:.12g} m, phi = {s.heading:.12g} rad'
        where = 'is moved to the origin, as by the library of ASAM; an empty section leaves it there'
        crg.notes.append(f'has no section $ROAD_CRG_MODS: its start at {start} {where}')
    _transform(s, modifiers)
    if crg.options and 0.0 in (crg.options.get('border_mode_u'), crg.options.get('border_mode_v')):
        crg.notes.append('ends at its border (BORDER_MODE 0); what leaves it finds the height of the border there')
    arrays = _arrays(s)
    digest = stored.keep(arrays)
    try:
        apart, (row, column) = from_bilinear(heights_of(digest))
    except SpecError as error:  # columns that are not even stand closer together here
        raise SceneError(f'{crg.source}: {error}') from None
    if apart > STEP:
        u, v = arrays['frame'][0] + row * s.du, arrays['v'][0] + column * arrays['frame'][3]
        crg.notes.append(
            'between its heights the road is smooth, where the library of ASAM is bilinear: they differ by up to '
            f'{apart:.2g} m, at u = {u:.6g} m, v = {v:.4g} m'
        )
    return {'kind': 'curved_grid', 'sha256': digest, 'file': str(crg.path), 'notes': tuple(crg.notes)}


def _channel(crg: Crg, table: np.ndarray, word: str, first: int) -> np.ndarray | None:
    """Column `word` (phi, slope, banking) of the reference line, None where the file has none.

    Raises SceneError if a number from row `first` on is missing.
    """
    found = [
        k for k, name in enumerate(crg.channels) if name.startswith('reference line') and name.split()[2:3] == [word]
    ]
    if not found:
        return None
    values = table[:, found[0]].astype(float)
    holes = np.flatnonzero(np.isnan(values[first:]))
    if len(holes):
        place = crg.where[f'D:{found[0] + 1}']
        raise SceneError(f'{place}: reference line {word}: its number in row {int(holes[0]) + first + 1} is missing')
    return values


def _surface(crg: Crg, table: np.ndarray, modifiers: dict[str, float]) -> _Surface:
    """The road of a file, scaled by its modifiers, still at its own place (calcRefLine and before)."""
    columns, v = sections_of(crg)
    known = {'phi', 'slope', 'banking'}
    for k, name in enumerate(crg.channels):
        words = name.split()
        if (
            words[:2] == ['reference', 'line']
            and words[2:3]
            and words[2] in ('u', 'x', 'y')
            and 'reference line phi' not in crg.channels
        ):
            remedy = 'is not the line of an OpenCRG 1.2 file: give the headings, D:reference line phi,rad'
            raise SceneError(f'{crg.where[f"D:{k + 1}"]}: {name}: {remedy}')
        if not name.startswith('long section') and not (
            words[:2] == ['reference', 'line'] and words[2:3] and words[2] in known
        ):
            crg.notes.append(f'the channel {name!r} is not used')
    road = crg.road
    first, du = road.get('reference_line_start_u', 0.0), road['reference_line_increment']
    phi, slope, bank = (_channel(crg, table, word, start) for word, start in (('phi', 1), ('slope', 1), ('banking', 0)))
    grid = table[:, columns].astype(np.float64 if table.dtype == np.float64 else np.float32)
    start_b = road.get('reference_line_start_b', 0.0)
    if bank is None and start_b != 0.0:
        bank = np.full(len(table), start_b)
    heading = road.get('reference_line_start_phi', 0.0)
    ends = {what: road.get(f'reference_line_end_{what}') for what in ('x', 'y', 'z')}
    # The modifiers that scale come in the order of crgDataSetModifiersApply. One that makes the end of the line wrong
    # removes the end that the file gives.
    if (factor := modifiers.get('scale_z_grid')) is not None:
        grid = grid * np.asarray(factor, grid.dtype)
    start_s = road.get('reference_line_start_s', 0.0)
    if (factor := modifiers.get('scale_slope')) is not None:
        slope = None if slope is None else slope * factor
        start_s, ends['z'] = start_s * factor, None
    if (factor := modifiers.get('scale_banking')) is not None and bank is not None:
        bank = bank * factor
    for key in ('scale_length', 'scale_width'):
        if key in modifiers and not modifiers[key] > 0.0:
            raise crg.refusal(key, 'must be positive')
    if (factor := modifiers.get('scale_length')) is not None:
        du = du * factor
        ends = dict.fromkeys(ends)
    v = v * modifiers.get('scale_width', 1.0)
    if (factor := modifiers.get('scale_curvature')) is not None and phi is not None:
        phi = heading + factor * (phi - heading)
        ends['x'] = ends['y'] = None
    _fill(crg, grid, modifiers)
    z, has_z = _profile(crg, len(table), du, slope, start_s, ends['z'])
    places = _line(road, len(table), du, heading, phi, ends)
    return _Surface(
        crg=crg, first=first, du=du, heading=heading, phi=phi, z=z, bank=bank, v=v, grid=grid,
        options=crg.options or {}, places=places,
        has_z=has_z or 'reference_line_start_z' in road,
    )  # fmt: skip


def _fill(crg: Crg, grid: np.ndarray, modifiers: dict[str, float]) -> None:
    """Fill missing heights in the grid, in place, by GRID_NAN_MODE and GRID_NAN_OFFSET."""
    rows = np.flatnonzero(np.isnan(grid).any(axis=1))
    if not len(rows):
        return
    mode, offset = modifiers.get('grid_nan_mode', 0.0), modifiers.get('grid_nan_offset', 0.0)
    if mode == 0.0:
        instead = 'GRID_NAN_MODE 0 keeps them missing; here the nearest height to the right takes their place'
        crg.notes.append(f'heights are missing in {len(rows)} rows: {instead}')
        offset = 0.0
    part = grid[rows]
    holes = np.isnan(part)
    if mode == 1.0:
        part[holes] = offset
    else:
        for columns in (range(1, part.shape[1]), range(part.shape[1] - 2, -1, -1)):
            before = -1 if columns.step > 0 else 1
            for k in columns:
                empty = np.isnan(part[:, k])
                part[empty, k] = part[empty, k + before]
        part[holes] += offset
    if np.isnan(part).any():
        raise SceneError(f'{crg.source}: row {int(rows[np.isnan(part).any(axis=1)][0]) + 1} has no height at all')
    grid[rows] = part


def _profile(
    crg: Crg, count: int, du: float, slope: np.ndarray | None, start_s: float, end: float | None
) -> tuple[np.ndarray, bool]:
    """(heights of the line [m], whether they are integrated from slopes) (calcRefLineZ).

    start_s: constant slope where there is no column of slopes. end: height that the file gives at the end [m], or None.
    """
    start = crg.road.get('reference_line_start_z', 0.0)
    if slope is None and start_s == 0.0:
        if end is not None and abs(end - start) > STEP:
            note = (
                f'reference_line_end_z = {end:g} without a slope: the line stays at {start:g} m, as in the library '
                'of ASAM'
            )
            crg.notes.append(note)
        return np.full(count, start), False
    rise = (slope[1:] if slope is not None else np.full(count - 1, start_s)) * du
    if end is None:
        return np.cumsum(np.concatenate(([start], rise))), True
    back = np.cumsum(np.concatenate(([end], -rise[::-1])))[::-1]
    z = back.copy()
    z[0] = start
    for i in range(count - 2):
        part = i / (count - 1)
        z[i + 1] = (1.0 - part) * (z[i] + rise[i]) + part * back[i + 1]
    return z, True


def _line(
    road: dict[str, float], count: int, du: float, heading: float, phi: np.ndarray | None, ends: dict[str, float | None]
) -> np.ndarray:
    """(count, 2) places of the line (calcRefLine): its headings, integrated from the start.

    Where the file gives the end, they are integrated from there too, and the two results are blended along the line.
    """
    start = np.array([road.get('reference_line_start_x', 0.0), road.get('reference_line_start_y', 0.0)])
    if phi is None:
        return start + du * np.arange(count)[:, None] * np.array([math.cos(heading), math.sin(heading)])
    step = du * np.column_stack([cos(phi[1:]), sin(phi[1:])])
    if ends['x'] is None or ends['y'] is None:
        return np.cumsum(np.concatenate(([start], step)), axis=0)
    back = np.cumsum(np.concatenate(([[ends['x'], ends['y']]], -step[::-1])), axis=0)[::-1]
    places = [start.tolist()]
    x, y = places[0]
    for i, ((dx, dy), (bx, by)) in enumerate(zip(step.tolist(), back[1:].tolist(), strict=True), 1):
        part = i / (count - 1)
        x, y = (1.0 - part) * (x + dx) + part * bx, (1.0 - part) * (y + dy) + part * by
        places.append([x, y])
    return np.array(places)


def _length(vectors: np.ndarray) -> np.ndarray:
    """(n, 1) lengths of vectors (n, 2), by operations whose rounding is the same on every processor."""
    x, y = vectors.T
    return np.sqrt(x * x + y * y)[:, None]


def _normals(places: np.ndarray) -> np.ndarray:
    """(rows, 2) vector of each row: from the line along the row, per metre of v (crgDataEvaluv2xy).

    In a bend it is longer than 1, so that the places at a constant v stay at the distance v from the pieces of the
    line.
    """
    across = np.concatenate([places[1:2] - places[:1], places[2:] - places[:-2], places[-1:] - places[-2:-1]])
    normal = np.column_stack([-across[:, 1], across[:, 0]])
    normal /= _length(normal)
    piece = np.diff(places, axis=0)
    piece = np.concatenate([piece, piece[-1:]])
    piece = np.column_stack([-piece[:, 1], piece[:, 0]]) / _length(piece)
    return normal / (normal * piece).sum(axis=1)[:, None]


def _place(s: _Surface, u: float, v: float) -> np.ndarray:
    """(2,) x, y [m] of the place u, v [m] (crgDataEvaluv2xy)."""
    at = (u - s.first) / s.du
    k = min(max(int(at), 0), len(s.places) - 2)
    ends = s.places[k : k + 2] + v * _normals(s.places[max(k - 1, 0) : k + 3])[k - max(k - 1, 0) :][:2]
    return ends[0] + (at - k) * (ends[1] - ends[0])


def _heading(s: _Surface, u: float) -> float:
    """Heading [rad] of the line at u [m], as the library takes it for refpoint_phi (crgDataEvaluv2pk of version 2.0).

    It is that of the start near the start, that of the end near the end, else that of the piece at u.
    """
    if s.phi is None:
        return s.heading
    k = min(max(int((u - s.first) / s.du), 0), len(s.phi) - 2)
    near = max(int(CURVATURE_LENGTH / s.du), 1)
    if near > k:
        return s.heading
    return float(s.phi[k + 1]) if k + near < len(s.phi) else s.crg.road.get('reference_line_end_phi', float(s.phi[-1]))


def _transform(s: _Surface, modifiers: dict[str, float]) -> None:
    """Move the road to its place, by the modifiers refpoint_... or refline_... (crgDataApplyTransformations).

    refpoint_...: a point of the road comes to a given place. refline_...: the whole road is turned and shifted by
    offsets.
    """
    # refpoint_u_offset and refpoint_v_offset alone do not move a road
    by_point = [key for key in modifiers if key.startswith('refpoint_') and not key.endswith('_offset')]
    for of, fraction in (('u', 'refpoint_u_fraction'), ('v', 'refpoint_v_fraction')):
        if (
            f'refpoint_{of}_offset' in modifiers
            and modifiers[f'refpoint_{of}_offset'] != 0.0
            and fraction not in modifiers
        ):
            raise s.crg.refusal(
                f'refpoint_{of}_offset', f'has an effect beside {fraction.upper()} only: give that, too'
            )
    if by_point:
        u, v = modifiers.get('refpoint_u', s.first), modifiers.get('refpoint_v', 0.0)
        if (part := modifiers.get('refpoint_u_fraction')) is not None:
            u = s.first + part * (s.last - s.first) + modifiers.get('refpoint_u_offset', 0.0)
        if (part := modifiers.get('refpoint_v_fraction')) is not None:
            v = float(s.v[0] + part * (s.v[-1] - s.v[0])) + modifiers.get('refpoint_v_offset', 0.0)
        centre = _place(s, u, v)
        turn = modifiers.get('refpoint_phi', 0.0) - _heading(s, u)
        shift = np.array([modifiers.get('refpoint_x', 0.0), modifiers.get('refpoint_y', 0.0)]) - centre
        rise = modifiers.get('refpoint_z', 0.0) - float(_heights(s, np.array([u]), np.array([v]))[0, 0])
    else:
        centre = np.array([modifiers.get(f'refline_rotcenter_{of}', s.places[0, k]) for k, of in enumerate('xy')])
        turn = modifiers.get('refline_offset_phi', 0.0)
        shift = np.array([modifiers.get('refline_offset_x', 0.0), modifiers.get('refline_offset_y', 0.0)])
        rise = modifiers.get('refline_offset_z', 0.0)
    c, q = math.cos(turn), math.sin(turn)
    d = s.places - centre
    s.places = np.column_stack([centre[0] + c * d[:, 0] - q * d[:, 1], centre[1] + q * d[:, 0] + c * d[:, 1]]) + shift
    s.heading += turn
    if s.phi is not None:
        s.phi = s.phi + turn
    if s.has_z:
        s.z = s.z + rise
    else:
        s.mean = rise


def _within(x: np.ndarray, first: float, last: float, mode: int) -> np.ndarray:
    """The coordinates x, each moved to the place between `first` and `last` that it stands for beyond a border."""
    if mode == REPEAT:
        return np.where((x < first) | (x > last), first + np.mod(x - first, last - first), x)
    if mode == REFLECT:
        return first + np.abs(np.mod(x - first + (last - first), 2.0 * (last - first)) - (last - first))
    return np.clip(x, first, last)


def _heights(s: _Surface, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(len(u), len(v)) heights [m] at all pairs of u and v [m], bilinear between the nodes, with all options
    (crgDataEvaluv2z)."""
    modes = [int(s.options.get(f'border_mode_{of}', KEEP)) or KEEP for of in 'uv']
    offset_u, offset_v = (s.options.get(f'border_offset_{of}', 0.0) for of in 'uv')
    slack = 1e-9 * s.du
    out_u = (u < s.first - slack) | (u > s.last + slack)
    out_v = (v < s.v[0] - 1e-9) | (v > s.v[-1] + 1e-9)
    at = _within(u, s.first, s.last, modes[0])
    across = _within(v, s.v[0], s.v[-1], modes[1])
    a = np.clip((at - s.first) / s.du, 0.0, len(s.z) - 1.0)
    i = np.minimum(np.floor(a + 1e-9).astype(np.int64), len(s.z) - 2)
    a = np.clip(a - i, 0.0, 1.0)[:, None]
    j = np.clip(np.searchsorted(s.v, across + 1e-12, side='right') - 1, 0, len(s.v) - 2)
    b = np.clip((across - s.v[j]) / (s.v[j + 1] - s.v[j]), 0.0, 1.0)
    # all places are nodes: of these there are many, and nothing is interpolated
    if (b == 0.0).all() and (a == 0.0).all():
        height = s.grid[np.ix_(i, j)].astype(float)
    else:
        low = s.grid[np.ix_(i, j)] * (1.0 - b) + s.grid[np.ix_(i, j + 1)] * b
        height = low * (1.0 - a) + (s.grid[np.ix_(i + 1, j)] * (1.0 - b) + s.grid[np.ix_(i + 1, j + 1)] * b) * a
    height += s.mean
    zero_v = out_v if modes[1] == ZERO else np.zeros_like(out_v)
    height[:, zero_v] = 0.0
    height += s.z[i][:, None] * (1.0 - a) + s.z[i + 1][:, None] * a
    if s.bank is not None:
        bank = s.bank[i][:, None] * (1.0 - a) + s.bank[i + 1][:, None] * a
        height += bank * np.clip(across, s.v[0], s.v[-1])
    gone_u = out_u & (modes[0] in (KEEP, ZERO))
    gone_v = out_v & (modes[1] in (KEEP, ZERO))
    offset = np.where(out_u, offset_u, 0.0)[:, None] + np.where(out_v, offset_v, 0.0)
    added = gone_u[:, None] | gone_v
    if modes[0] == ZERO:
        height[gone_u] = 0.0
    if modes[1] == ZERO:
        height[np.ix_(~gone_u, zero_v)] = 0.0
    height += np.where(added, offset, 0.0)
    return _smoothed(s, height, at, out_u, u, modes[0])


def _smoothed(s: _Surface, height: np.ndarray, at: np.ndarray, out: np.ndarray, u: np.ndarray, mode: int) -> np.ndarray:
    """Heights that fade into the height of the line at its ends, over BORDER_SMOOTH_UBEG and BORDER_SMOOTH_UEND."""
    for key, far, end in (('border_smooth_ubeg', at - s.first, 0), ('border_smooth_uend', s.last - at, -1)):
        zone = s.options.get(key, 0.0)
        if zone < 0.0 or zone > s.last - s.first:
            raise s.crg.refusal(key, f'must be in [0, {s.last - s.first:g}], the length of the road')
        if zone > 0.0:
            base = float(s.z[end]) if s.has_z else 0.0
            scale = np.where(out & (mode in (KEEP, ZERO)) & ((u < s.first) == (end == 0)), 0.0, far / zone)
            inside = scale <= 1.0
            height[inside] = base + (height[inside] - base) * np.clip(scale[inside], 0.0, 1.0)[:, None]
    return height


def _columns(s: _Surface) -> float:
    """Distance [m] of the columns of an even grid on which all long sections lie. Raises SceneError if there is
    none."""
    steps = np.diff(s.v)
    for parts in range(1, MOST_PARTS + 1):
        dv = float(steps.min()) / parts
        count = round(float(s.v[-1] - s.v[0]) / dv)
        dv = float(s.v[-1] - s.v[0]) / count
        at = (s.v - s.v[0]) / dv
        if (count + 1) * len(s.grid) > MOST_NODES:
            break
        if np.abs(at - np.rint(at)).max() * dv < COMMENSURABLE:
            return dv
    remedy = f'place them at multiples of one distance, so that the road has at most {MOST_NODES} heights'
    sections = f'the {len(s.v)} long sections (the nearest two are {steps.min():g} m apart)'
    raise SceneError(f'{s.crg.source}: {sections} lie on no even grid: {remedy}')


def _arrays(s: _Surface) -> dict[str, np.ndarray]:
    """The road as arrays of a curved grid (solver.elements.curved_grid), continued beyond its borders."""
    if s.grid.size > MOST_NODES:
        raise SceneError(
            f'{s.crg.source}: {s.grid.size} heights are too many (at most {MOST_NODES}): give a part of the road'
        )
    dv = _columns(s)
    modes = [int(s.options.get(f'border_mode_{of}', KEEP)) or KEEP for of in 'uv']
    folds = [{REPEAT: 'repeat', REFLECT: 'reflect'}.get(mode, 'keep') for mode in modes]
    moved = [s.options.get(f'border_offset_{of}', 0.0) != 0.0 for of in 'uv']
    beside = [
        BEYOND if fold != 'keep' or mode == ZERO or off else 0
        for fold, mode, off in zip(folds, modes, moved, strict=True)
    ]
    for of, fold, off in zip('uv', folds, moved, strict=True):
        if off and fold != 'keep':
            s.crg.notes.append(
                f'BORDER_OFFSET_{of.upper()} has no effect on a road that goes on beyond that border (BORDER_MODE 3 or '
                '4)'
            )
    rows, count = beside[0], len(s.grid)
    u = s.first + s.du * np.arange(-rows, count + rows)
    around = dv * np.arange(1, beside[1] + 1)
    v = np.concatenate([s.v[0] - around[::-1], s.v, s.v[-1] + around])
    height = _heights(s, u, v)
    for axis, fold, of in zip((0, 1), folds, ('its start and its end', 'its borders'), strict=True):
        if fold == 'repeat':
            a, n = beside[axis], height.shape[axis]
            begin, end = np.take(height, a, axis), np.take(height, n - 1 - a, axis)
            if (step := float(np.abs(begin - end).max())) > STEP:
                ramp = f'the last {(s.du, dv)[axis]:g} m are a ramp over it'
                s.crg.notes.append(f'is repeated with a step of {step:.3g} m between {of}: {ramp}')
                (height if axis == 0 else height.T)[n - 1 - a] = begin
    along = height[:, int(np.argmin(np.abs(v)))].copy()
    over = height - along[:, None]
    kept = over.astype(np.float32) if np.abs(over).max() < SINGLE else over
    straight = s.phi is None or float(np.ptp(s.phi[1:])) == 0.0
    direction = s.places[1] - s.places[0]
    yaw = math.atan2(direction[1], direction[0])
    origin = s.places[0] - s.first * direction / s.du
    frame = Frame(
        float(u[0]), s.du, float(v[0]), dv, float(origin[0]), float(origin[1]), yaw, FOLDS[folds[0]], FOLDS[folds[1]],
        s.first, s.last, float(s.v[0]), float(s.v[-1]),
    )  # fmt: skip
    arrays = {'frame': np.array(frame), 'v': v, 'z': along, 'height': kept}
    if not straight or folds != ['keep', 'keep']:
        normals = _normals(s.places)
        _require_room_in_curves(s, normals)
        arrays['line'] = np.column_stack([s.places, normals])
    return arrays


def _require_room_in_curves(s: _Surface, normals: np.ndarray) -> None:
    """Raise SceneError for a curve that is so tight that rows of the grid cross each other within the road."""
    piece = np.diff(s.places, axis=0)
    for v in (s.v[0], s.v[-1]):
        ahead = ((piece + v * np.diff(normals, axis=0)) * piece).sum(axis=1) / s.du**2
        k = int(np.argmin(ahead))
        if ahead[k] < LEAST_PROGRESS:
            where = f'u = {s.first + s.du * k:g} m'
            fault = f'the radius of its curve at {where} is below the distance of its border (v = {v:g} m)'
            remedy = 'give a narrower road, or headings that change more slowly'
            raise SceneError(f'{s.crg.source}: {fault}, so that rows cross each other; {remedy}')
