"""Findings, limits, certificates and reports of runs and levels. Data only; the checks that judge are in higher
modules."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Reason why a run is suspect: a value beyond the limit of a check (solver.checks).

    quantity: the name of the check. time: of the worst instant [s], None when it has none. where: the body or
    constraint row that is worst, or empty. of: what the value is of, where a check looks at several things, or empty.
    required: whether the limit is one that the scene requires. text: two sentences, what was found with its numbers,
    and what to do.
    """

    quantity: str
    value: float
    limit: float
    unit: str
    time: float | None
    where: str
    of: str = ''
    required: bool
    text: str

    def __str__(self) -> str:
        return self.text

    @property
    def fact(self) -> str:
        """The first of its sentences, without the remedy."""
        return self.text.partition('). ')[0] + ')'

    def covered_for(self, names: str) -> str:
        """Sentence on a finding that a certificate covers, for the quantities of these names."""
        return f'{self.fact}: covered by the certificate, whose plan has measured the effect on {names}'


@dataclass(frozen=True, kw_only=True)
class Certified:
    """A finding of the runs that a plan was measured on: its kind (quantity, of, where), and how far it went beyond a
    limit."""

    quantity: str
    of: str
    where: str
    value: float
    limit: float
    unit: str


@dataclass(frozen=True, kw_only=True)
class Limit:
    """Range in which a level holds: the quantity between low and high, in the unit, and why (None: no limit on that
    side)."""

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
    """Error of a quantity against the full vehicle in a maneuver: root mean square and largest error, as shares of its
    peak [unit]."""

    maneuver: str
    quantity: str
    rms: float
    largest: float
    peak: float
    unit: str


@dataclass(frozen=True, kw_only=True)
class LevelReport:
    """Differences between a level and the vehicle it is derived from.

    lost: modes and effects that it does not model, in words. absent: channels of the full vehicle that it does not
    publish. validity: where it holds. switched: every subsystem of the vehicle. errors: the error sheet, where it has
    been measured. certified: what would make a run suspect, but was there too where the plan that certifies it has
    measured its errors (solver.analysis.certificate_coverage). certificate: hash of the plan.
    """

    lost: tuple[str, ...] = ()
    absent: tuple[str, ...] = ()
    validity: tuple[Limit, ...] = ()
    switched: tuple[Switched, ...] = ()
    errors: tuple[ErrorFigure, ...] | None = None
    certified: tuple[Certified, ...] = ()
    certificate: str = ''
