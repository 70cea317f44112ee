"""The slider-crank with equal rods through its singular positions: starts at any phase, exact motion, limits, and one
judged run.

Twenty-six constraints, three of them redundant; at theta = pi/2 + n pi a second branch (slider at rest, rods turning
together) opens. All starts have the energy of the chapter's. The exact motion is that of one coordinate, with the
slider's mass: (2/3 + (2 + 4 m) sin^2 theta) theta'^2 / 2 + g sin theta = E.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from solver import simulation_of
from solver.compiled.so3 import quaternion_exp
from solver.errors import ConsistencyError, StepError
from solver.files.scene import load_scene
from solver.output.dependence import dense_jacobian
from solver.scene import Scene, StartSettings
from solver.simulation import Simulation
from solver.units import MODEL_GRAVITY

ENERGY = 13.603384190107  # of the massless slider at theta = pi/4 with 4 m/s [J]
SEED = 20260101
STEPS = (0.02, 0.01, 0.005, 0.002, 0.001)  # s
DURATION = 10.0  # s
LARGEST_JUDGED = 0.01  # s; above it only the branch and the absence of failures are required
LOOK_EVERY = 0.5  # s, at the branch
ON_BRANCH = 1e-2  # rad
BODIES = ('ground', 'crank', 'rod', 'slider')

# The defaults damp. Without damping the penalty has to be small enough for the step: docs/decisions/0004.
DAMPED: dict[str, Any] = {}
CONSERVING: dict[str, Any] = {'rho_inf': 1.0, 'penalty': 1e4}


class Limits(NamedTuple):
    """Largest allowed errors after DURATION, at 10 ms and at 1 ms."""

    energy: tuple[float, float]  # J
    position: tuple[float, float]  # m, of the slider


LIMITS = {'damped': Limits((1e-1, 1e-3), (4e-2, 4e-4)), 'conserving': Limits((1e-2, 5e-5), (1.5e-2, 1.5e-4))}


def limit(at_ten_and_one: tuple[float, float], h: float) -> float:
    """Allowed error at step h [s]: the two stated values joined by their power law, so second order holds in
    between."""
    at_ten, at_one = at_ten_and_one
    return at_ten * (h / 0.01) ** np.log10(at_ten / at_one)


def phases(count: int) -> np.ndarray:
    """(count,) starting angles theta [rad], uniform, the same for every call."""
    return np.random.default_rng(SEED).uniform(0.0, 2 * np.pi, count)


def inertia(theta: Any, slider: float) -> Any:
    """Generalized inertia of the crank angle [kg m^2] for a slider of this mass [kg]."""
    return 2 / 3 + (2 + 4 * slider) * np.sin(theta) ** 2


def crank_rate(theta: Any, slider: float) -> Any:
    """Crank rate [rad/s] at angle theta with ENERGY."""
    return np.sqrt(2 * (ENERGY - MODEL_GRAVITY * np.sin(theta)) / inertia(theta, slider))


def exact_angles(theta: np.ndarray, slider: float, times: np.ndarray, tolerance: float = 1e-12) -> np.ndarray:
    """(n, len(times)) crank angles [rad] of n starts at theta with ENERGY, all integrated together to a tolerance."""

    def motion(_t: float, y: np.ndarray) -> np.ndarray:
        angle, rate = y.reshape(2, -1)
        half_slope = (2 + 4 * slider) * np.sin(angle) * np.cos(angle)
        return np.concatenate([rate, (-half_slope * rate**2 - MODEL_GRAVITY * np.cos(angle)) / inertia(angle, slider)])

    start = np.concatenate([theta, crank_rate(theta, slider)])
    found = solve_ivp(motion, (0.0, times[-1]), start, method='DOP853', rtol=tolerance, atol=tolerance, t_eval=times)
    return found.y[: len(theta)]


def scene_at(theta: float, h: float, settings: dict[str, Any]) -> Scene:
    """The scene slider_crank started at crank angle theta [rad] with ENERGY, with step h [s] and these integrator
    settings.

    Keys that `settings` leave open take the defaults of IntegratorSettings, not the values of the scene.
    """
    scene = load_scene('slider_crank')
    ground, crank, rod, slider = (next(b for b in scene.model.bodies if b.name == name) for name in BODIES)
    rate = float(crank_rate(theta, slider.mass))
    cos, sin = float(np.cos(theta)), float(np.sin(theta))
    # All velocities are given: beside a singular position one rate alone does not determine the others accurately.
    turned = (
        ground,
        crank.replace(orientation=quaternion_exp((0.0, 0.0, theta)), angular_velocity=(0.0, 0.0, rate)),
        rod.replace(
            position=(cos, sin, 0.0),
            orientation=quaternion_exp((0.0, 0.0, -theta)),
            velocity=(-sin * rate, cos * rate, 0.0),
            angular_velocity=(0.0, 0.0, -rate),
        ),
        slider.replace(position=(2 * cos, 0.0, 0.0), velocity=(-2 * sin * rate, 0.0, 0.0)),
    )
    return dataclasses.replace(
        scene,
        model=dataclasses.replace(scene.model, bodies=turned),
        start=StartSettings(),
        integrator=type(scene.integrator)(h=h, **settings),
    )


def slider_mass() -> float:
    """Mass of the slider in the scene [kg]."""
    return next(b.mass for b in load_scene('slider_crank').model.bodies if b.name == 'slider')


def jacobian(theta: float) -> tuple[np.ndarray, np.ndarray]:
    """(A (nc, n), M (n, n)) at a crank angle on the right branch."""
    simulation = Simulation(scene_at(theta, 1e-3, {}))
    bodies = simulation.model.tables.bodies
    n = simulation.model.n_bodies
    M = np.zeros((6 * n, 6 * n))
    for b in range(n):
        M[6 * b : 6 * b + 3, 6 * b : 6 * b + 3] = bodies.mass[b] * np.eye(3)
        M[6 * b + 3 : 6 * b + 6, 6 * b + 3 : 6 * b + 6] = bodies.inertia[b]
    return dense_jacobian(simulation.model, simulation.last_step.J), M


class Passage(NamedTuple):
    """One run of DURATION, judged. Errors are nan unless outcome is 'ok'."""

    outcome: str  # 'ok', 'wrong branch', or 'failed'
    until: float  # s
    energy_error: float  # largest error of the energy balance [J]
    position_error: float  # of the slider at the end [m]
    iterations: float  # per step
    message: str  # of a failure


def passage(theta: float, angle: float, h: float, settings: dict[str, Any], duration: float = DURATION) -> Passage:
    """Run from crank angle theta; `angle` is the exact one after the duration [rad]."""
    try:
        simulation = simulation_of(scene_at(theta, h, settings))
    except ConsistencyError as error:
        return Passage('failed', 0.0, np.nan, np.nan, 0.0, str(error))
    start = simulation.snapshot().joint_position
    look, steps = max(1, round(LOOK_EVERY / h)), round(duration / h)
    try:
        while simulation.k < steps:
            snapshot = simulation.advance(min(look, steps - simulation.k))
            turn = snapshot.joint_position - start
            if not abs(2 * turn[0] + turn[1]) < ON_BRANCH:  # knee = -2 crank on the right branch
                return Passage('wrong branch', simulation.t_ns * 1e-9, np.nan, np.nan, _iterations(simulation), '')
    except StepError as error:
        return Passage('failed', simulation.t_ns * 1e-9, np.nan, np.nan, _iterations(simulation), str(error))
    position = abs(snapshot.pose[3, 0] - 2 * np.cos(angle))
    return Passage(
        'ok', duration, simulation.totals()['energy_error_max'], float(position), _iterations(simulation), ''
    )


def _iterations(simulation: Simulation) -> float:
    return simulation.totals()['iterations'] / max(1, simulation.k)
