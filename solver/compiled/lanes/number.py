"""A number, and a truth value, of every lane: types, arithmetic, comparisons and choices."""

from __future__ import annotations

import operator
from pathlib import Path
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.imputils import lower_builtin, lower_cast, lower_getattr
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AbstractTemplate, AttributeTemplate, infer_global, signature
from numba.extending import infer_getattr, intrinsic, models, overload, register_model

from solver import disk
from solver.compiled.by_reference import Field, FieldType
from solver.compiled.lanes import LANES
from solver.compiled.lanes.agreement import agreed, agreed_number, spread
from solver.compiled.memory import zeros
from solver.compiled.select import some, where

DOUBLE, WORD = ir.DoubleType(), ir.IntType(64)
VECTOR = ir.VectorType(DOUBLE, LANES)
TRUTHS = ir.VectorType(ir.IntType(1), LANES)
ALIGN = 8 * LANES  # bytes
# The names of the types carry what these files hold: the cache of kernels knows types by their names
DIGEST = disk.digest(*(disk.syntax(p.read_bytes()) for p in sorted(Path(__file__).parent.glob('*.py')))).hex()[:12]


class LaneType(FieldType):
    """A float64 of every lane."""

    words, of_lanes = 1, True

    def __init__(self) -> None:
        super().__init__(name=f'Lane({LANES}, {DIGEST})')

    def can_convert_from(self, typingctx, other):
        return Conversion.safe if isinstance(other, types.Float | types.Integer) else None

    def unify(self, typingctx, other):
        return self if isinstance(other, types.Float | types.Integer) else None

    def load(self, context, builder, load):
        """The numbers behind the address that a Ref holds; they never change while compiled code runs."""
        loaded = builder.load(builder.inttoptr(load(0), ir.PointerType(VECTOR)), align=ALIGN)
        loaded.set_metadata('invariant.load', builder.module.add_metadata([]))
        return loaded


class MaskType(types.Type):
    """A truth value of every lane."""

    of_lanes = True

    def __init__(self) -> None:
        super().__init__(name=f'LaneMask({LANES}, {DIGEST})')

    def can_convert_from(self, typingctx, other):
        return Conversion.safe if isinstance(other, types.Boolean) else None

    def unify(self, typingctx, other):
        return self if isinstance(other, types.Boolean) else None


LANE, MASK = LaneType(), MaskType()


class Lane(Field):
    """A number of every lane that a Ref holds: parameters. numbers: (LANES,)."""

    def __init__(self, numbers: Any) -> None:
        self.numbers = zeros(LANES)
        self.numbers[:] = numbers
        self.kind, self.words = LANE, [self.numbers.ctypes.data]


@register_model(LaneType)
class _LaneModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type) -> None:
        super().__init__(dmm, fe_type, VECTOR)


@register_model(MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type) -> None:
        super().__init__(dmm, fe_type, TRUTHS)


@lower_cast(types.Float, LaneType)
@lower_cast(types.Integer, LaneType)
def _number_as_lane(context, builder, fromty, toty, value):
    return spread(builder, context.cast(builder, value, fromty, types.float64))


@lower_cast(types.Boolean, MaskType)
def _truth_as_mask(context, builder, fromty, toty, value):
    return spread(builder, context.cast(builder, value, fromty, types.boolean))


def is_lane(kind: types.Type) -> bool:
    return isinstance(kind, LaneType)


def is_number(kind: types.Type) -> bool:
    """True for a number of lanes, and for one that all of them have in common."""
    return isinstance(kind, types.Float | types.Integer | LaneType)


def _template(operation, result, kinds=is_number):
    """Teach numba the type of an operation on at least one number of lanes."""

    @infer_global(operation)
    class Template(AbstractTemplate):
        def generic(self, args, kws):
            if any(map(is_lane, args)) and all(map(kinds, args)):
                return signature(result, *[LANE] * len(args))
            return None


def _operation(operations, emit):
    for operation in operations:
        _template(operation, LANE)

        @lower_builtin(operation, LaneType, LaneType)
        def _lowered(context, builder, sig, args):
            return emit(builder, *args)


_operation((operator.add, operator.iadd), lambda b, x, y: b.fadd(x, y))
_operation((operator.sub, operator.isub), lambda b, x, y: b.fsub(x, y))
_operation((operator.mul, operator.imul), lambda b, x, y: b.fmul(x, y))
_operation((operator.truediv, operator.itruediv), lambda b, x, y: b.fdiv(x, y))
_template(operator.neg, LANE)
_template(operator.pos, LANE)


@lower_builtin(operator.neg, LaneType)
def _neg(context, builder, sig, args):
    return builder.fneg(args[0])


@lower_builtin(operator.pos, LaneType)
def _pos(context, builder, sig, args):
    return args[0]


def _comparison(operation, sign):
    _template(operation, MASK)

    @lower_builtin(operation, LaneType, LaneType)
    def _lowered(context, builder, sig, args):
        # as numba compares float64: unlike is true of what is no number
        compare = builder.fcmp_unordered if sign == '!=' else builder.fcmp_ordered
        return compare(sign, *args)


for _op, _sign in ((operator.lt, '<'), (operator.le, '<='), (operator.gt, '>'), (operator.ge, '>='),
                   (operator.eq, '=='), (operator.ne, '!=')):  # fmt: skip
    _comparison(_op, _sign)


# -- truth ------------------------------------------------------------------------------------------------------------


@infer_global(bool)
class _Bool(AbstractTemplate):
    def generic(self, args, kws):
        return signature(types.boolean, MASK) if args == (MASK,) else None


@infer_global(operator.truth)
class _Truth(AbstractTemplate):
    def generic(self, args, kws):
        return signature(types.boolean, MASK) if args == (MASK,) else None


@lower_builtin(bool, MaskType)
@lower_builtin(operator.truth, MaskType)
def _bool(context, builder, sig, args):
    return agreed(builder, args[0])


@lower_cast(MaskType, types.Boolean)
def _mask_as_truth(context, builder, fromty, toty, value):
    return agreed(builder, value)


def _of_truths(operation, count, emit):
    @infer_global(operation)
    class Template(AbstractTemplate):
        def generic(self, args, kws):
            truths = all(isinstance(a, MaskType | types.Boolean) for a in args)
            return signature(MASK, *[MASK] * count) if truths and MASK in args and len(args) == count else None

    @lower_builtin(operation, *[MaskType] * count)
    def _lowered(context, builder, sig, args):
        return emit(builder, *args)


_of_truths(operator.and_, 2, lambda b, x, y: b.and_(x, y))
_of_truths(operator.or_, 2, lambda b, x, y: b.or_(x, y))
_of_truths(operator.iand, 2, lambda b, x, y: b.and_(x, y))
_of_truths(operator.ior, 2, lambda b, x, y: b.or_(x, y))
_of_truths(operator.not_, 1, lambda b, x: b.not_(x))
_of_truths(operator.invert, 1, lambda b, x: b.not_(x))


# -- choices ----------------------------------------------------------------------------------------------------------


@intrinsic
def _selected(typingctx, condition, a, b):
    def codegen(context, builder, signature, args):
        return builder.select(*args)

    return LANE(MASK, LANE, LANE), codegen


@intrinsic
def _selected_truth(typingctx, condition, a, b):
    def codegen(context, builder, signature, args):
        return builder.select(*args)

    return MASK(MASK, MASK, MASK), codegen


@intrinsic
def _any(typingctx, condition):
    def codegen(context, builder, signature, args):
        bits = builder.bitcast(args[0], ir.IntType(LANES))
        return builder.icmp_unsigned('!=', bits, ir.Constant(bits.type, 0))

    return types.boolean(MASK), codegen


@overload(where)
def _where(condition, a, b):
    if not isinstance(condition, MaskType):
        return None
    if isinstance(a, MaskType | types.Boolean):
        return lambda condition, a, b: _selected_truth(condition, a, b)  # noqa: PLW0108
    return lambda condition, a, b: _selected(condition, a, b)  # noqa: PLW0108


@overload(some)
def _some(condition):
    return (lambda condition: _any(condition)) if isinstance(condition, MaskType) else None  # noqa: PLW0108


def _extreme(operation, sign, count):
    """min or max of so many, by the comparisons of numba: the first one stays where none is beyond it."""

    @lower_builtin(operation, *[LaneType] * count)
    def _lowered(context, builder, sig, args):
        found = args[0]
        for value in args[1:]:
            found = builder.select(builder.fcmp_ordered(sign, value, found), value, found)
        return found


for _count in range(2, 9):  # numba looks for an implementation by the number of arguments
    _extreme(max, '>', _count)
    _extreme(min, '<', _count)
_template(max, LANE)
_template(min, LANE)


# -- parts, conversions -----------------------------------------------------------------------------------------------


@infer_getattr
class _LaneAttributes(AttributeTemplate):
    key = LaneType

    def resolve_real(self, kind):
        return kind


@lower_getattr(LaneType, 'real')
def _real(context, builder, kind, value):
    return value


@intrinsic
def lane_at(typingctx, x, k):
    """The number of lane k."""

    def codegen(context, builder, signature, args):
        return builder.extract_element(args[0], builder.trunc(args[1], ir.IntType(32)))

    return types.float64(x, types.int64), codegen


@intrinsic
def with_lane(typingctx, x, k, number):
    """x with another number in lane k."""

    def codegen(context, builder, signature, args):
        return builder.insert_element(args[0], args[2], builder.trunc(args[1], ir.IntType(32)))

    return x(x, types.int64, types.float64), codegen


@infer_global(int)
class _Int(AbstractTemplate):
    def generic(self, args, kws):
        return signature(types.int64, LANE) if args == (LANE,) else None


@lower_builtin(int, LaneType)
def _int(context, builder, sig, args):
    return agreed_number(builder, builder.fptosi(args[0], ir.VectorType(WORD, LANES)))


@infer_global(float)
class _Float(AbstractTemplate):
    def generic(self, args, kws):
        return signature(LANE, LANE) if args == (LANE,) else None


@lower_builtin(float, LaneType)
def _float(context, builder, sig, args):
    return args[0]


@overload(np.isfinite)
def _isfinite(x):
    return (lambda x: x - x == 0.0) if is_lane(x) else None


def vector_function(name, count=1):
    """An intrinsic that calls LLVM's function of a vector, which has the bits of the scalar one: rounding, roots,
    signs."""

    def codegen(context, builder, signature, args):
        kind = ir.FunctionType(VECTOR, [VECTOR] * count)
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, f'llvm.{name}.v{LANES}f64'), args)

    return codegen
