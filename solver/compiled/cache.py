"""Compiled kernels on disk: one file per kernel and signature, in a directory named after the sources of all kernels.

numba's own cache looks at the file of a function alone, not at its callees; it trusts what it reads, so that a damaged file ends the
program or computes other numbers; and of two processes that compile at once one may write its code under the other's signature. This one
takes numba's place behind every kernel (docs/decisions/0009-kernel-cache.md):

- The directory is `kernels-<key>`, the key a hash of the syntax of every file in FOLDERS, without docstrings and comments, and of what
  else decides about the code (versions, settings of numba). No path and no time goes into it: every checkout of the same content shares it.
- A file is named after the kernel and a hash of its bytecode, its signature and the processor, and begins with a digest of that hash and
  of its content. A file that does not fit is as good as none: the kernel is compiled anew and the file replaced.
- Files appear whole, by renaming, and depend on no other file. So processes may write, read and remove them at the same time.
- Where nothing can be written, kernels stay in memory, and one line on stderr says so.
"""

from __future__ import annotations

import ast
import hashlib
import os
import pickle
import platform
import shutil
import sys
import time
import uuid
from contextlib import suppress
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core import sigutils
from numba.core.caching import NullCache, _Cache
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

from solver.compiled import interruption

FOLDERS = ('compiled', 'elements', 'linear', 'model', 'output', 'start', 'step')  # those with kernels, and all that kernels take from
SETTINGS = ('OPT', 'LOOP_VECTORIZE', 'SLP_VECTORIZE', 'BOUNDSCHECK', 'DEBUGINFO_DEFAULT', 'USING_SVML', 'LLVM_REFPRUNE_PASS')  # of numba
KEPT = 3  # directories that stay when a new one is made,
KEPT_SECONDS = 86400.0  # and all that were used within this time: whoever works on several checkouts needs more
DIGEST = 16  # bytes
ATTEMPTS = 10  # to write a file while another process removes the directory


def location() -> Path:
    """Where caches live: MBD_CACHE_DIR, or the user's directory for caches."""
    given = os.environ.get('MBD_CACHE_DIR')
    if given:
        return Path(given).absolute()
    try:
        home = Path.home()
    except RuntimeError:  # a user without a home
        home = Path('/')
    return Path(os.environ.get('XDG_CACHE_HOME') or home / '.cache') / 'mbd_sim_ros'


def digest(*parts: bytes) -> bytes:
    """Of the parts in this order."""
    found = hashlib.blake2b(digest_size=DIGEST)
    for part in parts:
        found.update(len(part).to_bytes(8, 'little'))
        found.update(part)
    return found.digest()


class Sources:
    """The files that decide about the code of kernels, as they were when the process began.

    key: their hash. base: where a key may be remembered by the bytes of the files, since parsing them takes 0.3 s.
    """

    def __init__(self, root: Path, base: Path) -> None:
        paths = sorted(path for folder in FOLDERS for path in (root / folder).glob('**/*.py'))
        self.stamps = {str(path): _stamp(str(path)) for path in paths}  # before they are read
        contents = {path.relative_to(root).as_posix(): path.read_bytes() for path in paths}
        self.key = self._remembered(contents, base)

    def unchanged(self, path: str | None = None) -> bool:
        """Whether one file, or every one, is still what the key was made of."""
        names = self.stamps if path is None else [path]
        return all(self.stamps[name] == _stamp(name) for name in names)

    def _remembered(self, contents: dict[str, bytes], base: Path) -> str:
        surroundings = repr(_surroundings()).encode()
        name = digest(surroundings, *(part for path, text in contents.items() for part in (path.encode(), text))).hex()
        note = base / f'syntax-{name}'
        with suppress(OSError, ValueError):
            key, proof = note.read_text(encoding='ascii').split()
            if proof == digest(name.encode(), key.encode()).hex():
                os.utime(note)
                return key
        key = digest(surroundings, *(part for path, text in contents.items() for part in (path.encode(), syntax(text)))).hex()
        with suppress(OSError):
            base.mkdir(parents=True, exist_ok=True)
            _replace(note, f'{key} {digest(name.encode(), key.encode()).hex()}'.encode())
            _prune(base, 'syntax-*')
        return key


def syntax(text: bytes) -> bytes:
    """What Python makes of a source file, without docstrings, comments and places."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node, clean=False) is not None:
            del node.body[0]
    return ast.dump(tree).encode()


def _surroundings() -> tuple:
    """What else decides about the code, besides the processor, which every file's name has."""
    versions = (numba.__version__, llvmlite.__version__, np.__version__, platform.python_implementation(), sys.version_info[:3])
    return (*versions, sys.flags.optimize, *((name, getattr(numba.config, name, None)) for name in SETTINGS))


def _stamp(path: str) -> tuple[int, ...]:
    try:
        found = os.stat(path)
    except OSError:
        return ()
    return found.st_mtime_ns, found.st_size, found.st_ino


def _replace(path: Path, content: bytes) -> None:
    """Let a file appear whole, whatever was there before. Raises OSError."""
    fresh = path.with_name(f'.{uuid.uuid4().hex}.tmp')
    try:
        fresh.write_bytes(content)
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        fresh.replace(path)
    except BaseException:
        with suppress(OSError):
            fresh.unlink()
        raise


def _prune(base: Path, pattern: str) -> None:
    """Remove what nobody used lately. A process that still uses it makes it anew."""

    def used(path: Path) -> float:
        with suppress(OSError):  # another process removes it too
            return path.stat().st_mtime
        return 0.0

    found = sorted(((used(path), path) for path in base.glob(pattern)), reverse=True)
    for when, path in found[KEPT:]:
        if time.time() - when > KEPT_SECONDS:
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)


class Store:
    """The directory of this process: what its files hold, and whether it can be written."""

    def __init__(self, root: Path, base: Path) -> None:
        self.sources = Sources(root, base)
        self.directory = base / f'kernels-{self.sources.key}'
        self.unkept = ''  # why nothing can be written
        self._fresh: bool | None = None
        self._damaged: set[str] = set()
        self._told = False
        with suppress(OSError):
            os.utime(self.directory)

    def holds(self, function: FunctionType) -> bool:
        """Whether the kernel of this function may be kept: the key covers its file, it closes over nothing."""
        path = function.__code__.co_filename
        if path not in self.sources.stamps or function.__closure__ is not None:
            return False
        if not self.sources.unchanged(path):
            self._fresh = False
        return True

    def read(self, name: str, identity: bytes) -> Any:
        """The content of a file, or None where there is none that fits."""
        if self._fresh is None:
            self._fresh = self.sources.unchanged()
        if not self._fresh:  # edited since the process began: which edit it imported nobody knows
            return None
        try:
            data = (self.directory / name).read_bytes()
            if data[:DIGEST] == digest(identity, data[DIGEST:]):
                return pickle.loads(memoryview(data)[DIGEST:])
        except (FileNotFoundError, NotADirectoryError):
            return None
        except Exception:  # unreadable, or whole and yet nothing that can be unpickled
            pass
        self._damaged.add(name)
        return None

    def refuse(self, name: str) -> None:
        """What read() gave is of no use."""
        self._damaged.add(name)

    def write(self, name: str, identity: bytes, value: Any) -> None:
        """Keep a value under this name, or say once why it cannot be kept."""
        if self.unkept or self._fresh is False or not self.sources.unchanged():
            return
        content = dumps(value)
        try:
            self._write(name, digest(identity, content) + content)
        except OSError as error:
            self.unkept = (
                f'compiled kernels cannot be kept in {self.directory} ({error.strerror or error}): every start compiles them anew; '
                'set MBD_CACHE_DIR to a directory with space that can be written'
            )
            print(f'mbd: {self.unkept}', file=sys.stderr, flush=True)
            return
        if name in self._damaged and not self._told:
            self._told = True
            print(f'mbd: {self.directory / name} was damaged; compiled anew', file=sys.stderr, flush=True)

    def _write(self, name: str, content: bytes) -> None:
        for attempt in range(1, ATTEMPTS + 1):
            try:
                new = not self.directory.is_dir()
                self.directory.mkdir(parents=True, exist_ok=True)
                if new:
                    _prune(self.directory.parent, 'kernels-*')
                return _replace(self.directory / name, content)
            except (FileNotFoundError, FileExistsError):  # another process removed the directory just now
                if attempt == ATTEMPTS:
                    raise


class KernelCache(_Cache):
    """What a dispatcher of numba asks for compiled code and gives it to."""

    def __init__(self, function: FunctionType, store: Store) -> None:
        self._store = store
        self._enabled = True
        self._function = repr((function.__module__, function.__qualname__, _code(function.__code__, function.__doc__)))
        plain = ''.join(c for c in f'{function.__module__}.{function.__qualname__}' if c.isalnum() or c in '._')
        self._prefix = plain.removeprefix('solver.')

    @property
    def cache_path(self) -> str:
        return str(self._store.directory)

    def load_overload(self, sig, target_context):
        """The compiled kernel for this signature, or None."""
        interruption.check()
        target_context.refresh()
        if not self._enabled:
            return None
        name, identity = self._name(sig, target_context.codegen())
        found = self._store.read(name, identity)
        if found is None:
            return None
        try:
            return CompileResult._rebuild(target_context, *found)
        except Exception:  # whole, but not what numba takes for code
            self._store.refuse(name)
            return None

    def save_overload(self, sig, data) -> None:
        """Keep the compiled kernel, unless it is bound to this process (addresses in its code)."""
        if self._enabled and not data.library.has_dynamic_globals and all(code.can_cache for code in data.lifted):
            name, identity = self._name(sig, data.codegen)
            self._store.write(name, identity, data._reduce())
        interruption.check()

    def enable(self) -> None:
        self._enabled = True

    def disable(self) -> None:
        self._enabled = False

    def flush(self) -> None:
        """Nothing to do: what is compiled anew replaces its file."""

    def _name(self, sig, codegen) -> tuple[str, bytes]:
        arguments, result = sigutils.normalize_signature(sig)
        identity = digest(repr((self._function, arguments, result, codegen.magic_tuple())).encode())
        return f'{self._prefix}-{identity.hex()}', identity


def _code(code: CodeType, docstring: str | None) -> tuple:
    """What tells a function from another one of the same name in the same file: all but its place and its docstring."""
    constants = tuple(_code(c, None) if isinstance(c, CodeType) else repr(c) for c in code.co_consts if docstring is None or c != docstring)
    return code.co_name, code.co_code, constants, code.co_names, code.co_varnames, code.co_freevars


def cache_of(function: FunctionType, store: Store) -> _Cache:
    """The cache behind a kernel; none for one outside of FOLDERS, of whose callees the key knows nothing."""
    return KernelCache(function, store) if store.holds(function) else NullCache()
