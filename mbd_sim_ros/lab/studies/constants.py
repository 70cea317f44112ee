"""Numbers of the solver that somebody chose, each at a third and at three times its value: which of them does anything?

All numbers that modules of FOLDERS name are found in their syntax. Each is changed in a process of its own
(mbd_sim_ros.lab.studies.constants_changed), which runs the whole set: the scenes of config/scenes and random
mechanisms. Every run is compared with the unchanged one:

- *nothing*: every bit, every counter and every finding is the same.
- *rounding*: findings are the same, and no number departs by more than rounding: RESOLVED of its own size and LOST of
  the largest in its field.
- *within*: findings are the same, and no number departs by more than the error that its run has anyway, 4/3 of the
  difference from the run with half the step (the method is of second order), of vectors that of the worst component.
- *matters*: all else, also another status, a failure, and a run that does not end.

The word of a constant is the largest one of all its runs. A constant that does nothing here may still decide what the
set does not contain: models that are refused, starts that fail, and the sentences on them.
"""

from __future__ import annotations

import json
import math
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.lab.studies import Progress
from mbd_sim_ros.lab.studies.cells import ROOT, Cells, number
from mbd_sim_ros.lab.studies.constants_changed import LIMIT, OUTCOMES, Member, Outcome
from mbd_sim_ros.lab.studies.constants_found import Constant, constants
from mbd_sim_ros.lab.studies.report import COLOURS, Report, figure

FOLDERS = ('solver/start', 'solver/step')  # first the one without kernels, which needs no compilation
SUMMARY = 'chosen numbers of step and start at a third and at three times: what each does to scenes and mechanisms'
CHANGED = 'mbd_sim_ros.lab.studies.constants_changed'
FACTORS = (1.0 / 3.0, 3.0)
SECONDS, QUICK_SECONDS = 2.0, 0.2  # of a scene; ten times as much for the full set is a day
MECHANISMS, MECHANISM_SECONDS = 200, 0.5
RESOLVED, LOST = 1e-9, 1e-12  # rounding of a number, of its size and of its field's largest; ten times hides effects
NOTHING, ROUNDING, WITHIN, MATTERS = WORDS = ('nothing', 'rounding', 'within', 'matters')
VECTORS = {'pose': (3, 4), 'twist': (3, 3), 'imu': (3, 3), 'acceleration': (3, 3)}  # sizes of vectors
HEADINGS = 'What matters', 'Within the error', 'Rounding only', 'Nothing in this set'
Errors = dict[Member, dict[str, np.ndarray] | None]


class Variant:
    """Runs with one constant changed, in a process that is started with the first of them; close it."""

    def __init__(self, constant: Constant, factor: float) -> None:
        self._constant, self._value = constant, constant.times(factor)
        self._process: subprocess.Popen | None = None
        self._derived = tempfile.TemporaryDirectory()

    def __enter__(self) -> Variant:
        return self

    def __exit__(self, *_: Any) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None
        self._derived.cleanup()

    def run(self, member: Member) -> Outcome:
        """One run. A process that ends at it is an outcome; the next run starts another one."""
        if self._process is None:
            command = [sys.executable, '-m', CHANGED, self._constant.module, self._constant.name]
            command += [json.dumps(self._value), self._derived.name]
            pipes: dict[str, Any] = {'stdin': subprocess.PIPE, 'stdout': subprocess.PIPE, 'stderr': subprocess.DEVNULL}
            self._process = subprocess.Popen(command, cwd=ROOT, start_new_session=True, text=True, **pipes)
        process = self._process
        assert process.stdin is not None and process.stdout is not None
        line = ''
        try:
            process.stdin.write(json.dumps(member) + '\n')
            process.stdin.flush()
            line = process.stdout.readline()
        except BrokenPipeError:
            pass
        if line.endswith('\n'):
            return Outcome(**dict(zip(Outcome._fields, json.loads(line), strict=True)))
        code, self._process = process.wait(), None
        if code == -signal.SIGPROF:
            return Outcome('no end', f'no end within {LIMIT:g} s of CPU time')
        return Outcome('crashed', f'the process ended with {signal.Signals(-code).name if code < 0 else code}')


def compared(changed: Outcome, base: Outcome, error: dict[str, np.ndarray] | None) -> dict[str, Any]:
    """One run with a changed constant beside the unchanged one: word, statuses, field of the largest departure and its
    size in errors of the run, counters that differ as they were and are."""
    row: dict[str, Any] = {'status': changed.status, 'before': base.status, 'text': ''}
    row.update(field='', errors=0.0, departure=0.0)
    now, then = dict(changed.counters), dict(base.counters)
    row['counters'] = {name: [was, now[name]] for name, was in then.items() if now.get(name, was) != was}
    verdict = changed.status, list(changed.findings)
    as_before = verdict == (base.status, list(base.findings))
    if as_before and (changed.text, changed.digest, now) == (base.text, base.digest, then):
        return {**row, 'word': NOTHING}
    if not as_before:
        return {**row, 'word': MATTERS, 'text': changed.text}
    if not base.numbers:  # it failed before, and fails in other words
        return {**row, 'word': WITHIN, 'text': changed.text}
    values, word = _by_field(changed), ROUNDING
    for name, reference in _by_field(base).items():
        floor, mine = _floor(reference), values[name]
        departure = np.where(np.isnan(reference) & np.isnan(mine), 0.0, np.abs(mine - reference)).max(axis=0)
        if not np.all(np.isfinite(departure)):
            return {**row, 'word': MATTERS, 'field': name, 'errors': math.nan, 'text': 'not finite'}
        if np.any(departure > floor):
            word = max(word, WITHIN, key=WORDS.index)
            scale = floor if error is None else np.maximum(floor, error[name])
            ratios = departure / np.maximum(scale, 1e-300)
            worst = int(ratios.argmax())
            if ratios[worst] > row['errors']:
                row.update(field=name, errors=float(ratios[worst]), departure=float(departure[worst]))
    if row['errors'] > 1.0:
        word = MATTERS
    return {**row, 'word': word}


def errors_of(base: Outcome, halved: Outcome) -> dict[str, np.ndarray] | None:
    """Error of every number of a run by field, from the run with half the step; None where that failed."""
    if not base.numbers or not halved.numbers:
        return None
    fine = _by_field(halved)
    columns = {name: 4.0 / 3.0 * np.abs(values - fine[name]).max(axis=0) for name, values in _by_field(base).items()}
    return {name: _of_vectors(errors, VECTORS.get(name, (1,))) for name, errors in columns.items()}


def _of_vectors(errors: np.ndarray, sizes: Sequence[int]) -> np.ndarray:
    """Errors of columns; all of a vector have its largest, for a direction that symmetry spares has none of its own."""
    shared, begin = errors.copy(), 0
    while begin < len(errors):
        for size in sizes:
            shared[begin : begin + size] = errors[begin : begin + size].max()
            begin += size
    return shared


def _by_field(outcome: Outcome) -> dict[str, np.ndarray]:
    rows = np.array(outcome.numbers, float)  # null of a kept cell is nan
    ends = np.cumsum([size for _, size in outcome.fields]).tolist()
    return {name: rows[:, end - size : end] for (name, size), end in zip(outcome.fields, ends, strict=True) if size}


def _floor(values: np.ndarray) -> np.ndarray:
    """Rounding of every column."""
    sizes = np.abs(np.nan_to_num(values))
    return RESOLVED * sizes.max(axis=0) + LOST * sizes.max()


def members(*, quick: bool) -> list[Member]:
    """The set: all scenes, and unless it is quick the random mechanisms."""
    scenes = sorted(file.stem for file in (ROOT / 'config' / 'scenes').glob('*.yaml'))
    chosen = [Member(name, QUICK_SECONDS if quick else SECONDS) for name in scenes]
    if not quick:
        from mbd_sim_ros.lab.mechanisms.families import drawn

        chosen += [Member(drawn(k, 0).name, MECHANISM_SECONDS, k) for k in range(MECHANISMS)]
    return chosen


def study(out: Path, *, quick: bool, progress: Progress, folders: Sequence[str] = FOLDERS) -> dict:
    """Vary all constants of the folders."""
    found, chosen = constants(folders), members(quick=quick)
    varied = [one for one in found if not one.kept]
    cells = Cells(out / 'cells', [f'mbd_sim_ros/lab/studies/{name}.py' for name in ('constants', 'constants_changed')])
    units = len(FACTORS) * len(varied) + 3  # times of the whole set
    base, errors = _unchanged(cells, varied[0], chosen, progress, 2.0 / units)
    rows = []
    with Variant(varied[0], 1.0) as same:  # the control: changed to what it is, in another process
        control = [cells.cell(f'control {m}', partial(_compute, same, m, base, errors)) for m in chosen]
    for k, constant in enumerate(varied):
        for j, factor in enumerate(FACTORS):
            done = (3 + len(FACTORS) * k + j) / units
            runs = _runs(cells, constant, factor, base, errors, progress, done)
            rows.append(_summary(constant, factor, runs))
    return _report(out, found, rows, control, base)


def _unchanged(
    cells: Cells, any_one: Constant, chosen: Sequence[Member], progress: Progress, share: float
) -> tuple[dict[Member, Outcome], Errors]:
    """Every run of the set as it is, and its errors."""
    base: dict[Member, Outcome] = {}
    errors: Errors = {}
    with Variant(any_one, 1.0) as variant:
        for k, member in enumerate(chosen):
            progress(f'as it is: {member.scene}', share * k / len(chosen))
            pair = []
            for one in (member, member._replace(halved=True)):
                row = cells.cell(f'as it is {one}', partial(_as_it_is, variant, one))
                pair.append(Outcome(**{name: row[name] for name in Outcome._fields}))
            base[member], errors[member] = pair[0], errors_of(*pair)
    return base, errors


def _as_it_is(variant: Variant, member: Member) -> dict[str, Any]:
    return variant.run(member)._asdict()


def _runs(
    cells: Cells,
    constant: Constant,
    factor: float,
    base: dict[Member, Outcome],
    errors: Errors,
    progress: Progress,
    done: float,
) -> list[dict[str, Any]]:  # fmt: skip
    """The set with one constant changed, up to the first run that does not end."""
    rows = []
    with Variant(constant, factor) as variant:
        for member in base:
            name = f'{constant.key} {constant.times(factor)!r} {member}'
            progress(f'{constant.key} = {constant.times(factor):.4g}: {member.scene}', done)
            rows.append(cells.cell(name, partial(_compute, variant, member, base, errors)))
            if rows[-1]['status'] == 'no end':
                break
    return rows


def _compute(variant: Variant, member: Member, base: dict[Member, Outcome], errors: Errors) -> dict[str, Any]:
    return {'member': member.scene, **compared(variant.run(member), base[member], errors[member])}


def _summary(constant: Constant, factor: float, runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """All runs with one value in one row."""
    word = max((run['word'] for run in runs), key=WORDS.index)
    worst = max(runs, key=lambda run: (WORDS.index(run['word']), np.nan_to_num(number(run['errors']), nan=math.inf)))
    counted: dict[str, list[list[float]]] = {}
    for run in runs:
        for name, pair in run['counters'].items():
            counted.setdefault(name, []).append(pair)
    return {
        'constant': constant.key,
        'at': constant.place,
        'value': constant.value,
        'factor': factor,
        'changed to': constant.times(factor),
        'does': word,
        'runs': len(runs),
        **{name: sum(run['word'] == name for run in runs) for name in WORDS},
        'other status': sum(run['status'] != run['before'] for run in runs),
        'failed': sum(run['status'] not in ('ok', 'suspect') and run['before'] in ('ok', 'suspect') for run in runs),
        'errors': number(worst['errors']),
        'departure': number(worst['departure']),
        'field': worst['field'],
        'worst': worst['member'] if word != NOTHING else '',
        'text': worst['text'],
        'counters': {name: max(pairs, key=_change) for name, pairs in counted.items()},
    }


def _change(pair: Sequence[float]) -> float:
    was, now = pair
    return abs(math.log((now + 1.0) / (was + 1.0)))


def told(row: dict[str, Any]) -> str:
    """Effect of one value, as a cell of the table."""
    if row['does'] == NOTHING:
        return NOTHING
    parts = [row['does'] if row['does'] != WITHIN else 'within the error']
    if row['does'] == MATTERS:
        parts[0] += f' in {row[MATTERS]} of {row["runs"]} runs'
    if row['errors'] > 0.0:
        parts.append(f'up to {row["errors"]:.2g} errors of {row["field"]} ({row["departure"]:.2g} in {row["worst"]})')
    if row['other status']:
        parts.append(f'another status in {row["other status"]}, {row["failed"]} failed')
    parts += [f'{name} {was} to {now}' for name, (was, now) in row['counters'].items()]
    return ', '.join(parts)


def _report(
    out: Path,
    found: Sequence[Constant],
    rows: Sequence[dict[str, Any]],
    control: Sequence[dict[str, Any]],
    base: dict[Member, Outcome],
) -> dict[str, Any]:
    """Write the report; the figures of the study."""
    report = Report(out, 'Constants')
    varied = [one for one in found if not one.kept]
    of = {one.key: [row for row in rows if row['constant'] == one.key] for one in varied}
    words = {key: max((row['does'] for row in mine), key=WORDS.index) for key, mine in of.items()}
    mechanisms, longest = sum(member.number >= 0 for member in base), max(member.seconds for member in base)
    statuses = ', '.join(f'{n} {name}' for name in OUTCOMES if (n := sum(o.status == name for o in base.values())))
    report.text(
        f'{len(varied)} chosen numbers at a third and at three times their value, integers rounded, each in '
        f'{len(base)} runs: {len(base) - mechanisms} scenes and {mechanisms} random mechanisms '
        f'of at most {longest:g} s. As it is: {statuses}. {len(found) - len(varied)} numbers are not varied.'
    )
    report.text('## Numbers by what they do')
    report.table('words', [{'does': word, 'constants': sum(w == word for w in words.values())} for word in WORDS])
    for word, heading in zip(reversed(WORDS), HEADINGS, strict=True):
        mine = [one for one in varied if words[one.key] == word]
        report.text(f'## {heading}')
        if mine:
            report.table(word, [_line(one, of[one.key]) for one in mine])
        else:
            report.text('None.')
    report.text('## Not varied')
    kept = [{**_named(one), 'why': one.kept} for one in found if one.kept]
    if kept:
        report.table('kept', kept)
    report.table('runs', [{**row, 'counters': json.dumps(row['counters'])} for row in rows], shown=False)
    report.figure('errors', _picture(varied, rows), 'Largest departure by constant, in errors of its run')
    report.check('runs that differ with every number as it is', sum(row['word'] != NOTHING for row in control), 0)
    bare = sum(words[one.key] == MATTERS and not one.comment for one in varied)
    report.check('numbers that matter and have no reason beside them', bare, 0)
    report.write()
    return {'words': words, 'rows': rows, 'checks': report.checks}


def _line(one: Constant, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    by_factor = {row['factor']: row for row in rows}
    third, three = (told(by_factor[factor]) for factor in FACTORS)
    return {**_named(one), 'a third': third, 'three times': three}


def _named(one: Constant) -> dict[str, Any]:
    return {'constant': f'`{one.name}`', 'at': one.place, 'value': one.value}


def _picture(varied: Sequence[Constant], rows: Sequence[dict[str, Any]]) -> Any:
    shown = [one for one in varied if any(row['errors'] > 0.0 for row in rows if row['constant'] == one.key)]
    new, axes = figure(8.0, 1.2 + 0.17 * max(4, len(shown)))
    ax = axes[0, 0]
    for factor, colour in zip(FACTORS, COLOURS, strict=False):
        points = [
            (row['errors'], k) for k, one in enumerate(shown) for row in rows
            if (row['constant'], row['factor']) == (one.key, factor) and row['errors'] > 0.0
        ]  # fmt: skip
        if points:
            ax.plot(*np.array(points).T, '.', color=colour, label=f'times {factor:.3g}')
            ax.set_xscale('log')
    ax.axvline(1.0, lw=0.7, color='#999999')
    ax.set_yticks(range(len(shown)), [f'{one.module.rpartition(".")[2]}.{one.name}' for one in shown], fontsize=6)
    ax.set_xlabel('largest departure, in errors of the run')
    if ax.get_legend_handles_labels()[0]:
        ax.legend(fontsize=7, frameon=False)
    return new
