"""Start velocities are the nearest to what is given that satisfy the constraints, down to rounding."""

from __future__ import annotations

import numpy as np
import pytest

from mbd_sim_ros.lab.mechanisms.families import draw
from solver.errors import ConsistencyError
from solver.files.scene import load_scene, load_scene_text
from solver.output.dependence import dense_jacobian
from solver.simulation import Simulation
from solver.start.newton import ConsistentState

EPS = float(np.finfo(float).eps)
FAMILIES = ('tree', 'plane_loop', 'duplicates', 'scissor', 'rope', 'crank', 'bennett', 'sarrus', 'drivers')


def nearest(given: np.ndarray, metric: np.ndarray, A: np.ndarray, phi_t: np.ndarray) -> tuple[np.ndarray, float]:
    """(the nearest velocity to one (nb, 6), in the metric (nb, 6, 6), with A v + phi_t = 0, smallest singular value of
    a constraint).

    By singular values of the constraints in coordinates in which the metric is one, rows of length one.
    """
    roots = np.linalg.cholesky(metric)
    n = 6 * len(metric)
    L = np.zeros((n, n))
    for b, root in enumerate(roots):
        L[6 * b : 6 * b + 6, 6 * b : 6 * b + 6] = root
    B = np.linalg.solve(L, A[:, :n].T).T
    lengths = np.linalg.norm(B, axis=1)
    U, S, V = np.linalg.svd(B / lengths[:, None], full_matrices=False)
    rank = int(np.count_nonzero(S / S[0] > 1e-9))
    U, S, V = U[:, :rank], S[:rank], V[:rank]
    x = L.T @ given.ravel()
    x = x - V.T @ (V @ x + U.T @ (phi_t / lengths) / S)
    return np.linalg.solve(L.T, x).reshape(-1, 6), float(S[-1])


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize('family', FAMILIES)
def test_start_velocities_are_exact_to_rounding(family: str, seed: int) -> None:
    """Velocities of about one that fit no constraint. Rounding is that of the residuals, divided by the smallest
    singular value of the constraints; with that of the penalized matrix, 1e6 times as large, velocities of ropes were
    off by 0.09."""
    simulation = Simulation(draw(family, seed).at(1.0, h=1e-3))
    start = ConsistentState(simulation.model)
    state = simulation.state._replace(v=simulation.state.v.copy())
    state.v[:-1] = np.random.default_rng(seed).normal(size=(simulation.model.n_bodies, 6))
    given = state.v[:-1].copy()
    start.project_velocity(state, simulation.inputs)
    wanted, smallest = nearest(given, start.metric, dense_jacobian(simulation.model, start.J), start.phi_t)
    np.testing.assert_allclose(state.v[:-1], wanted, rtol=0, atol=100 * EPS * np.abs(given).max() / smallest)


@pytest.mark.parametrize('seed', [1000000 + k for k in (9, 11, 18, 35, 42, 43, 55, 58, 60)])
def test_ropes_with_heavy_ends_start_too(seed: int) -> None:
    """Light links that carry up to a million times their mass: augmentations one by one gain nothing, and these were
    refused for rates that contradict each other. Constraints hold to rounding; the energy of the change, least at the
    nearest velocity, is so to a thousandth."""
    simulation = Simulation(draw('rope', seed).at(1.0, h=1e-3))
    start = ConsistentState(simulation.model)
    state = simulation.state._replace(v=simulation.state.v.copy())
    state.v[:-1] = np.random.default_rng(seed).normal(size=(simulation.model.n_bodies, 6))
    given = state.v[:-1].copy()
    start.project_velocity(state, simulation.inputs)
    A = dense_jacobian(simulation.model, start.J)
    wanted, _ = nearest(given, start.metric, A, start.phi_t)
    energies = [np.einsum('bi,bij,bj->', v - given, start.metric, v - given) for v in (state.v[:-1], wanted)]
    assert np.abs(A[:, : given.size] @ state.v[:-1].ravel() + start.phi_t).max() < 1e3 * EPS * np.abs(state.v).max()
    assert energies[0] < 1.001 * energies[1]


@pytest.mark.parametrize('loss', ['0', '1e-9'])
def test_light_parts_that_nothing_damps_start_rolling(loss: str) -> None:
    """Drop links of 7e-6 kg m^2 beside a strut whose mount does not damp: rounding of the usual penalties turned them
    without bounds.

    A mount that damps a little starts with the same velocities, to a thousandth of the speed: what is left of it rings
    longer.
    """
    starts = []
    for given in (loss, '1e-4'):
        car = [
            'vehicle=vehicles/compact_fwd.yaml',
            f'vehicle.axles.front.suspension.strut.mount.loss={given}',
            'start.speed_kmh=40',
        ]
        simulation = Simulation(load_scene('car_step_steer', car))
        starts.append(simulation.snapshot().twist[:, :3])
        assert np.isfinite(simulation.advance(50).numbers).all()
    np.testing.assert_allclose(starts[0], starts[1], rtol=0, atol=1e-3 * 40 / 3.6)


@pytest.mark.parametrize(
    ('family', 'number', 'h'),
    [('sarrus', 31, 1e-3), ('sarrus', 34, 2e-3), ('sarrus', 42, 1e-2), ('sarrus', 64, 5e-4), ('scissor', 13, 1e-2)],
)
def test_what_rests_where_nothing_weighs_has_no_rates_that_contradict_each_other(
    family: str, number: int, h: float
) -> None:
    """Redundant rows, no gravity, no velocities: rates of 1e-19 were measured by themselves, left 1e-25 of them open,
    and the start was refused. They are compared with what the first step brings."""
    simulation = Simulation(draw(family, number).at(0.5, h=h))
    brought = h * np.abs(simulation.state.a).max()
    assert brought > 0.0
    assert np.abs(simulation.state.v).max() <= 1e-3 * brought  # the part of the method is of order h^2


TWO = """
mechanism:
  gravity: {gravity}
  bodies: {{cart: {{mass: 1, inertia: [1, 1, 1]}}}}
  joints: {{rail: {{kind: prismatic, i: world, j: cart, at: [0, 0, 0], axis: [1, 0, 0]}}}}
  couplers: {{a: {{terms: {{rail: 1}}, input: a}}, b: {{terms: {{rail: 1}}, input: b}}}}
maneuver:
  signals:
    a: {{kind: ramp, slope: {slope}, start: 0, blend: 0}}
    b: {{kind: ramp, slope: {other}, start: 0, blend: 0}}
"""


@pytest.mark.parametrize('gravity', ['[0, 0, 0]', '[0, 0, -9.81]'])
def test_drivers_that_contradict_each_other_are_refused(gravity: str) -> None:
    """One rail, driven at 2 and at 1 m/s: the nearest velocity, 1.5 m/s, leaves 0.5 m/s of both."""
    with pytest.raises(ConsistencyError, match=r"'[ab].*' is violated by 0\.5; remove contradicting initial rates"):
        Simulation(load_scene_text(TWO.format(gravity=gravity, slope=2.0, other=1.0)))


def test_drivers_that_contradict_each_other_slowly_are_refused_where_nothing_weighs() -> None:
    """A millionth of that: nothing is faster there, so it is no rounding. Driven alike it starts."""
    with pytest.raises(ConsistencyError, match='remove contradicting initial rates'):
        Simulation(load_scene_text(TWO.format(gravity='[0, 0, 0]', slope=2e-6, other=1e-6)))
    simulation = Simulation(load_scene_text(TWO.format(gravity='[0, 0, 0]', slope=2e-6, other=2e-6)))
    assert simulation.state.v[0, 0] == pytest.approx(2e-6, rel=1e-12)
