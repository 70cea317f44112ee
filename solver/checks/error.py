"""The check of the numerical error of a run, which a twin with another step tells (solver.analysis.error_bar).

A run that says nothing of its error is expected to be right to a few percent. LARGEST lies in the middle, by ratio, of
1 and 5 %: an estimate is right to a factor of 2, so a run within 1 % is not suspect, and one that is off by more than 5
% is. Forces follow from small differences of motions, and slips at small speeds: they may be off by more.
"""

from __future__ import annotations

from solver.checks.check import Check

LARGEST = 0.02  # of the peak; ten times as much lets wrong runs pass, a tenth tells of what nobody sees
FORCE = 0.1  # of the peak, of what follows from small differences; ten times as much would let forces chatter
LIMITS = {
    **dict.fromkeys(
        ('position', 'orientation', 'heading', 'yaw_rate', 'roll', 'pitch', 'steering_wheel_angle', 'articulation'),
        LARGEST,
    ),
    **dict.fromkeys(
        ('longitudinal_velocity', 'sideslip_velocity', 'lateral_acceleration', 'longitudinal_acceleration'), LARGEST
    ),
    **dict.fromkeys(('wheel_load', 'tire_force.x', 'tire_force.y'), FORCE),
}
"""Quantity -> largest share of its peak that a run may be off by; others are shown, and decide nothing."""

NUMERICAL_ERROR = Check(
    name='numerical_error',
    unit='%',
    limit=100.0 * LARGEST,
    rule='largest error of a quantity over time, by a twin of the run with another step, of its peak; of wheel loads '
    f'and tire forces {100.0 * FORCE:g} %; of positions and orientations of a mechanism beside the largest way and '
    f'turn of its bodies; where a scene requires accuracy its limits take the place',
    measure=None,
    reason='the numerical error of {of} is too large',
    remedy='Reduce integrator.h',
    plan='coarse',
)
