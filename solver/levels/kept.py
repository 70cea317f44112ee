"""Derived data on disk, beside the compiled kernels: what takes a while to derive is derived once.

A file holds one value, as JSON, and is named after what it was derived from and the sources of the solver, so nothing in it can be out of
date; it begins with a digest of its content, and one that does not fit is as good as none. Numbers come back with the same bits. Where
nothing can be written, everything is derived anew at every start.
"""

from __future__ import annotations

import functools
import json
import os
import time
import uuid
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from solver.compiled.cache import digest, location

KEPT_SECONDS = 30 * 86400.0  # files that nobody used for so long are removed when a new one is made


def kept(what: str, subject: str, make: Callable[[], Any]) -> Any:
    """The value that `make` derives from `subject`, made or read: lists, mappings with keys of text, text, numbers, truth values, None.

    what: names the kind of data, and the file. subject: text that says everything the value depends on besides the sources of the
    solver, e.g. repr() of a ModelSpec. The value is what JSON makes of it, also when it is fresh (tuples are lists).
    """
    identity = digest(sources(), what.encode(), subject.encode())
    path = location() / 'levels' / f'{what}-{identity.hex()}.json'
    with suppress(OSError, ValueError):
        proof, _, text = path.read_text(encoding='ascii').partition('\n')
        if proof == digest(identity, text.encode()).hex():
            os.utime(path)
            return json.loads(text)
    text = json.dumps(make(), allow_nan=False)
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        _prune(path.parent)
        fresh = path.with_name(f'.{uuid.uuid4().hex}.tmp')
        try:
            fresh.write_text(f'{digest(identity, text.encode()).hex()}\n{text}', encoding='ascii')
            fresh.replace(path)
        finally:
            fresh.unlink(missing_ok=True)
    return json.loads(text)


@functools.cache
def sources() -> bytes:
    """A digest of every source file of the solver."""
    root = Path(__file__).parents[1]
    paths = sorted(root.rglob('*.py'))
    return digest(*(part for path in paths for part in (path.relative_to(root).as_posix().encode(), path.read_bytes())))


def _prune(directory: Path) -> None:
    for path in directory.iterdir():
        with suppress(OSError):  # another process removes it too
            if time.time() - path.stat().st_mtime > KEPT_SECONDS:
                path.unlink()
