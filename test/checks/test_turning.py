"""Bodies that turn far in a step, motions that are imposed, and order four: what is told is what steps miss, by closed
forms."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solver import simulation_of
from solver.analysis.verdict import findings
from solver.files.scene import load_scene_text
from solver.simulation import Simulation

Z = [0, 0, 1]


def run(
    mechanism: dict[str, Any], duration: float, h: float, signals: dict[str, Any] | None = None, **settings: Any
) -> Simulation:
    scene: dict[str, Any] = {'mechanism': mechanism, 'integrator': {'h': h, **settings}, 'duration': duration}
    if signals:
        scene['maneuver'] = {'signals': signals}
    s = simulation_of(load_scene_text(json.dumps(scene)))
    s.advance(round(duration / h))
    return s


def told(s: Simulation) -> set[str]:
    return {finding.quantity for finding in findings(s)}


@pytest.mark.parametrize(('spin', 'h'), [(50.0, 2e-3), (100.0, 5e-3), (100.0, 1e-2), (300.0, 3e-3)])
def test_a_top_precesses_too_little_by_what_the_account_says(spin: float, h: float) -> None:
    """A top with a horizontal axis precesses with m g l / (C spin) exactly. With rho_inf = 1 a step misses (1/2 + A /
    C) (spin h)^2 / 12 of it, to leading order: the next one is (spin h)^2 of that, and the kinetic energy of the
    precession as much of the first again."""
    mass, arm, g, along, across = 1.0, 0.1, 9.81, 1.5, 1.0
    rate = mass * g * arm / (along * spin)
    duration = round(0.13 / rate / h) * h
    top = {'mass': mass, 'inertia': [along, across, across], 'com': [arm, 0, 0], 'angular_velocity': [spin, 0, rate]}
    s = run(
        {
            'gravity': [0, 0, -g],
            'bodies': {'top': top},
            'joints': {'p': {'kind': 'spherical', 'i': 'world', 'j': 'top'}},
        },
        duration,
        h,
        rho_inf=1,
    )
    axis = Rotation.from_quat(s.state.q[0, 3:]).apply([1, 0, 0])
    missed = rate * duration - np.arctan2(axis[1], axis[0])
    law = rate * duration * (0.5 + (across + mass * arm**2) / along) * (spin * h) ** 2 / 12.0
    assert missed == pytest.approx(law, rel=0.05)
    assert s.last_step.account.astray[0] == pytest.approx(law, rel=0.05)
    assert not findings(s)


@pytest.mark.parametrize(
    ('across', 'wobble', 'spin', 'says'),
    [(10.0, 50.0, 1200.0, True), (0.9, 5.0, 100.0, False), (10.0, 0.2, 100.0, False)],
)
def test_a_free_rotor_whose_axis_goes_far_round_is_told(across: float, wobble: float, spin: float, says: bool) -> None:
    """Its axis goes round its angular momentum with |H| / across; what it is off by is never more than its path is
    wide."""
    rotor = {'mass': 1, 'inertia': [across, across, 1], 'angular_velocity': [wobble, 0, spin]}
    s = run({'gravity': [0, 0, 0], 'bodies': {'rotor': rotor}}, 0.5, 1e-3)
    momentum = np.array([across * wobble, 0.0, spin])
    exact = Rotation.from_rotvec(0.5 * momentum / across).apply(Z)
    off = np.arccos(np.clip(exact @ Rotation.from_quat(s.state.q[0, 3:]).apply(Z), -1.0, 1.0))
    assert (off > 0.1) == ('turn_per_step' in told(s)) == says


@pytest.mark.parametrize('spin', [1000.0, 1500.0, 5000.0])
@pytest.mark.parametrize('order', [{}, {'order': 4, 'rho_inf': 1}])
def test_a_rotor_turns_as_far_as_it_likes_about_an_axis_that_stays(spin: float, order: dict[str, Any]) -> None:
    """It is exact, its joint's angle with all its turns too: of 5 rad in a step the nearest angle to the one before is
    one turn less."""
    rotor = {'mass': 1, 'inertia': [0.01, 0.02, 0.01], 'angular_velocity': [0, spin, 0]}
    axle = {'kind': 'revolute', 'i': 'world', 'j': 'r', 'at': [0, 0, 0], 'axis': [0, 1, 0]}
    s = run({'bodies': {'r': rotor}, 'joints': {'a': axle}}, 2.0, 1e-3, **order)
    if (
        order and spin == 5000.0
    ):  # 2.5 rad in a half step: undamped steps keep what rounding makes of it, and the run says so
        assert 'phase' in told(s)
        return
    assert s.snapshot().joint_position[0] == pytest.approx(2.0 * spin, rel=1e-12)
    assert not findings(s)


@pytest.mark.parametrize(('speed', 'h'), [(50.0, 1e-3), (50.0, 4e-3), (20.0, 1e-2)])
def test_a_motion_that_a_driver_imposes_loses_no_phase(speed: float, h: float) -> None:
    """A slider-crank at a constant speed is where its constraints put it; of 20 steps a turn it was said to be out of
    phase after two turns. x = r cos a + sqrt(l^2 - (r sin a)^2)."""
    bodies = {
        'crank': {'mass': 1, 'inertia': [0.01, 0.01, 0.01], 'com': [0.05, 0, 0]},
        'rod': {'mass': 1, 'inertia': [0.01, 0.02, 0.02], 'com': [0.15, 0, 0], 'position': [0.1, 0, 0]},
        'slider': {'mass': 1, 'inertia': [0.01, 0.01, 0.01], 'position': [0.4, 0, 0]},
    }
    joints = {
        'c': {'kind': 'revolute', 'i': 'world', 'j': 'crank', 'at': [0, 0, 0], 'axis': [0, 1, 0]},
        'k': {'kind': 'revolute', 'i': 'crank', 'j': 'rod', 'at': [0.1, 0, 0], 'axis': [0, 1, 0]},
        'p': {'kind': 'revolute', 'i': 'rod', 'j': 'slider', 'at': [0.4, 0, 0], 'axis': [0, 1, 0]},
        's': {'kind': 'prismatic', 'i': 'world', 'j': 'slider', 'at': [0.4, 0, 0], 'axis': [1, 0, 0]},
    }
    turn = {'kind': 'table', 'points': [[0, 0], [20.0, 20.0 * speed]]}
    driver = {'terms': [['c', 1]], 'input': 'turn'}
    s = run({'bodies': bodies, 'joints': joints, 'couplers': {'d': driver}}, 10.0, h, {'turn': turn})
    angle = 10.0 * speed
    exact = 0.1 * np.cos(angle) + np.sqrt(0.3**2 - (0.1 * np.sin(angle)) ** 2)
    assert s.state.q[2, 0] == pytest.approx(exact, abs=1e-9)
    assert not findings(s)
    assert s.last_step.account.phase.max() < 1e-3


def oscillator(stiffness: float, damping: float, duration: float, h: float, **settings: Any) -> Simulation:
    """1 kg on a slide with a spring [N/m] and a damper [N s/m], that starts with 1 m/s."""
    guide = {'kind': 'prismatic', 'i': 'world', 'j': 'b', 'at': [0, 0, 0], 'axis': [1, 0, 0]}
    spring = {'terms': [['g', 1]], 'spring': stiffness, 'damper': damping}
    body = {'mass': 1, 'inertia': [1, 1, 1], 'velocity': [1, 0, 0]}
    mechanism = {
        'gravity': [0, 0, 0],
        'bodies': {'b': body},
        'joints': {'g': guide},
        'coordinate_forces': {'s': spring},
    }
    return run(mechanism, duration, h, **settings)


@pytest.mark.parametrize(('steps_a_period', 'says'), [(30, False), (20, False), (12, True)])
def test_order_four_loses_the_phase_of_order_four(steps_a_period: int, says: bool) -> None:
    """(4 R(y/2)^2 - R(y)) / 3 with R(y) = (1 + i y/2) / (1 - i y/2) is exp(i y) (1 - i y^5 / 320 + y^6 / 1152 + ...), y
    = w h: of 20 steps a period order two loses 5.2 rad in 2 s, order four 0.019. The account finds half of the phase
    (the mean of sin^2)."""
    h, duration = 1e-3, 2.0
    w = 2.0 * np.pi / (steps_a_period * h)
    s = oscillator(w * w, 0.0, duration, h, order=4, rho_inf=1)
    x, v = s.snapshot().joint_position[0] * w, s.snapshot().joint_velocity[0]
    behind = (w * duration - np.arctan2(x, v) + np.pi) % (2.0 * np.pi) - np.pi
    n, y = duration / h, w * h
    assert behind == pytest.approx(n * y**5 / 320.0, rel=0.25 * y * y)
    assert np.hypot(x, v) == pytest.approx(np.exp(n * y**6 / 1152.0), rel=0.01)
    lost = s.last_step.account.phase[0]
    if steps_a_period < 30:  # else the start, along whose first swing the motion only grows, is most of it
        assert lost == pytest.approx(0.5 * n * y**5 / 320.0 * np.hypot(1.0, 320.0 / 1152.0 * y), rel=0.4)
    assert ('phase' in told(s)) == says


@pytest.mark.parametrize(
    ('stiffness', 'damping', 'h'), [(1000.0, 6.3, 1e-3), (1000.0, 63.0, 1e-3), (10.0, 0.63, 1e-2), (1e5, 63.0, 1e-4)]
)
def test_an_iteration_to_a_tolerance_that_is_balanced_has_settled(stiffness: float, damping: float, h: float) -> None:
    """One iteration solves a linear oscillator; the residuals say so, and its increment is that of the prediction."""
    s = oscillator(stiffness, damping, 200 * h, h, mode='tolerance')
    assert s.last_step.account.residual[0] <= 1e-8
    assert not findings(s)
