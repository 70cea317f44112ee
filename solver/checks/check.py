"""Record of a check: all that the rest of the program has to know of it; solver.checks.registry lists the records.

Findings with their sentences, the keys that `require` of a scene accepts, what a plan may cover, and the table of
docs/stability.md follow from these records. A record is checked when it is made.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np

from solver.findings import Finding, LevelReport
from solver.inputs.maneuver import ManeuverSource
from solver.inputs.recorded import RecordedSource
from solver.model.state import State
from solver.model.tables import Model
from solver.output.account import Account
from solver.output.branches import BranchSwitch
from solver.output.snapshot import Channels
from solver.step.settings import IntegratorSettings


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """A run so far, as checks look at it.

    h: step of the grid [s]. k: steps so far. time: the same [s]. duration: of the scene [s]. source: of the inputs.
    state, scheme: of the bodies, None where the engine has none (Scheme of solver.step.work). switches: branch switches
    so far; watched: the scene asks for all of them. level: what the model leaves out, None for a model as given.
    reached: how far the run went of what its level limits (value, time [s]). real_time_factor: None where nobody
    measured it.
    """

    account: Account
    model: Model
    channels: Channels
    settings: IntegratorSettings
    h: float
    k: int
    time: float
    duration: float
    source: ManeuverSource | RecordedSource
    state: State | None
    scheme: Any
    switches: list[BranchSwitch]
    watched: bool
    level: LevelReport | None
    reached: Mapping[str, tuple[float, float | None]]
    real_time_factor: float | None

    def body(self, index: int) -> str:
        """A body by its index, as a place in sentences."""
        return f'body {self.model.body_names[index]!r}'

    def row(self, index: int) -> str:
        """A row of constraints by its index, as a place in sentences."""
        return f'constraint {self.model.row_names[index]!r}'


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Measurement of a check at one place. Fields that are None or empty take the value of the check.

    limit: of this run, in the unit. time: of the worst instant [s], None when it has none. of: what the value is of,
    where a check looks at several things. reason, remedy: in place of those of the check, as they are to be read.
    """

    value: float
    limit: float | None = None
    time: float | None = None
    where: str = ''
    of: str = ''
    unit: str = ''
    reason: str = ''
    remedy: str = ''


Measure = Callable[[Evidence], Iterable[Measured]]


@dataclass(frozen=True, kw_only=True)
class Check:
    """A check: what is measured, how far it may go, and what a finding says.

    name: the quantity of its findings. unit: of value and limit. limit: that every run has; None: Measured.limit has
    that of a run, and without one only `require` limits the value. rule: the limit in words and where it comes from,
    for docs/stability.md. measure: a plain function; None: it is followed from snapshots while the run goes on
    (solver.analysis.envelope). reason: what a value beyond the limit says, a sentence with `{where}` for the place or
    `{of}`. remedy: what to do, a sentence. require: the key of `require` that replaces the limit; ''. count: the value
    is a whole number. least: the value must be no less than the limit. plan: what a plan makes of a finding
    (solver.analysis.certificate_coverage): 'broken' forbids a setting, 'coarse' is covered where it was measured,
    'scene' belongs to the scene whatever its setting. anywhere: a plan that covers it does so at every place.
    unresolved: it says that steps are too long for the motion. seen_by_twin: what it warns of differs between a run and
    its twin with another step, so where a twin was made the error decides, and this explains it
    (solver.analysis.verdict). turned: it may come from a body without inertia that is turned (solver.analysis.turned).
    """

    name: str
    unit: str = ''
    limit: float | None = None
    rule: str
    measure: Measure | None
    reason: str
    remedy: str
    require: str = ''
    count: bool = False
    least: bool = False
    plan: Literal['broken', 'coarse', 'scene'] = 'broken'
    anywhere: bool = False
    unresolved: bool = False
    seen_by_twin: bool = False
    turned: bool = False

    def __post_init__(self) -> None:
        where = f'check {self.name!r}'
        if not self.name.isidentifier():
            raise TypeError(f'{where}: the name must be one that a key may have')
        if self.measure is not None and len(inspect.signature(self.measure).parameters) != 1:
            raise TypeError(f'{where}: {self.measure.__name__} must take the evidence and nothing else')
        for name in ('rule', 'reason', 'remedy'):
            if not getattr(self, name):
                raise TypeError(f'{where}: {name} is empty')
        if self.reason.format(where='', of='').rstrip().endswith('.') or self.remedy.endswith('.'):
            raise TypeError(f'{where}: reason and remedy end without a full stop, which the sentence of a finding sets')
        if self.least and not self.require:
            raise TypeError(f'{where}: least, but only a limit of `require` is one from below')

    @property
    def hint(self) -> Any:
        """The type of the key of `require`, with its unit."""
        kind = int if self.count else float
        return Annotated[kind | None, self.unit] if self.unit else kind | None

    def findings(self, evidence: Evidence, required: Mapping[str, float]) -> Iterator[Finding]:
        """Findings of values beyond their limit; a limit among those required (key -> value) counts in place of that of
        the run."""
        own = required.get(self.require)
        for measured in self.measure(evidence) if self.measure is not None else ():
            limit = own if own is not None else self.limit if measured.limit is None else measured.limit
            if limit is None or (measured.value >= limit if self.least else measured.value <= limit):
                continue
            yield self.finding(measured, limit, required=own is not None)

    def finding(self, measured: Measured, limit: float | None = None, *, required: bool = False) -> Finding:
        """The finding on what is beyond a limit (None: its own), which a scene may have required."""
        limit = limit if limit is not None else self.limit if measured.limit is None else measured.limit
        assert limit is not None
        unit = measured.unit or self.unit
        bound = ('required' if required else 'limit') + (' at least' if self.least else '')
        numbers = [f'{self.name} {measured.value:.3g} {unit}'.rstrip(), f'{bound} {limit:.3g} {unit}'.rstrip()]
        if measured.time is not None:
            numbers.append(f't = {measured.time:.6g} s')
        reason = measured.reason or self.reason.format(where=measured.where, of=measured.of)
        if measured.where and measured.where not in reason and measured.where.replace('_', ' ') not in reason:
            numbers.append(measured.where)
        text = f'{reason[:1].upper()}{reason[1:]} ({", ".join(numbers)}). {measured.remedy or self.remedy}'
        return Finding(
            quantity=self.name, value=float(measured.value), limit=float(limit), unit=unit, time=measured.time,
            where=measured.where, of=measured.of, required=required, text=text,
        )  # fmt: skip


def largest(row: np.ndarray, place: Callable[[int], str]) -> Measured:
    """Measurement that the account noted in a row of (value, time [s], index), with the place that the index stands
    for."""
    value, time, index = row.tolist()
    return Measured(value=value, time=time, where=place(int(index)) if value > 0.0 else '')
