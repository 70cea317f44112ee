"""What is set on the command line has an effect or is refused, and the examples of the help are commands."""

from __future__ import annotations

import dataclasses
import json
import shlex
import subprocess
from pathlib import Path

import pytest

from mbd_sim_ros.analysis.evaluation import judging
from mbd_sim_ros.analysis.evaluation.registry import EVALUATIONS
from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.commands.main import COMMANDS, main, parser
from mbd_sim_ros.commands.scene_keys import overrides_of
from solver.files.scene import MODEL_KEYS, load_scene_text
from solver.scene import Scene


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
        '--set maneuver.steering: has no effect, because --set maneuver comes later and replaces all of maneuver; '
        'give --set maneuver first'
    ) in told


def test_options_for_keys_of_a_scene_are_overrides_before_those_of_set() -> None:
    given = ['run', 'light_car_straight', '--set', 'vehicle.drag=0', '--fidelity', 'kc', '--vehicle', 'compact_fwd']
    vehicle, fidelity, drag = overrides_of(parser().parse_args(given))
    assert vehicle.startswith('vehicle=/') and vehicle.endswith('config/vehicles/compact_fwd.yaml')
    assert (fidelity, drag) == ('fidelity=kc', 'vehicle.drag=0')
    assert overrides_of(parser().parse_args(['replay', 'bag', '--fidelity', 'kc'])) == ['fidelity=kc']


@pytest.mark.parametrize(
    ('option', 'value'), [('maneuver', 'step_steer'), ('duration', '3'), ('vehicle', 'light_car'), ('fidelity', 'kc')]
)
def test_what_is_given_twice_is_refused(option: str, value: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['run', 'light_car_straight', f'--{option}', value, '--set', f'{option}=x']) == 2
    assert f'--set {option}=x: --{option} is given too; keep one of them' in capsys.readouterr().err


@pytest.mark.parametrize('name', [command.__name__.rpartition('.')[2] for command in COMMANDS])
def test_the_examples_of_the_help_are_commands_of_a_shell(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Remarks in parentheses ended in a syntax error."""
    with pytest.raises(SystemExit):
        main([name, '--help'])
    lines = capsys.readouterr().out.replace('\\\n', ' ').splitlines()
    examples = [line.strip() for line in lines if line.startswith(f'  mbd {name} ')]
    assert examples
    for line in examples:
        assert subprocess.run(['bash', '-n', '-c', line], capture_output=True, text=True, check=False).stderr == ''
        parser().parse_args(shlex.split(line, comments=True)[1:])


def parted(*settings: str, of: str = 'iso4138') -> tuple[list[str], dict[str, float]]:
    """What --set of `mbd maneuver` makes of these: (overrides of the scene, parameters)."""
    command = ['maneuver', of, 'light_car', *(word for one in settings for word in ('--set', one))]
    return judging.divided(parser().parse_args(command).overrides, judging.called(of))


def test_one_option_sets_the_scene_and_the_evaluation() -> None:
    """mbd maneuver: --set had the scene and --with the evaluation, whose --set was that of mbd evaluate."""
    scene = [
        'integrator.h=0.002',
        'start.speed=22',
        'duration=3',
        'duration_ms=3000',
        'vehicle.chassis.mass=1500',
        'maneuver={}',
    ]
    assert parted(*scene, 'low=0.5', ' high = 3.5') == (scene, {'low': 0.5, 'high': 3.5})
    command = [
        'maneuver',
        'iso4138',
        'light_car',
        '--with',
        'low=0.5',
        '--set',
        'integrator.h=0.002',
        '--with',
        'low=0.6',
    ]
    assert judging.divided(parser().parse_args(command).overrides, judging.called('iso4138')) == (
        ['integrator.h=0.002'],
        {'low': 0.6},
    )
    for option in ('--set', '--with'):
        assert judging.assignments(parser().parse_args(['evaluate', 'bag', option, 'settled=2.5']).overrides) == {
            'settled': 2.5
        }


def test_a_parameter_with_the_name_of_a_key_of_scenes_is_told_by_its_number() -> None:
    """start: a place [m] for lane changes, a mapping in a scene. There is no other, and no such key of a scene takes a
    number."""
    assert parted('start=60', 'start.speed=22', of='iso3888_1') == (['start.speed=22'], {'start': 60.0})
    assert parted('start.speed=22', 'start=60', of='iso3888_1') == (['start.speed=22'], {'start': 60.0})
    assert parted('start={speed: 22}', of='iso3888_1') == (['start={speed: 22}'], {})
    assert parted('start=60') == (['start=60'], {})  # whose evaluations have none: the scene refuses it
    names = {f.name for evaluation in EVALUATIONS for f in dataclasses.fields(evaluation.parameters)}
    assert names & {*(f.name for f in dataclasses.fields(Scene)), *MODEL_KEYS} == {'start'}
    assert dataclasses.is_dataclass(Scene.start)


@pytest.mark.parametrize(
    ('command', 'says'),
    [
        (['maneuver', 'iso4138', 'light_car', '--set', 'hihg=1'], "no parameter 'hihg'; did you mean 'high'?"),
        (['maneuver', 'iso4138', 'light_car', '--set', 'low=fast'], "--set 'low=fast': write it as KEY=NUMBER"),
        (['maneuver', 'iso4138', 'light_car', '--set', 'sed=1'], "did you mean 'seed'?"),
        (
            ['evaluate', 'none', '--set', 'integrator.h=0.001'],
            'mbd replay BAG --set integrator.h=0.001 simulates it again',
        ),
        (['evaluate', 'none', '--with', 'settled'], "--set 'settled': write it as KEY=NUMBER"),
    ],
)
def test_what_is_set_nowhere_is_refused(command: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(command) == 2
    assert says in capsys.readouterr().err
