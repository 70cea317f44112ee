"""Copies of the program that a test may change, and processes that run in them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
RECIPE = ROOT / 'test' / 'data' / 'recipe'  # the files of docs/contributing.md


def copied_program(directory: Path) -> Path:
    """Both packages, the data and the settings of the tools, copied into a directory; returns it."""
    for package in ('solver', 'mbd_sim_ros', 'config'):
        # with times and byte code, which holds for what is not changed
        shutil.copytree(ROOT / package, directory / package)
    shutil.copy(ROOT / 'pyproject.toml', directory)
    return directory


def changed(file: Path, was: str, becomes: str) -> None:
    """Replace the only occurrence of a text in a file."""
    text = file.read_text(encoding='utf-8')
    assert text.count(was) == 1, f'{file}: {text.count(was)} times {was!r}'
    file.write_text(text.replace(was, becomes), encoding='utf-8')


def run_there(directory: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run Python with the packages of a directory, in it. Options of the tests that are running, as colcon has them,
    are not its own."""
    own = {**os.environ, 'PYTHONPATH': str(directory), 'PYTEST_ADDOPTS': '', **environment}
    return subprocess.run(
        [sys.executable, *arguments], cwd=directory, env=own, capture_output=True, text=True, timeout=300, check=False
    )


def mbd(directory: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run `mbd` of the program in a directory."""
    return run_there(directory, '-m', 'mbd_sim_ros.commands.main', *arguments, **environment)
