"""Actuation of a vehicle: gives a model other inputs than its template has, as the key `actuation` of a scene says.

steering: torque   a torque on the steering wheel, with end stops, replaces the coupler that imposes its angle
wheels             every brake gets an additional input of its own, and every wheel a drive torque of its own
                   (input `drive_torque_<wheel>`). On a driven wheel it acts at the output of the differential (torque
vectoring): the housing takes the reaction, and the top speed of the drive limits it. On another wheel it
                   acts between the wheel and its carrier (a motor in the hub), at any speed.
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

TORQUE = 'steering_torque'  # input of a steering wheel that turns freely
GEAR = 'gear'  # input of a gearbox
# Amount by which a pedal position may be beyond its stops, where it has no further effect. A spline through recorded
# positions may swing that far; ten times as much would accept positions in per cent.
SWING = 1.0
IN_DEGREES = 'if it is in deg, multiply it by 0.0174533'  # remedy for an angle that is too large in rad
# Natural frequency [rad/s] of a steering wheel alone on its end stops: its period is 31 steps of 1 ms. No usual step
# would resolve ten times as much.
STOP = 200.0
BUFFER = 0.05  # angle [rad] over which the end stops become stiff
# Inputs that impose the angle of the steering wheel, its rate and its acceleration.
MOTION = ('steering', 'steering' + RATE, 'steering' + ACCELERATION)


def actuated(model: ModelSpec, actuation: Actuation) -> ModelSpec:
    """The model with the inputs of an actuation. Raises SpecError for a model without the parts that the actuation
    needs."""
    if actuation.steering == 'torque':
        model = _steered_by_torque(model)
    return _with_wheels(model) if actuation.wheels else model


def _steered_by_torque(model: ModelSpec) -> ModelSpec:
    """The model with a torque on the steering wheel in place of its imposed angle."""
    drivers = [c for c in model.couplers if c.input == 'steering']
    if len(drivers) != 1 or len(drivers[0].terms) != 1:
        raise SpecError('actuation: steering = torque: the model needs one coupler that imposes its steering angle')
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
    """Torque [N m] of the end stops over the angle [rad] of a free steering wheel, None without stops.

    Their stiffness gives the steering wheel, with its own inertia, the natural frequency STOP.
    """
    wheel = next((body for body in model.bodies if body.name == 'steering_wheel'), None)
    if model.lock is None or wheel is None:
        return None
    rate, end, full = max(wheel.inertia[:3]) * STOP * STOP, model.lock, model.lock + BUFFER
    return Law((-full, -end, end, full), (-0.5 * rate * BUFFER, 0.0, 0.0, 0.5 * rate * BUFFER), (rate, 0.0, 0.0, rate))


def _with_wheels(model: ModelSpec) -> ModelSpec:
    """The model with inputs for brake and drive torque of every wheel."""
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
        name = next(
            (name for name in (f'output_shaft_{wheel}/angle', f'shaft_{wheel}', bearing) if name in outputs), None
        )
        sign, top_rate = (1.0, None) if name is None else _as_driven(*outputs[name])
        drives.append(
            CoordinateForceSpec(
                name=f'drive_{wheel}',
                terms=((name or bearing, sign),),
                input=f'drive_torque_{wheel}',
                top_rate=top_rate,
            )
        )
        inputs += [f'drive_torque_{wheel}', own[bearing]]
    if not drives:
        raise SpecError('actuation: wheels: the model has no tires')
    return dataclasses.replace(
        model,
        brakes=tuple(
            dataclasses.replace(b, own_input=own[b.coordinate]) if b.coordinate in own else b for b in model.brakes
        ),
        coordinate_forces=(*model.coordinate_forces, *drives),
        inputs=(*model.inputs, *inputs),
    )


def _as_driven(factor: float, force: CoordinateForceSpec) -> tuple[float, float | None]:
    """(sign of the factor, top speed [rad/s]) of one output of a drive.

    The top speed is that of the output when all outputs turn equally fast; None without a limit.
    """
    sign = 1.0 if factor > 0.0 else -1.0
    return sign, None if force.top_rate is None else force.top_rate / sum(abs(each) for _, each in force.terms)


def forward_gears(model: ModelSpec) -> int | None:
    """Number of forward gears of the gearboxes that follow the input `gear`; None without a gearbox."""
    return max((len(clutch.ratios) for clutch in model.clutches if clutch.gear == GEAR), default=None)


def reaches(model: ModelSpec) -> dict[str, Reach]:
    """Input of a pedal or a gear -> range in which it has an effect. Beyond it an element would clip the input
    silently."""
    found: dict[str, Reach] = {}
    for engine in model.engines:
        low, high = min(0.0, engine.pedals[0]), max(1.0, engine.pedals[-1])
        found[engine.input] = Reach(
            low - SWING, high + SWING, f'must be a position of the pedal, {low:g} to {high:g}, not per cent'
        )
    for clutch in model.clutches:
        found[clutch.input] = Reach(-SWING, 1.0 + SWING, 'must be a position of the pedal, 0 to 1, not per cent')
    for channel in {clutch.gear for clutch in model.clutches}:
        boxes = [clutch for clutch in model.clutches if clutch.gear == channel]
        back, count = any(box.reverse is not None for box in boxes), max(len(box.ratios) for box in boxes)
        gears = f'is no gear: there are 1 to {count}, 0 is neutral' + (
            ', -1 is the reverse gear' if back else '; there is no reverse gear'
        )
        remedy = gears if channel == GEAR else f'must be 0 to {count}'
        found[channel] = Reach(-1.5 if back else -0.5, count + 0.5, remedy)
    return found


def steering_reaches(model: ModelSpec) -> dict[str, Reach]:
    """Input of the steering -> range of possible angles [rad]; an angle beyond it is probably in degrees."""
    if not model.tires or MOTION[1] not in model.inputs:
        return {}
    what = f'is too large in rad for the angle of a steering wheel ({LOCK:g} rad, three turns, at most); {IN_DEGREES}'
    return {'steering': Reach(-LOCK, LOCK, what)}


def assisted_wheels(model: ModelSpec) -> tuple[AssistedWheel, ...]:
    """Wheels of a vehicle, as an assistance needs them, in the order of its tires. Their radius is that at nominal
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
