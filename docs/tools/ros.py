"""Writes the generated tables of docs/ros.md: topics, commands, services and parameters, as the code has them.

A part stands between `<!-- begin NAME -->` and `<!-- end -->`. Needs rclpy (the parameters are ROS parameters).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from mbd_sim_ros.messages.encode import Messages
from mbd_sim_ros.messages.topics import Topic
from mbd_sim_ros.node.adapter import PARAMETERS as ADAPTER
from mbd_sim_ros.node.commands import BY_WHEEL, PLAIN
from mbd_sim_ros.node.demand_messages import HEARD, TOLD
from mbd_sim_ros.node.interfaces import OFFERED, PACKAGE, snake
from mbd_sim_ros.node.maneuver_player import PARAMETERS as MANEUVER
from mbd_sim_ros.node.parameters import CHOICES, PARAMETERS
from mbd_sim_ros.node.services import SERVICES
from solver.inputs.command_filter import COMMANDS
from solver.output.snapshot import ENERGIES, Channels

FILE = Path(__file__).parents[1] / 'ros.md'
PART = re.compile(r'<!-- begin (?P<name>\w+) -->\n(?P<body>.*?)<!-- end -->', re.DOTALL)
WHEEL, KIND = '<wheel>', '<kind>'
MEANING = {
    'joint_states': 'position, velocity, generalized force of every joint coordinate; of `steering_wheel` the hand '
    'torque',
    'odom': 'chassis in `odom`; twist in `base_link`',
    'imu': 'specific force and angular velocity at the centre of mass of the chassis',
    f'tire/{WHEEL}/force': 'force and moment on the wheel, in its contact frame',
    'tire_states': 'named scalars per wheel: load, slip, slip angle, camber, spin, ...',
    'cmd_applied': 'inputs as applied in the step that led here, and `step`: the acknowledgement of a command',
    f'element_states/{KIND}': 'outputs of the force elements of a kind: `bushings`, `brakes`, ... (parameter '
    '`publish_elements`)',
    'reactions': 'reaction of every constraint row, NaN where the motion does not determine it (parameter '
    '`publish_elements`, scene `record.reactions`)',
    'body_motions': 'velocity and acceleration of every body, along its axes and of its reference frame (scene '
    '`record.motions`)',
    'energies': 'kinetic, potential, dissipated and exchanged energy and the error of their balance (scene '
    '`record.energies`)',
    '/tf': '`base_link` and the contact frames in `odom`; at the rate `record.poses` all bodies, as links, and '
    '`imu_link`',
}
SCENE = (
    'the scene that runs, with every include and override expanded; in its first line which solver computes, and '
    'where it begins'
)
FURTHER = (
    ('`robot_description`', 'std_msgs/String', 'reliable, 1, latched', 'URDF of the spanning tree'),
    ('`~/scene`', 'std_msgs/String', 'reliable, 1, latched', SCENE),
    (
        '`/clock`',
        'rosgraph_msgs/Clock',
        'best effort, 1',
        'simulation time, at most 100 Hz (in lockstep every state that waits)',
    ),
    ('`/diagnostics`', 'diagnostic_msgs/DiagnosticArray', 'reliable, 10', 'health, once a second'),
)


def main() -> None:
    """Write the tables."""
    FILE.write_text(render(FILE.read_text(encoding='utf-8')), encoding='utf-8')


def render(text: str) -> str:
    """The text with every generated part as the code has it now."""
    parts: dict[str, Callable[[], tuple[tuple[str, ...], list[tuple[str, ...]]]]] = {
        'topics': topics,
        'commands': commands,
        'services': services,
        'parameters': parameters,
        'adapter': adapter,
        'adapter_parameters': partial(described, ADAPTER),
        'maneuver_parameters': partial(described, MANEUVER),
        'interfaces': interfaces,
    }
    return PART.sub(lambda m: f'<!-- begin {m["name"]} -->\n{table(*parts[m["name"]]())}<!-- end -->', text)


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """A Markdown table."""
    lines = [head, tuple('---' for _ in head), *rows]
    return ''.join('| ' + ' | '.join(cells) + ' |\n' for cells in lines)


def topics() -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Table of published topics."""
    nothing: tuple[str, ...] = ()
    given = {
        'joints': ('a',),
        'joint_kinds': ('rotation',),
        'bodies': ('chassis',),
        'wheels': (WHEEL,),
        'inputs': COMMANDS,
        'chassis': 0,
    }
    names = Channels(**given, elements=('a/force',), reactions=nothing, moving=('chassis',), energies=ENERGIES)  # type: ignore[arg-type]
    rows = [
        (f'`{t.name}`', t.type.replace('/msg/', '/'), quality(t), MEANING[t.name])
        for t in Messages(
            names, element_states=True, reactions=True, kinds={'a': KIND}, motions_every=1, energies_every=1
        ).topics
    ]
    return ('topic', 'type', 'QoS', ''), [*rows, *FURTHER]


def quality(topic: Topic) -> str:
    """Reliability, depth and durability."""
    return f'{"reliable" if topic.reliable else "best effort"}, {topic.depth}' + (', latched' if topic.latched else '')


def commands() -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Table of subscribed topics."""
    rows = [
        (
            f'`~/{c.topic}`',
            f'std_msgs/{c.type.__name__}',
            'reliable, 1',
            c.text + (f', limit: `{c.limit}`' if c.limit else ''),
        )
        for c in PLAIN.values()
    ]
    rows.append(
        ('`~/<input>_cmd`', 'std_msgs/Float64', 'reliable, 1', 'input of an element that the scene adds to its vehicle')
    )
    single = '; '.join(f'`{start}{WHEEL}`: {c.text}, limit: `{c.limit}`' for start, c in BY_WHEEL.items())
    stamped = (
        'any commands by name ('
        + ', '.join(f'`{name}`' for name in PLAIN)
        + '); `header.stamp`: the state that is answered'
    )
    named = [('`~/wheel_cmd`', single), ('`~/lockstep_cmd`', stamped)]
    return ('topic', 'type', 'QoS', ''), [
        *rows,
        *((topic, 'sensor_msgs/JointState', 'reliable, 10', text) for topic, text in named),
    ]


def services() -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Table of services."""
    return ('service (std_srvs/Trigger)', ''), [(f'`~/{name}`', text) for name, text in SERVICES.items()]


def adapter() -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Table of topics of the adapter."""
    rows: list[tuple[str, ...]] = [
        (
            f'`{h.topic}`',
            h.type.replace('/msg/', '/'),
            'reliable, 1' + (', latched' if h.latched else ''),
            f'in: {h.text}',
        )
        for h in HEARD
    ]
    rows += [(f'`{t.topic}`', t.type.replace('/msg/', '/'), 'reliable, 1', f'out: {t.text}') for t in TOLD]
    return ('topic', 'type', 'QoS', ''), rows


def described(parameters: Mapping[str, tuple[Any, str]]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Table of parameters of a node beside the simulator."""
    return ('parameter', '', 'default'), [
        (f'`{n}`', text, 'empty' if d == '' else str(d)) for n, (d, text) in parameters.items()
    ]


def interfaces() -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Table of the parts of simulation_interfaces that are there."""
    return ('interface', ''), [(f'`~/{snake(name)}` {PACKAGE}/{name}', text) for name, text in OFFERED.items()]


def parameters() -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Table of parameters."""
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
