"""Branch switches: a mechanism that passes a singular position and leaves it along another branch of motion than it came in on.

At a regular position the velocities that the constraints allow form a space that turns smoothly with the motion. At a singular
position more velocities are possible; where two branches cross there, each continues its own space smoothly, and the space of the
other stands at an angle to it. So a switch is a turn of the space of free velocities, across the position where the constraints are
weakest, that its turning before and after does not explain. A motion that only comes to rest and returns does not turn its space.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from solver.model.state import fitting
from solver.output.dependence import RANK_TOLERANCE

EXPLAINED = 3.0  # times the turn over as many steps beside the weakest position may be the turn across it
LEAST = 0.1  # rad; a smaller turn is no other branch


class BranchSwitch(NamedTuple):
    """Time [s] of the step nearest to the singular position, and the turn of the free velocities across it [rad]."""

    t: float
    turn: float


class _Look(NamedTuple):
    t: float
    weakest: float  # smallest singular value that belongs to the rank
    free: np.ndarray  # (n, dof) orthonormal


class BranchWatch:
    """Finds branch switches from one look per step at the constraints. events: those found since reset()."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.events: list[BranchSwitch] = []
        self._rank = 0
        self._looks: deque[_Look] = deque(maxlen=5)

    def memory(self) -> dict[str, np.ndarray]:
        """The last looks, as arrays: a passage that has begun is judged by those before it."""
        looks = self._looks
        return {
            'looks': np.array([(look.t, look.weakest) for look in looks]).reshape(-1, 2),
            'free': np.array([look.free.T for look in looks]) if looks else np.zeros((0, 0, 0)),  # (looks, dof, n)
        }

    def recall(self, memory: dict[str, np.ndarray], events: list[BranchSwitch]) -> None:
        """Inverse of memory(), with what was found until then. Looking begins anew from a state that has no looks,
        because its run was not watched. Raises SpecError.
        """
        looks, free = memory.get('looks', np.zeros((0, 2))), memory.get('free', np.zeros((0, 0, 0)))
        fitting('looks', looks, np.zeros((looks.size // 2, 2)))
        fitting('free', free, np.zeros((len(looks), *free.shape[1:3])))
        self.reset()
        self.events += events
        self._rank = free.shape[2] - free.shape[1]
        self._looks.extend(_Look(t, weakest, rows.T) for (t, weakest), rows in zip(looks.tolist(), free, strict=True))

    def look(self, t: float, A: np.ndarray) -> None:
        """Take the scaled Jacobian A (nc, n) (solver.output.energy.scaled_jacobian) at time t [s] into account."""
        if not len(A):
            return
        _, size, right = np.linalg.svd(A)
        rank = int((size > RANK_TOLERANCE * size[0]).sum())
        if rank > self._rank:  # until now the mechanism stood in a singular position
            self._looks.clear()
            self._rank = rank
        self._looks.append(_Look(t, float(size[self._rank - 1]), right[self._rank :].T))
        if len(self._looks) < 5:
            return
        first, before, middle, after, last = self._looks
        if not (before.weakest > middle.weakest <= after.weakest):
            return
        turn = angle(before.free, after.free)
        if turn > EXPLAINED * (angle(first.free, before.free) + angle(after.free, last.free)) + LEAST:
            self.events.append(BranchSwitch(middle.t, turn))


def unexplained_turn(first: np.ndarray, before: np.ndarray, after: np.ndarray, last: np.ndarray) -> float:
    """Turn [rad] of the space of free velocities between `before` and `after` if what it turns beside them does not explain it, else 0.

    Scaled Jacobians (nc, n) at four instants, the same time apart.
    """
    if not len(first):
        return 0.0
    parts = [np.linalg.svd(A)[1:] for A in (first, before, after, last)]
    rank = max(int((size > RANK_TOLERANCE * size[0]).sum()) for size, _ in parts)
    free = [right[rank:].T for _, right in parts]
    turn = angle(free[1], free[2])
    return turn if turn > EXPLAINED * (angle(free[0], free[1]) + angle(free[2], free[3])) + LEAST else 0.0


def angle(N: np.ndarray, M: np.ndarray) -> float:
    """Largest principal angle [rad] between the spaces spanned by the orthonormal columns of N and M (n, dof)."""
    if not N.shape[1]:
        return 0.0
    return float(np.arccos(np.clip(np.linalg.svd(N.T @ M, compute_uv=False).min(), 0.0, 1.0)))


def switches_before(saved: Mapping[str, np.ndarray]) -> list[BranchSwitch]:
    """Branch switches of the run that saved a state. Raises SpecError."""
    found = saved.get('switches')
    return [BranchSwitch(*row) for row in fitting('switches', found, np.zeros((0 if found is None else found.size // 2, 2))).tolist()]
