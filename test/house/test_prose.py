"""Docstrings begin with their subject: "Inputs of a step", not "What a step takes" (docs/contributing.md, "Names")."""

from __future__ import annotations

import ast
from collections.abc import Iterator

import pytest
from processes import ROOT

BEGINNINGS = ('What', 'Of', 'Where', 'Whether', 'How')


def without_subject(source: str) -> Iterator[int]:
    """Lines of the modules, classes and functions of a program whose docstring begins with one of BEGINNINGS."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            words = (ast.get_docstring(node) or '').split()
            if words and words[0].rstrip(',') in BEGINNINGS:
                yield getattr(node, 'lineno', 1)


def test_docstrings_begin_with_their_subject() -> None:
    found = [
        f'{path.relative_to(ROOT)}:{line}'
        for folder in ('solver', 'mbd_sim_ros', 'docs/tools', 'launch')
        for path in sorted((ROOT / folder).rglob('*.py'))
        for line in without_subject(path.read_text(encoding='utf-8'))
    ]
    assert not found, 'begin the docstring with its subject, as in "Inputs of a step"'


@pytest.mark.parametrize(
    ('docstring', 'found'),
    [
        ('What a step takes.', 1),
        ('Where it is.', 1),
        ('Of a wheel [m].', 1),
        ('Inputs of a step.', 0),
        ('Whatever comes is kept.', 0),
    ],
)
def test_a_beginning_without_a_subject_is_found(docstring: str, found: int) -> None:
    assert len(list(without_subject(f'def f():\n    """{docstring}"""'))) == found
