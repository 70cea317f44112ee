"""Order of accuracy: errors of a scene against its exact motion at several step sizes, and the slope between them."""

from __future__ import annotations

import dataclasses

import numpy as np
from closed_forms import Motion, Problem
from scipy.spatial.transform import Rotation

from solver.files.scene import load_scene_text
from solver.output.snapshot import Snapshot
from solver.scene import Scene
from solver.simulation import Simulation

FIELDS = ('position', 'velocity', 'multipliers')


def scene_of(problem: Problem, **integrator) -> Scene:
    """The scene of a problem with integrator settings."""
    text, _, overrides = problem.scene.partition('override:')
    remove = ['mechanism.couplers={}'] if overrides else []
    scene = load_scene_text(text, overrides=remove)
    return dataclasses.replace(scene, integrator=dataclasses.replace(scene.integrator, **integrator))


def error(snapshot: Snapshot, exact: Motion) -> np.ndarray:
    """Largest errors (position [m or rad], velocity [m/s or rad/s], multipliers [N or N m])."""
    R = Rotation.from_quat(snapshot.pose[:, 3:])
    turn = (R.inv() * Rotation.from_matrix(exact.R)).magnitude()
    v = R.apply(snapshot.twist[:, :3])
    return np.array([
        max(np.abs(snapshot.pose[:, :3] - exact.p).max(), turn.max()),
        max(np.abs(v - exact.v).max(), np.abs(snapshot.twist[:, 3:] - exact.w).max()),
        np.nanmax(np.abs(snapshot.reactions - exact.reaction), initial=0.0),
    ])  # fmt: skip


def errors(problem: Problem, h: float, times: np.ndarray, **integrator) -> np.ndarray:
    """Largest errors over the times (multiples of h), (3,)."""
    simulation = Simulation(scene_of(problem, h=h, **integrator))
    worst = np.zeros(3)
    for t in times:
        snapshot = simulation.advance(round(t / h) - simulation.k)
        worst = np.maximum(worst, error(snapshot, problem.exact(t)))
    return worst


def orders(
    problem: Problem, steps: tuple[float, ...], times: np.ndarray, **integrator
) -> tuple[np.ndarray, np.ndarray]:
    """(slopes (3,) of log error over log h by least squares, errors (len(steps), 3))."""
    table = np.array([errors(problem, h, times, **integrator) for h in steps])
    x = np.log(steps)
    y = np.log(np.maximum(table, 1e-300))
    return ((x - x.mean()) @ (y - y.mean(axis=0))) / ((x - x.mean()) @ (x - x.mean())), table
