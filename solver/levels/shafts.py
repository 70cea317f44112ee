"""Shafts without bodies of their own: what only turns with something else lends it its inertia and is gone.

    half shaft      bearing -output- constant velocity -shaft- constant velocity -wheel: the coordinate of the bearing
                    becomes the rotation of the wheel against what carries the bearing
    propeller shaft bearing -pinion- joint -shaft- joint -shaft- free to turn: the pinion has the inertia of all
                    and no play along its axis

Chains are found by what their joints are, not by names.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.compiled.portable import norm, product
from solver.elements.coordinate import CoordinateSpec
from solver.elements.coordinate_force import CoordinateForceSpec
from solver.elements.joint import JointSpec
from solver.levels.draft import Draft, Hold, spread, unit
from solver.model.compile import joint_coordinates
from solver.model.frames import Placement

COUPLINGS = ('constant_velocity', 'universal')
BEARINGS = ('revolute', 'cylindrical')


def reduced_shafts(draft: Draft) -> None:
    """Take out all half shafts and propeller shafts."""
    _half_shafts(draft)
    _free_shafts(draft)


class Bearing(NamedTuple):
    """Bearing of a body that turns: the joint, its end on the body, what carries it, and its frame there."""

    joint: JointSpec
    hold: Hold
    base: str
    frame: Placement


def joints_of(draft: Draft, body: str, kinds: tuple[str, ...]) -> list[Hold]:
    """Ends of joints of some kinds on a body."""
    return [h for h in draft.holds(body) if h.section == 'joints' and draft.spec(h).kind in kinds]


def bearing_of(draft: Draft, body: str, others: int) -> Bearing | None:
    """The bearing of a body that has besides it so many other holds and nothing else."""
    found = joints_of(draft, body, BEARINGS)
    if len(found) != 1 or len(draft.holds(body)) != 1 + others:
        return None
    joint = draft.spec(found[0])
    return Bearing(joint, found[0], draft.other(found[0]).body, draft.placed(joint.i))


def disc(inertia: float, axis: np.ndarray) -> np.ndarray:
    """(3, 3) inertia [kg m^2] of a disc with this moment about its axis, which has half of it across."""
    return inertia * (0.5 * np.eye(3) + 0.5 * axis[:, None] * axis[None, :])


def add_disc(draft: Draft, body: str, axis: np.ndarray, inertia: float) -> None:
    """Let a body carry a disc without mass."""
    draft.set_mass(body, draft.bodies[body].mass, draft.com(body), draft.inertia(body) + disc(inertia, axis))


def without_disc(draft: Draft, body: str, axis: np.ndarray) -> float:
    """Take from a body what turns about an axis, as a disc, and return its inertia [kg m^2]; masses along the axis are
    left."""
    J = draft.inertia(body)
    spin = float(product(axis, product(J, axis)))
    across = np.eye(3) - axis[:, None] * axis[None, :]
    slender = product(product(across, J - disc(spin, axis)), across)
    if float(np.trace(slender)) < 0.0:
        slender = np.zeros((3, 3))
    draft.set_mass(body, draft.bodies[body].mass, draft.com(body), slender)
    return spin


def _aligned(R: np.ndarray, z: np.ndarray) -> np.ndarray:
    """The frame R turned the shortest way so that its z axis is along z: no twist between the two."""
    a = R[:, 2]
    axis = np.cross(a, z)
    s, c = norm(axis), float(product(a, z))
    if s < 1e-12:
        return R
    n = axis / s
    along = n[:, None] * n[None, :]
    skew = np.array([[0.0, -n[2], n[1]], [n[2], 0.0, -n[0]], [-n[1], n[0], 0.0]])
    turn = c * np.eye(3) + (1.0 - c) * along + s * skew
    return product(turn, R)


# -- half shafts -----------------------------------------------------------------------------------------------------


def _half_shafts(draft: Draft) -> None:
    for shaft in list(draft.bodies):
        ends = joints_of(draft, shaft, ('constant_velocity',))
        if len(ends) != 2 or len(draft.holds(shaft)) != 2:
            continue
        for inner, outer in (ends, ends[::-1]):
            output, wheel = draft.other(inner).body, draft.other(outer).body
            bearing = bearing_of(draft, output, 1) if output in draft.bodies else None
            if bearing is not None and wheel in draft.bodies:
                _take_half_shaft(draft, shaft, inner, outer, output, wheel, bearing)
                break


def _take_half_shaft(
    draft: Draft, shaft: str, inner: Hold, outer: Hold, output: str, wheel: str, bearing: Bearing
) -> None:
    start, end = draft.placed(draft.other(inner)).p, draft.placed(draft.other(outer))
    spin = end.R[:, 2] if float(product(end.R[:, 2], bearing.frame.R[:, 2])) > 0.0 else -end.R[:, 2]
    turning = without_disc(draft, output, unit(bearing.frame.R[:, 2])) + without_disc(draft, shaft, unit(end.p - start))
    angle = draft.coordinates_of(bearing.joint.name)[0]
    for name in (bearing.joint.name, inner.name, outer.name):
        draft.drop('joints', name)
    draft.share(shaft, bearing.base, start, wheel, end.p)
    draft.merge(output, bearing.base)
    add_disc(draft, wheel, spin, turning)
    draft.put(
        'coordinates',
        CoordinateSpec(
            name=angle, kind='rotation', i=draft.marker(bearing.base, end.p, bearing.frame.R),
            j=draft.marker(wheel, end.p, _aligned(bearing.frame.R, spin)),
        ),
    )  # fmt: skip
    draft.lose(f'motion of {shaft} and {output} along and across their axes')


# -- propeller shafts ------------------------------------------------------------------------------------------------


def _free_shafts(draft: Draft) -> None:
    for pinion in list(draft.bodies):
        if pinion not in draft.bodies:
            continue
        bearing = bearing_of(draft, pinion, 1)
        links = joints_of(draft, pinion, COUPLINGS)
        if bearing is None or len(links) != 1:
            continue
        chain = _free_chain(draft, pinion, links[0])
        if chain:
            _take_free_shaft(draft, pinion, bearing, chain)


def _free_chain(draft: Draft, pinion: str, link: Hold) -> list[str]:
    """The shafts behind a coupling, one after the other, if nothing else holds the last one from turning."""
    chain: list[str] = []
    last = link
    while True:
        body = draft.other(last).body
        if body not in draft.bodies or body in (*chain, pinion, draft.chassis):
            return []
        chain.append(body)
        rest = [h for h in draft.holds(body) if h.name != last.name]
        couplings = [h for h in rest if h.section == 'joints' and draft.spec(h).kind in COUPLINGS]
        if len(rest) == 1 and couplings:
            last = couplings[0]
            continue
        free = rest and all(
            h.section == 'joints' and draft.spec(h).kind in ('spherical', 'point_on_line') for h in rest
        )
        return chain if free and len(rest) == 2 else []


def _take_free_shaft(draft: Draft, pinion: str, bearing: Bearing, chain: list[str]) -> None:
    axis = bearing.frame.R[:, 2]
    turning = 0.0
    before = pinion
    for shaft in chain:
        joint = next(h for h in draft.holds(shaft) if draft.other(h).body == before)
        at = draft.placed(getattr(draft.spec(joint), joint.field)).p
        rest = [h for h in draft.holds(shaft) if h.name != joint.name]
        ends = [(draft.other(h).body, draft.placed(draft.other(h)).p) for h in rest]
        turning += without_disc(draft, shaft, unit(ends[-1][1] - at))
        draft.drop('joints', joint.name)
        if len(ends) == 2:  # the last one: where it hangs and where it is guided
            for h in rest:
                draft.drop('joints', h.name)
        (near, a), (far, b) = ends if len(ends) == 2 else (ends[0], (pinion, at))
        carried(draft, shaft, near, a, far, b, draft.chassis)
        before = shaft
    angle = draft.coordinates_of(bearing.joint.name)[0]
    draft.drop('joints', bearing.joint.name)
    draft.put('joints', bearing.joint.replace(name=angle, kind='revolute'))
    add_disc(draft, pinion, axis, turning)
    draft.lose(f'non-uniformity and whirl of {", ".join(chain)}')


def carried(draft: Draft, body: str, near: str, a: np.ndarray, far: str, b: np.ndarray, base: str) -> None:
    """Share a body between two supports like its weight, and remove it; base: where what its inertia is less goes."""
    mass, com, inertia = draft.bodies[body].mass, draft.com(body), draft.inertia(body)
    line = b - a
    share = min(max(float(product(com - a, line)) / float(product(line, line)), 0.0), 1.0)
    at = a + share * line
    draft.drop('bodies', body)
    aside = com - at  # what the line does not pass through stays where it is, with both
    draft.add_mass(far, share * mass, b + aside, np.zeros((3, 3)))
    rest = inertia - spread(share * mass, b + aside - com) - spread((1.0 - share) * mass, a + aside - com)
    draft.add_mass(near, (1.0 - share) * mass, a + aside, np.zeros((3, 3)))
    draft.add_inertia(base, rest, body)


# -- torsion of the driveline ----------------------------------------------------------------------------------------


def elastic_drives(draft: Draft) -> list[CoordinateForceSpec]:
    """Final drives through which a propeller shaft turns with outputs elastically."""
    drives = draft.sections['coordinate_forces'].values()
    return [
        drive
        for drive in drives
        if len(drive.terms) == 3 and drive.spring is not None and drive.input is None and _joint(draft, drive)
    ]


def without_torsion(draft: Draft) -> None:
    """Let propeller shafts turn with the mean of their outputs, those on which nothing acts besides: not those of a
    gearbox in front of them, or of a connection with another axle.

    Their inertia over the square of the ratio turns by equal parts with the outputs: exact for equal speeds.
    """
    for drive in elastic_drives(draft):
        joint, angle = _joint(draft, drive), drive.terms[-1][0]
        if joint is not None and draft.uses(angle) == [drive.name]:
            _take_pinion(draft, drive, joint.j.body)


def _joint(draft: Draft, drive: CoordinateForceSpec) -> JointSpec | None:
    """The bearing of what the last term of a final drive turns, of a pinion."""
    angle = drive.terms[-1][0]
    return next((j for j in draft.sections['joints'].values() if angle in draft.coordinates_of(j.name)), None)


def _take_pinion(draft: Draft, drive: CoordinateForceSpec, pinion: str) -> None:
    _free_shafts(draft)
    *outputs, (angle, share) = drive.terms
    joint = next(j for j in draft.sections['joints'].values() if angle in draft.coordinates_of(j.name))
    axis = draft.placed(joint.i).R[:, 2]
    turning = without_disc(draft, pinion, axis) / (share * share)
    draft.drop('coordinate_forces', drive.name)
    draft.drop('joints', joint.name)
    draft.merge(pinion, joint.i.body)
    total = sum(abs(factor) for _, factor in outputs)
    for name, factor in outputs:
        coordinate = next(
            (c for j in draft.sections['joints'].values() for c in joint_coordinates(j) if c.name == name), None
        )
        coordinate = coordinate or draft.sections['coordinates'][name]
        # half of the inertia of the mean: at equal speeds the same energy
        add_disc(draft, coordinate.j.body, draft.placed(coordinate.j).R[:, 2], turning * abs(factor) * total)
