"""mbd list, and what the Tab key offers."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest

from mbd_sim_ros.commands.list import USES
from mbd_sim_ros.commands.main import COMMANDS, main
from mbd_sim_ros.commands.scene_keys import LEVELS
from mbd_sim_ros.lab.studies import installed, module, summary
from solver.files.catalogue import KINDS
from solver.scene import Fidelity


def listed(capsys: pytest.CaptureFixture[str], *kinds: str) -> dict:
    assert main(['list', *kinds, '--json']) == 0
    return json.loads(capsys.readouterr().out)


def test_every_kind_is_listed_and_each_name_has_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    data = listed(capsys)
    assert set(USES) == {*KINDS, 'studies'} == data.keys() - {'status', 'directories'}
    assert all(one['text'] for kind in USES for one in data[kind])
    assert {one['name'] for one in data['vehicles']} >= {'full_car', 'light_car'}
    assert main(['list']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert 'scenes: mbd run NAME' in lines
    assert next(line for line in lines if line.startswith('  car_step_steer ')).endswith(
        'Full car, step steer (ISO 7401)'
    )


def test_kinds_are_arguments(capsys: pytest.CaptureFixture[str]) -> None:
    assert listed(capsys, 'tires', 'roads', 'tires').keys() == {'status', 'directories', 'tires', 'roads'}
    for wrong, meant in (('scene', 'scenes'), ('vehicels', 'vehicles'), ('tyres', 'tires')):
        assert main(['list', 'roads', wrong]) == 2
        assert capsys.readouterr().err == f'mbd list: there is no kind {wrong!r}; did you mean {meant!r}?\n'
    assert main(['list', 'xyz', '--json']) == 2
    assert 'allowed: maneuvers, mechanisms, roads' in json.loads(capsys.readouterr().out)['error']


def test_files_of_the_user_are_listed_with_their_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'vehicles').mkdir()
    (tmp_path / 'vehicles' / 'coupe.yaml').write_text('# A coupe. It is mine.\nkind: car\n')
    (tmp_path / 'vehicles' / 'silent.yaml').write_text('kind: car\n')
    assert main(['list', 'vehicles']) == 0
    text = capsys.readouterr().out
    assert 'A coupe (vehicles/coupe.yaml)\n' in text and '  (vehicles/silent.yaml)\n' in text
    installed_here = tmp_path / '.venv' / 'share' / 'mbd_sim_ros' / 'config' / 'vehicles'
    installed_here.mkdir(parents=True)
    (installed_here / 'of_package.yaml').write_text('kind: car\n')
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path / '.venv'))
    own = {one['name']: one['own'] for one in listed(capsys, 'vehicles')['vehicles']}
    assert own['coupe'] and own['silent'] and not own['full_car'] and own['of_package'] is False


@pytest.mark.slow
def test_the_line_of_a_study_is_its_summary() -> None:
    assert {name: summary(name) for name in installed()} == {name: module(name).SUMMARY for name in installed()}


def offered(line: str, directory: Path) -> list[str]:
    """What a shell would offer behind this line."""
    written = directory / 'offered'
    environment = {
        **os.environ,
        'PYTHONPATH': os.pathsep.join(sys.path),
        '_ARGCOMPLETE': '1',
        '_ARGCOMPLETE_IFS': '\n',
        '_ARGCOMPLETE_STDOUT_FILENAME': str(written),
        'COMP_LINE': line,
        'COMP_POINT': str(len(line)),
    }
    command = [sys.executable, '-m', 'mbd_sim_ros.commands.main']
    done = subprocess.run(
        command, cwd=directory, env=environment, capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stdout) == (0, '')
    return written.read_text().split('\n')


@pytest.mark.parametrize(
    ('line', 'names'),
    [
        ('mbd ', [c.__name__.rpartition('.')[2] for c in COMMANDS]),
        ('mbd run car_st', ['car_step_steer ']),
        ('mbd run --ve', ['--vehicle ']),
        ('mbd run car_circle --vehicle f', ['formula_student', 'full_car']),
        ('mbd run car_circle --fidelity k', ['kc ']),
        ('mbd run min', ['mine.yaml ']),
        ('mbd info 205', ['205_55R16.tir ']),
        ('mbd list ti', ['tires ']),
        ('mbd study tra', ['trade ']),
        ('mbd sweep step', ['step_steer_mass ']),
        ('mbd maneuver fmv', ['fmvss126 ']),
    ],
)
def test_the_tab_key_offers_names(line: str, names: list[str], tmp_path: Path) -> None:
    (tmp_path / 'mine.yaml').touch()
    (tmp_path / 'mine.csv').touch()
    assert offered(line, tmp_path) == names


def test_the_tab_key_offers_all_levels() -> None:
    assert get_args(Fidelity) == LEVELS
