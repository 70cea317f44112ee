"""Figures of a vehicle, computed from its own model.

Masses from the specification, modes from the linearised model (solver.analysis.modes), kinematics and compliance from a bench
(solver.analysis.kinematics_and_compliance), understeer and roll from a run. Angles in rad, SI units. Where they usually lie:
solver.analysis.usual.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from solver.analysis.kinematics_and_compliance import CORNERS, Rig, kinematic_figures, wheel_centers
from solver.analysis.modes import AXLES, named_modes
from solver.elements.road import RoadSpec
from solver.inputs.maneuver import Maneuver
from solver.inputs.signals import Ramp
from solver.model.frames import matrix
from solver.model.spec import ModelSpec
from solver.scene import Scene, StartSettings
from solver.simulation import Simulation
from solver.step.settings import IntegratorSettings
from solver.vehicle.hardpoints import SIDES


def mass_figures(spec: ModelSpec) -> dict[str, float]:
    """Mass [kg], centre of mass [m], principal directions' inertia about it [kg m^2], wheelbase, tracks [m], share of the front axle."""
    placed = [(b, np.array(b.position) + matrix(b.orientation) @ np.array(b.com)) for b in spec.bodies]
    mass = sum(b.mass for b, _ in placed)
    com = sum(b.mass * p for b, p in placed) / mass
    inertia = np.zeros((3, 3))
    for b, p in placed:
        R, d = matrix(b.orientation), p - com
        inertia += R @ b.inertia_matrix() @ R.T + b.mass * (d @ d * np.eye(3) - np.outer(d, d))
    at = wheel_centers(spec)
    x = {axle: 0.5 * (at[f'{axle}_left'][0] + at[f'{axle}_right'][0]) for axle in AXLES}
    track = {axle: at[f'{axle}_left'][1] - at[f'{axle}_right'][1] for axle in AXLES}
    wheelbase = x['front'] - x['rear']
    return {
        'mass': float(mass),
        'com_x': float(com[0]), 'com_y': float(com[1]), 'com_z': float(com[2]),
        'roll_inertia': float(inertia[0, 0]), 'pitch_inertia': float(inertia[1, 1]), 'yaw_inertia': float(inertia[2, 2]),
        'wheelbase': float(wheelbase), 'track_front': float(track['front']), 'track_rear': float(track['rear']),
        'front_share': float((com[0] - x['rear']) / wheelbase),
    }  # fmt: skip


def understeer_gradient(spec: ModelSpec, ratio: float, *, speed: float = 22.0, h: float = 2e-3) -> dict[str, float]:
    """Slow ramp of the steering wheel at nearly constant speed (ISO 4138, method 2): understeer gradient [rad s^2/m] and roll gradient
    [rad s^2/m] by a straight line through lateral accelerations up to 3.5 m/s^2. ratio: of the steering."""
    figures = mass_figures(spec)
    maneuver = Maneuver(steering=Ramp(slope=0.2, start=0.5, blend=0.4), drive_torque=Ramp(slope=20.0, initial=150.0, start=0.5, blend=0.2))
    scene = Scene(
        name='understeer', model=spec, start=StartSettings(kind='equilibrium', speed=speed), maneuver=maneuver,
        integrator=IntegratorSettings(h=h, penalty=1e6),
    )  # fmt: skip
    simulation = Simulation(scene)
    chassis = simulation.channels.chassis or 0
    rows = []
    for _ in range(400):
        s = simulation.advance(round(0.02 / h))
        v, r = np.hypot(*s.twist[chassis, :2]), s.twist[chassis, 5]
        x, y, z, w = s.pose[chassis, 3:]
        rows.append(
            (v * r, s.inputs[spec.inputs.index('steering')] / ratio - figures['wheelbase'] * r / v, np.arcsin(2.0 * (z * y + w * x)))
        )
        if v * r > 3.5:
            break
    a, understeer, roll = np.array(rows).T
    used = a > 0.5
    return {
        'understeer_gradient': float(np.polyfit(a[used], understeer[used], 1)[0]),
        'roll_gradient': float(np.polyfit(a[used], roll[used], 1)[0]),
    }


def sag(simulation: Simulation) -> dict[str, float]:
    """How much lower than designed the vehicle stands [m], per axle: the mean travel of its wheels."""
    names = simulation.channels.joints
    x = simulation.advance(0).joint_position
    return {f'sag_{axle}': float(np.mean([x[names.index(f'travel_{axle}_{side}')] for side in SIDES])) for axle in AXLES}


def is_vehicle(spec: ModelSpec) -> bool:
    """Whether the figures of this module can be computed: tires at the four corners."""
    return {tire.name for tire in spec.tires} == set(CORNERS)


def standing(scene: Scene) -> Simulation:
    """The vehicle of a scene standing in equilibrium on a flat road, wheels straight, no torque."""
    model = dataclasses.replace(scene.model, road=RoadSpec())
    return Simulation(
        dataclasses.replace(
            scene, model=model, start=StartSettings(kind='equilibrium'), maneuver=Maneuver(), integrator=IntegratorSettings(penalty=1e6)
        )
    )


def figures(simulation: Simulation) -> dict[str, float]:
    """All figures of a vehicle whose simulation stands at its start (see standing()), without modes where there are none of bodies alone
    (solver.analysis.modes); solver.analysis.usual tells what they are."""
    spec = simulation.model.spec
    found = mass_figures(spec)
    for name, mode in named_modes(simulation).items() if not spec.struts else ():
        key = name.replace(' ', '_')
        found |= {f'{key}_frequency': mode.frequency, f'{key}_damping': mode.damping}
    found |= kinematic_figures(Rig(spec)) | sag(simulation)
    return found | understeer_gradient(spec, found['steering_ratio'])
