"""What numbers with few digits leave open: closed at the start, refused where joints contradict each other, told where
they come to."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from mbd_sim_ros.lab.mechanisms.families import drawn
from solver.analysis.error_bar import Twin
from solver.analysis.verdict import decided, findings
from solver.errors import ConsistencyError, StepError
from solver.files.scene import load_scene_text
from solver.simulation import Simulation

SARRUS = 23  # of the series of seed 0: sarrus_1


def simulation(mechanism: dict[str, Any], h: float, duration: float = 1.0, kind: str = 'as_placed') -> Simulation:
    scene = {'mechanism': mechanism, 'integrator': {'h': h}, 'duration': duration, 'start': {'kind': kind}}
    return Simulation(load_scene_text(json.dumps(scene)))


@pytest.mark.parametrize('h', [1e-3, 1e-5])
def test_an_opening_of_a_micrometre_makes_no_force(h: float) -> None:
    """1 kg hangs at rest. The first step closed the joint, by 18 N at 1 ms and 81 kN at 0.01 ms."""
    pivot = {
        'kind': 'revolute',
        'i': {'body': 'world', 'axis': [0, 1, 0]},
        'j': {'body': 'bob', 'position': [0, 0, 9e-7], 'axis': [0, 1, 0]},
    }
    bob = {'mass': 1, 'inertia': [0.01, 0.01, 0.01], 'com': [0, 0, -1]}
    s = simulation({'bodies': {'bob': bob}, 'joints': {'pivot': pivot}}, h)
    assert str(s.start) == 'as given'
    forces = []
    for _ in range(20):
        s.advance(1)
        forces.append(s.last_step.lam[2])
    np.testing.assert_allclose(forces, 9.81, rtol=0.02)
    assert not findings(s)


def four_bar(h: float, *, along: float = 0.0, axis: float = 0.0) -> Simulation:
    """A four-bar linkage of revolutes in space, whose last one is off along its axis [m], or whose axis is not quite
    parallel."""
    p = [np.zeros(3), np.array([0.0, 0.4, 0.0]), np.array([0.7795, 0.7692, 0.0]), np.array([1.0, 0.0, 0.0])]
    bodies, joints = {}, {}
    for k, name in enumerate(('crank', 'coupler', 'rocker')):
        x, y, _ = p[k + 1] - p[k]
        angle = float(np.arctan2(y, x))
        bodies[name] = {
            'mass': 1,
            'inertia': [1e-3, 1e-2, 1e-2],
            'position': ((p[k] + p[k + 1]) / 2).tolist(),
            'rpy': [0, 0, angle],
        }
    for k, (i, j) in enumerate((('world', 'crank'), ('crank', 'coupler'), ('coupler', 'rocker'), ('world', 'rocker'))):
        joints[f'J{k}'] = {'kind': 'revolute', 'i': i, 'j': j, 'at': p[k].tolist(), 'axis': [0, 0, 1]}
    joints['J3']['axis'] = [axis, axis, 1]
    if along:
        lower, upper = (
            {'body': body, 'at': [1, 0, z], 'axis': [0, 0, 1]} for body, z in (('world', 0.0), ('rocker', along))
        )
        joints['J3'] = {'kind': 'revolute', 'i': lower, 'j': upper}
    return simulation({'gravity': [0, -9.81, 0], 'bodies': bodies, 'joints': joints}, h, 2.0)


def test_joints_that_contradict_each_other_at_the_start_are_refused() -> None:
    """Off by a tenth of a micrometre it turned 2.5 of 6.3 rad too far in 2 s, with status ok: redundant rows held it
    with 3e6 N."""
    with pytest.raises(
        ConsistencyError, match=r"'J\d/.*stays open by .*redundant joints contradict each other.*more digits"
    ):
        four_bar(1e-3, along=1e-7)


@pytest.mark.parametrize(('axis', 'told'), [(0.0, False), (1e-9, False), (1e-7, True)])
def test_joints_that_come_to_contradict_each_other_are_told(axis: float, told: bool) -> None:
    """Closed as placed, an axis that is out by 1e-7 is held with 5e5 N as the linkage moves, and turns it 2 rad too
    far; energy is kept."""
    s = four_bar(1e-3, axis=axis)
    s.advance(2000)
    assert [found.quantity for found in findings(s)] == ['contradiction'] * told
    right = four_bar(1e-3)
    right.advance(2000)
    assert (abs(s.state.angle[0] - right.state.angle[0]) > 0.1) == told


def test_they_are_told_where_the_last_step_does_not_show_it() -> None:
    """Out by 1e-8 the linkage is 0.005 rad off after 1.9 s. In a third of the steps the rows hold each other by less
    than is told."""
    s = four_bar(1e-3, axis=1e-8)
    s.advance(1906)
    (found,) = findings(s)
    assert (found.quantity, found.where) == ('contradiction', "constraint 'J3/xz'")
    assert found.time == pytest.approx(0.72, abs=0.005)


@pytest.mark.parametrize(('mechanism', 'h', 'closing'), [('four_bar', 1e-3, False), ('sarrus', 5e-3, True)])
def test_rows_that_a_shorter_step_closes_do_not_contradict_each_other(mechanism: str, h: float, closing: bool) -> None:
    """Out by 1e-8 the four-bar is held by more with half the step; Sarrus' linkage passes a position in which 5 ms
    leave rows open."""
    s = four_bar(h, axis=1e-8) if mechanism == 'four_bar' else Simulation(drawn(SARRUS, 0).at(1.0, h=h))
    twin = Twin(s, round(1.0 / h))
    while twin.next is not None:
        twin.note(s.advance(twin.next - s.k))
    error = twin.made()
    assert 'contradiction' in [found.quantity for found in findings(s)]
    assert error.closing == closing
    deciding, explaining = decided(findings(s), error)
    assert 'contradiction' in [found.quantity for found in (explaining if closing else deciding)]


def test_a_step_that_fails_by_them_says_so() -> None:
    """Out by 1e-5 the rows tear each other apart: finer steps, or larger penalties, would only do so sooner."""
    with pytest.raises(
        StepError, match=r"redundant joints contradict each other, most at constraint 'J[23]/xz': give .* more digits"
    ):
        four_bar(1e-3, axis=1e-5).advance(2000)
