"""The report: everything is in one file, the numbers in it are those of the comparison, and a browser draws it."""

from __future__ import annotations

import base64
import json
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from browser import CHROMIUM, QUIET
from scalars import run, run_of

from mbd_sim_ros.analysis.comparison import Comparison, compare
from mbd_sim_ros.analysis.html import write_report
from solver.errors import BagError


def compared() -> Comparison:
    b = run(n=501, **{'imu/wz': np.sin, 'odom/twist/vx': lambda t: 20.0 + t})
    a = run_of({'imu/wz': 1.1 * b['imu/wz'], 'odom/twist/vx': b['odom/twist/vx']}, b.time_ns)
    return compare(a, b)


def written(found: Comparison, file: Path, names: tuple[str, ...] = ('run', 'car <1>')) -> dict:
    write_report(found, file, names=names, about=['0.137 s added'], verdict=(False, '1 of 2 channels outside'))
    page = file.read_text()
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)[1])


def floats(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), '<f4')


def test_the_report_holds_the_figures_and_curves(tmp_path: Path) -> None:
    found = compared()
    data = written(found, tmp_path / 'deep' / 'r.html')
    assert data['title'] == 'run compared with car <1>'
    rows = {row[0]: dict(zip(data['columns'], row, strict=True)) for row in data['rows']}
    wz = found.differences[0]
    assert rows['imu/wz']['unit'] == 'rad/s'
    assert rows['imu/wz']['largest difference'] == wz.max
    assert rows['imu/wz']['rating'] == wz.rating.overall
    assert rows['odom/twist/vx']['verdict'] == ''
    chart = data['charts'][0]
    assert (chart['name'], chart['unit']) == ('imu/wz', 'rad/s')
    t = floats(chart['time'])
    np.testing.assert_allclose(t, np.arange(501) * 0.01, rtol=1e-6)
    np.testing.assert_allclose(floats(chart['run']), 1.1 * np.sin(t), atol=1e-6)
    np.testing.assert_allclose(floats(chart['difference']), 0.1 * np.sin(t), atol=1e-6)


def test_the_report_needs_no_network(tmp_path: Path) -> None:
    written(compared(), tmp_path / 'r.html')
    page = (tmp_path / 'r.html').read_text()
    assert not re.search(r'https?:|src=|<link|@import|url\(', page)
    assert (tmp_path / 'r.html').stat().st_size < 100_000


def test_stamps_with_the_time_of_day_stay_sharp(tmp_path: Path) -> None:
    b = run(n=501, start_ns=1_700_000_000 * 10**9, x=np.sin)
    chart = written(compare(b, b), tmp_path / 'r.html')['charts'][0]
    assert chart['origin'] == 1.7e9
    np.testing.assert_allclose(np.diff(floats(chart['time'])), 0.01, rtol=1e-3)


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / 'file').touch()
    with pytest.raises(BagError, match='cannot write'):
        written(compared(), tmp_path / 'file' / 'r.html')


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason='needs a browser: apt-get install chromium')
def test_a_browser_draws_it(tmp_path: Path) -> None:
    repeats = [run(n=501, x=lambda t, d=d: np.sin(t) + d) for d in (-0.05, 0.0, 0.05)]
    found = compare(run(n=501, x=lambda t: 1.3 * np.sin(t)), *repeats)
    written(found, tmp_path / 'r.html', ('run', 'lap 1', 'lap 2', 'lap 3'))
    home = [
        '--user-data-dir=' + str(tmp_path / 'profile'),
        '--window-size=1280,1300',
        '--disable-component-update',
        '--disable-sync',
    ]
    picture = tmp_path / 'r.png'
    command = [CHROMIUM, *QUIET, *home, f'--screenshot={picture}', f'file://{tmp_path / "r.html"}']
    subprocess.run(command, timeout=120, check=True, capture_output=True)
    from matplotlib.image import imread

    pixels = imread(picture)[..., :3]
    for colour in ((0xD5, 0x5E, 0x00), (0x00, 0x72, 0xB2), (0x76, 0x76, 0x76)):  # run, reference, difference
        assert np.sum(np.all(np.abs(pixels - np.array(colour) / 255.0) < 0.04, axis=-1)) > 300
