"""A recording in motion as one web page that needs nothing else: bodies to turn around, a slider of time, curves
below."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.analysis import pages, runs
from mbd_sim_ros.analysis.pages import Page, floats, thinned
from mbd_sim_ros.analysis.provenance import facts_of_runs
from mbd_sim_ros.analysis.runs import units
from mbd_sim_ros.analysis.view.drawing import WORLD_BODY, Drawing
from mbd_sim_ros.analysis.view.motion import RecordedMotion, curves_of
from solver.analysis.verdict import OK

POINTS = 1000  # of a curve, about
SMALLEST = 1e-3  # m: half of what is seen of a mechanism at least
METRES = 10  # of ground to every side of a car
STEPS = 8000  # whole numbers to either side of the middle of a column; 32000 would make pages half as large again
MISSING = -32768  # stands for no number
HOME = 'mbd_sim_ros.analysis.view'
PICTURE = {
    'THREE': 'mbd_sim_ros.analysis.third_party.three:three.min.js',
    'SCENE': f'{HOME}:scene.js',
}  # parts of a page that draws what moves


def write_page(motions: list[RecordedMotion], file: Path, channels: tuple[str, ...] = ()) -> None:
    """Write the page of one recording, or of several: the first is solid, the others are ghosts. Raises BagError."""
    first = motions[0]
    unit = units(*(motion.run for motion in motions))
    origins = [np.zeros(3) if first.follows == WORLD_BODY else first.pose[0, first.follows, :3]] * len(motions)
    motion = {
        'kind': 'motion',
        'runs': [_run(one, origin) for one, origin in zip(motions, origins, strict=True)],
        'origin': _numbers(origins[0] if first.follows != WORLD_BODY else np.zeros(3)),
        'size': size_of(first),
        'ground': _ground(first, origins[0]),
    }
    drawn = [_chart(name, unit(name), motions) for name in curves_of(first, channels)]
    status = first.run.metadata.get('status', '')
    said = f'verdict: {status}' if status else ''
    Page(
        title=' and '.join(one.name for one in motions),
        verdict=said,
        ok=status == OK if status else None,
        about=[note for one in motions for note in runs.suspicion(one.run)],
        facts=facts_of_runs([one.run for one in motions], [one.name for one in motions]),
        blocks=[motion, pages.charts(drawn)],
        scripts=[PICTURE['SCENE'], f'{HOME}:view.js'],
        programs={'THREE': PICTURE['THREE']},
    ).write(file)


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


def _run(motion: RecordedMotion, origin: np.ndarray) -> dict[str, Any]:
    """A recording for the script: places from that of the body in the middle, whose own are `base`."""
    n = len(motion.time)
    base = np.zeros((n, 3)) if motion.follows == WORLD_BODY else motion.pose[:, motion.follows, :3] - origin
    pose = motion.pose.copy()
    pose[..., :3] -= (origin + base)[:, None]
    contact = motion.contact - (origin + base)[:, None]
    columns = [pose.reshape(n, -1), contact.reshape(n, -1), motion.force.reshape(n, -1)]
    return {
        'name': motion.name,
        'follows': motion.follows,
        'time': floats(motion.time - motion.time[0]),
        'start': float(motion.time[0]),
        'base': floats(base),
        'packed': packed(np.hstack(columns)),
        **described(motion.drawing),
    }


def run_of(motion: RecordedMotion, origin: np.ndarray) -> dict[str, Any]:
    """A recording for the script of a page that is driven, all places from an origin (3,) [m]."""
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


def packed(values: np.ndarray) -> dict[str, Any]:
    """Numbers (n, m) in few characters: each column as whole numbers of 16 bits between its ends, which is a part in
    16000 of its range; second differences of these, which are small where motion is smooth; deflated. unpacked() in
    view.js is the inverse."""
    n, m = values.shape
    known = np.isfinite(values)
    low = np.where(known, values, np.inf).min(axis=0, initial=np.inf)
    high = np.where(known, values, -np.inf).max(axis=0, initial=-np.inf)
    low, high = (np.where(np.isfinite(end), end, 0.0) for end in (low, high))
    offset, scale = 0.5 * (low + high), 0.5 * (high - low) / STEPS
    shares = (np.where(known, values, offset) - offset) / np.where(scale > 0.0, scale, 1.0)
    whole = np.where(known, np.rint(shares), MISSING).astype(np.int16)
    for _ in range(2):  # sums over 16 bits, as the differences are, wrap around and back
        whole[1:] -= whole[:-1].copy()
    data = whole.T.astype('>i2').tobytes()
    planes = data[::2] + data[1::2]
    return {
        'rows': n,
        'columns': m,
        'offset': floats(offset),
        'scale': floats(scale),
        'data': pages.deflated(planes),
    }


def _chart(name: str, unit: str, motions: list[RecordedMotion]) -> pages.Block:
    """A channel of every recording that has it, thinned to the extremes of every stretch."""
    curves = []
    start = min(motion.time[0] for motion in motions)  # stamps are counted from it, for they have 32 bits
    for k, motion in enumerate(motions):
        if name not in motion.run.columns:
            continue
        topic = next(one for one in motion.run.series.values() if name in one.columns)
        time, value = topic.time_ns * 1e-9 - start, topic.columns[name]
        keep = thinned(POINTS, value)
        colour = 1 if len(motions) == 1 else (1, 3, 4, 2)[k % 4]
        own = motion.name if len(motions) > 1 else ''
        curves.append(pages.curve(own, time[keep], value[keep], colour=colour, start=float(start)))
    label = name.rpartition('/')[2] + (f' [{unit}]' if unit not in ('', '1') else '')
    return pages.chart(name, 'time [s]', label, curves, linked='time', seeks=True)


def _numbers(values: np.ndarray) -> list[float]:
    return [float(value) for value in values]
