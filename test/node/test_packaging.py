"""The package as others get it: built by colcon, installed by pip, used away from the checkout."""

from __future__ import annotations

import ast
import os
import re
import runpy
import shutil
import subprocess
import sys
import sysconfig
import venv
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree
from zipfile import ZipFile

import pytest

ROOT = Path(__file__).parents[2]
PARTS = ('solver', 'mbd_sim_ros', 'config', 'docs', 'launch', 'resource', 'bags/step_steer', 'bags/real_car')
FILES = (
    'package.xml', 'setup.py', 'setup.cfg', 'pyproject.toml', 'README.md', 'CHANGELOG.rst',
    *(f'bags/{name}' for name in ('README.md', 'real_car.py', 'real_car.yaml', 'limits.yaml')),
)  # fmt: skip
# Away from the checkout: packages, message definitions and scene data are found, and they are those just installed.
CHECK = """
import os, sys
import mbd_sim_ros, solver
from mbd_sim_ros.messages.definitions import schema_text
from solver import load_scene
assert os.path.realpath(solver.__file__).startswith(os.path.realpath(sys.argv[1])), solver.__file__
assert 'float64[] effort' in schema_text('sensor_msgs/msg/JointState')
print(load_scene('pendulum').name)
"""


@pytest.fixture
def source(tmp_path):
    """A copy of the package, so that building leaves nothing in the checkout."""
    copy = tmp_path / 'src' / 'mbd_sim_ros'
    copy.mkdir(parents=True)
    for part in PARTS:
        shutil.copytree(ROOT / part, copy / part, ignore=shutil.ignore_patterns('__pycache__'))
    for name in FILES:
        shutil.copy(ROOT / name, copy / name)
    return copy


def run(command: list[str], directory: Path, **environment: str) -> str:
    own = {**os.environ, 'PATH': f'{Path(sys.executable).parent}:{os.environ["PATH"]}', **environment}
    own = {key: value for key, value in own.items() if value}
    done = subprocess.run(command, cwd=directory, env=own, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize('options', [[], ['--symlink-install']])
def test_colcon_builds_it(source, tmp_path, options):
    run(['colcon', '--log-base', str(tmp_path / 'log'), 'build', *options], tmp_path, PYTHONPATH='')
    prefix = tmp_path / 'install' / 'mbd_sim_ros'
    for name in ('simulator', 'maneuver', 'mbd'):  # where `ros2 run` looks
        assert os.access(prefix / 'lib' / 'mbd_sim_ros' / name, os.X_OK)
    for name in (
        'launch/sim.launch.py',
        'config/node.yaml',
        'config/scenes/pendulum.yaml',
        'package.xml',
        'docs/conventions.md',
        'bags/real_car.yaml',
    ):
        assert (prefix / 'share' / 'mbd_sim_ros' / name).is_file()
    assert (prefix / 'share/ament_index/resource_index/packages/mbd_sim_ros').is_file()
    setup = f'source {tmp_path}/install/local_setup.bash && exec "$@"'
    assert (
        run(['bash', '-c', setup, '-', sys.executable, '-c', CHECK, str(tmp_path)], tmp_path / 'log', PYTHONPATH='')
        == 'pendulum\n'
    )


@pytest.mark.slow
def test_pip_installs_it_without_ros(source, tmp_path):
    """Into a new environment that sees the dependencies of this one, but not this checkout."""
    venv.create(tmp_path / 'venv', with_pip=False)
    python = tmp_path / 'venv' / 'bin' / 'python'
    site = sysconfig.get_path('purelib', vars={'base': str(tmp_path / 'venv'), 'platbase': str(tmp_path / 'venv')})
    (Path(site) / 'dependencies.pth').write_text(sysconfig.get_path('purelib') + '\n')
    pip = [
        sys.executable,
        '-m',
        'pip',
        '--python',
        str(python),
        'install',
        '--quiet',
        '--no-deps',
        '--no-build-isolation',
        '--no-index',
        '.',
    ]
    run(pip, source, PYTHONPATH='')
    assert run([str(python), '-c', CHECK, str(tmp_path)], tmp_path / 'venv', PYTHONPATH='') == 'pendulum\n'
    assert 'mbd COMMAND --help' in run([str(python.parent / 'mbd'), '--help'], tmp_path / 'venv', PYTHONPATH='')
    assert not (Path(site) / 'test').exists() and not (Path(site) / 'config').exists()
    lab = Path(site) / 'mbd_sim_ros' / 'lab'
    assert (
        (lab / 'studies' / 'trade.py').exists() and not (lab / 'mechanisms').exists() and not list(lab.rglob('*.csv'))
    )
    shown = run([str(python.parent / 'mbd'), 'study', '--help'], tmp_path / 'venv', PYTHONPATH='')
    assert (
        re.search(r'^  trade +\w', shown, re.MULTILINE)
        and 'in a checkout of the source only:\n  slider_crank, ' in shown
    )
    words, own = [str(python.parent / 'mbd'), 'study', 'stability'], {**os.environ, 'PYTHONPATH': ''}
    done = subprocess.run(
        words, cwd=tmp_path / 'venv', env=own, capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert "study 'stability': proves the program to itself and is not installed; run it in a checkout" in done.stderr


@pytest.mark.slow
def test_the_wheel_holds_what_users_run_and_nothing_else(tmp_path):
    """.ci/wheel, as `make wheel` runs it, judges what is in it; one that lacks a file is refused by name."""
    shown = run(['bash', str(ROOT / '.ci' / 'wheel'), sys.executable, str(tmp_path)], tmp_path)
    (wheel,) = tmp_path.glob('*.whl')
    assert shown.startswith(f'{wheel}: ')
    names = ZipFile(wheel).namelist()
    assert f'mbd_sim_ros-{version_of()}.dist-info/METADATA' in names
    assert 'mbd_sim_ros/lab/studies/stability.py' not in names and 'mbd_sim_ros/lab/mechanisms/draft.py' not in names


def test_what_is_installed_imports_nothing_that_is_not():
    """Of the lab; and more of the lab stays behind than is installed."""
    is_installed = told()['is_installed']
    lines = {True: 0, False: 0}
    for path in sorted([*(ROOT / 'solver').rglob('*.py'), *(ROOT / 'mbd_sim_ros').rglob('*.py')]):
        module = '.'.join(path.relative_to(ROOT).with_suffix('').parts)
        if module.startswith('mbd_sim_ros.lab.'):
            lines[is_installed(module)] += len(path.read_text(encoding='utf-8').splitlines())
        if not is_installed(module):
            continue
        for node in ast.walk(ast.parse(path.read_bytes())):
            found = [f'{node.module}.{alias.name}' for alias in node.names] if isinstance(node, ast.ImportFrom) else []
            for name in [*found, *(one.rpartition('.')[0] for one in found)]:
                assert not (ROOT / Path(*name.split('.'))).with_suffix('.py').exists() or is_installed(name), (
                    f'{module} imports {name}'
                )
    assert lines[False] > lines[True] > 1000


def test_manifest_names_what_is_imported():
    """package.xml depends on every ROS package that the code imports."""
    manifest = ElementTree.parse(ROOT / 'package.xml').getroot()
    declared = {element.text for element in manifest.iter('exec_depend')}
    imported = set()
    for path in [*(ROOT / 'mbd_sim_ros').rglob('*.py'), *(ROOT / 'launch').glob('*.py')]:
        for node in ast.walk(ast.parse(path.read_text())):
            names = (
                [a.name for a in node.names]
                if isinstance(node, ast.Import)
                else [node.module or '']
                if isinstance(node, ast.ImportFrom)
                else []
            )
            imported |= {name.split('.')[0] for name in names}
    ros = {
        name
        for name in imported
        if name.endswith(('_msgs', '_srvs', 'rclpy')) or name in ('launch', 'launch_ros', 'rcl_interfaces')
    }
    assert ros <= declared
    assert {'rclpy', 'sensor_msgs', 'launch_ros'} <= ros
    assert manifest.findtext('export/build_type') == 'ament_python'


def test_manifest_has_a_key_for_all_that_pip_installs():
    """Keys of rosdep: python3-NAME of the system, but for mcap, which only a package that is built on it brings."""
    declared = {element.text for element in ElementTree.parse(ROOT / 'package.xml').getroot().iter('exec_depend')}
    needed = {re.split(r'[<>=]', text)[0] for text in requirements()}
    assert {'numba', 'mcap', 'tqdm'} <= needed
    keys = {'pyyaml': 'python3-yaml', 'mcap': 'mcap-ros2-support', 'llvmlite': 'python3-numba'}
    assert {keys.get(name, f'python3-{name}') for name in needed} <= declared


def test_what_is_installed_is_in_the_ranges_that_have_been_tested():
    """And the ranges are closed: what is newer has not been tested."""
    ranges = {
        name: (low, high)
        for name, low, high in (re.fullmatch(RANGE, text).groups() for text in requirements() if '>=' in text)
    }
    assert {'numba', 'llvmlite', 'numpy', 'scipy', 'mcap'} <= ranges.keys()
    for name, (low, high) in ranges.items():
        assert number(low) <= number(version(name)) < number(high), name


RANGE = r'(\w+)>=([\d.]+),<([\d.]+)'


def number(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r'\d+', text)[:3])


def told() -> dict:
    """The names of setup.py, and as `options` what it tells setuptools."""
    options: dict = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr('setuptools.setup', lambda **given: options.update(given))
        patch.chdir(ROOT)
        return {**runpy.run_path(str(ROOT / 'setup.py')), 'options': options}


def requirements() -> list[str]:
    """What setup.py has installed with the package."""
    return told()['options']['install_requires']


def version_of() -> str:
    """The version that setup.py gives."""
    return told()['options']['version']


def test_the_page_on_ros_agrees_with_the_code():
    import importlib.util

    pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    spec = importlib.util.spec_from_file_location('ros_page', ROOT / 'docs' / 'tools' / 'ros.py')
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    text = module.FILE.read_text(encoding='utf-8')
    assert module.render(text) == text, 'run `python docs/tools/ros.py`'
