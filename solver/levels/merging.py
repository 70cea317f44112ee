"""Bodies that move as one: what is joined rigidly, or by bushings stiffer than a scene can feel."""

from __future__ import annotations

import math

import numpy as np

from solver.analysis.modes import smallest_eigenvalue
from solver.compiled.portable import product
from solver.elements.marker import WORLD
from solver.levels.compliance import cross_matrix, rates
from solver.levels.draft import Draft


def merge_fixed(draft: Draft) -> None:
    """Merge what fixed joints hold together, the lighter body into the heavier one."""
    while fixed := next((joint for joint in draft.sections['joints'].values() if joint.kind == 'fixed'), None):
        merge_pair(draft, fixed.i.body, fixed.j.body)


def merge_pair(draft: Draft, a: str, b: str) -> None:
    """Merge two bodies into the one that is to stay: the world, the chassis, or the heavier one."""
    keep = [name for name in (WORLD, draft.chassis) if name in (a, b)]
    into = keep[0] if keep else max((a, b), key=lambda name: draft.bodies[name].mass)
    draft.merge(b if into == a else a, into)


# times the limit of a frequency for bodies that others hang on: their mounts are in series with what those hang in
CARRYING = 10.0
SHAFTS = ('revolute', 'cylindrical', 'constant_velocity', 'universal')


def merge_stiff(draft: Draft, frequency: float) -> None:
    """Merge bodies that are held by bushings and are faster on these than `frequency` [Hz] in every direction.

    The load of a body that carries more than shafts hangs in a row of two bushings, and its motion under a load counts,
    not its vibration: a subframe on mounts of 170 Hz makes a third of an axle's lateral compliance. There the limit is
    CARRYING times as high.
    """
    for body in list(draft.bodies):
        holders = {hold.name for hold in draft.holds(body) if hold.section == 'bushings'}
        for other in sorted({m.body for name in holders for m in _ends(draft, name) if m.body != body}):
            own = [name for name in sorted(holders) if other in {m.body for m in _ends(draft, name)}]
            limit = frequency * (1.0 if _carries_shafts(draft, body, own) else CARRYING)
            lowest = slowest(draft, body, own) if body != draft.chassis else 0.0
            if lowest >= limit:
                draft.lose(
                    f'motion of {body} on its mounts' + (f', {lowest:.0f} Hz and more' if lowest < math.inf else '')
                )
                draft.merge(body, other)
                break


def _carries_shafts(draft: Draft, body: str, mounts: list[str]) -> bool:
    """True where nothing but shafts turns in a body on these mounts."""
    rest = [hold for hold in draft.holds(body) if hold.section != 'coordinates' and hold.name not in mounts]
    return all(hold.section == 'joints' and draft.spec(hold).kind in SHAFTS for hold in rest)


def _ends(draft: Draft, name: str):
    spec = draft.sections['bushings'][name]
    return spec.i, spec.j


def slowest(draft: Draft, body: str, bushings: list[str]) -> float:
    """The lowest natural frequency [Hz] of a body on these bushings, whose other ends are held."""
    com = draft.com(body)
    K = np.zeros((6, 6))
    for name in bushings:
        spec = draft.sections['bushings'][name]
        p, R = draft.placed(spec.i)
        k = rates(spec)
        linear = product(product(R, np.diag(k[:3])), R.T)
        turning = product(product(R, np.diag(k[3:])), R.T)
        G = np.hstack([np.eye(3), -cross_matrix(p - com)])  # displacement of the point by translation and rotation
        K += product(product(G.T, linear), G)
        K[3:, 3:] += turning
    M = np.zeros((6, 6))
    M[:3, :3] = draft.bodies[body].mass * np.eye(3)
    M[3:, 3:] = draft.inertia(body)
    lowest = smallest_eigenvalue(K, M)
    return math.sqrt(max(lowest, 0.0)) / (2.0 * math.pi)
