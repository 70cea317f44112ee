"""Which channels a shell pattern means."""

from __future__ import annotations

import re
from collections.abc import Iterable
from fnmatch import fnmatchcase

INDEX = re.compile(r'\[(\d+)\]')  # of an item in a list of parts, as in tf/transforms[0]/transform/translation/x


def fits(name: str, pattern: str) -> bool:
    """Whether a channel is meant. [0] is a set of characters to the shell, and may be an index here."""
    return fnmatchcase(name, pattern) or ('[' in pattern and fnmatchcase(name, INDEX.sub(r'[[]\1]', pattern)))


def fits_any(name: str, patterns: Iterable[str]) -> bool:
    """Whether a channel is meant by one of them."""
    return any(fits(name, pattern) for pattern in patterns)


def may_fit(topic: str, patterns: Iterable[str]) -> bool:
    """Whether one of them may mean a channel of a topic, whatever the channel is called."""
    begins = [re.split(r'[*?[]', pattern)[0] for pattern in patterns]
    return any(begin.startswith(f'{topic}/') or f'{topic}/'.startswith(begin) for begin in begins)
