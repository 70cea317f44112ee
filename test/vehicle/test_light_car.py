"""The light car at rest and running straight: counts, statics, symmetry."""

from __future__ import annotations

import numpy as np
import pytest

from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.errors import SceneError
from solver.files.scene import load_scene
from solver.simulation import Simulation

FX, FY, FZ = range(3)
G = 9.81
MASSES = ('chassis', 'front.wheel', 'front.knuckle', 'rear.wheel', 'rear.knuckle', 'steering.rack', 'steering.wheel')
WHEELS = ('front_left', 'front_right', 'rear_left', 'rear_right')


def simulation(*overrides: str, scene: str = 'light_car_straight') -> Simulation:
    return Simulation(load_scene(scene, overrides))


@pytest.fixture(scope='module')
def at_rest():
    return simulation('start.speed_kmh=0')


def column(sim: Simulation, name: str) -> float:
    return float(sim.snapshot().elements[sim.channels.elements.index(name)])


def test_count_of_freedom_is_that_of_the_hand_count(at_rest):
    # 6 x 11 bodies - (2 struts x 2 + 2 x 3 rods + 2 arms x 5 + 4 wheels x 5 + rack 5 + steering wheel 5 + pinion +
    # driver) = 6 of the car + 4 of the suspension + 4 of the wheels
    found = at_rest.describe()
    assert (found['bodies'], found['constraint_rows'], found['dof'], found['redundant_constraints']) == (11, 52, 14, 0)
    # contact deflections, twist and give of the tread of the tires, wind-up of the brakes
    assert found['internal_states'] == 4 * 4 + 4
    assert 1300.0 < found['mass'] < 1600.0


@pytest.mark.parametrize(
    ('given', 'says'),
    [
        (
            ['vehicle.front.wheel.center=[-1.325, 0.765, 0.298]'],
            'front.wheel.center = -1.325: its x must lie ahead of the rear wheels',
        ),
        ([f'vehicle.{part}.mass=0' for part in MASSES], 'light car: mass = 0.0: must be positive'),
        (['vehicle.front.top_mount=[1.279, 0.59, 0.2]'], 'top_mount = .*: must lie above strut by at least 0.05 m'),
        (
            ['vehicle.front.arm_pivots=[[1.3, 0.4, 0.2], [1.3, 0.4, 0.2]]'],
            'arm_pivots = .*: do not lead the wheel up and down',
        ),
    ],
)
def test_a_car_without_wheelbase_mass_or_suspension_is_refused(given, says):
    with pytest.raises(SceneError, match=says):
        load_scene('light_car_straight', given)


def test_wheel_loads_are_those_of_the_moment_balance(at_rest):
    bodies = at_rest.scene.model.bodies
    mass = sum(b.mass for b in bodies)
    moment = sum(b.mass * (b.position[0] + b.com[0]) for b in bodies)
    x_front, x_rear = 1.325, -1.325
    front = 0.5 * G * (moment - mass * x_rear) / (x_front - x_rear)
    rear = 0.5 * G * mass - front
    load = at_rest.snapshot().tire[:, FZ]
    assert 2500.0 < rear < front < 4500.0
    # neglected: the car settles by about 1 mm and pitches by 1e-3 rad, which moves the centre of mass by 0.6 mm of the
    # wheelbase
    assert load == pytest.approx([front, front, rear, rear], rel=6e-4)
    assert load.sum() == pytest.approx(mass * G, rel=1e-7)  # equilibrium to 1e-8 of the weight


def test_springs_carry_what_their_lever_arms_say(at_rest):
    fz = at_rest.snapshot().tire[:, FZ]
    # front: six forces hold the knuckle with the wheel, two of the top mount, three of rods, that of the spring.
    # Neglected: the car has settled by less than a millimetre
    tire = at_rest.snapshot().tire[0]
    top, strut, ball, rack, knuckle = (
        np.array(p)
        for p in (
            [1.279, 0.59, 0.83],
            [1.3165, 0.653, 0.38],
            [1.331, 0.725, 0.195],
            [1.175, 0.352, 0.2373],
            [1.193, 0.7, 0.235],
        )
    )
    axis = (top - strut) / np.linalg.norm(top - strut)
    across = np.cross(axis, (1.0, 0.0, 0.0)), np.cross(axis, (0.0, 1.0, 0.0))
    lines = [(d, top) for d in (-axis, *across)]
    lines += [
        (d / np.linalg.norm(d), p)
        for d, p in ((ball - [1.34, 0.375, 0.205], ball), (ball - [1.06, 0.385, 0.213], ball))
    ]
    lines += [((knuckle - rack) / np.linalg.norm(knuckle - rack), knuckle)]
    contact = (1.325, 0.765 + 0.298 * np.tan(np.deg2rad(0.4)), 0.0)
    given = [
        ((0.0, 0.0, -20.0 * G), (1.325, 0.765, 0.298)),
        ((0.0, 0.0, -18.0 * G), (1.315, 0.70, 0.32)),
        (tire[:3], contact),
    ]
    load = np.sum([np.concatenate([f, np.cross(p, f)]) for f, p in given], axis=0) + [0.0, 0.0, 0.0, *tire[3:6]]
    columns = np.array([np.concatenate([d, np.cross(p, d)]) for d, p in lines]).T
    force = np.linalg.solve(columns, -load)[0]
    assert column(at_rest, 'spring_front_left/force') == pytest.approx(-force, rel=3e-3)
    free = next(s.free_length for s in at_rest.scene.model.spring_dampers if s.name == 'spring_front_left')
    assert free - np.linalg.norm(top - strut) == pytest.approx(force / 22000.0, rel=3e-3)
    # rear: moments about the axis of the arm; neglected: 48 N of camber thrust at 0.34 m
    inner, outer = np.array([-0.96, 0.30, 0.345]), np.array([-0.90, 0.62, 0.339])
    e = (outer - inner) / np.linalg.norm(outer - inner)

    def arm(point, direction):
        return e @ np.cross(np.subtract(point, inner), direction)

    top, bottom = np.array([-1.235, 0.56, 0.50]), np.array([-1.245, 0.56, 0.22])
    push = (bottom - top) / np.linalg.norm(bottom - top)
    up = (0.0, 0.0, 1.0)
    moment = fz[2] * arm((-1.325, 0.76, 0.0), up) - G * (
        20.0 * arm((-1.325, 0.76, 0.301), up) + 20.0 * arm((-1.20, 0.62, 0.30), up)
    )
    assert column(at_rest, 'spring_rear_left/force') == pytest.approx(moment / arm(bottom, push), rel=8e-3)


def test_design_position_is_near_equilibrium(at_rest):
    channels, snapshot = at_rest.channels, at_rest.snapshot()
    travel = [snapshot.joint_position[channels.joints.index(f'travel_{w}')] for w in WHEELS]
    assert np.abs(travel).max() < 1e-3  # camber thrust, and heights of the wheel centres rounded to 1 mm
    assert np.abs(snapshot.pose[channels.chassis, :3]).max() < 2e-3


def test_standstill_stays_at_rest():
    sim = simulation('start.speed_kmh=0', 'maneuver={brake_torque: 1000}')
    before = sim.snapshot()
    after = sim.advance(1000)
    assert np.abs(after.pose - before.pose).max() < 2e-6
    assert np.abs(after.twist).max() < 1e-5


FREE = {
    axle: f'vehicle.{axle}.tire={{<<: tires/205_55R16.tir, values: {{QSY1: 0, QSY3: 0, QSY4: 0}}}}'
    for axle in ('front', 'rear')
}


def test_with_released_brakes_toe_and_camber_push_it_where_nothing_resists_rolling():
    """The search for equilibrium holds the chassis by a spring. Let go, it is pushed by the camber thrust of the rear
    wheels along x, toe 0.15 deg. Neglected: that camber thrust fades as the wheels roll sideways. With its rolling
    resistance the car stands (next test)."""
    free = simulation('start.speed_kmh=0', *FREE.values())
    before = free.snapshot()
    push = 2.0 * before.tire[3, FY] * np.sin(np.deg2rad(0.15))
    after = free.advance(500)
    mass = sum(b.mass for b in free.scene.model.bodies) + 4.0 * 0.9 / 0.30**2
    assert after.twist[0, 0] == pytest.approx(-0.5 * push / mass, rel=0.15)


def test_with_released_brakes_rolling_resistance_holds_it(at_rest):
    """Toe and camber push by less than the wheels resist; the tread gives by less than 0.1 mm."""
    x, before = at_rest.snapshot().pose[0, 0], at_rest.k
    after = at_rest.advance(3000)
    assert after.k == before + 3000
    assert abs(after.pose[0, 0] - x) < 1e-4
    assert abs(after.twist[0, 0]) < 1e-6


def test_straight_running_stays_straight():
    # block form and a second iteration, which refines the solution of the first: otherwise the round-off of the matrix,
    # 1e-16 times the penalty, is a disturbance
    sim = simulation('maneuver={drive_torque: 200}', 'integrator.form=block', 'integrator.iterations=2')
    after = sim.advance(3000)
    x, y = after.pose[0, :2]
    assert 70.0 < x < 80.0
    # a symmetric car knows no side but that of rounding
    assert abs(y) < 1e-7 and np.abs(after.twist[0, [1, 3, 5]]).max() < 1e-8
    left, right = after.tire[0::2], after.tire[1::2]
    assert left[:, [FX, FZ]] == pytest.approx(right[:, [FX, FZ]], rel=1e-9)
    assert left[:, FY] == pytest.approx(-right[:, FY], rel=1e-6)


def test_open_differential_shares_the_torque_equally():
    sim = simulation('maneuver={drive_torque: 400, steering: 0.8}', scene='light_car_circle')
    sim.advance(2000)
    names = list(sim.channels.joints)
    effort = sim.snapshot().joint_effort
    left, right = (effort[names.index(f'shaft_front_{side}')] for side in ('left', 'right'))
    assert (left, right) == (200.0, 200.0)
    speed = sim.snapshot().joint_velocity
    outer, inner = speed[names.index('shaft_front_right')], speed[names.index('shaft_front_left')]
    assert outer > 1.01 * inner > 0.0  # and lets the wheels of a turning car roll at their own speeds


def test_mirrored_steering_gives_the_mirrored_motion():
    # block form as above; rounding errors of the start (its matrix is condensed, with a penalty of 1e8) grow with the
    # distance
    settings = ('maneuver.steering.start=0.2', 'integrator.form=block')
    left, right = (
        simulation(f'maneuver.steering.value={a}', *settings, scene='light_car_step_steer').advance(1500)
        for a in (0.9, -0.9)
    )
    assert left.pose[0, 1] > 0.5  # it did turn, to the left
    mirrored = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    assert left.twist[0] == pytest.approx(mirrored * right.twist[0], abs=1e-8)
    assert left.pose[0] == pytest.approx(np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0]) * right.pose[0], abs=1e-7)
    other = [1, 0, 3, 2]
    same = [TIRE_COLUMNS.index(c) for c in ('fx', 'fz', 'kappa', 'spin', 'deflection')]
    opposite = [TIRE_COLUMNS.index(c) for c in ('fy', 'alpha', 'gamma')]
    scale = np.abs(left.tire).max(axis=0)
    assert np.abs(left.tire[:, same] - right.tire[other][:, same]).max() < 1e-8 * scale.max()
    assert np.abs(left.tire[:, opposite] + right.tire[other][:, opposite]).max() < 1e-8 * scale.max()
