"""Web pages of one file that need nothing else: a template, what all of them share (page.css, page.js), and data.

In a template @STYLE@ and @SCRIPT@ stand for the shared style and script, and @DATA@ for the data as JSON; the script
gives the rest `data`. Curves go as 32-bit floats in base64 (docs/decisions/0011-report-of-comparisons.md).
"""

from __future__ import annotations

import base64
import html
import json
import math
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from solver.disk import atomic_write, plain
from solver.errors import BagError

HOME = 'mbd_sim_ros.analysis'


def fill(file: Path, template: str, data: dict[str, Any], **parts: str) -> None:
    """Write a page; see filled(). Raises BagError when it cannot be written."""
    write_text(file, filled(template, data, **parts))


def filled(template: str, data: dict[str, Any], **parts: str) -> str:
    """A template (package:file) filled with data; numbers that are not finite become null. parts: mark -> the file
    (package:file) that stands for it too."""
    text = json.dumps(plain(data), allow_nan=False).replace('<', '\\u003c')  # no tag can end the script
    page = _text(template)
    for mark, part in {'STYLE': f'{HOME}:page.css', 'SCRIPT': f'{HOME}:page.js', **parts}.items():
        page = page.replace(f'@{mark}@', _text(part))
    return page.replace('@DATA@', text)


def plain_page(title: str, parts: Sequence[str]) -> str:
    """A page without script: its parts, in HTML, under the shared style."""
    named, style = html.escape(title), _text(f'{HOME}:page.css')
    head = (
        '<!DOCTYPE html>\n<html lang="en"><head><meta '
        f'charset="utf-8"><title>{named}</title><style>{style}</style></head><body>'
    )
    return '\n'.join([head, f'<h1>{named}</h1>', *parts, '</body></html>\n'])


def write_text(file: Path, text: str) -> None:
    """Write a text, and the directories above it; what was there before stays until all is written. Raises BagError."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(file) as part:
            part.write_text(text, encoding='utf-8')
    except OSError as error:
        raise BagError(f'cannot write {file}: {error.strerror}; choose another place') from None


def floats(values: np.ndarray) -> str:
    """Numbers for the script."""
    with np.errstate(over='ignore'):
        return base64.b64encode(np.ascontiguousarray(values, '<f4').tobytes()).decode()


def thinned(points: int, *signals: np.ndarray) -> np.ndarray:
    """Which samples of signals of one length are drawn: all of short ones, else the extremes of each in every stretch,
    about `points`."""
    n = signals[0].size
    if n <= points:
        return np.arange(n)
    stretch = math.ceil(n * 2 * len(signals) / points)
    starts = np.arange(0, n, stretch)
    chosen = [np.array([0, n - 1])]
    for values in signals:
        for fill, best in ((np.inf, np.argmin), (-np.inf, np.argmax)):
            padded = np.full(starts.size * stretch, fill)
            padded[:n] = np.where(np.isfinite(values), values, fill)
            chosen.append(starts + best(padded.reshape(-1, stretch), axis=1))
    return np.unique(np.concatenate(chosen).clip(max=n - 1))


def _text(file: str) -> str:
    package, _, name = file.partition(':')
    return files(package).joinpath(name).read_text(encoding='utf-8')
