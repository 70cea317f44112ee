"""The signals that evaluations ask for, on one even grid of time, from our recordings and from mapped ones of others.

A signal is taken from the channel of its own name (a mapping file may give `roll: {channel: vehicle/roll, unit: deg}`),
or it is computed from the channels of our recordings. Axes and signs: docs/conventions.md; velocities and positions are
those of base_link, accelerations those of the place of the IMU, the centre of mass of the chassis.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from mbd_sim_ros.analysis.evaluation import grid
from mbd_sim_ros.analysis.evaluation.grid import POSE
from mbd_sim_ros.bags import clocks
from mbd_sim_ros.bags.reader import Run
from solver.analysis.driven import DIRECT
from solver.analysis.figures import is_vehicle, mass_figures
from solver.analysis.kinematics_and_compliance import Rig, kinematic_figures
from solver.errors import BagError, MbdError
from solver.files.scene import load_scene_text
from solver.quantities import OF_BODY
from solver.scene import Scene
from solver.vehicle.size import size_of

TWIST = tuple(f'odom/twist/{name}' for name in ('vx', 'vy', 'vz', 'wx', 'wy', 'wz'))
FORCE = tuple(f'imu/{name}' for name in ('ax', 'ay', 'az'))
BODY = (*POSE, *TWIST, *FORCE)
GIVEN = 'by --set'  # parameters of an evaluation
# torques, which hold
COMMANDS = tuple(f'cmd_applied/{name}' for name in ('brake_torque', 'drive_torque', 'steering_torque'))
Columns = Sequence[np.ndarray]


class Way(NamedTuple):
    """One way to a signal: from these channels. note: what is lost by it."""

    channels: tuple[str, ...]
    of: Callable[[Columns], np.ndarray]
    note: str = ''


def _of_body(name: str) -> Way:
    last = 16 if name.endswith('acceleration') else 7 if name in ('heading', 'roll') else 13

    def of(columns: Columns) -> np.ndarray:
        table = np.zeros((columns[0].size, 16))
        table[:, : len(columns)] = np.column_stack(columns)
        return OF_BODY[name](table)[:, 0]

    return Way(BODY[:last], of)


def _one(channel: str, note: str = '') -> Way:
    return Way((channel,), lambda columns: columns[0], note)


TILT = (
    'lateral acceleration is the channel imu/ay as it is, with what the roll of the body adds to it: the recording '
    'has no orientation'
)
WAYS: dict[str, tuple[str, str, tuple[Way, ...]]] = {
    'steering': (
        'rad',
        'angle of the steering wheel',
        (_one('cmd_applied/steering'), _one('joint_states/steering_wheel/position')),
    ),
    # of a wheel that a torque turns the effort is what all elements act on it with: the hand, and a damper of the
    # steering
    'steering_torque': (
        'N m',
        'hand torque',
        (_one('cmd_applied/steering_torque'), _one('joint_states/steering_wheel/effort')),
    ),
    'brake': ('N m', 'brake command', (_one('cmd_applied/brake_torque'),)),
    'speed': ('m/s', 'speed along the vehicle', (_of_body('longitudinal_velocity'), _one('odom/twist/vx'))),
    'sideslip_angle': (
        'rad',
        'sideslip angle of base_link',
        (_of_body('sideslip_angle'), Way(('odom/twist/vx', 'odom/twist/vy'), lambda c: np.arctan2(c[1], c[0]))),
    ),
    'yaw_rate': ('rad/s', 'yaw rate', (_of_body('yaw_rate'), _one('imu/wz'), _one('odom/twist/wz'))),
    'lateral_acceleration': ('m/s^2', 'lateral acceleration', (_of_body('lateral_acceleration'), _one('imu/ay', TILT))),
    'roll': ('rad', 'roll angle', (_of_body('roll'),)),
    'heading': ('rad', 'yaw angle', (_of_body('heading'),)),
    'x': ('m', 'place', (_one('odom/pose/x'),)),
    'y': ('m', 'place', (_one('odom/pose/y'),)),
    'road_angle': ('rad', 'steering angle of the front road wheels, mean', ()),
    'road_angle_left': ('rad', 'steering angle of the left front road wheel', ()),
    'road_angle_right': ('rad', 'steering angle of the right front road wheel', ()),
    'ax': ('m/s^2', 'specific force forward', (_one('imu/ax'),)),
    'ay': ('m/s^2', 'specific force to the left', (_one('imu/ay'),)),
    'az': ('m/s^2', 'specific force upwards', (_one('imu/az'),)),
}
WHEELS = ('front_left', 'front_right', 'rear_left', 'rear_right')
UNDER = {f'friction_{wheel}': f'tire_states/{wheel}/friction' for wheel in WHEELS}
WAYS |= {name: ('1', 'factor on the friction under a wheel', (_one(channel),)) for name, channel in UNDER.items()}
TURNS = {f'wheel_rate_{wheel}': f'joint_states/wheel_{wheel}/velocity' for wheel in WHEELS}
WAYS |= {name: ('rad/s', 'speed of rotation of a wheel', (_one(channel),)) for name, channel in TURNS.items()}
WAYS |= {f'wheel_speed_{wheel}': ('m/s', 'circumferential speed of a wheel', ()) for wheel in WHEELS}
NEEDED = tuple(dict.fromkeys(channel for _, _, ways in WAYS.values() for way in ways for channel in way.channels))


@dataclass(frozen=True, kw_only=True)
class Vehicle:
    """Data of a recording about its vehicle; None where it holds no scene of one. ratio: steering wheel to road wheels
    [-]."""

    scene: Scene | None = None
    masses: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, scene: Scene | None) -> Vehicle:
        """From the scene in a recording."""
        if scene is None or not is_vehicle(scene.model):
            return cls(scene=scene)
        return cls(scene=scene, masses=mass_figures(scene.model))

    @cached_property
    def ratio(self) -> float | None:
        """Ratio of the steering, on the bench."""
        if not self.masses or self.scene is None:
            return None
        try:
            return kinematic_figures(Rig(self.scene.model))['steering_ratio']
        except MbdError:
            return None

    @property
    def turned(self) -> float:
        """By what part of that of a passenger car the steering wheel is turned for the same lateral acceleration, at
        most 1: little where the steering is as direct, and the wheelbase as short, as those of models are. 1 where the
        vehicle is not known."""
        if self.ratio is None or self.scene is None:
            return 1.0
        return min(1.0, abs(self.ratio) / DIRECT) * min(1.0, size_of(self.scene.model).length)

    def known(self, name: str) -> float | None:
        """wheelbase [m], mass [kg], ratio ... or None."""
        return self.ratio if name == 'ratio' else self.masses.get(name)


def scene_of(run: Run, place: str) -> tuple[Scene | None, str]:
    """The scene that a recording holds, or why one that it holds cannot be read, as that of another version; (None, '')
    without one."""
    text = run.metadata.get('resolved_scene', '')
    try:
        return (load_scene_text(text, f'scene in {place}') if text else None), ''
    except MbdError as error:
        return None, str(error)


@dataclass(kw_only=True)
class Signals:
    """The signals of a recording. t: (n,) evenly spaced [s], counted from the first stamp where stamps tell the time of
    day. spacing: time between two samples of what a signal is made from, where that is longer [s]. missing: (n,) masks
    of signals that have gaps, True within a gap.
    """

    place: str
    t: np.ndarray
    values: dict[str, np.ndarray]
    notes: list[str]
    vehicle: Vehicle = field(default_factory=Vehicle)
    spacing: dict[str, float] = field(default_factory=dict)
    missing: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def rate(self) -> float:
        """Samples per second."""
        return 1.0 / (self.t[1] - self.t[0])

    def every(self, *names: str) -> float:
        """The longest time between two samples of these signals as they were recorded [s]."""
        return max(self.spacing.get(name, 1.0 / self.rate) for name in names)

    def __getitem__(self, name: str) -> np.ndarray:
        return self.values[name]

    def __contains__(self, name: str) -> bool:
        return name in self.values

    def refuse(self, why: str) -> BagError:
        """The error of a recording in which the maneuver is not."""
        return BagError(f'{self.place}: {why}')

    def between(self, begin: float, end: float) -> np.ndarray:
        """(n,) mask of the samples from begin to end [s]."""
        return (self.t >= begin - 1e-9) & (self.t <= end + 1e-9)

    def parameter(self, given: Any, name: str, missing: str) -> float:
        """A number of the vehicle: as given, or of the scene; NaN and a note that says what is missing without it."""
        value = given if given is not None else self.vehicle.known(name)
        if value is None:
            self.notes.append(f'{missing}: give {name}=... ({GIVEN})')
        return math.nan if value is None else float(value)


def signals(
    run: Run,
    place: str,
    needs: Sequence[str],
    also: Sequence[str] = (),
    *,
    held: frozenset[str] = frozenset(),
    vehicle: Vehicle | None = None,
) -> Signals:
    """The signals `needs`, and those of `also` that the recording has. held: channels whose last value holds.

    Raises BagError that says which channel is missing.
    """
    home = {name: one for one in grid.without_jumps(run).values() for name in one.columns}
    chosen: dict[str, Way] = {}
    without: dict[str, None] = {}
    empty = {c for c in (*NEEDED, *WAYS) if c in home and not np.isfinite(home[c].columns[c]).any()}
    for name in (*needs, *also):
        _, text, ways = WAYS[name]
        there = [w for w in (_one(name), *ways) if all(channel in home for channel in w.channels)]
        way = next((w for w in there if empty.isdisjoint(w.channels)), there[0] if there and name in needs else None)
        if way is not None:
            chosen[name] = way
            continue
        unread = next(
            (
                f'{t} is not read: {why}'
                for t, why in run.left_out.items()
                for w in ways
                if w.channels[-1].startswith(f'{t}/')
            ),
            '',
        )
        if name in needs:
            fewest = min((w.channels for w in ways), key=len, default=())
            needed = [name, *[channel for channel in fewest if channel not in home][:1]]
            if unread:
                raise BagError(f'{place}: has no {text}: {unread}')
            raise BagError(
                f'{place}: has no {text}: the channel {" or ".join(needed)} is needed; map it with --map THEIRS={name}'
            )
        if unread:
            without[unread] = None
    channels = tuple(dict.fromkeys(channel for way in chosen.values() for channel in way.channels))
    samples = {c: grid.numbers(home[c], c, place) for c in channels}
    held = held | {c for c in channels if c in COMMANDS}
    try:
        t_ns, origin, notes = grid.shared_grid({c: t for c, (t, _) in samples.items()}, place, held)
    except BagError:
        if told := clocks.apart(run.accounts):
            raise BagError(f'{place}: {told}') from None
        raise
    on_grid = {c: grid.resampled(t_ns, *samples[c], c, c in held) for c in channels}
    grid.normalise(on_grid)
    values = {name: way.of([on_grid[c] for c in way.channels]) for name, way in chosen.items()}
    notes += [*without, *(way.note for way in chosen.values() if way.note)]
    apart = {c: grid.spacing(t) * 1e-9 for c, (t, _) in samples.items() if t.size > 1}
    gaps = {c: grid.gaps(t_ns, t) for c, (t, _) in samples.items() if c not in held}
    missing = {name: [gaps[c] for c in way.channels if c in gaps and gaps[c].any()] for name, way in chosen.items()}
    spacing = {name: max(apart.get(c, 0.0) for c in way.channels) for name, way in chosen.items()}
    return Signals(
        place=place,
        t=(t_ns - origin) * 1e-9,
        values=values,
        notes=notes,
        vehicle=vehicle or Vehicle(),
        spacing={name: seconds for name, seconds in spacing.items() if seconds > 1e-9 * (t_ns[1] - t_ns[0])},
        missing={name: np.logical_or.reduce(masks) for name, masks in missing.items() if masks},
    )
