"""Comparing runs: known differences are found, unknown ones are not invented, tables survive the way out and back."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from mbd_sim_ros.analysis import tables
from mbd_sim_ros.analysis.compare import align, compare
from mbd_sim_ros.analysis.plots import plot_comparison
from mbd_sim_ros.bags.reader import Run
from solver.errors import BagError


def run(n: int = 101, h_ns: int = 10_000_000, **columns) -> Run:
    t = np.arange(n) * h_ns
    values = {name: f(t * 1e-9) for name, f in columns.items()}
    return Run(t, values)


def test_largest_and_rms_difference_are_those_of_the_formula() -> None:
    a = run(x=lambda t: np.sin(t) + 0.3 * t, y=lambda t: t)
    b = run(x=np.sin, y=lambda t: t)
    found = compare(a, b, rtol=0.0, atol=0.31)
    x = next(d for d in found.differences if d.channel == 'x')
    assert x.max == pytest.approx(0.3, rel=1e-14)
    assert x.time == pytest.approx(1.0, rel=1e-15)
    assert x.rms == pytest.approx(0.3 * np.sqrt(np.mean(np.linspace(0.0, 1.0, 101) ** 2)), rel=1e-14)
    assert x.scale == pytest.approx(np.sin(1.0), rel=1e-14)
    assert found.ok
    assert not found.interpolated
    assert not compare(a, b, rtol=0.0, atol=0.29).ok


@pytest.mark.parametrize(('rtol', 'atol', 'ok'), [(0.0101, 0.0, True), (0.0099, 0.0, False), (0.005, 0.0101, True), (0.005, 0.0099, False)])
def test_tolerance_is_absolute_plus_relative_to_the_largest_reference_value(rtol: float, atol: float, ok: bool) -> None:
    b = run(x=lambda t: 2.0 * np.cos(np.pi * t))
    a = Run(b.time_ns, {'x': b.columns['x'] + 0.02})
    assert compare(a, b, rtol=rtol, atol=atol).ok is ok


def test_worst_channel_comes_first() -> None:
    b = run(small=lambda t: 1e-3 + t, large=lambda t: 1e3 + t)
    a = Run(b.time_ns, {'large': b.columns['large'] + 1e-3, 'small': b.columns['small'] + 1e-4})
    assert [d.channel for d in compare(a, b, rtol=1e-3, atol=0.0).differences] == ['small', 'large']


def test_nothing_is_interpolated_where_the_coarse_instants_exist_in_the_fine_run() -> None:
    coarse = run(n=11, h_ns=100_000_000, x=lambda t: t**3)
    fine = run(x=lambda t: t**3)
    for a, b in ((coarse, fine), (fine, coarse)):
        found = compare(a, b, rtol=0.0, atol=0.0)
        assert found.ok
        assert not found.interpolated
        assert len(found.time) == 11


def test_different_grids_are_interpolated_linearly_in_the_common_interval() -> None:
    a = Run(np.array([5, 15, 25, 35]) * 10**8, {'x': np.array([1.0, 3.0, 5.0, 7.0])})
    b = Run(np.arange(0, 31, 2) * 10**8, {'x': np.arange(0, 31, 2) * 0.2})
    found = compare(a, b, rtol=0.0, atol=1e-12)
    assert found.interpolated
    np.testing.assert_allclose(found.time, [0.5, 1.5, 2.5])
    assert found.ok  # both are the straight line x = 2 t
    with pytest.raises(BagError, match='do not overlap'):
        align(np.array([0, 1]), np.array([5, 6]))


def test_a_quaternion_and_its_negative_are_the_same_orientation_but_not_the_same_bits() -> None:
    q = {f'odom/pose/{c}': (lambda t, k=k: np.cos(t + k)) for k, c in enumerate(('qx', 'qy', 'qz', 'qw'))}
    b = run(**q)
    flip = np.where(np.arange(101) % 2, -1.0, 1.0)
    a = Run(b.time_ns, {c: flip * v for c, v in b.columns.items()})
    assert compare(a, b, rtol=0.0, atol=1e-15).ok
    assert not compare(a, b, exact=True).ok


def test_nan_agrees_with_nan_only() -> None:
    b = run(x=lambda t: np.where(t < 0.5, np.nan, t))
    assert compare(Run(b.time_ns, dict(b.columns)), b).ok
    a = Run(b.time_ns, {'x': b.time})
    assert not compare(a, b, atol=1e9).ok
    assert not compare(b, a, atol=1e9).ok


def test_exact_means_every_bit_every_instant_and_every_channel() -> None:
    b = run(x=np.sin, y=np.cos)
    assert compare(Run(b.time_ns.copy(), {c: v.copy() for c, v in b.columns.items()}), b, exact=True).ok
    a = Run(b.time_ns, {'x': b.columns['x'], 'y': b.columns['y'].copy()})
    a.columns['y'][50] = np.nextafter(a.columns['y'][50], 2.0)
    found = compare(a, b, exact=True)
    assert [d.channel for d in found.differences if not d.ok] == ['y']
    assert found.differences[0].max == pytest.approx(np.spacing(b.columns['y'][50]), rel=0.5)
    zero, minus = run(x=lambda t: 0.0 * t), run(x=lambda t: -0.0 * t)
    assert not compare(zero, minus, exact=True).ok
    assert compare(zero, minus, rtol=0.0, atol=0.0).ok
    assert not compare(run(n=100, x=np.sin, y=np.cos), b, exact=True).ok
    assert not compare(Run(b.time_ns, {'x': b.columns['x']}), b, exact=True).ok


def test_channels_are_chosen_by_pattern_and_matched_by_name() -> None:
    a, b = run(**{'odom/x': np.sin, 'odom/y': np.cos}), run(**{'odom/x': np.cos, 'theirs': np.cos})
    found = compare(a, b, names={'theirs': 'odom/y'}, channels=['odom/y'])
    assert [d.channel for d in found.differences] == ['odom/y']
    assert found.ok
    with pytest.raises(BagError, match=re.escape("no common channel matches 'odm/*'; did you mean 'odom/x'?")):
        compare(a, b, channels=['odm/*'])
    with pytest.raises(BagError, match="no column 'thers'; did you mean 'theirs'"):
        compare(a, b, names={'thers': 'odom/y'})
    with pytest.raises(BagError, match='no channel in common'):
        compare(a, run(z=np.sin))


def wild(rng: np.random.Generator) -> Run:
    n = 50
    time_ns = np.cumsum(rng.integers(1, 10**7, n))
    columns = {
        f'joint_states/{j}/{p}': rng.standard_normal(n) * 10.0 ** rng.integers(-300, 300, n)
        for j in ('a', 'b/angle')
        for p in ('position', 'velocity')
    }
    columns['tire/front_left/force/fx'] = rng.standard_normal(n)
    columns['cmd_applied/steering'] = np.where(rng.random(n) < 0.5, np.nan, 1.0)
    return Run(time_ns, columns, {'joint_kinds': '{"a": "rotation", "b/angle": "translation"}'})


def test_export_and_back_is_the_same_bits(rng: np.random.Generator, tmp_path: Path) -> None:
    before = wild(rng)
    files = tables.export(before, tmp_path)
    assert sorted(f.name for f in files) == ['cmd_applied.csv', 'joint_states.csv', 'tire.front_left.force.csv']
    after = tables.read(tmp_path)
    assert compare(after, before, exact=True).ok
    assert set(after.columns) == set(before.columns)


def test_header_names_quantity_and_unit(rng: np.random.Generator, tmp_path: Path) -> None:
    tables.export(wild(rng), tmp_path)
    header = (tmp_path / 'joint_states.csv').read_text().splitlines()[0]
    assert header == 'time [s],a/position [rad],a/velocity [rad/s],b/angle/position [m],b/angle/velocity [m/s]'
    assert (tmp_path / 'tire.front_left.force.csv').read_text().splitlines()[0] == 'time [s],fx [N]'


@pytest.mark.parametrize(
    ('text', 'says'),
    [
        ('x,y\n1,2\n', "the first column is 'x'"),
        ('time [s],y\n', 'holds no data'),
        ('time,y\n0,1\n0,2\n', 'must increase'),
        ('time,y\n0,1\n1\n', 'row 3 has 1 values for 2 columns'),
        ('time,y\n0,abc\n', "could not convert string to float: 'abc'"),
        ('time,y,y\n0,1,2\n', "the column 'y' is given twice"),
    ],
)
def test_a_broken_table_is_refused_with_its_place(text: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / 'x.csv'
    file.write_text(text)
    with pytest.raises(BagError, match=re.escape(says)) as caught:
        tables.read(file)
    assert str(file) in str(caught.value)


def test_comments_and_blank_lines_in_a_table_are_skipped(tmp_path: Path) -> None:
    file = tmp_path / 'x.csv'
    file.write_text('# source: measured\ntime [s],angle [rad]\n0,1\n\n0.5,2\n')
    read = tables.read(file)
    assert read.time_ns.tolist() == [0, 500_000_000]
    assert read['angle'].tolist() == [1.0, 2.0]


def test_picture_shows_both_runs_and_the_difference(tmp_path: Path) -> None:
    a, b = run(x=np.sin, y=np.cos), run(x=lambda t: np.sin(t) + 0.1, y=np.cos)
    file = tmp_path / 'deep' / 'c.png'
    plot_comparison(compare(a, b), file)
    from matplotlib.image import imread

    pixels = imread(file)[..., :3]
    assert pixels.shape[1] > 1000
    for colour in ((0xD9, 0x5F, 0x02), (0x1B, 0x6C, 0xA8), (0x55, 0x55, 0x55)):  # run, reference, difference
        assert np.sum(np.all(np.abs(pixels - np.array(colour) / 255.0) < 0.02, axis=-1)) > 200
    with pytest.raises(BagError, match='cannot write the picture'):
        plot_comparison(compare(a, b), file / 'x.png')
