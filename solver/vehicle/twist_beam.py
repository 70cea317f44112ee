"""Twist beam: two trailing arms on one bushing each, joined by a cross-beam that is stiff in bending and soft in
torsion.

    left arm with half the beam -revolute- right arm with the other half       (in the middle, at the shear centre;
                                                                               torsion spring)
    chassis -bushing- arm

In parallel travel both arms turn about the line of the pivots; in opposite travel each turns about the line from its
pivot to the shear centre, which the two halves share, so the place of the shear centre between pivots and wheels
decides camber and toe in roll. With ideal pivots (spherical joints) the halves are joined by a universal joint: the
bending about the vertical axis that the exact geometry of large roll wants is left to them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from solver.dimensions import Point, Time, TurnStiffness
from solver.elements.coordinate import CoordinateSpec
from solver.elements.coordinate_force import CoordinateForceSpec
from solver.elements.joint import JointSpec
from solver.elements.laws import Law
from solver.elements.rigid_body import RigidBodySpec
from solver.validate import Vector, finite, require
from solver.vehicle.hardpoints import SIDES, marker_at
from solver.vehicle.parts import LEFTWARDS, Bushing, Corner, Part, Parts, Sprung, Structure, joined, mounting, sprung
from solver.vehicle.wheel_end import Suspension

FORWARD: Vector = (1.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class TwistBeam(Sprung, Suspension):
    """Data of the left half; both halves are alike.

    arm: trailing arm, wheel carrier and half of the cross-beam; pivot: centre of its bushing; shear_center: of the
    cross-beam in the middle of the car (y = 0) [m]. torsion: moment of the cross-beam over the twist between the halves
    [N m/rad], torsion_loss: damping over stiffness [s]. spring_chassis, spring_arm, damper_chassis, damper_arm: ends of
    spring and damper [m].
    """

    kind: Literal['twist_beam'] = 'twist_beam'
    arm: Part
    pivot: Point
    bushing: Bushing | None = None
    shear_center: Point
    torsion: TurnStiffness
    torsion_loss: Time = 0.001

    def __post_init__(self) -> None:
        super().__post_init__()
        finite('twist beam', 'torsion', self.torsion, low=0.0)
        finite('twist beam', 'torsion_loss', self.torsion_loss, low=0.0)
        centred = abs(self.shear_center[1]) < 1e-9
        require(
            centred,
            'twist beam',
            'shear_center',
            self.shear_center,
            'must lie in the plane y = 0, where the two halves meet',
        )

    def corners(
        self, axle: str, structures: Mapping[str, Structure], right: Suspension | None = None
    ) -> dict[str, Corner]:
        """Both halves by side; the beam is a part of the left one."""
        require(right is None, 'twist beam', 'right', 'given', 'the two halves are alike: remove it')
        arms = {side: self.arm.body(f'beam_{axle}_{side}', self.wheel.center, side) for side in SIDES}
        found = {}
        for side, arm in arms.items():
            name, base = f'{axle}_{side}', structures[side]
            hub, wheel = self.hub(name, side, base.chassis, arm)
            foot = mounting(
                f'arm_{name}',
                base.subframe,
                arm,
                (self.pivot,),
                self.bushing,
                ideal='spherical',
                side=side,
                axis=LEFTWARDS,
            )
            parts = [Parts(bodies=(arm,)), hub, foot, sprung(name, side, base.chassis, arm, self)]
            if side == 'left':
                parts.append(self._beam(f'beam_{axle}', arms))
            found[side] = Corner(joined(parts), arm, wheel, arm)
        return found

    def _beam(self, name: str, arms: Mapping[str, RigidBodySpec]) -> Parts:
        ends = arms['right'], arms['left']
        # along the beam the halves turn freely in both forms; the second pin of the universal joint is vertical
        axes = (LEFTWARDS, None) if self.bushing is not None else (FORWARD, LEFTWARDS)
        i, j = (marker_at(body, self.shear_center, *axes) for body in ends)
        joint = JointSpec(name=name, kind='revolute' if self.bushing is not None else 'universal', i=i, j=j)
        across = [marker_at(body, self.shear_center, LEFTWARDS) for body in ends]
        twist = CoordinateSpec(name=f'{name}_twist', kind='rotation', i=across[0], j=across[1])
        spring = CoordinateForceSpec(
            name=f'{name}_twist', terms=((twist.name, 1.0),), spring=Law.linear(self.torsion),
            damper=Law.linear(self.torsion_loss * self.torsion) if self.torsion_loss > 0.0 else None,
        )  # fmt: skip
        return Parts(joints=(joint,), coordinates=(twist,), coordinate_forces=(spring,))
