"""Branches of kernels that step several simulations: one way is taken, and lanes that ask for another one are noted.

Where a kernel asks `if x > 0.0`, lanes mostly agree, which costs two instructions. If they do not, the way is that of
most lanes that count. The others are noted in Flags.left and count no more: whatever they compute behind that is void.
Indices from numbers of lanes are agreed upon in the same way, with the first lane that counts. So a kernel is never
wrong in silence, whatever it branches on; `where` in its place only makes it faster.

Flags belong to a thread: compiled code finds them behind a key of the C library, since no argument leads from an
addition to a group of simulations.
"""

from __future__ import annotations

import ctypes

import llvmlite.binding as llvm
import numpy as np
from llvmlite import ir
from numba.core import cgutils

from solver.compiled.lanes import LANES

ALL = (1 << LANES) - 1
WORD = ir.IntType(64)
BITS = ir.IntType(LANES)
_SYMBOL = 'mbd_lane_flags'
_C = ctypes.CDLL(None)


class Flags:
    """Lanes that count, and those that left: bits, lane 0 the lowest. Bound to a thread by bind()."""

    def __init__(self) -> None:
        self.words = np.array([ALL, 0], np.int64)

    def bind(self) -> None:
        """Make them the ones that compiled code in this thread notes in."""
        _C.pthread_setspecific(_KEY, ctypes.c_void_p(self.words.ctypes.data))


def _accessor() -> tuple[ctypes.c_uint, object]:
    """(a key of the C library, the engine that holds the function by which kernels get what is behind it)."""
    key = ctypes.c_uint()
    if _C.pthread_key_create(ctypes.byref(key), None):
        raise MemoryError('the C library has no key left for numbers of a thread')
    code = f"""
    declare i8* @pthread_getspecific(i32)
    define i8* @{_SYMBOL}_of_{key.value}() {{
      %p = call i8* @pthread_getspecific(i32 {key.value})
      ret i8* %p
    }}"""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    module = llvm.parse_assembly(code)
    engine = llvm.create_mcjit_compiler(module, llvm.Target.from_default_triple().create_target_machine())
    engine.finalize_object()
    llvm.add_symbol(_SYMBOL, engine.get_function_address(f'{_SYMBOL}_of_{key.value}'))
    return key, engine


_KEY, _ENGINE = _accessor()
_default = Flags()  # of the thread that imports this: a kernel that is called from Python finds flags
_default.bind()


def _flags(builder):
    kind = ir.FunctionType(ir.PointerType(WORD), [])
    words = builder.call(cgutils.get_or_insert_function(builder.module, kind, _SYMBOL), [])
    one = ir.Constant(ir.IntType(32), 1)
    return words, builder.gep(words, [one])


def _noted(name, build):
    """A function of a module that is called where lanes do not agree; never inlined, so that agreement stays short."""

    def function(builder, result, argument):
        kind = ir.FunctionType(result, [argument.type])
        found = cgutils.get_or_insert_function(builder.module, kind, name)
        if not found.blocks:
            found.linkage = 'linkonce_odr'
            found.attributes.add('noinline')
            found.attributes.add('cold')
            build(ir.IRBuilder(found.append_basic_block()), found.args[0])
        return builder.call(found, [argument])

    return function


def _note(builder, counting, left, active, differing):
    """Take the lanes `differing` out of those that count."""
    builder.store(builder.and_(active, builder.not_(differing)), counting)
    builder.store(builder.or_(builder.load(left), differing), left)


def _vote(builder, mask):
    """True where most of the lanes that count say so; notes the others."""
    counting, left = _flags(builder)
    active = builder.load(counting)
    yes = builder.and_(builder.zext(mask, WORD), active)
    no = builder.and_(builder.not_(yes), active)
    most = builder.icmp_unsigned('>', builder.ctpop(yes), builder.ctpop(no))
    _note(builder, counting, left, active, builder.select(most, no, yes))
    builder.ret(most)


def _first(builder, numbers):
    """The number of the first lane that counts; notes those with another one."""
    counting, left = _flags(builder)
    active = builder.load(counting)
    with_end = builder.or_(active, ir.Constant(WORD, 1 << (LANES - 1)))
    lane = builder.cttz(with_end, ir.Constant(ir.IntType(1), 1))
    chosen = builder.extract_element(numbers, builder.trunc(lane, ir.IntType(32)))
    same = builder.zext(builder.bitcast(builder.icmp_signed('==', numbers, spread(builder, chosen)), BITS), WORD)
    _note(builder, counting, left, active, builder.and_(active, builder.not_(same)))
    builder.ret(chosen)


_voted = _noted('mbd_lanes_vote', _vote)
_chosen = _noted('mbd_lanes_first', _first)


def spread(builder, scalar):
    """The vector of which every lane is this scalar."""
    kind = ir.VectorType(scalar.type, LANES)
    undefined, lane = ir.Constant(kind, ir.Undefined), ir.IntType(32)
    first = builder.insert_element(undefined, scalar, ir.Constant(lane, 0))
    return builder.shuffle_vector(first, undefined, ir.Constant(ir.VectorType(lane, LANES), [0] * LANES))


def agreed(builder, truths):
    """One truth value, i1, of a vector of them."""
    bits = builder.bitcast(truths, BITS)
    all_, none = ir.Constant(BITS, ALL), ir.Constant(BITS, 0)
    result = cgutils.alloca_once_value(builder, builder.icmp_unsigned('==', bits, all_))
    unlike = builder.and_(builder.icmp_unsigned('!=', bits, all_), builder.icmp_unsigned('!=', bits, none))
    with builder.if_then(unlike, likely=False):
        builder.store(_voted(builder, ir.IntType(1), bits), result)
    return builder.load(result)


def agreed_number(builder, numbers):
    """One integer of a vector of them."""
    first = builder.extract_element(numbers, ir.Constant(ir.IntType(32), 0))
    same = builder.bitcast(builder.icmp_signed('==', numbers, spread(builder, first)), BITS)
    result = cgutils.alloca_once_value(builder, first)
    with builder.if_then(builder.icmp_unsigned('!=', same, ir.Constant(BITS, ALL)), likely=False):
        builder.store(_chosen(builder, WORD, numbers), result)
    return builder.load(result)
