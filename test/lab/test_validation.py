"""Published figures: every case runs, converges with the order of the method, and to what is published within its
accuracy."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mbd_sim_ros.lab.studies import published_joints, published_mechanisms
from mbd_sim_ros.lab.studies.published import PublishedProblem, PublishedValue, Quantity, compare, read
from mbd_sim_ros.lab.studies.validation import SECOND
from solver.files.scene import load_scene

CASES = {case.name: case for case in (*published_mechanisms.cases(), *published_joints.cases())}
SLOW = {'A04', 'A05', 'heavy_top', 'squeezer'}
LONG = {'A02'}  # `mbd study validation` has it too
MARKS = {**dict.fromkeys(SLOW, pytest.mark.slow), **dict.fromkeys(LONG, (pytest.mark.slow, pytest.mark.long))}


@pytest.mark.parametrize('name', [pytest.param(name, marks=MARKS.get(name, ())) for name in CASES])
def test_ours_converge_to_the_published_figures(name: str) -> None:
    case = CASES[name]
    rows, judgements = compare(case)
    assert len(rows) == len(case.figures) > 0
    for j in judgements:
        assert j.limiting <= j.limit, f'{j.quantity}: {j.limiting:g}'
        assert math.isnan(j.order) or j.order >= SECOND[0], f'{j.quantity}: order {j.order:.2f}'


def test_reactions_of_the_cases_tell_sign_body_and_point() -> None:
    """Torques that are not zero stand against every kind of joint that has them; those of sliding joints are far from
    marker G."""
    figures = read('joints')
    for name, component in {
        'Revolute_Case02': 13.0, 'Universal_Case03': 0.1, 'Prismatic_Case02': 600.0, 'Prismatic_Case03': 19.0,
        'Cylindrical_Case03': 1700.0, 'RevSpherical_Case02': 70.0, 'RotSpring_Case01': 19.0,
    }.items():  # fmt: skip
        torques = [f.values for f in figures[name] if f.quantity == 'reaction torque']
        assert np.abs(torques).max() > component
        assert 'reaction torque' in CASES[name].quantities
    assert sum(len(figures[name]) for name in figures) == sum(len(CASES[name].figures) for name in figures)


def test_a_departure_and_an_order_are_found() -> None:
    """A case made of ours: the coordinate of a pendulum, published 1e-3 too large. A quaternion may have either
    sign."""

    def angle(s):
        return np.array([s.snapshot().joint_position[0]])

    def turned(s):
        return -s.snapshot().pose[0, 3:]

    def scene(h):
        return load_scene('pendulum', [f'integrator.h={h}', 'integrator.mode=fixed'])

    exact = _fine(scene, angle)
    case = PublishedProblem(
        'own', '', '', scene, 0.01,
        {'angle': Quantity('rad', angle, 1e-5), 'turn': Quantity('1', turned, 1e-5, either_sign=True)},
        (
            PublishedValue('angle', 1.0, (f'{exact[0] + 1e-3:.12f}',)),
            PublishedValue('turn', 1.0, tuple(f'{-x:.12f}' for x in _fine(scene, turned))),
        ),
    )  # fmt: skip
    rows, (first, second) = compare(case)
    assert first.limiting == pytest.approx(1e-3, rel=1e-3)
    assert first.order == pytest.approx(2.0, abs=0.05)
    assert first.differences[0] != pytest.approx(first.differences[1], rel=1e-3)
    assert second.limiting < 1e-6
    assert [len(r.ours) for r in rows] == [3, 3]


def _fine(scene, look):
    from solver.simulation import Simulation

    simulation = Simulation(scene(1e-4))
    simulation.advance(10000, audit=False)
    return look(simulation)
