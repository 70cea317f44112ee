"""Scenes as units of co-simulation: valid, the bits of a run, states that go elsewhere, and errors by code."""

from __future__ import annotations

import ctypes
import re
import subprocess
import sys
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmi_unit import Unit
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu

from mbd_sim_ros.commands.main import main
from mbd_sim_ros.native.fmu import exponents, write
from mbd_sim_ros.native.kernels import target
from solver import load_scene, simulation_of
from solver.disk import Store
from solver.inputs.command_filter import CommandSource
from solver.start import known

PAGE = Path(__file__).parents[2] / 'docs' / 'native.md'
SUPPORT = Path(__file__).parents[1] / 'support'
CAR, CRANK = 'car_step_steer', 'slider_crank'
SHOWN = {CAR: ['odom/twist/wz', 'odom/pose/x', 'tire/front_left/force/fz'], CRANK: ['joint_states/crank/position']}


@pytest.fixture(scope='module')
def units(tmp_path_factory) -> dict[tuple[str, int], Unit]:
    """Archives of two scenes in both versions."""
    there = tmp_path_factory.mktemp('units')
    made = {}
    for scene in (CAR, CRANK):
        simulation = simulation_of(load_scene(scene))
        for version in (2, 3):
            file = there / f'{scene}{version}.fmu'
            write(simulation, file, target('v3'), version=version, program='test')
            made[scene, version] = Unit(file, version)
    return made


def shown(simulation, names: list[str]) -> list[float]:
    """Numbers of a simulation by the names of their columns."""
    from mbd_sim_ros.native.channels import channels_of

    places = {channel.name: channel.place for channel in channels_of(simulation)}
    return [float(simulation.snapshot().numbers[places[name]]) for name in names]


@pytest.mark.parametrize('version', [2, 3])
@pytest.mark.parametrize('scene', [CAR, CRANK])
def test_an_archive_is_valid_and_small(units, scene, version):
    unit = units[scene, version]
    assert validate_fmu(str(unit.file)) == []
    variables = {v.name: v for v in unit.description.modelVariables}
    if scene == CAR:
        stated = re.search(r'archive of the full car has ([0-9.]+) MB', PAGE.read_text())
        assert stated and unit.file.stat().st_size == pytest.approx(1e6 * float(stated[1]), rel=0.2)
        assert [v.name for v in variables.values() if v.causality == 'input'] == [
            'steering', 'drive_torque', 'brake_torque',
        ]  # fmt: skip
        assert variables['steering'].unit == 'rad' and variables['drive_torque'].unit == 'N m'
        assert variables['odom/twist/vx'].unit == 'm/s' and variables['odom/twist/vx'].causality == 'output'
    told = subprocess.run(
        ['nm', '-D', *map(str, unit.folder.glob('binaries/*/*.so'))], capture_output=True, text=True, check=True
    ).stdout
    assert ' T fmi' in told and 'Py' not in told and 'numba' not in told


@pytest.mark.parametrize('version', [2, 3])
@pytest.mark.parametrize('milliseconds', [1, 5, 10])
def test_communication_in_any_multiple_of_the_step_gives_the_bits_of_a_run(units, version, milliseconds):
    unit, simulation, slave = units[CAR, version], simulation_of(load_scene(CAR)), units[CAR, version].begun()
    assert unit.get(slave, SHOWN[CAR]) == shown(simulation, SHOWN[CAR])
    for k in range(200 // milliseconds):
        slave.doStep(k * milliseconds * 1e-3, milliseconds * 1e-3)
        simulation.advance(milliseconds)
        assert unit.get(slave, SHOWN[CAR]) == shown(simulation, SHOWN[CAR])
    assert unit.get(slave, ['time', 'steps']) == [0.2, 200.0]
    slave.freeInstance()


def test_fmpy_simulates_to_the_end(units):
    for version in (2, 3):
        result = fmpy.simulate_fmu(
            str(units[CRANK, version].file), stop_time=0.5, step_size=0.005, output_interval=0.005, output=SHOWN[CRANK]
        )
        simulation = simulation_of(load_scene(CRANK))
        simulation.advance(500)
        assert result[-1][1] == shown(simulation, SHOWN[CRANK])[0] and len(result) == 101


RUN = """
import resource, sys
if sys.argv[1] == 'unit':
    import fmpy
    every = {'step_size': 0.01, 'output_interval': 0.01}
    told = fmpy.simulate_fmu(sys.argv[2], stop_time=float(sys.argv[3]), output=sys.argv[4:], **every)
    print(*(float(told[-1][name]).hex() for name in sys.argv[4:]))
else:
    from mbd_sim_ros.commands.main import main
    assert main(['run', *sys.argv[2:], '--no-record', '--json']) in (0, 1)
used = resource.getrusage(resource.RUSAGE_SELF)
print(used.ru_utime + used.ru_stime)
"""


@pytest.mark.long
@pytest.mark.parametrize(
    ('scene', 'level', 'seconds'), [(CAR, 'full', 60), (CAR, 'kc', 60), (CAR, 'condensed', 20), (CRANK, '', 10)]
)
def test_a_whole_run_in_fmpy_has_the_bits_of_a_run_and_takes_no_longer(tmp_path, scene, level, seconds):
    """Processor time of processes, import and archive included: at most 1.2 times that of `mbd run --no-record`."""
    settings = [f'duration={seconds}', *([f'fidelity={level}'] if level else [])]
    simulation = simulation_of(load_scene(scene, settings))
    write(simulation, tmp_path / 'unit.fmu', target('v3'))
    simulation.reset()
    simulation.advance(simulation.scene.steps)

    def told(*words: object) -> list[str]:
        done = subprocess.run(
            [sys.executable, '-W', 'ignore', '-c', RUN, *map(str, words)],
            capture_output=True,
            text=True,
            timeout=500,
            check=True,
        )
        return done.stdout.strip().splitlines()[-2:]

    values, by_unit = told('unit', tmp_path / 'unit.fmu', seconds, *SHOWN[scene])
    assert values.split() == [value.hex() for value in shown(simulation, SHOWN[scene])]
    by_run = told('run', scene, *(word for setting in settings for word in ('--set', setting)))[-1]
    print(f'{scene} {level}: {float(by_unit):.2f} s in FMPy, {float(by_run):.2f} s by mbd run')
    assert float(by_unit) < 1.2 * float(by_run)


@pytest.mark.parametrize('version', [2, 3])
@pytest.mark.parametrize(
    ('now', 'step', 'sentence'),
    [
        (0.0, 0.0073, 'a communication step of 7.3 ms is no multiple of the step of the model, 1 ms: take 7 or 8 ms'),
        (0.0, 0.0004, 'take 0 or 1 ms'),
        (0.004, 0.001, 'the communication begins at 0.004 s, and the unit is at 0 s'),
        (0.0, -0.001, 'no step is negative'),
        (0.0, float('nan'), 'must be finite'),
        (float('inf'), 0.001, 'must be finite'),
    ],
)
def test_a_step_beside_the_grid_is_refused_and_nothing_is_done(units, version, now, step, sentence):
    unit, slave = units[CAR, version], units[CAR, version].begun()
    before = unit.get(slave, SHOWN[CAR])
    with pytest.raises(FMICallException):
        slave.doStep(now, step)
    assert sentence in unit.said[-1]
    assert unit.get(slave, [*SHOWN[CAR], 'steps']) == [*before, 0.0]
    slave.doStep(0.0, 0.007)
    assert unit.get(slave, ['steps']) == [7.0]
    slave.freeInstance()


@pytest.mark.parametrize('version', [2, 3])
def test_instances_know_nothing_of_each_other_and_inputs_pass_the_filter(units, version):
    unit = units[CAR, version]
    one, other = unit.begun(), unit.begun()
    unit.set(one, steering=0.4, drive_torque=100.0, brake_torque=0.0)
    assert unit.get(one, ['steering', 'drive_torque']) == [0.4, 100.0]
    steered, free = simulation_of(load_scene(CAR)), simulation_of(load_scene(CAR))
    commands = CommandSource(steered.channels.inputs, steered.h_ns)
    for k in range(10):
        one.doStep(k * 0.01, 0.01)
        other.doStep(k * 0.01, 0.01)
        for _ in range(10):
            steered.advance(1, commands.advance(0.4, 100.0, 0.0))
        free.advance(10)
    assert unit.get(one, SHOWN[CAR]) == shown(steered, SHOWN[CAR])
    assert unit.get(other, SHOWN[CAR]) == shown(free, SHOWN[CAR])
    refused = {
        'steering': (float('nan'), 'input steering is not finite: it stays as it was'),
        'odom/pose/x': (1.0, 'odom/pose/x is not an input'),
        'steering_filter/bandwidth': (0.0, 'bandwidth and rate limit of the steering filter must be > 0'),
        'time': (1.0, 'a value reference is not one of this unit that can be set'),
    }
    for name, (value, sentence) in refused.items():
        with pytest.raises(FMICallException):
            unit.set(one, **{name: value})
        assert unit.said[-1] == sentence
    one.freeInstance()
    other.freeInstance()


@pytest.mark.parametrize('version', [2, 3])
def test_parameters_of_the_filter_are_those_of_the_node(units, version):
    unit, simulation = units[CAR, version], simulation_of(load_scene(CAR))
    slave = unit.begun()
    unit.set(slave, **{'steering_filter/bandwidth': 8.0, 'steering_filter/rate_limit': 1.5, 'steering': -0.3})
    unit.set(slave, drive_torque=0.0, brake_torque=0.0)
    assert unit.get(slave, ['steering_filter/bandwidth', 'steering_filter/rate_limit']) == [8.0, 1.5]
    commands = CommandSource(simulation.channels.inputs, simulation.h_ns, bandwidth=8.0, rate_limit=1.5)
    slave.doStep(0.0, 0.1)
    for _ in range(100):
        simulation.advance(1, commands.advance(-0.3, 0.0, 0.0))
    assert unit.get(slave, SHOWN[CAR]) == shown(simulation, SHOWN[CAR])
    w, t = 16.0 * np.pi, 0.1  # by hand, critically damped behind a reference that runs at the limit all the time
    angle = 1.5 * (t - 2.0 / w + (2.0 / w + t) * np.exp(-w * t))
    assert unit.get(slave, ['joint_states/steering_wheel/position']) == pytest.approx([-angle], rel=1e-6)
    slave.freeInstance()


ELSEWHERE = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from fmi_unit import Unit
unit = Unit(Path(sys.argv[2]), int(sys.argv[3]))
slave = unit.begun()
state = (slave.deSerializeFMUstate if unit.version == 2 else slave.deserializeFMUState)(Path(sys.argv[4]).read_bytes())
(slave.setFMUstate if unit.version == 2 else slave.setFMUState)(state)
slave.doStep(0.05, 0.05)
print([value.hex() for value in unit.get(slave, sys.argv[5:])])
"""


@pytest.mark.parametrize('version', [pytest.param(2, marks=pytest.mark.slow), 3])
def test_a_state_goes_back_and_into_another_process(units, version, tmp_path):
    unit, slave = units[CAR, version], units[CAR, version].begun()
    save, restore, release, serialize, deserialize = (
        (slave.getFMUstate, slave.setFMUstate, slave.freeFMUstate, slave.serializeFMUstate, slave.deSerializeFMUstate)
        if version == 2
        else (
            slave.getFMUState,
            slave.setFMUState,
            slave.freeFMUState,
            slave.serializeFMUState,
            slave.deserializeFMUState,
        )
    )
    slave.doStep(0.0, 0.05)
    state = save()
    data = serialize(state)
    slave.doStep(0.05, 0.05)
    expected = unit.get(slave, SHOWN[CAR])
    restore(state)
    slave.doStep(0.05, 0.05)
    assert unit.get(slave, SHOWN[CAR]) == expected
    release(state)
    (tmp_path / 'state').write_bytes(data)
    command = [sys.executable, '-c', ELSEWHERE, str(SUPPORT), str(unit.file), str(version)]
    done = subprocess.run(
        [*command, str(tmp_path / 'state'), *SHOWN[CAR]], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.stdout.strip() == str([value.hex() for value in expected]), done.stderr
    generator = np.random.default_rng(5)
    for _ in range(100):  # none is taken, and the instance stays as it was
        mutant = bytearray(data)
        for at in generator.integers(0, len(data), 4):
            mutant[at] ^= int(generator.integers(1, 256))
        with pytest.raises(FMICallException):
            deserialize(
                bytes(mutant[: int(generator.integers(1, len(data) + 1))] if generator.random() < 0.3 else mutant)
            )
    assert unit.get(slave, SHOWN[CAR]) == expected
    slave.freeInstance()


@pytest.mark.parametrize('version', [2, 3])
def test_parts_that_do_not_belong_together_make_no_instance(units, version, tmp_path):
    unit = units[CRANK, version]
    with pytest.raises(Exception, match=r'(?i)instantiate'):
        unit.instance(guid='0' * 32).instantiate()
    model = unit.folder / 'resources' / 'model.mbd'
    whole = model.read_bytes()
    generator = np.random.default_rng(3)
    try:
        for k in range(50):
            mutant = bytearray(whole)
            mutant[int(generator.integers(0, len(whole)))] ^= int(generator.integers(1, 256))
            model.write_bytes(bytes(mutant[: len(whole) if k % 2 else int(generator.integers(0, len(whole)))]))
            with pytest.raises(Exception, match=r'(?i)instantiate'):
                unit.instance().instantiate()
        model.unlink()
        with pytest.raises(Exception, match=r'(?i)instantiate'):
            unit.instance().instantiate()
    finally:
        model.write_bytes(whole)
    unit.begun().freeInstance()


class Allocated(ctypes.Structure):
    """struct mallinfo2 of glibc: what its allocator has given out."""

    _fields_ = tuple(
        (name, ctypes.c_size_t)
        for name in (
            'arena',
            'ordblks',
            'smblks',
            'hblks',
            'hblkhd',
            'usmblks',
            'fsmblks',
            'uordblks',
            'fordblks',
            'keep',
        )
    )


@pytest.mark.parametrize('version', [2, 3])
@pytest.mark.parametrize('leak', [0, 64])
def test_instances_that_are_freed_leave_nothing(units, version, leak):
    """Bytes that are given out grow by less than 64 an instance, of the 120 kB that it takes; 64 more are seen."""
    libc, unit, count = ctypes.CDLL(None), units[CRANK, version], 100
    libc.mallinfo2.restype = Allocated
    libc.malloc.argtypes = [ctypes.c_size_t]
    slave = unit.instance()  # one for all: FMPy's own objects come and go in the same memory

    def bytes_after(instances: int) -> int:
        for _ in range(instances):
            unit.begun(slave).doStep(0.0, 0.001)
            getattr(slave, f'fmi{version}FreeInstance')(slave.component)
            if leak:
                libc.malloc(leak)
        now = libc.mallinfo2()
        return now.uordblks + now.hblkhd

    before = bytes_after(10)
    assert (bytes_after(count) - before < 64 * count) == (leak == 0)


def test_a_start_that_was_known_gives_the_archive_of_one_that_was_searched(tmp_path, monkeypatch):
    """What a search leaves in the scratch of a step is nobody's business."""
    monkeypatch.setattr(known, 'store_of', lambda name: Store(tmp_path / name))
    made = []
    for forget in (True, False, True):
        if forget:
            known._remembered.clear()
            for kept in tmp_path.rglob('*'):
                kept.unlink() if kept.is_file() else None
        file = tmp_path / 'car.fmu'
        write(simulation_of(load_scene('light_car_step_steer')), file, target('v3'), program='test')
        made.append(file.read_bytes())
    assert made[0] == made[1] == made[2]


def test_the_same_scene_gives_the_same_archive_and_the_command_writes_it(units, tmp_path, capsys):
    file = tmp_path / 'crank.fmu'
    write(simulation_of(load_scene(CRANK)), file, target('v3'), program='test')
    assert file.read_bytes() == units[CRANK, 2].file.read_bytes()
    assert main(['fmu', CRANK, '--out', str(tmp_path / 'a.fmu'), '--fmi', '3']) == 0
    assert 'FMI 3.0' in capsys.readouterr().out
    assert main(['fmu', 'car_lane_change', '--json']) != 0
    assert 'the scene has a driver' in capsys.readouterr().out
    assert main(['fmu', CRANK, '--out', str(tmp_path / 'no' / 'a.fmu')]) != 0
    assert 'No such file or directory' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('unit', 'expected'),
    [
        ('N m/rad', {'kg': 1, 'm': 2, 's': -2, 'rad': -1}),
        ('m/s^2', {'m': 1, 's': -2}),
        ('1', {}),
        ('N/(m/s)', None),
        ('m or rad', None),
        ('J', {'kg': 1, 'm': 2, 's': -2}),
    ],
)
def test_units_have_the_exponents_of_their_bases(unit, expected):
    assert exponents(unit) == expected
