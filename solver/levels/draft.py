"""A model that can be changed: a ModelSpec while rules replace its parts, and move markers and masses from body to
body.

All places and directions are those of the design frame, in which the bodies of the specification are placed. Sums of
masses, of first moments and of moments of inertia are exact. No number is computed by BLAS, whose bits depend on the
processor (docs/decisions/0008).
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Hashable, Iterator
from typing import Any, NamedTuple, cast

import numpy as np

from solver.compiled.portable import norm, product
from solver.elements.marker import WORLD, Marker, Spec
from solver.elements.rigid_body import RigidBodySpec
from solver.errors import SpecError
from solver.model.compile import joint_coordinates
from solver.model.frames import Placement, matrix, quaternion
from solver.model.spec import ModelSpec
from solver.validate import Vector


class Hold(NamedTuple):
    """A marker on a body, by section and name of the specification that has it, and its field there ('i', 'j')."""

    section: str
    name: str
    field: str


def three(v: np.ndarray) -> Vector:
    """A vector (3,) as a tuple of floats."""
    x, y, z = (float(c) for c in v)
    return (x, y, z)


def unit(v: np.ndarray) -> np.ndarray:
    """The vector scaled to length one."""
    return v / norm(v)


def spread(mass: float, arm: np.ndarray) -> np.ndarray:
    """(3, 3) inertia [kg m^2] of a point mass [kg] about a point; arm: (3,) from that point to the mass [m]."""
    return mass * (float(product(arm, arm)) * np.eye(3) - arm[:, None] * arm[None, :])


@functools.cache
def marked(cls: Hashable) -> tuple[str, ...]:
    """Names of the fields of a specification that are markers, in their order."""
    return tuple(field.name for field in dataclasses.fields(cast(Any, cls)) if str(field.type).startswith('Marker'))


class Draft:
    """A model that can be changed.

    sections: field of ModelSpec -> name -> specification. lost: sentences on parts that the model has lost (the keys).
    """

    def __init__(self, model: ModelSpec) -> None:
        self._given = model
        self.sections: dict[str, dict[str, Any]] = {
            section: {spec.name: spec for spec in specs} for section, specs in model.sections().items()
        }
        self.road = model.road
        self.lost: dict[str, None] = {}

    def model(self) -> ModelSpec:
        """The model as it is now."""
        return dataclasses.replace(
            self._given, road=self.road, **{name: tuple(specs.values()) for name, specs in self.sections.items()}
        )

    def lose(self, what: str) -> None:
        """Note, in words, a part or an effect that is not modelled any more."""
        self.lost[what] = None

    # -- parts --------------------------------------------------------------------------------------------------------

    @property
    def chassis(self) -> str:
        """Name of the body whose motion odom and imu show."""
        return self._given.chassis or self._given.bodies[0].name

    @property
    def bodies(self) -> dict[str, RigidBodySpec]:
        """The bodies by name."""
        return self.sections['bodies']

    def put(self, section: str, spec: Spec) -> None:
        """Add a specification, or replace the one of this name."""
        self.sections[section][spec.name] = spec

    def drop(self, section: str, name: str) -> Any:
        """Remove a specification and return it."""
        return self.sections[section].pop(name)

    def every(self) -> Iterator[tuple[str, Any]]:
        """(section, specification) of all parts but the bodies."""
        for section, specs in self.sections.items():
            if section != 'bodies':
                for spec in list(specs.values()):
                    yield section, spec

    def holds(self, body: str) -> list[Hold]:
        """All markers on a body."""
        return [
            Hold(section, spec.name, field)
            for section, spec in self.every()
            for field in marked(spec.__class__)
            if (marker := getattr(spec, field)) is not None and marker.body == body
        ]

    def spec(self, hold: Hold) -> Any:
        """The specification to which a marker belongs."""
        return self.sections[hold.section][hold.name]

    def other(self, hold: Hold) -> Marker:
        """The other marker of an element between i and j."""
        return getattr(self.spec(hold), 'j' if hold.field == 'i' else 'i')

    def coordinates_of(self, joint: str) -> list[str]:
        """Names of the coordinates that a joint defines."""
        return [c.name for c in joint_coordinates(self.sections['joints'][joint])]

    def uses(self, coordinate: str) -> list[str]:
        """Names of the constraints and forces that are written in a coordinate."""
        return [
            spec.name
            for _, spec in self.every()
            if coordinate in [name for name, *_ in getattr(spec, 'terms', ())]
            or getattr(spec, 'coordinate', None) == coordinate
        ]

    # -- places -------------------------------------------------------------------------------------------------------

    def frame(self, body: str) -> Placement:
        """The reference frame of a body, or the world's."""
        if body == WORLD:
            return Placement(np.zeros(3), np.eye(3))
        spec = self.bodies[body]
        return Placement(np.array(spec.position), matrix(spec.orientation))

    def placed(self, marker: Marker) -> Placement:
        """Placement of a marker."""
        p, R = self.frame(marker.body)
        return Placement(p + product(R, marker.position), product(R, matrix(marker.orientation)))

    def marker(self, body: str, p: np.ndarray, R: np.ndarray | None = None) -> Marker:
        """The marker on a body at a place, parallel to the design frame unless its axes R are given."""
        origin, axes = self.frame(body)
        turned = axes.T if R is None else product(axes.T, R)
        return Marker(body=body, position=three(product(axes.T, p - origin)), orientation=quaternion(turned))

    def com(self, body: str) -> np.ndarray:
        """(3,) centre of mass of a body [m]."""
        p, R = self.frame(body)
        return p + product(R, self.bodies[body].com)

    def inertia(self, body: str) -> np.ndarray:
        """(3, 3) inertia of a body about its centre of mass, along the axes of the design frame [kg m^2]."""
        _, R = self.frame(body)
        return product(product(R, self.bodies[body].inertia_matrix()), R.T)

    # -- changes ------------------------------------------------------------------------------------------------------

    def set_mass(self, body: str, mass: float, com: np.ndarray, inertia: np.ndarray) -> None:
        """Give a body another mass [kg], centre of mass (3,) [m], and inertia (3, 3) about it [kg m^2]."""
        p, R = self.frame(body)
        J = product(product(R.T, inertia), R)
        six = (
            J[0, 0],
            J[1, 1],
            J[2, 2],
            0.5 * (J[0, 1] + J[1, 0]),
            0.5 * (J[0, 2] + J[2, 0]),
            0.5 * (J[1, 2] + J[2, 1]),
        )
        spec = self.bodies[body]
        self.put(
            'bodies', spec.replace(mass=mass, com=three(product(R.T, com - p)), inertia=tuple(float(x) for x in six))
        )

    def add_mass(self, body: str, mass: float, com: np.ndarray, inertia: np.ndarray) -> None:
        """Add a rigid mass [kg], with its centre of mass [m] and its inertia about that [kg m^2], to a body. The world
        has none."""
        if body == WORLD:
            return
        own, at = self.bodies[body].mass, self.com(body)
        total = own + mass
        middle = at if total == 0.0 else (own * at + mass * com) / total
        self.set_mass(
            body, total, middle, self.inertia(body) + inertia + spread(own, at - middle) + spread(mass, com - middle)
        )

    def add_inertia(self, body: str, inertia: np.ndarray, of: str) -> None:
        """Add an inertia (3, 3) [kg m^2], which may be negative, of a removed part.

        of: name of that part. If the inertia of the body would not be possible then, nothing is added, and lose() notes
        it.
        """
        if body == WORLD:
            return
        try:
            self.set_mass(body, self.bodies[body].mass, self.com(body), self.inertia(body) + inertia)
        except SpecError:
            self.lose(f'a part of the inertia of {of}')

    def resist(self, body: str, stiffness: np.ndarray, damping: np.ndarray) -> bool:
        """Add rotational stiffness [N m/rad] and damping [N m s/rad] (3, 3) to the only bushing of a body.

        Only the components about the axes of the bushing are added; an axis with a law keeps its stiffness. Returns
        False, and adds nothing, if the body has no bushing or several.
        """
        found = [hold for hold in self.holds(body) if hold.section == 'bushings']
        if len(found) != 1:
            return False
        spec = self.spec(found[0])
        R = self.placed(spec.i).R
        k, c = list(spec.stiffness), list(spec.damping)
        for q in range(3):
            n = R[:, q]
            k[3 + q] += float(product(n, product(stiffness, n)))
            c[3 + q] += float(product(n, product(damping, n)))
        self.put('bushings', spec.replace(stiffness=tuple(k), damping=tuple(c)))
        return True

    def move(self, hold: Hold, body: str) -> None:
        """Move a marker to another body; its place and its axes stay."""
        spec = self.spec(hold)
        p, R = self.placed(getattr(spec, hold.field))
        self.put(hold.section, spec.replace(**{hold.field: self.marker(body, p, R)}))

    def merge(self, body: str, into: str) -> None:
        """Make a body a rigid part of another one, and remove the elements between the two."""
        for hold in self.holds(body):
            if hold.name not in self.sections[hold.section]:
                continue
            spec = self.spec(hold)
            if {m.body for f in ('i', 'j') if isinstance(m := getattr(spec, f, None), Marker)} == {body, into}:
                self.drop(hold.section, hold.name)
            else:
                self.move(hold, into)
        if into != WORLD:
            self.add_mass(into, self.bodies[body].mass, self.com(body), self.inertia(body))
        self.drop('bodies', body)

    def share(
        self, body: str, near: str, a: np.ndarray, far: str, b: np.ndarray, about: np.ndarray | None = None
    ) -> None:
        """Remove a body and divide its mass between the bodies at its two ends: `near`, at the place a, and `far`, at
        b.

        `far` gets a point mass at b that has the same inertia about a as the body (about the axis `about` through a, if
        it is given): so `far` feels the same inertia. `near` gets the rest, at the place that keeps the common centre
        of mass, with the inertia that keeps the sum; it may be negative. The inertia about the line from a to b is left
        to the caller.
        """
        mass, com, inertia = self.bodies[body].mass, self.com(body), self.inertia(body)
        line = b - a
        arm = com - a
        whole = inertia + spread(mass, arm)
        if about is None:
            along = unit(line)
            across = 0.5 * (whole[0, 0] + whole[1, 1] + whole[2, 2] - float(product(along, product(whole, along))))
            lever = float(product(line, line))
        else:
            across = float(product(about, product(whole, about)))
            radial = line - float(product(about, line)) * about
            lever = float(product(radial, radial))
        outer = min(across / lever, mass) if lever > 0.0 else 0.0
        inner = mass - outer
        at = com if inner == 0.0 else (mass * com - outer * b) / inner
        rest = inertia - spread(outer, b - com) - (spread(inner, at - com) if inner > 0.0 else 0.0)
        self.drop('bodies', body)
        self.add_mass(far, outer, b, np.zeros((3, 3)))
        self.add_mass(near, inner, at, np.zeros((3, 3)))
        self.add_inertia(near, rest, body)
