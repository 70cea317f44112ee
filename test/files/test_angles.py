"""Angles in degrees where radians are meant: refused with their key and the remedy, wherever a file or an override
holds an angle."""

from __future__ import annotations

import math

import pytest

from solver.analysis.figures import alignment, standing
from solver.errors import SceneError
from solver.files.scene import load_scene, load_scene_text

CIRCLE = 'path: {kind: circle, radius: 50}'
REFUSED = [
    (
        'vehicle.front.wheel.toe=5',
        'vehicle.front.wheel.toe = 5: is too large in rad for the toe of a wheel (5 deg at most)',
        'write toe_deg',
    ),
    ('vehicle.rear.wheel.toe=-0.2', 'vehicle.rear.wheel.toe = -0.2', 'write toe_deg'),
    ('vehicle.front.wheel.camber=-0.8', 'vehicle.front.wheel.camber = -0.8', 'write camber_deg'),
    ('vehicle.front.wheel.toe_deg=7', 'toe_deg = 7: is too large in deg for the toe of a wheel (5 deg at most)', ''),
    (
        'maneuver.steering.value=51.6',
        'maneuver.steering = 51.6: is too large in rad for the angle of a steering wheel',
        '0.0174533',
    ),
    (
        'maneuver={steering: {kind: ramp, slope: 10, final: 20.001}}',
        'maneuver.steering = 20.001: is too large in rad',
        '0.0174533',
    ),
    ('maneuver={steering: {kind: sine, amplitude: -45, frequency: 0.5}}', 'maneuver.steering = ', '0.0174533'),
    (f'maneuver={{driver: {{{CIRCLE}, limit: 460}}}}', 'maneuver.driver.limit = 460', 'write limit_deg'),
    (f'maneuver={{driver: {{{CIRCLE}, rate_limit: 720}}}}', 'maneuver.driver.rate_limit = 720', ''),
    (
        f'maneuver={{driver: {{{CIRCLE}, understeer: 2.5}}}}',
        'understeer = 2.5: is too large in rad s^2/m',
        '1 deg/g is 0.00178',
    ),
    (
        'maneuver={steering: {kind: sine, amplitude: 1, frequency: 1, phase: 90}}',
        'maneuver.steering.phase = 90',
        'write phase_deg',
    ),
    ('start.coordinates.steering_wheel.value=45', 'start.coordinates.steering_wheel.value = 45', '0.0174533'),
    (
        'road.patches=[{center: [0, 0], size: [1, 1], yaw: 30, factor: 0.5}]',
        'road.patches[0].yaw = 30',
        'write yaw_deg',
    ),
]


@pytest.mark.parametrize(('override', 'place', 'remedy'), REFUSED)
def test_degrees_of_a_vehicle_are_told_with_the_remedy(override: str, place: str, remedy: str) -> None:
    with pytest.raises(SceneError) as refusal:
        load_scene('car_step_steer', [override])
    assert place in str(refusal.value)
    assert remedy in str(refusal.value)


@pytest.mark.parametrize(
    'override',
    [
        'vehicle.front.wheel.toe_deg=5', 'vehicle.front.wheel.toe=-0.05', 'vehicle.rear.wheel.camber_deg=-10',
        'maneuver.steering.value=14', f'maneuver={{driver: {{{CIRCLE}, limit_deg: 700}}}}',
        'road.patches=[{center: [0, 0], size: [1, 1], yaw_deg: 360, factor: '
        '0.5}]', 'start.coordinates.steering_wheel.value=7',
        'start.coordinates.steering_wheel.value=-20', 'maneuver.steering.value=20',
        # ramps that rounding takes up to 4e-14 rad beyond their end
        'maneuver={steering: {kind: ramp, start: 0.2, slope: 3, final: 20}}',
        'maneuver={steering: {kind: ramp, start: 0.3, slope: -3, final: -20, blend: 0.37}}',
        'maneuver={steering: {kind: ramp, start: 0.3, slope: 17, final: 20, blend: 0.37}}',
        'maneuver={steering: {kind: sine, amplitude: 20, frequency: 0.25}}',
    ],
)  # fmt: skip
def test_large_but_possible_angles_pass(override: str) -> None:
    load_scene('car_step_steer', [override])


PENDULUM = """
mechanism:
  bodies: {rod: {mass: 1, inertia: [0.1, 0.1, 0.1], com: [0, 0, -0.5]TURNED}}
  joints: {pivot: {kind: revolute, i: world, j: rod, at: [0, 0, 0], axis: [0, 1, 0]}}
start: {kind: assemble, coordinates: {pivot: {value: ANGLE}}}
"""


@pytest.mark.parametrize(
    ('angle', 'turned', 'sentence'),
    [
        (
            '45',
            '',
            'start.coordinates.pivot.value = 45: is too large in rad for an angle at the start (one turn at most)',
        ),
        (
            '0',
            ', rpy: [0, 45, 0]',
            'rpy = [0, 45, 0]: is too large in rad for an angle (one turn at most); if it is in deg, write rpy_deg',
        ),
        ('0', ', rpy_deg: [0, 4500, 0]', 'rpy_deg = [0, 4500, 0]: is too large in deg for an angle (one turn at most)'),
    ],
)
def test_degrees_of_a_mechanism_are_told(angle: str, turned: str, sentence: str) -> None:
    with pytest.raises(SceneError) as refusal:
        load_scene_text(PENDULUM.replace('ANGLE', angle).replace('TURNED', turned))
    assert sentence in str(refusal.value)
    load_scene_text(PENDULUM.replace('ANGLE', '-3.1').replace('TURNED', ', rpy: [0, 1.5, 0]'))


def test_a_spring_may_be_wound_by_several_turns() -> None:
    spring = '  coordinate_forces: {spring: {terms: {pivot: 1}, spring: 2.0}}\nstart:'
    load_scene_text(PENDULUM.replace('ANGLE', '45').replace('TURNED', '').replace('start:', spring))


def test_static_toe_and_camber_are_those_of_the_data_as_the_vehicle_stands() -> None:
    """The stiffness of the suspension of the light car and its sag turn a wheel by less than 0.05 degrees."""
    given = {
        'vehicle.front.wheel.toe_deg': 1.5,
        'vehicle.front.wheel.camber_deg': -3.0,
        'vehicle.rear.wheel.toe_deg': -0.75,
    }
    base = alignment(standing(load_scene('light_car_straight')))
    found = alignment(standing(load_scene('light_car_straight', [f'{key}={value}' for key, value in given.items()])))
    for key, value in given.items():
        axle, angle = key.split('.')[1], key.split('.')[3].removesuffix('_deg')
        for side in ('left', 'right'):
            assert found[f'{angle}_{axle}_{side}'] == pytest.approx(math.radians(value), abs=math.radians(0.05))
        assert found[f'{angle}_{axle}'] == pytest.approx(
            0.5 * sum(found[f'{angle}_{axle}_{s}'] for s in ('left', 'right'))
        )
    assert found['camber_rear'] == pytest.approx(base['camber_rear'], abs=math.radians(0.05))
