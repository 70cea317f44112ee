"""Block-sparse LU without a runtime symbolic phase: the elimination is planned once per model.

Nodes are bodies (n x n form) or bodies and constraint groups (block form). Every block is 6x6, stored in rows of eight
(one SIMD vector); groups with fewer rows are padded by the identity. Ordering: minimum degree ([Tinney1967] scheme 2,
on the quotient graph [George1989]); in the block form a group becomes eligible only after one of its bodies, so its
pivot is the well-conditioned A S^-1 A^T instead of the tiny regularisation. Bodies without mass or inertia have no
pivot of their own and follow all of their groups.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
from solver.linear.blocks import backward, forward, invert, multiply, subtract_product


class Elimination(NamedTuple):
    """The schedule of a block LU. Slots index an array of blocks (n_blocks, 6, WIDTH)."""

    node: np.ndarray  # (n,) pivot order
    diagonal: np.ndarray  # (n,) slot of each pivot
    start: np.ndarray  # (n + 1,) neighbours of each pivot that are eliminated later
    neighbour: np.ndarray  # (m,) their nodes
    lower: np.ndarray  # (m,) slot (neighbour, pivot)
    upper: np.ndarray  # (m,) slot (pivot, neighbour)
    update_start: np.ndarray  # (n + 1,)
    update: np.ndarray  # (sum m^2,) slot (neighbour a, neighbour b), a-major
    row_start: np.ndarray  # (n + 1,) neighbours of each pivot that are eliminated earlier
    row_node: np.ndarray  # (m,) their nodes
    row_slot: np.ndarray  # (m,) slot (pivot, neighbour)
    n_blocks: np.ndarray  # (1,) with fill


def plan_elimination(
    n_nodes: int,
    slots: dict[tuple[int, int], int],
    wait_for: dict[int, set[int]] | None = None,
    follow: dict[int, set[int]] | None = None,
) -> Elimination:
    """Choose the pivot order and list all block operations.

    slots: (row, column) -> slot of the assembled blocks; the pattern is made symmetric, fill is appended after the
    largest slot. wait_for: node -> nodes of which at least one must be eliminated before it; follow: node -> nodes that
    all must.
    """
    slots = dict(slots)
    first_free = max(slots.values()) + 1 - len(slots)
    neighbours: list[set[int]] = [set() for _ in range(n_nodes)]
    for r, c in slots:
        if r != c:
            neighbours[r].add(c)
            neighbours[c].add(r)

    def slot(r: int, c: int) -> int:
        return slots.setdefault((r, c), first_free + len(slots))

    wait_for = {k: set(v) for k, v in (wait_for or {}).items()}
    follow = {k: set(v) for k, v in (follow or {}).items() if v}
    left = set(range(n_nodes))
    node, diagonal, start, neighbour, lower, upper, update_start, update = [], [], [0], [], [], [], [0], []
    # degree buckets keep the choice of the pivot cheap for long chains
    buckets: list[set[int]] = [set() for _ in range(n_nodes + 1)]
    degree = [len(s) for s in neighbours]
    for k in left:
        if k not in wait_for and k not in follow:
            buckets[degree[k]].add(k)
    lowest = 0
    while left:
        lowest = max(0, min(lowest, n_nodes))
        while lowest <= n_nodes and not buckets[lowest]:
            lowest += 1
        if lowest > n_nodes:  # only blocked groups are left (a group between two others' bodies): release them
            for k in {*wait_for, *follow}:
                if k in left:
                    buckets[degree[k]].add(k)
            wait_for, follow = {}, {}
            lowest = 0
            continue
        p = min(buckets[lowest])
        buckets[lowest].discard(p)
        left.discard(p)
        later = sorted(neighbours[p])
        node.append(p)
        diagonal.append(slot(p, p))
        for a in later:
            neighbour.append(a)
            lower.append(slot(a, p))
            upper.append(slot(p, a))
        for a in later:
            for b in later:
                update.append(slot(a, b))
        start.append(len(neighbour))
        update_start.append(len(update))
        for a in later:
            buckets[degree[a]].discard(a)
            if p in wait_for.get(a, ()):
                del wait_for[a]
            if a in follow:
                follow[a].discard(p)
                if not follow[a]:
                    del follow[a]
            neighbours[a].discard(p)
            neighbours[a].update(b for b in later if b != a)
            degree[a] = len(neighbours[a])
            if a not in wait_for and a not in follow:
                buckets[degree[a]].add(a)
                lowest = min(lowest, degree[a])
    earlier: list[list[tuple[int, int]]] = [[] for _ in range(n_nodes)]
    for k, p in enumerate(node):
        for a in range(start[k], start[k + 1]):
            earlier[neighbour[a]].append((p, lower[a]))
    row = [pair for p in node for pair in earlier[p]]
    row_start = np.cumsum([0] + [len(earlier[p]) for p in node])
    as_array = lambda values: np.array(values, np.int64)  # noqa: E731
    return Elimination(
        as_array(node), as_array(diagonal), as_array(start), as_array(neighbour), as_array(lower), as_array(upper),
        as_array(update_start), as_array(update), as_array(row_start), as_array([p for p, _ in row]),
        as_array([s for _, s in row]),
        as_array([first_free + len(slots)]),
    )  # fmt: skip


SMALLEST_PIVOT = 1e-15  # relative to the diagonal before elimination within the block


@kernel(borrow=True)
def factorize(plan, B, T):
    """Factorize the blocks B (n_blocks, 6, WIDTH) in place. T[0, 0] returns -1, or the node with a singular pivot."""
    bad = -1
    for k in range(plan.node.shape[0]):
        if not invert(B, plan.diagonal[k]) > SMALLEST_PIVOT:
            bad = plan.node[k]
            break
        first = plan.start[k]
        last = plan.start[k + 1]
        width = last - first
        for a in range(width):
            low = plan.lower[first + a]
            multiply(B, low, low, plan.diagonal[k])
            base = plan.update_start[k] + a * width
            for b in range(width):
                subtract_product(B, plan.update[base + b], low, plan.upper[first + b])
    T[0, 0] = bad


@kernel(borrow=True)
def solve(plan, B, x):
    """Solve with the factorized blocks; x (n_nodes, WIDTH) holds the right-hand side, then the solution; its padding is
    zero."""
    n = plan.node.shape[0]
    for k in range(n):
        forward(B, plan.row_slot, plan.row_node, plan.row_start[k], plan.row_start[k + 1], x, plan.node[k], 0)
    for k in range(n - 1, -1, -1):
        backward(B, plan.upper, plan.neighbour, plan.start[k], plan.start[k + 1], x, plan.node[k], plan.diagonal[k])
