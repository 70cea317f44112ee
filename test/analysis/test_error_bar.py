"""Error bars against motions whose error is known in closed form, and what becomes of motions whose error no twin
tells."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from mbd_sim_ros.batch import simulate
from solver import Simulation, load_scene, load_scene_text, simulation_of
from solver.analysis.error_bar import FEWEST, MOST, Twin, instants
from solver.analysis.kept_errors import NONE, keep, kept
from solver.quantities import quantity

OSCILLATOR = """
mechanism:
  gravity: [0, 0, 0]
  bodies: {{b: {{mass: 1, inertia: [1, 1, 1]}}}}
  joints: {{g: {{kind: prismatic, i: world, j: b, at: [0, 0, 0], axis: [0, 0, 1]}}}}
  coordinate_forces: {{s: {{terms: [[g, 1]], spring: {stiffness}, damper: {damping}}}}}
start: {{coordinates: {{g: {{value: 0.1}}}}}}
duration: {duration}
"""
PENDULUM = """
mechanism:
  bodies: {b: {mass: 1, inertia: [0.1, 0.1, 0.1], com: [0, 0, -1], rpy_deg: [0, 60, 0]}}
  joints: {g: {kind: revolute, i: world, j: b, at: [0, 0, 0], axis: [0, 1, 0]}}
duration: 3
"""
DOUBLE = """
mechanism: mechanisms/double_pendulum.yaml
duration: 10
"""


def bar(text: str, *overrides: str) -> tuple[Simulation, dict]:
    simulation = simulation_of(load_scene_text(text, 'scene', overrides))
    return simulation, simulate(simulation, simulation.scene.steps, error=True)


@pytest.mark.parametrize(('h', 'damping'), [(0.005, 0.0), (0.002, 0.0), (0.001, 1.5), (0.0005, 60.0)])
def test_the_error_of_an_oscillator_is_that_of_its_closed_form(h: float, damping: float) -> None:
    """x = 0.1 exp(-d t) (cos w t + d/w sin w t), with d half the damping and w^2 = 400 - d^2. All steps between are of
    the run."""
    text = OSCILLATOR.format(stiffness=400.0, damping=damping, duration=2.0)
    simulation, data = bar(text, f'integrator.h={h}')
    simulation.reset()
    worst, d = 0.0, 0.5 * damping
    w = np.sqrt(complex(400.0 - d * d))
    for k in range(1, simulation.scene.steps + 1):
        found = simulation.advance(1).pose[0, 2]
        t = k * h
        worst = max(worst, abs(found - (0.1 * np.exp(-d * t) * (np.cos(w * t) + d / w * np.sin(w * t))).real))
    assert 0.5 < data['errors']['position']['value'] / worst < 2.0
    assert data['error_text'].startswith(
        'Numerical error (half step)' if h == 0.005 else 'Numerical error (double step)'
    )  # 1.7 % are near 2 %


@pytest.mark.parametrize(
    'settings', [{'h': 0.004}, {'h': 0.004, 'order': 4, 'rho_inf': 1.0, 'mode': 'tolerance', 'tolerance': 1e-12}]
)
def test_the_error_of_a_pendulum_is_that_against_a_finer_run(settings: dict) -> None:
    """By order two and by order four, which falls by 16 with half the step."""
    integrator = ', '.join(f'{key}: {value}' for key, value in settings.items())
    _, data = bar(PENDULUM, f'integrator={{{integrator}}}')
    scene = load_scene_text(PENDULUM, 'scene', [f'integrator={{{integrator}}}'])
    coarse = simulation_of(scene)
    fine = simulation_of(
        dataclasses.replace(scene, integrator=dataclasses.replace(scene.integrator, h=settings['h'] / 16))
    )
    worst = 0.0
    for _ in range(scene.steps):
        a, b = coarse.advance(1).joint_position[0], fine.advance(16).joint_position[0]
        worst = max(worst, abs(a - b))
    assert 0.5 < data['errors']['orientation']['value'] / worst < 2.0
    assert data['status'] == 'ok'


def test_a_twin_makes_half_the_steps_from_the_same_start() -> None:
    simulation = simulation_of(load_scene_text(PENDULUM, 'scene'))
    twin, steps = Twin(simulation, 1001), 0
    while twin.next is not None:
        twin.note(simulation.advance(twin.next - simulation.k))
    steps = sum(twin.make())
    assert (simulation.k, steps) == (1000, 500)
    assert twin.result().measured


@pytest.mark.parametrize('steps', [1, 2, 63, 64, 999, 100_000])
def test_instants_are_even_steps_in_order_and_closer_at_the_beginning(steps: int) -> None:
    found = instants(steps)
    assert found[0] == 0 and found == sorted(set(found)) and found[-1] == steps - steps % 2
    assert all(k % 2 == 0 for k in found)
    assert len(found) <= MOST + 40
    if steps > 2:
        assert found[1] == 2


def test_a_run_of_few_steps_has_a_twin_with_half_the_step() -> None:
    _, data = bar(PENDULUM, 'integrator.h=0.05')
    assert round(3 / 0.05) < FEWEST
    assert data['error_text'].startswith('Numerical error (half step)')


@pytest.mark.parametrize(
    ('overrides', 'why'),
    [
        (['integrator={kind: reference_kkt, tolerance: 1e-8}'], 'a reference integrator controls its own error'),
        (['integrator.h=0.050000021', 'duration=0.6'], 'no half of whole nanoseconds'),
    ],
)
def test_what_is_not_measured_is_said_with_the_reason_and_findings_decide(overrides: list[str], why: str) -> None:
    _, data = bar(PENDULUM, *overrides)
    assert data['errors'] == {}
    assert data['error_text'].startswith('The numerical error was not measured: ') and why in data['error_text']


@pytest.mark.parametrize('h', [0.9, 0.5])
def test_steps_that_are_divided_into_those_of_the_twin_are_no_measure(h: float) -> None:
    """Swings of 2 s in steps of 0.9 s: those that fail are halved, and the run with half the step was the same; its
    error, 0."""
    scene = load_scene('pendulum', [f'integrator.h={h}'])
    data = simulate(simulation_of(scene), scene.steps, error=True)
    assert (data['status'], data['findings'][0]['quantity']) == ('suspect', 'numerical_error')
    assert data['errors']['position']['share'] > 0.1


def test_a_run_of_one_step_has_no_twin() -> None:
    _, data = bar(PENDULUM, 'integrator.h=0.5', 'duration=0.5')
    assert data['error_text'] == 'The numerical error was not measured: a run of one step has no twin'


def test_a_turn_of_a_round_body_about_its_axis_makes_no_error_and_one_about_another_does() -> None:
    """1.2 rad a step: exact about the axis of a round body, half a turn off after 0.1 s about a middle axis that is not
    one."""
    text = 'mechanism:\n  bodies: {{rotor: {{mass: 1, inertia: {}, angular_velocity: [{}, 0, 1200]}}}}\nduration: 0.1\n'
    _, data = bar(text.format('[1, 1, 2]', 0))
    assert (data['status'], data['errors']['orientation']['share'] < 1e-6) == ('ok', True)
    _, data = bar(text.format('[1, 2, 1.3]', 3))
    assert (data['status'], data['findings'][0]['quantity']) == ('suspect', 'numerical_error')


def test_a_body_at_rest_has_no_error() -> None:
    _, data = bar(OSCILLATOR.format(stiffness=400.0, damping=0.0, duration=1.0).replace('value: 0.1', 'value: 0'))
    assert data['status'] == 'ok'
    assert max(error['share'] for error in data['errors'].values()) < 1e-6


def test_an_oscillation_that_damping_takes_away_in_both_runs_is_seen_at_the_beginning() -> None:
    """Ten periods a second, one a step, rho_inf 0: both runs have lost it long before the first of evenly spread
    instants."""
    text = OSCILLATOR.format(stiffness=4.0 * math.pi**2 * 100.0, damping=0.0, duration=400.0)
    _, data = bar(text, 'integrator={h: 0.1, rho_inf: 0.0}')
    assert (data['status'], data['findings'][0]['quantity']) == ('suspect', 'numerical_error')


def test_a_chaotic_motion_is_called_sensitive_with_the_time_from_which_on_only_statistics_hold() -> None:
    """The double pendulum: half the step moves that time by as much as is told, to the spread of one fourfold
    growth."""
    scene = load_scene('double_pendulum')
    since = []
    for h in (0.001, 0.0005):
        simulation = simulation_of(dataclasses.replace(scene, integrator=dataclasses.replace(scene.integrator, h=h)))
        data = simulate(simulation, simulation.scene.steps, error=True)
        assert 'The motion is sensitive' in data['error_text']
        since.append(float(data['error_text'].split('From t = ')[1].split(' s')[0]))
    assert 3.0 < since[0] < since[1]


def test_a_limit_that_a_scene_requires_takes_the_place_of_the_published_ones() -> None:
    _, data = bar(PENDULUM, 'integrator.h=0.01', 'require={joint_states/g/position: {max: 1e-6 rad}}')
    assert data['status'] == 'suspect'
    (found,) = data['findings']
    assert (found['required'], found['of'], data['passed']) == (True, 'joint_states/g/position max', False)
    _, data = bar(PENDULUM, 'integrator.h=0.01', 'require={joint_states/g/position: {max: 0.1 rad}}')
    assert (data['status'], data['passed']) == ('ok', True)


def test_what_was_measured_is_known_for_the_same_scene_and_step_alone(tmp_path, monkeypatch) -> None:
    """Whatever divides steps that fail, which the node does not; another step, maneuver or vehicle has another
    error."""
    monkeypatch.setenv('MBD_CACHE_DIR', str(tmp_path))
    scene = load_scene('pendulum')
    assert kept(scene) == NONE
    keep(scene, 'Numerical error (double step): little')
    node = load_scene('pendulum', ['integrator.step_policy=constant', 'record.every=7'])
    assert kept(node) == 'Numerical error (double step): little (measured by mbd run pendulum, 10 s of its maneuver)'
    for other in (
        'integrator.h=0.002',
        'integrator.step_policy=error',
        'integrator.iterations=2',
        'mechanism.gravity=[0, 0, -1]',
    ):
        more = ['integrator.mode=tolerance'] if 'policy' in other else []
        assert kept(load_scene('pendulum', [*more, other])) == NONE


FORCED = """
mechanism:
  gravity: [0, 0, 0]
  bodies: {b: {mass: 1, inertia: [1, 1, 1]}}
  joints: {g: {kind: prismatic, i: world, j: b, at: [0, 0, 0], axis: [0, 0, 1]}}
  coordinate_forces: {f: {terms: [[g, 1]], input: u}}
maneuver: {signals: {u: {kind: sine, amplitude: 10, frequency: 1000}}}
duration: 1
"""


@pytest.mark.parametrize(
    ('text', 'override', 'quantity'),
    [
        (FORCED, 'integrator.h=0.001', 'input'),  # whole periods in both steps: a constant force in both runs
        (PENDULUM, 'integrator.penalty=1e13', 'penalty'),
        (PENDULUM, 'require.energy_error_max=1e-12', 'energy_error_max'),
    ],
)
def test_what_both_runs_have_in_common_and_what_is_required_decides_beside_the_error(
    text: str, override: str, quantity: str
) -> None:
    _, data = bar(text, override)
    assert data['status'] == 'suspect'
    assert quantity in [found['quantity'] for found in data['findings']]


def test_what_rounding_does_to_a_light_body_is_seen_by_the_twin() -> None:
    """1e-10 kg beside 1 kg, hidden by the rounding of penalties: its motion differs from step to step."""
    body = '{{mass: {m}, inertia: [{j}, {j}, {j}], position: [{x}, 0, 0], com: [0, 0, -1], rpy_deg: [0, 60, 0]}}'
    text = (
        f'mechanism:\n  bodies:\n    a: {body.format(m=1, j=0.1, x=0)}\n    b: {body.format(m=1e-10, j=1e-11, x=2)}\n '
        f' joints:\n    a: {{kind: revolute, i: world, j: a, at: [0, 0, 0], axis: [0, 1, 0]}}\n    b: {{kind: '
        'revolute, i: world, j: b, at: [2, 0, 0], axis: [0, 1, 0]}\nduration: 5\n'
    )
    _, data = bar(text)
    assert (data['status'], data['findings'][0]['quantity']) == ('suspect', 'numerical_error')
    assert 'light_body' in [found['quantity'] for found in data['explaining']]


@pytest.mark.parametrize('recorded', [True, False])
def test_reactions_are_measured_where_they_are_recorded_and_else_named_as_not_judged(recorded: bool) -> None:
    """A pendulum of 1 kg, whose reaction is unique: stated against the run with a quarter of the step, which has a
    sixteenth of the error."""
    keys = [f'record.reactions={str(recorded).lower()}', 'duration=1']
    made = {}
    for h in (0.004, 0.001):
        run = simulation_of(load_scene('pendulum', [*keys, f'integrator.h={h}']))
        twin = Twin(run, run.scene.steps)
        rows = []
        while run.k < run.scene.steps:
            snapshot = run.advance(round(0.004 / h))
            twin.note(snapshot)
            rows.append(snapshot.reactions)
        made[h] = np.array(rows), twin
    bar = made[0.004][1].made()
    assert ('reactions' in bar.errors) == recorded
    assert bar.text.count('the model and reactions are not judged') == (not recorded)
    if recorded:
        error = bar.errors['reactions']
        lengths = run.bodies.work.row_length
        true = float(np.abs((made[0.004][0] - made[0.001][0]) / lengths).max()) * 16.0 / 15.0
        assert 0.5 < error.value / true < 2.0
        assert error.limit is None and error.unit == 'N'


def test_instants_at_which_an_effort_is_not_determined_are_left_out_of_what_is_required() -> None:
    """A required accuracy is judged by the others: an effort that is not a number breaks no limit, one that is off
    does."""
    name = 'joint_states/g/effort'
    text = PENDULUM + f'require: {{accuracy: {{{name}: {{max: 1 %}}}}}}\n'
    twin = Twin(simulation_of(load_scene_text(text, 'scene')), 300)
    for k in twin.instants[1:]:
        twin.note(twin._run.advance(k - twin._run.k))
    for _ in twin.make():
        pass
    assert twin.result().findings == ()
    place = quantity(name, twin._run.channels).places[0]
    twin._rows[7][place] = np.nan
    assert twin.result().findings == ()
    twin._rows[8][place] = 1.0
    (found,) = twin.result().findings
    assert found.quantity == 'numerical_error' and 0.0 < found.value < np.inf
