"""Numbers with their units, for the hints of specifications: solver.files.schema reads the unit there, for tables, axes
and suffixes.

`Length | None` and `tuple[Length, ...]` have the unit too. Who needs one that is not here writes Annotated[float,
'W/K']. A quantity whose meaning bounds it also carries the bound (Within): a number beyond it is one in another unit,
and files with it are refused.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

# rad at the steering wheel, from the middle: lorries have 18; ten times as much would let 57 deg pass for 57 rad
LOCK = 20.0

# relative rounding of a bound that a number may meet: 360 deg are one turn; 1e-8 would do as well
BOUND_ROUNDING = 1e-9


class Within(NamedTuple):
    """The largest magnitude, in the unit of the hint, with which a quantity still means something. `what` ends "is too
    large for ...".

    Ten times as much would let degrees pass for radians.
    """

    most: float
    what: str


Time = Annotated[float, 's']
Frequency = Annotated[float, 'Hz']
PerSecond = Annotated[float, '1/s']

Length = Annotated[float, 'm']
Area = Annotated[float, 'm^2']
Speed = Annotated[float, 'm/s']
Acceleration = Annotated[float, 'm/s^2']
Angle = Annotated[float, 'rad', Within(2.0 * math.pi, 'an angle (one turn at most)')]
# of race cars up to 3 deg
Toe = Annotated[float, 'rad', Within(math.radians(5.0), 'the toe of a wheel (5 deg at most)')]
# of race cars up to 6 deg
Camber = Annotated[float, 'rad', Within(math.radians(10.0), 'the camber of a wheel (10 deg at most)')]
WheelTurn = Annotated[float, 'rad', Within(LOCK, 'the angle of a steering wheel (20 rad, three turns, at most)')]
# of steering robots up to 44 rad/s
HandRate = Annotated[float, 'rad/s', Within(60.0, 'the rate of a steering wheel (60 rad/s at most)')]
Rate = Annotated[float, 'rad/s']  # of rotation
YawRate = Annotated[float, 'rad/s', Within(1.0, 'the threshold of a yaw rate (57 deg/s at most)')]

Mass = Annotated[float, 'kg']
Inertia = Annotated[float, 'kg m^2']
Density = Annotated[float, 'kg/m^3']

Force = Annotated[float, 'N']
Torque = Annotated[float, 'N m']
Pressure = Annotated[float, 'Pa']
Energy = Annotated[float, 'J']
Stiffness = Annotated[float, 'N/m']
Damping = Annotated[float, 'N s/m']
TurnStiffness = Annotated[float, 'N m/rad']
TurnDamping = Annotated[float, 'N m s/rad']
ConverterCapacity = Annotated[float, 'N m s^2/rad^2']
Understeer = Annotated[float, 'rad s^2/m', Within(0.05, 'an understeer gradient (1 deg/g is 0.00178 rad s^2/m)')]

Point = tuple[Length, Length, Length]
Place = tuple[Length, Length]  # on the ground, and steps and sizes there
Moments = tuple[Inertia, Inertia, Inertia]
