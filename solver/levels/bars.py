"""Anti-roll bars without bodies of their own: a torsion spring over the difference of what the two drop links move.

A bar is a torsion spring between two bodies, each in a bearing (a bushing or a revolute joint) on a common base, each
with a drop link to a suspension arm. The twist of a half is the displacement of the link's outer end along the link,
relative to the base, over its lever; the bending of the bar in its bearings is in series with its torsion. Exact for
small displacements. (With the swing of the arm instead the force would not act where the link does, and the tenth of a
millimetre that the arm's bushing then gives more or less steers the wheel.)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from solver.compiled.portable import product
from solver.elements.bushing import BushingSpec
from solver.elements.coordinate import CoordinateSpec
from solver.elements.coordinate_force import CoordinateForceSpec
from solver.elements.laws import Law
from solver.levels.compliance import RIGID, at_arm, rates, turning
from solver.levels.draft import Draft, Hold, spread, three, unit
from solver.model.frames import frame_of_axis

LINKS = ('spherical', 'universal')


class Half(NamedTuple):
    """One half of a bar: its body, bearing, base, drop link with both joints, arm, and the link's ends."""

    body: str
    bearing: Hold
    base: str
    inner: Hold
    link: str
    outer: Hold
    arm: str
    pin: np.ndarray
    end: np.ndarray


def reduced_bars(draft: Draft) -> None:
    """Take out the bodies of all anti-roll bars."""
    for force in list(draft.sections['coordinate_forces'].values()):
        twist = draft.sections['coordinates'].get(force.terms[0][0]) if len(force.terms) == 1 else None
        if twist is None or twist.kind != 'rotation' or draft.uses(twist.name) != [force.name]:
            continue
        halves = [_half(draft, marker.body, twist.name) for marker in (twist.i, twist.j)]
        plain = (
            force.input is None
            and not force.preload
            and not force.reference
            and force.spring is not None
            and len(force.spring.x) == 1
        )
        if plain and halves[0] is not None and halves[1] is not None and halves[0].base == halves[1].base:
            _take(draft, force, twist, halves[0], halves[1])


def drop_bars(draft: Draft) -> None:
    """Leave out all anti-roll bars: halves, bearings, drop links, springs."""
    for force in [f for f in draft.sections['coordinate_forces'].values() if f.name.startswith('anti_roll_bar')]:
        draft.drop('coordinate_forces', force.name)
        twist = draft.sections['coordinates'].get(force.terms[0][0]) if len(force.terms) == 1 else None
        if twist is None or draft.uses(twist.name):
            continue
        for half in (_half(draft, marker.body, twist.name) for marker in (twist.i, twist.j)):
            if half is not None:
                for hold in (half.inner, half.outer, half.bearing):
                    draft.drop(hold.section, hold.name)
                draft.drop('bodies', half.link)
                draft.drop('bodies', half.body)
        draft.drop('coordinates', twist.name)


def _half(draft: Draft, body: str, twist: str) -> Half | None:
    rest = [h for h in draft.holds(body) if h.name != twist]
    bearings = [
        h for h in rest if h.section == 'bushings' or (h.section == 'joints' and draft.spec(h).kind == 'revolute')
    ]
    links = [h for h in rest if h.section == 'joints' and draft.spec(h).kind in LINKS]
    if len(rest) != 2 or len(bearings) != 1 or len(links) != 1:
        return None
    link = draft.other(links[0]).body
    others = [h for h in draft.holds(link) if h.name != links[0].name] if link in draft.bodies else []
    if len(others) != 1 or others[0].section != 'joints' or draft.spec(others[0]).kind not in LINKS:
        return None
    if all(draft.spec(h).kind == 'universal' for h in (links[0], others[0])):
        return None  # it would turn the arm
    inner, outer = (draft.placed(draft.spec(h).i).p for h in (links[0], others[0]))
    return Half(
        body,
        bearings[0],
        draft.other(bearings[0]).body,
        links[0],
        link,
        others[0],
        draft.other(others[0]).body,
        inner,
        outer,
    )


def _take(draft: Draft, force: CoordinateForceSpec, twist: CoordinateSpec, right: Half, left: Half) -> None:
    centre, R = draft.placed(twist.i)
    axis = R[:, 2]
    assert force.spring is not None
    # a bar of no stiffness is there, and slack
    softness = 1.0 / force.spring.slope[0] if force.spring.slope[0] else math.inf
    terms = []
    for half, sign in ((left, 1.0), (right, -1.0)):
        along = unit(half.end - half.pin)
        # of the bar's twist on the motion along the link [m/rad]
        lever = float(product(np.cross(axis, half.pin - centre), along))
        softness += _bending(draft, half, axis, along) / (lever * lever)
        name = half.link
        F = frame_of_axis(three(along))
        i, j = draft.marker(half.base, half.end, F), draft.marker(half.arm, half.end, F)
        terms.append((name, sign * force.terms[0][1] / lever))
        draft.drop('joints', half.inner.name)
        draft.drop('joints', half.outer.name)
        axes = draft.placed(draft.spec(half.bearing).i).R
        bearing = draft.drop(half.bearing.section, half.bearing.name)
        _carry(draft, half, axis, centre, lever)
        if half.bearing.section == 'bushings':
            _twisted_bearing(draft, half, bearing, axes, axis, along, lever)
        draft.put('coordinates', CoordinateSpec(name=name, kind='translation', i=i, j=j))
    rate = 1.0 / softness
    draft.drop('coordinates', twist.name)
    draft.put('coordinate_forces', force.replace(terms=tuple(terms), spring=Law.linear(rate)))
    draft.lose(f'vibration of {left.body} and {right.body}, and what their bearings damp when they bend')


def _bending(draft: Draft, half: Half, axis: np.ndarray, along: np.ndarray) -> float:
    """Compliance [m/N] of a bearing along the drop link with the bar held from turning."""
    if half.bearing.section != 'bushings':
        return 0.0
    spec = draft.spec(half.bearing)
    at, R = draft.placed(spec.i)
    k = rates(spec)
    about = int(np.argmax([abs(float(product(R[:, q], axis))) for q in range(3)]))
    k[3 + about] = RIGID  # the turn about the axis is the twist itself
    C = at_arm(k, R, half.pin - at)
    return float(product(along, product(C, along)))


def _pivot(draft: Draft, half: Half) -> tuple[np.ndarray, np.ndarray] | None:
    """(point, direction) of the axis about which the arm swings on the base of the bar, if it hangs there in a
    bushing."""
    hanging = [
        draft.spec(h) for h in draft.holds(half.arm) if h.section == 'bushings' and draft.other(h).body == half.base
    ]
    if len(hanging) != 1:
        return None
    p, R = draft.placed(hanging[0].i)
    return p, R[:, int(np.argmin(rates(hanging[0])[3:]))]


def _twisted_bearing(
    draft: Draft, half: Half, bearing: BushingSpec, axes: np.ndarray, axis: np.ndarray, along: np.ndarray, lever: float
) -> None:
    """Let the arm feel the resistance of a bar's bearing against turning, which grows with the square of bar's turn
    over arm's."""
    pivot = _pivot(draft, half)
    if pivot is None:
        draft.lose(f'the resistance of {bearing.name} against turning')
        return
    p, n = pivot
    ratio = float(product(np.cross(n, half.end - p), along)) / lever
    K, C = turning(bearing, axes)
    about = ratio * ratio * n[:, None] * n[None, :]
    draft.resist(
        half.arm, float(product(axis, product(K, axis))) * about, float(product(axis, product(C, axis))) * about
    )


def _carry(draft: Draft, half: Half, axis: np.ndarray, centre: np.ndarray, lever: float) -> None:
    """Let base and arm carry half and link, and remove both: what of the half turns about the axis moves with the end
    of the link."""
    link, bar = draft.bodies[half.link], draft.bodies[half.body]
    draft.add_mass(half.arm, link.mass, draft.com(half.link), draft.inertia(half.link))
    draft.drop('bodies', half.link)
    mass, com, inertia = bar.mass, draft.com(half.body), draft.inertia(half.body)
    about = inertia + spread(mass, com - centre)
    outer = min(float(product(axis, product(about, axis))) / (lever * lever), mass)
    inner = mass - outer
    at = com if inner == 0.0 else (mass * com - outer * half.end) / inner
    rest = inertia - spread(outer, half.end - com) - (spread(inner, at - com) if inner > 0.0 else 0.0)
    draft.drop('bodies', half.body)
    draft.add_mass(half.arm, outer, half.end, np.zeros((3, 3)))
    draft.add_mass(half.base, inner, at, np.zeros((3, 3)))
    draft.add_inertia(half.base, rest, half.body)
