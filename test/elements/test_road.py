"""The road: surface, slopes, curvature, friction and the ISO 8608 spectrum."""

from __future__ import annotations

import numpy as np
import pytest
from interpreted import interpreted

from solver.compiled.dual import partial, variable
from solver.compiled.kernel import kernel
from solver.elements.road import FrictionPatch, HeightGrid, RandomRoad, RoadSpec, compile_road, road_at, surface_at
from solver.elements.road_grids import ISO_8608_DENSITY
from solver.errors import SpecError


@kernel
def dual_road(road, x, y):
    """Height, normal z and friction with derivatives along x (0) and y (1)."""
    h, n, mu = road_at(road, variable(x, 0), variable(y, 1))
    z = n[2]
    return (
        (h.real, z.real, mu.real),
        (partial(h, 0), partial(z, 0), partial(mu, 0)),
        (partial(h, 1), partial(z, 1), partial(mu, 1)),
    )


def bumpy() -> RoadSpec:
    i, j = np.meshgrid(np.arange(9), np.arange(7), indexing='ij')
    height = 0.05 * np.sin(0.9 * i + 0.3) * np.cos(0.7 * j)
    return RoadSpec(
        point=(1.0, 2.0, 0.5),
        normal=(0.1, -0.2, 1.0),
        grids=(HeightGrid(origin=(-2.0, -1.0), step=(0.5, 0.4), yaw=0.4, height=tuple(map(tuple, height))),),
        patches=(FrictionPatch(center=(0.3, 0.2), size=(2.0, 1.0), yaw=0.3, factor=0.3, blend=0.5),),
    )


def test_plane_by_point_and_normal() -> None:
    """n . (r - point) = 0."""
    road = compile_road(RoadSpec(point=(1.0, 2.0, 3.0), normal=(1.0, -2.0, 4.0)))
    h, n, mu = road_at(road, 5.0, -1.0)
    assert np.dot([1.0, -2.0, 4.0], [5.0 - 1.0, -1.0 - 2.0, h - 3.0]) == pytest.approx(0.0, abs=1e-14)
    np.testing.assert_allclose(n, np.array([1.0, -2.0, 4.0]) / np.sqrt(21.0), atol=1e-15)
    assert mu == 1.0


def test_grid_is_interpolated_at_every_node_and_constant_beyond() -> None:
    rng = np.random.default_rng(7)
    height = rng.normal(size=(6, 5))
    grid = HeightGrid(origin=(1.0, -2.0), step=(0.3, 0.2), yaw=0.7, height=tuple(map(tuple, height)))
    road = compile_road(RoadSpec(grids=(grid,)))
    c, s = np.cos(0.7), np.sin(0.7)

    def at(a: float, b: float) -> float:
        return road_at(road, 1.0 + c * a - s * b, -2.0 + s * a + c * b)[0]

    for i in range(6):
        for j in range(5):
            assert at(0.3 * i, 0.2 * j) == pytest.approx(height[i, j], abs=1e-13)
    for j in range(5):  # as high as at the border
        assert (
            at(-50.0, 0.2 * j) == pytest.approx(at(-0.6, 0.2 * j), abs=1e-13) == pytest.approx(height[0, j], abs=1e-13)
        )
    for i in range(6):
        assert at(0.3 * i, 50.0) == pytest.approx(at(0.3 * i, 1.2), abs=1e-13) == pytest.approx(height[i, 4], abs=1e-13)
    assert at(1e9, 1e9) == pytest.approx(height[5, 4], abs=1e-13)
    assert np.isfinite(at(-1e300, 1e300))


@pytest.mark.parametrize('x, y', [(0.1, 0.3), (-0.9, 0.7), (1.4, 0.9), (-2.2, -1.3), (0.3, 0.45), (9.0, -8.0)])
def test_slopes_curvature_and_duals_are_derivatives(x: float, y: float) -> None:
    road = compile_road(bumpy())
    step = 1e-30
    value, along_x, along_y = dual_road(road, x, y)
    a = surface_at(road, x, y)
    for (dx, dy), dual, first, second in (((1, 0), along_x, a[1], (a[3], a[4])), ((0, 1), along_y, a[2], (a[4], a[5]))):
        h, n, mu = interpreted(road_at)(road, x + 1j * step * dx, y + 1j * step * dy)
        exact = np.array([h.imag, n[2].imag, mu.imag]) / step
        np.testing.assert_allclose(dual, exact, atol=1e-12)
        assert first == pytest.approx(exact[0], abs=1e-12)
        b = interpreted(surface_at)(road, x + 1j * step * dx, y + 1j * step * dy)
        np.testing.assert_allclose(second, [b[1].imag / step, b[2].imag / step], atol=1e-11)
    h, n, mu = road_at(road, x, y)
    np.testing.assert_array_equal(value, [h, n[2], mu])
    assert np.dot(n, n) == pytest.approx(1.0, abs=1e-14)


def test_surface_and_curvature_are_continuous_across_cells() -> None:
    """Both sides of a cell border, 1e-9 m apart, agree in height, slope and curvature (third derivatives are below
    100/m^2)."""
    road = compile_road(
        RoadSpec(grids=(HeightGrid(origin=(0, 0), step=(0.1, 0.1), height=((0, 0, 0), (0, 0.05, 0.01), (0, 0, 0.02))),))
    )
    for edge in (-0.1, 0.0, 0.1, 0.2, 0.3):
        for other in (-0.03, 0.07, 0.13):
            for point in ((edge, other), (other, edge)):
                d = np.array([1e-9, 1e-9])
                np.testing.assert_allclose(surface_at(road, *(point - d)), surface_at(road, *(point + d)), atol=1e-5)


def test_friction_patch_blends_from_outside_to_inside() -> None:
    road = compile_road(
        RoadSpec(friction=0.9, patches=(FrictionPatch(center=(10.0, 0.0), size=(4.0, 2.0), factor=0.5, blend=0.2),))
    )
    assert road_at(road, 10.0, 0.0)[2] == pytest.approx(0.45)
    assert road_at(road, 7.0, 0.0)[2] == pytest.approx(0.9)
    assert road_at(road, 8.0, 0.0)[2] == pytest.approx(0.9 * 0.75)  # half way on the edge
    assert road_at(road, 10.0, 1.11)[2] == pytest.approx(0.9)
    assert road_at(road, 8.0, 1.0)[2] == pytest.approx(0.9 * (1 - 0.5 * 0.25))  # the corner


def test_friction_over_an_edge_changes_as_steeply_as_for_a_contact_patch() -> None:
    """A sharp edge under a contact patch of 106 mm ([Pacejka2012] table 9.1): the part behind the edge grows by 1/0.106
    per metre."""
    road = compile_road(RoadSpec(patches=(FrictionPatch(center=(10.0, 0.0), size=(4.0, 2.0), factor=0.5),)))
    x = np.linspace(7.8, 8.2, 4001)
    friction = np.array([road_at(road, float(place), 0.0)[2] for place in x])
    steepest = np.abs(np.diff(friction)).max() / (x[1] - x[0]) / 0.5
    assert steepest == pytest.approx(1.0 / 0.106, rel=0.01)


def test_random_road_has_the_iso_8608_spectrum_and_repeats() -> None:
    """Mean of the periodogram over 3 octaves of a 2 km road: 64 e-6 m^3 (0.1 n)^-2 for class B, to 4 standard
    deviations of the mean."""
    spec = RandomRoad(origin=(0, 0), length=2000.0, width=1.0, quality='B', seed=11, step=(0.1, 1.0), ramp=0.1)
    height = np.array(spec.expand().height)
    assert spec.expand() == spec.expand()
    assert (
        spec.expand() != RandomRoad(**{**{f: getattr(spec, f) for f in spec.__dataclass_fields__}, 'seed': 12}).expand()
    )
    n = np.fft.rfftfreq(len(height), 0.1)
    for track in height.T:
        density = 2.0 * np.abs(np.fft.rfft(track)) ** 2 * 0.1 / len(height)
        band = (n > 0.05) & (n < 0.4)
        ratio = density[band] / (ISO_8608_DENSITY['B'] * (n[band] / 0.1) ** -2)
        assert ratio.mean() == pytest.approx(1.0, abs=4.0 / np.sqrt(band.sum()))


def test_neighbouring_tracks_have_the_stated_coherence() -> None:
    """Coherence exp(-2 pi c n y) at 0.05 to 0.4 cycles/m between tracks 1.5 m apart, measured over the bands of a 4 km
    road."""
    spec = RandomRoad(
        origin=(0, 0), length=4000.0, width=1.5, quality='C', seed=3, step=(0.1, 0.5), coherence=0.7, ramp=0.1
    )
    height = np.array(spec.expand().height)
    a, b = np.fft.rfft(height[:, 0]), np.fft.rfft(height[:, 3])
    n = np.fft.rfftfreq(len(height), 0.1)
    for low, high in ((0.03, 0.06), (0.1, 0.2), (0.25, 0.4)):
        band = (n > low) & (n < high)
        measured = abs((a[band] * b[band].conj()).sum()) / np.sqrt(
            (abs(a[band]) ** 2).sum() * (abs(b[band]) ** 2).sum()
        )
        weight = n[band] ** -2.0
        expected = (weight * np.exp(-2 * np.pi * 0.7 * 1.5 * n[band])).sum() / weight.sum()
        assert measured == pytest.approx(expected, abs=4.0 / np.sqrt(band.sum()))


@pytest.mark.parametrize(
    'make, words',
    [
        (lambda: RoadSpec(normal=(1.0, 0.0, 0.0)), 'must point upwards'),
        (lambda: RoadSpec(friction=0.0), 'friction'),
        (lambda: FrictionPatch(center=(0, 0), size=(1.0, 0.05), factor=0.5), 'blend width'),
        (lambda: HeightGrid(origin=(0, 0), step=(1, 1), height=((0.0, 1.0), (0.0,))), 'rows of equal length'),
        (lambda: HeightGrid(origin=(0, 0), step=(0, 1), height=((0.0, 1.0), (0.0, 1.0))), 'positive'),
        (lambda: RandomRoad(origin=(0, 0), length=50.0, width=2.0, quality='Z', seed=1), "'A' to 'H'"),
        (lambda: RandomRoad(origin=(0, 0), length=50.0, width=2.0, quality='A', seed=-1), 'seed'),
    ],
)
def test_refusals_name_field_and_limit(make, words: str) -> None:
    with pytest.raises(SpecError, match=words):
        make()
