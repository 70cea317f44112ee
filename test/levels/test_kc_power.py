"""Engine, clutch and gearbox at the level kc, beside those of the whole vehicle."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from live_axle_cars import off_roader
from live_axle_cars import scene as of_vehicle

from solver import simulation_of
from solver.errors import SpecError
from solver.files.scene import load_scene_text
from solver.levels.kc import kc_model
from solver.scene import Scene

POWER = 'vehicle.engine.power=docs/examples/power.yaml'
CONVERTER = 'vehicle.engine.power.converter=docs/examples/converter.yaml'
ACROSS, ALONG = ('compact_fwd', ()), ('full_car', ('vehicle.engine.power.final=1',))
STEER = '{steering: {kind: step, value: 0.8, start: 0.2, rise: 0.15}, signals: {gear: 3, accelerator: 0.5}}'


def scene(*changes: str, vehicle: str, speed: float, maneuver: str) -> Scene:
    text = (
        f'vehicle: vehicles/{vehicle}.yaml\nstart: {{kind: equilibrium, speed: {speed}}}\nintegrator: {{h: '
        f'0.002}}\nmaneuver: {maneuver}\n'
    )
    return load_scene_text(text, 'power', (POWER, *changes))


def driven(given: Scene, seconds: float) -> np.ndarray:
    """(n, 3) speed [m/s], rate of the crankshaft [rad/s] and yaw rate [rad/s], ten times a second."""
    simulation = simulation_of(given)
    crankshaft, chassis = simulation.channels.joints.index('crankshaft'), simulation.channels.chassis or 0
    rows = []
    for _ in range(round(10 * seconds)):
        shot = simulation.advance(round(0.1 / simulation.h))
        rows.append((shot.twist[chassis, 0], abs(shot.joint_velocity[crankshaft]), shot.twist[chassis, 5]))
    return np.array(rows)


def misses(found: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """RMS of the errors of what speed and crankshaft gain, and of the yaw rate, as shares of the peaks."""
    a, b = found - found[0] * (1, 1, 0), whole - whole[0] * (1, 1, 0)
    return np.sqrt(np.mean((a - b) ** 2, axis=0)) / np.abs(b).max(axis=0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('car', 'changes', 'speed', 'maneuver'),
    [
        (ACROSS, (), 10.0, '{signals: {gear: 2, accelerator: 0.6}}'),
        (ALONG, (), 20.0, '{signals: {gear: 3, accelerator: 0.6}}'),
        (ACROSS, (CONVERTER,), 15.0, '{signals: {gear: 2, accelerator: 0.6}}'),
        (ACROSS, (), 20.0, STEER),
    ],
)
def test_it_drives_as_the_whole_vehicle(car: Any, changes: tuple[str, ...], speed: float, maneuver: str) -> None:
    """Within the two percent of the level, with the engine across and along, behind a converter, and in a bend."""
    vehicle, own = car
    runs = [
        driven(scene(f'fidelity={level}', *own, *changes, vehicle=vehicle, speed=speed, maneuver=maneuver), 2.0)
        for level in ('kc', 'full')
    ]
    assert (misses(*runs)[: 3 if 'steering' in maneuver else 2] < 0.02).all()


@pytest.mark.slow
def test_a_gearbox_in_front_of_two_axles() -> None:
    """By their shares, through propeller shafts and the differentials of live axles."""
    vehicle = off_roader(power=True, shares=(0.4, 0.6))
    given = {
        'maneuver': {'signals': {'gear': 2, 'accelerator': 0.5}},
        'start': {'kind': 'equilibrium', 'speed': 8.0},
        'duration': 5.0,
    }
    runs = [driven(of_vehicle(vehicle, fidelity=level, **given), 2.0) for level in ('kc', 'full')]
    assert (misses(*runs)[:2] < 0.02).all()


def test_the_gearbox_turns_the_wheels_by_the_ratios_of_the_axle() -> None:
    """An open differential is half of each wheel, behind its final drive; the universal joints are 1e-4 off where they
    stand."""
    vehicle, own = ALONG
    full = scene(*own, vehicle=vehicle, speed=0.0, maneuver='{}').model
    (clutch,) = kc_model(full).clutches
    shares = dict(clutch.outputs)
    assert set(shares) == {'wheel_rear_left', 'wheel_rear_right'}
    np.testing.assert_allclose(list(shares.values()), 0.5 * 3.2, rtol=1e-3)


@pytest.mark.slow
def test_energy_closes_with_second_order() -> None:
    errors = []
    for h in (2e-3, 1e-3):
        given = scene(
            'fidelity=kc', f'integrator.h={h}', vehicle='compact_fwd', speed=10.0,
            maneuver='{signals: {gear: 2, accelerator: {kind: step, value: 0.5, start: 0.2, rise: 0.3}}}',
        )  # fmt: skip
        simulation = simulation_of(given)
        simulation.advance(round(1.0 / h))
        errors.append(simulation.totals()['energy_error_max'])
    assert errors[0] / errors[1] > 3.0


def test_a_shaft_that_turns_no_wheel_is_refused() -> None:
    vehicle, own = ALONG
    full = scene(*own, vehicle=vehicle, speed=0.0, maneuver='{}').model
    (clutch,) = full.clutches
    loose = dataclasses.replace(full, clutches=(clutch.replace(outputs=(('steering_wheel', 1.0),)),))
    with pytest.raises(SpecError, match="'steering_wheel' turns with no wheel; use full"):
        kc_model(loose)
