"""Output of `mbd compare --look`: the first look at a recording as a mapping file, with the evidence in comments, or as
JSON."""

from __future__ import annotations

import json
import re
from typing import Any

from mbd_sim_ros.analysis.look.first import Look
from mbd_sim_ros.analysis.look.grid import Column
from mbd_sim_ros.analysis.look.relations import TEXTS
from mbd_sim_ros.analysis.runs import suspicion
from mbd_sim_ros.bags.reader import Run

WIDTH = 118  # characters of a comment line at most
MOST = 30  # columns without a quantity that are listed by name; the others are counted


def as_data(found: Look, run: Run) -> dict[str, Any]:
    """A look as an object for JSON.

    `mapping` is the content of a mapping file. `told` says of a column that its quantity, unit and sign are identified;
    the other columns are listed under `unknown`.
    """
    return {
        'status': 'ok',
        'mapping': {'channels': {ours: _source(c) for ours, c in found.mapping.items()}},
        'side': found.side or None,
        'columns': {
            c.name: {
                'quantity': c.role.what or None,
                'unit': c.unit,
                'sign': c.sign,
                'told': c.told,
                'evidence': _why(c),
            }
            for c in found.columns
        },
        'unknown': [c.name for c in found.columns if not c.told],
        'not_read': dict(run.left_out),
        'doubts': [*suspicion(run)],
        'notes': [*found.notes],
    }


def as_yaml(found: Look, run: Run, place: str) -> str:
    """A look as the text of a mapping file. Comments say of every column why it is in the mapping, or why it is not."""
    seconds = run.time_ns[-1] * 1e-9 - run.time_ns[0] * 1e-9
    lines = _comment(
        f'First look at {place}: {run.time_ns.size} instants in {seconds:.4g} s. A proposal: confirm every line of it.'
    )
    for text in (*suspicion(run), *found.notes):
        lines += _comment(text)
    side = (
        f'With the signs below, left is positive: {found.side}.'
        if found.side
        else 'The data do not show which side is positive. The signs below fit each other and assume left. '
        'If right is positive, turn all of them.'
    )
    lines += _comment(side) if found.mapping else []
    lines.append('channels:' if found.mapping else 'channels: {}  # no column was identified')
    for ours, c in found.mapping.items():
        source = ', '.join(f'{key}: {_quoted(value)}' for key, value in _source(c).items())
        lines.append(f'  {ours}: {{{source}}}')
        lines += [f'    {line}' for text in _why(c) for line in _comment(text)]
    mapped = {c.name for c in found.mapping.values()}
    others = [c for c in found.columns if c.role.what and c.name not in mapped]
    for title, group in (
        ('Identified, but not mapped (another column is taken, or no channel fits):', [c for c in others if c.told]),
        ('Not identified (the data do not confirm what the name proposes):', [c for c in others if not c.told]),
    ):
        if group:
            lines += ['', f'# {title}']
            for c in group:
                known = ', '.join(
                    [TEXTS[c.role.what], *([c.unit] if c.unit else []), *(['turned'] if c.sign == -1 else [])]
                )
                lines += _comment(f'{c.name} ({known}): {"; ".join(_why(c))}', '  ')
                if c.told and (signal := _signal(c)):
                    source = ', '.join(f'{key}: {_quoted(value)}' for key, value in _source(c).items())
                    lines.append(f'  # {signal}: {{{source}}}    # for mbd evaluate')
    unnamed = [c.name for c in found.columns if not c.role.what]
    if unnamed:
        more = f' and {len(unnamed) - MOST} more' if len(unnamed) > MOST else ''
        names = f'{", ".join(unnamed[:MOST])}{more}'
        lines += ['', *_comment(f'Not looked at (no quantity has such a name): {names}')]
    for topic, why in run.left_out.items():
        lines += _comment(f'Not read: {topic}: {why}')
    return '\n'.join(lines)


def _signal(c: Column) -> str:
    """Signal of evaluations that an identified column is, which no channel of ours fits; '' where there is none."""
    side = {'front_left': '_left', 'front_right': '_right', '': ''}.get(c.role.corner)
    if c.role.what == 'road_angle':
        return '' if side is None else f'road_angle{side}'
    return {'yaw': 'heading', 'sideslip': 'sideslip_angle'}.get(c.role.what, '')


def _source(c: Column) -> dict[str, Any]:
    """Entry of a column in a mapping file."""
    return {'channel': c.name, 'unit': c.unit, **({'sign': -1} if c.sign == -1 else {})}


def _why(c: Column) -> list[str]:
    """Sentences on why a column is identified, or is not."""
    if not c.role.what:
        return ['its name is not that of a quantity that is looked for']
    return [
        *c.why,
        *(() if c.told else c.against),
        *([f'its header says {c.stated}'] if c.stated and not c.unit else []),
    ]


def _quoted(value: Any) -> str:
    """A value as YAML, in quotes where YAML would read it as something else."""
    text = str(value)
    return (
        text
        if re.fullmatch(r'-?[A-Za-z0-9_/^.]+', text) and text not in ('1', 'y', 'n', 'on', 'off')
        else json.dumps(value, ensure_ascii=False)
    )


def _comment(text: str, indent: str = '') -> list[str]:
    """A text as YAML comment lines of at most WIDTH characters."""
    import textwrap

    return textwrap.wrap(
        ' '.join(text.split()),
        WIDTH,
        initial_indent=f'# {indent}',
        subsequent_indent=f'# {indent}  ',
        break_on_hyphens=False,
    )
