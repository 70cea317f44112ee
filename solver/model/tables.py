"""The compiled model: immutable tables, layout and pattern, as NamedTuples that kernels read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.compiled.by_reference import Ref
from solver.elements.aero_drag import AeroDragTable
from solver.elements.applied_force import AppliedForceTable
from solver.elements.brake import BrakeTable
from solver.elements.bushing import BushingTable
from solver.elements.contact import ContactTable
from solver.elements.coordinate import CoordinateTable
from solver.elements.coordinate_force import CoordinateForceTable
from solver.elements.coupler import CouplerTable
from solver.elements.joint import JointTable
from solver.elements.laws import LawTable
from solver.elements.rigid_body import BodyTable
from solver.elements.spring_damper import SpringDamperTable
from solver.elements.tire_pacejka import TireTable
from solver.linear.elimination import Elimination
from solver.model.spec import ModelSpec

MAX_CALLS = 16


class ConstraintTable(NamedTuple):
    """Constraint groups (a joint, a contact or a coupler each): rows, Jacobian blocks and the matrix blocks they fill."""

    row: np.ndarray  # (ng + 1,) first row of each group
    entry: np.ndarray  # (ng + 1,) first Jacobian block of each group
    body: np.ndarray  # (entries + 1,) body of each Jacobian block; block 0 is the trash block of the world
    pair: np.ndarray  # (ng + 1,) first of the entry x entry slots of each group
    slot: np.ndarray  # (pairs,) slot of (entry a, entry b), a-major
    holonomic: np.ndarray  # (nc,) 1 for position constraints, 0 for velocity constraints, whose phi is A v
    up: np.ndarray  # (entries + 1,) block form: slot (body, group)
    down: np.ndarray  # (entries + 1,) block form: slot (group, body)
    centre: np.ndarray  # (ng,) block form: slot (group, group)
    joints: JointTable
    contacts: ContactTable
    couplers: CouplerTable


class Tables(NamedTuple):
    """Everything the kernels need of a model."""

    calls: np.ndarray  # (MAX_CALLS,) addresses of the kernels of this model's elements (solver.model.evaluate.bind)
    bodies: BodyTable
    penalty_inverse_mass: np.ndarray  # (nb,) 1/mass with a floor, for the effective masses of constraints only
    penalty_inverse_inertia: np.ndarray  # (nb, 3, 3)
    block_row: np.ndarray  # (ns + 1,) body of the row of each slot; slot 0 is the trash slot of the world
    block_col: np.ndarray  # (ns + 1,)
    coordinates: CoordinateTable
    constraints: ConstraintTable
    laws: LawTable
    spring_dampers: SpringDamperTable
    bushings: BushingTable
    coordinate_forces: CoordinateForceTable
    brakes: BrakeTable
    applied_forces: AppliedForceTable
    aero_drags: AeroDragTable
    tires: TireTable
    condensed: Elimination  # of the n x n form
    block: Elimination  # of the block form


@dataclass(frozen=True, kw_only=True)
class Model:
    """A compiled model: its specification, kernel tables and names."""

    spec: ModelSpec
    tables: Ref  # of Tables
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
    coordinate_index: dict[str, int]
