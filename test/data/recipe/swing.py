"""A toy study of the recipe in docs/contributing.md: how the energy error of a swinging pendulum falls with the
step."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from mbd_sim_ros.lab.studies.report import COLOURS, Report, figure
from solver import load_scene, simulation_of

SUMMARY = 'energy error of a pendulum over the step'
STEPS = (0.02, 0.01, 0.005)  # s
SECONDS = 2.0


def study(out: Path, *, quick: bool, progress: Callable[[str, float], None]) -> dict:
    """See mbd_sim_ros.lab.studies."""
    rows = []
    for k, h in enumerate(STEPS[:2] if quick else STEPS):
        progress(f'step {h:g} s', k / len(STEPS))
        simulation = simulation_of(load_scene('pendulum', [f'integrator.h={h}', 'integrator.rho_inf=1']))
        simulation.advance(round(SECONDS / h))
        rows.append({'step [s]': h, 'energy error [J]': simulation.totals()['energy_error_max']})
    steps, errors = (np.array([row[name] for row in rows]) for name in ('step [s]', 'energy error [J]'))
    order = float(np.polyfit(np.log(steps), np.log(errors), 1)[0])
    report = Report(out, 'A pendulum over the step')
    report.text(f'Without damping of the method, over {SECONDS:g} s, the error falls with order {order:.2f}.')
    report.table('errors', rows)
    picture, axes = figure(4.0, 3.0)
    axes[0, 0].loglog(steps, errors, 'o-', color=COLOURS[0])
    axes[0, 0].set(xlabel='step [s]', ylabel='energy error [J]')
    report.figure('errors', picture, 'error over step')
    report.check('order of the energy error', order, 1.9, least=True)
    report.write()
    return {'order': order, 'checks': report.checks}
