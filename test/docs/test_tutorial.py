"""Every command of the tutorial runs as it is written, in a shell."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TUTORIAL = ROOT / 'docs' / 'tutorial.md'
EXAMPLES = ('step_steer', 'real_car', 'real_car.yaml', 'limits.yaml')  # come with the repository


@pytest.mark.slow
def test_every_command_of_the_tutorial_succeeds(tmp_path: Path) -> None:
    (tmp_path / 'bags').mkdir()
    for name in EXAMPLES:
        source = ROOT / 'bags' / name
        (shutil.copytree if source.is_dir() else shutil.copy)(source, tmp_path / 'bags' / name)
    programs = tmp_path / 'programs'  # mbd of this checkout and interpreter, wherever it is installed
    programs.mkdir()
    (programs / 'mbd').write_text(f'#!/bin/sh\nexec "{sys.executable}" -m mbd_sim_ros.commands.main "$@"\n')
    (programs / 'mbd').chmod(0o755)
    paths = {'PATH': f'{programs}:{os.environ["PATH"]}', 'PYTHONPATH': f'{ROOT}:{os.environ.get("PYTHONPATH", "")}'}
    blocks = re.findall(r'```bash\n(.*?)```', TUTORIAL.read_text(encoding='utf-8'), re.DOTALL)
    commands = [line for block in blocks for line in block.splitlines()]
    assert {command.split()[1] for command in commands} >= {'run', 'view', 'compare', 'evaluate', 'sweep', 'export', 'replay'}
    for command in commands:
        promised = re.search(r'# exit code (\d)$', command)
        assert command.startswith('mbd ')
        done = subprocess.run(['bash', '-c', command], cwd=tmp_path, env=os.environ | paths, capture_output=True, text=True, check=False)
        assert done.returncode == (int(promised[1]) if promised else 0), f'{command}: {done.stdout}{done.stderr}'
        assert done.stdout, command
    for name in (
        'step.html',
        'compare.html',
        'both.html',
        'car.html',
        'evaluation.html',
        'step/imu.parquet',
        'mass/report.html',
        'mass/sweep.parquet',
    ):
        assert (tmp_path / 'out' / name).stat().st_size > 1000
