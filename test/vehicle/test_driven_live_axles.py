"""Two driven live axles, each behind a propeller shaft: names and freedoms, what the housing carries, the share of
each, and what connects them in a bend. Torques act at the differentials; test_powered_axles.py has engine and gearbox
in front of them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from axle_statics import links, loads
from live_axle_cars import DAMPING, RATIO, SPINNING, car, forces, moved, off_roader, rates, scene, shaft, truck
from scipy.spatial.transform import Rotation

from solver import simulation_of
from solver.analysis.reactions import joint_reaction
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.errors import MbdError
from solver.files.scene import load_scene_text
from solver.simulation import Simulation

PUSH = {'drive_torque': {'kind': 'step', 'value': 1500.0, 'start': 0.1, 'rise': 0.5}}
BEND = {'steering': {'kind': 'step', 'value': 6.0, 'start': 0.2, 'rise': 1.0}}
SIDES = ('left', 'right')


def rolling(vehicle: dict[str, Any], speed: float, maneuver: dict[str, Any], *changes: str, **more: Any) -> Simulation:
    start = {'kind': 'equilibrium', 'speed': speed}
    return Simulation(scene(vehicle, *changes, start=start, maneuver=maneuver, duration=30.0, **more))


@pytest.mark.parametrize(
    ('vehicle', 'dof'), [(off_roader(), 6 + 4 + 4 + 1 + 2), (truck(power=False), 6 + 6 + 6 + 1 + 2)]
)
def test_no_redundant_rows_and_the_degrees_of_freedom_counted_by_hand(vehicle: dict[str, Any], dof: int) -> None:
    """Chassis 6, wheels, bounce and roll of each axle, the pitman arm against its elastic worm, and each propeller
    shaft, whose pinion turns with it."""
    counts = Simulation(scene(vehicle)).describe()
    assert counts['redundant_rows'] == []
    assert counts['dof'] == dof


def test_parts_of_the_shafts_are_named_after_their_axles_where_there_are_several() -> None:
    names = {body.name for body in scene(off_roader()).model.bodies}
    assert {'propshaft_front', 'propshaft_rear', 'drive_pinion_front', 'drive_pinion_rear'} <= names
    one = scene(
        car({'front': 1.6, 'rear': -1.6}, {'rear': shaft([0.3, 0, 0.5], [-1.29, 0, 0.42])}, 1500, power=False)
    ).model
    assert {'propshaft', 'drive_pinion'} <= {body.name for body in one.bodies}
    assert {'final_drive', 'differential'} <= {force.name for force in one.coordinate_forces}
    pickup = load_scene_text('vehicle: vehicles/pickup_awd.yaml', 'pickup').model
    assert {'propshaft_front', 'propshaft_rear', 'drive_pinion'} <= {body.name for body in pickup.bodies}
    assert {'final_drive', 'differential_front', 'differential_rear', 'transfer'} <= {
        force.name for force in pickup.coordinate_forces
    }


def test_the_housing_carries_the_reaction_of_the_drive_torque() -> None:
    """The free body of the rear axle: its links meet far ahead, so what pulls at the ground raises the chassis by the
    springs. Besides tires, springs, links, weight and inertia it gets nothing: torque and reaction are inner ones.
    Within 1 % of the torque."""
    run = rolling(off_roader(), 5.0, PUSH)
    run.advance(2000)
    found = loads(run, 'rear', links('rear'))
    assert (found.along, found.across) == pytest.approx((0.0, 0.0), abs=0.01 * 750.0)


def test_the_drive_torque_turns_the_knuckles_about_kingpins_that_lean() -> None:
    """Knuckle and wheel on the left, about their kingpin k: tire, track rod, weight, inertia and the shaft, whose joint
    in the kingpin passes on T (h + s)/(1 + h . s) between the axes of housing and wheel. The track rod has to hold what
    the torque of a drive on the knuckle would not ask of it, 52 N m beside 65."""
    run = rolling(off_roader(), 3.0, PUSH)
    run.advance(2000)
    before = run.snapshot().twist.copy()
    shot = run.advance(10)
    faster = (shot.twist - before) / (10 * run.h)
    spec, column = run.model.spec, {name: k for k, name in enumerate(TIRE_COLUMNS)}
    names = [body.name for body in spec.bodies]
    turn = {name: Rotation.from_quat(shot.pose[k, 3:7]) for k, name in enumerate(names)}

    def at(body: str, point: Any) -> np.ndarray:
        return shot.pose[names.index(body), :3] + turn[body].apply(point)

    pin = next(joint.i for joint in spec.joints if joint.name == 'kingpin_front_left')
    foot, k = at(pin.body, pin.position), (turn[pin.body] * Rotation.from_quat(pin.orientation)).as_matrix()[:, 2]
    row, rod = shot.tire[0], joint_reaction(run, 'track_rod_front_outer')
    patch = Rotation.from_quat(row[column['qx'] : column['qw'] + 1])
    arm = row[column['px'] : column['pz'] + 1] - foot
    moments = [np.cross(arm, patch.apply(row[:3])) + patch.apply(row[column['mx'] : column['mz'] + 1]), rod.about(foot)]
    for name in ('upright_front_left', 'wheel_front_left'):
        body = spec.bodies[names.index(name)]
        felt = np.array([0.0, 0.0, -9.81]) - np.array([faster[run.channels.chassis or 0, 0], 0.0, 0.0])
        moments.append(np.cross(at(name, body.com) - foot, body.mass * felt))
    wheel, housing = turn['wheel_front_left'].as_matrix()[:, 1], turn['axle_front'].as_matrix()[:, 1]
    moments.append(-body.inertia[1] * faster[names.index('wheel_front_left'), 4] * wheel)
    torque = 0.25 * 1500.0 + 0.5 * forces(run)['final_drive_front']['force']
    shaft = torque * (housing + wheel) @ k / (1.0 + housing @ wheel)
    assert float(np.sum(moments, axis=0) @ k) == pytest.approx(-shaft, abs=0.2)
    assert shaft < -50.0


@pytest.mark.parametrize('shares', [(0.5, 0.5), (0.3, 0.7), (0.0, 1.0)])
def test_each_axle_pulls_by_its_share(shares: tuple[float, float]) -> None:
    """Straight on, the force at the tires of an axle is its torque over their lever, less what its wheels and shaft
    take to turn faster."""
    run = rolling(off_roader(shares=shares), 5.0, PUSH)
    run.advance(2000)
    before = run.snapshot().joint_velocity.copy()
    shot = run.advance(100)
    faster = dict(zip(run.channels.joints, (shot.joint_velocity - before) / (100 * run.h), strict=True))
    bodies = {body.name: body for body in run.model.spec.bodies}
    column = {name: shot.tire[:, k] for k, name in enumerate(TIRE_COLUMNS)}
    for k, (axle, share) in enumerate(zip(('front', 'rear'), shares, strict=True)):
        pair = slice(2 * k, 2 * k + 2)
        lever = 0.401 - column['deflection'][pair]  # UNLOADED_RADIUS of the tire
        inertia = 2.0 * bodies[f'wheel_{axle}_left'].inertia[1] + RATIO**2 * SPINNING
        left = (column['fx'][pair] * lever).sum() - column['my'][pair].sum()
        assert left == pytest.approx(1500.0 * share - inertia * faster[f'wheel_{axle}_left'], abs=2.0)


def kinematic(angles: list[float]) -> float:
    """How much faster the front axle turns in a bend about a point beside the rear one, from the angles of its
    wheels."""
    return 1.0 / math.cos(float(np.mean(angles))) - 1.0


def turned(run: Simulation) -> dict[str, float]:
    return dict(zip(run.channels.joints, run.snapshot().joint_position.tolist(), strict=True))


def test_a_soft_connection_winds_up_by_what_the_front_axle_goes_further() -> None:
    """1 N m/rad hold nothing: x_front - x_rear grows by the kinematic difference of the two, within 4 % of it (tires
    slip sideways)."""
    run = rolling(off_roader(transfer={'axle': 'front', 'to': 'rear', 'stiffness': 1.0, 'damping': 1e-3}), 3.0, BEND)
    run.advance(2000)
    before, wheels = forces(run)['transfer'], turned(run)
    run.advance(2000)
    now, after = forces(run)['transfer'], turned(run)
    rear = float(np.mean([after[f'wheel_rear_{side}'] - wheels[f'wheel_rear_{side}'] for side in SIDES]))
    wanted = rear * kinematic([after[f'kingpin_front_{side}'] for side in SIDES])
    assert now['value'] - before['value'] == pytest.approx(wanted, rel=0.04)
    assert wanted > 0.5
    assert now['force'] == pytest.approx(-now['value'] - 1e-3 * now['rate'], rel=1e-9)


def test_a_locked_one_slips_the_tires_by_it_brakes_in_front_and_drives_behind() -> None:
    """Wound up as far as tires give way: both axles turn alike, so their slips differ by what the front axle goes
    further, from its angle of steering and its slip angle (2 %); the tires of each have the torque of the transfer case
    at their lever, but for rolling."""
    stiffness, damping = 20000.0, 60.0
    run = rolling(
        off_roader(transfer={'axle': 'front', 'to': 'rear', 'stiffness': stiffness, 'damping': damping}), 3.0, BEND
    )
    run.advance(3500)
    found, there = forces(run)['transfer'], turned(run)
    turning, shot = rates(run), run.snapshot()
    means = {axle: np.mean([turning[f'wheel_{axle}_{side}'] for side in SIDES]) for axle in ('front', 'rear')}
    column = {name: shot.tire[:, k].reshape(2, 2) for k, name in enumerate(TIRE_COLUMNS)}
    assert found['force'] == pytest.approx(-stiffness * found['value'] - damping * found['rate'], rel=1e-9)
    assert means['front'] == pytest.approx(means['rear'], rel=2e-3)
    kappa = column['kappa'].mean(axis=1)
    steer = float(np.mean([there[f'kingpin_front_{side}'] for side in SIDES]))
    path = math.cos(steer) + math.sin(steer) * math.tan(steer - abs(float(column['alpha'][0].mean())))
    slip = (1.0 + kappa[1]) / (1.0 + kappa[0]) * means['front'] / means['rear']
    assert kappa[0] < 0.0 < kappa[1]
    assert slip - 1.0 == pytest.approx(path - 1.0, rel=0.02)
    pulls = (column['fx'] * (0.401 - column['deflection'])).sum(axis=1)
    assert pulls[0] < -1000.0 and pulls[1] > 1000.0
    assert pulls == pytest.approx((found['force'], -found['force']), rel=0.05)


def test_a_viscous_one_has_its_torque_by_its_law_and_heats() -> None:
    run = rolling(off_roader(transfer={'damping': 150.0}), 3.0, BEND)
    run.advance(3000)
    found, turning = forces(run)['transfer'], rates(run)
    difference = np.mean([turning[f'wheel_front_{s}'] for s in SIDES]) - np.mean(
        [turning[f'wheel_rear_{s}'] for s in SIDES]
    )
    assert found['force'] == pytest.approx(-150.0 * found['rate'], rel=1e-9)
    assert found['rate'] == pytest.approx(difference, rel=5e-3)  # of the shafts, whose final drives give way
    assert found['dissipation'] == pytest.approx(150.0 * found['rate'] ** 2, rel=1e-9)
    assert found['rate'] > 0.3


def mirrored(value: Any, key: str = '') -> Any:
    """Parts that are given as they are, not for the left side, on the other side of the car."""
    if isinstance(value, dict):
        return {name: mirrored(one, name) for name, one in value.items()}
    return (
        [value[0], -value[1], value[2]] if isinstance(value, list) and len(value) == 3 and key != 'inertia' else value
    )


def test_the_mirror_image_turns_to_the_other_side() -> None:
    """With shafts that turn the other way round (a ratio below 0), as in a mirror: left and right exchanged, but for
    what the iterations of a step leave."""
    lock = {'axle': 'front', 'to': 'rear', 'stiffness': 20000.0, 'damping': DAMPING}
    image = off_roader(transfer=lock)
    image['steering'] = mirrored(image['steering'])
    for axle in image['axles'].values():
        own = axle['suspension']
        own['rods'], own['housing'] = mirrored(own['rods']), mirrored(own['housing'])
        axle['drive'] = mirrored(axle['drive']) | {'ratio': -RATIO}
        if 'kingpins' in own:
            own['kingpins'] |= {'drag_link': mirrored(own['kingpins']['drag_link']), 'drag_link_on': 'left'}
    found = []
    for vehicle, sign in ((off_roader(transfer=lock), 1.0), (image, -1.0)):
        steering = {'kind': 'step', 'value': 3.0 * sign, 'start': 0.1, 'rise': 0.3}
        run = rolling(vehicle, 8.0, PUSH | {'steering': steering})
        shot = run.advance(1500)
        twist, loads = shot.twist[run.channels.chassis or 0], shot.tire[:, TIRE_COLUMNS.index('fz')]
        order = slice(None) if sign > 0.0 else [1, 0, 3, 2]
        found.append(
            np.array([*(twist * [1, sign, 1, sign, 1, sign]), *(1e-4 * loads[order]), forces(run)['transfer']['value']])
        )
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-6)
    assert abs(found[0][5]) > 0.1


@pytest.mark.slow
@pytest.mark.parametrize(
    ('level', 'transfer'),
    [
        ('condensed', None),
        ('kc', None),
        pytest.param('single_track', None, marks=pytest.mark.long),
        ('condensed', {'damping': 150.0}),
        ('kc', {'damping': 150.0}),
    ],
)
def test_levels_steer_as_the_whole_car_does(level: str, transfer: dict[str, Any] | None) -> None:
    """A step of the steering wheel at 15 m/s: yaw rate and speed at its end."""
    rate = []
    for fidelity in ('full', level):
        given = scene(
            off_roader(transfer=transfer), fidelity=fidelity, start={'kind': 'equilibrium', 'speed': 15.0},
            maneuver={'steering': {'kind': 'step', 'value': 1.0, 'start': 0.2, 'rise': 0.3}}, duration=2.5,
        )  # fmt: skip
        run = simulation_of(given)
        run.advance(round(2.5 / run.h))
        twist = run.snapshot().twist[run.channels.chassis or 0]
        rate.append((twist[5], twist[0]))
    assert rate[1] == pytest.approx(rate[0], rel=0.02)
    if transfer is not None and level == 'kc':
        assert 'the torque of transfer between axles that turn differently fast' in run.level.lost


LOCK = {'axle': 'front', 'to': 'rear', 'stiffness': 2e4, 'damping': 60.0}


@pytest.mark.parametrize('level', ['kc', 'single_track'])
def test_levels_without_a_locked_transfer_case_say_so(level: str) -> None:
    with pytest.raises(
        MbdError, match=r'vehicle: transfer = .*this level has no locked transfer case: use condensed or full'
    ):
        simulation_of(scene(off_roader(transfer=LOCK), fidelity=level))


def _with(axle: str, **changed: Any) -> dict[str, Any]:
    vehicle = off_roader()
    vehicle['axles'][axle]['drive'] |= changed
    return vehicle


def _through_each_other() -> dict[str, Any]:
    vehicle = _with('rear', through='front')
    vehicle['axles']['front']['drive']['through'] = 'rear'
    return vehicle


MOTORS = {'kind': 'motors', 'share': 0.5}


@pytest.mark.parametrize(
    ('vehicle', 'says'),
    [
        (off_roader(transfer=LOCK | {'axle': 'middle'}), 'axle = .?middle.*is not driven; driven are: front, rear'),
        (off_roader(transfer=LOCK | {'to': 'front'}), 'to = .?front.*is no other driven axle; these are: rear'),
        (
            off_roader(transfer=[LOCK, {'axle': 'rear', 'to': 'front', 'damping': 1.0}]),
            'axle = .?rear.*and front are connected twice',
        ),
        (off_roader(transfer=LOCK | {'damping': 0}), r'transfer\.damping = 0.*must be > 0'),
        (off_roader(shares=(0.5, 0.4)), 'share = 0.9.*must add up to 1'),
        (off_roader(shares=(-0.5, 1.5)), 'share = -0.5: must be >= 0'),
        (off_roader() | {'engine': None}, "drive of axle 'front': engine = None: the car has none: add it"),
        (_with('rear', through='rear'), "through = 'rear': is no other driven axle .*these are: front"),
        (_through_each_other(), "through = 'rear': the shafts to front, rear come through each other"),
        (_with('rear', center_joint=[0, 0, 0.4]), 'center_bearing = None: is missing: a shaft of two parts has'),
    ],
)
def test_what_cannot_be_is_refused_by_name(vehicle: dict[str, Any], says: str) -> None:
    with pytest.raises(MbdError, match=f'(?s){says}'):
        scene(vehicle)


def test_a_connection_needs_a_shaft_on_one_side() -> None:
    vehicle = off_roader(transfer=LOCK)
    for axle in vehicle['axles'].values():
        axle['drive'] = MOTORS
    with pytest.raises(MbdError, match=r'axle = .?front.*and rear have no propeller shaft'):
        scene(vehicle)
    with pytest.raises(MbdError, match='to = None: name the axle that front is locked to: middle or rear'):
        three = truck(power=False, transfer={'axle': 'front', 'damping': 1.0})
        three['axles']['front']['drive'] = MOTORS | {'share': 0.0}
        scene(three)


def test_points_of_an_axle_move_with_it() -> None:
    """The helper of these tests."""
    assert moved({'center': [1, 2, 3], 'mass': 4}, 1.0) == {'center': [0, 2, 3], 'mass': 4}
