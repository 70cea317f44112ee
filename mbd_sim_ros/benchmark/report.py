"""The figures of a benchmark for people: aligned text, or the same tables as Markdown."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from mbd_sim_ros.benchmark.overhead import FIGURES as OVERHEAD_FIGURES
from mbd_sim_ros.benchmark.phases import PHASES
from mbd_sim_ros.benchmark.stepping import FIGURES as STEPPING_FIGURES


class Table(NamedTuple):
    """One table: its title, what its numbers are, its rows with the header first, and what its figures or lines mean, by name."""

    title: str
    about: str
    rows: list[list[str]]
    meaning: Mapping[str, str] = MappingProxyType({})


GENERATED = re.compile(r'<!-- begin bench -->\n.*?<!-- end -->\n', re.DOTALL)


def tables(report: dict[str, Any]) -> list[Table]:
    """Everything that was measured, table by table; tables without rows are left out."""
    measured = [case for case in report['cases'] if case['status'] == 'ok']
    stepping = [case for case in measured if case['measure'] == 'steps']
    overhead = [case for case in measured if case['measure'] != 'steps']
    found: list[Table] = []
    if stepping:
        found += [_stepping(stepping), _growth(stepping), _phases(stepping), _elements(stepping)]
    if overhead:
        found.append(_overhead(overhead))
    found += [_targets(report['cases']), _unavailable(report['cases'])]
    return [table for table in found if len(table.rows) > 1]


def _number(value: float) -> str:
    return f'{value:.2f}' if abs(value) < 10.0 else f'{value:.1f}' if abs(value) < 100.0 else f'{value:.0f}'


def _stepping(cases: Sequence[dict[str, Any]]) -> Table:
    header = ['case', 'h [ms]', 'bodies', 'rows', *STEPPING_FIGURES, 'x real time', 'iterations', 'factorizations', 'evaluations']
    rows = [header]
    for case in cases:
        counters = case['counters']['audited']
        rows.append(
            [case['name'], f'{case["h"] * 1e3:g}', str(case['bodies']), str(case['rows'])]
            + [_number(case['us'][figure]) for figure in STEPPING_FIGURES]
            + [_number(case['real_time_factor']), *(f'{counters[name]:.3g}' for name in header[-3:])]
        )
    return Table('A step', 'CPU time in us; counters are those of an audited step.', rows, STEPPING_FIGURES)


def _growth(cases: Sequence[dict[str, Any]]) -> Table:
    """How time and memory grow between the smallest and the largest model of a scene: the exponent n of bodies^n."""
    rows = [['scene', 'bodies', 'us of the smallest', 'us of the largest', 'time', 'kB of the smallest', 'kB of the largest', 'memory']]
    for scene in dict.fromkeys(case['scene'] for case in cases):
        sizes = {case['bodies']: case for case in cases if case['scene'] == scene}
        if len(sizes) < 2:
            continue
        small, large = sizes[min(sizes)], sizes[max(sizes)]
        ratio = math.log(large['bodies'] / small['bodies'])
        row = [scene, f'{small["bodies"]} to {large["bodies"]}']
        for values in ((small['us']['batch'], large['us']['batch']), (small['bytes'] / 1e3, large['bytes'] / 1e3)):
            row += [*map(_number, values), f'{math.log(values[1] / values[0]) / ratio:.3f}']
        rows.append(row)
    about = 'Steps in a batch, and the arrays of model, state and step; time and memory are the exponents of the number of bodies.'
    return Table('Growth with the number of bodies', about, rows)


def _columns(cases: Sequence[dict[str, Any]], names: Sequence[str], value: Callable[[dict[str, Any], str], str]) -> list[list[str]]:
    """One row per name, one column per case."""
    return [['us', *(case['name'] for case in cases)], *([name, *(value(case, name) for case in cases)] for name in names)]


def _phases(cases: Sequence[dict[str, Any]]) -> Table:
    rows = _columns(cases, [*PHASES, 'whole'], lambda case, name: _number(case['phases'][name]))
    about = 'CPU time in us per audited step: every compiled piece of a step repeated alone on the data of a real one, times its calls.'
    return Table('Phases of a step', about, rows, PHASES)


def _elements(cases: Sequence[dict[str, Any]]) -> Table:
    names = list(dict.fromkeys(name for case in cases for name in case['elements'] if name != 'bodies'))
    about = 'CPU time in us per evaluation with tangents, by kind; bodies: gyroscopic terms, gravity and the clearing of the arrays.'
    show = lambda case, name: _number(case['elements'][name]) if name in case['elements'] else ''  # noqa: E731
    return Table('Force elements', about, _columns(cases, [*names, 'bodies'], show))


def _overhead(cases: Sequence[dict[str, Any]]) -> Table:
    rows = [['case', 'rate [Hz]', 'topics', 'with a reader', 'bytes', *OVERHEAD_FIGURES]]
    for case in cases:
        rows.append(
            [case['name'], f'{case["rate"]:g}', str(case['topics']), str(case['published_topics']), str(case['bytes_per_step'])]
            + [_number(case['us'][figure]) for figure in OVERHEAD_FIGURES]
        )
    return Table('Publishing and recording', 'CPU time in us per step of a loop paced in real time.', rows, OVERHEAD_FIGURES)


def _targets(cases: Sequence[dict[str, Any]]) -> Table:
    rows = [['case', 'figure', 'us', 'target', 'met']]
    for case in cases:
        for target in case['targets']:
            value = target['value']
            met = {True: 'yes', False: 'NO', None: 'not measured'}[target['met']]
            rows.append([case['name'], target['figure'], '' if value is None else _number(value), f'{target["limit"]:g}', met])
    return Table('Targets', '', rows)


def _unavailable(cases: Sequence[dict[str, Any]]) -> Table:
    rows = [[case['name'], case['reason']] for case in cases if case['status'] != 'ok']
    return Table('Not measured', '', [['case', 'reason'], *rows])


def machine(report: dict[str, Any]) -> list[str]:
    """Sentences about the machine and the run."""
    m, d = report['machine'], report['disturbance']
    return [
        f'{m["cpu"]}, {m["cores"]} cores ({m["host_target"]}), {m["system"]}',
        f'Python {m["python"]}, numpy {m["numpy"]}, numba {m["numba"]}, LLVM {m["llvm"]}; solver {m["source_hash"]}',
        f'one core, {report["rounds"]} rounds over all cases; reading the CPU clock takes {m["clock_us"]:.2f} us and is not subtracted',
        f'load average before the run {m["load_average"]:.2f}; the thread waited for its core {d["waited"]:.1%} of the time, '
        f'the hypervisor took {d["stolen"]:.1%} of the core',
        *(f'WARNING: {text}' for text in report['warnings']),
    ]


def text(report: dict[str, Any]) -> str:
    """All tables, aligned."""
    blocks = ['\n'.join(machine(report))]
    for title, _, rows, _ in tables(report):
        widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
        left = [all(not _is_number(row[k]) for row in rows[1:]) for k in range(len(widths))]
        lines = (
            '  '.join(c.ljust(w) if words else c.rjust(w) for c, w, words in zip(row, widths, left, strict=True)).rstrip() for row in rows
        )
        blocks.append(f'{title}\n' + '\n'.join(lines))
    return '\n\n'.join(blocks)


def _is_number(cell: str) -> bool:
    return bool(re.fullmatch(r'-?[0-9.e+-]+', cell))


def markdown(report: dict[str, Any]) -> str:
    """All tables as Markdown, with what the figures mean."""
    blocks = ['\n'.join(f'- {line}' for line in machine(report))]
    for title, about, rows, meaning in tables(report):
        head, *body = (f'| {" | ".join(row)} |' for row in rows)
        lines = [f'## {title}', '', *([about, ''] if about else []), head, '|' + '---|' * len(rows[0]), *body]
        lines += [*([''] if meaning else []), *(f'- {name}: {text}' for name, text in meaning.items())]
        blocks.append('\n'.join(lines))
    return '\n\n'.join(blocks) + '\n'


def write(report: dict[str, Any], file: Path, command: str) -> None:
    """Write the tables into a Markdown file. Of a file that has a generated part only that part is replaced. Raises OSError."""
    part = f'<!-- begin bench -->\nMade by `{command}`.\n\n{markdown(report)}<!-- end -->\n'
    before = file.read_text(encoding='utf-8') if file.exists() else ''
    if GENERATED.search(before):
        after = GENERATED.sub(lambda _: part, before, count=1)
    else:
        after = f'# Performance\n\n{part}'
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(after, encoding='utf-8')
