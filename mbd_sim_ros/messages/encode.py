"""The only conversion from a Snapshot to ROS messages: the same bytes are published by the node and written into
recordings.

Every topic is one `cdr.Template`, which mbd_sim_ros.messages.composition makes; a step patches its numbers. At a rate
of its own /tf holds the reference frames of all bodies too, under the names of their links in `robot_description`: what
shows the robot then shows the motion as it is.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbd_sim_ros.messages.cdr import ENCAPSULATION
from mbd_sim_ros.messages.composition import Composition, Spot
from mbd_sim_ros.messages.topics import ELEMENTS, ENERGY, MOTIONS, family
from solver.elements.registry import FORCES
from solver.errors import StepError
from solver.files.urdf import link_of
from solver.model.spec import ModelSpec
from solver.output.sensors import Sensors
from solver.output.snapshot import NO_STEPS, Channels, Snapshot, layout_of

if TYPE_CHECKING:
    from solver.scene import Scene
    from solver.simulation import Simulation

PARTS = 64  # selections of topics that are remembered
PATTERNS = 4096  # steps whose selection of topics is remembered, of the period in which these come again
STAMP = struct.Struct('<iI')  # builtin_interfaces/Time: s, ns


class _Part(NamedTuple):
    """Data for the messages of some topics: places of their times and numbers, and of the numbers of a snapshot that go
    there."""

    stamps: list[int]  # bytes from the begin of the buffer
    source: np.ndarray
    target: np.ndarray
    messages: list[tuple[int, memoryview]]  # places of the topics, and their parts of the buffer
    sensed: bool  # whether any of them shows noise


class Messages:
    """Turns snapshots into encoded messages, one per topic.

    `frame_prefix` is put before every frame name (several vehicles in one graph). `element_states` and `reactions` add
    the outputs of every force element and the reaction of every constraint row as named scalars. kinds: element -> its
    kind, whose elements have a topic of their own (others share one). elements_every: steps between messages of
    elements. sensors: covariances and noise of odom and imu. motions_every: steps between messages of velocities and
    accelerations of all bodies, energies_every: of energies (0: there are none). poses_every: steps between messages
    that place all bodies (0: none does); links: their names in `robot_description`, 'base_link' for one that has its
    place anyway (default: all bodies but the chassis under their own names); imu_at: where the chassis has its centre
    of mass [m]. All messages lie in one buffer, and a step is one indexed copy from the numbers of the snapshot to
    those of the messages that are wanted: one instance serves one thread.
    """

    def __init__(
        self,
        channels: Channels,
        *,
        frame_prefix: str = '',
        element_states: bool = False,
        reactions: bool = False,
        kinds: Mapping[str, str] | None = None,
        elements_every: int = 1,
        motions_every: int = 0,
        energies_every: int = 0,
        poses_every: int = 0,
        links: Sequence[str] = (),
        imu_at: Sequence[float] = (0.0, 0.0, 0.0),
        sensors: Sensors | None = None,
    ) -> None:
        self.channels = channels
        self.poses_every = poses_every
        parts = Composition(channels, frame_prefix)
        parts.add_joints()
        parts.add_chassis(sensors or Sensors())
        parts.add_wheels()
        parts.add_inputs()
        if element_states:
            parts.add_elements(kinds or {})
        if reactions:
            parts.add_reactions()
        if motions_every:
            parts.add_motions()
        if energies_every:
            parts.add_energies()
        parts.add_frames(bodies=poses_every > 0, links=links, imu_at=imu_at)
        self.topics = tuple(parts.topics)
        self._seldom = parts.seldom
        apart = {ELEMENTS: elements_every, MOTIONS: motions_every, ENERGY: energies_every}
        self._every = [apart.get(family(topic.name), 1) for topic in self.topics]
        if self._seldom == len(self.topics) - 1:  # /tf has no other
            self._every[-1] = poses_every
        self._lay_out(parts, sensors)

    @classmethod
    def of(cls, scene: Scene, simulation: Simulation, frame_prefix: str = '') -> Messages:
        """The encoder of what a simulation (solver.simulation.Simulation or alike) shows, as its scene has it
        recorded."""
        channels, record = simulation.channels, scene.record
        h = simulation.h_ns * 1e-9
        every = record.poses_every(h)
        kinds = kinds_of(simulation.scene.model) if record.elements and hasattr(simulation, 'scene') else {}
        links, at = [], (0.0, 0.0, 0.0)
        if every:
            model = simulation.scene.model  # of a level of detail it is not that of the scene that was asked for
            links = [link_of(model, name) for name in channels.bodies]
            at = at if channels.chassis is None else model.bodies[channels.chassis].com
        return cls(
            channels,
            frame_prefix=frame_prefix,
            element_states=record.elements,
            reactions=record.reactions,
            kinds=kinds,
            elements_every=record.elements_every(h),
            motions_every=record.motions_every(h),
            energies_every=record.energies_every(h),
            poses_every=every,
            links=links,
            imu_at=at,
            sensors=scene.sensors,
        )

    def _lay_out(self, parts: Composition, sensors: Sensors | None) -> None:
        """Put the templates into one buffer, every body at a multiple of 8 bytes, as CDR aligns its numbers."""
        begins, end = [], 0
        for message in parts.templates:
            begins.append(end + 8 - len(ENCAPSULATION))
            end = begins[-1] + len(message.data) + -(begins[-1] + len(message.data)) % 8
        self._numbers = np.zeros(end // 8)
        self._memory = memory = memoryview(self._numbers).cast('B')  # type: ignore[arg-type]  # numpy arrays are buffers
        self._messages = [
            memory[begin : begin + len(message.data)] for begin, message in zip(begins, parts.templates, strict=True)
        ]
        self._stamps: list[list[int]] = []  # of every template, where its times are
        for begin, own, message in zip(begins, self._messages, parts.templates, strict=True):
            own[:] = message.data
            self._stamps.append(
                [begin + place.offset for path, place in message.places.items() if path.endswith('stamp.sec')]
            )

        def number(spot: Spot) -> int:
            return (begins[spot.template] + spot.offset) // 8

        # of every template, which numbers of the snapshot go where
        self._filled = [(spot.template, source, number(spot) + np.arange(len(source))) for spot, source in parts.filled]
        self._parts: dict[tuple[tuple[int, ...], bool], _Part] = {}
        self._sensors = sensors if sensors is not None and sensors.noise and parts.sensed else None
        self._sensed_at = [number(spot) for spot in parts.sensed]
        self._sensed_in = {spot.template for spot in parts.sensed}
        # of all templates, for many snapshots at once
        empty = np.zeros(0, int)
        self._all = _Part(
            stamps=[place for places in self._stamps for place in places],
            source=np.concatenate([empty, *(source for _, source, _ in self._filled)]),
            target=np.concatenate([empty, *(target for _, _, target in self._filled)]),
            messages=[],
            sensed=False,
        )
        self._table, self._layout = np.zeros((0, len(self._numbers))), layout_of(self.channels)
        self._spans = [(begin, begin + len(message)) for begin, message in zip(begins, self._messages, strict=True)]
        self._patterns: dict[int, list[tuple[int, int, int]]] = {}
        self._period = math.lcm(*self._every, self.poses_every or 1)
        inputs = parts.templates[parts.applied].places['position']
        self._step = number(Spot(parts.applied, inputs.offset)) + inputs.size - 1

    def encode(
        self, snapshot: Snapshot, *, whole: bool = False, only: Sequence[int] | None = None
    ) -> list[bytes | None]:
        """Return one encoded message per topic, in the order of `topics`; None where a topic has none at this step,
        unless `whole`.

        only: places of topics; the others are None too. Raises StepError, which names what and when, if a number in the
        snapshot is not finite, wanted or not: such a state never leaves.
        """
        require_finite(snapshot, self.channels)
        k, every = snapshot.k, self._every
        due = tuple([i for i in (range(len(every)) if only is None else only) if whole or k % every[i] == 0])
        placed = self._seldom is not None and (whole or k % self.poses_every == 0)
        part = self._parts.get((due, placed)) or self._part(due, placed)
        seconds, rest = divmod(snapshot.t_ns, 1_000_000_000)
        for place in part.stamps:
            STAMP.pack_into(self._memory, place, seconds, rest)
        self._numbers[part.target] = snapshot.numbers[part.source]
        self._numbers[self._step] = k
        if part.sensed and self._sensors is not None:
            self._scatter(self._sensors, k)
        messages: list[bytes | None] = [None] * len(every)
        for i, message in part.messages:
            messages[i] = bytes(message)
        return messages

    def encode_rows(self, steps: np.ndarray, t_ns: np.ndarray, rows: np.ndarray) -> list[list[bytes | None]]:
        """encode() of the numbers (n, m) of snapshots of n steps, at times t_ns (n,): the same bytes, in one copy, up
        to the first snapshot that encode() refuses."""
        n = finite_rows(rows, self.channels)
        if n == 0:
            return []
        steps, t_ns, rows = steps[:n], t_ns[:n], rows[:n]
        snapshots = (
            Snapshot(k, t, row, self._layout, NO_STEPS)
            for k, t, row in zip(steps.tolist(), t_ns.tolist(), rows, strict=True)
        )
        if self._sensors is not None:  # whose noise is made step by step
            return [self.encode(snapshot) for snapshot in snapshots]
        if len(rows) > len(self._table):
            self._table = np.repeat(self._numbers[None], len(rows), axis=0)
        table = self._table[: len(rows)]
        table[:, self._all.target] = rows[:, self._all.source]
        table[:, self._step] = steps
        seconds, rest = np.divmod(t_ns, 1_000_000_000)
        halves = table.view(np.int32)
        stamps = np.array(self._all.stamps, int) // halves.itemsize
        halves[:, stamps] = seconds[:, None]
        halves.view(np.uint32)[:, stamps + 1] = rest[:, None]
        data = memoryview(table).cast('B')  # type: ignore[arg-type]  # numpy arrays are buffers
        size, found = table.itemsize * table.shape[1], list[list[bytes | None]]()
        for begin, k in zip(range(0, size * len(rows), size), steps.tolist(), strict=True):
            messages: list[bytes | None] = [None] * len(self._every)
            for i, first, last in self._due(k):
                messages[i] = bytes(data[begin + first : begin + last])
            found.append(messages)
        return found

    def _due(self, k: int) -> list[tuple[int, int, int]]:
        """Places of the topics that have a message at step k, and of its bytes in the buffer."""
        pattern = k % self._period
        if pattern not in self._patterns:
            if len(self._patterns) == PATTERNS:
                self._patterns.clear()
            due = [i for i, every in enumerate(self._every) if k % every == 0]
            placed = self._seldom is not None and k % self.poses_every == 0
            last = len(self.topics) - 1
            chosen = [(i, self._seldom if placed and i == last and self._seldom is not None else i) for i in due]
            self._patterns[pattern] = [(i, *self._spans[template]) for i, template in chosen]
        return self._patterns[pattern]

    def _part(self, due: tuple[int, ...], placed: bool) -> _Part:
        """Part of the buffer that the topics at these places take, the last of them with all bodies if `placed`; kept
        for the next time."""
        last = len(self.topics) - 1
        chosen = [(i, self._seldom if placed and i == last and self._seldom is not None else i) for i in due]
        templates = {k for _, k in chosen}
        sensed = self._sensors is not None and not templates.isdisjoint(self._sensed_in)
        if sensed:
            templates |= self._sensed_in
        filled = [(source, target) for k, source, target in self._filled if k in templates]
        empty = np.zeros(0, int)
        if len(self._parts) == PARTS:  # listeners come and go
            self._parts.clear()
        part = self._parts[due, placed] = _Part(
            stamps=[place for k in sorted(templates) for place in self._stamps[k]],
            source=np.concatenate([empty, *(source for source, _ in filled)]),
            target=np.concatenate([empty, *(target for _, target in filled)]),
            messages=[(i, self._messages[k]) for i, k in chosen],
            sensed=sensed,
        )
        return part

    def _scatter(self, sensors: Sensors, k: int) -> None:
        """Put the noise of step k onto the numbers of odom and imu."""
        pose, twist, orientation, rate, acceleration = self._sensed_at
        n = self._numbers
        odom = np.concatenate([n[pose : pose + 7], n[twist : twist + 6]])
        imu = np.concatenate([n[orientation : orientation + 4], n[rate : rate + 3], n[acceleration : acceleration + 3]])
        sensors.scatter(k, odom, imu)
        n[pose : pose + 7], n[twist : twist + 6] = odom[:7], odom[7:]
        n[orientation : orientation + 4], n[rate : rate + 3], n[acceleration : acceleration + 3] = (
            imu[:4],
            imu[4:7],
            imu[7:],
        )


def kinds_of(model: ModelSpec) -> dict[str, str]:
    """The kind of every force element, by its name."""
    return {element.name: kind.name for kind in FORCES if not kind.wheels for element in getattr(model, kind.name)}


def finite_rows(rows: np.ndarray, channels: Channels) -> int:
    """Number of rows (n, m) of snapshots before the first that require_finite() refuses."""
    with np.errstate(over='ignore', invalid='ignore'):
        total = rows.sum()  # not a product, for which libraries of matrices start threads
    if math.isfinite(total):
        return len(rows)
    layout = layout_of(channels)
    for k in np.flatnonzero(~np.isfinite(rows).all(axis=1)).tolist():
        try:
            require_finite(Snapshot(0, 0, rows[k], layout, NO_STEPS), channels)
        except StepError:
            return int(k)
    return len(rows)


def require_finite(snapshot: Snapshot, channels: Channels) -> None:
    """Raise StepError naming the first channel that is not finite, with time and step. A reaction and the effort of a
    joint may be NaN: next to a singular position the motion does not determine them (solver.output.undetermined).
    """
    numbers = snapshot.numbers
    # NaN and inf survive a sum of squares: the cheapest test of all
    if math.isfinite(np.vdot(numbers, numbers)) or snapshot.is_finite():
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
        ('acceleration of body', snapshot.acceleration, channels.moving),
        ('energy', snapshot.energies, channels.energies),
    )
    for what, values, names in named:
        for name, value in zip(names, values):
            if not np.all(np.isfinite(value)):
                raise StepError(
                    f'{what} {name!r} is not finite at t = {snapshot.t_ns * 1e-9:.6f} s (step {snapshot.k}); try a '
                    'smaller step'
                )
    if not np.all(np.isfinite(snapshot.imu)):
        raise StepError(
            f'the imu output is not finite at t = {snapshot.t_ns * 1e-9:.6f} s (step {snapshot.k}); try a smaller step'
        )
