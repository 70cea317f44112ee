"""The preview driver: geometry of the track, the law, lane changes inside the cones, exact replay and exact checkpoints."""

from __future__ import annotations

import numpy as np
import pytest

from solver import simulation_of
from solver.errors import SceneError, SpecError
from solver.files.scene import load_scene
from solver.inputs.driver import DoubleLaneChange, PreviewDriver, Sight, Waypoints
from solver.inputs.maneuver import Maneuver
from solver.simulation import Simulation

LENGTH = 4.6  # of the body of a mid-size car [m]


def test_track_of_iso_3888() -> None:
    """Part 1: 125 m with lanes 1.1 w + 0.25, 1.2 w + 0.25, 1.3 w + 0.25; part 2: 61 m, w + 1 in the middle, 3 m or more at the end."""
    first, second, third = DoubleLaneChange(width=1.8, start=10.0).gates
    assert np.diff([*first[:2], *second[:2], *third[:2]]) == pytest.approx([15, 30, 25, 25, 30])
    assert [g.left - g.right for g in (first, second, third)] == pytest.approx([2.23, 2.41, 2.59])
    assert second.right - first.right == pytest.approx(3.5)
    first, second, third = DoubleLaneChange(standard='iso_3888_2', width=1.8).gates
    assert third.end - first.begin == pytest.approx(61.0)
    assert np.diff([*first[:2], *second[:2], *third[:2]]) == pytest.approx([12, 13.5, 11, 12.5, 12])
    assert [g.left - g.right for g in (first, second, third)] == pytest.approx([2.23, 2.8, 3.0])
    assert second.right - first.left == pytest.approx(1.0)


def test_path_runs_through_the_middle_of_the_lanes() -> None:
    track = DoubleLaneChange(width=1.8, start=10.0)
    for gate in track.gates:
        for x in (gate.begin, 0.5 * (gate.begin + gate.end), gate.end):
            assert track.lateral(x) == pytest.approx(gate.middle)
    assert track.lateral(-5.0) == 0.0


def test_law_is_the_steady_state_on_the_arc_through_the_preview_point() -> None:
    """On a circle of radius 200 m, tangent to it: steering = ratio (L + K v^2)/R, to the arc's (l/R)^2/4."""
    R = 200.0
    x = np.linspace(0.0, 60.0, 601)
    path = Waypoints(points=tuple((float(a), float(R - np.sqrt(R * R - a * a))) for a in x))
    driver = PreviewDriver(path=path, preview=0.8, wheelbase=2.7, ratio=15.0, understeer=0.002)
    expected = 15.0 * (2.7 + 0.002 * 20.0**2) / R
    assert driver.steering(Sight(0.0, 0.0, 0.0, 20.0)) == pytest.approx(expected, rel=(16.0 / R) ** 2)
    straight = PreviewDriver(path=Waypoints(points=((0.0, 0.0), (100.0, 0.0))))
    assert straight.steering(Sight(10.0, 0.0, 0.0, 20.0)) == 0.0
    assert straight.steering(Sight(10.0, 0.5, 0.0, 20.0)) < 0.0  # left of the path: steer to the right
    assert straight.steering(Sight(10.0, 0.0, -0.1, 20.0)) > 0.0  # heading to the right: steer to the left
    assert straight.steering(Sight(10.0, 50.0, 0.0, 0.0)) == -straight.limit


def margins(scene: str) -> tuple[Simulation, list[float], np.ndarray]:
    """The run of a scene, distance [m] of the body's corners to the cones of each lane, and lateral acceleration [m/s^2]."""
    loaded = load_scene(scene)
    simulation, path = Simulation(loaded), loaded.maneuver.driver.path  # type: ignore[union-attr]
    track = []
    while simulation.k < loaded.steps:
        s = simulation.advance(10)
        x, y, _, qx, qy, qz, qw = s.pose[0]
        track.append([x, y, np.arctan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz)), s.twist[0, 0] * s.twist[0, 5]])
    x, y, heading, acceleration = np.array(track).T
    found = []
    for gate in path.gates:
        worst = np.inf
        for along in (-0.5 * LENGTH, 0.5 * LENGTH):
            for side in (-0.5 * path.width, 0.5 * path.width):
                X = x + along * np.cos(heading) - side * np.sin(heading)
                Y = y + along * np.sin(heading) + side * np.cos(heading)
                between = (gate.begin <= X) & (gate.end >= X)
                assert between.any()
                worst = min(worst, (gate.left - Y[between]).min(), (Y[between] - gate.right).min())
        found.append(float(worst))
    return simulation, found, acceleration


@pytest.mark.slow
@pytest.mark.parametrize(('scene', 'least'), [('car_lane_change', 6.0), ('car_obstacle_avoidance', 6.0), ('light_car_lane_change', 5.0)])
def test_lane_change_stays_between_the_cones(scene: str, least: float) -> None:
    """No corner of the body touches a cone, at lateral accelerations beyond the linear range, and the car runs straight afterwards."""
    simulation, margin, acceleration = margins(scene)
    assert min(margin) > 0.0
    assert np.abs(acceleration).max() > least
    assert abs(simulation.snapshot().twist[0, 5]) < 0.06


@pytest.mark.slow
def test_replay_of_what_was_applied_is_exact() -> None:
    """One step at a time, many at once, the recorded inputs played back, and a run continued from a saved state give the same bits."""
    scene = load_scene('light_car_lane_change', ['maneuver.driver.path.start=5'])
    single, chunked, replayed, continued = (Simulation(scene) for _ in range(4))
    inputs, saved = [], b''
    for k in range(1500):
        if k == 700:
            saved = single.save()
        inputs.append(single.advance(1).inputs)
    end = single.snapshot()
    assert np.abs(np.array(inputs)[:, scene.model.inputs.index('steering')]).max() > 0.3
    chunked.advance(1500)
    replayed.advance(1500, np.array(inputs))
    continued.restore(saved)
    continued.advance(800)
    for other in (chunked, replayed, continued):
        for name in ('pose', 'twist', 'tire', 'inputs'):
            assert np.array_equal(getattr(other.snapshot(), name), getattr(end, name))
    single.reset()
    single.advance(1500)
    assert np.array_equal(single.snapshot().pose, end.pose)


def test_refusals() -> None:
    driver = PreviewDriver(path=DoubleLaneChange())
    with pytest.raises(SpecError, match='the driver steers'):
        Maneuver(driver=driver, steering=0.3)
    with pytest.raises(SpecError, match='sees the motion'):
        Maneuver(driver=driver).commands(0.0)
    with pytest.raises(SpecError, match='preview'):
        PreviewDriver(path=DoubleLaneChange(), preview=0.0)
    with pytest.raises(SpecError, match='two'):
        Waypoints(points=((0.0, 0.0),))
    with pytest.raises(SceneError, match='standard'):
        load_scene('light_car_lane_change', ['maneuver.driver.path.standard=iso_3888'])
    with pytest.raises(SpecError, match='functions of time'):
        simulation_of(load_scene('light_car_lane_change', ['integrator={kind: reference_kkt}']))
