"""Results of evaluations: figures with units, limits and verdicts, curves to look at, and notes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from solver.units import STANDARD_GRAVITY

DEG = 180.0 / math.pi
SHOWN = {  # SI unit -> (unit for people, factor)
    'rad': ('deg', DEG),
    'rad/s': ('deg/s', DEG),
    'rad s': ('deg s', DEG),
    'rad s^2/m': ('deg/g', DEG * STANDARD_GRAVITY),
    'N m s^2/m': ('N m/g', STANDARD_GRAVITY),
    'N m/rad': ('N m/deg', 1.0 / DEG),
    'm/s^2/rad': ('m/s^2/deg', 1.0 / DEG),
    'N m s/rad': ('N m/(deg/s)', 1.0 / DEG),
}

UNTOLD = 'not told by this drive'


class Figure(NamedTuple):
    """One number. name: its key in JSON. text: for people. unit: SI. limit: what the norm asks for, as text; ok:
    whether it is kept (None: not judged). error: of its value by the step of the simulation, None where nobody measured
    it. interval: of 95 %, of figures that are estimated from a drive. why: the reason where a drive does not tell it.
    """

    name: str
    text: str
    value: float
    unit: str
    limit: str = ''
    ok: bool | None = None
    error: float | None = None
    interval: tuple[float, float] | None = None
    why: str = ''

    @property
    def verdict(self) -> str:
        """'pass', 'FAIL' or 'not judged'."""
        return 'not judged' if self.ok is None else 'pass' if self.ok else 'FAIL'

    def shown(self) -> tuple[str, str]:
        """(value, unit) for people."""
        unit, factor = SHOWN.get(self.unit, (self.unit, 1.0))
        error = '' if self.error is None else f' ± {self.error * factor:.1g}'
        return (
            '-' if not math.isfinite(self.value) else f'{self.value * factor:.4g}{error}'
        ), '' if unit == '1' else unit

    def between(self) -> str:
        """The 95 % interval for people, or why there is none."""
        if self.why:
            return f'{UNTOLD}: {self.why}'
        factor = SHOWN.get(self.unit, (self.unit, 1.0))[1]
        return '' if self.interval is None else ' to '.join(f'{factor * one:.4g}' for one in self.interval)


class Curve(NamedTuple):
    """A line of a chart. style: run, reference, third, other, limit (dashed) or points. group: the variant that it is
    of, where several are drawn over each other."""

    name: str
    x: np.ndarray
    y: np.ndarray
    style: str = 'run'
    group: str = ''


@dataclass(frozen=True, kw_only=True)
class Chart:
    """Curves over one axis; units in SI become those for people when drawn. keep_shape: one metre is as long in x as in
    y."""

    title: str
    x: tuple[str, str]  # label, unit
    y: tuple[str, str]
    curves: tuple[Curve, ...]


@dataclass(frozen=True, kw_only=True)
class Result:
    """Result of one recording. evaluation: its name. norm: the norm that it follows. notes: cautions for users of the
    figures."""

    evaluation: str
    title: str
    norm: str
    figures: tuple[Figure, ...]
    charts: tuple[Chart, ...] = ()
    notes: tuple[str, ...] = ()
    source: str = ''
    parameters: dict[str, float | None] = field(default_factory=dict)

    @property
    def passed(self) -> bool | None:
        """True where every limit is kept; None where nothing is judged."""
        return verdict(figure.ok for figure in self.figures)

    def __getitem__(self, name: str) -> float:
        return next(figure.value for figure in self.figures if figure.name == name)

    def data(self) -> dict[str, Any]:
        """For JSON."""
        return {
            'evaluation': self.evaluation,
            'title': self.title,
            'norm': self.norm,
            'source': self.source,
            'passed': self.passed,
            'figures': {
                f.name: {
                    'text': f.text,
                    'value': f.value,
                    'unit': f.unit,
                    'limit': f.limit,
                    'verdict': f.verdict,
                    **({} if f.error is None else {'numerical_error': f.error}),
                    **({} if f.interval is None else {'interval_95': f.interval}),
                    **({} if not f.why else {'not_told': f.why}),
                }
                for f in self.figures
            },
            'parameters': self.parameters,
            'notes': list(self.notes),
        }


def verdict(oks: Any) -> bool | None:
    """All of them, None where none is judged."""
    judged = [ok for ok in oks if ok is not None]
    return all(judged) if judged else None


def sentence(results: Sequence[Result]) -> str:
    """Sentence that says if all limits of the norms are kept. A limit that was not judged is not counted among those
    that are kept."""
    figures = [figure for result in results for figure in result.figures]
    told, untold = sum(f.interval is not None for f in figures), sum(bool(f.why) for f in figures)
    if told or untold:
        return f'{told} figures with intervals of 95 %, {untold} {UNTOLD}'
    left = sum(bool(figure.limit) and figure.ok is None for figure in figures)
    passed = verdict(result.passed for result in results)
    if passed is None:
        return (
            f'not judged: see the notes ({left} limit{"s" * (left > 1)})'
            if left
            else 'not judged: the norm has no limits'
        )
    if not passed:
        return 'limits of the norm are not kept'
    return (
        f'all limits of the norm that were judged are kept, {left} {"was" if left == 1 else "were"} not judged'
        if left
        else 'all limits of the norm are kept'
    )


def rows(results: Sequence[Result]) -> list[tuple[str, ...]]:
    """A table of figures for people; one result gives its figures below each other. Where they are estimated from a
    drive their intervals, or why it does not tell them, take the place of the limits."""
    estimated = any(f.interval or f.why for result in results for f in result.figures)
    if estimated:
        head = ('figure', 'value', 'unit', '95 % interval')
        return [head, *((f.text, *f.shown(), f.between()) for result in results for f in result.figures)]
    lines: list[tuple[str, ...]] = [('figure', 'value', 'unit', 'limit', '')]
    for result in results:
        lines += [(f.text, *f.shown(), f.limit, f.verdict if f.limit else '') for f in result.figures]
    return lines
