"""What is said of a run and of a level: findings, limits, certificates, reports. Words only; who judges stands above."""

from __future__ import annotations

from dataclasses import dataclass

# Quantities of findings that a plan may have measured: what they tell of is a matter of step, iterations or level.
COARSE = ('turn_per_step', 'resolution', 'phase', 'validity', 'envelope')
ANYWHERE = ('turn_per_step',)  # iterations contract by the largest turn, whichever body makes it; of four wheels now one, now another
WORSE = 0.1  # of the value: as much as a plan leaves free of a limit for maneuvers beside those it chose on (solver.trade.search)


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What makes a run suspect.

    quantity: as in `require` where there is such a limit. time: of the worst instant [s], None when it has none. where: the body or
    constraint row that is worst, or empty. required: whether the limit is one that the scene requires.
    """

    quantity: str
    value: float
    limit: float
    unit: str
    time: float | None
    where: str
    required: bool
    text: str

    def __str__(self) -> str:
        return self.text

    @property
    def what(self) -> str:
        """What it says, without numbers: with quantity and where the kind of the finding."""
        return self.text.partition(f' {self.value:.3g}')[0]


@dataclass(frozen=True, kw_only=True)
class Certified:
    """A finding of the runs that a plan was measured on: its kind (quantity, what it says, where) and how far it went beyond a limit."""

    quantity: str
    what: str
    where: str
    value: float
    limit: float
    unit: str

    def covers(self, finding: Finding) -> bool:
        """Whether a finding is the same, beyond the same end of a range, and not considerably worse."""
        if finding.quantity not in COARSE or finding.required or kind_of(finding) != kind_of(self):
            return False
        return side_of(self) * (finding.value - self.value) <= WORSE * abs(self.value)


def kind_of(one: Finding | Certified) -> tuple[str, str, str, float]:
    """Quantity, what it says, where, and beyond which end of a range: findings alike in these are the same at another size."""
    return one.quantity, one.what, '' if one.quantity in ANYWHERE else one.where, side_of(one)


def side_of(one: Finding | Certified) -> float:
    """Beyond which end of its range: 1 above the upper, -1 below the lower one. What was measured to the left says nothing of the right."""
    return 1.0 if one.value > one.limit else -1.0


@dataclass(frozen=True, kw_only=True)
class Limit:
    """Where a level holds: the quantity between low and high, in the unit, and why (None: no limit on that side)."""

    quantity: str
    unit: str
    low: float | None = None
    high: float | None = None
    why: str

    def __str__(self) -> str:
        low = '' if self.low is None else f'{self.low:g} {self.unit}'.rstrip() + ' <= '
        high = '' if self.high is None else f' <= {self.high:g} {self.unit}'.rstrip()
        return f'{low}{self.quantity}{high}: {self.why}'


@dataclass(frozen=True, kw_only=True)
class Switched:
    """A subsystem that the vehicle has, whether the model has it, and why."""

    subsystem: str
    on: bool
    why: str


@dataclass(frozen=True, kw_only=True)
class ErrorFigure:
    """How far a quantity is from the full vehicle in a maneuver: root mean square and largest error, as shares of its peak [unit]."""

    maneuver: str
    quantity: str
    rms: float
    largest: float
    peak: float
    unit: str


@dataclass(frozen=True, kw_only=True)
class LevelReport:
    """What a level leaves out of the vehicle it is derived from.

    lost: modes and effects that it does not model, in words. absent: channels of the full vehicle that it does not publish. validity:
    where it holds. switched: every subsystem of the vehicle. errors: the error sheet, where it has been measured. certified: what would
    make a run suspect, but was there too where the plan that certifies it has measured its errors (solver.analysis.covered).
    """

    lost: tuple[str, ...] = ()
    absent: tuple[str, ...] = ()
    validity: tuple[Limit, ...] = ()
    switched: tuple[Switched, ...] = ()
    errors: tuple[ErrorFigure, ...] | None = None
    certified: tuple[Certified, ...] = ()
