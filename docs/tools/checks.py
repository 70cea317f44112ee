"""Fills the table of checks in docs/stability.md from their records: `python docs/tools/checks.py` rewrites it, a test
compares."""

from __future__ import annotations

import re
from pathlib import Path

from solver.checks.registry import CHECKS

FILE = Path(__file__).parents[1] / 'stability.md'
PART = re.compile(r'<!-- begin checks -->\n.*?<!-- end -->', re.DOTALL)
HEAD = ('check', 'unit', 'limit unless `require` sets one', 'key of `require`', 'a finding says', 'and advises')


def render(text: str) -> str:
    """The document with its table made anew."""
    return PART.sub(lambda _: f'<!-- begin checks -->\n{table()}<!-- end -->', text)


def table() -> str:
    """The table; a place in a sentence is `...`."""
    rows = [HEAD, ('---',) * len(HEAD)]
    for check in CHECKS:
        key, reason = f'`{check.require}`' if check.require else '', check.reason.format(where='...', of='...')
        limit = '' if check.limit is None else f'{check.limit:.3g} {check.unit}'.rstrip() + ': '
        rows.append(
            (
                f'`{check.name}`',
                check.unit,
                limit + check.rule,
                key,
                reason,
                check.remedy[:1].lower() + check.remedy[1:],
            )
        )
    return ''.join('| ' + ' | '.join(cells) + ' |\n' for cells in rows)


if __name__ == '__main__':
    FILE.write_text(render(FILE.read_text(encoding='utf-8')), encoding='utf-8')
