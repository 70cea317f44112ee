"""The example of several driven axles in docs/vehicle.md, run as it is written there, and such cars from files of their
own."""

from __future__ import annotations

import itertools
import json
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml
from live_axle_cars import off_roader, truck

from mbd_sim_ros.commands.main import main
from solver.files.scene import load_scene
from solver.simulation import Simulation

PAGE = Path(__file__).parents[2] / 'docs' / 'vehicle.md'


def example() -> list[str]:
    """Arguments of the command."""
    section = PAGE.read_text(encoding='utf-8').split('## Several driven axles')[1]
    found = re.search(r'```bash\n(.*?)```', section, re.DOTALL)
    assert found is not None
    return shlex.split(found[1].replace('\\\n', ' '))[1:]


@pytest.mark.slow
def test_it_runs(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*example(), '--set', 'duration=0.5', '--no-record', '--json']) == 0
    assert json.loads(capsys.readouterr().out)['status'] == 'ok'


def test_both_axles_pull() -> None:
    argv = example()
    changes = [change for key, change in itertools.pairwise(argv) if key == '--set']
    run = Simulation(load_scene(argv[1], changes))
    run.advance(round(0.5 / run.h))
    forces = run.model.spec.coordinate_forces
    rows = run.model.outputs('coordinate_forces', run.outputs)
    torques = {force.name: row[4] for force, row in zip(forces, rows, strict=True)}
    assert torques['final_drive_front'] > 50.0 and torques['final_drive_rear'] > 50.0
    assert 'transfer' in torques


@pytest.mark.parametrize('vehicle', [off_roader(power=True), truck()])
def test_info_counts_such_cars(vehicle: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / 'my_truck.yaml'
    file.write_text(yaml.safe_dump(vehicle), encoding='utf-8')
    assert main(['info', str(file), '--brief', '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert found['redundant_constraints'] == 0
