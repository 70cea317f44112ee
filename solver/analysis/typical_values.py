"""Typical values of the figures of vehicles (solver.analysis.figures), by category of vehicle.

The books give orders of magnitude and signs, not limits: the ranges are drawn around what they call usual.
[Reimpell2001], [Gillespie1992], [Heydinger1999], [Milliken1995] of docs/references.md. Static toe and camber are drawn
around settings and tolerances that five manufacturers publish [ServiceManuals2014]; those of racing cars are by
experience.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from solver.model.spec import ModelSpec
from solver.units import STANDARD_GRAVITY
from solver.vehicle.size import size_of


class Typical(NamedTuple):
    """A figure of a vehicle: what it is, its unit in text and the factor to it from SI, where it usually lies (SI), and
    who says so."""

    text: str
    unit: str
    factor: float
    low: float
    high: float
    source: str


R = 'Reimpell, Stoll, Betzler, The Automotive Chassis (2001)'
G = 'Gillespie, Fundamentals of Vehicle Dynamics (1992)'
H = 'Heydinger et al., SAE 1999-01-1336'
M = 'Milliken, Milliken, Race Car Vehicle Dynamics (1995)'
V = 'characteristic speeds of 65 to 100 km/h, euromotor.org, lectures on lateral dynamics'
S = 'alignment tables in service manuals of five passenger cars of 2000 to 2014 [ServiceManuals2014]'
K = 'orders of magnitude that are told of such cars; no measurement at hand'
OWN = 'what the rest asks for'
DEG = float(np.rad2deg(1.0))
TEXTS = {  # text, unit, factor from SI
    'mass': ('mass', 'kg', 1.0),
    'front_share': ('share of the front axle', '', 1.0),
    'wheelbase': ('wheelbase', 'm', 1.0),
    'track_front': ('track, front', 'm', 1.0),
    'track_rear': ('track, rear', 'm', 1.0),
    'com_z': ('height of the centre of mass', 'm', 1.0),
    'roll_inertia': ('roll inertia', 'kg m^2', 1.0),
    'pitch_inertia': ('pitch inertia', 'kg m^2', 1.0),
    'yaw_inertia': ('yaw inertia', 'kg m^2', 1.0),
    'sag_front': ('stands lower than designed, front', 'mm', 1e3),
    'sag_rear': ('stands lower than designed, rear', 'mm', 1e3),
    'toe_front': ('static toe of a wheel, front (in: positive)', 'deg', DEG),
    'toe_rear': ('static toe of a wheel, rear (in: positive)', 'deg', DEG),
    'camber_front': ('static camber, front (top inwards: negative)', 'deg', DEG),
    'camber_rear': ('static camber, rear (top inwards: negative)', 'deg', DEG),
    'bounce_frequency': ('bounce', 'Hz', 1.0),
    'bounce_damping': ('bounce, damping ratio', '', 1.0),
    'pitch_frequency': ('pitch', 'Hz', 1.0),
    'roll_frequency': ('roll, on standing tires', 'Hz', 1.0),
    'wheel_hop_front_frequency': ('wheel hop, front', 'Hz', 1.0),
    'wheel_hop_rear_frequency': ('wheel hop, rear', 'Hz', 1.0),
    'engine_bounce_frequency': ('engine bounce', 'Hz', 1.0),
    'wheel_rate_front': ('wheel rate, front', 'kN/m', 1e-3),
    'wheel_rate_rear': ('wheel rate, rear', 'kN/m', 1e-3),
    'roll_stiffness_front': ('roll stiffness, front', 'N m/deg', 1.0 / DEG),
    'roll_stiffness_rear': ('roll stiffness, rear', 'N m/deg', 1.0 / DEG),
    'roll_center_front': ('roll-centre height, front', 'mm', 1e3),
    'roll_center_rear': ('roll-centre height, rear', 'mm', 1e3),
    'bump_toe_front': ('toe by bump, front (out: understeer)', 'deg/m', DEG),
    'bump_toe_rear': ('toe by bump, rear (in: understeer)', 'deg/m', DEG),
    'roll_steer_front': ('roll steer, front (negative: understeer)', 'deg/deg', 1.0),
    'roll_steer_rear': ('roll steer, rear (positive: understeer)', 'deg/deg', 1.0),
    'bump_camber_front': ('camber by bump, front', 'deg/m', DEG),
    'bump_camber_rear': ('camber by bump, rear', 'deg/m', DEG),
    'lateral_steer_front': ('steer by lateral force, front (away: understeer)', 'deg/kN', 1e3 * DEG),
    'lateral_steer_rear': ('steer by lateral force, rear (towards: understeer)', 'deg/kN', 1e3 * DEG),
    'longitudinal_compliance_front': ('longitudinal compliance, front', 'mm/kN', 1e6),
    'longitudinal_compliance_rear': ('longitudinal compliance, rear', 'mm/kN', 1e6),
    'aligning_steer_front': ('steer by aligning moment, front', 'deg/(100 N m)', 1e2 * DEG),
    'steering_ratio': ('steering wheel to road wheel', '', 1.0),
    'ackermann': ("share of Ackermann's condition at 20 deg", '%', 1e2),
    'understeer_gradient': ('understeer gradient', 'deg/g', STANDARD_GRAVITY * DEG),
    'roll_gradient': ('roll gradient', 'deg/g', STANDARD_GRAVITY * DEG),
    'steering_sensitivity': (
        'lateral acceleration by steering wheel, at 100 km/h',
        'g/(100 deg)',
        1e2 / (STANDARD_GRAVITY * DEG),
    ),
    'response_time': ('response of lateral acceleration to a step, to 90 %', 's', 1.0),
    'hand_torque': ('torque at the steering wheel, at 0.33 g', 'N m', 1.0),
    'parking_rack_force': ('force of the rack, turned while standing', 'kN', 1e-3),
}
SALOON = {
    'mass': (1400, 1700, H),
    'front_share': (0.48, 0.60, H),
    'wheelbase': (2.6, 2.8, H),
    'track_front': (1.45, 1.62, H),
    'track_rear': (1.45, 1.62, H),
    'com_z': (0.50, 0.58, H),
    'roll_inertia': (400, 700, H),
    'pitch_inertia': (2000, 2900, H),
    'yaw_inertia': (2200, 3100, H),
    'sag_front': (-0.005, 0.005, OWN),
    'sag_rear': (-0.005, 0.005, OWN),
    'toe_front': (-0.25 / DEG, 0.25 / DEG, S),
    'toe_rear': (-0.1 / DEG, 0.35 / DEG, S),
    'camber_front': (-1.5 / DEG, 0.5 / DEG, S),
    'camber_rear': (-2.2 / DEG, 0.2 / DEG, S),
    'bounce_frequency': (1.1, 1.6, G),
    'bounce_damping': (0.15, 0.40, G),
    'pitch_frequency': (1.1, 1.8, G),
    'roll_frequency': (1.1, 2.2, G),
    'wheel_hop_front_frequency': (10, 15, G),
    'wheel_hop_rear_frequency': (10, 15, G),
    'engine_bounce_frequency': (8, 14, R),
    'wheel_rate_front': (18e3, 32e3, R),
    'wheel_rate_rear': (18e3, 34e3, R),
    'roll_stiffness_front': (3.5e4, 7e4, R),
    'roll_stiffness_rear': (2.5e4, 6e4, R),
    'roll_center_front': (0.0, 0.12, R),
    'roll_center_rear': (0.05, 0.18, R),
    'bump_toe_front': (-0.12, 0.0, R),
    'bump_toe_rear': (0.0, 0.10, R),
    'roll_steer_front': (-0.15, 0.0, R),
    'roll_steer_rear': (0.0, 0.10, R),
    'bump_camber_front': (-0.45, -0.10, R),
    'bump_camber_rear': (-0.60, -0.15, R),
    'lateral_steer_front': (-4e-6, 0.0, R),
    'lateral_steer_rear': (0.0, 3e-6, R),
    'longitudinal_compliance_front': (1.5e-6, 5e-6, R),
    'longitudinal_compliance_rear': (1.5e-6, 4.5e-6, R),
    'aligning_steer_front': (5e-6, 8e-5, R),
    'steering_ratio': (13, 18, R),
    'ackermann': (0.2, 0.8, K),
    'understeer_gradient': (0.0035, 0.0082, V),
    'roll_gradient': (0.0055, 0.0115, G),
    'steering_sensitivity': (4.5, 8.0, K),
    'response_time': (0.20, 0.42, K),
    'hand_torque': (3.0, 5.0, K),
    'parking_rack_force': (3e3, 9e3, K),
}
# How other categories differ; None: says nothing about them
COMPACT = {
    'mass': (1150, 1500, H),
    'front_share': (0.55, 0.65, H),
    'wheelbase': (2.45, 2.70, H),
    'roll_inertia': (350, 620, H),
    'pitch_inertia': (1400, 2400, H),
    'yaw_inertia': (1500, 2600, H),
    # a twist beam's is at the height of the lines from pivot to shear centre, over the axle
    'roll_center_rear': (0.0, 0.35, R),
    'bump_toe_rear': (-0.02, 0.10, R),  # in parallel travel both halves turn about one line across
    'bump_camber_rear': (-0.60, 0.05, R),
    # a twist beam gives way backwards on the outer side unless its bushings correct it
    'lateral_steer_rear': (-2e-6, 3e-6, R),
    # the bushings of a twist beam that carry its lateral forces are stiff along, too
    'longitudinal_compliance_rear': (0.8e-6, 4.5e-6, R),
    'steering_sensitivity': (4.5, 9.0, K),  # on a shorter wheelbase
}
PICKUP = {
    'mass': (1800, 2500, H),
    'front_share': (0.54, 0.62, H),
    'wheelbase': (2.9, 3.6, H),
    'track_front': (1.50, 1.75, H),
    'track_rear': (1.50, 1.75, H),
    'com_z': (0.60, 0.75, H),
    'roll_inertia': (600, 1100, H),
    'pitch_inertia': (3500, 6500, H),
    'yaw_inertia': (3800, 6800, H),
    'bounce_frequency': (1.2, 2.0, G),
    'pitch_frequency': (1.2, 2.2, G),
    'wheel_hop_rear_frequency': (8, 15, G),  # a live axle carries its differential, too
    'wheel_rate_front': (28e3, 60e3, R),
    'wheel_rate_rear': (25e3, 60e3, R),
    'roll_stiffness_front': (5e4, 12e4, R),
    'roll_stiffness_rear': (1.5e4, 6e4, R),
    # of a live axle on leaf springs: about the height of the springs over the ground
    'roll_center_rear': (0.30, 0.60, R),
    'bump_toe_rear': (-0.002, 0.002, R),  # a live axle does not toe
    'bump_camber_rear': (-0.002, 0.002, R),
    'lateral_steer_rear': (-2e-6, 3e-6, R),
    'steering_ratio': (14, 20, R),
    'understeer_gradient': (0.0040, 0.0098, V),
    'roll_gradient': (0.0065, 0.0130, G),
    'response_time': (0.25, 0.50, K),
    'parking_rack_force': (4e3, 14e3, K),
}
ELECTRIC = {
    'mass': (1650, 2300, H),
    'front_share': (0.45, 0.55, H),
    'wheelbase': (2.6, 3.0, H),
    'com_z': (0.42, 0.54, H),
    'pitch_inertia': (2200, 3600, H),
    'yaw_inertia': (2400, 4000, H),
    'wheel_rate_front': (22e3, 40e3, R),
    'wheel_rate_rear': (22e3, 42e3, R),
}
FORMULA = {
    'mass': (240, 340, M),
    'front_share': (0.44, 0.54, M),
    'wheelbase': (1.525, 1.70, M),
    'track_front': (1.10, 1.30, M),
    'track_rear': (1.05, 1.30, M),
    'com_z': (0.24, 0.34, M),
    'roll_inertia': (20, 60, M),
    'pitch_inertia': (60, 140, M),
    'yaw_inertia': (80, 170, M),
    'sag_front': (-0.002, 0.002, OWN),
    'sag_rear': (-0.002, 0.002, OWN),
    'toe_front': (-1.0 / DEG, 1.0 / DEG, K),
    'toe_rear': (-1.0 / DEG, 1.0 / DEG, K),
    'camber_front': (-4.0 / DEG, 0.5 / DEG, K),
    'camber_rear': (-4.0 / DEG, 0.5 / DEG, K),
    'bounce_frequency': (2.0, 4.0, M),
    'bounce_damping': (0.3, 0.8, M),
    'pitch_frequency': (2.5, 6.0, M),
    'roll_frequency': None,  # on tires as stiff as the springs rolling and swaying are one
    'wheel_hop_front_frequency': (13, 25, M),
    'wheel_hop_rear_frequency': (13, 25, M),
    'wheel_rate_front': (15e3, 40e3, M),
    'wheel_rate_rear': (15e3, 40e3, M),
    'roll_stiffness_front': (1.0e4, 3.0e4, M),
    'roll_stiffness_rear': (1.0e4, 3.0e4, M),
    'roll_center_front': (0.0, 0.06, M),
    'roll_center_rear': (0.0, 0.08, M),
    'bump_toe_front': (-0.06, 0.06, M),
    'bump_camber_front': (-1.2, -0.3, M),
    'bump_camber_rear': (-1.2, -0.3, M),
    'roll_steer_front': (-0.05, 0.05, M),
    'steering_ratio': (3.5, 7.0, M),
    'understeer_gradient': (-0.001, 0.003, M),
    'roll_gradient': (0.0010, 0.0030, M),
    'ackermann': None,  # a matter of its tires and turns
    'steering_sensitivity': None,  # as high as its direct gear makes it
    'response_time': (0.10, 0.30, K),
    'hand_torque': (2.0, 12.0, K),
    'parking_rack_force': (0.3e3, 4e3, K),
}
Range = tuple[float, float, str] | None
CATEGORIES: Mapping[str, Mapping[str, Range]] = {
    'saloon': {}, 'compact': COMPACT, 'pickup': PICKUP, 'electric': ELECTRIC, 'formula': FORMULA,
}  # fmt: skip


def typical_values(spec: ModelSpec) -> dict[str, Typical]:
    """Typical values of the figures of a vehicle of the category of a model; empty for one that is no passenger car in
    size (solver.vehicle.size)."""
    if not size_of(spec).ordinary:
        return {}
    ranges: dict[str, Range] = {**SALOON, **CATEGORIES[spec.category or 'saloon']}
    return {name: Typical(*TEXTS[name], *limits) for name, limits in ranges.items() if limits is not None}
