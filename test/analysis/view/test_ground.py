"""The drawn road is the one that the wheels feel."""

from __future__ import annotations

import numpy as np

from mbd_sim_ros.analysis.view.ground import Ground
from solver.elements.road import RoadSpec, compile_road, road_at
from solver.elements.road_grids import HeightGrid, RandomRoad

RNG = np.random.default_rng(5)


def test_heights_are_those_of_the_solver_inside_grids_at_their_borders_and_beyond():
    rough = HeightGrid(origin=(1.0, -2.0), step=(0.5, 0.4), yaw=0.7, height=tuple(map(tuple, RNG.normal(size=(7, 5)))))
    ramp = HeightGrid(origin=(-3.0, -3.0), step=(1.0, 6.0), height=((0.0, 0.0), (0.2, 0.3)))
    random = RandomRoad(origin=(0.0, 1.0), length=5.0, width=2.0, quality='D', seed=3, step=(0.1, 1.0), ramp=0.5)
    spec = RoadSpec(point=(1.0, 2.0, 3.0), normal=(0.1, -0.2, 1.0), grids=(rough, ramp, random), contact='point')
    table, ground = compile_road(spec), Ground(spec)
    x, y = RNG.uniform(-8.0, 12.0, (2, 400))
    np.testing.assert_allclose(
        ground.at(x, y), [road_at(table, *place)[0] for place in zip(x, y, strict=True)], rtol=0.0, atol=1e-12
    )
    x, y = np.full(2, 1e6), np.array([-1e6, 0.4])
    np.testing.assert_allclose(
        ground.at(x, y), [road_at(table, *place)[0] for place in zip(x, y, strict=True)], rtol=1e-15
    )
