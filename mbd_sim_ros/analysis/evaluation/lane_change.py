"""Lane changes [ISO3888]: part 1, double lane change, and part 2, obstacle avoidance: speeds and contact with the
cones.

The lanes follow from the width of the vehicle (solver.inputs.driver.DoubleLaneChange). The body is a rectangle on the
road. The distance to the cones of a lane is the least of: corners of the body to the rows of cones, while they are
between its first and last cone; and the first and last cones to the sides of the body, while these pass. A negative one
means that a cone is hit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mbd_sim_ros.analysis.evaluation.figures import Chart, Curve, Figure, Result
from mbd_sim_ros.analysis.evaluation.kinds import Drive, Evaluation, speed_of
from mbd_sim_ros.analysis.evaluation.measures import at, crossing
from mbd_sim_ros.analysis.evaluation.signals import GIVEN, Signals
from solver.inputs.driver import DoubleLaneChange, Gate
from solver.scene import Scene

NORM = 'ISO 3888 [ISO3888]'
PLACE = ('x', 'y', 'heading')
FINE = 1e-3  # s between two places of the body that are looked at
WELL_KNOWN = 0.01  # m: distances to cones known less well are told
RELEASED = 2.0  # m behind the first cones the throttle is released, in part 2
# times the time that the track takes at the speed of the start: the second car rolls out
SPARE = {'iso_3888_1': 1.21, 'iso_3888_2': 1.29}


@dataclass(frozen=True, kw_only=True)
class LaneChange:
    """width, length: of the body without mirrors [m]; width and start none: as the driver of the scene has them.
    middle: of the body ahead of base_link [m]. start: x of the first cones [m]; the centre line of the first lane is y
    = 0."""

    width: float | None = None
    length: float = 4.6
    middle: float = 0.0
    start: float | None = None


def distances(gate: Gate, x: np.ndarray, y: np.ndarray, heading: np.ndarray, p: LaneChange, width: float) -> float:
    """Least distance [m] of the body to the cones of a lane over all samples; NaN if it is never in the lane."""
    c, s = np.cos(heading), np.sin(heading)
    found = []
    ends = (p.middle - 0.5 * p.length, p.middle + 0.5 * p.length)
    for along in ends:
        for side in (-0.5 * width, 0.5 * width):
            X, Y = x + along * c - side * s, y + along * s + side * c
            inside = (gate.begin <= X) & (gate.end >= X)
            if not inside.any():
                return math.nan
            found.append(float(np.minimum(gate.left - Y, Y - gate.right)[inside].min()))
    for cone_x in (gate.begin, gate.end):
        for cone_y, way in ((gate.left, 1.0), (gate.right, -1.0)):
            dx, dy = cone_x - x, cone_y - y
            forward, left = c * dx + s * dy, c * dy - s * dx
            beside = (forward >= ends[0]) & (forward <= ends[1])
            if beside.any():
                found.append(float((way * left - 0.5 * width)[beside].min()))
    return min(found)


def path_of(s: Signals, kept: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, y and heading, straight between the samples kept: a corner passes the ends of a lane between two of them."""
    t = np.arange(s.t[0], s.t[-1], FINE)
    x, y, heading = (s[name][kept] for name in PLACE)
    return tuple(np.interp(t, s.t[kept], values) for values in (x, y, np.unwrap(heading)))  # type: ignore[return-value]


def clearances(s: Signals, gates: tuple[Gate, ...], p: LaneChange, width: float) -> tuple[list[float], float]:
    """(distance to the cones of every lane [m], how well these are known: by how much they change where every second of
    the places recorded is left out)."""
    apart = min(round(s.every(*PLACE) * s.rate), s.t.size // 2)
    parts = [slice(None), slice(0, None, 2 * apart), slice(apart, None, 2 * apart)]
    whole, *halves = (np.array([distances(gate, *path_of(s, kept), p, width) for gate in gates]) for kept in parts)
    return whole.tolist(), float(np.nanmax([np.abs(whole - half) for half in halves], initial=0.0))


def judge(s: Signals, p: LaneChange, standard: str) -> Result:
    """Speeds at entry and exit and distance to the cones. Raises BagError."""
    driver = s.vehicle.scene.maneuver.driver if s.vehicle.scene is not None else None
    path = (
        driver.path
        if driver is not None and isinstance(driver.path, DoubleLaneChange) and driver.path.standard == standard
        else None
    )
    width = p.width if p.width is not None else (path.width if path else None)
    start = p.start if p.start is not None else (path.start if path else None)
    if width is None or start is None:
        missing = 'width' if width is None else 'start'
        raise s.refuse(
            f'the track is not known: no driver of a scene in it follows it (no {missing}); give width=... start=... '
            f'({GIVEN})'
        )
    gates = DoubleLaneChange(standard=standard, width=width, start=start).gates  # type: ignore[arg-type]
    x, y, heading, t = s['x'], s['y'], s['heading'], s.t
    if x.max() < gates[-1].end or x.min() > gates[0].begin:
        raise s.refuse(
            f'does not pass the track: x from {x.min():.4g} to {x.max():.4g} m, the track from {gates[0].begin:g} to '
            f'{gates[-1].end:g} m; '
            f'it lasts {t[-1] - t[0]:.3g} s, a slow car takes longer (mbd maneuver --set duration=...)'
        )
    entry, leave = crossing(t, x, gates[0].begin), crossing(t, x, gates[-1].end)
    figures = [
        Figure('entry_speed', 'speed at entry', at(t, s['speed'], entry), 'm/s'),
        Figure('exit_speed', 'speed at exit', at(t, s['speed'], leave), 'm/s'),
        Figure('time', 'time in the track', leave - entry, 's'),
    ]
    found, known = clearances(s, gates, p, width)
    for k, distance in enumerate(found, 1):
        figures.append(
            Figure(
                f'clearance_{k}', f'distance to the cones of lane {k}', distance, 'm', '>= 0 m', bool(distance >= 0.0)
            )
        )
    if known > WELL_KNOWN:
        s.notes.append(
            f'places are recorded every {s.every(*PLACE):.3g} s: distances to the cones are not known better than to '
            f'{known:.2g} m'
        )
    inside = s.between(entry, leave)
    figures += [
        Figure(
            'largest_acceleration',
            'largest lateral acceleration',
            float(np.abs(s['lateral_acceleration'][inside]).max()),
            'm/s^2',
        ),
        Figure('largest_yaw_rate', 'largest yaw rate', float(np.abs(s['yaw_rate'][inside]).max()), 'rad/s'),
    ]
    figures += [
        Figure(name, text, float(np.abs(s[key][inside]).max()), unit)
        for name, text, key, unit in (
            ('largest_steering', 'largest steering-wheel angle', 'steering', 'rad'),
            ('largest_sideslip', 'largest sideslip angle', 'sideslip_angle', 'rad'),
            ('largest_roll', 'largest roll angle', 'roll', 'rad'),
        )
        if key in s
    ]
    rows = [
        Curve('cones' if k == 0 else '', np.array([g.begin, g.end]), np.full(2, edge), 'limit')
        for k, (g, edge) in enumerate((g, e) for g in gates for e in (g.left, g.right))
    ]
    ahead = p.middle + 0.5 * p.length
    sides = [
        Curve(
            'front corners' if k == 0 else '',
            x + ahead * np.cos(heading) - side * np.sin(heading),
            y + ahead * np.sin(heading) + side * np.cos(heading),
            'other',
        )
        for k, side in enumerate((-0.5 * width, 0.5 * width))
    ]
    near = (x > gates[0].begin - 10.0) & (x < gates[-1].end + 10.0)
    sides = [c._replace(x=c.x[near], y=c.y[near]) for c in sides]
    charts = [
        Chart(title='path', x=('x', 'm'), y=('y', 'm'), curves=(Curve('base_link', x[near], y[near]), *sides, *rows)),
        Chart(
            title='lateral acceleration',
            x=('time', 's'),
            y=('lateral acceleration', 'm/s^2'),
            curves=(Curve('car', t - entry, s['lateral_acceleration']),),
        ),
    ]
    if 'steering' in s:
        charts.append(
            Chart(
                title='steering',
                x=('time', 's'),
                y=('steering-wheel angle', 'rad'),
                curves=(Curve('steering wheel', t - entry, s['steering']),),
            )
        )
    part = standard[-1]
    return Result(
        evaluation=f'iso3888_{part}', title=('Double lane '
            'change') if part == '1' else 'Obstacle avoidance', norm=f'{NORM}, part {part}',
        figures=tuple(figures), charts=tuple(charts), notes=tuple(s.notes), source=s.place,
    )  # fmt: skip


def _fitted(scene: Scene, duration: float) -> dict[str, object]:
    """As long as the track takes; in part 2 the throttle is released at its place."""
    path = scene.maneuver.driver.path if scene.maneuver.driver is not None else None
    if not isinstance(path, DoubleLaneChange):
        return {}
    speed = speed_of(scene)
    settings: dict[str, object] = {
        'duration': round(max(duration, SPARE[path.standard] * path.gates[-1].end / speed), 1)
    }
    if path.standard == 'iso_3888_2':
        settings['maneuver.speed.until'] = round((path.start + RELEASED) / speed, 3)
    return settings


def _evaluation(part: int, title: str, speed: float, duration: float) -> Evaluation:
    return Evaluation(
        name=f'iso3888_{part}',
        title=title,
        norm=f'{NORM}, part {part}',
        needs=('x', 'y', 'heading', 'speed', 'yaw_rate', 'lateral_acceleration'),
        also=('steering', 'sideslip_angle', 'roll'),
        parameters=LaneChange,
        judge=lambda s, p: judge(s, p, f'iso_3888_{part}'),
        drive=Drive(
            maneuver=f'iso3888_{part}',
            speed=speed / 3.6,
            duration=duration,
            every=5,
            driver=True,
            cones=True,
            fitted=lambda scene: _fitted(scene, duration),
        ),
    )


DOUBLE = _evaluation(1, 'double lane change: speeds, distance to the cones', 80.0, 8.5)
AVOIDANCE = _evaluation(2, 'obstacle avoidance: speeds, distance to the cones', 50.0, 8.0)
