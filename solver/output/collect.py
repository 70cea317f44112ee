"""From state and element outputs to a Snapshot: names, and one compiled pass that fills the arrays."""

from __future__ import annotations

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.vec import add, cross, load3, load33, mv, scale, sub, tmv
from solver.elements.coordinate import coordinate_rate, evaluate_coordinate
from solver.elements.kind import FIRST_OUTPUTS
from solver.elements.point_pair import angular_velocity, linear_velocity
from solver.elements.registry import FORCES
from solver.model.tables import Model
from solver.output.energy import show_energies
from solver.output.snapshot import ENERGIES, Channels

FIRST_COLUMN = len(FIRST_OUTPUTS)  # of the outputs of a wheel that its topics show


def channels_of(model: Model, *, motions: bool = False, energies: bool = False) -> Channels:
    """Names of everything a Snapshot of this model holds. motions: the accelerations of all bodies too; energies: those
    of the account."""
    spec = model.spec
    return Channels(
        joints=model.coordinate_names,
        joint_kinds=model.coordinate_kinds,
        bodies=model.body_names,
        wheels=tuple(e.name for kind in FORCES if kind.wheels for e in getattr(spec, kind.name)),
        inputs=spec.inputs,
        elements=tuple(
            f'{e.name}/{column}'
            for kind in FORCES
            if not kind.wheels
            for e in getattr(spec, kind.name)
            for column in kind.outputs
        ),
        reactions=model.row_names,
        chassis=model.body_names.index(spec.chassis) if spec.chassis else 0,
        moving=model.body_names if motions else (),
        energies=ENERGIES if energies else (),
    )


@kernel(inner=True)
def hide(drives, marks, frame):
    """Show NaN for the reactions that are marked, and for the efforts of drives that are among them."""
    for i in range(frame.reactions.shape[0]):
        if marks[i] != 0.0:
            frame.reactions[i] = np.nan
    for k in range(drives.output.shape[0]):
        if marks[drives.output[k]] != 0.0:
            frame.joint_effort[drives.coordinate[k]] = np.nan


@kernel(borrow=True)
def collect(tables, chassis, kin, a, lam, marks, u, state, outputs, account, frame):
    """Assign the OutputArrays of a state: kin and a (nb + 1, 6) are those of the outputs, lam (nc,) and u (nu,) what
    was applied. marks (nc + 1,): reactions that the motion does not determine, and their number; they are shown as NaN.
    account: of this state, where energies are shown.
    """
    x = tables.coordinates
    for k in range(x.kind.shape[0]):
        value, g_i, g_j = evaluate_coordinate(x, kin, k, state.angle)
        frame.joint_position[k] = value
        frame.joint_velocity[k] = coordinate_rate(x, kin, k, g_i, g_j)
        frame.joint_effort[k] = 0.0
    effort = tables.effort
    for k in range(effort.output.shape[0]):
        frame.joint_effort[effort.coordinate[k]] += effort.factor[k] * outputs[effort.output[k]]
    drives = tables.drives
    for k in range(drives.output.shape[0]):
        frame.joint_effort[drives.coordinate[k]] += drives.factor[k] * lam[drives.output[k]]
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
    for b in range(frame.acceleration.shape[0]):
        R, com, w = load33(kin.R, b), load3(tables.bodies.com, b), angular_velocity(kin, b)
        turning = (a[b, 3], a[b, 4], a[b, 5])
        v = sub(tmv(R, load3(a, b)), add(cross(turning, com), cross(w, cross(w, com))))
        for i in range(3):
            frame.acceleration[b, i] = v[i]
            frame.acceleration[b, 3 + i] = turning[i]
    R = load33(kin.R, chassis)
    gravity = (tables.bodies.gravity[0], tables.bodies.gravity[1], tables.bodies.gravity[2])
    force = tmv(R, add(load3(a, chassis), scale(-1.0, gravity)))
    w = angular_velocity(kin, chassis)
    for i in range(3):
        frame.imu[i] = force[i]
        frame.imu[3 + i] = w[i]
    elements = frame.elements.shape[0]
    for i in range(elements):
        frame.elements[i] = outputs[i]
    at = elements  # wheels come last
    for e in range(frame.tire.shape[0]):
        at += FIRST_COLUMN
        for i in range(frame.tire.shape[1]):
            frame.tire[e, i] = outputs[at + i]
        at += frame.tire.shape[1]
    for i in range(lam.shape[0]):
        frame.reactions[i] = lam[i]
    for i in range(u.shape[0]):
        frame.inputs[i] = u[i]
    show_energies(account, frame)
    if marks[-1] != 0.0:
        hide(tables.drives, marks, frame)
