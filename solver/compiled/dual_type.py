"""The compiled form of Dual (solver.compiled.dual): numba types, their layout, and the vector instructions of the chain
rule."""

from __future__ import annotations

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic, models, register_model

N = 12  # partial derivatives of the wide Dual
NARROW = 4  # and of the narrow one
LANES = 4  # float64 per vector


class DualType(types.Type):
    """The compiled form of Dual with n partial derivatives."""

    def __init__(self, n: int) -> None:
        self.chunks = tuple(f'd{k}' for k in range(n // LANES))
        super().__init__(name=f'Dual{n}')


class _PartialsType(types.Type):
    def __init__(self) -> None:
        super().__init__(name='DualPartials')


WIDE, SLIM = DualType(N), DualType(NARROW)
_PARTIALS = _PartialsType()
_VECTOR = ir.VectorType(ir.DoubleType(), LANES)
_SIX = ir.VectorType(ir.DoubleType(), N // 2)
_INDEX = ir.IntType(32)


@register_model(_PartialsType)
class _PartialsModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type) -> None:
        super().__init__(dmm, fe_type, _VECTOR)


@register_model(DualType)
class _DualModel(models.StructModel):
    def __init__(self, dmm, fe_type) -> None:
        super().__init__(dmm, fe_type, [('value', types.float64), *((name, _PARTIALS) for name in fe_type.chunks)])


def is_dual(x: types.Type) -> bool:
    return isinstance(x, DualType)


def is_wide(x: types.Type) -> bool:
    return x == WIDE


def is_real(x: types.Type) -> bool:
    return isinstance(x, types.Float | types.Integer)


def _unpacked(context, builder, kind, packed):
    """(value, [vectors of partials]) of a Dual."""
    proxy = cgutils.create_struct_proxy(kind)(context, builder, packed)
    return proxy.value, [getattr(proxy, name) for name in kind.chunks]


def _packed(context, builder, kind, value, chunks):
    result = cgutils.create_struct_proxy(kind)(context, builder)
    result.value = value
    for name, chunk in zip(kind.chunks, chunks, strict=True):
        setattr(result, name, chunk)
    return result._getvalue()


def _splat(builder, scalar):
    """The vector of which every lane is this scalar."""
    undefined = ir.Constant(_VECTOR, ir.Undefined)
    lane = builder.insert_element(undefined, scalar, ir.Constant(_INDEX, 0))
    return builder.shuffle_vector(lane, undefined, ir.Constant(ir.VectorType(_INDEX, LANES), [0] * LANES))


def _sum(builder, a, b, c):
    """a + b c, in one instruction where the processor has one: of derivatives only, values keep the bits of plain
    arithmetic."""
    kind = ir.FunctionType(_VECTOR, [_VECTOR] * 3)
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, f'llvm.fmuladd.v{LANES}f64'), [b, c, a])


def _lanes(builder, scalars):
    """The vector of these LANES scalars."""
    vector = ir.Constant(_VECTOR, ir.Undefined)
    for lane, scalar in enumerate(scalars):
        vector = builder.insert_element(vector, scalar, ir.Constant(_INDEX, lane))
    return vector


def _unit(builder, k, first):
    """The vector whose lane k - first is 1 and all others 0."""
    one, zero = ir.Constant(ir.DoubleType(), 1.0), ir.Constant(ir.DoubleType(), 0.0)
    here = [builder.icmp_signed('==', k, ir.Constant(k.type, first + lane)) for lane in range(LANES)]
    return _lanes(builder, [builder.select(condition, one, zero) for condition in here])


@intrinsic
def dual_value(typingctx, x):
    def codegen(context, builder, signature, args):
        return _unpacked(context, builder, x, args[0])[0]

    return types.float64(x), codegen


@intrinsic
def dual_chain(typingctx, value, x, dx):
    """Dual(value, dx * partials of x)."""

    def codegen(context, builder, signature, args):
        p, a = _unpacked(context, builder, x, args[1])[1], _splat(builder, args[2])
        return _packed(context, builder, x, args[0], [builder.fmul(a, c) for c in p])

    return x(types.float64, x, types.float64), codegen


@intrinsic
def dual_chain2(typingctx, value, x, dx, y, dy):
    """Dual(value, dx * partials of x + dy * partials of y)."""

    def codegen(context, builder, signature, args):
        p, a = _unpacked(context, builder, x, args[1])[1], _splat(builder, args[2])
        q, b = _unpacked(context, builder, y, args[3])[1], _splat(builder, args[4])
        chunks = [_sum(builder, builder.fmul(a, c), b, d) for c, d in zip(p, q, strict=True)]
        return _packed(context, builder, x, args[0], chunks)

    return x(types.float64, x, types.float64, y, types.float64), codegen


@intrinsic
def dual_variable(typingctx, value, k):
    def codegen(context, builder, signature, args):
        chunks = [_unit(builder, args[1], c * LANES) for c in range(len(WIDE.chunks))]
        return _packed(context, builder, WIDE, args[0], chunks)

    return WIDE(types.float64, types.int64), codegen


@intrinsic
def dual_seeded(typingctx, value, partials):
    def codegen(context, builder, signature, args):
        scalars = [builder.extract_value(args[1], k) for k in range(N)]
        chunks = [_lanes(builder, scalars[k : k + LANES]) for k in range(0, N, LANES)]
        return _packed(context, builder, WIDE, args[0], chunks)

    return WIDE(types.float64, types.UniTuple(types.float64, N)), codegen


@intrinsic
def dual_local(typingctx, value, k):
    def codegen(context, builder, signature, args):
        return _packed(context, builder, SLIM, args[0], [_unit(builder, args[1], 0)])

    return SLIM(types.float64, types.int64), codegen


@intrinsic
def dual_compose(typingctx, y, a, b, c, d):
    def codegen(context, builder, signature, args):
        value, (slopes,) = _unpacked(context, builder, SLIM, args[0])
        total = [ir.Constant(_VECTOR, [0.0] * LANES)] * len(WIDE.chunks)
        for k in range(NARROW):
            slope = _splat(builder, builder.extract_element(slopes, ir.Constant(_INDEX, k)))
            partials = _unpacked(context, builder, WIDE, args[1 + k])[1]
            total = [_sum(builder, t, slope, p) for t, p in zip(total, partials, strict=True)]
        return _packed(context, builder, WIDE, value, total)

    return WIDE(SLIM, WIDE, WIDE, WIDE, WIDE), codegen


@intrinsic
def dual_add_partials(typingctx, x, Kq, Kv, s, r):
    """Add the first six partials of a wide Dual to row r of block s of Kq, the others to that of Kv, both (n, 6, 6)."""

    def codegen(context, builder, signature, args):
        p = _unpacked(context, builder, x, args[0])[1]
        word = ir.IntType(64)
        offset = builder.add(builder.mul(args[3], ir.Constant(word, 36)), builder.mul(args[4], ir.Constant(word, 6)))
        for blocks, pair, lanes in ((1, p[:2], range(6)), (2, p[1:], range(2, 8))):
            data = context.make_array(signature.args[blocks])(context, builder, args[blocks]).data
            place = builder.bitcast(builder.gep(data, [offset]), ir.PointerType(_SIX))
            six = builder.shuffle_vector(*pair, ir.Constant(ir.VectorType(_INDEX, 6), list(lanes)))
            builder.store(builder.fadd(builder.load(place, align=8), six), place, align=8)
        return context.get_dummy_value()

    return types.none(x, Kq, Kv, types.int64, types.int64), codegen


@intrinsic
def dual_partial(typingctx, x, k):
    def codegen(context, builder, signature, args):
        chunks = _unpacked(context, builder, x, args[0])[1]
        chunk = chunks[0]
        for c in range(1, len(chunks)):
            here = builder.icmp_signed('>=', args[1], ir.Constant(args[1].type, c * LANES))
            chunk = builder.select(here, chunks[c], chunk)
        lane = builder.and_(args[1], ir.Constant(args[1].type, LANES - 1))
        return builder.extract_element(chunk, builder.trunc(lane, _INDEX))

    return types.float64(x, types.int64), codegen
