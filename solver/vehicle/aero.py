"""Air drag and lift of a car."""

from __future__ import annotations

from dataclasses import dataclass

from solver.dimensions import Area, Point
from solver.elements.aero_drag import AeroDragSpec
from solver.elements.rigid_body import RigidBodySpec
from solver.validate import finite
from solver.vehicle.hardpoints import marker_at


@dataclass(frozen=True, kw_only=True)
class Aero:
    """Drag and lift at one point [m]; drag_area and lift_area [m^2]."""

    point: Point
    drag_area: Area
    lift_area: Area = 0.0

    def __post_init__(self) -> None:
        finite('aero', 'drag_area', self.drag_area, low=0.0)


def aero_drag(aero: Aero | None, chassis: RigidBodySpec) -> tuple[AeroDragSpec, ...]:
    """Drag and lift on the chassis, if there are any."""
    if aero is None:
        return ()
    return (
        AeroDragSpec(
            name='aero', marker=marker_at(chassis, aero.point), drag_area=aero.drag_area, lift_area=aero.lift_area
        ),
    )
