"""Writes the generated tables of docs/ros.md: topics, commands, services and parameters, as the code has them.

A part stands between `<!-- begin NAME -->` and `<!-- end -->`. Needs rclpy (the parameters are ROS parameters).
"""

from __future__ import annotations

import re
from pathlib import Path

from mbd_sim_ros.messages.encode import Messages, Topic
from mbd_sim_ros.node.commands import LIMITS, PLAIN
from mbd_sim_ros.node.parameters import CHOICES, PARAMETERS
from mbd_sim_ros.node.services import SERVICES
from solver.inputs.maneuver import COMMANDS
from solver.output.snapshot import Channels

FILE = Path(__file__).parents[1] / 'ros.md'
PART = re.compile(r'<!-- begin (?P<name>\w+) -->\n(?P<body>.*?)<!-- end -->', re.DOTALL)
WHEEL = '<wheel>'
MEANING = {
    'joint_states': 'position, velocity, generalized force of every joint coordinate; of `steering_wheel` the hand torque',
    'odom': 'chassis in `odom`; twist in `base_link`',
    'imu': 'specific force and angular velocity at the centre of mass of the chassis',
    f'tire/{WHEEL}/force': 'force and moment on the wheel, in its contact frame',
    'tire_states': 'named scalars per wheel: load, slip, slip angle, camber, spin, ...',
    'cmd_applied': 'inputs as applied in the step that led here, and `step`: the acknowledgement of a command',
    'element_states': 'outputs of every force element (parameter `publish_elements`)',
    'reactions': 'reaction of every constraint row (parameter `publish_elements`, scene `record.reactions`)',
    '/tf': '`base_link` and the contact frames in `odom`; at the rate `record.poses` all bodies, as links, and `imu_link`',
}
FURTHER = (
    ('`robot_description`', 'std_msgs/String', 'reliable, 1, latched', 'URDF of the spanning tree'),
    ('`/clock`', 'rosgraph_msgs/Clock', 'best effort, 1', 'simulation time, at most 100 Hz (in lockstep every step)'),
    ('`/diagnostics`', 'diagnostic_msgs/DiagnosticArray', 'reliable, 10', 'health, once a second'),
)
UNITS = {'steering': 'steering wheel angle [rad]', 'drive_torque': 'at the differential [N m]', 'brake_torque': 'all wheels together [N m]'}


def main() -> None:
    """Write the tables."""
    FILE.write_text(render(FILE.read_text(encoding='utf-8')), encoding='utf-8')


def render(text: str) -> str:
    """The text with every generated part as the code has it now."""
    parts = {'topics': topics, 'commands': commands, 'services': services, 'parameters': parameters}
    return PART.sub(lambda m: f'<!-- begin {m["name"]} -->\n{table(*parts[m["name"]]())}<!-- end -->', text)


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """A Markdown table."""
    lines = [head, tuple('---' for _ in head), *rows]
    return ''.join('| ' + ' | '.join(cells) + ' |\n' for cells in lines)


def topics() -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """What is published."""
    nothing: tuple[str, ...] = ()
    given = {'joints': ('a',), 'joint_kinds': ('rotation',), 'bodies': ('chassis',), 'wheels': (WHEEL,), 'inputs': COMMANDS, 'chassis': 0}
    names = Channels(**given, elements=nothing, reactions=nothing)  # type: ignore[arg-type]
    rows = [
        (f'`{t.name}`', t.type.replace('/msg/', '/'), quality(t), MEANING[t.name])
        for t in Messages(names, element_states=True, reactions=True).topics
    ]
    return ('topic', 'type', 'QoS', ''), [*rows, *FURTHER]


def quality(topic: Topic) -> str:
    """Reliability, depth and durability."""
    return f'{"reliable" if topic.reliable else "best effort"}, {topic.depth}' + (', latched' if topic.latched else '')


def commands() -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """What is listened to."""
    rows = [
        (f'`~/{topic}`', 'std_msgs/Float64', 'reliable, 1', f'{UNITS[name]}, limit: `{limit}`')
        for topic, name, limit in zip(PLAIN, COMMANDS, LIMITS, strict=True)
    ]
    stamped = 'any of ' + ', '.join(f'`{name}`' for name in COMMANDS) + ' by name; `header.stamp`: the state that is answered'
    return ('topic', 'type', 'QoS', ''), [*rows, ('`~/lockstep_cmd`', 'sensor_msgs/JointState', 'reliable, 10', stamped)]


def services() -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """What may be called."""
    return ('service (std_srvs/Trigger)', ''), [(f'`~/{name}`', text) for name, text in SERVICES.items()]


def parameters() -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """What may be set."""
    rows: list[tuple[str, ...]] = []
    for name, spec in PARAMETERS.items():
        numeric = isinstance(spec.default, int | float) and not isinstance(spec.default, bool)
        allowed = f'{spec.low:g} to {spec.high:g}' if numeric else ', '.join(CHOICES.get(name, ()))
        default = {'': 'empty', "['']": 'empty'}.get(
            str(spec.default), str(spec.default).lower() if isinstance(spec.default, bool) else str(spec.default)
        )
        rows.append((f'`{name}`', spec.text, default, allowed, 'yes' if spec.live else ''))
    return ('parameter', '', 'default', 'range', 'while running'), rows


if __name__ == '__main__':
    main()
