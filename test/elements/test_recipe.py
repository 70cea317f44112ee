"""The recipe of docs/contributing.md, followed to the letter: a new force element and a new constraint are one file and
one entry each.

They are put into a copy of the program, which then knows them everywhere: files, outputs, energy, balances, references,
save and restore, recordings. Whoever forgets the entry, or a part of the contract, is told at once.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from program_copy import RECIPE, ROOT, changed, copied_program, mbd, run_there

MASS, GAIN, LAG, INPUT, SECONDS = 2.0, 5.0, 0.1, 0.8, 0.5
SCENE = f"""
mechanism:
  bodies:
    sledge: {{mass: {MASS}, inertia: [0.1, 0.1, 0.1]}}
  levels:
    runway: {{i: world, j: sledge}}
  pushers:
    motor: {{i: {{body: world, position: [-1, 0, 0]}}, j: sledge, input: drive, gain: {GAIN}, lag: {LAG}}}
maneuver: {{signals: {{drive: {INPUT}}}}}
integrator: {{h: 1.0e-3, mode: tolerance, rho_inf: 1}}
record: {{reactions: true}}
duration: {SECONDS}
"""
PROGRAM = """
import json, sys
from pathlib import Path
from mbd_sim_ros.batch import simulate
from solver import load_scene, simulation_of
scene = load_scene(sys.argv[1])
simulation = simulation_of(scene)
out = Path(sys.argv[2])
run = simulate(simulation, scene.steps, directory=out / 'bag', balance=True)
last = simulation.snapshot()
saved = simulation.save()
ahead = simulation.advance(5).numbers.tobytes()
simulation.restore(saved)
reference = simulation_of(load_scene(sys.argv[1], ['integrator.kind=reference_kkt', 'integrator.tolerance=1e-10']))
found = {
    'elements': dict(zip(simulation.channels.elements, last.elements.tolist())),
    'reactions': dict(zip(simulation.channels.reactions, last.reactions.tolist())),
    'x': float(last.pose[0, 0]), 'z': float(last.pose[0, 2]),
    'energy_error': run['energy_error_max'], 'balance': run['energy_by_kind'],
    'repeats': simulation.advance(5).numbers.tobytes() == ahead,
    'reference_x': float(reference.advance(scene.steps).pose[0, 0]),
    'described': simulation.describe(), 'inputs': list(simulation.channels.inputs),
}
print(json.dumps(found))
"""
FORCE_ENTRY, CONSTRAINT_ENTRY = ('pusher', 'PUSHERS', '    SPRING_DAMPERS,\n'), ('level', 'LEVELS', '    JOINTS,\n')


def program(directory: Path, *, entries=(FORCE_ENTRY, CONSTRAINT_ENTRY)) -> Path:
    """A copy of the program with the new files, and these entries in the registry."""
    copied_program(directory)
    for module in ('pusher', 'level'):
        shutil.copy(RECIPE / f'{module}.py', directory / 'solver' / 'elements')
    registry = directory / 'solver' / 'elements' / 'registry.py'
    for module, name, after in entries:
        line = 'from solver.elements.spring_damper import'
        changed(registry, line, f'from solver.elements.{module} import {name}\n{line}')
        changed(registry, after, f'{after}    {name},\n')
    (directory / 'scene.yaml').write_text(SCENE)
    return directory


@pytest.mark.long
@pytest.mark.slow
def test_a_kind_that_follows_the_recipe_is_known_everywhere(tmp_path):
    """Position: the closed form of a force with a lag; x to second order of the method, 1e-6 m at 1 ms; the reaction is
    the weight."""
    directory = program(tmp_path)
    done = run_there(directory, '-c', PROGRAM, 'scene.yaml', str(directory), MBD_CACHE_DIR=str(tmp_path / 'cache'))
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    grown = 1.0 - np.exp(-SECONDS / LAG)
    x = GAIN * INPUT / MASS * (SECONDS**2 / 2 - LAG * SECONDS + LAG**2 * grown)
    assert found['x'] == pytest.approx(x, abs=1e-6)
    assert found['reference_x'] == pytest.approx(x, abs=1e-8)
    assert found['z'] == pytest.approx(0.0, abs=1e-9)
    assert found['reactions']['runway'] == pytest.approx(MASS * 9.81, rel=1e-9)
    assert found['elements']['motor/force'] == pytest.approx(GAIN * INPUT * grown, rel=1e-5)
    assert found['elements']['motor/length'] == pytest.approx(1.0 + found['x'], rel=1e-12)
    work = found['balance']['pushers']
    speed = GAIN * INPUT / MASS * (SECONDS - LAG * grown)
    assert work['supplied'] == pytest.approx(MASS * speed**2 / 2, rel=1e-4)
    assert abs(work['error']) < 1e-4 * work['supplied']
    assert found['energy_error'] < 1e-4 * work['supplied']
    assert found['repeats']
    assert found['inputs'] == ['drive']
    assert found['described']['force_elements'] == 1
    assert found['described']['levels'] == 1
    assert found['described']['internal_states'] == 1
    assert found['described']['dof'] == 5

    exported = mbd(directory, 'export', 'bag', '--csv', 'csv', MBD_CACHE_DIR=str(tmp_path / 'cache'))
    assert exported.returncode == 0, exported.stderr
    header = (directory / 'csv' / 'element_states.csv').read_text().splitlines()[0]
    assert 'motor/force' in header


@pytest.mark.slow
def test_the_test_that_comes_with_the_element_passes(tmp_path):
    """It stands where the recipe puts it, beside the support of all tests."""
    directory = program(tmp_path)
    test = tmp_path / 'test' / 'elements' / 'test_pusher.py'
    test.parent.mkdir(parents=True)
    shutil.copy(RECIPE / 'test_pusher.py', test)
    shutil.copy(ROOT / 'test' / 'conftest.py', test.parents[1])
    shutil.copytree(ROOT / 'test' / 'support', tmp_path / 'test' / 'support')
    done = run_there(
        directory, '-m', 'pytest', '-q', '-p', 'no:cacheprovider', str(test), MBD_CACHE_DIR=str(tmp_path / 'cache')
    )
    assert done.returncode == 0, done.stdout
    assert '4 passed' in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize('kept', [FORCE_ENTRY, CONSTRAINT_ENTRY])
def test_a_forgotten_entry_is_an_error_with_a_name(tmp_path, kept):
    """The section is unknown; nothing is computed."""
    directory = program(tmp_path, entries=(kept,))
    done = mbd(directory, 'info', 'scene.yaml')
    missing = {'pusher': 'levels', 'level': 'pushers'}[kept[0]]
    assert done.returncode == 2
    assert f'mechanism.{missing}: unknown key' in done.stderr


BROKEN = (
    ('pusher', 'now, effects, out', 'now, out', 'must have the arguments'),
    (
        'pusher',
        "'energy': 'J', 'dissipation': 'W'",
        "'dissipation': 'W', 'energy': 'J'",
        'the first two outputs must be energy',
    ),
    ('pusher', 'supplies=True', "effort='torque'", "effort = 'torque' is no output"),
    ('pusher', "name='pushers'", "name='bushings'", "the name 'bushings' is used twice"),
    ('pusher', 'supplies=True', 'wheels=True', 'wheels must come last'),
    ('level', 'lam, Kq, Kv', 'lam, Kq', 'must have the arguments'),
)
IMPORTS = """
import importlib, json, sys
from pathlib import Path
said = []
for module, was, becomes, _ in [('level', '', '', ''), *json.loads(sys.argv[1])]:
    path = Path('solver/elements') / f'{module}.py'
    text = path.read_text()
    assert was in text
    path.write_text(text.replace(was, becomes, 1))
    for name in ('registry', 'pusher', 'level'):
        sys.modules.pop(f'solver.elements.{name}', None)
    importlib.invalidate_caches()
    try:
        importlib.import_module('solver.elements.registry')
    except Exception as error:
        said.append(f'{type(error).__name__}: {error}')
    else:
        said.append('')
    path.write_text(text)
print(json.dumps(said))
"""


@pytest.fixture(scope='module')
def refusals(tmp_path_factory):
    """What the import of the registry says: as the recipe has it, and with each of BROKEN. All in one process, without
    byte code, whose age is told in seconds."""
    directory = program(tmp_path_factory.mktemp('broken'))
    done = run_there(directory, '-B', '-c', IMPORTS, json.dumps(BROKEN))
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_kinds_that_keep_the_contract_are_imported(refusals):
    assert refusals[0] == ''


@pytest.mark.parametrize('number', range(len(BROKEN)), ids=[f'{name}: {becomes}' for name, _, becomes, _ in BROKEN])
def test_a_kind_that_breaks_the_contract_is_refused_at_import(refusals, number):
    assert BROKEN[number][-1] in refusals[1 + number]
