"""Docstrings of this package for Sphinx: prose with `code` in single backquotes becomes reStructuredText; see
site_pages.py."""

from __future__ import annotations

import re
from typing import Any

PARAMETER = re.compile(r'(?<=\. )(?=[a-z_]+(?:, [a-z_]+)*: )')  # a sentence that begins with the name of an argument


def as_rst(lines: list[str]) -> list[str]:
    """Every mark that reStructuredText would read is text, and each argument begins a line of its own."""
    text = '\n'.join(lines)
    paragraphs = []
    for paragraph in re.split(r'\n\s*\n', text):
        if paragraph.startswith('    '):
            paragraphs.append('::\n\n' + paragraph)  # an example
            continue
        joined = ' '.join(paragraph.split())
        parts = PARAMETER.split(joined)
        paragraphs += [_prose(part) for part in parts]
    return '\n\n'.join(paragraphs).splitlines()


def _prose(text: str) -> str:
    pieces = re.split(r'(`[^`]+`)', text.strip())
    whole = ''.join(f'`{piece}`' if k % 2 else re.sub(r'([\\*|_])', r'\\\1', piece) for k, piece in enumerate(pieces))
    return re.sub(r'^([a-z_\\]+(?:, [a-z_\\]+)*): ', r'**\1**: ', whole)


def setup(app: Any) -> None:
    """Connect it."""

    def docstring(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
        lines[:] = as_rst(lines)

    app.connect('autodoc-process-docstring', docstring)
