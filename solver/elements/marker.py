"""Markers (frames fixed in bodies), the base of all specifications, and the context in which they are compiled."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from solver.dimensions import Point
from solver.elements.laws import Law
from solver.validate import Quaternion, unit_quaternion, vector

WORLD = 'world'
IDENTITY: Quaternion = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class Spec:
    """A named part of a model. Subclasses validate themselves in __post_init__.

    counted_as: the count in which the description of a model has it; the 'force_elements' are the action-reaction
    elements.
    """

    name: str
    counted_as: ClassVar[str] = 'force_elements'

    @property
    def where(self) -> str:
        """Name of this element in error sentences."""
        return f'{type(self).__name__.removesuffix("Spec")} {self.name!r}'

    def set(self, field: str, value: object) -> None:
        """Assign a normalised value during __post_init__."""
        object.__setattr__(self, field, value)

    def replace(self, **changes):
        """Return a copy with some fields changed."""
        return dataclasses.replace(self, **changes)


@dataclass(frozen=True, kw_only=True)
class ConstraintSpec(Spec):
    """A named constraint: one or more rows."""

    def row_names(self) -> list[str]:
        """Names of the constraint rows, '<constraint>/<row>'; of a single row the name of the constraint."""
        return [self.name]

    def holonomic(self) -> list[int]:
        """1 for rows of positions, 0 for rows of velocities."""
        return [1] * len(self.row_names())


@dataclass(frozen=True, kw_only=True)
class Marker:
    """A frame fixed in a body.

    body: body name or 'world'. position: [m] in the body's reference frame. orientation: unit quaternion xyzw
    R_B_marker.
    """

    body: str
    position: Point = (0.0, 0.0, 0.0)
    orientation: Quaternion = IDENTITY

    def __post_init__(self) -> None:
        where = f'marker on {self.body!r}'
        object.__setattr__(self, 'position', vector(where, 'position', self.position))
        object.__setattr__(self, 'orientation', unit_quaternion(where, 'orientation', self.orientation))


class PlacedMarker(NamedTuple):
    """A compiled marker: body index (nb for the world), position from the centre of mass [m] in B, rotation R_BM (3,
    3)."""

    body: int
    r: np.ndarray
    R: np.ndarray


class Context(Protocol):
    """Questions that `compile_<kind>(specs, context)` may ask. Implemented by solver.model.compile."""

    n_bodies: int
    road: Any  # RoadSpec

    def body(self, where: str, name: str) -> int:
        """Index of a body (n_bodies for 'world'); SpecError with a suggestion for an unknown name."""

    def marker(self, where: str, marker: Marker) -> PlacedMarker:
        """Marker relative to the centre of mass of its body."""

    def slot(self, row: int, column: int) -> int:
        """Index of the 6x6 block (row body, column body); the trash slot if either is the world."""

    def input(self, where: str, name: str) -> int:
        """Index of a scalar input channel; SpecError for an unknown one."""

    def coordinate(self, where: str, name: str) -> int:
        """Index of a joint coordinate; SpecError for an unknown one."""

    def coordinate_bodies(self, index: int) -> tuple[int, int]:
        """Bodies i and j of a joint coordinate."""

    def placed_coordinate(self, index: int) -> float:
        """Value of a joint coordinate in the placed configuration [m or rad]."""

    def rows(self, spec: ConstraintSpec, bodies: Sequence[int]) -> tuple[int, list[int]]:
        """Number the rows of a constraint between bodies: (first row, Jacobian block of each body; the trash block of
        the world)."""

    def law(self, law: Law | None) -> int:
        """Index of a force law in the law table (-1 for None)."""

    def internal_states(self, where: str, count: int, size: float = 1.0) -> int:
        """Reserve `count` internal states, return the index of the first. size: what their errors count relative to
        where steps follow the local error: 1 for deflections [m or rad], for a force what it may be at most."""


class Between(Protocol):
    """A specification of an element between two markers."""

    @property
    def where(self) -> str: ...
    @property
    def i(self) -> Marker: ...
    @property
    def j(self) -> Marker: ...


class MarkerPairs(NamedTuple):
    """Columns that all elements between marker F on body i and marker G on body j have; their tables take what they
    need."""

    body: np.ndarray  # (n, 2)
    r_i: np.ndarray  # (n, 3) origin of F from the centre of mass of i, in B_i [m]
    r_j: np.ndarray  # (n, 3) origin of G from the centre of mass of j, in B_j [m]
    F: np.ndarray  # (n, 3, 3) axes of F in B_i
    G: np.ndarray  # (n, 3, 3) axes of G in B_j
    slot: np.ndarray  # (n, 4) blocks ii ij ji jj


def compile_pairs(specs: Sequence[Between], context: Context) -> MarkerPairs:
    """Resolve the markers i and j of all specs."""
    n = len(specs)
    pairs = MarkerPairs(
        body=np.zeros((n, 2), np.int64),
        r_i=np.zeros((n, 3)),
        r_j=np.zeros((n, 3)),
        F=np.zeros((n, 3, 3)),
        G=np.zeros((n, 3, 3)),
        slot=np.zeros((n, 4), np.int64),
    )
    for e, spec in enumerate(specs):
        i, j = context.marker(spec.where, spec.i), context.marker(spec.where, spec.j)
        pairs.body[e] = i.body, j.body
        pairs.r_i[e], pairs.r_j[e] = i.r, j.r
        pairs.F[e], pairs.G[e] = i.R, j.R
        pairs.slot[e] = np.ravel(slots((i.body, j.body), context))
    return pairs


def slots(bodies: Sequence[int], context: Context) -> list[list[int]]:
    """Blocks (row body, column body) of some bodies."""
    return [[context.slot(row, column) for column in bodies] for row in bodies]


def number_pairs(specs: Sequence[Any], context: Context) -> tuple[np.ndarray, np.ndarray]:
    """(first rows (n,), Jacobian blocks of i and j (n, 2)) of constraints between two markers."""
    first, blocks = np.zeros(len(specs), np.int64), np.zeros((len(specs), 2), np.int64)
    for e, spec in enumerate(specs):
        first[e], blocks[e] = context.rows(spec, [context.body(spec.where, marker.body) for marker in (spec.i, spec.j)])
    return first, blocks
