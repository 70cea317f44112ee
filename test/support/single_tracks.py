"""A single track of plain numbers, on a road."""

from __future__ import annotations

import dataclasses
import functools

from solver.elements.road import RoadSpec
from solver.files.scene import load_scene
from solver.inputs.maneuver import Maneuver
from solver.levels.single_track import shown
from solver.levels.single_track_engine import SingleTrack
from solver.scene import Scene, StartSettings
from solver.simulation import Simulation
from solver.step.settings import IntegratorSettings

MODEL = shown(load_scene('light_car_straight').model)
STRAIGHT, FLAT = Maneuver(), RoadSpec()
AXLE = {
    'x': 1.2, 'half_track': 0.76, 'load': 7000.0, 'shifted': -1.0, 'stiffness_x': 150e3, 'stiffness_y': 90e3,
    'stiffness_load': 0.8,
    'peak_x': 7500.0, 'peak_y': 7000.0, 'shape_x': 1.5, 'shape_y': 1.3, 'curvature_x': 0.0, 'curvature_y': 0.0,
    'length_x': 0.15,
    'length_y': 0.4, 'steered': 1.0, 'roll_steer': -0.03, 'trail': 0.04, 'trail_lost': 0.04, 'radius': 0.298,
    'rolling_radius': 0.308,
    'inertia': 1.8, 'resistance': 0.01, 'drive': 1.0, 'top_spin': 230.0, 'brake': 0.7, 'brake_stiffness': 8e4,
    'brake_damping': 600.0,
}  # fmt: skip
PARAMETERS = {
    'mounting': {
        'x': -0.1, 'axis': 0.1, 'height': 0.0, 'pitch': 0.0, 'pitch_by_shift': -1.5e-5, 'pitch_by_drive': -2e-6,
        'pitch_by_roll': 0.5,
        'com_x': 0.1, 'com_y': 0.0, 'com_z': 0.6,
        'yaw': 0.0, 'gravity': 9.81,
    },
    'body': {
        'mass': 1400.0, 'yaw_inertia': 2300.0, 'roll_inertia': 1000.0, 'coupling': 800.0, 'product': -20.0,
        'roll_stiffness': 9e4,
        'roll_damping': 2700.0, 'drag': 0.4, 'height': 0.2, 'lag': 0.05, 'ratio': 1.0 / 16.0, 'ratio_3': 5e-5,
        'steering_inertia': 0.05,
        'steering_damping': 0.5, 'low_speed': 2.0, 'contact_time': 0.04,
    },
    'front': AXLE,
    'rear': AXLE | {
        'x': -1.45, 'load': 6500.0, 'shifted': 1.0, 'stiffness_y': 110e3, 'steered': 0.0, 'roll_steer': 0.0,
        'trail': 0.0,
        'trail_lost': 0.0, 'drive': 0.0, 'top_spin': 0.0, 'brake': 0.3,
    },
}  # fmt: skip


def simulation(
    maneuver: Maneuver = STRAIGHT,
    *,
    speed: float = 20.0,
    h: float = 1e-3,
    parameters: dict = PARAMETERS,
    road: RoadSpec = FLAT,
) -> Simulation:
    """A run of the model on a road."""
    scene = Scene(
        name='track', model=dataclasses.replace(MODEL, road=road), maneuver=maneuver,
        start=StartSettings(kind='equilibrium', speed=speed),
        integrator=IntegratorSettings(h=h), duration=10.0,
    )  # fmt: skip
    return track(scene, parameters)


def track(scene: Scene, parameters: dict = PARAMETERS) -> Simulation:
    """A scene of plain numbers."""
    return Simulation(scene, functools.partial(SingleTrack, parameters=parameters))
