"""Every command of the tutorial runs as it is written: a shell makes words of it, and the program does what they
say."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from mbd_sim_ros.commands.main import main

ROOT = Path(__file__).parents[2]
TUTORIAL = ROOT / 'docs' / 'tutorial.md'
EXAMPLES = ('step_steer', 'real_car', 'real_car.yaml', 'limits.yaml')  # come with the repository


def words_of(command: str) -> list[str]:
    """The words that a shell makes of a line, in the directory at hand: quotes, patterns of files, comments."""
    program = f'mbd() {{ printf "%s\\0" mbd "$@"; }}\n{command}'
    done = subprocess.run(['bash', '-c', program], capture_output=True, text=True, check=True)
    return done.stdout.split('\0')[:-1]


@pytest.mark.slow
@pytest.mark.parametrize('samples', [4, pytest.param(32, marks=pytest.mark.long)])
def test_every_command_of_the_tutorial_succeeds(
    samples: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The cars of its sweep are fewer than the file has."""
    place = tmp_path / 'config' / 'sweeps'  # which comes before that of the program
    place.mkdir(parents=True)
    delivered = (ROOT / 'config' / 'sweeps' / 'step_steer_mass.yaml').read_text(encoding='utf-8')
    assert delivered.count('samples: 32,') == 1
    (place / 'step_steer_mass.yaml').write_text(delivered.replace('samples: 32,', f'samples: {samples},'))
    (tmp_path / 'bags').mkdir()
    for name in EXAMPLES:
        source = ROOT / 'bags' / name
        (shutil.copytree if source.is_dir() else shutil.copy)(source, tmp_path / 'bags' / name)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv('PYTHONPATH', f'{ROOT}:{os.environ.get("PYTHONPATH", "")}')
    blocks = re.findall(r'```bash\n(.*?)```', TUTORIAL.read_text(encoding='utf-8'), re.DOTALL)
    commands = [line for block in blocks for line in block.splitlines()]
    assert {command.split()[1] for command in commands} >= {
        'run',
        'view',
        'compare',
        'evaluate',
        'sweep',
        'export',
        'replay',
    }
    for k, command in enumerate(commands):
        promised = re.search(r'# exit code (\d)$', command)
        words = words_of(command)
        assert words.pop(0) == 'mbd'
        # a process of its own, as all of them are for whoever follows; the others have what is imported here
        if k == 0:
            done = subprocess.run(
                [sys.executable, '-m', 'mbd_sim_ros.commands.main', *words], capture_output=True, text=True, check=False
            )
            code, said, complained = done.returncode, done.stdout, done.stderr
        else:
            code = main(words)
            said, complained = capsys.readouterr()
        assert code == (int(promised[1]) if promised else 0), f'{command}: {said}{complained}'
        assert said, command
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
