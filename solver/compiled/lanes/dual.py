"""Dual numbers of lanes (solver.compiled.dual): a number of every lane, with its partial derivatives.

Values have the bits of plain lanes, derivatives those of the duals of a single run: the same products and sums, fused
where those are.
"""

from __future__ import annotations

import operator

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.imputils import lower_getattr
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, intrinsic, models, overload, register_model

from solver.compiled import dual
from solver.compiled.by_reference import FieldType
from solver.compiled.dual_type import NARROW, N
from solver.compiled.lanes import LANES
from solver.compiled.lanes.agreement import spread
from solver.compiled.lanes.arrays import LaneArrayType
from solver.compiled.lanes.number import ALIGN, DIGEST, DOUBLE, LANE, VECTOR, WORD, is_lane, is_number


class LaneDualType(FieldType):
    """A dual number of every lane with n partial derivatives."""

    def __init__(self, n: int) -> None:
        self.n, self.names = n, tuple(f'd{k}' for k in range(n))
        super().__init__(name=f'LaneDual{n}({LANES}, {DIGEST})')


WIDE, SLIM = LaneDualType(N), LaneDualType(NARROW)
ZERO = ir.Constant(VECTOR, [0.0] * LANES)


@register_model(LaneDualType)
class _LaneDualModel(models.StructModel):
    def __init__(self, dmm, fe_type) -> None:
        super().__init__(dmm, fe_type, [('value', LANE), *((name, LANE) for name in fe_type.names)])


def is_dual(kind: types.Type) -> bool:
    return isinstance(kind, LaneDualType)


def _unpacked(context, builder, kind, packed):
    proxy = cgutils.create_struct_proxy(kind)(context, builder, packed)
    return proxy.value, [getattr(proxy, name) for name in kind.names]


def _packed(context, builder, kind, value, partials):
    found = cgutils.create_struct_proxy(kind)(context, builder)
    found.value = value
    for name, partial in zip(kind.names, partials, strict=True):
        setattr(found, name, partial)
    return found._getvalue()


def _sum(builder, a, b, c):
    """a + b c, fused as solver.compiled.dual_type does it."""
    kind = ir.FunctionType(VECTOR, [VECTOR] * 3)
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, f'llvm.fmuladd.v{LANES}f64'), [b, c, a])


def _unit(builder, k, n):
    one, zero = (ir.Constant(DOUBLE, x) for x in (1.0, 0.0))
    same = [builder.icmp_signed('==', k, ir.Constant(k.type, c)) for c in range(n)]
    return [spread(builder, builder.select(here, one, zero)) for here in same]


@infer_getattr
class _Attributes(AttributeTemplate):
    key = LaneDualType

    def resolve_real(self, kind):
        return LANE


@lower_getattr(LaneDualType, 'real')
def _real(context, builder, kind, value):
    return _unpacked(context, builder, kind, value)[0]


@intrinsic
def _chain(typingctx, value, x, dx):
    """value, with dx times the partial derivatives of x."""

    def codegen(context, builder, signature, args):
        partials = _unpacked(context, builder, x, args[1])[1]
        return _packed(context, builder, x, args[0], [builder.fmul(args[2], p) for p in partials])

    return x(LANE, x, LANE), codegen


@intrinsic
def _chain2(typingctx, value, x, dx, y, dy):
    """value, with dx times the partial derivatives of x plus dy times those of y."""

    def codegen(context, builder, signature, args):
        p, q = _unpacked(context, builder, x, args[1])[1], _unpacked(context, builder, y, args[3])[1]
        partials = [_sum(builder, builder.fmul(args[2], c), args[4], d) for c, d in zip(p, q, strict=True)]
        return _packed(context, builder, x, args[0], partials)

    return x(LANE, x, LANE, y, LANE), codegen


@intrinsic
def _variable(typingctx, value, k):
    def codegen(context, builder, signature, args):
        return _packed(context, builder, WIDE, args[0], _unit(builder, args[1], N))

    return WIDE(LANE, types.int64), codegen


@intrinsic
def _seeded(typingctx, value, partials):
    def codegen(context, builder, signature, args):
        given = signature.args[1].types
        cast = [context.cast(builder, builder.extract_value(args[1], k), t, LANE) for k, t in enumerate(given)]
        return _packed(context, builder, WIDE, args[0], cast)

    return WIDE(LANE, partials), codegen


@intrinsic
def _local(typingctx, value, k):
    def codegen(context, builder, signature, args):
        return _packed(context, builder, SLIM, args[0], _unit(builder, args[1], NARROW))

    return SLIM(LANE, types.int64), codegen


@intrinsic
def _compose(typingctx, y, a, b, c, d):
    def codegen(context, builder, signature, args):
        value, slopes = _unpacked(context, builder, SLIM, args[0])
        total = [ZERO] * N
        for slope, argument in zip(slopes, args[1:], strict=True):
            partials = _unpacked(context, builder, WIDE, argument)[1]
            total = [_sum(builder, t, slope, p) for t, p in zip(total, partials, strict=True)]
        return _packed(context, builder, WIDE, value, total)

    return WIDE(SLIM, WIDE, WIDE, WIDE, WIDE), codegen


@intrinsic
def _add_partials(typingctx, x, Kq, Kv, s, r):
    def codegen(context, builder, signature, args):
        partials = _unpacked(context, builder, x, args[0])[1]
        offset = builder.add(builder.mul(args[3], ir.Constant(WORD, 36)), builder.mul(args[4], ir.Constant(WORD, 6)))
        for place, part in ((1, partials[: N // 2]), (2, partials[N // 2 :])):
            data = cgutils.create_struct_proxy(signature.args[place])(context, builder, args[place]).data
            row = builder.gep(builder.inttoptr(data, ir.PointerType(VECTOR)), [offset])
            for k, number in enumerate(part):
                at = builder.gep(row, [ir.Constant(WORD, k)])
                builder.store(builder.fadd(builder.load(at, align=ALIGN), number), at, align=ALIGN)
        return context.get_dummy_value()

    return types.none(x, Kq, Kv, types.int64, types.int64), codegen


@intrinsic
def _partial(typingctx, x, k):
    def codegen(context, builder, signature, args):
        partials = _unpacked(context, builder, x, args[0])[1]
        found = partials[0]
        for c, other in enumerate(partials[1:], 1):
            found = builder.select(builder.icmp_signed('==', args[1], ir.Constant(args[1].type, c)), other, found)
        return found

    return LANE(x, types.int64), codegen


@overload(dual.variable)
def _variable_overload(value, k):
    return (lambda value, k: _variable(value, k)) if is_lane(value) else None  # noqa: PLW0108


@overload(dual.seeded)
def _seeded_overload(value, partials):
    return (lambda value, partials: _seeded(value, partials)) if is_lane(value) else None  # noqa: PLW0108


@overload(dual.local)
def _local_overload(x, k):
    if x == WIDE:
        return lambda x, k: _local(x.real, k)
    return (lambda x, k: x) if is_lane(x) or x == SLIM else None


@overload(dual.compose)
def _compose_overload(y, a, b, c, d):
    if y == SLIM:
        return lambda y, a, b, c, d: _compose(y, a, b, c, d)  # noqa: PLW0108
    return (lambda y, a, b, c, d: y) if is_lane(y) else None


@overload(dual.differentiates)
def _differentiates_overload(x):
    if x == WIDE:
        return lambda x: True
    return (lambda x: False) if is_lane(x) or x == SLIM else None


@overload(dual.partial)
def _partial_overload(x, k):
    return (lambda x, k: _partial(x, k)) if is_dual(x) else None  # noqa: PLW0108


@overload(dual.add_partials)
def _add_partials_overload(x, Kq, Kv, s, r):
    if is_dual(x) and isinstance(Kq, LaneArrayType):
        return lambda x, Kq, Kv, s, r: _add_partials(x, Kq, Kv, s, r)  # noqa: PLW0108
    return None


@overload(dual.value)
def _value_overload(x):
    if is_dual(x):
        return lambda x: x.real
    return (lambda x: x) if is_lane(x) else None


@overload(operator.add)
def _add(a, b):
    if is_dual(a) and is_dual(b):
        return lambda a, b: _chain2(a.real + b.real, a, 1.0, b, 1.0)
    if is_dual(a) and is_number(b):
        return lambda a, b: _chain(a.real + b, a, 1.0)
    if is_number(a) and is_dual(b):
        return lambda a, b: _chain(a + b.real, b, 1.0)
    return None


@overload(operator.sub)
def _sub(a, b):
    if is_dual(a) and is_dual(b):
        return lambda a, b: _chain2(a.real - b.real, a, 1.0, b, -1.0)
    if is_dual(a) and is_number(b):
        return lambda a, b: _chain(a.real - b, a, 1.0)
    if is_number(a) and is_dual(b):
        return lambda a, b: _chain(a - b.real, b, -1.0)
    return None


@overload(operator.neg)
def _neg(a):
    return (lambda a: _chain(-a.real, a, -1.0)) if is_dual(a) else None


@overload(operator.mul)
def _mul(a, b):
    if is_dual(a) and is_dual(b):
        return lambda a, b: _chain2(a.real * b.real, a, b.real, b, a.real)
    if is_dual(a) and is_number(b):
        return lambda a, b: _chain(a.real * b, a, b)
    if is_number(a) and is_dual(b):
        return lambda a, b: _chain(a * b.real, b, a)
    return None


@overload(operator.truediv)
def _div(a, b):
    if is_dual(a) and is_dual(b):

        def divide(a, b):
            q = a.real / b.real
            r = 1.0 / b.real
            return _chain2(q, a, r, b, -q * r)

        return divide
    if is_dual(a) and is_number(b):
        return lambda a, b: _chain(a.real / b, a, 1.0 / b)
    if is_number(a) and is_dual(b):

        def invert(a, b):
            q = a / b.real
            return _chain(q, b, -q / b.real)

        return invert
    return None


def _function(function, rule, plain) -> None:
    @overload(function)
    def choose(x):
        if is_dual(x):

            def differentiate(x):
                f, df = rule(x.real)
                return _chain(f, x, df)

            return differentiate
        return (lambda x: plain(x)) if is_lane(x) else None  # noqa: PLW0108


for _name, _plain in (
    ('sin', np.sin), ('cos', np.cos), ('arctan', np.arctan), ('exp', np.exp), ('log', np.log), ('sqrt', np.sqrt),
):  # fmt: skip
    _function(getattr(dual, _name), getattr(dual, f'_{_name}'), _plain)
