"""Roads from files: pictures, arrays and OpenCRG, written here by their specifications, and what is refused."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from solver.elements.road import FrictionMap, RasterGrid, RoadSpec, compile_road, road_at
from solver.elements.road_grids import Raster
from solver.errors import SceneError, SpecError
from solver.files.crg import read_crg
from solver.files.raster import read_npz, read_png
from solver.files.scene import load_scene, load_scene_text

RNG = np.random.default_rng(4)


def png(path: Path, grey: np.ndarray, filters: int | None = None, depth: int = 16) -> Path:
    """Write rows of integers as a greyscale picture; filters: the filter of every row, None: row k has filter k mod 5."""
    height, width = grey.shape
    size = depth // 8
    rows = [row.astype('>u2' if depth == 16 else 'u1').tobytes() for row in grey]
    packed, above = b'', bytes(width * size)
    for k, row in enumerate(rows):
        kind = k % 5 if filters is None else filters
        line = bytearray()
        for i, byte in enumerate(row):
            a, b, c = (row[i - size] if i >= size else 0), above[i], (above[i - size] if i >= size else 0)
            p = a + b - c
            paeth = min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]
            line.append((byte - (0, a, b, (a + b) // 2, paeth)[kind]) & 255)
        packed += bytes([kind]) + bytes(line)
        above = row

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack('>I', len(body)) + kind + body + struct.pack('>I', zlib.crc32(kind + body))

    head = struct.pack('>IIBBBBB', width, height, depth, 0, 0, 0, 0)
    path.write_bytes(b'\x89PNG\r\n\x1a\n' + chunk(b'IHDR', head) + chunk(b'IDAT', zlib.compress(packed)) + chunk(b'IEND', b''))
    return path


@pytest.mark.parametrize('depth', [8, 16])
def test_pictures_with_every_filter(tmp_path: Path, depth: int) -> None:
    """The first index of the raster runs to the right, the second up."""
    grey = RNG.integers(0, 2**depth, (11, 7))
    values = read_png(png(tmp_path / 'a.png', grey, depth=depth)).values
    np.testing.assert_allclose(values, (grey / (2**depth - 1))[::-1].T, atol=0.5 / 65535)


@pytest.mark.parametrize('name', ['height', 'z'])
def test_arrays(tmp_path: Path, name: str) -> None:
    values = RNG.normal(size=(5, 9))
    np.savez_compressed(tmp_path / 'a.npz', **{name: values})
    np.testing.assert_allclose(read_npz(tmp_path / 'a.npz').values, values, atol=0.51 * np.ptp(values) / 65535)


def test_a_scene_takes_heights_and_friction_from_files_and_keeps_them(tmp_path: Path) -> None:
    png(tmp_path / 'bumps.png', np.array([[0, 0, 0, 0], [0, 0, 0, 0], [0, 65535, 0, 0]]), 0)
    np.savez(tmp_path / 'ice.npz', factor=np.array([[1.0, 1.0], [0.2, 0.2], [0.2, 0.2]]))
    scene = tmp_path / 'scene.yaml'
    scene.write_text(
        'vehicle: vehicles/light_car.yaml\nroad:\n'
        '  grids: [{kind: raster_grid, origin: [1, 2], step: [0.5, 0.5], scale: 0.04, raster: bumps.png}]\n'
        '  maps: [{origin: [0, -5], step: [10, 10], raster: ice.npz}]\n'
        'start: {kind: equilibrium, speed_kmh: 20}\nduration: 0.1\n'
    )
    loaded = load_scene(scene)
    again = load_scene_text(loaded.resolved)
    assert again.model.road == loaded.model.road
    road = compile_road(again.model.road)
    assert road_at(road, 1.5, 2.0)[0] == pytest.approx(0.04, rel=1e-6)  # second from the left, lowest row
    assert road_at(road, 1.5, 3.0)[0] == pytest.approx(0.0, abs=1e-12)
    factors = [road_at(road, x, 0.0)[2] for x in (-50.0, 5.0, 10.0, 40.0)]
    assert factors[0] == pytest.approx(1.0)
    assert factors[-1] == pytest.approx(0.2)
    assert 0.2 < factors[2] < factors[1] < 1.0


def crg(path: Path, form: str, table: np.ndarray, head: str, channels: list[str]) -> Path:
    """Write an OpenCRG file: rows of channels in one of the four forms."""
    definition = '\n'.join(f'D:{name},m' for name in channels)
    text = (
        f'$CT\ncomment\n$\n$ROAD_CRG\n{head}\n$\n$KD_DEFINITION\n#:{form}\nU:reference line u,m,0,0.5\n{definition}\n$\n' + '$' * 72 + '\n'
    )
    if form[0] == 'K':
        data = table.astype('>f4' if form == 'KRBI' else '>f8').tobytes()
        data += bytes(-len(data) % 80)
    else:
        width, per_line = (10, 8) if form == 'LRFI' else (20, 4)
        rows = []
        for row in table:
            cells = [f'{x:{width}.{width - 4}f}' if np.isfinite(x) else '*missing*'.rjust(width) for x in row]
            rows += [''.join(cells[k : k + per_line]) for k in range(0, len(cells), per_line)]
        data = '\n'.join(rows).encode() + b'\n'
    path.write_bytes(text.encode() + data)
    return path


SECTIONS = [f'long section at v = {v:.3f}' for v in np.linspace(-2.0, 2.0, 9)]


@pytest.mark.parametrize('form', ['LRFI', 'LDFI', 'KRBI', 'KDBI'])
def test_a_straight_opencrg_road_keeps_its_grid(tmp_path: Path, form: str) -> None:
    table = np.round(RNG.uniform(-0.05, 0.05, (21, 9)), 4)
    head = 'reference_line_start_u = 0.0\nreference_line_end_u = 10.0 ! metres\nREFERENCE_LINE_START_X = 5\nreference_line_start_phi = 0.5'
    fields = read_crg(crg(tmp_path / 'road.crg', form, table, head, SECTIONS))
    assert fields.pop('kind') == 'raster_grid'
    grid = RasterGrid(**fields)
    assert grid.step == (pytest.approx(0.5), pytest.approx(0.5))
    np.testing.assert_allclose(grid.heights.height, table, atol=1e-6)  # a range of 0.1 m in 65535
    road = compile_road(RoadSpec(grids=(grid,)))
    c, s = np.cos(0.5), np.sin(0.5)
    for i, j in ((0, 0), (7, 3), (20, 8)):
        u, v = 0.5 * i, -2.0 + 0.5 * j
        assert road_at(road, 5.0 + u * c - v * s, u * s + v * c)[0] == pytest.approx(table[i, j], abs=2e-6)


@pytest.mark.parametrize('form', ['LRFI', 'KRBI'])
def test_a_head_with_tabs_is_read_and_a_road_that_was_cut_off_is_refused(tmp_path: Path, form: str) -> None:
    table = np.zeros((21, 9))
    file = crg(tmp_path / 'road.crg', form, table, 'reference_line_end_u\t= 10.0\nreference_line_start_x\t=\t5', SECTIONS)
    assert read_crg(file)['origin'] == (5.0, -2.0)
    data = file.read_bytes()
    file.write_bytes(data[: len(data) - (len(data) - data.index(b'$$$$')) // 4])
    with pytest.raises(SceneError, match=r'has 1\d rows instead of 21, up to reference_line_end_u: it was cut off'):
        read_crg(file)


def test_slope_banking_and_missing_numbers(tmp_path: Path) -> None:
    table = np.zeros((21, 11))
    table[:, 0], table[:, 1] = 0.1, 0.02  # slope, banking
    table[4, 2:5] = np.nan
    names = ['reference line slope', 'reference line banking', *SECTIONS]
    height = read_crg(crg(tmp_path / 'road.crg', 'KDBI', table, 'reference_line_start_z = 3.0', names))['raster'].values
    u, v = 0.5 * np.arange(21), np.linspace(-2.0, 2.0, 9)
    np.testing.assert_allclose(height, 3.0 + 0.1 * u[:, None] + 0.02 * v[None, :], atol=1e-5)


def test_a_curved_road_is_sampled_where_it_runs(tmp_path: Path) -> None:
    """A quarter of a circle of 20 m radius with a crest across and a lip along its left border."""
    count = 63
    table = np.zeros((count, 10))
    table[:, 0] = (np.arange(count) - 0.5) * 0.5 / 20.0  # heading of the piece before each place
    u = 0.5 * np.arange(count)
    table[:, 1:] = 0.05 * np.exp(-(((u - 15.0) / 2.0) ** 2))[:, None]
    fields = read_crg(crg(tmp_path / 'road.crg', 'KDBI', table, '', ['reference line phi', *SECTIONS]))
    fields.pop('kind')
    road = compile_road(RoadSpec(grids=(RasterGrid(**fields),)))
    for length in (10.0, 15.0, 17.0, 25.0):
        for v in (-1.5, 0.0, 1.5):
            angle = length / 20.0
            x, y = (20.0 - v) * np.sin(angle), 20.0 - (20.0 - v) * np.cos(angle)
            assert road_at(road, x, y)[0] == pytest.approx(0.05 * np.exp(-(((length - 15.0) / 2.0) ** 2)), abs=1e-3)


def crg_text(head: str = '', form: str = 'LRFI', data: str = ' 0.0 0.0\n') -> bytes:
    sections = 'D:long section at v = -1,m\nD:long section at v = 1,m'
    return f'$ROAD_CRG\n{head}\n$\n$KD_DEFINITION\n#:{form}\nU:u,m,0,0.5\n{sections}\n$\n$$$$\n{data}'.encode()


@pytest.mark.parametrize(
    ('content', 'words'),
    [
        (b'', 'has no data'),
        (b'$CT\nnothing here\n', 'has no data'),
        (crg_text(form='XYZ'), 'form XYZ are not supported'),
        (crg_text('reference_line_start_x = here'), 'reference_line_start_x = here: must be a finite number below 1e+09'),
        (crg_text(data='       0.0       0.0\n'), 'has 1 rows of 2 numbers'),
        (crg_text(data='       abc       0.0\n' * 3), 'data = abc'),
        (crg_text(data=' *missing* *missing*\n' * 3), 'row 0 has no height at all'),
        (crg_text(data='  9000000.       0.0\n' * 3), 'beyond 1e6'),
        (b'$ROAD_CRG_FILE\nother.crg\n' + crg_text(), 'a reference to another file'),
        (b'$ROAD_CRG_MODS\nscale_z_grid = 2\n' + crg_text(), 'modifiers (scale_z_grid)'),
    ],
)
def test_opencrg_files_that_are_refused(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / 'road.crg'
    path.write_bytes(content)
    with pytest.raises(SceneError) as caught:
        read_crg(path)
    assert words in str(caught.value)
    assert str(caught.value).startswith(f'{path}: ')
    assert '\n' not in str(caught.value)


def test_pictures_and_arrays_that_are_refused(tmp_path: Path) -> None:
    good = png(tmp_path / 'a.png', np.ones((4, 4), int), 0).read_bytes()
    for name, content, words in (
        ('b.png', b'GIF89a', 'is not a PNG picture'),
        ('c.png', good[:40], 'has no pixels'),
        ('d.png', good.replace(struct.pack('>II', 4, 4), struct.pack('>II', 4, 5), 1), 'bytes of pixels instead of'),
        ('e.png', good.replace(struct.pack('>II', 4, 4), struct.pack('>II', 40000, 40000), 1), 'at most'),
        ('f.npz', b'PK nothing', 'not readable as .npz'),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(SceneError, match=words):
            (read_png if name.endswith('png') else read_npz)(tmp_path / name)
    for values, words in ((np.ones(3), 'shape'), (np.full((2, 2), np.nan), 'finite'), (np.array([['a', 'b']] * 2), 'must be numbers')):
        np.savez(tmp_path / 'g.npz', values)
        with pytest.raises(SceneError, match=words):
            read_npz(tmp_path / 'g.npz')
    buffer = io.BytesIO()
    np.savez(buffer, a=np.ones((2, 2)), b=np.ones((2, 2)))
    (tmp_path / 'h.npz').write_bytes(buffer.getvalue())
    with pytest.raises(SceneError, match='has the arrays a, b: give one, or call it height'):
        read_npz(tmp_path / 'h.npz')


def test_rasters_and_maps_that_are_refused() -> None:
    raster = Raster.of(np.ones((3, 3)))
    with pytest.raises(SpecError, match=r'packed = .* must be 12 bytes'):
        Raster(rows=2, columns=3, low=0.0, resolution=1.0, packed=raster.packed)
    with pytest.raises(SpecError, match='too many'):
        Raster(rows=10_000, columns=10_000, low=0.0, resolution=1.0, packed='')
    with pytest.raises(SpecError, match='take a part, or coarser steps'):
        Raster.of(RNG.normal(size=(1000, 1000)))
    with pytest.raises(SpecError, match=r'must be in \[0.001, 10\]'):
        FrictionMap(origin=(0.0, 0.0), step=(1.0, 1.0), raster=raster, scale=-1.0)


def test_the_seed_of_a_scene_makes_other_random_roads() -> None:
    """7 of the road and 3 of the scene are 10; again from the resolved text, as a recording holds it."""
    (before,), (after,) = (load_scene('car_rough_road', settings).model.road.grids for settings in ((), ('seed=3',)))
    assert (before.seed, after.seed) == (7, 10)
    assert before.expand().height != after.expand().height
    scene = load_scene('car_rough_road', ('seed=3',))
    assert load_scene_text(scene.resolved).model == scene.model
    with pytest.raises(SceneError, match='seed = -1: must be 0 or more'):
        load_scene('car_rough_road', ('seed=-1',))
