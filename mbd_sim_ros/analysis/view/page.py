"""A recording in motion as one web page that needs nothing else: bodies to turn around, a slider of time, curves
beside."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.analysis.pages import fill, floats, thinned
from mbd_sim_ros.analysis.runs import units
from mbd_sim_ros.analysis.view.drawing import WORLD_BODY, Drawing
from mbd_sim_ros.analysis.view.motion import RecordedMotion, curves_of

POINTS = 1500  # of a curve, about
SMALLEST = 1e-3  # m: half of what is seen of a mechanism at least
METRES = 10  # of ground to every side of a car
HOME = 'mbd_sim_ros.analysis.view'
PICTURE = {'THREE': f'{HOME}:three.min.js', 'SCENE': f'{HOME}:scene.js'}  # parts of a page that draws what moves


def write_page(motions: list[RecordedMotion], file: Path, channels: tuple[str, ...] = ()) -> None:
    """Write the page of one recording, or of several: the first is solid, the others are ghosts. Raises BagError."""
    first = motions[0]
    unit = units(*(motion.run for motion in motions))
    origins = [np.zeros(3) if first.follows == WORLD_BODY else first.pose[0, first.follows, :3]] * len(motions)
    data = {
        'title': ' and '.join(motion.name for motion in motions),
        'runs': [run_of(motion, origin) for motion, origin in zip(motions, origins, strict=True)],
        'origin': _numbers(origins[0] if first.follows != WORLD_BODY else np.zeros(3)),
        'curves': [_curve(name, unit(name), motions) for name in curves_of(first, channels)],
        'size': size_of(first),
        'ground': _ground(first, origins[0]),
    }
    fill(file, f'{HOME}:view.html', data, **PICTURE)


def _ground(motion: RecordedMotion, origin: np.ndarray) -> dict[str, Any] | None:
    """The road under what drives: its base plane, in the world, and the points at whole metres along the way, from
    `origin`, where it is not that plane."""
    if motion.follows == WORLD_BODY:
        return None
    x, y = motion.pose[:, motion.follows, :2].T
    nodes = np.zeros((0, 3)) if motion.ground.flat else motion.ground.along(x, y, METRES + 2)
    height = nodes[:, 2] - origin[2]
    return {
        'plane': [float(part) for part in motion.ground.plane],
        'x': floats(nodes[:, 0]),
        'y': floats(nodes[:, 1]),
        'z': floats(height),
    }


def size_of(motion: RecordedMotion) -> float:
    """Half the height of what the camera sees [m]: the vehicle, or all the places where a mechanism comes."""
    if motion.follows != WORLD_BODY:
        at = motion.pose[0, [wheel.body for wheel in motion.drawing.wheels], :3]
        # the car is in the middle, a trailer is not
        behind = np.linalg.norm(at - motion.pose[0, motion.follows, :3], axis=1).max()
        return float(max(0.9 * np.ptp(at, axis=0).max(), 1.2 * behind))
    reach = [np.abs(motion.pose[:, :, :3]).max(initial=SMALLEST)]
    ends = [(line.body, end) for line in motion.drawing.lines for end in (line.a, line.b)]
    ends += [end for spring in motion.drawing.springs for end in ((spring.i, spring.a), (spring.j, spring.b))]
    reach += [np.abs(motion.point(k, *end)).max() for k in range(0, len(motion.time), 10) for end in ends]
    return 1.15 * float(max(reach))


def run_of(motion: RecordedMotion, origin: np.ndarray) -> dict[str, Any]:
    """A recording for the script, all places from an origin (3,) [m]."""
    pose = motion.pose.copy()
    pose[..., :3] -= origin
    return {
        'name': motion.name,
        'follows': motion.follows,
        'time': floats(motion.time),
        'pose': floats(pose),
        'contact': floats(motion.contact - origin),
        'force': floats(motion.force),
        **described(motion.drawing),
    }


def described(drawing: Drawing) -> dict[str, Any]:
    """A drawing for the script (scene.js)."""
    return {
        'bodies': len(drawing.bodies),
        'lines': [[line.body, *line.a, *line.b, line.kind] for line in drawing.lines],
        'springs': [[s.i, *s.a, s.j, *s.b] for s in drawing.springs],
        'wheels': [[w.body, *w.center, *w.axis, w.radius, w.width] for w in drawing.wheels],
    }


def _curve(name: str, unit: str, motions: list[RecordedMotion]) -> dict[str, Any]:
    """A channel of every recording that has it, thinned to the extremes of every stretch."""
    lines = []
    for motion in motions:
        if name not in motion.run.columns:
            lines.append({'time': '', 'value': ''})
            continue
        topic = next(one for one in motion.run.series.values() if name in one.columns)
        time, value = topic.time_ns * 1e-9, topic.columns[name]
        keep = thinned(POINTS, value)
        lines.append({'time': floats(time[keep]), 'value': floats(value[keep])})
    return {'name': name, 'unit': unit, 'lines': lines}


def _numbers(values: np.ndarray) -> list[float]:
    return [float(value) for value in values]
