"""The first step: stiff elements relax in it, motions that are prescribed move from the first instant on, and it costs
no order."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from mbd_sim_ros.lab.mechanisms.families import draw
from solver import simulation_of
from solver.files.scene import load_scene_text
from solver.simulation import Simulation

STIFF = """
mechanism:
  gravity: [0, 0, 0]
  bodies: {{b: {{mass: 1, inertia: [1, 1, 1], position: [0, 0, 1.1]}}}}
  joints: {{p: {{kind: prismatic, i: world, j: b}}}}
  spring_dampers:
    s: {{i: {{body: world, position: [0, 0, 0]}}, j: b, free_length: 1.0, spring: 1.0e9, damper: {damper}}}
integrator: {{h: 1.0e-3, rho_inf: {rho}}}
"""


def path(text: str, steps: int) -> np.ndarray:
    s = simulation_of(load_scene_text(text))
    return np.array([s.advance(1).pose[0, 2] for _ in range(steps)])


@pytest.mark.parametrize('rho', [0.0, 0.5, 0.8])
def test_an_overdamped_spring_creeps(rho: float) -> None:
    """1e9 N/m and 3.16e10 N s/m: z = 1 + 0.1 e^(-t/31.6 s). Before, the first step went 0.5 m, with rho_inf = 0 17 m,
    past the end."""
    z = path(STIFF.format(damper=3.16e10, rho=rho), 100)
    exact = 1.0 + 0.1 * np.exp(-np.arange(1, 101) * 1e-3 / 31.6)
    np.testing.assert_allclose(z, exact, rtol=0, atol=1e-5)


@pytest.mark.parametrize('damper', [0.0, 1e5])
def test_a_stiff_spring_is_not_thrown_through_its_anchor(damper: float) -> None:
    """31 rad in a step cannot be resolved; with rho_inf = 0 they die out at once, on the side of the anchor where the
    body is.

    Between two points there is a second equilibrium beyond the anchor. The acceleration of the first instant, 1e8
    m/s^2, predicted a first step of 50 m, and Newton's iteration then found that one: the body was at -1 m.
    """
    z = path(STIFF.format(damper=damper, rho=0.0), 50)
    assert np.abs(z - 1.0).max() < 0.02  # of 0.1 m
    assert abs(z[-1] - 1.0) < 1e-8


CART = """
mechanism:
  bodies:
    cart: {{mass: 1, inertia: [1, 1, 1]}}
    bob: {{mass: 1, inertia: [0.01, 0.01, 0.01], com: [0, 0, -1]}}
  joints:
    rail: {{kind: prismatic, i: world, j: cart, at: [0, 0, 0], axis: [1, 0, 0]}}
    pivot: {{kind: revolute, i: cart, j: bob, at: [0, 0, 0], axis: [0, 1, 0]}}
  couplers: {{motor: {{terms: {{rail: 1}}, input: motor}}}}
maneuver: {{signals: {{motor: {signal}}}}}
integrator: {{h: {h}, mode: tolerance, tolerance: 1.0e-12}}
"""
MOVING = {
    'ramp': '{kind: ramp, slope: 2, start: 0, blend: 0}',
    'sine': '{kind: sine, amplitude: 0.3, frequency: 1, start: 0, blend: 0}',
}


def driven(signal: str, h: float) -> Simulation:
    return simulation_of(load_scene_text(CART.format(signal=signal, h=h)))


@pytest.mark.parametrize('name', MOVING)
def test_a_motion_that_begins_at_the_start_moves_at_once(name: str) -> None:
    """Its rate at t = 0 is the one just after; before, it was zero, and the first step made up for it."""
    rate = {'ramp': 2.0, 'sine': 0.6 * np.pi}[name]
    s = driven(MOVING[name], 1e-3)
    assert s.snapshot().joint_velocity[0] == pytest.approx(rate, rel=1e-12)
    assert s.snapshot().joint_position[0] == 0.0


@pytest.mark.parametrize('name', MOVING)
def test_it_is_of_second_order_from_there_on(name: str) -> None:
    """The pendulum hanging from the cart at 0.4 s: differences at 8, 4, 2 ms fall by four (slope 2 +- 0.15)."""
    end = [driven(MOVING[name], h).advance(round(0.4 / h)).joint_position[1] for h in (8e-3, 4e-3, 2e-3)]
    assert np.log2((end[0] - end[1]) / (end[1] - end[2])) == pytest.approx(2.0, abs=0.15)


@pytest.mark.parametrize(('number', 'h'), [(40, 1e-3), (5000001, 5e-4)])
def test_redundant_rows_start_without_multipliers_that_balance_each_other(number: int, h: float) -> None:
    """The same rows twice, and bodies so light that augmentations are combined: rounding was taken for a part of the
    solution, and balanced multipliers of 1e8 N moved the bodies as soon as they turned (40: 24 kg weigh 235 N). In
    5000001 those of 4400 N came with a step of 0.5 ms only, from where constraints were open beside the start, and the
    run was off by 0.03 m, ok, where 1 ms is right to 4e-4 m.
    """
    s = Simulation(draw('duplicates', number).at(0.5, h=h))
    weight = s.model.tables.bodies.mass.sum() * 9.81
    assert np.abs(s.state.lam).max() < 10.0 * weight


def test_redundant_rows_start_with_second_order_whatever_the_step() -> None:
    """Places after 0.05 s with 1, 0.5 and 0.25 ms: differences fall by four. Before, 0.5 ms was off by 80 times as
    much."""
    places = []
    for h in (1e-3, 5e-4, 2.5e-4):
        places.append(Simulation(draw('duplicates', 5000001).at(0.5, h=h)).advance(round(0.05 / h)).pose)
    coarse, fine = (np.abs(a - b).max() for a, b in itertools.pairwise(places))
    assert np.log2(coarse / fine) == pytest.approx(2.0, abs=0.15)
