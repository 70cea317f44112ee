"""Specification -> tables: names become indices, elements flat columns, the body graph an elimination plan."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from solver.compiled.by_reference import Ref
from solver.compiled.portable import inverse, norms, principal_moments
from solver.elements.coordinate import CoordinateSpec, compile_coordinates, evaluate_coordinate
from solver.elements.joint import JointSpec
from solver.elements.kind import FIRST_OUTPUTS, ForceKind
from solver.elements.laws import Law, compile_laws
from solver.elements.marker import WORLD, ConstraintSpec, Marker, PlacedMarker
from solver.elements.registry import CONSTRAINTS, FORCES
from solver.elements.rigid_body import compile_bodies
from solver.elements.road import RoadSpec
from solver.errors import SpecError, suggestion
from solver.linear.elimination import plan_elimination
from solver.model.frames import matrix
from solver.model.free_rotations import standing_inertia
from solver.model.scale import length_of
from solver.model.spec import ModelSpec
from solver.model.state import kinematics_of, placed_configuration
from solver.model.tables import (
    CONSTRAINT_ON_COORDINATES,
    CONSTRAINT_TABLE,
    COUNT,
    DRIVEN,
    OUTPUT,
    PEAK,
    ROTATION,
    TABLE,
    WIDTH,
    ConstraintTable,
    EffortTable,
    Model,
    Tables,
)

# of the mean mass; keeps 1/(a M^-1 a^T) away from zero for (nearly) massless bodies and point masses
PENALTY_MASS_FLOOR = 1e-4

MASSLESS = 1e-12  # of the largest mass or moment of inertia in the model
THIN = 1e-9  # of the largest moment of inertia: bodies that turn about an axis with less have a floor there too


def joint_coordinates(joint: JointSpec) -> list[CoordinateSpec]:
    """Coordinates that a joint defines: revolute and prismatic one named after it, cylindrical '/angle' and
    '/slide'."""
    kinds: dict[str, list[tuple[str, Literal['translation', 'rotation']]]] = {
        'revolute': [('', 'rotation')],
        'prismatic': [('', 'translation')],
        'cylindrical': [('/angle', 'rotation'), ('/slide', 'translation')],
    }
    return [
        CoordinateSpec(name=joint.name + end, kind=kind, i=joint.i, j=joint.j)
        for end, kind in kinds.get(joint.kind, [])
    ]


class _Context:
    """The Context of solver.elements.marker over one ModelSpec."""

    def __init__(self, spec: ModelSpec) -> None:
        self.spec = spec
        self.road: RoadSpec = spec.road
        self.n_bodies = len(spec.bodies)
        self.bodies = {b.name: k for k, b in enumerate(spec.bodies)} | {WORLD: self.n_bodies}
        self.inputs = {name: k for k, name in enumerate(spec.inputs)}
        self.coordinates: dict[str, int] = {}
        self.coordinate_specs: list[CoordinateSpec] = []
        self.laws: list[Law] = []
        self.slots: dict[tuple[int, int], int] = {}
        self.internal_owner: list[str] = []
        self.internal_size: list[float] = []
        self.groups = _Groups(self)
        for b in range(self.n_bodies):
            self.slot(b, b)
        self.coordinate_specs = [c for joint in spec.joints for c in joint_coordinates(joint)] + list(spec.coordinates)
        for k, c in enumerate(self.coordinate_specs):
            if c.name in self.coordinates:
                raise SpecError(f'{c.where}: name = {c.name!r}: a joint already defines this coordinate; rename one')
            self.coordinates[c.name] = k
        self.coordinate_table = compile_coordinates(self.coordinate_specs, self)

    @staticmethod
    def _look_up(where: str, what: str, name: str, known: dict[str, int]) -> int:
        if name not in known:
            raise SpecError(f'{where}: {what} = {name!r}: no such {what}' + suggestion(str(name), known))
        return known[name]

    def body(self, where: str, name: str) -> int:
        return self._look_up(where, 'body', name, self.bodies)

    def marker(self, where: str, marker: Marker) -> PlacedMarker:
        b = self.body(where, marker.body)
        com = np.array(self.spec.bodies[b].com) if b < self.n_bodies else np.zeros(3)
        return PlacedMarker(b, np.array(marker.position) - com, matrix(marker.orientation))

    def slot(self, row: int, column: int) -> int:
        if self.n_bodies in (row, column):
            return 0
        return self.slots.setdefault((row, column), 1 + len(self.slots))

    def input(self, where: str, name: str) -> int:
        return self._look_up(where, 'input', name, self.inputs)

    def coordinate(self, where: str, name: str) -> int:
        return self._look_up(where, 'coordinate', name, self.coordinates)

    def coordinate_bodies(self, index: int) -> tuple[int, int]:
        """Bodies i and j of a coordinate."""
        spec = self.coordinate_specs[index]
        return self.body(spec.where, spec.i.body), self.body(spec.where, spec.j.body)

    def placed_coordinate(self, index: int) -> float:
        """Value of a coordinate in the placed configuration."""
        kin = kinematics_of(placed_configuration(self.spec.bodies), np.zeros((self.n_bodies + 1, 6)))
        return float(evaluate_coordinate(Ref(self.coordinate_table), kin, index, np.zeros(len(self.coordinates)))[0])

    def rows(self, spec: ConstraintSpec, bodies: Sequence[int]) -> tuple[int, list[int]]:
        """Number the rows of a constraint between bodies: (first row, Jacobian block of each body)."""
        return self.groups.add(spec, bodies)

    def law(self, law: Law | None) -> int:
        if law is None:
            return -1
        self.laws.append(law)
        return len(self.laws) - 1

    def internal_states(self, where: str, count: int, size: float = 1.0) -> int:
        self.internal_owner += [where] * count
        self.internal_size += [size] * count
        return len(self.internal_owner) - count


class _Groups:
    """Numbers constraint rows, Jacobian blocks and the matrix blocks that their products fill."""

    def __init__(self, context: _Context) -> None:
        self.context = context
        self.row, self.entry, self.body, self.pair = [0], [1], [context.n_bodies], [0]
        self.slot: list[int] = []
        self.holonomic: list[int] = []
        self.row_names: list[str] = []
        self.names: list[str] = []

    def add(self, spec: ConstraintSpec, bodies: Sequence[int]) -> tuple[int, list[int]]:
        """See _Context.rows."""
        nb, first = self.context.n_bodies, self.row[-1]
        index = {nb: 0}  # the world gets the trash block 0
        for b in bodies:
            if b not in index:
                index[b] = len(self.body)
                self.body.append(b)
        own = [b for b in index if b != nb]
        self.slot += [self.context.slot(a, b) for a in own for b in own]
        self.row.append(first + len(spec.row_names()))
        self.entry.append(len(self.body))
        self.pair.append(len(self.slot))
        self.row_names += spec.row_names()
        self.holonomic += spec.holonomic()
        self.names.append(spec.name)
        return first, [index[b] for b in bodies]

    def table(self, driven: list[np.ndarray]) -> ConstraintTable:
        """All groups; the slots of the block form are still to be given."""
        as_array = lambda values: np.array(values, np.int64)  # noqa: E731
        return ConstraintTable(
            row=as_array(self.row),
            entry=as_array(self.entry),
            body=as_array(self.body),
            pair=as_array(self.pair),
            slot=as_array(self.slot),
            holonomic=as_array(self.holonomic),
            up=np.zeros(len(self.body), np.int64),
            down=np.zeros(len(self.body), np.int64),
            centre=np.zeros(len(self.names), np.int64),
            driven=np.concatenate([np.zeros((0, 3), np.int64), *driven]),
        )


def compile_model(spec: ModelSpec) -> Model:
    """Compile a ModelSpec. Raises SpecError (element, field, value, remedy) for anything that does not fit together."""
    context = _Context(spec)
    elements: dict[str, Ref] = {}
    constraint_kinds, driven, drives = _compile_constraints(context, elements)
    forces, effort, fed, internal_bodies = _compile_forces(context, elements, drives)
    constraints = context.groups.table(driven)
    n_slots = len(context.slots)
    block_row = np.zeros(n_slots + 1, np.int64)
    block_col = np.zeros(n_slots + 1, np.int64)
    for (row, column), s in context.slots.items():
        block_row[s], block_col[s] = row, column
    nb = context.n_bodies
    groups = len(constraints.centre)
    block_slots = dict(context.slots)
    wait_for: dict[int, set[int]] = {}
    for g in range(groups):
        for e in range(constraints.entry[g], constraints.entry[g + 1]):
            b = int(constraints.body[e])
            constraints.up[e] = block_slots.setdefault((b, nb + g), 1 + len(block_slots))
            constraints.down[e] = block_slots.setdefault((nb + g, b), 1 + len(block_slots))
            wait_for.setdefault(nb + g, set()).add(b)
        constraints.centre[g] = block_slots.setdefault((nb + g, nb + g), 1 + len(block_slots))
    bodies = compile_bodies(spec.bodies, spec.gravity, [context.slots[b, b] for b in range(nb)])
    bodies.inertia[:] += standing_inertia(spec)
    follow: dict[int, set[int]] = {b: set() for b in _massless(bodies)}
    for group, members in wait_for.items():
        for b in members & follow.keys():
            follow[b].add(group)
    wait_for = {group: heavy for group, members in wait_for.items() if (heavy := members - follow.keys())}
    inverse_mass, inverse_inertia = _floored_inverses(
        bodies, [elements[kind.name] for kind in CONSTRAINTS], length_of(spec)
    )
    tables = Ref(
        Tables(
            forces=forces,
            constraint_kinds=constraint_kinds,
            linear=np.zeros(2, np.int64),
            bodies=bodies,
            penalty_inverse_mass=inverse_mass,
            penalty_inverse_inertia=inverse_inertia,
            block_row=block_row,
            block_col=block_col,
            damped=n_slots + 1 if forces[:, COUNT].any() else nb + 1,
            coordinates=context.coordinate_table,
            constraints=constraints,
            laws=compile_laws(context.laws),
            effort=effort,
            drives=drives,
            fed=fed,
            condensed=plan_elimination(nb, context.slots),
            block=plan_elimination(nb + groups, block_slots, wait_for, follow),
        )
    )
    return Model(
        spec=spec,
        tables=tables,
        elements=elements,
        n_bodies=nb,
        n_rows=int(constraints.row[-1]),
        n_slots=n_slots,
        n_entries=len(constraints.body) - 1,
        n_internal=len(context.internal_owner),
        coordinate_names=tuple(context.coordinates),
        coordinate_kinds=tuple(c.kind for c in context.coordinate_specs),
        coordinate_index=dict(context.coordinates),
        row_names=tuple(context.groups.row_names),
        group_names=tuple(context.groups.names),
        body_names=tuple(b.name for b in spec.bodies),
        internal_owner=tuple(context.internal_owner),
        internal_size=tuple(context.internal_size),
        internal_bodies=internal_bodies,
    )


def _compile_constraints(
    context: _Context, elements: dict[str, Ref]
) -> tuple[np.ndarray, list[np.ndarray], EffortTable]:
    """(constraint_kinds of Tables without addresses, rows of ConstraintTable.driven of every kind, drives); adds the
    tables to elements."""
    kinds = np.zeros((len(CONSTRAINTS), 4), np.int64)
    driven = []
    drives: list[tuple[int, int, float]] = []
    for kind, row in zip(CONSTRAINTS, kinds, strict=True):
        specs = getattr(context.spec, kind.name)
        before = len(context.groups.names)
        table = kind.compile(specs, context)
        if len(context.groups.names) != before + len(specs):
            raise TypeError(
                f'kind {kind.name!r}: {kind.compile.__name__} must number the rows of every element once (context.rows)'
            )
        elements[kind.name] = Ref(table)
        row[CONSTRAINT_TABLE] = elements[kind.name].pointer
        row[CONSTRAINT_ON_COORDINATES] = kind.on_coordinates
        if kind.driven:
            follows = table.input[:, 0] >= 0
            driven.append(np.column_stack([table.row, table.input[:, 1:]])[follows])
            if kind.on_coordinates:
                for e in np.flatnonzero(follows):
                    drives += [
                        (int(table.row[e]), int(table.coordinate[e, t]), float(table.factor[e, t]))
                        for t in range(table.terms[e])
                    ]
    return kinds, driven, _effort_table(drives)


DISSIPATION = FIRST_OUTPUTS.index('dissipation')  # its column


def _compile_forces(
    context: _Context, elements: dict[str, Ref], drives: EffortTable
) -> tuple[np.ndarray, EffortTable, np.ndarray, tuple[int, ...]]:
    """(forces of Tables without addresses, efforts, outputs of work from outside, bodies whose motion internal states
    depend on); adds the tables to elements."""
    forces = np.zeros((len(FORCES), 8), np.int64)
    efforts, fed = [], []
    driven = _driven_alone(drives)
    internal_bodies: set[int] = set()
    start = 0
    for kind, row in zip(FORCES, forces, strict=True):
        specs = getattr(context.spec, kind.name)
        states = len(context.internal_owner)
        table = kind.compile(specs, context)
        if len(context.internal_owner) > states:
            internal_bodies |= set(np.unique(table.body).tolist()) - {context.n_bodies}
        elements[kind.name] = Ref(table)
        width = len(kind.outputs)
        row[[TABLE, DRIVEN]] = elements[kind.name].pointer, kind.driven
        row[[OUTPUT, COUNT, WIDTH]] = start, len(specs), width
        row[ROTATION] = -1 if kind.rotation is None else list(kind.outputs).index(kind.rotation)
        row[PEAK] = -1 if kind.peak is None else kind.column(kind.peak)
        if kind.effort is not None and specs:
            efforts += [row for row in _efforts(kind, table, start) if row[1] not in driven]
        fed += [start + e * width + DISSIPATION for e, spec in enumerate(specs) if kind.feeds(spec)]
        start += len(specs) * width
    return forces, _effort_table(efforts), np.array(fed, np.int64), tuple(sorted(internal_bodies))


def _effort_table(rows: list[tuple[int, int, float]]) -> EffortTable:
    columns = tuple(zip(*rows, strict=True)) or ((), (), ())
    return EffortTable(np.array(columns[0], np.int64), np.array(columns[1], np.int64), np.array(columns[2], float))


def _driven_alone(drives: EffortTable) -> set[int]:
    """Coordinates that a driver prescribes one by one: what forces do there is in its effort, with the other sign."""
    return {
        int(k)
        for row, k in zip(drives.output, drives.coordinate, strict=True)
        if np.count_nonzero(drives.output == row) == 1
    }


def _efforts(kind: ForceKind, table: Any, start: int) -> list[tuple[int, int, float]]:
    """Rows of EffortTable of a kind whose outputs begin at `start`."""
    columns = [kind.column(name) for name in kind.efforts]
    coordinates = table.coordinate.reshape(len(table.coordinate), -1)
    factors = table.factor if 'factor' in table._fields else np.ones(coordinates.shape)
    terms = table.terms if 'terms' in table._fields else np.full(len(coordinates), coordinates.shape[1])
    return [
        (start + e * len(kind.outputs) + columns[t % len(columns)], int(coordinates[e, t]), float(factors[e, t]))
        for e in range(len(coordinates))
        for t in range(terms[e])
        if coordinates[e, t] >= 0
    ]


def _massless(bodies) -> list[int]:
    """Bodies whose mass matrix is singular, or nearly so beside those of the others."""
    moments = principal_moments(bodies.inertia)
    light = bodies.mass <= MASSLESS * bodies.mass.max()
    return [int(b) for b in np.flatnonzero(light | (moments[:, 0] <= MASSLESS * moments.max()))]


def _floored_inverses(bodies, constraints: Sequence[Any], length: float) -> tuple[np.ndarray, np.ndarray]:
    """1/mass (nb,) and inverse inertia (nb, 3, 3) with floors, of a model of that length [m].

    The floor of the inertia is a fraction of the mean of inertia and mass * (lever arm of a joint)^2: the second
    remains when all bodies are point masses, and without arms the length of the model stands for them; where nothing
    has mass, any will do. Bodies that turn without inertia about any axis have it, thin rods among them.
    """
    n = len(bodies.mass)
    mean = float(bodies.mass.mean()) if n else 0.0
    mass = np.maximum(bodies.mass, PENALTY_MASS_FLOOR * (mean or 1.0))
    size = np.trace(bodies.inertia, axis1=1, axis2=2)
    arm = np.zeros(n + 1)
    for table in constraints:
        if 'r_i' in table._fields:  # between two markers
            for side, r in enumerate((table.r_i, table.r_j)):
                np.maximum.at(arm, table.body[:, side], norms(r))
    own = float((size + bodies.mass * arm[:n] ** 2).mean()) if n else 0.0
    floor = PENALTY_MASS_FLOOR * (own or mean * length * length or 1.0)
    moments = principal_moments(bodies.inertia)
    floored = (size < 3 * floor) | (moments[:, 0] <= THIN * moments.max())
    return 1.0 / mass, inverse(bodies.inertia + floor * np.eye(3) * floored.reshape(n, 1, 1))
