"""A run is watched against the ranges of the certificate that it relies on."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest

import solver
from mbd_sim_ros.batch import simulate
from solver.analysis.envelope import Envelope
from solver.analysis.verdict import findings
from solver.files.scene import load_scene_text
from solver.findings import LevelReport, Limit

TIRE = Path(__file__).parents[2] / 'config' / 'tires' / '205_55R16.tir'
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
    assert (
        'lateral acceleration is valid from -1 to 2 m/s^2 (' in found['text']
        and 'The limits: certified. ' in found['text']
    )


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
    """A car that drives straight ahead is certified for lateral accelerations of its rounding, 1e-9 m/s^2, or for none
    at all; of another rounding it is not suspect, of a bend it is."""
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
    """Slips of the wheels, which this level does not show, between two negative numbers; it follows the largest
    magnitude of an axle."""
    simulation = solver.simulation_of(solver.load_scene('light_car_straight', ['fidelity=single_track']))
    certified = Limit(quantity='slip', unit='1', low=-0.0005, high=-0.0004, why='the plan is certified for this range')
    simulation.level = dataclasses.replace(simulation.level, validity=(*simulation.level.validity, certified))
    simulation.advance(500)
    assert simulation.reached['slip'][0] > 0.0
    assert findings(simulation) == []


def test_both_ends_of_a_range_are_told() -> None:
    """5 m/s^2 to the left, then 4 to the right, where -1 to 2 are certified: what a plan has measured to one side
    covers that alone."""
    simulation = solver.simulation_of(solver.load_scene('light_car_straight', ['start={kind: equilibrium}']))
    simulation.level = LevelReport(validity=LIMITS[:1])
    watch = Envelope(simulation)
    for sideways in (0.0, 5.0, -4.0, 3.0):
        snapshot = simulation.snapshot()
        snapshot.imu[1] = sideways
        watch.look(snapshot)
    left, right = watch.findings()
    assert (left.value, left.limit) == (pytest.approx(5.0, abs=0.05), 2.0)
    assert (right.value, right.limit) == (pytest.approx(-4.0, abs=0.05), -1.0)


def test_a_quantity_without_a_unit_is_shown_without_one() -> None:
    slip = Limit(quantity='slip', unit='1', low=-1e-6, high=1e-6, why='certified')
    simulation = solver.simulation_of(solver.load_scene('light_car_step_steer', ['duration=0.3']))
    simulation.level = LevelReport(validity=(slip,))
    watch = Envelope(simulation)
    watch.look(simulation.advance(100))
    driven, braked = watch.findings()  # wheels that drive and wheels that are drawn
    for found in (driven, braked):
        assert ' 1, ' not in found.text and 'valid from -1e-06 to 1e-06 (' in found.text


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
        assert 'frequency of steering wheel is valid up to 5 Hz (envelope 6.9' in found[0].text


def leaning(
    simulation: solver.simulation.Simulation, body: int, degrees: float, axis: tuple[float, float, float]
) -> solver.Snapshot:
    """What a simulation shows, with a body turned by an angle about an axis from where it stands upright in the
    world."""
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
    found = [f for f in watch.findings() if f.quantity == 'rollover']  # its wheels, which stay, are another finding
    assert [f.where for f in found] == ['chassis'] * told
    if told:
        away = np.degrees(np.arccos(np.dot(normal, (0.0, 0.0, 1.0)) / np.linalg.norm(normal)))
        # of those that are told both add up
        assert found[0].value == pytest.approx(np.radians(abs(degrees) + away), abs=1e-9)
    watch.restart()
    assert watch.findings() == []


def test_a_car_on_its_roof_is_suspect_in_its_report() -> None:
    """With 2.5 times the friction a step steer at 110 km/h turns the car over; it was ok, the chassis half a metre in
    the road."""
    steering = 'maneuver={steering: {kind: step, value: 5, start: 0.2, rise: 0.3}}'
    speed = 'start={kind: equilibrium, speed_kmh: 110}'
    scene = solver.load_scene(
        'light_car_step_steer', ['road={friction: 2.5}', speed, steering, 'duration=2', 'record={every: 20}']
    )
    data = simulate(solver.simulation_of(scene), scene.steps)
    assert data['status'] == 'suspect'
    assert 'rollover' in [f['quantity'] for f in data['findings']]


def test_a_tire_that_carries_more_than_its_data_cover_is_told() -> None:
    """FZMAX is 11 kN. Six tonnes of body press the tires with 15 kN in the mean, those in front with more; in the
    delivered car it is 3.5 kN. An instant says nothing."""
    for mass, told in ((6000, True), (1250, False)):
        scene = solver.load_scene(
            'light_car_straight', [f'vehicle.chassis.mass={mass}', 'start={kind: equilibrium}', 'maneuver={}']
        )
        watch = Envelope(simulation := solver.simulation_of(scene))
        for _ in range(6):
            watch.look(simulation.advance(100))
            found = watch.findings(ended=False)
            assert found == []
        found = watch.findings()
        assert [(f.quantity, f.limit) for f in found] == [('tire_load', 11e3)] * told
        if told:
            assert found[0].where.startswith('front')
            assert found[0].value > 0.25 * (mass + 100.0) * 9.81
        watch.restart()
        assert watch.findings() == []


@pytest.mark.parametrize(('speed', 'beyond'), [(1.0, False), (10.0, True)])
def test_a_tire_that_is_pressed_in_beyond_its_rim_is_told_with_the_instant(speed: float, beyond: bool) -> None:
    """1000 kg that come down on a 205/55 R16 have 500 J at 1 m/s and 50 kJ at 10 m/s. Its spring of 215 kN/m takes 1.4
    kJ until 113 mm are pressed in, when the tread lies on the rim, and the folded sidewall 0.2 kJ; what is beyond may
    have been 509 kN, and was ok."""
    wheel = {'mass': 1000, 'inertia': [10, 10, 10], 'position': [0, 0, 0.316]}
    slide = {'kind': 'prismatic', 'i': 'world', 'j': 'wheel', 'at': [0, 0, 0.316], 'axis': [0, 0, 1]}
    tire = {'marker': 'wheel', 'data': str(TIRE)}
    mechanism = {'bodies': {'wheel': wheel}, 'joints': {'slide': slide}, 'tires': {'tire': tire}}
    start = {'coordinates': {'slide': {'rate': -speed}}}
    text = json.dumps({'mechanism': mechanism, 'start': start, 'integrator': {'h': 1e-4}, 'duration': 0.1})
    scene = load_scene_text(text.replace(f'"{TIRE}"', str(TIRE)))
    simulation = solver.simulation_of(scene)
    simulation.advance(1000)
    found = [f for f in findings(simulation) if f.quantity == 'tire_deflection']
    assert [(f.where, f.limit) for f in found] == [('tire', pytest.approx(0.316 - 0.2032))] * beyond
    # from touching on it takes longer than at its first speed, and less than a quarter of a swing on the spring alone
    if beyond:
        assert found[0].limit / speed < found[0].time < 0.5 * math.pi * math.sqrt(1000.0 / 215e3)


@pytest.mark.slow
def test_a_trailer_that_rolls_over_is_told_by_its_name() -> None:
    simulation = solver.simulation_of(solver.load_scene('saloon_with_trailer'))
    watch = Envelope(simulation)
    watch.look(leaning(simulation, simulation.channels.bodies.index('trailer'), 90.0, (1.0, 0.0, 0.0)))
    assert [f.where for f in watch.findings() if f.quantity == 'rollover'] == ['trailer']


@pytest.mark.parametrize(('slow', 'recorded'), [(False, False), (True, False), (False, True)])
def test_what_a_run_is_told_depends_neither_on_what_is_recorded_nor_on_the_machine(
    slow, recorded, tmp_path: Path, monkeypatch
) -> None:
    """The steering wheel swings at 10 Hz where 5 Hz is certified. Who looks every 0.1 s, as calls of a hundred steps
    do, sees it stand still; on a slow machine a call makes one step."""
    if slow:
        monkeypatch.setattr('mbd_sim_ros.batch.DEAF', 0.0)
    steering = 'maneuver.steering={kind: sine, amplitude: 0.1, frequency: 10}'
    scene = solver.load_scene('light_car_step_steer', ['duration=1.5', steering, 'record.every=100'])
    simulation = solver.simulation_of(scene)
    simulation.level = LevelReport(validity=(FREQUENCY,))
    seen: list[int] = []
    monkeypatch.setattr(
        Envelope,
        'look_at',
        lambda self, t_ns, rows, look=Envelope.look_at: (seen.extend(t_ns // simulation.h_ns), look(self, t_ns, rows)),
    )
    data = simulate(simulation, scene.steps, directory=tmp_path / 'bag' if recorded else None)
    assert seen == [*range(5, 1501, 5)]
    (found,) = data['findings']
    assert found['where'] == 'frequency'
    assert found['value'] == pytest.approx(10.0, rel=0.02)


def test_what_has_no_range_is_looked_at_fifty_times_a_second() -> None:
    """How a car leans, and what its tires carry; of a mechanism there is nothing to see."""
    watch = Envelope(solver.simulation_of(solver.load_scene('light_car_step_steer')))
    assert [watch.every(h) for h in (1_000_000, 4_000_000, 20_000_000)] == [20, 5, 1]
    assert Envelope(solver.simulation_of(solver.load_scene('pendulum'))).every(1_000_000) == 0
