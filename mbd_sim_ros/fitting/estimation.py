"""The fit: nuisances alone, then all, with weights from the residuals; intervals; judged by recordings held out.

1. The vehicle as it is given: only steering and sensors are fitted. Its error on what is held out is that *before*.
2. All unknowns, three times: from the second time on the residuals are weighted by their own noise and discrepancy.
3. The intervals are those of the scatter of the windows, which are right also where residuals are not what the weights
   say (covariance.py).
4. What is held out is driven by the result. A result that predicts it worse is refused.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.fitting.covariance import covariance_of
from mbd_sim_ros.fitting.foresight import Told, require_told, told_by
from mbd_sim_ros.fitting.foresight import preflight as look_ahead
from mbd_sim_ros.fitting.noise import Noise, estimated
from mbd_sim_ros.fitting.problem import Problem
from mbd_sim_ros.fitting.screen import screen
from mbd_sim_ros.fitting.solve import Found, descend
from mbd_sim_ros.fitting.unknowns import FARTHEST
from solver.errors import BagError, SpecError, StepError

ROUNDS = (
    2  # fits with weights from the residuals of the one before: the sum of squares of a third one is the same to 1e-4
)
RECENTRED = 6  # times that a level is derived anew; ten times as many would wait for what does not converge
# of the least sd of an unknown, the others held: by which a result may move from where it was derived; ten times as
# much takes a linear level far from its centre
SAME = 0.3
# of the weighted error on what is held out: from there on a result predicts it worse; 1.2 lets pass what is worse by a
# fifth
WORSE = 1.02
# sd of the classes by which further starts lie about the first; ten times as much begins with cars that spin
SPREAD = 1.0
Say = Callable[[str], None]


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A parameter: value, 95 % interval, half of it over 1.96; the interval over that of the weights alone; whether the
    recordings tell it."""

    name: str
    unit: str
    value: float
    low: float
    high: float
    sd: float
    widened: float
    told: bool
    sought: bool


@dataclasses.dataclass(frozen=True)
class Fitted:
    """A fit. x: the vector. covariance: of it. estimates: of all unknowns. held_out: by channel the RMS of the error,
    and that before. before: the vector with which that was made."""

    problem: Problem
    x: np.ndarray
    before: np.ndarray
    covariance: np.ndarray
    estimates: tuple[Estimate, ...]
    noise: dict[str, Noise]
    held_out: dict[str, dict[str, float]]
    preflight: Told
    cost: float
    starts: tuple[float, ...]
    found: Found

    @property
    def parameters(self) -> dict[str, Estimate]:
        """The parameters of the file, by name."""
        return {one.name: one for one in self.estimates if one.sought}

    def samples(self, count: int, seed: int) -> np.ndarray:
        """(count, n) vectors from the distribution of the result, within bounds."""
        random = np.random.default_rng(seed)
        drawn = random.multivariate_normal(self.x, self.covariance, count, method='eigh')
        return np.clip(drawn, *self.problem.bounds)


def fit(problem: Problem, out: str | Path | None = None, *, say: Say = lambda text: None) -> Fitted:
    """Fit a problem. out: directory in which runs are kept until the result is there: a fit that was killed goes on.
    Raises MbdError, one sentence: what is refused, and why."""
    try:
        return _fit(problem, out, say)
    finally:
        problem.close()


def _fit(problem: Problem, out: str | Path | None, say: Say) -> Fitted:
    problem.require_enough()
    if out is not None:
        problem.remember(Path(out) / 'runs')
    problem.linearize(problem.start)
    say('looking at the recordings beside the vehicle')
    problem.leave_out_undriven()
    problem.require_enough()
    screen(problem)
    alone = np.array([u.of != 'vehicle' for u in problem.unknowns])
    say('steering and sensors alone')
    try:
        first = descend(problem, problem.start, problem.of('fit'), alone, say, 0.1)
        while problem.leave_out_undriven(first.x):  # at the limit a little more steering makes it spin
            problem.require_enough()
            first = descend(problem, first.x, problem.of('fit'), alone, say, 0.1)
        which, kept_out = problem.of('fit'), problem.of('held_out')
        before_held = problem.residuals(first.x, kept_out)
    except StepError as error:
        raise StepError(
            f'the vehicle as it is given cannot follow the recordings ({str(error).partition(";")[0]}): begin with '
            'numbers nearer to the car, e.g. a larger friction as value under parameters'
        ) from None
    everything = np.ones(len(problem.unknowns), bool)
    say('derivatives by all unknowns')
    J = problem.jacobian(first.x, which, first.motions, central=False)
    told = look_ahead(problem, first.x, advise=False, J=J)
    try:
        require_told(told)
    except SpecError:
        say('which maneuvers would tell more')
        require_told(look_ahead(problem, first.x, J=J))
    starts: list[np.ndarray | Found] = [first._replace(J=J), *_starts(problem, first.x)]
    minima = []
    for k, begin in enumerate(starts):
        say(f'all unknowns, start {k + 1} of {len(starts)}')
        problem.reset_noise()
        minima.append(descend(problem, begin, which, everything, say, rest=False))
    best = min(minima, key=lambda one: one.cost)
    for k in range(ROUNDS):
        say(f'weights from the residuals, {k + 1} of {ROUNDS}')
        problem.set_noise(noise_of(problem, best.r, which))
        best = descend(problem, best, which, everything, say, rest=k == ROUNDS - 1)
    if problem.file.level == 'single_track':
        best = _recentred(problem, best, which, everything, say)
    covariance, ratio = covariance_of(problem, best)
    estimates = _estimates(problem, best, covariance, ratio)
    _require_this_car(problem, best)
    held = problem.residuals(best.x, kept_out)
    held_out = judged(problem, held, before_held, kept_out)
    require_better(held_out, problem)
    return Fitted(
        problem, best.x, first.x, covariance, estimates, dict(problem.noise), held_out, told, best.cost,
        tuple(one.cost for one in minima), best,
    )  # fmt: skip


def _recentred(problem: Problem, best: Found, which: list[int], free: np.ndarray, say: Say) -> Found:
    """The minimum of a level that is linear in its numbers, derived anew there until it is where it was derived.

    A minimum that springs from one side of where it is to the other, each time by a part of the time before, is where
    the steps would cancel: the level is derived there (Aitken's rule, as far as it shortens steps).
    """
    centre, before = best.x, None
    for _ in range(RECENTRED):
        say('deriving the level at the result')
        problem.linearize(centre)
        found = descend(problem, centre, which, free, say)
        W = problem.white(found.J, which)
        sd = 1.0 / np.sqrt(np.diag(W.T @ W + np.diag(problem.prior + 1e-12)))
        step = (found.x - centre) / sd
        if float(np.max(np.abs(step))) < SAME:
            return found
        turns = 0.0 if before is None else min(float(step @ before) / float(before @ before), 0.0)
        centre, before = centre + (found.x - centre) / (1.0 - turns), step
    raise StepError(
        'level: the fit at level single_track does not come to rest where its tables were derived; take full or kc'
    )


def _starts(problem: Problem, x: np.ndarray) -> list[np.ndarray]:
    """Further starts: the parameters moved by what their classes scatter."""
    random = np.random.default_rng(problem.file.seed)
    low, high = problem.bounds
    sought = np.array([u.sought for u in problem.unknowns])
    scale = np.array([min(u.sd / u.width, SPREAD) for u in problem.unknowns])
    found = []
    for _ in range(problem.file.starts - 1):
        moved = x + np.where(sought, random.uniform(-1.0, 1.0, x.size) * scale, 0.0)
        found.append(np.clip(moved, low, high))
    return found


def noise_of(problem: Problem, r: np.ndarray, which: list[int]) -> dict[str, Noise]:
    """Noise and discrepancy of all channels from residuals."""
    found = {}
    for name, pieces in problem.split(r, which).items():
        size = float(np.std(np.concatenate([p.y for p in problem.pieces if p.channel == name])))
        found[name] = estimated(pieces, 1e-4 * size)
    return found


def _estimates(problem: Problem, found: Found, covariance: np.ndarray, ratio: np.ndarray) -> tuple[Estimate, ...]:
    which = problem.of('fit')
    rows = {row.name: row for row in told_by(problem.white(found.J, which), problem.prior, problem.unknowns)}
    estimates = []
    for j, u in enumerate(problem.unknowns):
        value, sd = u.centre + u.width * float(found.x[j]), u.width * math.sqrt(covariance[j, j])
        told = rows[u.name].alone * ratio[j] < (u.sd if math.isfinite(u.sd) else u.width) if u.sought else (
            sd < 0.7 * u.sd
        )  # fmt: skip
        estimates.append(
            Estimate(
                u.name, u.unit, value, value - 1.96 * sd, value + 1.96 * sd, sd, float(ratio[j]), bool(told), u.sought
            )
        )
    return tuple(estimates)


def _apart(problem: Problem, found: Found) -> list[tuple[float, int, float]]:
    """(standard deviations between, index, value that the recordings want) of every unknown of which something is known
    before: that, beside what the recordings and all other knowledge give without it, by one step of Gauss-Newton."""
    which, prior = problem.of('fit'), problem.prior
    W = problem.white(found.J, which)
    A = W.T @ W + np.diag(prior + 1e-12)
    away = []
    for j, u in enumerate(problem.unknowns):
        if not math.isfinite(u.sd):
            continue
        without = A.copy()
        without[j, j] -= prior[j]
        C = np.linalg.inv(without)
        wanted = found.x[j] + C[j, j] * prior[j] * found.x[j]
        far = abs(wanted) * u.width / math.hypot(u.sd, u.width * math.sqrt(max(C[j, j], 0.0)))
        away.append((float(far), j, u.centre + u.width * float(wanted)))
    return away


def _require_this_car(problem: Problem, found: Found) -> None:
    """Refuse a result that contradicts what is known before, or lies at a bound. Raises BagError."""
    low, high = problem.bounds
    away = _apart(problem, found)
    if away:
        far, j, wanted = max(away)
        u = problem.unknowns[j]
        if far > FARTHEST:
            if u.of == 'vehicle':
                raise BagError(
                    f'recordings: alone they give {u.name} = {wanted:.4g} {u.unit}, {far:.2g} standard deviations '
                    f'from the {u.centre:.4g} known before: they are of another car, or its value and sd under '
                    'parameters or constants are wrong'
                )
            raise BagError(
                f'recordings: alone they give {u.name} = {wanted:.3g} {u.unit}, {far:.2g} standard deviations from '
                f'the {u.centre:g} of a usual sensor: mend the recording, or give it as value in the file of the fit'
            )
    for j, u in enumerate(problem.unknowns):
        if u.sought and (found.x[j] <= low[j] + 1e-6 or found.x[j] >= high[j] - 1e-6):
            value = u.centre + u.width * float(found.x[j])
            raise BagError(
                f'recordings: the fit ends at the bound of {u.name}, {value:.4g} {u.unit}: they are of another car, or '
                'its low or high under parameters is wrong'
            )


def judged(problem: Problem, after: np.ndarray, before: np.ndarray, which: list[int]) -> dict[str, dict[str, float]]:
    """By channel: RMS of the residuals on what is held out, and before."""
    rms = [
        {name: float(np.sqrt(np.mean(np.concatenate([v for _, v in pieces]) ** 2)))
         for name, pieces in problem.split(r, which).items() if pieces}
        for r in (after, before)
    ]  # fmt: skip
    return {name: {'rms': value, 'before': rms[1][name]} for name, value in rms[0].items()}


def require_better(held_out: dict[str, dict[str, float]], problem: Problem) -> None:
    """Refuse a result that predicts what is held out worse than the vehicle before, by the mean of the logarithms over
    the channels. Raises StepError."""
    gain = np.mean([math.log(max(one['rms'], 1e-300) / max(one['before'], 1e-300)) for one in held_out.values()])
    if gain > math.log(WORSE):
        name, one = max(held_out.items(), key=lambda item: item[1]['rms'] / item[1]['before'])
        raise StepError(
            f'the result predicts the recordings held out worse than the vehicle it began with: {name} to '
            f'{one["rms"]:.3g} instead of {one["before"]:.3g}: nothing is written; are all '
            'recordings those of one car in one state?'
        )


def report(fitted: Fitted) -> dict[str, Any]:
    """As an object of JSON."""
    return {
        'parameters': {
            name: {'value': e.value, 'low': e.low, 'high': e.high, 'told': e.told, 'sd': e.sd, 'unit': e.unit,
                   'widened': e.widened}
            for name, e in fitted.parameters.items()
        },
        'nuisances': {
            e.name: {'value': e.value, 'low': e.low, 'high': e.high, 'unit': e.unit}
            for e in fitted.estimates if not e.sought
        },
        'held_out': fitted.held_out,
        'noise': {name: n._asdict() for name, n in fitted.noise.items()},
        'cost': fitted.cost, 'starts': list(fitted.starts), 'runs': fitted.problem.runs,
        'left_out': fitted.problem.told,
    }  # fmt: skip
