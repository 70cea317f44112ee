"""Forward-mode derivatives: a value and its partial derivatives, one number to the formulas.

There are two widths. The 12 directions of the wide one are the variation (dp in W, dtheta in B) and the twist (linear
in W, angular in B) of one body, so the last step of a one-body element is to copy the partials of its generalized force
into the rows of Kq and Kv. A law with few arguments runs on the narrow one, whose 4 directions are these arguments:
`local` makes them, `compose` applies the chain rule to the results. That is a third of the work, and a number needs one
register instead of three.

Inside compiled code a Dual is a float64 and one or three SIMD vectors of four float64, so a product costs a few
instructions (one vector of 12 fits no register and would be taken apart at every call). A function written with + - * /
and the functions of this module runs on float64, complex128 and both Duals alike. Branch on `.real`. Outside compiled
code (NUMBA_DISABLE_JIT=1) the Python class below has the same meaning. Reference: [Griewank2008], chapters 3 and 4.
"""

from __future__ import annotations

import operator

import numpy as np
from numba.extending import overload, overload_attribute

from solver.compiled.by_reference import FieldType
from solver.compiled.dual_type import (
    NARROW,
    DualType,
    N,
    dual_add_partials,
    dual_chain,
    dual_chain2,
    dual_compose,
    dual_local,
    dual_partial,
    dual_seeded,
    dual_value,
    dual_variable,
    is_dual,
    is_real,
    is_wide,
)
from solver.compiled.kernel import kernel


class Dual:
    """A number with N or NARROW partial derivatives. `real` is the value, `partials` an (N,) or (NARROW,) array."""

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


@overload_attribute(DualType, 'real')
def _real(x):
    return lambda x: dual_value(x)  # noqa: PLW0108  (numba takes a function, not an intrinsic)


def variable(value, k):
    """The independent variable k (0 to N-1) with this value [any unit]."""
    partials = np.zeros(N)
    partials[k] = 1.0
    return Dual(value, partials)


@overload(variable)
def _variable_overload(value, k):
    if isinstance(value, FieldType):
        return None
    return lambda value, k: dual_variable(value, k)  # noqa: PLW0108


def seeded(value, partials):
    """The wide Dual of this value and these N partial derivatives."""
    return Dual(value, np.array(partials, float))


@overload(seeded)
def _seeded_overload(value, partials):
    if isinstance(value, FieldType):
        return None
    return lambda value, partials: dual_seeded(value, partials)  # noqa: PLW0108


def local(x, k):
    """x as argument k (0 to NARROW-1) of a law, a constant for k = -1: a narrow Dual if x is a wide one, else x
    itself."""
    if not isinstance(x, Dual):
        return x
    return Dual(x.real, np.array([float(k == lane) for lane in range(NARROW)]))


@overload(local)
def _local_overload(x, k):
    if isinstance(x, FieldType):
        return None
    return (lambda x, k: dual_local(dual_value(x), k)) if is_wide(x) else (lambda x, k: x)


def compose(y, a, b, c, d):
    """Chain rule: y, a result of a law in the narrow directions, with the partials that its arguments 0 to 3 (a, b, c,
    d) give it.

    y itself if it is no Dual.
    """
    if not isinstance(y, Dual):
        return y
    return Dual(y.real, sum(slope * x.partials for slope, x in zip(y.partials, (a, b, c, d), strict=True)))


@overload(compose)
def _compose_overload(y, a, b, c, d):
    if isinstance(y, FieldType):
        return None
    return (lambda y, a, b, c, d: dual_compose(y, a, b, c, d)) if is_dual(y) else (lambda y, a, b, c, d: y)  # noqa: PLW0108


def differentiates(x):
    """True where x is a wide Dual; decided at compile time."""
    return isinstance(x, Dual) and len(x.partials) == N


@overload(differentiates)
def _differentiates_overload(x):
    if isinstance(x, FieldType):
        return None
    return (lambda x: True) if is_wide(x) else (lambda x: False)


def partial(x, k):
    """Partial derivative of x with respect to variable k."""
    return x.partials[k]


@overload(partial)
def _partial_overload(x, k):
    return (lambda x, k: dual_partial(x, k)) if is_dual(x) else None  # noqa: PLW0108


def add_partials(x, Kq, Kv, s, r):
    """Add the first half of the partials of a wide Dual, those of the variation, to row r of block s of Kq (n, 6, 6),
    the other half, those of the twist, to that of Kv; both arrays contiguous."""
    Kq[s, r] += x.partials[: N // 2]
    Kv[s, r] += x.partials[N // 2 :]


@overload(add_partials)
def _add_partials_overload(x, Kq, Kv, s, r):
    return (lambda x, Kq, Kv, s, r: dual_add_partials(x, Kq, Kv, s, r)) if is_dual(x) else None  # noqa: PLW0108


def value(x):
    """x without its derivatives (real and complex numbers are returned as they are)."""
    return x.real if isinstance(x, Dual) else x


@overload(value)
def _value_overload(x):
    if isinstance(x, FieldType):
        return None
    return (lambda x: dual_value(x)) if is_dual(x) else (lambda x: x)  # noqa: PLW0108


@overload(operator.add)
def _add(a, b):
    if is_dual(a) and is_dual(b):
        return lambda a, b: dual_chain2(a.real + b.real, a, 1.0, b, 1.0)
    if is_dual(a) and is_real(b):
        return lambda a, b: dual_chain(a.real + b, a, 1.0)
    if is_real(a) and is_dual(b):
        return lambda a, b: dual_chain(a + b.real, b, 1.0)
    return None


@overload(operator.sub)
def _sub(a, b):
    if is_dual(a) and is_dual(b):
        return lambda a, b: dual_chain2(a.real - b.real, a, 1.0, b, -1.0)
    if is_dual(a) and is_real(b):
        return lambda a, b: dual_chain(a.real - b, a, 1.0)
    if is_real(a) and is_dual(b):
        return lambda a, b: dual_chain(a - b.real, b, -1.0)
    return None


@overload(operator.neg)
def _neg(a):
    if is_dual(a):
        return lambda a: dual_chain(-a.real, a, -1.0)
    return None


@overload(operator.mul)
def _mul(a, b):
    if is_dual(a) and is_dual(b):
        return lambda a, b: dual_chain2(a.real * b.real, a, b.real, b, a.real)
    if is_dual(a) and is_real(b):
        return lambda a, b: dual_chain(a.real * b, a, float(b))
    if is_real(a) and is_dual(b):
        return lambda a, b: dual_chain(a * b.real, b, float(a))
    return None


@overload(operator.truediv)
def _div(a, b):
    if is_dual(a) and is_dual(b):

        def divide(a, b):
            q = a.real / b.real  # the same bits as without derivatives
            r = 1.0 / b.real
            return dual_chain2(q, a, r, b, -q * r)

        return divide
    if is_dual(a) and is_real(b):
        return lambda a, b: dual_chain(a.real / b, a, 1.0 / b)
    if is_real(a) and is_dual(b):

        def invert(a, b):
            q = a / b.real
            return dual_chain(q, b, -q / b.real)

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
        if is_dual(x):

            def differentiate(x):
                f, df = rule(x.real)
                return dual_chain(f, x, df)

            return differentiate
        return None if isinstance(x, FieldType) else lambda x: plain(x)  # noqa: PLW0108


for _f, _rule, _plain in (
    (sin, _sin, np.sin),
    (cos, _cos, np.cos),
    (arctan, _arctan, np.arctan),
    (exp, _exp, np.exp),
    (log, _log, np.log),
    (sqrt, _sqrt, np.sqrt),
):
    _register(_f, _rule, _plain)
