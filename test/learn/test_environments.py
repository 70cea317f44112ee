"""Environments of Gymnasium: its own checker, the same bits by seed, alone and in a vector, and refusals."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

gymnasium = pytest.importorskip('gymnasium', reason='pip install .[learn]')

from gymnasium.utils.env_checker import check_env  # noqa: E402

from mbd_sim_ros.learn import TASKS, Task, single, vector  # noqa: E402
from mbd_sim_ros.learn.fleet import Fleet  # noqa: E402
from mbd_sim_ros.learn.line import Line  # noqa: E402
from solver.errors import SpecError  # noqa: E402
from solver.inputs.driver import Course  # noqa: E402

SHORT: dict[str, Any] = {'duration': 1.0}


def test_a_line_knows_side_heading_and_curvature_of_a_circle() -> None:
    """Of radius 30 m, run to the left: corners of its polygon are 0.3 m apart, so offsets are right to 0.2 mm."""
    turn = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    line = Line.of(Course(points=tuple(zip((30 * np.cos(turn)).tolist(), (30 * np.sin(turn)).tolist())), closed=True))
    assert line.length == pytest.approx(2.0 * np.pi * 30.0, rel=1e-3)
    np.testing.assert_allclose(line.curvature, 1.0 / 30.0, rtol=0.05)
    for angle in (0.0, 1.0, 4.0):
        k = line.nearest(*(29.0 * np.array([np.cos(angle), np.sin(angle)])))
        assert line.offset(k, 29.0 * np.cos(angle), 29.0 * np.sin(angle)) == pytest.approx(1.0, abs=2e-2)
        assert line.turn_to(k, angle + 0.5 * np.pi + 0.1) == pytest.approx(0.1, abs=2e-2)
    ahead = line.ahead(line.nearest(30.0, 0.0), 0.25 * line.length)
    np.testing.assert_allclose(line.points[ahead], [0.0, 30.0], atol=0.3)


def test_left_is_positive_beside_a_line_that_leads_to_the_left_and_then_bends_to_the_right() -> None:
    """Along +y at x = 3 m, then a quarter of a circle of radius 20 m about (23, 40), then along +x."""
    way, turn = np.arange(0.0, 40.0, 0.25)[:, None], np.linspace(0.0, 0.5 * np.pi, 200)
    bend = np.column_stack([23.0 - 20.0 * np.cos(turn), 40.0 + 20.0 * np.sin(turn)])
    line = Line(np.concatenate([[3.0, 0.0] + way * [0.0, 1.0], bend, [23.25, 60.0] + way * [1.0, 0.0]]), closed=False)
    k = line.nearest(1.0, 10.0)
    assert line.offset(k, 1.0, 10.0) == pytest.approx(2.0)  # west of a way to the north
    assert line.turn_to(k, 1.7) == pytest.approx(1.7 - 1.5708, abs=1e-4)
    assert line.curvature[k] == pytest.approx(0.0, abs=1e-9)
    assert line.curvature[line.ahead(k, 45.0)] == pytest.approx(-1.0 / 20.0, rel=0.05)
    assert line.offset(line.nearest(50.0, 59.0), 50.0, 59.0) == pytest.approx(-1.0)  # south of a way to the east


def test_a_place_is_followed_along_a_line_however_far_a_car_has_gone() -> None:
    """Also to an end, back again, from the middle of a circle, and not across to the other leg of a hairpin."""
    straight = Line(np.column_stack([np.arange(0.0, 200.1, 0.25), np.zeros(801)]), closed=False)
    assert [straight.nearest(x, 3.0, near) for x, near in ((100.0, 0), (16.0, 0), (1e3, 5), (-9.0, 700))] == [
        400, 64, 800, 0,
    ]  # fmt: skip
    turn = np.arange(1000) * 2.0 * np.pi / 1000
    circle = Line(30.0 * np.column_stack([np.cos(turn), np.sin(turn)]), closed=True)
    assert circle.nearest(29.0 * np.cos(turn[400]), 29.0 * np.sin(turn[400]), 0) == 400
    assert circle.nearest(31.0 * np.cos(turn[600]), 31.0 * np.sin(turn[600]), 0) == 600  # the other way round
    assert 0 <= circle.nearest(0.0, 0.0, 10) < 1000
    legs = np.concatenate([straight.points, [[200.0, 2.0]], straight.points[::-1] + [0.0, 4.0]])
    assert Line(legs, closed=False).nearest(150.0, 3.0, 0) == 600  # 3 m from the leg it drives, 1 m from the other one


def test_a_start_to_the_left_a_turn_to_the_right_and_the_way_have_their_signs() -> None:
    """The road begins along +x; what a generator would have drawn is given: all of the offset, half of the turn."""

    class Drawn:
        """Numbers in turn."""

        def __init__(self) -> None:
            self._numbers = iter((1.0, -0.5))

        def uniform(self, low: float, high: float) -> float:
            """The next one."""
            return next(self._numbers)

    seen = {'offset': 1.0, 'heading_error': 1.0, 'progress': 10.0, 'yaw_rate': 1.0}
    signs = {'costs': {}, 'alive': 0.0, 'progress': 0.2, 'start': (0.4, 0.1)}
    fleet = Fleet(TASKS['lane_keeping'].replace(observations=seen, **signs), 1)
    fleet.reset(0, Drawn())  # type: ignore[arg-type]
    np.testing.assert_allclose(fleet.observe()[0], [0.4, -0.05, 0.0, 0.0], atol=1e-3)
    np.testing.assert_allclose(fleet.ensemble.simulations[0].snapshot().pose[0][:2], [0.0, 0.4], atol=0.2)
    done = fleet.step(np.array([[0.0]]))  # 25 m/s for 0.1 s, of which sin(0.05) to the right
    np.testing.assert_allclose(done.observations[0], [0.4 - 0.125, -0.05, 0.25, 0.0], atol=0.03)
    assert done.rewards[0] == pytest.approx(0.2 * 2.5, rel=0.06)  # the way counts in points 0.25 m apart at most
    for _ in range(5):
        done = fleet.step(np.array([[0.5]]))
    assert done.observations[0, 3] > 0.05  # steered to the left


@pytest.mark.slow
@pytest.mark.parametrize('name', TASKS)
def test_gymnasium_s_own_checker_has_nothing_to_say(name: str) -> None:
    changes = {'every': 0.02} if name == 'split_friction_stop' else {}
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        check_env(
            gymnasium.make(f'mbd_sim_ros.learn:mbd/{_camel(name)}-v0', disable_env_checker=True, **changes).unwrapped
        )


def _camel(name: str) -> str:
    return ''.join(part.capitalize() for part in name.split('_'))


def _episode(env, seed: int, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(observations, rewards) of the first episode."""
    seen, _ = env.reset(seed=seed)
    observations, rewards = [seen], []
    for action in actions:
        seen, reward, ended, cut, _ = env.step(action)
        observations.append(seen)
        rewards.append(reward)
        if ended or cut:
            break
    return np.array(observations), np.array(rewards)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bits_alone_and_in_a_vector() -> None:
    """Also behind an end: the car goes on from where reset() would have put it next."""
    actions = np.random.default_rng(5).uniform(-0.3, 0.3, (14, 5, 1))
    envs = vector('lane_keeping', 5, **SHORT)
    assert envs.fleet.ensemble.in_lanes
    observations, _ = envs.reset(seed=20)
    told, gained = [observations], []
    for row in actions:
        observations, rewards, ended, cut, _ = envs.step(row)
        told.append(observations.copy())
        gained.append(rewards.copy())
    assert cut is not None and not ended.any()
    for k in (0, 3):
        alone = single('lane_keeping', **SHORT)
        for _ in range(2):
            seen, rewards = _episode(alone, 20 + k, actions[:, k])
            assert len(rewards) == 10  # cut off after a second
            assert (seen == np.array(told)[:11, k]).all() and (rewards == np.array(gained)[:10, k]).all()
        again, _ = alone.reset()
        assert (np.array(told)[11, k] == again).all() and gained[10][k] == 0.0
        assert (alone.step(actions[11, k])[0] == np.array(told)[12, k]).all()
    assert not (np.array(told)[0, 0] == np.array(told)[0, 1]).all()


@pytest.mark.slow
def test_cars_vary_by_their_seed_and_only_in_what_is_asked_for() -> None:
    asked = {
        'vary': {'vehicle.chassis.mass': (1100.0, 1400.0)},
        'changes': (),
        **SHORT,
    }  # whole cars: nothing is derived
    envs = vector('lane_keeping', 3, variation=7, **asked)
    mass = lambda env, k: env.fleet.ensemble.simulations[k].scene.model.bodies[0].mass  # noqa: E731
    drawn = [float(envs.task.drawn(7 + k)[0].split('=')[1]) for k in range(3)]
    assert len(set(drawn)) == 3 and all(1100.0 <= m <= 1400.0 for m in drawn)
    assert [mass(envs, k) for k in range(3)] == drawn
    assert mass(single('lane_keeping', variation=8, **asked), 0) == drawn[1]


@pytest.mark.slow
def test_rewards_are_those_of_the_formula_and_an_exit_ends_badly() -> None:
    env = single('lane_keeping', costs={'offset': (0.5, 2.0)}, alive=1.0, observations={'offset': 1.0, 'progress': 1.0})
    cost = lambda offset: 4.0 * offset**2 / (1.0 + 4.0 * offset**2)  # noqa: E731
    env.reset(seed=1)
    seen, reward, *_ = env.step(np.array([0.1]))
    assert reward == pytest.approx(0.1 * (1.0 - 2.0 * cost(seen[0])), rel=1e-5)
    for _ in range(60):
        before = seen
        seen, reward, ended, cut, told = env.step(np.array([1.0]))
        if ended:
            break
    assert ended and not cut and abs(seen[0]) > env.task.width >= abs(before[0]) and told['failure'] == ''
    assert reward == pytest.approx(0.1 * (1.0 - 2.0 * cost(seen[0])) - 10.0, rel=1e-5)
    assert told['progress'] == pytest.approx(25.0 * env.fleet.ensemble.simulations[0].t_ns * 1e-9, rel=0.1)


@pytest.mark.parametrize(
    ('changes', 'said'),
    [
        ({'observations': {'yaw_rat': 1.0}}, 'yaw_rat: no such quantity'),
        ({'observations': {'curvature+x': 1.0}}, 'write curvature+20 for 20 m'),
        ({'observations': {}}, 'name one signal at least'),
        ({'observations': {'offset': 0.0}}, 'scale of offset'),
        ({'every': 0.0123}, 'must be a multiple of integrator.h'),
        ({'scene': 'light_car_swept_steer', 'points': ()}, 'there is no line'),
        ({'weidth': 3.0}, 'no such field; one of'),
        ({'vary': {'vehicle.chassis.mass': (2.0, 1.0)}}, 'give (low, high)'),
        ({'scene': 'pendulum', 'changes': ()}, 'the car has no input steering'),
        ({'observations': {'offset+5': 1.0}}, 'only curvature is seen ahead'),
        ({'observations': {'curvature+nan': 1.0}}, 'only curvature is seen ahead'),
        ({'observations': ['offset']}, 'give a dict by names'),
        ({'costs': {'offset': 0.5}}, 'costs.offset (scale, weight) = 0.5: must be a list of 2 numbers'),
        ({'costs': {'offset': (1.0, 'x')}}, 'must be a finite number'),
        ({'vary': {'vehicle.chassis.mass': 1100.0}}, 'must be a list of 2 numbers'),
        ({'start': 0.5}, 'must be a list of 2 numbers'),
        ({'alive': float('nan')}, 'alive = nan: must be a finite number'),
        ({'duration': 0.05}, 'duration = 0.05: must be >= 0.1'),
        ({'changes': 'fidelity=kc'}, 'give a tuple of key=value'),
        ({'points': (('a', 0.0), (1.0, 1.0))}, 'points[0][0]'),
        ({'variation': -1}, 'variation = -1: give a whole number of at least 0'),
    ],
)
def test_a_task_that_does_not_fit_is_refused_in_a_sentence(changes: dict, said: str) -> None:
    with pytest.raises(SpecError) as caught:
        single('lane_keeping', **changes)
    assert said in str(caught.value) and '\n' not in str(caught.value)


def test_an_unknown_task_is_refused_with_those_that_there_are() -> None:
    with pytest.raises(SpecError, match=r'no such task.*lane_keeping'):
        single('lane_keping')
    with pytest.raises(SpecError, match='or give a Task'):
        single(None)  # type: ignore[arg-type]
    with pytest.raises(SpecError, match='count = 0'):
        vector('lane_keeping', 0)
    with pytest.raises(SpecError, match='observations'):
        Task(name='empty', scene='pendulum')


def test_actions_that_are_none_are_refused_and_no_car_moves() -> None:
    env, envs = single('lane_keeping'), vector('lane_keeping', 3)
    with pytest.raises(gymnasium.error.ResetNeeded):
        envs.step(np.zeros((3, 1)))
    for seed in ([1, 2], [1, 2, 3, 4]):
        with pytest.raises(SpecError, match='one for each of the 3 cars'):
            envs.reset(seed=seed)
    before, _ = env.reset(seed=1)
    for shape in ((0,), (2,), (), (1, 1)):
        with pytest.raises(SpecError, match='shape of actions'):
            env.step(np.zeros(shape))
    for value, said in ((np.nan, 'action of car 0'), ('left', 'give an array of numbers')):
        with pytest.raises(SpecError, match=said):
            env.step(np.array([value]))
    assert (env.fleet.observe()[0] == before).all()
    envs.reset(seed=1)
    for shape in ((2, 1), (4, 1), (3,), (1, 1)):
        with pytest.raises(SpecError, match='must be \\(3, 1\\)'):
            envs.step(np.zeros(shape))


def _driven(env, law: Callable[[dict[str, float]], list[float]]) -> tuple[float, bool, bool, dict]:
    """(return, whether it ended, whether it was cut off, facts) of an episode by a law of signals."""
    seen, told = env.reset(seed=1)
    gained, ended, cut = 0.0, False, False
    while not (ended or cut):
        signals = dict(zip(env.task.observations, (seen * [*env.task.observations.values()]).tolist(), strict=True))
        seen, reward, ended, cut, told = env.step(np.array(law(signals)))
        gained += reward
    return gained, ended, cut, told


@pytest.mark.slow
def test_who_steers_against_the_pull_of_split_friction_gains_and_stops() -> None:
    env = single('split_friction_stop')
    steered = lambda s: [-0.6 * s['offset'] - 12.0 * s['heading_error'] - 1.5 * s['yaw_rate']]  # noqa: E731
    best, ended, cut, told = _driven(env, steered)
    held, *_ = _driven(env, lambda s: [0.0])
    assert ended and not cut and told['failure'] == '' and env.fleet.observe()[0, 5] * 20.0 < env.task.slow
    assert 0.0 > best > held + 1.0


@pytest.mark.slow
def test_the_handling_course_can_be_driven_round_by_a_simple_law() -> None:
    """The curvature 5 m ahead at 8 m/s: once round and further, inside of the lane."""
    env = single('handling_course')

    def law(s: dict[str, float]) -> list[float]:
        bend = s['curvature+5'] - 0.02 * s['offset'] - 0.25 * s['heading_error']
        return [8.4 * bend, 0.4 * (8.0 - s['longitudinal_velocity'])]

    gained, ended, cut, told = _driven(env, law)
    assert cut and not ended and told['progress'] > env.fleet.line.length
    assert gained > 0.5 * env.task.progress * told['progress']
