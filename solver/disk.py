"""Everything that is kept on disk: files that are whole or not there, stores, locks, digests of sources, JSON.

A *store* is a directory of values under names. A value is named after all that it depends on, so none is ever out of
date. Its file begins with a proof, a digest of that and of the content, so a damaged one is as good as none. Files
appear by renaming and need no other file: processes read, write and remove them at the same time, and whoever is
killed, or finds the disk full, leaves what was there before.
"""

from __future__ import annotations

import ast
import fcntl
import functools
import hashlib
import json
import math
import os
import shutil
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from stat import S_ISREG
from typing import Any

from solver.errors import BagError

DIGEST = 16  # bytes of a digest; ten times as many would prove no more
PROOF = 2 * DIGEST + 1  # bytes at the beginning of a file: the digest in hexadecimal, and the end of the line
PART = '.part'  # in the name of a file that is not whole yet
USED = 3600.0  # s: a use is noted at most so often; ten times as much would come near YOUNG
YOUNG = 86400.0  # s: what was used since is never removed; ten times as much keeps the kernels of every edit of a week
KEPT = 30 * 86400.0  # s: what was not used since is removed; ten times as much fills disks with what nobody remembers
SIZE = 1 << 29  # bytes of a store: above it what was used longest ago is removed; ten times as much fills small disks
ATTEMPTS = 10  # to write a file while another process removes the directory


def location() -> Path:
    """Directory of all stores: MBD_CACHE_DIR, or the user's directory for caches."""
    given = os.environ.get('MBD_CACHE_DIR')
    if given:
        return Path(given).absolute()
    try:
        home = Path.home()
    except RuntimeError:  # a user without a home
        home = Path('/')
    return Path(os.environ.get('XDG_CACHE_HOME') or home / '.cache') / 'mbd_sim_ros'


def digest(*parts: bytes | str) -> bytes:
    """Digest of the parts in this order, each with its length; text as UTF-8."""
    found = hashlib.blake2b(digest_size=DIGEST)
    for part in parts:
        part = part.encode() if isinstance(part, str) else part
        found.update(len(part).to_bytes(8, 'little'))
        found.update(part)
    return found.digest()


@contextmanager
def atomic_write(file: Path) -> Iterator[Path]:
    """Path to write to; its content replaces `file` when the block ends. A process that is killed meanwhile, or finds
    the disk full, leaves `file` as it was.

    The target of a link is replaced, not the link. A device cannot be replaced, and is written to directly.
    """
    place = Path(os.path.realpath(file))
    if place.exists() and not place.is_file():
        yield place
        return
    part = place.with_name(f'.{os.urandom(16).hex()}{PART}{place.suffix[:20]}')  # some writers go by the ending
    try:
        yield part
        part.replace(place)
    finally:
        with suppress(OSError):  # it tells of the first error, not of the second
            part.unlink(missing_ok=True)


class Store:
    """A directory of values, made with the first one. bounded: what nobody uses is removed before the first write
    (prune). damaged: names of files that did not fit."""

    def __init__(self, directory: Path, *, bounded: bool = False) -> None:
        self.directory = directory
        self.damaged: set[str] = set()
        self._bounded = bounded

    def read(self, name: str, *identity: bytes | str) -> bytes | None:
        """The value of this name that depends on `identity`; None where there is none that fits."""
        path = self.directory / name
        try:
            with path.open('rb') as file:
                stat = os.fstat(file.fileno())
                data = file.read() if S_ISREG(stat.st_mode) else b''
                if time.time() - stat.st_mtime > USED:
                    with suppress(OSError):  # a store that can only be read
                        os.utime(path)
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError:
            data = b''
        content = data[PROOF:]
        if data[:PROOF] == _proof(identity, content):
            return content
        self.damaged.add(name)
        return None

    def write(self, name: str, content: bytes, *identity: bytes | str) -> None:
        """Keep a value. Raises OSError."""
        path = self.directory / name
        for attempt in range(1, ATTEMPTS + 1):
            try:
                self.directory.mkdir(parents=True, exist_ok=True)
                if self._bounded:
                    self._bounded = False
                    self.prune()
                if path.is_symlink():  # nothing that this store has made
                    path.unlink()
                elif path.is_dir():
                    shutil.rmtree(path)
                with atomic_write(path) as part:
                    part.write_bytes(_proof(identity, content) + content)
                return
            except (FileNotFoundError, FileExistsError):  # another process removed the directory just now
                if attempt == ATTEMPTS:
                    raise

    def made(self, name: str, make: Callable[[], Any], *identity: bytes | str) -> Any:
        """The value of this name, kept or made, as JSON holds it: tuples are lists, floats keep their bits.

        It is made every time if nothing can be written. Raises TypeError and ValueError for what JSON does not hold.
        """
        content = self.read(name, *identity)
        if content is None:
            content = json.dumps(make(), allow_nan=False).encode()
            with suppress(OSError):
                self.write(name, content, *identity)
        return json.loads(content)

    def prune(self) -> None:
        """Remove what was not used for KEPT and, above SIZE, what was used longest ago; never what is YOUNG."""
        now, found = time.time(), []
        for path in self.directory.iterdir():
            with suppress(OSError):  # another process removes it too
                stat = path.stat()
                if path.is_file():
                    found.append((now - stat.st_mtime, stat.st_size, path))
        left = sum(size for _, size, _ in found)
        for age, size, path in sorted(found, reverse=True):
            if age > KEPT or (age > YOUNG and (left > SIZE or PART in path.name)):
                with suppress(OSError):
                    path.unlink()
                    left -= size


def store_of(name: str) -> Store:
    """The bounded store of this name below location(). It is one for the process, which looks for what is old once and
    not with every value: to look takes a system call for each file.
    """
    return _bounded(location() / name)


@functools.cache
def _bounded(directory: Path) -> Store:
    return Store(directory, bounded=True)


def derived(what: str, subject: str, make: Callable[[], Any]) -> Any:
    """A value that takes a while to derive, made once (Store.made). what: names the kind of data, and the file.
    subject: says all that it depends on besides the sources of the solver, e.g. repr() of a ModelSpec."""
    identity = sources(), what, subject
    return store_of('levels').made(f'{what}-{digest(*identity).hex()}.json', make, *identity)


def _proof(identity: Iterable[bytes | str], content: bytes) -> bytes:
    return digest(*identity, content).hex().encode() + b'\n'


@contextmanager
def alone(directory: Path) -> Iterator[None]:
    """A directory, made where it is not there, in which no other command goes on meanwhile; a process that dies lets go
    of it.

    Raises BagError.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        file = (directory / '.lock').open('a')
    except OSError as error:
        raise BagError(f'--out {directory}: {error.strerror}; choose another place') from None
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BagError(
                f'--out {directory}: another mbd is at work there; wait for its end, or choose another place'
            ) from None
        except OSError:  # a file system without locks
            pass
        yield


@functools.cache
def sources(*places: Path, suffixes: tuple[str, ...] = ('.py',)) -> str:
    """A digest, in 32 hexadecimal digits, of all files with these endings at or below the places: by default of the
    solver."""
    parts: list[bytes] = []
    for top in places or (Path(__file__).parent,):
        files = [path for path in sorted(top.rglob('*')) if path.suffix in suffixes] if top.is_dir() else [top]
        for path in files:
            parts += [path.relative_to(top.parent).as_posix().encode(), path.read_bytes()]
    return digest(*parts).hex()


def syntax(text: bytes) -> bytes:
    """Syntax tree of a source file, without docstrings, comments and places."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
            and ast.get_docstring(node, clean=False) is not None
        ):
            del node.body[0]
    return ast.dump(tree).encode()


def plain(value: Any) -> Any:
    """A value as JSON can hold it: numbers of numpy as numbers, those that are not finite as null, all else as text."""
    if isinstance(value, dict):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    if hasattr(value, 'item'):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if isinstance(value, str | int | float | bool | None) else str(value)
