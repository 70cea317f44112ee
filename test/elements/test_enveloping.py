"""The effective road of a tire: cams, two-point follower, a force with a potential, and obstacles as they are met in
driving."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
import pytest
from contract import check_contract
from tire_bench import CAR, tire, value, wheel

from solver.analysis.verdict import findings
from solver.elements import enveloping
from solver.elements.enveloping import Footprint, Heights, effective, sharpest
from solver.elements.footprint import footprint
from solver.elements.road import HeightGrid, RandomRoad, RoadSpec, compile_road, envelops, surface_at, too_large
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.errors import SpecError
from solver.files.scene import load_scene
from solver.remembered import forget
from solver.simulation import Simulation

TIRE = footprint([CAR])
assert TIRE is not None
FZ = TIRE_COLUMNS.index('fz')


def obstacle(height: float, begin: float, end: float, *, length: float = 3.0, step: float = 0.005) -> HeightGrid:
    """A block across the lane from begin to end [m], from x = 0 on."""
    x = np.arange(round(length / step)) * step
    block = np.where((x > begin - 1e-9) & (x < end + 1e-9), height, 0.0)
    return HeightGrid(origin=(0.0, -4.0), step=(step, 8.0), height=tuple((float(h), float(h)) for h in block))


def kerb_curve(x: np.ndarray, height: float, edge: float, tire: Footprint) -> np.ndarray:
    """Height of a cam before and on a kerb: its outline stands on the edge, or it stands on the road."""
    s = np.clip((edge - x) / tire.cam_length, 0.0, 1.0)
    drop = tire.cam_height * (1.0 - (1.0 - s**tire.order) ** (1.0 / tire.order))
    return np.maximum(height - drop, 0.0)


@pytest.mark.parametrize('height', [0.02, 0.1])
def test_slope_is_that_between_a_front_and_a_rear_cam(height: float) -> None:
    road = effective(obstacle(height, 1.5, 9.0, step=0.002).heights, TIRE, 'road')
    x = road.origin[0] + np.arange(road.height.shape[0]) * road.step[0]
    slope = np.gradient(road.height[:, 0], road.step[0])
    front, rear = (kerb_curve(x + s * TIRE.length / 2.0, height, 1.499, TIRE) for s in (1.0, -1.0))
    want = (front - rear) / TIRE.length
    assert np.abs(slope - want).max() < 0.03 * want.max()  # the kinks of the slope are a node wide
    assert road.height[:, 0].max() == pytest.approx(height, rel=1e-12)
    assert road.height[0, 0] == pytest.approx(0.0, abs=1e-15)


def test_roads_without_hollows_keep_their_slope() -> None:
    """A plane given as a grid: the same slopes, and higher by what a cam stands above a slope."""
    step, rise, lean = 0.25, 0.08, 0.05
    height = rise * step * np.arange(30)[:, None] + lean * step * np.arange(9)[None, :]
    road = effective(Heights((0.0, 0.0), (step, step), 0.0, height), TIRE, 'road')
    inner = road.height[200:-200, 30:-30]
    np.testing.assert_allclose(np.diff(inner, axis=0) / road.step[0], rise, atol=1e-9)
    np.testing.assert_allclose(np.diff(inner, axis=1) / road.step[1], lean, atol=1e-9)
    above = road.height - rise * (np.arange(road.height.shape[0]) * road.step[0] + road.origin[0])[:, None]
    above -= lean * (np.arange(road.height.shape[1]) * road.step[1] + road.origin[1])[None, :]
    assert 0.0 < above[200:-200, 30:-30].max() < 0.5 * rise**2 * TIRE.radius


def test_rows_of_cams_across_the_tread_climb_an_edge_along_the_road() -> None:
    """A step along the road: between the outer rows the effective road leans by step over width."""
    step, edge = 0.01, 41
    height = np.zeros((40, 81))
    height[:, edge:] = 0.03
    road = effective(Heights((0.0, 0.0), (0.1, step), 0.0, height), TIRE, 'road')
    lean = np.diff(road.height[road.height.shape[0] // 2]) / road.step[1]
    assert lean.max() == pytest.approx(0.03 / TIRE.width, rel=0.02)
    assert np.count_nonzero(lean > 1e-6) * road.step[1] == pytest.approx(TIRE.width + step, rel=0.15)


def test_the_grid_may_be_turned_and_the_plane_inclined() -> None:
    grid = obstacle(0.05, 1.0, 1.05)
    turned = HeightGrid(origin=(3.0, 2.0), step=grid.step, height=grid.height, yaw=0.7)
    a = compile_road(RoadSpec(grids=(HeightGrid(origin=(0.0, 0.0), step=grid.step, height=grid.height),)), TIRE)
    b = compile_road(RoadSpec(normal=(0.1, 0.0, 1.0), grids=(turned,)), TIRE)
    c, s = np.cos(0.7), np.sin(0.7)
    for u, v in ((0.9, 1.0), (1.1, 2.0), (-0.1, 0.5)):
        x, y = 3.0 + u * c - v * s, 2.0 + u * s + v * c
        assert surface_at(b, x, y)[0] == pytest.approx(surface_at(a, u, v)[0] - 0.1 * x, abs=1e-12)


STRIP = RoadSpec(normal=(0.02, 0.01, 1.0), grids=(obstacle(0.05, 1.0, 1.05),))
PLACES = {'before': 0.82, 'climbing': 0.95, 'on top': 1.03, 'leaving': 1.16}


@pytest.mark.parametrize('x', PLACES.values(), ids=PLACES)
def test_contract_of_force_elements_on_an_obstacle(x: float) -> None:
    kin = wheel(position=(x, 0.1, 0.30), velocity=(5.0, 0.2, -0.1), spin=16.0, yaw=0.1, camber=0.03)
    element = tire(road=STRIP)
    check_contract(element, kin, pair=False, tolerance=1e-10, zp=(0.003, 0.002, 0.0), cz=5e-4)


@pytest.mark.parametrize('x', PLACES.values(), ids=PLACES)
def test_the_force_on_an_upright_wheel_is_the_gradient_of_its_energy(x: float) -> None:
    """At rest and without deflection of the contact there is the spring alone."""
    element = tire(road=RoadSpec(grids=STRIP.grids))

    def at(dx: float, dz: float):
        return element.evaluate(wheel(position=(x + dx, 0.0, 0.31 + dz)), zp=(0.0, 0.0))

    step = 1e-6
    force = at(0.0, 0.0).f[0]
    for axis, (dx, dz) in ((0, (step, 0.0)), (2, (0.0, step))):
        energies = [value(element, at(s * dx, s * dz), 'energy') for s in (1.0, -1.0)]
        assert force[axis] == pytest.approx(-(energies[0] - energies[1]) / (2.0 * step), rel=1e-6, abs=1e-3)
    assert abs(force[0]) > 100.0


def test_auto_envelops_edges_and_leaves_smooth_roads() -> None:
    cleat = load_scene('car_cleat').model.road
    assert envelops(cleat, TIRE) == (False,)
    assert compile_road(cleat, TIRE).enveloping[0] == 0.0
    rough = RandomRoad(origin=(0.0, 0.0), length=20.0, width=2.0, quality='C', seed=1)
    mixed = RoadSpec(grids=(obstacle(0.05, 1.0, 1.05), rough))
    assert envelops(mixed, TIRE) == (True, False)
    assert envelops(RoadSpec(grids=mixed.grids, contact='point'), TIRE) == (False, False)
    assert envelops(RoadSpec(grids=mixed.grids, contact='enveloping'), TIRE) == (True, True)
    edge = sharpest(mixed.grids[0].heights)
    assert edge.place[0] in (pytest.approx(0.995), pytest.approx(1.055))


def test_an_effective_road_that_is_too_large_is_refused() -> None:
    grid = HeightGrid(
        origin=(0.0, 0.0), step=(10.0, 10.0), height=((0.0, 0.0, 0.0), (0.0, 5.0, 0.0), (0.0, 0.0, 1.0)) * 40
    )
    with pytest.raises(
        SpecError, match=r'road that the tires make of it has \d+ nodes: take a smaller grid, or contact: point'
    ):
        compile_road(RoadSpec(grids=(grid,), contact='enveloping'), TIRE)


def test_a_large_effective_road_is_computed_in_parts_and_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """In parts of two columns and of seven; the sums begin elsewhere, which is rounding."""
    heights = Heights((1.0, 2.0), (0.01, 0.02), 0.3, 0.01 * np.random.default_rng(1).random((300, 50)))
    whole = effective(heights, TIRE, 'road')
    for columns in (2, 7):
        monkeypatch.setattr(enveloping, 'BLOCK', columns * whole.height.shape[0])
        parts = effective(heights, TIRE, 'road')
        assert parts[:3] == whole[:3]
        np.testing.assert_allclose(parts.height, whole.height, rtol=0.0, atol=1e-14)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Effective roads of 100 nodes at most; what is kept of others, and for others, is forgotten."""
    monkeypatch.setattr(enveloping, 'LARGEST', 100)
    for clear in (too_large.cache_clear, compile_road.cache_clear, forget):
        clear()
    yield
    for clear in (too_large.cache_clear, compile_road.cache_clear, forget):
        clear()


@pytest.mark.usefixtures('small')
def test_auto_touches_what_is_too_large_to_be_enveloped_at_a_point_and_tells_it() -> None:
    """It was refused under `auto` too; asked for, it still is."""
    road = RoadSpec(grids=(obstacle(0.05, 1.0, 1.05),))
    assert envelops(road, TIRE) == (False,)
    assert re.fullmatch(
        r'the road that the tires make of it would have \d+ nodes \(at most 100 nodes .*\)',
        too_large(road.grids[0], TIRE),
    )
    assert compile_road(road, TIRE).enveloping[0] == 0.0
    with pytest.raises(SpecError, match='contact: point'):
        compile_road(RoadSpec(grids=road.grids, contact='enveloping'), TIRE)
    sim, _ = drive('strip', 1e-3, 'auto', 0.01)
    found = {finding.quantity: str(finding.text) for finding in findings(sim)}
    assert 'Take a part of the road (the road that the tires make of it would have' in found['road_curvature']


OBSTACLES = {'strip': (0.05, 0.05, 20), 'pothole': (-0.06, 0.5, 20), 'kerb': (0.1, 9.0, 20), 'cleat': (0.015, 0.03, 40)}


def drive(kind: str, h: float, contact: str = 'auto', duration: float = 1.2) -> tuple[Simulation, float]:
    """The light car rolling over an obstacle: (simulation, largest load of a tire [N])."""
    height, length, speed = OBSTACLES[kind]
    grid = obstacle(height, 0.5, 0.5 + length)
    heights = [list(row) for row in grid.height]
    road = (
        f'road={{contact: {contact}, grids: [{{kind: height_grid, origin: [2.5, -4], step: [0.005, 8], height: '
        f'{heights}}}]}}'
    )
    start = f'start={{kind: equilibrium, speed_kmh: {speed}}}'
    sim = Simulation(
        load_scene(
            'light_car_straight', [road, start, f'integrator.h={h}', f'duration={duration}', 'maneuver={name: coast}']
        )
    )
    loads = []
    for _ in range(sim.scene.steps):
        sim.advance(1, audit=True)
        loads.append(sim.snapshot().tire[:, FZ].max())
    return sim, float(max(loads))


@pytest.mark.slow
@pytest.mark.parametrize(
    ('kind', 'low', 'high'), [('strip', 10e3, 25e3), ('pothole', 10e3, 25e3), ('kerb', 10e3, 25e3), ('cleat', 5e3, 8e3)]
)
def test_obstacles_are_crossed_with_loads_that_converge(kind: str, low: float, high: float) -> None:
    """10 to 25 kN at a wheel at 20 km/h; within 2 % at half the step, and the energy account closes a quarter as far
    off."""
    coarse, peak = drive(kind, 1e-3)
    fine, converged = drive(kind, 5e-4)
    assert low < converged < high
    assert peak == pytest.approx(converged, rel=0.02)
    assert not findings(coarse)
    errors = [s.last_step.account.worst[0] for s in (coarse, fine)]
    assert all(np.isfinite(errors))
    speed = fine.snapshot().twist[0, 0] * 3.6
    assert OBSTACLES[kind][2] * 0.85 < speed < OBSTACLES[kind][2]


def test_point_contact_with_an_edge_is_suspect_and_says_where() -> None:
    sim, _ = drive('strip', 1e-3, 'point', 0.01)
    found = {finding.quantity: finding for finding in findings(sim)}
    assert found['road_curvature'].where.startswith('road.grids[0].height[')
    assert 'at x = ' in found['road_curvature'].where
    assert 'road.contact: enveloping' in str(found['road_curvature'])
    sim, _ = drive('strip', 1e-3, 'auto', 0.01)
    assert not findings(sim)
