"""Engine on its mounts, propeller shaft, differential and half shafts of a driven axle.

    engine -spherical- propshaft_front -universal- propshaft_rear -constant velocity- drive_pinion -cylindrical-
    differential
    chassis -point on line- propshaft_front                                           (centre bearing, a point of the
                                                                                      shaft)
    differential -cylindrical- output_shaft -constant velocity- half_shaft -constant velocity- wheel      (left and
                                                                                                          right)

Length changes are taken up where shafts slide in splines: the drive pinion's flange and the output shafts in their side
gears. A shaft of one part has no centre bearing and no universal joint:

    engine -spherical- propshaft -constant velocity- drive_pinion -cylindrical- differential

and begins at another axle instead of the engine where it comes `through` that, as between two driven axles of a truck.
The torques that turn and brake it there act against the engine (solver.vehicle.transfer), so of the torque of both
axles each housing gets what belongs to it.

The drive torque acts at the differential, as in the reference maneuver: `differential` puts the input drive_torque on
the mean of the two output angles, so each side gets half of it and the housing the reaction. The gearbox is in neutral:
propeller shaft and pinion turn along through `final_drive`, the elasticity of half shafts and gear mesh, whose torque
acts on mean output angle minus pinion angle / ratio. Both are the generalized forces of an ideal open differential.
limited_slip adds the torque of a viscous lock over the difference of the output speeds (one more force element).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.dimensions import Length, Mass, Point, Rate, TurnDamping, TurnStiffness
from solver.elements.coordinate_force import CoordinateForceSpec
from solver.elements.joint import JointSpec
from solver.elements.laws import Law
from solver.elements.marker import Marker
from solver.elements.rigid_body import RigidBodySpec
from solver.validate import Vector, finite, require
from solver.vehicle.hardpoints import SIDES, marker_at, on_side
from solver.vehicle.parts import (
    LEFTWARDS,
    UP,
    Bushing,
    Part,
    Parts,
    joined,
    mounting,
    require_positive,
    require_resisting,
    rods,
    shaft_markers,
    vector_of,
)
from solver.vehicle.power import Power
from solver.vehicle.rotor import Rotor, rotor
from solver.vehicle.wheel_end import spin_axis

STUB = 0.08  # length of output shafts and pinion behind their flanges [m]


@dataclass(frozen=True, kw_only=True)
class Mount:
    """A bushing at a point [m]; None: the part is fixed there."""

    point: Point
    bushing: Bushing | None = None


@dataclass(frozen=True, kw_only=True)
class Engine:
    """Engine and gearbox in one. mounts: by name; `_left` in a name stands for a pair, the right one is mirrored.
    Without a bushing on the first mount the engine is fixed to its base and the others are ignored. power: what turns
    in it (None: the input is the torque at the differential)."""

    part: Part
    mounts: dict[str, Mount]
    power: Power | None = None


@dataclass(frozen=True, kw_only=True)
class Shaft:
    """A straight shaft. mass [kg], radius of the cylinder that has its inertia [m]."""

    mass: Mass
    radius: Length

    def __post_init__(self) -> None:
        require_positive('shaft', self, 'mass', 'radius')


@dataclass(frozen=True, kw_only=True)
class HalfShafts:
    """Half shafts of an axle; the left one, the right one is mirrored.

    output: centre of the inner joint; the outer one is at the wheel, `inset` [m] inwards of its centre along the spin
    axis. top_speed: mean speed of the outputs at which the engine's limiter ends the drive torque [rad/s]; None: it
    never does. limited_slip: torque that the faster output hands to the slower one, half of what their torques differ
    by, over the difference of their speeds [N m s/rad]. rotor: of a motor on the differential.
    """

    output: Point
    output_shaft: Shaft
    half_shaft: Shaft
    inset: Length
    limited_slip: Law | None = None
    top_speed: Rate | None = None
    rotor: Rotor | None = None

    def __post_init__(self) -> None:
        finite('driveline', 'inset', self.inset, low=0.0)
        require_positive('driveline', self, 'top_speed')
        require_resisting('driveline', 'limited_slip', self.limited_slip)


@dataclass(frozen=True, kw_only=True)
class Propshaft:
    """A propeller shaft and the final drive behind it.

    engine_flange, center_joint, pinion_flange: its joints, center_bearing: its bearing on the chassis [m]; one of a
    single part, propshaft_front, has neither center_bearing, center_joint nor propshaft_rear. through: the driven axle
    on whose housing engine_flange is (None: it is on the engine). ratio: of the final drive; stiffness [N m/rad] and
    damping [N m s/rad] of half shafts and mesh, at the outputs.
    """

    ratio: float
    stiffness: TurnStiffness
    damping: TurnDamping
    through: str | None = None
    engine_flange: Point
    center_bearing: Point | None = None
    center_joint: Point | None = None
    pinion_flange: Point
    propshaft_front: Shaft
    propshaft_rear: Shaft | None = None
    pinion: Shaft

    def __post_init__(self) -> None:
        require_positive('driveline', self, 'stiffness')
        # below it the crown wheel is on the other side
        require(self.ratio != 0.0, 'driveline', 'ratio', self.ratio, 'must not be 0')
        finite('driveline', 'damping', self.damping, low=0.0)
        second = ('center_bearing', 'center_joint', 'propshaft_rear')
        missing = [name for name in second if getattr(self, name) is None]
        whole = f'is missing: a shaft of two parts has {", ".join(second)}, one of a single part none of them'
        require(len(missing) in (0, len(second)), 'driveline', (*missing, '')[0], None, whole)


@dataclass(frozen=True, kw_only=True)
class Driveline(HalfShafts, Propshaft):
    """Propeller shaft, differential and half shafts of a rear-driven car. differential: housing, on identical mounts at
    `mounts`."""

    differential: Part
    mounts: tuple[Point, ...]
    mount_bushing: Bushing | None = None

    def __post_init__(self) -> None:
        HalfShafts.__post_init__(self)
        Propshaft.__post_init__(self)


class Base(NamedTuple):
    """Base that a drive is attached to. single, only_shaft: no other axle is driven, or has a propeller shaft, so that
    parts of the drive, or of its shaft, need not be named after the axle. housings: of the differentials of all driven
    axles that have one of their own. turning: the axis about which shafts along the car turn, forwards or backwards."""

    chassis: RigidBodySpec
    subframe: RigidBodySpec
    engine: RigidBodySpec | None
    single: bool
    only_shaft: bool
    housings: Mapping[str, RigidBodySpec]
    turning: Vector

    def name(self, part: str, axle: str) -> str:
        """Name of a part of the drive of an axle."""
        return part if self.single else f'{part}_{axle}'

    def of_shaft(self, part: str, axle: str) -> str:
        """Name of a part of the propeller shaft to an axle."""
        return part if self.only_shaft else f'{part}_{axle}'

    def powered(self, axle: str) -> RigidBodySpec:
        """The engine, which a drive needs."""
        require(self.engine is not None, f'drive of axle {axle!r}', 'engine', None, 'the car has none: add it')
        assert self.engine is not None
        return self.engine

    def flange(self, axle: str, through: str | None, engine: RigidBodySpec) -> RigidBodySpec:
        """Flange at which the propeller shaft to an axle begins."""
        others = [name for name in self.housings if name != axle]
        known = f'is no other driven axle whose differential has a housing; these are: {", ".join(others) or "none"}'
        require(through is None or through in others, f'drive of axle {axle!r}', 'through', through, known)
        return engine if through is None else self.housings[through]


class PropellerShaft(NamedTuple):
    """A propeller shaft where others take hold of it. body: its part at the engine, along `axis`; output: the
    coordinate of that against the engine, pinion: that of the drive pinion, both about `turning`; ratio: turns of these
    per turn of the wheels, below 0 where they turn the other way."""

    body: RigidBodySpec
    axis: Vector
    turning: Vector
    output: str
    pinion: str
    ratio: float


def engine(data: Engine, chassis: RigidBodySpec, subframe: RigidBodySpec) -> Parts:
    """The engine on its mounts: pairs on the subframe, single ones on the chassis."""
    body = data.part.body('engine', data.part.com)
    parts = [Parts(bodies=(body,))]
    rigid = next(iter(data.mounts.values())).bushing is None
    for name, mount in data.mounts.items():
        pair = name.endswith('_left')
        for side in ('left', 'right') if pair else ('left',):
            where = f'engine_mount_{name.removesuffix("_left") + "_" + side if pair else name}'
            base = subframe if pair else chassis
            parts.append(mounting(where, base, body, (mount.point,), mount.bushing, ideal='fixed', side=side))
            if rigid:
                return joined(parts)
    return joined(parts)


def driveline(
    data: Driveline, base: Base, wheels: Mapping[str, RigidBodySpec], axle: str, share: float
) -> tuple[Parts, tuple[str, str], PropellerShaft]:
    """(propeller shaft, differential and half shafts to the wheels (by side) of an axle; coordinates of the outputs;
    the shaft).

    share: of the input drive_torque [-]. Coordinates output_shaft_<corner>/angle and drive_pinion/angle, positive when
    rolling forward.
    """
    differential, lock = base.name('differential', axle), base.name('limited_slip', axle)
    housing = data.differential.body(differential, data.differential.com)
    shafts, outputs = half_shafts(data, housing, wheels, axle)
    drive = open_differential(differential, outputs, share=share, top_speed=data.top_speed)
    turning, shaft = propeller_shaft(data, base, housing, axle)
    parts = (
        Parts(bodies=(housing,)),
        mounting(
            f'{differential}_mount', base.subframe, housing, data.mounts, data.mount_bushing, ideal='fixed', axis=UP
        ),
        turning,
        shafts,
        Parts(coordinate_forces=(drive, final_drive(data, base, axle, outputs))),
        limited_slip(lock, outputs, data.limited_slip),
        rotor(data.rotor, differential.replace('differential', 'rotor'), housing, outputs),
    )
    return joined(parts), outputs, shaft


def half_shafts(
    data: HalfShafts, housing: RigidBodySpec, wheels: Mapping[str, RigidBodySpec], axle: str
) -> tuple[Parts, tuple[str, str]]:
    """(half shafts from a housing to the wheels (by side) of an axle; names of the coordinates of their outputs, left
    and right)."""
    parts = joined(half_shaft(data, housing, wheel, f'{axle}_{side}', side) for side, wheel in wheels.items())
    return parts, (f'output_shaft_{axle}_left/angle', f'output_shaft_{axle}_right/angle')


def open_differential(
    name: str, outputs: tuple[str, str], *, share: float = 1.0, top_speed: float | None = None
) -> CoordinateForceSpec:
    """A share [-] of the input drive_torque, halved between two outputs."""
    terms = tuple((output, 0.5) for output in outputs)
    return CoordinateForceSpec(name=name, terms=terms, input='drive_torque', input_gain=share, top_rate=top_speed)


def final_drive(data: Propshaft, base: Base, axle: str, outputs: tuple[str, str]) -> CoordinateForceSpec:
    """The elasticity between the mean of the outputs of an axle and the drive pinion."""
    halves = tuple((name, 0.5) for name in outputs)
    return CoordinateForceSpec(
        name=base.of_shaft('final_drive', axle),
        terms=(*halves, (f'{base.of_shaft("drive_pinion", axle)}/angle', -1.0 / data.ratio)),
        spring=Law.linear(data.stiffness), damper=Law.linear(data.damping),
    )  # fmt: skip


def limited_slip(name: str, outputs: tuple[str, str], law: Law | None) -> Parts:
    """A viscous lock over the difference of two outputs, if there is one."""
    if law is None:
        return Parts()
    return Parts(
        coordinate_forces=(CoordinateForceSpec(name=name, terms=((outputs[0], 1.0), (outputs[1], -1.0)), damper=law),)
    )


def half_shaft(data: HalfShafts, housing: RigidBodySpec, wheel: RigidBodySpec, corner: str, side: str) -> Parts:
    """Output shaft in the side gear and half shaft to the wheel."""
    sign = SIDES[side]
    spin = spin_axis(wheel)
    inner = on_side(side, data.output)
    outer = vector_of(np.array(wheel.position) - sign * data.inset * np.array(spin))
    along = vector_of(sign * np.subtract(outer, inner))  # to the left, so that both sides turn forward about it
    stub = vector_of(np.array(inner) - (0.0, sign * STUB, 0.0))
    output = rods(f'output_shaft_{corner}', ((data.output_shaft.mass, stub, inner, data.output_shaft.radius),))
    shaft = rods(f'half_shaft_{corner}', ((data.half_shaft.mass, inner, outer, data.half_shaft.radius),))
    bearing = marker_at(housing, inner, LEFTWARDS), marker_at(output, inner, LEFTWARDS)
    joints = (
        ('output_shaft', 'cylindrical', *bearing),
        ('half_shaft_inner', 'constant_velocity', *shaft_markers(output, shaft, inner, LEFTWARDS, along)),
        ('half_shaft_outer', 'constant_velocity', *shaft_markers(shaft, wheel, outer, along, spin)),
    )
    return Parts(
        bodies=(output, shaft),
        joints=tuple(JointSpec(name=f'{name}_{corner}', kind=kind, i=i, j=j) for name, kind, i, j in joints),
    )


def lengthwise(turning: Vector, a: Vector, b: Vector) -> Vector:
    """The direction of the line through two points that leads as `turning` does: of shafts to the front axle too, or
    their joints would be open by half a turn."""
    begin, end = (a, b) if (b[0] > a[0]) == (turning[0] > 0.0) else (b, a)
    return vector_of(np.subtract(end, begin))


def require_beginning(shafts: Mapping[str, Propshaft]) -> None:
    """Refuse shafts (by axle) that come through each other: nothing would turn or hold them. Raises SpecError."""
    for axle in shafts:
        chain, at = [axle], shafts[axle].through
        while at is not None and at in shafts and at not in chain:
            chain.append(at)
            at = shafts[at].through
        round_ = len(chain) > 1 and at == axle
        remedy = f'the shafts to {", ".join(chain)} come through each other: let one of them begin at the engine'
        require(not round_, f'drive of axle {axle!r}', 'through', shafts[axle].through, remedy)


def propeller_shaft(data: Propshaft, base: Base, housing: RigidBodySpec, axle: str) -> tuple[Parts, PropellerShaft]:
    """(propeller shaft to the housing of an axle, of two parts with a centre bearing or of one, and drive pinion; where
    to hold it)."""
    engine = base.flange(axle, data.through, base.powered(axle))
    front, rear = data.engine_flange, data.pinion_flange
    centre = rear if data.center_joint is None else data.center_joint
    end = vector_of(np.array(rear) + (math.copysign(STUB, rear[0] - front[0]), 0.0, 0.0))
    whole = 'propshaft' if data.propshaft_rear is None else 'propshaft_front'
    first = rods(base.of_shaft(whole, axle), ((data.propshaft_front.mass, front, centre, data.propshaft_front.radius),))
    axis_front = axis = lengthwise(base.turning, centre, front)
    last = first
    joints: tuple[tuple[str, str, Marker, Marker], ...] = (
        ('propshaft_flange', 'spherical', marker_at(engine, front), marker_at(first, front)),
    )
    bodies: tuple[RigidBodySpec, ...] = (first,)
    if data.propshaft_rear is not None and data.center_bearing is not None:
        last = rods(
            base.of_shaft('propshaft_rear', axle),
            ((data.propshaft_rear.mass, centre, rear, data.propshaft_rear.radius),),
        )
        axis = lengthwise(base.turning, rear, centre)
        # along a line of the chassis: rows of one in the shaft would turn with it, and iterations gain less
        # (docs/decisions/0002)
        bearing = marker_at(base.chassis, data.center_bearing, axis_front), marker_at(first, data.center_bearing)
        bodies = (first, last)
        joints += (
            ('propshaft_bearing', 'point_on_line', *bearing),
            ('propshaft_joint', 'universal', *shaft_markers(first, last, centre, axis_front, axis)),
        )
    pinion = rods(base.of_shaft('drive_pinion', axle), ((data.pinion.mass, rear, end, data.pinion.radius),))
    joints += (
        ('propshaft_pinion', 'constant_velocity', *shaft_markers(last, pinion, rear, axis, base.turning)),
        ('drive_pinion', 'cylindrical', marker_at(housing, rear, base.turning), marker_at(pinion, rear, base.turning)),
    )
    parts = Parts(
        bodies=(*bodies, pinion),
        joints=tuple(JointSpec(name=base.of_shaft(name, axle), kind=kind, i=i, j=j) for name, kind, i, j in joints),
    )
    return parts, PropellerShaft(
        first, axis_front, base.turning, base.of_shaft('gearbox_output', axle), f'{pinion.name}/angle', data.ratio
    )
