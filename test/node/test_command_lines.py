"""Command lines of the nodes that cannot be meant: one sentence, at once, exit code 2."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from forks import Fork
from processes import DOMAIN, ROOT

pytestmark = pytest.mark.slow

CASES = {
    'no -p': (
        'main',
        ['scene:=light_car_straight'],
        r"\['scene:=light_car_straight'\] is not understood: parameters are given as --ros-args -p",
    ),
    'no --ros-args': (
        'main',
        ['-p', 'scene:=light_car_straight', '--', 'record:=true'],
        "simulator: 'record:=true' is not understood: parameters are given as --ros-args -p",
    ),
    'whole number': (
        'main',
        ['-p', 'duration:=5'],
        "expecting type 'DOUBLE': duration; write it with a point, e.g. 5.0",
    ),
    'number with a point': (
        'main',
        ['-p', 'lockstep_every:=2.5'],
        "expecting type 'INTEGER': lockstep_every; write it without a point",
    ),
    'none of the states': ('main', ['-p', 'lockstep_every:=0'], 'lockstep_every'),
    'fewer than none of the states': ('main', ['-p', 'lockstep_every:=-10'], 'lockstep_every'),
    'text for a number': (
        'main',
        ['-p', 'lockstep_every:=ten'],
        "expecting type 'INTEGER': lockstep_every; write it as a number, e.g. 5",
    ),
    'text for a list': (
        'main',
        ['-p', 'overrides:=duration=2'],
        "expecting type 'STRING_ARRAY': overrides; write it as a list, e.g. ",
    ),
    'empty list': (
        'main',
        ['-p', 'scene:=light_car_straight', '-p', 'lockstep_commands:=[]'],
        'lockstep_commands is an empty list, which has',
    ),
    'empty list of nothing': (
        'main',
        ['-p', 'scene:=light_car_strait', '-p', 'overrides:=[]'],
        "did you mean 'light_car_straight'",
    ),
    'negative rate': (
        'maneuver_player',
        ['-p', 'maneuver:=brake', '-p', 'rate:=-1.0'],
        'rate = -1, timeout = 20: must not be negative',
    ),
    'name with a blank': (
        'maneuver_player',
        ['-p', 'maneuver:=brake', '-p', 'simulator:=a b'],
        "Invalid topic name: .*: 'a b/steering_cmd'",
    ),
    'no such scene': ('adapter', ['-p', 'scene:=light_car_strait'], "did you mean 'light_car_straight'"),
    'no such enclave': (
        'main',
        ['--enclave', '/other', '-p', 'scene:=light_car_straight'],
        "SECURITY ERROR: directory '.*other' does not exist",
    ),
}
SECURED = {'ROS_SECURITY_ENABLE': 'true', 'ROS_SECURITY_STRATEGY': 'Enforce'}


def run(arguments: list[str], directory: Path, **more: str) -> tuple[int, str]:
    """(exit code, all it said) of a node that is expected to end by itself."""
    environment = {
        **os.environ,
        'PYTHONPATH': str(ROOT),
        'ROS_DOMAIN_ID': DOMAIN,
        'ROS_LOG_DIR': str(directory / 'log'),
        **more,
    }
    with (directory / 'said').open('w+') as said:
        code = Fork(arguments, cwd=directory, env=environment, output=said.fileno()).wait(30.0)
        said.seek(0)
        return code, said.read()


@pytest.mark.parametrize('case', CASES)
def test_a_command_line_that_cannot_be_meant_is_one_sentence(case: str, tmp_path: Path) -> None:
    pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    module, arguments, words = CASES[case]
    more = {**SECURED, 'ROS_SECURITY_KEYSTORE': str(tmp_path)} if 'enclave' in case else {}
    code, text = run(['-m', f'mbd_sim_ros.node.{module}', '--ros-args', *arguments], tmp_path, **more)
    said = [line for line in text.splitlines() if not line.startswith('[')]  # rcl logs on its own
    assert code == 2, text
    assert len(said) == 1, text
    assert re.search(words, said[0]), said[0]
