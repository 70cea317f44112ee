"""A Python module that is not installed, or does not load, is one sentence with module and remedy, and exit code 2, for
`mbd` and nodes."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from solver.errors import missing

ROOT = Path(__file__).parents[2]
ABSENT = "raise ModuleNotFoundError(\"No module named '{name}'\", name='{name}')"
MBD = ('-m', 'mbd_sim_ros.commands.main', 'run', 'pendulum', '--set', 'duration=0.01')
NODE = ('-m', 'mbd_sim_ros.node.main', '--ros-args', '-p', 'scene:=pendulum')


def run(command: tuple[str, ...], directory: Path, name: str, text: str = ABSENT) -> subprocess.CompletedProcess[str]:
    """A command whose module `name` is what `text` says."""
    (directory / f'{name}.py').write_text(text.format(name=name))
    environment = {
        **os.environ,
        'PYTHONPATH': f'{directory}:{ROOT}',
        'ROS_DOMAIN_ID': '59',
        'ROS_LOG_DIR': str(directory / 'log'),
    }
    return subprocess.run(
        [sys.executable, *command],
        cwd=directory,
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.mark.slow
@pytest.mark.parametrize('name', ['mcap', 'tqdm', 'numba', 'yaml'])
def test_a_module_that_is_missing_ends_a_command_in_one_sentence(name: str, tmp_path: Path) -> None:
    done = run(MBD, tmp_path, name)
    package = {'yaml': 'pyyaml'}.get(name, name)
    assert (done.returncode, done.stdout) == (2, '')
    assert re.fullmatch(
        f'mbd: the Python module {name} is missing: python -m pip install {package}, or, .*rosdep install .*\n',
        done.stderr,
    )


@pytest.mark.slow
@pytest.mark.parametrize('name', ['mcap', 'scipy', 'nav_msgs'])
def test_a_module_that_is_missing_ends_a_node_in_one_sentence(name: str, tmp_path: Path) -> None:
    """The adapter needs messages that the simulator has no need of before it publishes."""
    pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    command = ('-m', 'mbd_sim_ros.node.adapter') if name == 'nav_msgs' else NODE
    done = run(command, tmp_path, name)
    said = [line for line in done.stderr.splitlines() if not line.startswith('[')]  # rcl logs on its own
    assert done.returncode == 2 and len(said) == 1, done.stderr
    assert f'{name} is missing: ' in said[0] and ('pip install' in said[0])
    assert 'Traceback' not in done.stderr + done.stdout


@pytest.mark.slow
def test_versions_that_do_not_go_together_are_said_in_the_words_of_the_package(tmp_path: Path) -> None:
    done = run(
        (*MBD, '--json'), tmp_path, 'numba', "raise ImportError('Numba needs NumPy 1.26 or less. Got NumPy 2.4.')"
    )
    error = json.loads(done.stdout)['error']
    assert done.returncode == 2
    assert error.startswith(
        'a Python package does not load (Numba needs NumPy 1.26 or less. Got NumPy 2.4): python -m pip install '
        '--upgrade'
    )


@pytest.mark.parametrize('name', ['solver.nothing', 'mbd_sim_ros.bags.nothing'])
def test_a_module_of_ours_that_is_missing_is_a_defect(name: str) -> None:
    assert missing(ModuleNotFoundError(f'No module named {name!r}', name=name)) == ''
    assert missing(ImportError(f"cannot import name 'x' from {name!r}", name=name)) == ''


@pytest.mark.parametrize('name', ['rclpy', 'nav_msgs.msg', 'std_srvs', 'rcl_interfaces'])
def test_a_module_of_ros_is_not_installed_by_its_name(name: str) -> None:
    text = missing(ModuleNotFoundError(f'No module named {name!r}', name=name))
    assert text.startswith(f'{name.partition(".")[0]} is missing: source a ROS 2 Jazzy installation')
