"""A driver that asks for more than its mechanism can do is named, with its value, the end of its reach (here in closed
form), and what is in line there."""

from __future__ import annotations

import json
import math
import re
from typing import Any

import pytest

from solver import simulation_of
from solver.analysis.verdict import findings
from solver.errors import ConsistencyError, MbdError, StepError
from solver.files.scene import load_scene_text
from solver.simulation import Simulation

BAR = {'mass': 1, 'inertia': [0.1, 0.1, 0.1]}
Y = {'axis': [0, 1, 0]}


def simulation(mechanism: dict[str, Any], maneuver: Any, **more: Any) -> Simulation:
    scene = {
        'mechanism': {'gravity': [0, 0, 0], **mechanism},
        'maneuver': {'signals': maneuver},
        'duration': 40,
        **more,
    }
    return simulation_of(load_scene_text(json.dumps(scene)))


def hinge(i: str, j: str, at: list[float], axis: Any = (0, 1, 0)) -> dict[str, Any]:
    return {'kind': 'revolute', 'i': i, 'j': j, 'at': at, 'axis': list(axis)}


FOUR_BAR = {
    'bodies': {'crank': {**BAR, 'com': [0, 0, 0.5]}, 'rod': {**BAR, 'position': [0, 0, 1]},
    'rocker': {**BAR, 'position': [1.6, 0, 0]}},
    'joints': {
        'A': hinge('world', 'crank', [0, 0, 0]), 'B': hinge('crank', 'rod', [0, 0.1, 1]),
        'C': hinge('rod', 'rocker', [0.8, 0, 1]), 'D': hinge('world', 'rocker', [1.6, 0, 0]),
    },
    'couplers': {'motor': {'terms': {'A': 1}, 'input': 'motor'}},
}  # fmt: skip
# B is as far from D as rod and rocker are long together: 1 + 1.6^2 - 3.2 sin(a) = (0.8 + hypot(0.8, 1))^2
FOUR_BAR_END = math.asin((1 + 1.6**2 - (0.8 + math.hypot(0.8, 1.0)) ** 2) / 3.2)
SLIDER = {
    'bodies': {'crank': BAR, 'rod': {**BAR, 'position': [0, 0, 1]}, 'block': {**BAR, 'position': [math.sqrt(3), 0, 0]}},
    'joints': {
        'A': hinge('world', 'crank', [0, 0, 0]), 'B': hinge('crank', 'rod', [0, 0, 1]),
        'C': hinge('rod', 'block', [math.sqrt(3), 0, 0]),
        'slide': {'kind': 'prismatic', 'i': 'world', 'j': 'block', 'at': [math.sqrt(3), 0, 0], 'axis': [1, 0, 0]},
    },
    'couplers': {'press': {'terms': {'slide': 1}, 'input': 'press'}},
}  # fmt: skip
SLIDER_END = 3.0 - math.sqrt(3)  # crank and rod, 1 m and 2 m, in line; the coordinate is 0 where the block is placed
# crank about z in the plane, rocker about x at (1.5, 1, 0): spatial, the rod between them with balls at its ends
SPATIAL = {
    'bodies': {'crank': BAR, 'rocker': {**BAR, 'position': [1.5, 1, 0]}},
    'joints': {
        'A': hinge('world', 'crank', [0, 0, 0], (0, 0, 1)), 'D': hinge('world', 'rocker', [1.5, 1, 0], (1, 0, 0)),
        'rod': {'kind': 'distance', 'i': {'body': 'crank', 'at': [0.5, 0, 0]},
        'j': {'body': 'rocker', 'at': [1.5, 1, 0.7]}},
    },
    'couplers': {'motor': {'terms': {'A': 1}, 'input': 'motor'}},
}  # fmt: skip


def spatial_end() -> float:
    """The ball of the rocker is on the circle (1.5, 1 - 0.7 sin b, 0.7 cos b), the rod sqrt(1 + 1 + 0.49) long: its
    crank cannot go on where the nearest place of the circle, in the plane of the crank, is as far as that."""

    def left(a: float) -> float:
        x, y = 0.5 * math.cos(a), 0.5 * math.sin(a)
        return math.sqrt(1.0 + 1.0 + 0.49) - math.hypot(1.5 - x, abs(1.0 - y) - 0.7)

    low, high = 0.0, 3.0
    assert left(low) > 0.0 > left(high)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if left(middle) > 0.0 else (low, middle)
    return low


RAMP = {'kind': 'ramp', 'start': 0.2}
CASES = {
    'planar': (FOUR_BAR, 'motor', -1.0, FOUR_BAR_END, "'rod' and 'rocker' are in line"),
    'prismatic': (SLIDER, 'press', 1.0, SLIDER_END, "'crank' and 'rod' are in line"),
    'spatial': (SPATIAL, 'motor', 1.0, spatial_end(), "the constraints 'rod'"),
}


def told(error: MbdError, name: str, end: float) -> None:
    text = str(error)
    assert re.search(rf"driver '{name}' (asks for|moves on from) {name} = ", text), text
    reach = re.search(r'reaches (\S+) (rad|m) at most', text)
    assert reach is not None, text
    assert float(reach[1]) == pytest.approx(end, rel=1e-3)
    assert 'digits' not in text
    assert 'integrator.h' not in text


@pytest.mark.parametrize('case', CASES)
@pytest.mark.parametrize(
    'integrator',
    [
        pytest.param({}, id='plain'),
        pytest.param({'step_policy': 'constant'}, id='constant', marks=pytest.mark.slow),
        pytest.param({'h': 0.005}, id='coarse', marks=pytest.mark.slow),
    ],
)
def test_a_driver_that_leaves_its_reach_is_named(case: str, integrator: dict[str, Any]) -> None:
    mechanism, name, slope, end, line = CASES[case]
    s = simulation(mechanism, {name: {**RAMP, 'slope': slope}}, integrator=integrator)
    with pytest.raises(StepError) as error:
        s.advance(2500)
    told(error.value, name, end)
    assert line in str(error.value)


@pytest.mark.parametrize('kind', ['as_placed', 'assemble'])
@pytest.mark.parametrize('case', CASES)
def test_a_driver_that_begins_beyond_its_reach_is_named(case: str, kind: str) -> None:
    mechanism, name, slope, end, line = CASES[case]
    with pytest.raises(ConsistencyError) as error:
        simulation(mechanism, {name: end + 0.1 * slope}, start={'kind': kind})
    told(error.value, name, end)
    assert line in str(error.value)


def test_a_driver_within_its_reach_is_not_to_blame() -> None:
    """What fails at the start for another reason keeps its own sentence, also beside a driver."""
    with pytest.raises(ConsistencyError, match=r'is open by .*as the bodies are placed; set start.kind: assemble'):
        simulation(FOUR_BAR, {'motor': FOUR_BAR_END + 0.05}, start={'kind': 'as_placed'})
    simulation(FOUR_BAR, {'motor': FOUR_BAR_END + 0.05}, start={'kind': 'assemble'}).advance(10)


def test_drivers_that_contradict_each_other_are_both_named() -> None:
    both = {**FOUR_BAR['couplers'], 'second': {'terms': {'D': 1}, 'input': 'second'}}
    with pytest.raises(ConsistencyError, match=r"driver 'motor'.*driver 'second' too: together they ask for too much"):
        simulation({**FOUR_BAR, 'couplers': both}, {'motor': 0.1, 'second': -0.2}, start={'kind': 'assemble'})


def test_a_run_that_goes_on_beyond_the_reach_says_so_at_its_end() -> None:
    s = simulation(SLIDER, {'press': {**RAMP, 'slope': 1.0}}, integrator={'mode': 'tolerance', 'h': 0.005})
    s.advance(600)
    (text,) = [found.text for found in findings(s) if found.quantity == 'contradiction']
    assert (
        "driver 'press' asks for press = 2.8 m of 'slide', and the mechanism reaches 1.268 m at most, where 'crank' "
        "and 'rod'"
    ) in text


@pytest.mark.parametrize('asked', [1.91e14, -5e10])
def test_a_driver_whose_value_has_no_digits_left_is_named_without_a_search(asked: float) -> None:
    with pytest.raises(
        MbdError, match=r"driver 'motor' asks for motor = .* rad, whose last digit is worth .*; keep it below 4e9"
    ):
        simulation(FOUR_BAR, {'motor': asked})
