"""Runs of a mechanism with the default settings at several steps, held against independent solutions of the same
equations.

The error e(h) of a run is its largest difference from the reference (mbd_sim_ros.lab.mechanisms.references), looked at
every SAMPLE; h is the mean of its steps, where some were divided.

Second order predicts an error in proportion to what a step does not see of the motion, d(h), the largest second
difference of the reference at the distance h, halved. If a step resolves the motion, that is h^2 / 2 times its largest
acceleration, so e(h) / d(h) is the same at all steps; of a vibration that no step resolves it is the amplitude, and the
error is no larger either. A run is *right* when

    e(h) <= WORSE * d(h) * median of e / d of the other steps     or     e(h) <= floor

(of other steps that are ok and were not divided; where there are none, the error may be CLOSE what second order
predicts from the next coarser run that came to its end, though that was told, or WORSE * d(h)). floor: RESOLVED of the
size of the motion, or what the reference leaves open. It is *told* when it failed, was refused or is suspect. Otherwise
it is *silently wrong*.

A reference is not trusted where a second one, to a tolerance a thousand times coarser, differs from it by a tenth of
the error or more, and where its velocities change at once (a step collapses, or a second difference stands out), on its
way to another branch at a singular position perhaps: then who agrees with it, to WORSE * d(h), is right, and who does
not is *undecided*, as where no reference was found. Runs whose errors stay while d falls agree with each other on
another motion; by each other they would be right, so they must agree with the reference to WORSE * d(h) too.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mbd_sim_ros.lab.mechanisms.draft import Mechanism
from mbd_sim_ros.lab.mechanisms.references import FINE, TOLERANCES, difference, measured, references
from solver.analysis.verdict import findings, status_of
from solver.errors import MbdError, StepError
from solver.scene import Scene
from solver.simulation import Simulation

STEPS = (0.01, 0.005, 0.002, 0.001, 0.0005)  # s
DURATION = 0.5  # s
SAMPLE = 0.01  # s, a multiple of every step
# s, step for which the start of the references is made: a start fits its velocities to its step, by its square
START = 1e-6
WORSE = 10.0
UNDIVIDED = 0.9  # of a step: a mean below it belongs to a run whose error is not that of its step
CLOSE = 2.0  # second order and a little more
RESOLVED = 1e-9  # of the size of the motion, at least 1 m or rad: rounding of a step divided by its length squared
STAY, FALLS = 0.9, 0.5  # of an error, and of d, at the next coarser step
RIGHT, TOLD, WRONG, UNDECIDED = 'right', 'told', 'silently wrong', 'undecided'


@dataclass(frozen=True, kw_only=True)
class RunAtStep:
    """A run at one step. status: 'ok', 'suspect', 'error' or 'refused'; text: why. error: e(h), nan when it did not
    arrive."""

    h: float
    status: str
    text: str
    error: float
    unseen: float  # d(h)
    allowed: float
    judgement: str = ''


@dataclass(frozen=True, kw_only=True)
class Judged:
    """All runs of a mechanism. spread: difference of the two references, nan without a second; reference: which one."""

    name: str
    bodies: int
    rows: int
    reference: str
    spread: float
    evaluations: int
    runs: tuple[RunAtStep, ...]

    def report(self) -> dict[str, Any]:
        """As an object for JSON."""
        return asdict(self)

    @property
    def worst(self) -> str:
        """The worst judgement of any run."""
        return max((run.judgement for run in self.runs), key=(RIGHT, TOLD, UNDECIDED, WRONG).index)


def unseen(y: np.ndarray, h: float) -> float:
    """d(h): the largest second difference at the distance h, halved, of a motion (n, nb, 7) every FINE; between
    multiples of it as h^2."""
    k = max(1, round(h / FINE))
    return float(0.5 * np.abs(y[2 * k :] - 2.0 * y[k:-k] + y[: -2 * k]).max(initial=0.0)) * (h / (k * FINE)) ** 2


def run(scene: Scene, exact: np.ndarray | None, sample: float = SAMPLE) -> tuple[str, str, float, float]:
    """(status, text, e(h), mean step [s]) of a scene; exact: the reference every FINE; sample: when they are compared,
    a multiple of the step [s].
    """
    try:
        simulation = Simulation(scene)
    except MbdError as error:
        return 'refused', str(error), np.nan, scene.integrator.h
    every = round(sample / simulation.h)
    motion = [simulation.state.q.copy()]
    try:
        while simulation.k < scene.steps:
            simulation.advance(every)
            motion.append(simulation.state.q.copy())
    except StepError as error:
        return 'error', str(error), np.nan, simulation.h
    found = findings(simulation)
    error_ = np.nan
    if exact is not None:
        sampled = exact[:: round(sample / FINE)]
        error_ = difference(measured(np.array(motion)), sampled)
    taken = simulation.h * simulation.k / simulation.totals()['substeps']
    return status_of(found), '; '.join(map(str, found)), error_, taken


def judge(mechanism: Mechanism, steps: Sequence[float] = STEPS, duration: float = DURATION, **settings: Any) -> Judged:
    """Run a mechanism at all steps with default settings, but for those that are given, and classify."""
    simulation = Simulation(mechanism.at(duration, h=START))
    kind, motions, evaluations, smooth = references(simulation, mechanism, duration)
    exact = motions[0] if motions else None
    spread = difference(*motions) if exact is not None else np.nan
    size = 1.0 if exact is None else max(1.0, float(np.abs(exact - exact[0]).max()))
    found = []
    for h in steps:
        found.append((h, *run(mechanism.at(duration, h=h, **settings), exact)))
    runs = compare(found, exact, spread, size, smooth=smooth)
    model = simulation.model
    return Judged(
        name=mechanism.name, bodies=model.n_bodies, rows=model.n_rows, reference=kind,
        spread=spread, evaluations=evaluations, runs=runs,
    )  # fmt: skip


def refused(mechanism: Mechanism, text: str) -> Judged:
    """Judgement of a mechanism that cannot be simulated at all, which says so."""
    runs = tuple(
        RunAtStep(h=h, status='refused', text=text, error=np.nan, unseen=np.nan, allowed=np.nan, judgement=TOLD)
        for h in STEPS
    )
    return Judged(name=mechanism.name, bodies=0, rows=0, reference='', spread=np.nan, evaluations=0, runs=runs)


def compare(
    runs: Sequence[tuple[float, str, str, float, float]],
    exact: np.ndarray | None,
    spread: float,
    size: float,
    known: Sequence[float] = (),
    *,
    smooth: bool = True,
) -> tuple[RunAtStep, ...]:
    """classify() of runs (h, status, text, error, mean step)."""
    found = [
        (h, status, text, error, np.nan if exact is None else unseen(exact, taken))
        for h, status, text, error, taken in runs
    ]
    return classify(found, spread, size, known, {h for h, *_, taken in runs if taken < UNDIVIDED * h}, smooth=smooth)


def classify(
    found: Sequence[tuple[float, str, str, float, float]],
    spread: float,
    size: float,
    known: Sequence[float] = (),
    divided: Set[float] = frozenset(),
    *,
    smooth: bool = True,
) -> tuple[RunAtStep, ...]:
    """Judge runs (h, status, text, error, d(h)) of one mechanism by each other (module), or by known ratios e / d of
    others."""
    ratios = {h: error / max(d, 1e-300) for h, _, _, error, d in found if np.isfinite(error)}
    ok = {h for h, status, *_ in found if status == 'ok' and h not in divided}
    errors, unseen_of = {h: error for h, _, _, error, _ in found}, {h: d for h, *_, d in found}
    floor = RESOLVED * size + (0.0 if np.isnan(spread) else TOLERANCES[0] / TOLERANCES[1] * spread)
    runs = []
    for h, status, text, error, d in found:
        others = known or [ratio for other, ratio in ratios.items() if other in ok - {h}]
        if others:
            allowed = max(floor, WORSE * d * float(np.median(others)))
        else:
            coarser = min((other for other in ratios if other > h), default=None)
            allowed = max(floor, d * max(WORSE, CLOSE * ratios[coarser] if coarser else 0.0))
        trusted = smooth and not spread >= 0.1 * error
        before = min((other for other in ok if other > h), default=None)
        same = before is not None and error > STAY * errors[before] and d < FALLS * unseen_of[before]
        if same or not trusted:
            allowed = max(floor, min(allowed, WORSE * d))
        if status != 'ok':
            judgement = TOLD
        elif np.isnan(spread):
            judgement = UNDECIDED
        elif error <= allowed:
            judgement = RIGHT
        else:
            judgement = WRONG if trusted else UNDECIDED
        runs.append(
            RunAtStep(h=h, status=status, text=text, error=error, unseen=d, allowed=allowed, judgement=judgement)
        )
    return tuple(runs)
