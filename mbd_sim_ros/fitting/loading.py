"""The problem of a fit file: of recordings, or of maneuvers that are only planned."""

from __future__ import annotations

from pathlib import Path

from mbd_sim_ros.fitting.file import load_file
from mbd_sim_ros.fitting.planned import plan_of, planned
from mbd_sim_ros.fitting.problem import Problem
from solver.errors import SpecError


def load(file: str | Path, *, workers: int = 0) -> Problem:
    """The problem of a fit file. workers: processes for runs; 0: in this one. Raises MbdError, one sentence."""
    path = Path(file)
    if not path.is_file():
        raise SpecError(f'{path}: no such file; a fit needs a file (docs/fitting.md)')
    given = load_file(path)
    plans = [one.maneuver for one in given.recordings.values() if one.maneuver]
    if not plans:
        return Problem(given, path.parent, workers=workers)
    if len(plans) < len(given.recordings):
        raise SpecError(f'{path}: recordings: some are planned maneuvers and some are files; give only one of both')
    return planned(given, None, path.parent, [plan_of(name) for name in plans])
