"""A start may wind a coordinate by any number of turns: what is wanted of it is an angle, not a direction."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from solver import simulation_of
from solver.errors import ConsistencyError
from solver.files.scene import load_scene_text
from solver.simulation import Simulation

DISC = {'mass': 1, 'inertia': [0.1, 0.1, 0.1]}
HINGE = {'kind': 'revolute', 'i': 'world', 'j': 'disc', 'at': [0, 0, 0], 'axis': [0.2, 0.3, 1]}


def start(scene: dict[str, Any], **more: Any) -> Simulation:
    mechanism = {'gravity': [0, 0, 0], 'bodies': {'disc': DISC}, 'joints': {'hinge': HINGE}, **scene}
    return simulation_of(load_scene_text(json.dumps({'mechanism': mechanism, 'integrator': {'h': 1e-3}, **more})))


@pytest.mark.parametrize('kind', ['as_placed', 'assemble'])
@pytest.mark.parametrize('angle', [3.0, 4.0, 7.0, -10.0, 100.0])
def test_a_coordinate_starts_wound_as_far_as_it_is_wanted(angle: float, kind: str) -> None:
    """A disc of 0.1 kg m^2 on a torsion spring of 2 N m/rad, let go: angle cos(w t) with w^2 = 20 / s^2. The phase of
    the method is short by (w h)^2/12 of w t: 7.5e-6 of the angle after one second."""
    spring = {'k': {'terms': {'hinge': 1}, 'spring': 2}}
    s = start({'coordinate_forces': spring}, start={'kind': kind, 'coordinates': {'hinge': {'value': angle}}})
    assert s.snapshot().joint_position[0] == pytest.approx(angle, abs=1e-11)
    assert s.snapshot().joint_effort[0] == pytest.approx(-2.0 * angle, abs=1e-10)
    end = s.advance(1000).joint_position[0]
    assert end == pytest.approx(angle * np.cos(np.sqrt(20.0)), abs=1e-5 * abs(angle))


@pytest.mark.parametrize('angle', [7.0, -40.0])
def test_a_driver_may_begin_wound(angle: float) -> None:
    """It holds what is placed at zero at its angle."""
    driver = {'d': {'terms': {'hinge': 1}, 'input': 'drive', 'offset': 0}}
    s = start({'couplers': driver}, maneuver={'signals': {'drive': angle}}, start={'kind': 'assemble'})
    assert s.snapshot().joint_position[0] == pytest.approx(angle, abs=1e-11)
    assert s.advance(10).joint_position[0] == pytest.approx(angle, abs=1e-9)


def test_a_gear_winds_what_it_drives_while_the_start_turns_it() -> None:
    """2 rad of the disc are 50 times as much, 100 rad or 16 turns, of the pinion beside it."""
    scene = {
        'bodies': {'disc': DISC, 'pinion': {'mass': 1, 'inertia': [1e-3, 1e-3, 1e-3], 'position': [1, 0, 0]}},
        'joints': {
            'hinge': HINGE,
            'shaft': {'kind': 'revolute', 'i': 'world', 'j': 'pinion', 'at': [1, 0, 0], 'axis': [0, 0, 1]},
        },
        'couplers': {'gear': {'terms': {'hinge': 50, 'shaft': -1}}},
    }
    s = start(scene, start={'kind': 'assemble', 'coordinates': {'hinge': {'value': 2.0}}})
    assert s.snapshot().joint_position.tolist() == pytest.approx([2.0, 100.0], abs=1e-10)


def test_what_is_out_of_reach_is_refused() -> None:
    """200 iterations and 10000 more turn by 0.3 rad about z, that is by 0.319 rad about the axis: 3253 of 5000 rad."""
    with pytest.raises(ConsistencyError, match=r"constraint 'start of hinge' stays open by 1\.75e\+03"):
        start(
            {'coordinate_forces': {'k': {'terms': {'hinge': 1}, 'spring': 2}}},
            start={'kind': 'assemble', 'coordinates': {'hinge': {'value': 5000.0}}},
        )
