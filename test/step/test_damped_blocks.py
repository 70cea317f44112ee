"""Blocks of the step matrix that no force can damp: nobody clears them and nobody looks at them."""

from __future__ import annotations

import numpy as np
import pytest

from solver import load_scene, simulation_of
from solver.simulation import Simulation


def run(scene: str, *, all_damped: bool = False, left: float = 0.0) -> tuple[Simulation, np.ndarray]:
    """(a simulation after a few hundred steps, its state); left: what the blocks between bodies hold at the
    beginning."""
    s = simulation_of(load_scene(scene, ['duration=1']))
    if all_damped:
        tables = s.model.tables
        tables.words[tables.type.field('damped')[1]] = s.model.n_slots + 1
    s.bodies.work.Kv[s.model.n_bodies + 1 :] = left
    s.advance(300)
    return s, np.concatenate([s.state.q.ravel(), s.state.v.ravel(), s.state.lam])


@pytest.mark.parametrize('scene', ['slider_crank', 'four_bar_n'])
def test_joints_alone_leave_them_out_with_the_same_bits(scene: str) -> None:
    """The blocks of bodies on themselves are needed, for gyroscopic forces; those between bodies may hold anything."""
    s, state = run(scene)
    assert s.model.tables.damped == s.model.n_bodies + 1 < s.model.n_slots + 1
    np.testing.assert_array_equal(state, run(scene, all_damped=True)[1])
    np.testing.assert_array_equal(state, run(scene, left=np.nan)[1])


def test_with_a_force_element_all_are_cleared() -> None:
    s, state = run('flyball_governor')
    assert s.model.tables.damped == s.model.n_slots + 1
    np.testing.assert_array_equal(state, run('flyball_governor', left=np.nan)[1])
