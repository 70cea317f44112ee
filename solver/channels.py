"""From state and element outputs to a Snapshot: names, and one compiled pass that fills the arrays."""

from __future__ import annotations

import numpy as np

from solver.dynamics import Outputs
from solver.elements import aero_drag, applied_force, brake, bushing, coordinate_force, spring_damper, tire_pacejka
from solver.elements.coordinate import coordinate_rate, evaluate_coordinate
from solver.elements.point_pair import angular_velocity, linear_velocity
from solver.jit import kernel
from solver.lie.vec import add, cross, load3, load33, mv, scale, sub, tmv
from solver.model.tables import Model
from solver.snapshot import TIRE_COLUMNS, Channels

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


@kernel(borrow=True)
def collect(tables, chassis, kin, a, angle, outputs, position, velocity, effort, pose, twist, imu, q):
    """Assign the Snapshot arrays that are not mere copies: joints, body frames and the inertial unit."""
    x = tables.coordinates
    for k in range(x.kind.shape[0]):
        value, g_i, g_j = evaluate_coordinate(x, kin, k, angle)
        position[k] = value
        velocity[k] = coordinate_rate(x, kin, k, g_i, g_j)
        effort[k] = 0.0
    t = tables.coordinate_forces
    for e in range(outputs.coordinate_forces.shape[0]):
        for k in range(t.terms[e]):
            effort[t.coordinate[e, k]] += t.factor[e, k] * outputs.coordinate_forces[e, FORCE_COLUMN]
    for e in range(outputs.brakes.shape[0]):
        effort[tables.brakes.coordinate[e]] += outputs.brakes[e, BRAKE_COLUMN]
    for b in range(tables.bodies.mass.shape[0]):
        R = load33(kin.R, b)
        com = load3(tables.bodies.com, b)
        w = angular_velocity(kin, b)
        p = sub(load3(kin.p, b), mv(R, com))
        v = sub(tmv(R, linear_velocity(kin, b)), cross(w, com))
        for i in range(3):
            pose[b, i] = p[i]
            twist[b, i] = v[i]
            twist[b, 3 + i] = w[i]
        for i in range(4):
            pose[b, 3 + i] = q[b, 3 + i]
    R = load33(kin.R, chassis)
    gravity = (tables.bodies.gravity[0], tables.bodies.gravity[1], tables.bodies.gravity[2])
    force = tmv(R, add(load3(a, chassis), scale(-1.0, gravity)))
    w = angular_velocity(kin, chassis)
    for i in range(3):
        imu[i] = force[i]
        imu[3 + i] = w[i]
