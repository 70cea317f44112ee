"""mbd evaluate: recordings of others, refusals, verdicts, the list."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
from browser import data_of
from drives import EPOCH, circling, dwelling, stepped, weaving
from scalars import run_of, write_scalars

from mbd_sim_ros.analysis import runs
from mbd_sim_ros.analysis.evaluation import judging, sine_with_dwell, variants
from mbd_sim_ros.analysis.evaluation.figures import Figure, Result
from mbd_sim_ros.analysis.evaluation.registry import EVALUATIONS, called, names
from mbd_sim_ros.analysis.evaluation.signals import WAYS, Signals, scene_of
from mbd_sim_ros.analysis.evaluation.variants import Variant
from mbd_sim_ros.bags.reader import Run
from mbd_sim_ros.batch import simulate
from mbd_sim_ros.commands.evaluate import report
from mbd_sim_ros.commands.main import main
from solver import load_scene, simulation_of
from solver.errors import SpecError

G = 9.80665


def recorded(directory: Path, s: Signals, names: dict[str, str]) -> Path:
    """A bag of plain scalars: signal -> name of the channel there."""
    stamps = EPOCH + np.round(s.t * 1e9).astype(np.int64)
    topics: dict[str, dict[str, np.ndarray]] = {}
    for name, channel in names.items():
        topic, _, rest = channel.rpartition('/')
        topics.setdefault(topic, {})[rest] = s[name]
    return write_scalars(directory, {topic: (stamps, columns) for topic, columns in topics.items()})


MAPPING = """
channels:
  yaw_rate: {channel: car/imu/yaw, unit: deg/s}
  lateral_acceleration: {channel: car/imu/lateral, unit: g, sign: -1}
  speed: {channel: car/speed/kmh, unit: km/h}
  steering: {channel: car/wheel/angle, unit: deg}
"""
THEIRS = {
    'yaw_rate': 'car/imu/yaw',
    'lateral_acceleration': 'car/imu/lateral',
    'speed': 'car/speed/kmh',
    'steering': 'car/wheel/angle',
}


@pytest.fixture
def foreign(tmp_path: Path) -> tuple[Path, Path]:
    """A recording of another system with a step steer, and the mapping file for it."""
    s = stepped(rate=100.0)
    units = {'yaw_rate': 180.0 / math.pi, 'lateral_acceleration': -1.0 / G, 'speed': 3.6, 'steering': 180.0 / math.pi}
    s.values = {name: factor * s[name] for name, factor in units.items()}
    (tmp_path / 'car.yaml').write_text(MAPPING)
    return recorded(tmp_path / 'car', s, THEIRS), tmp_path / 'car.yaml'


def test_a_recording_of_others_is_evaluated(
    foreign: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag, file = foreign
    page = tmp_path / 'page.html'
    assert (
        main(['evaluate', str(bag), '--as', 'iso7401_step', '--mapping', str(file), '--html', str(page), '--json']) == 0
    )
    captured = capsys.readouterr()
    assert captured.err == ''
    data = json.loads(captured.out)
    assert data['passed'] is None
    figures = data['results'][0]['figures']
    assert figures['yaw_rate_peak_time']['value'] == pytest.approx(math.pi / (2.0 * np.pi * 1.2 * 0.8), abs=5e-3)
    assert figures['yaw_rate_peak_time']['unit'] == 's'
    assert figures['lateral_acceleration_gain']['value'] == pytest.approx(8.0, rel=2e-3)
    assert "default-src 'none'" in page.read_text(encoding='utf-8')  # it can fetch nothing
    assert main(['evaluate', str(bag), '--as', 'iso7401_step', '--mapping', str(file)]) == 0
    assert 'not judged' in capsys.readouterr().out


@pytest.mark.parametrize('options', [[], ['--map', 'wheel=steering'], ['--mapping', 'car.yaml']])
def test_a_table_in_the_units_of_its_header_is_evaluated_in_si(
    options: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The units of the header count, but where a mapping says another one."""
    monkeypatch.chdir(tmp_path)
    s = stepped(rate=100.0)
    wheel = 'wheel' if options else 'steering'
    columns = {
        f'{wheel} [deg]': 180.0 / math.pi,
        'speed [km/h]': 3.6,
        'yaw_rate [°/s]': 180.0 / math.pi,
        'lateral_acceleration [g]': 1.0 / G,
    }
    values = [
        s.t,
        *(
            factor * s[n]
            for n, factor in zip(('steering', 'speed', 'yaw_rate', 'lateral_acceleration'), columns.values())
        ),
    ]
    np.savetxt(
        'car.csv',
        np.column_stack(values),
        delimiter=',',
        header=','.join(['time [s]', *columns]),
        comments='',
        encoding='utf-8',
    )
    Path('car.yaml').write_text('channels:\n  steering: {channel: wheel, unit: rad}\n')
    assert main(['evaluate', 'car.csv', '--as', 'iso7401_step', '--json', *options]) == 0
    figures = {n: f['value'] for n, f in json.loads(capsys.readouterr().out)['results'][0]['figures'].items()}
    assert figures['speed'] == pytest.approx(22.0)
    assert figures['yaw_rate_steady'] == pytest.approx(0.3, rel=1e-3)
    assert figures['lateral_acceleration_steady'] == pytest.approx(4.0, rel=1e-3)
    assert figures['steering'] == pytest.approx(0.5 * (180.0 / math.pi if '--mapping' in options else 1.0))


@pytest.mark.parametrize(
    ('arguments', 'sentence'),
    [
        ([], 'does not say which maneuver of a norm it holds; say it with --as'),
        (['--as', 'iso7401_stepp'], "did you mean 'iso7401_step'"),
        (['--as', 'iso7401_step'], 'none of the channels that evaluations use is in it'),
        (
            ['--as', 'iso7401_step', '--map', 'car/wheel/angle=steering'],
            'has no speed along the vehicle: the channel speed or',
        ),
        (['--as', 'iso13674', '--mapping', 'FILE'], 'no weaving in the recording'),
        (['--as', 'iso7401', '--mapping', 'FILE'], 'hold? iso7401_step, iso7401_frequency'),
        (['--as', 'iso7401_step', '--mapping', 'FILE', '--set', 'settle=1'], "did you mean 'settled'"),
        (['--as', 'iso7401_step', '--mapping', 'FILE', '--set', 'settled'], 'write it as KEY=NUMBER'),
        (['--as', 'iso7401_step', '--mapping', 'FILE', '--set', 'settled=-1'], 'settled = -1.0: must be > 0'),
        (
            ['--as', 'iso7401_frequency', '--mapping', 'FILE', '--set', 'segment=1e-9'],
            'at least 3 are needed; give segment=',
        ),
        (['--as', 'iso7401_frequency', '--mapping', 'FILE', '--set', 'low=3'], 'low = 3.0: must be below high = 2.5'),
        (['--as', 'iso3888_2', '--mapping', 'FILE', '--set', 'start=nan'], 'start = nan: must be a finite number'),
        (['--as', 'iso2631', '--mapping', 'FILE', '--set', 'kx=1e300'], 'kx = 1e+300: must not be beyond 1e+09'),
        (
            ['--as', 'iso7401_step', '--map', 'car/wheel/angle=stering'],
            "no evaluation has a signal 'stering'; did you mean 'steering'?",
        ),
        (
            ['--as', 'iso7401_step', '--mapping', 'FILE', '--sett', 'settled=1'],
            "unrecognized argument --sett; did you mean '--set'?; see mbd evaluate",
        ),
    ],
)
def test_refusals_are_one_sentence(
    foreign: tuple[Path, Path], arguments: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    bag, file = foreign
    assert main(['evaluate', str(bag), *(str(file) if a == 'FILE' else a for a in arguments)]) != 0
    captured = capsys.readouterr()
    assert captured.out == ''
    assert captured.err.count('\n') == 1
    assert sentence in captured.err


@pytest.mark.parametrize(
    ('right', 'wrong', 'factor'),
    [
        ('', '', None),
        ('unit: deg/s', 'unit: rad/s', math.pi / 180.0),
        ('unit: km/h', 'unit: m/s', 1.0 / 3.6),
        (', sign: -1', '', -1.0),
    ],
)
def test_units_and_signs_that_cannot_be_are_told(
    foreign: tuple[Path, Path], right: str, wrong: str, factor: float | None, capsys: pytest.CaptureFixture[str]
) -> None:
    bag, file = foreign
    file.write_text(MAPPING.replace(right, wrong))
    assert main(['evaluate', str(bag), '--as', 'iso7401_step', '--mapping', str(file), '--json']) == 0
    notes = json.loads(capsys.readouterr().out)['results'][0]['notes']
    told = [note for note in notes if 'check units, signs and axes' in note]
    assert len(told) == (factor is not None)
    if factor is not None:  # of 4 m/s^2 at 22 m/s and 0.3 rad/s
        assert float(told[0].split()[4]) == pytest.approx(factor * 4.0 / 6.6, rel=0.05)


def test_a_steering_wheel_whose_sign_is_wrong_is_told(
    foreign: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Else a car that understeers has an understeer gradient below zero, and nobody knows why."""
    bag, file = foreign
    file.write_text(MAPPING.replace('angle, unit: deg', 'angle, unit: deg, sign: -1'))
    assert main(['evaluate', str(bag), '--as', 'iso7401_step', '--mapping', str(file), '--json']) == 0
    notes = json.loads(capsys.readouterr().out)['results'][0]['notes']
    assert notes == [
        'the car turns to the other side than its steering wheel: check the signs of steering and yaw rate'
    ]
    for s in (circling('constant_radius'), circling('constant_speed', -1.0), weaving(), dwelling(), stepped(-1.0)):
        del s.values['lateral_acceleration']  # of its own
        assert judging.misfit(s) == ()
        s.values['steering'] = -s['steering']
        assert len(judging.misfit(s)) == 1
    braked = stepped()  # on split friction he steers against what turns the car
    braked.values |= {'steering': -braked['steering'], 'brake': np.ones(braked.t.size)}
    del braked.values['lateral_acceleration']
    assert judging.misfit(braked) == ()


def test_a_steering_wheel_beyond_any_lock_is_told() -> None:
    """52 deg taken as rad: all gains were 57 times too small, without a word."""
    s = stepped()
    s.values['steering'] = s['steering'] * 0.9 / np.abs(s['steering']).max()
    assert judging.misfit(s) == ()
    s.values['steering'] = np.degrees(s['steering'])
    assert judging.misfit(s) == ('the steering wheel is turned to 51.57 rad, beyond any lock: check its unit',)


def swept(rate: float = 100.0) -> Signals:
    """A swept sine to 3.5 Hz of a car whose lateral acceleration lags behind its yaw rate, as 1 / (1 + i w / (5
    rad/s))^2 in size and half of that in phase: 1 times speed times yaw rate where it is slow, next to nothing where it
    is fast."""
    t = np.arange(0.0, 60.0, 1.0 / rate)
    w = 2.0 * math.pi * np.linspace(0.05, 3.5, t.size)
    phase = np.concatenate([[0.0], np.cumsum(0.5 * (w[1:] + w[:-1]) / rate)])
    lag = np.arctan(w / 5.0)
    yaw, lateral = 0.1 * np.sin(phase), 2.2 * np.cos(lag) ** 2 * np.sin(phase - lag)
    values = {
        'steering': 0.3 * np.sin(phase + 0.1),
        'speed': np.full(t.size, 22.0),
        'yaw_rate': yaw,
        'lateral_acceleration': lateral,
    }
    return Signals(place='car', t=t, values=values, notes=[])


def test_a_car_that_is_steered_faster_than_it_follows_is_no_wrong_unit() -> None:
    """The full car was told to check its units in its own swept sine, where the lateral acceleration is 0.48 of speed
    times yaw rate."""
    s = swept()
    turning = s['speed'] * s['yaw_rate']
    assert turning @ s['lateral_acceleration'] / (turning @ turning) < judging.FITS[0]
    assert judging.misfit(s) == ()
    for name, factor in (
        ('lateral_acceleration', 1.0 / G),
        ('yaw_rate', 180.0 / math.pi),
        ('speed', 3.6),
        ('lateral_acceleration', -1.0),
    ):
        wrong = swept()
        wrong.values[name] = factor * wrong[name]
        assert any('times speed times yaw rate, not about 1: check units' in note for note in judging.misfit(wrong)), (
            name
        )
    back = swept()
    back.values |= {name: -back[name] for name in ('speed', 'yaw_rate')}
    assert judging.misfit(back) == ()


def test_units_of_our_own_recordings_are_known_until_somebody_maps_them() -> None:
    s = stepped()
    s.values['yaw_rate'] = np.degrees(s['yaw_rate'])
    told = 'check units, signs and axes of the three'
    for metadata, mapped, doubted in (
        ({}, False, True),
        ({'resolved_scene': 'name: x'}, False, False),
        ({'resolved_scene': ''}, True, True),
    ):
        run = run_of(s.values, np.round(s.t * 1e9), {'status': 'ok', **metadata})
        found = judging.judge(called('iso7401_step')[0], run, 'bag', {}, mapped=mapped)
        assert any(told in note for note in found.notes) == doubted


@pytest.mark.parametrize('signal', ['steering', 'yaw_rate'])
def test_what_is_no_number_is_told(signal: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    s = stepped(rate=100.0)
    s.values[signal] = s[signal].copy()
    s[signal][50:120] = np.nan
    channels = {name: f'car/{name}' for name in THEIRS}
    options = ['--as', 'iso7401_step', '--map', 'car/*=*', '--json']
    assert main(['evaluate', str(recorded(tmp_path / 'part', s, channels)), *options]) == 0
    counted = f'topic car: values that are no number: car/{signal} (70)'
    assert json.loads(capsys.readouterr().out)['results'][0]['notes'] == [
        counted,
        '0.71 s without samples behind t = 0.49 s',
    ]
    s[signal][:] = np.nan
    assert main(['evaluate', str(recorded(tmp_path / 'all', s, channels)), *options]) == 5
    assert f'the channel {signal} holds no number' in json.loads(capsys.readouterr().out)['error']


def test_a_car_that_stands_drives_no_maneuver(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    s = stepped(rate=100.0)
    s.values['speed'] = np.zeros(s.t.size)
    bag = recorded(tmp_path / 'car', s, {name: f'car/{name}' for name in THEIRS})
    assert main(['evaluate', str(bag), '--as', 'iso7401_step', '--map', 'car/*=*']) == 5
    assert 'the car does not move' in capsys.readouterr().err


@pytest.mark.parametrize(
    'metadata, told',
    [
        ({}, ''),  # of others
        ({'resolved_scene': 'name: x', 'status': 'ok'}, ''),
        (
            {'resolved_scene': 'name: x', 'status': 'suspect', 'findings': '[{"text": "it drifts"}]'},
            'the run is suspect: it drifts',
        ),
        (
            {'resolved_scene': 'name: x', 'end': 'the simulating process died'},
            'the run has no verdict: the simulating process died',
        ),
        ({'resolved_scene': 'name: x'}, 'the run has no verdict: its recording was cut off'),
        (
            {'resolved_scene': 'name: x', 'status': 'ok', 'damage': 'its end is missing'},
            'the recording is not whole: its end is missing',
        ),
        ({'resolved_scene': 'name: x', 'status': 'ok', 'dropped_steps': '0'}, ''),
        (
            {'resolved_scene': 'name: x', 'status': 'ok', 'dropped_steps': '20'},
            '20 steps are missing in the recording: the disk was too slow for them',
        ),
    ],
)
def test_a_run_that_is_not_ok_or_not_whole_is_told(metadata: dict[str, str], told: str) -> None:
    assert runs.suspicion(Run({}, metadata)) == ((told,) if told else ())


def test_strict_fails_where_the_norm_is_not_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keys = {name: name for name in ('steering', 'speed', 'yaw_rate', 'lateral_acceleration')}
    bags = [
        recorded(tmp_path / name, dwelling(ratios=ratios), {k: f'car/{v}' for k, v in keys.items()})
        for name, ratios in (('good', (0.2, 0.1)), ('bad', (0.5, 0.1)))
    ]
    options = ['--as', 'sine_with_dwell', '--map', 'car/*=*']
    assert main(['evaluate', str(bags[0]), *options, '--strict']) == 0
    assert main(['evaluate', str(bags[1]), *options]) == 0
    assert main(['evaluate', str(bags[1]), *options, '--strict']) == 1
    capsys.readouterr()
    assert main(['evaluate', *map(str, bags), *options, '--json']) == 0
    data = json.loads(capsys.readouterr().out)
    assert data['passed'] is False
    assert data['together']['fmvss126']['worst_ratio_100']['value'] == pytest.approx(0.5, rel=0.02)


def test_every_evaluation_is_listed_and_can_be_called(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['evaluate', '--list', '--json']) == 0
    data = json.loads(capsys.readouterr().out)
    assert [e['name'] for e in data['evaluations']] == [e.name for e in EVALUATIONS]
    for e in EVALUATIONS:
        assert called(e.name) == (e,)
        assert set(e.needs + e.also) <= set(WAYS)
        assert judging.parameters_of(e, {})
    assert [e.name for e in called('iso4138')] == [
        'iso4138_constant_radius',
        'iso4138_constant_steering',
        'iso4138_constant_speed',
    ]
    assert called('ISO-3888-2')[0].name == 'iso3888_2'
    assert 'iso19365' in names()
    with pytest.raises(SpecError, match='iso4138'):
        called('iso4183')


@pytest.mark.parametrize(
    ('stated', 'judged'),
    [('fmvss126', True), ('iso19365', True), ('ISO-19365', True), ('iso7401_step', False), ('of mine', False)],
)
def test_what_a_maneuver_states_counts_by_every_name_of_its_evaluation(stated: str, judged: bool) -> None:
    """With A = 0.25 rad the 1.5 rad of the steering wheel are 6 A, and responsiveness is judged."""
    scene = load_scene('light_car_straight', [f'maneuver.evaluation={stated}', 'maneuver.evaluate_with.reference=0.25'])
    s = dwelling()
    run = run_of(s.values, np.round(s.t * 1e9))
    found = judging.judge(called('fmvss126')[0], run, 'bag', {}, scene=scene)
    assert ('over_reference' in [f.name for f in found.figures]) == judged
    assert judging.judge(called('fmvss126')[0], run, 'bag', {'reference': 0.3}, scene=scene)[
        'over_reference'
    ] == pytest.approx(5.0, rel=2e-3)


def test_a_scene_that_cannot_be_read_any_more_is_told_and_its_recording_judged() -> None:
    s = dwelling()
    run = run_of(s.values, np.round(s.t * 1e9), {'resolved_scene': 'engine: of another version', 'status': 'ok'})
    assert scene_of(run, 'bag')[0] is None
    found = judging.judge(called('fmvss126')[0], run, 'bag', {'reference': 0.3})
    assert found['over_reference'] == pytest.approx(5.0, rel=2e-3)
    (told,) = [note for note in found.notes if 'scene in bag' in note]
    assert 'a scene needs exactly one of the keys' in told and 'masses and the steering ratio are not known' in told


def test_a_figure_without_value_never_passes() -> None:
    assert Result(evaluation='x', title='x', norm='x', figures=()).passed is None
    r = sine_with_dwell.judge(dwelling(), sine_with_dwell.SineWithDwell())
    assert all(math.isfinite(f.value) for f in r.figures if f.ok)


def test_the_notes_of_a_series_are_told_and_the_figures_of_what_is_in_no_series() -> None:
    """Two sines with dwell, one of them too slow, and a step of the steering wheel; the text had the table of the
    series alone."""
    slow = dwelling(side=-1.0)
    slow.values['speed'][:] = 60.0 / 3.6
    known = sine_with_dwell.SineWithDwell
    runs_ = [sine_with_dwell.judge(s, known()) for s in (dwelling(), slow)]
    runs_ = [dataclasses.replace(r, source=f'bags/{name}') for r, name in zip(runs_, ('first', 'second'), strict=True)]
    step = called('iso7401_step')[0].judge(stepped(), called('iso7401_step')[0].parameters())
    text = report([Variant('car', (*runs_, step))], html=None, strict=False).text
    assert 'fmvss126, 2 runs' in text
    assert text.count('responsiveness is not judged') == 1
    assert 'note (2 of 2 runs): responsiveness is not judged' in text
    assert 'note (second): steered at 60 km/h; the norm wants 80 km/h, to 2 km/h' in text
    assert 'yaw rate, response time (90 %)' in text
    close = [
        dataclasses.replace(r, notes=(f'steered at {speed} km/h',))
        for r, speed in zip(runs_, (74.7, 7.5e1), strict=True)
    ]
    assert (
        'note (2 of 2 runs, this of first): steered at 74.7 km/h'
        in report([Variant('car', tuple(close))], html=None, strict=False).text
    )
    many = [dataclasses.replace(runs_[0], notes=('note ' + 'x' * k,)) for k in range(11)]
    text = report([Variant('car', tuple(many))], html=None, strict=False).text
    assert text.count('note (') == 8
    assert '... and 3 more notes; --json or --html has all' in text


def varied(tmp_path: Path, options: dict[str, float]) -> list[str]:
    """Bags of a step steer whose yaw rate is larger by a factor: name -> factor."""
    keys = {name: f'car/{name}' for name in ('steering', 'speed', 'yaw_rate', 'lateral_acceleration')}
    places = []
    for name, factor in options.items():
        s = stepped(rate=100.0)
        s.values['yaw_rate'] = factor * s['yaw_rate']
        places.append(str(recorded(tmp_path / name, s, keys)))
    return places


def test_variants_stand_side_by_side_with_their_differences(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of linear figures the difference in percent is that of the signal: 25 % more, 40 % less."""
    places = varied(tmp_path, {'base': 1.0, 'more': 1.25, 'less': 0.6})
    options = ['--as', 'iso7401_step', '--map', 'car/*=*']
    assert main(['evaluate', *places, *options, '--json']) == 0
    (found,) = json.loads(capsys.readouterr().out)['variants']
    assert found['names'] == ['base', 'more', 'less']
    assert found['figures']['yaw_rate_steady']['difference_percent'] == pytest.approx([0.0, 25.0, -40.0], abs=1e-6)
    base = found['figures']['yaw_rate_steady']['values'][0]
    assert found['figures']['yaw_rate_steady']['values'] == pytest.approx([base, 1.25 * base, 0.6 * base])
    assert found['figures']['lateral_acceleration_steady']['difference_percent'] == pytest.approx([0, 0, 0])
    assert main(['evaluate', *places, *options]) == 0
    out = capsys.readouterr().out
    head = next(line for line in out.splitlines() if line.startswith('figure'))
    assert head.split() == ['figure', 'unit', 'base', 'more', 'difference', 'less', 'difference']
    assert '+25 %' in out and '-40 %' in out


def test_differences_say_no_more_than_is_known() -> None:
    """Of a base of zero there is no percentage; one below the numerical errors is told as such; a negative base counts
    by its size; a figure that a variant lacks is empty."""
    figures = [
        Figure('zero', 'zero', 0.0, 'm'),
        Figure('negative', 'negative', -2.0, 'm'),
        Figure('close', 'close', 1.0, 'm', error=0.01),
        Figure('lone', 'lone', 1.0, 'm'),
    ]
    others = [
        Figure('zero', 'zero', 1.0, 'm'),
        Figure('negative', 'negative', -1.0, 'm', ok=False),
        Figure('close', 'close', 1.015, 'm', error=0.01),
    ]
    of = [
        Variant(name, (Result(evaluation='iso7401_step', title='', norm='', figures=tuple(some)),))
        for name, some in (('a', figures), ('b', others))
    ]
    rows = {row[0]: row[1:] for row in variants.rows(of, 'iso7401_step')[1:]}
    assert rows == {
        'zero': ('m', '0', '1', '-'),
        'negative': ('m', '-2', '-1 FAIL', '+50 %'),
        'close': ('m', '1 ± 0.01', '1.015 ± 0.01', variants.WITHIN),
        'lone': ('m', '1', '-', '-'),
    }


@pytest.mark.slow
def test_variants_say_in_which_keys_they_differ(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Those of our own recordings, at the head of text and page: the second from the first, and one that does not."""
    places = []
    for name, overrides in (('base', ()), ('heavy', ('vehicle.chassis.mass=1500', 'integrator.h=0.002')), ('same', ())):
        simulation = simulation_of(load_scene('light_car_step_steer', ['duration=6', *overrides]))
        places.append(str(tmp_path / name))
        simulate(simulation, simulation.scene.steps, directory=tmp_path / name)
    html = tmp_path / 'p.html'
    assert main(['evaluate', *places, '--as', 'iso7401_step', '--html', str(html)]) == 0
    said = capsys.readouterr().out
    heavy = said.splitlines()[0].removeprefix('heavy differs from base: ')
    assert {*heavy.split(', ')} == {'integrator.h: 0.001 \u2192 0.002', 'vehicle.chassis.mass: 1250 \u2192 1500'}
    assert 'same differs from base: none' in said
    assert any(line.startswith('heavy differs from base: ') for line in data_of(html)['about'])


def test_a_series_is_a_variant_and_so_is_what_mbd_maneuver_left(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two directories as `mbd maneuver` leaves them, each with two sines with dwell: their worst figures are compared,
    and a directory whose report names what is not there is refused."""
    keys = {name: f'car/{name}' for name in ('steering', 'speed', 'yaw_rate', 'lateral_acceleration')}
    for name, ratios in (('soft', ((0.2, 0.1), (0.3, 0.1))), ('stiff', ((0.25, 0.1), (0.15, 0.1)))):
        for k, ratio in enumerate(ratios):
            recorded(tmp_path / name / f'run{k}', dwelling(ratios=ratio), keys)
        results = [{'source': f'elsewhere/run{k}'} for k in range(2)]
        (tmp_path / name / 'report.json').write_text(json.dumps({'results': results, 'refused': {'other': 'why'}}))
    places = [str(tmp_path / name) for name in ('soft', 'stiff')]
    assert main(['evaluate', *places, '--as', 'fmvss126', '--map', 'car/*=*', '--json']) == 0
    (found,) = json.loads(capsys.readouterr().out)['variants']
    worst = found['figures']['worst_ratio_100']
    assert found['names'] == ['soft', 'stiff'] and worst['values'] == pytest.approx([0.3, 0.25], rel=0.02)
    assert main(['evaluate', *places, '--as', 'fmvss126', '--map', 'car/*=*']) == 0
    assert f'{places[0]}: other: REFUSED: why' in capsys.readouterr().out
    (tmp_path / 'soft' / 'report.json').write_text(json.dumps({'results': [{'source': 'x/run7'}], 'refused': {}}))
    assert main(['evaluate', *places, '--as', 'fmvss126', '--map', 'car/*=*']) == 5
    assert 'names run7, which is not in' in capsys.readouterr().err
    (tmp_path / 'soft' / 'report.json').write_text('[]')
    assert main(['evaluate', *places, '--as', 'fmvss126', '--map', 'car/*=*']) == 5
    assert 'is no report of mbd maneuver' in capsys.readouterr().err


def test_names_of_variants_tell_them_apart() -> None:
    found = variants.names([Path('a/run'), Path('b/run'), Path('c')])
    assert found[:2] == ['a/run', 'b/run'] and found[2].endswith('/c')
    assert variants.names([Path('a'), Path('a')]) == ['a', 'a (2)']
    assert variants.names([Path('x/one'), Path('y/two')]) == ['one', 'two']
