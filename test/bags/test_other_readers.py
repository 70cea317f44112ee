"""Programs of others open every kind of bag that is written here: rosbags, the mcap reader, pandas and, where it is
installed, Rerun."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from mbd_sim_ros.analysis import load
from mbd_sim_ros.bags import reader
from mbd_sim_ros.bags.recovery import recover
from mbd_sim_ros.batch import simulate
from mbd_sim_ros.messages.topics import family
from solver import load_scene, simulation_of

BAGS = Path(__file__).parents[2] / 'bags'
pytestmark = pytest.mark.slow
KINDS = ('step_steer', 'real_car', 'everything', 'recovered')


@pytest.fixture(scope='module')
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A car, a recording with scalars of std_msgs, a mechanism with all that can be recorded, and what is recovered of
    a broken file."""
    home = tmp_path_factory.mktemp('bags')
    simulation = simulation_of(
        load_scene('andrews', ('duration=0.01', 'record.reactions=true', 'record.elements=true', 'record.poses=100'))
    )
    simulate(simulation, simulation.scene.steps, directory=home / 'everything')
    broken = home / 'broken.mcap'
    whole = (BAGS / 'step_steer' / 'step_steer_0.mcap').read_bytes()
    broken.write_bytes(whole[: len(whole) // 3])
    recover(broken, home / 'recovered')
    return {name: BAGS / name for name in KINDS[:2]} | {name: home / name for name in KINDS[2:]}


def counts(bag: Path) -> Counter[str]:
    """Messages of every topic, by the mcap reader with all checksums."""
    found: Counter[str] = Counter()
    with next(bag.glob('*.mcap')).open('rb') as stream:
        for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            assert schema is not None and schema.encoding == 'ros2msg' and message.data
            found[channel.topic] += 1
    return found


@pytest.mark.parametrize('kind', KINDS)
def test_rosbags_decodes_every_message(kind: str, bags: dict[str, Path]) -> None:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    found: Counter[str] = Counter()
    speeds = []
    with AnyReader([bags[kind]], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as rosbag:
        for connection, _, data in rosbag.messages():
            message = rosbag.deserialize(data, connection.msgtype)
            found[connection.topic] += 1
            if connection.topic == '/odom':
                speeds.append(message.twist.twist.linear.x)
    assert found == counts(bags[kind])
    if speeds:
        np.testing.assert_array_equal(
            speeds, reader.read(bags[kind], ['odom/*']).series['odom'].columns['odom/twist/vx']
        )


@pytest.mark.parametrize('kind', KINDS)
def test_pandas_holds_every_number(kind: str, bags: dict[str, Path]) -> None:
    pytest.importorskip('pandas', reason='pip install .[analysis]')
    """Elements of all kinds, each with a message at every instant, are one table."""
    number, frames = {family(topic.strip('/')): n for topic, n in counts(bags[kind]).items()}, load(bags[kind])
    assert frames.keys() == number.keys() - {'tf', 'robot_description', 'inputs_applied'}
    for topic, frame in frames.items():
        assert len(frame) == number[topic]
        assert np.isfinite(frame.to_numpy()).all() and frame.index.is_monotonic_increasing


@pytest.mark.parametrize('kind', KINDS)
def test_rerun_decodes_every_topic(kind: str, bags: dict[str, Path]) -> None:
    """Its decoders of ROS messages make numbers and poses of each message, and the links move: /tf becomes
    transforms."""
    chunks = pytest.importorskip('rerun.chunk', reason="pip install '.[rerun]'")
    rows: Counter[str] = Counter()
    columns: dict[str, set[str]] = {}
    for chunk in chunks.McapReader(next(bags[kind].glob('*.mcap'))).stream():
        path = str(chunk.entity_path)
        names = set(chunk.to_record_batch().schema.names)
        if 'message_log_time' in names:
            rows[path] += chunk.num_rows
        columns.setdefault(path, set()).update(names)
    for topic, n in counts(bags[kind]).items():
        inside = [path for path in rows if path == topic or path.startswith(topic + '/')]
        assert max(rows[path] for path in inside) >= n, topic
    if '/tf' in columns:
        assert any('Transform3D:translation' in names for names in columns.values())
