"""The level `single_track`: a model with two axles that moves in the plane and rolls, identified from runs of the full
vehicle.

Taken from the data of the vehicle: mass, centre of mass, moments of inertia in yaw and roll and their product, axle
loads, wheelbase, tracks, inertia of the parts that turn with the wheels, drag, the shares of the axles in drive and
brakes. Identified from runs of the full vehicle on a flat road of friction 1:

    run                                      parameters that it gives
    creeping with the steering turned        steering ratio, also of a rear axle that steers with the front one
    driving and braking straight on          rolling radius, rolling resistance, slip stiffness, load transfer with its
                                             lag, pitch
    braking harder and harder                peak of the longitudinal force
    ramp steer, step steer at two speeds,    lateral characteristic and relaxation length of both axles, roll steer,
    step steer with braking in the bend      roll stiffness and damping

The last group is a least-squares fit: the level drives the same inputs, and the differences to the full vehicle in yaw
rate, lateral velocity and roll over time become as small as possible (Levenberg-Marquardt from a fixed start, with the
same bits on every processor).
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Any

import numpy as np

from solver.disk import derived
from solver.elements.joint import JointSpec
from solver.elements.road import RoadSpec
from solver.errors import SceneError
from solver.findings import LevelReport, Limit
from solver.levels.carried import apart, in_order, left_out
from solver.levels.derived import Derived
from solver.levels.fitting import least_squares
from solver.levels.single_track_engine import AXLES, COMMANDS, SingleTrack
from solver.levels.track_bends import Lateral, bends, feel, limits
from solver.levels.track_bulk import axis_of, brakes, drag, masses, top_spin, wheelbase_of
from solver.levels.track_friction import varies
from solver.levels.track_runs import CORNERS, SPEED, driven
from solver.levels.track_straight import gear, straight
from solver.model.spec import ModelSpec
from solver.scene import Scene
from solver.start.rolling import REACH
from solver.vehicle.hardpoints import marker_at
from solver.vehicle.size import size_of
from solver.vehicle.trailer import refuse_trailer
from solver.vehicle.transfer import refuse_locked, without_connections

STANDING = Limit(
    quantity='height over the road at the start',
    unit='m',
    high=REACH,
    why='it stands on the road, and neither falls nor springs up',
)
# 1 - friction of the road, at most. At friction 0.5 three cars turned 4 to 5 % less than the full vehicle, at three
# quarters of their lateral limit; at friction 0.3 one of them turned 12 % less.
SLIPPERY = Limit(quantity='friction below 1', unit='', high=0.5, why='it is identified on a road of friction 1')
LIFTED = (
    'raising of the car by the kingpins when it steers: the torque at the steering wheel comes from the tires alone, '
    'and is too small in slow, tight bends'
)
# Quantities whose limits are in proportion to the friction of the road.
WITH_FRICTION = ('lateral acceleration', 'slip angle', 'slip', 'combined acceleration')


def derive(scene: Scene) -> Derived:
    """The level `single_track` of a scene. Raises SceneError for a vehicle or a maneuver that the level cannot have."""
    model, more = apart(scene.model)
    where = f"scene {scene.name!r}: fidelity = 'single_track'"
    refuse_trailer(model)
    refuse_locked(model)
    if {tire.name for tire in model.tires} != set(CORNERS):
        wheels = f'needs the wheels {", ".join(CORNERS)} and no others'
        raise SceneError(f'{where}: {wheels}; rename the tires, or take the level condensed or full')
    missing = [name for name in COMMANDS if name not in model.inputs]
    if missing:
        needed = f'needs the input {missing[0]!r}, which the vehicle does not have'
        raise SceneError(f'{where}: {needed}; take another level')
    if model.engines or model.clutches:
        raise SceneError(
            f'{where}: the vehicle has an engine with a gearbox, which this level does not have; take full or condensed'
        )
    if scene.actuation.wheels:
        raise SceneError(f'{where}: actuation.wheels: this level has no single wheels; remove it or take another level')
    other = [name for name in scene.maneuver.channels if name not in COMMANDS]
    if other:
        raise SceneError(
            f'{where}: maneuver: {other[0]!r} acts on a part that this level does not model; remove this input or take '
            'another level'
        )
    found = derived('single_track', repr(dataclasses.replace(model, road=RoadSpec())), lambda: identified(model))
    parameters = {name: found[name] for name in ('mounting', 'body', 'front', 'rear')}
    report = LevelReport(
        lost=(
            'left and right of an axle: wheel loads and forces of single wheels, wheel lift',
            'travel of the wheels, bounce, pitch as a motion of its own, wheel hop, engine and subframes on their '
            'mounts',
            'unevenness and slope of the road; friction counts as the mean of both wheels of an axle',
            'torsion of steering and driveline; the published effort of a wheel is its brake torque alone',
            'turn slip, and the moment that resists turning a wheel on the spot',
            LIFTED,
            *without_connections(model),
            *unlifted(model),
            *(f'assistance map of {servo.name}: a linear steering torque replaces it' for servo in model.servos),
            *map(left_out, in_order(more)),
        ),
        validity=(*(on_road(Limit(**limit), model.road) for limit in found['validity']), STANDING, SLIPPERY),
    )
    given = dataclasses.replace(scene, model=shown(model), require=dataclasses.replace(scene.require, accuracy={}))
    return Derived(
        scene=given, level='single_track', report=report, engine=functools.partial(SingleTrack, parameters=parameters)
    )


def unlifted(model: ModelSpec) -> tuple[str, ...]:
    """(one sentence on the aerodynamic lift that the level leaves out), or () for a vehicle without lift."""
    wings = [aero.name for aero in model.aero_drags if aero.lift_area]
    return (
        (f'lift of {", ".join(wings)}: the axles are loaded as at {SPEED * size_of(model).speed:g} m/s at every speed',)
        if wings
        else ()
    )


def on_road(limit: Limit, road: RoadSpec) -> Limit:
    """A limit that was found at friction 1, as it holds on the road of the scene, whose friction may differ from place
    to place."""
    scaled = on_friction(limit, road.friction)
    if limit.quantity not in WITH_FRICTION or not varies(road):
        return scaled
    return dataclasses.replace(
        scaled, why=f'{scaled.why}; reached on a more slippery part of the road it counts for more, in proportion'
    )


def on_friction(limit: Limit, friction: float) -> Limit:
    """A limit that was found at friction 1, as it holds at another friction [-].

    The peak force of a tire is in proportion to the friction, its slip stiffness does not change. So the slips and
    forces up to which the level was fitted scale with the friction. Friction above 1 was not tried: the limit stays.
    """
    if limit.quantity not in WITH_FRICTION or limit.high is None or friction >= 1.0:
        return limit
    return dataclasses.replace(
        limit, high=float(f'{friction * limit.high:.3g}'), why=f'{limit.why}, in proportion to the friction of the road'
    )


def shown(model: ModelSpec) -> ModelSpec:
    """Model that outputs, URDF and viewers see: a chassis with all the mass, and on it the wheels and the steering
    wheel."""
    bodies = {b.name: b for b in model.bodies}
    chassis = bodies[model.chassis or model.bodies[0].name]
    wheels = {tire.name: bodies[tire.marker.body] for tire in model.tires}
    joints = []
    for corner, wheel in wheels.items():
        at = axis_of(wheel, corner, model)
        joints.append(
            JointSpec(name=f'wheel_{corner}', kind='revolute', i=marker_at(chassis, *at), j=marker_at(wheel, *at))
        )
    shown_bodies = [*wheels.values()]
    for joint in model.joints:
        if joint.name == 'steering_wheel' and joint.i.body == chassis.name:
            shown_bodies.append(bodies[joint.j.body])
            joints.append(joint)
    mass = sum(b.mass for b in model.bodies) - sum(b.mass for b in shown_bodies)
    whole_ = dataclasses.replace(chassis, mass=mass)
    return ModelSpec(
        bodies=(whole_, *shown_bodies), joints=tuple(joints), road=model.road, gravity=model.gravity,
        inputs=model.inputs,
        chassis=chassis.name, category=model.category, lock=model.lock,
    )  # fmt: skip


def identified(model: ModelSpec) -> dict[str, Any]:
    """All parameters of the level, by group, and under 'validity' the limits within which it was fitted."""
    scene = Scene(name='identification', model=dataclasses.replace(model, road=RoadSpec()))
    bulk = masses(model)
    mass, com, inertia, size = bulk['mass'], bulk['com'], bulk['inertia'], size_of(model)
    ratio, ratio_3, behind = gear(model)
    axles, lengthwise, lock = straight(model, mass)
    wheelbase = wheelbase_of(model)
    chassis = next(b for b in model.bodies if b.name == (model.chassis or model.bodies[0].name))
    g = -model.gravity[2]
    parameters: dict[str, dict[str, float]] = {}
    for i, axle in enumerate(AXLES):
        found = axles[axle]
        stiffness, damping = brakes(model, axle)
        parameters[axle] = found | {
            'x': wheelbase[i] - float(com[0]),
            'shifted': -1.0 if i == 0 else 1.0,
            'steered': 1.0 if i == 0 else behind,
            'stiffness_y': 15.0 * found['load'],
            'stiffness_load': 0.8,
            'peak_y': 1.0 * found['load'],
            'shape_y': 1.3,
            'curvature_x': 0.0,
            'curvature_y': 0.0,
            'length_x': 0.5 * found['radius'],
            'length_y': 0.5 * size.length,
            'roll_steer': 0.0,
            'trail': 0.0,
            'trail_lost': 0.0,
            'top_spin': top_spin(model, axle),
            'brake_stiffness': stiffness,
            'brake_damping': damping,
        }
    body = {
        'mass': mass,
        'yaw_inertia': float(inertia[2, 2]),
        'roll_inertia': float(inertia[0, 0]),
        'coupling': 0.4 * mass * size.length,
        'product': -float(inertia[0, 2]),
        'roll_stiffness': 0.4 * mass * g * size.length / math.radians(5.0),
        'roll_damping': 0.05 * 0.4 * mass * g * size.length * size.time / math.radians(5.0),
        'drag': drag(model),
        'height': lengthwise['height'],
        'lag': lengthwise['lag'],
        'ratio': ratio,
        'ratio_3': ratio_3,
        'steering_inertia': 0.0,
        'steering_damping': 0.0,
        'low_speed': float(model.tires[0].low_speed),
        'contact_time': float(model.tires[0].standstill_damping),
    }
    mounting = {
        'x': -float(com[0]), 'axis': 0.1 * size.length, 'height': lengthwise['z'], 'pitch': lengthwise['pitch'],
        'pitch_by_shift': lengthwise['pitch_by_shift'], 'pitch_by_drive': lengthwise['pitch_by_drive'],
        'pitch_by_roll': 0.0,
        'com_x': float(chassis.com[0]), 'com_y': float(chassis.com[1]), 'com_z': float(chassis.com[2]), 'yaw': 0.0,
        'gravity': g,
    }  # fmt: skip
    start = {'mounting': mounting, 'body': body, **parameters}
    runs = [(drive, driven(model, drive)) for drive in bends(start, wheelbase[0] - wheelbase[1], size.time)]
    search = Lateral(scene, start, inertia, runs)
    x = least_squares(search.residual, np.zeros(len(search.NAMES)))
    parameters = search.parameters(x)
    feel(parameters, scene, runs)
    return parameters | {'validity': limits(parameters, scene, runs, lock, model)}
