"""An edge of the road at the wheels that a contact at a point cannot roll over is named by a start that fails: what,
how high, where."""

from __future__ import annotations

import json

import numpy as np
import pytest

from solver import load_scene, simulation_of
from solver.errors import ConsistencyError
from solver.model.evaluate import prepare
from solver.model.state import new_state
from solver.start.obstacle import edge_at_wheels

KERB = [[0.0] * 2] * 20 + [[0.1] * 2] * 20  # along x: 100 mm up between two nodes


def road(
    height: list[list[float]],
    x: float,
    *,
    dx: float = 0.05,
    dy: float = 6.0,
    y: float = -3.0,
    contact: str = 'point',
    more: str = '',
) -> str:
    """A grid whose node 19 along x, the last low one of KERB, is at x [m]."""
    grid = (
        f'{{kind: height_grid, origin: [{x - 19 * dx}, {y}], step: [{dx}, {dy}], height: {json.dumps(height)}{more}}}'
    )
    return f'road={{contact: {contact}, grids: [{grid}]}}'


def told(setting: str, ahead: float = 0.0) -> str:
    """What is said of the light car as it is placed."""
    model = prepare(load_scene('light_car_straight', [setting]).model)
    return edge_at_wheels(model, new_state(model).q, model.body_names.index('chassis'), ahead)


def front() -> np.ndarray:
    """(2,) place of the left front wheel [m]."""
    model = load_scene('light_car_straight').model
    return np.array(next(body.position[:2] for body in model.bodies if body.name == 'wheel_front_left'))


@pytest.mark.parametrize(
    ('height', 'at', 'ahead', 'sentence'),
    [
        (KERB, 0.105, 0.0, "a kerb of 100 mm is 0.13 m before the centre of wheel 'front_left'; the tires"),
        (KERB, -0.225, 0.0, "a kerb of 100 mm is 0.20 m behind the centre of wheel 'front_left'; the tires"),
        (KERB, -0.025, 0.0, "a kerb of 100 mm is under wheel 'front_left'; the tires"),
        (KERB, 1.0, 1.25, "a kerb of 100 mm is 1.02 m before the centre of wheel 'front_left', and the wheels roll 1.2 "
            "m ahead"),
        ([[0.15 - 1.5 * z for z in row] for row in KERB], 0.105, 0.0, 'a step down of 150 mm is 0.13 m before'),
        ([[0.03 + 0.5 * z for z in row] for row in KERB], 0.105, 0.0, 'a kerb of 50 mm is 0.13 m before'),
        (KERB, 1.0, 0.0, ''),  # further away than the wheels come
        ([[0.1 * z for z in row] for row in KERB], 0.1, 0.0, ''),  # 10 mm, which no start fails by
        ([[0.005 * i] * 2 for i in range(40)], 0.1, 0.0, ''),  # a slope
    ],
)  # fmt: skip
def test_what_is_at_the_wheels_is_told_with_its_height_and_the_remedy(
    height: list[list[float]], at: float, ahead: float, sentence: str
) -> None:
    text = told(road(height, front()[0] + at), ahead)
    assert text.startswith(sentence) if sentence else text == ''
    assert not text or text.endswith('set road.contact: enveloping, or start further away from it')


def test_an_edge_beside_a_wheel_is_told() -> None:
    """Half of the left wheels on the pavement: an edge along the road, 20 mm left of their middle."""
    x, y = front()
    grid = road([[0.0, 0.0, 0.1, 0.1]] * 40, x, dx=0.2, dy=0.02, y=y + 0.01 - 0.02)
    assert told(grid).startswith("a kerb of 100 mm is 0.02 m left of the centre of wheel 'front_left'")


@pytest.mark.parametrize('contact', ['enveloping', 'auto'])
def test_an_edge_that_the_tires_envelop_is_no_reason(contact: str) -> None:
    assert told(road(KERB, front()[0] + 0.1, contact=contact), 1.25) == ''


@pytest.mark.slow
@pytest.mark.parametrize('at', [2.2, 2.3])
def test_a_start_before_a_kerb_names_it(at: float) -> None:
    """At 25 m/s the car settles within steps of 50 ms: it met the kerb, and was thrown onto its roof, or no step
    converged."""
    with pytest.raises(
        ConsistencyError,
        match=r'^start: a kerb of 100 mm is .* m before the centre of wheel .* set road.contact: envel',
    ):
        simulation_of(load_scene('light_car_straight', [f'road={{contact: point, grids: [{SHORT % (at - 0.1)}]}}']))


SHORT = '{kind: height_grid, origin: [%g, -3], step: [0.05, 6], height: [[0, 0], [0, 0], [0.1, 0.1], [0.1, 0.1]]}'


@pytest.mark.parametrize(
    ('at', 'where'), [(-0.025, 'under wheel'), (0.105, 'before the centre of wheel'), (-0.225, 'behind the centre')]
)
def test_a_standing_start_beside_a_kerb_is_told(at: float, where: str) -> None:
    """It was accepted without a word; with enveloping it is a start like any other."""
    settings = ['start={kind: as_placed}', 'duration=0.01']
    said = str(simulation_of(load_scene('light_car_straight', [road(KERB, front()[0] + at), *settings])).start)
    assert 'a kerb of 100 mm is' in said and where in said and 'road.contact: enveloping' in said
    for other in (road(KERB, front()[0] + 1.5), road(KERB, front()[0] + at, contact='enveloping')):
        assert 'kerb' not in str(simulation_of(load_scene('light_car_straight', [other, *settings])).start)
