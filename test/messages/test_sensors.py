"""Sensors: covariances are squares of the deviations, noise has them, is a function of seed and step, and is off unless
wanted."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from synthetic import channels, snapshot

from mbd_sim_ros.messages import cdr
from mbd_sim_ros.messages.encode import Messages
from mbd_sim_ros.messages.topics import ODOMETRY
from solver.errors import SpecError
from solver.output.sensors import ImuSensor, OdomSensor, Sensors


def vector(value: dict, *names: str) -> np.ndarray:
    return np.array([value[name] for name in names])


def sensed(k: int, sensors: Sensors | None = None) -> tuple[Messages, dict[str, dict]]:
    names = channels()
    messages = Messages(names, sensors=sensors)
    encoded = messages.encode(snapshot(names, k))
    kinds = {t.name: t.type for t in messages.topics}
    return messages, {
        n: cdr.decode(k, cdr.schema_text(k), d)[0]
        for (n, k), d in zip(kinds.items(), encoded, strict=True)
        if n in SENSED
    }


SENSED = ('odom', 'imu')
NOISY = Sensors(
    odom=OdomSensor(position=0.5, orientation=0.01, velocity=0.2, rate=0.03),
    imu=ImuSensor(orientation=0.02, rate=0.004, acceleration=0.6),
    noise=True,
    seed=11,
)


def test_covariances_are_squares_of_the_deviations_and_numbers_stay_exact():
    _, exact = sensed(5)
    _, said = sensed(5, dataclasses.replace(NOISY, noise=False))
    pose, twist = np.diag([0.25] * 3 + [1e-4] * 3), np.diag([0.04] * 3 + [9e-4] * 3)
    np.testing.assert_allclose(said['odom']['pose']['covariance'].reshape(6, 6), pose, rtol=1e-14)
    np.testing.assert_allclose(said['odom']['twist']['covariance'].reshape(6, 6), twist, rtol=1e-14)
    np.testing.assert_allclose(
        said['imu']['linear_acceleration_covariance'].reshape(3, 3), np.diag([0.36] * 3), rtol=1e-14
    )
    assert said['odom']['pose']['pose'] == exact['odom']['pose']['pose']
    assert said['imu']['linear_acceleration'] == exact['imu']['linear_acceleration']
    assert not exact['odom']['pose']['covariance'].any() and not exact['imu']['orientation_covariance'].any()


def numbers_of(value: dict) -> np.ndarray:
    """Of odom: position, velocity, angular velocity; of imu: angular velocity, specific force."""
    if 'pose' in value:
        parts = (
            value['pose']['pose']['position'],
            value['twist']['twist']['linear'],
            value['twist']['twist']['angular'],
        )
    else:
        parts = (value['angular_velocity'], value['linear_acceleration'])
    return np.concatenate([vector(part, 'x', 'y', 'z') for part in parts])


def test_noise_has_its_deviations_and_is_a_function_of_seed_and_step():
    names = channels()
    exact, noisy = Messages(names), Messages(names, sensors=NOISY)
    at = [[t.name for t in exact.topics].index(name) for name in SENSED]
    found = {}
    for k in range(1, 801):
        shot = snapshot(names, k)
        pairs = [(exact.encode(shot)[i], noisy.encode(shot)[i], exact.topics[i].type) for i in at]
        found[k] = np.concatenate([numbers_of(cdr.decode(t, cdr.schema_text(t), b)[0]) - numbers_of(cdr.decode(t,
        cdr.schema_text(t), a)[0])
                                   for a, b, t in pairs])  # fmt: skip
    deviations = np.repeat([0.5, 0.2, 0.03, 0.004, 0.6], 3)
    scatter = np.array(list(found.values())) / deviations
    assert np.max(np.abs(scatter.mean(axis=0))) < 4.0 / np.sqrt(800)  # four deviations of a mean
    assert np.max(np.abs(scatter.std(axis=0) - 1.0)) < 4.0 / np.sqrt(2 * 800)
    assert np.max(np.abs(np.corrcoef(scatter.T) - np.eye(15))) < 5.0 / np.sqrt(800)
    other, again = Messages(names, sensors=dataclasses.replace(NOISY, seed=12)), Messages(names, sensors=NOISY)
    shot = snapshot(names, 400)
    assert [again.encode(shot)[i] for i in at] == [noisy.encode(shot)[i] for i in at]  # whatever was encoded before
    assert all(other.encode(shot)[i] != noisy.encode(shot)[i] for i in at)


def test_a_noisy_orientation_is_a_turn_by_its_deviation():
    names = channels()
    shot = snapshot(names, 3)
    shot.pose[1, 3:] = np.array([0.1, -0.2, 0.3, 0.9]) / np.sqrt(0.95)
    noisy = Messages(names, sensors=NOISY)
    angles = []
    for k in range(400):
        odom = cdr.decode(ODOMETRY, cdr.schema_text(ODOMETRY), noisy.encode(shot._replace(k=k))[1])[0]
        q = vector(odom['pose']['pose']['orientation'], 'x', 'y', 'z', 'w')
        assert abs(q @ q - 1.0) < 1e-14
        angles.append(2.0 * np.arccos(min(1.0, abs(float(q @ shot.pose[1, 3:])))))
    assert np.sqrt(np.mean(np.square(angles))) == pytest.approx(0.01 * np.sqrt(3.0), rel=4.0 / np.sqrt(2 * 3 * 400))


def test_noise_needs_a_seed():
    with pytest.raises(SpecError, match='needs a seed'):
        Sensors(noise=True)


def test_slow_topics_have_messages_at_their_instants_only():
    names = channels()
    messages = Messages(names, element_states=True, elements_every=4)
    at = [t.name for t in messages.topics].index('element_states')
    there = [messages.encode(snapshot(names, k))[at] is not None for k in range(9)]
    assert there == [k % 4 == 0 for k in range(9)]
    assert messages.encode(snapshot(names, 3), whole=True)[at] is not None
