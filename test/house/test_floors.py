"""The floors of the house: the map tells what import-linter checks, and import-linter refuses an import upwards."""

from __future__ import annotations

import ast
import re
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
from program_copy import ROOT, changed, copied_program, run_there
from scipy.sparse.csgraph import connected_components

LINT = (
    'import sys; from importlinter.cli import lint_imports_command; sys.argv = ["lint-imports", "--no-logo"]; '
    'lint_imports_command()'
)


def lint(directory: Path) -> tuple[int, str]:
    """Exit code and text of `lint-imports` over the packages of a directory."""
    done = run_there(directory, '-c', LINT)
    return done.returncode, ' '.join((done.stdout + done.stderr).split())


@pytest.mark.slow
def test_an_import_upwards_breaks_the_contract_by_name(tmp_path):
    """The copy passes as it is; with one planted line it does not, and the sentence names both ends."""
    pytest.importorskip('importlinter', reason='comes with the extra dev')
    copied_program(tmp_path)
    code, text = lint(tmp_path)
    assert code == 0, text
    assert 'BROKEN' not in text
    first = 'from __future__ import annotations\n'
    changed(tmp_path / 'solver' / 'model' / 'frames.py', first, f'{first}\nfrom solver.simulation import Simulation\n')
    code, text = lint(tmp_path)
    assert code == 1
    assert 'solver.model is not allowed to import solver.simulation' in text
    assert 'solver.model.frames -> solver.simulation' in text


@pytest.mark.slow
def test_only_commands_import_the_lab(tmp_path):
    pytest.importorskip('importlinter', reason='comes with the extra dev')
    copied_program(tmp_path)
    first = 'from __future__ import annotations\n'
    changed(tmp_path / 'mbd_sim_ros' / 'batch.py', first, f'{first}\nfrom mbd_sim_ros.lab.studies import STUDIES\n')
    code, text = lint(tmp_path)
    assert code == 1
    assert 'mbd_sim_ros.batch -> mbd_sim_ros.lab.studies' in text


@pytest.mark.slow
def test_a_room_that_no_floor_names_breaks_the_contract(tmp_path):
    pytest.importorskip('importlinter', reason='comes with the extra dev')
    copied_program(tmp_path)
    shutil.copytree(tmp_path / 'solver' / 'inputs', tmp_path / 'solver' / 'cellar')
    code, text = lint(tmp_path)
    assert code != 0
    assert 'cellar' in text


def circles(directory: Path) -> list[set[str]]:
    """Groups of files that import each other, by imports of any kind: at the top, within functions, for hints."""
    files = {
        '.'.join(path.relative_to(directory).with_suffix('').parts).removesuffix('.__init__'): path
        for path in python_files(directory)
    }
    names = list(files)
    reach = np.zeros((len(names), len(names)), bool)
    for k, (module, path) in enumerate(files.items()):
        for node in ast.walk(ast.parse(path.read_bytes())):
            found = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.module and not node.level:
                whole = [f'{node.module}.{alias.name}' for alias in node.names]
                found = [name if name in files else node.module for name in whole]
            reach[k, [names.index(name) for name in found if name in files and name != module]] = True
    count, label = connected_components(reach, connection='strong')
    groups = [{names[k] for k in np.flatnonzero(label == group)} for group in range(count)]
    return [group for group in groups if len(group) > 1]


def python_files(directory: Path) -> list[Path]:
    """Of both packages."""
    return [path for package in ('solver', 'mbd_sim_ros') for path in sorted((directory / package).rglob('*.py'))]


def test_no_file_imports_itself_by_a_way_around(tmp_path):
    """Not here; in a copy with one import within a function and one for hints there are both."""
    assert circles(ROOT) == []
    for path in python_files(ROOT):
        target = tmp_path / path.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, target)
    with (tmp_path / 'solver' / 'inputs' / 'signals.py').open('a') as file:
        file.write('\n\ndef planted():\n    from solver.inputs.maneuver import Maneuver\n\n    return Maneuver\n')
    with (tmp_path / 'mbd_sim_ros' / 'messages' / 'cdr.py').open('a') as file:
        file.write('\n\nif TYPE_CHECKING:\n    from mbd_sim_ros.messages.encode import Messages\n')
    found = circles(tmp_path)
    assert any({'solver.inputs.signals', 'solver.inputs.maneuver'} <= group for group in found)
    assert any({'mbd_sim_ros.messages.cdr', 'mbd_sim_ros.messages.encode'} <= group for group in found)


def test_the_map_shows_the_floors_that_are_checked():
    """docs/README.md: one line per floor, in the order of the contracts, and nothing else in its tables of floors."""
    contracts = tomllib.loads((ROOT / 'pyproject.toml').read_text(encoding='utf-8'))['tool']['importlinter'][
        'contracts'
    ]
    floors = {contract['containers'][0]: contract['layers'] for contract in contracts if 'containers' in contract}
    page = (ROOT / 'docs' / 'README.md').read_text(encoding='utf-8')
    tables = re.findall(r'\| floor \| what is there \|\n\|---\|---\|\n((?:\|.*\n)+)', page)
    shown = [
        [' | '.join(re.findall(r'`(\w+)`', line.split('|')[1])) for line in table.splitlines()] for table in tables
    ]
    assert shown == [floors['mbd_sim_ros'], floors['solver']]


@pytest.mark.parametrize('package', ['solver', 'mbd_sim_ros'])
def test_tests_lie_in_folders_named_like_those_they_test(package):
    """Every room with files of its own has its folder of tests."""
    rooms = {path.name for path in (ROOT / package).iterdir() if path.is_dir() and (path / '__init__.py').is_file()}
    there = {path.name for path in (ROOT / 'test').iterdir() if path.is_dir()}
    assert rooms - there - {'model'} == set()  # test/physics, elements and step see nothing but the model at work
