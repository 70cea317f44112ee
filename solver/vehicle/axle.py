"""An axle of a car or trailer: its suspension, and what else it has: a subframe, an anti-roll bar, a drive, a rack."""

from __future__ import annotations

import math
from dataclasses import dataclass

from solver.dimensions import Length, Point
from solver.elements.coupler import CouplerSpec
from solver.elements.joint import JointSpec
from solver.elements.rigid_body import RigidBodySpec
from solver.validate import require
from solver.vehicle.antiroll import AntiRollBar, anti_roll_bar
from solver.vehicle.double_wishbone import DoubleWishbone
from solver.vehicle.drives import Drive
from solver.vehicle.hardpoints import marker_at
from solver.vehicle.live_axle import LiveAxle
from solver.vehicle.macpherson import MacPherson
from solver.vehicle.multilink import MultiLink
from solver.vehicle.parts import LEFTWARDS, UP, Bushing, Corner, Part, Parts, Structure, joined, mounting
from solver.vehicle.trailing_arm import TrailingArm
from solver.vehicle.twist_beam import TwistBeam

# What a suspension may be; a further kind is one more file and one more name here.
AnySuspension = DoubleWishbone | MacPherson | MultiLink | TrailingArm | TwistBeam | LiveAxle


@dataclass(frozen=True, kw_only=True)
class Subframe:
    """A subframe on mounts. mounts: groups of points with the same bushing [m]; a group becomes one element at its
    centre. Without a bushing the subframe is fixed to the chassis."""

    part: Part
    mounts: tuple[tuple[Point, ...], ...]
    bushing: Bushing | None = None

    def __post_init__(self) -> None:
        require(len(self.mounts) >= 1, 'subframe', 'mounts', self.mounts, 'needs at least one group of points')


@dataclass(frozen=True, kw_only=True)
class FollowingRack:
    """A rack that the steering wheel moves by a fixed ratio: rear steering. per_turn: its travel to the left per turn
    of the steering wheel [m]; negative steers the other way round."""

    rack: Part
    per_turn: Length


@dataclass(frozen=True, kw_only=True)
class Axle:
    """An axle; suspension: of the left side, mirrored on the right, unless `right` gives that of the right side (as its
    mirror image)."""

    name: str
    suspension: AnySuspension
    right: AnySuspension | None = None
    subframe: Subframe | None = None
    anti_roll_bar: AntiRollBar | None = None
    drive: Drive | None = None
    rack: FollowingRack | None = None


def suspensions(axle: Axle, structure: Structure) -> dict[str, Corner]:
    """The two corners of an axle by side."""
    return axle.suspension.corners(axle.name, {'left': structure, 'right': structure}, axle.right)


def subframe(axle: str, data: Subframe | None, chassis: RigidBodySpec) -> tuple[Parts, RigidBodySpec]:
    """(parts, body) of the subframe of an axle on the chassis; without one nothing and the chassis."""
    if data is None:
        return Parts(), chassis
    body = data.part.body(f'{axle}_subframe', data.part.com)
    groups = data.mounts if data.bushing is not None else (sum(data.mounts, ()),)
    mounts = [
        mounting(f'{axle}_subframe_mount_{k + 1}', chassis, body, points, data.bushing, ideal='fixed', axis=UP)
        for k, points in enumerate(groups)
    ]
    return joined((Parts(bodies=(body,)), *mounts)), body


def following_rack(axle: str, data: FollowingRack, base: RigidBodySpec) -> tuple[Parts, RigidBodySpec]:
    """(parts, body) of a rack that follows the steering wheel. Coordinate rack_<axle>, positive along y [m]."""
    body, name = data.rack.body(f'rack_{axle}', data.rack.com), f'rack_{axle}'
    slide = JointSpec(
        name=name,
        kind='prismatic',
        i=marker_at(base, data.rack.com, LEFTWARDS),
        j=marker_at(body, data.rack.com, LEFTWARDS),
    )
    ratio = CouplerSpec(
        name=name + '_ratio', terms=((name, 1.0), ('steering_wheel', -data.per_turn / (2.0 * math.pi))), offset=0.0
    )
    return Parts(bodies=(body,), joints=(slide,), couplers=(ratio,)), body


def axle_bar(axle: Axle, base: RigidBodySpec, corners: dict[str, Corner]) -> Parts:
    """The anti-roll bar of an axle, if it has one."""
    if axle.anti_roll_bar is None:
        return Parts()
    return anti_roll_bar(axle.name, axle.anti_roll_bar, base, {side: corner.arm for side, corner in corners.items()})
