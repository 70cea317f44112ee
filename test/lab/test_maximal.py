"""The reference in maximal coordinates against closed forms, its rows against differences, and linkages against another
reference.

Tolerance 1e-11 of every step adds up to some 1e-9 of the size within a second; what is compared with closed forms is
held to 1e-8.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.special import ellipj

from mbd_sim_ros.lab.mechanisms.maximal import CHANGE, TIGHT, Maximal, Unresolved, motion, placed
from mbd_sim_ros.lab.mechanisms.maximal_reader import read
from mbd_sim_ros.lab.mechanisms.mixtures import PARTS, mixture

LINKAGES = Path(__file__).parents[1] / 'data' / 'linkages'
TIMES = np.linspace(0.0, 1.0, 21)
pytestmark = pytest.mark.slow  # its kernels are compiled where they are not kept yet


def solved(
    mechanism: dict, maneuver: dict | None = None, times: np.ndarray = TIMES
) -> tuple[Maximal, dict[str, np.ndarray]]:
    """A mechanism and its motion: p, q, v, w (times, bodies, 3 or 4)."""
    maximal = Maximal(
        yaml.safe_dump({'mechanism': mechanism, **({'maneuver': {'signals': maneuver}} if maneuver else {})})
    )
    y, _ = maximal.solve(times, TIGHT)
    n = maximal.n
    p, q, v, w = np.split(y, (3 * n, 7 * n, 10 * n), axis=1)
    return maximal, {
        'p': p.reshape(-1, n, 3),
        'q': q.reshape(-1, n, 4),
        'v': v.reshape(-1, n, 3),
        'w': w.reshape(-1, n, 3),
    }


def body(mass: float, inertia, position=(0.0, 0.0, 0.0), **more) -> dict:
    return {'mass': mass, 'inertia': [float(x) for x in inertia], 'position': [float(x) for x in position], **more}


def revolute(i: str, j: str, at, axis=(0.0, 0.0, 1.0)) -> dict:
    return {'kind': 'revolute', 'i': i, 'j': j, 'at': [float(x) for x in at], 'axis': list(axis)}


def test_a_pendulum_swings_as_elliptic_functions_say():
    """From rest at 2.5 rad: sin(theta / 2) = k cd(w t, k), k = sin(2.5 / 2)."""
    begin, length, mass, own = 2.5, 0.7, 1.3, 0.02
    place = length * np.array([np.sin(begin), -np.cos(begin), 0.0])
    _, found = solved(
        {
            'gravity': [0, -9.81, 0],
            'bodies': {'bob': body(mass, (0.01, 0.03, own), place)},
            'joints': {'pivot': revolute('world', 'bob', (0, 0, 0))},
        }
    )
    k = np.sin(begin / 2.0)
    _, cn, dn, _ = ellipj(np.sqrt(mass * 9.81 * length / (own + mass * length**2)) * TIMES, k * k)
    theta = 2.0 * np.arcsin(k * cn / dn)
    assert found['p'][:, 0, :2] == pytest.approx(length * np.column_stack((np.sin(theta), -np.cos(theta))), abs=1e-8)


def test_an_axisymmetric_rotor_precesses_about_its_angular_momentum():
    """At |L| / A, with its axis at a constant angle."""
    A, C, w = 0.3, 0.5, np.array([1.0, 0.0, 20.0])
    _, found = solved({'gravity': [0, 0, 0], 'bodies': {'rotor': body(2.0, (A, A, C), angular_velocity=w.tolist())}})
    L = np.array([A * w[0], 0.0, C * w[2]])
    turns = Rotation.from_rotvec(np.outer(TIMES, L / A))
    assert Rotation.from_quat(found['q'][:, 0]).apply([0, 0, 1]) == pytest.approx(turns.apply([0, 0, 1]), abs=1e-8)


def test_a_disc_rolls_in_a_circle_with_a_constant_lean():
    """Steady rolling: A W^2 sin cos - (C + m r^2) W w3 sin - m g r cos = 0, theta between disc and ground."""
    mass, r, theta, turning = 1.5, 0.3, 1.1, 2.0
    A, C, s, c = mass * r * r / 4.0, mass * r * r / 2.0, np.sin(theta), np.cos(theta)
    w3 = (A * turning**2 * s * c - mass * 9.81 * r * c) / ((C + mass * r * r) * turning * s)
    up, along = np.array([0.0, c, s]), np.array([1.0, 0.0, 0.0])  # in the disc, from the ground up and along its path
    axis = np.cross(along, up)  # (0, -s, c): the third axis, with W z . axis = W cos
    w = turning * np.array([0.0, 0.0, 1.0]) + (w3 - turning * c) * axis
    centre = r * up
    R = np.column_stack((along, up, axis))
    _, found = solved(
        {
            'bodies': {
                'disc': body(
                    mass, (A, A, C), centre,
                    orientation=Rotation.from_matrix(R).as_quat().tolist(),
                    velocity=np.cross(w, centre).tolist(),
                    angular_velocity=(R.T @ w).tolist(),
                )
            },
            'contacts': {
                'ground': {
                    'kind': 'rolling', 'radius': r, 'i': {'body': 'world', 'at': [3.0, 2.0, 0.0], 'axis': [0, 0, 1]},
                    'j': {'body': 'disc', 'at': centre.tolist(), 'axis': axis.tolist()},
                }
            },
        }
    )  # fmt: skip
    assert found['p'][:, 0, 2] == pytest.approx(np.full(len(TIMES), r * s), abs=1e-8)
    heading = Rotation.from_quat(found['q'][:, 0]).apply([0, 0, 1])
    assert np.unwrap(np.arctan2(heading[:, 1], heading[:, 0])) - np.arctan2(axis[1], axis[0]) == pytest.approx(
        turning * TIMES, abs=1e-8
    )


def test_a_chaplygin_sleigh_runs_as_hyperbolic_functions_say():
    """u = V tanh(x), w = V sqrt(m / J) sech(x), x' = a V m / J, with the centre of mass a ahead of the blade."""
    mass, own, a, V, x0 = 2.0, 0.1, 0.25, 1.5, -2.0
    J = own + mass * a * a
    u, w = V * np.tanh(x0), V * np.sqrt(mass / J) / np.cosh(x0)
    _, found = solved(
        {
            'gravity': [0, 0, 0],
            'bodies': {
                'sleigh': body(
                    mass,
                    (0.05, 0.06, own),
                    (a, 0, 0),
                    velocity=[float(u), float(a * w), 0.0],
                    angular_velocity=[0, 0, float(w)],
                )
            },
            'joints': {
                'plane': {'kind': 'point_on_plane', 'i': 'world', 'j': 'sleigh', 'at': [0, 0, 0], 'axis': [0, 0, 1]}
            },
            'contacts': {'blade': {'kind': 'knife_edge', 'i': 'world', 'j': {'body': 'sleigh', 'at': [0, 0, 0]}}},
        }
    )
    x = x0 + a * V * mass / J * TIMES
    assert found['w'][:, 0, 2] == pytest.approx(V * np.sqrt(mass / J) / np.cosh(x), abs=1e-8)


def test_a_driven_four_bar_is_where_two_circles_meet():
    """Crank turned by a cubic spline; the rocker follows from lengths alone."""
    P, Q = np.zeros(2), np.array([2.0, 0.3])
    A, B = np.array([0.4, 0.5]), np.array([1.7, 1.6])
    bodies = {
        'crank': body(1.0, (0.1, 0.1, 0.1), (*(P + A) / 2, 0.0)),
        'coupler': body(2.0, (0.1, 0.3, 0.2), (*(A + B) / 2, 0.4)),
        'rocker': body(1.5, (0.2, 0.1, 0.3), (*(Q + B) / 2, 0.0)),
    }
    joints = {
        'a': revolute('world', 'crank', (*P, 0)), 'b': revolute('crank', 'coupler', (*A, 0)),
        'c': revolute('coupler', 'rocker', (*B, 0)), 'd': revolute('world', 'rocker', (*Q, 0)),
    }  # fmt: skip
    points = [[0.0, 0.0], [0.5, 0.8], [1.0, -0.3]]
    maximal, found = solved(
        {'bodies': bodies, 'joints': joints, 'couplers': {'drive': {'terms': {'a': 1.0}, 'input': 'u'}}},
        {'u': {'kind': 'table', 'points': points}},
    )
    assert (maximal.freedoms, maximal.rank, len(maximal.rows[0])) == (0, 18, 21)
    turn = np.arctan2(A[1], A[0]) - 0.3
    tip = np.hypot(*A) * np.array([np.cos(turn), np.sin(turn)])
    arm, first = np.hypot(*(B - Q)), np.arctan2(*(B - Q)[::-1])

    def open_by(angle: float) -> float:
        return float(np.hypot(*(Q + arm * np.array([np.cos(angle), np.sin(angle)]) - tip)) - np.hypot(*(B - A)))

    angle = brentq(open_by, first - 0.4, first + 0.4, xtol=1e-14)
    assert found['p'][-1, 2, :2] == pytest.approx(Q + arm / 2.0 * np.array([np.cos(angle), np.sin(angle)]), abs=1e-8)


def test_a_body_on_an_undamped_bushing_keeps_its_energy_through_large_turns():
    """Potential (k d^2 + c theta^2) / 2 over displacement and rotation vector along marker i: the torque is its
    gradient."""
    k, c, inertia = np.array([50.0, 80.0, 30.0]), np.array([4.0, 2.0, 7.0]), np.array([0.3, 0.4, 0.5])
    bushing = {
        'i': 'world',
        'j': {'body': 'box', 'position': [0.1, 0.2, -0.3]},
        'stiffness': [*k.tolist(), *c.tolist()],
    }
    _, found = solved(
        {
            'gravity': [0, 0, 0],
            'bodies': {'box': body(2.0, inertia, velocity=[0.5, -1, 0.3], angular_velocity=[3, 5, -4])},
            'bushings': {'b': bushing},
        }
    )
    R = Rotation.from_quat(found['q'][:, 0])
    theta, d = R.as_rotvec(), found['p'][:, 0] + R.apply([0.1, 0.2, -0.3])
    energy = (
        2.0 * np.sum(found['v'][:, 0] ** 2, axis=1) + found['w'][:, 0] ** 2 @ inertia + d**2 @ k + theta**2 @ c
    ) / 2.0
    assert np.max(np.linalg.norm(theta, axis=1)) > 1.5
    assert energy == pytest.approx(np.full(len(TIMES), energy[0]), rel=1e-9)


@pytest.mark.parametrize('name', ['goldberg', 'myard', 'bricard_3fold', 'kaleido6', 'stewart', 'jansen'])
def test_linkages_move_as_another_reference_has_it(name):
    """Centres of mass and velocities at a quarter, at half and at the end, with ten digits behind the point."""
    known = json.loads((LINKAGES / 'references.json').read_text())[name]
    maximal = Maximal((LINKAGES / f'{name}.yaml').read_text())
    y, _ = maximal.solve(np.array([0.0, *map(float, known['states'])]), TIGHT)
    n = maximal.n
    for state, at in zip(known['states'].values(), y[1:], strict=True):
        for b, of in enumerate(known['bodies']):
            assert maximal.of.names[b] == of
            assert at[3 * b : 3 * b + 3] == pytest.approx(state['com'][of], abs=1e-9)
            assert at[7 * n + 3 * b : 7 * n + 3 * b + 3] == pytest.approx(state['vel'][of], abs=2e-9)


@pytest.mark.parametrize('index', [0, 1, 3, 4, 5, 6, 8])
def test_rates_and_second_derivatives_of_rows_are_those_of_their_values(index):
    """Along constant velocities that the rows allow; differences over 1e-5 s are good to 1e-8 of what changes in a
    second."""
    maximal = Maximal(mixture(index).text)
    n, rng = maximal.n, np.random.default_rng(index)
    directions = maximal.free_directions()
    allowed = (rng.normal(size=len(directions)) @ directions).reshape(n, 6)
    allowed *= maximal.size / np.max(np.abs(allowed[:, :3]))
    y = maximal.y.copy()
    y[7 * n : 10 * n], y[10 * n :] = allowed[:, :3].ravel(), allowed[:, 3:].ravel()
    w = placed(y, n)[3][:n]

    def at(dt: float) -> tuple[np.ndarray, ...]:
        z = y.copy()
        z[: 3 * n] += dt * y[7 * n : 10 * n]
        turned = Rotation.from_rotvec(dt * w) * Rotation.from_quat(y[3 * n : 7 * n].reshape(n, 4))
        z[3 * n : 7 * n] = turned.as_quat().ravel()
        z[10 * n :] = turned.inv().apply(w).ravel()  # constant along the world
        return maximal.values(0.3 + dt, z)

    h = 1e-5
    _, rate, second, gradient = at(0.0)
    before, after = at(-h), at(h)
    scale = np.max(np.abs(rate)) + np.max(np.abs(second))
    assert (after[0] - before[0])[maximal.holonomic] / (2 * h) == pytest.approx(
        rate[maximal.holonomic], abs=1e-8 * scale
    )
    assert (after[1] - before[1]) / (2 * h) == pytest.approx(second, abs=1e-7 * scale)
    velocity = np.hstack((y[7 * n : 10 * n].reshape(n, 3), w))
    own = np.einsum('kbi,bi->k', gradient[:, :n], velocity)
    driven = maximal.of.codes[:, 4] >= 0  # rows with a signal, which has a rate of its own
    assert own[~driven] == pytest.approx(rate[~driven], abs=1e-12 * scale)


def test_mixtures_are_what_their_seed_and_index_say_and_start_closed():
    """Values 1e-9 of the size and rates 1e-9 of the speed are rounding of markers a few sizes away."""
    drawn = [mixture(k, 3) for k in range(24)]
    assert {part for one in drawn for part in one.parts} == {part.__name__ for part in PARTS}
    assert mixture(5, 3) == drawn[5]
    assert mixture(5, 4) != drawn[5]
    for one in drawn:
        maximal = Maximal(one.text)
        if not len(maximal.rows[0]):
            continue
        value, rate, _, _ = maximal.values(0.0, maximal.y)
        assert np.max(np.abs(value)) < 1e-9 * max(maximal.size, 1.0)
        assert np.max(np.abs(rate)) < 1e-9 * np.max(maximal.scale(maximal.y))


def test_a_motion_knows_its_spread_and_what_it_makes_of_a_change():
    """A double pendulum that is thrown over multiplies a change of its start, and both tolerances agree."""
    bodies = {
        'one': body(1.0, (0.01, 0.1, 0.1), (0.5, 0, 0), angular_velocity=[0, 0, 5.0], velocity=[0, 2.5, 0]),
        'two': body(1.0, (0.01, 0.1, 0.1), (1.5, 0, 0), angular_velocity=[0, 0, -5.0], velocity=[0, 2.5, 0]),
    }
    joints = {'a': revolute('world', 'one', (0, 0, 0)), 'b': revolute('one', 'two', (1, 0, 0))}
    text = yaml.safe_dump({'mechanism': {'gravity': [0, -9.81, 0], 'bodies': bodies, 'joints': joints}})
    short, long = motion(text, 0.5), motion(text, 3.0)
    assert max(short.spread, long.spread) < 1e-6
    assert short.growth < long.growth
    assert 1.0 < long.growth < 1e-3 / CHANGE


def test_a_scene_that_the_reader_does_not_know_is_refused_and_one_that_takes_too_long_given_up():
    scene = {'mechanism': {'bodies': {'a': body(1.0, (1, 1, 1))}, 'tires': {}}}
    with pytest.raises(ValueError, match="'tires'"):
        read(yaml.safe_dump(scene))
    maximal = Maximal(mixture(0).text)
    maximal.most = 5
    with pytest.raises(Unresolved, match='after 6 evaluations'):
        maximal.solve(TIMES, TIGHT)
