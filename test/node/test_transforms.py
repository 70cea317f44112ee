"""/tf over the real topic, with a stand-in of its package where no wheel offers it: what RViz and Foxglove place wheels
and links by."""

from __future__ import annotations

import sys

import pytest
from client import client
from foreign import packages
from mcap.reader import make_reader
from real_node import simulator

from mbd_sim_ros.bags.files import find_file
from mbd_sim_ros.messages.cdr import decode
from mbd_sim_ros.messages.definitions import schema_text
from mbd_sim_ros.messages.topics import TF, TYPE_HASHES

pytestmark = [pytest.mark.realtime, pytest.mark.slow]

__all__ = ['client', 'simulator']  # fixtures
POSES, RATE = 50, 200.0  # Hz
EVERY_NS = 5_000_000


def recorded(directory) -> dict[int, dict]:
    """Time [ns] -> transforms, as the recording has them."""
    with find_file(directory).open('rb') as stream:
        messages = make_reader(stream).iter_messages(topics=['/tf'])
        return {message.log_time: decode(TF, schema_text(TF), message.data)[0] for _, _, message in messages}


def flat(transforms: list) -> list[tuple]:
    """Frames and numbers of transforms, of a message or decoded."""
    out = []
    for item in transforms:
        get = (lambda o, k: o[k]) if isinstance(item, dict) else getattr
        t, r = (get(get(item, 'transform'), part) for part in ('translation', 'rotation'))
        frames = get(get(item, 'header'), 'frame_id'), get(item, 'child_frame_id')
        out.append((*frames, *(get(t, k) for k in 'xyz'), *(get(r, k) for k in 'xyzw')))
    return out


def test_transforms_are_heard_as_they_are_recorded(client, simulator, tmp_path) -> None:
    """A plain subscriber gets every message from its first one on: chassis and contact frames at rate_tf, all bodies at
    record.poses."""
    where = packages()
    sys.path.insert(0, str(where))
    from tf2_msgs.msg import TFMessage

    heard: list[TFMessage] = []
    client.node.create_subscription(TFMessage, '/tf', heard.append, 1000)
    overrides = [f'record.poses={POSES}', 'record.every=1']
    rates = {'rate_tf': RATE, 'rate_odom': 10.0, 'rate_cmd_applied': 10.0}  # the client hears these too
    process = simulator(
        str(where), scene='light_car_straight', overrides=overrides, duration=0.0, record=True, out='run', **rates
    )
    # the kernels may have to be compiled
    client.until(lambda: len(heard) > RATE or process.process.poll() is not None, 300.0)
    assert heard, process.output
    (info,) = client.node.get_publishers_info_by_topic('/tf')
    assert str(info.topic_type_hash) == TYPE_HASHES[TF]
    process.process.terminate()
    assert process.end() == 0, process.output
    stamps = [stamp(message) for message in heard]
    assert stamps == list(range(stamps[0], stamps[-1] + 1, EVERY_NS))
    expected = recorded(tmp_path / 'run')
    for t, message in zip(stamps, heard, strict=True):
        assert flat(message.transforms) == flat(expected[t]['transforms'])
    every = 1_000_000_000 // POSES
    # base_link, a contact frame of each wheel
    assert {len(message.transforms) for t, message in zip(stamps, heard) if t % every} == {5}
    seldom = [
        {item.child_frame_id for item in message.transforms} for t, message in zip(stamps, heard) if t % every == 0
    ]
    assert seldom and all({'base_link', 'wheel_front_left', 'imu_link'} <= frames for frames in seldom)


def stamp(message) -> int:
    """[ns]"""
    at = message.transforms[0].header.stamp
    return at.sec * 1_000_000_000 + at.nanosec
