"""A run is watched against the ranges of the certificate that it relies on."""

from __future__ import annotations

import dataclasses

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
