"""Results of a fit on disk: the vehicle file, samples of its distribution with a sweep of them, numbers, and a page."""

from __future__ import annotations

import csv
import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.analysis import pages
from mbd_sim_ros.analysis.pages import write_text
from mbd_sim_ros.analysis.provenance import facts_of_scene
from mbd_sim_ros.analysis.rating import rate
from mbd_sim_ros.fitting.estimation import Fitted, report
from mbd_sim_ros.fitting.foresight import Told
from mbd_sim_ros.fitting.sensors import KINDS
from mbd_sim_ros.fitting.similar import read_back
from mbd_sim_ros.fitting.unknowns import with_unit
from solver.disk import plain, sources
from solver.files.yaml_tree import node_of, text_of

SAMPLES = 64  # of the distribution, a power of two; ten times as many make a sweep of hours
SHOWN = 4  # windows held out that the page shows, of every signal; ten times as many make a page of megabytes
DRAWN = 6  # vectors by which the page draws what the parameters leave open; ten times as many take minutes
TRUST = 'The intervals are somewhat too small: of 95 % ones 93 % hold the truth of synthetic drives (docs/fitting.md)'
RELATED = 0.8  # correlation from which the page names a pair; from 0.08 on it names nearly all


def write(fitted: Fitted, out: str | Path) -> dict[str, str]:
    """Write all results into a directory; returns their files by what they are. Raises BagError."""
    home = Path(out)
    rated = ratings(fitted)
    numbers = report(fitted) | {'ratings': rated}
    files = {
        'vehicle': home / 'vehicle.yaml',
        'samples': home / 'samples.csv',
        'sweep': home / 'sweep.yaml',
        'page': home / 'fit.html',
        'numbers': home / 'fit.json',
    }
    write_text(files['vehicle'], vehicle_text(fitted))
    write_text(files['samples'], samples_text(fitted))
    write_text(files['sweep'], sweep_text(files['vehicle'].resolve()))
    write_text(files['numbers'], json.dumps(plain(numbers), indent=1))
    page(fitted, rated).write(files['page'])
    return {name: str(file) for name, file in files.items()}


def vehicle_text(fitted: Fitted) -> str:
    """The vehicle file: all data of the vehicle with the numbers that were found, and where they come from."""
    problem = fitted.problem
    values = {name: e.value for name, e in fitted.parameters.items()}
    scene = problem.car.scene(_all(fitted))
    data = read_back(scene.resolved)['vehicle']
    head = [
        f'# Fitted to recordings by mbd fit, from {_base(problem)}; sources {sources()[:12]}.',
        *(
            f'# {name} = {with_unit(f"{values[name]:.6g}", e.unit)}, 95 % from {e.low:.4g} to {e.high:.4g}, '
            f'{"told by the recordings" if e.told else "by what was known before"}'
            for name, e in fitted.parameters.items()
        ),
        *(f'# Recording {name}: {one.file}, {one.use}' for name, one in problem.file.recordings.items()),
        f'# Level {problem.file.level}. Held out: '
        + ', '.join(
            f'{n} RMS {o["rms"]:.3g} {_unit(fitted, n)}, before {o["before"]:.3g}' for n, o in fitted.held_out.items()
        ),
    ]
    return '\n'.join(head) + '\n' + str(text_of(node_of(data, None)))


def _base(problem: Any) -> str:
    """The vehicle that the fit began with, as its file names it."""
    return problem.file.vehicle or f'like {problem.file.like.vehicle}'


def _all(fitted: Fitted) -> dict[str, float]:
    """Numbers of the vehicle at the result, also those that were not sought."""
    values = fitted.problem.values(fitted.x)
    return {u.part: values[u.name] for u in fitted.problem.unknowns if u.of == 'vehicle'}


def _unit(fitted: Fitted, channel: str) -> str:
    return KINDS[fitted.problem.kinds[channel]].unit


def samples_text(fitted: Fitted) -> str:
    """Samples of the numbers of the vehicle, by their keys in a scene, one row each."""
    problem = fitted.problem
    drawn = fitted.samples(SAMPLES, problem.file.seed)
    rows = []
    for x in drawn:
        values = problem.values(x)
        own = problem.car.assignments({u.part: values[u.name] for u in problem.unknowns if u.of == 'vehicle'})
        rows.append(dict(one.split('=') for one in own))
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator='\n')
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def sweep_text(vehicle: Path) -> str:
    """A sweep over the samples: a step steer of the vehicle, with the scatter that the fit leaves."""
    return (
        '# What the fit leaves open of a step steer; other scenes and figures go in the same way (docs/fitting.md).\n'
        f"scene: light_car_step_steer\nset: ['vehicle={vehicle}', duration=4]\n"
        'design: {kind: samples, file: samples.csv}\n'
        'figures:\n  yaw_rate_peak: {quantity: yaw_rate, take: peak}\n'
        '  lateral_acceleration_final: {quantity: lateral_acceleration, take: final}\n'
        '  roll_peak: {quantity: roll, take: peak}\n'
    )


def ratings(fitted: Fitted) -> dict[str, dict[str, float | None]]:
    """By channel the mean rating after ISO/TS 18571 over the windows that are held out, and before; None where they are
    too short for it."""
    problem, which = fitted.problem, fitted.problem.of('held_out')
    after, before = (_signals(fitted, x) for x in (fitted.x, fitted.before))
    found: dict[str, dict[str, float | None]] = {}
    pieces = [p for p in problem.pieces if p.window in set(which)]
    for name in problem.file.channels:
        scores: list[list[float]] = [[], []]
        for k, p in enumerate(pieces):
            if p.channel == name:
                for into, signals in zip(scores, (after, before), strict=True):
                    one = rate(p.t, signals[k], p.y)
                    if one is not None:
                        into.append(one.overall)
        found[name] = {
            key: float(np.mean(some)) if some else None for key, some in zip(('rating', 'before'), scores, strict=True)
        }
    return found


def _signals(fitted: Fitted, x: np.ndarray) -> list[np.ndarray]:
    problem, which = fitted.problem, fitted.problem.of('held_out')
    return problem.signals(x, problem.motions(x, which), which)


def page(fitted: Fitted, rated: dict[str, dict[str, float | None]]) -> pages.Page:
    """The page of a fit."""
    problem = fitted.problem
    others = [e for e in fitted.estimates if not e.sought]
    parameters: list[tuple[str, ...]] = [
        ('parameter', 'value', '95 % from', 'to', 'known before', 'told by the recordings', 'over that of the weights')
    ]
    parameters += [
        (e.name, with_unit(f'{e.value:.5g}', e.unit), f'{e.low:.5g}', f'{e.high:.5g}', _known(problem, e.name),
         'yes' if e.told else 'no: known before', f'{e.widened:.2f}')
        for e in fitted.parameters.values()
    ]  # fmt: skip
    judged: list[tuple[str, ...]] = [
        ('signal', 'RMS of the error', 'RMS before', 'ISO/TS 18571', 'ISO/TS 18571 before')
    ]
    judged += [
        (name, f'{one["rms"]:.3g} {_unit(fitted, name)}', f'{one["before"]:.3g}',
         *(_score(rated[name][key]) for key in ('rating', 'before')))
        for name, one in fitted.held_out.items()
    ]  # fmt: skip
    nuisances: list[tuple[str, ...]] = [('', 'value', '95 % from', 'to')]
    nuisances += [(e.name, with_unit(f'{e.value:.4g}', e.unit), f'{e.low:.4g}', f'{e.high:.4g}') for e in others]
    residuals: list[tuple[str, ...]] = [('signal', 'noise', 'discrepancy', 'its correlation time')]
    residuals += [
        (name, f'{n.noise:.3g} {_unit(fitted, name)}', f'{n.size:.3g}', f'{n.time:.3g} s')
        for name, n in fitted.noise.items()
    ]
    better = [
        f'{name} {one["rms"]:.3g} {_unit(fitted, name)} (before {one["before"]:.3g})'
        for name, one in fitted.held_out.items()
    ]
    of_use = {
        use: ', '.join(name for name, one in problem.file.recordings.items() if one.use == use)
        for use in ('fit', 'held_out')
    }
    resolved = problem.car.scene(_all(fitted)).resolved
    return pages.Page(
        title='Fit of ' + (problem.file.vehicle or 'a vehicle'),
        verdict='RMS of the error on what is held out: ' + ', '.join(better),
        ok=all(one['rms'] <= one['before'] for one in fitted.held_out.values()) or None,
        facts=[
            *(fact for fact in facts_of_scene(resolved, 'fit') if 'vehicle' in fact[0]),
            ('begun with', _base(problem)),
            ('level', problem.file.level),
            ('fitted to', of_use['fit']),
            ('held out', of_use['held_out']),
        ],
        about=(
            f'{fitted.preflight.seconds:.0f} s of recordings in {fitted.preflight.windows} windows, driven open loop '
            f'at level {problem.file.level}; {problem.runs} runs of all windows.',
        ),
        blocks=[
            pages.heading('Parameters'),
            pages.table(parameters),
            pages.text(
                'An interval is that of the scatter of the windows (last column: over that of the weights alone). It '
                'contains what the constants below leave open, and not what the level itself lacks in all drives. '
                f'{TRUST}.'
            ),
            pages.heading('Recordings held out'),
            pages.table(judged),
            pages.text('Before: the vehicle as it was given, with steering and sensors fitted.'),
            pages.charts(_curves(fitted), wide=True),
            pages.heading('Steering, sensors and constants'),
            pages.table(nuisances),
            pages.heading('Residuals'),
            pages.table(residuals),
            pages.heading('Pairs'),
            _pairs(fitted),
            pages.heading('Left out'),
            pages.text(*(problem.told or ['nothing'])),
        ],
    )


def _known(problem: Any, name: str) -> str:
    u = next(u for u in problem.unknowns if u.name == name)
    return f'{u.centre:.5g} \u00b1 {u.sd:.2g}' if math.isfinite(u.sd) else 'nothing'


def _score(value: float | None) -> str:
    return 'too short' if value is None else f'{value:.2f}'


def _pairs(fitted: Fitted) -> pages.Block:
    C, names = fitted.covariance, fitted.problem.names
    sd = np.sqrt(np.diag(C))
    R = C / np.outer(sd, sd)
    found = sorted(
        ((abs(R[i, j]), i, j) for i in range(len(names)) for j in range(i) if abs(R[i, j]) > RELATED), reverse=True
    )
    if not found:
        return pages.text(f'No two unknowns are correlated by more than {RELATED:g}.')
    return pages.table(
        [('', 'and', 'correlation'), *((names[j], names[i], f'{R[i, j]:+.2f}') for _, i, j in found[:20])]
    )


def _curves(fitted: Fitted) -> list[pages.Block]:
    problem, which = fitted.problem, fitted.problem.of('held_out')
    after, before = (_signals(fitted, x) for x in (fitted.x, fitted.before))
    pieces = [p for p in problem.pieces if p.window in set(which)]
    # the band: noise and discrepancy of the signal, and what the parameters leave open
    spread = _spread(fitted)
    found = []
    for name in problem.file.channels:
        own = [k for k, p in enumerate(pieces) if p.channel == name][:SHOWN]
        for k in own:
            p = pieces[k]
            window = problem.windows[p.window]
            t = p.t + window.begin
            band = 1.96 * np.hypot(np.hypot(fitted.noise[name].noise, fitted.noise[name].size), spread[k])
            curves = [
                pages.curve('95 % band', t, after[k] - band, high=after[k] + band, style='band'),
                pages.curve('measured', t, p.y, style='reference', width=2.4),
                pages.curve('before', t, before[k], style='other', dash=2),
                pages.curve('predicted', t, after[k], style='run', dash=1),
            ]
            title = f'{name}, {window.recording} from {window.first:.1f} s'
            found.append(pages.chart(title, 'time [s]', f'{name} [{_unit(fitted, name)}]', curves))
    return found


def _spread(fitted: Fitted) -> list[np.ndarray]:
    """By piece held out: sd of the predicted signal by the parameters, from few samples of their distribution."""
    drawn = list(fitted.samples(DRAWN, fitted.problem.file.seed + 1))
    which = fitted.problem.of('held_out')
    made = []
    for x, motions in zip(drawn, fitted.problem.many(drawn, which), strict=True):
        if isinstance(motions, list):
            made.append(fitted.problem.signals(x, motions, which))
    if len(made) < 2:
        return [np.zeros(p.t.size) for p in fitted.problem.pieces if p.window in set(which)]
    return [np.std(np.stack(some), axis=0, ddof=1) for some in zip(*made, strict=True)]


def text(fitted: Fitted) -> list[str]:
    """Lines for people."""
    lines = ['parameter                         value      95 % interval              told']
    for name, e in fitted.parameters.items():
        lines.append(
            f'{name:30s} {e.value:10.5g}  {e.low:10.5g} to {e.high:10.5g} {with_unit("", e.unit):9s} '
            f'{"yes" if e.told else "no: known before"}'
        )
    lines += [
        f'held out: {name}: RMS {one["rms"]:.3g} {_unit(fitted, name)}, before {one["before"]:.3g}'
        for name, one in fitted.held_out.items()
    ]
    return [*lines, TRUST]


def told_text(told: Told) -> list[str]:
    """Lines for people, of a preflight."""
    lines = [f'{told.seconds:.0f} s of recordings in {told.windows} windows']
    lines += [f'left out: {one}' for one in told.doubts]
    for row in told.rows:
        share = f' ({100.0 * row.alone / abs(row.value):.2g} %)' if row.value else ''
        before = f', known before to {row.before:.3g}' if math.isfinite(row.before) else ', nothing known before'
        line = f'{row.name}: {"told" if row.told else "NOT told"}: '
        line += f'standard error {with_unit(f"{row.alone:.3g}", row.unit)}{share}{before}'
        if row.apart:
            line += '; cannot be told from ' + ', '.join(name for name, _ in row.apart[:3])
        if row.maneuvers:
            line += f'; would be told by: {", ".join(row.maneuvers)}'
        elif not row.told:
            line += '; no delivered maneuver tells it'
        lines.append(line)
    return lines
