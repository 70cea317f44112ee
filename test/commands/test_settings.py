"""What is set on the command line has an effect or is refused, and the examples of the help are commands."""

from __future__ import annotations

import json
import shlex
import subprocess
from pathlib import Path

import pytest

from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.commands.main import COMMANDS, main, parser
from mbd_sim_ros.commands.scene_keys import overrides_of
from solver.files.scene import load_scene_text


def test_parts_of_another_maneuver_can_be_set(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The maneuver came behind what was set of it: the car was steered by the 0.9 rad of the file."""
    settings = ['--maneuver', 'step_steer', '--set', 'maneuver.steering.value=0.123', '--duration', '0.01']
    assert main(['run', 'light_car_straight', *settings, '--out', str(tmp_path / 'r'), '--json']) == 0
    maneuver = load_scene_text(bag.read(tmp_path / 'r').metadata['resolved_scene']).maneuver
    assert maneuver.name == 'step_steer' and maneuver.channels['steering'].value == 0.123


@pytest.mark.parametrize(
    'command',
    [
        ['run', 'light_car_straight'],
        ['info', 'light_car_straight'],
        ['plan', 'light_car_straight'],
        ['replay', 'bag'],
        ['maneuver', 'iso7401', 'light_car'],
        ['study', 'trade', 'light_car_straight'],
    ],
)
def test_what_another_setting_would_replace_is_refused(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    settings = ['maneuver.steering=0.1', 'integrator.h=1e-3', 'maneuver={}']
    assert main([*command, '--json', *(word for one in settings for word in ('--set', one))]) == 2
    told = json.loads(capsys.readouterr().out)['error']
    assert (
        '--set maneuver.steering: has no effect, because --set maneuver comes later and replaces all of maneuver; give --set maneuver first'
        in told
    )


def test_options_for_keys_of_a_scene_are_overrides_before_those_of_set() -> None:
    given = ['run', 'light_car_straight', '--set', 'vehicle.drag=0', '--fidelity', 'kc', '--vehicle', 'compact_fwd']
    vehicle, fidelity, drag = overrides_of(parser().parse_args(given))
    assert vehicle.startswith('vehicle=/') and vehicle.endswith('config/vehicles/compact_fwd.yaml')
    assert (fidelity, drag) == ('fidelity=kc', 'vehicle.drag=0')
    assert overrides_of(parser().parse_args(['replay', 'bag', '--fidelity', 'kc'])) == ['fidelity=kc']


@pytest.mark.parametrize(('option', 'value'), [('maneuver', 'step_steer'), ('duration', '3'), ('vehicle', 'light_car'), ('fidelity', 'kc')])
def test_what_is_given_twice_is_refused(option: str, value: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['run', 'light_car_straight', f'--{option}', value, '--set', f'{option}=x']) == 2
    assert f'--set {option}=x: --{option} is given too; keep one of them' in capsys.readouterr().err


@pytest.mark.parametrize('name', [command.__name__.rpartition('.')[2] for command in COMMANDS])
def test_the_examples_of_the_help_are_commands_of_a_shell(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Remarks in parentheses ended in a syntax error."""
    with pytest.raises(SystemExit):
        main([name, '--help'])
    examples = [line.strip() for line in capsys.readouterr().out.splitlines() if line.startswith(f'  mbd {name} ')]
    assert examples
    for line in examples:
        assert subprocess.run(['bash', '-n', '-c', line], capture_output=True, text=True, check=False).stderr == ''
        parser().parse_args(shlex.split(line, comments=True)[1:])
