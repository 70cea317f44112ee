"""Citations: a key in a text stands in docs/references.md, and what is listed there is cited."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LIST = ROOT / 'docs' / 'references.md'
KEY = re.compile(r'\[([A-Z][A-Za-z]+\d{4})\]')  # [Chung1993], [ISO8608]
ENTRY = re.compile(r'^- \*\*\[(\w+)\]\*\*', re.MULTILINE)


def listed() -> list[str]:
    return ENTRY.findall(LIST.read_text(encoding='utf-8'))


def cited() -> dict[str, set[str]]:
    """Keys by the file that cites them, in everything that people read but the list itself."""
    found = {}
    for folder, pattern in (
        ('solver', '*.py'),
        ('mbd_sim_ros', '*.py'),
        ('test', '*.py'),
        ('docs', '*.md'),
        ('config', '*.*'),
    ):
        for path in sorted((ROOT / folder).rglob(pattern)):
            if path not in (LIST, Path(__file__).resolve()):
                found[str(path.relative_to(ROOT))] = set(KEY.findall(path.read_text(encoding='utf-8')))
    return found


def test_every_key_is_listed_once_and_every_listed_work_is_cited():
    keys = listed()
    assert len(keys) == len(set(keys)) > 0
    assert all(KEY.fullmatch(f'[{key}]') for key in keys)
    where = cited()
    assert {path: sorted(used - set(keys)) for path, used in where.items() if used - set(keys)} == {}
    assert set(keys) - set().union(*where.values()) == set()
