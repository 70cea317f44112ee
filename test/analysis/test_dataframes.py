"""Recordings as DataFrames and Parquet files: every number, its instant and its unit."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from scalars import write_scalars

from mbd_sim_ros.analysis import load
from mbd_sim_ros.analysis.dataframes import export_parquet
from mbd_sim_ros.bags import reader as bag
from solver.errors import BagError

pd = pytest.importorskip('pandas', reason='pip install .[analysis]')
pq = pytest.importorskip('pyarrow.parquet', reason='pip install .[analysis]')


@pytest.fixture(scope='module')
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(2)
    fast, slow = np.arange(200) * 5_000_000, 7 + np.arange(20) * 50_000_000
    topics = {
        'tire_states': (
            fast,
            {'front_left/fz': rng.standard_normal(200), 'front_left/alpha': rng.standard_normal(200)},
        ),
        'cmd_applied': (slow, {'steering': rng.standard_normal(20)}),
    }
    return write_scalars(tmp_path_factory.mktemp('bags') / 'bag', topics)


def test_one_frame_per_topic_with_time_names_and_units(recorded: Path) -> None:
    run = bag.read(recorded)
    found = load(recorded)
    assert set(found) == {'tire_states', 'cmd_applied'}
    tires = found['tire_states']
    assert tires.index.name == 'time'
    np.testing.assert_array_equal(tires.index, np.arange(200) * 5_000_000 * 1e-9)
    assert list(tires.columns) == ['tire_states/front_left/fz', 'tire_states/front_left/alpha']
    assert tires.attrs['units'] == {'tire_states/front_left/fz': 'N', 'tire_states/front_left/alpha': 'rad'}
    assert tires.attrs['metadata']['scene'] == 'synthetic'
    for frame in found.values():
        for name in frame.columns:
            np.testing.assert_array_equal(frame[name], run[name][~np.isnan(run[name])])


def test_one_dataset_per_topic_with_units_of_every_variable(recorded: Path) -> None:
    pytest.importorskip('xarray', reason='pip install .[analysis]')
    frames, found = load(recorded), load(recorded, to='xarray')
    assert set(found) == set(frames)
    tires = found['tire_states']
    assert tires['tire_states/front_left/fz'].attrs['units'] == 'N'
    assert tires['time'].attrs['units'] == 's'
    assert tires.attrs['scene'] == 'synthetic'
    for topic, dataset in found.items():
        pd.testing.assert_frame_equal(dataset.to_dataframe(), frames[topic], check_exact=True)
    with pytest.raises(BagError, match='must be pandas or xarray'):
        load(recorded, to='polars')  # type: ignore[call-overload]


def test_topics_are_chosen_and_wrong_ones_refused(recorded: Path) -> None:
    assert list(load(recorded, topics=['/cmd_applied'])) == ['cmd_applied']
    with pytest.raises(BagError, match=r"no topic 'tire_state' that can be read; did you mean 'tire_states'"):
        load(recorded, topics=['tire_state'])


def test_parquet_and_back_is_the_same_bits(recorded: Path, tmp_path: Path) -> None:
    run = bag.read(recorded)
    files = export_parquet(run, tmp_path / 'deep')
    assert sorted(f.name for f in files) == ['cmd_applied.parquet', 'tire_states.parquet']
    wanted = load(recorded)
    for file in files:
        back = pd.read_parquet(file)
        np.testing.assert_array_equal(back.pop('time_ns'), run.series[file.stem].time_ns)
        pd.testing.assert_frame_equal(back, wanted[file.stem], check_exact=True)
    schema = pq.read_schema(tmp_path / 'deep' / 'tire_states.parquet')
    units = {field.name: field.metadata[b'unit'].decode() for field in schema}
    assert units == {
        'time_ns': 'ns',
        'time': 's',
        'tire_states/front_left/fz': 'N',
        'tire_states/front_left/alpha': 'rad',
    }


def test_topics_with_hundreds_of_channels_are_written_without_a_warning(tmp_path: Path) -> None:
    """As the outputs of all elements of a car are: what a library says to programmers is not for who exports."""
    values = {f'element_states/e{k}/force': np.full(3, float(k)) for k in range(200)}
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        (file,) = export_parquet(bag.Run({'element_states': bag.Series(np.arange(3), values)}), tmp_path)
    back = pd.read_parquet(file)
    np.testing.assert_array_equal(back['element_states/e199/force'], 199.0)
    np.testing.assert_array_equal(back['time_ns'], np.arange(3))


def test_a_place_that_cannot_be_written_is_named(recorded: Path, tmp_path: Path) -> None:
    (tmp_path / 'file').touch()
    with pytest.raises(BagError, match=r'cannot write to .*choose another place'):
        export_parquet(bag.read(recorded), tmp_path / 'file' / 'out')
