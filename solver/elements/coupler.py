"""Couplers and drivers: one constraint row that is linear in joint coordinates.

phi = sum_k factor_k x_k - offset - u(t). Rack and pinion, gears and the open differential (three terms) are couplers;
a driver (prescribed motion) is a coupler with an input u, whose rate and acceleration are inputs too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import kernel, sixes
from solver.elements.coordinate import add_coordinate_hessian, evaluate_coordinate
from solver.elements.kind import ConstraintKind
from solver.elements.marker import ConstraintSpec, Context
from solver.inputs.maneuver import ACCELERATION, RATE
from solver.validate import finite, require

MAX_TERMS = 3


@dataclass(frozen=True, kw_only=True)
class CouplerSpec(ConstraintSpec):
    """sum of factor * coordinate = offset + input.

    terms: up to three (coordinate name, factor). offset: None takes the value that holds in the placed (initial)
    configuration. input: name of the channel of u; channels '<input>_rate' and '<input>_acceleration' must exist beside
    it.
    """

    terms: tuple[tuple[str, float], ...]
    offset: float | None = None
    input: str | None = None

    def __post_init__(self) -> None:
        require(
            1 <= len(self.terms) <= MAX_TERMS,
            self.where,
            'terms',
            self.terms,
            f'needs 1 to {MAX_TERMS} [coordinate, factor] pairs',
        )
        self.set('terms', tuple((str(c), finite(self.where, f'factor of {c}', f)) for c, f in self.terms))
        if self.offset is not None:
            self.set('offset', finite(self.where, 'offset', self.offset))


class CouplerTable(NamedTuple):
    """Columns of all couplers (one row each, up to three terms)."""

    row: np.ndarray  # (n,) row in phi
    terms: np.ndarray  # (n,) number of terms
    coordinate: np.ndarray  # (n, 3)
    factor: np.ndarray  # (n, 3)
    entry: np.ndarray  # (n, 3, 2) Jacobian block of bodies i and j of each term; terms may share blocks
    offset: np.ndarray  # (n,)
    input: np.ndarray  # (n, 3) channels of value, rate, acceleration; -1 for none


def compile_couplers(specs: Sequence[CouplerSpec], context: Context) -> CouplerTable:
    """Resolve names into a table; offsets that are not given are those of the placed configuration."""
    n = len(specs)
    table = CouplerTable(
        row=np.zeros(n, np.int64),
        terms=np.array([len(c.terms) for c in specs], np.int64),
        coordinate=np.zeros((n, MAX_TERMS), np.int64),
        factor=np.zeros((n, MAX_TERMS)),
        entry=np.zeros((n, MAX_TERMS, 2), np.int64),
        offset=np.zeros(n),
        input=np.full((n, 3), -1, np.int64),
    )
    for e, spec in enumerate(specs):
        coordinates = [context.coordinate(spec.where, name) for name, _ in spec.terms]
        table.coordinate[e, : len(coordinates)] = coordinates
        table.factor[e, : len(coordinates)] = [factor for _, factor in spec.terms]
        table.row[e], blocks = context.rows(spec, [b for c in coordinates for b in context.coordinate_bodies(c)])
        table.entry[e, : len(coordinates)] = np.reshape(blocks, (-1, 2))
        if spec.input is not None:
            table.input[e] = [context.input(spec.where, spec.input + end) for end in ('', RATE, ACCELERATION)]
        if spec.offset is not None:
            table.offset[e] = spec.offset
        else:
            for t, c in enumerate(coordinates):
                table.offset[e] += table.factor[e, t] * context.placed_coordinate(c)
    return table


@kernel(borrow=True)
def evaluate_couplers(table, coordinates, kin, angle, u, gradients, phi, J):
    """Assign residuals phi (nc,) and, when `gradients`, blocks J (entries + 1, 6, 6) of A of all couplers.

    `angle` continues the rotations (see solver.elements.coordinate).
    """
    J = sixes(J)
    for e in range(table.row.shape[0] if gradients else 0):
        for t in range(table.terms[e]):
            for side in range(2):
                for c in range(6):
                    J[table.entry[e, t, side], 0, c] = 0.0
    for e in range(table.row.shape[0]):
        residual = -table.offset[e] + 0.0 * kin.p[0, 0]
        if table.input[e, 0] >= 0:
            residual -= u[table.input[e, 0]]
        for t in range(table.terms[e]):
            factor = table.factor[e, t]
            x, g_i, g_j = evaluate_coordinate(coordinates, kin, table.coordinate[e, t], angle)
            residual += factor * x
            if gradients:
                a = table.entry[e, t, 0]
                b = table.entry[e, t, 1]
                for c in range(3):
                    J[a, 0, c] += factor * g_i[0][c]
                    J[a, 0, 3 + c] += factor * g_i[1][c]
                    J[b, 0, c] += factor * g_j[0][c]
                    J[b, 0, 3 + c] += factor * g_j[1][c]
        phi[table.row[e]] = residual


@kernel(borrow=True)
def add_coupler_hessians(table, coordinates, kin, lam, Kq, Kv):
    """Add the geometric stiffness d(A^T lam)/dq of all couplers to Kq; Kv is left alone."""
    Kq = sixes(Kq)
    for e in range(table.row.shape[0]):
        for t in range(table.terms[e]):
            add_coordinate_hessian(coordinates, kin, table.coordinate[e, t], lam[table.row[e]] * table.factor[e, t], Kq)


COUPLERS = ConstraintKind(
    name='couplers',
    spec=CouplerSpec,
    compile=compile_couplers,
    residuals=evaluate_couplers,
    hessians=add_coupler_hessians,
    on_coordinates=True,
)
