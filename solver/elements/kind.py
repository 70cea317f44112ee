"""Kinds of elements, as the rest of the program knows them: one object for each, listed in solver.elements.registry.

Tables, calls, outputs, the energy account, balances, references, recordings and the sections of files follow from these objects in
loops. A kind is checked when it is made, so that a forgotten step is an error at import.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from solver.elements.marker import ConstraintSpec, Spec

FORCE = ('table', 'now', 'effects', 'out')
RESIDUALS = ('table', 'kin', 'gradients', 'phi', 'J')
RESIDUALS_ON_COORDINATES = ('table', 'coordinates', 'kin', 'angle', 'u', 'gradients', 'phi', 'J')
HESSIANS = ('table', 'kin', 'lam', 'Kq', 'Kv')
HESSIANS_ON_COORDINATES = ('table', 'coordinates', *HESSIANS[1:])
FIRST_OUTPUTS = ('energy', 'dissipation')


class Held(NamedTuple):
    """Behaviour of the elements of a kind while static equilibrium is sought."""

    table: Any
    inputs: np.ndarray  # (nu,)
    limits: dict[int, float]  # largest magnitude that an internal state keeps when the search has ended


def _require_arguments(where: str, kernel: Callable, wanted: tuple[str, ...]) -> None:
    given = tuple(inspect.signature(getattr(kernel, 'py_func', kernel)).parameters)
    if given != wanted:
        raise TypeError(f'{where}: {kernel.__name__}({", ".join(given)}) must have the arguments ({", ".join(wanted)})')


def _follows_inputs(spec: type[Spec]) -> bool:
    return any(field.name == 'input' for field in dataclasses.fields(spec))


@dataclass(frozen=True, kw_only=True)
class ForceKind:
    """A kind of force element.

    name: the field of ModelSpec and the section of a file. compile(specs, context): their table, a NamedTuple of arrays; with
    a column `body` where elements have internal states, `input` (indices of channels, -1 for none) where the specification
    has one. kernel: see solver.elements. outputs: column -> unit, energy and dissipation first. supplies: inputs are loads,
    which feed energy in, not capacities. effort: the column that is a generalized force on the joint coordinates in the
    table's columns `coordinate` (-1 for none), times `factor` where there is one; or one column for each of these
    coordinates. wheels: the elements are the wheels of a vehicle, shown by topics of their own. held(table, u): how they act
    in the search for static equilibrium; approach(table): with which table it begins, where a start far away needs another
    one.
    capacities(table, u): the largest torques of the brakes that they are or have, under the inputs u (nu,). rotation: the first of three
    columns that are a rotation vector [rad] on which the element acts, and which jumps where it turns by pi. peak: the column whose largest
    value the account of a run notes of every element.
    """

    name: str
    spec: type[Spec]
    compile: Callable[..., Any]
    kernel: Callable[..., None]
    outputs: Mapping[str, str]
    supplies: bool = False
    effort: str | tuple[str, ...] | None = None
    rotation: str | None = None
    peak: str | None = None
    wheels: bool = False
    held: Callable[[Any, np.ndarray], Held] | None = None
    approach: Callable[[Any], Any] | None = None
    capacities: Callable[[Any, np.ndarray], np.ndarray] | None = None

    def __post_init__(self) -> None:
        where = f'kind {self.name!r}'
        _require_arguments(where, self.kernel, FORCE)
        if tuple(self.outputs)[:2] != FIRST_OUTPUTS:
            raise TypeError(
                f'{where}: the first two outputs must be {" and ".join(FIRST_OUTPUTS)}, not {", ".join(list(self.outputs)[:2])}'
            )
        for name in self.efforts:
            if name not in self.outputs:
                raise TypeError(f'{where}: effort = {name!r} is no output')
        if self.rotation is not None and self.rotation not in tuple(self.outputs)[:-2]:
            raise TypeError(f'{where}: rotation = {self.rotation!r} is not the first of three outputs')
        if self.peak is not None and self.peak not in self.outputs:
            raise TypeError(f'{where}: peak = {self.peak!r} is no output')
        if self.supplies and not self.driven:
            raise TypeError(f'{where}: supplies, but {self.spec.__name__} has no input')

    @property
    def efforts(self) -> tuple[str, ...]:
        """The columns that are generalized forces."""
        return (self.effort,) if isinstance(self.effort, str) else self.effort or ()

    @property
    def driven(self) -> bool:
        """True where forces may follow inputs."""
        return _follows_inputs(self.spec)

    def column(self, name: str) -> int:
        """Index of an output. Raises ValueError."""
        return list(self.outputs).index(name)


@dataclass(frozen=True, kw_only=True)
class ConstraintKind:
    """A kind of constraint.

    name: the field of ModelSpec and the section of a file. compile(specs, context): their table; rows and Jacobian
    blocks are those that context.rows() gives out. If the specification has an input, the table has columns `row` and
    `input` (n, 3): channels of value, rate and acceleration, -1 for none, and the value is subtracted in that row.
    residuals assigns phi and, when `gradients`, J; hessians adds d(A^T lam)/dq to Kq (Kv is scratch of its shape).
    on_coordinates: the kernels take the table of joint coordinates, and residuals their values and the inputs.
    """

    name: str
    spec: type[ConstraintSpec]
    compile: Callable[..., Any]
    residuals: Callable[..., None]
    hessians: Callable[..., None]
    on_coordinates: bool = False

    def __post_init__(self) -> None:
        where = f'kind {self.name!r}'
        _require_arguments(where, self.residuals, RESIDUALS_ON_COORDINATES if self.on_coordinates else RESIDUALS)
        _require_arguments(where, self.hessians, HESSIANS_ON_COORDINATES if self.on_coordinates else HESSIANS)
        if self.driven and not self.on_coordinates:
            raise TypeError(f'{where}: {self.spec.__name__} has an input, which only kernels on coordinates are given')

    @property
    def driven(self) -> bool:
        """True where rows may follow inputs."""
        return _follows_inputs(self.spec)
