"""Error bar of a run: its numerical error by quantity, from a twin with another step.

The twin simulates the same scene from the same start with the double step, which is half the work again. Where the
error falls with the power p of the step, the error of the run is (x_h - x_2h) / (2^p - 1) [Richardson1911]: p is 2, 4
with `order: 4`, and 1 where a driver or an assistance looks once a step. With steps shorter by r, for runs of few steps
and where the double one fails, it is (x_h - x_h/r) r^p / (r^p - 1). Both runs are compared at common instants, evenly
spread, and closer at the beginning, where what no step resolves has not been damped yet.

With error control (`step_policy: error`) the steps follow a tolerance, whose root they are: the twin has r^2 times of
it and a grid of r steps. Recorded inputs are those of the run, or the means of those of two steps. A reference
integrator controls its own error, and has no twin.

*Doubt*: an estimate beyond DOUBTFUL of a limit may be the error of the twin alone, which the double step may shake, or
too small, since errors fall less than they should. Such a run has a second twin with half the step, and its error
follows from how the distances fall from step to step. Where runs are apart by more than COARSE of the peak, it is a
lower bound. *Sensitive*: the distance of both runs grew by more than GROWN in the second half of the time that it took
to become COARSE, LONG steps at least, and not at once. No power of time up to the sixth does that: it grows
exponentially, and shorter steps only delay it. From when the error reaches its limit only statistics of the motion
hold.

The file is long because an error is measured, compared and judged by rules that share their bounds (DOUBTFUL, COARSE).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from solver.analysis.departures import departure
from solver.analysis.error_curves import Curve, curves_of
from solver.checks.check import Measured
from solver.checks.error import LIMITS, NUMERICAL_ERROR
from solver.errors import MbdError, StepError
from solver.findings import Finding
from solver.output.energy import contradicts
from solver.output.snapshot import Snapshot
from solver.quantities import quantity
from solver.scene import Accuracy
from solver.simulation import Simulation
from solver.vehicle.size import scale_of, size_of

# instants at which two runs are compared; ten times as many would find peaks of a four-thousandth of the run
MOST = 400
FEWEST = 64  # steps of a run whose twin takes the double step: a twin of a tenth as many would resolve nothing
DOUBTFUL = 0.5  # of a limit: the estimate is right to a factor of two where errors fall with their power of the step
CLOSES = 0.5  # of their energy, with half the step; ten times as much would take for closed what grows
COARSE = 0.1  # of the peak; with ten times as much both runs have nothing in common
GROWN = 64.0  # in the second half of a time: 2^6
LONG = 256  # steps until both runs are COARSE apart: what takes fewer is not resolved, whatever it is
AT_ONCE = 0.5  # of the growth, in powers, between two instants: an impact, or a singular position
# parts of a step, of which the first is taken that leaves whole nanoseconds and makes other steps
NEXT = (2, 3, 4, 5, 7, 8)
# times as many steps, counting parts of those that were divided; runs of the same steps have the same error
OTHER = 1.3
DOUBLE = 'double step'
PORTION = 100  # steps of a call
# quantities that a sentence names first
LEADING = ('position', 'orientation', 'yaw_rate', 'lateral_acceleration', 'wheel_load', 'articulation', 'reactions')
SLACK = 2.0  # to which an estimate is right: a plan has measured the error itself
TOO_SHORT = 'a run of one step has no twin'
UNCONTROLLED = 'a reference integrator controls its own error'


@dataclass(frozen=True, kw_only=True)
class NumericalError:
    """Error of one quantity over time: the largest and the root mean square [unit].

    share: the largest, of the peak. limit: largest share that a run may have; None: it decides nothing. time: of the
    largest [s]. where: the wheel or the body that is worst. bound: the error is at least so large.
    """

    value: float
    unit: str
    share: float
    rms: float
    peak: float
    limit: float | None
    time: float
    where: str
    bound: bool


@dataclass(frozen=True, kw_only=True)
class ErrorBar:
    """The numerical error of a run. twin: how it was measured, '' where it was not. why: it was not measured, or more
    there is to know. findings: what of it makes the run suspect. sensitive: time [s] from which on only statistics of
    the motion hold. closing: redundant rows that seemed to contradict each other close with a shorter step."""

    twin: str = ''
    why: str = ''
    errors: dict[str, NumericalError] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    sensitive: float | None = None
    closing: bool = False

    @property
    def measured(self) -> bool:
        """True where a twin was made."""
        return bool(self.twin)

    @property
    def doubtful(self) -> bool:
        """True where the estimate comes near a limit, and a second twin shall tell whether errors fall as they
        should."""
        return self.sensitive is None and (bool(self.findings) or self.worst > DOUBTFUL)

    @property
    def worst(self) -> float:
        """The largest share of a deciding quantity, of its limit: 1 is the limit."""
        return max((error.share / error.limit for error in self.errors.values() if error.limit), default=0.0)

    @property
    def text(self) -> str:
        """One or two sentences."""
        if not self.measured:
            return f'The numerical error was not measured: {self.why}'
        said = {name: self.errors[name] for name in LEADING if name in self.errors}
        deciding = {name: e for name, e in self.errors.items() if e.limit}
        worst = max(deciding, key=lambda name: deciding[name].share / (deciding[name].limit or 1.0))
        said |= {worst: self.errors[worst]}
        parts = ', '.join(f'{name.replace("_", " ")} {shown(name, error)}' for name, error in said.items())
        more = f'. {self.why}' if self.why else ''
        without_reactions = 'orientation' in self.errors and 'reactions' not in self.errors  # of a mechanism
        unjudged = 'model and reactions are' if without_reactions else 'model itself is'
        return f'Numerical error ({self.twin}): {parts}; the {unjudged} not judged{more}'

    def report(self) -> dict[str, dict[str, Any]]:
        """By quantity, as objects for JSON."""
        return {name: asdict(error) for name, error in self.errors.items()}


NOT_ASKED = ErrorBar(why='nobody asked for it')


def shown(name: str, error: NumericalError) -> str:
    """An error for people: a length in units, all else as part of the peak."""
    least = 'at least ' if error.bound else ''
    share = 'below 0.001 %' if error.share < 1e-5 else f'{100.0 * error.share:.2g} %'
    if name != 'position':
        return least + share
    factor, unit = (1.0, 'm') if error.value >= 0.1 else (1e3, 'mm')
    return f'{least}{error.value * factor:.2g} {unit} ({share})'


class Twin:
    """The twin of a run that begins at the start of its scene.

    instants: steps of the run whose snapshots note() takes. make() follows the run, result() follows make().
    """

    def __init__(self, simulation: Simulation, steps: int) -> None:
        self._run, self._rows = simulation, list[np.ndarray]()
        self.why = UNCONTROLLED if simulation.engine.follows else TOO_SHORT if steps < 2 else ''
        self.instants = [] if self.why else instants(steps)
        self._ratio, self.twin = (2.0, DOUBLE) if steps >= FEWEST else (0.0, '')
        self._closing = False
        self._others: list[np.ndarray] = []
        self._coarse: list[np.ndarray] = []  # of a twin with the double step, where another one followed
        self.note(simulation.snapshot())

    @property
    def next(self) -> int | None:
        """The step whose snapshot is wanted next; None: no more."""
        return self.instants[len(self._rows)] if len(self._rows) < len(self.instants) else None

    @property
    def done(self) -> bool:
        """True where result() has all that it needs, or knows why there is nothing."""
        return bool(self.why) or len(self._others) == len(self.instants)

    def note(self, snapshot: Snapshot) -> None:
        """Keep a snapshot of the run where it is the next one wanted."""
        if snapshot.k == self.next:
            self._rows.append(snapshot.numbers)

    def make(self, most: Callable[[], int] = lambda: PORTION) -> Iterator[int]:
        """Make the steps of the twin, no more than most() at a time; gives the number of each call."""
        if self.why:
            return
        coarse = False
        if self._ratio:
            try:
                yield from self._made(self._ratio, most)
            except MbdError:  # too long a step for this motion
                pass
            else:
                if not (self._compared().doubtful or self._contradicted):
                    return
                coarse, self._coarse = True, self._others
        why = f'integrator.h = {self._run.h:g} s has no half of whole nanoseconds'
        for finer in (r for r in NEXT if self._run.h_ns % r == 0):
            self._ratio, self.twin = 1.0 / finer, 'half step' if finer == 2 else f'step / {finer}'
            try:
                yield from self._made(self._ratio, most)
                return
            except MbdError as error:
                why = f'the run with the {self.twin} failed: {error}'
        if coarse:
            self._others, self._ratio, self.twin, self._coarse = self._coarse, 2.0, DOUBLE, []
        else:
            self.why, self.twin = why, ''

    def _made(self, ratio: float, most: Callable[[], int]) -> Iterator[int]:
        s, given = self._run, self._run.scene.integrator
        h_ns = round(s.h_ns * ratio)
        settings: dict[str, Any] = {'h': h_ns * 1e-9}
        if given.h_min:
            settings['h_min'] = min(given.h_min, h_ns * 1e-9)
        if given.step_policy == 'error':
            settings['error_tolerance'] = given.error_tolerance * ratio * ratio
        elif ratio > 1.0 and given.step_policy != 'constant':
            # a double step that fails would become the steps of the run
            settings |= {'step_policy': 'rescue', 'h_min': h_ns * 1e-9}
        twin = s.twin(self.instants[-1] * s.h, **settings)
        self._others = [twin.snapshot().numbers]
        # the account tells what contradicts, and which reactions are not determined
        audit = s.scene.record.reactions or (ratio < 1.0 and self._contradicted)
        for k in self.instants[1:]:
            last = k * s.h_ns // h_ns
            while twin.k < last:
                n = min(last - twin.k, most())
                snapshot = twin.advance(n, audit=audit)
                yield n
            if not snapshot.is_finite():
                raise MbdError(f't = {twin.t_ns * 1e-9:g} s: the motion is no longer finite')
            self._others.append(snapshot.numbers)
        taken, others = (float(one.totals()['substeps']) / one.k for one in (s, twin))
        if max(taken / s.h_ns, others / h_ns) < OTHER * min(taken / s.h_ns, others / h_ns):
            raise StepError('both runs take the same steps, for steps are divided')
        if ratio < 1.0 and self._contradicted:
            closed = CLOSES * float(self._run.last_step.account.contradiction[0])
            self._closing = float(twin.last_step.account.contradiction[0]) < closed

    @property
    def _contradicted(self) -> bool:
        """True where redundant rows of the run hold each other: by a contradiction, which grows as the step falls, or
        for a long step leaves them open."""
        s = self._run
        return (
            s.of_bodies
            and s.model.n_rows > 0
            and contradicts(s.last_step.account, s.model.tables.bodies, scale_of(s.model.spec)[0])[0]
        )

    def made(self) -> ErrorBar:
        """The error bar, with all steps of the twin made now."""
        for _ in self.make():
            pass
        return self.result()

    def compared(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        """(instants (n,) [s], numbers of the run and of the twin there (n, m), what their difference times makes the
        error)."""
        p = order(self._run)
        factor = 1.0 / (2.0**p - 1.0) if self._ratio > 1.0 else 1.0 / (1.0 - self._ratio**p)
        return np.array(self.instants) * self._run.h, np.array(self._rows), np.array(self._others), factor

    def result(self) -> ErrorBar:
        """The error bar, once make() has come to its end."""
        if self.why or not self.done:
            return ErrorBar(why=self.why or 'the measurement was interrupted')
        return self._compared()

    def _compared(self) -> ErrorBar:
        """The error bar by the numbers of both runs."""
        s = self._run
        times, rows, others, factor = self.compared()
        errors, distances = {}, {}
        coarse = np.array(self._coarse) if self._coarse and self._ratio < 1.0 else None
        for curve in curves_of(s):
            errors[curve.name], distances[curve.name] = _error(curve, times, rows, others, factor, coarse)
        deciding = [name for name in errors if errors[name].limit]
        together = np.max([distances[name] for name in deciding], axis=0)
        limit = min(errors[name].limit or math.inf for name in deciding)
        why, since = _growth(times, together, limit / factor, s.h, 2.0 ** order(s))
        found = _required(s, times, rows, others, factor) if s.scene.require.accuracy else _findings(errors, why)
        return ErrorBar(
            twin=self.twin, why=why, errors=errors, findings=tuple(found), sensitive=since, closing=self._closing
        )


def instants(steps: int) -> list[int]:
    """Even steps, ascending, at which a run of so many steps is compared with its twin."""
    pairs = steps // 2
    spread = {round(pairs * i / MOST) for i in range(1, MOST + 1)} if pairs > MOST else set(range(1, pairs + 1))
    early, k = [0], 1
    while k < min(spread, default=0):
        early.append(k)
        k = max(k + 1, k * 3 // 2)
    return [2 * pair for pair in [*early, *sorted(spread)]]


def order(simulation: Simulation) -> int:
    """The power of the step with which the error of a run falls."""
    sources = simulation.sources
    if sources.driver is not None or sources.assistant is not None or sources.controllers:
        return 1
    return simulation.scene.integrator.order


def _error(
    curve: Curve, times: np.ndarray, rows: np.ndarray, others: np.ndarray, factor: float, coarse: np.ndarray | None
) -> tuple[NumericalError, np.ndarray]:
    """(error of a quantity, (n,) distance of both runs over time as part of the peak). coarse: numbers of a run with
    the double step.

    With three steps the distances fall by what the errors do: where that is less than the power of the step says, the
    error is larger, at most the distance to the run with the double step, as an error that falls with the step itself.
    """
    apart, peaks = curve.apart(rows, others), curve.peaks(rows)
    if coarse is not None:
        falls = float(curve.apart(rows, coarse).max()) / max(float(apart.max()), np.finfo(float).tiny)
        factor = max(factor, min(falls / (falls - 1.0), falls) if falls > 1.0 else 0.0)
    shares = apart / peaks
    k, place = np.unravel_index(int(np.argmax(shares)), shares.shape)
    error = NumericalError(
        value=float(factor * apart[k, place]), unit=curve.unit, share=float(factor * shares[k, place]),
        rms=float(factor * np.sqrt(np.mean(apart[:, place] ** 2))), peak=float(peaks[place]),
        limit=LIMITS.get(curve.name),
        time=float(times[k]), where=curve.places[place], bound=bool(shares[k, place] > COARSE),
    )  # fmt: skip
    return error, shares.max(1)


def _growth(times: np.ndarray, shares: np.ndarray, limit: float, h: float, gain: float) -> tuple[str, float | None]:
    """(sentence on how the distance of both runs grew, time [s] from which on only statistics hold). limit: of the
    distance. h: step [s]. gain: what half the step makes of an error."""
    reached = int(np.argmax(shares > COARSE))
    if not shares[reached] > COARSE or times[reached] < LONG * h:
        return '', None
    most = np.maximum.accumulate(shares)
    half = int(np.searchsorted(times, 0.5 * times[reached], side='right')) - 1
    most = np.maximum(most, np.finfo(float).eps)
    grown = most[half : reached + 1] / most[half]
    if not grown[-1] > GROWN:
        return '', None
    jump = np.diff(np.log(grown))
    worst = int(np.argmax(jump))
    if jump[worst] > AT_ONCE * math.log(grown[-1]):
        return (
            f'It comes at once, at t = {times[half + worst + 1]:.4g} s, from an impact or a singular position there. '
            'Reduce integrator.h',
            None,
        )
    since = float(times[int(np.argmax(shares > min(limit, COARSE)))])
    tenfold = (times[reached] - times[half]) * math.log(10.0) / math.log(grown[-1])
    later = tenfold * math.log10(gain)
    told = f'The motion is sensitive: an error grows tenfold in {tenfold:.2g} s'
    return (
        f'{told}. From t = {since:.4g} s on only its statistics hold; half the step delays that by {later:.2g} s',
        since,
    )


def _findings(errors: Mapping[str, NumericalError], why: str) -> Iterator[Finding]:
    """The quantity that is furthest beyond its published limit."""
    beyond = {name: e for name, e in errors.items() if e.limit is not None and not e.share <= e.limit}
    if beyond:
        name = max(beyond, key=lambda name: beyond[name].share / (beyond[name].limit or 1.0))
        e = beyond[name]
        reason = f'the numerical error of {name.replace("_", " ")} is {shown(name, e)}'
        remedy = why or NUMERICAL_ERROR.remedy
        assert e.limit is not None
        yield NUMERICAL_ERROR.finding(
            Measured(
                value=100.0 * e.share,
                limit=100.0 * e.limit,
                time=e.time,
                where=e.where,
                of=name,
                reason=reason,
                remedy=remedy,
            )
        )


def _required(
    s: Simulation, times: np.ndarray, rows: np.ndarray, others: np.ndarray, factor: float
) -> Iterator[Finding]:
    """Limits of accuracy that the scene requires and the numerical error alone breaks."""
    slack = SLACK if s.level is not None and s.level.certificate else 1.0
    for name, asked in s.scene.require.accuracy.items():
        try:
            q = quantity(name, s.channels, size_of(s.scene.model))
        except MbdError:
            continue  # a level that does not publish it
        twin, run = q.of(others[:, q.places]), q.of(rows[:, q.places])
        # both motions are finite: what is not, is the effort of a driver that one of both does not determine
        there = np.isfinite(twin - run).all(axis=1)
        if there.any():
            yield from _broken(name, asked, departure(q, times[there], twin[there], run[there]), q.unit, factor / slack)


def _broken(name: str, asked: Accuracy, apart: Any, unit: str, factor: float) -> Iterator[Finding]:
    for measure, bound in asked.bounds.items():
        error = abs(factor * float(getattr(apart, measure)))
        limit = bound.of(apart.peak) if measure != 'delay' else bound.value
        if error > limit:
            unit_ = 's' if measure == 'delay' else unit
            reason = f'the numerical error of {name.replace("_", " ")} ({measure}) is too large'
            measured = Measured(value=error, limit=limit, of=f'{name} {measure}', unit=unit_, reason=reason)
            yield NUMERICAL_ERROR.finding(measured, limit, required=True)
