"""Influence of the other wheel of an axle on a wheel of a loaded vehicle, measured in the loaded position.

Polynomials describe that influence (solver.elements.guide); they are fitted about the design position. A vehicle that
stands deep in its springs leans about another position, where rubber carries other loads and stops begin to act: a
twist beam that leans on a bump rubber steers less.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from solver.elements.guide_map import BESIDE
from solver.errors import ConsistencyError
from solver.levels.bench import Bench, Stand

# of the load at rest: the range of bends, without the stops; the polynomials are fitted in it
FITTED_LOADS = 0.25, 1.75
LEANT = 0.031  # m, of a wheel off where it stands


class OtherWheel(NamedTuple):
    """Influence on one wheel, a row per position of the bench: terms (n, 6) that the coefficients multiply, and change
    (n, 5) of the place of the wheel against its place with the other wheel in the design position."""

    terms: np.ndarray
    change: np.ndarray


NO_INFLUENCE = (OtherWheel(np.zeros((0, BESIDE - 1)), np.zeros((0, 5))),) * 2


def terms(own: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(n, 6) terms that b_0 ... b_5 of a map multiply (solver.elements.guide), at the travels of a wheel itself and of
    the other wheel."""
    s, o = own, other
    return np.column_stack([o, o * s, o * o, o * s * s, o * s * o, o * o * o])


def where_it_stands(
    bench: Bench, fine: np.ndarray, alone: Mapping[str, Sequence[Stand]], corners: Sequence[str], at: float | None
) -> tuple[OtherWheel, ...]:
    """Influence on each wheel of an axle, about the travel `at` of its loaded position (None: near the design position,
    no influence to add).

    alone: by corner, the bench at the travels `fine` of that wheel with the other one at 0. One wheel moves, or both do
    in opposite directions.
    """
    if at is None:
        return NO_INFLUENCE
    middle, step = int(np.argmin(np.abs(fine - at))), float(fine[1] - fine[0])
    reach = min(int(LEANT * bench.size.length / step), middle, len(fine) - 1 - middle)
    moves = [(k, other) for k in range(-reach, reach + 1) if k for other in (-k, 0)] + [
        (0, k) for k in range(-reach, reach + 1) if k
    ]

    def stand(*nodes: int) -> Stand:
        return bench.stand(**{f'travel_{corner}': float(fine[n]) for corner, n in zip(corners, nodes, strict=True)})

    rest = stand(middle, middle).load
    found: list[list[tuple[float, float, np.ndarray]]] = [[], []]
    for left, right in moves:
        nodes = middle + left, middle + right
        try:
            s = stand(*nodes)
        except ConsistencyError:  # deep in the stops
            continue
        if all(FITTED_LOADS[0] * rest[c] <= s.load[c] <= FITTED_LOADS[1] * rest[c] for c in corners):
            for k, corner in enumerate(corners):
                change = s.x[corner] - alone[corner][nodes[k]].x[corner]
                found[k].append((float(fine[nodes[k]]), float(fine[nodes[1 - k]]), change))
    return tuple(_other_wheel(rows) for rows in found)


def _other_wheel(rows: Sequence[tuple[float, float, np.ndarray]]) -> OtherWheel:
    own, other = (np.array([row[k] for row in rows], float) for k in (0, 1))
    return OtherWheel(terms(own, other), np.array([change for _, _, change in rows], float).reshape(-1, 5))
