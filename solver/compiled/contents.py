"""Contents of a kernel, by value, from which its machine code follows: its bytecode, options and constants, and those
of its callees.

numba compiles the bytecode that is in memory, puts callees into it, and freezes the globals that it names at what they
are then. This module looks at the same objects, so it reads no sources. A kernel that names something else than is
understood here is not kept (Unknown). The name is enough of extensions of the compiler in this folder: the cache knows
their files, since no name leads from `a + b` to what adds two duals.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterable
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba.core import types
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic

from solver import disk

NUMBERS = (bool, int, float, complex, str, bytes, type(None), type(...))
# their versions are in the key
LIBRARIES = ('builtins', 'math', 'cmath', '_operator', 'operator', 'numpy', 'numba', 'llvmlite')
HERE = __name__.rpartition('.')[0] + '.'
SIMPLE = (types.Number, types.Boolean, types.Array, types.NoneType, types.Literal, types.Omitted, types.UnicodeType)
MISSING = object()


class Unknown(Exception):
    """Nobody can say if something has changed that a kernel names."""


def contents(kernel: Dispatcher, arguments: Iterable[types.Type]) -> tuple[bytes, set[Dispatcher]]:
    """(a digest of what the code of a kernel for these types is made of, the kernels in it). Raises Unknown."""
    first = _Node()
    first.own = disk.digest(repr([first.value(kernel), *map(first.type, arguments)]))
    nodes, places, parts = [first], dict[Any, int](), list[bytes]()
    for node in nodes:  # which become more meanwhile
        for called in node.calls:
            if called not in places:
                places[called] = len(nodes)
                nodes.append(_node(called))
        parts += [node.own, repr([places[called] for called in node.calls]).encode()]
    return disk.digest(*parts), {called for called in places if isinstance(called, Dispatcher)}


def foreign(kind: types.Type) -> bool:
    """True for the type of a function that numba was taught elsewhere: no name leads to the code that it is compiled
    to."""
    function = kind.typing_key if isinstance(kind, types.Function) else None
    module = getattr(function, '__module__', None) or 'builtins'
    return isinstance(function, FunctionType) and not _of_library(module) and not module.startswith(HERE)


class _Node:
    """A function by value. own: a digest of all but what it calls. calls: kernels, intrinsics and functions, numbered
    in own."""

    def __init__(self) -> None:
        self.own = b''
        self.calls: list[Any] = []
        self._seen: list[tuple[dict[str, Any], str, Any]] = []  # (namespace, name, object) of all that was looked at
        self._lasting = True
        self._emits = False  # it is not compiled, but makes code

    def look(self, called: Any) -> None:
        """Describe a kernel, an intrinsic, or a function that makes code."""
        self._emits = not isinstance(called, Dispatcher)
        function, options = called, ''
        if isinstance(called, Dispatcher):
            function, options = called.py_func, repr((sorted(called.targetoptions.items()), called.locals))
        elif isinstance(called, _Intrinsic):
            function, options = called._defn, repr((called._prefer_literal, called._ctor_kwargs))
        cells = [self.value(cell.cell_contents) for cell in function.__closure__ or ()]
        self._lasting = not cells
        own = (function.__module__, function.__qualname__, options, _code(function.__code__, function.__doc__), cells)
        named = self._named(function.__code__, function.__globals__)
        self.own = disk.digest(repr((*own, self.value(function.__defaults__), named)))

    def lasts(self) -> bool:
        """True where all names still mean the same objects, and none of these can change."""
        return self._lasting and all(space.get(name, MISSING) is value for space, name, value in self._seen)

    def _named(self, code: CodeType, space: dict[str, Any], *inside: ModuleType) -> list[Any]:
        """Meanings of the names in a function in a module. Attributes count as names: a coincidence compiles once too
        often."""
        found = []
        for name in sorted(_names(code)):
            value = space.get(name, MISSING)  # a name of Python's own, or an attribute
            self._seen.append((space, name, value))
            if isinstance(value, ModuleType) and not _of_library(value.__name__):
                if value not in inside:
                    found.append((name, self._named(code, vars(value), *inside, value)))
            elif value is not MISSING:
                found.append((name, self.value(value)))
        return found

    def value(self, value: Any) -> Any:
        """Properties of a global or constant that decide about the code. Raises Unknown."""
        kind = type(value)
        if kind in NUMBERS:
            return kind.__name__, repr(value)
        if isinstance(value, np.generic):
            return str(value.dtype), value.tobytes()
        if isinstance(value, np.ndarray) and not value.dtype.hasobject:
            self._lasting = False
            return repr(value.dtype), value.shape, value.strides, value.flags.num, value.tobytes()
        if isinstance(value, tuple | list | set | frozenset | dict):
            self._lasting &= isinstance(value, tuple | frozenset)
            parts = [self.value(one) for one in (value.items() if isinstance(value, dict) else value)]
            return self.value(kind), sorted(parts, key=repr) if isinstance(value, set | frozenset) else parts
        if isinstance(value, types.Type):
            return self.type(value)
        module, name = getattr(value, '__module__', None) or kind.__module__, getattr(value, '__qualname__', '')
        if isinstance(value, ModuleType):
            return value.__name__
        if isinstance(value, type) and issubclass(value, tuple) and hasattr(value, '_fields'):
            return module, name, value._fields, self.value(getattr(value, '_field_defaults', {}))
        ours = not _of_library(module) and not module.startswith(HERE)
        # no kernel calls a plain function (foreign)
        followed = _Intrinsic | FunctionType if self._emits else _Intrinsic
        if isinstance(value, Dispatcher) or (isinstance(value, followed) and ours):
            if value not in self.calls:
                self.calls.append(value)
            return 'calls', self.calls.index(value)
        if name and (
            not ours or isinstance(value, FunctionType) or (isinstance(value, type) and issubclass(value, Exception))
        ):
            return module, name
        told = isinstance(value, np.ufunc | np.dtype) or kind.__module__.partition('.')[0] in ('llvmlite', 'numba')
        if told and ' at 0x' not in (text := str(value)):
            return kind.__module__, kind.__qualname__, text
        raise Unknown(f'{value!r} of {kind.__module__}.{kind.__qualname__}')

    def type(self, kind: types.Type) -> Any:
        """Properties of the type of an argument that decide about the code. Raises Unknown."""
        if isinstance(kind, types.BaseNamedTuple):
            return self.value(kind.instance_class), [self.type(one) for one in kind.types]
        if isinstance(kind, types.BaseTuple):
            return [self.type(one) for one in kind.types]
        if isinstance(kind, types.Dispatcher):
            return self.value(kind.dispatcher)
        # the name of a RefType has a digest of its layout
        if isinstance(kind, SIMPLE) or type(kind).__module__.startswith(HERE):
            return str(kind)
        raise Unknown(str(kind))


_nodes: weakref.WeakKeyDictionary[Any, _Node] = weakref.WeakKeyDictionary()


def _node(called: Any) -> _Node:
    node = _nodes.get(called)
    if node is None or not node.lasts():
        node = _Node()
        node.look(called)
        _nodes[called] = node
    return node


def _of_library(module: str) -> bool:
    return module.partition('.')[0] in LIBRARIES


def _names(code: CodeType) -> set[str]:
    """All that it may look up: names, and texts, which getattr() takes."""
    inner = (_names(c) for c in code.co_consts if isinstance(c, CodeType))
    return {*code.co_names, *(c for c in code.co_consts if isinstance(c, str))}.union(*inner)


def _code(part: Any, docstring: str | None = None) -> Any:
    """All of a function, or of a constant in it, but its place and its docstring."""
    if not isinstance(part, CodeType):
        return sorted(map(repr, part)) if isinstance(part, frozenset) else repr(part)
    constants = [_code(c) for c in part.co_consts if docstring is None or c != docstring]
    variables = (part.co_names, part.co_varnames, part.co_freevars, part.co_cellvars)
    counts = (part.co_argcount, part.co_posonlyargcount, part.co_kwonlyargcount, part.co_flags)
    return part.co_name, part.co_code, part.co_exceptiontable, constants, variables, counts
