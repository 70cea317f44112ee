"""A toy constraint of the recipe in docs/contributing.md: a point of body j stays at a height above the point of i,
along z of the world.

phi = e_z . (p_j - p_i) - height
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.vec import cross, cross_cross, load3, load33, mscale, put33, tmv
from solver.dimensions import Length
from solver.elements.kind import ConstraintKind
from solver.elements.marker import ConstraintSpec, Context, Marker, compile_pairs, number_pairs
from solver.elements.point_pair import point_position
from solver.validate import finite


@dataclass(frozen=True, kw_only=True)
class LevelSpec(ConstraintSpec):
    """The origin of marker j is `height` [m] above that of marker i."""

    i: Marker
    j: Marker
    height: Length = 0.0

    def __post_init__(self) -> None:
        self.set('height', finite(self.where, 'height', self.height))


class LevelTable(NamedTuple):
    """Columns of all levels."""

    body: np.ndarray
    r_i: np.ndarray
    r_j: np.ndarray
    slot: np.ndarray
    row: np.ndarray
    entry: np.ndarray
    height: np.ndarray


def compile_levels(specs: Sequence[LevelSpec], context: Context) -> LevelTable:
    """Resolve names into a table."""
    row, entry = number_pairs(specs, context)
    pairs = compile_pairs(specs, context)
    height = np.array([s.height for s in specs], float)
    return LevelTable(
        body=pairs.body, r_i=pairs.r_i, r_j=pairs.r_j, slot=pairs.slot, row=row, entry=entry, height=height
    )


@kernel(borrow=True)
def evaluate_levels(table, kin, gradients, phi, J):
    """Assign residuals phi (nc,) and, when `gradients`, blocks J (entries + 1, 6, 6) of A."""
    up = (0.0, 0.0, 1.0)
    for e in range(table.row.shape[0]):
        i, j = table.body[e, 0], table.body[e, 1]
        r_i, r_j = load3(table.r_i, e), load3(table.r_j, e)
        phi[table.row[e]] = point_position(kin, j, r_j)[2] - point_position(kin, i, r_i)[2] - table.height[e]
        if gradients:
            turn_i = cross(r_i, tmv(load33(kin.R, i), up))
            turn_j = cross(r_j, tmv(load33(kin.R, j), up))
            for c in range(3):
                J[table.entry[e, 0], 0, c] = -up[c]
                J[table.entry[e, 0], 0, 3 + c] = -turn_i[c]
                J[table.entry[e, 1], 0, c] = up[c]
                J[table.entry[e, 1], 0, 3 + c] = turn_j[c]


@kernel(borrow=True)
def add_level_hessians(table, kin, lam, Kq, Kv):
    """Add d(A^T lam)/dq of all levels to Kq; Kv is left alone."""
    for e in range(table.row.shape[0]):
        P = (0.0, 0.0, lam[table.row[e]])
        on_j = cross_cross(load3(table.r_j, e), tmv(load33(kin.R, table.body[e, 1]), P))
        on_i = cross_cross(load3(table.r_i, e), tmv(load33(kin.R, table.body[e, 0]), P))
        put33(Kq, table.slot[e, 3], 3, 3, on_j)
        put33(Kq, table.slot[e, 0], 3, 3, mscale(-1.0, on_i))


LEVELS = ConstraintKind(
    name='levels', spec=LevelSpec, compile=compile_levels, residuals=evaluate_levels, hessians=add_level_hessians
)
