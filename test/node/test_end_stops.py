"""Commands beyond the end stops of the steering: clamped there, and told by whose limit; without a graph of ROS."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from solver import load_scene, simulation_of

pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')

from mbd_sim_ros.node.commands import Commands
from mbd_sim_ros.node.driving import Driving
from mbd_sim_ros.node.latch import Latch

PARAMETERS = {'max_steering': 12.0, 'max_road_wheel': 0.7, 'max_drive_torque': 100.0}


class Node:
    """What commands ask of a node."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def get_parameter(self, name: str) -> SimpleNamespace:
        return SimpleNamespace(value=PARAMETERS[name])

    def get_logger(self) -> SimpleNamespace:
        return SimpleNamespace(warning=self.said.append)


def commands(ends: dict[str, tuple[float, float]]) -> tuple[Commands, Node]:
    node = Node()
    latch = Latch(SimpleNamespace(k=0, t_ns=0), commands=('steering', 'road_wheel', 'drive_torque'))  # type: ignore[arg-type]
    return Commands(node, latch, ends=ends, deaf=True), node  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ('index', 'asked', 'applied', 'by'),
    [
        (0, 5.0, 3.5, 'end stops of the steering'),
        (0, -40.0, -3.5, 'end stops of the steering'),
        (0, 3.5, 3.5, ''),
        (0, -3.4, -3.4, ''),
        (1, 0.5, 0.3, 'end stops of the steering'),
        (1, -0.5, -0.4, 'end stops of the steering'),  # a map need not be symmetric
        (2, 500.0, 100.0, 'parameter max_drive_torque'),
        (0, math.nan, None, 'is not a number'),
    ],
)
def test_what_is_beyond_the_stops_is_clamped_and_told(index: int, asked: float, applied: float | None, by: str) -> None:
    one, node = commands({'steering': (-3.5, 3.5), 'road_wheel': (-0.4, 0.3)})
    assert one._accepted(index, 'steering_cmd', asked) == applied
    assert by in node.said[0] if by else not node.said


def test_a_parameter_only_narrows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PARAMETERS, 'max_steering', 2.0)
    one, node = commands({'steering': (-3.5, 3.5)})
    assert one._accepted(0, 'steering_cmd', 5.0) == 2.0
    assert 'parameter max_steering' in node.said[0]


@pytest.mark.parametrize(
    ('settings', 'lock'),
    [([], None), (['vehicle.steering.lock=2.5'], 2.5), (['vehicle.steering.lock_deg=90'], math.pi / 2)],
)
def test_the_ends_are_those_of_the_car(settings: list[str], lock: float | None) -> None:
    scene = load_scene('light_car_straight', settings)
    values = {'commands': 'topics', 'steering_bandwidth': 5.0, 'steering_rate_limit': 20.0}
    simulation = simulation_of(scene)
    ends = Driving(scene, simulation, Latch(simulation), values.get).ends['steering']
    assert ends == (-scene.model.lock, scene.model.lock)
    assert lock is None or ends[1] == pytest.approx(lock, rel=1e-15)
