"""Digests of runs, in a process whose processor can be another: `python bits_of_runs.py [--nudged] SCENE ...` prints
them as JSON."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from solver import load_scene, simulation_of
from solver.inputs.driver import Waypoints
from solver.inputs.signals import Sine, SineWithDwell, Sum, Sweep, Table

SECONDS = 0.2
ELEMENTARY = (
    'sin', 'cos', 'tan', 'exp', 'expm1', 'log', 'log10', 'log1p', 'sinh', 'cosh', 'tanh', 'arctan2', 'arctan', 'arcsin',
    'arccos',
    'power', 'float_power', 'hypot', 'cbrt',
)  # fmt: skip
BLAS = ('dot', 'vdot', 'inner', 'matmul', 'tensordot')
LAPACK = ('norm', 'inv', 'solve', 'det', 'lstsq', 'eigh', 'eigvalsh', 'eigvals', 'cholesky', 'svd', 'qr', 'pinv')


def digest(*arrays: np.ndarray) -> str:
    """Of all their bits."""
    found = hashlib.sha256()
    for array in arrays:
        found.update(np.ascontiguousarray(array, float).tobytes())
    return found.hexdigest()[:16]


def of_scene(name: str) -> list[str]:
    """Digests of the start and of what is published until SECONDS."""
    simulation = simulation_of(load_scene(name))
    start = digest(*simulation.state)
    steps = round(SECONDS / simulation.h)
    return [start, digest(*(simulation.advance(steps // 10).numbers for _ in range(10)))]


def of_inputs() -> list[str]:
    """Digests of what signals and a driver's path give."""
    points = tuple((0.3 * k, (0.7 * k * k) % 1.0) for k in range(12))
    terms = (
        Sine(amplitude=0.3, frequency=1.7, phase=0.2),
        SineWithDwell(amplitude=1.1, start=0.1),
        Sweep(amplitude=0.2, frequency=0.3, final_frequency=4.0, duration=2.0, start=0.0),
        Table(points=points),
    )
    path = Waypoints(points=tuple((10.0 * x, y) for x, y in points))
    return [
        digest(*Sum(terms=terms).jet(np.linspace(0.0, 3.0, 301))),
        digest(np.array([path.lateral(0.37 * k) for k in range(100)])),
    ]


def of_all(scenes: list[str]) -> dict[str, list[str]]:
    """Digests by name."""
    return {name: of_scene(name) for name in scenes} | {'inputs': of_inputs()}


def nudged(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function on another processor: every number that it returns is the next one."""

    def other(*arguments: Any, **named: Any) -> Any:
        return _next(function(*arguments, **named))

    return other


def _next(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(map(_next, value))
    if isinstance(value, float | np.ndarray | np.floating) and np.asarray(value).dtype == np.float64:
        return np.nextafter(value, np.inf)
    return value


def nudge_numpy() -> None:
    """Replace what numpy computes differently on different processors. Kernels that are compiled stay as they are."""
    for module, names in ((np, ELEMENTARY + BLAS), (np.linalg, LAPACK)):
        for name in names:
            setattr(module, name, nudged(getattr(module, name)))


if __name__ == '__main__':
    scenes = [name for name in sys.argv[1:] if name != '--nudged']
    found = {'here': of_all(scenes)}
    if '--nudged' in sys.argv:
        nudge_numpy()
        assert np.sin(1.0) != float.fromhex((0.8414709848078965).hex())
        found['nudged'] = of_all(scenes)
    print(json.dumps(found))
