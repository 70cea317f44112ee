"""The command line: exit codes, one JSON object, one sentence per error, recordings that are always closed."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.bags.recorder import code_version
from mbd_sim_ros.commands import main as cli
from mbd_sim_ros.commands.main import COMMANDS, main

ROOT = Path(__file__).resolve().parents[2]
SHORT = ['--duration', '0.2']


def output(capsys: pytest.CaptureFixture[str], *argv: str) -> tuple[int, str, str]:
    code = main(argv)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def document(capsys: pytest.CaptureFixture[str], *argv: str) -> tuple[int, dict]:
    code, out, err = output(capsys, *argv, '--json')
    assert err == ''
    assert out.count('\n') == 1
    return code, json.loads(out)


@pytest.fixture(scope='module')
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp('bags') / 'first'
    assert main(['run', 'four_bar', *SHORT, '--out', str(directory), '--json']) == 0
    return directory


@pytest.mark.parametrize('command', [c.__name__.rpartition('.')[2] for c in COMMANDS])
def test_every_command_has_help_with_an_example(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main([command, '--help'])
    assert caught.value.code == 0
    assert re.search(rf'example:\n +mbd {command} \S+', capsys.readouterr().out)


@pytest.mark.parametrize(
    ('argv', 'code', 'says'),
    [
        ((), 2, 'required: COMMAND'),
        (('rnu',), 2, "no command 'rnu'; did you mean 'run'?"),
        (('run',), 2, 'required: SCENE'),
        (('--quiet', 'run', 'four_bar'), 2, 'mbd: --quiet stands before the command; write mbd COMMAND ... --quiet'),
        (
            ('--set', 'integrator.h=1e-3', 'run', 'four_bar'),
            2,
            'mbd: --set stands before the command; write mbd COMMAND ... --set',
        ),
        (
            ('info', 'four_bar', '--resolved', '--urdf', 'x.urdf'),
            2,
            'argument --urdf: not allowed with argument --resolved',
        ),
        (('info', '/dev/null'), 2, "scene '/dev/null': is a pipe or a device, not a file"),
        (
            ('run', 'four_bar', '--set', 'mechanism=my bar.yaml'),
            2,
            'in it is written as a whole path, from the first / on',
        ),
        (
            ('run', 'four_bar', '--set', 'mechanism={<<: my bar.yaml}'),
            2,
            'in it is written as a whole path, from the first / on',
        ),
        (
            ('run', 'four_bar', '--set', 'mechanism=chain'),
            2,
            'must be a mapping of keys; a file is named with its ending, as chain.yaml',
        ),
        (
            ('run', 'car_step_steer', '--set', 'vehicle=compact_fwd.yaml'),
            2,
            "no such file; did you mean 'vehicles/compact_fwd.yaml'?",
        ),
        (
            ('run', 'four_bar', '--set', 'mechanism=bar.YAML'),
            2,
            'the ending of a file that stands here is in small letters: .yaml',
        ),
        (('study', 'kandc', '--out', '/dev/null'), 5, '--out /dev/null: File exists; choose another place'),
        (('run', 'four_bar', '--duration', '1e12'), 2, 'duration = 1000000000000.0: must be at most 9e+09'),
        (('replay', '/dev/null'), 5, '/dev/null is a pipe or a device; copy what comes from it into a file'),
        (
            ('bench', '--suite', 'scalling'),
            2,
            "--suite 'scalling': no such file, here or in config; did you mean 'scaling.yaml'?",
        ),
        (('run', 'four_bar', '--fast'), 2, 'mbd run: unrecognized argument --fast; '),
        (('run', 'fourbar'), 2, "did you mean 'four_bar'?"),
        (
            ('run', 'four_bar', '--duration', 'long'),
            2,
            "--duration: 'long' is not a number; write it in digits and without a unit",
        ),
        (('run', 'four_bar', '--duration', '-1'), 2, 'duration = -1.0: must be > 0'),
        (('run', 'four_bar', '--duration', 'nan'), 2, 'duration = nan: must be finite'),
        (
            ('run', 'four_bar', '--set', 'integrator.h=abc'),
            2,
            '--set integrator.h: integrator.h = abc: must be a number',
        ),
        (('run', 'four_bar', '--maneuver', 'step_stear'), 2, "did you mean 'step_steer'?"),
        (('info', 'nothing_like_it'), 2, 'no such file'),
        (('info', ''), 2, 'scene: its name is empty; allowed: '),
        (('export', 'nowhere', '--csv', 'out'), 5, 'nowhere is not there'),
        (('recover', 'nowhere', 'out'), 5, 'nowhere is not there'),
        (('replay', 'nowhere'), 5, 'nowhere is not there'),
        (('compare', 'nowhere', 'elsewhere'), 5, 'nowhere is not there'),
        (('compare', 'a', 'b', '--map', 'x'), 5, 'write it as THEIRS=OURS'),
        (('compare', 'a', 'b', '--rtol', '-1'), 5, '--rtol -1: must be a number that is not negative'),
    ],
)
def test_an_error_is_one_sentence_and_a_code(
    argv: tuple[str, ...], code: int, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    got, out, err = output(capsys, *argv)
    assert (got, out) == (code, '')
    assert err.startswith('mbd')
    assert err.count('\n') == 1
    assert says in err
    got, data = document(capsys, *argv)
    assert got == code
    assert data.keys() == {'status', 'error'}
    assert data['status'] == 'error'
    assert says in data['error']


def test_an_unforeseen_error_has_no_traceback(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: object) -> None:
        raise RuntimeError('two\nlines')

    monkeypatch.setattr(cli.info, 'run', fail)
    code, out, err = output(capsys, 'info', 'pendulum')
    assert (code, out) == (70, '')
    assert 'internal error: RuntimeError: two lines' in err
    assert err.count('\n') == 1


def test_json_before_the_command_is_told_where_it_stands(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = output(capsys, '--json', 'info', 'pendulum')
    assert (code, err) == (2, '')
    assert json.loads(out)['error'] == 'mbd: --json stands before the command; write mbd COMMAND ... --json'


def test_a_urdf_is_written_into_folders_that_are_made(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    file = tmp_path / 'out' / 'deep' / 'bar.urdf'
    assert document(capsys, 'info', 'four_bar', '--urdf', str(file))[0] == 0
    assert file.read_text(encoding='utf-8').lstrip().startswith('<')


@pytest.mark.parametrize('content', [b'\x89PNG\r\n\x1a\n', None])
def test_a_benchmark_that_could_not_be_written_is_told_before_it_is_measured(
    content: bytes | None, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A picture, or a place below a file."""
    file = tmp_path / 'x.png'
    file.write_bytes(content or b'')
    monkeypatch.setattr('mbd_sim_ros.lab.benchmarks.suite.run', None)
    code, out, err = output(
        capsys, 'bench', '--cases', 'slider_crank', '--out', str(file if content else file / 'x.md')
    )
    assert (code, out) == (1, '')
    assert err.count('\n') == 1 and 'x.png' in err
    assert file.read_bytes() == (content or b'')


def test_info_counts_the_slider_crank_of_the_chapter(capsys: pytest.CaptureFixture[str]) -> None:
    code, data = document(capsys, 'info', 'slider_crank')
    assert code == 0
    wanted = {
        'status': 'ok',
        'bodies': 4,
        'joints': 5,
        'bushings': 0,
        'spring_dampers': 0,
        'force_elements': 0,
        'tires': 0,
    }
    assert {k: data[k] for k in wanted} == wanted
    assert (data['constraint_rows'], data['redundant_constraints'], data['dof']) == (26, 3, 1)
    code, out, _ = output(capsys, 'info', 'slider_crank')
    assert code == 0
    assert re.search(r'^redundant constraints +3$', out, re.MULTILINE)


@pytest.mark.slow
def test_info_finds_a_tire_by_its_name_and_suggests_the_nearest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ('tires/205_55R16.tir', '205_55R16.tir'):
        assert main(['info', name]) == 0
        assert 'keys' not in capsys.readouterr().err
    assert main(['info', '205_55R15.tir']) == 2
    said = capsys.readouterr().err
    assert "tire '205_55R15.tir': no such file, and no name in config/tires; did you mean '205_55R16.tir'?" in said


def test_info_gives_units_and_counts_one_key_as_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['info', 'light_car_step_steer', '--brief']) == 0
    rows = capsys.readouterr().out
    for name, value in (('mass', '1413 kg'), ('h', '0.001 s'), ('duration', '8 s')):
        assert re.search(rf'^{name} +{value}$', rows, re.MULTILINE), name
    assert ' 1 key ignored' in rows


def test_resolved_scene_runs_like_the_scene(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    file = tmp_path / 'four_bar.yaml'
    file.write_text(document(capsys, 'info', 'four_bar', '--resolved')[1]['resolved'])
    for name, directory in (('four_bar', tmp_path / 'a'), (str(file), tmp_path / 'b')):
        assert document(capsys, 'run', name, *SHORT, '--out', str(directory))[0] == 0
    assert document(capsys, 'compare', str(tmp_path / 'a'), str(tmp_path / 'b'), '--exact')[1]['status'] == 'same'


def test_run_reports_and_records(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code, data = document(
        capsys, 'run', 'four_bar', *SHORT, '--set', 'integrator.h=0.002', '--out', str(tmp_path / 'r')
    )
    assert (code, data['status'], data['steps'], data['out']) == (0, 'ok', 100, str(tmp_path / 'r'))
    for key in ('real_time_factor', 'cpu_per_step_us', 'iterations_per_step'):
        assert data[key] > 0.0
    for key in ('energy_error_max', 'position_drift_max', 'velocity_drift_max'):
        assert 0.0 <= data[key] < 1e-3
    run = bag.read(tmp_path / 'r')
    assert run.time_ns.tolist() == list(range(0, 200_000_001, 2_000_000))
    assert run.metadata['status'] == 'ok'
    assert 'h: 0.002' in run.metadata['resolved_scene']


@pytest.mark.slow
def test_changes_of_step_and_penalties_are_counted_recorded_and_repeated(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    settings = (
        'mode=tolerance',
        'augmentation=plain',
        'penalty=100',
        'penalty_policy=adaptive',
        'step_policy=error',
        'h=0.01',
        'error_tolerance=1e-5',
    )
    overrides = [word for s in settings for word in ('--set', f'integrator.{s}')]
    code, data = document(capsys, 'run', 'slider_crank', '--duration', '0.6', *overrides, '--out', str(tmp_path / 'r'))
    assert (code, data['steps']) == (0, 60)
    assert data['substeps'] > 120
    run = bag.read(tmp_path / 'r')
    assert len(run.events) == data['events'] > 0
    assert {event['kind'] for event in run.events} >= {'step', 'penalty'}
    assert all(set(event) == {'t', 'kind', 'name', 'old', 'new', 'cause'} for event in run.events)
    code, _ = document(capsys, 'replay', str(tmp_path / 'r'), '--out', str(tmp_path / 'again'))
    assert code == 0
    assert bag.read(tmp_path / 'again').events == run.events


@pytest.mark.slow
def test_a_recording_is_never_overwritten(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, data = document(capsys, 'run', 'four_bar', *SHORT, '--out', str(recording))
    assert code == 5
    assert 'not empty' in data['error']


def test_nothing_is_recorded_on_request(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, data = document(capsys, 'run', 'four_bar', *SHORT, '--no-record')
    assert (code, data['out']) == (0, None)
    assert list(tmp_path.iterdir()) == []


def test_recording_defaults_to_a_new_directory_in_bags(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, data = document(capsys, 'run', 'four_bar', *SHORT)
    assert code == 0
    assert re.fullmatch(r'bags/four_bar-\d{8}-\d{6}', data['out'])
    assert bag.read(tmp_path / data['out']).time_ns[-1] == 200_000_000


def test_a_requirement_that_is_not_met_fails_the_run(capsys: pytest.CaptureFixture[str]) -> None:
    code, data = document(capsys, 'run', 'four_bar', *SHORT, '--no-record', '--set', 'require.energy_error_max=1e-30')
    assert (code, data['status']) == (1, 'suspect')
    assert data['violations'][0].startswith('energy_error_max: ')
    code, data = document(capsys, 'run', 'four_bar', *SHORT, '--no-record', '--set', 'require.energy_error_max=1')
    assert (code, data['require']) == (0, {'energy_error_max': 1.0})


def test_a_failed_step_closes_the_recording(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    impossible = ['--set', 'mechanism.couplers.motor.terms={rocker: 1}']  # the rocker cannot turn round
    code, data = document(capsys, 'run', 'four_bar', '--duration', '2', *impossible, '--out', str(tmp_path / 'r'))
    assert code == 4
    assert re.match(r't = [\d.]+ s, step \d+: ', data['error'])
    assert bag.read(tmp_path / 'r').metadata['status'] == 'error'


@pytest.mark.slow
def test_a_recording_replays_bit_by_bit(recording: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code, data = document(capsys, 'replay', str(recording), '--out', str(tmp_path / 'again'))
    assert (code, data['status'], data['steps'], data['same_code']) == (0, 'identical', 200, True)
    assert document(capsys, 'compare', str(recording), str(tmp_path / 'again'), '--exact')[0] == 0


@pytest.mark.slow
def test_compare_finds_another_step_size_and_draws_it(
    recording: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(['run', 'four_bar', *SHORT, '--set', 'integrator.h=0.004', '--out', str(tmp_path / 'coarse')]) == 0
    capsys.readouterr()
    pair = (str(tmp_path / 'coarse'), str(recording))
    code, data = document(capsys, 'compare', *pair, '--rtol', '1e-12', '--atol', '0', '--plot', str(tmp_path / 'c.png'))
    assert (code, data['status'], data['instants'], data['interpolated']) == (1, 'different', 51, False)
    assert (tmp_path / 'c.png').stat().st_size > 10_000
    code, data = document(capsys, 'compare', *pair, '--rtol', '1', '--atol', '1')
    assert (code, data['status'], data['outside']) == (0, 'same', [])
    code, out, _ = output(capsys, 'compare', *pair, '--rtol', '1e-12', '--atol', '0')
    assert code == 1
    assert 'OUTSIDE' in out


def test_export_agrees_with_the_recording(recording: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code, data = document(capsys, 'export', str(recording), '--csv', str(tmp_path / 'csv'))
    assert code == 0
    assert data['rows'] == 201
    assert document(capsys, 'compare', str(tmp_path / 'csv'), str(recording), '--exact')[0] == 0
    header = (tmp_path / 'csv' / 'joint_states.csv').read_text().splitlines()[0]
    assert header.startswith('time [s],crank/position [rad],')


def test_export_tells_of_tables_that_an_older_one_left(
    recording: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    directory = tmp_path / 'csv'
    assert document(capsys, 'export', str(recording), '--csv', str(directory))[1]['others'] == []
    (directory / 'tire_states.csv').write_text('time [s],front_left/kappa\n')
    code, data = document(capsys, 'export', str(recording), '--csv', str(directory))
    assert (code, data['others']) == (0, [str(directory / 'tire_states.csv')])
    text = output(capsys, 'export', str(recording), '--csv', str(directory))[1]
    assert 'there before, and not of this export: tire_states.csv in ' in text


def test_recover_saves_a_cut_recording(recording: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    whole = next(recording.glob('*.mcap')).read_bytes()
    cut = tmp_path / 'cut.mcap'
    cut.write_bytes(whole[: len(whole) * 2 // 3])
    code, data = document(capsys, 'export', str(cut), '--csv', str(tmp_path / 'csv'))
    assert code == 5
    assert 'mbd recover' in data['error']
    code, data = document(capsys, 'recover', str(recording), str(tmp_path / 'saved'))
    assert (code, data['complete']) == (0, True)
    assert document(capsys, 'compare', str(tmp_path / 'saved'), str(recording), '--exact')[0] == 0


@pytest.mark.slow
@pytest.mark.parametrize(('number', 'code'), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_interrupted_run_closes_its_recording(number: signal.Signals, code: int, tmp_path: Path) -> None:
    directory = tmp_path / 'r'
    command = [
        sys.executable,
        '-m',
        'mbd_sim_ros.commands.main',
        'run',
        'four_bar',
        '--duration',
        '10000',
        '--out',
        str(directory),
    ]
    child = subprocess.Popen(
        command,
        cwd=ROOT,
        env=dict(os.environ),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        deadline = time.monotonic() + 600.0
        while not (list(directory.glob('*.part')) and next(directory.glob('*.part')).stat().st_size > 200_000):
            assert child.poll() is None, child.stderr and child.stderr.read()
            assert time.monotonic() < deadline
            time.sleep(0.05)
        child.send_signal(number)
        out, err = child.communicate(timeout=60)
    finally:
        child.kill()
        child.wait()
    assert (child.returncode, out) == (code, '')
    assert err.count('\n') == 1
    assert re.search(r'at t = [\d.]+ s \(step \d+\); the recording in .* is complete up to there', err)
    run = bag.read(directory)
    assert run.metadata['status'] == 'interrupted'
    assert f'(step {int(run["cmd_applied/step"][-1])})' in err


@pytest.mark.parametrize(
    'argv',
    [
        ('run', 'four_bar', *SHORT, '--out', '/dev/full'),
        ('run', 'four_bar', *SHORT, '--out', '/proc/nothing/r'),
        ('info', 'four_bar', '--urdf', '/dev/full'),
    ],
)
def test_places_that_take_nothing_are_one_sentence(argv: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = output(capsys, *argv)
    assert code in (1, 5) and out == ''
    assert err.count('\n') == 1 and argv[-1].rpartition('/')[0] in err


def test_folders_may_have_any_name(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    folder = tmp_path / 'it\'s "new" \\s (50 % é)'
    folder.mkdir()
    shutil.copy(ROOT / 'config' / 'vehicles' / 'light_car.yaml', folder / 'my car.yaml')
    shutil.copy(ROOT / 'config' / 'maneuvers' / 'straight_ahead.yaml', folder / 'go on.yaml')
    code, data = document(capsys, 'info', str(folder / 'my car.yaml'), '--brief')
    assert (code, data['scene']) == (0, 'my car')
    settings = ['--maneuver', str(folder / 'go on.yaml'), '--duration', '0.01', '--out', str(folder / 'a run')]
    assert document(capsys, 'run', 'light_car_straight', *settings)[0] == 0
    for changed in (['--set', 'integrator.iterations=3'], ['--vehicle', str(folder / 'my car.yaml')]):
        code, data = document(capsys, 'replay', str(folder / 'a run'), *changed)
        assert (code, data['status']) == (0, 'compared')


@pytest.mark.parametrize('name', ['../../outside', '/tmp/outside', '..', 'a b/c'])
def test_the_name_of_a_scene_stays_inside_bags(
    name: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / 'here').mkdir()
    monkeypatch.chdir(tmp_path / 'here')
    code, data = document(capsys, 'run', 'four_bar', *SHORT, '--set', f'name={json.dumps(name)}')
    assert code == 0
    assert Path(data['out']).parent == Path('bags')
    assert [p.name for p in tmp_path.iterdir()] == ['here'] and [p.name for p in (tmp_path / 'here').iterdir()] == [
        'bags'
    ]


def test_it_says_which_version_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(['--version'])
    assert (ended.value.code, capsys.readouterr().out) == (0, f'mbd_sim_ros {code_version()}\n')
