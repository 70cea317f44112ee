"""Compiled kernels on disk: one file per kernel, types of its arguments and all that its code was made of.

numba's own cache looks at the file of a function alone, trusts what it reads, and of two processes that compile at once
one may write its code under the other's signature. This one takes its place
(docs/decisions/0021-kernels-by-content.md). A file is named after a digest of what the code is made of
(solver.compiled.contents) and of what the code of every kernel depends on: the syntax of the files in this folder,
which extend the compiler, versions, settings of numba and the processor.

A wheel brings kernels for every processor with AVX2 and FMA (.ci/wheel): what is not kept for this one is taken from
there where it fits, and nothing is compiled then.
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
from solver.compiled.target import V3, runs_v3

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
        np.__version__.split('.')[:2],
        platform.python_implementation(),
        sys.version_info[:2],  # bytecode is part of what a kernel is made of
    )
    return (*versions, sys.flags.optimize, *((name, getattr(numba.config, name, None)) for name in SETTINGS))


class Kernels:
    """The kernels that are kept: what their files hold, and whether they can be written.

    unkept: why not. shipped: directory of kernels that came with the program. used: files that were read or written.
    """

    def __init__(self, folder: Path, base: Path, shipped: Path = Path('/nowhere')) -> None:
        self.compiler = Compiler(folder, base)
        self.store = disk.Store(base / 'kernels', bounded=True)
        self.shipped = disk.Store(shipped) if shipped.is_dir() and runs_v3() else None
        self.used: set[str] = set()
        self.unkept = ''
        self._fresh: bool | None = None
        self._told = False

    def read(self, name: str, identity: bytes, *, shipped: bool = False) -> Any:
        """The content of a file, or None where there is none that fits. shipped: of one that came with the program."""
        store = self.shipped if shipped else self.store
        if self._fresh is None:
            self._fresh = self.compiler.unchanged()
        if not self._fresh or store is None:  # edited since the process began: which edit it imported nobody knows
            return None
        content = store.read(name, identity)
        try:
            found = None if content is None else pickle.loads(content)
        except Exception:  # whole, and yet nothing that can be unpickled
            store.damaged.add(name)
            return None
        if found is not None:
            self.used.add(name)
        return found

    def write(self, name: str, identity: bytes, value: Any) -> None:
        """Keep a value under this name, or say once why it cannot be kept."""
        if self.unkept or self._fresh is False or not self.compiler.unchanged():
            return
        try:
            self.store.write(name, dumps(value), identity)
            self.used.add(name)
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
        codegen, kernels = target_context.codegen(), self._kernels
        identity, _ = self._made_of(sig, codegen)
        if identity is None:
            return None
        self._asked[sig] = identity
        found = kernels.read(self._file(identity), identity)
        if found is None and kernels.shipped is not None:
            anywhere, _ = self._made_of(sig, codegen, V3)
            found = None if anywhere is None else kernels.read(self._file(anywhere), anywhere, shipped=True)
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

    def _made_of(self, sig, codegen, processor: tuple[str, str] | None = None) -> tuple[bytes | None, set[Any]]:
        """(identity of the compiled kernel, kernels in it); None of one that is not kept. processor: another one, name
        and features as LLVM says them."""
        if self._dispatcher.__module__ == '__main__':  # of which every program has another one
            return None, set()
        try:
            made_of, kernels = contents(self._dispatcher, sigutils.normalize_signature(sig)[0])
        except Unknown:
            return None, set()
        triple, *here = codegen.magic_tuple()
        machine = (triple, *(processor or here))
        return disk.digest(self._kernels.compiler.key, made_of, repr(machine)), kernels

    def _file(self, identity: bytes) -> str:
        return f'{self._prefix}-{identity.hex()}'
