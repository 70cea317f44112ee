"""A run is watched against the ranges of the certificate that it relies on."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

import solver
from mbd_sim_ros.batch import simulate
from solver.analysis.envelope import Envelope
from solver.analysis.verdict import findings
from solver.levels.derived import LevelReport, Limit

LIMITS = (
    Limit(quantity='lateral_acceleration', unit='m/s^2', low=-1.0, high=2.0, why='certified'),
    Limit(quantity='wheel_load', unit='N', low=0.0, high=20e3, why='certified'),
    Limit(quantity='frequency', unit='Hz', high=3.0, why='a limit of another kind'),
)


def test_a_run_that_leaves_its_envelope_is_suspect_with_what_and_when() -> None:
    """6.7 m/s^2 to the left where 2 is certified; the loads stay within theirs."""
    scene = solver.load_scene('light_car_step_steer', ['duration=1.2', 'maneuver.steering.start=0.2'])
    simulation = solver.simulation_of(scene)
    simulation.level = LevelReport(validity=LIMITS)
    data = simulate(simulation, scene.steps)
    (found,) = [f for f in data['findings'] if f['quantity'] == 'envelope']
    assert data['status'] == 'suspect'
    assert found['where'] == 'lateral_acceleration'
    assert 5.0 < found['value'] < 9.0
    assert found['limit'] == 2.0
    assert 0.3 < found['time'] < 1.2001
    assert 'valid is -1 to 2 m/s^2 (certified)' in found['text']


@pytest.mark.parametrize('validity', [(), LIMITS[2:], (dataclasses.replace(LIMITS[0], low=-20.0, high=20.0),)])
def test_a_run_within_its_envelope_is_not(validity: tuple[Limit, ...]) -> None:
    scene = solver.load_scene('light_car_step_steer', ['duration=0.3'])
    simulation = solver.simulation_of(scene)
    simulation.level = LevelReport(validity=validity)
    watch = Envelope(simulation)
    for _ in range(3):
        watch.look(simulation.advance(100))
    assert watch.findings() == []


def test_what_is_left_of_nothing_is_not_left() -> None:
    """A car that drives straight ahead is certified for lateral accelerations of its rounding, 1e-9 m/s^2, or for none at all; of another
    rounding it is not suspect, of a bend it is."""
    for width in (1e-9, 0.0):
        straight = Limit(quantity='lateral_acceleration', unit='m/s^2', low=-width, high=width, why='certified')
        for steering, suspect in ((1e-6, False), (0.01, True)):
            scene = solver.load_scene('light_car_step_steer', ['duration=0.3', f'maneuver.steering={steering}'])
            simulation = solver.simulation_of(scene)
            simulation.level = LevelReport(validity=(straight,))
            watch = Envelope(simulation)
            for _ in range(3):
                watch.look(simulation.advance(100))
            assert bool(watch.findings()) == suspect


@pytest.mark.slow
def test_the_range_of_a_certificate_is_no_limit_of_a_level_of_the_same_name() -> None:
    """Slips of the wheels, which this level does not show, between two negative numbers; it follows the largest magnitude of an axle."""
    simulation = solver.simulation_of(solver.load_scene('light_car_straight', ['fidelity=single_track']))
    certified = Limit(quantity='slip', unit='1', low=-0.0005, high=-0.0004, why='the plan is certified for this range')
    simulation.level = dataclasses.replace(simulation.level, validity=(*simulation.level.validity, certified))
    simulation.advance(500)
    assert simulation.reached['slip'][0] > 0.0
    assert findings(simulation) == []


def test_a_quantity_without_a_unit_is_shown_without_one() -> None:
    slip = Limit(quantity='slip', unit='1', low=-1e-6, high=1e-6, why='certified')
    simulation = solver.simulation_of(solver.load_scene('light_car_step_steer', ['duration=0.3']))
    simulation.level = LevelReport(validity=(slip,))
    watch = Envelope(simulation)
    watch.look(simulation.advance(100))
    (found,) = watch.findings()
    assert ' 1 at t = ' not in found.text and 'valid is -1e-06 to 1e-06 (certified)' in found.text


FREQUENCY = Limit(quantity='frequency', unit='Hz', high=5.0, why='certified')


@pytest.mark.parametrize(('frequency', 'suspect'), [(4.0, False), (7.0, True)])
def test_how_fast_a_run_swings_is_watched(frequency: float, suspect: bool) -> None:
    """The steering wheel swings with a given frequency; a sine has no other, and the wheels hardly travel."""
    steering = f'maneuver.steering={{kind: sine, amplitude: 0.1, frequency: {frequency}}}'
    simulation = solver.simulation_of(solver.load_scene('light_car_step_steer', ['duration=1.5', steering]))
    simulation.level = LevelReport(validity=(FREQUENCY,))
    watch = Envelope(simulation)
    for _ in range(150):
        watch.look(simulation.advance(10))
    found = watch.findings()
    assert len(found) == suspect
    if suspect:
        assert found[0].where == 'frequency'
        assert found[0].value == pytest.approx(frequency, rel=0.05)
        assert 'frequency of steering wheel is 6.9' in found[0].text
        assert 'valid is up to 5 Hz (certified)' in found[0].text


def leaning(simulation: solver.simulation.Simulation, body: int, degrees: float, axis: tuple[float, float, float]) -> solver.Snapshot:
    """What a simulation shows, with a body turned by an angle about an axis from where it stands upright in the world."""
    snapshot = simulation.snapshot()
    half = np.radians(degrees) / 2.0
    snapshot.pose[body, 3:] = [*(np.sin(half) * np.array(axis)), np.cos(half)]
    return snapshot


BANK = (0.0, -math.tan(math.radians(20.0)), 1.0)


@pytest.mark.parametrize(
    ('degrees', 'axis', 'normal', 'told'),
    [
        (59.0, (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), False),
        (61.0, (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), True),
        (-180.0, (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), True),
        (61.0, (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), True),
        (170.0, (0.0, 0.0, 1.0), (0.0, 0.0, 1.0), False),  # it turns round on its wheels
        (75.0, (1.0, 0.0, 0.0), BANK, False),
        (-45.0, (1.0, 0.0, 0.0), BANK, True),
    ],
)
def test_a_vehicle_that_leans_over_from_the_road_is_told_from_60_degrees_on(
    degrees: float, axis: tuple[float, float, float], normal: tuple[float, float, float], told: bool
) -> None:
    """Whatever its level: from there on it lies on its side or its roof soon, which do not touch the road."""
    brakes = ['maneuver={brake_torque: 4000}', f'road={{normal: {list(normal)}}}', 'start={kind: equilibrium}']
    watch = Envelope(simulation := solver.simulation_of(solver.load_scene('light_car_straight', brakes)))
    assert watch.findings() == []
    watch.look(leaning(simulation, 0, degrees, axis))
    found = watch.findings()
    assert [(f.quantity, f.where) for f in found] == [('rollover', 'chassis')] * told
    if told:
        away = np.degrees(np.arccos(np.dot(normal, (0.0, 0.0, 1.0)) / np.linalg.norm(normal)))
        assert found[0].value == pytest.approx(np.radians(abs(degrees) + away), abs=1e-9)  # of those that are told both add up
    watch.restart()
    assert watch.findings() == []


def test_a_car_on_its_roof_is_suspect_in_its_report() -> None:
    """With 2.5 times the friction a step steer at 110 km/h turns the car over; it was ok, the chassis half a metre in the road."""
    steering = 'maneuver={steering: {kind: step, value: 5, start: 0.2, rise: 0.3}}'
    speed = 'start={kind: equilibrium, speed_kmh: 110}'
    scene = solver.load_scene('light_car_step_steer', ['road={friction: 2.5}', speed, steering, 'duration=2', 'record={every: 20}'])
    data = simulate(solver.simulation_of(scene), scene.steps)
    assert data['status'] == 'suspect'
    assert 'rollover' in [f['quantity'] for f in data['findings']]


@pytest.mark.slow
def test_a_trailer_that_rolls_over_is_told_by_its_name() -> None:
    simulation = solver.simulation_of(solver.load_scene('saloon_with_trailer'))
    watch = Envelope(simulation)
    watch.look(leaning(simulation, simulation.channels.bodies.index('trailer'), 90.0, (1.0, 0.0, 0.0)))
    assert [f.where for f in watch.findings()] == ['trailer']
