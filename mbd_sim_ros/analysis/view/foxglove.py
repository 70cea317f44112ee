"""A layout for Foxglove: the bodies of a recording in three dimensions, and its curves, to be opened beside the bag.

The fields are those of layouts that Foxglove exports; its message paths name a value in a topic,
`/imu.angular_velocity.z`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mcap.reader import make_reader

from mbd_sim_ros.analysis.pages import write_text
from mbd_sim_ros.analysis.view.drawing import WORLD_BODY
from mbd_sim_ros.analysis.view.motion import RecordedMotion, curves_of
from mbd_sim_ros.bags.files import find_file
from mbd_sim_ros.messages import cdr
from mbd_sim_ros.messages.topics import IMU, JOINT_STATE, ODOMETRY, WRENCH

AXES = 'xyz'
# Per type of message: channel -> field. pose/qx ..., twist/vx ...; named as bags.reader names them.
FIELDS = {
    ODOMETRY: {
        **{f'pose/{a}': f'pose.pose.position.{a}' for a in AXES},
        **{f'pose/q{a}': f'pose.pose.orientation.{a}' for a in 'xyzw'},
        **{f'twist/v{a}': f'twist.twist.linear.{a}' for a in AXES},
        **{f'twist/w{a}': f'twist.twist.angular.{a}' for a in AXES},
    },
    IMU: {
        **{f'q{a}': f'orientation.{a}' for a in 'xyzw'},
        **{f'w{a}': f'angular_velocity.{a}' for a in AXES},
        **{f'a{a}': f'linear_acceleration.{a}' for a in AXES},
    },
    WRENCH: {**{f'f{a}': f'wrench.force.{a}' for a in AXES}, **{f'm{a}': f'wrench.torque.{a}' for a in AXES}},
}


def write_layout(motion: RecordedMotion, bag: Path, file: Path, channels: tuple[str, ...] = ()) -> None:
    """Write the layout for a recording. channels: patterns of those that are drawn as curves. Raises BagError."""
    namespace = '/' + motion.run.metadata.get('namespace', '').strip('/')  # of the node; '/' without any
    paths = message_paths(bag, curves_of(motion, channels), namespace)
    plots = {f'Plot!{k}': _plot(name, path) for k, (name, path) in enumerate(paths.items())}
    moving = 'base_link' if motion.follows != WORLD_BODY else 'odom'
    layout: dict[str, Any] | str = ''
    for k, plot in enumerate(reversed(plots)):
        layout = (
            {'first': plot, 'second': layout, 'direction': 'column', 'splitPercentage': 100.0 / (k + 1)} if k else plot
        )
    data = {
        'configById': {'3D!motion': _scene(moving, namespace), **plots},
        'globalVariables': {},
        'userNodes': {},
        'playbackConfig': {'speed': 1},
        'layout': {'first': '3D!motion', 'second': layout, 'direction': 'row', 'splitPercentage': 60}
        if plots
        else '3D!motion',
    }
    write_text(file, json.dumps(data, indent=1))


def message_paths(bag: Path, channels: list[str], namespace: str = '/') -> dict[str, str]:
    """Channel -> where its value is in the messages of its topic. namespace: of the topics that have one; channels are
    without."""
    result = {}
    before = namespace.rstrip('/')
    with find_file(bag).open('rb') as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        topics = {c.topic for c in summary.channels.values()} if summary is not None else set()
        own = {topic.removeprefix(before) if topic.startswith(before + '/') else topic: topic for topic in topics}
        for name in channels:
            short = max((t for t in own if ('/' + name).startswith(t + '/')), key=len)
            topic, rest = own[short], ('/' + name)[len(short) + 1 :]
            schema, _, message = next(iter(reader.iter_messages(topics=[topic])))
            assert schema is not None
            if schema.name == JOINT_STATE:
                names = cdr.decode(schema.name, schema.data.decode(), message.data)[0]['name']
                owner, part = (rest, 'position') if rest in names else rest.rpartition('/')[::2]
                result[name] = f'{topic}.{part}[{names.index(owner)}]'
            else:
                result[name] = (
                    f'{topic}.{FIELDS[schema.name][rest] if schema.name in FIELDS else rest.replace("/", ".")}'
                )
    return result


def _plot(name: str, path: str) -> dict[str, Any]:
    return {
        'foxglovePanelTitle': name,
        'paths': [{'value': path, 'label': name, 'enabled': True, 'timestampMethod': 'receiveTime'}],
        'xAxisVal': 'timestamp',
        'isSynced': True,
        'showLegend': False,
        'showXAxisLabels': True,
        'showYAxisLabels': True,
    }


def _scene(follow: str, namespace: str) -> dict[str, Any]:
    camera = {
        'perspective': True,
        'distance': 7.0,
        'phi': 70.0,
        'thetaOffset': 60.0,
        'targetOffset': [0.0, 0.0, 0.0],
        'fovy': 45.0,
    }
    layers = {
        'bodies': {
            'layerId': 'foxglove.Urdf',
            'instanceId': 'bodies',
            'sourceType': 'topic',
            'topic': f'{namespace.rstrip("/")}/robot_description',
            'visible': True,
        },
        'ground': {'layerId': 'foxglove.Grid', 'instanceId': 'ground', 'size': 200, 'divisions': 200, 'visible': True},
    }
    return {
        'followTf': follow,
        'followMode': 'follow-position',
        'cameraState': camera,
        'layers': layers,
        'topics': {},
        'transforms': {},
    }
