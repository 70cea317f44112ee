"""NamedTuples by reference: a model's tables cross a call as one pointer instead of hundreds of array fields.

numba passes a NamedTuple of arrays by value: every array is seven or more arguments, unpacked from Python on every call
and threaded through every nested call. A compiled model has about 150 arrays; by value they cost 30 us per call from
Python and most of the compile time. `Ref(value)` lays the array descriptors of a (nested) NamedTuple out in memory
once; compiled code sees a pointer, `ref.field` loads a descriptor, `ref.nested` is another pointer. Kernels are written
as for plain NamedTuples and accept both.
"""

from __future__ import annotations

import functools
import hashlib
import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import config, typeof
from numba.core import cgutils, types
from numba.core.imputils import lower_getattr_generic
from numba.core.typing.templates import AttributeTemplate
from numba.extending import NativeValue, infer_getattr, intrinsic, models, register_model, typeof_impl, unbox

WORD = 8


class FieldType(types.Type):
    """Type of what a Ref may hold beside arrays, numbers and NamedTuples: `words` of memory, which load() makes a value
    of."""

    words: int

    def load(self, context: Any, builder: Any, load: Any) -> Any:
        """The value, from load(k), the k-th of its words."""
        raise NotImplementedError

    def operation(self, name: str, *arguments: Any) -> Any:
        """(signature, code) of an intrinsic for arguments of which the first has this type: matrix_at() here, those of
        solver.linear.blocks."""
        raise NotImplementedError


class Field:
    """A value of such a type. words: what a Ref stores of it."""

    kind: FieldType
    words: list[int]


class RefType(types.Type):
    """Compiled type of a Ref to a NamedTuple type, with the lengths of all dimensions of its arrays but the first.

    Those are the same in every model (a block is 6x6, a position has three numbers), and what the compiler knows of
    them it need not multiply when it addresses an element.
    """

    def __init__(self, target: types.BaseNamedTuple, inner: tuple) -> None:
        self.target = target
        self.inner = inner  # of each field: shape[1:] of an array, the same again of a NamedTuple, () of a number
        self._places: dict[str, tuple[types.Type, int, tuple]] = {}
        # whole it has thousands of letters
        digest = hashlib.sha256(f'{_layout(target)} {inner}'.encode()).hexdigest()[:16]
        super().__init__(name=f'Ref({target.instance_class.__name__}, {digest})')

    def field(self, name: str) -> tuple[types.Type, int, tuple]:
        """(type, offset in words, inner shape) of a field. Raises KeyError."""
        if not self._places:
            offset = 0
            for field, kind, inner in zip(self.target.fields, self.target.types, self.inner, strict=True):
                self._places[field] = kind, offset, inner
                offset += _words(kind)
        return self._places[name]


@functools.cache
def _layout(kind: types.Type) -> str:
    """All that decides where compiled code finds a field: the name that numba gives to a NamedTuple says nothing of its
    fields."""
    if not isinstance(kind, types.BaseNamedTuple):
        return str(kind)
    fields = (f'{name}: {_layout(one)}' for name, one in zip(kind.fields, kind.types, strict=True))
    return f'{kind.instance_class.__module__}.{kind.instance_class.__qualname__}({", ".join(fields)})'


def _inner(value: Any) -> tuple:
    if isinstance(value, tuple):
        return tuple(_inner(field) for field in value)
    return value.shape[1:] if isinstance(value, np.ndarray) else ()


_KNOWN: dict[tuple, RefType] = {}  # numba looks at every array of a model's tables anew each time


def _type_of(value: tuple) -> RefType:
    """The type of a Ref to a value, of which it depends on classes, kinds of numbers and inner shapes."""
    structure = _structure(value)
    kind = _KNOWN.get(structure)
    if kind is None:
        kind = _KNOWN[structure] = RefType(_fields(value), _inner(value))
    return kind


def _fields(value: Any) -> types.Type:
    """numba's type of a value. Its own typeof() compares the class of every NamedTuple with all abstract base
    classes."""
    return (
        types.BaseTuple.from_types(tuple(map(_fields, value)), type(value))
        if isinstance(value, tuple)
        else value.kind
        if isinstance(value, Field)
        else typeof(value)
    )


def _structure(value: Any) -> Any:
    if isinstance(value, tuple):
        return (type(value), *map(_structure, value))
    if isinstance(value, Field):
        return value.kind
    return (value.dtype, value.ndim, value.shape[1:]) if isinstance(value, np.ndarray) else type(value)


def _words(kind: types.Type) -> int:
    if isinstance(kind, types.BaseNamedTuple):
        return sum(_words(t) for t in kind.types)
    if isinstance(kind, types.Array):
        return 3
    if isinstance(kind, FieldType):
        return kind.words
    if kind in (types.int64, types.float64):
        return 1
    raise TypeError(f'a Ref holds arrays, int, float and NamedTuples of them, not {kind}')


def _flatten(value: Any) -> list[int]:
    if isinstance(value, tuple):
        return [word for field in value for word in _flatten(field)]
    if isinstance(value, np.ndarray):
        if not value.flags.carray:
            raise ValueError('a Ref needs writable C-contiguous arrays, aligned to their numbers')
        return [value.size, value.ctypes.data, len(value)]
    if isinstance(value, Field):
        return value.words
    if isinstance(value, float):
        return [int(np.float64(value).view(np.int64))]
    return [int(value)]


def nbytes(value: Any) -> int:
    """Memory of all arrays in nested tuples."""
    if isinstance(value, np.ndarray):
        return value.nbytes
    return sum(map(nbytes, value)) if isinstance(value, tuple) else 0


class Ref:
    """A NamedTuple of arrays, numbers and such NamedTuples, as compiled code sees it. The arrays are shared, never
    copied."""

    __slots__ = ('pointer', 'type', 'value', 'words')

    def __init__(self, value: tuple) -> None:
        self.value: Any = value
        self.type = _type_of(value)
        self.words = np.array(_flatten(value), np.int64)
        self.pointer = self.words.ctypes.data

    def __getattr__(self, name: str) -> Any:
        return getattr(self.value, name)

    def assign(self, **numbers: float) -> None:
        """Change float fields of the NamedTuple itself. Only between calls: compiled code takes what it reads for
        constant."""
        for name, number in numbers.items():
            self.words[self.type.field(name)[1]] = np.float64(number).view(np.int64)
        self.value = self.value._replace(**numbers)

    @property
    def _numba_type_(self) -> RefType:
        return self.type  # numba's fast path to the type of an argument


@typeof_impl.register(Ref)
def _typeof_ref(value: Ref, context: object) -> RefType:
    return value.type


@register_model(RefType)
class _RefModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type) -> None:
        super().__init__(dmm, fe_type, ir.IntType(64))


@unbox(RefType)
def _unbox_ref(typ, obj, c):
    pointer = c.pyapi.object_getattr_string(obj, 'pointer')
    value = c.pyapi.long_as_longlong(pointer)
    c.pyapi.decref(pointer)
    return NativeValue(value, is_error=cgutils.is_not_null(c.builder, c.pyapi.err_occurred()))


@infer_getattr
class _RefAttribute(AttributeTemplate):
    key = RefType

    def generic_resolve(self, typ, attr):
        try:
            kind, _, inner = typ.field(attr)
        except KeyError:
            return None
        return RefType(kind, inner) if isinstance(kind, types.BaseNamedTuple) else kind


@lower_getattr_generic(RefType)
def _lower_ref_attribute(context, builder, typ, value, attr):
    kind, offset, inner = typ.field(attr)
    word = ir.IntType(64)
    base = builder.add(value, ir.Constant(word, WORD * offset))
    if isinstance(kind, types.BaseNamedTuple):
        return base

    def load(index: int, llvm_type=word):
        address = builder.add(base, ir.Constant(word, WORD * index))
        loaded = builder.load(builder.inttoptr(address, ir.PointerType(llvm_type)))
        loaded.set_metadata('invariant.load', builder.module.add_metadata([]))  # descriptors never change
        return loaded

    if isinstance(kind, FieldType):
        return kind.load(context, builder, load)
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder)
        array.meminfo = cgutils.get_null_value(array.meminfo.type)
        array.parent = cgutils.get_null_value(array.parent.type)
        array.nitems = load(0)
        size = np.dtype(str(kind.dtype)).itemsize
        strides = [size * math.prod(inner[k:]) for k in range(kind.ndim)]
        array.itemsize = ir.Constant(word, size)
        array.data = builder.inttoptr(load(1), array.data.type)
        array.shape = cgutils.pack_array(builder, [load(2), *(ir.Constant(word, n) for n in inner)], ty=word)
        array.strides = cgutils.pack_array(builder, [ir.Constant(word, n) for n in strides], ty=word)
        return array._getvalue()
    return load(0, context.get_value_type(kind))


@intrinsic(prefer_literal=True)
def assign(typing_context, ref, name, number):
    """Change a float field of the NamedTuple behind a Ref, as Ref.assign does from Python (whose Ref.value does not
    follow).

    Only for a kernel that reads that field nowhere itself, nor in what it calls but through invoke(): compiled code
    takes it for constant.
    """
    if not isinstance(ref, RefType) or not isinstance(name, types.StringLiteral):
        return None
    _, offset, _ = ref.field(name.literal_value)

    def generate(context, builder, signature, args):
        address = builder.add(args[0], ir.Constant(ir.IntType(64), WORD * offset))
        builder.store(args[2], builder.inttoptr(address, ir.PointerType(ir.DoubleType())))
        return context.get_dummy_value()

    return types.none(ref, name, types.float64), generate


@intrinsic
def matrix_at(typing_context, numbers, start, rows, columns):
    """The (rows, columns) matrix that lies in the vector `numbers` from index `start` on. Its memory is that of the
    vector."""
    if isinstance(numbers, FieldType):
        return numbers.operation('matrix_at', numbers, start, rows, columns)
    vector = types.Array(numbers.dtype, 1, 'C')
    matrix = types.Array(numbers.dtype, 2, 'C')
    if numbers != vector:
        return None

    def generate(context, builder, signature, args):
        source = context.make_array(vector)(context, builder, args[0])
        size = ir.Constant(ir.IntType(64), np.dtype(str(vector.dtype)).itemsize)
        array = context.make_array(matrix)(context, builder)
        array.meminfo = cgutils.get_null_value(array.meminfo.type)
        array.parent = cgutils.get_null_value(array.parent.type)
        array.nitems = builder.mul(args[2], args[3])
        array.itemsize = size
        array.data = builder.gep(source.data, [args[1]])
        array.shape = cgutils.pack_array(builder, [args[2], args[3]])
        array.strides = cgutils.pack_array(builder, [builder.mul(args[3], size), size])
        return array._getvalue()

    return matrix(vector, types.int64, types.int64, types.int64), generate


if config.DISABLE_JIT:
    matrix_at = lambda numbers, start, rows, columns: numbers[start : start + rows * columns].reshape(rows, columns)  # noqa: E731
