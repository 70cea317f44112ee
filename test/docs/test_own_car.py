"""The car of docs/vehicle.md, "Your own car", written from the documents alone: it stands where it was designed, and
drives."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mbd_sim_ros.commands.main import main

VAN = Path(__file__).parents[2] / 'docs' / 'examples' / 'van.yaml'


def said(capsys: pytest.CaptureFixture[str], *argv: str) -> dict:
    assert main([*argv, '--json']) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_a_vehicle_file_is_counted_and_has_its_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By its path, wherever it lies; the springs carry the van within a few millimetres of the design position."""
    copy = tmp_path / 'my_car.yaml'
    copy.write_text(VAN.read_text(encoding='utf-8'), encoding='utf-8')
    found = said(capsys, 'info', str(copy))
    assert found['scene'] == 'my_car' and found['redundant_constraints'] == 0
    assert all(found['figures'][f'sag_{axle}']['within'] for axle in ('front', 'rear'))


@pytest.mark.slow
def test_it_drives(capsys: pytest.CaptureFixture[str]) -> None:
    changes = (f'vehicle={VAN}', 'maneuver.steering.start=0.1', 'duration=0.5')
    found = said(
        capsys, 'run', 'car_step_steer', *(part for change in changes for part in ('--set', change)), '--no-record'
    )
    assert found['status'] == 'ok'
