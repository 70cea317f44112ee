"""The one place that configures numba: `kernel` is the decorator of every compiled function; solver.compiled.cache
keeps them."""

from __future__ import annotations

import gc
import threading
from itertools import chain
from pathlib import Path

import numba
import numpy as np
from numba.core import event
from numba.core.compiler_lock import global_compiler_lock

from solver.compiled import interruption
from solver.compiled.cache import KernelCache, Kernels
from solver.disk import location

PATIENCE = 100_000  # objects made before garbage is looked for, while compiling
KERNELS = Kernels(Path(__file__).parent, location(), Path(__file__).parents[1] / 'shipped')

# Truth values for calls of one kernel by another: numba compiles the callee once more for each literal among its
# arguments.
YES, NO = np.bool_(True), np.bool_(False)


class _Lock(event.Listener):
    """State while numba compiles or loads: interruptions wait, and garbage is collected less often (almost all that
    numba makes is kept, and looking through it again and again took a twelfth of the time).
    """

    def __init__(self) -> None:
        self._depth = 0
        self._lock = threading.Lock()  # numba tells of its own lock before it has it
        self._thresholds = gc.get_threshold()

    def on_start(self, event) -> None:
        interruption.enter()
        with self._lock:
            if self._depth == 0:
                self._thresholds = gc.get_threshold()
                gc.set_threshold(PATIENCE, *self._thresholds[1:])
            self._depth += 1

    def on_end(self, event) -> None:
        with self._lock:
            self._depth -= 1
            if self._depth == 0:
                gc.set_threshold(*self._thresholds)
        interruption.leave()


class _Passes(event.Listener):
    """Between two passes the compiler can be left."""

    def on_start(self, event) -> None:
        interruption.check()

    def on_end(self, event) -> None:
        pass


event.register('numba:compiler_lock', _Lock())
event.register('numba:run_pass', _Passes())


def kernel(function=None, *, inline: bool = False, borrow: bool = False, inner: bool | None = None):
    """Compile a function with the project's settings: kept on disk, no fastmath, GIL released, IEEE division.

    borrow: the function only reads and writes the arrays it is given, so their references need not be counted. Counting
    takes an atomic operation per array and table and made the element kernels six times slower. Such a function cannot
    allocate, nor assign an array to a slice of another one (numba then says 'NRT required but not enabled'). inner:
    only other kernels call it; it borrows, and has no entry for Python, whose compilation took a tenth of the time of
    all. inline: for small functions; always inlined, and inner unless said otherwise.
    """
    inner = inline if inner is None else inner
    options = {'nogil': True, 'error_model': 'numpy', 'fastmath': False, 'no_cfunc_wrapper': True}
    if inline or borrow or inner:
        options['_nrt'] = False
    if inline:
        options['forceinline'] = True
    if inner:
        options['no_cpython_wrapper'] = True

    def compiled(function):
        dispatcher = numba.njit(function, **options)
        if numba.config.DISABLE_JIT:
            return dispatcher
        dispatcher._cache = KernelCache(dispatcher, KERNELS)
        return _refusing_python(dispatcher) if inner else dispatcher

    return compiled if function is None else compiled(function)


def _refusing_python(dispatcher):
    """The kernel without an entry for Python, where numba would call address 0 for it."""

    def refuse(*arguments, **named):
        raise TypeError(
            f'{dispatcher.__name__} is an inner kernel: call it from a kernel, or compile it with inner=False'
        )

    dispatcher.add_overload = lambda result: dispatcher.overloads.update({tuple(result.signature.args): result})
    dispatcher._compile_for_args = refuse
    return dispatcher


@numba.extending.intrinsic
def invoke(typing_context, address, arguments):
    """Call the compiled kernel at `address` (see `address_of`) with a tuple of arguments; the kernel returns None.

    numba puts a copy of every callee into its caller and optimises and emits it again there; with kernels nested four
    deep that was most of the compile time. A call through an address compiles each kernel once. The types of the
    arguments must be those the address was compiled for.
    """
    from llvmlite import ir
    from numba.core import types

    argument_types = tuple(types.unliteral(t) for t in arguments)
    _require_plain_arrays(argument_types)
    signature = types.none(address, arguments)

    def generate(context, builder, sig, args):
        values = []
        for k, (given, wanted) in enumerate(zip(sig.args[1], argument_types, strict=True)):
            values.append(context.cast(builder, builder.extract_value(args[1], k), given, wanted))
        function_type = context.call_conv.get_function_type(types.none, argument_types)
        function = builder.inttoptr(args[0], ir.PointerType(function_type))
        context.call_conv.call_function(builder, function, types.none, argument_types, values)
        return context.get_dummy_value()

    return signature, generate


@numba.extending.intrinsic
def sixes(typing_context, array):
    """The array, (n, 6) or (n, 6, 6), with its inner lengths known to the compiler: what crosses invoke() has lost
    them, and every address would be multiplied out at run time. Others that a Ref may hold know them anyway.
    """
    if not isinstance(array, numba.core.types.Array):
        return array(array), lambda context, builder, signature, args: args[0]

    def generate(context, builder, signature, args):
        from llvmlite import ir
        from numba.core import cgutils
        from numba.core.imputils import impl_ret_borrowed

        kind = signature.args[0]
        word = ir.IntType(64)
        known = context.make_array(kind)(context, builder, args[0])
        size = context.get_abi_sizeof(context.get_data_type(kind.dtype))
        first = cgutils.unpack_tuple(builder, known.shape)[0]
        strides = [ir.Constant(word, size * 6 ** (kind.ndim - 1 - k)) for k in range(kind.ndim)]
        known.shape = cgutils.pack_array(builder, [first, *[ir.Constant(word, 6)] * (kind.ndim - 1)], ty=word)
        known.strides = cgutils.pack_array(builder, strides, ty=word)
        # counted, where references are
        return impl_ret_borrowed(context, builder, signature.return_type, known._getvalue())

    return array(array), generate


if numba.config.DISABLE_JIT:
    sixes = lambda array: array  # noqa: E731


def _require_plain_arrays(argument_types) -> None:
    """Refuse at compile time what address_of never compiles for: strided or read-only arrays, and tuples by value.

    A NamedTuple of what may be passed may be passed too: it is no more than its fields, one after the other.
    """
    from numba.core import errors, types

    fields = [t.types if isinstance(t, types.BaseNamedTuple) else (t,) for t in argument_types]
    for t in chain.from_iterable(fields):
        if isinstance(t, types.BaseTuple):
            raise errors.TypingError(f'invoke: pass {t} by Ref')
        if getattr(t, 'of_lanes', False):
            raise errors.TypingError(f'invoke: {t}: the kernel at the address takes what all lanes have in common')
        if isinstance(t, types.Array) and not (t.layout == 'C' and t.mutable and t.aligned):
            raise errors.TypingError(f'invoke: {t} is not a writable C-contiguous array')


def address_of(function, *arguments) -> int:
    """Address of a kernel compiled for the types of `arguments`, for `invoke`."""
    if not hasattr(function, 'compile'):
        raise TypeError('invoke needs compiled kernels; unset NUMBA_DISABLE_JIT')
    signature = tuple(numba.typeof(a) for a in arguments)
    with global_compiler_lock:
        function.compile(signature)
        result = function.overloads[signature]
        return result.library.get_pointer_to_function(result.fndesc.llvm_func_name)


def optimised(compiled) -> str:
    """The code of a compiled kernel (numba's record of it) behind the optimiser, as LLVM writes it, all that it calls
    included."""
    with global_compiler_lock:
        return str(compiled.library._get_module_for_linking())
