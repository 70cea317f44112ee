"""Engine on its mounts, two-part propeller shaft, differential and half shafts of a rear-driven car.

    engine -spherical- propshaft_front -universal- propshaft_rear -constant velocity- drive_pinion -cylindrical- differential
    chassis -point on line- propshaft_front                                           (centre bearing)
    differential -cylindrical- output_shaft -constant velocity- half_shaft -constant velocity- wheel      (left and right)

Length changes are taken up where shafts slide in splines: the drive pinion's flange and the output shafts in their side gears.

The drive torque acts at the differential, as in the reference maneuver: `differential` puts the input drive_torque on the mean of the two
output angles, so each side gets half of it and the housing the reaction. The gearbox is in neutral: propeller shaft and pinion turn
along through `final_drive`, the elasticity of half shafts and gear mesh, whose torque acts on mean output angle minus pinion
angle / ratio. Both are the generalized forces of an ideal open differential. limited_slip adds the torque of a viscous lock over the
difference of the output speeds (one more force element).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.elements.coordinate_force import CoordinateForceSpec
from solver.elements.joint import JointSpec
from solver.elements.laws import Law
from solver.elements.marker import Vector, finite
from solver.elements.rigid_body import RigidBodySpec
from solver.vehicle.corner import Part, spin_axis
from solver.vehicle.hardpoints import marker_at, on_side
from solver.vehicle.parts import LEFTWARDS, Bushing, Parts, joined, mounting, rods, shaft_markers

FORWARD: Vector = (1.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class Mount:
    """A bushing at a point [m]; None: the part is fixed there."""

    point: Vector
    bushing: Bushing | None = None


@dataclass(frozen=True, kw_only=True)
class Engine:
    """Engine and gearbox in one. mounts: by name; `_left` in a name stands for a pair, the right one is mirrored. Without a bushing on
    the first mount the engine is fixed to its base and the others are ignored."""

    part: Part
    mounts: dict[str, Mount]


@dataclass(frozen=True, kw_only=True)
class Shaft:
    """A straight shaft. mass [kg], radius of the cylinder that has its inertia [m]."""

    mass: float
    radius: float


@dataclass(frozen=True, kw_only=True)
class Driveline:
    """Data of the driveline; the left half shaft, the right one is mirrored.

    differential: housing, on identical mounts at `mounts`. output: centre of the inner joint of the half shaft; the outer one is
    at the wheel, `inset` [m] inwards of its centre along the spin axis. ratio: of the final drive; stiffness [N m/rad] and damping
    [N m s/rad] of half shafts and mesh, at the outputs. engine_flange, center_joint, pinion_flange: joints of the propeller shaft,
    center_bearing: its bearing on the chassis [m]. limited_slip: locking torque over the difference of the output speeds [N m s/rad].
    """

    differential: Part
    mounts: tuple[Vector, ...]
    mount_bushing: Bushing | None = None
    output: Vector
    output_shaft: Shaft
    half_shaft: Shaft
    inset: float
    ratio: float
    stiffness: float
    damping: float
    engine_flange: Vector
    center_bearing: Vector
    center_joint: Vector
    pinion_flange: Vector
    propshaft_front: Shaft
    propshaft_rear: Shaft
    pinion: Shaft
    limited_slip: Law | None = None

    def __post_init__(self) -> None:
        finite('driveline', 'inset', self.inset, low=0.0)
        finite('driveline', 'stiffness', self.stiffness, low=0.0, strict=True)


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
    data: Driveline,
    chassis: RigidBodySpec,
    engine: RigidBodySpec,
    subframe: RigidBodySpec,
    wheels: dict[str, RigidBodySpec],
    axle: str,
) -> Parts:
    """Propeller shaft, differential and half shafts to the wheels (by side) of an axle.

    Coordinates output_shaft_<corner>/angle and drive_pinion/angle, positive when rolling forward.
    """
    housing = data.differential.body('differential', data.differential.com)
    parts = [Parts(bodies=(housing,)), mounting('differential_mount', subframe, housing, data.mounts, data.mount_bushing, ideal='fixed', axis=(0, 0, 1))]
    parts.append(propeller_shaft(data, chassis, engine, housing))
    outputs = []
    for side, wheel in wheels.items():
        corner = f'{axle}_{side}'
        parts.append(half_shaft(data, housing, wheel, corner, side))
        outputs.append(f'output_shaft_{corner}/angle')
    halves = tuple((name, 0.5) for name in outputs)
    forces = [
        CoordinateForceSpec(name='differential', terms=halves, input='drive_torque'),
        CoordinateForceSpec(
            name='final_drive', terms=(*halves, ('drive_pinion/angle', -1.0 / data.ratio)),
            spring=Law.linear(data.stiffness), damper=Law.linear(data.damping),
        ),
    ]  # fmt: skip
    if data.limited_slip is not None:
        forces.append(CoordinateForceSpec(name='limited_slip', terms=((outputs[0], 1.0), (outputs[1], -1.0)), damper=data.limited_slip))
    return joined((*parts, Parts(coordinate_forces=tuple(forces))))


def half_shaft(data: Driveline, housing: RigidBodySpec, wheel: RigidBodySpec, corner: str, side: str) -> Parts:
    """Output shaft in the side gear and half shaft to the wheel."""
    inner = np.array(on_side(side, data.output))
    spin = np.array(spin_axis(wheel))
    inwards = -1.0 if side == 'left' else 1.0
    outer = np.array(wheel.position) + inwards * data.inset * spin
    along = outer - inner if side == 'left' else inner - outer  # to the left, so that both sides turn forward about it
    stub = inner + (0.0, inwards * 0.08, 0.0)
    output = rods(f'output_shaft_{corner}', ((data.output_shaft.mass, tuple(stub), tuple(inner), data.output_shaft.radius),))
    shaft = rods(f'half_shaft_{corner}', ((data.half_shaft.mass, tuple(inner), tuple(outer), data.half_shaft.radius),))
    inner_joint = shaft_markers(output, shaft, tuple(inner), LEFTWARDS, along)
    outer_joint = shaft_markers(shaft, wheel, tuple(outer), along, spin)
    return Parts(
        bodies=(output, shaft),
        joints=(
            JointSpec(
                name=f'output_shaft_{corner}', kind='cylindrical', i=marker_at(housing, inner, LEFTWARDS), j=marker_at(output, inner, LEFTWARDS)
            ),
            JointSpec(name=f'half_shaft_{corner}_inner', kind='constant_velocity', i=inner_joint[0], j=inner_joint[1]),
            JointSpec(name=f'half_shaft_{corner}_outer', kind='constant_velocity', i=outer_joint[0], j=outer_joint[1]),
        ),
    )


def propeller_shaft(data: Driveline, chassis: RigidBodySpec, engine: RigidBodySpec, housing: RigidBodySpec) -> Parts:
    """Two-part propeller shaft with centre bearing, and the drive pinion."""
    front, bearing, centre, rear = (np.array(p) for p in (data.engine_flange, data.center_bearing, data.center_joint, data.pinion_flange))
    first = rods('propshaft_front', ((data.propshaft_front.mass, tuple(front), tuple(centre), data.propshaft_front.radius),))
    second = rods('propshaft_rear', ((data.propshaft_rear.mass, tuple(centre), tuple(rear), data.propshaft_rear.radius),))
    pinion = rods('drive_pinion', ((data.pinion.mass, tuple(rear), tuple(rear - (0.1, 0.0, 0.0)), data.pinion.radius),))
    axis_front, axis_rear = front - centre, centre - rear
    cross = shaft_markers(first, second, tuple(centre), axis_front, axis_rear)
    flange = shaft_markers(second, pinion, tuple(rear), axis_rear, FORWARD)
    return Parts(
        bodies=(first, second, pinion),
        joints=(
            JointSpec(name='propshaft_flange', kind='spherical', i=marker_at(engine, front), j=marker_at(first, front)),
            JointSpec(name='propshaft_bearing', kind='point_on_line', i=marker_at(first, bearing, axis_front), j=marker_at(chassis, bearing)),
            JointSpec(name='propshaft_joint', kind='universal', i=cross[0], j=cross[1]),
            JointSpec(name='propshaft_pinion', kind='constant_velocity', i=flange[0], j=flange[1]),
            JointSpec(name='drive_pinion', kind='cylindrical', i=marker_at(housing, rear, FORWARD), j=marker_at(pinion, rear, FORWARD)),
        ),
    )
