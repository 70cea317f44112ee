"""Numbers with their units, for the hints of specifications: solver.files.schema reads the unit there, for tables, axes and suffixes.

`Length | None` and `tuple[Length, ...]` have the unit too. Who needs one that is not here writes Annotated[float, 'W/K'].
"""

from __future__ import annotations

from typing import Annotated

Time = Annotated[float, 's']
Frequency = Annotated[float, 'Hz']
PerSecond = Annotated[float, '1/s']

Length = Annotated[float, 'm']
Area = Annotated[float, 'm^2']
Speed = Annotated[float, 'm/s']
Acceleration = Annotated[float, 'm/s^2']
Angle = Annotated[float, 'rad']
Rate = Annotated[float, 'rad/s']  # of rotation

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
Understeer = Annotated[float, 'rad s^2/m']

Point = tuple[Length, Length, Length]
Place = tuple[Length, Length]  # on the ground, and steps and sizes there
Moments = tuple[Inertia, Inertia, Inertia]
