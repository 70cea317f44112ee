"""The named quantities of a vehicle: unit, least peak and explanation. How they are computed: solver.quantities.

What only needs their names and units, as a comparison of two recordings, imports no element and no compiler by it.
"""

from __future__ import annotations

from typing import NamedTuple


class Named(NamedTuple):
    """A named quantity of a vehicle. least: smallest peak to which percentages refer. text: explanation."""

    unit: str
    least: float
    text: str


NAMED: dict[str, Named] = {
    'position': Named('m', 1.0, 'place of base_link on the ground, x and y; the error is a distance'),
    'heading': Named('rad', 0.01, 'yaw angle'),
    'yaw_rate': Named('rad/s', 0.01, 'yaw velocity, the rate of the yaw angle'),
    'longitudinal_velocity': Named('m/s', 0.1, 'horizontal velocity of base_link along X'),
    'sideslip_velocity': Named('m/s', 0.02, 'horizontal velocity of base_link along Y, the lateral velocity'),
    'sideslip_angle': Named('rad', 0.001, 'angle between X and the horizontal velocity of base_link'),
    'longitudinal_acceleration': Named('m/s^2', 0.1, 'horizontal acceleration along X'),
    'lateral_acceleration': Named('m/s^2', 0.1, 'horizontal acceleration along Y'),
    'roll': Named('rad', 0.001, 'vehicle roll angle'),
    'pitch': Named('rad', 0.001, 'vehicle pitch angle'),
    'steering_wheel_angle': Named('rad', 0.01, 'angle of the steering wheel, positive to the left'),
    'steering_torque': Named(
        'N m', 0.1, 'hand torque: what the imposed angle of the steering wheel takes, or what turns it'
    ),
}
BY_WHEEL: dict[str, Named] = {
    'wheel_load': Named('N', 100.0, 'force of the road on the tire along its normal'),
    'tire_force': Named('N', 100.0, 'force on the tire in the contact frame; add .x, .y or .z'),
    'slip_angle': Named('rad', 0.001, 'slip angle of the tire'),
    'slip': Named('1', 0.001, 'longitudinal slip of the tire'),
    'suspension_travel': Named('m', 0.001, 'travel of the wheel, positive in bump'),
}
