"""Bulk properties of a vehicle that its single-track model conserves: masses, lengths, inertia of all that turns with
the wheels, drag, brakes."""

from __future__ import annotations

from typing import Any

import numpy as np

from solver.compiled.portable import product
from solver.elements.rigid_body import RigidBodySpec
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.inputs.maneuver import Maneuver
from solver.levels.single_track_engine import AXLES
from solver.levels.track_runs import Drive, whole_vehicle
from solver.model.frames import matrix
from solver.model.spec import ModelSpec
from solver.vehicle.hardpoints import SIDES
from solver.vehicle.size import size_of


def masses(model: ModelSpec) -> dict[str, Any]:
    """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg m^2] of all bodies in the design position."""
    placed = [(b, np.array(matrix(b.orientation)), np.array(b.position)) for b in model.bodies]
    placed = [(b, R, p + product(R, b.com)) for b, R, p in placed]
    mass = sum(b.mass for b, _, _ in placed)
    com = sum(b.mass * p for b, _, p in placed) / mass
    inertia = np.zeros((3, 3))
    for b, R, p in placed:
        d = p - com
        inertia += product(product(R, b.inertia_matrix()), R.T.copy()) + b.mass * (
            product(d, d) * np.eye(3) - d[:, None] * d
        )
    return {'mass': mass, 'com': com, 'inertia': inertia}


def turning(model: ModelSpec, speed: float) -> tuple[dict[str, float], float]:
    """(inertia of both wheels of each axle, inertia of all else that turns with them), in kg m^2 of the mean spin of
    its axle.

    From the kinetic energy of a vehicle that rolls straight on: nothing else turns then.
    """
    simulation = whole_vehicle(model, Drive(speed=speed, maneuver=Maneuver(), duration=1.0))
    state, spec = simulation.state, simulation.model.spec
    energy = {
        b.name: float(product(product(w, b.inertia_matrix()), w))
        for b, w in zip(spec.bodies, state.v[:-1, 3:], strict=True)
    }
    spin = float(np.mean(simulation.snapshot().tire[:, TIRE_COLUMNS.index('spin')]))
    own = dict.fromkeys(AXLES, 0.0)
    for tire in spec.tires:
        own[tire.name.partition('_')[0]] += energy.pop(tire.marker.body)
    return {axle: value / spin**2 for axle, value in own.items()}, sum(energy.values()) / spin**2


def drag(model: ModelSpec) -> float:
    """Drag over the square of the speed [kg/m]."""
    return float(sum(0.5 * a.air_density * a.drag_area for a in model.aero_drags))


def top_spin(model: ModelSpec, axle: str) -> float:
    """Spin at which the drive torque of an axle ends [rad/s], 0: never."""
    drives = [force for force in model.coordinate_forces if force.input == 'drive_torque']
    own = [force for force in drives if any(f'{axle}_{side}' in name for name, _ in force.terms for side in SIDES)]
    return min(
        (float(force.top_rate / abs(sum(factor for _, factor in force.terms))) for force in own if force.top_rate),
        default=0.0,
    )


def brakes(model: ModelSpec, axle: str) -> tuple[float, float]:
    """(stiffness [N m/rad], damping [N m s/rad]) of the wind-up of the brakes of an axle."""
    found = [b for b in model.brakes if b.coordinate.startswith(f'wheel_{axle}')]
    if not found:
        size = size_of(model)
        return 4e4 * size.torque, 200.0 * size.torque * size.time
    return float(sum(b.stiffness for b in found)), float(sum(b.damping for b in found)) or 1e-3 * float(
        sum(b.stiffness for b in found)
    )


def axis_of(wheel: RigidBodySpec, corner: str, model: ModelSpec) -> tuple[Any, Any]:
    """(centre, axis of spin) of a wheel in the design position."""
    tire = next(t for t in model.tires if t.name == corner)
    R = np.array(matrix(wheel.orientation))
    centre = np.array(wheel.position) + product(R, tire.marker.position)
    axis = product(R, np.array(matrix(tire.marker.orientation))[:, 1])
    return tuple(centre.tolist()), tuple(axis.tolist())


def wheelbase_of(model: ModelSpec) -> tuple[float, float]:
    """x of both axles in the design position [m]."""
    bodies = {b.name: b for b in model.bodies}
    at = {t.name: axis_of(bodies[t.marker.body], t.name, model)[0][0] for t in model.tires}
    front, rear = (0.5 * (at[f'{axle}_left'] + at[f'{axle}_right']) for axle in AXLES)
    return front, rear
