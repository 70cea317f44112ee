"""The slider-crank with equal rods passes its singular positions from any starting phase, at any step, damped and conserving.

Twenty-six constraints, three of them redundant; at theta = pi/2 + n pi a second branch (slider at rest, rods turning together) opens.
The reference is the one-coordinate equation of motion with the slider's mass, at tight tolerance. PHASES can be raised through the
environment (MBD_PHASES=200) for the full study.
"""

from __future__ import annotations

import dataclasses
import os

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from solver.lie.so3 import quaternion_exp
from solver.scene import CoordinateStart, Scene, Start, load_scene
from solver.simulation import Simulation

PHASES = int(os.environ.get('MBD_PHASES', '12'))
DURATION = 10.0
LARGEST_JUDGED = 0.01  # above it only the branch and the absence of failures are required [s]
G = 9.81
ENERGY = 13.603384190107  # of the massless slider at theta = pi/4 with 4 m/s [J]
CONSERVING = {'rho_inf': 1.0, 'penalty': 1e4, 'iterations': 3, 'mode': 'fixed', 'form': 'condensed'}
DAMPED = {'rho_inf': 0.9, 'penalty': 1e4, 'iterations': 3, 'mode': 'fixed', 'form': 'condensed'}
TOLERANCE = {'rho_inf': 0.9, 'mode': 'tolerance', 'form': 'condensed'}


def inertia(theta: np.ndarray, slider: float) -> np.ndarray:
    """Generalized inertia of the crank angle [kg m^2]."""
    return 2 / 3 + (2 + 4 * slider) * np.sin(theta) ** 2


def crank_angle(theta: float, rate: float, slider: float) -> float:
    """Crank angle after DURATION from the equation of motion of one coordinate."""

    def motion(_t: float, y: np.ndarray) -> list[float]:
        half_slope = (2 + 4 * slider) * np.sin(y[0]) * np.cos(y[0])
        return [y[1], (-half_slope * y[1] ** 2 - G * np.cos(y[0])) / inertia(y[0], slider)]

    return float(solve_ivp(motion, (0, DURATION), [theta, rate], method='DOP853', rtol=1e-12, atol=1e-12).y[0, -1])


def scene_at(theta: float, h: float, settings: dict) -> tuple[Scene, float, float]:
    """(scene started at crank angle theta with the energy above, crank rate, slider mass)."""
    scene = load_scene('slider_crank')
    body = {b.name: b for b in scene.model.bodies}
    slider = body['slider'].mass
    rate = float(np.sqrt(2 * (ENERGY - G * np.sin(theta)) / inertia(theta, slider)))
    turned = (
        body['ground'],
        body['crank'].replace(orientation=quaternion_exp((0.0, 0.0, theta))),
        body['rod'].replace(position=(np.cos(theta), np.sin(theta), 0.0), orientation=quaternion_exp((0.0, 0.0, -theta))),
        body['slider'].replace(position=(2 * np.cos(theta), 0.0, 0.0)),
    )
    scene = dataclasses.replace(
        scene,
        model=dataclasses.replace(scene.model, bodies=turned),
        start=Start(coordinates={'crank': CoordinateStart(rate=rate)}),
        integrator=dataclasses.replace(scene.integrator, h=h, **settings),
    )
    return scene, rate, slider


def limit(at_ten: float, at_one: float, h: float) -> float:
    """Allowed error at step h: the two stated values joined by their power law, so second order holds in between."""
    order = np.log(at_ten / at_one) / np.log(10.0)
    return at_ten * (h / 0.01) ** order


@pytest.mark.parametrize(('settings', 'energy', 'position'), [
    pytest.param(CONSERVING, (1e-2, 5e-5), (1.5e-2, 1.5e-4), id='conserving'),
    pytest.param(DAMPED, (1e-1, 1e-3), (4e-2, 4e-4), id='damped'),
    pytest.param(TOLERANCE, (1e-1, 1e-3), (4e-2, 4e-4), id='tolerance'),
])  # fmt: skip
@pytest.mark.parametrize('h', [0.02, 0.01, 0.005, 0.002, 0.001])
def test_every_phase_passes_every_singular_position_on_its_branch(h: float, settings: dict, energy: tuple, position: tuple) -> None:
    rng = np.random.default_rng(20260101)
    for theta in rng.uniform(0.0, 2 * np.pi, PHASES):
        scene, rate, slider = scene_at(theta, h, settings)
        simulation = Simulation(scene)
        start = simulation.snapshot().joint_position
        snapshot = simulation.advance(round(DURATION / h))
        turn = snapshot.joint_position - start
        crank, knee = turn[0], turn[1]
        assert abs(2 * crank + knee) < 1e-2, f'left its branch from theta = {theta:.6f}'
        if h > LARGEST_JUDGED:
            continue
        x = snapshot.pose[3, 0]
        exact = 2 * np.cos(crank_angle(theta, rate, slider))
        assert abs(x - exact) < limit(*position, h), f'slider at {x:.6f} instead of {exact:.6f} from theta = {theta:.6f}'
        assert simulation.audit()['energy_error_max'] < limit(*energy, h), f'energy from theta = {theta:.6f}'
