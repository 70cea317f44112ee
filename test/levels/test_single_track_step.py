"""The single-track model in motion, with parameters given here: closed forms of the linear model, braking, rest,
energy, bits."""

from __future__ import annotations

import copy
import dataclasses
import math
import pickle

import numpy as np
import pytest
from scipy.linalg import expm
from single_tracks import MODEL, PARAMETERS, simulation, track

from solver.analysis.verdict import findings
from solver.elements.road import FrictionPatch, RoadSpec
from solver.errors import ConsistencyError, SpecError, StepError
from solver.inputs.maneuver import Maneuver
from solver.inputs.signals import Ramp, Sine, Step
from solver.levels.single_track_engine import ELEMENTS, rolling
from solver.levels.track_tables import DRIVE, LATERAL, ROLL, SHIFT, SPIN, VX, VY, YAW, YAW_RATE
from solver.scene import Scene, StartSettings
from solver.simulation import Simulation


def linear(**more: float) -> dict:
    """Parameters without roll, resistance and relaxation: what the closed forms are about. more: of both axles."""
    p = copy.deepcopy(PARAMETERS)
    p['body'] |= {'coupling': 0.0, 'product': 0.0, 'drag': 0.0, 'ratio_3': 0.0}
    for axle in ('front', 'rear'):
        p[axle] |= {
            'roll_steer': 0.0,
            'resistance': 0.0,
            'length_y': 1e-3,
            'trail': 0.0,
            'trail_lost': 0.0,
            'drive': 0.0,
            **more,
        }
    return p


def understeer() -> float:
    """Gradient of the linear model [rad s^2/m]: m / L (b / Cf - a / Cr) ([Gillespie1992] 6.4)."""
    a, b = PARAMETERS['front']['x'], -PARAMETERS['rear']['x']
    front, rear = PARAMETERS['front']['stiffness_y'], PARAMETERS['rear']['stiffness_y']
    return PARAMETERS['body']['mass'] / (a + b) * (b / front - a / rear)


@pytest.mark.parametrize('speed', [8.0, 20.0, 45.0])
def test_steady_yaw_gain_is_that_of_the_linear_single_track_model(speed: float) -> None:
    wheel = 1e-3
    s = simulation(Maneuver(steering=Step(value=wheel, start=0.1, rise=0.2)), speed=speed, parameters=linear())
    s.advance(6000)
    v = s.engine.y[VX]
    gain = s.engine.y[YAW_RATE] / (wheel / 16.0)
    assert gain == pytest.approx(v / (2.65 + understeer() * v * v), rel=1e-4)


@pytest.mark.parametrize('behind', [-0.5, 0.2])
def test_a_rear_axle_that_is_steered_too_turns_it_by_the_difference(behind: float) -> None:
    """Yaw gain of the linear model with both axles steered: v (1 - behind) / (L + K v^2)."""
    wheel, p = 1e-3, linear()
    p['rear']['steered'] = behind
    s = simulation(Maneuver(steering=Step(value=wheel, start=0.1, rise=0.2)), speed=8.0, parameters=p)
    s.advance(6000)
    v = s.engine.y[VX]
    assert s.engine.y[YAW_RATE] / (wheel / 16.0) == pytest.approx(
        v * (1.0 - behind) / (2.65 + understeer() * v * v), rel=1e-4
    )


@pytest.mark.parametrize(('speed', 'trail'), [(8.0, 0.04), (-8.0, -0.02)])
def test_backwards_the_trail_of_the_tires_is_in_front_of_the_axis_of_steering(speed: float, trail: float) -> None:
    """Of 40 mm 30 are of the tires: 10 - 30 backwards."""
    p = linear()
    p['front'] |= {'trail': 0.04, 'trail_lost': 0.03}
    s = simulation(Maneuver(steering=Step(value=1e-3, start=0.1, rise=0.2)), speed=speed, parameters=p)
    shot = s.advance(3000)
    force = shot.elements[ELEMENTS.index('axle_front/fy')]
    assert abs(force) > 1.0
    assert shot.joint_effort[0] == pytest.approx(trail / 16.0 * force, rel=1e-3)


def matrix(p: dict, v: float) -> np.ndarray:
    """Of the linear model with relaxation at a speed v [m/s]: lateral velocity, yaw rate, lateral deflections of both
    axles."""
    m, inertia = p['body']['mass'], p['body']['yaw_inertia']
    x = [p[axle]['x'] for axle in ('front', 'rear')]
    c = [p[axle]['stiffness_y'] / p[axle]['length_y'] for axle in ('front', 'rear')]
    decay = [-v / p[axle]['length_y'] for axle in ('front', 'rear')]
    return np.array(
        [
            [0.0, -v, c[0] / m, c[1] / m],
            [0.0, 0.0, x[0] * c[0] / inertia, x[1] * c[1] / inertia],
            [-1.0, -x[0], decay[0], 0.0],
            [-1.0, -x[1], 0.0, decay[1]],
        ]
    )


def test_free_motion_is_the_matrix_exponential_of_the_linear_model() -> None:
    p, v = linear(length_y=0.4), 25.0
    s = simulation(speed=v, parameters=p)
    x = np.array([0.02, 0.0, -0.02 / v * 0.4, -0.02 / v * 0.4])
    s.engine.y[VY], s.engine.y[LATERAL : LATERAL + 2] = x[0], x[2:]
    for k in range(1, 6):
        s.advance(100)
        expected = expm(matrix(p, v) * 0.1 * k) @ x
        assert [s.engine.y[VY], s.engine.y[YAW_RATE], *s.engine.y[LATERAL : LATERAL + 2]] == pytest.approx(
            expected.tolist(), abs=2e-6
        )


@pytest.mark.parametrize('v', [15.0, 40.0])
def test_without_relaxation_natural_frequency_and_damping_are_those_of_the_books(v: float) -> None:
    """The linear model the level is held against above has the eigenvalues of [Gillespie1992] with short relaxation
    lengths."""
    p = linear(length_y=1e-4)
    m, inertia, a, b = p['body']['mass'], p['body']['yaw_inertia'], p['front']['x'], -p['rear']['x']
    front, rear = p['front']['stiffness_y'], p['rear']['stiffness_y']
    slow = sorted(np.linalg.eigvals(matrix(p, v)), key=abs)[:2]
    frequency2 = front * rear * (a + b) ** 2 / (m * inertia * v * v) + (b * rear - a * front) / inertia
    damping = (inertia * (front + rear) + m * (a * a * front + b * b * rear)) / (m * inertia * v)
    assert np.prod(slow).real == pytest.approx(frequency2, rel=1e-2)
    assert -np.sum(slow).real == pytest.approx(damping, rel=1e-2)


def test_roll_in_a_steady_bend_is_what_the_stiffness_leaves() -> None:
    s = simulation(Maneuver(steering=Step(value=0.1, start=0.1, rise=0.2)))
    s.advance(5000)
    lateral = s.engine.y[VX] * s.engine.y[YAW_RATE]
    assert s.engine.y[ROLL] == pytest.approx(800.0 * lateral / 9e4, rel=5e-3)  # it still slows down a little
    assert s.engine.y[ROLL] > 0.0  # to the right in a bend to the left


def test_roll_alone_is_a_damped_oscillator() -> None:
    """About an axis without mass beside it: period and decay of I p' = -k phi - c p."""
    p = linear()
    s = simulation(speed=0.0, parameters=p)
    s.engine.y[ROLL] = 0.01
    w, d = math.sqrt(9e4 / 1000.0), 0.5 * 2700.0 / 1000.0
    wd = math.sqrt(w * w - d * d)
    s.advance(400)
    assert s.engine.y[ROLL] == pytest.approx(
        0.01 * math.exp(-d * 0.4) * (math.cos(wd * 0.4) + d / wd * math.sin(wd * 0.4)), abs=1e-6
    )


def test_braking_slows_mass_and_wheels() -> None:
    s = simulation(Maneuver(brake_torque=Step(value=1500.0, start=0.1, rise=0.1)), speed=30.0, parameters=linear())
    s.advance(1000)
    before = s.engine.y[VX]
    s.advance(500)
    turning = sum(1.8 / (0.298 * 0.308) for _ in range(2))
    assert (before - s.engine.y[VX]) / 0.5 == pytest.approx(1500.0 / 0.298 / (1400.0 + turning), rel=2e-3)


def test_each_axle_has_a_limiter_of_its_own() -> None:
    """At 20 m/s wheels turn at 65 rad/s: motors in front that end at 50 rad/s have nothing left, those behind drive
    with their 60 %."""
    p = linear()
    p['front'] |= {'drive': 0.4, 'top_spin': 50.0}
    p['rear'] |= {'drive': 0.6}
    s = simulation(Maneuver(drive_torque=1000.0), speed=20.0, parameters=p)
    s.advance(500)
    before = s.engine.y[VX]
    s.advance(500)
    turning = sum(1.8 / (0.298 * 0.308) for _ in range(2))
    assert (s.engine.y[VX] - before) / 0.5 == pytest.approx(600.0 / 0.298 / (1400.0 + turning), rel=2e-3)
    assert s.engine.y[DRIVE] == pytest.approx(600.0, rel=1e-6)
    assert s.totals()['energy_error_max'] < 5e-5 * 0.5 * 1400.0 * 20.0**2


def test_coasting_against_the_drag_follows_its_closed_form() -> None:
    p = linear()
    p['body']['drag'] = 0.4
    s = simulation(speed=40.0, parameters=p)
    s.advance(5000)
    m = 1400.0 + 2.0 * 1.8 / (0.298 * 0.308)
    assert s.engine.y[VX] == pytest.approx(40.0 / (1.0 + 0.4 * 40.0 * 5.0 / m), rel=1e-4)


@pytest.mark.parametrize('h', [1e-3, 1e-2])
def test_it_brakes_to_rest_and_stays_there(h: float) -> None:
    s = simulation(Maneuver(brake_torque=3000.0, steering=0.5), speed=10.0, h=h)
    s.advance(round(8.0 / h))
    rest = s.snapshot()
    s.advance(round(4.0 / h))
    moved = s.snapshot().pose - rest.pose
    assert np.abs(moved).max() < 1e-6
    assert np.abs(s.snapshot().twist).max() < 1e-6


def test_a_brake_that_lets_go_holds_no_more() -> None:
    s = simulation(
        Maneuver(brake_torque=Step(initial=2000.0, value=0.0, start=3.0, rise=0.1), drive_torque=300.0), speed=3.0
    )
    s.advance(2900)
    assert abs(s.engine.y[VX]) < 1e-3
    s.advance(2000)
    assert s.engine.y[VX] > 0.8
    assert s.snapshot().joint_effort[1:].max() == pytest.approx(0.0, abs=1e-9)


def skidding(friction: float, vx: float, steps: int) -> Simulation:
    """Thrown sideways at 10 m/s with locked wheels, without roll and load transfer."""
    p = linear()
    p['body']['height'] = 0.0
    s = simulation(Maneuver(brake_torque=20e3), speed=0.0, parameters=p, road=RoadSpec(friction=friction))
    s.engine.y[VX], s.engine.y[VY] = vx, 10.0
    s.advance(steps)
    return s


def test_a_skid_goes_straight_on_and_stores_no_more_than_the_road_can_carry() -> None:
    s = skidding(1.0, 1.5, 300)
    assert np.arctan2(s.engine.y[VY], s.engine.y[VX]) + s.engine.y[YAW] == pytest.approx(
        np.arctan2(10.0, 1.5), abs=np.radians(3.0)
    )
    dry, wet = (skidding(friction, 0.0, 100).engine.y[LATERAL] for friction in (1.0, 0.1))
    assert wet == pytest.approx(0.1 * dry, rel=0.02)


def bend(h: float, braking: float = 400.0) -> Simulation:
    """Steered to and fro, and braked at the end with a torque that grows by so much [N m/s]."""
    brake = Ramp(slope=braking, start=3.0, blend=0.2)
    s = simulation(Maneuver(steering=Sine(amplitude=0.8, frequency=0.5), drive_torque=200.0, brake_torque=brake), h=h)
    s.advance(round(5.0 / h))
    return s


def test_energy_closes_with_the_second_power_of_the_step() -> None:
    """A brake that begins is stiffer than any step, and closes with the first power."""
    errors = [bend(h, 0.0).totals()['energy_error_max'] for h in (2e-3, 1e-3, 5e-4)]
    assert errors[0] / errors[1] > 3.2
    assert errors[1] / errors[2] > 3.2
    assert errors[2] < 5e-5 * 0.5 * 1400.0 * 20.0**2
    errors = [bend(h).totals()['energy_error_max'] for h in (2e-3, 1e-3, 5e-4)]
    assert errors[1] / errors[2] > 1.6
    assert errors[1] < 1e-4 * 0.5 * 1400.0 * 20.0**2
    assert findings_of_energy(bend(1e-3)) == []


def findings_of_energy(s: Simulation) -> list[str]:
    return [finding.text for finding in findings(s) if finding.quantity == 'energy_error_max']


def test_the_motion_converges_with_the_second_power_of_the_step() -> None:
    fine = bend(1.25e-4).engine.y[:10]
    errors = [np.abs(bend(h).engine.y[:10] - fine).max() for h in (2e-3, 1e-3)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.25)


def test_pieces_and_restored_states_give_the_same_bits() -> None:
    whole = bend(1e-3)
    s = bend(1e-3)
    s.reset()
    s.advance(1700)
    kept = s.save()
    s.advance(33)
    s.restore(kept)
    assert s.k == 1700
    while s.k < 5000:
        s.advance(min(7, 5000 - s.k))
    assert s.snapshot().numbers.tobytes() == whole.snapshot().numbers.tobytes()
    assert s.totals()['energy_error_max'] == whole.totals()['energy_error_max']
    assert s.reached == whole.reached


def test_it_goes_on_with_the_same_bits_in_another_process() -> None:
    s = bend(1e-3)
    again = pickle.loads(pickle.dumps(s))
    assert again.advance(50).numbers.tobytes() == s.advance(50).numbers.tobytes()
    assert again.totals() == s.totals()


def test_what_it_does_not_model_is_absent() -> None:
    s = simulation()
    assert s.channels.wheels == ()
    assert s.channels.bodies == ('chassis',)
    assert s.channels.joints == (
        'steering_wheel',
        'wheel_front_left',
        'wheel_front_right',
        'wheel_rear_left',
        'wheel_rear_right',
    )
    assert s.channels.elements == ELEMENTS
    assert s.snapshot().tire.size == 0


def test_velocity_and_pose_of_the_chassis_belong_together() -> None:
    """The twist is the derivative of the pose, roll and pitch included."""
    s = simulation(
        Maneuver(steering=Sine(amplitude=1.0, frequency=1.0), brake_torque=Step(value=1000.0, start=0.5, rise=0.3)),
        h=1e-4,
    )
    s.advance(8000)
    a, b = s.snapshot(), s.advance(1)
    x, y, z, w = 0.5 * (a.pose[0, 3:] + b.pose[0, 3:])
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    moved = R.T @ (b.pose[0, :3] - a.pose[0, :3]) / 1e-4
    assert moved == pytest.approx(0.5 * (a.twist[0, :3] + b.twist[0, :3]), abs=2e-4)
    q, dq = np.array([x, y, z, w]), (b.pose[0, 3:] - a.pose[0, 3:]) / 1e-4
    turned = 2.0 * np.array(
        [
            q[3] * dq[0] - q[0] * dq[3] + -(q[1] * dq[2] - q[2] * dq[1]),
            q[3] * dq[1] - q[1] * dq[3] + -(q[2] * dq[0] - q[0] * dq[2]),
            q[3] * dq[2] - q[2] * dq[3] + -(q[0] * dq[1] - q[1] * dq[0]),
        ]
    )
    assert turned == pytest.approx(0.5 * (a.twist[0, 3:] + b.twist[0, 3:]), abs=2e-4)
    assert np.abs(turned).min() > 1e-4


def test_less_friction_leaves_less_force() -> None:
    steering = Step(value=2.0, start=0.1, rise=0.5)
    dry, wet = (
        simulation(Maneuver(steering=steering)),
        simulation(Maneuver(steering=steering), road=RoadSpec(friction=0.4)),
    )
    dry.advance(2000)
    wet.advance(2000)
    assert wet.reached['lateral acceleration'][0] < 0.45 * 9.81 < dry.reached['lateral acceleration'][0]


def test_friction_that_differs_between_the_sides_is_noticed() -> None:
    strip = FrictionPatch(center=(0.0, -5.0), size=(1000.0, 10.0), factor=0.3)
    s = simulation(road=RoadSpec(patches=(strip,)))
    s.advance(100)
    assert s.reached['friction difference'][0] == pytest.approx(0.7)


def test_the_frequency_of_a_sine_is_found() -> None:
    s = simulation(Maneuver(steering=Sine(amplitude=0.1, frequency=3.0)))
    s.advance(5000)
    assert s.reached['frequency'][0] == pytest.approx(3.0, rel=0.02)


def test_it_starts_where_the_chassis_is_placed() -> None:
    """Turned by 90 degrees: it drives along y, and its wheels turn from zero."""
    half = math.sqrt(0.5)
    chassis, *others = MODEL.bodies
    placed = dataclasses.replace(chassis, position=(3.0, 4.0, 0.0), orientation=(0.0, 0.0, half, half))
    scene = Scene(
        name='turned',
        model=dataclasses.replace(MODEL, bodies=(placed, *others)),
        start=StartSettings(kind='equilibrium', speed=20.0),
    )
    s = track(scene)
    assert s.snapshot().joint_position[1:] == pytest.approx(np.zeros(4))
    assert s.snapshot().pose[0, :2] == pytest.approx([3.0, 4.0])
    moved = s.advance(100).pose[0, :2]
    assert moved[0] == pytest.approx(3.0, abs=1e-3)
    assert moved[1] == pytest.approx(6.0, rel=1e-2)


TURNED = Maneuver(steering=0.5, drive_torque=150.0)


@pytest.mark.parametrize('speed', [20.0, -8.0])
def test_a_steered_vehicle_starts_in_its_bend(speed: float) -> None:
    """Its roll at the start is what the stiffness leaves of S r v, its yaw rate goes on for half a second within 2 %,
    and in the first 20 ms it goes along x within its sideslip; it has its speed, and the centre of mass of its chassis,
    0.5 m over the axis of roll, stands at the origin: the chassis itself, 0.1 m under that axis, 0.6 m times its roll
    to the left."""
    s = simulation(Maneuver(steering=0.5, drive_torque=math.copysign(150.0, speed)), speed=speed)
    shot = s.snapshot()
    roll, rate = s.engine.y[ROLL], s.engine.y[YAW_RATE]
    assert rate == pytest.approx(
        speed * 0.5 / 16.0 / (2.65 + math.copysign(understeer(), speed) * speed * speed), rel=0.2
    )
    assert roll == pytest.approx(800.0 * speed * rate / 9e4, rel=5e-3)
    assert shot.twist[0, 5] == pytest.approx(rate, rel=1e-3)
    assert shot.twist[0, 0] + rate * 0.6 * roll == pytest.approx(speed, rel=1e-4)
    assert shot.pose[0, :2] == pytest.approx([0.0, 0.6 * roll], abs=1e-6)
    assert shot.pose[0, 5] == pytest.approx(0.0, abs=1e-3)
    assert shot.joint_position[1:] == pytest.approx(np.zeros(4))
    moved = s.advance(20).pose[0, :2] - shot.pose[0, :2]
    assert moved == pytest.approx([0.02 * speed, 0.02 * shot.twist[0, 1]], abs=2e-3)
    assert s.advance(480).twist[0, 5] == pytest.approx(rate, rel=0.02)
    s.reset()
    assert s.snapshot().numbers.tobytes() == shot.numbers.tobytes()
    assert s.totals()['energy_error_max'] == 0.0


def test_a_steered_start_does_not_depend_on_the_step_of_the_scene() -> None:
    assert simulation(TURNED, h=5e-3).engine.y.tobytes() == simulation(TURNED, h=1e-3).engine.y.tobytes()


def test_a_start_straight_on_rolls_as_before_whatever_drives_and_brakes() -> None:
    """To the bit, also steered from t = 0 on where it stands, or as it was placed."""
    s = simulation(Maneuver(drive_torque=150.0, brake_torque=500.0))
    assert s.engine.y.tobytes() == rolling(s.engine.tables.value, 20.0, 0.1).tobytes()
    s = simulation(TURNED, speed=0.0)
    assert s.engine.y.tobytes() == rolling(s.engine.tables.value, 0.0, 0.1).tobytes()
    placed = dataclasses.replace(s.scene, start=StartSettings(kind='as_placed', speed=20.0))
    assert track(placed).engine.y.tobytes() == rolling(s.engine.tables.value, 20.0, 0.1).tobytes()


def test_brakes_that_are_on_have_moved_load_forward_at_a_steered_start() -> None:
    """800 N m at 0.298 m: 0.2 of that force and of the resistance of all axles is load that has moved, and the car
    turns in for it."""
    braked, free = simulation(Maneuver(steering=0.5, brake_torque=800.0)), simulation(Maneuver(steering=0.5))
    moved = free.engine.y[SHIFT] - braked.engine.y[SHIFT]
    assert moved == pytest.approx(0.2 * 800.0 / 0.298, rel=0.03)
    assert braked.engine.y[YAW_RATE] > 1.01 * free.engine.y[YAW_RATE]


def test_a_drive_that_spins_the_wheels_acts_from_a_steered_start_on() -> None:
    """12 kN m at an axle that holds some 2: at the start it is as without it; 0.1 s later its wheels spin."""
    s = simulation(Maneuver(steering=0.5, drive_torque=12000.0), speed=3.0)
    assert s.engine.y.tobytes() == simulation(Maneuver(steering=0.5), speed=3.0).engine.y.tobytes()
    assert s.engine.y[YAW_RATE] == pytest.approx(3.0 * 0.5 / 16.0 / 2.65, rel=0.05)
    s.advance(100)
    assert s.engine.y[SPIN] > 20.0


def test_errors_are_sentences() -> None:
    s = simulation()
    with pytest.raises(StepError, match="input 'drive_torque' is not finite; nothing was advanced"):
        s.advance(1, inputs=np.array([0.0, 0.0, 0.0, np.nan, 0.0]))
    assert s.k == 0
    with pytest.raises(SpecError, match='take another level'):
        _ = s.state
    with pytest.raises(
        ConsistencyError, match=r'does not settle at 1e\+200 m/s with the steering wheel at 0.5 rad: reduce the speed'
    ):
        simulation(TURNED, speed=1e200)
