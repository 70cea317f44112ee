"""Coil-overs without bodies of their own: spring and damper act between what the tube stands on and what the rod hangs
in.

A strut is two bodies that slide in each other, each with one more connection, and springs and a damper between the same
two points of them. If rubber holds an end, spring and damper are in a row with it (solver.elements.strut); where both
ends hang in rubber, the two bushings are in series along the line. The body on the lower bushing turns against the
strut, which hardly turns itself: the bushing's resistance against that goes to what the body hangs in.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.compiled.portable import norm, product
from solver.elements.bushing import BushingSpec
from solver.elements.laws import Law
from solver.elements.spring_damper import SpringDamperSpec
from solver.elements.strut import StrutSpec
from solver.levels.compliance import at_arm, in_series, increasing, rates, turning
from solver.levels.draft import Draft, Hold, spread, unit

HINGES = ('spherical', 'universal', 'revolute')
ALONG = 0.99  # cosine between an axis of a mount and the strut, from which the axis is the strut's
NEAR = 1e-9  # m


class End(NamedTuple):
    """One half of a strut: its body, what connects it, and to which body, where."""

    body: str
    hold: Hold
    base: str
    p: np.ndarray


def reduced_struts(draft: Draft) -> None:
    """Take out the bodies of all struts."""
    for slide in list(draft.sections['joints'].values()):
        if slide.kind == 'prismatic' and not draft.uses(slide.name):
            ends = [_end(draft, body, slide.name) for body in (slide.i.body, slide.j.body)]
            if ends[0] is not None and ends[1] is not None:
                _take(draft, slide.name, ends[0], ends[1])


def _end(draft: Draft, body: str, slide: str) -> End | None:
    """A half of a strut, if nothing else than springs and dampers is on it besides one connection."""
    if body not in draft.bodies or body == draft.chassis:
        return None
    rest = [h for h in draft.holds(body) if h.name != slide and h.section != 'spring_dampers']
    fits = len(rest) == 1 and (
        rest[0].section == 'bushings' or (rest[0].section == 'joints' and draft.spec(rest[0]).kind in HINGES)
    )
    return End(body, rest[0], draft.other(rest[0]).body, draft.placed(draft.other(rest[0])).p) if fits else None


def _take(draft: Draft, slide: str, one: End, two: End) -> None:
    elastic = [end for end in (one, two) if end.hold.section == 'bushings']
    if elastic and min(elastic, key=lambda end: float(rates(draft.spec(end.hold))[:3].min())) is one:
        one, two = two, one  # the rod, two, hangs in the softer end
    elements = {
        h.name: draft.spec(h) for end in (one, two) for h in draft.holds(end.body) if h.section == 'spring_dampers'
    }
    if not elements or all(
        end.hold.section == 'joints' and draft.spec(end.hold).kind != 'spherical' for end in (one, two)
    ):
        return  # a telescope that turns what it holds, like that of a steering column
    line = unit(two.p - one.p)
    if elastic:
        strut = _strut(draft, list(elements.values()), one, two, line)
        if strut is None:
            return
        for name in elements:
            draft.drop('spring_dampers', name)
        draft.put('struts', strut)
    else:
        for end in (one, two):
            for h in draft.holds(end.body):
                if h.section == 'spring_dampers':
                    draft.move(h, end.base)
    eye = draft.spec(one.hold)
    eye_axes = draft.placed(eye.i).R
    draft.drop('joints', slide)
    for end in (one, two):
        draft.drop(end.hold.section, end.hold.name)
    for end in (one, two):
        mass, com, inertia = draft.bodies[end.body].mass, draft.com(end.body), draft.inertia(end.body)
        share = float(product(com - one.p, line)) / norm(two.p - one.p)
        draft.drop('bodies', end.body)
        rest = inertia - spread((1.0 - share) * mass, one.p - com) - spread(share * mass, two.p - com)
        draft.add_mass(one.base, (1.0 - share) * mass, one.p, np.zeros((3, 3)))
        draft.add_mass(two.base, share * mass, two.p, np.zeros((3, 3)))
        draft.add_inertia(two.base, rest, end.body)
    if one.hold.section == 'bushings' and not draft.resist(one.base, *turning(eye, eye_axes)):
        draft.lose(f'the resistance of {eye.name} against turning')
    draft.lose(f'motion of {one.body} and {two.body} by themselves')


def _strut(draft: Draft, elements: list[SpringDamperSpec], one: End, two: End, line: np.ndarray) -> StrutSpec | None:
    """The element that stands for springs, damper and bushings; None where they are not of that kind."""
    dampers = [e for e in elements if e.damper is not None]
    springs = [e for e in elements if e.damper is None]
    if len(dampers) != 1 or len(springs) > 1 or any(e.preload for e in elements):
        return None
    ends = [sorted((marker.body, tuple(draft.placed(marker).p)) for marker in (e.i, e.j)) for e in elements]
    if any(norm(np.subtract(p, q)) > NEAR for other in ends[1:] for (_, p), (_, q) in zip(ends[0], other, strict=True)):
        return None
    damper = dampers[0]
    spring = None
    if springs and springs[0].spring is not None:
        shift = springs[0].free_length - damper.free_length
        law = springs[0].spring
        spring = Law(tuple(x + shift for x in law.x), law.y, law.slope)
    rows = [_along(draft, end, line) for end in (one, two) if end.hold.section == 'bushings']
    found = [row for row in rows if row is not None]
    if len(found) != len(rows):
        return None
    total = 1.0 / sum(1.0 / rate for _, rate, _ in found)
    # a force f moves the parts by f / rate each: what they dissipate together
    damping = total * total * sum(c / (rate * rate) for _, rate, c in found)
    bases = {end.body: end.base for end in (one, two)}
    i, j = (draft.marker(bases[marker.body], draft.placed(marker).p) for marker in (damper.i, damper.j))
    return StrutSpec(
        name=damper.name, i=i, j=j, free_length=damper.free_length, spring=spring, stops=damper.spring,
        damper=damper.damper,
        mount=in_series([(law, 1.0) for law, _, _ in found]), mount_damping=damping,
    )  # fmt: skip


def _along(draft: Draft, end: End, line: np.ndarray) -> tuple[Law, float, float] | None:
    """(law of the extension along the strut, its slope at rest [N/m], damping [N s/m]) of a bushing at an end."""
    spec: BushingSpec = draft.spec(end.hold)
    R = draft.placed(spec.i).R
    k = rates(spec)
    cosines = [float(product(R[:, q], line)) for q in range(3)]
    rate = 1.0 / float(product(line, product(at_arm(k, R, np.zeros(3)), line)))
    damping = float(np.median(np.array(spec.damping)[:3] / k[:3])) * rate
    axis = int(np.argmax(np.abs(cosines)))
    law = spec.laws[axis]
    if law is None and not any(spec.laws[:3]):
        return (Law.linear(rate), rate, damping) if damping > 0.0 else None
    if law is None or abs(cosines[axis]) < ALONG or not increasing(law) or not damping > 0.0:
        return None
    # under tension the half moves away from its base, to where its centre of mass is: against the axis of the bushing
    # or along it
    outward = (
        float(product(draft.com(end.body) - end.p, line)) * cosines[axis] * (1.0 if spec.j.body == end.body else -1.0)
    )
    return (law if outward > 0.0 else _mirrored(law)), rate, damping


def _mirrored(law: Law) -> Law:
    return Law(tuple(-x for x in reversed(law.x)), tuple(-y for y in reversed(law.y)), tuple(reversed(law.slope)))
