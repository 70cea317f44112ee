"""Branch switches: a mechanism enters a singular position on one branch of motion and leaves it on another one.

The free velocities are those that the constraints allow. At a regular position they form a space that turns smoothly
with the motion. At a singular position more velocities are free, and two branches of motion may cross. Along each
branch the space of free velocities turns smoothly, but the spaces of the two branches stand at an angle to each other.
So a switch shows as a jump of this space across the position where the constraints are weakest: it turns by more than
its turning just before and after explains. A motion that comes to rest and returns does not turn the space, and is no
switch.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from solver.model.state import fitting
from solver.output.dependence import RANK_TOLERANCE

# Turn of the free velocities across the weakest position, as a multiple of their turn over as many steps beside it,
# that is no switch. With ten times as much, switches during a fast motion would be missed.
EXPLAINED = 3.0
# Turn [rad] that is no switch, whatever the turn beside it. Ten times as much would miss branches that cross at 1 rad.
LEAST = 0.1


class BranchSwitch(NamedTuple):
    """Time [s] of the step nearest to the singular position, and the turn of the free velocities across it [rad]."""

    t: float
    turn: float


class _Look(NamedTuple):
    """The constraints at one step."""

    t: float  # [s]
    weakest: float  # smallest singular value of the scaled Jacobian that counts for its rank
    free: np.ndarray  # (n, dof) orthonormal basis of the free velocities


class BranchWatch:
    """Finds branch switches while a simulation runs: look() takes the constraints of every step. events: switches since
    reset()."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all looks and events."""
        self.events: list[BranchSwitch] = []
        self._rank = 0
        self._looks: deque[_Look] = deque(maxlen=5)

    def memory(self) -> dict[str, np.ndarray]:
        """The last looks as arrays, for a saved state: a passage that has begun is judged by the looks before it."""
        looks = self._looks
        return {
            'looks': np.array([(look.t, look.weakest) for look in looks]).reshape(-1, 2),
            'free': np.array([look.free.T for look in looks]) if looks else np.zeros((0, 0, 0)),  # (looks, dof, n)
        }

    def recall(self, memory: dict[str, np.ndarray], events: list[BranchSwitch]) -> None:
        """Inverse of memory(). events: switches found until then. A state without looks comes from a run that was not
        watched; looking then begins anew. Raises SpecError for arrays whose shapes do not fit.
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
        if rank > self._rank:  # the looks until now were in a singular position, where the rank is lower
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
    """Turn [rad] of the free velocities between `before` and `after` where it is a switch, else 0.

    The arguments are scaled Jacobians (nc, n) at four instants at equal distances. The turn is a switch where the turns
    from `first` to `before` and from `after` to `last` do not explain it.
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
    """Branch switches in a saved state: those of the run until it was saved. Raises SpecError for an array of another
    shape."""
    found = saved.get('switches')
    return [
        BranchSwitch(*row)
        for row in fitting('switches', found, np.zeros((0 if found is None else found.size // 2, 2))).tolist()
    ]
