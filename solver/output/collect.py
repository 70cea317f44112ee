"""From state and element outputs to a Snapshot: names, and one compiled pass that fills the arrays."""

from __future__ import annotations

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.vec import add, cross, load3, load33, mv, scale, sub, tmv
from solver.elements import aero_drag, applied_force, brake, bushing, coordinate_force, spring_damper, tire_pacejka
from solver.elements.coordinate import coordinate_rate, evaluate_coordinate
from solver.elements.point_pair import angular_velocity, linear_velocity
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.model.evaluate import Outputs
from solver.model.tables import Model
from solver.output.snapshot import Channels

OUTPUT_COLUMNS = {
    'spring_dampers': spring_damper.OUTPUTS,
    'bushings': bushing.OUTPUTS,
    'coordinate_forces': coordinate_force.OUTPUTS,
    'brakes': brake.OUTPUTS,
    'applied_forces': applied_force.OUTPUTS,
    'aero_drags': aero_drag.OUTPUTS,
    'tires': tire_pacejka.OUTPUTS,
}
FORCE_COLUMN = coordinate_force.OUTPUTS.index('force')
BRAKE_COLUMN = brake.OUTPUTS.index('torque')
FIRST_TIRE_COLUMN = tire_pacejka.OUTPUTS.index(TIRE_COLUMNS[0])


def new_outputs(model: Model) -> Outputs:
    """Output arrays of every element kind, filled with NaN until an evaluation assigns them."""
    return Outputs(*(np.full((len(getattr(model.spec, kind)), len(OUTPUT_COLUMNS[kind])), np.nan) for kind in Outputs._fields))


def channels_of(model: Model) -> Channels:
    """Names of everything a Snapshot of this model holds."""
    spec = model.spec
    return Channels(
        joints=model.coordinate_names,
        joint_kinds=model.coordinate_kinds,
        bodies=model.body_names,
        wheels=tuple(t.name for t in spec.tires),
        inputs=spec.inputs,
        elements=tuple(
            f'{e.name}/{column}'
            for kind in Outputs._fields
            if kind != 'tires'
            for e in getattr(spec, kind)
            for column in OUTPUT_COLUMNS[kind]
        ),
        reactions=model.row_names,
        chassis=model.body_names.index(spec.chassis) if spec.chassis else 0,
    )


@kernel(inner=True)
def _append(out, elements, at):
    """Copy the outputs of a kind of element to elements[at:]; returns where the next one goes."""
    for e in range(out.shape[0]):
        for i in range(out.shape[1]):
            elements[at] = out[e, i]
            at += 1
    return at


@kernel(borrow=True)
def collect(tables, chassis, kin, a, lam, u, state, outputs, frame):
    """Assign the Frame of a state: kin and a (nb + 1, 6) are those of the outputs, lam (nc,) and u (nu,) what was applied."""
    x = tables.coordinates
    for k in range(x.kind.shape[0]):
        value, g_i, g_j = evaluate_coordinate(x, kin, k, state.angle)
        frame.joint_position[k] = value
        frame.joint_velocity[k] = coordinate_rate(x, kin, k, g_i, g_j)
        frame.joint_effort[k] = 0.0
    t = tables.coordinate_forces
    for e in range(outputs.coordinate_forces.shape[0]):
        for k in range(t.terms[e]):
            frame.joint_effort[t.coordinate[e, k]] += t.factor[e, k] * outputs.coordinate_forces[e, FORCE_COLUMN]
    for e in range(outputs.brakes.shape[0]):
        frame.joint_effort[tables.brakes.coordinate[e]] += outputs.brakes[e, BRAKE_COLUMN]
    for b in range(tables.bodies.mass.shape[0]):
        R = load33(kin.R, b)
        com = load3(tables.bodies.com, b)
        w = angular_velocity(kin, b)
        p = sub(load3(kin.p, b), mv(R, com))
        v = sub(tmv(R, linear_velocity(kin, b)), cross(w, com))
        for i in range(3):
            frame.pose[b, i] = p[i]
            frame.twist[b, i] = v[i]
            frame.twist[b, 3 + i] = w[i]
        for i in range(4):
            frame.pose[b, 3 + i] = state.q[b, 3 + i]
    R = load33(kin.R, chassis)
    gravity = (tables.bodies.gravity[0], tables.bodies.gravity[1], tables.bodies.gravity[2])
    force = tmv(R, add(load3(a, chassis), scale(-1.0, gravity)))
    w = angular_velocity(kin, chassis)
    for i in range(3):
        frame.imu[i] = force[i]
        frame.imu[3 + i] = w[i]
    for e in range(outputs.tires.shape[0]):
        for i in range(frame.tire.shape[1]):
            frame.tire[e, i] = outputs.tires[e, FIRST_TIRE_COLUMN + i]
    at = _append(outputs.spring_dampers, frame.elements, 0)
    at = _append(outputs.bushings, frame.elements, at)
    at = _append(outputs.coordinate_forces, frame.elements, at)
    at = _append(outputs.brakes, frame.elements, at)
    at = _append(outputs.applied_forces, frame.elements, at)
    _append(outputs.aero_drags, frame.elements, at)
    for i in range(lam.shape[0]):
        frame.reactions[i] = lam[i]
    for i in range(u.shape[0]):
        frame.inputs[i] = u[i]
