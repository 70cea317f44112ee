"""A fit as a whole, of recordings whose truth is known: by the command, and from Python."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from browser import data_of

from mbd_sim_ros import fitting
from mbd_sim_ros.commands.main import main
from mbd_sim_ros.fitting import example
from mbd_sim_ros.fitting.estimation import Fitted
from mbd_sim_ros.fitting.file import load_file
from mbd_sim_ros.fitting.problem import STEP
from solver.errors import BagError, MbdError, SpecError

FIT = """
vehicle: vehicles/light_car.yaml
recordings:
  one: {file: one.csv}
  two: {file: two.csv, use: held_out}
drive: {steering_wheel: wheel, speed: v, gain: {sd: none}, delay: {sd: none}, offset: {sd: none}}
channels:
  yaw_rate: {channel: r, gain: {sd: none}, offset: {sd: none}}
windows: {length: 8}
constants: exact
parameters:
  cornering_stiffness_front: {}
  cornering_stiffness_rear: {}
"""
TRUTH = {'cornering_stiffness_front': 0.88, 'cornering_stiffness_rear': 1.1}


def made(home: Path, *, text: str = FIT, circle: bool = False, seconds: float = 26.0) -> Path:
    """Two recordings of a car with other tires and the file of their fit."""
    (home / 'fit.yaml').write_text(text)
    file = load_file(home / 'fit.yaml')
    for k, name in enumerate(('one', 'two')):
        inputs = example.course(seconds, k + 1)
        if circle:
            inputs[:, 1], inputs[:, 2] = 1.0 * np.clip(inputs[:, 0], 0.0, 1.0), 15.0
        columns = example.recorded(file, home, inputs, TRUTH, {'yaw_rate': {'delay': 0.02}}, k)
        example.write_table(home / f'{name}.csv', columns, {'t': 's', 'wheel': 'rad', 'v': 'm/s', 'r': 'rad/s'})
    return home / 'fit.yaml'


@pytest.fixture(scope='module')
def tables(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recordings, made once."""
    return made(tmp_path_factory.mktemp('drives')).parent


@pytest.fixture
def file(tables: Path, tmp_path: Path) -> Path:
    """The file of a fit, beside recordings of its own."""
    for name in ('one.csv', 'two.csv', 'fit.yaml'):
        (tmp_path / name).write_bytes((tables / name).read_bytes())
    return tmp_path / 'fit.yaml'


@pytest.fixture(scope='module')
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the fit from Python is written."""
    return tmp_path_factory.mktemp('out')


@pytest.fixture(scope='module')
def first(tables: Path, out: Path) -> Fitted:
    """The fit from Python."""
    return fitting.fit(fitting.load(tables / 'fit.yaml'), out)


@pytest.mark.slow
def test_known_truth_from_python(first: Fitted, tables: Path, out: Path) -> None:
    """Every number within its interval, the delay of the sensor too, and an interval of a few percent; a fit that
    begins again with the runs of the first one needs no other ones and has the same bits."""
    for name, truth in TRUTH.items():
        one = first.parameters[name]
        assert one.low - 0.2 * one.sd < truth < one.high + 0.2 * one.sd  # of three numbers one in seven is beyond 95 %
        assert one.told
        assert one.sd < 0.05
    delay = next(e for e in first.estimates if e.name == 'yaw_rate.delay')
    assert abs(delay.value - 0.02) < 3.0 * delay.sd
    assert first.held_out['yaw_rate']['rms'] < 0.5 * first.held_out['yaw_rate']['before']
    again = fitting.fit(fitting.load(tables / 'fit.yaml'), out)
    assert again.problem.runs == 0
    assert np.array_equal(again.x, first.x)
    assert np.array_equal(again.covariance, first.covariance)
    files = fitting.write(first, out)
    text = Path(files['vehicle']).read_text()
    assert 'cornering_stiffness_front' in text
    page = data_of(Path(files['page']))
    facts = dict(page['facts'])
    assert page['verdict']['ok'] is True and 'yaw_rate' in page['verdict']['text']
    assert facts['vehicle'].startswith('light_car, changed, hash ') and 'LKY' in facts['changed keys of the vehicle']
    assert {'begun with', 'level', 'fitted to', 'held out'} <= {*facts} and '' not in facts.values()
    from mbd_sim_ros.sweep.design import cases, load_sweep
    from solver import load_scene

    sweep = load_sweep(files['sweep'])
    drawn = cases(sweep)
    assert len(drawn) == 64
    assert set(drawn[0]) == {'vehicle.front.tire.values.LKY', 'vehicle.rear.tire.values.LKY'}
    spread = np.std([one['vehicle.front.tire.values.LKY'] for one in drawn])
    assert spread == pytest.approx(first.parameters['cornering_stiffness_front'].sd, rel=0.35)
    tire = load_scene(sweep.scene, sweep.set).model.tires[0]
    assert tire.data.values['LKY'] == pytest.approx(first.parameters['cornering_stiffness_front'].value)


@pytest.mark.slow
def test_command_has_the_bits_of_python(
    file: Path, first: Fitted, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One object on stdout, with the names that are promised; the files are there, the runs are gone. Nothing is shared
    with the fit from Python, whose bits it has."""
    assert main(['fit', str(file), '--preflight', '--json', '--workers', '1']) == 0
    told = json.loads(capsys.readouterr().out)
    assert told['parameters']['cornering_stiffness_front']['told'] is True
    assert main(['fit', str(file), '--out', str(tmp_path / 'out'), '--json', '--workers', '1']) == 0
    found = json.loads(capsys.readouterr().out)
    assert found['status'] == 'ok'
    assert set(found['parameters']['cornering_stiffness_rear']) >= {'value', 'low', 'high', 'told'}
    assert set(found['held_out']['yaw_rate']) == {'rms', 'before'}
    for name, one in first.parameters.items():
        assert [found['parameters'][name][key] for key in ('value', 'low', 'high')] == [one.value, one.low, one.high]
    assert all(Path(place).is_file() for place in found['files'].values())
    assert not (tmp_path / 'out' / 'runs').exists()


@pytest.mark.slow
def test_steady_circles_do_not_tell_a_yaw_inertia(tmp_path: Path) -> None:
    """It is told before the fit, with the maneuver that would, and refused; with a prior it goes on."""
    text = FIT.replace('parameters:\n', 'parameters:\n  yaw_inertia: {}\n').replace(
        '  cornering_stiffness_rear: {}\n', ''
    )
    text = text.replace('cornering_stiffness_front: {}', 'cornering_stiffness_front: {sd: class}')
    file = made(tmp_path, text=text, circle=True)
    problem = fitting.load(file)
    row = fitting.preflight(problem).row('yaw_inertia')
    assert not row.told
    assert 'double lane change of ISO 3888-1' in row.maneuvers
    assert 'steady circle' not in row.maneuvers
    with pytest.raises(SpecError, match='yaw_inertia: these recordings give it a standard error') as error:
        fitting.fit(problem)
    assert 'give it a prior' in str(error.value)


@pytest.mark.slow
def test_derivatives_do_not_depend_on_their_step(tmp_path: Path) -> None:
    """Derivatives of a fit beside Richardson's extrapolation of two with two and four times their step, of order four:
    parameters and the delay of the steering, with torques that follow a noisy speed, to 1e-6 of a signal."""
    text = FIT.replace(', delay: {sd: none}', '').replace('parameters:', 'parameters:\n  mass: {sd: class}')
    problem = fitting.load(made(tmp_path, text=text, seconds=14.0))
    which = problem.of('fit')
    motions = problem.motions(problem.start, which)
    columns = [problem.names.index(n) for n in ('mass', 'cornering_stiffness_front', 'steering.delay')]
    J, two, four = (
        problem.jacobian(problem.start, which, motions, columns, step=k * STEP)[:, columns] for k in (1, 2, 4)
    )
    size = float(np.std(np.concatenate([p.y for p in problem.pieces])))
    error = np.abs(J - (two + (two - four) / 3.0)) / size
    assert np.abs(J).max() > 1e-2 * size
    assert error.max() < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize(
    ('change', 'sentence'),
    [
        (('use: held_out', 'use: fit'), 'none is held out'),
        (('file: one.csv', 'file: one.csv, end: 9'), 's are left to fit'),
        (('channel: r', 'channel: q'), 'no signal'),
        (('file: two.csv', 'file: none.csv'), 'no such file'),
        (('cornering_stiffness_rear: {}', 'cornering_stiffness_rear: {value: 20}'), 'outside of its bounds'),
        (('cornering_stiffness_rear: {}', 'cornering_stiffness: {}'), 'keep one of them'),
        (('cornering_stiffness_rear: {}', 'cornering_stifness_rear: {}'), 'did you mean'),
        (('yaw_rate:', 'yaw_speed:'), 'no quantity'),
        (('wheel,', 'wheel, scale: 60,'), 'units of its channels'),
    ],
)  # fmt: skip
def test_refused(file: Path, change: tuple[str, str], sentence: str) -> None:
    """One sentence each, and the right one."""
    file.write_text(FIT.replace(*change))
    with pytest.raises(MbdError, match=sentence) as error:
        fitting.fit(fitting.load(file))
    assert '\n' not in str(error.value)


@pytest.mark.long
def test_a_result_that_is_worse_is_refused(file: Path, tmp_path: Path) -> None:
    """The recording that is held out is of the car that the fit begins with: what fits the other one is worse there."""
    given = load_file(file)
    columns = example.recorded(given, tmp_path, example.course(26.0, 2), {}, {'yaw_rate': {'delay': 0.02}}, 3)
    example.write_table(tmp_path / 'two.csv', columns, {'t': 's', 'wheel': 'rad', 'v': 'm/s', 'r': 'rad/s'})
    with pytest.raises(MbdError, match='predicts the recordings held out worse'):
        fitting.fit(fitting.load(file))


@pytest.mark.slow
def test_priors_that_exclude_each_other(file: Path) -> None:
    """A number that is known to a thousandth, and which the recordings contradict."""
    file.write_text(FIT.replace('cornering_stiffness_rear: {}', 'cornering_stiffness_rear: {value: 1.5, sd: 0.1 %}'))
    with pytest.raises(BagError, match='of another car, or its value and sd under parameters'):
        fitting.fit(fitting.load(file))
