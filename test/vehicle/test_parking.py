"""Parking: a standing car is steered, and what resists is the moment against turning on the spot, which needs not be
asked for."""

from __future__ import annotations

import numpy as np
import pytest

import solver
from solver.elements.tire_pacejka import TIRE_COLUMNS, TIRES
from solver.files.scene import load_scene
from solver.simulation import Simulation

MZ = TIRE_COLUMNS.index('mz')
SPEED = 10.0  # m/s


def car(name: str, *overrides: str, speed: float, maneuver: str) -> Simulation:
    given = [f'start={{kind: equilibrium, speed: {speed}}}', f'maneuver={maneuver}', *overrides]
    simulation = solver.simulation_of(load_scene(name, given))
    assert isinstance(simulation, Simulation)
    return simulation


@pytest.mark.slow
@pytest.mark.parametrize('brake_torque', [0, 2000])
def test_rack_force_of_a_standing_car(brake_torque: int) -> None:
    """200 degrees of steering wheel to each side in 4 s, brakes released and held: the saloon asks for 3.5 to 8 kN at
    the rack, as real ones do, without turn slip for what its weight on inclined axes makes. It stays where it is, and
    its energy account closes."""
    peak = {}
    for turn_slip in ('on', 'off'):
        swing = f'{{steering: {{kind: sine, amplitude: 3.4907, frequency: 0.25}}, brake_torque: {brake_torque}}}'
        s = car('car_step_steer', f'switches.turn_slip={turn_slip}', 'integrator.h=2e-3', speed=0.0, maneuver=swing)
        rack = s.channels.joints.index('rack')
        peak[turn_slip] = max(abs(float(s.advance(20).joint_effort[rack])) for _ in range(100))  # of mesh and motor
        pose = s.snapshot().pose[s.channels.chassis or 0]
        assert abs(2.0 * pose[5]) < 0.005  # heading [rad]
        assert s.totals()['energy_error_max'] < 0.05
        assert s.snapshot().counters.stagnated == 0
    assert 3500.0 < peak['on'] < 8000.0
    assert peak['off'] < 600.0


@pytest.mark.parametrize('level', ['condensed', 'kc'])
def test_levels_carry_it(level: str) -> None:
    """The front tires of a standing saloon resist, those of one without turn slip do not."""
    turn = '{steering: {kind: step, value: 3.0, start: 0.0, rise: 0.5}}'
    moment = []
    for turn_slip in ('on', 'off'):
        s = car('car_step_steer', f'fidelity={level}', f'switches.turn_slip={turn_slip}', speed=0.0, maneuver=turn)
        moment.append(np.abs(s.advance(round(0.6 / s.h)).tire[:2, MZ]))
    assert moment[0].min() > 100.0
    assert moment[1].max() < 5.0


@pytest.mark.parametrize('scene', ['light_car_step_steer', pytest.param('car_step_steer', marks=pytest.mark.slow)])
def test_a_rolling_car_has_the_bits_of_one_without(scene: str) -> None:
    """From the start at 10 m/s on, in a slalom: places, velocities, tires; it has a state of each tire more, which
    stays 0."""
    slalom = '{steering: {kind: sine, amplitude: 1.0, frequency: 1.0}}'
    on, off = (car(scene, f'switches.turn_slip={given}', speed=SPEED, maneuver=slalom) for given in ('on', 'off'))
    assert on.describe()['internal_states'] == off.describe()['internal_states'] + 4
    for _ in range(20):
        a, b = on.advance(20), off.advance(20)
        for name in ('pose', 'twist', 'tire', 'elements', 'joint_position'):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    table = on.model.elements[TIRES.name].value
    assert table.states.tolist() == [4] * 4
    assert not on.state.z[table.state + 2].any()


def test_a_standing_car_starts_without_twist() -> None:
    """The equilibrium of a car that stands with its wheels turned is that of one without the moment, and it stays in
    it."""
    held = '{steering: 2.0, brake_torque: 500}'
    on, off = (
        car('light_car_step_steer', f'switches.turn_slip={given}', speed=0.0, maneuver=held) for given in ('on', 'off')
    )
    np.testing.assert_array_equal(on.state.q, off.state.q)
    before = on.snapshot().pose.copy()
    assert np.abs(on.snapshot().tire[:, MZ] - off.snapshot().tire[:, MZ]).max() == 0.0
    assert np.abs(on.advance(1000).pose - before).max() < 1e-6


def test_a_car_that_comes_to_rest_in_a_bend() -> None:
    """Braked to a standstill while it turns, through the fade: it stays where it stops, and the account of its energy
    closes."""
    bend = '{steering: 3.0, brake_torque: {kind: step, value: 1500, start: 0.2, rise: 0.3}}'
    s = car('light_car_brake', speed=7.0, maneuver=bend)
    s.advance(round(8.0 / s.h))
    shot = s.snapshot()
    assert np.abs(shot.twist).max() < 1e-3
    assert shot.counters.stagnated == 0
    assert s.totals()['energy_error_max'] < 1.0
