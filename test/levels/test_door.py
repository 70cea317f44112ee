"""The one door to levels and switches: what a scene may ask for, and that nothing simulates another model than is asked
for."""

from __future__ import annotations

import dataclasses

import pytest

import solver
from solver.errors import SceneError, SpecError
from solver.files.scene import load_scene, load_scene_text
from solver.findings import Limit
from solver.levels import LEVELS, derive
from solver.levels.derived import channels
from solver.scene import SUBSYSTEMS
from solver.simulation import Simulation


def test_a_scene_without_the_keys_is_simulated_as_it_is_given() -> None:
    scene = load_scene('light_car_straight')
    assert scene.fidelity == 'full'
    assert not scene.reduced
    simulation = solver.simulation_of(scene)
    assert simulation.scene is scene
    assert simulation.level is None


def test_subsystems_that_are_on_change_nothing() -> None:
    scene = load_scene('light_car_straight', [f'switches.{name}=on' for name in SUBSYSTEMS])
    assert solver.simulation_of(scene).scene is scene


@pytest.mark.parametrize(
    ('setting', 'sentence'),
    [
        ('fidelity=coarse', 'fidelity'),
        ('switches.engine_mount=off', "switches = 'engine_mount': no such subsystem; did you mean 'engine_mounts'"),
        ('switches.drag=maybe', 'switches.drag'),
    ],
)
def test_what_is_no_level_and_no_switch_is_refused_with_its_place(setting: str, sentence: str) -> None:
    with pytest.raises(SceneError, match=r'one of the choices|no such subsystem') as refused:
        load_scene('light_car_straight', [setting])
    assert sentence in str(refused.value)
    assert '\n' not in str(refused.value)


@pytest.mark.parametrize(
    ('setting', 'key'),
    [('fidelity=condensed', 'fidelity'), ('switches.drag=off', 'switches'), ('fidelity=auto', 'fidelity')],
)
def test_a_mechanism_has_no_levels(setting: str, key: str) -> None:
    with pytest.raises(SceneError, match='only a vehicle has') as refused:
        load_scene('slider_crank', [setting])
    assert key in str(refused.value)


def test_the_resolved_text_keeps_level_and_switches() -> None:
    scene = load_scene('light_car_straight', ['fidelity=kc', 'switches.drag=off'])
    again = load_scene_text(scene.resolved)
    assert (again.fidelity, again.switches) == ('kc', {'drag': 'off'})
    assert scene.reduced


def test_a_simulation_refuses_to_be_made_past_the_door() -> None:
    """Otherwise it would silently be the full vehicle."""
    with pytest.raises(SpecError, match='use simulation_of'):
        Simulation(load_scene('light_car_straight', ['fidelity=condensed']))


def test_a_steering_wheel_that_turns_freely_is_beyond_the_level_kc() -> None:
    """Its bench would let go of the wheels, and blame springs and tires that it finds no equilibrium."""
    scene = load_scene('light_car_step_steer', ['fidelity=kc', 'actuation={steering: torque}', 'maneuver={}'])
    with pytest.raises(SceneError, match=r"fidelity = 'kc': actuation.steering is torque, .* use condensed or full"):
        derive(scene)


def test_auto_needs_a_plan() -> None:
    with pytest.raises(SceneError, match='no plan of this scene'):
        derive(load_scene('light_car_straight', ['fidelity=auto']))


@pytest.mark.slow
def test_every_level_of_the_key_has_a_module() -> None:
    for level in LEVELS:
        scene = load_scene('light_car_straight', [f'fidelity={level}'])
        derived = derive(scene)
        assert derived.level == level
        assert derived.scene.fidelity == 'full'
        assert derived.scene.resolved == scene.resolved


def test_channels_name_what_a_model_publishes() -> None:
    model = load_scene('light_car_straight').model
    found = channels(model)
    assert len(set(found)) == len(found)
    assert {
        'joint travel_front_left',
        'joint rack',
        'body chassis',
        'wheel rear_right',
        'element brake_front_left',
    } <= set(found)
    less = dataclasses.replace(model, aero_drags=())
    assert set(found) - set(channels(less)) == {f'element {spec.name}' for spec in model.aero_drags}


@pytest.mark.parametrize(
    ('setting', 'said'),
    [
        ('switches.drag=off', False),
        ('switches.engine_mounts=off', True),
        ('fidelity=condensed', True),
        pytest.param('fidelity=kc', True, marks=pytest.mark.slow),
        # at the centre of mass of the chassis alone
        pytest.param('fidelity=single_track', False, marks=pytest.mark.slow),
    ],
)
def test_an_imu_that_stands_elsewhere_is_told(setting: str, said: bool) -> None:
    """Accelerations are those of the centre of mass of the chassis, which moves by what becomes a part of it, the
    engine above all: its 215 kg stand 1.3 m ahead of it."""
    scene = load_scene('car_step_steer', [setting])
    derived = derive(scene)
    one, other = (next(b for b in model.bodies if b.name == 'chassis') for model in (scene.model, derived.scene.model))
    (found,) = [text for text in derived.report.lost if text.startswith('imu')] or ['']
    assert bool(found) == said == (other.com[0] > one.com[0] + 5e-3)
    if said:
        assert f'({1e3 * (other.com[0] - one.com[0]):.0f}, ' in found


def test_a_limit_reads_as_a_sentence() -> None:
    assert (
        str(Limit(quantity='frequency', unit='Hz', high=15.0, why='links have no mass'))
        == 'frequency <= 15 Hz: links have no mass'
    )
