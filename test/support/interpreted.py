"""A kernel as plain Python, with all that it calls.

Complex numbers go through kernels in tests only, where they give derivatives by the complex step. Compiled for them
once more, a tire took forty seconds of a processor and ran for a hundredth of one; interpreted it runs for tenths of a
second. What is compiled stays what models run, and is compared with what its source says.
"""

from __future__ import annotations

import types
from collections.abc import Callable
from typing import Any

from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic

from solver.compiled.by_reference import matrix_at
from solver.compiled.kernel import sixes

INTRINSICS: dict[str, Callable[..., Any]] = {
    sixes.__name__: lambda array: array,
    matrix_at.__name__: lambda numbers, start, rows, columns: numbers[start : start + rows * columns].reshape(
        rows, columns
    ),
}

_MADE: dict[types.FunctionType, types.FunctionType] = {}


def interpreted(kernel: Any) -> Any:
    """The function behind a kernel, and behind every kernel it calls, without compilation."""
    function: types.FunctionType = kernel.py_func if isinstance(kernel, Dispatcher) else kernel
    if function not in _MADE:
        names: dict[str, Any] = dict(function.__globals__)
        made = types.FunctionType(
            function.__code__, names, function.__name__, function.__defaults__, function.__closure__
        )
        _MADE[function] = made  # before what it calls, which may call it
        for name in _names(function.__code__):
            called = names.get(name)
            if isinstance(called, _Intrinsic):
                names[name] = INTRINSICS[called.__name__]
            elif isinstance(called, Dispatcher) or (
                isinstance(called, types.FunctionType) and called.__module__.startswith('solver.')
            ):
                names[name] = interpreted(called)
    return _MADE[function]


def _names(code: types.CodeType) -> set[str]:
    inner = (constant for constant in code.co_consts if isinstance(constant, types.CodeType))
    return set(code.co_names).union(*map(_names, inner))
