"""Energy: conserved without dissipation, removed from unresolved oscillations only, at the rate that rho_inf says."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from closed_forms import falling_four_bar, pendulum, steady_top, torque_free_top
from convergence import scene_of

from solver.files.scene import load_scene_text
from solver.simulation import Simulation

CONSERVING = {'rho_inf': 1.0, 'mode': 'tolerance', 'tolerance': 1e-13}


def energy_band(simulation: Simulation, duration: float) -> float:
    """Largest error of the energy balance [J] over the next `duration` s, sampled every third step."""
    worst = 0.0
    for _ in range(round(duration / simulation.h / 3)):
        simulation.advance(3)
        audit = simulation.last_step.account
        worst = max(worst, abs(audit.energy[0] - audit.reference[0] + audit.work[0]))
    return worst


@pytest.mark.parametrize(('problem', 'h'), [(pendulum(), 4e-3), (falling_four_bar(0.1), 4e-3), (steady_top(), 2e-3)])
def test_energy_error_does_not_grow_without_dissipation(problem, h):
    """rho_inf = 1: the band of the last quarter of 40 s is that of the first, to 20 %."""
    simulation = Simulation(scene_of(problem, h=h, **CONSERVING))
    bands = [energy_band(simulation, 10.0) for _ in range(4)]
    assert 0 < bands[-1] < 1.2 * bands[0]


def test_energy_error_falls_with_the_square_of_the_step():
    """Four-bar, rho_inf = 1: slope 2 +- 0.3 between steps of 2 and 0.5 ms (the pendulum alone does better)."""
    bands = [energy_band(Simulation(scene_of(falling_four_bar(0.1), h=h, **CONSERVING)), 2.0) for h in (2e-3, 5e-4)]
    assert np.log(bands[0] / bands[1]) / np.log(4) == pytest.approx(2.0, abs=0.3)


def test_energy_of_a_free_body_is_conserved_to_rounding():
    """Without constraints rho_inf = 1 is the midpoint rule in w, which conserves the quadratic energy exactly."""
    simulation = Simulation(scene_of(torque_free_top(), h=1e-2, **CONSERVING))
    assert energy_band(simulation, 20.0) < 1e-13 * simulation.last_step.account.energy[0]


STIFF = """
mechanism:
  gravity: [0, 0, 0]
  bodies:
    mass: {mass: 1, inertia: [0.01, 0.01, 0.01], position: [0, 0, -1]}
  joints:
    guide: {kind: prismatic, i: world, j: mass, at: [0, 0, -1], axis: [0, 0, 1]}
  spring_dampers:
    spring: {i: world, j: mass, free_length: 0.999999, spring: 1.0e10}
"""


def oscillation(rho_inf: float) -> Simulation:
    """A resting mass released 1 um from the free length of a spring whose natural frequency is 100 / h."""
    scene = load_scene_text(STIFF)
    return Simulation(
        dataclasses.replace(scene, integrator=dataclasses.replace(scene.integrator, h=1e-3, rho_inf=rho_inf))
    )


def test_unresolved_oscillation_keeps_its_energy_without_dissipation():
    simulation = oscillation(1.0)
    start = simulation.last_step.account.energy[0]
    simulation.advance(1000)
    assert simulation.last_step.account.energy[0] == pytest.approx(start, rel=1e-7)


@pytest.mark.parametrize('rho_inf', [0.9, 0.8, 0.5])
def test_unresolved_oscillation_decays_by_rho_inf_per_step(rho_inf):
    """The scheme has three roots rho_inf there [Chung1993]: between rho_inf^n and n^2 rho_inf^n, from step 10 to 25."""
    simulation = oscillation(rho_inf)
    amplitude = []
    for steps in (10, 15):
        simulation.advance(steps)
        amplitude.append(np.sqrt(simulation.last_step.account.energy[0]))
    ratio = amplitude[1] / amplitude[0]
    assert 0.9 * rho_inf**15 < ratio < 1.1 * 2.5**2 * rho_inf**15


def test_unresolved_oscillation_disappears_at_rho_inf_zero():
    simulation = oscillation(0.0)
    start = simulation.last_step.account.energy[0]
    simulation.advance(10)
    assert simulation.last_step.account.energy[0] < 1e-20 * start
