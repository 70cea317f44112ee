"""What the other wheel of an axle does to a wheel of a loaded vehicle, measured where it stands.

The polynomials that stand for it (solver.elements.guide) are fitted about the design position. A vehicle that stands deep in its springs
leans about another one, where rubber carries other loads and stops begin to act: a twist beam that leans on a bump rubber steers less.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from solver.elements.guide_map import BESIDE
from solver.errors import ConsistencyError
from solver.levels.bench import Bench, Stand

USUAL = 0.25, 1.75  # of the load at rest: what bends do to wheels, without the stops; what a polynomial stands for is fitted there
LEANT = 0.031  # m, of a wheel off where it stands


class Beside(NamedTuple):
    """Of a wheel, in rows: what the coefficients are the factors of (terms), and by how much its place (5,) is another one than with the
    other wheel in its design position."""

    terms: np.ndarray
    change: np.ndarray


NOTHING = (Beside(np.zeros((0, BESIDE - 1)), np.zeros((0, 5))),) * 2


def terms(own: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(n, 6) of a map what b_0 ... b_5 are the factors of (solver.elements.guide), at own travels and those of the other wheel."""
    s, o = own, other
    return np.column_stack([o, o * s, o * o, o * s * s, o * s * o, o * o * o])


def where_it_stands(
    bench: Bench, fine: np.ndarray, alone: Mapping[str, Sequence[Stand]], corners: Sequence[str], at: float | None
) -> tuple[Beside, ...]:
    """By wheel of an axle, about the travel `at` at which it stands (None: near the design position, nothing to add); alone: by corner the
    bench at the travels `fine` of that wheel, the other one at 0. One wheel moves, or both do in opposite directions."""
    if at is None:
        return NOTHING
    middle, step = int(np.argmin(np.abs(fine - at))), float(fine[1] - fine[0])
    reach = min(int(LEANT * bench.size.length / step), middle, len(fine) - 1 - middle)
    moves = [(k, other) for k in range(-reach, reach + 1) if k for other in (-k, 0)] + [(0, k) for k in range(-reach, reach + 1) if k]

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
        if all(USUAL[0] * rest[c] <= s.load[c] <= USUAL[1] * rest[c] for c in corners):
            for k, corner in enumerate(corners):
                change = s.x[corner] - alone[corner][nodes[k]].x[corner]
                found[k].append((float(fine[nodes[k]]), float(fine[nodes[1 - k]]), change))
    return tuple(_beside(rows) for rows in found)


def _beside(rows: Sequence[tuple[float, float, np.ndarray]]) -> Beside:
    own, other = (np.array([row[k] for row in rows], float) for k in (0, 1))
    return Beside(terms(own, other), np.array([change for _, _, change in rows], float).reshape(-1, 5))
