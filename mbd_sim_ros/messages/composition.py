"""The topics of a simulation: the template of each message, and which numbers of a snapshot go where in it.

Frames: `odom` is the world, `base_link` the reference frame of the chassis, `<wheel>_contact` the contact frame of a
tire (ISO-W, docs/conventions.md), `imu_link` the chassis' centre of mass with the axes of `base_link` (REP-145: an IMU
reports at its own frame).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from mbd_sim_ros.messages.cdr import Template, template
from mbd_sim_ros.messages.topics import ELEMENTS, ENERGY, IMU, JOINT_STATE, MOTIONS, ODOMETRY, TF, WRENCH, Topic
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.output.sensors import Sensors
from solver.output.snapshot import NO_STEPS, Channels, Snapshot, layout_of, new_numbers

_LOAD = TIRE_COLUMNS.index('fz')
_SLIP = TIRE_COLUMNS.index('kappa')
_CONTACT = TIRE_COLUMNS.index('px')
MOTION = ('vx', 'vy', 'vz', 'wx', 'wy', 'wz', 'ax', 'ay', 'az', 'dwx', 'dwy', 'dwz')  # of a body
TIRE_STATES = ('fz', *TIRE_COLUMNS[_SLIP:])  # the scalars of topic tire_states, per wheel


class Spot(NamedTuple):
    """A place in a template."""

    template: int
    offset: int  # bytes


class Composition:
    """Topics in their order, added one concept after the other.

    Template k is that of topic k. The last topic, /tf, has another one at steps that place all bodies: `seldom` (None:
    no step does). filled: spots in templates, and which numbers of the snapshot go there. sensed: spots of pose and
    twist in odom, and of orientation, angular velocity and acceleration in imu. applied: the template of cmd_applied.
    """

    def __init__(self, channels: Channels, frame_prefix: str) -> None:
        self.channels = channels
        self.topics: list[Topic] = []
        self.templates: list[Template] = []
        self.filled: list[tuple[Spot, np.ndarray]] = []
        self.sensed: list[Spot] = []
        self.applied = -1
        self.seldom: int | None = None
        self._prefix = frame_prefix
        self._frames: list[tuple[str, np.ndarray]] = []  # frames on /tf, and the numbers of their places
        layout = layout_of(channels)
        # each number is its own index, so what a slice holds says where it comes from
        self._snapshot = Snapshot(0, 0, np.arange(new_numbers(layout).size), layout, NO_STEPS)

    def frame(self, name: str) -> str:
        """Return the name of a frame with the prefix of this vehicle."""
        return self._prefix + name

    def add(self, topic: Topic, value: dict) -> None:
        """Add a topic with a message of this value."""
        self.topics.append(topic)
        self.templates.append(template(topic.type, value))

    def spot(self, path: str) -> Spot:
        """Place of a field in the newest message."""
        return Spot(len(self.templates) - 1, self.templates[-1].places[path].offset)

    def fill(self, path: str, source: np.ndarray) -> None:
        """Put numbers of the snapshot into a field of the newest message, and those behind it."""
        self.filled.append((self.spot(path), source.ravel()))

    def scalars(self, name: str, names: Sequence[str], source: np.ndarray) -> None:
        """Add a topic of named scalars."""
        self.add(Topic(name, JOINT_STATE), {'name': list(names), 'position': np.zeros(len(names))})
        self.fill('position', source)

    def add_joints(self) -> None:
        """Add the state of all joints."""
        s, joints = self._snapshot, self.channels.joints
        sources = {'position': s.joint_position, 'velocity': s.joint_velocity, 'effort': s.joint_effort}
        zeros = dict.fromkeys(sources, np.zeros(len(joints)))
        self.add(Topic('joint_states', JOINT_STATE), {'name': list(joints)} | zeros)
        for path, source in sources.items():
            self.fill(path, source)

    def add_chassis(self, sensors: Sensors) -> None:
        """Add odometry and imu of the chassis, where there is one, with the covariances of the sensors."""
        s, chassis = self._snapshot, self.channels.chassis
        if chassis is None:
            return
        covariances, base = sensors.covariances, self.frame('base_link')
        self._frames.append((base, s.pose[chassis]))
        header = {'header': {'frame_id': self.frame('odom')}, 'child_frame_id': base}
        self.add(Topic('odom', ODOMETRY), header | covariances['odom'])
        self.sensed += [self.spot('pose.pose.position.x'), self.spot('twist.twist.linear.x')]
        self.fill('pose.pose.position.x', s.pose[chassis])
        self.fill('twist.twist.linear.x', s.twist[chassis])
        self.add(Topic('imu', IMU), {'header': {'frame_id': self.frame('imu_link')}} | covariances['imu'])
        self.sensed += [self.spot(path) for path in ('orientation.x', 'angular_velocity.x', 'linear_acceleration.x')]
        self.fill('orientation.x', s.pose[chassis, 3:])
        self.fill('linear_acceleration.x', s.imu[:3])
        self.fill('angular_velocity.x', s.imu[3:])

    def add_wheels(self) -> None:
        """Add force and state of every tire."""
        s, wheels = self._snapshot, self.channels.wheels
        for i, wheel in enumerate(wheels):
            self._frames.append((self.frame(f'{wheel}_contact'), s.tire[i, _CONTACT:]))
            self.add(Topic(f'tire/{wheel}/force', WRENCH), {'header': {'frame_id': self._frames[-1][0]}})
            self.fill('wrench.force.x', s.tire[i, :6])
        if wheels:
            names = [f'{wheel}/{name}' for wheel in wheels for name in TIRE_STATES]
            self.scalars('tire_states', names, np.column_stack([s.tire[:, _LOAD], s.tire[:, _SLIP:]]))

    def add_inputs(self) -> None:
        """Add the inputs that were applied, and the step."""
        self.applied = len(self.templates)
        self.scalars('cmd_applied', (*self.channels.inputs, 'step'), self._snapshot.inputs)

    def add_elements(self, kinds: Mapping[str, str]) -> None:
        """Add the outputs of all force elements: a topic for each kind, and one for all elements without.

        kinds: element -> kind.
        """
        names, of_kind = self.channels.elements, dict[str, list[int]]()
        for i, name in enumerate(names):
            of_kind.setdefault(kinds.get(name.rpartition('/')[0], ''), []).append(i)
        for kind, columns in of_kind.items():
            topic = f'{ELEMENTS}/{kind}' if kind else ELEMENTS
            self.scalars(topic, [names[i] for i in columns], self._snapshot.elements[columns])

    def add_reactions(self) -> None:
        """Add the reaction of every constraint row."""
        self.scalars('reactions', self.channels.reactions, self._snapshot.reactions)

    def add_motions(self) -> None:
        """Add velocities and accelerations of all bodies, where there are any."""
        s, moving = self._snapshot, self.channels.moving
        if moving:
            names = [f'{body}/{name}' for body in moving for name in MOTION]
            self.scalars(MOTIONS, names, np.column_stack([s.twist, s.acceleration]))

    def add_energies(self) -> None:
        """Add the energies of the account, where there are any."""
        if self.channels.energies:
            self.scalars(ENERGY, self.channels.energies, self._snapshot.energies)

    def add_frames(self, *, bodies: bool, links: Sequence[str], imu_at: Sequence[float]) -> None:
        """Add /tf: the frames so far, and at some steps, where `bodies` is set, those of all bodies and the sensor too.

        links, imu_at: see mbd_sim_ros.messages.encode.Messages. It is the last topic.
        """
        if self._frames or bodies:
            self.topics.append(Topic('/tf', TF))
        if self._frames:
            self._add_transforms(self._frames, [])
        if not bodies:
            return
        chassis, names = self.channels.chassis, self.channels.bodies
        links = links or ['base_link' if b == chassis else name for b, name in enumerate(names)]
        others = [(self.frame(link), self._snapshot.pose[b]) for b, link in enumerate(links) if link != 'base_link']
        at = {'translation': dict(zip('xyz', imu_at, strict=True)), 'rotation': {'w': 1.0}}
        header = {'frame_id': self.frame('base_link')}
        sensor = {'header': header, 'child_frame_id': self.frame('imu_link'), 'transform': at}
        self.seldom = len(self.templates)
        self._add_transforms([*self._frames, *others], [] if chassis is None else [sensor])

    def _add_transforms(self, frames: Sequence[tuple[str, np.ndarray]], more: list[dict]) -> None:
        header = {'frame_id': self.frame('odom')}
        placed = [{'header': header, 'child_frame_id': name} for name, _ in frames]
        self.templates.append(template(TF, {'transforms': placed + more}))
        for i, (_, place) in enumerate(frames):
            self.fill(f'transforms[{i}].transform.translation.x', place)
