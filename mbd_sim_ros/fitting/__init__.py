"""Fitting a vehicle to recordings (docs/fitting.md): what they tell of its parameters, how well, and what they do not.

from mbd_sim_ros import fitting

problem = fitting.load('fit.yaml')
told = fitting.preflight(problem)          # before any fit: standard errors, pairs, maneuvers that would help
fitted = fitting.fit(problem, 'out/fit')   # parameters, intervals, held-out recordings
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mbd_sim_ros.fitting.estimation import fit
    from mbd_sim_ros.fitting.foresight import preflight
    from mbd_sim_ros.fitting.loading import load
    from mbd_sim_ros.fitting.problem import Problem
    from mbd_sim_ros.fitting.results import write

__all__ = ['Problem', 'fit', 'load', 'preflight', 'write']
_HOMES = {
    'load': 'mbd_sim_ros.fitting.loading',
    'Problem': 'mbd_sim_ros.fitting.problem',
    'preflight': 'mbd_sim_ros.fitting.foresight',
    'fit': 'mbd_sim_ros.fitting.estimation',
    'write': 'mbd_sim_ros.fitting.results',
}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
