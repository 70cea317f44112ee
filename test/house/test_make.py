"""The Makefile before anything is made: which Python is taken, and which tests run."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from mbd_sim_ros.commands.main import parser

ROOT = Path(__file__).parents[2]
OLDER = """#!/bin/sh
exec {python} -c 'import sys; sys.version_info = (3, {minor}, 2, "final", 0); exec(sys.argv[1])' "$2"
"""


def make(*arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {name: value for name, value in os.environ.items() if not name.startswith('MAKE')}
    return subprocess.run(
        ['make', '-s', *arguments], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=20, check=False
    )


@pytest.mark.parametrize('minor', [8, 10])
@pytest.mark.parametrize('where', ['named', 'of the environment'])
def test_a_python_that_is_too_old_ends_make_setup_at_once(minor: int, where: str, tmp_path: Path) -> None:
    place = tmp_path / 'older' if where == 'named' else tmp_path / 'venv' / 'bin' / 'python'
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text(OLDER.format(python=sys.executable, minor=minor))
    place.chmod(0o755)
    named = place if where == 'named' else sys.executable
    for target in ('setup', 'runtime'):
        done = make(target, f'PYTHON={named}', f'VENV={tmp_path / "venv"}')
        assert done.returncode == 2
        assert done.stdout == (
            f'{place} is Python 3.{minor}, and 3.11 or newer is needed: name another one, e.g. make setup '
            f'PYTHON=python3.11, and remove {tmp_path}/venv if it was made with this one\n'
        )
    assert where != 'named' or not (tmp_path / 'venv').exists()


@pytest.mark.parametrize('name', ['python3.99', './nothing', '/bin/true', '/bin/false', '/etc/passwd'])
def test_a_name_that_is_no_python_ends_make_setup_at_once(name: str, tmp_path: Path) -> None:
    done = make('setup', f'PYTHON={name}', f'VENV={tmp_path / "venv"}')
    assert done.returncode == 2
    assert (
        done.stdout.startswith(f'{name} is no Python that can be started: name another one')
        and done.stdout.count('\n') == 1
    )


def test_each_target_brings_what_it_needs_and_no_more(tmp_path: Path) -> None:
    """Users have the program and ROS, and are told what to type next; lint and tests bring their own tools before they
    run."""
    venv = f'VENV={tmp_path / "venv"}'
    setup, runtime = make('-n', 'setup', venv).stdout, make('-n', 'runtime', venv).stdout
    assert "-e '.[ros]'" in setup or "-e '.'" in setup
    assert '[test' not in setup and ',test' not in setup and 'dev]' not in setup
    assert setup.rstrip().endswith('echo "$NEXT"') and 'NEXT' not in runtime and "-e '.'" in runtime
    for target in ('tools', 'lint', 'check', 'test', 'wheel'):
        done = make('-n', target, venv).stdout
        assert (
            'test,dev]' in done
            and done.index('test,dev]') < (done + '-m pytest').index('-m pytest')
            and 'NEXT' not in done
        ), target


def test_setup_ends_with_commands(tmp_path: Path) -> None:
    """What is there is not made anew; what is said then are commands."""
    (tmp_path / 'bin').mkdir()
    (tmp_path / 'bin' / 'python').symlink_to(sys.executable)
    (tmp_path / '.installed').touch()
    done = make('setup', f'VENV={tmp_path}')
    assert (done.returncode, done.stderr) == (0, '')
    told = [line.strip() for line in done.stdout.splitlines() if line.strip().startswith('mbd ')]
    assert len(told) == 3 and f'. {tmp_path}/bin/activate' in done.stdout
    for line in told:
        parser().parse_args(shlex.split(line, comments=True)[1:])


def test_what_runs_after_every_edit_has_no_test_that_a_release_waits_for() -> None:
    """What `make check` runs, `make test` runs too."""
    (chosen,) = [line for line in make('-n', 'check').stdout.splitlines() if 'pytest' in line]
    assert all(f'not {mark}' in chosen for mark in ('slow', 'realtime', 'long'))
