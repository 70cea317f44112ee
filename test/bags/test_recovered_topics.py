"""Recovered topics are offered as they were recorded: who plays the bag back reaches who listens to late or lossy
topics."""

from __future__ import annotations

from pathlib import Path

import yaml
from mcap.reader import make_reader
from mcap.writer import Writer

from mbd_sim_ros.bags.recovery import recover
from mbd_sim_ros.bags.writer import RECORD, BagWriter
from mbd_sim_ros.messages.cdr import template
from mbd_sim_ros.messages.definitions import schema_text
from mbd_sim_ros.messages.topics import STRING, Topic

TEXT = template(STRING, {'data': 'x'}).data
# topic -> profile as recorded, and what it says: reliable, latched, depth; rosbag2 wrote numbers before Jazzy
PROFILES = {
    '/map': ('durability: 1\n  depth: 1', True, True, 1),
    '/scan': ('depth: 7\n  reliability: best_effort\n  durability: volatile', False, False, 7),
    '/old': ('reliability: 2\n  durability: 2', False, False, 100),
    '/none': ('', True, False, 100),
}


def offered(file: Path) -> dict[str, str]:
    """Topic -> the profile in the file."""
    with file.open('rb') as stream:
        channels = make_reader(stream).get_summary().channels.values()
    return {one.topic: one.metadata['offered_qos_profiles'] for one in channels}


def test_profiles_of_ours_are_copied(tmp_path: Path) -> None:
    topics = [
        Topic('robot_description', STRING, depth=1, latched=True),
        Topic('s', STRING),
        Topic('fast', STRING, reliable=False),
    ]
    writer = BagWriter(tmp_path / 'r', topics, {RECORD: {'scene': 'synthetic'}})
    writer.write(0, [(k, TEXT) for k in range(3)])
    before = offered(writer.finish() / 'r_0.mcap')
    assert 'durability: transient_local' in before['/robot_description']
    assert offered(recover(tmp_path / 'r', tmp_path / 's').directory / 's_0.mcap') == before


def test_profiles_of_others_are_understood(tmp_path: Path) -> None:
    with (tmp_path / 'other.mcap').open('wb') as stream:
        writer = Writer(stream)
        writer.start(profile='ros2', library='test')
        schema = writer.register_schema(STRING, 'ros2msg', schema_text(STRING).encode())
        for topic, (text, *_) in PROFILES.items():
            writer.add_message(
                writer.register_channel(topic, 'cdr', schema, {'offered_qos_profiles': f'- history: 1\n  {text}\n'}),
                0,
                TEXT,
                0,
            )
        writer.finish()
    directory = recover(tmp_path / 'other.mcap', tmp_path / 'saved').directory
    about = yaml.safe_load((directory / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    for topic in (one['topic_metadata'] for one in about['topics_with_message_count']):
        _, reliable, latched, depth = PROFILES[topic['name']]
        (profile,) = topic['offered_qos_profiles']
        assert profile['reliability'] == ('reliable' if reliable else 'best_effort')
        assert profile['durability'] == ('transient_local' if latched else 'volatile')
        assert profile['depth'] == depth
