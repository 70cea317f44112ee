"""docs/evaluating.md has the tables that the code gives."""

from __future__ import annotations

import importlib.util
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_the_tables_are_those_of_the_code():
    spec = importlib.util.spec_from_file_location('evaluations', ROOT / 'docs' / 'tools' / 'evaluations.py')
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    text = module.FILE.read_text(encoding='utf-8')
    assert module.render(text) == text, 'run `python docs/tools/evaluations.py`'
