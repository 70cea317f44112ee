"""Drives of an axle. Each takes its share of the input drive_torque.

propshaft     differential on the subframe behind a propeller shaft, half shafts        (solver.vehicle.powertrain)
half_shafts   differential on the subframe, or in the gearbox of the engine (transverse engine), half shafts
live_axle     differential in the housing of a live axle, behind a propeller shaft
motors        a motor per wheel, on the chassis or in the upright
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from solver.dimensions import Point, Rate
from solver.elements.coordinate import CoordinateSpec
from solver.elements.coordinate_force import CoordinateForceSpec
from solver.elements.laws import Law
from solver.elements.rigid_body import RigidBodySpec
from solver.validate import require
from solver.vehicle.hardpoints import marker_at
from solver.vehicle.parts import (
    LEFTWARDS,
    UP,
    Bushing,
    Corner,
    Part,
    Parts,
    joined,
    mounting,
    require_positive,
    require_resisting,
)
from solver.vehicle.powertrain import (
    Base,
    Driveline,
    HalfShafts,
    Propshaft,
    driveline,
    final_drive,
    half_shafts,
    limited_slip,
    open_differential,
    propeller_shaft,
)
from solver.vehicle.rotor import Rotor, rotor
from solver.vehicle.transfer import Driven
from solver.vehicle.wheel_end import spin_axis


@dataclass(frozen=True, kw_only=True)
class PropshaftDrive(Driveline):
    """Propeller shaft, differential on the subframe, half shafts. share: of the drive torque that goes to the axle
    [-]."""

    kind: Literal['propshaft'] = 'propshaft'
    share: float = 1.0

    def parts(self, axle: str, base: Base, corners: Mapping[str, Corner]) -> Driven:
        """The drive of an axle."""
        wheels = {side: corner.wheel for side, corner in corners.items()}
        parts, outputs, shaft = driveline(self, base, wheels, axle, self.share)
        return Driven(parts, self.kind, self.share, outputs, shaft)

    def housing(self, axle: str, base: Base, corners: Mapping[str, Corner]) -> RigidBodySpec:
        """Housing of the differential."""
        return self.differential.body(base.name('differential', axle), self.differential.com)


@dataclass(frozen=True, kw_only=True)
class HalfShaftDrive(HalfShafts):
    """A differential with half shafts, without a propeller shaft of its own. differential: its housing on identical
    mounts at `mounts`; None: it is a part of the engine. share: of the drive torque that goes to the axle [-]."""

    kind: Literal['half_shafts'] = 'half_shafts'
    share: float = 1.0
    differential: Part | None = None
    mounts: tuple[Point, ...] = ()
    mount_bushing: Bushing | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        placed = bool(self.mounts) == (self.differential is not None)
        require(placed, 'drive', 'mounts', self.mounts, 'belong to a differential of its own: give both or neither')

    def parts(self, axle: str, base: Base, corners: Mapping[str, Corner]) -> Driven:
        """The drive of an axle."""
        name = base.name('differential', axle)
        if self.differential is None:
            housing, own = base.powered(axle), Parts()
        else:
            housing = self.differential.body(name, self.differential.com)
            feet = mounting(
                f'{name}_mount', base.subframe, housing, self.mounts, self.mount_bushing, ideal='fixed', axis=UP
            )
            own = joined((Parts(bodies=(housing,)), feet))
        shafts, outputs = half_shafts(self, housing, {side: corner.wheel for side, corner in corners.items()}, axle)
        drive = Parts(coordinate_forces=(open_differential(name, outputs, share=self.share, top_speed=self.top_speed),))
        lock = limited_slip(base.name('limited_slip', axle), outputs, self.limited_slip)
        parts = joined((own, shafts, drive, lock, rotor(self.rotor, base.name('rotor', axle), housing, outputs)))
        return Driven(parts, self.kind, self.share, outputs, inside=self.differential is None)

    def housing(self, axle: str, base: Base, corners: Mapping[str, Corner]) -> RigidBodySpec | None:
        """Housing of the differential, None for one in the gearbox."""
        return (
            None
            if self.differential is None
            else self.differential.body(base.name('differential', axle), self.differential.com)
        )


@dataclass(frozen=True, kw_only=True)
class LiveAxleDrive(Propshaft):
    """A propeller shaft to the differential in the housing of a live axle. share: of the drive torque that goes to the
    axle [-]. limited_slip, top_speed, rotor: as of HalfShafts."""

    kind: Literal['live_axle'] = 'live_axle'
    share: float = 1.0
    limited_slip: Law | None = None
    top_speed: Rate | None = None
    rotor: Rotor | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive('driveline', self, 'top_speed')
        require_resisting('driveline', 'limited_slip', self.limited_slip)

    def parts(self, axle: str, base: Base, corners: Mapping[str, Corner]) -> Driven:
        """The drive of an axle."""
        housing = self.housing(axle, base, corners)
        require(
            housing is not None,
            f'drive of axle {axle!r}',
            'kind',
            self.kind,
            'is for a suspension of this kind: choose half_shafts',
        )
        assert housing is not None
        turning, shaft = propeller_shaft(self, base, housing, axle)
        outputs = (f'wheel_{axle}_left', f'wheel_{axle}_right')
        shafts: tuple[CoordinateSpec, ...] = ()
        # through joints in the kingpins: the torque turns the knuckles about these
        if corners['left'].upright.name != housing.name:
            outputs = (f'shaft_{axle}_left', f'shaft_{axle}_right')
            shafts = tuple(wheel_shaft(f'{axle}_{side}', housing, corner.wheel) for side, corner in corners.items())
        forces = open_differential(base.name('differential', axle), outputs, share=self.share, top_speed=self.top_speed)
        parts = (
            turning,
            Parts(coordinates=shafts, coordinate_forces=(forces, final_drive(self, base, axle, outputs))),
            limited_slip(base.name('limited_slip', axle), outputs, self.limited_slip),
            rotor(self.rotor, base.name('rotor', axle), housing, outputs),
        )
        return Driven(joined(parts), self.kind, self.share, outputs, shaft)

    def housing(self, axle: str, base: Base, corners: Mapping[str, Corner]) -> RigidBodySpec | None:
        """That of the axle, which holds the differential."""
        return corners['left'].housing


@dataclass(frozen=True, kw_only=True)
class Motors:
    """A motor per wheel: `chassis` on the chassis, with ideal shafts, `upright` in the wheel. share: of the drive
    torque that goes to the axle [-], half to each wheel. top_speed: speed of the wheel at which it ends [rad/s]. rotor:
    of each of them (None: its inertia is not modelled)."""

    kind: Literal['motors'] = 'motors'
    share: float = 1.0
    on: Literal['chassis', 'upright'] = 'chassis'
    top_speed: Rate | None = None
    rotor: Rotor | None = None

    def __post_init__(self) -> None:
        require_positive('motors', self, 'top_speed')

    def parts(self, axle: str, base: Base, corners: Mapping[str, Corner]) -> Driven:
        """The drive of an axle."""
        shafts: tuple[CoordinateSpec, ...] = ()
        outputs = (f'wheel_{axle}_left', f'wheel_{axle}_right')
        if self.on == 'chassis':
            outputs = (f'shaft_{axle}_left', f'shaft_{axle}_right')
            shafts = tuple(
                wheel_shaft(f'{axle}_{side}', base.chassis, corner.wheel) for side, corner in corners.items()
            )
        forces = tuple(
            CoordinateForceSpec(
                name=f'motor_{axle}_{side}', terms=((output, 1.0),), input='drive_torque',
                input_gain=0.5 * self.share, top_rate=self.top_speed,
            )
            for side, output in zip(corners, outputs, strict=True)
        )  # fmt: skip
        turning = tuple(
            rotor(
                self.rotor, f'rotor_{axle}_{side}', base.chassis if self.on == 'chassis' else corner.upright, (output,),
                at=corner.wheel.position, axis=LEFTWARDS if self.on == 'chassis' else spin_axis(corner.wheel),
            )
            for (side, corner), output in zip(corners.items(), outputs, strict=True)
        )  # fmt: skip
        return Driven(
            joined((Parts(coordinates=shafts, coordinate_forces=forces), *turning)), self.kind, self.share, outputs
        )

    def housing(self, axle: str, base: Base, corners: Mapping[str, Corner]) -> None:
        """Motors have none."""


Drive = PropshaftDrive | HalfShaftDrive | LiveAxleDrive | Motors


def wheel_shaft(corner: str, base: RigidBodySpec, wheel: RigidBodySpec) -> CoordinateSpec:
    """Coordinate shaft_<corner>: rotation of a wheel against the chassis, or the housing of a live axle, as an ideal
    shaft with constant-velocity joints has it."""
    return CoordinateSpec(
        name=f'shaft_{corner}', kind='rotation', i=marker_at(base, wheel.position, LEFTWARDS),
        j=marker_at(wheel, wheel.position, spin_axis(wheel)),
    )  # fmt: skip
