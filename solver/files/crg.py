"""Roads from OpenCRG files (.crg): heights along a reference line, as a raster in the plane.

Format: ASAM OpenCRG 1.2 user manual. Read are the text forms LRFI, LDFI and the binary forms KRBI, KDBI; the reference line by its
heading, its height by slope or by the heights of its ends, banking, and sections at equal or given distances from it. A straight road
keeps its grid; a curved one is sampled anew on a grid along x and y. Beyond its borders a road goes on as at them. Modifiers and
references to other files are refused, options (of the evaluation at borders, of smoothing) are not used.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solver.compiled.elementary import cos, sin
from solver.elements.road_grids import LARGEST_RASTER
from solver.errors import SceneError
from solver.files.raster import content_of, packed

_FORMS = {'LRFI': (10, 8, ''), 'LDFI': (20, 4, ''), 'KRBI': (0, 0, '>f4'), 'KDBI': (0, 0, '>f8')}
_HEADER = re.compile(r'([A-Za-z_][\w]*)[\s.]*=\s*(\S+)')
STRAIGHT = 1e-6  # [rad]: headings of a straight road differ by less
HOLES = 'grid_nan_mode'  # a modifier about missing numbers, which are always those of their neighbours here
LARGEST_NUMBER = 1e9
CLOSEST = 1e-3  # [m] between two long sections
FINEST = 0.02  # [m]: a curved road is not sampled finer
BLOCK = 256  # nodes that are looked for together


@dataclass(frozen=True, kw_only=True)
class _Definition:
    """What the head of a file says. numbers: by lower-case name; u: (start, increment); channels: names; form: of the data."""

    numbers: dict[str, float]
    u: tuple[float, float]
    channels: list[str]
    form: str
    data: bytes


def read_crg(path: Path) -> dict[str, Any]:
    """The fields of a raster grid (solver.elements.road_grids.RasterGrid) with its kind. Raises SceneError."""
    head = _definition(path, content_of(path))
    table = _table(path, head)
    phi, z, v, heights = _surface(path, head, table)
    du = head.u[1]
    first = head.numbers.get('reference_line_start_phi', 0.0)
    x0 = head.numbers.get('reference_line_start_x', 0.0)
    y0 = head.numbers.get('reference_line_start_y', 0.0)
    if np.abs(phi - first).max() < STRAIGHT:
        v, heights = _uniform(path, v, heights)
        c, s = math.cos(first), math.sin(first)
        origin = (x0 - v[0] * s, y0 + v[0] * c)  # v counts to the left
        return _grid(path, origin, (du, float(v[1] - v[0])), first, heights + z[:, None])
    x = x0 + np.concatenate(([0.0], np.cumsum(cos(phi[1:]) * du)))
    y = y0 + np.concatenate(([0.0], np.cumsum(sin(phi[1:]) * du)))
    return _sampled(path, (x, y, phi), v, heights + z[:, None], du)


def _definition(path: Path, data: bytes) -> _Definition:
    """Everything before the data."""
    numbers: dict[str, float] = {}
    channels: list[str] = []
    section, form, u, at = '', '', None, 0
    while at < len(data):
        end = data.find(b'\n', at)
        end = len(data) if end < 0 else end
        line = data[at:end].decode('latin-1').rstrip('\r')
        at = end + 1
        if line.startswith('$$$$') and form:
            break
        bare = line.split('!')[0].strip()
        if line.startswith('$'):
            section = bare[1:].split()[0].upper() if bare[1:].split() else ''
        elif section in ('ROAD_CRG_FILE', 'ROAD_CRG_MODS') and bare and not bare.startswith('*') and not bare.lower().startswith(HOLES):
            what = 'a reference to another file' if section == 'ROAD_CRG_FILE' else f'modifiers ({bare.split()[0]})'
            raise SceneError(f'{path}: has {what}, which is not supported: write the road with them in place')
        elif section == 'ROAD_CRG' and (match := _HEADER.match(bare)):
            numbers[match[1].lower()] = _float(path, match[1], match[2])
        elif section == 'KD_DEFINITION' and bare.startswith('#:'):
            form = bare[2:].strip().upper()
        elif section == 'KD_DEFINITION' and bare[:2].upper() == 'U:':
            cells = bare.split(',')
            if len(cells) >= 4:
                u = (_float(path, 'u', cells[2]), _float(path, 'u', cells[3]))
        elif section == 'KD_DEFINITION' and bare[:2].upper() == 'D:':
            channels.append(bare[2:].split(',')[0].strip().lower())
    else:
        raise SceneError(f'{path}: not readable as OpenCRG: it has no data (a line that begins with $$$$)')
    if form not in _FORMS:
        raise SceneError(f'{path}: data of the form {form or "none"} are not supported; allowed: {", ".join(_FORMS)}')
    if u is None:
        u = (numbers.get('reference_line_start_u', 0.0), numbers.get('reference_line_increment', 0.0))
    if not (u[1] > 0.0 and math.isfinite(u[1]) and math.isfinite(u[0])):
        raise SceneError(f'{path}: the increment of the reference line is {u[1]:g}: must be positive')
    if sum('long section' in c for c in channels) < 2:
        raise SceneError(f'{path}: has {sum("long section" in c for c in channels)} long sections: must have two or more')
    return _Definition(numbers=numbers, u=u, channels=channels, form=form, data=data[at:])


def _float(path: Path, key: str, text: str) -> float:
    try:
        value = float(re.sub('[dD]', 'e', text))
    except ValueError:
        value = math.nan
    if not abs(value) <= LARGEST_NUMBER:
        raise SceneError(f'{path}: {key} = {text}: must be a finite number below {LARGEST_NUMBER:g}')
    return value


def _table(path: Path, head: _Definition) -> np.ndarray:
    """The data, one row per place along the line and one column per channel; missing numbers are NaN."""
    width, per_line, kind = _FORMS[head.form]
    columns, expected = len(head.channels), _expected_rows(head)
    if kind:
        rows = len(head.data) // (columns * np.dtype(kind).itemsize)
        rows = min(rows, expected) if expected else rows
        with np.errstate(invalid='ignore'):  # NaN of any kind stands for a missing number
            found = np.frombuffer(head.data, kind, rows * columns).astype(float).reshape(rows, columns)
    else:
        lines_of_row = -(-columns // per_line)
        lines = [line for line in head.data.decode('latin-1').splitlines() if line.strip() and line[0] not in '$']
        rows = len(lines) // lines_of_row
        found = np.full((rows, columns), np.nan)
        for k in range(rows):
            text = ''.join(line.ljust(width * per_line) for line in lines[k * lines_of_row : (k + 1) * lines_of_row])
            for j in range(columns):
                found[k, j] = _cell(path, text[j * width : (j + 1) * width])
    if rows < expected - 1:  # the end may lie between two rows
        raise SceneError(f'{path}: has {rows} rows instead of {expected}, up to reference_line_end_u: it was cut off')
    if rows < 2:
        raise SceneError(f'{path}: has {rows} rows of {columns} numbers: must have two or more')
    if found.size > LARGEST_RASTER:
        raise SceneError(f'{path}: {found.size} numbers are too many (at most {LARGEST_RASTER}): give a part of the road')
    if np.isinf(found).any() or np.nanmax(np.abs(found), initial=0.0) > 1e6:
        raise SceneError(f'{path}: has numbers beyond 1e6: the file is damaged, or has another byte order')
    return found


def _cell(path: Path, text: str) -> float:
    text = text.strip()
    if not text or text.startswith('*') or text.lower() == 'nan':
        return math.nan
    return _float(path, 'data', text)


def _expected_rows(head: _Definition) -> int:
    end = head.numbers.get('reference_line_end_u')
    return 0 if end is None else round((end - head.u[0]) / head.u[1]) + 1


def _surface(path: Path, head: _Definition, table: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(heading [rad] and height [m] of the line at each place, distances v to the left [m], heights over the line (places, v) [m])."""
    names, count = head.channels, table.shape[0]
    du = head.u[1]

    def channel(word: str) -> np.ndarray | None:
        found = [k for k, name in enumerate(names) if word in name and 'long section' not in name]
        return np.nan_to_num(table[:, found[0]]) if found else None

    phi = channel('phi')
    first = head.numbers.get('reference_line_start_phi', 0.0)
    if phi is None:
        phi = np.full(count, first)
    else:
        phi = np.concatenate((phi[1:2], phi[1:]))  # the first is not used: phi of a place is the heading of the piece before it
        if 'reference_line_start_phi' not in head.numbers:
            head.numbers['reference_line_start_phi'] = float(phi[0])
    slope = channel('slope')
    start = head.numbers.get('reference_line_start_z', 0.0)
    if slope is not None:
        z = start + np.concatenate(([0.0], np.cumsum(slope[1:] * du)))
    else:
        steady = head.numbers.get('reference_line_start_s', 0.0)
        end = head.numbers.get('reference_line_end_z', start + steady * du * (count - 1))
        z = start + (end - start) * np.arange(count) / (count - 1)
    sections = [k for k, name in enumerate(names) if 'long section' in name]
    at = [re.search(r'v\s*=\s*([-+.\deE]+)', names[k]) for k in sections]
    if all(at):
        v = np.array([_float(path, 'v', m[1]) for m in at if m])
    else:
        half = 0.5 * head.numbers.get('long_section_v_increment', math.nan) * (len(sections) - 1)
        right = head.numbers.get('long_section_v_right', -half)
        left = head.numbers.get('long_section_v_left', half)
        v = np.linspace(right, left, len(sections))
    order = np.argsort(v)
    v, heights = v[order], table[:, sections][:, order]
    if not np.isfinite(v).all() or np.diff(v).min() < CLOSEST:
        remedy = f'must be given and differ by {CLOSEST:g} m (LONG_SECTION_V_RIGHT, LONG_SECTION_V_LEFT)'
        raise SceneError(f'{path}: the distances of the long sections {remedy}')
    banking = channel('banking')
    if banking is None:
        banking = np.full(count, head.numbers.get('reference_line_start_b', 0.0))
    return phi, z, v, _filled(path, v, heights) + banking[:, None] * v[None, :]


def _filled(path: Path, v: np.ndarray, heights: np.ndarray) -> np.ndarray:
    """Missing heights of a row are those between its neighbours, or of the border."""
    holes = np.isnan(heights)
    for k in np.flatnonzero(holes.any(axis=1)):
        known = ~holes[k]
        if not known.any():
            raise SceneError(f'{path}: row {k} has no height at all')
        heights[k] = np.interp(v, v[known], heights[k][known])
    return heights


def _uniform(path: Path, v: np.ndarray, heights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same surface at equal distances, linear between the given ones."""
    steps = np.diff(v)
    if np.ptp(steps) < 1e-6 * steps.max():
        return v, heights
    count = max(round((v[-1] - v[0]) / steps.min()), 1) + 1
    if count * len(heights) > LARGEST_RASTER:
        raise SceneError(f'{path}: {count * len(heights)} heights at equal distances are too many (at most {LARGEST_RASTER})')
    even = np.linspace(v[0], v[-1], count)
    return even, np.array([np.interp(even, v, row) for row in heights])


def _sampled(path: Path, line: tuple[np.ndarray, np.ndarray, np.ndarray], v: np.ndarray, heights: np.ndarray, du: float) -> dict[str, Any]:
    """A curved road on a grid along x and y: each node takes the height at the nearest place of the line."""
    x, y, phi = line
    step = max(min(du, float(np.diff(v).min())), FINEST)
    reach = max(abs(v[0]), abs(v[-1]))
    low = np.array([x.min() - reach, y.min() - reach])
    shape = [math.ceil((high + reach - a) / step) + 1 for high, a in ((x.max(), low[0]), (y.max(), low[1]))]
    if shape[0] * shape[1] > LARGEST_RASTER:
        remedy = 'give a shorter part of the road, or a coarser one'
        raise SceneError(f'{path}: the curved road covers {shape[0]} x {shape[1]} nodes of {step:g} m (at most {LARGEST_RASTER}): {remedy}')
    along, left = cos(phi), sin(phi)
    out = np.empty(shape)
    ys = low[1] + step * np.arange(shape[1])
    for i in range(shape[0]):
        px = low[0] + step * i
        near = _nearest(px, ys, x, y, reach + 4.0 * step)
        ahead = np.minimum(near + 1, len(phi) - 1)
        dx, dy = px - x[near], ys - y[near]
        c, s = along[ahead], left[ahead]
        u = np.clip(near + (dx * c + dy * s) / du, 0.0, len(x) - 1.0)
        across = np.clip(dy * c - dx * s, v[0], v[-1])
        k = np.minimum(u.astype(np.int64), len(x) - 2)
        part = u - k
        j = np.clip(np.searchsorted(v, across, side='right') - 1, 0, len(v) - 2)
        side = (across - v[j]) / (v[j + 1] - v[j])
        before = heights[k, j] * (1.0 - side) + heights[k, j + 1] * side
        after = heights[k + 1, j] * (1.0 - side) + heights[k + 1, j + 1] * side
        out[i] = before * (1.0 - part) + after * part
    return _grid(path, (float(low[0]), float(low[1])), (step, step), 0.0, out)


def _nearest(px: float, ys: np.ndarray, x: np.ndarray, y: np.ndarray, reach: float) -> np.ndarray:
    """Index of the place of a line x, y (n,) that is nearest to each of the points px, ys (m,) [m]; of one farther than `reach` from the
    line, which is off the road, some place about as near."""
    near = np.empty(len(ys), np.int64)
    for first in range(0, len(ys), BLOCK):
        part = ys[first : first + BLOCK]
        k = np.flatnonzero((np.abs(x - px) <= reach) & (y >= part[0] - reach) & (y <= part[-1] + reach))
        if not len(k):
            k = np.arange(0, len(x), max(len(x) // BLOCK, 1))
        dx, dy = x[k] - px, part[:, None] - y[k]
        near[first : first + BLOCK] = k[np.argmin(dx * dx + dy * dy, axis=1)]
    return near


def _grid(path: Path, origin: tuple[float, float], step: tuple[float, float], yaw: float, heights: np.ndarray) -> dict[str, Any]:
    if heights.size > LARGEST_RASTER:
        raise SceneError(f'{path}: {heights.size} heights are too many (at most {LARGEST_RASTER})')
    return {
        'kind': 'raster_grid',
        'origin': tuple(map(float, origin)),
        'step': tuple(map(float, step)),
        'yaw': float(yaw),
        'raster': packed(path, heights),
    }
