"""Fills the figures of README.md from the tables that commands wrote: `python docs/tools/readme.py` rewrites them, a
test compares.

The tables are those of docs/performance.md (`mbd bench`) and docs/validation.md (`mbd study validation`).
"""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
FILE = ROOT / 'README.md'
PART = re.compile(r'(<!-- begin figures -->\n).*?(<!-- end -->)', re.DOTALL)


def render(text: str) -> str:
    """The README with its figures made anew."""
    return PART.sub(lambda m: m[1] + table() + m[2], text)


def table() -> str:
    """The figures as a table of Markdown. Raises LookupError where a page no longer holds one of them."""
    bench = (ROOT / 'docs' / 'performance.md').read_text(encoding='utf-8')
    car = row(bench, 'A step', 'car_1ms')
    rig = row(bench, 'The car on a rig, here and in Exudyn', 'car_on_rig')
    bars = row(bench, 'N four-bar linkages, here, in Exudyn and in MuJoCo', 'four_bar_20_in_other_programs')
    validation = (ROOT / 'docs' / 'validation.md').read_text(encoding='utf-8')
    agreed = re.search(r'(\d+) of (\d+) quantities are within their limits', validation)
    if agreed is None:
        raise LookupError('docs/validation.md does not say how many quantities are within their limits')
    rows = [
        (
            f'the full car ({car["bodies"]} bodies), 1 ms steps',
            f'{car["x real time"]} times real time on one core',
            '',
            'mbd bench --cases car_1ms',
        ),
        (
            f'the same number of bodies, joints and bushings on a rig: CPU time for {car["h [ms]"]} ms, and error',
            f'{rig["ours"]} us, {rig["our_error"]} um',
            f'Exudyn {rig["exudyn"]} us, {rig["exudyn_error"]} um',
            'mbd bench --cases car_on_rig',
        ),
        (
            f'twenty four-bar linkages ({bars["rows"]} constraints) through singular positions, within 0.1 mm: CPU '
            'time for 1 ms',
            f'{bars["ours_01mm"]} us',
            f'Exudyn {bars["exudyn_01mm"]} us, MuJoCo {bars["mujoco_01mm"]} us',
            'mbd bench --cases four_bar_20_in_other_programs',
        ),
        (
            'published motions and reactions of Adams, IFToMM benchmarks and others',
            f'{agreed[1]} of {agreed[2]} quantities as published, to their last digit or accuracy',
            '',
            'mbd study validation',
        ),
    ]
    lines = ['| | mbd_sim_ros | others | made by |', '|---|---|---|---|']
    return ''.join(f'{line}\n' for line in (*lines, *(f'| {a} | {b} | {c} | `{d}` |' for a, b, c, d in rows)))


def row(text: str, heading: str, case: str) -> dict[str, str]:
    """The row of a case in the table below a heading, by column. Raises LookupError."""
    part = text.partition(f'\n## {heading}\n')[2].partition('\n## ')[0]
    cells = [
        [cell.strip() for cell in line.strip('|').split('|')] for line in part.splitlines() if line.startswith('|')
    ]
    found = next((one for one in cells if one[0] == case), None)
    if found is None:
        raise LookupError(f'docs/performance.md: no row {case} below {heading!r}')
    return dict(zip(cells[0], found, strict=True))


if __name__ == '__main__':
    FILE.write_text(render(FILE.read_text(encoding='utf-8')), encoding='utf-8')
