"""The one place that configures numba: `kernel` is the decorator of every compiled function.

numba's on-disk cache does not notice when a callee in another file changes, so the cache directory is keyed by a hash
of all solver sources; stale directories are removed. Where the location is not writable a temporary one is used.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from pathlib import Path

KEPT_CACHES = 3


def source_hash() -> str:
    """Return a short hash of every Python file of the solver package (and of the numba and numpy versions)."""
    from importlib.metadata import version

    digest = hashlib.sha256()
    root = Path(__file__).parent
    for path in sorted(root.rglob('*.py')):
        digest.update(str(path.relative_to(root)).encode())
        digest.update(path.read_bytes())
    for name in ('numba', 'numpy'):
        digest.update(version(name).encode())
    return digest.hexdigest()[:16]


def _pin_cache() -> Path:
    base = Path(os.environ.get('MBD_CACHE_DIR') or Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache') / 'mbd_sim_ros')
    directory = base / ('kernels-' + source_hash() + ('-boundscheck' if os.environ.get('NUMBA_BOUNDSCHECK') == '1' else ''))
    try:
        directory.mkdir(parents=True, exist_ok=True)
        probe = directory / f'.probe-{os.getpid()}'
        probe.touch()
        probe.unlink()
        os.utime(directory)
        old = sorted(base.glob('kernels-*'), key=lambda p: p.stat().st_mtime, reverse=True)[KEPT_CACHES:]
        for stale in old:
            shutil.rmtree(stale, ignore_errors=True)
    except OSError:
        directory = Path(tempfile.mkdtemp(prefix='mbd_sim_ros-kernels-'))
    os.environ['NUMBA_CACHE_DIR'] = str(directory)
    return directory


CACHE_DIRECTORY = _pin_cache()

import numba  # noqa: E402  (must come after the cache directory is set)

numba.config.CACHE_DIR = str(CACHE_DIRECTORY)


def kernel(function=None, *, inline: bool = False, borrow: bool = False):
    """Compile a function with the project's settings: cached, no fastmath, GIL released, IEEE division.

    borrow: the function only reads and writes the arrays it is given, so their references need not be counted. Counting
    takes an atomic operation per array and table and made the element kernels six times slower. Such a function cannot allocate,
    nor assign an array to a slice of another one (numba then says 'NRT required but not enabled').
    inline: for small functions; always inlined, and borrowing.
    """
    options = {'cache': True, 'nogil': True, 'error_model': 'numpy', 'fastmath': False}
    if inline or borrow:
        options['_nrt'] = False
    if inline:
        options['forceinline'] = True
    if function is None:
        return numba.njit(**options)
    return numba.njit(function, **options)
