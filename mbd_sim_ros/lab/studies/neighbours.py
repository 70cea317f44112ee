"""Errors held against those of the neighbouring steps alone, beside the judgement by all others
(mbd_sim_ros.lab.mechanisms.judgement).

The next coarser and the next finer run may have missed the motion themselves, and then allow much; the other steps that
are ok allow less, but where few of them resolve the motion they compare a run with what it cannot know. So both are
counted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbd_sim_ros.lab.mechanisms.judgement import STAY, WORSE, WRONG
from mbd_sim_ros.lab.studies.cells import number

SILENT, BEYOND = 'silently wrong, by all other steps', 'silently wrong, by the neighbouring steps'


def within(runs: Sequence[Mapping[str, Any]], k: int) -> bool:
    """True where the error of run k is at most WORSE times the one that second order predicts from its neighbours, the
    mean of both predictions, and not as large as with the next coarser step: then it does not converge. False without a
    neighbour that came to its end.

    Errors are in proportion to `unseen` where runs have it (judgement), else to the square of the step.
    """
    h = [run['h'] for run in runs]
    scale = [run.get('unseen') or run['h'] ** 2 for run in runs]
    error = [number(run['error']) for run in runs]
    known = [i for i in range(len(runs)) if i != k and np.isfinite(error[i])]
    coarser = min((i for i in known if h[i] > h[k]), key=h.__getitem__, default=None)
    finer = max((i for i in known if h[i] < h[k]), key=h.__getitem__, default=None)
    neighbours = [i for i in (coarser, finer) if i is not None]
    if not neighbours or (coarser is not None and error[k] > STAY * error[coarser]):
        return False
    return bool(error[k] <= WORSE * scale[k] * np.mean([error[i] / scale[i] for i in neighbours]))


def silent(rows: Sequence[Mapping[str, Any]]) -> tuple[int, int]:
    """(runs that are silently wrong, those of them that are not within what their neighbours allow either)."""
    wrong = [(row['runs'], k) for row in rows for k, run in enumerate(row['runs']) if run['judgement'] == WRONG]
    return len(wrong), sum(not within(runs, k) for runs, k in wrong)
