"""Colour of what is not in order, in the text for people: on a terminal only, and never where NO_COLOR is set
(no-color.org)."""

from __future__ import annotations

import os
import re
from typing import TextIO

RED, PLAIN = '\x1b[31m', '\x1b[0m'
# Words of verdicts, which commands write in capitals, and lines that are a verdict.
BAD = re.compile(
    r'\b(?:SUSPECT|REQUIREMENT|OUTSIDE|FAILED|FAIL|NOT MET|REFUSED)\b'
    r'|(?<=^verdict) +(?!ok\b)[^ \n]+|(?<=^plan) +(?!ok\b)[^ \n]+'
    r'|^the recordings differ|^\d+ of \d+ channels outside tolerance|^topics that differ|^[1-9]\d* of \d+ checks not '
    r'met'
    r'|^limits of the norm are not kept',
    re.MULTILINE,
)


def is_wanted(stream: TextIO) -> bool:
    """True for a terminal that shows colours, of somebody who has not said that there shall be none."""
    return stream.isatty() and not os.environ.get('NO_COLOR') and os.environ.get('TERM') != 'dumb'


def painted(text: str) -> str:
    """The text with its bad words in red."""
    return BAD.sub(lambda found: f'{RED}{found[0]}{PLAIN}', text)
