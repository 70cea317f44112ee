"""Tasks of driving to be learned: a scene, what is commanded, what is seen, what is rewarded, and when it ends.

Signals are named as everywhere: quantities (docs/accuracy.md) and columns of recordings, and those of a car on the line
that it is to follow,

| name | |
|---|---|
| offset | distance of base_link to the left of the line [m] |
| heading_error | heading relative to the line [rad], positive to the left |
| curvature, curvature+20 | curvature of the line beside the car, and 20 m ahead of it [1/m], positive to the left |
| progress | way along the line since the start [m] |
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mbd_sim_ros.learn.line import Line
from solver.errors import SpecError
from solver.inputs.driver import Course, PreviewDriver
from solver.scene import Scene
from solver.validate import finite, require, vector

ON_LINE = ('offset', 'heading_error', 'curvature', 'progress')


@dataclass(frozen=True, kw_only=True)
class Task:
    """A task.

    scene, changes: as `mbd run` takes them; the line is that of the scene's driver, else `points`. steering [rad]:
    angle of the steering wheel at an action of 1; drive, brake [N m]: torques at an action of 1 and -1 of the second
    number, where there is one (0 of both: the maneuver of the scene drives and brakes). every [s]: between two actions.
    duration [s]: after which an episode is cut off.

    observations: signal -> its scale; what is seen is value / scale, cut at `LIMIT`. costs: signal -> (scale, weight).
    The reward of a decision is

        every (alive - sum of weight u / (1 + u)) + progress (way along the line) - crash, where it ends badly

    with u = (value / scale)^2: a signal at its scale costs half its weight, and never more than it.

    It ends badly beyond `width` [m] of the line, at a heading error over `turned` [rad], and where the simulation
    fails; well below `slow` [m/s]. start: largest offset [m] and heading [rad] that an episode begins with, drawn anew
    each time (of none on roads that are not the same everywhere). vary: key -> (low, high), drawn once for each car.
    """

    name: str
    scene: str
    changes: tuple[str, ...] = ()
    points: tuple[tuple[float, float], ...] = ()
    steering: float = 1.5
    drive: float = 0.0
    brake: float = 0.0
    every: float = 0.1
    duration: float = 20.0
    observations: Mapping[str, float] = field(default_factory=dict)
    costs: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    alive: float = 1.0
    progress: float = 0.0
    crash: float = 10.0
    width: float = 2.0
    turned: float = 1.0
    slow: float = 0.0
    start: tuple[float, float] = (0.0, 0.0)
    vary: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        where = f'task {self.name}'
        for name in ('steering', 'every', 'width', 'turned'):
            finite(where, name, getattr(self, name), low=0.0, strict=True)
        finite(where, 'duration', self.duration, low=self.every)
        for name in ('drive', 'brake', 'slow'):
            finite(where, name, getattr(self, name), low=0.0)
        for name in ('alive', 'progress', 'crash'):
            finite(where, name, getattr(self, name))
        require(not isinstance(self.changes, str), where, 'changes', self.changes, 'give a tuple of key=value')
        for name in ('observations', 'costs', 'vary'):
            value = getattr(self, name)
            require(isinstance(value, Mapping), where, name, value, 'give a dict by names')
        require(bool(self.observations), where, 'observations', {}, 'name one signal at least')
        for signal, cost in self.costs.items():
            vector(where, f'costs.{signal} (scale, weight)', cost, 2)
        for signal, scale in (*self.observations.items(), *((name, cost[0]) for name, cost in self.costs.items())):
            finite(where, f'scale of {signal}', scale, low=0.0, strict=True)
        for value in vector(where, 'start (offset, heading)', self.start, 2):
            finite(where, 'start', value, low=0.0)
        for k, point in enumerate(self.points):
            vector(where, f'points[{k}]', point, 2)
        for key, ends in self.vary.items():
            low, high = vector(where, f'vary.{key} (low, high)', ends, 2)
            require(low <= high, where, f'vary.{key}', ends, 'give (low, high)')

    @property
    def actions(self) -> int:
        """Numbers in an action."""
        return 2 if self.drive > 0.0 or self.brake > 0.0 else 1

    def line(self, scene: Scene) -> Line:
        """The line of this task. Raises SpecError where neither it nor the scene has one."""
        driver = scene.maneuver.driver
        if self.points:
            return Line.of(Course(points=self.points))
        if isinstance(driver, PreviewDriver) and isinstance(driver.path, Course):
            return Line.of(driver.path)
        raise SpecError(f'task {self.name}: there is no line: give points, or a scene whose driver follows a course')

    def drawn(self, seed: int) -> list[str]:
        """Changes of the scene of a car, drawn with a seed."""
        chance = np.random.default_rng(seed)
        return [f'{key}={chance.uniform(low, high)!r}' for key, (low, high) in sorted(self.vary.items())]

    def replace(self, **changes: object) -> Task:
        """Copy with other fields. Raises SpecError for one that there is not."""
        known = {f.name for f in dataclasses.fields(self)}
        some = f'no such field; one of: {", ".join(sorted(known))}'
        for name, value in changes.items():
            require(name in known, f'task {self.name}', name, value, some)
        return dataclasses.replace(self, **changes)  # type: ignore[arg-type]


def _winding(length: float = 1500.0, wave: float = 200.0, side: float = 3.0) -> tuple[tuple[float, float], ...]:
    """A road that winds by 2 * side [m], up to 1.9 m/s^2 to the sides at 25 m/s, straight at its origin."""
    x = np.arange(-20.0, length, 2.0)
    y = np.where(x > 0.0, side * (1.0 - np.cos(2.0 * math.pi * x / wave)), 0.0)
    return tuple(zip(x.tolist(), y.tolist(), strict=True))


STEERED = {'yaw_rate': 0.3, 'sideslip_angle': 0.05, 'steering_wheel_angle': 0.5}
LANE_KEEPING = Task(
    name='lane_keeping',
    scene='light_car_straight',
    changes=('fidelity=single_track', 'integrator.h=0.005'),
    points=_winding(),
    steering=1.0,
    observations={
        'offset': 1.0, 'heading_error': 0.1, **STEERED, 'longitudinal_velocity': 25.0,
        'curvature': 0.003, 'curvature+12': 0.003, 'curvature+25': 0.003,
    },
    costs={'offset': (0.5, 0.8), 'lateral_acceleration': (5.0, 0.1)},
    start=(0.5, 0.02),
)  # fmt: skip
HANDLING_COURSE = Task(
    name='handling_course',
    scene='handling_course',
    changes=('fidelity=single_track', 'integrator.h=0.005', 'start.speed=8'),
    steering=6.0,
    drive=1200.0,
    brake=3000.0,
    duration=90.0,
    observations={
        'offset': 1.0, 'heading_error': 0.3, **STEERED, 'steering_wheel_angle': 4.0, 'longitudinal_velocity': 10.0,
        'curvature': 0.05, 'curvature+5': 0.05, 'curvature+10': 0.05, 'curvature+20': 0.05,
    },
    costs={'offset': (1.5, 0.5)},
    alive=0.0,
    progress=0.2,
    width=2.5,
    start=(0.3, 0.03),
)  # fmt: skip
# The brake comes at 2 s; with bodies alone do the wheels of a side slip by themselves.
SPLIT_FRICTION_STOP = Task(
    name='split_friction_stop',
    scene='car_split_mu_brake',
    changes=('vehicle=vehicles/light_car.yaml', 'integrator.iterations=1', 'maneuver.brake_torque.value=1600'),
    points=((-20.0, 0.0), (300.0, 0.0)),
    steering=3.0,
    duration=10.0,
    every=0.05,
    observations={
        'offset': 1.0, 'heading_error': 0.1, **STEERED, 'longitudinal_velocity': 20.0,
        'longitudinal_acceleration': 5.0,
    },
    costs={'offset': (0.5, 0.5), 'heading_error': (0.1, 0.5)},
    alive=0.0,  # who stops later must not gain by it
    width=3.0,
    slow=0.5,
)  # fmt: skip
TASKS = {task.name: task for task in (LANE_KEEPING, HANDLING_COURSE, SPLIT_FRICTION_STOP)}
