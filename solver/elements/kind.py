"""Kinds of elements: one ForceKind or ConstraintKind object for each, listed in solver.elements.registry.

The program knows elements by these objects alone. Loops over them make tables, calls of kernels, outputs, the energy
account, balances, reference solutions, recordings and the sections of files. A kind is checked when its object is made,
so that a forgotten part is an error at import.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from solver.elements.marker import ConstraintSpec, Spec

# Arguments that kernels must have.
FORCE = ('table', 'now', 'effects', 'out')
RESIDUALS = ('table', 'kin', 'gradients', 'phi', 'J')
RESIDUALS_ON_COORDINATES = ('table', 'coordinates', 'kin', 'angle', 'u', 'gradients', 'phi', 'J')
HESSIANS = ('table', 'kin', 'lam', 'Kq', 'Kv')
HESSIANS_ON_COORDINATES = ('table', 'coordinates', *HESSIANS[1:])
FIRST_OUTPUTS = ('energy', 'dissipation')


class Held(NamedTuple):
    """Behaviour of the elements of a kind in the search for static equilibrium."""

    table: Any  # table of the kind that the search uses
    inputs: np.ndarray  # (nu,) inputs that the search uses
    limits: dict[int, float]  # internal state -> magnitude to which it is cut at the end of the search


def _require_arguments(where: str, kernel: Callable, wanted: tuple[str, ...]) -> None:
    """Raise TypeError for a kernel that has other arguments."""
    given = tuple(inspect.signature(getattr(kernel, 'py_func', kernel)).parameters)
    if given != wanted:
        raise TypeError(f'{where}: {kernel.__name__}({", ".join(given)}) must have the arguments ({", ".join(wanted)})')


def _follows_inputs(spec: type[Spec]) -> bool:
    return any(field.name == 'input' for field in dataclasses.fields(spec))


@dataclass(frozen=True, kw_only=True)
class ForceKind:
    """A kind of force element.

    name: field of ModelSpec, and section of a file. spec: class of the specifications. compile(specs, context): makes
    their table, a NamedTuple of arrays; it has a column `body` if the elements have internal states, and a column
    `input` (indices of inputs, -1 for none) if the specification has an input. kernel: see solver.elements. outputs:
    column -> unit, energy and dissipation first.

    supplies: the inputs are loads, which supply energy (else they are capacities, as of brakes). active: the elements
    do work from outside of the mechanics without an input, as a motor does. effort: output column
    that is a generalized force on the joint coordinates in the table's column `coordinate` (-1 for none), times its
    column `factor` if it has one; or a tuple with a column for each coordinate. rotation: first of three output columns
    that are a rotation vector [rad] on which the element acts; it jumps at a turn by pi. peak: output column whose
    largest value the account of a run notes. wheels: the elements are the wheels of a vehicle, with topics of their
    own.

    held(table, u): table, inputs and limits in the search for static equilibrium. approach(table): table with which
    that search begins, for a start that may be far away. capacities(table, u): largest torques [N m] of the brakes in
    these elements, under the inputs u (nu,).
    """

    name: str
    spec: type[Spec]
    compile: Callable[..., Any]
    kernel: Callable[..., None]
    outputs: Mapping[str, str]
    supplies: bool = False
    active: bool = False
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
                f'{where}: the first two outputs must be {" and ".join(FIRST_OUTPUTS)}, not '
                f'{", ".join(list(self.outputs)[:2])}'
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
        """Output columns that are generalized forces."""
        return (self.effort,) if isinstance(self.effort, str) else self.effort or ()

    @property
    def driven(self) -> bool:
        """True if the elements can have an input."""
        return _follows_inputs(self.spec)

    def feeds(self, spec: Spec) -> bool:
        """True for an element whose whole power is work from outside (negative dissipation), what it loses included."""
        return self.active or (self.supplies and bool(getattr(spec, 'input', None)))

    def column(self, name: str) -> int:
        """Index of an output column. Raises ValueError for an unknown name."""
        return list(self.outputs).index(name)


@dataclass(frozen=True, kw_only=True)
class ConstraintKind:
    """A kind of constraint.

    name: field of ModelSpec, and section of a file. spec: class of the specifications. compile(specs, context): makes
    their table, with rows and Jacobian blocks from context.rows(). If the specification has an input, the table has
    columns `row` and `input` (n, 3): indices of the inputs of value, rate and acceleration, -1 for none; the value is
    subtracted in that row. residuals: kernel that assigns phi and, when `gradients`, J. hessians: kernel that adds
    d(A^T lam)/dq to Kq; Kv is scratch of the same shape. on_coordinates: the kernels also take the table of joint
    coordinates, and `residuals` their values and the inputs.
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
        """True if the constraints can have an input."""
        return _follows_inputs(self.spec)
