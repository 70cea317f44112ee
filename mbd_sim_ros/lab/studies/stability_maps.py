"""The maps of the study of stability: small mechanisms with known motions, over two quantities each.

A map is a list of lines; a line is one problem with one value of the ordinate, run at all abscissae. Motions are known
in closed form or from minimal coordinates, but for the governor, whose reference is an implicit dense integrator.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from mbd_sim_ros.lab.mechanisms.judgement import RESOLVED, START, compare, run, unseen
from mbd_sim_ros.lab.mechanisms.references import FINE, difference, measured, reference
from mbd_sim_ros.lab.studies import crank
from solver.elements.marker import WORLD, Marker
from solver.errors import StepError
from solver.files.scene import load_scene, load_scene_text
from solver.model.spec import ModelSpec
from solver.scene import Scene
from solver.simulation import Simulation
from solver.step.settings import IntegratorSettings
from solver.units import MODEL_GRAVITY

DURATION = 1.0  # s
SAMPLE = 0.1  # s, a multiple of all steps
STEPS = (0.05e-3, 0.1e-3, 0.2e-3, 0.5e-3, 1e-3, 2e-3, 5e-3, 10e-3, 20e-3, 50e-3)  # s
QUICK_STEPS = (0.5e-3, 1e-3, 2e-3, 5e-3, 10e-3, 50e-3)
EPS = float(np.finfo(float).eps)
TIMES = np.arange(round(DURATION / FINE) + 1) * FINE


class Problem(NamedTuple):
    """A scene by its step and other settings, its motion q (n, nb + 1, 7) every FINE, and the difference of two
    references of it."""

    scene: Callable[..., Scene]
    exact: Callable[[], np.ndarray]
    spread: Callable[[], float] = lambda: 1e-12


def about_z(angle: np.ndarray) -> np.ndarray:
    """(n, 4) quaternions of rotations about z."""
    zero = np.zeros_like(angle)
    return np.stack([zero, zero, np.sin(angle / 2), np.cos(angle / 2)], axis=-1)


def bodies(*motions: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """q (n, nb + 1, 7) of bodies with places (n, 3) and quaternions (n, 4)."""
    n = len(motions[0][0])
    world = np.tile([0.0, 0, 0, 0, 0, 0, 1], (n, 1))
    return np.stack([*(np.hstack(pair) for pair in motions), world], axis=1)


def at(x: Any, y: Any = 0.0, z: Any = 0.0) -> np.ndarray:
    """(n, 3) places."""
    return np.stack(np.broadcast_arrays(x, y, z, np.zeros(len(TIMES)))[:3], axis=-1).astype(float)


def scene_of(mechanism: dict[str, Any], **rest: Any) -> Callable[..., Scene]:
    """Scenes of a mechanism by their settings."""
    made = load_scene_text(json.dumps({'mechanism': mechanism, 'duration': DURATION, **rest}), 'mechanism')
    return lambda **settings: dataclasses.replace(made, integrator=IntegratorSettings(**settings))


# -- problems --------------------------------------------------------------------------------------------------------


@cache
def slider_crank(theta: float = np.pi / 4) -> Problem:
    """The slider-crank with equal rods from a crank angle, through its singular positions (crank)."""

    def exact() -> np.ndarray:
        angle = crank.exact_angles(np.array([theta]), crank.slider_mass(), TIMES)[0]
        com = {body.name: np.array(body.com) for body in load_scene('slider_crank').model.bodies}
        c, s = np.cos(angle), np.sin(angle)
        still = np.tile([0.0, 0, 0, 1], (len(TIMES), 1))
        x, y, z = com['crank']
        crank_at = at(c * x - s * y, s * x + c * y, z)
        x, y, z = com['rod']
        rod_at = at(c + c * x + s * y, s - s * x + c * y, z)
        ground, slider = (at(*com[name]) for name in ('ground', 'slider'))
        slider[:, 0] += 2 * c
        return bodies((ground, still), (crank_at, about_z(angle)), (rod_at, about_z(-angle)), (slider, still))

    def scene(h: float, **settings: Any) -> Scene:
        return dataclasses.replace(crank.scene_at(theta, h, settings), duration=DURATION)

    return Problem(scene, exact)


@cache
def pendulum(ratio: float = 1.0) -> Problem:
    """A double pendulum of balls of 1 and `ratio` kg (radius of gyration 0.3 m) on arms of 1 m, from the horizontal and
    30 deg below."""
    square, start = 0.09, np.array([np.pi / 2, np.pi / 3])

    def motion(_: float, y: np.ndarray) -> np.ndarray:
        (one, two), (w1, w2) = y[:2], y[2:]
        c, s = np.cos(one - two), np.sin(one - two)
        a, b = (1.0, ratio) if ratio <= 1.0 else (1.0 / ratio, 1.0)  # masses over the larger one
        M = np.array([[a * (1 + square) + b, b * c], [c, 1 + square]])
        f = [-b * s * w2**2 - (a + b) * MODEL_GRAVITY * np.sin(one), s * w1**2 - MODEL_GRAVITY * np.sin(two)]
        return np.concatenate([y[2:], np.linalg.solve(M, f)])

    def exact() -> np.ndarray:
        found = solve_ivp(
            motion, (0, DURATION), [*start, 0, 0], method='DOP853', rtol=1e-13, atol=1e-13, t_eval=TIMES
        ).y[:2]
        x, y = np.sin(found[0]), -np.cos(found[0])
        first = (at(x, y), about_z(found[0] - start[0]))
        return bodies(first, (at(x + np.sin(found[1]), y - np.cos(found[1])), about_z(found[1] - start[1])))

    one, two = ([float(np.sin(a)), float(-np.cos(a)), 0.0] for a in start)
    both = {'a': (1.0, one), 'b': (ratio, [p + q for p, q in zip(one, two, strict=True)])}
    mechanism = {
        'gravity': [0, -MODEL_GRAVITY, 0],
        'bodies': {name: {'mass': m, 'inertia': [square * m] * 3, 'position': p} for name, (m, p) in both.items()},
        'joints': {
            'one': {'kind': 'revolute', 'i': 'world', 'j': 'a', 'at': [0, 0, 0], 'axis': [0, 0, 1]},
            'two': {'kind': 'revolute', 'i': 'a', 'j': 'b', 'at': one, 'axis': [0, 0, 1]},
        },
    }
    return Problem(scene_of(mechanism), exact)


@cache
def oscillator(stiffness: float = 1e3, damping: float = 0.0) -> Problem:
    """1 kg on a guide, let go 0.1 m from where its spring [N/m] is free; damping: as a part of critical."""
    w0 = np.sqrt(stiffness)
    d = damping * w0

    def exact() -> np.ndarray:
        t = TIMES
        if damping < 1.0:
            w = np.sqrt(w0**2 - d**2)
            x = np.exp(-d * t) * (np.cos(w * t) + d / w * np.sin(w * t))
        elif damping == 1.0:
            x = np.exp(-d * t) * (1 + d * t)
        else:
            fast = d + np.sqrt(d**2 - w0**2)
            slow = w0**2 / fast  # the other root, without cancellation
            x = (fast * np.exp(-slow * t) - slow * np.exp(-fast * t)) / (fast - slow)
        return bodies((at(0.1 * x), np.tile([0.0, 0, 0, 1], (len(t), 1))))

    guide = {'body': 'world', 'at': [0, 0, 0], 'axis': [1, 0, 0]}
    mechanism = {
        'gravity': [0, 0, 0],
        'bodies': {'mass': {'mass': 1, 'inertia': [0.01, 0.01, 0.01], 'position': [0.1, 0, 0]}},
        'joints': {'guide': {'kind': 'prismatic', 'i': guide, 'j': {**guide, 'body': 'mass', 'at': [0.1, 0, 0]}}},
        'coordinate_forces': {'spring': {'terms': [['guide', 1.0]], 'spring': stiffness, 'damper': 2.0 * d}},
    }
    return Problem(scene_of(mechanism), exact)


@cache
def top(spin: float = 10.0) -> Problem:
    """A free disc that spins [rad/s] about its axis and tumbles with 1 rad/s: steady precession about its angular
    momentum."""
    one, three, tumble = 0.01, 0.018, 1.0
    momentum = np.array([one * tumble, 0.0, three * spin])

    def exact() -> np.ndarray:
        from scipy.spatial.transform import Rotation

        precession = Rotation.from_rotvec(np.outer(TIMES, momentum / one))
        own = Rotation.from_rotvec(np.outer(TIMES, [0.0, 0.0, (1 - three / one) * spin]))
        return bodies((at(0.0), (precession * own).as_quat()))

    body = {'mass': 1, 'inertia': [one, one, three], 'angular_velocity': [tumble, 0, spin]}
    return Problem(scene_of({'gravity': [0, 0, 0], 'bodies': {'disc': body}}), exact)


@cache
def governor(stiffness: float = 1.0) -> Problem:
    """The flyball governor with springs and dampers that are `stiffness` times as stiff."""
    parts = [f'mechanism.spring_dampers.spring_{side}' for side in ('left', 'right')]
    changes = [f'{p}.{key}={value * stiffness!r}' for p in parts for key, value in (('spring', 8e5), ('damper', 4e4))]
    made = dataclasses.replace(load_scene('flyball_governor', changes), duration=DURATION)

    def scene(**settings: Any) -> Scene:
        return dataclasses.replace(made, integrator=IntegratorSettings(**settings))

    @cache
    def motions() -> list[np.ndarray]:
        start = Simulation(scene(h=START))
        return [reference(start, DURATION, tolerance, 'reference_radau')[0] for tolerance in (1e-9, 1e-6)]

    def exact() -> np.ndarray:
        y = motions()[0].copy()
        y[..., 3:] /= 2.0
        return np.concatenate([y, np.tile([0.0, 0, 0, 0, 0, 0, 1], (len(y), 1, 1))], axis=1)

    return Problem(scene, exact, lambda: difference(*motions()))


@cache
def moved(inner: Callable[[], Problem], distance: float) -> Problem:
    """A problem at a distance [m] from the origin."""
    d = distance * np.array([0.6, -0.64, 0.48])

    def marker(m: Marker) -> Marker:
        return dataclasses.replace(m, position=tuple(m.position + d)) if m.body == WORLD else m

    def placed(spec: Any) -> Any:
        given = {f.name: getattr(spec, f.name) for f in dataclasses.fields(spec)}
        return spec.replace(**{name: marker(value) for name, value in given.items() if isinstance(value, Marker)})

    def shifted(model: ModelSpec) -> ModelSpec:
        changes: dict[str, Any] = {
            name: tuple(map(placed, specs)) for name, specs in model.sections().items() if name != 'bodies'
        }
        changes['bodies'] = tuple(body.replace(position=tuple(body.position + d)) for body in model.bodies)
        return dataclasses.replace(model, **changes)

    def scene(**settings: Any) -> Scene:
        there = inner().scene(**settings)
        return dataclasses.replace(there, model=shifted(there.model))

    def exact() -> np.ndarray:
        q = inner().exact().copy()
        q[:, :-1, :3] += d
        return q

    return Problem(scene, exact)


# -- maps ------------------------------------------------------------------------------------------------------------


class Line(NamedTuple):
    """A problem over the abscissae of its map: `steps`, or `settings` at one step. rounding: what positions are rounded
    by [m]."""

    problem: Callable[[], Problem]
    ordinate: float
    settings: Mapping[str, Any] = MappingProxyType({})
    rounding: float = 0.0


class Map(NamedTuple):
    """A map of panels of lines. abscissa and ordinate: labels with units; logarithmic: the ordinate is (0 apart, as the
    first value)."""

    title: str
    ordinate: str
    panels: dict[str, list[Line]]


RHO = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 1.0)
STIFFNESS = tuple(10.0**k for k in range(-3, 7))
RATIOS = tuple(10.0**k for k in range(-12, 13, 2))
DAMPING = (0.0, 1e-3, 1e-2, 0.1, 1.0, 10.0, 1e2, 1e3, 1e4)
SPINS = (1.0, 10.0, 30.0, 100.0, 300.0, 1e3, 3e3, 1e4)
DISTANCES = (0.0, 1.0, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7)
ITERATIONS = tuple(range(1, 11))
PENALTIES = tuple(10.0**k for k in range(1, 14))


def _every(values: Sequence[float], quick: bool, few: int = 3) -> Sequence[float]:
    """All values, or a few of them, the ends among them."""
    return [values[k] for k in np.unique(np.linspace(0, len(values) - 1, few).round().astype(int))] if quick else values


def maps(quick: bool) -> dict[str, Map]:
    """All maps over the step."""
    three = {'slider-crank': slider_crank, 'double pendulum': pendulum, 'oscillator, 5 Hz': oscillator}
    return {
        'step_rho': Map(
            'spectral radius rho_inf', 'rho_inf',
            {n: [Line(p, r, {'rho_inf': r}) for r in _every(RHO, quick)] for n, p in three.items()}
        ),
        'step_stiffness': Map(
            'stiffness', 'times as stiff',
            {
                'oscillator, 1 kg on 1 kN/m': [Line(partial(oscillator, 1e3 * x), x) for x in _every(STIFFNESS, quick)],
                'flyball governor': [Line(partial(governor, x), x) for x in _every(STIFFNESS[:7], quick)],
            },
        ),
        'step_mass_ratio': Map(
            'mass ratio', 'second mass / first', {'double '
                'pendulum': [Line(partial(pendulum, r), r) for r in _every(RATIOS, quick)]}
        ),
        'step_damping': Map(
            'damping', 'of critical',
            {
                'oscillator, 5 Hz': [Line(partial(oscillator, 1e3, x), x) for x in _every(DAMPING, quick)],
                'oscillator, 500 Hz': [Line(partial(oscillator, 1e7, x), x) for x in _every(DAMPING, quick)],
            },
        ),
        'step_spin': Map('spin', 'spin [rad/s]', {'free '
            'disc': [Line(partial(top, w), w) for w in _every(SPINS, quick)]}),
        'step_distance': Map(
            'distance from the origin', 'distance [m]',
            {n: [Line(partial(moved, p, x), x, {}, EPS * x) for x in _every(DISTANCES, quick)] for n,
            p in list(three.items())[:2]},
        ),
    }  # fmt: skip


def run_line(line: Line, steps: Sequence[float]) -> dict[str, Any]:
    """The runs of a line over the step, judged by each other."""
    problem = line.problem()
    try:
        exact, spread = measured(problem.exact()), problem.spread()
    except StepError:  # nothing resolves the motion
        exact, spread = None, np.nan
    found = []
    for h in steps:
        found.append((h, *run(problem.scene(h=h, **line.settings), exact, SAMPLE)))
    moving = 1.0 if exact is None else max(1.0, float(np.abs(exact - exact[0]).max()))
    runs = []
    for k, h in enumerate(steps):
        # A step rounds places, by which a velocity is off from then on: as many kicks as steps, which walk at random.
        walked = line.rounding * (DURATION / h) ** 1.5
        runs.append(compare(found, exact, spread, max(moving, walked / RESOLVED))[k])
    return {'runs': [dataclasses.asdict(r) for r in runs]}


def run_grid(problem: Problem, h: float, iterations: Sequence[int], penalties: Sequence[float]) -> dict[str, Any]:
    """Runs at one step over iterations and penalty, judged by what the default is off by at five steps."""
    exact = measured(problem.exact())
    known = []
    for step in (10e-3, 5e-3, 2e-3, 1e-3, 0.5e-3):
        status, _, error, taken = run(problem.scene(h=step), exact, SAMPLE)
        if status == 'ok':
            known.append(error / unseen(exact, taken))
    rows = []
    for count in iterations:
        for penalty in penalties:
            found = (h, *run(problem.scene(h=h, mode='fixed', iterations=count, penalty=penalty), exact, SAMPLE))
            (judged,) = compare([found], exact, problem.spread(), 1.0, known)
            rows.append({'iterations': count, 'penalty': penalty, **dataclasses.asdict(judged)})
    return {'runs': rows}
