"""Between gearbox and driven axles: how its torque is divided among them, and what locks two of them.

    divided:  omega = sum of share_k omega_k,   T_k = share_k T        of the gearbox omega, T; at the shaft to axle k
              omega_k, T_k
    locked:   T = stiffness s + damping ds/dt,  s = x_a - x_b          x: what the mean of the wheels of an axle has
              turned, T at the wheels

The first is an ideal centre differential: planetary gears without inertia whose shares add up to one (half each between
bevel gears), one behind the other between more than two axles. Its torques follow from its speeds by their power, sum
of T_k omega_k = T omega, so nothing is lost however fast the axles turn. The second is a transfer case that is locked
(its shafts and gears wind up by s, whose energy is stored) or viscous (T ds/dt is lost), beside the differential or,
where the shares are 1 and 0, alone: an axle that is engaged.

Shafts are measured, and torques act on them, against the engine, which holds gearbox and transfer case; x is the angle
of a propeller shaft there over the ratio of the axle. An axle without a shaft from there (half shafts from a housing of
their own) is locked by its outputs to the drive pinion of the other one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from solver.dimensions import TurnDamping, TurnStiffness
from solver.elements.coordinate import CoordinateSpec
from solver.elements.coordinate_force import CoordinateForceSpec
from solver.elements.laws import Law
from solver.elements.rigid_body import RigidBodySpec
from solver.model.spec import ModelSpec
from solver.validate import finite, require
from solver.vehicle.parts import Parts, joined, shaft_markers
from solver.vehicle.powertrain import PropellerShaft

Terms = tuple[tuple[str, float], ...]


class Driven(NamedTuple):
    """The drive of an axle. share: of the torque that it is given; outputs: coordinates of its outputs, left and right,
    positive when rolling forward; shaft: its propeller shaft (None: it has none); inside: its differential is in the
    gearbox."""

    parts: Parts
    kind: str
    share: float
    outputs: tuple[str, str]
    shaft: PropellerShaft | None = None
    inside: bool = False

    @property
    def wheels(self) -> Terms:
        """The mean of the outputs."""
        left, right = self.outputs
        return (left, 0.5), (right, 0.5)

    def at_gearbox(self, final: float) -> Terms:
        """Terms of the gearbox behind its final drive of a ratio, which is that of an axle inside."""
        if self.shaft is None:
            return self.wheels
        return ((self.shaft.output, math.copysign(1.0, self.shaft.ratio) / final),)


@dataclass(frozen=True, kw_only=True)
class Transfer:
    """A connection of two driven axles: a locked transfer case (stiffness [N m/rad]), or a viscous one (damping [N m
    s/rad] alone), both at the wheels. axle, to: the two (to None: the only other one with a propeller shaft)."""

    implied: ClassVar[bool] = True  # a mapping that is no list of them

    axle: str = 'front'
    to: str | None = None
    stiffness: TurnStiffness = 0.0
    damping: TurnDamping

    def __post_init__(self) -> None:
        finite('transfer', 'stiffness', self.stiffness, low=0.0)
        finite('transfer', 'damping', self.damping, low=0.0, strict=True)

    def parts(self, name: str, driven: Mapping[str, Driven]) -> Parts:
        """The force element `name`. driven: by axle."""
        terms = self._terms(driven)
        spring = Law.linear(self.stiffness) if self.stiffness > 0.0 else None
        return Parts(
            coordinate_forces=(
                CoordinateForceSpec(name=name, terms=terms, spring=spring, damper=Law.linear(self.damping)),
            )
        )

    def behind(self, driven: Mapping[str, Driven]) -> str:
        """The axle that `axle` is connected with. Raises SpecError."""
        require(self.axle in driven, 'transfer', 'axle', self.axle, f'is not driven; driven are: {", ".join(driven)}')
        if self.to is None:
            shafts = [name for name, one in driven.items() if one.shaft is not None and name != self.axle]
            require(
                bool(shafts), 'transfer', 'axle', self.axle, 'needs another axle with a propeller shaft to be locked to'
            )
            require(
                len(shafts) == 1,
                'transfer',
                'to',
                None,
                f'name the axle that {self.axle} is locked to: {" or ".join(shafts)}',
            )
            return shafts[0]
        others = [name for name in driven if name != self.axle]
        require(
            self.to in others,
            'transfer',
            'to',
            self.to,
            f'is no other driven axle; these are: {", ".join(others) or "none"}',
        )
        return self.to

    def at_engine(self, driven: Mapping[str, Driven]) -> bool:
        """True where both axles have shafts from the engine: the transfer then acts at the engine."""
        ends = (self.behind(driven), self.axle)
        return all(driven[end].shaft is not None or driven[end].inside for end in ends)

    def _terms(self, driven: Mapping[str, Driven]) -> Terms:
        to = self.behind(driven)
        first, second = driven[self.axle], driven[to]
        shaft = second.shaft or first.shaft
        require(
            shaft is not None,
            'transfer',
            'axle',
            self.axle,
            f'and {to} have no propeller shaft: give one of them such a drive',
        )
        assert shaft is not None
        if self.at_engine(driven):
            return (*_turned(first, 1.0), *_turned(second, -1.0))
        return (*(first if second.shaft else second).wheels, (shaft.pinion, -1.0 / shaft.ratio))


def _turned(one: Driven, sign: float) -> Terms:
    """Terms of the turn of the wheels of an axle, by its shaft at the engine."""
    if one.shaft is None:
        return tuple((name, sign * factor) for name, factor in one.wheels)
    return ((one.shaft.output, sign / one.shaft.ratio),)


def transfers(given: tuple[Transfer, ...], driven: Mapping[str, Driven]) -> Parts:
    """All connections of driven axles: one is `transfer`, each of several `transfer_<axle>_<to>`."""
    pairs = [(one.axle, one.behind(driven)) for one in given]
    for k, pair in enumerate(pairs):
        again = {pair, pair[::-1]} & set(pairs[:k])
        require(not again, 'transfer', 'axle', pair[0], f'and {pair[1]} are connected twice: remove one of the two')
    names = ['transfer'] if len(pairs) == 1 else [f'transfer_{axle}_{to}' for axle, to in pairs]
    return joined(one.parts(name, driven) for one, name in zip(given, names, strict=True))


def shafts_at_engine(
    engine: RigidBodySpec | None, given: tuple[Transfer, ...], driven: Mapping[str, Driven], *, powered: bool
) -> Parts:
    """Coordinates of the propeller shafts against the engine where something acts there: a gearbox, or a connection."""
    ends = [end for one in given if one.at_engine(driven) for end in (one.axle, one.behind(driven))]
    return Parts(
        coordinates=tuple(
            _against(engine, one.shaft)
            for axle, one in driven.items()
            if one.shaft is not None and (powered or axle in ends)
        )
    )


def _against(engine: RigidBodySpec | None, shaft: PropellerShaft) -> CoordinateSpec:
    assert engine is not None  # drives with a propeller shaft need one
    # so it turns as evenly as it does
    i, j = shaft_markers(engine, shaft.body, shaft.body.position, shaft.turning, shaft.axis)
    return CoordinateSpec(name=shaft.output, kind='rotation', i=i, j=j)


def divided(driven: Iterable[Driven], final: float) -> Terms:
    """Coordinates that a gearbox turns, with their shares of its torque behind a final drive of a ratio; see the
    module."""
    return tuple((name, one.share * factor) for one in driven for name, factor in one.at_gearbox(final))


def _connections(model: ModelSpec) -> list[CoordinateForceSpec]:
    return [force for force in model.coordinate_forces if force.name.split('_')[0] == 'transfer']


def refuse_locked(model: ModelSpec) -> None:
    """Raise SpecError for a vehicle with axles that are locked to each other, at levels of detail that do not have
    this."""
    locked = [force.name for force in _connections(model) if force.spring is not None]
    require(
        not locked,
        'vehicle',
        ', '.join(locked),
        'stiffness',
        'this level has no locked transfer case: use condensed or full',
    )


def without_connections(model: ModelSpec) -> tuple[str, ...]:
    """Sentences on properties of viscous connections that such levels do not show."""
    return tuple(
        f'the torque of {force.name} between axles that turn differently fast' for force in _connections(model)
    )
