"""The surface that an OpenCRG file describes: reference line, modifiers, options, and the nodes that stand for it.

Heights and places of the nodes are those of ASAM's library (crgLoader.c, crgMgr.c, crgEvalz.c, crgEvaluv2xy.c) [ASAM2020].
Between the nodes, where the library is bilinear, the solver goes smoothly through the same heights.
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

KEEP, ZERO, REPEAT, REFLECT = 2, 1, 3, 4  # of BORDER_MODE_U and BORDER_MODE_V; 0: the road ends
# Without a section of modifiers those of ASAM's library are in force (crgOptionSetDefaultModifiers)
DEFAULTS = {'grid_nan_mode': 2.0, 'refpoint_x': 0.0, 'refpoint_y': 0.0, 'refpoint_z': 0.0, 'refpoint_phi': 0.0}
CURVATURE_LENGTH = 0.5  # [m] from the ends of a line, where the library takes the heading of the end
LEAST_PROGRESS = 0.05  # of the distance of two rows, at the borders: rows that meet there have no places between them
COMMENSURABLE = 1e-6  # [m]: sections are so near to columns at equal distances
MOST_PARTS = 1000  # of the least distance of two sections
SINGLE = 8.0  # [m]: heights over the line below it are kept in single precision, to 2.4e-7 m
STEP = 1e-6  # [m]: a road that is repeated is told to have a step from here on


@dataclass(kw_only=True)
class _Surface:
    """The road after its modifiers.

    first, du: of the rows [m]. heading: at the start, as the file says [rad]. phi: of the piece before each place [rad], None of a straight
    line. z: of the line [m]. bank: [-], None without. v: of the sections [m]. grid: heights over the line [m], (rows, sections). places:
    (rows, 2) of the line [m]. has_z: whether z is given. mean: added to the grid [m].
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
        return self.first + self.du * (len(self.grid) - 1)


def read_crg(path: Path) -> dict[str, Any]:
    """The fields of a curved grid (solver.elements.curved_grid.CurvedGrid) with its kind. Raises SceneError."""
    crg = parsed(path)
    return fields_of(crg, table_of(crg))


def fields_of(crg: Crg, table: np.ndarray) -> dict[str, Any]:
    """The fields of a curved grid for a file and its numbers. Raises SceneError."""
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
            f'between its heights the road is smooth, where the library of ASAM is bilinear: they differ by up to {apart:.2g} m, '
            f'at u = {u:.6g} m, v = {v:.4g} m'
        )
    return {'kind': 'curved_grid', 'sha256': digest, 'file': str(crg.path), 'notes': tuple(crg.notes)}


def _channel(crg: Crg, table: np.ndarray, word: str, first: int) -> np.ndarray | None:
    """A channel of the reference line; all its numbers from row `first` on must be there."""
    found = [k for k, name in enumerate(crg.channels) if name.startswith('reference line') and name.split()[2:3] == [word]]
    if not found:
        return None
    values = table[:, found[0]].astype(float)
    holes = np.flatnonzero(np.isnan(values[first:]))
    if len(holes):
        place = crg.where[f'D:{found[0] + 1}']
        raise SceneError(f'{place}: reference line {word}: its number in row {int(holes[0]) + first + 1} is missing')
    return values


def _surface(crg: Crg, table: np.ndarray, modifiers: dict[str, float]) -> _Surface:
    columns, v = sections_of(crg)
    known = {'phi', 'slope', 'banking'}
    for k, name in enumerate(crg.channels):
        words = name.split()
        if words[:2] == ['reference', 'line'] and words[2:3] and words[2] in ('u', 'x', 'y') and 'reference line phi' not in crg.channels:
            remedy = 'is not the line of an OpenCRG 1.2 file: give the headings, D:reference line phi,rad'
            raise SceneError(f'{crg.where[f"D:{k + 1}"]}: {name}: {remedy}')
        if not name.startswith('long section') and not (words[:2] == ['reference', 'line'] and words[2:3] and words[2] in known):
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
    # modifiers, in the order of crgDataSetModifiersApply
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
        crg=crg, first=first, du=du, heading=heading, phi=phi, z=z, bank=bank, v=v, grid=grid, options=crg.options or {}, places=places,
        has_z=has_z or 'reference_line_start_z' in road,
    )  # fmt: skip


def _fill(crg: Crg, grid: np.ndarray, modifiers: dict[str, float]) -> None:
    """Put numbers where heights are missing, in place: GRID_NAN_MODE and GRID_NAN_OFFSET."""
    rows = np.flatnonzero(np.isnan(grid).any(axis=1))
    if not len(rows):
        return
    mode, offset = modifiers.get('grid_nan_mode', 0.0), modifiers.get('grid_nan_offset', 0.0)
    if mode == 0.0:
        who = 'are to stay missing (GRID_NAN_MODE 0): those beside them, to the right, stand there'
        crg.notes.append(f'heights are missing in {len(rows)} rows and {who}')
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


def _profile(crg: Crg, count: int, du: float, slope: np.ndarray | None, start_s: float, end: float | None) -> tuple[np.ndarray, bool]:
    """Heights of the line, and whether they are integrated (calcRefLineZ)."""
    start = crg.road.get('reference_line_start_z', 0.0)
    if slope is None and start_s == 0.0:
        if end is not None and abs(end - start) > STEP:
            note = f'reference_line_end_z = {end:g} without a slope: the line stays at {start:g} m, as in the library of ASAM'
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
    """(count, 2) places of the line (calcRefLine): headings integrated from its start; from its end too, where that is given."""
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
    """(n, 1) of vectors (n, 2), by operations whose rounding is the same on every processor."""
    x, y = vectors.T
    return np.sqrt(x * x + y * y)[:, None]


def _normals(places: np.ndarray) -> np.ndarray:
    """(rows, 2) of each row: along it from the line, as long as the pieces beside it stay one metre apart (crgDataEvaluv2xy)."""
    across = np.concatenate([places[1:2] - places[:1], places[2:] - places[:-2], places[-1:] - places[-2:-1]])
    normal = np.column_stack([-across[:, 1], across[:, 0]])
    normal /= _length(normal)
    piece = np.diff(places, axis=0)
    piece = np.concatenate([piece, piece[-1:]])
    piece = np.column_stack([-piece[:, 1], piece[:, 0]]) / _length(piece)
    return normal / (normal * piece).sum(axis=1)[:, None]


def _place(s: _Surface, u: float, v: float) -> np.ndarray:
    """x, y of u, v (crgDataEvaluv2xy)."""
    at = (u - s.first) / s.du
    k = min(max(int(at), 0), len(s.places) - 2)
    ends = s.places[k : k + 2] + v * _normals(s.places[max(k - 1, 0) : k + 3])[k - max(k - 1, 0) :][:2]
    return ends[0] + (at - k) * (ends[1] - ends[0])


def _heading(s: _Surface, u: float) -> float:
    """The heading that the library moves to the new one (crgDataEvaluv2pk of 2.0): of the start, the end, or the piece at u."""
    if s.phi is None:
        return s.heading
    k = min(max(int((u - s.first) / s.du), 0), len(s.phi) - 2)
    near = max(int(CURVATURE_LENGTH / s.du), 1)
    if near > k:
        return s.heading
    return float(s.phi[k + 1]) if k + near < len(s.phi) else s.crg.road.get('reference_line_end_phi', float(s.phi[-1]))


def _transform(s: _Surface, modifiers: dict[str, float]) -> None:
    """Move the road: by a point of it that comes to a given place, or by offsets (crgDataApplyTransformations)."""
    # what moves a road by a point of it; the offset of u or v alone does nothing there
    by_point = [key for key in modifiers if key.startswith('refpoint_') and not key.endswith('_offset')]
    for of, fraction in (('u', 'refpoint_u_fraction'), ('v', 'refpoint_v_fraction')):
        if f'refpoint_{of}_offset' in modifiers and modifiers[f'refpoint_{of}_offset'] != 0.0 and fraction not in modifiers:
            raise s.crg.refusal(f'refpoint_{of}_offset', f'has an effect beside {fraction.upper()} only: give that, too')
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
    """Place that x stands for, beyond the borders."""
    if mode == REPEAT:
        return np.where((x < first) | (x > last), first + np.mod(x - first, last - first), x)
    if mode == REFLECT:
        return first + np.abs(np.mod(x - first + (last - first), 2.0 * (last - first)) - (last - first))
    return np.clip(x, first, last)


def _heights(s: _Surface, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(u, v) heights, bilinear between the nodes, with all options (crgDataEvaluv2z)."""
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
    if (b == 0.0).all() and (a == 0.0).all():  # nodes, of which there are many
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
    """Heights that fade to those of the line at its ends over BORDER_SMOOTH_UBEG and BORDER_SMOOTH_UEND."""
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
    """The distance of columns at equal distances on which all sections lie."""
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
    remedy = f'sections at multiples of a distance of which {MOST_NODES} heights make the road, or at equal distances'
    raise SceneError(
        f'{s.crg.source}: the distances of the {len(s.v)} long sections (the least {steps.min():g} m) have no common part: take {remedy}'
    )


def _arrays(s: _Surface) -> dict[str, np.ndarray]:
    """The road as arrays (solver.elements.curved_grid)."""
    if s.grid.size > MOST_NODES:
        raise SceneError(f'{s.crg.source}: {s.grid.size} heights are too many (at most {MOST_NODES}): give a part of the road')
    dv = _columns(s)
    modes = [int(s.options.get(f'border_mode_{of}', KEEP)) or KEEP for of in 'uv']
    folds = [{REPEAT: 'repeat', REFLECT: 'reflect'}.get(mode, 'keep') for mode in modes]
    moved = [s.options.get(f'border_offset_{of}', 0.0) != 0.0 for of in 'uv']
    beside = [BEYOND if fold != 'keep' or mode == ZERO or off else 0 for fold, mode, off in zip(folds, modes, moved, strict=True)]
    for of, fold, off in zip('uv', folds, moved, strict=True):
        if off and fold != 'keep':
            s.crg.notes.append(f'BORDER_OFFSET_{of.upper()} has no effect on a road that goes on beyond that border (BORDER_MODE 3 or 4)')
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
                s.crg.notes.append(f'is repeated with a step of {step:.3g} m between {of}: the last {(s.du, dv)[axis]:g} m lead over it')
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
    """Raise SceneError where rows cross each other within the road."""
    piece = np.diff(s.places, axis=0)
    for v in (s.v[0], s.v[-1]):
        ahead = ((piece + v * np.diff(normals, axis=0)) * piece).sum(axis=1) / s.du**2
        k = int(np.argmin(ahead))
        if ahead[k] < LEAST_PROGRESS:
            where = f'u = {s.first + s.du * k:g} m'
            remedy = f'its curve at {where} is tighter than the road is wide there (v = {v:g} m): rows of the grid cross each other'
            raise SceneError(f'{s.crg.source}: {remedy}; give a narrower road, or headings that change more slowly')
