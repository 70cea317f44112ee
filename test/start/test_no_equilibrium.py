"""What nothing holds has no static equilibrium, and is said to have none."""

from __future__ import annotations

import numpy as np
import pytest

from solver import simulation_of
from solver.errors import ConsistencyError
from solver.files.scene import load_scene_text

BODY = 'mechanism:\n  bodies: {body: {mass: 1, inertia: [0.1, 0.2, 0.1], position: [0, 0, 0.5]}}\n'
SLIDE = '  joints: {slide: {kind: prismatic, i: world, j: body, at: [0, 0, 0], axis: [1, 0, 1]}}\n'
WHEEL = """
  joints:
    upright: {kind: perpendicular, i: {body: world, axis: [0, 1, 0]}, j: {body: body, axis: [1, 0, 0]}}
    straight: {kind: perpendicular, i: {body: world, axis: [0, 1, 0]}, j: {body: body, axis: [0, 0, 1]}}
  contacts:
    road: {kind: rolling, i: world, j: {body: body, axis: [0, 1, 0]}, radius: 0.5}
"""
DOWNHILL = '  gravity: [0.979, 0, -9.761]\n'


@pytest.mark.parametrize('rest', ['', SLIDE, WHEEL + DOWNHILL], ids=['falling', 'sliding', 'rolling'])
def test_a_body_that_falls_slides_or_rolls_is_reported(rest):
    with pytest.raises(ConsistencyError, match=r"no static equilibrium was found: .* remain on body 'body'"):
        simulation_of(load_scene_text(BODY + rest + 'start: {kind: equilibrium}\n'))


def test_a_wheel_on_the_level_stays_where_it_was_placed():
    s = simulation_of(load_scene_text(BODY + WHEEL + 'start: {kind: equilibrium}\n'))
    np.testing.assert_allclose(s.advance(100).pose[0, :3], [0.0, 0.0, 0.5], atol=1e-12)
