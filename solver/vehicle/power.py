"""An engine that turns: its map over pedal and speed, crankshaft, clutch and gearbox in front of the differential.

    engine -revolute- crankshaft                the torque of the map acts on it (solver.elements.engine_map), its
                                                reaction on the engine
    crankshaft =clutch, gear= gearbox output    (solver.elements.clutch)

With a torque converter the gears are behind its turbine, and the clutch is that of the gears:

    engine -revolute- turbine                   crankshaft =oil= turbine (solver.elements.converter), and =lock-up=
                                                where there is one
    turbine =clutch, gear= gearbox output

The output of the gearbox is the propeller shaft, or, where the differential is in the gearbox, both half shafts behind
`final`; of several driven axles all of these, by their shares of its torque (solver.vehicle.transfer). The engine with
its mounts takes what crankshaft and outputs do not balance. Inputs: accelerator and clutch (pedals, 0 to 1), gear (0:
neutral, below 0 the reverse gear), and lock_up (closed from 0.5 on while the clutch pedal is up); left out of a
maneuver they are 0: neutral, clutch closed, idling. drive_torque acts besides, at the differential.
"""

from __future__ import annotations

from dataclasses import dataclass

from solver.dimensions import ConverterCapacity, Inertia, Mass, Rate, Torque, TurnDamping, TurnStiffness
from solver.elements.clutch import ClutchSpec, require_gears
from solver.elements.converter import ConverterSpec, require_converter
from solver.elements.engine_map import EngineSpec, require_engine
from solver.elements.joint import JointSpec
from solver.elements.rigid_body import RigidBodySpec
from solver.validate import Vector, finite, require_positions
from solver.vehicle.hardpoints import marker_at
from solver.vehicle.parts import LEFTWARDS, Parts, joined

FORWARD: Vector = (1.0, 0.0, 0.0)
BACKWARDS: Vector = (-1.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class LockUp:
    """The lock-up clutch of a torque converter. capacity [N m]; stiffness [N m/rad] and damping [N m s/rad] of its
    springs."""

    capacity: Torque
    stiffness: TurnStiffness
    damping: TurnDamping

    def __post_init__(self) -> None:
        for field in ('capacity', 'stiffness', 'damping'):
            finite('lock_up', field, getattr(self, field), low=0.0, strict=True)


@dataclass(frozen=True, kw_only=True)
class Converter:
    """A torque converter between crankshaft and gears. speed_ratios (0 to 1) of turbine and pump, rising; at these the
    torque_ratios [-] and the capacities: torque of the pump over the square of its rate, 1/K^2 of its K-factor [N m
    s^2/rad^2], the last one 0. mass [kg] and inertia [kg m^2] of the turbine and what turns with it in front of the
    gears; the pump is part of the crankshaft."""

    speed_ratios: tuple[float, ...]
    torque_ratios: tuple[float, ...]
    capacities: tuple[ConverterCapacity, ...]
    mass: Mass
    inertia: Inertia
    lock_up: LockUp | None = None

    def __post_init__(self) -> None:
        require_converter('converter', self.speed_ratios, self.torque_ratios, self.capacities)
        for field in ('mass', 'inertia'):
            finite('converter', field, getattr(self, field), low=0.0, strict=True)


@dataclass(frozen=True, kw_only=True)
class Power:
    """Engine and gearbox: data of the parts that turn in them. speeds [rad/s] and pedals (0 to 1), rising; torques: at
    the crankshaft [N m], for each pedal those at the speeds; it idles where that of the first pedal is zero. mass [kg]
    and inertia [kg m^2] of crankshaft, flywheel and what turns with them, beside the part of the engine. ratios: of the
    gears from the first one on; reverse: of the reverse gear (None: there is none); final: of the final drive, where
    the differential is in the gearbox. capacity [N m] of the clutch; stiffness [N m/rad] and damping [N m s/rad] of its
    springs. converter: a torque converter in front of the gears (None: there is none)."""

    speeds: tuple[Rate, ...]
    pedals: tuple[float, ...]
    torques: tuple[tuple[Torque, ...], ...]
    mass: Mass
    inertia: Inertia
    ratios: tuple[float, ...]
    reverse: float | None = None
    final: float = 1.0
    capacity: Torque
    stiffness: TurnStiffness
    damping: TurnDamping
    converter: Converter | None = None

    def __post_init__(self) -> None:
        require_engine('power', self.speeds, self.pedals, self.torques)
        require_positions('power', self.pedals)
        require_gears('power', self.ratios, self.reverse)
        for field in ('mass', 'inertia', 'final', 'capacity', 'stiffness', 'damping'):
            finite('power', field, getattr(self, field), low=0.0, strict=True)

    def parts(self, engine: RigidBodySpec, outputs: tuple[tuple[str, float], ...], *, across: bool) -> Parts:
        """Crankshaft, map, clutch. outputs: coordinates that the gearbox turns behind its final drive, with their
        shares of its torque, below 0 where they turn backwards; across: the crankshaft lies across the car. Coordinate
        crankshaft, positive when rolling forward."""
        axis = LEFTWARDS if across else turning(self)
        crank = shaft('crankshaft', engine, axis, self.mass, self.inertia)
        engines = EngineSpec(
            name='engine',
            coordinate='crankshaft',
            input='accelerator',
            speeds=self.speeds,
            pedals=self.pedals,
            torques=self.torques,
        )
        driving = 'crankshaft' if self.converter is None else 'turbine'
        clutch = ClutchSpec(
            name='clutch', shaft=driving, outputs=outputs, input='clutch', gear='gear', capacity=self.capacity,
            ratios=tuple(ratio * self.final for ratio in self.ratios),
            reverse=None if self.reverse is None else self.reverse * self.final, stiffness=self.stiffness,
            damping=self.damping,
        )  # fmt: skip
        parts = (crank, Parts(engines=(engines,), clutches=(clutch,)))
        return joined(parts if self.converter is None else (*parts, turbine(self.converter, engine, axis)))


def turning(power: Power | None) -> Vector:
    """The axis about which shafts along a car turn as it rolls forward: with an engine clockwise seen from the front,
    as nearly all do, so that driving takes load off the right wheel of a live axle. Without one they turn along, the
    other way round: nothing drives them.
    """
    return FORWARD if power is None else BACKWARDS


def shaft(name: str, engine: RigidBodySpec, axis: Vector, mass: float, inertia: float) -> Parts:
    """Shaft that turns in an engine about an axis (backwards or to the left), across which it has half of its inertia
    [kg m^2]."""
    at, across = engine.position, 0.5 * inertia
    own = (across, inertia, across) if axis is LEFTWARDS else (inertia, across, across)
    body = RigidBodySpec(name=name, mass=mass, inertia=(*own, 0.0, 0.0, 0.0), position=at)
    bearing = JointSpec(name=name, kind='revolute', i=marker_at(engine, at, axis), j=marker_at(body, at, axis))
    return Parts(bodies=(body,), joints=(bearing,))


def turbine(data: Converter, engine: RigidBodySpec, axis: Vector) -> Parts:
    """The turbine of a torque converter behind the crankshaft, and its lock-up clutch. Coordinate turbine."""
    converter = ConverterSpec(
        name='converter', pump='crankshaft', turbine='turbine', speed_ratios=data.speed_ratios,
        torque_ratios=data.torque_ratios,
        capacities=data.capacities,
    )  # fmt: skip
    lock: tuple[ClutchSpec, ...] = ()
    if data.lock_up is not None:
        own = {name: getattr(data.lock_up, name) for name in ('capacity', 'stiffness', 'damping')}
        lock = (
            ClutchSpec(
                name='lock_up',
                shaft='crankshaft',
                outputs=(('turbine', 1.0),),
                ratios=(1.0,),
                input='clutch',
                gear='lock_up',
                **own,
            ),
        )
    return joined(
        (shaft('turbine', engine, axis, data.mass, data.inertia), Parts(converters=(converter,), clutches=lock))
    )
