"""Numerical errors of the figures of an evaluation: the same scene with the double step, judged the same way.

A recording of ours holds its scene. That is simulated again with the double step, and its figures are those of the
recording but for the error of the step; what they differ by is taken for it as in solver.analysis.error_bar. The double
step may shake where the step of the recording does not: an interval is then wider than the error.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path

from mbd_sim_ros import interrupts
from mbd_sim_ros.analysis.evaluation.figures import Figure, Result
from mbd_sim_ros.analysis.evaluation.judging import judge, read
from mbd_sim_ros.analysis.evaluation.kinds import Evaluation
from mbd_sim_ros.batch import simulate
from solver import load_scene_text, simulation_of
from solver.analysis.error_bar import order
from solver.errors import BagError, MbdError


def with_intervals(evaluation: Evaluation, result: Result, place: Path, given: Mapping[str, float]) -> Result:
    """The result of a recording with the numerical errors of its figures; with a note that says why where there are
    none. given: parameters of the evaluation, as for judge()."""
    try:
        return _measured(evaluation, result, place, given)
    except MbdError as error:
        return dataclasses.replace(
            result, notes=(*result.notes, f'the numerical errors of the figures were not measured: {error}')
        )


def _measured(evaluation: Evaluation, result: Result, place: Path, given: Mapping[str, float]) -> Result:
    run, _, scene = read(place)
    if scene is None or 'resolved_scene' not in run.metadata:
        raise BagError(f'{place} does not hold the scene that it is of')
    doubled = [f'integrator.h={2 * scene.integrator.h_ns * 1e-9!r}', f'record.every={max(1, scene.record.every // 2)}']
    simulation = simulation_of(load_scene_text(run.metadata['resolved_scene'], scene.name, doubled))
    interrupts.now(f'measuring the numerical errors of {place}')
    with interrupts.scratch('mbd-intervals-') as directory:
        simulate(simulation, simulation.scene.steps, directory=directory / 'run')
        other, held, its = read(directory / 'run')
        twin = judge(evaluation, other, str(place), given, held=held, scene=its)
    factor = 1.0 / (2.0 ** order(simulation) - 1.0)
    values = {figure.name: figure.value for figure in twin.figures}
    return dataclasses.replace(
        result, figures=tuple(_with_error(one, values.get(one.name, math.nan), factor) for one in result.figures)
    )


def _with_error(figure: Figure, other: float, factor: float) -> Figure:
    """A figure with its error, by its value with the double step."""
    error = factor * abs(figure.value - other)
    return figure._replace(error=error) if math.isfinite(error) else figure
