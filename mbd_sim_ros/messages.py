"""The only conversion from a Snapshot to ROS messages: the same bytes are published by the node and written into recordings.

Every topic is one `cdr.Template`; a step patches its numbers. Frames: `odom` is the world, `base_link` the reference frame of
the chassis, `<wheel>_contact` the contact frame of a tire (ISO-W, docs/conventions.md), `imu_link` the chassis' centre of
mass with the axes of `base_link` (REP-145: an IMU reports at its own frame).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mbd_sim_ros.cdr import Template
from solver.errors import StepError
from solver.snapshot import TIRE_COLUMNS, Channels, Snapshot

JOINT_STATE = 'sensor_msgs/msg/JointState'
ODOMETRY = 'nav_msgs/msg/Odometry'
IMU = 'sensor_msgs/msg/Imu'
WRENCH = 'geometry_msgs/msg/WrenchStamped'
TF = 'tf2_msgs/msg/TFMessage'
STRING = 'std_msgs/msg/String'

# The type hashes (REP-2016) of ROS 2 Jazzy; a test compares them with the installed ones.
TYPE_HASHES = {
    JOINT_STATE: 'RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e',
    ODOMETRY: 'RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0',
    IMU: 'RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b',
    WRENCH: 'RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77',
    TF: 'RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087',
    STRING: 'RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18',
}

_LOAD = TIRE_COLUMNS.index('fz')
_SLIP = TIRE_COLUMNS.index('kappa')
_CONTACT = TIRE_COLUMNS.index('px')
TIRE_STATES = ('fz', *TIRE_COLUMNS[_SLIP:])  # the scalars of topic tire_states, per wheel


class Topic(NamedTuple):
    """Name (relative, except /tf), type and quality of service of what is published; all are volatile, keep last."""

    name: str
    type: str
    depth: int = 10
    reliable: bool = True
    latched: bool = False


class Messages:
    """Turns snapshots into encoded messages, one per topic.

    `frame_prefix` is put before every frame name (several vehicles in one graph). `element_states` and `reactions` add the
    outputs of every force element and the reaction of every constraint row as named scalars. The arrays inside are reused:
    one instance serves one thread.
    """

    def __init__(self, channels: Channels, *, frame_prefix: str = '', element_states: bool = False, reactions: bool = False) -> None:
        self.channels = channels
        self._prefix = frame_prefix
        self._templates: list[Template] = []
        self._stamps: list[tuple[memoryview, int]] = []
        self._fills: list[tuple[np.ndarray, Callable[[Snapshot], np.ndarray | float]]] = []
        topics: list[Topic] = []

        def add(topic: Topic, value: dict) -> Template:
            template = Template(topic.type, value)
            topics.append(topic)
            self._templates.append(template)
            self._stamps += [(template.memory, place.offset) for path, place in template.places.items() if path.endswith('stamp.sec')]
            return template

        def fill(view: np.ndarray, source: Callable[[Snapshot], np.ndarray | float]) -> None:
            if view.size:
                self._fills.append((view, source))

        def scalars(name: str, names: tuple[str, ...]) -> np.ndarray:
            template = add(Topic(name, JOINT_STATE), {'name': list(names), 'position': np.zeros(len(names))})
            return template.view('position')

        n = len(channels.joints)
        joints = add(
            Topic('joint_states', JOINT_STATE),
            {'name': list(channels.joints), 'position': np.zeros(n), 'velocity': np.zeros(n), 'effort': np.zeros(n)},
        )
        fill(joints.view('position'), lambda s: s.joint_position)
        fill(joints.view('velocity'), lambda s: s.joint_velocity)
        fill(joints.view('effort'), lambda s: s.joint_effort)

        frames = [self.frame('base_link')] if channels.chassis is not None else []
        if channels.chassis is not None:
            chassis = channels.chassis
            odom = add(Topic('odom', ODOMETRY), {'header': {'frame_id': self.frame('odom')}, 'child_frame_id': self.frame('base_link')})
            fill(odom.view('pose.pose.position.x', 7), lambda s: s.pose[chassis])
            fill(odom.view('twist.twist.linear.x', 6), lambda s: s.twist[chassis])
            imu = add(Topic('imu', IMU), {'header': {'frame_id': self.frame('imu_link')}})
            fill(imu.view('orientation.x', 4), lambda s: s.pose[chassis, 3:])
            fill(imu.view('linear_acceleration.x', 3), lambda s: s.imu[:3])
            fill(imu.view('angular_velocity.x', 3), lambda s: s.imu[3:])

        for i, wheel in enumerate(channels.wheels):
            frames.append(self.frame(f'{wheel}_contact'))
            wrench = add(Topic(f'tire/{wheel}/force', WRENCH), {'header': {'frame_id': frames[-1]}})
            fill(wrench.view('wrench.force.x', 6), lambda s, i=i: s.tire[i, :6])  # type: ignore[misc]
        if channels.wheels:
            states = scalars('tire_states', tuple(f'{wheel}/{name}' for wheel in channels.wheels for name in TIRE_STATES))
            states = states.reshape(len(channels.wheels), len(TIRE_STATES))
            fill(states[:, 0], lambda s: s.tire[:, _LOAD])
            fill(states[:, 1:], lambda s: s.tire[:, _SLIP:])

        self._applied = len(topics)
        applied = scalars('cmd_applied', (*channels.inputs, 'step'))
        start = len(self._fills)
        fill(applied[:-1], lambda s: s.inputs)
        fill(applied[-1:], lambda s: float(s.k))
        self._applied_fills = self._fills[start:]
        if element_states:
            fill(scalars('element_states', channels.elements), lambda s: s.elements)
        if reactions:
            fill(scalars('reactions', channels.reactions), lambda s: s.reactions)

        if frames:
            transforms = [{'header': {'frame_id': self.frame('odom')}, 'child_frame_id': frame} for frame in frames]
            tf = add(Topic('/tf', TF, depth=100), {'transforms': transforms})
            views = [tf.view(f'transforms[{i}].transform.translation.x', 7) for i in range(len(frames))]
            if channels.chassis is not None:
                fill(views.pop(0), lambda s: s.pose[chassis])
            for i, view in enumerate(views):
                fill(view, lambda s, i=i: s.tire[i, _CONTACT:])  # type: ignore[misc]
        self.topics = tuple(topics)

    def frame(self, name: str) -> str:
        """Return the name of a frame with the prefix of this vehicle."""
        return self._prefix + name

    def encode(self, snapshot: Snapshot) -> list[bytes]:
        """Return one encoded message per topic, in the order of `topics`.

        Raises StepError, which names what and when, if a number in the snapshot is not finite: such a state never leaves.
        """
        require_finite(snapshot, self.channels)
        stamp = struct.pack('<iI', *divmod(snapshot.t_ns, 1_000_000_000))
        for memory, offset in self._stamps:
            memory[offset : offset + 8] = stamp
        for view, source in self._fills:
            view[...] = source(snapshot)
        return [template.bytes() for template in self._templates]

    def encode_inputs(self, snapshot: Snapshot) -> list[bytes | None]:
        """Return the same list with `cmd_applied` alone: what a recording needs of the steps it otherwise leaves out."""
        require_finite(snapshot, self.channels)
        template = self._templates[self._applied]
        template.memory[template.places['header.stamp.sec'].offset :][:8] = struct.pack('<iI', *divmod(snapshot.t_ns, 1_000_000_000))
        for view, source in self._applied_fills:
            view[...] = source(snapshot)
        return [template.bytes() if i == self._applied else None for i in range(len(self._templates))]


def require_finite(snapshot: Snapshot, channels: Channels) -> None:
    """Raise StepError naming the first channel that is not finite, with time and step."""
    s = snapshot
    arrays = (s.pose, s.twist, s.joint_position, s.joint_velocity, s.joint_effort, s.imu, s.tire, s.inputs, s.elements, s.reactions)
    if math.isfinite(sum(np.vdot(a, a) for a in arrays)):  # NaN and inf survive a sum of squares: the cheapest test of all
        return
    named: tuple[tuple[str, np.ndarray, tuple[str, ...]], ...] = (
        ('pose of body', snapshot.pose, channels.bodies),
        ('velocity of body', snapshot.twist, channels.bodies),
        ('position of joint', snapshot.joint_position, channels.joints),
        ('velocity of joint', snapshot.joint_velocity, channels.joints),
        ('effort of joint', snapshot.joint_effort, channels.joints),
        ('state of tire', snapshot.tire, channels.wheels),
        ('input', snapshot.inputs, channels.inputs),
        ('output', snapshot.elements, channels.elements),
        ('reaction', snapshot.reactions, channels.reactions),
    )
    for what, values, names in named:
        for name, value in zip(names, values):
            if not np.all(np.isfinite(value)):
                raise StepError(
                    f'{what} {name!r} is not finite at t = {snapshot.t_ns * 1e-9:.6f} s (step {snapshot.k}); try a smaller step'
                )
    if not np.all(np.isfinite(snapshot.imu)):
        raise StepError(f'the imu output is not finite at t = {snapshot.t_ns * 1e-9:.6f} s (step {snapshot.k}); try a smaller step')
