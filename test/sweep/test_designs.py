"""Designs of sweeps: where their cases lie, and what is said of their figures."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from mbd_sim_ros.commands.main import main
from mbd_sim_ros.sweep.case import overrides_of
from mbd_sim_ros.sweep.design import Design, Parameter, Sweep, SweepFigure, cases, load_sweep
from mbd_sim_ros.sweep.table import known_to, no_indices, sensitivities
from solver.errors import SceneError, SpecError


def sweep_of(kind: str, samples: int = 16, **more: Parameter) -> Sweep:
    ranges = {name: Parameter(low=0.0, high=1.0) for name in ('a', 'b', 'c')} | more
    return Sweep(
        scene='x',
        parameters=ranges,
        figures={'f': SweepFigure(quantity='q')},
        design=Design(kind=kind, samples=samples, seed=3),
    )  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ('kind', 'count'), [('latin_hypercube', 16), ('sobol', 16), ('morris', 16 * 4), ('saltelli', 16 * 5), ('grid', 125)]
)
def test_designs_stay_inside_repeat_and_fill_the_space(kind: str, count: int):
    sweep = sweep_of(kind)
    found = cases(sweep)
    assert found == cases(sweep)
    table = np.array([[case[name] for name in 'abc'] for case in found], float)
    assert table.shape == (count, 3)
    assert (table >= 0.0).all() and (table <= 1.0).all()
    if kind == 'latin_hypercube':  # one in every sixteenth of each axis
        assert (np.sort(np.floor(16 * table).astype(int), axis=0) == np.arange(16)[:, None]).all()
    if kind == 'sobol':  # balanced: as many in either half
        assert ((table < 0.5).sum(axis=0) == 8).all()


def test_why_there_are_no_indices_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """One failed case of twelve takes the indices of all figures, and one that is always the same has none."""
    (tmp_path / 's.yaml').write_text(
        'scene: pendulum\nset: [duration=0.02]\ndesign: {kind: morris, samples: 2}\nparameters: {integrator.rho_inf: '
        '{low: 0.5, high: 1.3}}\nfigures: {y: {quantity: odom/pose/y, take: min}}\n'
    )
    assert main(['sweep', str(tmp_path / 's.yaml'), '--out', str(tmp_path / 'out'), '--workers', '1']) == 0
    reason = r'no indices of y: [1-3] of 4 cases have no value'
    assert re.search(reason, capsys.readouterr().out)
    assert re.search(reason, (tmp_path / 'out' / 'report.html').read_text())
    sweep = sweep_of('morris', 2)
    assert no_indices(sweep, [{'f': 1.0}, {'f': 1.0}], 'f') == 'no indices of f: it is the same in all cases'
    still = [{'f': 3e-17 * k} for k in range(4)]  # the yaw rate of a car that drives straight on: nothing but rounding
    assert no_indices(sweep, still, 'f') == 'no indices of f: it is the same in all cases'
    assert no_indices(sweep, [{'f': 1e-9}, {'f': 2e-9}], 'f') == ''
    assert no_indices(sweep_of('grid'), [{'f': 1.0}], 'f') == ''
    assert no_indices(sweep, [{'f': 1.0}, {'f': 2.0}], 'f') == ''


def test_indices_of_a_known_function():
    """f = a + 2 b: S1 = ST = 1/5, 4/5, 0; elementary effects 1, 2, 0 everywhere."""
    for kind in ('saltelli', 'morris'):
        sweep = sweep_of(kind, 1024 if kind == 'saltelli' else 8)
        rows = [{**case, 'f': float(case['a']) + 2.0 * float(case['b'])} for case in cases(sweep)]
        found = sensitivities(sweep, rows)['f']
        if kind == 'saltelli':
            for name, share in zip('abc', (0.2, 0.8, 0.0), strict=True):
                # the estimator's error falls like 1/sqrt(1024)
                assert found[name]['S1'] == pytest.approx(share, abs=0.1)
                assert found[name]['ST'] == pytest.approx(share, abs=0.1)
        else:
            for name, effect in zip('abc', (1.0, 2.0, 0.0), strict=True):
                assert found[name]['mu_star'] == pytest.approx(effect, abs=1e-9)
                assert found[name]['sigma'] == pytest.approx(0.0, abs=1e-9)


def test_indices_say_how_well_they_are_known():
    """Of f = a + 2 b the width of a confidence interval falls like the root of the samples, here to an eleventh; eight
    tell it badly."""
    found = {}
    for samples in (8, 1024):
        sweep = sweep_of('saltelli', samples)
        rows = [{**case, 'f': float(case['a']) + 2.0 * float(case['b'])} for case in cases(sweep)]
        found[samples] = sensitivities(sweep, rows)['f']
    for name in 'ab':
        for index in ('S1', 'ST'):
            few, many = (found[samples][name][f'{index}_conf'] for samples in (8, 1024))
            assert few > 2.0 * many > 0.0
            assert abs(found[1024][name][index] - {'a': 0.2, 'b': 0.8}[name]) < 2.0 * many
    assert known_to(sweep_of('saltelli', 1024), found[1024]) == ''
    assert known_to(sweep_of('saltelli', 8), found[8]) == (
        'its indices are known to about 0.59 (95 % confidence): samples = 8 are few, about 512 would give 0.1'
    )
    # two samples that happen to agree
    exact = {name: dict.fromkeys(('S1', 'S1_conf', 'ST', 'ST_conf'), 0.0) for name in 'abc'}
    assert known_to(sweep_of('saltelli', 2), exact).startswith('its indices are known to about 0.71')
    assert known_to(sweep_of('morris', 2), {'a': {'mu_star': 1.0, 'mu_star_conf': 1.0, 'sigma': 1.0}}) == ''


def test_elementary_effects_are_those_of_the_whole_range():
    """f = d/100 + a, d from 1000 to 1500."""
    sweep = sweep_of('morris', 4, d=Parameter(low=1000.0, high=1500.0))
    rows = [{**case, 'f': 0.01 * float(case['d']) + float(case['a'])} for case in cases(sweep)]
    found = sensitivities(sweep, rows)['f']
    assert found['d']['mu_star'] == pytest.approx(5.0, rel=1e-9)
    assert found['a']['mu_star'] == pytest.approx(1.0, rel=1e-9)
    assert found['d']['mu_star_conf'] == pytest.approx(0.0, abs=1e-9)


def test_designs_that_cannot_be_are_refused():
    with pytest.raises(SpecError, match='power of two'):
        Design(kind='sobol', samples=12)
    with pytest.raises(SpecError, match=r'samples = 1: must be 2 at least: sigma is the spread of trajectories'):
        Design(kind='morris', samples=1)
    for seed in (-1, 2**32):
        with pytest.raises(SpecError, match=f'seed = {seed}: must be a whole number'):
            Design(seed=seed)
    with pytest.raises(SpecError, match='low and high'):
        sweep_of('morris', 16, d=Parameter(values=(1.0, 2.0)))
    with pytest.raises(SceneError, match='more than'):
        cases(sweep_of('grid', **{name: Parameter(low=0.0, high=1.0, steps=100) for name in 'abcd'}))
    with pytest.raises(SceneError, match='more than'):  # before the values are laid out, which would fill the memory
        cases(sweep_of('grid', a=Parameter(low=0.0, high=1.0, steps=10**15)))


@pytest.mark.parametrize('names', [('vehicle', 'vehicle.chassis.mass'), ('vehicle.chassis.mass', 'vehicle')])
def test_a_part_of_a_parameter_is_set_behind_it(names: tuple[str, ...]) -> None:
    """In the order of the file the mass was replaced with the vehicle, and the table said that it had varied."""
    assert overrides_of(dict.fromkeys(names, 'x')) == ['vehicle=x', 'vehicle.chassis.mass=x']


@pytest.mark.parametrize(
    ('given', 'parameters', 'told'),
    [
        (
            [],
            ('start.speed', 'start.speed_kmh'),
            'parameters = .start.speed_kmh.: is the same key as start.speed; keep one of them',
        ),
        ([], ('road.a[0]', 'road.a.0'), 'is the same key as'),
        (
            ['start.speed=20'],
            ('integrator.h', 'start'),
            'set = .start.speed=20.: has no effect, because the parameter start replaces all',
        ),
        (
            ['start.speed=20', 'start={}'],
            ('integrator.h',),
            'set = .start.speed=20.: has no effect, because the parameter start={} replaces all',
        ),
    ],
)
def test_what_would_have_no_effect_is_refused(given: list[str], parameters: tuple[str, ...], told: str) -> None:
    one = {name: Parameter(values=(1.0,)) for name in parameters}
    with pytest.raises(SpecError, match=told):
        Sweep(scene='x', set=tuple(given), parameters=one, figures={'f': SweepFigure(quantity='yaw_rate')})


def tabled(directory: Path, table: str) -> Sweep:
    (directory / 'table.csv').write_text(table)
    file = directory / 'sweep.yaml'
    file.write_text(
        'scene: car_step_steer\ndesign: {kind: samples, file: table.csv}\nfigures: {r: {quantity: yaw_rate}}\n'
    )
    return load_sweep(file)


def test_the_rows_of_a_table_are_the_cases(tmp_path: Path) -> None:
    sweep = tabled(tmp_path, 'integrator.h, duration\n0.001,2\n\n0.002,1\n')
    assert sweep.fewest == 2
    assert sweep.design.text == 'rows of table.csv'
    assert cases(sweep) == [{'integrator.h': 0.001, 'duration': 2.0}, {'integrator.h': 0.002, 'duration': 1.0}]


@pytest.mark.parametrize(
    ('table', 'told'),
    [
        ('integrator.h\n', 'table.csv: a table of samples needs a header of keys, and rows'),
        ('integrator.h\n\n0.001\nx\n', "table.csv:4: 'x': every cell must be a finite number"),
        ('integrator.h,duration\n0.001,1\n\n0.001\n', 'table.csv:4: 1 cells, but the header has 2'),
        ('\nduration,duration\n1,1\n', 'table.csv:2: a key stands twice in the header'),
        ('integrator.h,\n0.001,1\n', 'table.csv:1: column 2 of the header has no key'),
        ('integrator.h\nnan\n', "table.csv:2: 'nan': every cell must be a finite number"),
    ],
)
def test_a_table_that_cannot_be_is_refused_where_it_is_wrong(tmp_path: Path, table: str, told: str) -> None:
    with pytest.raises(SceneError, match=re.escape(told)):
        tabled(tmp_path, table)
