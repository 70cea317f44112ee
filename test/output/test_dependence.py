"""Reactions are unique or said not to be, by the name of the constraint."""

from __future__ import annotations

import json

import numpy as np
import pytest

from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.commands.main import main
from solver import simulation_of
from solver.files.scene import load_scene, load_scene_text
from solver.output.dependence import (
    RANK_TOLERANCE,
    dense_jacobian,
    dependence,
    scaled_blocks,
    scaled_jacobian,
    tied_groups,
)
from solver.simulation import Simulation


def rows(simulation: Simulation) -> tuple[set[str], set[str]]:
    """Names of the rows whose reactions are (unique, not unique)."""
    shared = set(simulation.describe()['reactions_not_unique'])
    return set(simulation.model.row_names) - shared, shared


def test_planar_slider_crank_in_space_has_unique_forces_in_its_plane_only():
    """26 constraints, 3 redundant: forces out of the plane and moments about axes in it are shared around the loop, in
    all its joints."""
    s = simulation_of(load_scene('slider_crank'))
    assert s.describe()['redundant_constraints'] == 3
    unique, shared = rows(s)
    assert shared == {f'{joint}/{row}' for joint in ('crank', 'knee', 'pin') for row in ('z', 'xz', 'yz')} | {
        'slide/y',
        'slide/xy',
        'slide/yz',
    }
    assert {f'base/{row}' for row in ('x', 'y', 'z', 'xy', 'xz', 'yz')} < unique


def test_no_reaction_of_bricards_mechanism_is_unique():
    """One redundant constraint, in which all thirty rows have a part."""
    unique, shared = rows(simulation_of(load_scene('bricard')))
    assert (len(unique), len(shared)) == (0, 30)


def test_reactions_of_linked_four_bars_are_unique_in_their_plane():
    """N loops: 3 N redundant; of each of the 3 N + 1 hinges the two forces in the plane are unique."""
    s = simulation_of(load_scene('four_bar_n', ['mechanism.loops=5']))
    unique, shared = rows(s)
    assert unique == {f'{joint.name}/{row}' for joint in s.scene.model.joints for row in 'xy'}
    assert len(shared) == 3 * (3 * 5 + 1)


@pytest.mark.parametrize('name', ['double_pendulum', 'flyball_governor', 'spinning_top', 'rolling_disc', 'knife_edge'])
def test_without_redundancy_every_reaction_is_unique(name):
    s = simulation_of(load_scene(name))
    assert s.describe()['redundant_constraints'] == 0
    assert not rows(s)[1]


@pytest.mark.parametrize('name', ['slider_crank', 'bricard', 'four_bar'])
def test_multipliers_that_balance_each_other_change_no_motion_and_no_unique_reaction(name):
    """Started with 100 N of every self-equilibrated set of multipliers more: same motion, other reactions in just the
    rows named."""
    settings = [
        'integrator.mode=tolerance',
        'integrator.tolerance=1e-11',
        'integrator.form=condensed',
        'integrator.h=1e-3',
    ]
    plain, loaded = (simulation_of(load_scene(name, settings)) for _ in range(2))
    left, size, _ = np.linalg.svd(dense_jacobian(loaded.model, loaded.last_step.J))
    null = left[:, (size > 1e-9).sum() :]
    for lam in (loaded.state.lam, loaded.state.lam_before):
        lam += 100.0 * null.sum(axis=1)
    shared = np.array([row in plain.describe()['reactions_not_unique'] for row in plain.model.row_names])
    a, b = plain.advance(5), loaded.advance(5)
    np.testing.assert_allclose(b.pose, a.pose, rtol=0, atol=1e-9)
    np.testing.assert_allclose(b.reactions[~shared], a.reactions[~shared], rtol=0, atol=1e-4)
    assert np.abs(b.reactions[shared] - a.reactions[shared]).max() > 10.0


TREE = """
mechanism:
  bodies:
    crank: {mass: 1, inertia: [1, 2, 3], position: [0, 0.5, 0]}
    rod: {mass: 1, inertia: [1, 2, 3], position: [0.5, 1, 0]}
    lever: {mass: 1, inertia: [1, 2, 3], position: [1, 0.5, 0]}
    arm: {mass: 1, inertia: [1, 2, 3], position: [2, 1, 0]}
    bob: {mass: 1, inertia: [1, 2, 3], position: [3, 1, 0]}
    swing: {mass: 1, inertia: [1, 2, 3], position: [0, -1, 0]}
  joints:
    a: {kind: revolute, i: world, j: crank, at: [0, 0, 0]}
    b: {kind: revolute, i: crank, j: rod, at: [0, 1, 0]}
    c: {kind: revolute, i: rod, j: lever, at: [1, 1, 0]}
    d: {kind: revolute, i: lever, j: world, at: [1, 0, 0]}
    shoulder: {kind: universal, i: lever, j: arm, at: [1, 1, 0]}
    wrist: {kind: spherical, i: arm, j: bob, at: [2, 1, 0]}
    rope: {kind: distance, i: {body: world, at: [0, 0, 0]}, j: {body: swing, at: [0, -1, 0]}}
    double: {kind: distance, i: {body: world, at: [0, 0, 0]}, j: {body: swing, at: [0, -1, 0]}}
  contacts:
    blade: {kind: knife_edge, i: world, j: bob}
"""


@pytest.mark.parametrize(
    'name', ['tree', 'andrews', 'bricard', 'four_bar', 'flyball_governor', 'rolling_disc', 'chain', 'torque_free_top']
)
def test_rank_and_reactions_are_those_of_all_rows_together(name):
    """Open chains are taken off before the rank is found; every decision is that of the singular values of the whole
    Jacobian."""
    s = simulation_of(load_scene_text(TREE) if name == 'tree' else load_scene(name))
    found = dependence(s.model, s.last_step.J)
    A, holonomic = scaled_jacobian(s.model, s.last_step.J), s.model.tables.constraints.holonomic == 1
    left, size, _ = np.linalg.svd(A)
    rank = int((size > RANK_TOLERANCE).sum())
    assert found.rank == rank
    assert found.position_rank == np.linalg.matrix_rank(A[holonomic], RANK_TOLERANCE)
    np.testing.assert_array_equal(found.unique, np.abs(left[:, rank:]).max(axis=1, initial=0.0) < RANK_TOLERANCE)
    assert len(found.redundant) == s.model.n_rows - rank
    assert np.linalg.matrix_rank(np.delete(A, found.redundant, axis=0), RANK_TOLERANCE) == rank


def test_open_chains_are_taken_apart_and_loops_are_not():
    """Of the tree only its four-bar and the rod that hangs twice on the same two points remain; of a chain nothing,
    however long."""
    for scene, remain in ((load_scene_text(TREE), 'abcd'), (load_scene('chain', ['mechanism.links=300']), '')):
        s = simulation_of(scene)
        names = [s.model.group_names[g] for g in tied_groups(s.model, scaled_blocks(s.model, s.last_step.J))]
        assert names == [*remain, *(('rope', 'double') if remain else ())]


def test_info_and_recordings_name_the_reactions_that_are_not_unique(capsys, tmp_path):
    assert main(['info', 'slider_crank', '--json']) == 0
    data = json.loads(capsys.readouterr().out)
    assert len(data['reactions_not_unique']) == 12
    assert len(data['redundant_rows']) == 3
    assert main(['info', 'slider_crank']) == 0
    assert 'reactions not unique' in capsys.readouterr().out
    assert main(['run', 'slider_crank', '--duration', '0.01', '--out', str(tmp_path / 'run')]) == 0
    assert json.loads(bag.read(tmp_path / 'run').metadata['reactions_not_unique']) == data['reactions_not_unique']
