"""Contents at the head of long pages: `python docs/tools/contents.py` writes them, a test compares."""

from __future__ import annotations

import re
from pathlib import Path

DOCS = Path(__file__).parents[1]
LONG = 150  # lines; a page of ten times as many cannot be read without
FEWEST = 4  # headings
PART = re.compile(r'<!-- contents -->\n.*?<!-- end -->\n\n?', re.DOTALL)
FENCE = re.compile(r'^```.*?^```', re.DOTALL | re.MULTILINE)


def render(text: str) -> str:
    """The page with its contents made anew, behind its title; without them where it is short."""
    text = PART.sub('', text)
    headings = re.findall(r'^## (.*)$', FENCE.sub('', text), re.MULTILINE)
    if text.count('\n') < LONG or len(headings) < FEWEST:
        return text
    title, rest = text.split('\n\n', 1)
    links = ' · '.join(f'[{heading.replace("`", "")}](#{anchor(heading)})' for heading in headings)
    return f'{title}\n\n<!-- contents -->\n{links}\n<!-- end -->\n\n{rest}'


def anchor(heading: str) -> str:
    """The address of a heading within its page, as GitHub spells it."""
    return re.sub(r'[^\w\- ]', '', heading.lower()).replace(' ', '-')


def pages() -> list[Path]:
    """The pages that may have contents."""
    return sorted(DOCS.glob('*.md'))


if __name__ == '__main__':
    for page in pages():
        before = page.read_text(encoding='utf-8')
        if (after := render(before)) != before:
            page.write_text(after, encoding='utf-8')
            print(page)
