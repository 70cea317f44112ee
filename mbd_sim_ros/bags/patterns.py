"""Which channels a shell pattern means, and which ones may be meant by one that means none."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from difflib import SequenceMatcher
from fnmatch import fnmatchcase
from functools import lru_cache

INDEX = re.compile(r'\[(\d+)\]')  # of an item in a list of parts, as in tf/transforms[0]/transform/translation/x

# likeness of names (difflib, part by part) from which one may be meant by the other; at 0.3 all are like all
NEAR = 0.72
LEAST = 0.5  # likeness of every part; a part that is another word is no slip of the pen
SHORTER = 0.9  # factor on the likeness of names of which only the last part, or the topic, is given
# how much less like than the nearest name another one may be that is offered too; at 1 all that are near enough
BESIDE = 0.12
OFFERED = 3  # names
LISTED = 8  # topics that are listed where no name is near


def fits(name: str, pattern: str) -> bool:
    """True where a pattern fits a channel. [0] is a set of characters to the shell, and may be an index here."""
    return fnmatchcase(name, pattern) or ('[' in pattern and fnmatchcase(name, INDEX.sub(r'[[]\1]', pattern)))


def fits_any(name: str, patterns: Iterable[str]) -> bool:
    """True where one of the patterns fits a channel."""
    return any(fits(name, pattern) for pattern in patterns)


def may_fit(topic: str, patterns: Iterable[str]) -> bool:
    """True where one of the patterns may fit a channel of a topic, whatever the channel is called."""
    begins = [re.split(r'[*?[]', pattern)[0] for pattern in patterns]
    return any(begin.startswith(f'{topic}/') or f'{topic}/'.startswith(begin) for begin in begins)


def nearest(wanted: str, known: Sequence[str]) -> str:
    """Guess at a channel, a pattern or a topic that does not exist, to be appended to a sentence: '; did you mean A, B
    or C?', with the wildcards of the pattern; or which topics there are.
    """
    parts = [part for part in re.split('/' if '/' in wanted else r'[/.]', wanted) if part] or ['']
    scores: dict[str, float] = {}
    for name in known:
        has = name.split('/')
        for near, score in _candidates(parts, has):
            if score >= NEAR and score > scores.get(near, 0.0):
                scores[near] = score
    best = max(scores.values(), default=0.0)
    found = sorted((near for near in scores if scores[near] > best - BESIDE), key=lambda near: (-scores[near], near))[
        :OFFERED
    ]
    if found:
        return f'; did you mean {" or ".join(filter(None, [", ".join(map(repr, found[:-1])), repr(found[-1])]))}?'
    topics = list(dict.fromkeys(name.split('/')[0] + '/*' if '/' in name else name for name in known))
    if not topics:
        return '; it has none'
    more = f' and {len(topics) - LISTED} more' if len(topics) > LISTED else ''
    return f'; there are {", ".join(topics[:LISTED])}{more}'


def _candidates(parts: Sequence[str], has: Sequence[str]) -> Iterable[tuple[str, float]]:
    """(what may be meant, how like it is, 0 to 1) of one known name, by its parts."""
    n = len(parts)
    if n == len(has):
        yield _mended(parts, has)
    if parts[-1].endswith('*') and 1 < n < len(has):
        near, score = _mended(parts[:-1], has[: n - 1])
        yield f'{near}/*', score
    if n == 1 and len(has) > 1:
        yield '/'.join(has), SHORTER * _likeness(parts[0], has[-1])
        yield f'{has[0]}/*', SHORTER * _likeness(parts[0], has[0])
    if 1 < n < len(has) and parts[-1] != '*':  # a part is left out
        ends = (parts[0], parts[-1]), (has[0], has[-1])
        yield '/'.join(has), SHORTER * _mended(*ends)[1]


def _mended(parts: Sequence[str], has: Sequence[str]) -> tuple[str, float]:
    """A pattern whose wrong parts are replaced, and its likeness: the mean over the parts, 0 where one is another
    word."""
    right = [fnmatchcase(name, part) for part, name in zip(parts, has)]
    scores = [1.0 if ok else _likeness(part, name) for ok, part, name in zip(right, parts, has)]
    near = '/'.join(part if ok else name for ok, part, name in zip(right, parts, has))
    return near, sum(scores) / len(scores) if min(scores) >= LEAST else 0.0


@lru_cache(maxsize=100_000)
def _likeness(part: str, name: str) -> float:
    """Likeness of two parts of names, whatever the case of their letters, 0 to 1."""
    return SequenceMatcher(None, part.lower(), name.lower()).ratio()
