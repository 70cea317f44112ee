"""Specification -> tables: names become indices, elements flat columns, the body graph an elimination plan."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from solver.compiled.by_reference import Ref
from solver.compiled.dense import inverse, norms, principal_moments
from solver.compiled.so3 import matrix_of_quaternion
from solver.elements.aero_drag import compile_aero_drags
from solver.elements.applied_force import compile_applied_forces
from solver.elements.brake import compile_brakes
from solver.elements.bushing import compile_bushings
from solver.elements.contact import ContactSpec, compile_contacts
from solver.elements.coordinate import CoordinateSpec, compile_coordinates, evaluate_coordinate
from solver.elements.coordinate_force import compile_coordinate_forces
from solver.elements.coupler import MAX_TERMS, CouplerTable
from solver.elements.joint import JointSpec, compile_joints
from solver.elements.laws import Law, compile_laws
from solver.elements.marker import WORLD, Marker, PlacedMarker
from solver.elements.rigid_body import compile_bodies
from solver.elements.spring_damper import compile_spring_dampers
from solver.elements.tire_pacejka import compile_tires
from solver.errors import SpecError, suggestion
from solver.linear.elimination import plan_elimination
from solver.model.spec import ModelSpec
from solver.model.state import kinematics_of, placed_configuration
from solver.model.tables import MAX_CALLS, ConstraintTable, Model, Tables

PENALTY_MASS_FLOOR = 1e-4  # of the mean mass; keeps 1/(a M^-1 a^T) away from zero for (nearly) massless bodies and point masses

MASSLESS = 1e-12  # of the largest mass or moment of inertia in the model


def rotation(quaternion) -> np.ndarray:
    """(3, 3) rotation matrix of a quaternion xyzw."""
    return np.array(matrix_of_quaternion(tuple(float(x) for x in quaternion))).reshape(3, 3)


def joint_coordinates(joint: JointSpec) -> list[CoordinateSpec]:
    """Coordinates that a joint defines: revolute and prismatic one named after it, cylindrical '/angle' and '/slide'."""
    kinds = {'revolute': [('', 'rotation')], 'prismatic': [('', 'translation')]}
    kinds['cylindrical'] = [('/angle', 'rotation'), ('/slide', 'translation')]
    return [CoordinateSpec(name=joint.name + end, kind=kind, i=joint.i, j=joint.j) for end, kind in kinds.get(joint.kind, [])]


class _Context:
    """The Context of solver.elements.marker over one ModelSpec."""

    def __init__(self, spec: ModelSpec) -> None:
        self.spec = spec
        self.n_bodies = len(spec.bodies)
        self.bodies = {b.name: k for k, b in enumerate(spec.bodies)} | {WORLD: self.n_bodies}
        self.inputs = {name: k for k, name in enumerate(spec.inputs)}
        self.coordinates: dict[str, int] = {}
        self.laws: list[Law] = []
        self.slots: dict[tuple[int, int], int] = {}
        self.internal_owner: list[str] = []
        for b in range(self.n_bodies):
            self.slot(b, b)

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
        return PlacedMarker(b, np.array(marker.position) - com, rotation(marker.orientation))

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

    def law(self, law: Law | None) -> int:
        if law is None:
            return -1
        self.laws.append(law)
        return len(self.laws) - 1

    def internal_states(self, where: str, count: int) -> int:
        self.internal_owner += [where] * count
        return len(self.internal_owner) - count


def compile_model(spec: ModelSpec) -> Model:
    """Compile a ModelSpec. Raises SpecError (element, field, value, remedy) for anything that does not fit together."""
    context = _Context(spec)
    coordinate_specs = [c for joint in spec.joints for c in joint_coordinates(joint)] + list(spec.coordinates)
    for k, c in enumerate(coordinate_specs):
        if c.name in context.coordinates:
            raise SpecError(f'{c.where}: name = {c.name!r}: a joint already defines this coordinate; rename one')
        context.coordinates[c.name] = k
    context.coordinate_specs = coordinate_specs
    coordinates = compile_coordinates(coordinate_specs, context)
    constraints, row_names, group_names = _compile_constraints(spec, context)
    forces = {
        'spring_dampers': compile_spring_dampers(spec.spring_dampers, context),
        'bushings': compile_bushings(spec.bushings, context),
        'coordinate_forces': compile_coordinate_forces(spec.coordinate_forces, context),
        'brakes': compile_brakes(spec.brakes, context),
        'applied_forces': compile_applied_forces(spec.applied_forces, context),
        'aero_drags': compile_aero_drags(spec.aero_drags, context),
        'tires': compile_tires(spec.tires, spec.road, context),
    }
    n_slots = len(context.slots)
    block_row = np.zeros(n_slots + 1, np.int64)
    block_col = np.zeros(n_slots + 1, np.int64)
    for (r, c), s in context.slots.items():
        block_row[s], block_col[s] = r, c
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
    follow: dict[int, set[int]] = {b: set() for b in _massless(bodies)}
    for group, members in wait_for.items():
        for b in members & follow.keys():
            follow[b].add(group)
    wait_for = {group: heavy for group, members in wait_for.items() if (heavy := members - follow.keys())}
    inverse_mass, inverse_inertia = _floored_inverses(bodies, constraints.joints)
    tables = Ref(
        Tables(
            calls=np.zeros(MAX_CALLS, np.int64),
            bodies=bodies,
            penalty_inverse_mass=inverse_mass,
            penalty_inverse_inertia=inverse_inertia,
            block_row=block_row,
            block_col=block_col,
            coordinates=coordinates,
            constraints=constraints,
            laws=compile_laws(context.laws),
            condensed=plan_elimination(nb, context.slots),
            block=plan_elimination(nb + groups, block_slots, wait_for, follow),
            **forces,
        )
    )
    model = Model(
        spec=spec,
        tables=tables,
        n_bodies=nb,
        n_rows=int(constraints.row[-1]),
        n_slots=n_slots,
        n_entries=len(constraints.body) - 1,
        n_internal=len(context.internal_owner),
        coordinate_names=tuple(context.coordinates),
        coordinate_kinds=tuple(c.kind for c in coordinate_specs),
        coordinate_index=dict(context.coordinates),
        row_names=tuple(row_names),
        group_names=tuple(group_names),
        body_names=tuple(b.name for b in spec.bodies),
        internal_owner=tuple(context.internal_owner),
    )
    _resolve_offsets(model)
    return model


def _compile_constraints(spec: ModelSpec, context: _Context) -> tuple[ConstraintTable, list[str], list[str]]:
    nb = context.n_bodies
    row, entry, body, pair, slot = [0], [1], [nb], [0], []
    row_names: list[str] = []

    def add_group(bodies: list[int], rows: int) -> dict[int, int]:
        """Number the Jacobian blocks of a group; the world gets the trash block 0."""
        index = {nb: 0}
        for b in bodies:
            if b not in index:
                index[b] = len(body)
                body.append(b)
        own = [b for b in index if b != nb]
        for a in own:
            for b in own:
                slot.append(context.slot(a, b))
        row.append(row[-1] + rows)
        entry.append(len(body))
        pair.append(len(slot))
        return index

    def add_pairs(specs: Sequence[JointSpec] | Sequence[ContactSpec]) -> tuple[list[int], list[tuple[int, int]]]:
        """Number the rows and blocks of constraints between two bodies: (first rows, blocks of i and j)."""
        first, entries = [], []
        for each in specs:
            i, j = context.body(each.where, each.i.body), context.body(each.where, each.j.body)
            first.append(row[-1])
            index = add_group([i, j], len(each.row_names()))
            entries.append((index[i], index[j]))
            row_names.extend(each.row_names())
        return first, entries

    joints = compile_joints(spec.joints, context, *add_pairs(spec.joints))
    holonomic = [1] * row[-1] + [flag for contact in spec.contacts for flag in contact.holonomic()]
    contacts = compile_contacts(spec.contacts, context, *add_pairs(spec.contacts))
    n = len(spec.couplers)
    couplers = CouplerTable(
        row=np.zeros(n, np.int64),
        terms=np.array([len(c.terms) for c in spec.couplers], np.int64),
        coordinate=np.zeros((n, MAX_TERMS), np.int64),
        factor=np.zeros((n, MAX_TERMS)),
        entry=np.zeros((n, MAX_TERMS, 2), np.int64),
        offset=np.zeros(n),
        input=np.full((n, 3), -1, np.int64),
    )
    for k, coupler in enumerate(spec.couplers):
        pairs = []
        for t, (name, factor) in enumerate(coupler.terms):
            c = context.coordinate(coupler.where, name)
            couplers.coordinate[k, t], couplers.factor[k, t] = c, factor
            pairs.append(context.coordinate_bodies(c))
        couplers.row[k] = row[-1]
        index = add_group([b for pair_ in pairs for b in pair_], 1)
        for t, (i, j) in enumerate(pairs):
            couplers.entry[k, t] = index[i], index[j]
        if coupler.input is not None:
            couplers.input[k] = [context.input(coupler.where, coupler.input + end) for end in ('', '_rate', '_acceleration')]
        row_names.append(coupler.name)
    groups = len(row) - 1
    table = ConstraintTable(
        row=np.array(row, np.int64),
        entry=np.array(entry, np.int64),
        body=np.array(body, np.int64),
        pair=np.array(pair, np.int64),
        slot=np.array(slot, np.int64),
        holonomic=np.array(holonomic + n * [1], np.int64),
        up=np.zeros(len(body), np.int64),
        down=np.zeros(len(body), np.int64),
        centre=np.zeros(groups, np.int64),
        joints=joints,
        contacts=contacts,
        couplers=couplers,
    )
    return table, row_names, [s.name for s in (*spec.joints, *spec.contacts, *spec.couplers)]


def _massless(bodies) -> list[int]:
    """Bodies whose mass matrix is singular, or nearly so beside those of the others."""
    moments = principal_moments(bodies.inertia)
    light = bodies.mass <= MASSLESS * bodies.mass.max()
    return [int(b) for b in np.flatnonzero(light | (moments[:, 0] <= MASSLESS * moments.max()))]


def _floored_inverses(bodies, joints) -> tuple[np.ndarray, np.ndarray]:
    """1/mass (nb,) and inverse inertia (nb, 3, 3) with floors.

    The floor of the inertia is a fraction of the mean of inertia and mass * (lever arm of a joint)^2: the second remains when all
    bodies are point masses.
    """
    n = len(bodies.mass)
    mass = np.maximum(bodies.mass, PENALTY_MASS_FLOOR * max(float(bodies.mass.mean()), 1e-12))
    size = np.trace(bodies.inertia, axis1=1, axis2=2)
    arm = np.zeros(n + 1)
    for side, r in enumerate((joints.r_i, joints.r_j)):
        np.maximum.at(arm, joints.body[:, side], norms(r))
    floor = PENALTY_MASS_FLOOR * max(float((size + bodies.mass * arm[:n] ** 2).mean()), 1e-12)
    return 1.0 / mass, inverse(bodies.inertia + floor * np.eye(3) * (size < 3 * floor).reshape(n, 1, 1) + 1e-300 * np.eye(3))


def _resolve_offsets(model: Model) -> None:
    """Give couplers without an offset the value that holds in the placed configuration."""
    table = model.tables.constraints.couplers
    kin = kinematics_of(placed_configuration(model), np.zeros((model.n_bodies + 1, 6)))
    zero = np.zeros(len(model.coordinate_names))
    coordinates = Ref(model.tables.coordinates)
    for k, coupler in enumerate(model.spec.couplers):
        if coupler.offset is not None:
            table.offset[k] = coupler.offset
            continue
        for t in range(table.terms[k]):
            x, _, _ = evaluate_coordinate(coordinates, kin, table.coordinate[k, t], zero)
            table.offset[k] += table.factor[k, t] * x
