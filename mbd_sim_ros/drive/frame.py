"""Pictures as pages get them: numbers of one instant, 64-bit floats in one row.

    t, number of the keys that are in it, paused, speed, ax, ay, yaw rate, steering wheel, gas, brake, handbrake, gear,
    then of every body its pose (7), of every wheel the place of its contact (3) and the force there (3), in the world,
    and its load.

SI units. ax and ay are the specific forces of the chassis, as imu has them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_sim_ros.analysis.pages import filled
from mbd_sim_ros.analysis.view.drawing import Drawing, drawing_of
from mbd_sim_ros.analysis.view.ground import Ground
from mbd_sim_ros.analysis.view.motion import RecordedMotion, rotated
from mbd_sim_ros.analysis.view.page import PICTURE, described, run_of
from solver.elements.road import RoadSpec
from solver.scene import Scene

HEAD = ('t', 'number', 'paused', 'speed', 'ax', 'ay', 'yaw_rate', 'steering', 'gas', 'brake', 'hand', 'gear')
SIZE = 2.6  # m of half the height of a picture: a car fills it
MOVED = 4.0  # m after which the road around is told anew
NEAR, FAR = 17, 26  # nodes to every side: a little more than the 12 and 25 that the page draws
LANE = 5.0  # m between the edges that are drawn of a course


class Head(NamedTuple):
    """The numbers before those of bodies and wheels."""

    t: float
    number: int = 0
    paused: float = 0.0
    speed: float = 0.0
    ax: float = 0.0
    ay: float = 0.0
    yaw_rate: float = 0.0
    steering: float = 0.0
    gas: float = 0.0
    brake: float = 0.0
    hand: float = 0.0
    gear: float = 0.0


def picture(head: Head, pose: np.ndarray, contact: np.ndarray, force: np.ndarray) -> bytes:
    """A picture of poses (nb, 7) of the drawing, and of contacts (nw, 3 + 4): place [m] and orientation; force (nw, 3)
    there, in the axes of the contact [N]."""
    world = rotated(contact[:, 3:], force)
    return (
        np.concatenate([head, pose.ravel(), contact[:, :3].ravel(), world.ravel(), force[:, 2]]).astype('<f8').tobytes()
    )


def page_data(
    scene: Scene, title: str, lock: float, ghost: RecordedMotion | None = None
) -> tuple[Drawing, dict[str, Any]]:
    """The drawing of a car, and all that the script of the page is told. lock: of the steering wheel [rad]."""
    spec = scene.model
    drawing, ground = drawing_of(spec), Ground(spec.road)
    told = {
        'name': 'now', 'follows': drawing.bodies.index(spec.chassis), 'names': [wheel.name for wheel in drawing.wheels],
        **described(drawing),
    }  # fmt: skip
    return drawing, {
        'title': title,
        'runs': [told] + ([] if ghost is None else [run_of(ghost, np.zeros(3))]),
        'origin': [0.0, 0.0, 0.0],
        'size': SIZE,
        'ground': {'plane': [float(part) for part in ground.plane]},
        'course': course_of(getattr(scene.maneuver.driver, 'path', None)),
        'lock': lock,
    }


class Around:
    """The road around a place, for pages: heights at whole metres near it, and at whole tens of metres further away."""

    def __init__(self, road: RoadSpec) -> None:
        self._ground = Ground(road)
        self._where = (math.nan, math.nan)
        self._text = ''

    def at(self, x: float, y: float) -> str:
        """The road around x, y [m] as JSON; '' where it is a plane. The same object until the place is another one."""
        if self._ground.flat or math.hypot(x - self._where[0], y - self._where[1]) < MOVED:
            return self._text
        self._where = (x, y)
        squares = []
        for apart, reach in ((1, NEAR), (10, FAR)):
            steps = apart * np.arange(-reach, reach + 1)
            i, j = apart * round(x / apart) + steps, apart * round(y / apart) + steps
            X, Y = np.meshgrid(i.astype(float), j.astype(float), indexing='ij')
            z = np.round(self._ground.at(X, Y), 3).ravel().tolist()
            squares.append({'x': int(i[0]), 'y': int(j[0]), 'apart': apart, 'z': z})
        self._text = json.dumps({'ground': squares})
        return self._text


def filled_page(data: dict[str, Any]) -> str:
    """The page as HTML."""
    return filled('mbd_sim_ros.drive:drive.html', data, **PICTURE)


def course_of(path: Any) -> dict[str, Any]:
    """The way that the driver of a scene follows, for the script: its edges (two lines of [x, y]) and its cones."""
    line = _line_of(path)
    found: dict[str, Any] = {'edges': [], 'cones': []}
    if line is not None:
        closed = bool(np.all(line[0] == line[-1]))
        around = np.concatenate([line[-2:-1] if closed else line[:1], line, line[1:2] if closed else line[-1:]])
        along = around[2:] - around[:-2]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        left = np.column_stack([-along[:, 1], along[:, 0]])
        found['edges'] = [np.round(line + side * left, 3).tolist() for side in (0.5 * LANE, -0.5 * LANE)]
    for gate in getattr(path, 'gates', ()):
        found['cones'] += [
            [x, y] for x in np.linspace(gate.begin, gate.end, 5).tolist() for y in (gate.right, gate.left)
        ]
    return found


def _line_of(path: Any) -> np.ndarray | None:
    """(n, 2) points of a course, about 1 m apart, without the straight ways behind the ends of an open one."""
    kind = getattr(path, 'kind', '')
    if kind == 'course':
        line = path.line if path.closed else path.line[1:-1]
        return np.concatenate([line[:-1:4], line[-1:]])
    if kind == 'circle':
        angle = np.append(np.arange(180) * np.pi / 90.0, 0.0)
        return np.column_stack([path.start + path.radius * np.sin(angle), path.radius * (1.0 - np.cos(angle))])
    if kind == 'waypoints':
        ends: Sequence[float] = [point[0] for point in path.points]
        x = np.arange(ends[0], ends[-1], 1.0)
        return np.column_stack([x, [path.lateral(float(one)) for one in x]])
    return None
