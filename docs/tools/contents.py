"""Contents at the head of long pages: `python docs/tools/contents.py` writes them, a test compares."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

DOCS = Path(__file__).parents[1]
LONG = 1000  # words, four minutes of reading; with ten times as many, pages that most need contents had none
# words, from which on a chapter has a line of its own, with its parts; ten times as many has no page
VERY_LONG = 10_000
FEWEST = 3  # headings; ten times as many has no page
PART = re.compile(r'<!-- contents -->\n.*?<!-- end -->\n\n?', re.DOTALL)
FENCE = re.compile(r'^```.*?^```', re.DOTALL | re.MULTILINE)


def render(text: str) -> str:
    """The page with its contents made anew, behind its title; without them where it is short."""
    text = PART.sub('', text)
    found = headings(text)
    words = len(text.split())
    if words < LONG or sum(level == 2 for level, _, _ in found) < FEWEST:
        return text
    title, rest = text.split('\n\n', 1)
    chapters: list[list[str]] = []
    for level, name, place in found:
        link = f'[{name.replace("`", "")}](#{place})'
        if level == 2:
            chapters.append([link])
        elif level == 3 and chapters:
            chapters[-1].append(link)
    if words < VERY_LONG:
        lines = [' · '.join(first for first, *_ in chapters)]
    else:
        lines = [f'- {first}' + (': ' if parts else '') + ' · '.join(parts) for first, *parts in chapters]
    return '\n'.join([title, '', '<!-- contents -->', *lines, '<!-- end -->', '', rest])


def headings(text: str) -> list[tuple[int, str, str]]:
    """Level, text and address of every heading; the second of a name has -1 behind it."""
    before: Counter[str] = Counter()
    found = []
    for marks, name in re.findall(r'^(#+) (.*)$', FENCE.sub('', text), re.MULTILINE):
        place = anchor(name)
        number, before[place] = before[place], before[place] + 1
        found.append((len(marks), name, f'{place}-{number}' if number else place))
    return found


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
