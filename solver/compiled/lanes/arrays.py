"""Arrays with a number of every lane in each entry, the lane innermost, as kernels see arrays of float64."""

from __future__ import annotations

import operator

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.imputils import lower_builtin, lower_getattr
from numba.core.typing.templates import AbstractTemplate, AttributeTemplate, infer_global, signature
from numba.extending import infer_getattr, models, overload, register_model, typeof_impl

from solver.compiled.by_reference import Field, FieldType
from solver.compiled.lanes import LANES
from solver.compiled.lanes.agreement import spread
from solver.compiled.lanes.blocks import OPERATIONS
from solver.compiled.lanes.number import ALIGN, DIGEST, LANE, VECTOR, WORD, LaneType, is_lane, is_number
from solver.compiled.memory import zeros


class LaneArrayType(FieldType):
    """inner: lengths of all dimensions but the first, None where only the run knows one."""

    mutable = True

    def __init__(self, ndim: int, inner: tuple[int | None, ...]) -> None:
        self.ndim, self.inner, self.words = ndim, tuple(inner), 1 + ndim
        super().__init__(name=f'LaneArray({LANES}, {ndim}, {self.inner}, {DIGEST})')

    def load(self, context, builder, load):
        """The array that a Ref holds."""
        array = cgutils.create_struct_proxy(self)(context, builder)
        array.data = load(0)
        known = [None, *self.inner]
        array.shape = cgutils.pack_array(
            builder, [load(1 + k) if n is None else ir.Constant(WORD, n) for k, n in enumerate(known)], ty=WORD
        )
        return array._getvalue()

    def operation(self, name, *arguments):
        """See FieldType.operation()."""
        return _matrix_at(*arguments) if name == 'matrix_at' else OPERATIONS[name](*arguments)


class LaneArray(Field):
    """An array of lanes that a Ref holds. numbers: (..., LANES), whose memory begins with a line of the cache."""

    def __init__(self, numbers: np.ndarray) -> None:
        aligned = not numbers.size or numbers.ctypes.data % ALIGN == 0
        if not (aligned and numbers.flags.c_contiguous and numbers.shape[-1] == LANES):
            raise ValueError('an array of lanes needs contiguous memory, aligned to a vector')
        self.numbers, self.shape = numbers, numbers.shape[:-1]
        self.kind = LaneArrayType(len(self.shape), self.shape[1:])
        self.words = [numbers.ctypes.data, *self.shape]


@typeof_impl.register(LaneArray)
def _typeof_lanes(value, context):
    return value.kind


def lane_zeros(shape: int | tuple[int, ...]) -> LaneArray:
    """(shape,) numbers of every lane, all zero."""
    shape = (shape,) if isinstance(shape, int) else shape
    return LaneArray(zeros((*shape, LANES)))


@register_model(LaneArrayType)
class _LaneArrayModel(models.StructModel):
    def __init__(self, dmm, fe_type) -> None:
        super().__init__(dmm, fe_type, [('data', types.intp), ('shape', types.UniTuple(types.intp, fe_type.ndim))])


def _lengths(context, builder, kind, array):
    found = cgutils.unpack_tuple(builder, array.shape)
    return [found[k] if n is None else ir.Constant(WORD, n) for k, n in enumerate([None, *kind.inner])]


def _address(context, builder, kind, value, index):
    """(address of the entry or part at an index, shorter than the array has dimensions or not; lengths of the part)."""
    array = cgutils.create_struct_proxy(kind)(context, builder, value)
    lengths = _lengths(context, builder, kind, array)
    at = index[0]
    for k in range(1, kind.ndim):
        at = builder.mul(at, lengths[k])
        if k < len(index):
            at = builder.add(at, index[k])
    return builder.add(array.data, builder.mul(at, ir.Constant(WORD, ALIGN))), lengths[len(index) :]


def _entry(context, builder, kind, value, index):
    return builder.inttoptr(_address(context, builder, kind, value, index)[0], ir.PointerType(VECTOR))


def _indices(context, builder, kind, value):
    parts = (
        [(builder.extract_value(value, k), t) for k, t in enumerate(kind.types)]
        if isinstance(kind, types.BaseTuple)
        else [(value, kind)]
    )
    return [context.cast(builder, x, t, types.intp) for x, t in parts]


def _count(kind) -> int:
    """Number of indices; 0 of what is no index."""
    if isinstance(kind, types.Integer):
        return 1
    whole = isinstance(kind, types.BaseTuple) and all(isinstance(t, types.Integer) for t in kind.types)
    return len(kind.types) if whole else 0


@infer_global(operator.getitem)
class _GetItem(AbstractTemplate):
    def generic(self, args, kws):
        array, index = args
        if not isinstance(array, LaneArrayType) or not 0 < (n := _count(index)) <= array.ndim:
            return None
        return signature(LANE if n == array.ndim else LaneArrayType(array.ndim - n, array.inner[n:]), array, index)


@lower_builtin(operator.getitem, LaneArrayType, types.Any)
def _getitem(context, builder, sig, args):
    kind = sig.args[0]
    index = _indices(context, builder, sig.args[1], args[1])
    if len(index) == kind.ndim:
        return builder.load(_entry(context, builder, kind, args[0], index), align=ALIGN)
    part = cgutils.create_struct_proxy(sig.return_type)(context, builder)
    part.data, lengths = _address(context, builder, kind, args[0], index)
    part.shape = cgutils.pack_array(builder, lengths, ty=WORD)
    return part._getvalue()


@infer_global(operator.getitem)
class _Slice(AbstractTemplate):
    def generic(self, args, kws):
        array, part = args
        here = isinstance(array, LaneArrayType) and array.ndim == 1 and isinstance(part, types.SliceType)
        return signature(array, array, part) if here else None


@lower_builtin(operator.getitem, LaneArrayType, types.SliceType)
def _slice(context, builder, sig, args):
    """x[first:last] of a vector, both within it."""
    array = cgutils.create_struct_proxy(sig.args[0])(context, builder, args[0])
    part = context.make_helper(builder, sig.args[1], args[1])
    array.data = builder.add(array.data, builder.mul(part.start, ir.Constant(WORD, ALIGN)))
    array.shape = cgutils.pack_array(builder, [builder.sub(part.stop, part.start)], ty=WORD)
    return array._getvalue()


def _matrix_at(numbers, start, rows, columns):
    """solver.compiled.by_reference.matrix_at() of a vector of lanes."""
    matrix = LaneArrayType(2, (None,))

    def codegen(context, builder, signature, args):
        source = cgutils.create_struct_proxy(signature.args[0])(context, builder, args[0])
        found = cgutils.create_struct_proxy(matrix)(context, builder)
        found.data = builder.add(source.data, builder.mul(args[1], ir.Constant(WORD, ALIGN)))
        found.shape = cgutils.pack_array(builder, [args[2], args[3]], ty=WORD)
        return found._getvalue()

    return matrix(numbers, *(types.int64,) * 3), codegen


@infer_global(operator.setitem)
class _SetItem(AbstractTemplate):
    def generic(self, args, kws):
        array, index, value = args
        if isinstance(array, LaneArrayType):
            if _count(index) == array.ndim and is_number(value):
                return signature(types.none, array, index, LANE)
            if isinstance(index, types.SliceType) and isinstance(value, types.Float | types.Integer):
                return signature(types.none, array, index, types.float64)
        return None


@lower_builtin(operator.setitem, LaneArrayType, types.Any, LaneType)
def _setitem(context, builder, sig, args):
    index = _indices(context, builder, sig.args[1], args[1])
    builder.store(args[2], _entry(context, builder, sig.args[0], args[0], index), align=ALIGN)
    return context.get_dummy_value()


@lower_builtin(operator.setitem, LaneArrayType, types.SliceType, types.Float)
def _fill(context, builder, sig, args):
    """x[:n] = a number, from the beginning on and without a step."""
    kind = sig.args[0]
    array = cgutils.create_struct_proxy(kind)(context, builder, args[0])
    lengths = _lengths(context, builder, kind, array)
    stop = context.make_helper(builder, sig.args[1], args[1]).stop
    total = builder.select(builder.icmp_signed('<', stop, lengths[0]), stop, lengths[0])
    for n in lengths[1:]:
        total = builder.mul(total, n)
    first = builder.inttoptr(array.data, ir.PointerType(VECTOR))
    value = spread(builder, args[2])
    with cgutils.for_range(builder, total, intp=WORD) as loop:
        builder.store(value, builder.gep(first, [loop.index]), align=ALIGN)
    return context.get_dummy_value()


@infer_getattr
class _ArrayAttributes(AttributeTemplate):
    key = LaneArrayType

    def resolve_shape(self, kind):
        return types.UniTuple(types.intp, kind.ndim)


@lower_getattr(LaneArrayType, 'shape')
def _shape(context, builder, kind, value):
    array = cgutils.create_struct_proxy(kind)(context, builder, value)
    return cgutils.pack_array(builder, _lengths(context, builder, kind, array), ty=WORD)


@overload(len)
def _len(array):
    return (lambda array: array.shape[0]) if isinstance(array, LaneArrayType) else None


__all__ = ['LaneArray', 'LaneArrayType', 'is_lane', 'lane_zeros']
