"""Forward-mode derivatives: a value and its 12 partial derivatives, one number to the formulas.

The 12 directions are the variation (dp in W, dtheta in B) and the twist (linear in W, angular in B) of one body, so the last
step of a one-body element is to copy the partials of its generalized force into the rows of Kq and Kv.

Inside compiled code a Dual is a float64 and three SIMD vectors of four float64, so a product costs a few instructions (one
vector of 12 fits no register and would be taken apart at every call). A function written with + - * / and the functions of
this module runs on float64, complex128 and Dual alike. Branch on `.real`. Outside compiled code (NUMBA_DISABLE_JIT=1) the
Python class below has the same meaning.
Reference: Griewank and Walther, "Evaluating derivatives" (2008), chapter 3.
"""

from __future__ import annotations

import operator

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic, models, overload, overload_attribute, register_model

from solver.jit import kernel

N = 12  # number of partial derivatives


class Dual:
    """A number with N partial derivatives. `real` is the value, `partials` an (N,) array."""

    __slots__ = ('partials', 'real')
    __array_ufunc__ = None  # numpy scalars leave arithmetic with a Dual to the Dual

    def __init__(self, value: float, partials: np.ndarray) -> None:
        self.real = value
        self.partials = partials

    def __add__(self, other: Dual | float) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.real + other.real, self.partials + other.partials)
        return Dual(self.real + other, self.partials)

    __radd__ = __add__

    def __neg__(self) -> Dual:
        return Dual(-self.real, -self.partials)

    def __sub__(self, other: Dual | float) -> Dual:
        return self + (-other)

    def __rsub__(self, other: float) -> Dual:
        return Dual(other - self.real, -self.partials)

    def __mul__(self, other: Dual | float) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.real * other.real, self.partials * other.real + other.partials * self.real)
        return Dual(self.real * other, self.partials * other)

    __rmul__ = __mul__

    def __truediv__(self, other: Dual | float) -> Dual:
        if isinstance(other, Dual):
            q = self.real / other.real
            return Dual(q, self.partials * (1.0 / other.real) + other.partials * (-q / other.real))
        return Dual(self.real / other, self.partials / other)

    def __rtruediv__(self, other: float) -> Dual:
        q = other / self.real
        return Dual(q, self.partials * (-q / self.real))


class DualType(types.Type):
    """The compiled form of Dual."""

    def __init__(self) -> None:
        super().__init__(name='Dual')


class _PartialsType(types.Type):
    def __init__(self) -> None:
        super().__init__(name='DualPartials')


DUAL = DualType()
_PARTIALS = _PartialsType()
_LANES = 4  # float64 per vector
_CHUNKS = tuple(f'd{k}' for k in range(N // _LANES))
_VECTOR = ir.VectorType(ir.DoubleType(), _LANES)
_INDEX = ir.IntType(32)


@register_model(_PartialsType)
class _PartialsModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type) -> None:
        super().__init__(dmm, fe_type, _VECTOR)


@register_model(DualType)
class _DualModel(models.StructModel):
    def __init__(self, dmm, fe_type) -> None:
        super().__init__(dmm, fe_type, [('value', types.float64), *((name, _PARTIALS) for name in _CHUNKS)])


def _is_dual(x: types.Type) -> bool:
    return isinstance(x, DualType)


def _is_real(x: types.Type) -> bool:
    return isinstance(x, types.Float | types.Integer)


def _proxy(context, builder, packed=None):
    return cgutils.create_struct_proxy(DUAL)(context, builder, packed)


def _packed(context, builder, value, chunks):
    result = _proxy(context, builder)
    result.value = value
    for name, chunk in zip(_CHUNKS, chunks, strict=True):
        setattr(result, name, chunk)
    return result._getvalue()


def _splat(builder, scalar):
    """The vector of which every lane is this scalar."""
    undefined = ir.Constant(_VECTOR, ir.Undefined)
    lane = builder.insert_element(undefined, scalar, ir.Constant(_INDEX, 0))
    return builder.shuffle_vector(lane, undefined, ir.Constant(ir.VectorType(_INDEX, _LANES), [0] * _LANES))


@intrinsic
def _value(typingctx, x):
    def codegen(context, builder, signature, args):
        return _proxy(context, builder, args[0]).value

    return types.float64(DUAL), codegen


@intrinsic
def _chain(typingctx, value, x, dx):
    """Dual(value, dx * partials of x)."""

    def codegen(context, builder, signature, args):
        p, a = _proxy(context, builder, args[1]), _splat(builder, args[2])
        return _packed(context, builder, args[0], [builder.fmul(a, getattr(p, c)) for c in _CHUNKS])

    return DUAL(types.float64, DUAL, types.float64), codegen


@intrinsic
def _chain2(typingctx, value, x, dx, y, dy):
    """Dual(value, dx * partials of x + dy * partials of y)."""

    def codegen(context, builder, signature, args):
        p, a = _proxy(context, builder, args[1]), _splat(builder, args[2])
        q, b = _proxy(context, builder, args[3]), _splat(builder, args[4])
        chunks = [builder.fadd(builder.fmul(a, getattr(p, c)), builder.fmul(b, getattr(q, c))) for c in _CHUNKS]
        return _packed(context, builder, args[0], chunks)

    return DUAL(types.float64, DUAL, types.float64, DUAL, types.float64), codegen


@intrinsic
def _variable(typingctx, value, k):
    def codegen(context, builder, signature, args):
        chunks = []
        for c in range(len(_CHUNKS)):
            chunk = ir.Constant(_VECTOR, [0.0] * _LANES)
            for lane in range(_LANES):
                here = builder.icmp_signed('==', args[1], ir.Constant(args[1].type, c * _LANES + lane))
                one = builder.select(here, ir.Constant(ir.DoubleType(), 1.0), ir.Constant(ir.DoubleType(), 0.0))
                chunk = builder.insert_element(chunk, one, ir.Constant(_INDEX, lane))
            chunks.append(chunk)
        return _packed(context, builder, args[0], chunks)

    return DUAL(types.float64, types.int64), codegen


@intrinsic
def _partial(typingctx, x, k):
    def codegen(context, builder, signature, args):
        p = _proxy(context, builder, args[0])
        chunk = getattr(p, _CHUNKS[0])
        for c in range(1, len(_CHUNKS)):
            here = builder.icmp_signed('>=', args[1], ir.Constant(args[1].type, c * _LANES))
            chunk = builder.select(here, getattr(p, _CHUNKS[c]), chunk)
        lane = builder.and_(args[1], ir.Constant(args[1].type, _LANES - 1))
        return builder.extract_element(chunk, builder.trunc(lane, _INDEX))

    return types.float64(DUAL, types.int64), codegen


@overload_attribute(DualType, 'real')
def _real(x):
    return lambda x: _value(x)  # noqa: PLW0108  (numba takes a function, not an intrinsic)


def variable(value, k):
    """The independent variable k (0 to N-1) with this value [any unit]."""
    partials = np.zeros(N)
    partials[k] = 1.0
    return Dual(value, partials)


@overload(variable)
def _variable_overload(value, k):
    return lambda value, k: _variable(value, k)  # noqa: PLW0108


def partial(x, k):
    """Partial derivative of x with respect to variable k."""
    return x.partials[k]


@overload(partial)
def _partial_overload(x, k):
    return lambda x, k: _partial(x, k)  # noqa: PLW0108


def value(x):
    """x without its derivatives (real and complex numbers are returned as they are)."""
    return x.real if isinstance(x, Dual) else x


@overload(value)
def _value_overload(x):
    return (lambda x: _value(x)) if _is_dual(x) else (lambda x: x)  # noqa: PLW0108


@overload(operator.add)
def _add(a, b):
    if _is_dual(a) and _is_dual(b):
        return lambda a, b: _chain2(a.real + b.real, a, 1.0, b, 1.0)
    if _is_dual(a) and _is_real(b):
        return lambda a, b: _chain(a.real + b, a, 1.0)
    if _is_real(a) and _is_dual(b):
        return lambda a, b: _chain(a + b.real, b, 1.0)
    return None


@overload(operator.sub)
def _sub(a, b):
    if _is_dual(a) and _is_dual(b):
        return lambda a, b: _chain2(a.real - b.real, a, 1.0, b, -1.0)
    if _is_dual(a) and _is_real(b):
        return lambda a, b: _chain(a.real - b, a, 1.0)
    if _is_real(a) and _is_dual(b):
        return lambda a, b: _chain(a - b.real, b, -1.0)
    return None


@overload(operator.neg)
def _neg(a):
    if _is_dual(a):
        return lambda a: _chain(-a.real, a, -1.0)
    return None


@overload(operator.mul)
def _mul(a, b):
    if _is_dual(a) and _is_dual(b):
        return lambda a, b: _chain2(a.real * b.real, a, b.real, b, a.real)
    if _is_dual(a) and _is_real(b):
        return lambda a, b: _chain(a.real * b, a, float(b))
    if _is_real(a) and _is_dual(b):
        return lambda a, b: _chain(a * b.real, b, float(a))
    return None


@overload(operator.truediv)
def _div(a, b):
    if _is_dual(a) and _is_dual(b):

        def divide(a, b):
            q = a.real / b.real  # the same bits as without derivatives
            r = 1.0 / b.real
            return _chain2(q, a, r, b, -q * r)

        return divide
    if _is_dual(a) and _is_real(b):
        return lambda a, b: _chain(a.real / b, a, 1.0 / b)
    if _is_real(a) and _is_dual(b):

        def invert(a, b):
            q = a / b.real
            return _chain(q, b, -q / b.real)

        return invert
    return None


@kernel
def _sin(v):
    return np.sin(v), np.cos(v)


@kernel
def _cos(v):
    return np.cos(v), -np.sin(v)


@kernel
def _arctan(v):
    return np.arctan(v), 1.0 / (1.0 + v * v)


@kernel
def _exp(v):
    e = np.exp(v)
    return e, e


@kernel
def _log(v):
    return np.log(v), 1.0 / v


@kernel
def _sqrt(v):
    s = np.sqrt(v)
    return s, 0.5 / s


def sin(x):
    return _of(_sin, x)


def cos(x):
    return _of(_cos, x)


def arctan(x):
    return _of(_arctan, x)


def exp(x):
    return _of(_exp, x)


def log(x):
    return _of(_log, x)


def sqrt(x):
    return _of(_sqrt, x)


def _of(rule, x):
    if isinstance(x, Dual):
        f, df = rule(x.real)
        return Dual(f, df * x.partials)
    return rule(x)[0]


def _register(function, rule, plain) -> None:
    @overload(function)
    def choose(x):
        if _is_dual(x):

            def differentiate(x):
                f, df = rule(x.real)
                return _chain(f, x, df)

            return differentiate
        return lambda x: plain(x)  # noqa: PLW0108


for _f, _rule, _plain in (
    (sin, _sin, np.sin),
    (cos, _cos, np.cos),
    (arctan, _arctan, np.arctan),
    (exp, _exp, np.exp),
    (log, _log, np.log),
    (sqrt, _sqrt, np.sqrt),
):
    _register(_f, _rule, _plain)
