"""Long pages have their contents at their head, and these are up to date."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

DOCS = Path(__file__).parents[2] / 'docs'


def tool() -> ModuleType:
    spec = importlib.util.spec_from_file_location('contents', DOCS / 'tools' / 'contents.py')
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize('page', tool().pages(), ids=lambda page: page.name)
def test_contents_are_those_of_the_page(page: Path) -> None:
    text = page.read_text(encoding='utf-8')
    assert tool().render(text) == text, 'run `python docs/tools/contents.py`'


def test_what_has_contents() -> None:
    """Headings of a long page, none in code; a short page loses what it has; a second time nothing changes."""
    words = 'a line of words\n' * 250
    body = ''.join(f'## Part `{k}`\n\ntext\n\n' for k in range(3)) + '```\n## none\n```\n' + words
    page = tool().render(f'# Title\n\nIntro.\n\n{body}')
    assert page.startswith('# Title\n\n<!-- contents -->\n[Part 0](#part-0) · ') and 'none](' not in page
    assert tool().render(page) == page and page.endswith(body)
    assert tool().render(page.replace(words, '')).startswith('# Title\n\nIntro.')


def test_a_very_long_page_shows_the_parts_of_its_chapters() -> None:
    """A line for each chapter; headings of one name have addresses of their own, as GitHub numbers them."""
    body = ''.join(f'## Chapter {k}\n\n### Cases\n\n#### Cases\n\n' for k in range(3)) + 'a line of words\n' * 2500
    page = tool().render(f'# Title\n\n{body}')
    lines = page.splitlines()[3:6]
    assert lines == [f'- [Chapter {k}](#chapter-{k}): [Cases](#cases{f"-{2 * k}" if k else ""})' for k in range(3)]
    assert tool().render(page) == page
