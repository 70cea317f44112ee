"""Electric power steering: what the hand feels, what the motor supplies, and friction in the gear."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import scipy.linalg

from solver.elements.coupler import CouplerSpec
from solver.elements.joint import JointSpec
from solver.elements.marker import WORLD, Marker
from solver.elements.rigid_body import RigidBodySpec
from solver.elements.servo import ServoSpec
from solver.errors import MbdError
from solver.files.scene import load_scene, load_scene_text
from solver.levels.condensed import condensed
from solver.model.spec import ModelSpec
from solver.scene import Scene
from solver.simulation import Simulation
from solver.step.settings import IntegratorSettings

ALONG_Y = (-np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))
SPEED = 22.0
# stiffness that acts at that speed [N m/rad]
WHOLE = {'full_car': 288.0, 'compact_fwd': 160.0, 'electric_4wd': 288.0, 'pickup_awd': 330.0}
TRAVEL = {
    'full_car': 0.0455,
    'compact_fwd': 0.048,
    'electric_4wd': 0.0445,
    'pickup_awd': 0.052,
}  # travel of the rack per turn of the pinion [m]

ASSIST = (  # that of electric_4wd
    '{speeds_kmh: [0, 30, 80, 150], torques: [2, 5, 6, 8], forces: [[800, 5000, 7000, 10000], [600, 2000, 2900, '
    '6000], [503, 1257, 1508, 2500], [360, 900, 1080, 1700]], limit: 11000, lag: 0.003}'
)


def test_a_helped_mass_moves_as_the_linear_equations_have_it():
    """m x'' = 2 T + z, T = -2 k x - 2 c x', lag z' = g T - z, from x = -50 mm: to second order."""
    m, k, c, gain, lag = 3.0, 200.0, 2.0, 5.0, 0.02
    A = np.array(
        [
            [0.0, 1.0, 0.0],
            [-4.0 * k / m, -4.0 * c / m, 1.0 / m],
            [-2.0 * gain * k / lag, -2.0 * gain * c / lag, -1.0 / lag],
        ]
    )
    expected = scipy.linalg.expm(0.2 * A) @ [-0.05, 0.0, 0.0]
    bodies = (
        RigidBodySpec(name='rack', mass=m, inertia=(1.0, 1.0, 1.0, 0.0, 0.0, 0.0), position=(0.0, -0.05, 0.0)),
        RigidBodySpec(name='wheel', mass=1.0, inertia=(1.0, 1.0, 1.0, 0.0, 0.0, 0.0)),
    )
    along = {'orientation': ALONG_Y}
    joints = (
        JointSpec(name='rack', kind='prismatic', i=Marker(body=WORLD, **along), j=Marker(body='rack', **along)),
        JointSpec(name='wheel', kind='revolute', i=Marker(body=WORLD), j=Marker(body='wheel')),
    )
    servo = ServoSpec(
        name='motor', terms=(('rack', -2.0), ('wheel', 1.0)), stiffness=k, damping=c, marker=Marker(body='rack'),
        speeds=(0.0,),
        torques=(1.0,), forces=((gain,),), limit=1e4, lag=lag,
    )  # fmt: skip
    hold = CouplerSpec(name='hold', terms=(('wheel', 1.0),), offset=0.0)
    model = ModelSpec(bodies=bodies, joints=joints, couplers=(hold,), servos=(servo,), gravity=(0.0, 0.0, 0.0))
    errors = []
    for h in (2e-3, 1e-3):
        settings = IntegratorSettings(h=h, mode='tolerance', tolerance=1e-10, rho_inf=1.0)
        simulation = Simulation(Scene(name='helped', model=model, integrator=settings))
        shot = simulation.advance(round(0.2 / h))
        found = shot.joint_position[0], shot.joint_velocity[0], simulation.state.z[0]
        errors.append(np.abs((np.array(found) - expected) / expected))
    assert (errors[1] < 2e-3).all()
    assert (errors[1] < 0.3 * errors[0]).all()


def drive(
    name: str, *changes: str, steering: str = '{kind: ramp, slope: 0.15, start: 0.3, blend: 0.3}', h: float = 2e-3
) -> Simulation:
    text = f'vehicle: vehicles/{name}.yaml\nstart: {{kind: equilibrium, speed: {SPEED}}}\nintegrator: {{h: {h}}}\n'
    return Simulation(load_scene_text(text + f'maneuver: {{steering: {steering}, drive_torque: 200}}\n', name, changes))


def ramp(simulation: Simulation) -> np.ndarray:
    """(n, 3) of a slow ramp up to 4 m/s^2: lateral acceleration, hand torque, angle of the steering wheel."""
    k, chassis, rows = simulation.channels.joints.index('steering_wheel'), simulation.channels.chassis or 0, []
    for _ in range(200):
        shot = simulation.advance(10)
        rows.append(
            (np.hypot(*shot.twist[chassis, :2]) * shot.twist[chassis, 5], shot.joint_effort[k], shot.joint_position[k])
        )
        if rows[-1][0] > 4.0:
            break
    return np.array(rows)


@pytest.mark.slow
@pytest.mark.parametrize(
    'name',
    [
        'full_car',
        'compact_fwd',
        *(pytest.param(name, marks=pytest.mark.long) for name in ('electric_4wd', 'pickup_awd')),
    ],
)
def test_the_hand_feels_what_the_map_leaves_and_the_car_goes_where_it_went(name: str) -> None:
    """At 0.33 g the hand has 3 to 5 N m, and with the motor on the rack the whole torque of a car without help whose
    torsion bar is as much stiffer as help makes it; the steering wheel turns as far."""
    helped, whole = (
        ramp(drive(name)),
        ramp(drive(name, 'vehicle.steering.assist=null', f'vehicle.steering.stiffness={WHOLE[name]}')),
    )
    simulation = drive(name)
    (servo,) = simulation.model.spec.servos
    torque = np.interp(0.33 * 9.81, helped[:, 0], helped[:, 1])
    assert 3.0 < torque < 5.0
    force = np.interp(torque, (0.0, *servo.torques), (0.0, *servo.at_speed(SPEED).forces[0]))
    lever = TRAVEL[name] / (2.0 * np.pi)
    assert torque + lever * force == pytest.approx(np.interp(0.33 * 9.81, whole[:, 0], whole[:, 1]), rel=0.02)
    for a in (1.0, 2.0, 3.0):
        assert np.interp(a, helped[:, 0], helped[:, 2]) == pytest.approx(
            np.interp(a, whole[:, 0], whole[:, 2]), rel=2e-3
        )


def test_the_motor_supplies_and_the_account_of_energy_closes() -> None:
    """Into a bend: what the account has of the motor is the work of its force, and what is missing of all goes down
    with the square of the step."""
    missing = []
    for h in (1e-3, 5e-4):
        simulation = drive('electric_4wd', steering='{kind: sine, amplitude: 0.5, frequency: 0.5}', h=h)
        supplied, work, before, k = 0.0, 0.0, (0.0, 0.0), simulation.channels.joints.index('rack')
        (servo,) = simulation.model.spec.servos
        for _ in range(round(0.5 / h)):
            rack = simulation.advance(1).joint_position[k]
            _, dissipation, _, rate, *_, force = simulation.model.outputs('servos', simulation.outputs)[0]
            supplied += h * (servo.damping * rate * rate - dissipation)
            work += 0.5 * (force + before[0]) * (rack - before[1])
            before = force, rack
        assert work > 1.0
        assert supplied == pytest.approx(work, rel=0.01)
        missing.append(simulation.totals()['energy_error_max'])
    assert missing[1] < 0.3 * missing[0] < 0.01 * work


def test_friction_is_felt_against_the_motion_and_not_at_rest() -> None:
    """A slow sine about straight ahead without help: where the steering wheel turns, the hand has the friction times
    the radius of the pinion more than without, to either side; where it turns back, and the rack stands, nothing."""
    steering = '{kind: sine, amplitude: 0.3, frequency: 0.25}'
    found = []
    for friction in (0.0, 300.0):
        simulation = drive(
            'compact_fwd',
            'vehicle.steering.assist=null',
            'vehicle.steering.stiffness=2000',
            f'vehicle.steering.friction={friction}',
            steering=steering,
        )
        k = simulation.channels.joints.index('steering_wheel')
        found.append([simulation.advance(50).joint_effort[k] for _ in range(40)])
    more = np.subtract(found[1], found[0])
    lever = 300.0 * TRAVEL['compact_fwd'] / (2.0 * np.pi)
    assert more[19] == pytest.approx(-lever, rel=0.05)
    assert more[39] == pytest.approx(lever, rel=0.05)
    assert abs(more[9]) < 0.1 * lever


@pytest.mark.parametrize('name', ['compact_fwd', 'pickup_awd'])
def test_the_mesh_has_its_place_in_the_effort_of_its_coordinates(name: str) -> None:
    """Joint states of the pinion show the torque of the mesh, those of the rack that over its radius and the motor
    beside friction (a coordinate force, too)."""
    simulation = drive(name, 'vehicle.steering.friction=0')
    shot = simulation.advance(300)
    _, _, value, rate, force, _, motor = simulation.model.outputs('servos', simulation.outputs)[0]
    (servo,) = simulation.model.spec.servos
    effort = dict(zip(simulation.channels.joints, shot.joint_effort, strict=True))
    assert force == pytest.approx(-servo.stiffness * value - servo.damping * rate, rel=1e-12)
    assert effort['steering_pinion'] == force
    assert effort['rack'] == pytest.approx(servo.terms[0][1] * force + motor, rel=1e-12)


def test_the_full_car_takes_it_in_the_place_of_its_mesh() -> None:
    """One action-reaction element as before; the counts are those of the reference car."""
    changes = ['vehicle.steering.stiffness=110', 'vehicle.steering.damping=0.5', f'vehicle.steering.assist={ASSIST}']
    simulation = Simulation(load_scene('car_swept_steer', changes))
    counts = simulation.describe()
    expected = {
        'bodies': 53,
        'joints': 49,
        'bushings': 29,
        'spring_dampers': 9,
        'force_elements': 9,
        'dof': 134,
        'redundant_rows': [],
    }
    assert {name: counts[name] for name in expected} == expected
    assert [s.name for s in simulation.model.spec.servos] == ['rack_and_pinion']
    assert 'rack_and_pinion' not in {f.name for f in simulation.model.spec.coordinate_forces}


def test_the_level_condensed_has_the_motor_behind_its_transmission() -> None:
    """The same torque of the hand in a step steer, without pinion and shafts."""
    whole = drive('electric_4wd', steering='{kind: step, value: 0.5, start: 0.1, rise: 0.1}')
    model, _ = condensed(whole.model.spec)
    (servo,) = model.servos
    assert [name for name, _ in servo.terms] == ['rack', 'steering_wheel']
    assert any(servo.harmonics)
    less = Simulation(dataclasses.replace(whole.scene, model=model))
    torques = [
        [s.advance(25).joint_effort[s.channels.joints.index('steering_wheel')] for _ in range(20)]
        for s in (whole, less)
    ]
    assert np.abs(np.subtract(*torques)).max() < 0.03 * np.abs(torques[0]).max()


@pytest.mark.parametrize(
    ('change', 'sentence'),
    [
        (
            'assist={speeds: [0], torques: [2, 1], forces: [[1, 2]], limit: 9}',
            r'steering\.assist\.torques\[1\] = 1.0: must be greater',
        ),
        ('assist.lag=0', 'steering.assist.lag = 0'),
        ('assist.limit=-5', 'steering.assist.limit = -5'),
        ('assist.forces=[[1, 2, 3, 4]]', 'steering.assist.forces = 1: must have one row for each of the 4 speeds'),
        ('friction=-1', 'steering.friction = -1'),
    ],
)
def test_what_cannot_be_is_one_sentence(change: str, sentence: str) -> None:
    with pytest.raises(MbdError, match=sentence):
        drive('compact_fwd', f'vehicle.steering.{change}')


def test_a_car_may_stand_with_its_wheels_turned() -> None:
    """From straight ahead the wind-up is far beyond the map: the equilibrium is found, the hand holds less than the
    help gives."""
    text = 'vehicle: vehicles/pickup_awd.yaml\nstart: {kind: equilibrium}\nmaneuver: {steering: 3.0}\n'
    simulation = Simulation(load_scene_text(text, 'parked'))
    force, speed, motor = simulation.model.outputs('servos', simulation.outputs)[0, 4:]
    assert abs(speed) < 1e-6
    assert 0.0 < -force < 8.0
    assert motor * TRAVEL['pickup_awd'] / (2.0 * np.pi) > -force
