"""The recipes of docs/contributing.md for a suspension, a check, a command, a topic and a study, followed in a copy of
the program.

Those for elements and constraints: test/elements/test_recipe.py.
"""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
from program_copy import RECIPE, ROOT, changed, copied_program, mbd, run_there

PAGE = (ROOT / 'docs' / 'contributing.md').read_text(encoding='utf-8')
STANDING = """
import json
from solver import load_scene, simulation_of
changes = ['vehicle.rear=sliding_pillar.yaml', 'start={kind: equilibrium}', 'maneuver=maneuvers/straight_ahead.yaml']
simulation = simulation_of(load_scene('car_step_steer', changes))
shot = simulation.advance(1)
print(json.dumps({**simulation.describe(), 'loads': shot.tire[:, 2].tolist(), 'wheels': simulation.channels.wheels}))
"""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    return copied_program(tmp_path)


def test_every_file_of_the_recipes_is_linked_from_the_page():
    linked = set(re.findall(r'\]\(\.\./test/data/recipe/([\w.]+)\)', PAGE))
    assert linked == {path.name for path in RECIPE.iterdir() if path.is_file()}


@pytest.mark.long
@pytest.mark.slow
def test_a_suspension_is_one_file_and_one_name(program):
    """Arm and links of the multi-link axle are gone, and the car stands: the tires carry its weight, left and right
    alike."""
    shutil.copy(RECIPE / 'sliding_pillar.py', program / 'solver' / 'vehicle')
    shutil.copy(RECIPE / 'sliding_pillar.yaml', program)
    arguments = ('info', 'car_step_steer', '--brief', '--set', 'vehicle.rear=sliding_pillar.yaml')
    forgotten = mbd(program, *arguments)
    assert forgotten.returncode == 2
    assert 'vehicle.rear' in forgotten.stderr and 'sliding_pillar' in forgotten.stderr
    template = program / 'solver' / 'vehicle' / 'axle.py'
    last = 'from solver.vehicle.parts import LEFTWARDS, UP, Bushing, Corner, Part, Parts, Structure, joined, mounting\n'
    changed(template, last, f'{last}from solver.vehicle.sliding_pillar import SlidingPillar\n')
    changed(template, 'TwistBeam | LiveAxle\n', 'TwistBeam | LiveAxle | SlidingPillar\n')
    done = run_there(program, '-c', STANDING)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found['bodies'] == 53 - 2 * 4  # arm and three links
    loads = dict(zip(found['wheels'], found['loads'], strict=True))
    assert sum(loads.values()) == pytest.approx(9.81 * found['mass'], rel=1e-3)
    for axle in ('front', 'rear'):
        assert loads[f'{axle}_left'] == pytest.approx(loads[f'{axle}_right'], rel=0.02)  # the column is on the left
    assert found['redundant_constraints'] == 0


@pytest.mark.slow
def test_a_check_is_one_record_and_one_line(program):
    """The pendulum hangs 1 m below its pivot, wherever it swings: its key is refused before, and its table and sentence
    follow."""
    beyond = ('run', 'pendulum', '--no-record', '--json', '--duration', '0.1', '--set', 'require.strayed_max=0.5')
    assert 'strayed_max: unknown key' in mbd(program, *beyond).stdout
    shutil.copy(RECIPE / 'strayed.py', program / 'solver' / 'checks')
    registry = program / 'solver' / 'checks' / 'registry.py'
    last = 'from solver.checks.speed import REAL_TIME_FACTOR_MIN\n'
    changed(registry, last, f'{last}from solver.checks.strayed import STRAYED\n')
    changed(registry, '    ENVELOPE,\n)', '    ENVELOPE,\n    STRAYED,\n)')
    done = mbd(program, *beyond)
    assert done.returncode == 1, done.stderr
    (found,) = json.loads(done.stdout)['findings']
    assert (found['quantity'], found['required'], found['where']) == ('strayed_max', True, "body 'bob'")
    assert found['text'] == (
        f"Body 'bob' has strayed from the origin (strayed_max {found['value']:.3g} m, required 0.5 m). Hold it, or end "
        'the run before'
    )
    assert mbd(program, *beyond[:-1], 'require.strayed_max=100').returncode == 0
    made = run_there(
        program, '-c', f'import runpy; print(runpy.run_path({str(ROOT / "docs/tools/checks.py")!r})["table"]())'
    )
    assert '| `strayed_max` | m | none; distance of a body' in made.stdout


@pytest.mark.slow
def test_a_command_is_one_file_and_its_name(program):
    shutil.copy(RECIPE / 'weigh.py', program / 'mbd_sim_ros' / 'commands')
    assert 'weigh' not in mbd(program, '--help').stdout
    main = program / 'mbd_sim_ros' / 'commands' / 'main.py'
    changed(main, '    view,\n)', '    view,\n    weigh,\n)')
    changed(main, '    fmu,\n)\nUSAGE', '    fmu,\n    weigh,\n)\nUSAGE')
    assert re.search(r'^ +weigh +add up the masses of a scene$', mbd(program, '--help').stdout, re.MULTILINE)
    assert 'mbd weigh car_step_steer' in mbd(program, 'weigh', '--help').stdout
    done = mbd(program, 'weigh', 'pendulum', '--set', 'mechanism.bodies.bob.mass=2.5', '--json')
    assert (done.returncode, json.loads(done.stdout)) == (0, {'status': 'ok', 'mass': 2.5})
    wrong = mbd(program, 'weigh', 'pendulun')
    assert (wrong.returncode, wrong.stdout, wrong.stderr.count('\n')) == (2, '', 1)
    assert "did you mean 'pendulum'?" in wrong.stderr


@pytest.mark.slow
def test_a_topic_is_one_line(program):
    """The line stands in the page; what it publishes is recorded and read without further ado."""
    (line,) = re.findall(r'^```python\n(.*?)^```$', PAGE, re.MULTILINE | re.DOTALL)
    behind = "            self.scalars('tire_states', names, np.column_stack([s.tire[:, _LOAD], s.tire[:, _SLIP:]]))\n"
    changed(program / 'mbd_sim_ros' / 'messages' / 'composition.py', behind, behind + line)
    done = mbd(program, 'run', 'light_car_straight', '--duration', '0.02', '--out', 'bag', '--json')
    assert done.returncode == 0, done.stderr + done.stdout
    look = (
        'from mbd_sim_ros.bags.reader import read; run = read("bag")\nfor w in ("front_left", "front_right", '
        '"rear_left", "rear_right"):\n    assert (run[f"wheel_loads/{w}"] == run[f"tire_states/{w}/fz"]).all() and '
        'run[f"wheel_loads/{w}"].min() > 1000.0'
    )
    read = run_there(program, '-c', look)
    assert read.returncode == 0, read.stderr


@pytest.mark.slow
def test_an_evaluation_is_one_file_and_one_line(program):
    """A car that loses 0.25 m/s every second, from 22 m/s on; a faster one does not keep the limit, a short one is
    refused."""
    folder = program / 'mbd_sim_ros' / 'analysis' / 'evaluation'
    shutil.copy(RECIPE / 'coasting.py', folder)
    changed(folder / 'registry.py', '    braking,\n', '    braking,\n    coasting,\n')
    changed(folder / 'registry.py', '    ride.RIDE,\n', '    ride.RIDE,\n    coasting.COASTING,\n')
    for name, slope, seconds in (('slow', 0.25, 40), ('fast', 0.8, 40), ('short', 0.25, 10)):
        rows = ''.join(f'{0.1 * k:.1f},{22.0 - slope * 0.1 * k!r}\n' for k in range(10 * seconds))
        (program / f'{name}.csv').write_text('time [s],speed [m/s]\n' + rows)
    done = mbd(program, 'evaluate', 'slow.csv', 'fast.csv', '--as', 'coasting', '--json')
    assert done.returncode == 0, done.stderr
    slow, fast = json.loads(done.stdout)['results']
    assert slow['figures']['deceleration']['value'] == pytest.approx(0.25)
    assert (slow['passed'], fast['passed']) == (True, False)
    refused = mbd(program, 'evaluate', 'short.csv', '--as', 'coasting')
    assert refused.returncode != 0
    assert 'does not roll out from 20 to 15 m/s' in refused.stderr


@pytest.mark.long
@pytest.mark.slow
def test_a_study_is_one_file_and_one_entry(program):
    shutil.copy(RECIPE / 'swing.py', program / 'mbd_sim_ros' / 'lab' / 'studies')
    studies = program / 'mbd_sim_ros' / 'lab' / 'studies' / '__init__.py'
    last = "    'car': 'mbd_sim_ros.lab.studies.car',\n"
    changed(studies, last, f"{last}    'swing': 'mbd_sim_ros.lab.studies.swing',\n")
    listed = mbd(program, 'study', '--help').stdout
    assert re.search(r'^ +swing +energy error of a pendulum over the step$', listed, re.MULTILINE)
    done = mbd(program, 'study', 'swing', '--quick', '--strict', '--json', '--out', 'out')
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads(done.stdout)
    assert found['missed'] == []
    assert (program / 'out' / 'errors.png').stat().st_size > 1000
    assert '| order of the energy error |' in (program / 'out' / 'report.md').read_text()
