"""docs/stability.md has the table of the checks that there are."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from solver.checks.registry import CHECKS

ROOT = Path(__file__).resolve().parents[2]


def test_the_table_is_that_of_the_records():
    spec = importlib.util.spec_from_file_location('checks', ROOT / 'docs' / 'tools' / 'checks.py')
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    text = module.FILE.read_text(encoding='utf-8')
    assert module.render(text) == text, 'run `python docs/tools/checks.py`'
    assert all(f'\n| `{check.name}` |' in text for check in CHECKS)
