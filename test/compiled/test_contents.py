"""What the code of a kernel is made of (solver.compiled.contents): all that decides about it makes another kernel,
nothing else does."""

from __future__ import annotations

import ast
import functools
import importlib
import inspect
import math
import pkgutil
import textwrap
from collections.abc import Iterator
from pathlib import Path
from types import FunctionType, ModuleType, SimpleNamespace
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest
from numba.core import types
from numba.core.dispatcher import Dispatcher
from numba.extending import intrinsic, overload
from toy_kernels import SOLVER, Edited

import solver
from solver.compiled.by_reference import Ref
from solver.compiled.cache import KernelCache, Kernels
from solver.compiled.contents import Unknown, contents
from solver.elements.registry import CONSTRAINTS, FORCES, KINDS

pytestmark = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason='about compiled code')


def all_kernels() -> Iterator[Dispatcher]:
    for module in pkgutil.walk_packages(solver.__path__, 'solver.'):
        for value in vars(importlib.import_module(module.name)).values():
            if isinstance(value, Dispatcher) and value.__module__ == module.name:
                yield value


KERNELS = [] if numba.config.DISABLE_JIT else list(all_kernels())


def test_every_kernel_can_be_kept() -> None:
    """Raises Unknown otherwise."""
    assert len(KERNELS) > 350
    for one in KERNELS:
        assert isinstance(one._cache, KernelCache)
        contents(one, ())


def test_an_element_is_in_the_code_of_no_other_one_nor_of_the_step() -> None:
    """So an edit of a kind compiles again its own kernel alone: those that evaluate all kinds call it through an
    address."""
    for kind in KINDS:
        entries = {kind.kernel} if kind in FORCES else {kind.residuals, kind.hessians}
        within = {one for one in KERNELS if entries & contents(one, ())[1]}
        assert within == entries, kind.name
    assert len(CONSTRAINTS) + len(FORCES) == len(KINDS)


@functools.cache
def named_in(function: FunctionType) -> list[Dispatcher]:
    """All kernels that the source of a function names in its module, also behind dots."""
    found = []
    own = function.__code__.co_varnames  # an argument may have the name of a kernel
    for node in ast.walk(ast.parse(textwrap.dedent(inspect.getsource(function)))):
        if isinstance(node, ast.Name | ast.Attribute) and ast.unparse(node).split('.')[0] not in own:
            value: Any = function.__globals__
            for name in ast.unparse(node).split('.'):
                value = value.get(name) if isinstance(value, dict) else getattr(value, name, None)
                if not isinstance(value, ModuleType):
                    break
            found += [value] if isinstance(value, Dispatcher) else []
    return found


@pytest.mark.slow
def test_all_kernels_that_sources_name_are_within() -> None:
    """The same by another way: syntax in place of bytecode."""
    for one in KERNELS:
        found, waiting = set(), [one]
        while waiting:
            called = waiting.pop()
            if called not in found:
                found.add(called)
                waiting += named_in(called.py_func)
        assert found <= contents(one, ())[1], one


class Pair(NamedTuple):
    low: Any
    high: Any


class Turned(NamedTuple):
    high: Any
    low: Any


# as after an edit: numba gives both types the same name
Turned.__qualname__, Turned.__name__ = Pair.__qualname__, Pair.__name__


def made(
    text: str = 'A * x', *, name: str = 'f', doc: str = '', default: object = None, options: Any = None, **space: Any
) -> Dispatcher:
    """A kernel with these globals."""
    given = {'__name__': __name__, 'A': 2.0, **space}
    exec(f'def {name}(x, y=default):\n    """{doc}"""\n    return {text}\n', {'default': default} | given, given)
    function = given[name]
    return numba.njit(FunctionType(function.__code__, given, name, function.__defaults__), **(options or {}))


def of(*args: Any, **given: Any) -> bytes:
    return contents(made(*args, **given), ())[0]


SQUARE = made('x * x', name='g')
CUBE = made('x * x * x', name='g')
MODULE, OTHER = ModuleType('ours'), ModuleType('ours')
MODULE.A, OTHER.A = 2.0, 3.0  # type: ignore[attr-defined]
DIFFERENT: dict[str, tuple[Any, Any]] = {
    'code': ({'text': 'A * x'}, {'text': 'x * A'}),
    'number in it': ({'text': '2.0 * x'}, {'text': '3.0 * x'}),
    'sign of zero': ({'text': '0.0 * x'}, {'text': '-0.0 * x'}),
    'name': ({'name': 'f'}, {'name': 'h'}),
    'default': ({'default': 1}, {'default': 2}),
    'option': ({'options': {}}, {'options': {'fastmath': True}}),
    'constant': ({'A': 2.0}, {'A': 3.0}),
    'type of a constant': ({'A': 2.0}, {'A': 2}),
    'truth value': ({'A': True}, {'A': 1}),
    'width of a constant': ({'A': np.int32(2)}, {'A': np.int64(2)}),
    'constant of numpy': ({'A': np.float64(2)}, {'A': np.float64(3)}),
    'tuple': ({'text': 'A[0] * x', 'A': (1.0, 2.0)}, {'text': 'A[0] * x', 'A': (2.0, 1.0)}),
    'array': ({'A': np.array([1.0, 2.0])}, {'A': np.array([1.0, 3.0])}),
    'shape of an array': ({'A': np.zeros((2, 3))}, {'A': np.zeros((3, 2))}),
    'type of an array': ({'A': np.zeros(2)}, {'A': np.zeros(2, np.int64)}),
    'order of an array': ({'A': np.zeros((2, 2))}, {'A': np.zeros((2, 2), order='F')}),
    'callee': ({'text': 'g(x)', 'g': SQUARE}, {'text': 'g(x)', 'g': CUBE}),
    'callee of a callee': ({'text': 'A(x)', 'A': made('g(x)', g=SQUARE)}, {'text': 'A(x)', 'A': made('g(x)', g=CUBE)}),
    'which of two callees': ({'text': 'A(g(x))', 'A': SQUARE, 'g': CUBE}, {'text': 'A(g(x))', 'A': CUBE, 'g': SQUARE}),
    'constant of a callee': ({'text': 'g(x)', 'g': made(A=2.0)}, {'text': 'g(x)', 'g': made(A=3.0)}),
    'constant of a module': ({'text': 'm.A * x', 'm': MODULE}, {'text': 'm.A * x', 'm': OTHER}),
    'constant by getattr': ({'text': "getattr(m, 'A') * x", 'm': MODULE}, {'text': "getattr(m, 'A') * x", 'm': OTHER}),
    'fields of a record': ({'text': 'P(x, x)', 'P': Pair}, {'text': 'P(x, x)', 'P': Turned}),
    'function of a library': ({'text': 'A(x)', 'A': math.sin}, {'text': 'A(x)', 'A': math.cos}),
    'exception': ({'A': ValueError}, {'A': KeyError}),
    'set in it': ({'text': 'x in {1, 2}'}, {'text': 'x in {1, 3}'}),
    'inner function': ({'text': '(lambda z: z + 1)(x)'}, {'text': '(lambda z: z + 2)(x)'}),
}


@pytest.mark.parametrize('what', DIFFERENT)
def test_what_decides_about_the_code_makes_another_kernel(what: str) -> None:
    one, other = DIFFERENT[what]
    assert of(**one) != of(**other)
    assert of(**one) == of(**one)


def test_a_closure_is_part_of_the_code() -> None:
    def scaled(factor: float) -> Dispatcher:
        return numba.njit(lambda x: factor * x)

    assert contents(scaled(2.0), ())[0] != contents(scaled(3.0), ())[0]
    assert contents(scaled(2.0), ())[0] == contents(scaled(2.0), ())[0]


def test_documents_places_and_what_nobody_names_make_none() -> None:
    reference = of()
    assert of(doc='In other words.') == reference
    assert of(B=3.0) == reference
    shifted = made()
    shifted.py_func.__code__ = shifted.py_func.__code__.replace(co_firstlineno=500, co_filename='elsewhere.py')
    assert contents(shifted, ())[0] == reference


def test_a_constant_that_changes_in_this_process_is_seen() -> None:
    """Nor is a kernel remembered as what it was: numba freezes what a global is when it compiles."""
    one = made('g(x)', g=made(A=2.0))
    before = contents(one, ())[0]
    callee = one.py_func.__globals__['g'].py_func.__globals__
    callee['A'] = 3.0
    changed = contents(one, ())[0]
    callee['A'] = 2.0
    assert changed != before == contents(one, ())[0]
    numbers = np.array([1.0, 2.0])
    one = made(A=numbers)
    before = contents(one, ())[0]
    numbers[1] = 3.0
    assert contents(one, ())[0] != before
    del callee['A']
    assert contents(made('g(x)', g=made(A=2.0)), ())[0] != contents(one, ())[0]


def emitting(number: float) -> Any:
    @intrinsic
    def emitted(typing_context, x):
        def generate(context, builder, signature, args):
            return builder.fmul(args[0], context.get_constant(types.float64, number))

        return types.float64(types.float64), generate

    return emitted


def test_an_intrinsic_is_known_by_what_emits_its_code() -> None:
    twice, thrice = emitting(2.0), emitting(3.0)
    assert of('g(x)', g=twice) != of('g(x)', g=thrice)
    assert of('g(x)', g=twice) == of('g(x)', g=emitting(2.0))


def test_what_nobody_understands_is_not_kept() -> None:
    for unknown in (SimpleNamespace(a=1), np.array([None]), object(), Path):
        with pytest.raises(Unknown):
            of('A(x)', A=unknown)


def taught(x: float) -> float:
    return x


@overload(taught)
def _taught(x):
    return lambda x: 2.0 * x


def that_calls_it(x):
    return taught(x)


def that_does_not(x):
    return 2.0 * x


@pytest.mark.parametrize(('one', 'kept'), [(that_calls_it, False), (that_does_not, True)])
def test_a_kernel_that_calls_what_numba_was_taught_elsewhere_is_not_kept(one: Any, kept: bool, tmp_path: Path) -> None:
    """No name leads to the function that it is compiled to."""
    fresh = numba.njit(one)
    fresh._cache = KernelCache(fresh, Kernels(SOLVER / 'compiled', tmp_path))
    assert fresh(1.5) == 3.0
    assert len(list(tmp_path.glob('kernels/*'))) == kept


@pytest.mark.parametrize(
    ('one', 'other'),
    [
        (1.0, 1),
        (np.zeros(2), np.zeros((2, 2))),
        (Pair(1.0, 2.0), Turned(1.0, 2.0)),
        (Pair(1.0, 2.0), (1.0, 2.0)),
        (Pair(np.zeros(2), 2.0), Turned(np.zeros(2), 2.0)),
        (Ref(Pair(1.0, 2.0)), Ref(Turned(1.0, 2.0))),
        (Ref(Pair(np.zeros((2, 3)), 2.0)), Ref(Pair(np.zeros((2, 4)), 2.0))),
        (Ref(Pair(Pair(1.0, 2.0), 2.0)), Ref(Pair(Turned(1.0, 2.0), 2.0))),
        (SQUARE, CUBE),
    ],
)
def test_types_of_arguments_make_another_kernel(one: Any, other: Any) -> None:
    """Layouts too, which the name that numba gives to a record does not tell."""
    function = made()
    assert contents(function, [numba.typeof(one)])[0] != contents(function, [numba.typeof(other)])[0]
    assert contents(function, [numba.typeof(one)])[0] == contents(function, [numba.typeof(one)])[0]


def test_types_of_others_are_not_kept() -> None:
    with pytest.raises(Unknown):
        contents(made(), [types.ListType(types.int64)])


# Edits of a program, each run by a process of its own on the kernels of the one before it.

LAW = """
from typing import NamedTuple
from solver.compiled.kernel import kernel

FACTOR = 2.0

class Pair(NamedTuple):
    low: float
    high: float

@kernel(inline=True)
def square(x):
    return x * x
"""
USER = '''
from solver.compiled.kernel import kernel
from solver.elements import law
from solver.elements.law import square

@kernel
def total(x):
    """Of x."""
    return law.FACTOR * square(x)

@kernel
def outer(x):
    return total(x) + 1.0

@kernel
def spread(pair):
    return pair.high - pair.low
'''
OTHER_FILE = """
from solver.compiled.kernel import kernel

@kernel
def other(x):
    return x - 1.0
"""
PROGRAM = """
from solver.compiled.by_reference import Ref
from solver.elements import law, user
pair = law.Pair(low=1.0, high=4.0, **dict.fromkeys(set(law.Pair._fields) - {'low', 'high'}, 0.0))
values = [user.outer(3.0), user.spread(pair), user.spread(Ref(pair))]
try:
    from solver.elements import other
    values.append(other.other(3.0))
except ImportError:
    pass
"""
VALUES = [19.0, 3.0, 3.0, 2.0]
CALLED = {'total', 'outer'}
EVERY = {'square', *CALLED, 'spread', 'other'}
EDITS: dict[str, tuple[tuple[str, str, str] | dict[str, str], list[float], set[str]]] = {
    'nothing': (('law', '', ''), VALUES, set()),
    'constant': (('law', 'FACTOR = 2.0', 'FACTOR = 3.0'), [28.0, *VALUES[1:]], CALLED),
    'type of a constant': (('law', 'FACTOR = 2.0', 'FACTOR = 2'), VALUES, CALLED),
    'callee': (('law', 'x * x', 'x * x * x'), [55.0, *VALUES[1:]], {'square', *CALLED}),
    'option of a callee': (('law', '(inline=True)', '(borrow=True)'), VALUES, {'square', *CALLED}),
    'order of fields': (
        ('law', '    low: float\n    high: float\n', '    high: float\n    low: float\n'),
        VALUES,
        {'spread'},
    ),
    'one more field': (('law', '    low: float\n', '    width: float\n    low: float\n'), VALUES, {'spread'}),
    'caller': (('user', '+ 1.0', '+ 2.0'), [20.0, *VALUES[1:]], {'outer'}),
    'another element': (('other', '- 1.0', '- 2.0'), [*VALUES[:3], 1.0], {'other'}),
    'comment and document': (('user', '    """Of x."""\n', '    """Of a number."""\n    # more\n\n'), VALUES, set()),
    'new code that nobody calls': (('law', 'FACTOR', 'MORE = 5.0\nFACTOR'), VALUES, set()),
    'module gone': (('other', OTHER_FILE, ''), VALUES[:3], set()),
    'optimization': ({'NUMBA_OPT': '1'}, VALUES, EVERY),
    'processor': ({'NUMBA_CPU_NAME': 'generic', 'NUMBA_CPU_FEATURES': ''}, VALUES, EVERY),
}


@pytest.mark.slow
def test_an_edit_compiles_again_what_calls_it_and_nothing_else(tmp_path: Path) -> None:
    files = {'law': LAW, 'user': USER, 'other': OTHER_FILE}
    edited = Edited(tmp_path, files, PROGRAM)
    assert edited.run() == (VALUES, EVERY)
    for what, (edit, values, compiled) in EDITS.items():
        environment = edit if isinstance(edit, dict) else {}
        name, was, becomes = ('law', '', '') if isinstance(edit, dict) else edit
        edited.change(files | {name: files[name].replace(was, becomes) if was else files[name]})
        assert edited.run(**environment) == (values, compiled), what
    edited.change(files)
    assert edited.run() == (VALUES, set())
