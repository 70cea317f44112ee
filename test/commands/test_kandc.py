"""mbd kandc: its curves have the slopes that the figures of the bench have, every column its unit, every end a note."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from mbd_sim_ros.analysis.kandc import measure
from mbd_sim_ros.commands.info import scene_of
from mbd_sim_ros.commands.main import main
from solver.analysis.kinematics_and_compliance import Rig, kinematic_figures


def test_curves_have_the_slopes_of_the_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In steps of 10 mm, those of kinematic_figures(), central differences in the middle are the same numbers, but for
    the equilibria, which are found to 1e-9 of their loads; left and right are mirrored."""
    arguments = ['kandc', 'light_car', '--travel', '0.02', '--points', '5', '--out', str(tmp_path)]
    assert main([*arguments, '--json']) == 0
    data = json.loads(capsys.readouterr().out)
    figures = kinematic_figures(Rig(scene_of('light_car', []).model))
    bump, roll = ({k: np.array(v) for k, v in data['sweeps'][name]['columns'].items()} for name in ('bump', 'roll'))
    track = 2.0 * Rig(scene_of('light_car', []).model).centers['front_left'][1]
    assert bump['wheel travel [m]'] == pytest.approx([-0.02, -0.01, 0.0, 0.01, 0.02])
    assert bump['front wheel_rate [N/m]'][2] == pytest.approx(figures['wheel_rate_front'], rel=1e-6)
    assert roll['rear roll_center [m]'][2] == pytest.approx(figures['roll_center_rear'], rel=1e-6)
    assert roll['front roll_stiffness [N m/rad]'][2] == pytest.approx(figures['roll_stiffness_front'], rel=1e-6)
    steer = roll['front_left steer [rad]']
    assert -0.5 * track * (steer[3] - steer[1]) / 0.02 == pytest.approx(figures['roll_steer_front'], rel=1e-6)
    toe = bump['front_left toe [rad]']
    assert (toe[3] - toe[1]) / 0.02 == pytest.approx(figures['bump_toe_front'], rel=1e-6)
    assert bump['front_right camber [rad]'] == pytest.approx(bump['front_left camber [rad]'], abs=1e-9)
    assert data['notes'] == []
    with (tmp_path / 'bump.csv').open() as file:
        header, *rows = csv.reader(file)
    assert header == list(bump) and len(rows) == 5
    assert [float(row[1]) for row in rows] == pytest.approx(toe, rel=1e-8, abs=1e-12)
    loads = {f'{load}_{way}.csv' for load in ('fx', 'fy', 'mz') for way in ('equal', 'opposite')}
    assert {Path(one).name for one in data['tables']} == {'bump.csv', 'roll.csv', 'steering.csv'} | loads


def test_a_sweep_ends_where_the_mechanism_does_and_says_so() -> None:
    """Wheels of the light car cannot go up by a metre; what is reached lies evenly about the design position."""
    bench = measure(scene_of('light_car', []), travel=1.0, points=11)
    bump = bench.sweeps[0]
    assert len(bump.notes) >= 1 and all(note.startswith('ends at ') for note in bump.notes)
    assert 0.0 in bump.x and len(bump.x) < 11
    assert len(bump.corners['rear_right']['load']) == len(bump.x)
    assert np.isfinite([values for _, values in bump.columns()]).all()


@pytest.mark.parametrize(
    ('arguments', 'sentence'),
    [
        (['slider_crank'], 'needs a vehicle with the four wheels'),
        (['compact_fw'], "did you mean 'compact_fwd'?"),
        (['light_car', '--travel', '0'], 'must be > 0'),
        (['light_car', '--steering', 'nan'], '--steering = nan'),
        (['light_car', '--travel', '60mm'], "'60mm' is not a number"),
        (['light_car', '--points', '2'], 'must be from 3 to 1001'),
        (['light_car', '--set', 'vehicle.chassis.mas=1'], "did you mean 'mass'"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(
    arguments: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['kandc', *arguments, '--out', str(tmp_path / 'out')]) == 2
    told = capsys.readouterr().err
    assert sentence in told and told.count('\n') == 1
    assert not (tmp_path / 'out').exists()
