"""Reactions are unique or said not to be, by the name of the constraint."""

from __future__ import annotations

import json

import numpy as np
import pytest

from mbd_sim_ros import bag
from mbd_sim_ros.cli import main
from solver.audit import dense_jacobian
from solver.scene import load_scene
from solver.simulation import Simulation, simulation_of


def rows(simulation: Simulation) -> tuple[set[str], set[str]]:
    """Names of the rows whose reactions are (unique, not unique)."""
    shared = set(simulation.describe()['reactions_not_unique'])
    return set(simulation.model.row_names) - shared, shared


def test_planar_slider_crank_in_space_has_unique_forces_in_its_plane_only():
    """26 constraints, 3 redundant: forces out of the plane and moments about axes in it are shared around the loop, in all its joints."""
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
    """Started with 100 N of every self-equilibrated set of multipliers more: same motion, other reactions in just the rows named."""
    settings = ['integrator.mode=tolerance', 'integrator.tolerance=1e-11', 'integrator.form=condensed', 'integrator.h=1e-3']
    plain, loaded = (simulation_of(load_scene(name, settings)) for _ in range(2))
    left, size, _ = np.linalg.svd(dense_jacobian(loaded.model, loaded.work.J))
    null = left[:, (size > 1e-9).sum() :]
    for lam in (loaded.state.lam, loaded.state.lam_before):
        lam += 100.0 * null.sum(axis=1)
    shared = np.array([row in plain.describe()['reactions_not_unique'] for row in plain.model.row_names])
    a, b = plain.advance(5), loaded.advance(5)
    np.testing.assert_allclose(b.pose, a.pose, rtol=0, atol=1e-9)
    np.testing.assert_allclose(b.reactions[~shared], a.reactions[~shared], rtol=0, atol=1e-4)
    assert np.abs(b.reactions[shared] - a.reactions[shared]).max() > 10.0


def test_info_and_recordings_name_the_reactions_that_are_not_unique(capsys, tmp_path):
    assert main(['info', 'slider_crank', '--json']) == 0
    data = json.loads(capsys.readouterr().out)
    assert len(data['reactions_not_unique']) == 12
    assert len(data['redundant_rows']) == 3
    assert main(['info', 'slider_crank']) == 0
    assert 'reactions not unique' in capsys.readouterr().out
    assert main(['run', 'slider_crank', '--duration', '0.01', '--out', str(tmp_path / 'run')]) == 0
    assert json.loads(bag.read(tmp_path / 'run').metadata['reactions_not_unique']) == data['reactions_not_unique']
