"""Variants side by side: figures in columns, differences from the first variant in percent, curves over each other.

A variant is one recording, or several that belong together: those of `mbd maneuver` in one directory, and a series of
one vehicle where the norm asks for a series.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from mbd_sim_ros.analysis.evaluation.figures import Chart, Figure, Result
from mbd_sim_ros.analysis.evaluation.registry import called
from solver.elements.road import RoadSpec
from solver.errors import BagError
from solver.scene import Scene

REPORT = 'report.json'  # of mbd maneuver, beside the recordings that it judges
WITHIN = 'within its numerical error'
OVERLAP = 'within the intervals'


class Variant(NamedTuple):
    """name: for people, unlike all others. results: of its recordings."""

    name: str
    results: tuple[Result, ...]

    def of(self, evaluation: str) -> tuple[Result, ...]:
        """Its results of one evaluation."""
        return tuple(r for r in self.results if r.evaluation == evaluation)

    def figures(self, evaluation: str) -> tuple[Figure, ...]:
        """Its figures of one evaluation: of a series those of all runs together."""
        found, together = self.of(evaluation), called(evaluation)[0].together
        if together is not None and self.serial(evaluation):
            return together(list(found))
        return found[0].figures if found else ()

    def serial(self, evaluation: str) -> bool:
        """True where it has a series of runs that the norm judges together."""
        return len(self.of(evaluation)) > 1 and called(evaluation)[0].together is not None


class Line(NamedTuple):
    """One figure of all variants: None where a variant does not have it."""

    name: str
    text: str
    unit: str
    figures: tuple[Figure | None, ...]

    def percent(self, k: int) -> float | None:
        """Difference of variant k from the first one, in percent of the size of the latter; None where that is zero or
        one of them has no value."""
        base, other = self.figures[0], self.figures[k]
        if base is None or other is None or not (math.isfinite(base.value) and math.isfinite(other.value)):
            return None
        if base.value == 0.0:
            return 0.0 if other.value == 0.0 else None
        return 100.0 * (other.value - base.value) / abs(base.value)

    def is_within_error(self, k: int) -> bool:
        """True where the numerical errors of both figures, where measured, are larger than their difference."""
        base, other = self.figures[0], self.figures[k]
        if base is None or other is None or (base.error is None and other.error is None):
            return False
        return abs(other.value - base.value) <= (base.error or 0.0) + (other.error or 0.0)

    def is_within_intervals(self, k: int) -> bool:
        """True where both figures have 95 % intervals, and the difference is within the root of the sum of the squares
        of their halves, that of independent drives."""
        base, other = self.figures[0], self.figures[k]
        if base is None or other is None or base.interval is None or other.interval is None:
            return False
        half = [0.5 * (one.interval[1] - one.interval[0]) for one in (base, other) if one.interval is not None]
        return abs(other.value - base.value) <= math.hypot(*half)


class Driven(NamedTuple):
    """Content of a directory of `mbd maneuver`: recordings, and sentences on maneuvers that were refused."""

    places: list[Path]
    refused: list[str]


def recordings(place: Path) -> Driven | None:
    """The recordings that `mbd maneuver` has judged in a directory; None for one that is not of it. Raises BagError."""
    report = place / REPORT
    if not report.is_file() or any(place.glob('*.mcap')):
        return None
    try:
        known = json.loads(report.read_text(encoding='utf-8'))
        places = [place / Path(one['source']).name for one in known['results']]
        refused = [f'{name}: REFUSED: {why}' for name, why in known['refused'].items()]
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        raise BagError(f'{report}: is no report of mbd maneuver; give the recordings beside it instead') from None
    for one in places:
        if not one.is_dir():
            raise BagError(f'{report} names {one.name}, which is not in {place}; give the recordings instead')
    if not places:
        raise BagError(f'{report}: none of its maneuvers has a result')
    return Driven(places, refused)


def names(places: Sequence[Path]) -> list[str]:
    """A name for each place: its last part, with as many directories before it as tell it from the others."""
    parts = [place.resolve().parts for place in places]
    for count in range(1, max(map(len, parts)) + 1):
        found = ['/'.join(one[-count:]) for one in parts]
        if len(set(found)) == len(set(parts)):
            break
    return [f'{name} ({found[:k].count(name) + 1})' if name in found[:k] else name for k, name in enumerate(found)]


def grouped(of: Sequence[tuple[str, Sequence[Result], Scene | None]]) -> list[Variant]:
    """Variants of what was given, in its order. of: name, results and scene (of one recording) of each argument.

    Recordings of one vehicle that the norm takes as a series are one variant; where no scene tells the vehicle, all.
    """
    found: list[tuple[str, list[Result], Scene | None]] = []
    for name, results, scene in of:
        evaluation = results[0].evaluation
        serial = len(results) == 1 and called(evaluation)[0].together is not None
        same = next(
            (
                one
                for one in found
                if serial and {r.evaluation for r in one[1]} == {evaluation} and _is_same_vehicle(one[2], scene)
            ),
            None,
        )
        if same is None:
            found.append((name, list(results), scene))
        else:
            same[1].extend(results)
    return [Variant(name, tuple(results)) for name, results, _ in found]


def _is_same_vehicle(one: Scene | None, other: Scene | None) -> bool:
    if one is None or other is None:
        return one is other
    return dataclasses.replace(one.model, road=RoadSpec()) == dataclasses.replace(other.model, road=RoadSpec())


def lines(variants: Sequence[Variant], evaluation: str) -> list[Line]:
    """The figures of an evaluation, in the order in which the variants name them first."""
    of = [{f.name: f for f in variant.figures(evaluation)} for variant in variants]
    first: dict[str, Figure] = {}
    for figures in of:
        for name, figure in figures.items():
            first.setdefault(name, figure)
    return [Line(name, f.text, f.unit, tuple(figures.get(name) for figures in of)) for name, f in first.items()]


def data(variants: Sequence[Variant], evaluation: str) -> dict[str, Any]:
    """For JSON: the names of the variants, and of every figure of an evaluation values [SI] and differences."""
    return {
        'evaluation': evaluation,
        'names': [variant.name for variant in variants],
        'figures': {
            line.name: {
                'text': line.text,
                'unit': line.unit,
                'values': [None if f is None else f.value for f in line.figures],
                'verdicts': [None if f is None else f.verdict for f in line.figures],
                'intervals_95': [None if f is None else f.interval for f in line.figures],
                'difference_percent': [line.percent(k) for k in range(len(variants))],
            }
            for line in lines(variants, evaluation)
        },
    }


def rows(variants: Sequence[Variant], evaluation: str) -> list[tuple[str, ...]]:
    """A table for people, its head first: a column for each variant, with the difference behind all but the first."""
    head = ['figure', 'unit', variants[0].name]
    for variant in variants[1:]:
        head += [variant.name, 'difference']
    table = [tuple(head)]
    for line in lines(variants, evaluation):
        shown = [('-', '') if f is None else f.shown() for f in line.figures]
        row = [line.text, next((unit for _, unit in shown if unit), '')]
        for k, (f, (value, _)) in enumerate(zip(line.figures, shown, strict=True)):
            interval = f' ({f.between()})' if f is not None and f.interval is not None else ''
            row.append(f'{value} FAIL' if f is not None and f.ok is False else f'{value}{interval}')
            if k:
                percent = line.percent(k)
                said = '-' if percent is None else f'{percent:+.3g} %'
                within = WITHIN if line.is_within_error(k) else OVERLAP if line.is_within_intervals(k) else ''
                row.append(within or said)
        table.append(tuple(row))
    return table


def overlaid(variants: Sequence[Variant], evaluation: str) -> tuple[Chart, ...]:
    """The charts of an evaluation with the curves of all variants, named after them; limits and marks are those of the
    first. Of a series the run that comes first is drawn."""
    charts: dict[str, Chart] = {}
    for variant in variants:
        found = variant.of(evaluation)
        for chart in found[0].charts if found else ():
            known = charts.get(chart.title)
            curves = tuple(
                curve._replace(name=f'{variant.name}: {curve.name}', group=variant.name)
                for curve in chart.curves
                if curve.style != 'limit' or known is None
            )
            charts[chart.title] = dataclasses.replace(chart, curves=((*known.curves, *curves) if known else curves))
    return tuple(charts.values())
