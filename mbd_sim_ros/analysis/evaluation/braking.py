"""Braking: stopping distance on a straight road [ISOStopping2007] and on split friction [ISOSplit1999].

A distance is the integral of the speed from the instant at which the brakes are applied. If they are applied several
times, the application counts that reduces the speed most. The car stands when its speed along its own axis is zero. So
a car that spins, and moves across its own axis, is refused.

Mean fully developed deceleration [BrakingUN2014]:

    (v_b^2 - v_e^2) / (2 (s_e - s_b))   with v_b = 0.8 v_0, v_e = 0.1 v_0, and s_b, s_e the distances at these speeds

The stopping distance is corrected to the nominal speed by the square of the ratio of the speeds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mbd_sim_ros.analysis.evaluation.figures import Chart, Curve, Figure, Result
from mbd_sim_ros.analysis.evaluation.kinds import Drive, Evaluation, speed_of
from mbd_sim_ros.analysis.evaluation.measures import applied, at, crossing, integral
from mbd_sim_ros.analysis.evaluation.signals import UNDER, Signals
from solver.scene import Scene
from solver.units import STANDARD_GRAVITY

NORM = 'ISO 21994:2007 [ISOStopping2007]'
SPLIT = 'ISO 14512:1999 [ISOSplit1999]'
APPLIED = 0.02  # brake command, relative to its largest value, from which on the brakes are applied
RELEASED = 0.5  # time [s] with released brakes after which they count as applied anew; a shorter time is pumping
MOVING = 2.0  # least speed [m/s] at which an application of the brakes counts
ACROSS = math.radians(60.0)  # yaw angle [rad] since the brakes were applied from which on a car spins
BEGIN, END = 0.8, 0.1  # speeds, relative to the initial speed, between which the deceleration is fully developed
SPLIT_BY = 0.1  # least difference of the friction factors under the wheels on a split road
# Deceleration [m/s^2] that a stop on a dry road has at least, for its duration; on other roads in proportion to their
# friction.
LEAST = 0.5 * STANDARD_GRAVITY
# Distance between two samples at the beginning of braking, relative to the stopping distance, from which on a note
# tells of it.
COARSE = 0.02
LONGEST = 120.0  # longest duration of a stop [s], whatever the friction
STRIP = 1.35  # time [s] from the start until the car reaches the slippery strip


@dataclass(frozen=True, kw_only=True)
class Stopping:
    """nominal: speed to which the stopping distance is corrected [m/s]. rest: speed that counts as standing [m/s].
    deviation: largest difference between initial and nominal speed without a note [m/s]."""

    nominal: float = 100.0 / 3.6
    rest: float = 0.05
    deviation: float = 2.0 / 3.6


@dataclass(frozen=True, kw_only=True)
class SplitFriction:
    """rest: speed that counts as standing [m/s]. after: reactions are given so long after the brakes are applied
    [s]."""

    rest: float = 0.05
    after: float = 1.0


def stop(s: Signals, rest: float) -> tuple[float, float, np.ndarray]:
    """(instant of application [s], instant of standing or NaN, distance travelled since application (n,) [m]). Raises
    BagError."""
    brake = np.abs(s['brake'])
    if not brake.max() > 0.0:
        raise s.refuse('the brakes are not applied in the recording')
    t0 = application(s, brake)
    if at(s.t, s['speed'], t0) < MOVING:
        raise s.refuse('the car stands already when the brakes are applied')
    end = crossing(s.t, -s['speed'], -rest, after=t0)
    way = integral(s.t, np.maximum(s['speed'], 0.0))
    return t0, end, way - at(s.t, way, t0)


def keep_ahead(s: Signals, t0: float, end: float) -> None:
    """Raise BagError for a car that spins between t0 and end [s]: the speed along its axis is then not the speed on its
    path."""
    turned = integral(s.t, s['yaw_rate'])
    if np.abs(turned - at(s.t, turned, t0))[s.between(t0, end)].max() > ACROSS:
        raise s.refuse('the car spins in the recording: its wheels lock; brake with less torque')


def application(s: Signals, brake: np.ndarray) -> float:
    """Instant [s] of the application of the brakes that reduces the speed most.

    A note tells of other applications while the car moves, and of brakes that are on in the first sample.
    """
    level = APPLIED * brake.max()
    on = np.flatnonzero(brake >= level)
    first = on[np.diff(s.t[on], prepend=-math.inf) > RELEASED]
    last = on[np.diff(s.t[on], append=math.inf) > RELEASED]
    k = int(np.argmax([s['speed'][a] - s['speed'][a : b + 1].min() for a, b in zip(first, last, strict=True)]))
    begin = int(last[k - 1]) + 1 if k else 0
    t0 = applied(s.t[begin:], brake[begin:], level)
    if t0 == s.t[0]:
        s.notes.append(
            f'the brakes are on in the first sample, at {100.0 * brake[0] / brake.max():.2g} % of their largest value: '
            'the distance counts from there. If a sensor shows that value at rest, a mapping file gives its `offset`'
        )
    times = int(np.sum(s['speed'][first] >= MOVING))
    if times > 1:
        judged = f'judged from t = {t0:.4g} s on, where the speed falls most'
        s.notes.append(f'the brakes are applied {times} times; {judged}')
    return t0


def developed(s: Signals, t0: float, way: np.ndarray, end: float = math.inf) -> float:
    """Mean fully developed deceleration [m/s^2]; NaN if the speed does not fall to END of its initial value until `end`
    [s]."""
    v0 = at(s.t, s['speed'], t0)
    tb, te = (crossing(s.t, -s['speed'], -part * v0, after=t0) for part in (BEGIN, END))
    if not te <= end:
        return math.nan
    return ((BEGIN * v0) ** 2 - (END * v0) ** 2) / (2.0 * (at(s.t, way, te) - at(s.t, way, tb)))


def judge_stopping(s: Signals, p: Stopping) -> Result:
    """Stopping distance, as driven and corrected. Raises BagError."""
    t0, end, way = stop(s, p.rest)
    if math.isnan(end):
        raise s.refuse(
            f'the car does not come to rest in the recording: {s["speed"][-1]:.3g} m/s at its end; it lasts '
            f'{s.t[-1] - s.t[0]:.3g} s, record for longer (mbd maneuver --set duration=...)'
        )
    if 'yaw_rate' in s:
        keep_ahead(s, t0, end)
    v0, distance = at(s.t, s['speed'], t0), at(s.t, way, end)
    notes = list(s.notes)
    if abs(v0 - p.nominal) > p.deviation:
        notes.append(
            f'braked from {3.6 * v0:.4g} km/h; the correction to {3.6 * p.nominal:g} km/h is meant for small '
            'differences'
        )
    between = v0 * s.every('speed')
    if between > COARSE * distance:
        notes.append(
            f'the speed is recorded every {s.every("speed"):.3g} s: braking begins between two samples, and the '
            f'distance is not known better than to {between:.2g} m'
        )
    figures = (
        Figure('initial_speed', 'speed when the brakes are applied', v0, 'm/s'),
        Figure('distance', 'stopping distance as driven', distance, 'm'),
        Figure(
            'corrected_distance',
            f'stopping distance corrected to {3.6 * p.nominal:g} km/h',
            distance * (p.nominal / v0) ** 2,
            'm',
        ),
        Figure('mfdd', 'mean fully developed deceleration', developed(s, t0, way), 'm/s^2'),
        Figure('mean_deceleration', 'mean deceleration over the distance', v0 * v0 / (2.0 * distance), 'm/s^2'),
        Figure('time', 'time to rest', end - t0, 's'),
    )
    shown = s.between(t0 - 0.5, end + 0.5)
    charts = (
        Chart(
            title='speed',
            x=('time', 's'),
            y=('speed', 'm/s'),
            curves=(Curve('speed', s.t[shown] - t0, s['speed'][shown]),),
        ),
        Chart(
            title='speed over distance',
            x=('distance', 'm'),
            y=('speed', 'm/s'),
            curves=(Curve('speed', way[shown], s['speed'][shown]),),
        ),
    )
    return Result(
        evaluation='iso21994',
        title='Stopping distance',
        norm=NORM,
        figures=figures,
        charts=charts,
        notes=tuple(notes),
        source=s.place,
    )


def slippery(s: Signals, t0: float, end: float) -> float:
    """Instant [s] until which the braked car is on split friction: that at which a wheel leaves the low friction, or
    `end`.

    Notes say where a wheel leaves, and where the friction is not split.
    """
    under = {name: s[name] for name in UNDER if name in s}
    if len(under) < len(UNDER):
        s.notes.append(
            'whether the wheels stay on the split friction is not known: the recording has no friction under them'
        )
        return end
    braked = s.between(t0, end)
    low, high = (float(of([of(values[braked]) for values in under.values()])) for of in (np.min, np.max))
    if high - low < SPLIT_BY:
        s.notes.append(f'no split friction: all wheels are on a friction of {low:.3g} to {high:.3g} from the brakes on')
        return end
    slips = {name: values < 0.5 * (low + high) for name, values in under.items()}
    then = int(np.argmax(braked))
    for axle in ('front', 'rear'):
        left, right = (bool(slips[f'friction_{axle}_{side}'][then]) for side in ('left', 'right'))
        if left == right:
            s.notes.append(
                f'both {axle} wheels are on {"low" if left else "high"} friction when the brakes are applied'
            )
    left_at = {
        name: float(s.t[k[0]])
        for name, on in slips.items()
        if (k := 1 + np.flatnonzero(braked[1:] & on[:-1] & ~on[1:])).size
    }
    if not left_at:
        return end
    first = min(left_at, key=lambda name: left_at[name])
    s.notes.append(
        f'judged until t = {left_at[first]:.4g} s, {left_at[first] - t0:.3g} s after the brakes are applied: the '
        f'{first.removeprefix("friction_").replace("_", " ")} wheel leaves the low friction then'
    )
    return left_at[first]


def judge_split(s: Signals, p: SplitFriction) -> Result:
    """Deceleration, yaw and lateral deviation of a car while it brakes on split friction. Raises BagError."""
    t0, end, way = stop(s, p.rest)
    stops = not math.isnan(end)
    stays = end if stops else float(s.t[-1])
    end = slippery(s, t0, stays)
    leaves, standing = end < stays, stops and end == stays
    keep_ahead(s, t0, end)
    if end < t0 + p.after:
        what = 'a wheel leaves the low friction' if leaves else 'it ends'
        raise s.refuse(f'{what} {end - t0:.3g} s after the brakes are applied; {p.after:g} s are needed')
    v0, inside, when = at(s.t, s['speed'], t0), s.between(t0, end), t0 + p.after
    distance = at(s.t, way, end)
    lost = v0 * v0 - at(s.t, s['speed'], end) ** 2
    figures = [
        Figure('initial_speed', 'speed when the brakes are applied', v0, 'm/s'),
        Figure('mean_deceleration', 'mean deceleration over the distance', lost / (2.0 * distance), 'm/s^2'),
        Figure('mfdd', 'mean fully developed deceleration', developed(s, t0, way, end), 'm/s^2'),
        Figure('distance', 'distance travelled' if standing else 'distance travelled (not to rest)', distance, 'm'),
    ]
    heading = s['heading'] if 'heading' in s else integral(s.t, s['yaw_rate'])
    turned = heading - at(s.t, heading, t0)
    seen = [('yaw_rate', 'yaw rate', s['yaw_rate'], 'rad/s'), ('yaw_angle', 'yaw angle', turned, 'rad')]
    if 'x' in s and 'y' in s:
        first = at(s.t, heading, t0)
        aside = -math.sin(first) * (s['x'] - at(s.t, s['x'], t0)) + math.cos(first) * (s['y'] - at(s.t, s['y'], t0))
        seen.append(('deviation', 'lateral deviation', aside, 'm'))
    if 'sideslip_angle' in s:
        fast = s['speed'] > 3.0
        seen.append(('sideslip', 'sideslip angle', np.where(fast, s['sideslip_angle'], 0.0), 'rad'))
    if 'steering' in s:
        seen.append(('steering', 'steering-wheel angle', s['steering'] - at(s.t, s['steering'], t0), 'rad'))
    early = s.between(t0, when)
    for name, text, values, unit in seen:
        then = at(s.t, values, when)
        figures.append(Figure(f'{name}_after', f'{text} {p.after:g} s after the brakes are applied', then, unit))
        figures.append(
            Figure(
                f'{name}_early', f'{text}, largest until then', max(abs(then), float(np.abs(values[early]).max())), unit
            )
        )
        figures.append(Figure(f'{name}_largest', f'{text}, largest', float(np.abs(values[inside]).max()), unit))
    shown = s.between(t0 - 0.5, end + 0.2)
    charts = tuple(
        Chart(title=text, x=('time', 's'), y=(text, unit), curves=(Curve(text, s.t[shown] - t0, values[shown]),))
        for _, text, values, unit in (('speed', 'speed', s['speed'], 'm/s'), *seen)
    )
    return Result(
        evaluation='iso14512',
        title='Braking on split friction',
        norm=SPLIT,
        figures=tuple(figures),
        charts=charts,
        notes=tuple(s.notes),
        source=s.place,
    )


def time_of_stop(scene: Scene) -> dict[str, object]:
    """Overrides of a scene: its duration, long enough for a stop at this speed and friction."""
    return {'duration': round(min(max(9.0, 2.0 + speed_of(scene) / (LEAST * scene.model.road.friction)), LONGEST), 1)}


def strip(scene: Scene) -> dict[str, object]:
    """Overrides of a scene: its slippery strip, from a place before braking to one that the car cannot reach."""
    speed = speed_of(scene)
    begin = STRIP * speed
    length = speed * max(scene.duration - STRIP, 1.0)
    return {
        'road.patches[0].center': [round(begin + 0.5 * length, 2), -2.5],
        'road.patches[0].size': [round(length, 2), 5.0],
    }


STOPPING = Evaluation(
    name='iso21994',
    title='stopping distance, corrected to the nominal speed, and mean fully developed deceleration',
    norm=NORM,
    needs=('speed', 'brake'),
    also=('yaw_rate',),
    parameters=Stopping,
    judge=judge_stopping,
    drive=Drive(
        maneuver='iso21994', speed=100.0 / 3.6, duration=9.0, every=5, brakes=6.0, hardest=True, fitted=time_of_stop
    ),
)
SPLIT_FRICTION = Evaluation(
    name='iso14512',
    title='braking on split friction: deceleration, yaw and lateral deviation',
    norm=SPLIT,
    needs=('speed', 'brake', 'yaw_rate'),
    also=('heading', 'x', 'y', 'sideslip_angle', 'steering', *UNDER),
    parameters=SplitFriction,
    judge=judge_split,
    drive=Drive(
        maneuver='iso14512', speed=80.0 / 3.6, duration=7.0, every=5, road='mu_split', brakes=2.85, fitted=strip
    ),
)
