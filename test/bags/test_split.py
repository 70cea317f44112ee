"""A recording that was split into files, as `ros2 bag record --max-bag-duration` does it: the sentence names the way,
`recover` goes it."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
import zstandard
from mcap.reader import make_reader
from mcap.writer import Writer

from mbd_sim_ros.bags import reader
from mbd_sim_ros.bags.files import find_file
from mbd_sim_ros.bags.recovery import recover
from mbd_sim_ros.commands.main import main
from solver.errors import BagError

WHOLE = Path(__file__).parents[2] / 'bags' / 'real_car'
PARTS = 11  # 2 comes before 10


@pytest.fixture(scope='module')
def split(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The measured car in files of equal time, in each of which the channels have other numbers."""
    directory = tmp_path_factory.mktemp('bags') / 'car'
    directory.mkdir()
    with next(WHOLE.glob('*.mcap')).open('rb') as stream:
        messages = list(make_reader(stream).iter_messages(log_time_order=True))
    begin, end = messages[0][2].log_time, messages[-1][2].log_time + 1
    names = [f'car_{k}.mcap' for k in range(PARTS)]
    for k, name in enumerate(names):
        mine = [one for one in messages if (one[2].log_time - begin) * PARTS // (end - begin) == k]
        with (directory / name).open('wb') as stream:
            writer = Writer(stream)
            writer.start(profile='ros2', library='test')
            channels: dict[str, int] = {}
            # whose channel comes first differs, and the order within a part
            for schema, channel, message in mine[k:] + mine[:k]:
                assert schema is not None
                if channel.topic not in channels:
                    kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                    channels[channel.topic] = writer.register_channel(channel.topic, 'cdr', kind, channel.metadata)
                writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time)
            writer.finish()
    about = {'rosbag2_bagfile_information': {'relative_file_paths': names}}
    (directory / 'metadata.yaml').write_text(yaml.safe_dump(about))
    return directory


@pytest.mark.parametrize(
    'words',
    [
        ('export', 'BAG', '--csv', 'csv'),
        ('evaluate', 'BAG'),
        ('compare', 'BAG', 'BAG'),
        ('view', 'BAG', '--out', 'page.html'),
    ],
)
def test_commands_say_how_its_files_become_one(
    words: tuple[str, ...], split: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(split) if word == 'BAG' else word for word in words]) == BagError.exit_code
    said = capsys.readouterr().err
    assert said.startswith(f'mbd: {split} holds {PARTS} .mcap files; name one of them, or,')
    assert f'`mbd recover {split} NEW` makes one file of them' in said


def test_recover_makes_one_of_them_with_every_number_at_its_instant(split: Path, tmp_path: Path) -> None:
    saved = recover(split, tmp_path / 'one')
    assert saved.complete and saved.lost == 0
    again, before = reader.read(tmp_path / 'one'), reader.read(WHOLE)
    assert again.series.keys() == before.series.keys()
    for topic, series in before.series.items():
        np.testing.assert_array_equal(again.series[topic].time_ns, series.time_ns)
        assert again.series[topic].columns.keys() == series.columns.keys()
        for name, values in series.columns.items():
            np.testing.assert_array_equal(again.series[topic].columns[name], values)


def test_what_is_wrong_with_one_file_is_told_by_its_name(split: Path, tmp_path: Path) -> None:
    """One is missing, one is cut off; those behind them are saved."""
    shutil.copytree(split, tmp_path / 'car')
    (tmp_path / 'car' / 'car_4.mcap').unlink()
    cut = tmp_path / 'car' / 'car_7.mcap'
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    saved = recover(tmp_path / 'car', tmp_path / 'saved')
    assert not saved.complete
    assert any(text.startswith('car_7.mcap: its end is missing') for text in saved.damage)
    assert 'car_4.mcap is missing' in saved.damage
    assert reader.read(tmp_path / 'saved').time_ns[-1] == reader.read(WHOLE).time_ns[-1]


def test_files_of_two_recordings_are_not_made_one(tmp_path: Path) -> None:
    """Both run from the same instant to the same end: 5 s, which the second begins before the first ends."""
    file = next(WHOLE.glob('*.mcap'))
    (tmp_path / 'two').mkdir()
    for name in ('one.mcap', 'other.mcap'):
        shutil.copy(file, tmp_path / 'two' / name)
    with pytest.raises(
        BagError, match=r'other.mcap begins \S+ s before one.mcap ends: these are not the parts of one recording'
    ):
        recover(tmp_path / 'two', tmp_path / 'saved')
    assert not (tmp_path / 'saved').exists()


def test_a_file_that_is_packed_as_a_whole_is_read_and_one_that_is_cut_is_told(tmp_path: Path) -> None:
    packed = zstandard.compress(next(WHOLE.glob('*.mcap')).read_bytes())
    (tmp_path / 'car_0.mcap.zstd').write_bytes(packed)
    whole = reader.read(WHOLE)
    for place in (tmp_path, tmp_path / 'car_0.mcap.zstd'):
        found = reader.read(place)
        assert all(np.array_equal(found[name], values, equal_nan=True) for name, values in whole.columns.items())
        with pytest.raises(
            BagError, match=r'car_0\.mcap\.zstd is packed as a whole .*: zstd -d \S+\.zstd -o \S+car_0\.mcap$'
        ):
            find_file(place)
    for rest in (packed[:4], packed[: len(packed) // 2], packed[:-9]):
        (tmp_path / 'car_0.mcap.zstd').write_bytes(rest)
        with pytest.raises(BagError, match=r'car_0\.mcap\.zstd is cut off or damaged'):
            reader.read(tmp_path)
