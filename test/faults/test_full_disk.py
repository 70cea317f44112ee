"""Where nothing can be written every command says one sentence with the place, whatever it writes there."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mbd_sim_ros.commands.main import INTERNAL_ERROR, main
from mbd_sim_ros.sweep.case import SweepCase
from mbd_sim_ros.sweep.design import SweepFigure
from mbd_sim_ros.sweep.workers import Workers
from solver.errors import BagError
from solver.files.scene import load_scene

FULL = Path('/dev/full')
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not FULL.exists(), reason='/dev/full, a device that is always full, exists on Linux alone'),
]


@pytest.fixture(scope='module')
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp('bags') / 'first'
    assert (
        main(
            [
                'run',
                'light_car_lane_change',
                '--duration',
                '0.2',
                '--set',
                'record.every=2',
                '--out',
                str(directory),
                '--json',
            ]
        )
        == 0
    )
    return directory


def full(file: Path) -> Path:
    """A file on a disk that is full."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.unlink(missing_ok=True)
    file.symlink_to(FULL)
    return file


def refused(capfd: pytest.CaptureFixture[str], place: str, *words: object, file: Path | None = None) -> None:
    """A command says one sentence with the place, as text and as JSON. file: the one whose disk is full."""
    capfd.readouterr()
    for as_json in ([], ['--json']):
        if file is not None:
            full(file)  # some remove what they could not write
        code = main([*map(str, words), *as_json])
        said = capfd.readouterr()
        assert code not in (0, INTERNAL_ERROR), said
        sentence = json.loads(said.out)['error'] if as_json else said.err
        assert place in sentence and sentence.strip().count('\n') == 0 and 'Traceback' not in said.err, said
        if not as_json:
            assert said.out == ''


@pytest.mark.parametrize(
    ('file', 'words'),
    [
        ('csv/odom.csv', ('export', 'BAG', '--csv', 'csv', '--channel', 'odom/*')),
        ('table/odom.parquet', ('export', 'BAG', '--parquet', 'table', '--channel', 'odom/*')),
        ('page.html', ('compare', 'BAG', 'BAG', '--html', 'page.html')),
        ('plot.png', ('compare', 'BAG', 'BAG', '--plot', 'plot.png')),
        ('page.html', ('view', 'BAG', '--out', 'page.html')),
        ('picture.png', ('view', 'BAG', '--out', 'picture.png', '--width', '320')),
        ('car.urdf', ('info', 'slider_crank', '--urdf', 'car.urdf')),
    ],
)
def test_a_file_on_a_full_disk(
    file: str,
    words: tuple[str, ...],
    recording: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    refused(
        capfd,
        file.partition('/')[0],
        *(str(recording) if word == 'BAG' else word for word in words),
        file=tmp_path / file,
    )


@pytest.mark.parametrize(
    'words',
    [
        ('run', 'slider_crank', '--out', 'file/bag'),
        ('recover', 'BAG', 'file/bag'),
        ('export', 'BAG', '--csv', 'file/csv'),
        ('view', 'BAG', '--out', 'file/page.html'),
        ('compare', 'BAG', 'BAG', '--html', 'file/page.html'),
        ('sweep', 'step_steer_mass', '--out', 'file/sweep'),
        ('maneuver', 'iso7401_step', 'light_car', '--out', 'file/drive'),
        ('study', 'slider_crank', '--quick', '--out', 'file/study'),
        ('plan', 'light_car_straight', '--set', 'require={yaw_rate: {rms: 2 %}}', '--out', 'file/plan'),
    ],
)
def test_a_folder_that_cannot_be_made(
    words: tuple[str, ...],
    recording: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr('solver.trade.certificate.plan', None)  # minutes of searching come after it is told
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'file').touch()
    refused(capfd, 'file', *(str(recording) if word == 'BAG' else word for word in words))


@pytest.mark.parametrize('name', ['scene.yaml', 'certificate.json', 'plan.html'])
def test_a_plan_on_a_full_disk(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(
        'solver.trade.certificate.plan', lambda _: {'status': 'ok', 'settings': {}, 'price': {}, 'notes': []}
    )
    monkeypatch.setattr('solver.levels.auto.keep', lambda *_: True)
    monkeypatch.setattr('solver.levels.auto.chosen', lambda scene, _: scene)
    monkeypatch.setattr('mbd_sim_ros.commands.plan._time', lambda *_: None)
    monkeypatch.setattr(
        'mbd_sim_ros.analysis.plan_page.write_page', lambda _search, _data, file, _scene: file.write_text('page')
    )
    full(tmp_path / name)
    refused(
        capfd, str(tmp_path), 'plan', 'light_car_straight', '--set', 'require={yaw_rate: {rms: 2 %}}', '--out', tmp_path
    )


def test_a_sweep_whose_rows_cannot_be_kept_stops_with_a_sentence(tmp_path: Path) -> None:
    scene = load_scene('pendulum', ['duration=0.01'])
    figures = {'a': SweepFigure(quantity=f'joint_states/{scene.model.joints[0].name}/position')}
    (tmp_path / 'rows').touch()
    case = SweepCase(
        number=0, text=scene.resolved, name='pendulum', values={}, figures=figures, rows=str(tmp_path / 'rows')
    )
    with Workers(1) as workers, pytest.raises(BagError, match=r'rows.*File exists.*the same command goes on'):
        list(workers.run([case]))
