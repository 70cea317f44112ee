"""Roads from pictures and arrays, written here by their specifications, and what is refused (OpenCRG:
test_opencrg.py)."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from solver.elements.road import FrictionMap, compile_road, road_at
from solver.elements.road_grids import Raster
from solver.errors import SceneError, SpecError
from solver.files.raster import read_npz, read_png
from solver.files.scene import load_scene, load_scene_text

RNG = np.random.default_rng(4)


def png(path: Path, grey: np.ndarray, filters: int | None = None, depth: int = 16) -> Path:
    """Write rows of integers as a greyscale picture; filters: the filter of every row, None: row k has filter k mod
    5."""
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
    path.write_bytes(
        b'\x89PNG\r\n\x1a\n' + chunk(b'IHDR', head) + chunk(b'IDAT', zlib.compress(packed)) + chunk(b'IEND', b'')
    )
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
        'vehicle: vehicles/light_car.yaml\nroad:\n  grids: [{kind: raster_grid, origin: [1, 2], step: [0.5, 0.5], '
        'scale: 0.04, raster: bumps.png}]\n  maps: [{origin: [0, -5], step: [10, 10], raster: ice.npz}]\nstart: '
        '{kind: equilibrium, speed_kmh: 20}\nduration: 0.1\n'
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
    for values, words in (
        (np.ones(3), 'shape'),
        (np.full((2, 2), np.nan), 'finite'),
        (np.array([['a', 'b']] * 2), 'must be numbers'),
    ):
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
