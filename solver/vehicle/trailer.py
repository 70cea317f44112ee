"""A trailer on the hitch of a car: one body behind a ball coupling, on one or two axles with the suspensions of cars.

    chassis -spherical- trailer        `hitch`, at the centre of the ball

The data have a design frame of their own (x forward, y left, z up, origin on the ground, as in
solver.vehicle.hardpoints), so that a trailer fits behind any car. The trailer is moved until its coupling lies on the
ball of the car. If the ball is higher or lower than the coupling, the wheels are then above or below the ground; the
start finds how car and trailer really stand.

Names begin with `trailer`: body `trailer`, `wheel_trailer_left`; tire `trailer_left`, with two axles
`trailer_front_left`. The coordinate `articulation` is the yaw angle of the trailer relative to the car [rad], positive
if the trailer points further to the left.

The brakes of a trailer take their share of the input brake_torque in addition to those of the car, whose shares add up
to one. A real overrun brake finds that share from the force in the drawbar; that is not modelled.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from solver.dimensions import Point, Torque, TurnDamping
from solver.elements.aero_drag import AeroDragSpec
from solver.elements.coordinate import CoordinateSpec
from solver.elements.coordinate_force import CoordinateForceSpec
from solver.elements.joint import JointSpec
from solver.elements.laws import Law
from solver.elements.marker import Marker, Spec
from solver.elements.rigid_body import RigidBodySpec
from solver.errors import SpecError
from solver.model.spec import ModelSpec
from solver.validate import Vector, finite, require
from solver.vehicle.aero import Aero, aero_drag
from solver.vehicle.axle import Axle, axle_bar, subframe, suspensions
from solver.vehicle.hardpoints import marker_at
from solver.vehicle.parts import UP, Part, Parts, Structure, joined, vector_of

TRAILER, HITCH, ARTICULATION = 'trailer', 'hitch', 'articulation'  # names of body, joint and coordinate
APART = 0.1  # largest difference in height of ball and coupling [m]: the suspensions take up no more
# Articulation rate [rad/s] from which on the dry friction of a coupling has its full size. Ten times as much is the
# rate of a trailer that snakes by one degree.
SLOW = 0.005


@dataclass(frozen=True, kw_only=True)
class Stabilizer:
    """Resistance to yaw in the coupling. friction: dry friction of the pads on the ball [N m]. damping: of a yaw damper
    [N m s/rad]."""

    friction: Torque = 0.0
    damping: TurnDamping = 0.0

    def __post_init__(self) -> None:
        finite('stabilizer', 'friction', self.friction, low=0.0)
        finite('stabilizer', 'damping', self.damping, low=0.0)

    def parts(self) -> Parts:
        """The force elements of friction and damping; one that is zero is left out."""
        terms, f, s = ((ARTICULATION, 1.0),), self.friction, SLOW
        pads = Law.table([(-2.0 * s, -f), (-s, -f), (0.0, 0.0), (s, f), (2.0 * s, f)])
        laws = (('hitch_friction', self.friction, pads), ('hitch_damper', self.damping, Law.linear(self.damping)))
        return Parts(
            coordinate_forces=tuple(
                CoordinateForceSpec(name=n, terms=terms, damper=law) for n, size, law in laws if size > 0.0
            )
        )


@dataclass(frozen=True, kw_only=True)
class Trailer:
    """Data of a trailer, in its own design frame (x forward, y left, z up, origin on the ground), for the left side.

    chassis: the whole sprung mass. coupling: centre of the ball in the coupling [m]. axles: one, or two from front to
    rear, without drive and rack; the shares of their brakes in the brake torque add to those of the car. stabilizer:
    friction and damping in the coupling. aero: drag and lift of the trailer.
    """

    chassis: Part
    coupling: Point
    axles: tuple[Axle, ...]
    stabilizer: Stabilizer | None = None
    aero: Aero | None = None

    def __post_init__(self) -> None:
        require(1 <= len(self.axles) <= 2, 'trailer', 'axles', len(self.axles), 'a trailer has one or two of them')
        for axle in self.axles:
            require(
                axle.drive is None,
                'trailer',
                'axles',
                axle.name,
                'an axle of a trailer is not driven: remove its drive',
            )
            require(
                axle.rack is None, 'trailer', 'axles', axle.name, 'an axle of a trailer is not steered: remove its rack'
            )
        along = [axle.suspension.wheel.center[0] for axle in self.axles]
        require(
            all(a > b for a, b in pairwise(along)),
            'trailer',
            'axles',
            along,
            'must stand one behind the other, from front to rear',
        )
        require(self.coupling[1] == 0.0, 'trailer', 'coupling', self.coupling, 'must lie in the middle, y = 0')
        ahead = f'must lie ahead of the first axle, x = {along[0]:g} m'
        require(self.coupling[0] > along[0], 'trailer', 'coupling', self.coupling, ahead)

    def named_axles(self) -> tuple[Axle, ...]:
        """The axles with their names in the model: a single one is `trailer`, one of two `trailer_<name>`."""
        if len(self.axles) == 1:
            return (dataclasses.replace(self.axles[0], name=TRAILER),)
        return tuple(dataclasses.replace(axle, name=f'{TRAILER}_{axle.name}') for axle in self.axles)


def require_behind(trailer: Trailer | None, hitch: Vector | None, rear: float) -> None:
    """Raise SpecError for a trailer that does not fit a car with this hitch (None: it has none) and its last axle at x
    = rear [m]."""
    if trailer is None:
        return
    require(hitch is not None, 'car', 'hitch', None, 'is missing: a trailer needs the centre of the ball')
    assert hitch is not None
    require(hitch[1] == 0.0, 'car', 'hitch', hitch, 'must lie in the middle, y = 0')
    apart = hitch[2] - trailer.coupling[2]
    remedy = (
        f'is {abs(apart):.3g} m {"above" if apart > 0.0 else "below"} the coupling of the trailer; {APART:g} m '
        'are bridged at most'
    )
    require(abs(apart) <= APART, 'car', 'hitch', hitch, remedy)
    first = trailer.axles[0].suspension.wheel.center[0] + hitch[0] - trailer.coupling[0]
    require(
        first < rear, 'trailer', 'coupling', trailer.coupling, 'puts its first axle ahead of the last axle of the car'
    )


def towed(trailer: Trailer | None, hitch: Vector | None, car: RigidBodySpec) -> Parts:
    """All parts of the trailer, coupled to the chassis `car`; none without a trailer. hitch: in the design frame of the
    car [m]."""
    if trailer is None or hitch is None:
        return Parts()
    body = trailer.chassis.body(TRAILER, (0.0, 0.0, 0.0))
    parts = [Parts(bodies=(body,))]
    for axle in trailer.named_axles():
        frame, base = subframe(axle.name, axle.subframe, body)
        corners = suspensions(axle, Structure(body, base))
        parts += [frame, *(corner.parts for corner in corners.values()), axle_bar(axle, base, corners)]
    drags: tuple[AeroDragSpec, ...] = tuple(drag.replace(name='aero_trailer') for drag in aero_drag(trailer.aero, body))
    own = joined(
        (*parts, Parts(aero_drags=drags), Parts() if trailer.stabilizer is None else trailer.stabilizer.parts())
    )
    return joined(
        (
            own.replace(bodies=moved(own.bodies, np.subtract(hitch, trailer.coupling))),
            coupled(trailer, hitch, car, body),
        )
    )


def coupled(trailer: Trailer, hitch: Vector, car: RigidBodySpec, body: RigidBodySpec) -> Parts:
    """Ball coupling and coordinate of articulation. body: the trailer, in its own design frame."""
    joint = JointSpec(name=HITCH, kind='spherical', i=marker_at(car, hitch), j=marker_at(body, trailer.coupling))
    angle = CoordinateSpec(
        name=ARTICULATION, kind='rotation', i=marker_at(car, hitch, UP), j=marker_at(body, trailer.coupling, UP)
    )
    return Parts(joints=(joint,), coordinates=(angle,))


def moved(bodies: tuple[RigidBodySpec, ...], by: np.ndarray) -> tuple[RigidBodySpec, ...]:
    """The bodies, shifted by (3,) [m]; markers are relative to their bodies and need no change."""
    return tuple(body.replace(position=vector_of(np.array(body.position) + by)) for body in bodies)


def has_trailer(model: ModelSpec) -> bool:
    """True where a vehicle pulls a trailer."""
    return any(joint.name == HITCH for joint in model.joints) and any(body.name == TRAILER for body in model.bodies)


def refuse_trailer(model: ModelSpec) -> None:
    """Raise SpecError for a vehicle with a trailer."""
    if has_trailer(model):
        raise SpecError(
            'the vehicle pulls a trailer, which this level does not have; use condensed or full, or remove '
            'vehicle.trailer'
        )


def without_trailer(model: ModelSpec) -> ModelSpec:
    """The model of the car alone, without the trailer and all elements on it. Inputs stay as they are."""
    if not has_trailer(model):
        return model
    elements = [spec for section, specs in model.sections().items() if section != 'bodies' for spec in specs]
    gone, names = {TRAILER}, {ARTICULATION}
    pairs = [held for spec in elements if spec.name not in (HITCH, ARTICULATION) if len(held := held_by(spec)) > 1]
    while more := {body for held in pairs if held & gone for body in held} - gone:
        gone |= more
    names |= {spec.name for spec in elements if held_by(spec) & gone and spec.name != HITCH}

    def stays(spec: Spec) -> bool:
        written = [name for name, *_ in getattr(spec, 'terms', ())] + [getattr(spec, 'coordinate', None)]
        return not (held_by(spec) & gone or {str(name).partition('/')[0] for name in written} & names)

    kept = {
        section: tuple(spec for spec in specs if stays(spec))
        for section, specs in model.sections().items()
        if section != 'bodies'
    }
    return dataclasses.replace(model, **kept, bodies=tuple(body for body in model.bodies if body.name not in gone))


def held_by(spec: Spec) -> set[str]:
    """Names of the bodies on which an element has its markers."""
    values: Iterable[object] = (getattr(spec, field.name) for field in dataclasses.fields(spec))
    return {value.body for value in values if isinstance(value, Marker)}
