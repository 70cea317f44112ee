"""Operations on 6x6 blocks as vector code: products, substitution, inversion, and the sums that fill a step matrix.

A block is stored in six rows of WIDTH numbers, one SIMD vector each, the last two zero. numba has no type for such a
vector, so these are intrinsics that emit it.
"""

from __future__ import annotations

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from solver.compiled.by_reference import FieldType

WIDTH = 8  # columns of a stored block row: six entries and padding, one SIMD vector


def _row_pointer(context, builder, array_type, array, slot, row):
    """Pointer to row `row` of block `slot` as a vector of WIDTH doubles."""
    data = context.make_array(array_type)(context, builder, array).data
    word = ir.IntType(64)
    offset = builder.add(builder.mul(slot, ir.Constant(word, 6 * WIDTH)), builder.mul(row, ir.Constant(word, WIDTH)))
    return builder.bitcast(builder.gep(data, [offset]), ir.PointerType(ir.VectorType(ir.DoubleType(), WIDTH)))


def _vector_pointer(context, builder, array_type, array, offset):
    """Pointer to WIDTH numbers of an array from `offset` on."""
    data = builder.gep(context.make_array(array_type)(context, builder, array).data, [offset])
    return builder.bitcast(data, ir.PointerType(ir.VectorType(ir.DoubleType(), WIDTH)))


def _six(context, builder, array_type, array, block, row):
    """Row `row` of a block of an (n, 6, 6) array, followed by two zeros."""
    word, lane = ir.IntType(64), ir.IntType(32)
    six = ir.VectorType(ir.DoubleType(), 6)
    offset = builder.add(builder.mul(block, ir.Constant(word, 36)), ir.Constant(word, 6 * row))
    data = builder.gep(context.make_array(array_type)(context, builder, array).data, [offset])
    numbers = builder.load(builder.bitcast(data, ir.PointerType(six)), align=8)
    return builder.shuffle_vector(
        numbers, ir.Constant(six, None), ir.Constant(ir.VectorType(lane, WIDTH), list(range(WIDTH)))
    )


def _spread(builder, number):
    """A vector of copies of a number."""
    vector = ir.VectorType(ir.DoubleType(), WIDTH)
    return _splat(
        builder, builder.insert_element(ir.Constant(vector, ir.Undefined), number, ir.Constant(ir.IntType(32), 0)), 0
    )


def _fma(builder, vector):
    """LLVM's fused multiply-add of vectors of WIDTH doubles."""
    return cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(vector, [vector] * 3), f'llvm.fma.v{WIDTH}f64'
    )


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
    """Intrinsic: sign = -1 for B[c] -= B[a] B[d], +1 for B[c] = B[a] B[d] (c may equal a). B is (n, 6, WIDTH)
    float64."""

    @intrinsic
    def operation(typing_context, B, c, a, d):
        if isinstance(B, FieldType):
            return B.operation('subtract_product' if sign < 0 else 'multiply', B, c, a, d)

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


subtract_product = _block_operation(-1)
multiply = _block_operation(1)


def _sums(builder, rows):
    """The sums over the lanes of six vectors, as one vector padded with zeros."""
    zero = ir.Constant(rows[0].type, None)

    def pairs(a, b, first, second):
        select = lambda lanes: builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), lanes))  # noqa: E731
        return builder.fadd(select(first), select(second))

    one, two, four = [0, 8, 2, 10, 4, 12, 6, 14], [0, 1, 8, 9, 4, 5, 12, 13], [0, 1, 2, 3, 8, 9, 10, 11]
    r = [pairs(rows[i], rows[i + 1], one, [k + 1 for k in one]) for i in (0, 2, 4)]
    left = pairs(r[0], r[1], two, [k + 2 for k in two])
    right = pairs(r[2], zero, two, [k + 2 for k in two])
    return pairs(left, right, four, [k + 4 for k in four])


def _substitution(with_diagonal):
    """Intrinsic: x[p] -= sum over a in first..last of B[slot[a]] x[node[a]], then x[p] = B[d] x[p] when
    `with_diagonal`."""

    @intrinsic
    def substitution(typing_context, B, slot, node, first, last, x, p, d):
        if isinstance(B, FieldType):
            name = 'backward' if with_diagonal else 'forward'
            return B.operation(name, B, slot, node, first, last, x, p, d)

        def generate(context, builder, signature, args):
            types_, word = signature.args, ir.IntType(64)
            B_, _, _, first_, last_, x_, p_, d_ = args
            vector = ir.VectorType(ir.DoubleType(), WIDTH)
            fma = _fma(builder, vector)

            def entry(position, at):  # of an index array
                return builder.load(
                    builder.gep(context.make_array(types_[position])(context, builder, args[position]).data, [at])
                )

            def unknown(n):
                return _vector_pointer(context, builder, types_[5], x_, builder.mul(n, ir.Constant(word, WIDTH)))

            def row(s, i):
                return _load_row(builder, _row_pointer(context, builder, types_[0], B_, s, ir.Constant(word, i)))

            sums = [cgutils.alloca_once_value(builder, ir.Constant(vector, None)) for _ in range(6)]
            with cgutils.for_range_slice(builder, first_, last_, ir.Constant(word, 1), word) as (a, _):
                s, y = entry(1, a), _load_row(builder, unknown(entry(2, a)))
                for i in range(6):
                    builder.store(builder.call(fma, [row(s, i), y, builder.load(sums[i])]), sums[i])
            target = unknown(p_)
            y = builder.fsub(_load_row(builder, target), _sums(builder, [builder.load(one) for one in sums]))
            if with_diagonal:
                y = _sums(builder, [builder.fmul(row(d_, i), y) for i in range(6)])
            builder.store(y, target, align=8)
            return context.get_dummy_value()

        integer = types.int64
        return types.none(B, slot, node, integer, integer, x, integer, integer), generate

    return substitution


forward = _substitution(False)
backward = _substitution(True)


@intrinsic
def add_weighted_product(typing_context, B, s, X, a, Y, b, W, first):
    """B[s] += sum over the six rows r of W[first + r] X[a, r]^T Y[b, r]; X is (n, 6, 6), B and Y are (n, 6, WIDTH)."""
    if isinstance(B, FieldType):
        return B.operation('add_weighted_product', B, s, X, a, Y, b, W, first)

    def generate(context, builder, signature, args):
        kinds, word, double = signature.args, ir.IntType(64), ir.DoubleType()
        B_, s_, X_, a_, Y_, b_, W_, first_ = args
        vector = ir.VectorType(double, WIDTH)
        fma = _fma(builder, vector)

        weights = context.make_array(kinds[6])(context, builder, W_).data
        left = builder.gep(
            context.make_array(kinds[2])(context, builder, X_).data, [builder.mul(a_, ir.Constant(word, 36))]
        )
        targets = [_row_pointer(context, builder, kinds[0], B_, s_, ir.Constant(word, i)) for i in range(6)]
        rows = [_load_row(builder, target) for target in targets]
        for r in range(6):
            weight = builder.load(builder.gep(weights, [builder.add(first_, ir.Constant(word, r))]))
            row = _load_row(builder, _row_pointer(context, builder, kinds[4], Y_, b_, ir.Constant(word, r)))
            right = builder.fmul(_spread(builder, weight), row)
            for i in range(6):
                factor = builder.load(builder.gep(left, [ir.Constant(word, 6 * r + i)]))
                rows[i] = builder.call(fma, [_spread(builder, factor), right, rows[i]])
        for target, row in zip(targets, rows, strict=True):
            builder.store(row, target, align=8)
        return context.get_dummy_value()

    integer = types.int64
    return types.none(B, integer, X, integer, Y, integer, W, integer), generate


def _rotated(with_damping):
    """Intrinsic: C[s] = q X[t] diag(1, T[n]) for 6x6 blocks X[t], plus v Y[t] when `with_damping`.

    C is (n, 6, WIDTH), its padding becomes zero; X and Y are (n, 6, 6), T (n, 3, 3).
    """

    @intrinsic
    def rotated(typing_context, C, s, X, t, T, n, q, Y, v):
        if isinstance(C, FieldType):
            return C.operation('combined_block' if with_damping else 'rotated_block', C, s, X, t, T, n, q, Y, v)

        def generate(context, builder, signature, args):
            kinds, word, lane = signature.args, ir.IntType(64), ir.IntType(32)
            C_, s_, X_, t_, T_, n_, q_, Y_, v_ = args
            vector = ir.VectorType(ir.DoubleType(), WIDTH)
            fma = _fma(builder, vector)
            turn = builder.gep(
                context.make_array(kinds[4])(context, builder, T_).data, [builder.mul(n_, ir.Constant(word, 9))]
            )
            turned = []
            for i in range(3):
                columns = ir.Constant(vector, None)
                for j in range(3):
                    number = builder.load(builder.gep(turn, [ir.Constant(word, 3 * i + j)]))
                    columns = builder.insert_element(columns, number, ir.Constant(lane, 3 + j))
                turned.append(columns)
            linear = ir.Constant(ir.VectorType(lane, WIDTH), [0, 1, 2, 8, 9, 10, 11, 12])
            for i in range(6):
                numbers = _six(context, builder, kinds[2], X_, t_, i)
                out = builder.shuffle_vector(numbers, ir.Constant(vector, None), linear)
                for j in range(3):
                    out = builder.call(fma, [_splat(builder, numbers, 3 + j), turned[j], out])
                out = builder.fmul(_spread(builder, q_), out)
                if with_damping:
                    out = builder.call(fma, [_spread(builder, v_), _six(context, builder, kinds[7], Y_, t_, i), out])
                builder.store(out, _row_pointer(context, builder, kinds[0], C_, s_, ir.Constant(word, i)), align=8)
            return context.get_dummy_value()

        integer, real = types.int64, types.float64
        return types.none(C, integer, X, integer, T, integer, real, Y, real), generate

    return rotated


rotated_block = _rotated(False)
combined_block = _rotated(True)


@intrinsic
def add_scaled_rows(typing_context, f, b, sign, weights, first, count, J, e):
    """f[b] += sign * sum over r below count of weights[first + r] J[e, r]; f is (n, 6), J (m, 6, 6)."""
    if isinstance(f, FieldType):
        return f.operation('add_scaled_rows', f, b, sign, weights, first, count, J, e)

    def generate(context, builder, signature, args):
        kinds, word = signature.args, ir.IntType(64)
        f_, b_, sign_, weights_, first_, count_, J_, e_ = args
        six = ir.VectorType(ir.DoubleType(), 6)
        fma = cgutils.get_or_insert_function(builder.module, ir.FunctionType(six, [six] * 3), 'llvm.fma.v6f64')

        def numbers(kind, array, offset):
            data = builder.gep(context.make_array(kind)(context, builder, array).data, [offset])
            return builder.bitcast(data, ir.PointerType(six))

        target = numbers(kinds[0], f_, builder.mul(b_, ir.Constant(word, 6)))
        base = builder.mul(e_, ir.Constant(word, 36))
        weight = context.make_array(kinds[3])(context, builder, weights_).data
        undefined, lanes = ir.Constant(six, ir.Undefined), ir.Constant(ir.VectorType(ir.IntType(32), 6), [0] * 6)
        total = cgutils.alloca_once_value(builder, builder.load(target, align=8))
        with cgutils.for_range(builder, count_, intp=word) as loop:
            factor = builder.fmul(sign_, builder.load(builder.gep(weight, [builder.add(first_, loop.index)])))
            factors = builder.shuffle_vector(
                builder.insert_element(undefined, factor, ir.Constant(ir.IntType(32), 0)), undefined, lanes
            )
            row = numbers(kinds[6], J_, builder.add(base, builder.mul(loop.index, ir.Constant(word, 6))))
            builder.store(builder.call(fma, [factors, builder.load(row, align=8), builder.load(total)]), total)
        builder.store(builder.load(total), target, align=8)
        return context.get_dummy_value()

    integer = types.int64
    return types.none(f, integer, types.float64, weights, integer, integer, J, integer), generate


@intrinsic
def subtract_weighted_rows(typing_context, x, b, J, e, t, first):
    """x[b] -= sum over the six rows r of t[first + r] J[e, r]; x is (n, WIDTH), J (m, 6, 6), t goes on for six more
    numbers."""
    if isinstance(x, FieldType):
        return x.operation('subtract_weighted_rows', x, b, J, e, t, first)

    def generate(context, builder, signature, args):
        kinds, word = signature.args, ir.IntType(64)
        x_, b_, J_, e_, t_, first_ = args
        vector = ir.VectorType(ir.DoubleType(), WIDTH)
        target = _vector_pointer(context, builder, kinds[0], x_, builder.mul(b_, ir.Constant(word, WIDTH)))
        weights = builder.gep(context.make_array(kinds[4])(context, builder, t_).data, [first_])
        out = _load_row(builder, target)
        for r in range(6):
            weight = builder.fneg(builder.load(builder.gep(weights, [ir.Constant(word, r)])))
            out = builder.call(
                _fma(builder, vector), [_spread(builder, weight), _six(context, builder, kinds[2], J_, e_, r), out]
            )
        builder.store(out, target, align=8)
        return context.get_dummy_value()

    return types.none(x, types.int64, J, types.int64, t, types.int64), generate


@intrinsic
def add_row_products(typing_context, t, first, J, e, x, b):
    """t[first + r] += J[e, r] . x[b] for six rows r; J is (m, 6, WIDTH), x (n, WIDTH), t goes on for eight more
    numbers."""
    if isinstance(t, FieldType):
        return t.operation('add_row_products', t, first, J, e, x, b)

    def generate(context, builder, signature, args):
        kinds, word = signature.args, ir.IntType(64)
        t_, first_, J_, e_, x_, b_ = args
        y = _load_row(
            builder, _vector_pointer(context, builder, kinds[4], x_, builder.mul(b_, ir.Constant(word, WIDTH)))
        )
        rows = [
            _load_row(builder, _row_pointer(context, builder, kinds[2], J_, e_, ir.Constant(word, r))) for r in range(6)
        ]
        target = _vector_pointer(context, builder, kinds[0], t_, first_)
        products = _sums(builder, [builder.fmul(row, y) for row in rows])
        builder.store(builder.fadd(_load_row(builder, target), products), target, align=8)
        return context.get_dummy_value()

    return types.none(t, types.int64, J, types.int64, x, types.int64), generate


@intrinsic
def invert(typing_context, B, s):
    """B[s] = inverse of B[s] in place, by Gauss-Jordan elimination in registers; returns the smallest |pivot /
    diagonal|.

    No pivoting: the diagonal blocks that reach it are M plus stiffness plus penalties, or A S^-1 A^T plus a
    regularisation, whose symmetric parts are positive; a ratio near round-off says where that fails. NaN where a pivot
    is zero.
    """
    if isinstance(B, FieldType):
        return B.operation('invert', B, s)

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
