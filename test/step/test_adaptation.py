"""Steps and penalties that adapt: they rescue, they keep the order and the tolerance, they forget nothing and repeat
bit by bit."""

from __future__ import annotations

import math

import numpy as np
import pytest
from closed_forms import driven_four_bar, falling_four_bar, heavy_body, pendulum, spring_mass, steady_top
from convergence import FIELDS, error, scene_of
from ensemble import neighbours

from solver.compiled import interruption
from solver.errors import SceneError, SpecError, StepError
from solver.files.scene import load_scene, load_scene_text
from solver.simulation import Simulation
from solver.step.adaptation import Adaptation
from solver.step.augmented_lagrangian import advance, perform
from solver.step.control import WANTED
from solver.step.interpolation import inputs_inside
from solver.step.interval import advance_adapting, is_undetermined

RHYTHM = (1, 4, 2, 1, 1, 5, 3, 2)  # steps in the intervals of the grid: sizes change by factors up to five, up and down
CONSTANT = 'step_policy=constant'
PLAIN = ('augmentation=plain',)  # combined augmentations leave penalties nothing to rescue
EXCITED = """
mechanism:
  gravity: [0, 0, 0]
  bodies: {b: {mass: 1, inertia: [1, 1, 1], position: [0.1, 0, 0]}}
  joints: {g: {kind: prismatic, i: world, j: b, at: [0, 0, 0], axis: [1, 0, 0]}}
  coordinate_forces: {s: {terms: [[g, 1]], spring: 400, input: push}}
maneuver: {signals: {push: {kind: sine, amplitude: 50, frequency: 2}}}
integrator: {mode: tolerance, step_policy: error, error_tolerance: 1.0e-5}
duration: 1
"""
BY_ERROR = {'mode': 'tolerance', 'step_policy': 'error'}
STEERED = """
mechanism:
  gravity: [0, 0, 0]
  bodies:
    r: {{mass: {m}, inertia: [{I}, {I}, {I}]}}
    w: {{mass: {m}, inertia: [{J}, {J}, {J}]}}
  joints:
    rack: {{kind: prismatic, i: world, j: r, at: [0, 0, 0], axis: [0, 1, 0]}}
    wheel: {{kind: revolute, i: world, j: w, at: [0, 0, 0], axis: [0, 0, 1]}}
  coordinate_forces:
    tires: {{terms: [[rack, 1]], spring: {k}, damper: {c}}}
    hand: {{terms: [[wheel, 1]], input: hand}}
  servos:
    assist: {{terms: [[rack, -140], [wheel, 1]], stiffness: {km}, damping: {cm}, marker: {{body: world}}, speeds: [0],
      torques: [{t1}, {t2}], forces: [[{f1}, {f2}]], limit: {f2}, lag: 0.003}}
maneuver: {{signals: {{hand: {{kind: sine, amplitude: {t1}, frequency: 1}}}}}}
integrator: {{h: 0.005, mode: tolerance, step_policy: error, error_tolerance: 1.0e-3}}
duration: 2
"""


def simulation(name: str, *settings: str) -> Simulation:
    return Simulation(load_scene(name, ['integrator.mode=tolerance', *(f'integrator.{s}' for s in settings)]))


def bits(sim: Simulation) -> bytes:
    """All numbers of the state, and everything the future depends on."""
    s = sim.snapshot()
    parts = [*sim.state, s.pose, s.twist, s.reactions, sim.last_step.account.numbers]
    if sim.adaptation is not None:
        parts += sim.adaptation.memory().values()
    return np.concatenate([np.ravel(part) for part in parts]).tobytes()


def adaptation(sim: Simulation) -> Adaptation:
    assert sim.adaptation is not None
    return sim.adaptation


# -- steps -----------------------------------------------------------------------------------------------------------

HASTY = ('h=0.01', 'max_iterations=3', 'tolerance=1e-4')  # too few iterations for the spinning top at this step


def test_a_step_that_fails_is_halved_and_the_run_goes_on():
    with pytest.raises(StepError, match='no convergence in 3 iterations'):
        simulation('spinning_top', *HASTY, CONSTANT).advance(150)
    sim = simulation('spinning_top', *HASTY, 'step_policy=rescue')
    sim.advance(150)
    audit = sim.totals()
    assert (sim.k, sim.t_ns) == (150, 150 * 10_000_000)  # the grid of time is untouched
    assert audit['rejected'] == sum(e.cause == 'failure' for e in sim.events) > 0
    assert audit['substeps'] > 150
    assert any(e.cause == 'easy' and e.new > e.old for e in sim.events), 'the step never grew again'


def test_a_failed_interval_leaves_the_state_of_its_start():
    """Down to the last bit, whatever was tried inside; and the attempt can be repeated."""
    sim = simulation('spinning_top', *HASTY, 'step_policy=rescue', 'h_min=0.01')
    with pytest.raises(StepError):
        sim.advance(150)
    other = simulation('spinning_top', *HASTY, 'step_policy=rescue', 'h_min=0.01')
    other.advance(sim.k)
    assert sim.k > 5
    for a, b in zip(sim.state, other.state, strict=True):
        assert a.tobytes() == b.tobytes()
    assert sim.last_step.account.numbers.tobytes() == other.last_step.account.numbers.tobytes()
    for name, value in adaptation(other).memory().items():
        assert value.tobytes() == adaptation(sim).memory()[name].tobytes(), name


# problem, grids, fields that are neither trivial nor prescribed
PROBLEMS = {
    'pendulum': (pendulum(), (4e-3, 2e-3, 1e-3), FIELDS),
    'spring and damper': (spring_mass(), (8e-3, 4e-3, 2e-3), FIELDS),
    'top in steady precession': (steady_top(), (2e-3, 1e-3, 5e-4), FIELDS),
    'heavy asymmetric body': (heavy_body(0.7), (4e-3, 2e-3, 1e-3), FIELDS),
    'falling four-bar': (falling_four_bar(0.7), (4e-3, 2e-3, 1e-3), FIELDS),
    'four-bar at constant crank speed': (driven_four_bar(6.0), (4e-3, 2e-3, 1e-3), ('multipliers',)),
}


def rhythm_errors(name: str, rho_inf: float, forgetful: bool = False) -> np.ndarray:
    """(grids, fields) largest errors over 0.64 s with steps in RHYTHM. forgetful: history stays where the last step
    left it."""
    problem, grids, _ = PROBLEMS[name]
    table = []
    for h in grids:
        sim = Simulation(
            scene_of(problem, h=h, rho_inf=rho_inf, mode='tolerance', tolerance=1e-12, step_policy='rescue')
        )
        worst = np.zeros(3)
        for k in range(round(0.64 / h)):
            control = adaptation(sim).values
            control.memory[WANTED] = h / RHYTHM[k % len(RHYTHM)]
            if forgetful:
                control.history.size[1] = np.inf
                control.history.offset[:], control.history.z_rate[:] = 0.0, 0.0
            worst = np.maximum(worst, error(sim.advance(1), problem.exact(sim.k * h)))
        assert sim.totals()['substeps'] == pytest.approx(sim.k * np.mean(RHYTHM), rel=0.1)
        table.append(worst)
    return np.array(table)


# with loops, redundant rows and singular positions; of the others by `pytest -m long` only
EACH_DAMPING = ('falling four-bar',)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('name', 'rho_inf'),
    [
        pytest.param(name, rho, marks=pytest.mark.long if rho != 0.8 and name not in EACH_DAMPING else ())
        for name in PROBLEMS
        for rho in (1.0, 0.8, 0.0)
    ],
)
def test_second_order_survives_any_rhythm_of_steps(name, rho_inf):
    """Positions, velocities and multipliers, largest error at any point of the grid over 0.64 s; slope 2 +- 0.3."""
    _, grids, fields = PROBLEMS[name]
    table = rhythm_errors(name, rho_inf)
    x = np.log(grids) - np.mean(np.log(grids))
    slopes = x @ np.log(np.maximum(table, 1e-300)) / (x @ x)
    judged = [FIELDS.index(f) for f in fields]
    np.testing.assert_allclose(slopes[judged], 2.0, rtol=0, atol=0.3, err_msg=f'errors {FIELDS} at {grids}:\n{table}')


def test_order_is_lost_when_the_history_stays_behind():
    """The law above tests something: with accelerations and velocity left where the last step had them it fails."""
    table = rhythm_errors('pendulum', 0.8, forgetful=True)
    slopes = np.log(table[0] / table[-1]) / np.log(4.0)
    assert slopes[0] < 1.7
    assert slopes[2] < 1.3


def run_by_error(problem, tolerance: float, h: float = 0.08) -> tuple[np.ndarray, Simulation]:
    """(largest errors (3,) over 0.64 s, simulation) on a grid that is coarse beside the steps the tolerance needs."""
    sim = Simulation(scene_of(problem, h=h, error_tolerance=tolerance, **BY_ERROR))
    worst = np.zeros(3)
    for _ in range(round(0.64 / h)):
        worst = np.maximum(worst, error(sim.advance(1), problem.exact(sim.k * h)))
    return worst, sim


@pytest.mark.slow
@pytest.mark.parametrize(
    'name', ['pendulum', 'spring and damper', 'top in steady precession', 'heavy asymmetric body', 'falling four-bar']
)
def test_the_error_of_a_run_is_proportional_to_its_tolerance(name):
    """Error per unit of time is controlled, so the slope is one: positions and velocities, three decades."""
    tolerances = (1e-3, 1e-4, 1e-5, 1e-6)
    errors = np.array([run_by_error(PROBLEMS[name][0], tolerance)[0] for tolerance in tolerances])
    x = np.log(tolerances) - np.mean(np.log(tolerances))
    slopes = x @ np.log(errors) / (x @ x)
    np.testing.assert_allclose(slopes[:2], 1.0, rtol=0, atol=0.15, err_msg=f'errors at {tolerances}:\n{errors}')
    assert (errors[:, 0] < 10.0 * np.array(tolerances)).all(), f'far above the tolerance:\n{errors}'


def test_steps_follow_the_tolerance_with_its_square_root():
    """Second order: a hundredth of the tolerance takes ten times the steps, within the quantum of the grid."""
    counts = [run_by_error(spring_mass(), tolerance)[1].totals()['substeps'] for tolerance in (1e-4, 1e-6)]
    assert counts[1] / counts[0] == pytest.approx(10.0, rel=0.2)


def test_steps_do_not_know_the_size_of_forces():
    """A steering with a motor, whose force is an internal state, and the same with everything that has kg in it a
    hundred times as large: the same motion by as many steps."""
    of_one = {
        'm': 30,
        'I': 1,
        'J': 0.05,
        'k': 2e5,
        'c': 3e3,
        'km': 100,
        'cm': 0.5,
        't1': 3,
        't2': 6,
        'f1': 1500,
        'f2': 6000,
    }
    made = []
    for scale in (1.0, 100.0):
        sim = Simulation(
            load_scene_text(STEERED.format(**{name: repr(scale * value) for name, value in of_one.items()}), 'steered')
        )
        sim.advance(sim.scene.steps)
        made.append(sim)
    one, large = (sim.totals()['substeps'] for sim in made)
    assert one == pytest.approx(large, rel=0.02)
    assert np.abs(made[0].state.q - made[1].state.q).max() < 1e-4


def test_work_is_counted_for_every_attempt():
    """Three steps per pair, each with an evaluation per iteration; outputs after the two that count."""
    _, sim = run_by_error(pendulum(), 1e-4)
    audit = sim.totals()
    pairs = audit['substeps'] // 2
    assert audit['substeps'] == 2 * pairs
    attempts = pairs + audit['rejected']
    assert audit['evaluations'] == audit['iterations'] + 2 * attempts
    assert 3 * attempts <= audit['factorizations'] <= audit['iterations']


@pytest.mark.slow
def test_singular_positions_are_passed_with_local_error_control():
    """A tolerance below what is determined there: the error that had to be accepted is an event. Every neighbour keeps
    its branch."""
    settings = ('mode=tolerance', 'step_policy=error', 'penalty_policy=adaptive', 'h=0.01', 'error_tolerance=1e-5')
    for scene in neighbours(load_scene('slider_crank', [f'integrator.{s}' for s in settings])):
        sim = Simulation(scene)
        start = sim.snapshot().joint_position[:2]
        sim.advance(200)
        turn = sim.snapshot().joint_position[:2] - start
        assert abs(2 * turn[0] + turn[1]) < 1e-2
        assert sim.totals()['energy_error_max'] < 1e-4
        assert all(e.new > e.old == 1e-5 for e in sim.events if e.kind == 'error')


def test_an_error_is_undetermined_when_smaller_steps_do_not_reduce_it():
    assert not is_undetermined(1e-3, 4.0, 5e-4, 1.0, 1.0)  # second order: the rate falls with the square
    assert is_undetermined(1e-3, 4.0, 5e-4, 8.0, 1.0)  # the same error in half the time
    assert not is_undetermined(1e-3, 4.0, 5e-4, 8.0, 1e-3)  # too much for an interval of the grid


def test_prescribed_motions_pass_through_an_interval_as_polynomials():
    """Value, rate and acceleration inside an interval of the grid are those of the quintic through both ends; forces
    are held."""
    sim = Simulation(
        load_scene('car_step_steer', ['integrator.mode=tolerance', 'integrator.step_policy=error', 'integrator.h=0.01'])
    )
    names = sim.channels.inputs
    polynomial = np.polynomial.Polynomial([0.3, -2.0, 5.0, 40.0, -300.0, 1000.0])
    T = sim.h

    def at(t: float) -> np.ndarray:
        u = np.arange(len(names)) * 1.0
        for n, name in enumerate(('steering', 'steering_rate', 'steering_acceleration')):
            u[names.index(name)] = polynomial.deriv(n)(t) if n else polynomial(t)
        return u

    for x in (0.25, 0.6, 1.0):
        u = np.full(len(names), np.nan)
        inputs_inside(adaptation(sim).values.motion, T, at(0.0), at(T), x, u)
        np.testing.assert_allclose(u, at(x * T), rtol=1e-10, atol=1e-10)


def test_the_account_of_energy_is_of_second_order_where_forces_follow_inputs():
    """A mass on a spring that a force excites with 2 Hz, steps by error control inside a coarse grid: its error falls
    with the square."""
    errors = []
    for h in (0.02, 0.01, 0.005):
        sim = Simulation(load_scene_text(EXCITED, 'excited', [f'integrator.h={h}']))
        sim.advance(round(1.0 / h))
        assert sim.totals()['substeps'] > 2 * sim.k
        errors.append(sim.totals()['energy_error_max'])
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(slopes, 2.0, rtol=0, atol=0.3, err_msg=f'{errors}')


# -- interruption ----------------------------------------------------------------------------------------------------


def test_a_long_interval_is_left_when_somebody_asks_for_an_end():
    """Thousands of steps in one interval of the grid: the run comes back with the state of its start, and can be taken
    up again."""
    settings = ('mode=tolerance', 'step_policy=error', 'h=0.2', 'error_tolerance=1e-5')
    sim, other = (simulation('double_pendulum', *settings) for _ in range(2))
    one = sim.advance(1)
    before = [array.copy() for array in sim.state]
    energy = sim.last_step.account.numbers.copy()
    interruption.request()
    try:
        now = sim.advance(3)
    finally:
        interruption.forget()
    assert sim.k == 1
    assert all(a.tobytes() == b.tobytes() for a, b in zip(sim.state, before, strict=True))
    assert sim.last_step.account.numbers.tobytes() == energy.tobytes()
    np.testing.assert_allclose(now.pose, one.pose, rtol=0, atol=1e-12)
    other.advance(4)
    sim.advance(3)
    assert adaptation(other).rejected > 0 and adaptation(other).substeps > 500
    assert bits(sim) == bits(other)


# -- memory ----------------------------------------------------------------------------------------------------------

ADAPTING = {
    'penalties': ('slider_crank', *PLAIN, 'penalty=100', 'penalty_policy=adaptive'),
    'rescue': ('spinning_top', *HASTY, 'step_policy=rescue'),
    'error': ('double_pendulum', 'step_policy=error', 'h=0.02', 'error_tolerance=1e-4'),
    'everything': (
        'slider_crank',
        *PLAIN,
        'penalty=100',
        'penalty_policy=adaptive',
        'step_policy=error',
        'h=0.01',
        'error_tolerance=1e-4',
    ),
}


@pytest.mark.parametrize('name', ADAPTING)
def test_a_saved_state_repeats_steps_penalties_and_events(name):
    """In the same simulation and in a new one, and after a reset: the controller's memory belongs to the state."""
    sim = simulation(*ADAPTING[name])
    start = bits(sim)
    sim.advance(40)
    saved, seen = sim.save(), len(sim.events)
    for _ in range(60):
        sim.advance(1)
    future, events = bits(sim), list(sim.events)
    assert len(events) > seen > 0, 'nothing adapted, nothing is shown'
    sim.restore(saved)
    assert sim.events == events[:seen]
    sim.advance(60)
    assert bits(sim) == future
    assert sim.events == events
    fresh = simulation(*ADAPTING[name])
    fresh.restore(saved)
    fresh.advance(60)
    assert bits(fresh) == future
    assert fresh.events == events[seen:]
    sim.reset()
    assert bits(sim) == start
    assert sim.events == []
    sim.advance(100)
    assert bits(sim) == future


def test_a_state_goes_on_with_another_policy_where_both_would_have_done_the_same():
    """Saved by a run with constant steps, as the node does, and taken up by one that may divide them, and the other way
    round."""
    runs = [simulation('slider_crank', CONSTANT), simulation('slider_crank', 'step_policy=rescue')]
    for sim in runs:
        sim.advance(50)
    for one, other in (runs, runs[::-1]):
        saved = one.save()
        future = one.advance(30)
        other.restore(saved)
        assert other.advance(30).numbers.tobytes() == future.numbers.tobytes()
        one.restore(saved)


def test_a_state_in_the_middle_of_a_rescue_is_refused_by_constant_steps():
    adaptive, constant = (
        simulation('spinning_top', *HASTY, 'step_policy=rescue'),
        simulation('spinning_top', *HASTY, CONSTANT),
    )
    adaptive.advance(150)
    assert adaptive.events[-1].new < 0.01
    with pytest.raises(
        SpecError, match=r'while step or penalties were not those of the setting; set integrator\.step_policy'
    ):
        constant.restore(adaptive.save())


def test_nothing_is_compiled_while_a_run_adapts():
    sim = simulation(*ADAPTING['everything'])
    sim.advance(1)
    kernels = (advance, advance_adapting, perform)
    before = [len(kernel.signatures) for kernel in kernels]
    sim.advance(100)
    assert [len(kernel.signatures) for kernel in kernels] == before


@pytest.mark.parametrize(('settings', 'says'), [
    (['mode=fixed', 'step_policy=error'], r"step_policy = 'error': needs integrator\.mode: tolerance"),
    (['mode=fixed', 'penalty_policy=adaptive'], r"penalty_policy = 'adaptive': needs integrator\.mode: tolerance"),
    (['mode=tolerance', 'penalty_policy=adaptive', 'penalty=1e9'], r'penalty_cap = .*must be at least '
        r'integrator\.penalty = 1e\+09'),
    (['mode=tolerance', 'step_policy=rescue', 'h=1e-3', 'h_min=1e-2'], r'h_min = .*must be at most integrator\.h = '
        r'0\.001'),
    (['mass_factor=0'], r'mass_factor = 0'),
    (['error_tolerance=0'], r'error_tolerance = 0'),
])  # fmt: skip
def test_settings_that_cannot_work_are_refused(settings, says):
    with pytest.raises(SceneError, match=says):
        load_scene('pendulum', [f'integrator.{s}' for s in settings])


def nearly_equal_crank(excess: float, tolerance: float) -> Simulation:
    """A crank of 1 m with a rod that is longer by `excess` [m]: it passes a position where the rod nearly folds onto
    the crank, and the slider is pulled through within about excess / (3 m/s)."""
    rod, half = 1.0 + excess, 0.5**0.5
    end, turn = half + (rod * rod - 0.5) ** 0.5, -math.asin(half / rod)
    return Simulation(
        load_scene_text(
            f"""
mechanism:
  gravity: [0, -9.81, 0]
  bodies:
    crank: {{mass: 1, inertia: [1.0e-4, 0.0833, 0.0833], com: [0.5, 0, 0], rpy: [0, 0, {math.pi / 4.0!r}]}}
    rod:
      mass: 1
      inertia: [1.0e-4, 0.0833, 0.0833]
      com: [{0.5 * rod!r}, 0, 0]
      position: [{half!r}, {half!r}, 0]
      rpy: [0, 0, {turn!r}]
    slider: {{mass: 1, inertia: [0.1, 0.1, 0.1], position: [{end!r}, 0, 0]}}
  joints:
    A: {{kind: revolute, i: world, j: crank, at: [0, 0, 0], axis: [0, 0, 1]}}
    B: {{kind: revolute, i: crank, j: rod, at: [{half!r}, {half!r}, 0], axis: [0, 0, 1]}}
    C: {{kind: revolute, i: rod, j: slider, at: [{end!r}, 0, 0], axis: [0, 0, 1]}}
    D: {{kind: prismatic, i: world, j: slider, at: [{end!r}, 0, 0], axis: [1, 0, 0]}}
start: {{coordinates: {{A: {{rate: -3.0}}}}}}
integrator: {{h: 0.002, mode: tolerance, step_policy: error, error_tolerance: {tolerance!r}}}
duration: 2
"""
        )
    )


@pytest.mark.parametrize('excess', [0.1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 0.0, -1e-3, -1e-2, -0.1])
def test_error_control_passes_a_nearly_equal_crank_or_names_its_singular_position(excess: float) -> None:
    """A rate of 1e-3 for 2 s leaves 2e-3 of velocities, and twice that of the 28 J that go from one form to another."""
    run = nearly_equal_crank(excess, 1e-3)
    try:
        run.advance(run.scene.steps)
    except StepError as error:
        assert abs(excess) < 1e-3 and 'passes next to a singular position' in str(error)
    else:
        assert run.totals()['energy_error_max'] < 4e-3 * 28.0
