"""Anti-roll bar: two halves on their mounts, a torsion spring between them, drop links to the suspension arms."""

from __future__ import annotations

from dataclasses import dataclass

from solver.dimensions import Length, Mass, Point, TurnStiffness
from solver.elements.coordinate import CoordinateSpec
from solver.elements.coordinate_force import CoordinateForceSpec
from solver.elements.laws import Law
from solver.elements.rigid_body import RigidBodySpec
from solver.validate import finite
from solver.vehicle.hardpoints import distance, marker_at, on_side
from solver.vehicle.parts import LEFTWARDS, Bushing, Link, Parts, joined, link, mounting, require_positive, rods


@dataclass(frozen=True, kw_only=True)
class AntiRollBar:
    """Data of the left half.

    center: middle of the bar (y = 0); bend: where the bar turns into its arm; mount: point of its bearing on the
    subframe [m]. drop_link: inner end on the arm of the bar, outer end on the arm of the suspension. mass of one half
    [kg], radius of the bar [m]. stiffness: torque over the twist between the two halves [N m/rad]. bushing: of the
    bearing, z along the bar; its tilting rate includes the bending of the bar, which is cut in the middle.
    """

    center: Point
    bend: Point
    mount: Point
    drop_link: Link
    mass: Mass
    radius: Length
    stiffness: TurnStiffness
    bushing: Bushing | None = None

    def __post_init__(self) -> None:
        finite('anti-roll bar', 'stiffness', self.stiffness, low=0.0)
        require_positive('anti-roll bar', self, 'mass', 'radius')


def anti_roll_bar(axle: str, data: AntiRollBar, subframe: RigidBodySpec, arms: dict[str, RigidBodySpec]) -> Parts:
    """The bar of an axle; arms: suspension arms by side.

    Coordinate anti_roll_bar_<axle>: twist of the left half against the right one [rad].
    """
    halves: dict[str, RigidBodySpec] = {}
    parts = []
    for side, arm in arms.items():
        end, bend = on_side(side, data.drop_link.inner), on_side(side, data.bend)
        spans = [(data.center, bend), (bend, end)]
        lengths = [distance(a, b) for a, b in spans]
        body = rods(
            f'anti_roll_bar_{axle}_{side}',
            [
                (data.mass * length / sum(lengths), a, b, data.radius)
                for (a, b), length in zip(spans, lengths, strict=True)
            ],
        )
        halves[side] = body
        parts += [
            Parts(bodies=(body,)),
            mounting(
                f'anti_roll_mount_{axle}_{side}',
                subframe,
                body,
                (data.mount,),
                data.bushing,
                ideal='revolute',
                side=side,
                axis=LEFTWARDS,
            ),
            link(f'drop_link_{axle}_{side}', data.drop_link, body, arm, side, pin=LEFTWARDS),
        ]
    name = f'anti_roll_bar_{axle}'
    twist = CoordinateSpec(
        name=name,
        kind='rotation',
        i=marker_at(halves['right'], data.center, LEFTWARDS),
        j=marker_at(halves['left'], data.center, LEFTWARDS),
    )
    spring = CoordinateForceSpec(name=name, terms=((name, 1.0),), spring=Law.linear(data.stiffness))
    return joined((*parts, Parts(coordinates=(twist,), coordinate_forces=(spring,))))
