"""Actuation of a vehicle: a model takes other inputs than its template gives it, by rules on the model.

steering: torque   the coupler that imposes the angle of the steering wheel gives way to a torque on it (`driver`), with the end stops
wheels             every brake gets an input of its own, and a torque `drive_<wheel>` acts on every wheel: that of a driven one at its
                   output of the differential, whose housing takes the reaction (torque vectoring), up to the top speed of the drive;
                   that of another one between the wheel and what carries it (a motor in the hub), at any speed
"""

from __future__ import annotations

import dataclasses

from solver.dimensions import LOCK
from solver.elements.coordinate_force import CoordinateForceSpec
from solver.elements.laws import Law
from solver.elements.tire_data import pack
from solver.elements.tire_pacejka import rolling_radius
from solver.errors import SpecError
from solver.inputs.actuation import Actuation
from solver.inputs.assistance import AssistedWheel
from solver.inputs.recorded import ACCELERATION, RATE, Reach
from solver.model.frames import matrix
from solver.model.spec import ModelSpec

TORQUE = 'steering_torque'
GEAR = 'gear'
SWING = 1.0  # by which a pedal may be beyond its stops, where it is held: a spline may swing that far, per cent are further off
IN_DEGREES = 'if it is in deg, multiply it by 0.0174533'
STOP = 200.0  # rad/s: of a steering wheel alone on its end stops, whose period takes 31 steps of 1 ms; ten times as much none resolves
BUFFER = 0.05  # rad, over which the stops take hold
MOTION = ('steering', 'steering' + RATE, 'steering' + ACCELERATION)


def actuated(model: ModelSpec, actuation: Actuation) -> ModelSpec:
    """The model with the inputs that an actuation wants. Raises SpecError for one that has not what it takes."""
    if actuation.steering == 'torque':
        model = _steered_by_torque(model)
    return _with_wheels(model) if actuation.wheels else model


def _steered_by_torque(model: ModelSpec) -> ModelSpec:
    drivers = [c for c in model.couplers if c.input == 'steering']
    if len(drivers) != 1 or len(drivers[0].terms) != 1:
        raise SpecError('actuation: steering = torque: the model has no single coupler that imposes the angle of a steering wheel')
    driver = drivers[0]
    torque = CoordinateForceSpec(name=driver.name, terms=driver.terms, input=TORQUE, spring=_end_stops(model))
    inputs = tuple(TORQUE if name == MOTION[0] else name for name in model.inputs if name not in MOTION[1:])
    return dataclasses.replace(
        model,
        couplers=tuple(c for c in model.couplers if c is not driver),
        coordinate_forces=(*model.coordinate_forces, torque),
        inputs=inputs,
    )


def _end_stops(model: ModelSpec) -> Law | None:
    """Torque [N m] of the end stops over the angle of a free steering wheel [rad], which bounces between them at STOP with what it is."""
    wheel = next((body for body in model.bodies if body.name == 'steering_wheel'), None)
    if model.lock is None or wheel is None:
        return None
    rate, end, full = max(wheel.inertia[:3]) * STOP * STOP, model.lock, model.lock + BUFFER
    return Law((-full, -end, end, full), (-0.5 * rate * BUFFER, 0.0, 0.0, 0.5 * rate * BUFFER), (rate, 0.0, 0.0, rate))


def _with_wheels(model: ModelSpec) -> ModelSpec:
    brakes = {brake.coordinate: brake for brake in model.brakes}
    outputs = {
        name: (factor, force)
        for force in model.coordinate_forces if force.input == 'drive_torque'
        for name, factor in force.terms
    }  # fmt: skip
    drives, own, inputs = [], {}, []
    for wheel in (tire.name for tire in model.tires):
        bearing = f'wheel_{wheel}'
        if bearing not in brakes:
            raise SpecError(f'actuation: wheels: wheel {wheel!r} has no brake on a coordinate {bearing!r}')
        own[bearing] = f'brake_torque_{wheel}'
        name = next((name for name in (f'output_shaft_{wheel}/angle', f'shaft_{wheel}', bearing) if name in outputs), None)
        sign, top_rate = (1.0, None) if name is None else _as_driven(*outputs[name])
        drives.append(
            CoordinateForceSpec(name=f'drive_{wheel}', terms=((name or bearing, sign),), input=f'drive_torque_{wheel}', top_rate=top_rate)
        )
        inputs += [f'drive_torque_{wheel}', own[bearing]]
    if not drives:
        raise SpecError('actuation: wheels: the model has no tires')
    return dataclasses.replace(
        model,
        brakes=tuple(dataclasses.replace(b, own_input=own[b.coordinate]) if b.coordinate in own else b for b in model.brakes),
        coordinate_forces=(*model.coordinate_forces, *drives),
        inputs=(*model.inputs, *inputs),
    )


def _as_driven(factor: float, force: CoordinateForceSpec) -> tuple[float, float | None]:
    """(sign, top speed [rad/s]) of one output of a drive, which has that speed when all of them turn as fast."""
    sign = 1.0 if factor > 0.0 else -1.0
    return sign, None if force.top_rate is None else force.top_rate / sum(abs(each) for _, each in force.terms)


def forward_gears(model: ModelSpec) -> int | None:
    """Number of gears of the gearboxes that follow the input `gear`; None where there is none."""
    return max((len(clutch.ratios) for clutch in model.clutches if clutch.gear == GEAR), default=None)


def reaches(model: ModelSpec) -> dict[str, Reach]:
    """Ranges in which pedals and gears of a model have an effect, by input. An input beyond its range would be held
    within it unsaid."""
    found: dict[str, Reach] = {}
    for engine in model.engines:
        low, high = min(0.0, engine.pedals[0]), max(1.0, engine.pedals[-1])
        found[engine.input] = Reach(low - SWING, high + SWING, f'must be a position of the pedal, {low:g} to {high:g}, not per cent')
    for clutch in model.clutches:
        found[clutch.input] = Reach(-SWING, 1.0 + SWING, 'must be a position of the pedal, 0 to 1, not per cent')
    for channel in {clutch.gear for clutch in model.clutches}:
        boxes = [clutch for clutch in model.clutches if clutch.gear == channel]
        back, count = any(box.reverse is not None for box in boxes), max(len(box.ratios) for box in boxes)
        gears = f'is no gear: there are 1 to {count}, 0 is neutral' + (', -1 is the reverse gear' if back else '; there is no reverse gear')
        remedy = gears if channel == GEAR else f'must be 0 to {count}'
        found[channel] = Reach(-1.5 if back else -0.5, count + 0.5, remedy)
    return found


def steering_reaches(model: ModelSpec) -> dict[str, Reach]:
    """Angles at which a vehicle can be steered, by input; one beyond is in degrees."""
    if not model.tires or MOTION[1] not in model.inputs:
        return {}
    what = f'is too large in rad for the angle of a steering wheel ({LOCK:g} rad, three turns, at most); {IN_DEGREES}'
    return {'steering': Reach(-LOCK, LOCK, what)}


def assisted_wheels(model: ModelSpec) -> tuple[AssistedWheel, ...]:
    """Wheels of a vehicle, as an assistance needs them, in the order of its tires; their radii are those under nominal
    load."""
    places = {b.name: k for k, b in enumerate(model.bodies)}
    shares = {brake.coordinate: brake.gain for brake in model.brakes}
    return tuple(
        AssistedWheel(
            name=tire.name,
            share=shares.get(f'wheel_{tire.name}', 0.0),
            radius=rolling_radius(pack(tire.data.values, tire.data.version, tire.pressure), tire.data['FNOMIN'], 0.0),
            left=model.bodies[places[tire.marker.body]].position[1],
            body=places[tire.marker.body],
            axis=matrix(tire.marker.orientation)[:, 1],
        )
        for tire in model.tires
    )
