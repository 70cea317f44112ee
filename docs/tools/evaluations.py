"""Fills the generated parts of docs/evaluating.md: `python docs/tools/evaluations.py` rewrites them, a test
compares."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

from mbd_sim_ros.analysis.evaluation.grid import POSE
from mbd_sim_ros.analysis.evaluation.registry import EVALUATIONS
from mbd_sim_ros.analysis.evaluation.signals import FORCE, TWIST, WAYS, Way

FILE = Path(__file__).parents[1] / 'evaluating.md'
PART = re.compile(r'<!-- begin (?P<name>\w+) -->\n.*?<!-- end -->', re.DOTALL)
GROUPS = {'<pose>': POSE, '<twist>': TWIST, '<imu>': FORCE}


def render(text: str) -> str:
    """The document with its generated parts made anew."""
    parts = {'evaluations': evaluations, 'parameters': parameters, 'signals': signals, 'maneuvers': maneuvers}
    return PART.sub(lambda m: f'<!-- begin {m["name"]} -->\n{table(parts[m["name"]]())}<!-- end -->', text)


def table(rows: list[tuple[str, ...]]) -> str:
    """A Markdown table; the first row is its head."""
    lines = [rows[0], tuple('---' for _ in rows[0]), *rows[1:]]
    return ''.join('| ' + ' | '.join(cells) + ' |\n' for cells in lines)


def evaluations() -> list[tuple[str, ...]]:
    """Table of evaluations."""
    rows: list[tuple[str, ...]] = [('evaluation', '', 'after', 'needs', 'more with', 'parameters')]
    for e in EVALUATIONS:
        names = ', '.join(f'`{name}`' for name in (e.name, *e.aliases))
        parameters = ', '.join(
            f'`{f.name}`' if f.default is None else f'`{f.name}` {f.default:.4g}'
            for f in dataclasses.fields(e.parameters)
        )
        rows.append((names, e.title, e.norm, listed(e.needs), listed(e.also), parameters))
    return rows


def parameters() -> list[tuple[str, ...]]:
    """Table of their parameters."""
    rows: list[tuple[str, ...]] = [('of', 'parameters')]
    for kind in dict.fromkeys(e.parameters for e in EVALUATIONS):
        rows.append(
            (listed(tuple(e.name for e in EVALUATIONS if e.parameters is kind)), ' '.join((kind.__doc__ or '').split()))
        )
    return rows


def listed(names: tuple[str, ...]) -> str:
    """Names as code."""
    return ', '.join(f'`{name}`' for name in names)


def signals() -> list[tuple[str, ...]]:
    """Table of sources of signals."""
    rows: list[tuple[str, ...]] = [('signal', '', 'unit', 'from')]
    rows += [
        (f'`{name}`', text, unit, '; or '.join(channels(way) for way in ways))
        for name, (unit, text, ways) in WAYS.items()
    ]
    return rows


def channels(way: Way) -> str:
    """The channels of a way, whole groups by their name."""
    left = list(way.channels)
    found = []
    for group, members in GROUPS.items():
        if all(name in left for name in members):
            found.append(group)
            left = [name for name in left if name not in members]
    return ', '.join(f'`{name}`' for name in (*found, *left))


def maneuvers() -> list[tuple[str, ...]]:
    """Table of their maneuvers."""
    rows: list[tuple[str, ...]] = [
        ('maneuver', 'file', 'speed at the start', 'time', 'amplitude of the steering wheel')
    ]
    for e in EVALUATIONS:
        d = e.drive
        if d is None:
            continue
        amplitude = (
            '' if not d.amplitude else 'series from the angle at 0.3 g' if d.series else f'for {d.reaches:.3g} m/s^2'
        )
        road = f', road `{d.road}.yaml`' if d.road else ''
        rows.append(
            (f'`{e.name}`', f'`{d.maneuver}.yaml`{road}', f'{3.6 * d.speed:.4g} km/h', f'{d.duration:g} s', amplitude)
        )
    return rows


if __name__ == '__main__':
    FILE.write_text(render(FILE.read_text(encoding='utf-8')), encoding='utf-8')
