"""The level single_track on the road of a scene: as high as that is, and told where the vehicle does not stand on
it."""

from __future__ import annotations

import dataclasses

import pytest
from single_tracks import MODEL, simulation, track

from solver.elements.road import RoadSpec
from solver.elements.road_grids import HeightGrid
from solver.levels.single_track import STANDING
from solver.scene import Scene, StartSettings

LEVEL_GRID = HeightGrid(origin=(-5.0, -5.0), step=(10.0, 10.0), height=((0.3, 0.3), (0.3, 0.3)))


@pytest.mark.parametrize(
    ('road', 'height'),
    [
        (RoadSpec(), 0.0),
        (RoadSpec(point=(7.0, 2.0, -0.5)), -0.5),
        (RoadSpec(point=(0.0, 0.0, -0.5), grids=(LEVEL_GRID,)), -0.2),
        (RoadSpec(normal=(-0.1, 0.0, 1.0), point=(-30.0, 0.0, 0.0)), 3.0),
    ],
)
def test_it_is_shown_as_high_as_the_road_is_at_its_start(road: RoadSpec, height: float) -> None:
    """The height 0 of the parameters at rest above it; it drives on as high as that. It was shown at z = 0 on every
    road."""
    track, flat = simulation(road=road), simulation()
    assert track.snapshot().pose[0, 2] == pytest.approx(height, abs=1e-12)
    if road.normal[0] == 0.0:
        there, here = track.advance(200).pose[0], flat.advance(200).pose[0]
        assert there[2] == pytest.approx(height, abs=1e-12)
        assert there[:2].tolist() == here[:2].tolist()


@pytest.mark.parametrize(
    ('kind', 'road', 'apart'), [('as_placed', -0.5, 0.5), ('assemble', 0.2, 0.2), ('equilibrium', -0.5, 0.0)]
)
def test_one_that_is_placed_above_or_in_the_road_is_told(kind: str, road: float, apart: float) -> None:
    """Other levels fall from there, or spring up; in its equilibrium a vehicle stands on the road wherever it was
    placed."""
    model = dataclasses.replace(MODEL, road=RoadSpec(point=(0.0, 0.0, road)))
    placed = track(Scene(name='placed', model=model, start=StartSettings(kind=kind)))
    placed.advance(1)
    value, time = placed.reached[STANDING.quantity]
    assert value == pytest.approx(apart, abs=1e-12)
    assert time is None
    assert STANDING.high is not None
    assert (value > STANDING.high) == (apart > 0.0)
