"""Velocities and accelerations of all bodies, on request (`record.motions`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mbd_sim_ros.analysis.runs import units
from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.batch import simulate
from mbd_sim_ros.messages.composition import MOTION
from mbd_sim_ros.messages.encode import Messages
from solver import simulation_of
from solver.files.scene import load_scene

H = 1e-3


def test_accelerations_are_the_derivatives_of_velocities() -> None:
    """Of a heavy top that spins and precesses: differences of velocities in the world over two steps, second order in
    the turn of a step. That of the reference frame is what is left of terms with the size of |dw| |com|."""
    h = 1e-4
    s = simulation_of(load_scene('spinning_top', ['record.motions=1000', f'integrator.h={h}']))
    s.advance(1000)
    shown = [s.advance(1) for _ in range(3)]
    turned = [Rotation.from_quat(shot.pose[:, 3:]) for shot in shown]
    turning = np.abs(shown[1].acceleration[:, 3:]).max()
    com = max(np.linalg.norm(body.com) for body in s.scene.model.bodies)
    second = (np.linalg.norm(shown[1].twist[:, 3:], axis=1).max() * h) ** 2
    for part, size in ((slice(0, 3), turning * com), (slice(3, 6), turning)):
        before, after = (R.apply(shot.twist[:, part]) for R, shot in ((turned[0], shown[0]), (turned[2], shown[2])))
        now = turned[1].apply(shown[1].acceleration[:, part])
        np.testing.assert_allclose((after - before) / (2.0 * h), now, atol=second * size)
    assert turning > 1.0


def test_that_of_the_chassis_is_what_its_imu_feels_without_gravity() -> None:
    s = simulation_of(load_scene('light_car_swept_steer', ['record.motions=1000']))
    s.advance(1500)
    shot, k = s.snapshot(), s.channels.chassis
    assert k is not None
    com, w, (a, turning) = s.scene.model.bodies[k].com, shot.twist[k, 3:], shot.acceleration[k].reshape(2, 3)
    gravity = Rotation.from_quat(shot.pose[k, 3:]).inv().apply(s.model.tables.bodies.gravity)
    np.testing.assert_allclose(
        a + np.cross(turning, com) + np.cross(w, np.cross(w, com)) - gravity, shot.imu[:3], rtol=1e-12, atol=1e-9
    )


def test_they_are_recorded_at_their_rate_with_units(tmp_path: Path) -> None:
    scene = load_scene('four_bar', ['record.motions=100', 'duration=0.1', f'integrator.h={H}'])
    s = simulation_of(scene)
    simulate(s, 100, directory=tmp_path / 'r')
    run = bag.read(tmp_path / 'r')
    series = run.series['body_motions']
    assert list(series.time_ns) == [k * 10_000_000 for k in range(11)]
    body = s.channels.bodies[-1]
    for i, name in enumerate(MOTION):
        values = series.columns[f'body_motions/{body}/{name}']
        assert values[-1] == np.concatenate([s.snapshot().twist[-1], s.snapshot().acceleration[-1]])[i]
    unit = units(run)
    assert [unit(f'body_motions/{body}/{name}') for name in MOTION] == ['m/s'] * 3 + ['rad/s'] * 3 + ['m/s^2'] * 3 + [
        'rad/s^2'
    ] * 3


@pytest.mark.parametrize('changes', [[], ['record.motions=50', 'fidelity=single_track']])
def test_without_a_request_or_bodies_there_are_none(changes: list[str]) -> None:
    scene = load_scene('light_car_straight', changes)
    s = simulation_of(scene)
    assert s.snapshot().acceleration.shape == (0, 6)
    assert 'body_motions' not in [topic.name for topic in Messages.of(scene, s).topics]
