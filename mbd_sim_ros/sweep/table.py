"""Results of a sweep: the table of all cases, sensitivities of figures to parameters, and a report in HTML."""

from __future__ import annotations

import csv
import importlib
import io
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.analysis import pages
from mbd_sim_ros.analysis.pages import Block, Page, write_text
from mbd_sim_ros.sweep.case import Row
from mbd_sim_ros.sweep.design import SENSITIVITY, Parameter, Sweep, problem
from solver.errors import BagError

# Range of a figure over all cases, relative to its size (or to 1 in SI units), that counts as none: rounding. Ten times
# as much would hide no effect that matters.
ROUNDING = 1e-12
# half width of a 95 % confidence interval of a Sobol index (0 to 1) from which on the report warns of few samples
CLEAR = 0.1
STATUSES = {'ok': 1, 'suspect': 4, 'error': 0}  # status -> colour of its points (page.js)
LISTED = 12  # values of a parameter at the head of the page; ten times as many fill it
CASES = 2000  # in the table of the page; ten times as many take seconds to open


def write_table(rows: Sequence[Row], directory: Path) -> Path:
    """Write all rows in the order of their cases, to sweep.parquet, or to sweep.csv without pyarrow. Raises
    BagError."""
    columns = {name: [row[name] for row in rows] for name in rows[0]}
    for name, values in columns.items():
        if any(isinstance(value, str) for value in values):
            columns[name] = [value if isinstance(value, str) else repr(value) for value in values]
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        file = directory / 'sweep.csv'
        text = io.StringIO()
        writer = csv.writer(text, lineterminator='\n')
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
        write_text(file, text.getvalue())
        return file
    file = directory / 'sweep.parquet'
    try:
        parquet.write_table(pa.table(columns), file)
    except OSError as error:
        raise BagError(f'cannot write {file}: {error.strerror or error}; choose another place') from None
    return file


def sensitivities(sweep: Sweep, rows: Sequence[Row]) -> dict[str, dict[str, dict[str, float]]]:
    """Sensitivity indices: figure -> parameter -> index -> value, by SALib.

    A design of kind morris has mu_star and sigma, of elementary effects over the whole range [Morris1991]. A design of
    kind saltelli has S1 and ST, first-order and total [Saltelli2010]. Other designs have none, and neither has a figure
    that no_indices() names. An index with the ending _conf is the half width of the 95 % confidence interval of the
    index of that name, by bootstrap; with few samples it is as large as the index.
    """
    if sweep.design.kind not in SENSITIVITY:
        return {}
    result: dict[str, dict[str, dict[str, float]]] = {}
    asked, names = problem(sweep), list(sweep.parameters)
    at = np.array([[float(row[name]) for name in names] for row in rows])
    for figure in sweep.figures:
        if no_indices(sweep, rows, figure):
            continue
        values = np.array([float(row[figure]) for row in rows])
        if sweep.design.kind == 'morris':
            from SALib.analyze import morris

            found = morris.analyze(asked, at, values, seed=sweep.design.seed)
            keys: tuple[str, ...] = ('mu_star', 'mu_star_conf', 'sigma')
        else:
            from SALib.analyze import sobol

            found = sobol.analyze(asked, values, calc_second_order=False, seed=sweep.design.seed)
            keys = ('S1', 'S1_conf', 'ST', 'ST_conf')
        result[figure] = {name: {key: float(found[key][i]) for key in keys} for i, name in enumerate(names)}
    return result


def no_indices(sweep: Sweep, rows: Sequence[Row], figure: str) -> str:
    """Sentence on why sensitivities() has no indices of a figure; '' if it has, or if the design asks for none."""
    if sweep.design.kind not in SENSITIVITY:
        return ''
    values = np.array([float(row[figure]) for row in rows])
    missing = int(np.sum(~np.isfinite(values)))
    if missing:
        return f'no indices of {figure}: {missing} of {len(rows)} cases have no value'
    same = np.ptp(values) <= ROUNDING * max(1.0, float(np.abs(values).max()))
    return f'no indices of {figure}: it is the same in all cases' if same else ''


def known_to(sweep: Sweep, indices: Mapping[str, Mapping[str, float]]) -> str:
    """Sentence on the uncertainty of the Sobol indices of a figure; '' if it is below CLEAR, and for indices of Morris.

    The uncertainty is the widest confidence interval, but at least 1/sqrt(samples): a bootstrap of few samples
    underestimates it. Indices of Morris only rank parameters.
    """
    widths = [value for one in indices.values() for key, value in one.items() if key in ('S1_conf', 'ST_conf')]
    width = max([1.0 / math.sqrt(sweep.design.samples), *widths]) if widths else 0.0
    if not width > CLEAR:
        return ''
    needed = sweep.design.samples * 2 ** math.ceil(2.0 * math.log2(width / CLEAR))
    few = f'samples = {sweep.design.samples} are few, about {needed} would give {CLEAR:g}'
    return f'its indices are known to about {width:.2g} (95 % confidence): {few}'


def write_report(
    sweep: Sweep,
    rows: Sequence[Row],
    indices: dict[str, Any],
    units: Mapping[str, str],
    directory: Path,
    title: str,
    facts: Sequence[tuple[str, str]] = (),
) -> Path:
    """Write report.html: counts, least and largest value of every figure with their cases, charts, indices, the table
    of all cases.

    units: parameter or figure -> unit, where it has one. facts: what the sweep is of. Raises BagError.
    """
    counts = {status: sum(row['status'] == status for row in rows) for status in STATUSES}
    blocks: list[Block] = []
    points = len(rows) * len(sweep.parameters) * len(sweep.figures)
    every = max(1, math.ceil(2 * points / pages.LARGEST))  # cases of which one is drawn
    for figure, meaning in sweep.figures.items():
        known = [row for row in rows if math.isfinite(row[figure])]
        blocks.append(pages.heading(f'{figure}: {meaning.text}'))
        if not known:
            blocks.append(pages.text('no case has a value'))
            continue
        low, high = min(known, key=lambda row: row[figure]), max(known, key=lambda row: row[figure])
        unit = units.get(figure, '')
        said = [f'from {low[figure]:.6g} (case {low["case"]}) to {high[figure]:.6g} {unit} (case {high["case"]})']
        said += [f'one of {every} cases is drawn'] if every > 1 else []
        said += [reason] if (reason := no_indices(sweep, rows, figure)) else []
        said += [doubt] if figure in indices and (doubt := known_to(sweep, indices[figure])) else []
        blocks.append(pages.text(*said))
        if figure in indices:
            keys = list(next(iter(indices[figure].values())))
            ranked = 'ST' if 'ST' in keys else 'mu_star'
            found = sorted(indices[figure].items(), key=lambda item: -abs(item[1][ranked]))
            blocks.append(
                pages.table([('parameter', *keys), *((name, *(one[key] for key in keys)) for name, one in found)])
            )
        blocks.append(pages.charts([_chart(sweep, known[::every], figure, name, units) for name in sweep.parameters]))
    blocks.append(pages.heading('Cases'))
    columns = [name for name in rows[0] if name not in ('message', 'bag')]
    shown = sorted(rows, key=lambda row: row['status'] == 'ok')[:CASES]
    if len(rows) > CASES:
        blocks.append(pages.text(f'{CASES} of {len(rows)} cases, those that are not ok first; the table has all.'))
    head = [*(_with_unit(name, units) for name in columns), 'what was found']
    lines = [[*(row[name] for name in columns), row['message']] for row in shown]
    blocks.append(pages.table([head, *lines], bad=[k for k, row in enumerate(shown) if row['status'] != 'ok']))
    file = directory / 'report.html'
    said_ = ', '.join(f'{n} {status}' for status, n in counts.items())
    Page(
        title=title,
        verdict=f'{len(rows)} cases: {said_}',
        ok=counts['ok'] == len(rows),
        facts=[
            *facts,
            ('parameters', '; '.join(f'{name}: {_range(one)}' for name, one in sweep.parameters.items())),
            ('design', sweep.design.text),
        ],
        blocks=blocks,
    ).write(file)
    return file


def _range(parameter: Parameter) -> str:
    if parameter.ranged:
        return f'{parameter.low:g} to {parameter.high:g}'
    if len(parameter.values) > LISTED:
        first, last = parameter.values[0], parameter.values[-1]
        return f'{len(parameter.values)} values, the first is {first}, the last {last}'
    return ', '.join(value if isinstance(value, str) else f'{value:g}' for value in parameter.values)


def _chart(sweep: Sweep, rows: Sequence[Row], figure: str, name: str, units: Mapping[str, str]) -> Block:
    """A figure over a parameter, a point for each case; values that are text have their place in the list."""
    listed = [value for value in sweep.parameters[name].values if isinstance(value, str)]
    where = ', '.join(f'{k} = {value}' for k, value in enumerate(listed))

    def place(row: Row) -> float:
        return float(listed.index(row[name])) if row[name] in listed else float(row[name])

    curves = []
    for status, colour in STATUSES.items():
        some = [row for row in rows if row['status'] == status]
        if some:
            x, y = np.array([place(row) for row in some]), np.array([row[figure] for row in some])
            curves.append(pages.curve(status, x, y, points=3.5, colour=colour))
    title = f'{figure} over {name}'
    return pages.chart(title, _with_unit(name, units), _with_unit(figure, units), curves, note=where)


def _with_unit(name: str, units: Mapping[str, str]) -> str:
    return f'{name} [{units[name]}]' if units.get(name) else name


def get_ready() -> None:
    """Import the library for the table. That takes a second, which costs nothing while the cases run."""
    with suppress(ImportError):
        importlib.import_module('pyarrow.parquet')
