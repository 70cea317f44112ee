"""The native library gives the bits of a run in a process without Python, and answers everything by a code."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mbd_sim_ros.commands.main import main
from mbd_sim_ros.native import kernels, library
from mbd_sim_ros.native.kernels import compiled, target
from mbd_sim_ros.native.model import FIELDS, native, require_native
from solver import load_scene, simulation_of
from solver.errors import MbdError, SpecError
from solver.inputs.command_filter import CommandSource

HERE = Path(__file__).parent
# An adapting mechanism with driven motions, a car with tires, road and relaxation, one step per millisecond without
# adaptation, error control, fourth order.
SCENES = {
    'slider_crank': [],
    'car_step_steer': [],
    'constant': ['integrator.step_policy=constant'],
    'by_error': ['integrator.step_policy=error'],
    'fourth': ['integrator.order=4', 'integrator.rho_inf=1'],
    'torque_free_top': [],
    'rescued': ['integrator.h=0.1'],
}
ENVIRONMENT = {'GLIBC_TUNABLES': 'glibc.malloc.tcache_count=0'}
FIRST = 16 + 32  # bytes before the fields: magic and digest


def scene_of(name: str):
    """The scene of an entry of SCENES: variations are of the slider crank."""
    return load_scene(name if not SCENES.get(name) else 'slider_crank', SCENES.get(name, []))


@pytest.fixture(scope='module')
def built(tmp_path_factory) -> Path:
    """A directory with library, models and driver."""
    there = tmp_path_factory.mktemp('native')
    called = {}
    for name in SCENES:
        made = native(simulation_of(scene_of(name)), 'test')
        (there / f'{name}.mbd').write_bytes(made.content)
        called.update({kernel.name: kernel for kernel in made.kernels})
    library.build(called.values(), target('v3'), there / library.NAME)
    library.copy_sources(there)
    compile_c(HERE / 'driver.c', there / 'driver', there)
    return there


def compile_c(source: Path, program: Path, there: Path) -> None:
    """Compile a C program against the library, without a warning."""
    command = [library.compiler(), '-std=c11', '-O2', '-Wall', '-Wextra', '-Werror', str(source), '-o', str(program)]
    command += [f'-I{there}', f'-I{library.HERE}', f'-L{there}', '-lmbd', '-lm', '-lpthread', f'-Wl,-rpath,{there}']
    subprocess.run(command, check=True, timeout=120)


def driver(there: Path, *arguments: object) -> list[str]:
    """Lines that the driver prints; a crash of it is an error. Freed memory is counted as free at once: without the
    cache that glibc keeps for every thread."""
    command = [str(there / 'driver'), arguments[0], str(there / f'{arguments[1]}.mbd'), *map(str, arguments[2:])]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, env=ENVIRONMENT)
    assert done.returncode in (0, 1), done
    return done.stdout.splitlines()


def digest(simulation) -> str:
    """As the driver prints it."""
    return f'{simulation.k} {hashlib.sha256(simulation.snapshot().numbers.tobytes()).hexdigest()[:32]}'


@pytest.mark.parametrize('name', SCENES)
def test_a_program_in_c_gives_the_bits_of_a_run(built, name):
    simulation = simulation_of(scene_of(name))
    for _ in range(20):
        simulation.advance(10)
    lines = driver(built, 'run', name, 200, 17)
    assert lines[0] == digest(simulation)
    if name == 'rescued':
        assert simulation.totals()['events'] > 0  # steps were divided, in C as well
    values = {line.split('|')[1]: float.fromhex(line.split('|')[3]) for line in lines[2:]}
    totals = simulation.totals()
    assert values['steps'] == 200 and values['iterations'] == totals['iterations']
    assert values['events'] == totals['events'] and values['smallest_step'] == totals['smallest_step']
    assert values['account/worst'] == totals['energy_error_max']
    assert values['residual_max'] == totals['residual_max']


def test_nothing_of_python_is_in_the_library(built):
    told = subprocess.run(['nm', '-D', str(built / library.NAME)], capture_output=True, text=True, check=True).stdout
    undefined = [line.split()[-1] for line in told.splitlines() if ' U ' in line]
    assert undefined and not [name for name in undefined if name.startswith(('Py', '_Py', 'numba', 'NRT'))]
    exported = [line.split()[-1] for line in told.splitlines() if ' T ' in line]
    assert 'mbd_step' in exported and all(name.startswith('mbd_') for name in exported)


def test_a_kernel_is_the_same_code_however_its_process_has_numbered_it(built, monkeypatch):
    """numba counts its symbols while it compiles; neither the number nor a text that names it is in a library."""
    kernel = next(k for k in compiled().values() if k.name.startswith('linear.elimination.solve'))
    code, wanted = kernels.optimised(kernel.result), target('v3')
    symbol, renumbered = kernel.result.fndesc.llvm_func_name, {}

    def other(found):
        return f'B5v{renumbered.setdefault(found[1], 9000 - len(renumbered))}'

    named = SimpleNamespace(fndesc=SimpleNamespace(llvm_func_name=kernels.NUMBER.sub(other, symbol)))
    again = kernels.NUMBER.sub(other, code)
    assert again != code and kernels.NUMBER.search(symbol)
    before = kernels._emitted(kernel, wanted)
    monkeypatch.setattr(kernels, 'optimised', lambda _: again)
    assert kernels._emitted(kernel._replace(result=named), wanted) == before
    assert b'NumbaEnv' not in (built / library.NAME).read_bytes()


def test_a_state_goes_on_in_another_process(built):
    simulation = simulation_of(scene_of('car_step_steer'))
    simulation.advance(150)
    state = built / 'state'
    driver(built, 'save', 'car_step_steer', 63, state)
    assert driver(built, 'restore', 'car_step_steer', 87, state) == [digest(simulation)]
    again = built / 'again'
    driver(built, 'save', 'car_step_steer', 63, again)
    assert state.read_bytes() == again.read_bytes()  # no address is in it
    assert driver(built, 'restore', 'slider_crank', 1, state)[0].startswith('code 8: ')


def test_two_models_in_two_threads_know_nothing_of_each_other(built):
    simulation = simulation_of(scene_of('car_step_steer'))
    simulation.advance(200)
    assert driver(built, 'threads', 'car_step_steer', 200) == [digest(simulation)] * 2


@pytest.mark.slow
def test_models_that_are_made_and_freed_leave_nothing(built):
    """The bytes that the allocator counts as given out are the same behind 300 cycles; one that keeps 64 is seen."""
    assert driver(built, 'cycle', 'slider_crank', 300) == ['grown 0 bytes']
    assert int(driver(built, 'cycle', 'slider_crank', 300, 64)[0].split()[1]) >= 300 * 64


VALGRIND = ('valgrind', '-q', '--error-exitcode=9', '--leak-check=full', '--errors-for-leak-kinds=all')


@pytest.mark.slow
@pytest.mark.skipif(shutil.which('valgrind') is None, reason='valgrind is not installed')
def test_nothing_is_read_beside_memory_and_nothing_is_kept(built):
    """As valgrind sees it; it lacks instructions that steps of the full car have. What is kept on purpose is seen."""
    trials = [
        ('run', 60, 7),
        ('cycle', 1),
        ('fuzz', 20),
        ('fuzz', 20, 'state'),
        ('places', 40, FIRST, FIRST + 8 * len(FIELDS)),
    ]
    state = built / 'watched'
    for what, *numbers in (*trials, ('save', 20, state), ('restore', 20, state)):
        command = [*VALGRIND, str(built / 'driver'), what, str(built / 'slider_crank.mbd'), *map(str, numbers)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        assert (done.returncode, done.stderr) == (0, ''), what
    command = [*VALGRIND, str(built / 'driver'), 'cycle', str(built / 'slider_crank.mbd'), '1', '64']
    assert subprocess.run(command, capture_output=True, timeout=120, check=False).returncode == 9


@pytest.mark.slow
@pytest.mark.parametrize('state', [(), ('state',)], ids=['model', 'state'])
def test_what_is_damaged_is_refused(built, state):
    taken, damaged, version = driver(built, 'fuzz', 'slider_crank', 500, *state)[0].split()[1::2]
    assert (int(taken), int(version)) == (0, 0) and int(damaged) > 450


@pytest.mark.slow
def test_places_beside_the_file_are_refused_though_the_digest_fits(built):
    """Some of the fields are numbers that may be others; of the places nearly all that are drawn are wrong."""
    fields = np.frombuffer((built / 'slider_crank.mbd').read_bytes()[FIRST : FIRST + 8 * len(FIELDS)], np.int64)
    at = dict(zip(FIELDS, fields.tolist(), strict=True))
    assert int(driver(built, 'places', 'slider_crank', 300, FIRST, FIRST + 8 * len(FIELDS))[0].split()[1]) > 200
    for part, words in (('fixups', 4), ('variables', 4), ('kernels', 1)):
        begin = at[f'{part}_at']
        told = driver(built, 'places', 'slider_crank', 100, begin, begin + 8 * words * at[part])[0]
        assert int(told.split()[1]) > 40, part


def test_inputs_that_make_no_sense_are_refused_by_name(built):
    assert 'input steering is not finite' in driver(built, 'run', 'car_step_steer', 1, 1, 'steering', 'nan')[0]
    assert 'no variable is not an input' in driver(built, 'run', 'car_step_steer', 1, 1, 'stearing', 1)[0]
    assert 'odom/pose/x is not an input' in driver(built, 'run', 'car_step_steer', 1, 1, 'odom/pose/x', 1)[0]
    told = driver(built, 'run', 'car_step_steer', 1, 1, 'steering_rate', 1)[0]
    assert told.endswith('steering_rate is part of a prescribed motion: set it with mbd_set_motion()')


def test_the_steering_command_passes_the_filter_of_the_node(built):
    simulation = simulation_of(scene_of('car_step_steer'))
    names = simulation.channels.inputs
    commands = CommandSource(names, simulation.h_ns)
    for _ in range(120):
        simulation.advance(1, commands.advance(0.7, 0.0, 300.0))
    given = ('steering', 0.7, 'drive_torque', 0.0, 'brake_torque', 300.0)
    assert driver(built, 'run', 'car_step_steer', 120, 120, *given)[0] == digest(simulation)


def test_a_maneuver_that_has_ended_is_told_unless_it_stays_as_it_is(built):
    ending = simulation_of(load_scene('car_swept_steer', ['duration=0.05']))
    (built / 'ending.mbd').write_bytes(native(ending).content)
    told = driver(built, 'run', 'ending', 100, 10)
    assert told[0].startswith('code 9 at 50: the maneuver of the scene ends at 0.05 s, and input ')
    assert driver(built, 'run', 'slider_crank', 10_001, 1000)[0].startswith('10001 ')  # its scene has 10000 steps


@pytest.mark.parametrize(
    ('name', 'settings', 'sentence'),
    [
        ('car_lane_change', [], r'maneuver: the scene has a driver, in Python alone.* \(--set maneuver.driver=null\)'),
        ('saloon_with_trailer', [], r'the scene has a speed that is kept, in Python.* \(--set maneuver.speed=null\)'),
        (
            'handling_course',
            [],
            r'has a driver and a speed that is kept, .* \(--set maneuver.driver=null --set maneuver.speed=null\)',
        ),
        pytest.param('car_step_steer', ['fidelity=single_track'], "fidelity = 'single_track'", marks=pytest.mark.slow),
        ('slider_crank', ['integrator.kind=reference_radau'], "integrator.kind = 'reference_radau'"),
    ],
)
def test_what_lives_in_python_is_refused_by_name(name, settings, sentence):
    with pytest.raises(SpecError, match=sentence):
        require_native(simulation_of(load_scene(name, settings)))


def test_without_a_c_compiler_there_is_one_sentence(monkeypatch):
    monkeypatch.setenv('PATH', '')
    monkeypatch.delenv('CC', raising=False)
    with pytest.raises(MbdError, match='no C compiler was found'):
        library.compiler()


def test_a_c_compiler_that_is_named_and_not_there_is_told(monkeypatch):
    monkeypatch.setenv('CC', 'no-such-compiler')
    with pytest.raises(MbdError, match="CC = 'no-such-compiler': no such program"):
        library.compiler()


@pytest.mark.slow
def test_the_command_writes_what_the_example_needs(built, tmp_path, capsys):
    """The example drives the full car as fast as the clock asks, and says how late it was."""
    assert main(['build', 'car_step_steer', '--out', str(tmp_path), '--json']) == 0
    assert '"status": "ok"' in capsys.readouterr().out
    assert (tmp_path / library.NAME).stat().st_size < 8_000_000
    compile_c(tmp_path / 'real_time.c', tmp_path / 'real_time', tmp_path)
    command = [str(tmp_path / 'real_time'), str(tmp_path / 'car_step_steer.mbd'), '0.5', '20']
    told = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True, env={}).stdout
    assert 'car_step_steer: 500 steps of 1 ms; at t = 0.5 s' in told
    assert 'late [us]: median' in told and 'verdict: ok' in told


@pytest.mark.slow
@pytest.mark.long
def test_all_delivered_scenes_have_the_same_bits(built, tmp_path):
    """Those with drivers by the inputs that these applied, and the full car at other levels of detail."""
    called, expected = {}, {}
    scenes: list[tuple[str, list[str]]] = [
        (path.stem, []) for path in sorted((HERE.parents[1] / 'config' / 'scenes').glob('*.yaml'))
    ]
    for scene, settings in [*scenes, *(('car_step_steer', [f'fidelity={level}']) for level in ('condensed', 'kc'))]:
        name = ' '.join([scene, *settings])
        simulation = simulation_of(load_scene(scene, settings))
        steps = min(200, simulation.scene.steps)
        shorter = simulation_of(load_scene(scene, [*settings, f'duration={steps * simulation.h!r}']))
        made = native(shorter, applied=shorter.sources.step_by_step)
        (tmp_path / f'{name}.mbd').write_bytes(made.content)
        called.update({kernel.name: kernel for kernel in made.kernels})
        simulation.advance(steps)
        expected[name] = digest(simulation)
    library.build(called.values(), target('v3'), tmp_path / library.NAME)
    shutil.copy(built / 'driver', tmp_path / 'driver')
    for name, known in expected.items():
        environment = {'LD_LIBRARY_PATH': str(tmp_path)}
        command = [str(tmp_path / 'driver'), 'run', str(tmp_path / f'{name}.mbd'), known.split()[0], '50']
        done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=60, check=False)
        assert done.stdout.splitlines()[0] == known, name
    assert len(expected) > 30
