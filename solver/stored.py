"""Arrays that are too large for the text of a scene: the text names them by a hash, recordings carry them as
attachments.

A set of arrays is known to this process from keep() or accept() on, and to others on this machine through a directory
beside the cache of kernels, which may be deleted: whoever reads the file, or the recording, again puts the arrays back.
"""

from __future__ import annotations

import hashlib
import json
import re
import zlib
from collections.abc import Callable, Mapping
from contextlib import suppress

import numpy as np

from solver.disk import Store, store_of
from solver.errors import SpecError

DIGEST = re.compile(r'\b[0-9a-f]{64}\b')
TYPES = ('<f4', '<f8')
LARGEST = 1 << 30  # [bytes] of all arrays of a set; ten times as much would not fit into the memory of a small machine
QUICK = 1  # level of zlib: 6 takes ten times as long and saves a tenth
_HEAD = b'mbd arrays 1\n'
_known: dict[str, dict[str, np.ndarray]] = {}


def keep(arrays: Mapping[str, np.ndarray]) -> str:
    """The hash (SHA-256, 64 hexadecimal digits) under which arrays of float32 or float64 can be found from now on."""
    ordered = {
        name: np.ascontiguousarray(a, '<f4' if a.dtype == np.float32 else '<f8') for name, a in sorted(arrays.items())
    }
    digest = _digest(ordered)
    if digest not in _known:
        _known[digest] = ordered
        _offer(digest, lambda: _packed(ordered))
    return digest


def find(digest: str) -> dict[str, np.ndarray] | None:
    """The arrays with this hash; None if neither this process nor the directory on this machine has them."""
    if digest not in _known and DIGEST.fullmatch(digest) and (data := _store().read(digest)) is not None:
        with suppress(SpecError):
            accept(data, digest)
    return _known.get(digest)


def packed(digest: str) -> bytes:
    """The arrays with this hash, which are known, as bytes: those of an attachment."""
    data = _store().read(digest)
    return _packed(_known[digest]) if data is None else data


def accept(data: bytes, digest: str) -> None:
    """Take arrays from the bytes of packed(). Raises SpecError for damaged ones, and for those of another hash."""
    arrays = _unpacked(data)
    if arrays is None or _digest(arrays) != digest:
        raise SpecError(f'arrays {digest[:12]}...: are damaged: their hash is another one')
    _known[digest] = arrays
    _offer(digest, lambda: data)


def named_in(text: str) -> dict[str, bytes]:
    """Hash -> packed(), of all arrays that the text of a scene names."""
    return {digest: packed(digest) for digest in dict.fromkeys(DIGEST.findall(text)) if find(digest) is not None}


def _store() -> Store:
    return store_of('arrays')


def _offer(digest: str, data: Callable[[], bytes]) -> None:
    store = _store()
    if not (store.directory / digest).is_file():
        with suppress(OSError):  # a directory that cannot be written leaves the arrays to this process
            store.write(digest, data())


def _header(arrays: Mapping[str, np.ndarray]) -> bytes:
    return json.dumps([[name, a.dtype.str, a.shape] for name, a in arrays.items()]).encode() + b'\n'


def _digest(arrays: Mapping[str, np.ndarray]) -> str:
    found = hashlib.sha256(_header(arrays))
    for a in arrays.values():
        found.update(a.data if a.size else b'')
    return found.hexdigest()


def _packed(arrays: Mapping[str, np.ndarray]) -> bytes:
    """A head, then the arrays deflated, all first bytes of their numbers before all second ones: so they take half as
    much."""
    deflate = zlib.compressobj(QUICK)
    pieces = [_HEAD, _header(arrays)]
    for a in arrays.values():
        for k in range(a.itemsize):
            pieces.append(deflate.compress(np.ascontiguousarray(a.reshape(-1).view(np.uint8)[k :: a.itemsize]).data))
    return b''.join([*pieces, deflate.flush()])


def _unpacked(data: bytes) -> dict[str, np.ndarray] | None:
    """The arrays; None of bytes that are none."""
    if not data.startswith(_HEAD):
        return None
    end = data.find(b'\n', len(_HEAD))
    try:
        listed = [
            (str(name), str(kind), tuple(int(n) for n in shape))
            for name, kind, shape in json.loads(data[len(_HEAD) : end])
        ]
        sizes = [int(np.prod(shape, dtype=object)) * np.dtype(kind).itemsize for _, kind, shape in listed]
        if any(kind not in TYPES or min(shape, default=0) < 0 for _, kind, shape in listed) or sum(sizes) > LARGEST:
            return None
        raw = zlib.decompressobj().decompress(memoryview(data)[end + 1 :], sum(sizes) + 1)
    except (ValueError, TypeError, KeyError, zlib.error, RecursionError):
        return None
    if len(raw) != sum(sizes):
        return None
    arrays, at = {}, 0
    for (name, kind, shape), size in zip(listed, sizes, strict=True):
        planes = np.frombuffer(raw, np.uint8, size, at).reshape(np.dtype(kind).itemsize, -1)
        arrays[name] = np.ascontiguousarray(planes.T).reshape(-1).view(kind).reshape(shape)
        at += size
    return arrays
