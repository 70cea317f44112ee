"""The compiled model: immutable tables, layout and pattern, as NamedTuples that kernels read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from solver.compiled.by_reference import Ref
from solver.elements.coordinate import CoordinateTable
from solver.elements.laws import LawTable
from solver.elements.registry import FORCE_BY_NAME, FORCES
from solver.elements.rigid_body import BodyTable
from solver.linear.elimination import Elimination
from solver.model.spec import ModelSpec

# Columns of Tables.forces: address of the kernel (0: the model has no such element) and of the table; whether its
# forces follow inputs; where the outputs are, number of elements and of columns
ADDRESS, TABLE, DRIVEN, OUTPUT, COUNT, WIDTH, ROTATION, PEAK = range(8)
# and of Tables.constraint_kinds: addresses of the kernels of residuals and of second derivatives, and of the table;
# whether the kernels work on joint coordinates
RESIDUALS, HESSIANS, CONSTRAINT_TABLE, CONSTRAINT_ON_COORDINATES = range(4)
FACTORIZE, SOLVE = range(2)  # of Tables.linear


class ConstraintTable(NamedTuple):
    """Constraint groups (a joint, a contact or a coupler each): rows, Jacobian blocks and the matrix blocks they
    fill."""

    row: np.ndarray  # (ng + 1,) first row of each group
    entry: np.ndarray  # (ng + 1,) first Jacobian block of each group
    body: np.ndarray  # (entries + 1,) body of each Jacobian block; block 0 is the trash block of the world
    pair: np.ndarray  # (ng + 1,) first of the entry x entry slots of each group
    slot: np.ndarray  # (pairs,) slot of (entry a, entry b), a-major
    holonomic: np.ndarray  # (nc,) 1 for position constraints, 0 for velocity constraints, whose phi is A v
    up: np.ndarray  # (entries + 1,) block form: slot (body, group)
    down: np.ndarray  # (entries + 1,) block form: slot (group, body)
    centre: np.ndarray  # (ng,) block form: slot (group, group)
    driven: np.ndarray  # (nd, 3) rows that follow an input, and the channels of its rate and acceleration


class EffortTable(NamedTuple):
    """Outputs that are generalized forces on joint coordinates, one after the other; those of forces at coordinates
    that no driver prescribes."""

    output: np.ndarray  # (m,) index in the outputs
    coordinate: np.ndarray  # (m,)
    factor: np.ndarray  # (m,)


class Tables(NamedTuple):
    """Everything the kernels need of a model. The tables of element kinds are known to their own kernels only."""

    forces: np.ndarray  # (kinds of forces, 8) see ADDRESS ... PEAK
    constraint_kinds: np.ndarray  # (kinds of constraints, 4)
    linear: np.ndarray  # (2,) addresses of factorize and solve
    bodies: BodyTable
    penalty_inverse_mass: np.ndarray  # (nb,) 1/mass with a floor, for the effective masses of constraints only
    penalty_inverse_inertia: np.ndarray  # (nb, 3, 3)
    block_row: np.ndarray  # (ns + 1,) body of the row of each slot; slot 0 is the trash slot of the world
    block_col: np.ndarray  # (ns + 1,)
    # slots, from the first one on, that forces may have a tangent over velocities in; in joints alone those of the
    # bodies
    damped: int
    coordinates: CoordinateTable
    constraints: ConstraintTable
    laws: LawTable
    effort: EffortTable
    fed: np.ndarray  # (m,) outputs of a `dissipation` that is work from outside (ForceKind.feeds)
    drives: EffortTable  # rows that prescribe a motion (`output` is the row) and the coordinates they drive
    condensed: Elimination  # of the n x n form
    block: Elimination  # of the block form


@dataclass(frozen=True, kw_only=True)
class Model:
    """A compiled model: its specification, kernel tables and names."""

    spec: ModelSpec
    tables: Ref  # of Tables
    elements: dict[str, Ref]  # tables of the kinds of forces and constraints, by name
    n_bodies: int
    n_rows: int  # constraint rows
    n_slots: int  # 6x6 blocks of forces and constraints, without fill and without the trash slot
    n_entries: int  # Jacobian blocks, without the trash block
    n_internal: int
    coordinate_names: tuple[str, ...]
    coordinate_kinds: tuple[str, ...]
    row_names: tuple[str, ...]
    group_names: tuple[str, ...]
    body_names: tuple[str, ...]
    internal_owner: tuple[str, ...]
    internal_size: tuple[float, ...]  # what their errors count relative to
    internal_bodies: tuple[int, ...]  # bodies whose motion internal states depend on
    coordinate_index: dict[str, int]

    def outputs(self, kind: str, numbers: np.ndarray) -> np.ndarray:
        """(n, columns) outputs of a kind of force within those of all elements (new_outputs); a view."""
        row = self.tables.forces[FORCES.index(FORCE_BY_NAME[kind])]
        return numbers[row[OUTPUT] : row[OUTPUT] + row[COUNT] * row[WIDTH]].reshape(row[COUNT], row[WIDTH])

    @property
    def n_peaks(self) -> int:
        """Elements of which the account notes a largest value."""
        forces = self.tables.forces
        return int(forces[forces[:, PEAK] >= 0, COUNT].sum())

    def new_outputs(self) -> np.ndarray:
        """Room for the outputs of all force elements, kind by kind, filled with NaN until an evaluation assigns
        them."""
        return np.full(int((self.tables.forces[:, COUNT] * self.tables.forces[:, WIDTH]).sum()), np.nan)

    def inputs_of(self, kind: str) -> np.ndarray:
        """Indices of the inputs that the forces of a kind follow."""
        used = np.unique(self.elements[kind].input) if FORCE_BY_NAME[kind].driven else np.zeros(0, int)
        return used[used >= 0]

    def only(self, kind: str | None) -> Ref:
        """The tables with the force elements of one kind alone, or with none."""
        forces = self.tables.forces.copy()
        forces[[k for k, other in enumerate(FORCES) if other.name != kind], ADDRESS] = 0
        return Ref(self.tables.value._replace(forces=forces))

    def with_tables(self, changed: dict[str, Any]) -> tuple[Ref, list[Ref]]:
        """(the tables with those of some kinds of force exchanged, what must be kept alive as long as they are
        used)."""
        forces, kept = self.tables.forces.copy(), []
        for kind, table in changed.items():
            kept.append(Ref(table))
            forces[FORCES.index(FORCE_BY_NAME[kind]), TABLE] = kept[-1].pointer
        return Ref(self.tables.value._replace(forces=forces)), kept
