"""Compiled kernels on disk: one file per kernel, types of its arguments and all that its code was made of.

numba's own cache looks at the file of a function alone, trusts what it reads, and of two processes that compile at once
one may write its code under the other's signature. This one takes its place
(docs/decisions/0021-kernels-by-content.md). A file is named after a digest of what the code is made of
(solver.compiled.contents) and of what the code of every kernel depends on: the syntax of the files in this folder,
which extend the compiler, versions, settings of numba and the processor.
"""

from __future__ import annotations

import pickle
import platform
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core import sigutils, types
from numba.core.caching import _Cache
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

from solver import disk
from solver.compiled import interruption
from solver.compiled.contents import Unknown, contents, foreign

# of numba
SETTINGS = (
    'OPT',
    'LOOP_VECTORIZE',
    'SLP_VECTORIZE',
    'BOUNDSCHECK',
    'DEBUGINFO_DEFAULT',
    'USING_SVML',
    'LLVM_REFPRUNE_PASS',
)


class Compiler:
    """The files in a folder that extend numba. key: a digest of them, as they were when the process began, and of
    settings."""

    def __init__(self, folder: Path, base: Path) -> None:
        self._folder, self._letters = folder, _letters(folder)

        def key() -> str:  # takes 50 ms, so it is remembered by the letters of the files
            paths = sorted(folder.glob('*.py'))
            return _digest(part for path in paths for part in (path.name, disk.syntax(path.read_bytes())))

        self.key: str = disk.Store(base / 'syntax', bounded=True).made(self._letters, key, self._letters)

    def unchanged(self) -> bool:
        """True where every file is still the one that the key was made of."""
        return self._letters == _letters(self._folder)


def _letters(folder: Path) -> str:
    return _digest(part for path in sorted(folder.glob('*.py')) for part in (path.name, path.read_bytes()))


def _digest(parts: Iterable[str | bytes]) -> str:
    return disk.digest(repr(_surroundings()), *parts).hex()


def _surroundings() -> tuple:
    """Versions and settings that decide about the code, besides the processor."""
    versions = (
        numba.__version__,
        llvmlite.__version__,
        np.__version__,
        platform.python_implementation(),
        sys.version_info[:3],
    )
    return (*versions, sys.flags.optimize, *((name, getattr(numba.config, name, None)) for name in SETTINGS))


class Kernels:
    """The kernels that are kept: what their files hold, and whether they can be written. unkept: why not."""

    def __init__(self, folder: Path, base: Path) -> None:
        self.compiler = Compiler(folder, base)
        self.store = disk.Store(base / 'kernels', bounded=True)
        self.unkept = ''
        self._fresh: bool | None = None
        self._told = False

    def read(self, name: str, identity: bytes) -> Any:
        """The content of a file, or None where there is none that fits."""
        if self._fresh is None:
            self._fresh = self.compiler.unchanged()
        if not self._fresh:  # edited since the process began: which edit it imported nobody knows
            return None
        content = self.store.read(name, identity)
        try:
            return None if content is None else pickle.loads(content)
        except Exception:  # whole, and yet nothing that can be unpickled
            self.store.damaged.add(name)
            return None

    def write(self, name: str, identity: bytes, value: Any) -> None:
        """Keep a value under this name, or say once why it cannot be kept."""
        if self.unkept or self._fresh is False or not self.compiler.unchanged():
            return
        try:
            self.store.write(name, dumps(value), identity)
        except OSError as error:
            self.unkept = (
                f'compiled kernels cannot be kept in {self.store.directory} ({error.strerror or error}): every start '
                'compiles them anew; set MBD_CACHE_DIR to a directory with space that can be written'
            )
            print(f'mbd: {self.unkept}', file=sys.stderr, flush=True)
            return
        if name in self.store.damaged and not self._told:
            self._told = True
            print(f'mbd: {self.store.directory / name} was damaged; compiled anew', file=sys.stderr, flush=True)


class KernelCache(_Cache):
    """Cache from which a dispatcher of numba takes compiled code, and in which it puts it."""

    def __init__(self, dispatcher: Any, kernels: Kernels) -> None:
        self._dispatcher, self._kernels = dispatcher, kernels
        self._asked: dict[Any, bytes] = {}  # identities of what is compiled now, by signature
        plain = ''.join(c for c in f'{dispatcher.__module__}.{dispatcher.__qualname__}' if c.isalnum() or c in '._')
        self._prefix = plain.removeprefix('solver.')[-150:]

    @property
    def cache_path(self) -> str:
        return str(self._kernels.store.directory)

    def load_overload(self, sig, target_context):
        """The compiled kernel for this signature, or None."""
        interruption.check()
        target_context.refresh()
        identity, _ = self._made_of(sig, target_context.codegen())
        if identity is None:
            return None
        self._asked[sig] = identity
        found = self._kernels.read(self._file(identity), identity)
        if found is None:
            return None
        try:
            return CompileResult._rebuild(target_context, *found)
        except Exception:  # whole, but not what numba takes for code
            self._kernels.store.damaged.add(self._file(identity))
            return None

    def save_overload(self, sig, data) -> None:
        """Keep the compiled kernel, unless it is bound to this process, has changed meanwhile, or calls what its
        identity lacks."""
        identity, kernels = self._made_of(sig, data.codegen)
        inferred = data.type_annotation.typemap.values()
        called = {kind.dispatcher for kind in inferred if isinstance(kind, types.Dispatcher)}
        bound = data.library.has_dynamic_globals or data.lifted or any(map(foreign, inferred))
        if identity is not None and identity == self._asked.pop(sig, None) and called <= kernels and not bound:
            self._kernels.write(self._file(identity), identity, data._reduce())
        interruption.check()

    def enable(self) -> None:
        """Nothing to do, as for the others: it is in use, and what is compiled anew replaces its file."""

    disable = flush = enable

    def _made_of(self, sig, codegen) -> tuple[bytes | None, set[Any]]:
        """(identity of the compiled kernel, kernels in it); None of one that is not kept."""
        if self._dispatcher.__module__ == '__main__':  # of which every program has another one
            return None, set()
        try:
            made_of, kernels = contents(self._dispatcher, sigutils.normalize_signature(sig)[0])
        except Unknown:
            return None, set()
        return disk.digest(self._kernels.compiler.key, made_of, repr(codegen.magic_tuple())), kernels

    def _file(self, identity: bytes) -> str:
        return f'{self._prefix}-{identity.hex()}'
