"""Cars put together from axles: what they consist of, their design position and figures, and where they stand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from saloon import without_bushings

from solver.analysis.figures import figures, standing
from solver.analysis.kinematics_and_compliance import Rig, kinematic_figures
from solver.analysis.typical_values import typical_values
from solver.errors import SpecError
from solver.files.mechanism import MechanismReader
from solver.files.scene import config_directories, find_file, load_scene_text
from solver.files.yaml_tree import read
from solver.model.evaluate import prepare
from solver.scene import Scene, StartSettings
from solver.simulation import Simulation
from solver.start.newton import ConsistentState
from solver.vehicle.axle import Axle, FollowingRack
from solver.vehicle.car import Car, car_model
from solver.vehicle.double_wishbone import DoubleWishbone
from solver.vehicle.live_axle import LiveAxle
from solver.vehicle.parts import Part
from solver.vehicle.twist_beam import TwistBeam
from solver.vehicle.wheel_end import spin_axis

CARS = ('compact_fwd', 'pickup_awd', 'electric_4wd', 'formula_student')
EVERY = (*CARS, 'light_car')
SLOPE = float(np.arctan(0.4))


def car(name: str) -> Car:
    """The data of config/vehicles/<name>.yaml."""
    root = read(find_file(name, 'vehicles'), config_directories())
    builder = MechanismReader().builder()
    fields = builder.mapping(root, '')
    fields.pop('kind')
    return builder.construct(Car, fields, root, '')


def scene(name: str, *changes: str) -> Scene:
    return load_scene_text(f'vehicle: vehicles/{name}.yaml\nstart: {{kind: equilibrium}}\n', name, changes)


@pytest.mark.parametrize('name', CARS)
def test_design_position_closes_every_joint(name: str) -> None:
    model = prepare(car_model(car(name)))
    start = ConsistentState(model)
    state = Simulation(Scene(name=name, model=model.spec)).state
    start._constraints(state.q, state.v, state.angle, np.zeros(len(model.spec.inputs)))
    assert np.abs(start.phi).max() < 1e-14


# Counted by hand with ideal joints, rack and wheels included: chassis 6, wheel spins 4, rack against its elastic pinion
# 1, and
CASES = {
    'compact_fwd': 4,  # four travels (bump and roll of the beam are two)
    # two travels in front, the differential's housing none; the axle on leaf hinges moves by 6, each hinge lets its
    # half leaf move by 1 in the plane of its eye (4), and the propeller shaft turns against the elastic final drive (1)
    'pickup_awd': None,
    'electric_4wd': 4,
    'formula_student': 4,
}


@pytest.mark.parametrize('name', [name for name, travels in CASES.items() if travels])
def test_ideal_joints_leave_the_degrees_of_freedom_counted_by_hand(name: str) -> None:
    counts = Simulation(Scene(name='ideal', model=car_model(without_bushings(car(name))))).describe()
    assert counts['bushings'] == 0
    assert counts['redundant_rows'] == []
    assert counts['dof'] == 6 + 4 + 1 + CASES[name]


def test_every_delivered_car_stands_at_its_design_height_with_its_weight_on_the_tires() -> None:
    for name in EVERY:
        simulation = standing(scene(name))
        shot = simulation.advance(1)
        loads = dict(zip(simulation.channels.wheels, shot.tire[:, 2], strict=True))
        mass = sum(body.mass for body in simulation.model.spec.bodies)
        assert sum(loads.values()) == pytest.approx(9.81 * mass, rel=2e-3), name
        for axle in ('front', 'rear'):  # the steering column is on one side
            assert loads[f'{axle}_left'] == pytest.approx(loads[f'{axle}_right'], rel=0.02), name


@pytest.mark.slow
@pytest.mark.parametrize('name', EVERY)
def test_figures_lie_where_those_of_its_category_do(name: str) -> None:
    simulation = standing(scene(name))
    found = figures(simulation)
    ranges = typical_values(simulation.model.spec)
    outside = {
        key: found[key] for key, where in ranges.items() if key in found and not where.low <= found[key] <= where.high
    }
    assert outside == {}


@pytest.mark.slow
@pytest.mark.parametrize('name', EVERY)
# 270 is the mirror image of 90
@pytest.mark.parametrize('heading', [0, 90, 180, pytest.param(270, marks=pytest.mark.long)])
def test_cars_stand_on_a_slope_of_forty_percent(name: str, heading: int) -> None:
    """Braked, in all four directions: every tire loaded, its forces carrying the weight along and across the slope."""
    uphill = np.deg2rad(heading)
    normal = (-np.sin(SLOPE) * np.cos(uphill), -np.sin(SLOPE) * np.sin(uphill), np.cos(SLOPE))
    simulation = Simulation(
        scene(name, f'road={{normal: {[float(x) for x in normal]}}}', 'maneuver={brake_torque: 6000}')
    )
    shot = simulation.advance(1)
    assert shot.tire[:, 2].min() > 0.0
    mass = sum(body.mass for body in simulation.model.spec.bodies)
    assert shot.tire[:, 2].sum() == pytest.approx(9.81 * mass * np.cos(SLOPE), rel=5e-3)


def test_a_twist_beam_turns_about_its_pivots_in_bump_and_about_the_shear_centre_in_roll() -> None:
    """The rates of camber and toe in roll are those of a rotation about the line from pivot to shear centre, to first
    order.

    Ideal joints; the torsion spring then makes the roll stiffness alone what the coil springs do not.
    """
    data = without_bushings(car('compact_fwd'))
    rear = data.axles[1].suspension
    assert isinstance(rear, TwistBeam)
    rig = Rig(car_model(data))
    step = 1e-3
    low, high = (rig.travel([s * step], opposite=True)['rear_left'] for s in (-1.0, 1.0))
    bump = [rig.travel([s * step])['rear_left'] for s in (-1.0, 1.0)]
    pivot, center, wheel = (np.array(p) for p in (rear.pivot, rear.shear_center, rear.wheel.center))
    axis = (center - pivot) / np.linalg.norm(center - pivot)
    rate = axis / np.cross(axis, wheel - pivot)[2]  # rotation vector per metre of travel in roll
    spin = np.array(spin_axis(rear.wheel.body('wheel', 'left')))
    turned = np.cross(rate, spin)  # of the spin axis of the left wheel
    steer = (high['steer'][0] - low['steer'][0]) / (2 * step)
    camber = (high['camber'][0] - low['camber'][0]) / (2 * step)
    assert steer == pytest.approx(-turned[0], rel=0.02)
    assert abs(camber) == pytest.approx(abs(turned[2]), rel=0.02)
    # In a bend to the left the car rolls to the right, so the left wheel drops, by half the track per radian: the axle
    # steers to the left, into the bend, which the figure counts as positive.
    to_the_left = -turned[0] * -wheel[1]
    assert to_the_left > 0.0
    assert kinematic_figures(rig, step)['roll_steer_rear'] == pytest.approx(to_the_left, rel=0.02)
    for key in ('steer', 'camber'):
        # about the line across through both pivots, toe and camber of a wheel that has none would not change
        assert abs(bump[1][key][0] - bump[0][key][0]) / (2 * step) < 0.1


def test_the_rate_of_a_leaf_spring_is_the_one_in_its_data() -> None:
    """Wheel rate of the pickup's rear axle: leaf and tilted, fixed eyes; within the share that shackle and bushings
    take."""
    data = car('pickup_awd')
    rear = data.axles[1].suspension
    assert isinstance(rear, LiveAxle) and rear.leaf is not None
    rig = Rig(car_model(data))
    low, high = (rig.travel([s * 2e-3])['rear_left']['load'][0] for s in (-1.0, 1.0))
    assert (high - low) / 4e-3 == pytest.approx(rear.leaf.rate, rel=0.1)


def test_both_sides_may_be_given() -> None:
    """The right side from data of its own: the same data make the same car; others change that side alone."""
    data = car('compact_fwd')
    front = data.axles[0]
    assert front.right is None
    same = dataclasses.replace(data, axles=(dataclasses.replace(front, right=front.suspension), data.axles[1]))
    assert car_model(same) == car_model(data)
    heavier = dataclasses.replace(front.suspension, wheel=dataclasses.replace(front.suspension.wheel, mass=25.0))
    other = car_model(dataclasses.replace(data, axles=(dataclasses.replace(front, right=heavier), data.axles[1])))
    changed = [a.name for a, b in zip(other.bodies, car_model(data).bodies, strict=True) if a != b]
    assert changed == ['wheel_front_right']


def test_a_rear_rack_follows_the_steering_wheel() -> None:
    """Rear steering against the front: per turn of the steering wheel the rack travels what the data say, and the
    wheels turn."""
    data = car('formula_student')
    rear = data.axles[1]
    assert isinstance(rear.suspension, DoubleWishbone)
    inner = rear.suspension.tie_rod.inner
    rack = FollowingRack(
        rack=Part(mass=0.8, com=(inner[0], 0.0, inner[2]), inertia=(0.01, 0.0004, 0.01)), per_turn=0.02
    )
    steered = dataclasses.replace(data, axles=(data.axles[0], dataclasses.replace(rear, rack=rack)))
    angle = 0.5
    rig = Rig(car_model(steered))
    curves = rig.steering([angle])
    moved = 0.02 * angle / (2.0 * np.pi)
    arm = rear.suspension.steering_arm()  # of the toe link: negative, behind the axis
    assert curves['rear_left']['steer'][0] - rig.steering([0.0])['rear_left']['steer'][0] == pytest.approx(
        moved / arm, rel=0.02
    )


def test_a_car_with_three_axles_drives() -> None:
    """The pickup with a second, undriven live axle behind: all six tires carry, together the weight, and it rolls
    straight on."""
    data = car('pickup_awd')
    driven = data.axles[1]
    rear = driven.suspension
    assert isinstance(rear, LiveAxle) and rear.leaf is not None

    def behind(point: tuple[float, ...]) -> tuple[float, float, float]:
        return point[0] - 1.1, point[1], point[2]

    leaf = dataclasses.replace(
        rear.leaf, **{key: behind(getattr(rear.leaf, key)) for key in ('front_eye', 'rear_eye', 'seat', 'shackle')}
    )
    brake = dataclasses.replace(rear.brake, share=0.5 * rear.brake.share)
    tag = dataclasses.replace(
        rear, leaf=leaf, brake=brake, wheel=dataclasses.replace(rear.wheel, center=behind(rear.wheel.center)),
        housing=dataclasses.replace(rear.housing, com=behind(rear.housing.com)),
        damper_chassis=behind(rear.damper_chassis), damper_axle=behind(rear.damper_axle),
    )  # fmt: skip
    first = dataclasses.replace(driven, suspension=dataclasses.replace(rear, brake=brake))
    model = car_model(dataclasses.replace(data, axles=(data.axles[0], first, Axle(name='tag', suspension=tag))))
    simulation = Simulation(Scene(name='three axles', model=model, start=StartSettings(kind='equilibrium', speed=15.0)))
    loads = simulation.advance(200).tire[:, 2]
    assert len(loads) == 6 and loads.min() > 1000.0
    assert loads.sum() == pytest.approx(9.81 * sum(body.mass for body in model.bodies), rel=5e-3)
    assert abs(simulation.snapshot().twist[simulation.channels.chassis or 0, 5]) < 1e-3


@pytest.mark.parametrize(
    ('change', 'says'),
    [
        (lambda c: {'axles': c.axles[:1]}, 'two to four'),
        (lambda c: {'axles': c.axles[::-1]}, 'front to rear'),
        (lambda c: {'axles': (c.axles[0], c.axles[0])}, 'one behind the other'),
        (lambda c: {'axles': (dataclasses.replace(c.axles[0], drive=None), c.axles[1])}, 'no axle is driven'),
        (lambda c: {'engine': None}, 'has none: add it'),
    ],
)
def test_cars_that_cannot_be(change, says: str) -> None:
    data = car('compact_fwd')
    with pytest.raises(SpecError, match=says):
        car_model(dataclasses.replace(data, **change(data)))


def test_a_limited_slip_takes_from_the_faster_output_what_it_gives_to_the_slower_one() -> None:
    """Compact on ice at its right wheels, 12 N m s/rad: each output has half of the drive torque and that times the
    difference of their speeds, one more and one less, so their torques differ by twice of it."""
    changes = (
        'start.speed=5',
        'maneuver={drive_torque: 800}',
        'road={patches: [{center: [40, -3], size: [200, 6], factor: 0.05}]}',
        'vehicle.axles.front.drive.limited_slip=[[-50, -600], [0, 0], [50, 600]]',
    )
    driven = Simulation(scene('compact_fwd', *changes))
    shot = driven.advance(500)
    outputs = [driven.channels.joints.index(f'output_shaft_front_{side}/angle') for side in ('left', 'right')]
    left, right = shot.joint_effort[outputs]
    slower, faster = shot.joint_velocity[outputs]
    assert faster - slower > 5.0
    assert left - 400.0 == pytest.approx(12.0 * (faster - slower), rel=1e-6)
    assert right - 400.0 == pytest.approx(-12.0 * (faster - slower), rel=1e-6)
