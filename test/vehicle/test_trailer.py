"""A trailer on a hitch: what it weighs and where, what the ball carries, turns, brakes, levels of detail, and what
cannot be."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from saloon import full_car
from towing import CARAVAN, FX, bodies_of_trailer, front_angle, mass_figures, single_track, steered, towing

import solver
from solver.analysis.figures import is_vehicle
from solver.analysis.reactions import joint_reaction
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.errors import SceneError, SpecError
from solver.files.mechanism import MechanismReader
from solver.files.scene import config_directories, find_file, load_scene, load_scene_text
from solver.files.urdf import spanning_tree
from solver.files.yaml_tree import read
from solver.levels import derive
from solver.levels.condensed import condensed
from solver.model.frames import matrix
from solver.scene import Scene, StartSettings
from solver.simulation import Simulation
from solver.vehicle.axle import Axle
from solver.vehicle.car import Car
from solver.vehicle.full_car import FullCar, full_car_model
from solver.vehicle.live_axle import LiveAxle
from solver.vehicle.trailer import Trailer, has_trailer, without_trailer
from solver.vehicle.trailing_arm import TrailingArm
from solver.vehicle.twist_beam import TwistBeam

CARS = ('light_car', 'full_car', 'compact_fwd', 'electric_4wd', 'pickup_awd')
G = 9.81
FZ = TIRE_COLUMNS.index('fz')
BRAKED = 'maneuver={brake_torque: 3000}'
HITCH = (-2.42, 0.0, 0.40)


def caravan() -> Trailer:
    """The data of config/vehicles/trailers/caravan.yaml."""
    root = read(find_file('trailers/caravan', 'vehicles'), config_directories())
    builder = MechanismReader().builder()
    return builder.construct(Trailer, builder.mapping(root, ''), root, '')


def pulling(trailer: Trailer) -> FullCar:
    """The saloon with a trailer."""
    return dataclasses.replace(full_car(), trailer=trailer, hitch=HITCH)


def loads(simulation: Simulation) -> dict[str, float]:
    """Load of every wheel [N]."""
    return dict(zip(simulation.channels.wheels, simulation.snapshot().tire[:, FZ].tolist(), strict=True))


@pytest.mark.parametrize('car', CARS)
def test_the_car_is_the_one_without_a_trailer(car: str) -> None:
    alone = load_scene_text(f'vehicle: vehicles/{car}.yaml\n', car).model
    model = towing(car).model
    assert has_trailer(model) and not has_trailer(alone)
    assert without_trailer(model) == alone
    assert len(model.bodies) == len(alone.bodies) + 5
    assert without_trailer(condensed(model)[0]) == condensed(alone)[0]


def test_seven_degrees_of_freedom_more() -> None:
    """Three of the ball, two travels, two wheels; the counts of the car itself: docs/vehicle.md."""
    counts = Simulation(towing('full_car')).describe()
    assert (counts['bodies'], counts['joints'], counts['dof']) == (53 + 5, 49 + 5, 134 + 7)
    assert counts['redundant_rows'] == []


@pytest.mark.parametrize('car', CARS)
def test_the_hitch_carries_what_the_lever_law_says(car: str) -> None:
    """At rest: the ball carries the moment of the trailer about its axle over the length of the drawbar, and shifts
    load from the front to the rear axle of the car. Within 2.5 % by the design position (the nose sinks in), to 0.1 %
    by where they stand."""
    simulation = Simulation(towing(car))
    shot = simulation.advance(1)
    model = simulation.model.spec
    wheels = loads(simulation)
    mass, com, _ = mass_figures(model, bodies_of_trailer(model))
    at = {body.name: body.position[0] for body in model.bodies}
    ball = next(joint.i.position[0] for joint in model.joints if joint.name == 'hitch')
    nose = mass * G * (com[0] - at['wheel_trailer_left']) / (ball - at['wheel_trailer_left'])
    reaction = joint_reaction(simulation, 'hitch')
    assert nose == pytest.approx(75.0 * G, rel=0.03)  # as the file says
    assert reaction.force[2] == pytest.approx(nose, rel=0.025)
    own = np.array([body.name in bodies_of_trailer(model) for body in model.bodies])
    weights = np.array([body.mass for body in model.bodies]) * G
    x = simulation.state.q[:-1, 0]
    contact = shot.tire[:, TIRE_COLUMNS.index('px')]
    stands = weights[own] @ (x[own] - contact[4]) / (reaction.point[0] - contact[4])
    assert reaction.force[2] == pytest.approx(stands, rel=1e-3)
    front, rear = wheels['front_left'] + wheels['front_right'], wheels['rear_left'] + wheels['rear_right']
    base = 0.5 * (contact[0] + contact[1] - contact[2] - contact[3])
    axle = 0.5 * (contact[2] + contact[3])
    alone = weights[~own] @ (x[~own] - axle) / base
    shifted = reaction.force[2] * (axle - reaction.point[0]) / base
    assert (front, rear) == pytest.approx(
        (alone - shifted, weights[~own].sum() - alone + reaction.force[2] + shifted), rel=1e-3
    )


@pytest.mark.parametrize('car', CARS)
def test_the_wheels_carry_all_the_weight(car: str) -> None:
    """Braked, to rounding; those of the trailer and the ball that of the trailer."""
    simulation = Simulation(towing(car, BRAKED))
    simulation.advance(1)
    model = simulation.model.spec
    wheels = loads(simulation)
    assert sum(wheels.values()) == pytest.approx(G * sum(body.mass for body in model.bodies), rel=1e-9)
    mass, _, _ = mass_figures(model, bodies_of_trailer(model))
    carried = wheels['trailer_left'] + wheels['trailer_right'] + joint_reaction(simulation, 'hitch').force[2]
    assert carried == pytest.approx(mass * G, rel=1e-7)


@pytest.mark.parametrize('speed', [0.0, 25.0])
def test_a_symmetric_car_with_a_symmetric_trailer_stays_so(speed: float) -> None:
    simulation = Simulation(towing('light_car', speed=speed))
    for steps in (1, 500):
        shot = simulation.advance(steps)
        assert shot.tire[::2, FZ] == pytest.approx(shot.tire[1::2, FZ], rel=1e-7)
        assert abs(shot.joint_position[simulation.channels.joints.index('articulation')]) < 1e-8


@pytest.mark.parametrize('slope', [(0.1, 0.0), (-0.1, 0.0), (0.0, 0.1)])
def test_car_and_trailer_stand_on_a_slope(slope: tuple[float, float]) -> None:
    """Braked by all wheels: tire forces are the weight; nothing moves. And at speed every wheel is loaded."""
    normal = f'road={{normal: [{-slope[0]}, {-slope[1]}, 1]}}'
    simulation = Simulation(towing('full_car', normal, BRAKED))
    shot = simulation.advance(500)
    weight = G * sum(body.mass for body in simulation.model.spec.bodies)
    assert shot.tire[:, FZ].sum() * np.hypot(1.0, 0.1) == pytest.approx(weight, rel=1e-7)
    assert np.abs(shot.twist[:, :3]).max() < 1e-6
    assert loads(Simulation(towing('full_car', normal, speed=20.0)))['trailer_left'] > 4000.0


@pytest.mark.long
@pytest.mark.slow
def test_it_starts_rolling_whatever_the_friction() -> None:
    """The ball joins two bodies of more than a ton: velocities of the start did not converge at some of these
    frictions."""
    for friction in (0.96, 0.9, 0.8, 0.7, 0.6, 0.5):
        simulation = Simulation(load_scene('saloon_with_trailer', [f'road={{friction: {friction}}}']))
        assert simulation.advance(1).twist[simulation.channels.chassis or 0, 0] == pytest.approx(25.0, abs=0.01)


def test_stability_control_and_anti_lock_work_with_a_trailer() -> None:
    """Full braking from 90 km/h: without them the wheels of front axle and trailer lock within 0.4 s."""
    slips = {}
    for assistance in ('{}', '{anti_lock: {}, stability: {wheelbase: 2.75, ratio: 16.7}}'):
        braked = 'maneuver={brake_torque: {kind: step, value: 5500, start: 0.2, rise: 0.2}}'
        simulation = Simulation(
            towing('full_car', 'actuation={wheels: true}', f'assistance={assistance}', braked, speed=25.0)
        )
        shots = [simulation.advance(5) for _ in range(80)]
        slips[assistance] = np.min([shot.tire[4:, TIRE_COLUMNS.index('kappa')] for shot in shots])
    free, controlled = slips.values()
    assert free < -0.95 and controlled > -0.5


@pytest.mark.long
@pytest.mark.slow
def test_at_walking_pace_the_trailer_follows_by_geometry() -> None:
    """Wheels without slip: with the middle of the turn on the line of the rear axle, R to its side, the ball runs on a
    circle of sqrt(R^2 + c^2) and the axle of the trailer on one of sqrt(R^2 + c^2 - l^2); the articulation is atan(c/R)
    + asin(l/sqrt(R^2 + c^2))."""
    simulation = Simulation(towing('light_car', speed=1.5, steering='{kind: step, value: 4.0, start: 0.5, rise: 3}'))
    shot = simulation.advance(round(40.0 / simulation.h))
    names = simulation.channels
    u, v, r = shot.twist[names.chassis or 0][[0, 1, 5]]
    rear, ball, drawbar = -1.325, 2.20 - 1.325, 3.90
    assert abs(v + rear * r) < 0.01 * u
    R = u / r
    assert 9.0 < R < 14.0
    angle = -(np.arctan(ball / R) + np.arcsin(drawbar / np.hypot(R, ball)))
    assert shot.joint_position[names.joints.index('articulation')] == pytest.approx(angle, rel=0.01)
    k = names.bodies.index('trailer')
    speed = np.hypot(*shot.twist[k, :2])  # its frame is on the ground below the axle
    assert speed / shot.twist[k, 5] == pytest.approx(np.sqrt(R * R + ball**2 - drawbar**2), rel=0.01)


@pytest.mark.slow
def test_a_steady_turn_is_that_of_the_linear_single_track() -> None:
    """At 20 m/s and 1 m/s^2, from the angle of the front wheels alone: yaw rate, articulation, and how axles run
    sideways."""
    u, angle = 20.0, 0.17
    track = single_track('light_car', u)
    scene = towing('light_car', speed=u, steering=steered(angle))
    simulation = Simulation(scene)
    shot = simulation.advance(round(12.0 / simulation.h))
    v, r, g, _ = track.steady(u, front_angle(scene, angle))
    forward, lateral, yaw = shot.twist[simulation.channels.chassis or 0][[0, 1, 5]]
    found = shot.joint_position[simulation.channels.joints.index('articulation')]
    assert forward * yaw == pytest.approx(1.0, rel=0.1)
    assert (yaw, found) == pytest.approx((r, g), rel=0.02)
    assert lateral + track.x * yaw == pytest.approx(v, abs=0.01)
    # sideways angle at which each axle runs: that of the trailer by as much more outwards as its tires slip more
    rear = (lateral + (track.x - track.b) * yaw) / forward
    behind = (lateral + (track.x - track.h - track.l) * yaw) / forward - found
    assert (rear, behind) == pytest.approx(tuple(-track.slip(u)[1:] @ np.array([v, r, g, 0.0])), rel=0.03)


def test_the_ball_gives_the_trailer_its_momentum_and_takes_it_from_the_car() -> None:
    """Braking in a bend, without air: tire forces, weight and the force of the ball are the change of momentum of the
    trailer; with the opposite force of that of the car (central differences over 2 ms)."""
    brakes = '{kind: step, value: 1500, start: 0.3, rise: 0.2}'
    maneuver = f'maneuver={{steering: {{kind: step, value: 0.8, start: 0.1, rise: 0.3}}, brake_torque: {brakes}}}'
    still = ('vehicle.aero=null', 'vehicle.trailer.aero=null')
    simulation = Simulation(towing('light_car', maneuver, *still, speed=20.0, h=1e-3))
    model = simulation.model.spec
    trailer = np.array([body.name in bodies_of_trailer(model) for body in model.bodies])
    mass = np.array([body.mass for body in model.bodies])

    def momenta() -> np.ndarray:
        weighted = mass[:, None] * simulation.state.v[:-1, :3]
        return np.array([weighted[trailer].sum(axis=0), weighted[~trailer].sum(axis=0)])

    simulation.advance(699)
    before = momenta()
    shot = simulation.advance(1)
    ball = joint_reaction(simulation, 'hitch').force
    simulation.advance(1)
    change = (momenta() - before) / 2e-3
    columns = [TIRE_COLUMNS.index(name) for name in ('qx', 'qy', 'qz', 'qw')]
    tires = np.array([matrix(tuple(row[columns])) @ row[:3] for row in shot.tire])
    weight = np.array([0.0, 0.0, -G])
    outside = (
        tires[4:].sum(axis=0) + mass[trailer].sum() * weight,
        tires[:4].sum(axis=0) + mass[~trailer].sum() * weight,
    )
    assert np.linalg.norm(ball[:2]) > 400.0
    assert outside[0] + ball == pytest.approx(change[0], abs=5.0)
    assert outside[1] - ball == pytest.approx(change[1], abs=5.0)


def test_its_brakes_take_their_share() -> None:
    """At 0.4 g the ball pushes with what the brakes of the trailer lack; without them with the whole force that
    decelerates it."""
    forces = {}
    for share in (0.32, 0.0):
        change = (f'vehicle.trailer.axles.axle.suspension.brake.share={share}', 'maneuver={brake_torque: 2000}')
        simulation = Simulation(towing('full_car', *change, speed=25.0))
        shot = simulation.advance(500)
        forces[share] = joint_reaction(simulation, 'hitch').force[0]
        deceleration = -(simulation.advance(1).twist[0, 0] - shot.twist[0, 0]) / simulation.h
        braked = -shot.tire[4:, FX].sum()
        drag = 0.5 * 1.2 * 1.6 * shot.twist[0, 0] ** 2
        # forwards on the trailer
        assert forces[share] == pytest.approx(braked + drag - 1300.0 * deceleration, abs=60.0)
    assert abs(forces[0.32]) < 0.25 * abs(forces[0.0])


def test_the_energy_account_closes_with_the_square_of_the_step() -> None:
    def error(h: float) -> float:
        sine = '{kind: sine, amplitude: 0.6, frequency: 1.0, start: 0.2, cycles: 1}'
        simulation = Simulation(
            towing(
                'light_car', 'vehicle.trailer.stabilizer={friction: 200, damping: 500}', speed=25.0, h=h, steering=sine
            )
        )
        simulation.advance(round(2.0 / h))
        return simulation.totals()['energy_error_max']

    coarse, fine = error(2e-3), error(1e-3)
    assert fine < 1.0  # of 850 kJ
    assert coarse > 2.5 * fine


def test_a_friction_stabilizer_resists_with_its_torque_and_stays_stuck_below_it() -> None:
    pads = ('vehicle.trailer.stabilizer={friction: 300}',)
    simulation = Simulation(
        towing('light_car', *pads, speed=22.0, steering='{kind: sine, amplitude: 0.7, frequency: 0.7, start: 0.2}')
    )
    place = simulation.channels.joints.index('articulation')
    column = simulation.channels.elements.index('hitch_friction/force')
    shots = [simulation.advance(5) for _ in range(300)]
    rate = np.array([shot.joint_velocity[place] for shot in shots])
    torque = np.array([shot.elements[column] for shot in shots])
    fast = np.abs(rate) > 0.005
    assert fast.any() and np.abs(torque).max() <= 300.0 * (1.0 + 1e-12)
    assert torque[fast] == pytest.approx(-300.0 * np.sign(rate[fast]))


def behind(data, by: float):
    """Data of a suspension with all points moved along x [m]."""
    if type(data) is tuple and len(data) == 3 and all(isinstance(c, float) for c in data):
        return data[0] + by, data[1], data[2]
    if type(data) is tuple:
        return tuple(behind(item, by) for item in data)
    if dataclasses.is_dataclass(data) and not isinstance(data, type):
        own = ('tire', 'brake', 'bushing', 'eye', 'pin', 'inertia', 'products', 'law', 'stops')
        return dataclasses.replace(
            data, **{f.name: behind(getattr(data, f.name), by) for f in dataclasses.fields(data) if f.name not in own}
        )
    return data


def rear_of(car: str):
    """The rear suspension of a delivered car, below the origin."""
    root = read(find_file(car, 'vehicles'), config_directories())
    builder = MechanismReader().builder()
    fields = builder.mapping(root, '')
    fields.pop('kind')
    suspension = builder.construct(Car, fields, root, '').axles[1].suspension
    return behind(suspension, -suspension.wheel.center[0])


def test_two_axles_share_the_load() -> None:
    """A tandem of two trailing arms 0.8 m apart: four wheels by their names, and a quarter of the load each, near
    enough."""
    data = caravan()
    arm = data.axles[0].suspension
    assert isinstance(arm, TrailingArm)
    arm = dataclasses.replace(arm, spring=dataclasses.replace(arm.spring, load=2800.0))
    axles = tuple(Axle(name=name, suspension=behind(arm, by)) for name, by in (('front', 0.4), ('rear', -0.4)))
    model = full_car_model(pulling(dataclasses.replace(data, axles=axles)))
    simulation = Simulation(Scene(name='tandem', model=model, start=StartSettings(kind='equilibrium', speed=20.0)))
    simulation.advance(500)
    wheels = loads(simulation)
    own = [f'trailer_{axle}_{side}' for axle in ('front', 'rear') for side in ('left', 'right')]
    assert set(own) < set(wheels)
    assert [wheels[name] for name in own] == pytest.approx([3000.0] * 4, rel=0.15)
    assert without_trailer(model) == full_car_model(full_car())


@pytest.mark.parametrize(('car', 'kind'), [('pickup_awd', LiveAxle), ('compact_fwd', TwistBeam)])
def test_any_suspension_carries_a_trailer(car: str, kind: type) -> None:
    suspension = rear_of(car)
    assert isinstance(suspension, kind)
    data = dataclasses.replace(caravan(), axles=(Axle(name='axle', suspension=suspension),))
    data = dataclasses.replace(data, chassis=dataclasses.replace(data.chassis, mass=600.0))
    model = full_car_model(dataclasses.replace(full_car(), trailer=data, hitch=(*HITCH[:2], 0.45)))
    simulation = Simulation(Scene(name='towing', model=model, start=StartSettings(kind='equilibrium', speed=15.0)))
    shot = simulation.advance(500)
    assert shot.tire[4:, FZ] == pytest.approx(G * 700.0 / 2.0, rel=0.2)
    assert abs(shot.joint_position[simulation.channels.joints.index('articulation')]) < 5e-3


def test_wheels_are_named_in_topics_and_in_the_tree_of_links() -> None:
    simulation = Simulation(towing('full_car', 'actuation={wheels: true}'))
    assert simulation.channels.wheels[-2:] == ('trailer_left', 'trailer_right')
    assert 'brake_torque_trailer_left' in simulation.channels.inputs
    tree = {child: (parent, edge.name) for parent, child, edge in spanning_tree(simulation.model.spec, 'chassis')}
    assert tree['trailer'] == ('chassis', 'articulation')
    assert tree['wheel_trailer_left'] == ('upright_trailer_left', 'wheel_trailer_left')
    assert not is_vehicle(simulation.model.spec)  # its figures are those of cars


@pytest.mark.long
@pytest.mark.slow
def test_condensed_has_it_and_the_levels_without_bodies_say_no() -> None:
    sine = '{kind: sine, amplitude: 0.6, frequency: 1.0, start: 0.2, cycles: 0.5}'
    angles = {}
    for fidelity in ('full', 'condensed'):
        simulation = solver.simulation_of(towing('full_car', f'fidelity={fidelity}', speed=25.0, steering=sine))
        place = simulation.channels.joints.index('articulation')
        angles[fidelity] = np.array([simulation.advance(10).joint_position[place] for _ in range(150)])
    assert np.abs(angles['full']).max() > 0.03
    assert angles['condensed'] == pytest.approx(angles['full'], abs=0.03 * np.abs(angles['full']).max())
    for fidelity in ('kc', 'single_track'):
        with pytest.raises(SceneError, match='pulls a trailer, which this level does not have; use condensed or full'):
            derive(towing('full_car', f'fidelity={fidelity}', speed=25.0))


@pytest.mark.slow
def test_the_impulse_of_the_scene_swings_out() -> None:
    """One impulse of the steering wheel: the trailer swings at 0.7 Hz, each time half as far as before or less."""
    scene = load_scene('saloon_with_trailer')
    simulation = Simulation(scene)
    place = simulation.channels.joints.index('articulation')
    y = np.array([simulation.advance(10).joint_position[place] for _ in range(scene.steps // 10)])
    peaks = [k for k in range(1, len(y) - 1) if abs(y[k]) > max(abs(y[k - 1]), abs(y[k + 1])) and abs(y[k]) > 2e-3]
    sizes = np.abs(y[peaks])[1:5]
    assert np.deg2rad(1.0) < sizes[0] < np.deg2rad(6.0)
    assert (sizes[1:] < 0.65 * sizes[:-1]).all()
    assert 0.5 / (0.01 * np.diff(peaks)[1:4].mean()) == pytest.approx(0.72, abs=0.05)


def test_a_trailer_beside_the_vehicle_is_the_one_in_it() -> None:
    head = 'vehicle: vehicles/light_car.yaml\n'
    file = 'trailer: vehicles/trailers/caravan.yaml\n'
    assert load_scene_text(head + file, 'beside').model == load_scene_text(head, 'in it', [CARAVAN]).model
    for own, beside, says in (
        (CARAVAN, file, r'the vehicle has one \(.*caravan.yaml:\d+\), and the scene gives another one'),
        (CARAVAN, 'trailer: null\n', 'the vehicle has one .*, and the scene gives none'),
        ('vehicle.trailer=null', file, r'says that it has none \(vehicle.trailer: null\), and the scene gives one'),
    ):
        with pytest.raises(SceneError, match=says):
            load_scene_text(head + beside, 'two keys', [own])
    assert (
        load_scene_text(head + 'trailer: null\n', 'none', ['vehicle.trailer=null']).model == load_scene_text(head).model
    )
    with pytest.raises(SceneError, match='only a vehicle pulls one'):
        load_scene_text('mechanism: mechanisms/pendulum.yaml\n' + file, 'pendulum')


@pytest.mark.parametrize(
    ('change', 'says'),
    [
        ('vehicle.hitch=null', 'hitch = None: is missing: a trailer needs the centre of the ball'),
        ('vehicle.hitch=[-2.4, 0, 0.9]', 'is 0.5 m above the coupling of the trailer; 0.1 m are bridged at most'),
        ('vehicle.hitch=[-2.4, 0.2, 0.4]', 'must lie in the middle, y = 0'),
        ('vehicle.hitch=[3, 0, 0.4]', 'puts its first axle ahead of the last axle of the car'),
        ('vehicle.trailer.coupling=[-1, 0, 0.4]', 'must lie ahead of the first axle, x = 0 m'),
        ('vehicle.trailer.axles={}', 'one or two of them'),
        ('vehicle.trailer.axles.axle.suspension.kind=sliding_pillar', 'unknown kind'),
        ('vehicle.trailer.axles.axle.drive={kind: motors}', 'is not driven: remove its drive'),
        (
            'vehicle.trailer.axles.axle.rack={rack: {mass: 1, com: [0, 0, 0.3], inertia: [1, 1, 1]}, per_turn: 0.01}',
            'is not steered: remove its rack',
        ),
        ('vehicle.trailer.stabilizer={friction: -1}', 'friction'),
        ('vehicle.trailer.mass=1300', 'unknown key'),
    ],
)
def test_trailers_that_cannot_be(change: str, says: str) -> None:
    with pytest.raises((SceneError, SpecError), match=says) as refused:
        towing('full_car', change)
    assert '\n' not in str(refused.value)
