"""Published figures as data, the same problem as a scene of ours, and how far apart the two are at several steps.

A figure is one line of published/*.csv: case, quantity, instant [s] and the numbers as published, to the digits given
there.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from solver.scene import Scene
from solver.simulation import Simulation

FIGURES = Path(__file__).with_name('published')
Look = Callable[[Simulation], np.ndarray]
HALVINGS = 3  # runs of a case; the order needs three
LEFT_BY_ITERATION = 1e-7  # of the largest number of a quantity: smaller changes with the step say nothing of an order


class PublishedValue(NamedTuple):
    """One published value or vector."""

    quantity: str
    t: float  # s
    text: tuple[str, ...]  # its numbers, digit by digit

    @property
    def values(self) -> np.ndarray:
        return np.array([float(x) for x in self.text])


class Quantity(NamedTuple):
    """Something that is compared."""

    unit: str
    look: Look  # its value in the state that the simulation shows
    limit: float  # largest departure of our limit for small steps from what is published
    either_sign: bool = False  # quaternions


class PublishedProblem(NamedTuple):
    """A published problem."""

    name: str
    text: str  # what it is
    source: str  # repository or work, and where in it
    scene: Callable[[float], Scene]  # with a step [s]
    h: float  # s, the first of the steps; each further one is half of it
    quantities: dict[str, Quantity]
    figures: tuple[PublishedValue, ...]


class Row(NamedTuple):
    """A figure beside ours."""

    case: str
    figure: PublishedValue
    ours: tuple[np.ndarray, ...]  # at h, h/2, ...
    limiting: np.ndarray  # extrapolated from the two finest runs


class Judgement(NamedTuple):
    """All figures of one quantity of a case."""

    case: str
    quantity: str
    unit: str
    size: float  # largest published number
    differences: tuple[float, ...]  # largest |ours - published| at h, h/2, ...
    limiting: float  # the same of the extrapolated values
    order: float  # with which ours converge, nan where they do not depend on the step
    limit: float


def read(name: str) -> dict[str, tuple[PublishedValue, ...]]:
    """The figures of a file by case."""
    found: dict[str, list[PublishedValue]] = {}
    with (FIGURES / f'{name}.csv').open(encoding='utf-8') as file:
        for row in csv.DictReader(file):
            found.setdefault(row['case'], []).append(
                PublishedValue(row['quantity'], float(row['t']), tuple(row['values'].split()))
            )
    return {case: tuple(figures) for case, figures in found.items()}


def run(case: PublishedProblem, h: float) -> dict[tuple[str, float], np.ndarray]:
    """Ours at every figure's quantity and instant. Raises MbdError."""
    simulation = Simulation(case.scene(h))
    found = {}
    for t in sorted({figure.t for figure in case.figures}):
        simulation.advance(round(t * 1e9 / simulation.h_ns) - simulation.k)
        for figure in case.figures:
            if figure.t == t:
                found[figure.quantity, t] = np.atleast_1d(case.quantities[figure.quantity].look(simulation))
    return found


def compare(case: PublishedProblem) -> tuple[list[Row], list[Judgement]]:
    """Every figure beside ours at three steps, and every quantity judged."""
    runs = [run(case, case.h / 2**k) for k in range(HALVINGS)]
    rows = []
    for figure in case.figures:
        ours = [r[figure.quantity, figure.t] for r in runs]
        if case.quantities[figure.quantity].either_sign:
            ours = [value if value @ figure.values >= 0.0 else -value for value in ours]
        rows.append(Row(case.name, figure, tuple(ours), ours[-1] + (ours[-1] - ours[-2]) / 3.0))
    return rows, [_judge(case, name, [r for r in rows if r.figure.quantity == name]) for name in case.quantities]


def _judge(case: PublishedProblem, name: str, rows: Sequence[Row]) -> Judgement:
    quantity = case.quantities[name]
    differences = tuple(max(float(np.abs(r.ours[k] - r.figure.values).max()) for r in rows) for k in range(HALVINGS))
    coarse, fine = (np.concatenate([r.ours[k + 1] - r.ours[k] for r in rows]) for k in range(2))
    size = max(float(np.abs(r.figure.values).max()) for r in rows)
    order = math.nan
    if np.linalg.norm(fine) > LEFT_BY_ITERATION * max(1.0, size):
        order = float(np.log2(np.linalg.norm(coarse) / np.linalg.norm(fine)))
    limiting = max(float(np.abs(r.limiting - r.figure.values).max()) for r in rows)
    return Judgement(case.name, name, quantity.unit, size, differences, limiting, order, quantity.limit)
