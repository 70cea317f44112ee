"""Files that are written whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole(file: Path) -> Iterator[Path]:
    """Where to write what becomes `file` at the end: who is killed meanwhile, or finds the disk full, leaves what was there.

    What a link points to is replaced, not the link; a device is no file to replace, and is written itself.
    """
    place = Path(os.path.realpath(file))
    if place.exists() and not place.is_file():
        yield place
        return
    part = place.with_name(f'.{place.name}.part')
    try:
        yield part
        part.replace(place)
    finally:
        part.unlink(missing_ok=True)
