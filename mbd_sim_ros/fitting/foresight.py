"""Preflight: what recordings, or planned maneuvers, can tell of the parameters before anything is fitted.

From the derivatives of the predicted signals at the start, weighted with noise and discrepancy, and what is known
before, follows the information of all unknowns ([Fisher1922], with the prior); its inverse is their covariance. A
parameter is told where the recordings alone, without what is known of it before, give it better than that (or than its
class, where nothing is known). Two that cannot be told apart have a correlation near one.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_sim_ros.fitting.planned import PLANS, planned
from mbd_sim_ros.fitting.problem import Problem
from mbd_sim_ros.fitting.unknowns import Unknown, with_unit
from solver.errors import MbdError, SpecError

TOGETHER = 0.95  # correlation from which two parameters cannot be told apart; 0.995 would let pass a tenfold interval
FAINT = 1e-12  # weight by which unknowns of which nothing at all is known stay finite


@dataclasses.dataclass(frozen=True)
class Row:
    """Entry of a parameter: what is told of it.

    sd: standard error with what is known before, alone: without that. before: sd of
    what is known, infinite where nothing is."""

    name: str
    value: float
    unit: str
    before: float
    sd: float
    alone: float
    told: bool
    apart: tuple[tuple[str, float], ...]
    maneuvers: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Told:
    """A preflight. rows: of all parameters. seconds: of recordings that are fitted. doubts: what was left out of
    them."""

    rows: tuple[Row, ...]
    seconds: float
    windows: int
    doubts: tuple[str, ...]
    runs: int

    def row(self, name: str) -> Row:
        """The row of a parameter."""
        return next(row for row in self.rows if row.name == name)


def told_by(J: np.ndarray, prior: np.ndarray, unknowns: Sequence[Unknown]) -> list[Row]:
    """Rows of all parameters from whitened derivatives J (samples, n) and the weights of what is known before."""
    information = J.T @ J
    whole = np.linalg.inv(information + np.diag(prior + FAINT))
    rows = []
    for j, u in enumerate(unknowns):
        if not u.sought:
            continue
        without = prior.copy()
        without[j] = 0.0
        C = np.linalg.inv(information + np.diag(without + FAINT))
        alone = u.width * math.sqrt(C[j, j])
        spread = np.sqrt(np.diag(C))
        related = C[j] / (spread * spread[j])
        apart = tuple(
            (unknowns[k].name, float(related[k]))
            for k in np.argsort(-np.abs(related)).tolist()
            if k != j and abs(related[k]) > TOGETHER
        )
        limit = u.sd if math.isfinite(u.sd) else u.width
        rows.append(
            Row(u.name, u.centre, u.unit, u.sd, u.width * math.sqrt(whole[j, j]), alone, bool(alone < limit), apart)
        )
    return rows


def preflight(
    problem: Problem, x: np.ndarray | None = None, *, advise: bool = True, J: np.ndarray | None = None
) -> Told:
    """Standard errors that the recordings which are fitted give.

    x: where, the start where none. advise: seek maneuvers for what they do not tell. J: the derivatives, where they are
    there already. Raises MbdError."""
    x = problem.start if x is None else x
    if J is None:
        problem.linearize(x)
        problem.leave_out_undriven()
    which = problem.of('fit')
    if J is None:
        J = problem.jacobian(x, which, problem.motions(x, which))
    rows = told_by(problem.white(J, which), problem.prior, problem.unknowns)
    if advise:
        rows = _advised(problem, rows)
    seconds = sum(problem.windows[k].last - problem.windows[k].first for k in which)
    return Told(tuple(rows), seconds, len(which), tuple(problem.told), problem.runs)


def _advised(problem: Problem, rows: list[Row]) -> list[Row]:
    """The rows with the maneuvers that would tell what is not told, one more drive of each beside the recordings."""
    missing = [row.name for row in rows if not row.told]
    helped: dict[str, list[str]] = {name: [] for name in missing}
    for plan in PLANS.values() if missing else ():
        try:
            one = planned(problem.file, problem, problem.home, [plan])
            which = one.of('fit')
            J = one.white(one.jacobian(one.start, which, one.motions(one.start, which)), which)
        except MbdError:
            continue  # a vehicle may be unable to drive it
        for row in told_by(J, one.prior, one.unknowns):
            if row.name in helped and row.told:
                helped[row.name].append(plan.words)
    return [dataclasses.replace(row, maneuvers=tuple(helped.get(row.name, ()))) for row in rows]


def require_told(told: Told, *, again: str = 'mbd fit FILE --preflight shows all') -> None:
    """Refuse parameters that are not told and of which nothing is known. Raises SpecError."""
    for row in told.rows:
        if row.told or math.isfinite(row.before):
            continue
        share = f' ({100.0 * row.alone / abs(row.value):.3g} % of it)' if row.value else ''
        pairs = f', and cannot be told from {row.apart[0][0]}' if row.apart else ''
        help_ = f', or drive a {row.maneuvers[0]}' if row.maneuvers else ''
        alone = with_unit(f'{row.alone:.3g}', row.unit)
        raise SpecError(
            f'parameters: {row.name}: these recordings give it a standard error of {alone}{share}'
            f'{pairs}: give it a prior (sd: class){help_}; {again}'
        )


def report(told: Told) -> dict[str, Any]:
    """As an object of JSON."""
    return {
        'parameters': {
            row.name: {
                'value': row.value, 'unit': row.unit, 'standard_error': row.sd, 'from_recordings': row.alone,
                'known_before': row.before if math.isfinite(row.before) else None, 'told': row.told,
                'not_apart_from': dict(row.apart), 'maneuvers': list(row.maneuvers),
            }
            for row in told.rows
        },
        'seconds': told.seconds, 'windows': told.windows, 'left_out': list(told.doubts), 'runs': told.runs,
    }  # fmt: skip
