"""The car of docs/vehicle.md, "Your own car", written from the documents alone: it stands where it was designed, and
drives."""

from __future__ import annotations

import json
import math
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


@pytest.mark.slow
def test_its_understeer_is_tuned_in_one_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As the page has it; the vehicle file that comes of it has the figure."""
    wanted = ['axles.front.suspension.tie_rod.inner[2]=0.225:0.245', 'understeer_gradient=3 deg/g']
    page = (VAN.parents[1] / 'vehicle.md').read_text(encoding='utf-8')
    assert all(f"'{one}'" in page for one in wanted)
    tuned = tmp_path / 'tuned.yaml'
    said(capsys, 'tune', str(VAN), *wanted, '--out', str(tuned))
    found = said(capsys, 'info', str(tuned))['figures']['understeer_gradient']
    assert math.degrees(found['value']) * 9.80665 == pytest.approx(3.0, rel=0.01)
