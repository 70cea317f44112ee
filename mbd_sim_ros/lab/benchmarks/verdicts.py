"""The figures of a benchmark for people: aligned text, or the same tables as Markdown."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from mbd_sim_ros.lab.benchmarks.growth import LIMIT
from mbd_sim_ros.lab.benchmarks.overhead import FIGURES as OVERHEAD_FIGURES
from mbd_sim_ros.lab.benchmarks.phases import PHASES
from mbd_sim_ros.lab.benchmarks.stepping import FIGURES as STEPPING_FIGURES
from mbd_sim_ros.lab.benchmarks.suite import MEASURES
from solver.errors import MbdError


class Table(NamedTuple):
    """One table: its title, what its numbers are, its rows with the header first, and what its figures or lines mean,
    by name."""

    title: str
    about: str
    rows: list[list[str]]
    meaning: Mapping[str, str] = MappingProxyType({})


TITLES = {  # of the measures whose table has one line per case and one column per figure
    'single': ('Single steps beside an idle loop', 'CPU time of one thread.'),
    'growth': ('Growth with the number of bodies', 'CPU time of steps in a batch, and memory.'),
    'threads': ('Simulations in threads', ''),
    'levels': ('Levels of detail', 'CPU time of one thread, in turns.'),
    'lanes': (
        'Eight cars in the lanes of a core',
        'CPU time of one thread per car and step, in turns with the same cars one after the other.',
    ),
    'peers': (
        'The car on a rig, here and in Exudyn',
        'CPU time per simulated millisecond on one core, in turns.',
    ),
    'linkage': (
        'N four-bar linkages, here, in Exudyn and in MuJoCo',
        'CPU time per simulated millisecond on one core, in turns, of the fastest run that is as accurate; empty where '
        'none is.',
    ),
    'start': ('Start', ''),
    'node': ('The node at work', 'Elapsed time, all cores; commanded over topics, everything published and recorded.'),
    'node_levels': (
        'The node at its levels of detail',
        'CPU time of all threads of the node, paced in real time.',
    ),
    'node_and_reader': ('The node at work, every topic with a reader', 'As above.'),
}


def tables(report: dict[str, Any]) -> list[Table]:
    """Everything that was measured, table by table; tables without rows are left out."""
    measured = [case for case in report['cases'] if case['status'] == 'ok']
    of = {name: [case for case in measured if case['measure'] == name] for name in MEASURES}
    found: list[Table] = []
    if of['steps']:
        found += [_stepping(of['steps']), _phases(of['steps']), _elements(of['steps'])]
    for name, (title, about) in TITLES.items():
        found.append(_plain(title, about, of[name], MEASURES[name].figures))
        if name == 'peers':
            about = 'Iterations and factorizations per step.'
            found.append(
                _runs('Runs on the rig', about, of[name], {key: key for key in ('iterations', 'factorizations')})
            )
        if name == 'linkage':
            about = (
                'error: largest distance of a centre of mass from the exact solution; gap: of the two points of a '
                'joint.'
            )
            found.append(_runs('Runs of the linkages', about, of[name], {'gap': 'gap [um]'}))
        if name == 'growth':
            found.append(_exponents(report['growth']))
    found += [_overhead(of['record'] + of['publish']), _targets(report['cases']), _unavailable(report['cases'])]
    return [table for table in found if len(table.rows) > 1]


def _number(value: float | None) -> str:
    if value is None or not math.isfinite(value):
        return ''
    if isinstance(value, int):
        return str(value)
    return f'{value:.2f}' if abs(value) < 10.0 else f'{value:.1f}' if abs(value) < 100.0 else f'{value:.0f}'


def _plain(title: str, about: str, cases: Sequence[dict[str, Any]], figures: Mapping[str, str]) -> Table:
    """One line per case, one column per figure; sizes of the model where the case has them."""
    sizes = [name for name in ('bodies', 'rows', 'steps') if all(name in case for case in cases)]
    rows = [['case', *sizes, *figures]]
    rows += [
        [case['name'], *(str(case[name]) for name in sizes), *(_number(case['figures'][name]) for name in figures)]
        for case in cases
    ]
    return Table(title, about, rows, figures)


def _runs(title: str, about: str, cases: Sequence[dict[str, Any]], more: Mapping[str, str]) -> Table:
    """Every run of every program; more: figures beside time and error, with their titles."""
    rows = [['case', 'program', 'settings', 'h [ms]', 'us per ms', 'error [um]', *more.values()]]
    for case in cases:
        for run in case['runs']:
            numbers = (
                ['failed'] if run['us'] is None else [_number(float(run[name])) for name in ('us', 'error', *more)]
            )
            row = [case['name'], run['program'], run['settings'], f'{run["h"] * 1e3:g}', *numbers]
            rows.append(row + [''] * (len(rows[0]) - len(row)))
    return Table(title, about, rows)


def _exponents(growth: Sequence[dict[str, Any]]) -> Table:
    rows = [['scene', 'bodies', 'time', 'time, two largest', 'memory', 'memory, two largest', f'at most {LIMIT:g}']]
    for row in growth:
        numbers = (row[name] for name in ('step', 'step_at_last', 'memory', 'memory_at_last'))
        met = 'yes' if row['met'] else 'NO'
        rows.append(
            [row['scene'], f'{row["smallest"]} to {row["largest"]}', *(f'{number:.3f}' for number in numbers), met]
        )
    about = (
        'Exponents of the number of bodies: of a line through the logarithms of all sizes, and between the two largest.'
    )
    return Table('Exponents', about, rows)


def _stepping(cases: Sequence[dict[str, Any]]) -> Table:
    header = [
        'case',
        'h [ms]',
        'bodies',
        'rows',
        *STEPPING_FIGURES,
        'x real time',
        'iterations',
        'factorizations',
        'evaluations',
    ]
    rows = [header]
    for case in cases:
        counters = case['counters']['audited']
        rows.append(
            [case['name'], f'{case["h"] * 1e3:g}', str(case['bodies']), str(case['rows'])]
            + [_number(case['figures'][figure]) for figure in STEPPING_FIGURES]
            + [_number(case['real_time_factor']), *(f'{counters[name]:.3g}' for name in header[-3:])]
        )
    return Table('A step', 'CPU time in us; counters are those of an audited step.', rows, STEPPING_FIGURES)


def _phases(cases: Sequence[dict[str, Any]]) -> Table:
    rows = [['case', *PHASES, 'whole'], *([case['name'], *map(_number, case['phases'].values())] for case in cases)]
    about = (
        'CPU time in us per audited step: every compiled piece of a step repeated alone on the data of a real one, '
        'times its calls.'
    )
    return Table('Phases of a step', about, rows, PHASES)


def _elements(cases: Sequence[dict[str, Any]]) -> Table:
    names = [*dict.fromkeys(name for case in cases for name in case['elements'] if name != 'bodies'), 'bodies']
    about = (
        'CPU time in us per evaluation with tangents, by kind; bodies: gyroscopic terms, gravity and the clearing '
        'of the arrays.'
    )
    rows = [
        ['case', *names],
        *([case['name'], *(_number(case['elements'].get(name)) for name in names)] for case in cases),
    ]
    return Table('Force elements', about, rows)


def _overhead(cases: Sequence[dict[str, Any]]) -> Table:
    rows = [['case', 'h [ms]', 'rate [Hz]', 'topics', 'with a reader', 'bytes', *OVERHEAD_FIGURES]]
    for case in cases:
        rows.append(
            [
                case['name'],
                f'{case["h"] * 1e3:g}',
                f'{case["rate"]:g}',
                str(case['topics']),
                str(case['published_topics']),
                str(case['bytes_per_step']),
            ]
            + [_number(case['figures'][figure]) for figure in OVERHEAD_FIGURES]
        )
    return Table(
        'Publishing and recording',
        'CPU time in us in a loop paced in real time; rate: of the messages.',
        rows,
        OVERHEAD_FIGURES,
    )


def _targets(cases: Sequence[dict[str, Any]]) -> Table:
    rows = [['case', 'figure', 'value', 'target', 'met']]
    for case in cases:
        for target in case['targets']:
            value = target['value']
            met = {True: 'yes', False: 'NO', None: 'not measured'}[target['met']]
            rows.append(
                [case['name'], target['figure'], '' if value is None else _number(value), f'{target["limit"]:g}', met]
            )
    return Table('Targets', '', rows)


def _unavailable(cases: Sequence[dict[str, Any]]) -> Table:
    rows = [
        [case['name'], reason] for case in cases for reason in (case['reason'], *case.get('left_out', [])) if reason
    ]
    return Table('Not measured', '', [['case', 'reason'], *rows])


def machine(report: dict[str, Any]) -> list[str]:
    """Sentences about the machine and the run."""
    m, d = report['machine'], report['disturbance']
    return [
        f'{m["cpu"]}, {m["cores"]} cores ({m["host_target"]}), {m["system"]}',
        f'Python {m["python"]}, numpy {m["numpy"]}, numba {m["numba"]}, LLVM {m["llvm"]}; solver {m["source_hash"]}',
        f'one core, {report["rounds"]} rounds over all cases; reading the CPU clock takes {m["clock_us"]:.2f} us and '
        'is not subtracted',
        f'load average before the run {m["load_average"]:.2f}; the thread waited for its core {d["waited"]:.1%} of '
        f'the time, the hypervisor took {d["stolen"]:.1%} of the core',
        *(f'WARNING: {text}' for text in report['warnings']),
    ]


def text(report: dict[str, Any]) -> str:
    """All tables, aligned."""
    blocks = ['\n'.join(machine(report))]
    for title, _, rows, _ in tables(report):
        widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
        left = [all(not _is_number(row[k]) for row in rows[1:]) for k in range(len(widths))]
        lines = (
            '  '.join(
                c.ljust(w) if words else c.rjust(w) for c, w, words in zip(row, widths, left, strict=True)
            ).rstrip()
            for row in rows
        )
        blocks.append(f'{title}\n' + '\n'.join(lines))
    return '\n\n'.join(blocks)


def _is_number(cell: str) -> bool:
    return bool(re.fullmatch(r'-?[0-9.e+-]+', cell))


def markdown(report: dict[str, Any], level: int = 2) -> str:
    """All tables as Markdown, with what the figures mean. level: of the headings."""
    blocks = ['\n'.join(f'- {line}' for line in machine(report))]
    for title, about, rows, meaning in tables(report):
        head, *body = (f'| {" | ".join(row)} |' for row in rows)
        lines = [
            f'{"#" * level} {title}',
            '',
            *([about, ''] if about else []),
            head,
            '|' + '---|' * len(rows[0]),
            *body,
        ]
        lines += [*([''] if meaning else []), *(f'- {name}: {text}' for name, text in meaning.items())]
        blocks.append('\n'.join(lines))
    return '\n\n'.join(blocks) + '\n'


def require_place(file: Path) -> None:
    """Raise MbdError or OSError where write() could not write a file: what is measured takes minutes."""
    there = file.exists()
    try:
        if there and not file.is_file():
            raise MbdError(f'--out {file}: is a pipe or a device; name a file .md')
        if there:
            file.read_text(encoding='utf-8')
    except UnicodeDecodeError:
        raise MbdError(f'--out {file}: is no text, so no tables can be put into it; name a file .md') from None
    file.parent.mkdir(parents=True, exist_ok=True)
    file.open('a').close()
    if not there:
        file.unlink()


def write(report: dict[str, Any], file: Path, command: str, suite: str = '') -> None:
    """Write the tables into a Markdown file. Only the generated part is replaced, or added, in a file that exists.
    Raises OSError.

    suite: name of a suite beside the usual one; it has a part of its own, one level of headings deeper.
    """
    begin = f'<!-- begin bench {suite}'.rstrip() + ' -->\n'
    part = f'{begin}Made by `{command}`.\n\n{markdown(report, 3 if suite else 2)}<!-- end -->\n'
    before = file.read_text(encoding='utf-8') if file.exists() else '# Performance\n'
    after, found = re.subn(re.escape(begin) + '.*?<!-- end -->\n', lambda _: part, before, count=1, flags=re.DOTALL)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(after if found else f'{before}\n{part}', encoding='utf-8')
