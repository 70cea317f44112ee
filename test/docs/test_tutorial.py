"""Every command of the tutorial runs as it is written."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from mbd_sim_ros.commands.main import main

TUTORIAL = Path(__file__).parents[2] / 'docs' / 'tutorial.md'


@pytest.mark.slow
def test_every_command_of_the_tutorial_succeeds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r'```bash\n(.*?)```', TUTORIAL.read_text(encoding='utf-8'), re.DOTALL)
    commands = [line for block in blocks for line in block.splitlines()]
    assert {command.split()[1] for command in commands} >= {'run', 'view', 'compare', 'evaluate', 'sweep', 'replay'}
    for command in commands:
        program, *arguments = shlex.split(command)
        assert program == 'mbd'
        code = main(arguments)
        said = capsys.readouterr()
        assert code == 0, f'{command}: {said.out}{said.err}'
        assert said.out, command
    for name in ('step.html', 'compare.html', 'both.html', 'evaluation.html', 'mass/report.html', 'mass/sweep.parquet'):
        assert (tmp_path / 'out' / name).stat().st_size > 1000
