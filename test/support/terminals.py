"""What a process writes on a terminal."""

from __future__ import annotations

import os


def written(ours: int) -> bytes:
    """All that was written on a pseudo terminal whose other end is closed; ours: its descriptor, which is closed."""
    text = b''
    while True:
        try:
            part = os.read(ours, 65536)
        except OSError:  # the end of a terminal
            break
        if not part:
            break
        text += part
    os.close(ours)
    return text
