"""A few cases of each kind of the fuzzer; `python test/faults/fuzz.py` makes thousands."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from faults import COUNT, SEED
from fuzz_cases import KINDS
from mutations import damage_bag, damage_text, damage_yaml, numbers_of

from mbd_sim_ros.commands.main import main
from solver.files.scene import config_directories

FUZZ = Path(__file__).with_name('fuzz.py')
CASES = len(KINDS) * (COUNT or 1)


@pytest.mark.slow
def test_damaged_input_ends_in_success_or_one_sentence(tmp_path: Path) -> None:
    """In a process that has no threads of a middleware: its children are forks."""
    command = [sys.executable, str(FUZZ), '--count', str(CASES), '--seed', str(SEED), '--out', str(tmp_path / 'out')]
    ended = subprocess.run(command, check=False, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    cases = [json.loads(line) for line in (tmp_path / 'out' / 'cases.jsonl').read_text().splitlines()]
    assert len(cases) == CASES and {one['kind'] for one in cases} == set(KINDS)
    assert not [one for one in cases if one['fault']]


def test_the_same_seed_gives_the_same_damage(tmp_path: Path) -> None:
    crank = tmp_path / 'crank'
    assert main(['run', 'slider_crank', '--duration', '0.1', '--out', str(crank), '--json']) == 0
    vehicle = (config_directories()[0] / 'vehicles' / 'light_car.yaml').read_text()
    for damage, source in ((damage_yaml, vehicle), (damage_text, vehicle), (damage_bag, crank / 'crank_0.mcap')):
        first, again, other = (damage(numbers_of('x', 1, case), source) for case in (5, 5, 6))  # type: ignore[operator]
        assert first == again != other
