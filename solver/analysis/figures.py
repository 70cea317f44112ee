"""Figures of a vehicle, computed from its own model, and where those of passenger cars lie.

Masses from the specification, modes from the linearised model (solver.analysis.modes), kinematics and compliance from a bench
(solver.analysis.kinematics_and_compliance), understeer and roll from a run. Angles in rad, SI units.
Usual ranges after [Reimpell2001], [Gillespie1992] and [Heydinger1999].
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

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


class Usual(NamedTuple):
    """A figure of a vehicle: what it is, its unit in text and the factor to it from SI, where passenger cars lie (SI), and who says so."""

    text: str
    unit: str
    factor: float
    low: float
    high: float
    source: str


R = 'Reimpell, Stoll, Betzler, The Automotive Chassis (2001)'
G = 'Gillespie, Fundamentals of Vehicle Dynamics (1992)'
H = 'Heydinger et al., SAE 1999-01-1336'
DEG = float(np.rad2deg(1.0))
# The books give orders of magnitude and signs, not limits: the ranges are drawn around what they call usual for a saloon.
USUAL: dict[str, Usual] = {
    'mass': Usual('mass', 'kg', 1.0, 1400, 1700, H),
    'front_share': Usual('share of the front axle', '', 1.0, 0.48, 0.60, H),
    'wheelbase': Usual('wheelbase', 'm', 1.0, 2.6, 2.8, H),
    'track_front': Usual('track, front', 'm', 1.0, 1.45, 1.62, H),
    'track_rear': Usual('track, rear', 'm', 1.0, 1.45, 1.62, H),
    'com_z': Usual('height of the centre of mass', 'm', 1.0, 0.50, 0.58, H),
    'roll_inertia': Usual('roll inertia', 'kg m^2', 1.0, 400, 700, H),
    'pitch_inertia': Usual('pitch inertia', 'kg m^2', 1.0, 2000, 2900, H),
    'yaw_inertia': Usual('yaw inertia', 'kg m^2', 1.0, 2200, 3100, H),
    'bounce_frequency': Usual('bounce', 'Hz', 1.0, 1.1, 1.6, G),
    'bounce_damping': Usual('bounce, damping ratio', '', 1.0, 0.15, 0.40, G),
    'pitch_frequency': Usual('pitch', 'Hz', 1.0, 1.1, 1.8, G),
    'roll_frequency': Usual('roll, on standing tires', 'Hz', 1.0, 1.1, 2.2, G),
    'wheel_hop_front_frequency': Usual('wheel hop, front', 'Hz', 1.0, 10, 15, G),
    'wheel_hop_rear_frequency': Usual('wheel hop, rear', 'Hz', 1.0, 10, 15, G),
    'engine_bounce_frequency': Usual('engine bounce', 'Hz', 1.0, 8, 14, R),
    'wheel_rate_front': Usual('wheel rate, front', 'kN/m', 1e-3, 18e3, 32e3, R),
    'wheel_rate_rear': Usual('wheel rate, rear', 'kN/m', 1e-3, 18e3, 34e3, R),
    'roll_stiffness_front': Usual('roll stiffness, front', 'N m/deg', 1.0 / DEG, 3.5e4, 7e4, R),
    'roll_stiffness_rear': Usual('roll stiffness, rear', 'N m/deg', 1.0 / DEG, 2.5e4, 6e4, R),
    'roll_center_front': Usual('roll-centre height, front', 'mm', 1e3, 0.0, 0.12, R),
    'roll_center_rear': Usual('roll-centre height, rear', 'mm', 1e3, 0.05, 0.18, R),
    'bump_toe_front': Usual('toe by bump, front (out: understeer)', 'deg/m', DEG, -0.12, 0.0, R),
    'bump_toe_rear': Usual('toe by bump, rear (in: understeer)', 'deg/m', DEG, 0.0, 0.10, R),
    'bump_camber_front': Usual('camber by bump, front', 'deg/m', DEG, -0.45, -0.10, R),
    'bump_camber_rear': Usual('camber by bump, rear', 'deg/m', DEG, -0.60, -0.15, R),
    'lateral_steer_front': Usual('steer by lateral force, front (away: understeer)', 'deg/kN', 1e3 * DEG, -4e-6, 0.0, R),
    'lateral_steer_rear': Usual('steer by lateral force, rear (towards: understeer)', 'deg/kN', 1e3 * DEG, 0.0, 3e-6, R),
    'longitudinal_compliance_front': Usual('longitudinal compliance, front', 'mm/kN', 1e6, 1e-6, 6e-6, R),
    'aligning_steer_front': Usual('steer by aligning moment, front', 'deg/(100 N m)', 1e2 * DEG, 5e-6, 8e-5, R),
    'steering_ratio': Usual('steering wheel to road wheel', '', 1.0, 13, 18, R),
    'understeer_gradient': Usual('understeer gradient', 'deg/g', 9.81 * DEG, 0.001, 0.007, G),
    'roll_gradient': Usual('roll gradient', 'deg/g', 9.81 * DEG, 0.0055, 0.0115, G),
}


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
    (solver.analysis.modes); USUAL tells what they are."""
    spec = simulation.model.spec
    found = mass_figures(spec)
    for name, mode in named_modes(simulation).items() if not spec.struts else ():
        key = name.replace(' ', '_')
        found |= {f'{key}_frequency': mode.frequency, f'{key}_damping': mode.damping}
    found |= kinematic_figures(Rig(spec))
    return found | understeer_gradient(spec, found['steering_ratio'])
