"""Every command of the tutorial runs as it is written."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import pytest

from mbd_sim_ros.commands.main import main

ROOT = Path(__file__).parents[2]
TUTORIAL = ROOT / 'docs' / 'tutorial.md'
EXAMPLES = ('step_steer', 'real_car', 'real_car.yaml', 'limits.yaml')  # come with the repository


@pytest.mark.slow
def test_every_command_of_the_tutorial_succeeds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'bags').mkdir()
    for name in EXAMPLES:
        source = ROOT / 'bags' / name
        (shutil.copytree if source.is_dir() else shutil.copy)(source, tmp_path / 'bags' / name)
    blocks = re.findall(r'```bash\n(.*?)```', TUTORIAL.read_text(encoding='utf-8'), re.DOTALL)
    commands = [line for block in blocks for line in block.splitlines()]
    assert {command.split()[1] for command in commands} >= {'run', 'view', 'compare', 'evaluate', 'sweep', 'export', 'replay'}
    for command in commands:
        program, *arguments = shlex.split(command, comments=True)
        promised = re.search(r'# exit code (\d)$', command)
        assert program == 'mbd'
        code = main(arguments)
        said = capsys.readouterr()
        assert code == (int(promised[1]) if promised else 0), f'{command}: {said.out}{said.err}'
        assert said.out, command
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
