"""Roads from OpenCRG files, written here by the standard: against ASAM's own library (pycrg), by law, and what is
refused."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pycrg
import pytest

from solver import stored
from solver.compiled.by_reference import Ref
from solver.elements.between_nodes import from_bilinear
from solver.elements.curved_grid import CurvedGrid
from solver.elements.enveloping import Heights
from solver.elements.road import RoadSpec, compile_road, heights_at, road_at, surface_at, within
from solver.errors import SceneError
from solver.files.crg import Crg, _sections, table_of
from solver.files.crg_surface import DEFAULTS, _heights, _surface, _transform, read_crg

RNG = np.random.default_rng(4)
LIBRARY = 1e-6  # [m]: the library keeps heights in single precision
SECTIONS = tuple(np.linspace(-2.0, 2.0, 9))
UNEVEN = (-1.5, -1.0, -0.25, 0.0, 0.75, 1.5)
ROWS, STEP = 41, 0.5
PHI = 0.3 + np.cumsum(np.random.default_rng(1).normal(0.0, 0.01, ROWS))
SLOPE = np.random.default_rng(2).normal(0.02, 0.01, ROWS)
BANKING = np.random.default_rng(3).normal(0.0, 0.02, ROWS)
LINE = {'phi': PHI, 'slope': SLOPE, 'banking': BANKING}
GRID = np.random.default_rng(5).normal(0.0, 0.02, (ROWS, len(UNEVEN)))


UNITS = {'phi': 'rad', 'slope': 'm/m', 'banking': 'm/m'}


def crg(
    path: Path, table: np.ndarray, channels: Sequence[str], head: str = '', form: str = 'LDFI', more: str = ''
) -> Path:
    """Write an OpenCRG file: rows of channels in one of the four forms. head: entries of $ROAD_CRG; more: further
    sections."""
    definition = '\n'.join(f'D:{name},{UNITS.get(name.split()[-1], "m")}' for name in channels)
    text = (
        f'$CT\ncomment\n$\n{more}$ROAD_CRG\nreference_line_increment = '
        f'{STEP}\n{head}\n$\n$KD_DEFINITION\n#:{form}\n{definition}\n$\n'
    )
    if form[0] == 'K':
        data = table.astype('>f4' if form == 'KRBI' else '>f8').tobytes()
        data += b'\x7f\xf8\0\0' * (-len(data) % 80 // 4)
    else:
        width, per_line = (10, 8) if form == 'LRFI' else (20, 4)
        rows = []
        for row in table:
            cells = [f'{x:{width}.{width - 4}f}' if np.isfinite(x) else '*missing*'.rjust(width) for x in row]
            rows += [''.join(cells[k : k + per_line]) for k in range(0, len(cells), per_line)]
        data = '\n'.join(rows).encode() + b'\n'
    path.write_bytes(text.encode() + b'$' * 72 + b'\n' + data)
    return path


def sections(v: Sequence[float] = SECTIONS) -> list[str]:
    return [f'long section at v = {x:.3f}' for x in v]


def along(
    path: Path,
    channels: Sequence[str] = ('phi', 'slope', 'banking'),
    *,
    options: str = '',
    modifiers: str | None = None,
    head: str = '',
    grid: np.ndarray = GRID,
) -> Path:
    """A road with the channels of LINE and heights at UNEVEN."""
    table = np.column_stack([*(LINE[name] for name in channels), grid])
    entries = {
        'reference_line_start_u': 3.0,
        'reference_line_end_u': 3.0 + STEP * (ROWS - 1),
        'long_section_v_right': UNEVEN[0],
        'long_section_v_left': UNEVEN[-1],
        'reference_line_start_phi': PHI[1],
        'reference_line_end_phi': PHI[-1] if 'phi' in channels else PHI[1],
    }
    head = '\n'.join(f'{key} = {value:.12f}' for key, value in entries.items()) + f'\n{head}'
    more = '' if modifiers is None else f'$ROAD_CRG_MODS\n{modifiers}\n$\n'
    more += f'$ROAD_CRG_OPTS\n{options}\n$\n' if options else ''
    return crg(path, table, [*(f'reference line {name}' for name in channels), *sections(UNEVEN)], head, more=more)


def grid_of(path: Path) -> CurvedGrid:
    fields = read_crg(path)
    assert fields.pop('kind') == 'curved_grid'
    return CurvedGrid(**fields)


def heights(grid: CurvedGrid, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Heights of the road as wheels find it."""
    z = np.zeros(x.size)
    heights_at(Ref(compile_road(RoadSpec(grids=(grid,)))), x.ravel(), y.ravel(), z)
    return z


def compare(path: Path, *, nodes: bool = True, beyond: tuple[float, float] = (1.3, 1.3)) -> CurvedGrid:
    """Against ASAM's library: the file as read, between its nodes and beyond its borders; the road of the solver, at
    the nodes."""
    file = Crg(path=path)
    _sections(path, file, ())
    modifiers = DEFAULTS if file.modifiers is None else file.modifiers
    read = _surface(file, table_of(file), modifiers)
    _transform(read, modifiers)
    grid = grid_of(path)
    with pycrg.DataSet.open(path) as data:
        point = data.create_contact_point()
        (u0, u1), (v0, v1) = data.u_range(), (float(read.v[0]), float(read.v[-1]))
        u = np.sort(u0 + (u1 - u0) * RNG.uniform(-beyond[0], 1.0 + beyond[0], 60))
        v = v0 + (v1 - v0) * RNG.uniform(-beyond[1], 1.0 + beyond[1], 40)
        z = point.uv_to_z_many(*np.meshgrid(u, v, indexing='ij'))
        known = np.isfinite(z)
        assert known.sum() > 100
        np.testing.assert_allclose(_heights(read, u, v)[known], z[known], atol=LIBRARY, rtol=0.0)
        places = np.meshgrid(u0 + read.du * np.arange(len(read.grid)), read.v, indexing='ij')
        x, y = point.uv_to_xy_many(*places)
        if nodes:
            np.testing.assert_allclose(heights(grid, x, y), point.uv_to_z_many(*places).ravel(), atol=LIBRARY, rtol=0.0)
    return grid


@pytest.mark.parametrize('form', ['LRFI', 'LDFI', 'KRBI', 'KDBI'])
def test_every_form_of_numbers(tmp_path: Path, form: str) -> None:
    table = np.round(RNG.uniform(-0.05, 0.05, (21, 9)), 4)
    head = (
        'reference_line_start_u = 0.0\nreference_line_end_u = 10.0 ! metres\nREFERENCE_LINE_START_X = '
        '5\nreference_line_start_phi = 0.5'
    )
    grid = compare(crg(tmp_path / 'road.crg', table, sections(), head, form, '$ROAD_CRG_MODS\n$\n'), beyond=(0.2, 0.0))
    c, s = np.cos(0.5), np.sin(0.5)
    for i, j in ((0, 0), (7, 3), (20, 8)):
        u, v = 0.5 * i, -2.0 + 0.5 * j
        assert heights(grid, np.array([5.0 + u * c - v * s]), np.array([u * s + v * c]))[0] == pytest.approx(
            table[i, j], abs=1e-8
        )


POINT = 'refpoint_x = 1\nrefpoint_y = 2\nrefpoint_z = 3\nrefpoint_phi = 0.4'
OFFSETS = 'refline_offset_x = 1\nrefline_offset_y = 2\nrefline_offset_z = 3\nrefline_offset_phi = 0.3'
MODIFIERS = (
    *(None, ''),
    *(
        'scale_z_grid = 2',
        'scale_slope = 0.5',
        'scale_banking = 3',
        'scale_length = 1.2',
        'scale_width = 0.8',
        'scale_curvature = 0.5',
    ),
    'refpoint_u = 8\nrefpoint_x = 4\nrefpoint_phi = 1',
    f'refpoint_u_fraction = 0.25\nrefpoint_u_offset = 0.3\nrefpoint_v = 0.5\n{POINT}',
    'refpoint_v_fraction = 0.2\nrefpoint_v_offset = 0.1',
    'refpoint_z = 2',
    OFFSETS,
    'refline_rotcenter_x = 4\nrefline_rotcenter_y = 1\nrefline_offset_phi = -0.3',
    'refline_rotcenter_x = 4',
)


@pytest.mark.parametrize('channels', [(), ('phi',), ('slope',), ('banking',), ('phi', 'slope', 'banking')])
def test_modifiers(tmp_path: Path, channels: tuple[str, ...]) -> None:
    for modifiers in MODIFIERS:
        compare(
            along(
                tmp_path / 'road.crg',
                channels,
                modifiers=modifiers,
                head='reference_line_start_x = 5\nreference_line_start_y = -2',
            )
        )


@pytest.mark.parametrize(
    'modifiers', [None, 'grid_nan_mode = 2', 'grid_nan_mode = 1', 'grid_nan_mode = 1\ngrid_nan_offset = 0.1']
)
def test_missing_heights(tmp_path: Path, modifiers: str | None) -> None:
    grid = GRID.copy()
    grid[4, :2] = grid[7, 5] = grid[9, 2] = np.nan
    compare(along(tmp_path / 'road.crg', modifiers=modifiers, grid=grid))


def test_border_modes(tmp_path: Path) -> None:
    """Repeated and reflected to the left and right the library's banking depends on how the sections are given: without
    it here."""
    for u, v in itertools.product(range(5), range(5)):
        channels = ('phi', 'slope') if v > 2 else ('phi', 'slope', 'banking')
        for offsets in ('', 'border_offset_u = 0.2\nborder_offset_v = -0.3'):
            file = along(
                tmp_path / 'road.crg', channels, options=f'border_mode_u = {u}\nborder_mode_v = {v}\n{offsets}'
            )
            grid = compare(file, nodes=3 not in (u, v))  # the last row of a repeated road leads over to its first
            assert (0 in (u, v)) == any('BORDER_MODE 0' in note for note in grid.notes)


@pytest.mark.parametrize('mode', [1, 2, 4])
def test_smoothing(tmp_path: Path, mode: int) -> None:
    options = f'border_mode_u = {mode}\nborder_smooth_ubeg = 3\nborder_smooth_uend = 4'
    compare(along(tmp_path / 'road.crg', options=options))
    compare(
        along(
            tmp_path / 'road.crg',
            (),
            options=options,
            modifiers='',
            head='reference_line_start_z = 2\nreference_line_end_z = 2',
        )
    )


@pytest.mark.parametrize(
    'head',
    [
        'reference_line_start_x = 5\nreference_line_end_x = 23\nreference_line_start_y = -2\nreference_line_end_y = 6',
        'reference_line_start_z = 1\nreference_line_end_z = 2',
        'reference_line_start_z = 1\nreference_line_start_s = 0.1\nreference_line_start_b = 0.03',
    ],
)
def test_a_line_with_given_ends(tmp_path: Path, head: str) -> None:
    compare(along(tmp_path / 'road.crg', modifiers='', head=head), beyond=(0.0, 0.5))
    compare(along(tmp_path / 'road.crg', ('phi',), modifiers='', head=head), beyond=(0.0, 0.5))


@pytest.mark.parametrize('u', ['U:reference line u,m,0,7', 'U:x,m,0,1', 'U:reference line x,m,3,0.25', 'U:u', ''])
def test_virtual_channels_decide_nothing(tmp_path: Path, u: str) -> None:
    file = along(tmp_path / 'road.crg')
    expected = grid_of(file).sha256
    file.write_bytes(file.read_bytes().replace(b'#:LDFI\n', f'#:LDFI\n{u}\n'.encode()))
    assert grid_of(file).sha256 == expected


def test_files_that_refer_to_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sections of the outer file replace those of the inner one, whatever their order; a name may stand in several
    lines."""
    (tmp_path / 'deep').mkdir()
    along(tmp_path / 'deep' / 'road.crg', options='border_mode_v = 1', modifiers='scale_z_grid = 3')
    plain = grid_of(along(tmp_path / 'plain.crg', options='border_mode_v = 1', modifiers='scale_z_grid = 3')).sha256
    other = grid_of(along(tmp_path / 'other.crg', options='border_mode_v = 1', modifiers='scale_z_grid = 2')).sha256
    monkeypatch.setenv('ROADS', str(tmp_path / 'deep'))
    for k, named in enumerate(
        (
            '  deep/road.crg ! relative',
            ' deep/ro\n ad.crg',
            ' $ROADS/road.crg',
            '$ROADS/road.crg',
            f' {tmp_path}/deep/road.crg',
        )
    ):
        for text, expected in (
            (f'$ROAD_CRG_FILE\n* a comment\n{named}\n$\n', plain),
            (f'$ROAD_CRG_FILE\n{named}\n$\n$ROAD_CRG_MODS\nscale_z_grid = 2\n$\n', other),
            (f'$ROAD_CRG_MODS\nscale_z_grid = 2\n$\n$ROAD_CRG_FILE\n{named}\n$\n', other),
            (f'$ROAD_CRG_FILE\n{named}', plain),
            (f'$ROAD_CRG_FILE\n{named}\n$\n$$$$\n', plain),
        ):
            file = tmp_path / f'ref{k}.crg'
            file.write_text(text)
            assert grid_of(file).sha256 == expected
    (tmp_path / 'mods.crg').write_text('$ROAD_CRG_MODS\nscale_z_grid = 2\n$\n')
    (tmp_path / 'two.crg').write_text('$ROAD_CRG_FILE\nmods.crg\ndeep/road.crg\n$\n')
    assert grid_of(tmp_path / 'two.crg').sha256 == other


def circle(path: Path, radius: float = 20.0, count: int = 63) -> Path:
    """A part of a circle to the left with a crest across."""
    table = np.zeros((count, 10))
    table[:, 0] = (np.arange(count) - 0.5) * STEP / radius  # heading of the piece before each place
    table[:, 1:] = 0.05 * np.exp(-(((STEP * np.arange(count) - 15.0) / 2.0) ** 2))[:, None]
    return crg(path, table, ['reference line phi', *sections()], more='$ROAD_CRG_MODS\n$\n')


def test_a_curved_road_runs_where_its_line_does(tmp_path: Path) -> None:
    """The places of a line with pieces of 0.5 m on a circle of 20 m are 1.6 mm beside it at most: 0.5^2 / (8 20)."""
    grid = grid_of(circle(tmp_path / 'road.crg'))
    for length, v in itertools.product((10.0, 15.0, 17.0, 25.0), (-1.5, 0.0, 1.5)):
        angle = length / 20.0
        x, y = (20.0 - v) * np.sin(angle), 20.0 - (20.0 - v) * np.cos(angle)
        assert heights(grid, np.array([x]), np.array([y]))[0] == pytest.approx(
            0.05 * np.exp(-(((length - 15.0) / 2.0) ** 2)), abs=1e-4
        )
        assert within(grid, np.array([x, -x, x + 50.0]), np.array([y, -y, y])).tolist() == [True, False, False]
    assert grid.place(15.0, 1.0) == pytest.approx((19.0 * np.sin(0.75), 20.0 - 19.0 * np.cos(0.75)), abs=2e-3)


@pytest.mark.parametrize('modes', [(2, 2), (3, 4), (4, 3), (2, 1)])
def test_slopes_and_curvatures_are_derivatives(tmp_path: Path, modes: tuple[int, int]) -> None:
    """Of the height by complex steps, of the slopes likewise: on the road, beyond its borders and ends, and inside of
    its curve."""
    options = 'border_mode_u = {}\nborder_mode_v = {}'.format(*modes)
    road = Ref(compile_road(RoadSpec(grids=(grid_of(along(tmp_path / 'road.crg', options=options)),))))
    for x, y in ((5.0, 0.3), (9.7, 1.1), (-3.0, 0.5), (24.0, 7.0), (10.0, -2.7), (12.0, 6.0)):
        _, h_x, h_y, h_xx, h_xy, h_yy = surface_at(road, x, y)
        dx = surface_at(road, complex(x, 1e-30), complex(y))
        dy = surface_at(road, complex(x), complex(y, 1e-30))
        found = [d.imag / 1e-30 for d in (dx[0], dy[0], dx[1], dy[1], dy[2])]
        np.testing.assert_allclose([h_x, h_y, h_xx, h_xy, h_yy], found, atol=1e-9, rtol=1e-9)
    circle_road = Ref(compile_road(RoadSpec(grids=(grid_of(circle(tmp_path / 'circle.crg')),))))
    assert np.isfinite(
        [surface_at(circle_road, x, y)[0] for x in (-30.0, 0.0, 1.0, 60.0) for y in (20.0, 19.0, -60.0)]
    ).all()


def test_a_road_that_is_repeated_goes_on(tmp_path: Path) -> None:
    """A wave whose period is the length of the road, repeated: the same wave, smooth over all seams."""
    u = STEP * np.arange(ROWS)
    table = np.repeat(0.1 * np.sin(2.0 * np.pi * u / u[-1])[:, None], 9, axis=1)
    grid = grid_of(crg(tmp_path / 'road.crg', table, sections(), more='$ROAD_CRG_OPTS\nborder_mode_u = 3\n$\n'))
    assert not any('repeated' in note for note in grid.notes)
    x = np.linspace(-70.0, 90.0, 997)
    np.testing.assert_allclose(heights(grid, x, 0.0 * x), 0.1 * np.sin(2.0 * np.pi * x / u[-1]), atol=1e-5)


def test_numbers_stay_together_with_their_hash(tmp_path: Path) -> None:
    grid = grid_of(along(tmp_path / 'road.crg'))
    data = stored.packed(grid.sha256)
    stored.accept(data, grid.sha256)
    assert stored.find('0' * 64) is None
    for damaged in (
        data[:-9],
        data[:40] + b'x' + data[41:],
        b'',
        b'mbd arrays 1\n',
        b'mbd arrays 1\n[["a", "<f8", [99999999999]]]\n',
    ):
        with pytest.raises(Exception, match='are damaged'):
            stored.accept(damaged, grid.sha256)


HEAD = (
    '$ROAD_CRG\nreference_line_increment = 0.5\n$\n$KD_DEFINITION\n#:LRFI\nD:long section at v = -1,m\nD:long '
    'section at v = 1,m\n$\n'
)
TEXT = HEAD + '$' * 72 + '\n'
ROW = '       0.0       0.0\n'
FLAT = TEXT + 3 * ROW


def with_entry(entry: str) -> str:
    return FLAT.replace('= 0.5', f'= 0.5\n{entry}')


def with_section(name: str, *lines: str) -> str:
    return f'$ROAD_CRG_{name}\n' + ''.join(f'{line}\n' for line in lines) + f'$\n{FLAT}'


@pytest.mark.parametrize(
    ('content', 'words'),
    [
        ('', ': not readable as OpenCRG: it has no data'),
        ('$CT\nnothing here\n', 'has no data'),
        ('\0' * 500, 'has no data'),
        (FLAT.replace('#:LRFI', '#:XYZ'), ':5: data of the form XYZ are not supported'),
        (FLAT.replace('reference_line_increment = 0.5', ''), 'reference_line_increment is missing'),
        (
            FLAT.replace('= 0.5', '= -1'),
            ':2: reference_line_increment = -1: the increment of the reference line must be positive',
        ),
        (with_entry('reference_line_start_x = here'), ':3: reference_line_start_x = here: must be a finite number'),
        (with_entry('reference_line_strat_x = 1'), 'reference_line_strat_x = 1: is no key of this section'),
        (with_entry('reference_line_end_u = 1e9'), ':3: reference_line_end_u = 1000000000: 2e+09 rows'),
        (
            with_entry('reference_line_end_u = 10'),
            'has 3 rows instead of 21, up to reference_line_end_u: it was cut off',
        ),
        (TEXT + ROW, 'has 1 rows of 2 numbers'),
        (TEXT + 3 * '       abc       0.0\n', ':10: column 1 (long section at v = -1) = abc: must be a number'),
        (TEXT + ROW + '       0.0\n' + ROW, ':11: column 2 (long section at v = 1) = nothing: must be a number'),
        (
            TEXT + ROW + '       0.0       0.0       0.0\n',
            ':11: has 30 characters instead of 20: 10 for each of 2 numbers',
        ),
        (TEXT + 3 * ' *missing* *missing*\n', 'row 1 has no height at all'),
        (TEXT + 3 * '  9000000.       0.0\n', 'beyond 1e6'),
        (FLAT.replace('v = 1,', 'v = -1,'), 'the distances of the long sections must be given and differ by 1e-06 m'),
        (
            FLAT.replace('at v = 1,', '2,'),
            'long sections must be given all by v, or all by the numbers 1, 2, ... in this order',
        ),
        (
            TEXT.replace('D:long section at v = 1,m\n', '') + 3 * '       0.0\n',
            'has 1 long sections: must have two or more',
        ),
        (with_section('FILE', 'other.crg'), ':2: other.crg: no such file'),
        ('$ROAD_CRG_FILE\nroad.crg\n$\n', ':2: road.crg: the file refers to itself'),
        (with_section('FILE', ' $NO_SUCH_PLACE/a.crg'), ':2: $NO_SUCH_PLACE: there is no such environment variable'),
        (with_section('FILE', '$NO_SUCH_PLACE/a.crg'), ':2: $NO_SUCH_PLACE: there is no such environment variable'),
        (with_section('FILE', '$NO_SUCH.crg'), ':2: $NO_SUCH: there is no such environment variable'),
        (
            with_section('FILE', '$NO_SUCH_PLACE'),
            'names no file (a word behind a $ in the first column begins a section)',
        ),
        (with_section('FILE'), 'the section $ROAD_CRG_FILE names no file'),
        (
            with_section('MODS', 'scale_zgrid = 2'),
            ':2: scale_zgrid = 2: is no key of this section of OpenCRG 1.2; did you mean',
        ),
        (with_section('MODS', 'grid_nan_mode = 3'), ':2: grid_nan_mode = 3: must be one of 0, 1, 2'),
        (with_section('MODS', 'scale_length = 0'), ':2: scale_length = 0: must be positive'),
        (
            with_section('MODS', 'refpoint_u_offset = 1'),
            ':2: refpoint_u_offset = 1: has an effect beside REFPOINT_U_FRACTION only',
        ),
        (with_section('OPTS', 'border_mode_u = 5'), ':2: border_mode_u = 5: must be one of 0, 1, 2, 3, 4'),
        (
            with_section('OPTS', 'border_smooth_ubeg = 9'),
            ':2: border_smooth_ubeg = 9: must be in [0, 1], the length of the road',
        ),
        (with_section('OPTS', 'something'), ":2: 'something': must be KEY = value"),
    ],
)
def test_what_is_refused(tmp_path: Path, content: str, words: str) -> None:
    path = tmp_path / 'road.crg'
    path.write_text(content)
    with pytest.raises(SceneError) as caught:
        read_crg(path)
    assert words in str(caught.value)
    assert str(path) in str(caught.value)
    assert '\n' not in str(caught.value)


def test_a_curve_tighter_than_the_road_is_wide_is_refused(tmp_path: Path) -> None:
    said = r'the radius of its curve at u = .* is below the distance of its border \(v = 2 m\)'
    with pytest.raises(SceneError, match=said):
        read_crg(circle(tmp_path / 'road.crg', radius=1.9, count=20))


def test_what_has_no_effect_is_told(tmp_path: Path) -> None:
    for head, options, said in (
        ('reference_line_offset_x = 5', '', 'reference_line_offset_x = 5 is of the map'),
        ('reference_line_start_x = 5', '', 'its start at x = 5 m, y = 0 m'),
        ('', 'border_mode_u = 3\nborder_offset_u = 1', 'BORDER_OFFSET_U has no effect'),
        ('', 'border_mode_u = 3', 'is repeated with a step of'),
    ):
        grid = grid_of(along(tmp_path / 'road.crg', head=head, options=options))
        assert any(said in note for note in grid.notes), grid.notes


def test_what_is_given_twice_is_told_and_the_last_counts_as_in_the_library(tmp_path: Path) -> None:
    table = np.round(RNG.uniform(-0.05, 0.05, (21, 9)), 4)
    place = tmp_path / 'road.crg'
    for head, more, said in (
        (
            f'reference_line_increment = {2.0 * STEP}',
            '',
            f'reference_line_increment is given twice: 1 of {place}:6 counts, not 0.5 of {place}:5',
        ),
        (
            'reference_line_start_z = 1\nREFERENCE_LINE_START_Z = 2',
            '$ROAD_CRG_MODS\n$\n',
            'START_Z is given twice: 2 of',
        ),
        (
            '',
            '$ROAD_CRG_MODS\nscale_z_grid = 2\nscale_z_grid = 3\n$\n',
            f'scale_z_grid is given twice: 3 of {place}:6 counts, not 2 of',
        ),
        ('', '$ROAD_CRG_OPTS\nborder_mode_u = 1\nborder_mode_u = 2\n$\n', 'border_mode_u is given twice: 2 of'),
        (
            '',
            '$ROAD_CRG_MODS\nscale_z_grid = 2\n$\n$ROAD_CRG_MODS\nrefline_offset_z = 3\n$\n',
            'road.crg:7: the section $ROAD_CRG_MODS is given twice: that of line 4 is dropped',
        ),
    ):
        grid = compare(crg(place, table, sections(), head, more=more), beyond=(0.0, 0.0))
        assert sum('given twice' in note for note in grid.notes) == 1
        assert any(said in note for note in grid.notes), grid.notes
    crg(place, table, sections())
    assert not any('given twice' in note for note in grid_of(place).notes)
    place.write_text(place.read_text().replace('#:LDFI', '#:LRFI\n#:LDFI'))
    assert any('LDFI of' in note and 'counts, not LRFI of' in note for note in grid_of(place).notes)


def test_a_head_with_tabs_and_a_swapped_exponent(tmp_path: Path) -> None:
    head = 'reference_line_end_u\t= 1.0+e01\nreference_line_start_x\t=\t5'
    grid = grid_of(crg(tmp_path / 'road.crg', np.zeros((21, 9)), sections(), head, more='$ROAD_CRG_MODS\n$\n'))
    assert road_at(Ref(compile_road(RoadSpec(grids=(grid,)))), 5.0, 0.0)[0] == 0.0
    assert grid.heights.origin == pytest.approx((5.0, -2.0))


def test_damaged_files_are_refused_in_one_sentence_or_read(tmp_path: Path) -> None:
    """Bytes, pieces and lines of a file changed by chance: a road, or a refusal that names the file; nothing else, and
    no line break."""
    rng = np.random.default_rng(7)
    whole = along(tmp_path / 'whole.crg', modifiers=POINT, options='border_mode_u = 3').read_bytes()
    pieces = (
        b'nan',
        b'inf',
        b'1e308',
        b'$',
        b'$$$$',
        b'\n',
        b'=',
        b'*',
        b'\0',
        b'scale_width = 1e-9\n',
        b'refpoint_u = 1e8\n',
        b'#:KDBI\n',
    )
    read = 0
    for _ in range(200):
        data = bytearray(whole)
        for _ in range(rng.integers(1, 3)):
            at, kind = int(rng.integers(len(data))), rng.integers(4)
            if kind == 0:
                data[at] = rng.integers(256)
            elif kind == 1:
                data[at:at] = pieces[rng.integers(len(pieces))]
            elif kind == 2:
                del data[at : at + int(rng.integers(1, 100))]
            else:
                start = data.rfind(b'=', 0, 900) + 1
                data[start:start] = b' -' if rng.random() < 0.5 else b'9'
        file = tmp_path / 'damaged.crg'
        file.write_bytes(bytes(data))
        try:
            grid = grid_of(file)
        except SceneError as error:
            assert str(tmp_path) in str(error)
            assert '\n' not in str(error)
        else:
            read += 1
            assert np.isfinite(grid.heights.height).all()
    assert 10 < read < 190


def test_between_its_heights_the_road_differs_from_the_bilinear_one_by_what_is_told(tmp_path: Path) -> None:
    """Against the library in the middle of all cells and of their edges, where the surface is smooth through the same
    heights."""
    path = along(tmp_path / 'road.crg')
    grid = grid_of(path)
    note = next(note for note in grid.notes if 'they differ by up to' in note)
    said = float(re.search(r'by up to ([\d.e-]+) m', note)[1])
    rows, columns = grid.heights.height.shape
    frame = grid.frame
    with pycrg.DataSet.open(path) as data:
        point = data.create_contact_point()
        u = frame.u + frame.du * 0.5 * np.arange(2 * rows - 1)
        v = frame.v + frame.dv * 0.5 * np.arange(2 * columns - 1)
        places = np.meshgrid(u, v, indexing='ij')
        x, y = point.uv_to_xy_many(*places)
        apart = np.abs(heights(grid, x, y) - point.uv_to_z_many(*places).ravel())
    assert apart.max() == pytest.approx(said, rel=0.06, abs=LIBRARY)  # it is told with two digits
    assert said > 10.0 * LIBRARY


def test_a_flat_road_differs_nowhere_and_a_slope_at_its_border_only() -> None:
    """Beyond its border a road is level, and the spline bends there; of what is rough the difference is of the order of
    the heights."""
    slope = np.add.outer(0.1 * np.arange(40.0), 0.03 * np.arange(7.0))
    flat, edge, rough = (
        from_bilinear(Heights((0.0, 0.0), (0.01, 0.02), 0.0, height))
        for height in (np.full((5, 5), 0.3), slope, np.random.default_rng(2).normal(size=(100, 9)))
    )
    assert flat.distance < 1e-12
    assert 1e-4 < edge.distance < 0.1 and edge.node[0] in (0, 38)
    assert 0.1 < rough.distance < 3.0
