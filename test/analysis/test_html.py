"""The report: everything is in one file, and the numbers in it are those of the comparison. A browser draws it in
test_page_in_browser.py."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from browser import blocks_of, data_of, numbers
from scalars import run, run_of

from mbd_sim_ros.analysis.comparison import Comparison, compare
from mbd_sim_ros.analysis.html import write_report
from solver.errors import BagError


def compared() -> Comparison:
    b = run(n=501, **{'imu/wz': np.sin, 'odom/twist/vx': lambda t: 20.0 + t})
    a = run_of({'imu/wz': 1.1 * b['imu/wz'], 'odom/twist/vx': b['odom/twist/vx']}, b.time_ns)
    return compare(a, b)


def written(found: Comparison, file: Path, names: tuple[str, ...] = ('run', 'car <1>')) -> dict:
    facts = [('tolerances', 'rtol 1e-3')]
    verdict = (False, '1 of 2 channels outside')
    write_report(found, file, names=names, about=['0.137 s added'], verdict=verdict, facts=facts)
    return data_of(file)


def test_the_report_holds_the_figures_and_curves(tmp_path: Path) -> None:
    found = compared()
    data = written(found, tmp_path / 'deep' / 'r.html')
    assert data['title'] == 'run compared with car <1>'
    assert data['verdict'] == {'ok': False, 'text': '1 of 2 channels outside'}
    assert ['tolerances', 'rtol 1e-3'] in data['facts'] and data['about'] == ['0.137 s added']
    (table,) = blocks_of(data, 'table')
    rows = {row[0]: dict(zip(table['columns'], row, strict=True)) for row in table['rows']}
    wz = found.differences[0]
    assert rows['imu/wz']['unit'] == 'rad/s'
    assert rows['imu/wz']['largest difference'] == wz.max
    assert wz.rating is not None and rows['imu/wz']['rating'] == wz.rating.overall
    assert rows['odom/twist/vx']['verdict'] == '' and table['bad'] == [0] and table['goes'][0] == 'imu/wz'
    chart, difference = blocks_of(data, 'charts')[0]['charts'][:2]
    assert (chart['title'], chart['y'], chart['key'], difference['linked']) == (
        'imu/wz',
        'wz [rad/s]',
        'imu/wz',
        'time',
    )
    reference, of_run = chart['curves']
    t = numbers(reference['x'])
    np.testing.assert_allclose(t, np.arange(501) * 0.01, rtol=1e-6)
    assert of_run['x'] is None  # the same
    np.testing.assert_allclose(numbers(of_run['y']), 1.1 * np.sin(t), atol=1e-6)
    np.testing.assert_allclose(numbers(difference['curves'][0]['y']), 0.1 * np.sin(t), atol=1e-6)


def test_repeats_and_their_band_are_drawn(tmp_path: Path) -> None:
    repeats = [run(n=501, x=lambda t, d=d: np.sin(t) + d) for d in (-0.05, 0.0, 0.05)]
    found = compare(run(n=501, x=lambda t: 1.3 * np.sin(t)), *repeats)
    chart = blocks_of(written(found, tmp_path / 'r.html', ('run', 'lap 1', 'lap 2', 'lap 3')), 'charts')[0]['charts'][0]
    styles = [curve['style'] for curve in chart['curves']]
    assert styles == ['band', 'repeat', 'repeat', 'repeat', 'reference', 'run']
    band = chart['curves'][0]
    half = 0.5 * (numbers(band['high']) - numbers(band['y']))
    np.testing.assert_allclose(half, 4.30265 * 0.05 / np.sqrt(3.0), rtol=1e-4)  # Student's t of 2, s = 0.05


def test_stamps_with_the_time_of_day_stay_sharp(tmp_path: Path) -> None:
    b = run(n=501, start_ns=1_700_000_000 * 10**9, x=np.sin)
    chart = blocks_of(written(compare(b, b), tmp_path / 'r.html'), 'charts')[0]['charts'][0]
    assert chart['origin'] == 1.7e9
    np.testing.assert_allclose(np.diff(numbers(chart['curves'][0]['x'])), 0.01, rtol=1e-3)


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / 'file').touch()
    with pytest.raises(BagError, match='cannot write'):
        written(compared(), tmp_path / 'file' / 'r.html')
