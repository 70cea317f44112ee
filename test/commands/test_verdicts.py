"""Every run ends 'ok' or 'suspect', with findings that say what is beyond, by how much, when, where, and what helps."""

from __future__ import annotations

import json
import math
import signal
from pathlib import Path

import pytest

from mbd_sim_ros import interrupts
from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.commands.main import main
from mbd_sim_ros.node.main import prepare
from solver.analysis.error_bar import Twin
from solver.files.scene import load_scene_text

SARRUS = """
mechanism:
  bodies:
    plate: {mass: 2, inertia: [0.1, 0.1, 0.1], position: [0, 0, 1.7320508075688772]}
    A1: {mass: 1, inertia: [0.01, 0.01, 0.01], position: [0.75, 0, 0.4330127018922193]}
    A2: {mass: 1, inertia: [0.01, 0.01, 0.01], position: [0.75, 0, 1.299038105676658]}
    B1: {mass: 1, inertia: [0.01, 0.01, 0.01], position: [0, 0.75, 0.4330127018922193]}
    B2: {mass: 1, inertia: [0.01, 0.01, 0.01], position: [0, 0.75, 1.299038105676658]}
  joints:
    Ag: {kind: revolute, i: world, j: A1, at: [0.5, 0, 0], axis: [0, 1, 0]}
    Ak: {kind: revolute, i: A1, j: A2, at: [1, 0, 0.8660254037844386], axis: [0, 1, 0]}
    Ap: {kind: revolute, i: A2, j: plate, at: [0.5, 0, 1.7320508075688772], axis: [0, 1, 0]}
    Bg: {kind: revolute, i: world, j: B1, at: [0, 0.5, 0], axis: [1, 0, 0]}
    Bk: {kind: revolute, i: B1, j: B2, at: [0, 1, 0.8660254037844386], axis: [1, 0, 0]}
    Bp: {kind: revolute, i: B2, j: plate, at: [0, 0.5, 1.7320508075688772], axis: [1, 0, 0]}
duration: 3
"""
STOP = """
mechanism:
  bodies: {b: {mass: 1, inertia: [1, 1, 1], position: [0, 0, 0.1]}}
  joints: {g: {kind: prismatic, i: world, j: b, at: [0, 0, 0], axis: [0, 0, 1]}}
  coordinate_forces: {stop: {terms: [[g, 1]], spring: [[-0.2, -100000], [-0.1, 0], [1, 0]]}}
duration: 1
"""
DISTANCE = """
mechanism:
  bodies: {pend: {mass: 1, inertia: [0.04, 0.1, 0.1], position: [-1, 4, 3]}}
  joints: {J: {kind: distance, i: {body: world, position: [1, 2, 3]}, j: {body: pend, at: [1, 4, 3]}}}
duration: 5
"""
OSCILLATOR = """
mechanism:
  gravity: [0, 0, 0]
  bodies: {b: {mass: 1, inertia: [1, 1, 1], position: [0, 0, 0.1]}}
  joints: {g: {kind: prismatic, i: world, j: b, at: [0, 0, 0], axis: [0, 0, 1]}}
  coordinate_forces: {s: {terms: [[g, 1]], spring: 3947.8417604357433}}
start: {coordinates: {g: {value: 0.1}}}
duration: 1
"""
PUSHED = """
mechanism:
  gravity: [0, 0, 0]
  bodies: {b: {mass: 1, inertia: [1, 1, 1]}}
  joints: {g: {kind: prismatic, i: world, j: b, at: [0, 0, 0], axis: [0, 0, 1]}}
  applied_forces:
    one: {marker: b, force: [0, 0, 3.0e+154]}
    two: {marker: b, force: [0, 0, 3.0e+154]}
duration: 0.08
"""
QUICK = ['--no-record']


def output(capsys: pytest.CaptureFixture[str], *argv: str) -> tuple[int, str, str]:
    code = main(argv)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def document(capsys: pytest.CaptureFixture[str], *argv: str) -> tuple[int, dict]:
    code, out, _ = output(capsys, *argv, '--json')
    return code, json.loads(out)


def run(tmp_path: Path, capsys: pytest.CaptureFixture[str], scene: str, *overrides: str) -> tuple[int, dict]:
    path = tmp_path / 'scene.yaml'
    path.write_text(scene)
    return document(capsys, 'run', str(path), *QUICK, *(word for o in overrides for word in ('--set', o)))


@pytest.mark.parametrize(
    ('scene', 'bad', 'good'),
    [
        pytest.param(SARRUS, ['integrator.h=0.02'], ['integrator.h=0.004'], id='sarrus'),
        pytest.param(STOP, ['integrator.h=0.005'], ['integrator.h=0.0005'], id='stop'),
        pytest.param(DISTANCE, ['integrator.h=0.005'], ['integrator.h=0.001'], id='distance'),
        pytest.param(DISTANCE, ['integrator={h: 0.01, mode: tolerance, penalty_policy: '
            'adaptive}'], ['integrator.h=0.001'], id='adaptive'),
    ],
)  # fmt: skip
def test_energy_from_nowhere_is_suspect_and_a_smaller_step_is_not(tmp_path, capsys, scene, bad, good) -> None:
    code, data = run(tmp_path, capsys, scene, *bad)
    assert (code, data['status']) == (1, 'suspect')
    assert data['findings'][0]['quantity'] == 'numerical_error'
    found = {f['quantity']: f for f in data['explaining']}['energy_error_max']
    assert found['value'] == data['energy_error_max'] > found['limit']
    assert 0.0 < found['time'] <= data['simulated_time']
    assert 'integrator.h' in found['text']
    code, data = run(tmp_path, capsys, scene, *good)
    assert (code, data['status'], data['findings']) == (0, 'ok', [])


@pytest.mark.parametrize(('steps_per_period', 'status'), [(200, 'ok'), (4, 'suspect')])
def test_the_limit_of_energy_is_that_of_a_resolved_oscillation(
    tmp_path, capsys, steps_per_period: int, status: str
) -> None:
    """Ten periods of 10 Hz without damping: what the damping of the default rho_inf takes away is missing in the
    account."""
    h = round(0.1 / steps_per_period, 9)
    _, data = run(tmp_path, capsys, OSCILLATOR, f'integrator.h={h}')
    assert data['status'] == status


def test_a_body_that_turns_too_far_in_a_step_is_named(tmp_path, capsys) -> None:
    """A free rotor whose axis goes round; one that turns about an axis that stays turns as far as it likes."""
    body = (
        'mechanism:\n  bodies: {{rotor: {{mass: 1, inertia: [10, 10, 1], angular_velocity: [{x}, 0, '
        '1200]}}}}\nduration: 0.5\n'
    )
    code, data = run(tmp_path, capsys, body.format(x=50))
    found = {f['quantity']: f for f in data['findings'] + data['explaining']}['turn_per_step']
    assert (code, found['where']) == (1, "body 'rotor'")
    assert found['value'] == pytest.approx(1.2, rel=0.01)
    code, data = document(capsys, 'run', str(tmp_path / 'scene.yaml'), *QUICK, '--no-error')
    assert code == 1 and found in data['findings'] and data['errors'] == {}
    assert 'not measured' in data['error_text']
    code, data = run(tmp_path, capsys, body.format(x=0))
    assert (code, data['findings'], data['explaining']) == (0, [], [])


@pytest.mark.parametrize(('speed', 'turned'), [(28.0, 2.8), (31.0, 3.1), (60.0, math.pi)])
def test_a_bushing_that_turns_by_pi_is_named(tmp_path, capsys, speed: float, turned: float) -> None:
    """10 rad/s of a rotor on a torsional stiffness: it swings by a tenth of its first speed, or leaps over where the
    torque jumps."""
    body = (
        f'mechanism:\n  gravity: [0, 0, 0]\n  bodies: {{rotor: {{mass: 1, inertia: [1, 1, 1], angular_velocity: [0, 0, '
        f'{speed}]}}}}\n'
        '  bushings: {mount: {i: world, j: rotor, stiffness: [1e4, 1e4, 1e4, 100, 100, 100]}}\nduration: 0.4\n'
    )
    code, data = run(tmp_path, capsys, body)
    if turned < 3.0:
        assert (code, data['findings']) == (0, [])
        return
    found = {f['quantity']: f for f in data['findings']}['rotation']
    assert (code, found['where']) == (1, 'mount')
    assert found['value'] == pytest.approx(turned, abs=0.06)  # a step turns by 0.06 rad


def test_steps_that_do_not_settle_are_named_with_the_body(tmp_path, capsys) -> None:
    _, data = run(tmp_path, capsys, STOP, 'integrator={h: 0.005, iterations: 1}', 'require.residual_max=1e-4')
    found = {f['quantity']: f for f in data['findings']}['residual_max']
    assert found['where'] == "body 'b'"
    assert 1e-4 < found['value'] < 0.01  # from which on a step goes on


def test_an_output_that_is_not_finite_ends_a_run_that_nobody_records_too(tmp_path, capsys) -> None:
    """6e154 N give 1 kg 6e154 m/s in a second, and each force of 3e154 N a power beyond 1.8e308 W after 0.1 s; such a
    run was ok."""
    code, data = run(tmp_path, capsys, PUSHED, 'duration=0.2')
    assert (code, data['status']) == (4, 'error')
    assert "output 'one/dissipation' is not finite at t = 0.1" in data['error']


def test_energies_beyond_what_numbers_hold_are_told(tmp_path, capsys) -> None:
    """Until 0.08 s every output is finite, but from 0.025 s on not the power of both times two; no limit held for their
    sum: it was ok."""
    code, data = run(tmp_path, capsys, PUSHED)
    assert (code, data['status']) == (1, 'suspect')
    assert [finding['quantity'] for finding in data['findings']] == ['not_finite']
    assert run(tmp_path, capsys, PUSHED, 'duration=0.02')[1]['status'] == 'ok'


def test_a_scene_may_allow_it_or_set_its_own_limit(tmp_path, capsys) -> None:
    bad = 'integrator.h=0.005'
    code, data = run(tmp_path, capsys, STOP, bad, 'require.allow_suspect=true')
    assert (code, data['status']) == (0, 'suspect')
    wide = 'require={energy_error_max: 1, residual_max: 0.1, allow_suspect: true}'
    code, data = run(tmp_path, capsys, STOP, bad, wide)
    assert [f['quantity'] for f in data['findings']] == ['numerical_error']
    assert [f['quantity'] for f in data['explaining']] == ['unsettled', 'resolution', 'phase']
    assert code == 0
    code, data = run(
        tmp_path, capsys, STOP, 'integrator.h=0.0005', 'require={residual_max: 1.0e-15, allow_suspect: true}'
    )
    assert (code, data['status'], data['findings'][0]['required']) == (1, 'suspect', True)
    assert data['violations'][0].startswith('residual_max: ')


def test_the_text_says_verdict_and_reason(tmp_path, capsys) -> None:
    path = tmp_path / 'scene.yaml'
    path.write_text(STOP)
    code, text, _ = output(capsys, 'run', str(path), *QUICK, '--set', 'integrator.h=0.005')
    assert code == 1
    assert 'verdict' in text.splitlines()[0]
    assert 'suspect' in text.splitlines()[0]
    assert any(
        line.startswith('SUSPECT') and 'The numerical error of position is' in line for line in text.splitlines()
    )
    assert any(line.startswith('because') and 'energy account misses' in line for line in text.splitlines())


def test_the_recording_holds_the_verdict(tmp_path, capsys) -> None:
    path = tmp_path / 'scene.yaml'
    path.write_text(STOP)
    document(capsys, 'run', str(path), '--out', str(tmp_path / 'r'), '--set', 'integrator.h=0.005')
    metadata = bag.read(tmp_path / 'r').metadata
    assert metadata['status'] == 'suspect'
    assert json.loads(metadata['findings'])[0]['quantity'] == 'numerical_error'
    assert json.loads(metadata['explaining'])[0]['quantity'] == 'energy_error_max'
    assert json.loads(metadata['errors'])['position']['unit'] == 'm'
    assert metadata['error_text'].startswith('Numerical error (')
    code, data = document(capsys, 'info', str(tmp_path / 'r'))
    assert (code, data['verdict'], data['errors']) == (0, 'suspect', json.loads(metadata['errors']))
    assert metadata['error_text'] in output(capsys, 'info', str(tmp_path / 'r'))[1]
    assert output(capsys, 'info', str(tmp_path / 'r'), '--set', 'duration=1')[0] == 2


def test_an_interrupt_while_the_error_is_measured_leaves_the_recording_whole(tmp_path, capsys, monkeypatch) -> None:
    path = tmp_path / 'scene.yaml'
    path.write_text(OSCILLATOR)
    made = Twin._made

    def interrupted(self, ratio, most):
        for n in made(self, ratio, most):
            monkeypatch.setattr(interrupts, '_number', signal.SIGINT)
            yield n

    monkeypatch.setattr(Twin, '_made', interrupted)
    code, text, said = output(capsys, 'run', str(path), '--out', str(tmp_path / 'r'))
    assert code == 128 + signal.SIGINT
    assert 'interrupted while the numerical error was measured; the recording in' in text + said
    run = bag.read(tmp_path / 'r')
    assert (run.metadata['status'], run.errors) == ('ok', {})
    assert run.error_text == 'The numerical error was not measured: the measurement was interrupted'
    assert run['cmd_applied/step'][-1] == 1000


def test_a_start_that_moves_bodies_is_told_by_run_and_info(tmp_path, capsys) -> None:
    path = tmp_path / 'scene.yaml'
    path.write_text(
        'mechanism:\n  bodies: {bob: {mass: 1, inertia: [0.01, 0.01, 0.01], com: [0, 0, -1]}}\n  joints:\n    pivot: '
        '{kind: revolute, i: {body: world, axis: [0, 1, 0]}, j: {body: bob, position: [0.1, 0, 0], axis: [0, 1, 0]}}\n'
        'start: {kind: assemble}\nduration: 0.1\n'
    )
    for command in (['run', str(path), *QUICK], ['info', str(path)]):
        _, data = document(capsys, *command)
        assert (data['start']['moved'], data['start']['placed_by']) == ('bob', 'assembly')


def test_an_edge_under_the_tires_is_told_and_the_profile_of_a_wheel_is_not(tmp_path, capsys) -> None:
    """A step of 50 mm over 50 mm: hollow by 20 1/m, where a wheel of 0.31 m makes 3.2 1/m of it; loads of 130 kN on a
    wheel came of it."""
    car = 'vehicle: vehicles/light_car.yaml\nstart: {kind: equilibrium, speed_kmh: 20}\nduration: 0.01\n'
    grid = '{kind: height_grid, origin: [6, -4], step: [0.05, 8], height: [[0, 0], [0, 0], [0.05, 0.05], [0.05, 0.05]]}'
    edge = f'road: {{contact: point, grids: [{grid}]}}\n'
    code, data = run(tmp_path, capsys, car + edge)
    (found,) = data['findings']
    assert (code, found['quantity'], found['where']) == (
        1,
        'road_curvature',
        'road.grids[0].height[1][0] at x = 6.05 m, y = -4 m',
    )
    assert found['value'] == pytest.approx(20.0)
    assert run(tmp_path, capsys, car + edge.replace('contact: point, ', ''))[0] == 0  # enveloped by itself
    code, data = document(capsys, 'run', 'car_cleat', '--no-record', '--duration', '0.01')
    assert (code, data['findings']) == (0, [])


HASTY = [
    *(f'integrator.{s}' for s in ('mode=tolerance', 'h=0.01', 'max_iterations=3', 'tolerance=1e-4')),
    'duration=1.5',
]


def test_a_step_that_fails_is_divided_by_default_and_the_run_says_so(tmp_path, capsys) -> None:
    """And its recording is replayed with the same steps; the node, whose steps have their time, keeps them constant
    unless told."""
    sets = [word for o in HASTY for word in ('--set', o)]
    code, data = document(capsys, 'run', 'spinning_top', *sets, '--set', 'integrator.step_policy=constant', *QUICK)
    assert (code, data['status']) == (4, 'error')
    directory = str(tmp_path / 'r')
    code, data = document(capsys, 'run', 'spinning_top', *sets, '--out', directory)
    assert data['rejected'] > 0 and data['substeps'] > data['steps'] == 150
    assert data['smallest_step'] < 0.01
    assert 'branch_switches' not in data
    _, out, _ = output(capsys, 'run', 'spinning_top', *sets, *QUICK)
    assert f'{data["rejected"]} attempts at a step failed' in out
    code, data = document(capsys, 'replay', directory)
    assert (code, data['status']) == (0, 'identical')


def test_the_node_keeps_steps_constant_unless_it_is_told(tmp_path, capsys) -> None:
    for sets, policy in ([], 'constant'), (['integrator.step_policy=rescue'], 'rescue'):
        scene, _ = prepare('pendulum', sets)
        assert scene.integrator.step_policy == policy
        # what a recording of it holds, and replays
        assert load_scene_text(scene.resolved).integrator.step_policy == policy


def test_a_run_that_fails_leaves_its_last_steps_and_a_state_to_start_again_from(tmp_path, capsys) -> None:
    """Recorded every 50 steps: its last 200 steps are there one by one, and replay from a state behind the start."""
    path = tmp_path / 'scene.yaml'
    path.write_text(
        'mechanism: mechanisms/four_bar.yaml\nmaneuver: {signals: {motor: {kind: ramp, slope: 2.0, start: '
        '0.1}}}\nduration: 4\n'
    )
    # the rocker cannot turn round
    impossible = ['--set', 'mechanism.couplers.motor.terms={rocker: 1}', '--set', 'record.every=50']
    code, data = document(capsys, 'run', str(path), *impossible, '--out', str(tmp_path / 'r'))
    assert (code, data['status']) == (4, 'error')
    assert 'last_steps' in data['error']
    assert bag.read(tmp_path / 'r').metadata['status'] == 'error'
    last = bag.read(tmp_path / 'r' / 'last_steps')
    step = last['cmd_applied/step']
    failed = int(data['error'].split('step ')[1].split(':')[0])
    assert step[-1] == failed
    assert failed - step[0] >= min(200, failed)
    assert set(step[1:] - step[:-1]) == {1.0}
    code, data = document(capsys, 'replay', str(tmp_path / 'r' / 'last_steps'))
    assert (code, data['status']) == (0, 'identical')


def test_what_is_made_of_a_suspect_recording_says_so(tmp_path, capsys) -> None:
    """The stop is too stiff for the step; the other one is long over before it is reached."""
    path = tmp_path / 'scene.yaml'
    path.write_text(STOP)
    document(capsys, 'run', str(path), '--out', str(tmp_path / 'coarse'), '--set', 'integrator.h=0.005')
    document(
        capsys, 'run', str(path), '--out', str(tmp_path / 'good'), '--set', 'integrator.h=0.0005', '--duration', '0.05'
    )
    _, text, _ = output(
        capsys,
        'compare',
        str(tmp_path / 'coarse'),
        str(tmp_path / 'good'),
        '--allow-missing',
        '--html',
        str(tmp_path / 'p'),
    )
    assert text.startswith('coarse: the run is suspect: ') and 'numerical error of position' in text.splitlines()[0]
    assert 'good: the run' not in text
    assert 'coarse: the run is suspect' in (tmp_path / 'p').read_text()
    _, data = document(capsys, 'compare', str(tmp_path / 'coarse'), str(tmp_path / 'good'), '--allow-missing')
    assert list(data['doubts']) == ['coarse']
    _, text, _ = output(capsys, 'export', str(tmp_path / 'coarse'), '--csv', str(tmp_path / 'csv'))
    assert 'the run is suspect: ' in text
