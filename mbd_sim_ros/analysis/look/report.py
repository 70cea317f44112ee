"""A first look as a mapping file with the evidence in comments, and as an object for JSON."""

from __future__ import annotations

import json
import re
from typing import Any

from mbd_sim_ros.analysis.look.first import Look
from mbd_sim_ros.analysis.look.grid import Column
from mbd_sim_ros.analysis.look.relations import TEXTS
from mbd_sim_ros.analysis.runs import suspicion
from mbd_sim_ros.bags.reader import Run

WIDTH = 118  # characters of a line of comment
MOST = 30  # names of columns without a quantity that are listed


def as_data(found: Look, run: Run) -> dict[str, Any]:
    """All of a look. `mapping` is what a mapping file holds; what is not told is listed under `unknown`."""
    return {
        'status': 'ok',
        'mapping': {'channels': {ours: _source(c) for ours, c in found.mapping.items()}},
        'side': found.side or None,
        'columns': {
            c.name: {'quantity': c.role.what or None, 'unit': c.unit, 'sign': c.sign, 'told': c.told, 'evidence': _why(c)}
            for c in found.columns
        },
        'unknown': [c.name for c in found.columns if not c.told],
        'not_read': dict(run.left_out),
        'doubts': [*suspicion(run)],
        'notes': [*found.notes],
    }


def as_yaml(found: Look, run: Run, place: str) -> str:
    """A mapping file that says of every column why it is, or is not, in it."""
    seconds = run.time_ns[-1] * 1e-9 - run.time_ns[0] * 1e-9
    lines = _comment(f'First look at {place}: {run.time_ns.size} instants in {seconds:.4g} s. A proposal: confirm every line of it.')
    for text in (*suspicion(run), *found.notes):
        lines += _comment(text)
    side = (
        f'Left is positive after the signs below: {found.side}.'
        if found.side
        else 'The data do not tell which side is positive: left is assumed, and the signs fit each other; turn all if it is right.'
    )
    lines += _comment(side) if found.mapping else []
    lines.append('channels:' if found.mapping else 'channels: {}  # nothing is told')
    for ours, c in found.mapping.items():
        source = ', '.join(f'{key}: {_quoted(value)}' for key, value in _source(c).items())
        lines.append(f'  {ours}: {{{source}}}')
        lines += [f'    {line}' for text in _why(c) for line in _comment(text)]
    mapped = {c.name for c in found.mapping.values()}
    others = [c for c in found.columns if c.role.what and c.name not in mapped]
    for title, group in (
        ('Told, but not needed, or without a channel of ours:', [c for c in others if c.told]),
        ('Unknown, for it is not confirmed:', [c for c in others if not c.told]),
    ):
        if group:
            lines += ['', f'# {title}']
            for c in group:
                known = ', '.join([TEXTS[c.role.what], *([c.unit] if c.unit else []), *(['turned'] if c.sign == -1 else [])])
                lines += _comment(f'{c.name} ({known}): {"; ".join(_why(c))}', '  ')
    unnamed = [c.name for c in found.columns if not c.role.what]
    if unnamed:
        more = f' and {len(unnamed) - MOST} more' if len(unnamed) > MOST else ''
        lines += ['', *_comment(f'Unknown, by their names none of the quantities that are looked for: {", ".join(unnamed[:MOST])}' + more)]
    for topic, why in run.left_out.items():
        lines += _comment(f'Not read: {topic}: {why}')
    return '\n'.join(lines)


def _source(c: Column) -> dict[str, Any]:
    return {'channel': c.name, 'unit': c.unit, **({'sign': -1} if c.sign == -1 else {})}


def _why(c: Column) -> list[str]:
    if not c.role.what:
        return ['its name is that of no quantity that is looked for']
    return [*c.why, *(() if c.told else c.against), *([f'its header says {c.stated}'] if c.stated and not c.unit else [])]


def _quoted(value: Any) -> str:
    text = str(value)
    return (
        text
        if re.fullmatch(r'-?[A-Za-z0-9_/^.]+', text) and text not in ('1', 'y', 'n', 'on', 'off')
        else json.dumps(value, ensure_ascii=False)
    )


def _comment(text: str, indent: str = '') -> list[str]:
    """A text as lines of comment."""
    import textwrap

    return textwrap.wrap(
        ' '.join(text.split()), WIDTH, initial_indent=f'# {indent}', subsequent_indent=f'# {indent}  ', break_on_hyphens=False
    )
