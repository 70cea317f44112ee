"""What a recording of a node in a namespace calls its topics."""

from __future__ import annotations

import yaml
from synthetic import channels, snapshot

from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.bags.inputs import content
from mbd_sim_ros.bags.recorder import StepRecorder, describe
from mbd_sim_ros.messages.encode import Messages


def test_in_a_namespace_all_topics_but_the_global_ones_have_it_the_description_too(tmp_path):
    names = channels()
    messages = Messages(names)
    about = describe(scene='x', resolved_yaml='', robot_description='<robot name="x"/>', namespace='/fleet')
    with StepRecorder(tmp_path / 'run', messages.topics, names.inputs, 0, about, namespace='/fleet') as recorder:
        shot = snapshot(names, 0)
        recorder.record(shot.t_ns, messages.encode(shot))
    written = yaml.safe_load((tmp_path / 'run' / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    topics = [one['topic_metadata']['name'] for one in written['topics_with_message_count']]
    assert '/fleet/robot_description' in topics and '/fleet/odom' in topics
    assert [name for name in topics if not name.startswith('/fleet/')] == ['/tf']
    assert 'robot_description' not in bag.read(tmp_path / 'run').left_out
    assert 'robot_description' not in content(tmp_path / 'run').outputs
