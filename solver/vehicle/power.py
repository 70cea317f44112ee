"""An engine that turns: its map over pedal and speed, crankshaft, clutch and gearbox in front of the differential.

    engine -revolute- crankshaft                the torque of the map acts on it (solver.elements.engine_map), its reaction on the engine
    crankshaft =clutch, gear= gearbox output    (solver.elements.clutch)

The output of the gearbox is the propeller shaft, or, where the differential is in the gearbox, both half shafts behind `final`. The engine
with its mounts takes what crankshaft and output do not balance. Inputs: accelerator and clutch (pedals, 0 to 1), gear (0: neutral, below 0
the reverse gear); left out of a maneuver they are 0: neutral, clutch closed, idling. drive_torque acts besides, at the differential.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from solver.elements.clutch import ClutchSpec, require_gears
from solver.elements.coordinate import CoordinateSpec
from solver.elements.engine_map import EngineSpec, require_engine
from solver.elements.joint import JointSpec
from solver.elements.rigid_body import RigidBodySpec
from solver.validate import Vector, finite
from solver.vehicle.hardpoints import marker_at
from solver.vehicle.parts import LEFTWARDS, Parts

FORWARD: Vector = (1.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class Power:
    """What turns in an engine and its gearbox. speeds [rad/s] and pedals (0 to 1), rising; torques: at the crankshaft [N m], for each pedal
    those at the speeds; it idles where that of the first pedal is zero. mass [kg] and inertia [kg m^2] of crankshaft, flywheel and what
    turns with them, beside the part of the engine. ratios: of the gears from the first one on; reverse: of the reverse gear (None: there is
    none); final: of the final drive, where the differential is in the gearbox. capacity [N m] of the clutch; stiffness [N m/rad] and
    damping [N m s/rad] of its springs."""

    speeds: Annotated[tuple[float, ...], 'rad/s']
    pedals: tuple[float, ...]
    torques: tuple[tuple[float, ...], ...]
    mass: float
    inertia: float
    ratios: tuple[float, ...]
    reverse: float | None = None
    final: float = 1.0
    capacity: float
    stiffness: float
    damping: float

    def __post_init__(self) -> None:
        require_engine('power', self.speeds, self.pedals, self.torques)
        require_gears('power', self.ratios, self.reverse)
        for field in ('mass', 'inertia', 'final', 'capacity', 'stiffness', 'damping'):
            finite('power', field, getattr(self, field), low=0.0, strict=True)

    def parts(self, engine: RigidBodySpec, output: RigidBodySpec | None, wheels: tuple[str, str]) -> Parts:
        """Crankshaft, map, clutch. output: the propeller shaft, at whose front end the gearbox is, or None: the half shafts, coordinates
        `wheels`, are. Coordinates crankshaft and gearbox_output, positive when rolling forward."""
        axis = LEFTWARDS if output is None else FORWARD
        at = engine.position
        across = 0.5 * self.inertia
        own = (across, self.inertia, across) if output is None else (self.inertia, across, across)
        crank = RigidBodySpec(name='crankshaft', mass=self.mass, inertia=(*own, 0.0, 0.0, 0.0), position=at)
        bearing = JointSpec(name='crankshaft', kind='revolute', i=marker_at(engine, at, axis), j=marker_at(crank, at, axis))
        coordinates: tuple[CoordinateSpec, ...] = ()
        outputs = tuple((name, 0.5) for name in wheels)
        if output is not None:
            place = output.position
            ends = marker_at(engine, place, FORWARD), marker_at(output, place, FORWARD)
            coordinates = (CoordinateSpec(name='gearbox_output', kind='rotation', i=ends[0], j=ends[1]),)
            outputs = (('gearbox_output', 1.0),)
        engines = EngineSpec(
            name='engine', coordinate='crankshaft', input='accelerator', speeds=self.speeds, pedals=self.pedals, torques=self.torques
        )
        clutch = ClutchSpec(
            name='clutch', shaft='crankshaft', outputs=outputs, input='clutch', gear='gear', capacity=self.capacity,
            ratios=tuple(ratio * self.final for ratio in self.ratios),
            reverse=None if self.reverse is None else self.reverse * self.final, stiffness=self.stiffness, damping=self.damping,
        )  # fmt: skip
        return Parts(bodies=(crank,), joints=(bearing,), coordinates=coordinates, engines=(engines,), clutches=(clutch,))
