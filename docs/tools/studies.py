"""Fills the generated parts of docs/studies.md, docs/validation.md, docs/vehicle.md, docs/stability.md,
docs/scene.md and docs/reality.md from finished studies: `python docs/tools/studies.py out [NAME ...]`, after `mbd
study NAME` into out/NAME. Without names, from all in `out`.

A part stands between `<!-- begin NAME: HEADING -->` and `<!-- end -->` and is that section of out/NAME/report.md
without its pictures; without a heading it is the text above the first section. Pictures that the document shows as
pictures/NAME_FILE.png are copied beside it, with few colours. Parts of studies that are not there stay as they are.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from pathlib import Path

from PIL import Image  # comes with matplotlib

FILES = [
    Path(__file__).parents[1] / name
    for name in ('studies.md', 'validation.md', 'vehicle.md', 'stability.md', 'scene.md', 'reality.md')
]
PART = re.compile(r'<!-- begin (?P<name>\w+)(: (?P<heading>[^\n]+))? -->\n.*?<!-- end -->', re.DOTALL)
COLOURS = 256  # of a copied picture, to keep it small; with 64 two lines of a picture became one colour
PICTURE = re.compile(r'\]\(pictures/(?P<file>[\w.]+)\)')


def section(report: str, heading: str | None) -> str:
    """A section of a report without pictures and their captions. Raises KeyError for an unknown heading."""
    pieces = re.split(r'^## (.*)\n', report, flags=re.MULTILINE)
    sections = dict(zip(pieces[1::2], pieces[2::2], strict=True))
    text = pieces[0].partition('\n')[2] if heading is None else sections[heading]
    return re.sub(r'!\[.*?\]\(.*?\)\n\n\*.*?\*\n*', '', text).strip() + '\n'


def fill(document: str, out: Path, names: Sequence[str]) -> str:
    """The document with the parts of these studies."""

    def part(match: re.Match[str]) -> str:
        report = out / match['name'] / 'report.md'
        if match['name'] not in names or not report.exists():
            return match[0]
        head = match[0].split('\n', 1)[0]
        return f'{head}\n{section(report.read_text(encoding="utf-8"), match["heading"])}<!-- end -->'

    return PART.sub(part, document)


def copy_pictures(document: str, out: Path, names: Sequence[str]) -> None:
    """Copy what the document shows from these studies."""
    target = FILES[0].with_name('pictures')
    target.mkdir(exist_ok=True)
    for match in PICTURE.finditer(document):
        for study in names:
            source = out / study / match['file'].removeprefix(f'{study}_')
            if match['file'].startswith(f'{study}_') and source.exists():
                Image.open(source).convert('RGB').quantize(COLOURS).save(target / match['file'], optimize=True)


if __name__ == '__main__':
    directory = Path(sys.argv[1] if len(sys.argv) > 1 else 'out')
    chosen = sys.argv[2:] or sorted(path.name for path in directory.iterdir() if path.is_dir())
    for file in FILES:
        text = file.read_text(encoding='utf-8')
        file.write_text(fill(text, directory, chosen), encoding='utf-8')
        copy_pictures(text, directory, chosen)
