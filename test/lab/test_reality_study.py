"""The study of reality with recordings in the form of those of real vehicles, made by the program itself: what it
finds, how it goes on, what it refuses."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from mbd_sim_ros.commands.main import main
from mbd_sim_ros.fitting.driving import Inputs, Steering
from mbd_sim_ros.fitting.example import course
from mbd_sim_ros.fitting.file import Drive, load_file
from mbd_sim_ros.fitting.recordings import Data, Track, Window
from mbd_sim_ros.lab.studies import reality
from mbd_sim_ros.lab.studies.reality_fits import USUAL, file_of, usual_car
from mbd_sim_ros.lab.studies.reality_vehicles import DART, DRIVE, FERRARI, VEHICLES, Cut
from solver.errors import BagError

TRUE = {'yaw_inertia': 1.08, 'stiffness_front': 1.1, 'stiffness_rear': 1.3, 'friction_front': 1.2, 'friction_rear': 1.3}
NOISE = {'lateral_acceleration': 0.05, 'yaw_rate': 0.002, 'sideslip': 0.001}  # sd of a sample, SI
SECONDS = 64.0
MADE = dataclasses.replace(
    FERRARI,
    fitted=(Cut(DRIVE, 0.0, 40.0),),
    held_out=(Cut(DRIVE, 40.0),),
    parts=((Cut(DRIVE, 0.0, 32.0),), (Cut(DRIVE, 32.0),)),
)


@pytest.fixture(scope='module')
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with a drive of a car in closed form, in the columns of the 250 LM, with noise."""
    car, random = usual_car(MADE), np.random.default_rng(1)
    t, angle, v = course(SECONDS, 3, ratio=1.0 / 16.0).T
    plain = Data('made', 'fit', {'angle': Track(t, angle), 'v': Track(t, v)})
    drive = Drive(road_wheel=('angle',), speed='v')
    window = Inputs(plain, drive, Window('made', 'fit', 0.0, 0.0, float(t[-1])), car)
    rows = car.driven({name: factor * car.value(name) for name, factor in TRUE.items()}, [window], Steering())[0]
    grid = np.arange(0.0, window.t[-1], 0.02)
    ay, vy, r = (CubicSpline(window.t, rows[:, k])(grid) for k in (1, 7, 11))  # as a fit reads between samples
    vx, delta = np.interp(grid, t, v), np.interp(grid, t, angle)
    noise = [sd * random.standard_normal(grid.size) for sd in NOISE.values()]
    table = np.column_stack([
        grid, vx, vy, 0.0 * vx, ay + noise[0], r + noise[1], np.arctan2(vy, vx) + noise[2], delta, delta
    ])  # fmt: skip
    place = tmp_path_factory.mktemp('data')
    (place / MADE.folder).mkdir()
    np.savetxt(
        place / MADE.folder / DRIVE, table, '%.7g', ',', comments='',
        header='t,vx,vy,axCG,ayCG,yawRate,beta_true,deltaFL,deltaFR',
    )  # fmt: skip
    return place


def run(data: Path, out: Path) -> dict:
    out.mkdir(exist_ok=True)
    return reality.study(out, quick=False, progress=lambda text, done: None, data=data, vehicles=[MADE], models=[USUAL])


@pytest.mark.slow
def test_a_car_of_the_same_equations_is_found(data, tmp_path, monkeypatch):
    """Fitted with its own equations, the drive held out is predicted to its noise and sampling, and the parameters are
    found as well; called again it fits nothing and writes the same report."""
    found = run(data, tmp_path / 'out')
    for row in found['held_out']:  # four samples are a mean; 2 % for the spline between samples of the inputs
        noise = 0.5 * NOISE[row['channel']] * reality.SIGNALS[row['channel']][2]
        assert 0.7 * noise < row[USUAL] < 1.2 * noise + 0.02 * row['size'], row
    car, fit = usual_car(MADE), found['fits'][f'{MADE.folder} {USUAL} whole']
    for name, factor in TRUE.items():
        one, truth = fit['parameters'][name], factor * car.value(name)
        assert abs(one['value'] - truth) < max(one['high'] - one['low'], 0.03 * truth), name  # 3 %: as of signals
    report = (tmp_path / 'out' / 'report.md').read_bytes()
    assert b'ferrari_250lm_drives.png' in report
    assert b'ferrari_250lm_estimates.png' in report
    monkeypatch.setattr(reality, 'fitted_to', lambda *args, **more: pytest.fail('a fit is made anew'))
    run(data, tmp_path / 'out')
    assert (tmp_path / 'out' / 'report.md').read_bytes() == report


def test_what_is_missing_is_named(tmp_path, capsys):
    """The option, the directory, and each recording, with where it is to be had; another study takes no recordings."""
    cases = [
        (['study', 'reality'], '--data is missing'),
        (['study', 'reality', '--data', str(tmp_path / 'no')], 'no such directory'),
        (['study', 'reality', '--data', str(tmp_path)], 'ferrari_250lm/drive.csv is missing; it is the columns t, vx'),
        (['study', 'levels', '--data', str(tmp_path)], "study 'levels': takes no recordings; remove --data"),
    ]
    for k, (argv, sentence) in enumerate(cases):
        assert main([*argv, '--out', str(tmp_path / f'out_{k}')]) != 0
        text = capsys.readouterr().err
        assert sentence in text
        assert text.count('\n') == 1
    for real in VEHICLES:
        for name in real.files:
            place = tmp_path / f'without_{real.folder}_{real.files.index(name)}' / real.folder
            place.mkdir(parents=True)
            for other in real.files:
                if other != name:
                    (place / other).touch()
            with pytest.raises(BagError, match='is missing') as error:
                real.require(place.parent)
            assert name in str(error.value)
            assert 'github.com/' in str(error.value)


@pytest.mark.parametrize('real', VEHICLES, ids=lambda real: real.folder)
@pytest.mark.parametrize('model', [USUAL, 'single_track', 'full'])
def test_files_of_fits(real, model, tmp_path):
    """Every file of a fit is one that mbd fit reads, with drives held out; parts do not overlap."""
    for fitted, held_out in ((real.fitted, real.held_out), *zip(real.parts, real.parts[1:], strict=False)):
        (tmp_path / 'fit.yaml').write_text(json.dumps(file_of(real, model, fitted, held_out, tmp_path)))
        given = load_file(tmp_path / 'fit.yaml')
        assert {one.use for one in given.recordings.values()} == {'fit', 'held_out'}
    cuts = sorted((cut.file, cut.start, cut.end or math.inf) for part in real.parts for cut in part)
    for (file, _, end), (other, start, _) in itertools.pairwise(cuts):
        assert file != other or end <= start
    assert len(real.parts) in (0, 5)


def test_place_of_the_capture(tmp_path):
    """The markers of the small car lie 0.115 m before its rear axle, in the frame of either model."""
    for model in (USUAL, 'full'):
        file = file_of(DART, model, DART.fitted, DART.held_out, tmp_path)
        x = file['channels']['lateral_velocity']['at'][0]
        rear = -DART.front_share * DART.wheelbase if model == USUAL else -0.5 * DART.wheelbase
        assert x == pytest.approx(rear + 0.115, abs=1e-6)


def test_scatter():
    """Values 1 to 5 with a claimed sd of 0.5: scatter sqrt(2.5), 3.16 times what is claimed; what is refused does not
    count."""
    parts = [{'parameters': {'mass': {'value': float(k), 'sd': 0.5, 'unit': 'kg'}}} for k in range(1, 6)]
    (row,) = reality.scatter(USUAL, {'refused': 'x'}, [*parts, {'refused': 'y'}])
    assert (row['parts'], row['whole'], row['scatter']) == (5, None, pytest.approx(math.sqrt(2.5)))
    assert row['scatter / claimed'] == pytest.approx(2.0 * math.sqrt(2.5))


def test_errors_are_those_of_windows_that_all_models_drive():
    """A window that one model could not drive counts for none; a model without a fit has no figure, and the sentence
    says which model is worse."""

    def windows(error: float, firsts: tuple[float, ...]) -> dict:
        sums = {'n': 4, 'signal': 16.0, 'error': 4.0 * error**2, 'before': 36.0}
        return {
            'windows': [{'recording': 'held_out_1', 'first': f, 'channels': dict.fromkeys(FERRARI.channels, sums)}
                        for f in firsts]
        }  # fmt: skip

    found = {
        (FERRARI.folder, USUAL, 'whole'): windows(1.0, (2.0, 12.0)),
        (FERRARI.folder, 'kc', 'whole'): windows(2.0, (12.0, 22.0)),
        (FERRARI.folder, 'full', 'whole'): {'refused': 'no'},
    }
    rows = reality.held_out(FERRARI, [USUAL, 'kc', 'full'], found)
    assert [row['windows'] for row in rows] == [1] * len(FERRARI.channels)
    row = next(row for row in rows if row['channel'] == 'lateral_acceleration')
    assert (row['size'], row[USUAL], row['kc'], row['kc, as given'], row['full']) == (2.0, 1.0, 2.0, 3.0, None)
    yaw = next(row for row in rows if row['channel'] == 'yaw_rate')
    assert yaw['kc'] == pytest.approx(math.degrees(2.0))
    text = reality._verdict(FERRARI, [USUAL, 'kc', 'full'], rows)
    assert 'Level kc predicts 3 of 3 signals worse' in text
    assert '2.00 instead of 1.00 m/s^2 (100 % worse)' in text
    assert 'Level full or the single track of seven parameters has no fit' in text
