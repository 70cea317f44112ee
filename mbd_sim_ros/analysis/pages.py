"""Web pages of one file that need nothing else, of one kind for all commands: a head, and blocks below it.

page.html, page.css, page.js and uPlot (third_party/uplot, MIT; it draws axes and curves and lets one zoom) stand in
every page; data follow as JSON, curves in it as 32-bit floats in base64. A policy in its head forbids the browser to
fetch anything. A block is a dictionary that page.js knows by its `kind`; the functions of this module make them.
"""

from __future__ import annotations

import base64
import html
import io
import json
import math
import re
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mbd_sim_ros import interrupts
from mbd_sim_ros.bags.recorder import code_version
from solver.disk import atomic_write, plain
from solver.errors import BagError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HOME = 'mbd_sim_ros.analysis'
LARGEST = 230_000  # numbers in the curves of a page: 1.2 MB in base64; ten times as many take seconds to open
LATE = 1e4  # s: stamps from here on are counted from the first; 32-bit floats would round ten times later ones to 8 ms
POINTS, FEWEST = 3000, 150  # of a curve: no picture shows more, and fewer hide what happens
Block = dict[str, Any]


@dataclass(kw_only=True)
class Page:
    """A page. ok: whether all is well (None: nothing was judged); verdict: a sentence on that. about: lines at its
    head. facts: what it is of, name and text. blocks: below each other. scripts: package:file of those that draw blocks
    of other kinds. programs: name -> package:file of what these start, which the page holds deflated."""

    title: str
    verdict: str = ''
    ok: bool | None = None
    about: Sequence[str] = ()
    facts: Sequence[tuple[str, str]] = ()
    blocks: list[Block] = field(default_factory=list)
    scripts: Sequence[str] = ()
    programs: Mapping[str, str] = field(default_factory=dict)

    def write(self, file: Path) -> None:
        """Write it. Raises BagError."""
        data = {
            'title': self.title,
            'verdict': {'ok': self.ok, 'text': self.verdict} if self.verdict else None,
            'about': list(self.about),
            'facts': [*made(), *self.facts],
            'blocks': self.blocks,
            'programs': {name: deflated(_text(of).encode()) for name, of in self.programs.items()},
        }
        plot = f'{HOME}.third_party.uplot'
        style = (f'{plot}:uPlot.min.css', f'{HOME}:page.css')
        script = (f'{plot}:uPlot.iife.min.js', f'{HOME}:base.js', f'{HOME}:page.js', *self.scripts)
        write_text(file, filled(f'{HOME}:page.html', data, STYLE=style, SCRIPT=script))


def filled(template: str, data: dict[str, Any], **parts: str | Sequence[str]) -> str:
    """A template (package:file) filled with data; numbers that are not finite become null. parts: mark -> the files
    (package:file) that stand for it; SCRIPT is base.js where it is not among them."""
    text = json.dumps(plain(data), allow_nan=False).replace('<', '\\u003c')  # no tag can end the script
    page = _text(template)
    for mark, of in {'SCRIPT': f'{HOME}:base.js', **parts}.items():
        page = page.replace(f'@{mark}@', '\n'.join(map(_text, [of] if isinstance(of, str) else of)))
    return page.replace('@TITLE@', html.escape(str(data.get('title', '')))).replace('@DATA@', text)


def deflated(content: bytes) -> str:
    """Bytes for the script, in few characters."""
    return base64.b64encode(zlib.compress(content, 9)).decode()


def made() -> list[tuple[str, str]]:
    """Facts of every page: the program, the time and the command that made it."""
    facts = [('program', f'mbd_sim_ros {code_version()}'), ('made', f'{datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC')]
    return [*facts, ('command', interrupts.command)] if interrupts.command else facts


def heading(text: str, level: int = 2) -> Block:
    """A heading of a level from 2 on."""
    return {'kind': 'heading', 'text': text, 'level': level}


def text(*lines: str, soft: bool = False) -> Block:
    """Paragraphs; code in backticks, **bold**."""
    return {'kind': 'text', 'lines': lines, 'soft': soft}


def table(rows: Sequence[Sequence[Any]], *, bad: Sequence[int] = (), goes: Sequence[str | None] = ()) -> Block:
    """A table that can be sorted. rows: its head first; cells are texts, numbers, or None. bad: indices of rows that
    are not in order. goes: of each row the key of the chart to which a click leads."""
    return {'kind': 'table', 'columns': rows[0], 'rows': rows[1:], 'bad': bad, 'goes': goes}


def charts(found: Sequence[Block], *, wide: bool = False) -> Block:
    """Charts beside each other, or below each other."""
    return {'kind': 'charts', 'charts': found, 'wide': wide}


def part(title: str, blocks: Sequence[Block], *, is_open: bool = True) -> Block:
    """Blocks under a title that can be folded."""
    return {'kind': 'part', 'title': title, 'blocks': blocks, 'open': is_open}


def curve(name: str, x: np.ndarray, y: np.ndarray, **more: Any) -> Block:
    """A curve. more: style (STYLES of page.js), colour (index of a variant), dash (index), points (radius of dots),
    high (upper edge of a band, whose lower one is y), group."""
    y = np.asarray(y, float)
    if offset := offset_of(y):
        more['offset'] = offset
    if 'high' in more:
        more['high'] = floats(np.asarray(more['high'], float) - offset)
    return {'name': name, 'x': floats(x), 'y': floats(y - offset), **more}


def chart(title: str, x: str, y: str, curves: Sequence[Block], **more: Any) -> Block:
    """A chart. x, y: labels with units. more: note, linked (charts of one such name have one axis x), equal (a metre is
    as long in both directions), zero (with zero in the picture), tall, key (to which rows of tables lead), origin (time
    of the first stamp [s], added to what is shown). Curves over the same x have it once."""
    last = None
    for one in curves:
        last, one['x'] = one['x'], None if one['x'] == last else one['x']
    return {'title': title, 'x': x, 'y': y, 'curves': curves, **more}


def picture(name: str, figure: Figure, caption: str) -> Block:
    """A figure of matplotlib, drawn in lines: SVG to be seen, PDF to be saved."""
    import matplotlib as mpl

    out = {}
    with mpl.rc_context({'svg.fonttype': 'none', 'pdf.fonttype': 42, 'svg.hashsalt': name}):
        for ending, metadata in (('svg', {'Date': None}), ('pdf', {'CreationDate': None})):
            content = io.BytesIO()
            figure.savefig(content, format=ending, metadata=metadata, bbox_inches='tight')
            out[ending] = content.getvalue()
    pdf = base64.b64encode(out['pdf']).decode()
    return {'kind': 'picture', 'name': name, 'caption': caption, 'svg': out['svg'].decode(), 'pdf': pdf}


def markdown(source: str) -> list[Block]:
    """Headings, paragraphs, lists and tables of a text in Markdown, as blocks."""
    blocks: list[Block] = []
    for paragraph in re.split(r'\n\s*\n', source.strip()):
        lines = paragraph.splitlines()
        if (head := re.fullmatch(r'(#+) (.*)', lines[0])) and len(lines) == 1:
            blocks.append(heading(head[2], max(2, len(head[1]))))
        elif lines[0].startswith('|') and len(lines) > 1:
            cells = [[cell.strip() for cell in line.strip().strip('|').split('|')] for line in lines]
            blocks.append(table([cells[0], *cells[2:]]))
        elif lines[0].startswith(('- ', '* ')):
            items = re.split(r'\n[-*] ', '\n' + paragraph)[1:]
            blocks.append(text(*(f'\u2022 {" ".join(item.split())}' for item in items)))
        else:
            blocks.append(text(' '.join(paragraph.split())))
    return blocks


def points_for(curves: int, columns: int = 2) -> int:
    """Points that each of so many curves of so many columns may have on a page."""
    return int(np.clip(LARGEST / max(curves * columns, 1), FEWEST, POINTS))


def write_text(file: Path, content: str) -> None:
    """Write a text, and the directories above it; what was there before stays until all is written. Raises BagError."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(file) as part_:
            part_.write_text(content, encoding='utf-8')
    except OSError as error:
        raise BagError(f'cannot write {file}: {error.strerror}; choose another place') from None


def floats(values: np.ndarray) -> str:
    """Numbers for the script."""
    with np.errstate(over='ignore'):
        return base64.b64encode(np.ascontiguousarray(values, '<f4').tobytes()).decode()


def offset_of(values: np.ndarray) -> float:
    """Value from which a curve is counted: its middle where that is farther from zero than the curve swings, else 0.
    32-bit floats then round to 6e-8 of the swing; counted from zero, those of an energy of 1e6 J draw stairs of
    0.06 J."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return 0.0
    low, high = 0.5 * float(finite.min()), 0.5 * float(finite.max())
    return low + high if abs(low + high) > 2.0 * (high - low) else 0.0


def origin_of(first: float) -> float:
    """Time [s] from which the stamps of a page are counted: the first stamp where it is late, else 0."""
    return first if abs(first) >= LATE else 0.0


def thinned(points: int, *signals: np.ndarray) -> np.ndarray:
    """Which samples of signals of one length are drawn: all of short ones, else the extremes of each in every stretch,
    about `points`."""
    n = signals[0].size
    if n <= points:
        return np.arange(n)
    stretch = math.ceil(n * 2 * len(signals) / points)
    starts = np.arange(0, n, stretch)
    chosen = [np.array([0, n - 1])]
    for values in signals:
        for fill, best in ((np.inf, np.argmin), (-np.inf, np.argmax)):
            padded = np.full(starts.size * stretch, fill)
            padded[:n] = np.where(np.isfinite(values), values, fill)
            chosen.append(starts + best(padded.reshape(-1, stretch), axis=1))
    return np.unique(np.concatenate(chosen).clip(max=n - 1))


def facts_of(entries: Mapping[str, object]) -> list[tuple[str, str]]:
    """Facts that say something, as text."""
    return [(name, str(value)) for name, value in entries.items() if value not in (None, '', [], {})]


def _text(file: str) -> str:
    package, _, name = file.partition(':')
    return files(package).joinpath(name).read_text(encoding='utf-8')
