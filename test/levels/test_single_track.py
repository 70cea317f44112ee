"""The level `single_track` beside the whole vehicle: errors, steady figures, what it says of itself, for three cars."""

from __future__ import annotations

import dataclasses
import functools
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from saloon import double_wishbones

import solver
from solver.analysis.envelope import Envelope
from solver.analysis.kinematics_and_compliance import Rig
from solver.analysis.verdict import findings
from solver.elements.rigid_body import RigidBodySpec
from solver.elements.road_grids import Raster
from solver.errors import SceneError
from solver.files.scene import load_scene, load_scene_text
from solver.inputs.maneuver import Maneuver
from solver.inputs.signals import Ramp, Sine, Step
from solver.levels import derive
from solver.levels.error_sheet import course_scene, courses, error_sheet
from solver.levels.single_track import LIFTED, unlifted
from solver.levels.single_track_engine import SingleTrack
from solver.levels.track_bends import Lateral, slowest_pressed
from solver.levels.track_bulk import top_spin
from solver.levels.track_straight import gear, straight
from solver.levels.track_tables import SingleTrackTables
from solver.model.spec import ModelSpec
from solver.quantities import quantity
from solver.scene import Scene, StartSettings
from solver.vehicle.full_car import full_car_model

SLOW_RAMP = Maneuver(steering=Ramp(slope=0.2, start=0.5), drive_torque=150.0)
ROOT = Path(__file__).parents[2]
CARS = ('full car', 'light car', 'double wishbones')
CASES = [pytest.param(car, marks=pytest.mark.long if car == 'double wishbones' else ()) for car in CARS]


@functools.cache
def model(car: str) -> ModelSpec:
    if car == 'double wishbones':
        return full_car_model(double_wishbones())
    return load_scene({'full car': 'car_step_steer', 'light car': 'light_car_step_steer'}[car]).model


def scene(car: str, maneuver: Maneuver, *, speed: float = 22.0, duration: float = 5.0) -> Scene:
    start = StartSettings(kind='equilibrium', speed=speed)
    return Scene(
        name='track', model=model(car), maneuver=maneuver, start=start, duration=duration, fidelity='single_track'
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    'car', [pytest.param(car, marks=() if car == 'light car' else pytest.mark.long) for car in CARS]
)
def test_errors_against_the_whole_vehicle(car: str) -> None:
    """Root mean squares over the peak: yaw rate below 5 % up to 0.5 g, and with three times the reference angle."""
    sheet = {(f.maneuver, f.quantity): f for f in error_sheet(model(car), 'single_track')}
    for maneuver in ('step steer 0.4 g', 'swept sine 0.3 g', 'sine with dwell 3 A'):
        assert sheet[maneuver, 'yaw_rate'].rms < 0.05, maneuver
        assert sheet[maneuver, 'sideslip_velocity'].rms < 0.06, maneuver
    assert sheet['braking 0.5 g', 'longitudinal_velocity'].rms < 0.005
    assert not any(quantity == 'wheel_load' for _, quantity in sheet)


@pytest.mark.slow
@pytest.mark.parametrize(('name', 'torque'), [('drive_torque', 600.0), ('brake_torque', 1200.0)])
def test_it_pitches_under_drive_and_under_brakes_by_what_the_whole_vehicle_does(name: str, torque: float) -> None:
    """When it has settled, within 5 % of the change: suspensions lift the body by other forces where they drive than
    where they brake."""
    maneuver = Maneuver(**{name: Step(value=torque, start=0.2, rise=0.3)})
    changes = []
    for level in ('single_track', 'full'):
        simulation = solver.simulation_of(dataclasses.replace(scene('light car', maneuver), fidelity=level))
        pitch = quantity('pitch', simulation.channels)
        rows = np.array([simulation.snapshot().numbers, simulation.advance(round(2.5 / simulation.h)).numbers])
        before, after = pitch.of(rows[:, pitch.places])[:, 0]
        changes.append(after - before)
    assert changes[0] == pytest.approx(changes[1], rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize('car', CASES)
def test_understeer_and_mass_are_those_of_the_whole_vehicle(car: str) -> None:
    """Gradient of the slow ramp of ISO 4138, and what is conserved exactly."""
    simulation = solver.simulation_of(scene(car, Maneuver()))
    engine = simulation.engine
    assert isinstance(engine, SingleTrack)
    t = engine.tables.value
    assert t.body.mass == pytest.approx(sum(b.mass for b in model(car).bodies), rel=1e-12)
    assert t.front.load + t.rear.load == pytest.approx(t.body.mass * 9.81, rel=1e-3)
    assert t.front.load * t.front.x == pytest.approx(-t.rear.load * t.rear.x, rel=1e-2)  # at speed, not at rest
    assert t.front.brake + t.rear.brake == pytest.approx(1.0, abs=0.02)
    assert t.front.drive + t.rear.drive == pytest.approx(1.0, abs=0.02)
    level, whole = (
        gradient(dataclasses.replace(scene(car, SLOW_RAMP), fidelity=each), t) for each in ('single_track', 'full')
    )
    assert level == pytest.approx(whole, abs=2e-4)
    assert whole > 1e-3


@pytest.mark.slow
def test_brakes_slow_down_what_turns_with_the_wheels_too() -> None:
    """Four rotors of 0.02 kg m^2 that turn 9 times as fast have 6.5 kg m^2, and took 3.5 % of what the brakes of the
    level did."""
    rotors = [f'vehicle.axles.{axle}.drive.rotor={{inertia: 0.02, ratio: 9}}' for axle in ('front', 'rear')]
    electric = load_scene('car_step_steer', ['vehicle=vehicles/electric_4wd.yaml', *rotors]).model
    axles, _, _ = straight(electric, sum(b.mass for b in electric.bodies))
    assert axles['front']['inertia'] + axles['rear']['inertia'] == pytest.approx(
        2.0 * (1.0 + 0.95) + 4 * 0.02 * 81, rel=0.03
    )
    assert axles['front']['brake'] + axles['rear']['brake'] == pytest.approx(1.0, abs=0.01)
    assert axles['front']['drive'] + axles['rear']['drive'] == pytest.approx(1.0, abs=0.01)


@pytest.mark.slow
def test_a_limiter_does_not_hide_who_drives() -> None:
    """That of a shuttle ends at 12 m/s, far below the speed the level is identified at: it seemed to have no drive, and
    one at 25 m/s half of it. Driven are the front wheels, by all of the torque."""
    slow = load_scene('light_car_straight', ['vehicle.driveline.top_speed=40']).model
    axles, lengthwise, _ = straight(slow, sum(b.mass for b in slow.bodies))
    usual, others, _ = straight(model('light car'), sum(b.mass for b in slow.bodies))
    assert axles['front']['drive'] == pytest.approx(1.0, abs=0.02)
    assert axles['rear']['drive'] == 0.0
    assert axles['front']['inertia'] == usual['front']['inertia']
    assert lengthwise['pitch_by_drive'] == pytest.approx(others['pitch_by_drive'], rel=0.1)


def test_limiters_are_those_of_each_axle() -> None:
    """Motors of the front axle end at 90 rad/s, those of the rear one never; the outputs of a differential have its
    rate in the mean."""
    changes = ['vehicle.axles.front.drive.top_speed=90', 'vehicle.axles.rear.drive.top_speed=null']
    electric = load_scene('car_step_steer', ['vehicle=vehicles/electric_4wd.yaml', *changes]).model
    assert (top_spin(electric, 'front'), top_spin(electric, 'rear')) == (90.0, 0.0)
    # driven in front
    assert (top_spin(model('light car'), 'front'), top_spin(model('light car'), 'rear')) == (230.0, 0.0)


@pytest.mark.slow
def test_a_rear_rack_that_follows_the_steering_wheel_is_found() -> None:
    """Its wheels turn as on the bench, within what forces do to both; without one they do not. The gear of the front is
    that of the bench too: with what a steering of a quarter turn does at its stops it was a fifth off."""
    text = {'rack': {'mass': 0.8, 'com': [-0.85, 0.0, 0.1305], 'inertia': [0.01, 0.0004, 0.01]}, 'per_turn': 0.02}
    scenes = [
        load_scene('car_step_steer', ['vehicle=vehicles/formula_student.yaml', *more])
        for more in ((), (f'vehicle.axles.rear.rack={text}',))
    ]
    fixed, follows = (gear(scene.model) for scene in scenes)
    assert fixed[2] == 0.0
    curves = Rig(scenes[1].model).steering([-0.5, 0.5])
    front, rear = (
        np.diff(sum(curves[f'{axle}_{side}']['steer'] for side in ('left', 'right')))[0] for axle in ('front', 'rear')
    )
    assert follows[2] == pytest.approx(rear / front, rel=0.02)
    assert follows[0] == pytest.approx(front / 2.0, rel=0.02)
    assert fixed[0] == pytest.approx(follows[0], rel=0.01)


@pytest.mark.slow
def test_backwards_it_is_followed_or_told() -> None:
    """Understeer is oversteer there, and trails are others: up to a speed at which it is looked at."""
    limit = next(
        one for one in derive(scene('light car', Maneuver())).report.validity if one.quantity == 'longitudinal_velocity'
    )
    assert limit.low in {-5.0, -10.0}


@pytest.mark.slow
def test_the_hand_feels_more_than_the_level_in_a_slow_bend_and_that_is_said() -> None:
    """Turned by 2 rad at 4 m/s the vehicle lifts its weight by a fifth of the torque."""
    given = scene('light car', Maneuver(steering=Step(value=2.0, start=0.1, rise=0.5)), speed=4.0)
    torques = []
    for level in ('full', 'single_track'):
        simulation = solver.simulation_of(dataclasses.replace(given, fidelity=level))
        hand = simulation.channels.joints.index('steering_wheel')
        torques.append(float(simulation.advance(round(2.0 / simulation.h)).joint_effort[hand]))
    assert torques[1] / torques[0] == pytest.approx(0.79, abs=0.05)
    assert LIFTED in derive(given).report.lost


def test_a_car_that_wings_press_down_has_a_lowest_speed() -> None:
    """Of 4000 N at 22 m/s 1000 are of its wings: at v it carries less by 1000 (1 - (v/22)^2), and that is 5 % of 4000
    at v^2 = 0.8 22^2. A twentieth of its load a car may lose altogether."""
    assert slowest_pressed(4000.0, 3000.0) == pytest.approx(22.0 * 0.8**0.5)
    assert slowest_pressed(4000.0, 3800.0) is None
    assert slowest_pressed(4000.0, 4010.0) is None


def test_lift_is_named_where_there_is_some() -> None:
    assert unlifted(load_scene('light_car_straight').model) == ()
    (said,) = unlifted(load_scene('car_step_steer', ['vehicle=vehicles/formula_student.yaml']).model)
    assert said == 'lift of aero: the axles are loaded as at 22 m/s at every speed'


def gradient(each: Scene, t: SingleTrackTables) -> float:
    """Understeer gradient [rad s^2/m] of a scene, by a straight line up to 3.5 m/s^2 (ISO 4138)."""
    simulation = solver.simulation_of(each)
    chassis = simulation.channels.chassis or 0
    rows = []
    for _ in range(500):
        s = simulation.advance(10)
        v, r = s.twist[chassis, 0], s.twist[chassis, 5]
        rows.append((v * r, s.inputs[0] * t.body.ratio - (t.front.x - t.rear.x) * r / v))
    a, understeer = np.array(rows).T
    used = (a > 0.5) & (a < 3.5)
    return float(np.polyfit(a[used], understeer[used], 1)[0])


@pytest.mark.slow
@pytest.mark.parametrize('car', CASES)
def test_braking_in_a_bend(car: str) -> None:
    """Another speed and other torques than the level was identified with: the load that moves forward turns the car
    in."""
    braking = Maneuver(
        steering=Step(value=0.45, start=0.5, rise=0.15), brake_torque=Step(value=1000.0, start=2.5, rise=0.2)
    )
    yaw = []
    for fidelity in ('full', 'single_track'):
        simulation = solver.simulation_of(dataclasses.replace(scene(car, braking, speed=25.0), fidelity=fidelity))
        yaw.append(np.array([simulation.advance(10).twist[0, 5] for _ in range(500)]))
    assert np.sqrt(np.mean((yaw[1] - yaw[0]) ** 2)) < 0.05 * np.abs(yaw[0]).max()


@pytest.mark.slow
def test_a_run_that_leaves_the_limits_is_suspect() -> None:
    mild = solver.simulation_of(scene('light car', Maneuver(steering=Step(value=0.3))))
    mild.advance(3000)
    assert findings(mild) == []
    wild = solver.simulation_of(
        scene('light car', Maneuver(steering=Sine(amplitude=0.5, frequency=6.0), brake_torque=9000.0))
    )
    wild.advance(3000)
    text = ' '.join(str(finding) for finding in findings(wild))
    assert 'frequency' in text
    assert 'The level of detail is outside its range of slip (validity ' in text
    assert 'Take a level with more detail' in text


@pytest.mark.slow
@pytest.mark.parametrize(('friction', 'angle', 'told'), [(0.6, 0.4, False), (0.6, 1.2, True), (0.3, 0.4, True)])
def test_a_slippery_road_is_followed_or_told(friction: float, angle: float, told: bool) -> None:
    """A steady turn beside the whole vehicle: within 5 %, or suspect. On friction 0.6 a limit of 7 m/s^2 is one of 4.2
    m/s^2."""
    turn = (
        f'road={{friction: {friction}}}',
        f'maneuver={{steering: {{kind: step, value: {angle}, start: 0.2, rise: 0.3}}}}',
    )
    whole, level = (
        solver.simulation_of(load_scene('light_car_step_steer', [*turn, f'fidelity={fidelity}']))
        for fidelity in ('full', 'single_track')
    )
    wanted, found = (s.advance(3000).twist[0, 5] for s in (whole, level))
    assert (abs(found / wanted - 1.0) < 0.05) != told
    assert bool(findings(level)) == told


def covered(kind: str, friction: float) -> str:
    """A road whose friction is 1, all of whose way lies in a patch or a map of another one."""
    if kind == 'patch':
        return f'{{patches: [{{center: [0, 0], size: [2000, 2000], factor: {friction}}}]}}'
    ones = ', '.join(f'{key}: {value}' for key, value in dataclasses.asdict(Raster.of(np.ones((4, 4)))).items())
    return f'{{maps: [{{origin: [-1000, -1000], step: [1000, 1000], raster: {{{ones}}}, scale: {friction}}}]}}'


@pytest.mark.slow
@pytest.mark.parametrize(('friction', 'angle', 'told'), [(0.6, 0.4, False), (0.6, 1.2, True), (0.3, 0.4, True)])
@pytest.mark.parametrize('kind', ['patch', 'map'])
def test_what_is_slippery_in_part_is_driven_and_told_like_what_is_so_everywhere(
    friction: float, angle: float, told: bool, kind: str
) -> None:
    turn = f'maneuver={{steering: {{kind: step, value: {angle}, start: 0.2, rise: 0.3}}}}'
    everywhere, part = (
        solver.simulation_of(load_scene('light_car_step_steer', [turn, f'road={road}', 'fidelity=single_track']))
        for road in (f'{{friction: {friction}}}', covered(kind, friction))
    )
    wanted, found = (s.advance(3000).twist[0, 5] for s in (everywhere, part))
    assert found == pytest.approx(wanted, rel=1e-6)
    assert bool(findings(everywhere)) == bool(findings(part)) == told
    saved, before = part.save(), findings(part)
    part.reset()
    assert not findings(part)
    part.restore(saved)
    assert findings(part) == before


@pytest.mark.slow
@pytest.mark.parametrize(('vehicle', 'speed', 'angle', 'told'), [
    ('light_car', 58.0, 0.14, False),
    pytest.param('formula_student', 45.0, 0.02, True, marks=pytest.mark.long),
])  # fmt: skip
def test_a_gentle_bend_faster_than_it_was_identified_is_followed_or_told(
    vehicle: str, speed: float, angle: float, told: bool
) -> None:
    """With wings, and next to neutral, a car turns a quarter less at 45 m/s than what was identified up to 33 m/s."""
    text = (
        f'vehicle: vehicles/{vehicle}.yaml\nstart: {{kind: equilibrium, speed: {speed}}}\nduration: 2.5\n'
        f'maneuver: {{steering: {{kind: step, value: {angle}, start: 0.2, rise: 0.3}}, speed: {{}}}}\n'
        'integrator: {h: 0.002, iterations: 2}\n'
    )
    rates = []
    for fidelity in ('full', 'single_track'):
        simulation = solver.simulation_of(load_scene_text(f'{text}fidelity: {fidelity}'))
        watch = Envelope(simulation)
        for _ in range(125):
            shot = simulation.advance(10)
            watch.look(shot)
        rates.append(float(shot.twist[0, 5]))
    assert (abs(rates[1] / rates[0] - 1.0) < 0.05) != told
    assert [f.where for f in watch.findings()] == ['longitudinal_velocity'] * told
    assert not findings(simulation)


@pytest.mark.slow
def test_a_slippery_part_that_is_not_driven_on_is_not_told() -> None:
    turn = 'maneuver={steering: {kind: step, value: 0.4, start: 0.2, rise: 0.3}}'
    road = 'road={patches: [{center: [0, -500], size: [2000, 100], factor: 0.1}]}'
    simulation = solver.simulation_of(load_scene('light_car_step_steer', [turn, road, 'fidelity=single_track']))
    simulation.advance(3000)
    assert not findings(simulation)


@pytest.mark.slow
def test_a_driver_finds_his_way() -> None:
    """The lane change of the light car, steered by the preview driver at both levels: the same path within a tenth of a
    metre."""
    whole = load_scene('light_car_lane_change', ['integrator.h=0.002'])
    level = load_scene('light_car_lane_change', ['integrator.h=0.002', 'fidelity=single_track'])
    paths = []
    for each in (whole, level):
        simulation = solver.simulation_of(each)
        paths.append(np.array([simulation.advance(20).pose[0, :2] for _ in range(150)]))
    departure = np.interp(paths[0][:, 0], *paths[1].T) - paths[0][:, 1]
    assert np.abs(paths[0][:, 1]).max() > 3.0
    assert np.abs(departure).max() < 0.1


@pytest.mark.slow
def test_steered_from_the_start_on_it_starts_in_the_bend_of_the_whole_vehicle() -> None:
    """Straight on it would start without a yaw rate, and be 1 m beside the way after four seconds."""
    steered = ['start.speed=20', 'maneuver={steering: 0.5, drive_torque: 150}', 'integrator.h=0.002']
    starts, ends = [], []
    for fidelity in ('full', 'single_track'):
        simulation = solver.simulation_of(load_scene('light_car_step_steer', [*steered, f'fidelity={fidelity}']))
        starts.append(simulation.snapshot())
        ends.append(simulation.advance(2000))
    assert starts[1].twist[0, 5] == pytest.approx(starts[0].twist[0, 5], rel=0.03)
    assert starts[1].pose[0, :2] == pytest.approx(starts[0].pose[0, :2], abs=5e-3)
    assert ends[1].pose[0, 1] == pytest.approx(ends[0].pose[0, 1], rel=0.03)


@pytest.mark.slow
def test_the_same_text_is_the_same_bits() -> None:
    """What is derived is kept; a scene from its resolved text drives the same way."""
    given = load_scene('light_car_step_steer', ['fidelity=single_track'])
    ends = [solver.simulation_of(s).advance(3000).numbers.tobytes() for s in (given, load_scene_text(given.resolved))]
    assert ends[0] == ends[1]


def test_what_the_level_lacks_is_refused_with_a_sentence() -> None:
    one = model('light car')
    fewer = dataclasses.replace(one, tires=one.tires[:2])
    with pytest.raises(SceneError, match='needs the wheels front_left'):
        derive(dataclasses.replace(scene('light car', Maneuver()), model=fewer))


@pytest.mark.long
@pytest.mark.slow
def test_other_processors_identify_the_same_numbers() -> None:
    """Neither BLAS nor the vector instructions of numpy enter; limits, which only judge, are shown with three
    digits."""
    program = (
        'import json; from solver.files.scene import load_scene; from solver.levels.single_track import identified; '
        'print(json.dumps(identified(load_scene("light_car_straight").model)))'
    )
    found = []
    for core in ('Haswell', 'Prescott'):
        environment = {**os.environ, 'PYTHONPATH': str(ROOT), 'OPENBLAS_CORETYPE': core}
        done = subprocess.run(
            [sys.executable, '-c', program], env=environment, capture_output=True, text=True, check=True, timeout=300
        )
        found.append(done.stdout)
    assert found[0] == found[1]
    assert 'stiffness_y' in found[0]


@pytest.mark.slow
def test_absent_channels_are_told() -> None:
    level = solver.simulation_of(scene('light car', Maneuver())).level
    assert level is not None
    assert {'joint travel_front_left', 'joint rack', 'wheel front_left', 'body knuckle_front_left'} <= set(level.absent)
    assert 'joint steering_wheel' not in level.absent


@pytest.mark.slow
def test_courses_reach_what_their_names_say() -> None:
    course = courses(model('light car'))[0]
    simulation = solver.simulation_of(course_scene(model('light car'), course, 'full'))
    lateral = [float((s := simulation.advance(10)).twist[0, 0] * s.twist[0, 5]) for _ in range(500)]
    assert lateral[-100] == pytest.approx(0.4 * 9.81, rel=0.08)


def test_no_axle_answers_faster_than_a_tenth_of_its_tires_relaxation() -> None:
    """A search that runs to negative lengths, as of a twist beam that steers by its own forces, ends at a length that
    can be integrated."""
    start = {part: dict.fromkeys((name for p, name in Lateral.NAMES if p == part), 1.0) for part, _ in Lateral.NAMES}
    start['body'] |= {'mass': 1000.0, 'roll_inertia': 1.0}
    scene = Scene(
        name='s',
        model=ModelSpec(bodies=(RigidBodySpec(name='chassis', mass=1.0, inertia=(1.0, 1.0, 1.0, 0.0, 0.0, 0.0)),)),
    )
    found = Lateral(scene, start, np.eye(3), []).parameters(np.full(len(Lateral.NAMES), -2.0))
    assert found['front']['length_y'] == found['rear']['length_y'] == pytest.approx(0.1)
    assert found['front']['peak_y'] == -1.0
