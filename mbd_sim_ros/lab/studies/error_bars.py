"""Error bars against true errors: random mechanisms and delivered scenes, at several steps.

The true error of a run is that against a run of the same scene from the same start with the step FINEST, iterated to
tolerance; where that is apart from one with twice the step by more than a share of UNCLEAR, or a tenth of the error,
there is no reference. Its physics is that of the run: what is asked here is what a step costs.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.lab.mechanisms.families import FAMILIES, drawn
from mbd_sim_ros.lab.studies import Progress
from mbd_sim_ros.lab.studies.cells import Cells, number
from mbd_sim_ros.lab.studies.report import Report
from solver import load_scene, simulation_of
from solver.analysis.certificate_coverage import weighed
from solver.analysis.envelope import Envelope
from solver.analysis.error_bar import ErrorBar, Twin
from solver.analysis.error_curves import curves_of
from solver.analysis.verdict import status_of
from solver.checks.error import LARGEST, LIMITS
from solver.errors import MbdError
from solver.scene import Scene
from solver.simulation import Simulation

SUMMARY = 'stated errors of runs against their true errors: random mechanisms and delivered scenes'
DRAWS = True
SAMPLES, QUICK_SAMPLES = 300, 4
STEPS = (0.01, 0.005, 0.002, 0.001, 0.0005)  # s
DURATION = 1.0  # s, of mechanisms
FINEST, EVERY = 1.25e-4, 1e-3  # s: of references, the coarser one has twice that; and between their instants
MOST = 10_000  # steps of a call
UNCLEAR = 2e-3  # of the peak, between both references
OFF, NEAR = 0.05, 0.01  # of the peak: off by more is wrong, by less is right
WITHIN = 2.0  # factor between a stated and a true error
SEEN = 1e-4  # of the peak: below it nobody asks for the factor
SCENES = {  # delivered scenes and steps [s]
    'car_step_steer': (0.001, 0.002, 0.005, 0.01),
    'car_lane_change': (0.001, 0.002, 0.005, 0.01),
    'car_circle': (0.001, 0.005, 0.01),
    'car_split_mu_brake': (0.001, 0.002),
    'light_car_lane_change': (0.001, 0.002, 0.005, 0.008, 0.01),
    'light_car_straight': (0.001, 0.005, 0.008, 0.01),
    'light_car_brake': (0.001, 0.002, 0.005),
    'double_pendulum': (0.001,),
    'four_bar_n': (0.001,),
    'slider_crank': (0.001, 0.01),
}


def study(out: Path, *, quick: bool, progress: Progress, n: int | None = None, seed: int = 0) -> dict:
    """Runs of n mechanisms of the series of a seed, and of the delivered scenes."""
    count = n if n is not None else QUICK_SAMPLES if quick else SAMPLES
    cells, rows = Cells(out / 'cells', ['mbd_sim_ros/lab/studies/error_bars.py']), list[dict[str, Any]]()
    steps = STEPS[1:4:2] if quick else STEPS
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', RuntimeWarning)
        for k in range(count):
            mechanism = drawn(k, seed)
            progress(f'{k} of {count}: {mechanism.name}', k / (count + len(SCENES)))
            of = partial(_of_mechanism, mechanism, steps)
            rows += cells.cell(f'{mechanism.name} {seed} {steps}', of)['runs']
        for k, (name, wanted) in enumerate(() if quick else SCENES.items()):
            progress(name, (count + k) / (count + len(SCENES)))
            rows += cells.cell(f'{name} {wanted}', partial(_of_scene, name, wanted))['runs']
    report = Report(out, 'Error bars')
    report.text(
        f'{count} random mechanisms (seed {seed}) of {len(FAMILIES)} families, {DURATION:g} s each, and delivered '
        'scenes. Errors are the '
        'largest of a deciding quantity over time, as part of its peak (mbd_sim_ros.lab.studies.error_bars).'
    )
    known = [row for row in rows if row['status'] in ('ok', 'suspect') and number(row['true']) == number(row['true'])]
    for title, some in (
        ('mechanisms', [r for r in known if r['family']]),
        ('scenes', [r for r in known if not r['family']]),
    ):
        if some:
            report.text(f'## {title.capitalize()}')
            report.table(
                title,
                [_counts(h, [r for r in some if r['h'] == h]) for h in sorted({r['h'] for r in some})]
                + [_counts(0.0, some)],
            )
    report.table('runs', rows, shown=False)
    of_all = _counts(0.0, known)
    report.check('ok runs that are off by more than 5 % [%]', of_all['ok, off by more than 5 %'], 0.5)
    report.check('suspect runs within 1 % [%]', of_all['suspect, within 1 %'], 5.0)
    report.check('stated errors within a factor of two [%]', of_all['stated within a factor of 2'], 90.0, least=True)
    report.write()
    return {'n': count, 'seed': seed, 'all': of_all, 'checks': report.checks}


def _counts(h: float, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """A row of a table. h: step [s], 0 for all."""
    ok, suspect = ([r for r in rows if r['status'] == status] for status in ('ok', 'suspect'))
    before = [r for r in rows if r['before'] == 'ok']
    stated = [r['stated'] / r['true'] for r in rows if r['true'] > SEEN and not r['sensitive']]

    def percent(part: Iterable[bool]) -> float:
        found = [*part]
        return 100.0 * sum(found) / len(found) if found else 0.0

    return {
        'step [ms]': h * 1e3 if h else 'all',
        'ok': len(ok),
        'ok, off by more than 5 %': percent(r['true'] > OFF for r in ok),
        'suspect': len(suspect),
        'suspect, within 1 %': percent(r['true'] < NEAR for r in suspect),
        'stated within a factor of 2': percent(1.0 / WITHIN < ratio < WITHIN for ratio in stated),
        'ok without a twin': len(before),
        'of these off by more than 5 %': percent(r['true'] > OFF for r in before),
        'suspect without a twin, within 1 %': percent(r['true'] < NEAR for r in rows if r['before'] == 'suspect'),
    }


def _of_mechanism(mechanism: Any, steps: Sequence[float]) -> dict[str, Any]:
    try:
        reference = Reference(simulation_of(mechanism.at(DURATION, h=steps[0])), DURATION, FINEST, EVERY)
    except MbdError as error:
        return {'runs': [_failed(mechanism.family, mechanism.name, 0.0, str(error))]}
    return {'runs': [_run(mechanism.at(DURATION, h=h), mechanism.family, mechanism.name, reference) for h in steps]}


def _of_scene(name: str, steps: Sequence[float]) -> dict[str, Any]:
    coarsest = simulation_of(load_scene(name, [f'integrator.h={max(steps)!r}']))
    reference = Reference(coarsest, coarsest.scene.duration, FINEST, EVERY)
    return {'runs': [_run(load_scene(name, [f'integrator.h={h!r}']), '', name, reference) for h in steps]}


class Reference:
    """Two runs of the scene of a simulation from its start, with steps of `finest` and twice that [s]: numbers every so
    often [s]."""

    def __init__(self, simulation: Simulation, duration: float, finest: float, every: float) -> None:
        self.every, self.runs = every, list[np.ndarray]()
        for h in (finest, 2.0 * finest):
            one = simulation.twin(duration, h=h, mode='tolerance', tolerance=1e-10, step_policy='rescue')
            found, n = [one.snapshot().numbers], round(every / h)
            try:
                for _ in range(round(duration / every)):
                    found.append(one.advance(n, audit=False).numbers)
            except MbdError:
                self.runs.clear()
                return
            self.runs.append(np.array(found))

    def at(self, times: np.ndarray) -> list[np.ndarray]:
        """Both runs at instants [s]; none where one of them failed."""
        places = np.rint(times / self.every).astype(int)
        return [run[places] for run in self.runs]


def _failed(family: str, name: str, h: float, text: str) -> dict[str, Any]:
    nothing = dict.fromkeys(('before', 'stated', 'true', 'spread', 'findings', 'quantity'))
    return {'family': family, 'name': name, 'h': h, 'status': 'error', 'sensitive': False, 'text': text, **nothing}


def _run(scene: Scene, family: str, name: str, reference: Reference) -> dict[str, Any]:
    """A run with its error bar and its true error."""
    h = scene.integrator.h
    try:
        simulation = simulation_of(scene)
        simulation.advance(1)
        simulation.reset()
        envelope = Envelope(simulation)
        twin = Twin(simulation, simulation.scene.steps)
        rows = [simulation.snapshot().numbers]
        look = envelope.every(simulation.h_ns)
        while twin.next is not None:
            snapshot = simulation.advance(min(twin.next - simulation.k, look - simulation.k % look if look else MOST))
            if look and simulation.k % look == 0:
                envelope.look(snapshot)
            if simulation.k == twin.next:
                rows.append(snapshot.numbers)
            twin.note(snapshot)
        for _ in twin.make():
            pass
    except MbdError as error:
        return _failed(family, name, h, str(error))
    bar = twin.result()
    found, before = weighed(simulation, envelope, error=bar), weighed(simulation, envelope)
    true, quantity, spread = _true(simulation, np.array(rows), reference.at(np.array(twin.instants) * h))
    return {
        'family': family, 'name': name, 'h': h, 'status': status_of(found.suspect), 'before': status_of(before.suspect),
        'true': true,
        'quantity': quantity, 'spread': spread, 'stated': _stated(bar), 'sensitive': bar.sensitive is not None,
        'text': bar.text,
        'findings': '; '.join(f'{f.quantity} {f.of} {f.value:.3g}' for f in found.suspect),
    }  # fmt: skip


def _stated(bar: ErrorBar) -> float:
    """The largest stated share of a deciding quantity; of forces, which may be off by more, in proportion."""
    return bar.worst * LARGEST


def _true(simulation: Simulation, rows: np.ndarray, fine: Sequence[np.ndarray]) -> tuple[float, str, float]:
    """(largest true share of the deciding quantities, which one, that between both references); nan without a
    reference."""
    if not fine:
        return np.nan, '', np.nan
    worst, which, spread = 0.0, '', 0.0
    for curve in curves_of(simulation):
        if curve.name in LIMITS:
            scale = LARGEST / LIMITS[curve.name]
            peaks = curve.peaks(fine[0])
            share = scale * float((curve.apart(rows, fine[0]) / peaks).max())
            spread = max(spread, scale * float((curve.apart(fine[1], fine[0]) / peaks).max()))
            if share > worst:
                worst, which = share, curve.name
    return (worst, which, spread) if spread < max(UNCLEAR, 0.1 * worst) else (np.nan, which, spread)
