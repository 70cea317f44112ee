"""Runs of one maneuver with different settings: sampled on one time grid, and compared with their converged limit.

run() makes a run. converged() extrapolates runs of ever smaller steps to the limit of step zero, with an error band.
departures(), orders() and growth() say by how much a run departs from that limit.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from solver import simulation_of
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.errors import MbdError, SpecError
from solver.files.scene import load_scene
from solver.simulation import Simulation

GRID = 0.01  # time between samples [s]; every step size must divide it
FORCES = tuple(TIRE_COLUMNS.index(name) for name in ('fx', 'fy', 'fz'))


class CarRun(NamedTuple):
    """A run, sampled every GRID seconds until its end or failure."""

    name: str
    t: np.ndarray  # (n,) [s]
    place: np.ndarray  # (n, 2) x, y of the chassis frame [m]
    heading: np.ndarray  # (n,) [rad], continuous
    velocity: np.ndarray  # (n, 2) of the chassis frame, along its own x and y [m/s]
    yaw_rate: np.ndarray  # (n,) [rad/s]
    forces: np.ndarray  # (n, 4, 3) tire forces fx, fy, fz in the contact frame [N]
    steps: np.ndarray  # (m, 2) time [s], step size from then on [s]
    figures: dict[str, float]  # counters, and CPU time [s]
    message: str  # error that ended the run early, or ''


def run(scene: str, name: str, overrides: Sequence[str], duration: float) -> CarRun:
    """Run a scene with these overrides for duration [s]; a failure ends the run and is kept as its message."""
    try:
        simulation = simulation_of(load_scene(scene, overrides))
    except MbdError as error:
        none, pairs = np.zeros(0), np.zeros((0, 2))
        return CarRun(name, none, pairs, none, pairs, none, np.zeros((0, 4, 3)), pairs, {}, str(error))
    return follow(simulation, name, duration)


def follow(simulation: Simulation, name: str, duration: float) -> CarRun:
    """The run of a simulation from its start on, for duration [s]; a failure ends the run and is kept as its
    message."""
    rows, message = [_row(simulation.snapshot())], ''
    begin = time.process_time()
    try:
        if abs(GRID / simulation.h - round(GRID / simulation.h)) > 1e-9:
            raise SpecError(
                f'{name}: integrator.h = {simulation.h:g}: must be a whole part of the common grid of {GRID:g} s'
            )
        for _ in range(round(duration / GRID)):
            rows.append(_row(simulation.advance(round(GRID / simulation.h), audit=False)))
    except MbdError as error:
        message = str(error)
    cpu = time.process_time() - begin
    data = np.array(rows)
    steps = [(0.0, simulation.h)] + [(e.t, e.new) for e in simulation.events if e.kind == 'step']
    reached = max(float(data[-1, 0]), GRID)
    audit = simulation.totals()
    figures = {'cpu': cpu, 'cpu_per_second': cpu / reached, 'until': float(data[-1, 0])}
    figures |= {key: float(audit[key]) for key in ('iterations', 'factorizations', 'evaluations', 'position_drift_max')}
    heading = np.unwrap(data[:, 3])
    return CarRun(
        name, data[:, 0], data[:, 1:3], heading, data[:, 4:6], data[:, 6], data[:, 7:].reshape(-1, 4, 3),
        np.array(steps), figures, message
    )  # fmt: skip


def _row(s) -> np.ndarray:
    """Numbers of a snapshot in the order in which follow() takes them apart."""
    x, y, z, w = s.pose[0, 3:]
    heading = np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))
    forces = s.tire[:, FORCES].ravel()
    return np.concatenate([[s.t_ns * 1e-9, *s.pose[0, :2], heading, *s.twist[0, :2], s.twist[0, 5]], forces])


CURVES = ('place', 'heading', 'velocity', 'yaw_rate', 'forces')  # fields of CarRun that are compared


class Converged(NamedTuple):
    """The limit of step halving, by Richardson's extrapolation of the two finest runs of a method of second order."""

    run: CarRun
    band: dict[str, np.ndarray]  # curve -> uncertainty: the distance to the extrapolation of the next coarser two runs


def extrapolated(coarse: CarRun, fine: CarRun) -> dict[str, np.ndarray]:
    """Curves of Richardson's extrapolation, without the error of order h^2; fine has half the step of coarse."""
    return {key: getattr(fine, key) + (getattr(fine, key) - getattr(coarse, key)) / 3.0 for key in CURVES}


def converged(levels: Sequence[CarRun]) -> Converged:
    """Converged limit of at least three complete runs, each with half the step of the one before."""
    best, before = extrapolated(levels[-2], levels[-1]), extrapolated(levels[-3], levels[-2])
    truth = levels[-1]._replace(name='converged', **best)  # type: ignore[arg-type]
    return Converged(truth, {key: np.abs(best[key] - before[key]) for key in CURVES})


def departures(found: CarRun, truth: CarRun, until: float) -> dict[str, float]:
    """Departures of a run from `truth`, over the time that both have, at most `until` [s].

    position: largest distance [m]. yaw_rate: largest difference, relative to the peak of the truth. tire_force: root
    mean square of the difference of a force component of a wheel, relative to the peak of the same component; the worst
    of the twelve. front_left_lateral: the same of the lateral force of that wheel. All are NaN for a run that failed,
    whose last values mean nothing.
    """
    if found.message:
        return dict.fromkeys(('position', 'yaw_rate', 'tire_force', 'front_left_lateral'), np.nan)
    last = round(until / GRID) + 1
    n = min(len(found.t), last)
    force = found.forces[:n] - truth.forces[:n]
    rms = np.sqrt((force**2).mean(0)) / np.abs(truth.forces[:last]).max(0)
    return {
        'position': float(np.hypot(*(found.place[:n] - truth.place[:n]).T).max()),
        'yaw_rate': float(np.abs(found.yaw_rate[:n] - truth.yaw_rate[:n]).max() / np.abs(truth.yaw_rate[:last]).max()),
        'tire_force': float(rms.max()),
        'front_left_lateral': float(rms[0, 1]),
    }


def orders(levels: Sequence[CarRun], until: float) -> list[dict[str, float]]:
    """Observed order of convergence from each three successive levels, over the time until [s].

    The order is log2 of the ratio of the root mean squares of the two differences. That of the tire forces is the least
    of the twelve components.
    """
    n = round(until / GRID) + 1

    def order(key: str, a: CarRun, b: CarRun, c: CarRun) -> np.ndarray:
        coarse, fine = (((getattr(p, key) - getattr(q, key))[:n] ** 2).mean(0) for p, q in ((a, b), (b, c)))
        return 0.5 * np.log2(coarse.sum() / fine.sum() if key == 'place' else coarse / fine)

    return [
        {
            'trajectory': float(order('place', *three)),
            'yaw_rate': float(order('yaw_rate', *three)),
            'tire_forces': float(order('forces', *three).min()),
        }
        for three in zip(levels, levels[1:], levels[2:], strict=False)
    ]


class Growth(NamedTuple):
    """Growth and causes of a position error."""

    power: float  # p in |error| ~ t^p
    power_misfit: float  # root mean square residual of log |error| in that fit
    rate: float  # s in |error| ~ exp(s t) [1/s]
    rate_misfit: float  # root mean square residual of log |error| in that fit
    # share of the final error that comes from the heading error; the velocity error makes the others
    heading_share: float
    rest: float  # share of the final error that neither explains


def growth(found: CarRun, truth: CarRun, start: float) -> Growth:
    """Growth of the position error after start [s]: fits of its envelope by least squares, and its two causes.

    The place is the integral over time of R(heading) velocity. To first order its error is the integral of
    (heading error) R'(heading) velocity, plus the integral of R(heading) (velocity error).
    """
    n = len(found.t)
    t, error = truth.t[:n], found.place - truth.place[:n]
    size = np.hypot(*error.T)
    used = (t > start) & (size > 0.0)
    envelope = np.maximum.accumulate(size)[used]
    x = t[used] - start + GRID

    def fit(abscissa: np.ndarray) -> tuple[float, float]:
        line = np.polyfit(abscissa, np.log(envelope), 1)
        return float(line[0]), float(np.sqrt(np.mean((np.polyval(line, abscissa) - np.log(envelope)) ** 2)))

    c, s = np.cos(truth.heading[:n]), np.sin(truth.heading[:n])
    u, v = truth.velocity[:n].T
    turned = (found.heading - truth.heading[:n])[:, None] * np.column_stack([-s * u - c * v, c * u - s * v])
    du, dv = (found.velocity - truth.velocity[:n]).T
    moved = np.column_stack([c * du - s * dv, s * du + c * dv])
    by_heading, by_velocity = (
        np.concatenate([[[0.0, 0.0]], np.cumsum(0.5 * GRID * (w[1:] + w[:-1]), 0)]) for w in (turned, moved)
    )
    end = error[-1] / (error[-1] @ error[-1])
    rest = np.linalg.norm(error[-1] - by_heading[-1] - by_velocity[-1]) / np.linalg.norm(error[-1])
    return Growth(*fit(np.log(x)), *fit(x), float(by_heading[-1] @ end), float(rest))
