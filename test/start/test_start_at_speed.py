"""A vehicle at speed: where it starts and on which course belongs to its placement, not to the integrator, the road or
who steers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solver import simulation_of
from solver.analysis.verdict import findings
from solver.elements.tire_pacejka import TIRES
from solver.errors import ConsistencyError
from solver.files.scene import load_scene
from solver.model.state import State
from solver.simulation import Simulation
from solver.start.rolling import turn_over_road


@pytest.mark.slow
@pytest.mark.parametrize('setting', ['rho_inf=0', 'augmentation=plain', 'mode=tolerance', 'h=0.0025', 'iterations=1'])
def test_settings_of_the_integrator_do_not_move_the_start(setting: str) -> None:
    """Places to the bit, velocities as the scheme wants them at its step: methods that are compared begin in the same
    state."""
    usual, other = (
        Simulation(load_scene('car_swept_steer', list(chosen))).state for chosen in ((), (f'integrator.{setting}',))
    )
    np.testing.assert_array_equal(other.q, usual.q)
    np.testing.assert_array_equal(other.z, usual.z)
    np.testing.assert_allclose(other.v, usual.v, rtol=0, atol=1e-3)


@pytest.mark.parametrize('change', ['road={normal: [0, 0.1, 1]}', 'maneuver={steering: 0.5}'])
def test_it_starts_on_the_course_it_was_placed_on(change: str) -> None:
    """On a bank of 10 % and with its wheels turned: along x within its sideslip while it settles, at its speed, already
    in its bend."""
    car = Simulation(load_scene('light_car_straight', ['maneuver={}', change]))
    chassis = car.state.q[car.channels.chassis]
    assert abs(Rotation.from_quat(chassis[3:]).as_euler('zyx')[0]) < 1e-3
    v = car.state.v[car.channels.chassis]
    assert v[0] == pytest.approx(car.scene.start.speed, rel=1e-3)
    turns = v[5]
    assert turns > 0.01
    car.advance(200)
    assert car.state.v[car.channels.chassis, 5] == pytest.approx(turns, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize('change', ['maneuver={steering: 1}', 'road={normal: [0, 0.2, 1]}'])
def test_in_a_bend_guided_wheels_start_without_a_blow(change: str) -> None:
    """Guides hold a wheel by springs of up to 3 kHz: 1e-5 rad from where it settles are 3500 rad/s^2, and steps of 5 ms
    left 4e-5 rad.

    The body turns steadily there, and the wheels with it: in their axes, which spin, by no more than spin times yaw
    rate.
    """
    for vehicle in ('light_car', 'compact_fwd'):
        chosen = [
            f'vehicle=vehicles/{vehicle}.yaml',
            'start={kind: equilibrium, speed: 20}',
            'maneuver={}',
            change,
            'fidelity=kc',
        ]
        car = simulation_of(load_scene('light_car_straight', chosen))
        car.advance(1)
        spins = np.abs(car.state.v[:-1, 4]).max()
        yaws = np.abs(car.state.v[car.channels.chassis, 3:]).max()
        assert np.abs(car.state.a[:-1, 3:]).max() < 2.0 * spins * yaws + 10.0
        car.advance(200)
        assert findings(car) == []


@pytest.mark.parametrize('rate', [0.0, 20.0])
def test_a_wheel_whose_rate_is_wanted_does_not_roll(rate: float) -> None:
    """A locked one and one that slips; its knuckle does not turn with it, and the other wheels roll at 10 m/s over
    about 0.31 m."""
    start = f'start={{kind: assemble, speed: 10, coordinates: {{wheel_front_right: {{rate: {rate}}}}}}}'
    car = Simulation(load_scene('light_car_straight', ['maneuver={}', start]))
    rates = dict(zip(car.channels.joints, car.snapshot().joint_velocity.tolist(), strict=True))
    assert rates['wheel_front_right'] == pytest.approx(rate, abs=1e-9)
    others = [rates[f'wheel_{corner}'] for corner in ('front_left', 'rear_left', 'rear_right')]
    assert others == pytest.approx([10.0 / 0.31] * 3, rel=0.02)
    knuckle = car.model.body_names.index('knuckle_front_right')
    assert np.abs(car.state.v[knuckle, 3:]).max() < 1e-3


def test_a_rate_that_would_be_lost_in_settling_is_refused() -> None:
    start = 'start={kind: equilibrium, speed: 10, coordinates: {wheel_front_right: {rate: 20}}}'
    with pytest.raises(
        ConsistencyError, match=r'start\.coordinates\.wheel_front_right\.rate: .* set start.kind: assemble'
    ):
        Simulation(load_scene('light_car_straight', ['maneuver={}', start]))


def test_a_torque_at_the_steering_wheel_acts_from_the_start_on() -> None:
    """Before, the wheel is free and stands straight; then it turns as the torque accelerates its inertia, within a
    step, or slower."""
    given = ['actuation.steering=torque', 'maneuver={signals: {steering_torque: 5}}', 'start.speed_kmh=80']
    car = Simulation(load_scene('light_car_straight', given))
    wheel = car.channels.joints.index('steering_wheel')
    assert abs(car.snapshot().joint_position[wheel]) < 1e-6
    inertia = next(b for b in car.model.spec.bodies if b.name == 'steering_wheel').inertia[2]
    t = 0.04
    turned = car.advance(round(t / car.h)).joint_position[wheel]
    assert 0.05 < turned < 0.5 * 5.0 / inertia * (t + car.h) ** 2


@pytest.mark.parametrize('speed', [0.5, 2.0, 8.0])
def test_a_drive_that_spins_the_wheels_acts_from_the_start_on(speed: float) -> None:
    """8000 N m at two wheels that hold some 3000: before, all roll; 0.1 s later these have spun up, by less than
    without the road."""
    given = [f'start.speed={speed}', 'maneuver={drive_torque: 8000}', 'integrator.h=0.001']
    car = Simulation(load_scene('light_car_straight', given))
    wheels = [car.model.body_names.index(tire.marker.body) for tire in car.model.spec.tires]
    rates = np.linalg.norm(car.state.v[wheels, 3:], axis=1)
    np.testing.assert_allclose(rates, speed / 0.31, rtol=0.05)
    car.advance(100)
    later = np.linalg.norm(car.state.v[wheels, 3:], axis=1)
    inertia = min(car.model.spec.bodies[wheel].inertia[1] for wheel in wheels)
    assert 1.5 * np.max(rates) < np.max(later) < np.max(rates) + 4000.0 / inertia * 0.1


@pytest.mark.slow
@pytest.mark.parametrize('friction', [0.008, 0.005, 0.001])
def test_a_car_stands_on_ice_with_its_wheels_turned(friction: float) -> None:
    """Tires slide on the way to where it rests, and hold next to nothing there; the search did not end."""
    car = Simulation(
        load_scene(
            'car_step_steer', [f'road.friction={friction}', 'maneuver={steering: 0.5}', 'start={kind: equilibrium}']
        )
    )
    columns = car.model.outputs('tires', car.outputs)
    loads, across = columns[:, TIRES.column('fz')], columns[:, TIRES.column('fy')]
    weight = 9.81 * sum(body.mass for body in car.model.spec.bodies)
    assert np.sum(loads) == pytest.approx(weight, rel=1e-3)
    assert np.abs(across).max() < 1.2 * friction * loads.max()


def test_with_the_brakes_on_the_wheels_roll_at_the_start() -> None:
    """Brakes do not take along what carries the wheels while velocities are found, nor slow the wheels: kc did not
    begin as the whole car and was 0.11 m/s faster after 0.3 s."""
    found = []
    for level in ('full', 'kc'):
        given = [f'fidelity={level}', 'start.speed=15', 'maneuver={brake_torque: 3000}', 'integrator.h=0.001']
        car = simulation_of(load_scene('light_car_straight', given))
        found.append(float(car.advance(300).twist[car.channels.chassis or 0, 0]))
    assert found[1] == pytest.approx(found[0], abs=0.01)


@pytest.mark.slow
def test_brakes_that_stop_it_at_once_leave_a_start() -> None:
    """At 0.3 m/s full brakes end the motion while it settles; it begins with its speed and stops."""
    car = Simulation(
        load_scene('car_step_steer', ['start={kind: equilibrium, speed: 0.3}', 'maneuver={brake_torque: 5000}'])
    )
    chassis = car.channels.chassis
    assert car.state.v[chassis, 0] == pytest.approx(0.3, rel=0.01)
    car.advance(2000)
    assert abs(car.state.v[chassis, 0]) < 0.02


def test_a_vehicle_is_turned_back_to_its_course_with_its_motion() -> None:
    """By hand, on the level: from north-west to north-east, which is 90 degrees to the right about the chassis at (1,
    2); then about an oblique normal, by what Rotation makes of the same turn."""
    s = np.sqrt(0.5)
    chassis, wheel = (
        (1.0, 2.0, 0.5, *Rotation.from_euler('z', 135, degrees=True).as_quat()),
        (1.0, 5.0, 0.25, 0.0, 0.0, 0.0, 1.0),
    )
    state = State(
        np.array([chassis, wheel, (9.0,) * 7]),
        *(np.tile([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], (3, 1)) for _ in range(4)),
        *np.zeros((5, 0)),
    )
    turn_over_road(state, 0, np.array([0.0, 0.0, 1.0]), np.array([s, s, 0.0]))
    np.testing.assert_allclose(
        state.q[0], (1.0, 2.0, 0.5, *Rotation.from_euler('z', 45, degrees=True).as_quat()), rtol=0, atol=1e-14
    )
    np.testing.assert_allclose(state.q[1], (4.0, 2.0, 0.25, 0.0, 0.0, -s, s), rtol=0, atol=1e-14)
    for rates in (state.v, state.a, state.a_stage, state.a_stage_before):
        # turns in the axes of the bodies
        np.testing.assert_allclose(rates[:2], [[2.0, -1.0, 3.0, 4.0, 5.0, 6.0]] * 2, rtol=0, atol=1e-14)
        np.testing.assert_array_equal(rates[2], [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    np.testing.assert_array_equal(state.q[2], 9.0)  # the world stays

    n = np.array([0.1, -0.2, 1.0]) / np.sqrt(1.05)
    before = state.q[:2].copy()
    turn_over_road(state, 0, n, np.array([0.0, 1.0, 0.0]))
    ahead = Rotation.from_quat(state.q[0, 3:]).apply([1.0, 0.0, 0.0])
    assert np.cross(ahead, [0.0, 1.0, 0.0]) @ n == pytest.approx(0.0, abs=1e-14) and ahead[1] > 0.0
    R = Rotation.from_quat(state.q[0, 3:]) * Rotation.from_quat(before[0, 3:]).inv()
    np.testing.assert_allclose(R.apply(n), n, rtol=0, atol=1e-14)
    np.testing.assert_allclose(
        R.apply(before[1, :3] - before[0, :3]), state.q[1, :3] - state.q[0, :3], rtol=0, atol=1e-14
    )
    np.testing.assert_allclose(
        (R * Rotation.from_quat(before[1, 3:])).as_matrix(), Rotation.from_quat(state.q[1, 3:]).as_matrix(), atol=1e-14
    )
    np.testing.assert_allclose(state.v[1, :3], R.apply([2.0, -1.0, 3.0]), rtol=0, atol=1e-14)


TURNING = 'maneuver={steering: {kind: sine, amplitude: 0.5, frequency: 0.5, start: 0.0}}'


@pytest.mark.parametrize('fidelity', ['full', 'kc'])
@pytest.mark.parametrize('speed', [0.0, 25.0])
def test_wheels_are_steered_from_the_start_on_where_the_steering_wheel_turns_already(
    fidelity: str, speed: float
) -> None:
    """By the ratio of the steering over the rate of the hand, at every level; guided wheels stood, and vibrated from
    the first step on."""
    settings = [f'fidelity={fidelity}', f'start.speed={speed}', 'duration=0.2']
    moving, still = (
        simulation_of(load_scene('light_car_straight', [*settings, m]))
        for m in (TURNING, 'maneuver={steering: 0.01307}')
    )
    wheel = moving.model.body_names.index('wheel_front_left')

    def turning(car: Simulation, body: int) -> float:
        return float(Rotation.from_quat(car.state.q[body, 3:]).apply(car.state.v[body, 3:])[2])

    turns = [turning(car, wheel) - turning(car, car.channels.chassis) for car in (moving, still)]
    hand = float(moving.snapshot().inputs[moving.channels.inputs.index('steering_rate')])
    # half of the amplitude of the rate: it begins in the middle of its blend
    assert hand == pytest.approx(0.25 * np.pi, rel=1e-3)
    slope = (turns[0] - turns[1]) / hand
    assert 1.0 / 25.0 < slope < 1.0 / 12.0  # over the ratio of the steering of this car, 15 to 20
    moving.advance(200, audit=True)
    assert not findings(moving)


@pytest.mark.slow
@pytest.mark.parametrize(('car', 'fidelity'), [('full_car', 'kc'), ('compact_fwd', 'full'), ('compact_fwd', 'kc')])
def test_what_hangs_on_the_steering_by_rubber_or_by_a_torsion_bar_starts_with_it(car: str, fidelity: str) -> None:
    settings = [f'vehicle=vehicles/{car}.yaml', f'fidelity={fidelity}', 'duration=0.2', TURNING]
    moving = simulation_of(load_scene('light_car_straight', settings))
    moving.advance(200, audit=True)
    assert not findings(moving)
