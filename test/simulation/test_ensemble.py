"""Several simulations in the lanes of a core: every one has the bits of its single run, whatever the others do."""

from __future__ import annotations

import copy
from typing import Any, cast

import numpy as np
import pytest
from single_tracks import PARAMETERS, simulation

import solver
from solver.elements.road import FrictionPatch, RoadSpec
from solver.ensemble import FEWEST, Ensemble
from solver.errors import SpecError
from solver.files.scene import load_scene
from solver.inputs.maneuver import RATE, Maneuver
from solver.inputs.signals import Sine, Step
from solver.simulation import Simulation

COUNT = 8


def state_of(one: Simulation) -> tuple:
    """Everything that a run leaves behind: outputs, state, account, totals, what its level has reached."""
    shown = one.snapshot()
    return shown.k, shown.numbers.tobytes(), shown.counters, one.save(), one.totals(), one.reached, one.inputs.tobytes()


def require_same(ensemble: Ensemble, alone: list[Simulation]) -> None:
    for k, (one, other) in enumerate(zip(ensemble.simulations, alone, strict=True)):
        assert state_of(one) == state_of(other), f'simulation {k}'


def cars(**changes) -> list[Simulation]:
    """Single-track cars that differ in everything that is a number: mass, tires, speed, road, steering, brakes."""
    made = []
    for k in range(COUNT):
        p = copy.deepcopy(PARAMETERS)
        p['body']['mass'] *= 1.0 + 0.02 * k
        p['front']['stiffness_y'] *= 1.0 - 0.03 * k
        p['rear']['drive'] = 0.1 * k
        # the last but one brakes until its wheels lock; the last one skids
        maneuver = Maneuver(
            steering=Sine(amplitude=0.4 * k, frequency=0.5), brake_torque=Step(value=9000.0 * (k == 6), start=0.3),
            drive_torque=Step(value=300.0 * (k - 3), start=0.2, rise=0.1),
        )  # fmt: skip
        road = RoadSpec(friction=1.0 - 0.05 * k, normal=(0.0, 0.01 * k, 1.0))
        made.append(simulation(maneuver, speed=15.0 + 2.0 * k, parameters=p, road=road, **changes))
    return made


@pytest.mark.parametrize('audit', [True, False])
def test_every_lane_has_the_bits_of_its_single_run(audit: bool) -> None:
    """Eight cars that differ in all numbers, one of which locks its wheels, in calls of many lengths."""
    together, alone = Ensemble(cars()), cars()
    assert together.in_lanes and not together.why
    for n in (1, 3, 700, 297):
        together.advance(n, audit=audit)
        for one in alone:
            one.advance(n, audit=audit)
        require_same(together, alone)
    assert abs(alone[6].snapshot().joint_velocity[1]) < 1.0 < abs(alone[5].snapshot().joint_velocity[1])


def test_rows_of_inputs_are_those_of_each() -> None:
    """Rows of each, one row held by all, and one held by each; and the sentence for another shape."""
    together, alone = Ensemble(cars()), cars()
    nu = len(together.channels.inputs)
    rng = np.random.default_rng(5)
    for rows in (rng.normal(size=(COUNT, 40, nu)), rng.normal(size=nu), rng.normal(size=(COUNT, 1, nu))):
        together.advance(40, rows)
        for k, one in enumerate(alone):
            one.advance(40, rows[k] if rows.ndim == 3 else rows)
        require_same(together, alone)
    with pytest.raises(SpecError, match=r'inputs of shape \(3, 3\); give \(\d+,\), \(40, \d+\), \(8, 40, \d+\)'):
        together.advance(40, np.zeros((3, 3)))


def test_a_lane_that_fails_leaves_the_others_alone() -> None:
    """One whose numbers overflow, one that is given an input that is not finite: both say what a single run says, stay
    at their last good step, and go on after a reset."""
    together, alone = Ensemble(cars()), cars()
    nu = len(together.channels.inputs)
    rows = np.zeros((COUNT, 60, nu))
    torque = together.channels.inputs.index('drive_torque')
    rows[2, 30:, torque] = 1e308
    rows[5, 50, torque] = np.nan
    snapshots = together.advance(60, rows)
    for k, one in enumerate(alone):
        if k in (2, 5):
            with pytest.raises(solver.StepError) as said:
                one.advance(60, rows[k])
            assert together.failures[k] == str(said.value)
        else:
            one.advance(60, rows[k])
            assert not together.failures[k]
    require_same(together, alone)
    assert [s.k for s in snapshots] == [60, 60, alone[2].k, 60, 60, 0, 60, 60]
    assert 30 <= alone[2].k < 60
    together.advance(20)  # those that failed wait
    assert [one.k for one in together.simulations] == [80, 80, alone[2].k, 80, 80, 0, 80, 80]
    together.reset([2, 5])
    together.advance(20)
    for k, one in enumerate(alone):
        if k in (2, 5):
            one.reset()
        else:
            one.advance(20)
        one.advance(20)
    require_same(together, alone)


@pytest.mark.parametrize('audit', [True, False])
def test_a_failure_late_in_a_call_leaves_what_was_shown_before_it(audit: bool) -> None:
    """Steps are taken in blocks of 256: one that fails in the third block shows what it showed before the call, as a
    single run does, and not what it was in the middle of it."""
    together, alone = Ensemble(cars()), cars()
    rows = np.zeros((COUNT, 700, len(together.channels.inputs)))
    rows[2, 600:, together.channels.inputs.index('drive_torque')] = 1e308
    for each in (together, *alone):
        each.advance(10, audit=audit)
    together.advance(700, rows, audit=audit)
    for k, one in enumerate(alone):
        if k == 2:
            with pytest.raises(solver.StepError) as said:
                one.advance(700, rows[k], audit=audit)
            assert together.failures[k] == str(said.value)
        else:
            one.advance(700, rows[k], audit=audit)
    require_same(together, alone)


def test_lanes_rest_where_fewer_than_four_are_left() -> None:
    """Five of eight fail at the beginning. The other three step alone for 256 steps, are tried together for one block,
    and then step alone for twice as long; their bits stay those of single runs."""
    together, alone = Ensemble(cars()), cars()
    (group, _), torque = together._groups[0], together.channels.inputs.index('drive_torque')
    blocks: list[int] = []  # steps asked of lanes
    by_itself: list[int] = []  # steps asked of the last engine alone
    last = group.engines[7]
    run, advance = group.run, last.advance

    def counted_run(count: int, *others: Any) -> None:
        blocks.append(count)
        run(count, *others)

    def counted_advance(k: int, rows: np.ndarray, n: int, *others: Any) -> Any:
        by_itself.append(n)
        return advance(k, rows, n, *others)

    group.run, last.advance = counted_run, counted_advance
    rows = np.zeros((COUNT, 2048, len(together.channels.inputs)))
    rows[:5, 10:, torque] = 1e308
    together.advance(2048, rows)
    assert [bool(failure) for failure in together.failures] == [True] * 5 + [False] * 3
    assert len(blocks) == 3 and 0 < by_itself[0] <= 256 - 10
    assert by_itself[1:3] == [256, 512]
    assert sum(by_itself[1:]) + sum(blocks) == 2048
    for k in (5, 6, 7):
        alone[k].advance(2048, rows[k])
        assert state_of(together.simulations[k]) == state_of(alone[k])


def test_simulations_stay_simulations() -> None:
    """One of them is saved, restored, advanced by itself and reset between two calls."""
    together, alone = Ensemble(cars()), cars()
    for each in (together.simulations, alone):
        saved = each[1].advance(25) and each[1].save()
        each[4].advance(7)
        each[1].advance(5)
        each[1].restore(saved)
    together.advance(33)
    for one in alone:
        one.advance(33)
    require_same(together, alone)
    together.reset()
    assert [one.k for one in together.simulations] == [0] * COUNT
    assert together.quantity('yaw_rate').shape == (COUNT,)
    assert together.field('pose').shape == (COUNT, 1, 7)
    with pytest.raises(SpecError, match='yaw_rat'):
        together.quantity('yaw_rat')


def test_a_scene_that_is_there_several_times_is_started_once() -> None:
    """Eleven: eight in lanes, and three that are too few to be."""
    one = cars()[3]
    together = Ensemble([one, *(one.twin(10.0) for _ in range(10))])
    together.advance(50)
    one_alone = cars()[3]
    one_alone.advance(50)
    assert {k.snapshot().numbers.tobytes() for k in together.simulations} == {one_alone.snapshot().numbers.tobytes()}
    few = Ensemble([one.twin(10.0) for _ in range(FEWEST - 1)])
    assert not few.in_lanes and 'one after the other' in few.why


def test_friction_that_changes_along_the_road_is_told_and_taken_one_after_the_other() -> None:
    """The level looks at it every 10 ms, from Python."""
    road = RoadSpec(patches=(FrictionPatch(center=(12.0, 0.0), size=(4.0, 4.0), factor=0.4),))
    made = lambda: [simulation(speed=20.0 + k, road=road) for k in range(4)]  # noqa: E731
    together, alone = Ensemble(made()), made()
    assert not together.in_lanes and 'friction' in together.why
    together.advance(900)
    for one in alone:
        one.advance(900)
    require_same(together, alone)


SCENES = (
    *('car_acceleration', 'car_circle', 'car_cleat', 'car_lane_change', 'car_obstacle_avoidance', 'car_rough_road'),
    *('car_sine_with_dwell', 'car_split_mu_brake', 'car_step_steer', 'car_swept_steer', 'light_car_brake'),
    *('light_car_circle', 'light_car_lane_change', 'light_car_step_steer', 'light_car_straight', 'handling_course'),
    *('light_car_swept_steer', 'saloon_with_trailer'),
)


@pytest.mark.long
@pytest.mark.parametrize('name', SCENES)
def test_delivered_cars_have_the_bits_of_their_single_runs(name: str) -> None:
    """Every car scene at the level single_track, if its vehicle has one: eight amplitudes of the steering, beyond what
    the tires hold, and brakes that lock the wheels of one."""
    try:
        first = solver.simulation_of(load_scene(name, ['fidelity=single_track']))
    except solver.MbdError as error:
        pytest.skip(str(error))
    together = Ensemble([first, *(first.twin(first.scene.duration) for _ in range(COUNT - 1))])
    alone = [first.twin(first.scene.duration) for _ in range(COUNT)]
    steps = min(3000, first.scene.steps)
    t = np.arange(steps) * first.h
    rows = np.zeros((COUNT, steps, len(together.channels.inputs)))
    names = together.channels.inputs
    for k in range(COUNT):
        rows[k, :, names.index('steering')] = 1.5 * k * np.sin(2.0 * t)
        rows[k, :, names.index('steering' + RATE)] = 3.0 * k * np.cos(2.0 * t)
        rows[k, :, names.index('brake_torque')] = 20e3 * (k == 5) * (t > 1.0)
    together.advance(steps, rows)
    for k, one in enumerate(alone):
        try:
            one.advance(steps, rows[k])
        except solver.StepError as error:
            assert together.failures[k] == str(error)
    require_same(together, alone)


@pytest.mark.parametrize(
    ('others', 'sentence'),
    [
        (lambda: [], r'Ensemble: there is no scene'),
        (lambda: [simulation(), simulation(h=2e-3)], r'integrator\.h = 0\.002 in simulation 1, 0\.001 in simulation 0'),
        (lambda: [simulation(), load_scene('slider_crank')], r'simulations 0 and 1 are of different levels'),
        (
            lambda: [load_scene('slider_crank'), load_scene('four_bar')],
            r'simulations 0 and 1 are of different topologies: joints \(',
        ),
        (
            lambda: [load_scene('slider_crank', ['integrator.kind=reference_kkt'])],
            r"simulation 0: integrator\.kind = 'reference_kkt' is a reference integrator",
        ),
    ],
)
def test_what_does_not_fit_is_refused_in_one_sentence(others, sentence: str) -> None:
    with pytest.raises(SpecError, match=sentence):
        Ensemble(others())


def test_the_same_simulation_twice_is_refused() -> None:
    one = simulation()
    with pytest.raises(SpecError, match='twice'):
        Ensemble([one, one])


def test_what_is_asked_wrongly_is_refused_in_one_sentence_and_changes_nothing() -> None:
    ensemble = Ensemble([simulation() for _ in range(2)])
    ensemble.advance(3)
    half, name, scene = cast(tuple[Any, ...], (2.5, 'car', ensemble.simulations[0].scene))
    for wrong, sentence in (
        (lambda: ensemble.advance(-1), r'n = -1: steps are a whole number, 0 at least'),
        (lambda: ensemble.advance(half), r'n = 2\.5: steps are a whole number'),
        (lambda: ensemble.reset([0, 2]), r'there is no simulation 2; the last one is 1'),
        (lambda: ensemble.field('poses'), r"field 'poses': no such field; did you mean 'pose'\?"),
        (lambda: Ensemble([ensemble.simulations[0], name]), r'give a list of scenes'),
        (lambda: Ensemble(scene), r'give a list of scenes'),
    ):
        with pytest.raises(SpecError, match=sentence):
            wrong()
    assert ensemble.field('k').tolist() == [3, 3]


def advance_both(together: Ensemble, alone: list[Simulation], n: int, inputs=None, *, audit=True, every=0) -> None:
    """Advance those in lanes, and each alone: they fail alike, and take the same rows behind every so many steps."""
    seen = [one.seen(every, n) for one in together.simulations] if every else None
    together.advance(n, inputs, audit=audit, seen=seen)
    for k, one in enumerate(alone):
        own = one.seen(every, n) if every else None
        if together.failures[k] and not one.k < together.simulations[k].k:
            continue  # it failed in a call before
        try:
            one.advance(n, None if inputs is None else inputs[k], audit=audit, seen=own)
        except solver.StepError as error:
            assert together.failures[k] == str(error)
        if seen is not None and own is not None:
            assert own.steps.tolist() == seen[k].steps.tolist(), f'simulation {k}'
            assert own.numbers.tobytes() == seen[k].numbers.tobytes(), f'simulation {k}'


def cranks() -> list[Simulation]:
    """Slider-cranks with other loads and speeds, which pass singular positions at other times."""
    return [
        solver.simulation_of(load_scene('slider_crank', [f'start.coordinates.slide.rate={-4.0 - 0.1 * k}']))
        for k in range(COUNT)
    ]


@pytest.mark.long
def test_bodies_have_the_bits_of_their_single_runs() -> None:
    """Iterations to a tolerance, whose number differs: whoever needs more goes on alone. One has a velocity that is not
    finite and fails, as alone. With and without an account of energy and rows of what is shown."""
    together, alone = Ensemble(cranks()), cranks()
    assert together.in_lanes
    for n, audit, every in ((300, False, 0), (7, True, 0), (40, False, 3), (301, True, 3), (9, True, 0)):
        advance_both(together, alone, n, audit=audit, every=every)
        require_same(together, alone)
    for each in (together.simulations, alone):
        each[3].state.v[0, 0] = np.nan
    together.advance(9, audit=False)
    for k, one in enumerate(alone):
        if k == 3:
            with pytest.raises(solver.StepError) as said:
                one.advance(9, audit=False)
            assert together.failures[3] == str(said.value)
        else:
            one.advance(9, audit=False)
            assert state_of(together.simulations[k]) == state_of(one)


@pytest.mark.long
@pytest.mark.parametrize('name', ['car_step_steer', 'car_split_mu_brake', 'car_sine_with_dwell'])
def test_cars_of_level_kc_have_the_bits_of_their_single_runs(name: str) -> None:
    """Eight amplitudes of the steering, beyond what the tires hold, with the energies that they exchange."""
    first = solver.simulation_of(load_scene(name, ['fidelity=kc', 'record.energies=100']))
    together = Ensemble([first, *(first.twin(first.scene.duration) for _ in range(COUNT - 1))])
    alone = [first.twin(first.scene.duration) for _ in range(COUNT)]
    assert together.in_lanes, together.why
    steps = min(2500, first.scene.steps)
    rows = np.repeat(first.source.table(0, steps)[None], COUNT, axis=0)
    steering = [name.startswith('steering') for name in together.channels.inputs]
    rows[:, :, steering] *= 0.4 * np.arange(COUNT)[:, None, None]
    advance_both(together, alone, steps - 300, rows[:, :-300], every=7)
    advance_both(together, alone, 300, rows[:, -300:], audit=False)
    require_same(together, alone)


@pytest.mark.parametrize(
    ('key', 'why'),
    [
        ('step_policy=error', 'step_policy: error'), ('penalty_policy=adaptive', 'penalty_policy: adaptive'),
        ('form=block', 'block form'),
    ],
)  # fmt: skip
def test_integrators_that_differ_from_step_to_step_go_one_after_the_other(key: str, why: str) -> None:
    ensemble = Ensemble([load_scene('slider_crank', [f'integrator.{key}'])] * FEWEST)
    assert not ensemble.in_lanes and why in ensemble.why
