"""Block-sparse LU without a runtime symbolic phase: the elimination is planned once per model.

Nodes are bodies (n x n form) or bodies and constraint groups (block form). Every block is 6x6, stored in rows of eight (one SIMD
vector); groups with fewer rows are padded by the identity. Ordering: minimum degree (Tinney-Walker scheme 2 on the quotient
graph); in the block form a group becomes eligible only after one of its bodies, so its pivot is the well-conditioned A S^-1 A^T
instead of the tiny regularisation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from solver.jit import kernel


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
    n_blocks: np.ndarray  # (1,) with fill


def plan_elimination(n_nodes: int, slots: dict[tuple[int, int], int], wait_for: dict[int, set[int]] | None = None) -> Elimination:
    """Choose the pivot order and list all block operations.

    slots: (row, column) -> slot of the assembled blocks; the pattern is made symmetric, fill is appended after the largest slot.
    wait_for: node -> nodes of which at least one must be eliminated before it.
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
    left = set(range(n_nodes))
    node, diagonal, start, neighbour, lower, upper, update_start, update = [], [], [0], [], [], [], [0], []
    # degree buckets keep the choice of the pivot cheap for long chains
    buckets: list[set[int]] = [set() for _ in range(n_nodes + 1)]
    degree = [len(s) for s in neighbours]
    for k in left:
        if k not in wait_for:
            buckets[degree[k]].add(k)
    lowest = 0
    while left:
        lowest = max(0, min(lowest, n_nodes))
        while lowest <= n_nodes and not buckets[lowest]:
            lowest += 1
        if lowest > n_nodes:  # only blocked groups are left (a group between two others' bodies): release them
            for k in list(wait_for):
                if k in left:
                    buckets[degree[k]].add(k)
            wait_for = {}
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
            released = a in wait_for and p in wait_for[a]
            if a not in wait_for:
                buckets[degree[a]].discard(a)
            if released:
                del wait_for[a]
            neighbours[a].discard(p)
            neighbours[a].update(b for b in later if b != a)
            degree[a] = len(neighbours[a])
            if a not in wait_for:
                buckets[degree[a]].add(a)
                lowest = min(lowest, degree[a])
    as_array = lambda values: np.array(values, np.int64)  # noqa: E731
    return Elimination(
        as_array(node), as_array(diagonal), as_array(start), as_array(neighbour), as_array(lower), as_array(upper),
        as_array(update_start), as_array(update), as_array([first_free + len(slots)]),
    )  # fmt: skip


SMALLEST_PIVOT = 1e-15  # relative to the diagonal before elimination within the block
WIDTH = 8  # columns of a stored block row: six entries and padding, one SIMD vector


def _row_pointer(context, builder, array_type, array, slot, row):
    """Pointer to row `row` of block `slot` as a vector of WIDTH doubles."""
    data = context.make_array(array_type)(context, builder, array).data
    word = ir.IntType(64)
    offset = builder.add(builder.mul(slot, ir.Constant(word, 6 * WIDTH)), builder.mul(row, ir.Constant(word, WIDTH)))
    return builder.bitcast(builder.gep(data, [offset]), ir.PointerType(ir.VectorType(ir.DoubleType(), WIDTH)))


def _fma(builder, vector):
    """LLVM's fused multiply-add of vectors of WIDTH doubles."""
    return cgutils.get_or_insert_function(builder.module, ir.FunctionType(vector, [vector] * 3), f'llvm.fma.v{WIDTH}f64')


def _load_row(builder, pointer):
    return builder.load(pointer, align=8)


def _splat(builder, vector, lane):
    """A vector of copies of one lane."""
    mask = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [lane] * WIDTH)
    return builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), mask)


def _product(builder, left, right, start, sign):
    """start + sign * left * right for one row `left` and the six rows `right` of a block, with fused multiply-add."""
    fma = _fma(builder, left.type)
    for k in range(6):
        factor = _splat(builder, left, k)
        factor = builder.fneg(factor) if sign < 0 else factor
        start = builder.fmul(factor, right[k]) if start is None else builder.call(fma, [factor, right[k], start])
    return start


def _block_operation(sign):
    """Intrinsic: sign = -1 for B[c] -= B[a] B[d], +1 for B[c] = B[a] B[d] (c may equal a). B is (n, 6, WIDTH) float64."""

    @intrinsic
    def operation(typing_context, B, c, a, d):
        def generate(context, builder, signature, args):
            word = ir.IntType(64)

            def pointer(slot, row):
                return _row_pointer(context, builder, signature.args[0], args[0], slot, ir.Constant(word, row))

            right = [_load_row(builder, pointer(args[3], k)) for k in range(6)]
            for i in range(6):
                target = pointer(args[1], i)
                start = _load_row(builder, target) if sign < 0 else None
                row = _product(builder, _load_row(builder, pointer(args[2], i)), right, start, sign)
                builder.store(row, target, align=8)
            return context.get_dummy_value()

        return types.none(B, types.int64, types.int64, types.int64), generate

    return operation


_subtract_product = _block_operation(-1)
_multiply = _block_operation(1)


@intrinsic
def axpy_row(typing_context, Y, s, i, X, t, k, m):
    """Y[s, i] += m * X[t, k] for rows of WIDTH entries."""

    def generate(context, builder, signature, args):
        Y_, s_, i_, X_, t_, k_, m_ = args
        target = _row_pointer(context, builder, signature.args[0], Y_, s_, i_)
        row = _load_row(builder, _row_pointer(context, builder, signature.args[3], X_, t_, k_))
        vector = builder.insert_element(ir.Constant(row.type, ir.Undefined), m_, ir.Constant(ir.IntType(32), 0))
        builder.store(builder.call(_fma(builder, row.type), [_splat(builder, vector, 0), row, _load_row(builder, target)]), target, align=8)
        return context.get_dummy_value()

    integer = types.int64
    return types.none(Y, integer, integer, X, integer, integer, types.float64), generate


@intrinsic
def _invert(typing_context, B, s):
    """B[s] = inverse of B[s] in place, by Gauss-Jordan elimination in registers; returns the smallest |pivot / diagonal|.

    No pivoting: the diagonal blocks that reach it are M plus stiffness plus penalties, or A S^-1 A^T plus a regularisation, whose
    symmetric parts are positive; a ratio near round-off says where that fails. NaN where a pivot is zero.
    """

    def generate(context, builder, signature, args):
        word, lane, double = ir.IntType(64), ir.IntType(32), ir.DoubleType()

        def pointer(row):
            return _row_pointer(context, builder, signature.args[0], args[0], args[1], ir.Constant(word, row))

        rows = [_load_row(builder, pointer(k)) for k in range(6)]
        fma = _fma(builder, rows[0].type)
        absolute = cgutils.get_or_insert_function(builder.module, ir.FunctionType(double, [double]), 'llvm.fabs.f64')
        diagonal = [builder.extract_element(rows[k], ir.Constant(lane, k)) for k in range(6)]
        worst = ir.Constant(double, 1.0)
        for k in range(6):
            at = ir.Constant(lane, k)
            pivot = builder.extract_element(rows[k], at)
            ratio = builder.call(absolute, [builder.fdiv(pivot, diagonal[k])])
            # unordered comparison: a NaN ratio is kept
            worst = builder.select(builder.fcmp_unordered('<', ratio, worst), ratio, worst)
            inverse = builder.fdiv(ir.Constant(double, 1.0), pivot)
            row = builder.insert_element(rows[k], ir.Constant(double, 1.0), at)
            vector = builder.insert_element(ir.Constant(row.type, ir.Undefined), inverse, ir.Constant(lane, 0))
            rows[k] = builder.fmul(row, _splat(builder, vector, 0))
            for i in range(6):
                if i != k:
                    factor = builder.fneg(_splat(builder, rows[i], k))
                    cleared = builder.insert_element(rows[i], ir.Constant(double, 0.0), at)
                    rows[i] = builder.call(fma, [factor, rows[k], cleared])
        for k in range(6):
            builder.store(rows[k], pointer(k), align=8)
        return worst

    return types.float64(B, types.int64), generate


@kernel(borrow=True)
def factorize(plan, B, T):
    """Factorize the blocks B (n_blocks, 6, WIDTH) in place. T[0, 0] returns -1, or the node with a singular pivot."""
    bad = -1
    for k in range(plan.node.shape[0]):
        if not _invert(B, plan.diagonal[k]) > SMALLEST_PIVOT:
            bad = plan.node[k]
            break
        first = plan.start[k]
        last = plan.start[k + 1]
        width = last - first
        for a in range(width):
            low = plan.lower[first + a]
            _multiply(B, low, low, plan.diagonal[k])
            base = plan.update_start[k] + a * width
            for b in range(width):
                _subtract_product(B, plan.update[base + b], low, plan.upper[first + b])
    T[0, 0] = bad


@kernel(borrow=True)
def solve(plan, B, x):
    """Solve with the factorized blocks; x (n_nodes, 6) holds the right-hand side, then the solution."""
    n = plan.node.shape[0]
    for k in range(n):
        p = plan.node[k]
        x0, x1, x2, x3, x4, x5 = x[p, 0], x[p, 1], x[p, 2], x[p, 3], x[p, 4], x[p, 5]
        for a in range(plan.start[k], plan.start[k + 1]):
            s = plan.lower[a]
            r = plan.neighbour[a]
            for i in range(6):
                x[r, i] -= B[s, i, 0] * x0 + B[s, i, 1] * x1 + B[s, i, 2] * x2 + B[s, i, 3] * x3 + B[s, i, 4] * x4 + B[s, i, 5] * x5
    for k in range(n - 1, -1, -1):
        p = plan.node[k]
        x0, x1, x2, x3, x4, x5 = x[p, 0], x[p, 1], x[p, 2], x[p, 3], x[p, 4], x[p, 5]
        for a in range(plan.start[k], plan.start[k + 1]):
            s = plan.upper[a]
            r = plan.neighbour[a]
            y0, y1, y2, y3, y4, y5 = x[r, 0], x[r, 1], x[r, 2], x[r, 3], x[r, 4], x[r, 5]
            x0 -= B[s, 0, 0] * y0 + B[s, 0, 1] * y1 + B[s, 0, 2] * y2 + B[s, 0, 3] * y3 + B[s, 0, 4] * y4 + B[s, 0, 5] * y5
            x1 -= B[s, 1, 0] * y0 + B[s, 1, 1] * y1 + B[s, 1, 2] * y2 + B[s, 1, 3] * y3 + B[s, 1, 4] * y4 + B[s, 1, 5] * y5
            x2 -= B[s, 2, 0] * y0 + B[s, 2, 1] * y1 + B[s, 2, 2] * y2 + B[s, 2, 3] * y3 + B[s, 2, 4] * y4 + B[s, 2, 5] * y5
            x3 -= B[s, 3, 0] * y0 + B[s, 3, 1] * y1 + B[s, 3, 2] * y2 + B[s, 3, 3] * y3 + B[s, 3, 4] * y4 + B[s, 3, 5] * y5
            x4 -= B[s, 4, 0] * y0 + B[s, 4, 1] * y1 + B[s, 4, 2] * y2 + B[s, 4, 3] * y3 + B[s, 4, 4] * y4 + B[s, 4, 5] * y5
            x5 -= B[s, 5, 0] * y0 + B[s, 5, 1] * y1 + B[s, 5, 2] * y2 + B[s, 5, 3] * y3 + B[s, 5, 4] * y4 + B[s, 5, 5] * y5
        d = plan.diagonal[k]
        for i in range(6):
            x[p, i] = B[d, i, 0] * x0 + B[d, i, 1] * x1 + B[d, i, 2] * x2 + B[d, i, 3] * x3 + B[d, i, 4] * x4 + B[d, i, 5] * x5
