"""Steered live axles: kingpins, track rod and drag link, from a file as a user would write it; and steered multi-link
suspensions."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from solver import simulation_of
from solver.analysis.kinematics_and_compliance import Rig
from solver.analysis.verdict import findings
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.errors import MbdError
from solver.files.mechanism import MechanismReader
from solver.files.scene import config_directories, find_file, load_scene_text
from solver.files.yaml_tree import read
from solver.scene import Scene
from solver.simulation import Simulation
from solver.vehicle.axle import FollowingRack
from solver.vehicle.car import Car, car_model
from solver.vehicle.multilink import MultiLink
from solver.vehicle.parts import Part

EXAMPLES = Path(__file__).parents[2] / 'docs' / 'examples'
FRONT, BOX = (
    (EXAMPLES / f'{name}.yaml').read_text(encoding='utf-8') for name in ('steered_live_axle', 'drag_link_steering')
)
PROPSHAFT = """
kind: live_axle
ratio: 3.7
stiffness: 22000
damping: 60
engine_flange: [0.900, 0.250, 0.470]
center_bearing: [1.000, 0.250, 0.460]
center_joint: [1.060, 0.250, 0.455]
pinion_flange: [1.400, 0.250, 0.420]
propshaft_front: {mass: 3, radius: 0.05}
propshaft_rear: {mass: 5, radius: 0.05}
pinion: {mass: 2, radius: 0.028}
"""
BEHIND = np.array([3.2, 0.0, 0.0])  # of the front axle to the rear one [m]


def moved_back(value: Any) -> Any:
    """A part of a file with all its points BEHIND the front axle."""
    if isinstance(value, dict):
        places = ('center', 'com', 'inner', 'outer', 'chassis', 'axle', 'damper_chassis', 'damper_axle')
        return {
            key: np.subtract(one, BEHIND).tolist() if key in places else moved_back(one) for key, one in value.items()
        }
    return value


def off_roader(**axles: Any) -> dict[str, Any]:
    """A car on two such axles, the front one steered, with ideal joints; axles: what they have beside their
    suspensions."""
    front = yaml.safe_load(FRONT)
    rear = moved_back({key: value for key, value in front.items() if key != 'kingpins'})
    rear['brake']['share'] = 0.16
    front['coil']['spring']['load'], rear['coil']['spring']['load'] = 4040.0, 3410.0
    chassis = {'mass': 1500, 'com': [0.12, 0, 0.76], 'inertia': [620, 3500, 3700]}
    found = {
        'kind': 'car', 'chassis': chassis, 'steering': yaml.safe_load(BOX),
        'axles': {'front': {'suspension': front}, 'rear': {'suspension': rear}},
    }  # fmt: skip
    for name, parts in (axles or {'rear': {'drive': {'kind': 'motors'}}}).items():
        found['axles'][name] |= parts
    return found


def scene(vehicle: dict[str, Any], **more: Any) -> Scene:
    text = {'vehicle': vehicle, 'start': {'kind': 'equilibrium'}, **more}
    return load_scene_text(yaml.safe_dump(text), 'off-roader')


def turned(point: Any, side: float, angle: float) -> np.ndarray:
    """A point of the left knuckle, on a side (1 left, -1 right), turned about its kingpin."""
    pins = yaml.safe_load(FRONT)['kingpins']
    flip = np.array([1.0, side, 1.0])
    low, high = np.array(pins['lower']) * flip, np.array(pins['upper']) * flip
    axis = (high - low) / np.linalg.norm(high - low)
    return low + Rotation.from_rotvec(angle * axis).apply(np.array(point) * flip - low)


def test_the_knuckles_turn_as_the_track_rod_has_them_and_the_inner_wheel_more() -> None:
    """The turn of the right knuckle from that of the left one by the length of the rod alone, in the frame of the
    axle."""
    rig = Rig(scene(off_roader()).model)
    names = list(rig.model.coordinate_names)
    ball = yaml.safe_load(FRONT)['kingpins']['track_rod']
    length = 2.0 * ball[1]
    for steering in (-8.0, -3.0, 3.0, 8.0):
        rig.settle({'steering': steering})
        left, right = (float(rig.state.angle[names.index(f'kingpin_front_{side}')]) for side in ('left', 'right'))
        one = turned(ball, 1.0, left)
        wanted = brentq(
            lambda angle, one=one: np.linalg.norm(turned(ball, -1.0, angle) - one) - length, left - 0.3, left + 0.3
        )
        assert right == pytest.approx(wanted, abs=1e-9)
        assert left * steering > 0.0
        # the rod lies behind the axle and is shorter than it
        assert abs(left) > abs(right) if steering > 0.0 else abs(right) > abs(left)


def mirrored(points: Any) -> Any:
    """Parts that are given as they are, not for the left side, on the other side of the car."""
    if isinstance(points, dict):
        return {
            key: [one[0], -one[1], one[2]] if isinstance(one, list) else mirrored(one) for key, one in points.items()
        }
    return points


def other_handed() -> dict[str, Any]:
    """The car with steering box, drag link, single rods and housings on the other side: the link pulls the left
    knuckle."""
    vehicle = off_roader()
    vehicle['steering'] = mirrored(vehicle['steering'])
    for axle in vehicle['axles'].values():
        suspension = axle['suspension']
        suspension['rods'] = mirrored(suspension['rods'])
        suspension['housing']['com'][1] *= -1.0
    pins = vehicle['axles']['front']['suspension']['kingpins']
    pins |= {'drag_link': mirrored(pins['drag_link']), 'drag_link_on': 'left'}
    return vehicle


def test_a_drag_link_on_the_left_knuckle_steers_as_its_mirror_image_does() -> None:
    angles = np.array([-4.0, -1.0, 0.0, 1.0, 4.0])
    there, here = (Rig(scene(vehicle).model).steering(angles) for vehicle in (off_roader(), other_handed()))
    for side, image in (('left', 'right'), ('right', 'left')):
        np.testing.assert_allclose(
            here[f'front_{side}']['steer'], -there[f'front_{image}']['steer'][::-1], rtol=0, atol=1e-9
        )
        assert np.all(np.diff(here[f'front_{side}']['steer']) > 0.05)


RACK = """
rack: {mass: 2.5, com: [1.800, 0, 0.500], inertia: [0.09, 0.003, 0.09]}
rack_per_turn: 0.050
rack_damping: 1500
stiffness: 85
damping: 0.7
pinion_foot: [1.800, 0.300, 0.507]
pinion_joint: [1.500, 0.330, 0.620]
column_joint: [0.960, 0.360, 0.900]
wheel_hub: [0.520, 0.360, 1.180]
pinion_mass: 0.6
shaft_mass: 1.4
wheel_mass: 3.6
wheel_inertia: 0.038
"""


def test_a_rack_pulls_the_drag_link() -> None:
    """The right knuckle turns by the way of the rack over the lever of the ball about the kingpin, but for what the
    link turns (3 %)."""
    rig = Rig(scene(off_roader() | {'steering': yaml.safe_load(RACK)}).model)
    pins = yaml.safe_load(FRONT)['kingpins']
    low, high, ball = (
        np.array(pins['lower']) * [1, -1, 1],
        np.array(pins['upper']) * [1, -1, 1],
        np.array(pins['drag_link']['outer']),
    )
    lever = np.cross((high - low) / np.linalg.norm(high - low), ball - low)
    pull = np.array(pins['drag_link']['outer']) - pins['drag_link']['inner']
    along = pull / np.linalg.norm(pull)
    turns = []
    for steering in (-0.5, 0.5):
        rig.settle({'steering': steering})
        turns.append(float(rig.state.angle[list(rig.model.coordinate_names).index('kingpin_front_right')]))
    way = 0.050 / (2.0 * np.pi) * (along @ [0.0, 1.0, 0.0])
    assert turns[1] - turns[0] == pytest.approx(way / (along @ lever), rel=0.03)


def test_it_has_no_redundant_rows_and_the_degrees_of_freedom_counted_by_hand() -> None:
    """Chassis 6, wheels 4, bounce and roll of both axles, and the pitman arm against its elastic worm."""
    counts = Simulation(scene(off_roader())).describe()
    assert counts['redundant_rows'] == []
    assert counts['dof'] == 6 + 4 + 2 + 2 + 1


def test_it_turns_to_both_sides_as_its_steering_says_and_holds_its_energy() -> None:
    """The steady yaw rate of a slow bend is v / l of the mean angle of the front wheels, less what tires slip: 5 % at
    0.5 m/s2. A drag link on one side makes left and right differ by their steering angles alone."""
    for steering in (1.5, -1.5):
        curve = Rig(scene(off_roader()).model).steering([0.0, steering])
        wheels = [curve[f'front_{side}']['steer'] for side in ('left', 'right')]
        angle = float(np.mean([steer[1] - steer[0] for steer in wheels]))
        maneuver = {'steering': {'kind': 'step', 'value': steering, 'start': 0.2, 'rise': 0.5}}
        run = Simulation(
            scene(
                off_roader(),
                start={'kind': 'equilibrium', 'speed': 5.0},
                maneuver=maneuver,
                duration=3.0,
                integrator={'h': 0.001},
            )
        )
        shot = run.advance(3000)
        twist = shot.twist[run.channels.chassis or 0]
        assert twist[5] == pytest.approx(twist[0] / BEHIND[0] * np.tan(angle), rel=0.05)
        assert not findings(run)


def test_a_driven_one_pulls_with_its_torque_and_straight_on() -> None:
    """Newton: the torque of the drive over the lever of the tire force, on the mass and on what turns; 2 % for
    resistance and slip."""
    engine = {
        'part': {'mass': 200, 'com': [0.7, 0.1, 0.6], 'inertia': [10, 15, 14]},
        'mounts': {'middle': {'point': [0.7, 0.0, 0.5]}},
    }
    vehicle = off_roader(front={'drive': yaml.safe_load(PROPSHAFT)}) | {'engine': engine}
    torque, at = 800.0, {'kind': 'equilibrium', 'speed': 8.0}
    speeds = []
    for pull in (0.0, torque):
        run = Simulation(
            scene(
                vehicle,
                start=at,
                maneuver={'drive_torque': {'kind': 'step', 'value': pull, 'start': 0.1, 'rise': 0.1}},
                duration=3.0,
            )
        )
        run.advance(round(1.0 / run.h))
        before = run.snapshot().twist[run.channels.chassis or 0, 0]
        shot = run.advance(round(1.0 / run.h))
        chassis = run.channels.chassis or 0
        speeds.append(shot.twist[chassis, 0] - before)
        assert abs(shot.twist[chassis, 5]) < 0.02
        assert not findings(run)
    spec, tire = run.model.spec, shot.tire[:2]  # 0.401 m: UNLOADED_RADIUS of 265_70R17.tir
    lever = 0.401 - float(tire[:, TIRE_COLUMNS.index('deflection')].mean())
    rolling = shot.twist[chassis, 0] / float(tire[:, TIRE_COLUMNS.index('spin')].mean())
    mass = sum(body.mass for body in spec.bodies)
    wheels = sum(body.inertia[1] for body in spec.bodies if body.name.startswith('wheel_'))
    shafts = 3.7**2 * sum(0.5 * body.mass * 0.05**2 for body in spec.bodies if 'propshaft' in body.name)
    assert speeds[1] - speeds[0] == pytest.approx(
        torque / lever / (mass + (wheels + shafts) / (lever * rolling)), rel=0.02
    )


@pytest.mark.parametrize('fidelity', ['condensed', 'kc', pytest.param('single_track', marks=pytest.mark.long)])
def test_its_levels_steer_as_it_does(fidelity: str) -> None:
    maneuver = {'steering': {'kind': 'step', 'value': 1.0, 'start': 0.2, 'rise': 0.3}}
    more = {'start': {'kind': 'equilibrium', 'speed': 15.0}, 'maneuver': maneuver, 'duration': 2.5}
    rates = []
    for level in ('full', fidelity):
        run = simulation_of(scene(off_roader(), fidelity=level, **more))
        run.advance(round(2.5 / run.h))
        shot = run.snapshot()
        rates.append(shot.twist[run.channels.chassis or 0, 5])
    assert rates[1] == pytest.approx(rates[0], rel=0.03)


REAR_RACK = {'rack': {'mass': 1, 'com': [-1.8, 0, 0.4], 'inertia': [0.01, 0.001, 0.01]}, 'per_turn': 0.02}


def _file(**front: Any) -> dict[str, Any]:
    vehicle = off_roader()
    vehicle['axles']['front']['suspension'] |= front
    return vehicle


PINS = yaml.safe_load(FRONT)['kingpins']


@pytest.mark.parametrize(
    ('vehicle', 'says'),
    [
        (_file(kingpins=None), 'live_axle.*is steered: it needs a .* live_axle with kingpins'),
        (_file(kingpins=PINS | {'upper': PINS['lower']}), 'upper.*must lie above lower'),
        (_file(kingpins=PINS | {'track_rod': [1.42, 0.0, 0.36]}), 'track_rod.*ball of the left side'),
        (_file(kingpins=PINS | {'drag_link_on': 'middle'}), 'drag_link_on = middle'),
        (off_roader(rear={'drive': {'kind': 'motors'}, 'rack': REAR_RACK}),
         'rack.*a live_axle like this one has no rod to it'),
        (off_roader() | {'steering': yaml.safe_load(BOX) | {'link_mass': 2.0}}, 'link_mass.*give both or neither'),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_by_name(vehicle: dict[str, Any], says: str) -> None:
    with pytest.raises(MbdError, match=f'(?s){says}'):
        scene(vehicle)


def test_a_multi_link_suspension_is_steered_by_its_tie_rod() -> None:
    """Of the electric car, the toe link on a rack that follows the steering wheel: travel over arm, both wheels to the
    same side."""
    root = read(find_file('electric_4wd', 'vehicles'), config_directories())
    builder = MechanismReader().builder()
    fields = builder.mapping(root, '')
    fields.pop('kind')
    data = builder.construct(Car, fields, root, '')
    rear = data.axles[1]
    assert isinstance(rear.suspension, MultiLink)
    assert rear.suspension.steering_arm() is None
    rod = dataclasses.replace(rear.suspension.links['toe_link'], bushing=None)
    links = {name: one for name, one in rear.suspension.links.items() if name != 'toe_link'}
    steered = dataclasses.replace(rear.suspension, links=links, tie_rod=rod)
    rack = FollowingRack(
        rack=Part(mass=0.8, com=(rod.inner[0], 0.0, rod.inner[2]), inertia=(0.01, 0.0004, 0.01)), per_turn=0.02
    )
    angle = 0.5
    travel = rack.per_turn * angle / (2.0 * np.pi)

    axle = dataclasses.replace(rear, suspension=steered, rack=rack)

    def toes(steering: float) -> np.ndarray:
        curves = Rig(car_model(dataclasses.replace(data, axles=(data.axles[0], axle)))).steering([steering])
        return np.array([curves[f'rear_{side}']['steer'][0] for side in ('left', 'right')])

    arm = steered.steering_arm()
    assert arm is not None and arm < 0.0  # behind the axis
    racked = toes(angle) - toes(0.0)
    assert racked[0] == pytest.approx(travel / arm, rel=0.1)  # its axis is not a line through two points
    assert racked[1] == pytest.approx(racked[0], rel=0.01)
