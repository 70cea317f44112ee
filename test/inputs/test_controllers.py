"""Controllers as units of co-simulation: they act as they would by hand, and end with a sentence."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mbd_sim_ros.commands.main import main
from mbd_sim_ros.native.library import compiler
from solver import load_scene, simulation_of
from solver.errors import MbdError, SceneError, SpecError
from solver.inputs import controllers

SCENE = 'light_car_step_steer'
VARIABLES = (
    ('speed', 'input', 'm/s', '0'),
    ('torque', 'output', 'N.m', None),
    ('gain', 'parameter', '', '100'),
    ('target', 'parameter', 'm/s', '25'),
    ('crash', 'parameter', 's', '0'),
    ('fail', 'parameter', 's', '0'),
)
EVERY = 0.005


def description(state: bool = True, speed_unit: str = 'm/s') -> str:
    """modelDescription.xml of the controller."""
    lines = []
    for k, (name, kind, unit, start) in enumerate(VARIABLES):
        unit = speed_unit if name == 'speed' else unit
        start = None if kind == 'output' else start
        number = (f' unit="{unit}"' if unit else '') + (f' start="{start}"' if start else '')
        variability = 'tunable' if kind == 'parameter' else 'continuous'
        lines.append(
            f'<ScalarVariable name="{name}" valueReference="{k}" causality="{kind}" variability="{variability}">'
            f'<Real{number}/></ScalarVariable>'
        )
    able = 'canGetAndSetFMUstate="true" canSerializeFMUstate="true"' if state else ''
    outputs = [f'<Unknown index="{k + 1}"/>' for k, v in enumerate(lines) if 'causality="output"' in v]
    structure = f'<Outputs>{"".join(outputs)}</Outputs><InitialUnknowns>{"".join(outputs)}</InitialUnknowns>'
    units = ''.join(f'<Unit name="{unit}"/>' for unit in {'m/s', 'N.m', 's', speed_unit})
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<fmiModelDescription fmiVersion="2.0" modelName="controller" guid="1">'
        f'<CoSimulation modelIdentifier="controller" {able}/><UnitDefinitions>{units}</UnitDefinitions>'
        f'<ModelVariables>{"".join(lines)}</ModelVariables><ModelStructure>{structure}</ModelStructure>'
        '</fmiModelDescription>'
    )


@pytest.fixture(scope='module')
def code(tmp_path_factory) -> bytes:
    """The controller as a shared library."""
    file = tmp_path_factory.mktemp('controller') / 'controller.so'
    source = Path(__file__).parent / 'controller.c'
    subprocess.run([compiler(), '-shared', '-fPIC', '-O1', str(source), '-o', str(file)], check=True, timeout=60)
    return file.read_bytes()


@pytest.fixture
def archive(code, tmp_path):
    """Function that writes the archive."""

    def write(name: str = 'speed.fmu', platform: str = 'linux64', **other) -> str:
        with zipfile.ZipFile(tmp_path / name, 'w') as file:
            file.writestr('modelDescription.xml', description(**other))
            file.writestr(f'binaries/{platform}/controller.so', code)
        return str(tmp_path / name)

    return write


def settings(fmu: str, *more: str, every: float = EVERY, inputs: str = '{speed: longitudinal_velocity}') -> list[str]:
    """Overrides that put the controller into a scene. more: further entries."""
    entries = ''.join(f', {one}' for one in more)
    return [
        f'controllers=[{{fmu: {fmu}, inputs: {inputs}, outputs: {{torque: drive_torque}}, every: {every}{entries}}}]'
    ]


def test_it_acts_as_by_hand_one_period_later(archive):
    simulation = simulation_of(load_scene(SCENE, settings(archive())))
    simulation.advance(60)
    other = simulation_of(load_scene(SCENE))
    names = other.channels.inputs
    held, following, integral = 0.0, 0.0, 0.0
    from solver.quantities import quantity

    speed = quantity('longitudinal_velocity', other.channels)
    for k in range(60):
        if k % 5 == 0:
            held = following
            off = 25.0 - float(speed.of(other.snapshot().numbers[speed.places][None, :])[0, 0])
            integral += off * EVERY
            following = 100.0 * off + integral
        row = other.source.table(k, 1)[0]
        row[names.index('drive_torque')] = held
        other.advance(1, row)
    assert held > 50.0  # it does something
    np.testing.assert_array_equal(simulation.snapshot().numbers, other.snapshot().numbers)


@pytest.mark.slow
def test_it_is_reset_saved_and_restored_to_the_same_bits(archive):
    simulation = simulation_of(load_scene(SCENE, settings(archive(), 'parameters: {gain: 80, target: 30}')))
    simulation.advance(33)
    state = simulation.save()
    expected = simulation.advance(30).numbers
    simulation.restore(state)
    np.testing.assert_array_equal(simulation.advance(30).numbers, expected)
    simulation.reset()
    np.testing.assert_array_equal(simulation.advance(63).numbers, expected)
    other = simulation_of(load_scene(SCENE, settings(archive(), 'parameters: {gain: 80, target: 30}')))
    other.restore(state)
    np.testing.assert_array_equal(other.advance(30).numbers, expected)


def test_it_acts_beside_a_driver_however_many_steps_a_call_makes(archive):
    scene = load_scene('light_car_lane_change', settings(archive()))
    one, other = simulation_of(scene), simulation_of(scene)
    one.advance(40)
    for _ in range(40):
        other.advance(1)
    assert one.inputs[one.channels.inputs.index('drive_torque')] > 50.0
    np.testing.assert_array_equal(one.snapshot().numbers, other.snapshot().numbers)


def test_a_unit_without_states_can_only_begin_at_its_start(archive):
    simulation = simulation_of(load_scene(SCENE, settings(archive(state=False))))
    simulation.advance(10)
    state = simulation.save()
    simulation.restore(state)
    with pytest.raises(SpecError, match='the unit can only begin at its start'):
        simulation.advance(1)


@pytest.mark.parametrize(
    ('other', 'more', 'sentence'),
    [
        ({}, {'inputs': '{torque: yaw_rate}'}, "inputs: variable 'torque' has causality 'output', not 'input'"),
        ({}, {'inputs': '{gain: yaw_rate}'}, "inputs: variable 'gain' has causality 'parameter', not 'input'"),
        ({'speed_unit': 'mm/s'}, {}, "variable 'speed' is in 'mm/s', and longitudinal_velocity in 'm/s'"),
        ({'speed_unit': 'rad/s'}, {}, "variable 'speed' is in 'rad/s', and longitudinal_velocity in 'm/s'"),
        ({'platform': 'darwin64'}, {}, 'has no binary for this platform \\(linux64\\), only for darwin64'),
        ({'platform': 'linux32'}, {}, 'has no binary for this platform \\(linux64\\), only for linux32'),
        ({'speed_unit': 'km/h'}, {}, "variable 'speed' is in 'km/h', and longitudinal_velocity in 'm/s'"),
        ({'platform': 'win64'}, {}, 'has no binary for this platform \\(linux64\\), only for win64'),
        ({}, {'inputs': '{sped: longitudinal_velocity}'}, "has no variable 'sped'; did you mean 'speed'"),
        ({}, {'inputs': '{speed: longitudinal_speed}'}, 'longitudinal_speed: no such quantity'),
        ({}, {'every': 0.0024}, 'takes 2.4 steps of integrator.h = 0.001; the nearest whole one is 0.002'),
    ],
)
def test_misuse_is_one_sentence(archive, other, more, sentence):
    with pytest.raises(MbdError, match=sentence):
        simulation_of(load_scene(SCENE, settings(archive(**other), **more))).advance(1)


def test_files_that_are_none_are_one_sentence(archive, tmp_path):
    (tmp_path / 'broken.fmu').write_bytes(Path(archive()).read_bytes()[:500])
    for file, sentence in (('broken.fmu', 'is no unit of FMI that can be read'), ('none.fmu', 'there is no such file')):
        with pytest.raises(SpecError, match=sentence):
            simulation_of(load_scene(SCENE, settings(str(tmp_path / file)))).advance(1)
    with pytest.raises(SceneError, match='the model has no such input'):
        load_scene(SCENE, [settings(archive())[0].replace('drive_torque', 'drive_torq')])
    twice = settings(archive())[0].replace('[{', '[{fmu: b.fmu, outputs: {brake: drive_torque}}, {')
    with pytest.raises(SceneError, match="'drive_torque': two controllers command it"):
        load_scene(SCENE, [twice])
    with pytest.raises(MbdError, match='parameters: variable'):
        simulation_of(load_scene(SCENE, settings(archive(), 'parameters: {torque: 1}'))).advance(1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('parameter', 'sentence'),
    [
        ('crash', 'its process ended (signal 6): the unit crashed'),
        ('fail', 'fails in its step at t = 0.1 s: the valve'),
    ],
)
def test_a_crash_inside_does_not_lose_the_recording(archive, tmp_path, capsys, parameter, sentence):
    words = ['run', SCENE, '--set', 'duration=0.3', '--out', str(tmp_path / 'bag'), '--no-error']
    given = settings(archive(), f'parameters: {{{parameter}: 0.1}}')
    assert main([*words, '--set', given[0]]) != 0
    assert sentence in capsys.readouterr().err
    assert main(['info', str(tmp_path / 'bag'), '--json']) == 0
    told = json.loads(capsys.readouterr().out)
    assert told['verdict'] == 'error' and told['duration'] == pytest.approx(0.1)


@pytest.mark.slow
def test_a_run_is_recorded_and_replayed_without_the_unit(archive, tmp_path, capsys):
    fmu = archive()
    words = ['run', SCENE, '--set', 'duration=0.2', '--set', settings(fmu)[0], '--no-error']
    assert main([*words, '--out', str(tmp_path / 'bag')]) == 0
    Path(fmu).unlink()
    assert main(['replay', str(tmp_path / 'bag'), '--out', str(tmp_path / 'again'), '--json']) == 0
    capsys.readouterr()


def test_a_unit_that_hangs_is_told(archive, monkeypatch):
    monkeypatch.setattr(controllers, 'PATIENCE', 0.0)
    with pytest.raises(MbdError, match='the unit hangs'):
        simulation_of(load_scene(SCENE, settings(archive()))).advance(1)


@pytest.mark.parametrize(
    ('there', 'here', 'same'),
    [
        ('N.m', 'N m', True),
        ('m/s2', 'm/s^2', True),
        ('Nm', 'N m', True),
        ('1', '', True),
        ('deg', 'rad', False),
        ('m/s', 'm/s^2', False),
        ('kN.m', 'N m', False),
    ],
)
def test_units_are_the_same_however_a_tool_spells_them(there, here, same):
    assert (controllers._plain(there) == controllers._plain(here)) == same


@pytest.mark.slow
def test_an_interrupt_is_for_the_run_and_no_crash_of_the_unit(archive, tmp_path):
    """Ctrl-C reaches all processes of the terminal's group. Nothing unpacked stays behind."""
    (tmp_path / 'unpacked').mkdir()
    words = [
        sys.executable,
        '-m',
        'mbd_sim_ros.commands.main',
        'run',
        SCENE,
        '--no-error',
        '--out',
        str(tmp_path / 'bag'),
    ]
    words += ['--set', 'duration=1000', '--set', settings(archive())[0]]
    environment = os.environ | {'TMPDIR': str(tmp_path / 'unpacked')}
    run = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, start_new_session=True, env=environment)
    deadline = time.monotonic() + 60.0
    while not list(tmp_path.glob('bag/*')) or not list(tmp_path.glob('unpacked/mbd_controller_*/binaries')):
        assert run.poll() is None and time.monotonic() < deadline
        time.sleep(0.05)
    os.killpg(run.pid, signal.SIGINT)
    told = run.communicate(timeout=60)[1]
    assert run.returncode == 130 and 'Traceback' not in told and 'crashed' not in told
    assert not list(tmp_path.glob('unpacked/mbd_controller_*'))


class Speaking:
    """In place of the process of a unit: it says 0.3 at its start and -0.7 after every step."""

    folder = SimpleNamespace(name='')

    def __init__(self, where: str) -> None:
        pass

    def ask(self, question):
        return {'values': [0.3], 'units': {}} if 'open' in question else {'values': [-0.7]}

    def close(self) -> None:
        pass


def test_a_steering_angle_passes_the_filter_with_its_sign(monkeypatch):
    """By hand: the reference runs at 20 rad/s, and the angle follows it critically damped at 5 Hz, from rest."""
    monkeypatch.setattr(controllers, '_Process', Speaking)
    names = ('drive_torque', 'steering', 'steering_rate', 'steering_acceleration')
    controller = controllers.Controller(fmu='x', outputs={'a': 'steering'}, every=0.002)
    acting = controllers.Controlled(controller, names, 1_000_000, lambda: np.zeros(0), {})
    rows = [acting.act(k, np.array([5.0, 9.0, 9.0, 9.0])) for k in range(2000)]
    w = 10.0 * np.pi
    for k, t in ((0, 0.001), (1, 0.002)):
        decay = np.exp(-w * t)
        angle = 20.0 * t - 40.0 / w + (40.0 / w + 20.0 * t) * decay
        rate = 20.0 - (20.0 + 20.0 * w * t) * decay
        np.testing.assert_allclose(rows[k], [5.0, angle, rate, w * w * (20.0 * t - angle) - 2.0 * w * rate], rtol=1e-9)
    assert rows[1][3] > 0.0 > rows[2][3] - rows[1][3]  # at 2 ms, one period later, it turns the other way
    np.testing.assert_allclose(rows[-1], [5.0, -0.7, 0.0, 0.0], atol=1e-9)
