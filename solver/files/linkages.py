"""Mechanisms of many equal parts, as functions of their data: what a mechanism file chooses by the key `kind`.

    mechanism: {kind: four_bar_n, loops: 40}

A further one is a data class, a function to a ModelSpec and an entry in LINKAGES.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver.dimensions import Length, Mass
from solver.elements.joint import JointSpec
from solver.elements.marker import WORLD, Marker
from solver.elements.rigid_body import RigidBodySpec
from solver.model.spec import ModelSpec
from solver.units import MODEL_GRAVITY
from solver.validate import finite

SLENDER = 1e-4  # moment of inertia of a rod about its axis, over mass * length^2 (planar motion does not depend on it)


@dataclass(frozen=True, kw_only=True)
class EqualRods:
    """Equal uniform rods along x of their frames, whose origins are at the one end and whose centres of mass are in the
    middle."""

    length: Length = 1.0
    mass: Mass = 1.0

    def __post_init__(self) -> None:
        finite(type(self).__name__, 'length', self.length, low=0.0, strict=True)
        finite(type(self).__name__, 'mass', self.mass, low=0.0, strict=True)

    def rod(self, name: str, x: float, y: float, **placed: Any) -> RigidBodySpec:
        """A rod with its frame at (x, y, 0)."""
        along, across = SLENDER * self.mass * self.length**2, self.mass * self.length**2 / 12
        inertia = (along, across, across, 0.0, 0.0, 0.0)
        return RigidBodySpec(
            name=name, mass=self.mass, inertia=inertia, com=(self.length / 2, 0.0, 0.0), position=(x, y, 0.0), **placed
        )


@dataclass(frozen=True, kw_only=True)
class FourBarN(EqualRods):
    """N four-bar linkages side by side (IFToMM benchmark A02 [Gonzalez2006]; two loops: [Bayo1994]), 2 N + 1 equal
    uniform rods.

    The cranks crank_0 ... crank_N turn on the ground at x = 0, length, 2 length, ...; rod_1 ... rod_N join their ends.
    All cranks are placed upright in the x-y plane, gravity acts along -y. The coordinate A0 is the angle of crank_0
    from the x axis, counter-clockwise. One degree of freedom, N + 1 in the horizontal position; modelled in space with
    3 N + 1 revolutes, 3 N of 15 N + 5 constraints are redundant.
    """

    loops: int = 40

    def __post_init__(self) -> None:
        super().__post_init__()
        finite('FourBarN', 'loops', self.loops, low=1, high=1000)


def four_bar_n(data: FourBarN) -> ModelSpec:
    """The model of FourBarN."""
    length, upright = data.length, (0.0, 0.0, float(np.sqrt(0.5)), float(np.sqrt(0.5)))

    def hinge(name: str, i: Marker, j: Marker) -> JointSpec:
        return JointSpec(name=name, kind='revolute', i=i, j=j)

    def end(body: str) -> Marker:
        return Marker(body=body, position=(length, 0.0, 0.0))

    bodies = [data.rod('crank_0', 0.0, 0.0, orientation=upright)]
    joints = [hinge('A0', Marker(body=WORLD), Marker(body='crank_0'))]
    for k in range(1, data.loops + 1):
        x = k * length
        bodies += [data.rod(f'rod_{k}', x - length, length), data.rod(f'crank_{k}', x, 0.0, orientation=upright)]
        joints += [
            hinge(f'A{k}', Marker(body=WORLD, position=(x, 0.0, 0.0)), Marker(body=f'crank_{k}')),
            hinge(f'B{k - 1}', end(f'crank_{k - 1}'), Marker(body=f'rod_{k}')),
            hinge(f'C{k}', end(f'rod_{k}'), end(f'crank_{k}')),
        ]
    return ModelSpec(bodies=tuple(bodies), joints=tuple(joints), gravity=(0.0, -MODEL_GRAVITY, 0.0))


@dataclass(frozen=True, kw_only=True)
class Chain(EqualRods):
    """A chain of equal uniform rods that hangs on the ground at the origin and is placed straight along x; gravity acts
    along -y.

    link_1 ... link_N are joined by the revolutes A1 (to the ground) ... AN, whose axes are z: N degrees of freedom, no
    redundant constraint.
    """

    links: int = 10

    def __post_init__(self) -> None:
        super().__post_init__()
        finite('Chain', 'links', self.links, low=1, high=100000)


def chain(data: Chain) -> ModelSpec:
    """The model of Chain."""
    names = [f'link_{k}' for k in range(1, data.links + 1)]
    bodies = [data.rod(name, k * data.length, 0.0) for k, name in enumerate(names)]
    ends = [Marker(body=WORLD)] + [Marker(body=name, position=(data.length, 0.0, 0.0)) for name in names[:-1]]
    joints = [
        JointSpec(name=f'A{k}', kind='revolute', i=end, j=Marker(body=name))
        for k, (end, name) in enumerate(zip(ends, names, strict=True), start=1)
    ]
    return ModelSpec(bodies=tuple(bodies), joints=tuple(joints), gravity=(0.0, -MODEL_GRAVITY, 0.0))


LINKAGES: dict[str, tuple[type, Callable[[Any], ModelSpec]]] = {
    'four_bar_n': (FourBarN, four_bar_n),
    'chain': (Chain, chain),
}
