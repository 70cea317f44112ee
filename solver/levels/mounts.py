"""Equal bushings side by side between two bodies: one bushing at their centre, exact for small displacements.

Translational rates and laws add up, rotational ones grow by rate times distance squared (the rate at rest, where an
axis has a law). Only bushings whose places couple no two rotations are joined, as in solver.vehicle.parts.mounting.
"""

from __future__ import annotations

import math

import numpy as np

from solver.compiled.portable import product
from solver.elements.bushing import BushingSpec
from solver.elements.laws import Law
from solver.levels.compliance import rates
from solver.levels.draft import Draft
from solver.vehicle.parts import SKEW


def joined_mounts(draft: Draft) -> None:
    """Join all bushings that are equal but for their places."""
    groups: dict[tuple, list[BushingSpec]] = {}
    for spec in draft.sections['bushings'].values():
        R = tuple(round(float(x), 9) for x in draft.placed(spec.i).R.ravel())
        groups.setdefault(
            (spec.i.body, spec.j.body, R, spec.stiffness, spec.damping, spec.laws, spec.preload), []
        ).append(spec)
    for group in groups.values():
        if len(group) > 1 and not any(group[0].preload) and not any(group[0].laws[3:]):
            _join(draft, group)


def _join(draft: Draft, group: list[BushingSpec]) -> None:
    first, n = group[0], len(group)
    R = draft.placed(first.i).R
    places = np.array([draft.placed(spec.i).p for spec in group])
    centre = np.add.reduce(places) / n
    arms = product(places - centre, R)
    k, c = rates(first), np.array(first.damping)
    squares = np.add.reduce(arms * arms)
    turning = [n * r[3:] + np.array([_about(r, squares, q) for q in range(3)]) for r in (k, c)]
    for a, b, other in ((0, 1, 2), (0, 2, 1), (1, 2, 0)):
        coupling = abs(k[other] * float(np.add.reduce(arms[:, a] * arms[:, b])))
        if coupling > SKEW * math.sqrt(turning[0][a] * turning[0][b]):
            return
    laws = tuple(
        None if law is None else Law(law.x, tuple(n * y for y in law.y), tuple(n * s for s in law.slope))
        for law in first.laws
    )
    for spec in group:
        draft.drop('bushings', spec.name)
    i, j = draft.marker(first.i.body, centre, R), draft.marker(first.j.body, centre, R)
    stiffness = (*(n * np.array(first.stiffness[:3])).tolist(), *turning[0].tolist())
    damping = (*(n * c[:3]).tolist(), *turning[1].tolist())
    draft.put('bushings', BushingSpec(name=first.name, i=i, j=j, stiffness=stiffness, damping=damping, laws=laws))
    draft.lose(f'forces and progression of {", ".join(spec.name for spec in group)} one by one')


def _about(rate: np.ndarray, squares: np.ndarray, axis: int) -> float:
    """Rate about an axis that translational rates at these arms (squares of their sums) give."""
    a, b = [q for q in range(3) if q != axis]
    return float(rate[a] * squares[b] + rate[b] * squares[a])
