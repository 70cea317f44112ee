"""Vehicles actuated otherwise: torques of single wheels, a torque at the steering wheel, an angle of the road wheels,
actuators."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import solver
from mbd_sim_ros import batch
from mbd_sim_ros.bags.inputs import content, inputs_of
from mbd_sim_ros.commands.main import main
from solver.analysis.kinematics_and_compliance import Rig
from solver.errors import SceneError
from solver.files.scene import load_scene
from solver.inputs.actuation import Actuation
from solver.inputs.signals import Constant
from solver.levels.road_wheel import steering_map, steering_wheel_at
from solver.vehicle.actuation import actuated

LIGHT = 'light_car_straight'


def simulation(*overrides: str, scene: str = LIGHT):
    return solver.simulation_of(load_scene(scene, overrides))


def held(sim, **values: float) -> np.ndarray:
    """(nu,) inputs."""
    assert set(values) <= set(sim.channels.inputs)
    return np.array([values.get(name, 0.0) for name in sim.channels.inputs])


def motion(snapshot) -> np.ndarray:
    return np.concatenate([snapshot.pose.ravel(), snapshot.twist.ravel()])


def test_what_is_off_is_not_there():
    plain, same = load_scene(LIGHT).model, load_scene(LIGHT, ['actuation.actuators.brake_torque.lag=0.1']).model
    assert plain == same
    wheels = load_scene(LIGHT, ['actuation.wheels=true']).model
    assert wheels.inputs[: len(plain.inputs)] == plain.inputs
    assert set(wheels.inputs[len(plain.inputs) :]) == {
        f'{kind}_torque_{t.name}' for t in plain.tires for kind in ('drive', 'brake')
    }


def test_shares_of_the_sum_are_torques_of_the_wheels():
    """Braked by the shares one by one, the car moves as braked by the sum: the same capacities, bit for bit; so does
    the driven one."""
    both = simulation('actuation.wheels=true')
    shares = {b.name.removeprefix('brake_'): b.gain for b in both.model.spec.brakes}
    braked = both.advance(100, held(both, brake_torque=1500.0)).numbers.copy()
    both.reset()
    one_by_one = both.advance(
        100, held(both, **{f'brake_torque_{wheel}': share * 1500.0 for wheel, share in shares.items()})
    )
    at = [i for i, name in enumerate(both.channels.inputs) if name.startswith('brake')]
    assert one_by_one.inputs[at].sum() == pytest.approx(1500.0)
    both.reset()
    again = both.advance(100, held(both, brake_torque=1500.0))
    assert again.numbers.tobytes() == braked.tobytes()
    assert motion(one_by_one).tobytes() == motion(again).tobytes()
    both.reset()
    driven = motion(both.advance(100, held(both, drive_torque=400.0)))
    both.reset()
    halves = motion(both.advance(100, held(both, drive_torque_front_left=200.0, drive_torque_front_right=200.0)))
    np.testing.assert_allclose(halves, driven, atol=1e-10)


def test_a_brake_of_a_wheel_takes_from_its_share():
    """A valve that takes all of its share away: the wheel rolls on freely; the others brake. Never below zero."""
    sim = simulation('actuation.wheels=true')
    snapshot = sim.advance(200, held(sim, brake_torque=4000.0, brake_torque_front_left=-4000.0))
    torque = {w: snapshot.elements[sim.channels.elements.index(f'brake_{w}/torque')] for w in sim.channels.wheels}
    assert torque['front_left'] == 0.0
    assert all(torque[w] < -100.0 for w in ('front_right', 'rear_left', 'rear_right'))


def test_torques_of_a_differential_yaw_the_car():
    """Torque vectoring: 300 N m forth at the right, back at the left, turn the car to the left with 2 M/r * half the
    track about."""
    sim = simulation('actuation.wheels=true')
    snapshot = sim.advance(300, held(sim, drive_torque_rear_left=-300.0, drive_torque_rear_right=300.0))
    assert snapshot.twist[sim.channels.chassis, 5] > 0.01
    assert abs(snapshot.twist[sim.channels.chassis, 0] - 25.0) < 0.2


def test_a_wheel_is_driven_at_its_own_shaft_whatever_else_is_called_alike():
    """Axles mid_rear, which is driven, and rear, which is not: rear has motors in its hubs."""
    named = {'front': 'mid_rear', 'rear': 'rear'}
    model = load_scene(LIGHT).model

    def other(name):
        return name.replace('front_', 'mid_rear_')

    forces = [f for f in model.coordinate_forces if f.input == 'drive_torque']
    assert forces and all('front_' in name for f in forces for name, _ in f.terms)
    model = dataclasses.replace(
        model,
        tires=tuple(dataclasses.replace(t, name=other(t.name)) for t in model.tires),
        brakes=tuple(dataclasses.replace(b, coordinate=other(b.coordinate)) for b in model.brakes),
        coordinate_forces=tuple(dataclasses.replace(f, terms=tuple((other(n), x) for n, x in f.terms)) for f in forces),
    )
    drives = {
        f.name: f.terms[0][0]
        for f in actuated(model, Actuation(wheels=True)).coordinate_forces
        if f.name.startswith('drive_')
    }
    assert drives == {
        f'drive_{axle}_{side}': f'{"shaft" if axle == "mid_rear" else "wheel"}_{axle}_{side}'
        for axle in named.values()
        for side in ('left', 'right')
    }


def test_the_torque_of_a_driven_wheel_ends_at_the_top_speed_of_its_drive():
    """On ice, with 1000 N m at either wheel in front: they spin up to the limiter of the car, not beyond. Hub motors
    behind have none."""
    overrides = ('actuation.wheels=true', 'road={friction: 0.1}', 'start.speed=5', 'maneuver={}')
    sim = simulation(*overrides)
    top = {f.name: f.top_rate for f in sim.model.spec.coordinate_forces if f.name.startswith('drive_')}
    limit = next(f.top_rate for f in sim.model.spec.coordinate_forces if f.input == 'drive_torque')
    assert top == {
        'drive_front_left': limit,
        'drive_front_right': limit,
        'drive_rear_left': None,
        'drive_rear_right': None,
    }
    snapshot = sim.advance(
        round(1.5 / sim.h), held(sim, drive_torque_front_left=1000.0, drive_torque_front_right=1000.0)
    )
    spins = snapshot.joint_velocity[[sim.channels.joints.index(f'wheel_front_{side}') for side in ('left', 'right')]]
    assert np.all(np.abs(spins) > 0.9 * limit) and np.all(np.abs(spins) < 1.01 * limit)


def test_the_hand_torque_steers_like_the_hand():
    """The torque that an imposed angle took, given as a torque, moves the wheel along that angle: same law, solved for
    the other side.

    Both runs are of second order, and the torque is held over steps: their difference falls with the step.
    """
    apart = []
    for h in (2e-3, 1e-3):
        steer = '{steering: {kind: step, value: 0.3, start: 0.1, rise: 0.4}}'
        angle = simulation(f'maneuver={steer}', f'integrator.h={h}', 'integrator.iterations=3')
        place = angle.channels.joints.index('steering_wheel')
        torques, angles = [], []
        for _ in range(round(0.4 / h)):
            snapshot = angle.advance()
            torques.append(snapshot.joint_effort[place])
            angles.append(snapshot.joint_position[place])
        torque = simulation('actuation.steering=torque', 'maneuver={}', f'integrator.h={h}', 'integrator.iterations=3')
        found = []
        before = 0.0
        for now in torques:
            found.append(torque.advance(1, held(torque, steering_torque=0.5 * (before + now))).joint_position[place])
            before = now
        apart.append(np.max(np.abs(np.subtract(found, angles))))
    assert apart[1] < 0.01 * 0.3
    assert apart[1] < 0.6 * apart[0]


@pytest.mark.slow
def test_road_wheels_stand_where_they_are_commanded():
    """Between the nodes of the map, too: the bench steered by the mapped angle finds the road wheels there, to a ten
    thousandth."""
    model = load_scene('car_step_steer').model
    road = steering_map(model)
    wanted = np.array([-0.31, -0.05, 0.003, 0.12, 0.4])
    curves = Rig(model).steering([steering_wheel_at(road, x) for x in wanted.tolist()])
    found = 0.5 * (curves['front_left']['steer'] + curves['front_right']['steer'])
    np.testing.assert_allclose(found, wanted, atol=1e-4 * 0.4)


def test_a_maneuver_may_command_the_road_wheels():
    sim = simulation('maneuver={road_wheel: {kind: step, value: 0.03, start: 0.0, rise: 0.1}}')
    assert sim.scene.maneuver.road_wheel == Constant()
    snapshot = sim.advance(200)
    ratio = snapshot.inputs[sim.channels.inputs.index('steering')] / 0.03
    assert ratio == pytest.approx(steering_wheel_at(steering_map(sim.scene.model), 0.03) / 0.03, rel=1e-12)
    assert snapshot.twist[sim.channels.chassis, 5] > 0.1


@pytest.mark.parametrize(
    ('overrides', 'says'),
    [
        (['maneuver={road_wheel: 2.0}'], 'is beyond the steering.*if it is in deg'),
        (['maneuver={road_wheel: 0.1, steering: 0.1}'], 'something else steers too'),
        (['actuation.steering=torque', 'maneuver={steering: 1.0}'], "did you mean 'steering_torque'"),
        (['actuation.actuators.brakes={lag: 0.1}'], 'the model has no such input'),
        (['actuation.wheels=true', 'fidelity=single_track'], 'no single wheels'),
        (['actuation.wheels=true', 'fidelity=kc'], 'beyond this level'),
    ],
)
def test_what_cannot_be_is_one_sentence(overrides, says):
    with pytest.raises(SceneError, match=says) as error:
        simulation(*overrides)
    assert '\n' not in str(error.value)


ACTUATED = ['actuation.actuators={steering: {lag: 0.05, dead_time: 0.01}, brake_torque: {lag: 0.1, rate_limit: 1.0e4}}']
BRAKED = (
    'maneuver={steering: {kind: sine, amplitude: 0.2, frequency: 1.0}, brake_torque: {kind: step, value: 2000, '
    'start: 0.05, rise: 0.01}}'
)


def test_actuators_stand_between_maneuver_and_inputs_and_are_saved():
    sim = simulation(*ACTUATED, BRAKED)
    name = sim.channels.inputs.index('brake_torque')
    applied = [sim.advance().inputs[name] for _ in range(150)]
    assert 0.0 < applied[100] < 1999.0 and np.all(np.diff(applied) >= 0.0)
    assert np.max(np.diff(applied)) <= 1.0e4 * sim.h * (1 + 1e-9)
    saved = sim.save()
    expected = sim.advance(50).numbers
    sim.restore(saved)
    assert sim.advance(50).numbers.tobytes() == expected.tobytes()
    sim.reset()
    assert [sim.advance().inputs[name] for _ in range(150)] == applied


@pytest.mark.slow
def test_what_was_applied_behind_actuators_is_recorded_and_replays(tmp_path, capsys):
    scene = load_scene(LIGHT, [*ACTUATED, BRAKED, 'actuation.wheels=true', 'duration=0.3'])
    sim = solver.simulation_of(scene)
    batch.simulate(sim, scene.steps, directory=tmp_path / 'r')
    rows = inputs_of(content(tmp_path / 'r')).rows
    assert 0.0 < rows['brake_torque'][100] < 1999.0
    capsys.readouterr()
    assert main(['replay', str(tmp_path / 'r')]) == 0
    assert 'identical' in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize('level', ['full', 'condensed'])
def test_the_full_car_has_torques_of_single_wheels_too(level):
    """Driven at the outputs of its differential behind, by motors in the hubs in front; braked one by one."""
    sim = simulation('actuation.wheels=true', f'fidelity={level}', scene='car_step_steer')
    snapshot = sim.advance(100, held(sim, drive_torque_rear_left=-200.0, drive_torque_rear_right=200.0))
    yaw = snapshot.twist[sim.channels.chassis, 5]
    assert yaw > 1e-3
    sim.reset()
    snapshot = sim.advance(100, held(sim, drive_torque_front_left=-200.0, drive_torque_front_right=200.0))
    assert snapshot.twist[sim.channels.chassis, 5] > 1e-3
    sim.reset()
    snapshot = sim.advance(100, held(sim, brake_torque_front_right=300.0))
    assert snapshot.twist[sim.channels.chassis, 5] < -1e-3
