"""Results of a sweep: the table of all cases, sensitivities of figures to parameters, and a report in HTML."""

from __future__ import annotations

import base64
import csv
import html
import importlib
import io
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.analysis.pages import plain_page, write_text
from mbd_sim_ros.sweep.case import Row
from mbd_sim_ros.sweep.design import SENSITIVITY, Sweep, problem
from solver.errors import BagError

# Range of a figure over all cases, relative to its size (or to 1 in SI units), that counts as none: rounding. Ten times
# as much would hide no effect that matters.
ROUNDING = 1e-12
# half width of a 95 % confidence interval of a Sobol index (0 to 1) from which on the report warns of few samples
CLEAR = 0.1
COLOURS = {'ok': '#0072b2', 'suspect': '#e69f00', 'error': '#d55e00'}


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
    sweep: Sweep, rows: Sequence[Row], indices: dict[str, Any], units: Mapping[str, str], directory: Path, title: str
) -> Path:
    """Write report.html: counts, least and largest value of every figure with their cases, pictures, indices, failures.

    units: parameter or figure -> unit, where it has one. Raises BagError.
    """
    counts = {status: sum(row['status'] == status for row in rows) for status in COLOURS}
    parts = [f'<p>{len(rows)} cases: {", ".join(f"{n} {status}" for status, n in counts.items())}.</p>']
    for figure, meaning in sweep.figures.items():
        known = [row for row in rows if math.isfinite(row[figure])]
        parts.append(f'<h2>{html.escape(figure)}: {html.escape(meaning.text)}</h2>')
        if not known:
            parts.append('<p>no case has a value</p>')
            continue
        low, high = min(known, key=lambda row: row[figure]), max(known, key=lambda row: row[figure])
        parts.append(
            f'<p>from {low[figure]:.6g} (case {low["case"]}) to {high[figure]:.6g} {units.get(figure, "")} (case '
            f'{high["case"]})</p>'
        )
        parts.append(
            f'<img alt="{html.escape(figure)}" src="data:image/png;base64,{_picture(sweep, known, figure, units)}">'
        )
        parts += [f'<p>{html.escape(reason)}</p>'] if (reason := no_indices(sweep, rows, figure)) else []
        if figure in indices:
            keys = list(next(iter(indices[figure].values())))
            ranked = 'ST' if 'ST' in keys else 'mu_star'
            rows_ = ''.join(
                f'<tr><td>{html.escape(name)}</td>{"".join(f"<td>{found[key]:.4g}</td>" for key in keys)}</tr>'
                for name, found in sorted(indices[figure].items(), key=lambda item: -abs(item[1][ranked]))
            )
            parts += [f'<p>{html.escape(doubt)}</p>'] if (doubt := known_to(sweep, indices[figure])) else []
            parts.append(
                f'<table><tr><th>parameter</th>{"".join(f"<th>{key}</th>" for key in keys)}</tr>{rows_}</table>'
            )
    failed = [row for row in rows if row['status'] != 'ok']
    if failed:
        parts.append('<h2>Not ok</h2><table><tr><th>case</th><th>status</th><th>what was found</th></tr>')
        parts += [
            f'<tr><td>{row["case"]}</td><td>{row["status"]}</td><td>{html.escape(row["message"])}</td></tr>'
            for row in failed
        ]
        parts.append('</table>')
    file = directory / 'report.html'
    write_text(file, plain_page(title, parts))
    return file


def _picture(sweep: Sweep, rows: Sequence[Row], figure: str, units: Mapping[str, str]) -> str:
    """Picture of the figure over every parameter, as PNG in base64."""
    from matplotlib.figure import Figure

    names = list(sweep.parameters)
    across = min(3, len(names))
    down = math.ceil(len(names) / across)
    drawing = Figure(figsize=(4.2 * across, 3.0 * down), dpi=90, layout='constrained')
    for k, name in enumerate(names):
        axes = drawing.add_subplot(down, across, k + 1)
        for status, colour in COLOURS.items():
            some = [row for row in rows if row['status'] == status]
            if some:
                axes.plot(
                    [row[name] for row in some],
                    [row[figure] for row in some],
                    'o',
                    color=colour,
                    markersize=4,
                    label=status,
                )
        axes.set_xlabel(_with_unit(name, units), fontsize=9)
        axes.set_ylabel(_with_unit(figure, units) if k % across == 0 else '', fontsize=9)
        axes.tick_params(labelsize=8)
        axes.grid(color='#e5e5e5')
        if k == 0:
            axes.legend(fontsize=8)
    out = io.BytesIO()
    drawing.savefig(out, format='png')
    return base64.b64encode(out.getvalue()).decode()


def _with_unit(name: str, units: Mapping[str, str]) -> str:
    return f'{name} [{units[name]}]' if units.get(name) else name


def get_ready() -> None:
    """Import the libraries for table and report. That takes a second, which costs nothing while the cases run."""
    for library in ('pyarrow.parquet', 'matplotlib.figure'):
        with suppress(ImportError):
            importlib.import_module(library)
