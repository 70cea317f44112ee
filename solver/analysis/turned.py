"""Bodies without inertia that forces turn: a spring off the centre of mass of a point mass, or beside the axis of a
thin rod.

Such a rotation has no equation of motion: it follows from the forces alone while they hold it, as a line under tension
does, and is infinitely fast where they do not (a spring that goes slack, or is pressed). No step resolves that.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from solver.checks.registry import BY_NAME
from solver.checks.resolution import PARTS
from solver.compiled.portable import norm
from solver.elements.marker import Marker
from solver.elements.rigid_body import RigidBodySpec
from solver.findings import Finding
from solver.model.spec import ModelSpec

PULLING = ('spring_dampers', 'applied_forces')  # elements that act at points and resist no rotation by themselves
NOTHING = 1e-9  # of the largest moment of inertia; or of the arm: what sixteen digits leave of zero


def caused(spec: ModelSpec, found: list[Finding]) -> list[Finding]:
    """The findings of a run; those of rotations that shorter steps do not mend name what turns a body without inertia
    instead."""
    if not any(_of_rotation(finding) for finding in found):
        return found
    causes = turned(spec)
    told = []
    for finding in found:
        why = [text for body, text in causes.items() if not finding.where or f'body {body!r}' in finding.where]
        if why and _of_rotation(finding):
            finding = dataclasses.replace(finding, text=f'{finding.fact}. {"; ".join(why)}')
        told.append(finding)
    return told


def _of_rotation(finding: Finding) -> bool:
    """True where a rotation that is too fast for a step may be the cause of a finding."""
    return BY_NAME[finding.quantity].turned and finding.of != PARTS[0]


def turned(spec: ModelSpec) -> dict[str, str]:
    """By body that is turned about an axis without inertia: what turns it and what to do, as a sentence."""
    found = {}
    for body in spec.bodies:
        axes = _without_inertia(body)
        if not body.mass > 0.0 or not axes.any() or _held(spec, body.name):
            continue
        for name, arm in _pulls(spec, body):
            # the torque arm x force has no part along the axes for any force only where the arm is along all of them
            lever = float(norm(np.cross(axes, arm).ravel()))
            if lever > NOTHING * (1.0 + float(norm(arm))):
                what = 'no inertia' if not any(body.inertia) else 'no inertia about that axis'
                found[body.name] = (
                    f'{name} pulls at body {body.name!r} {float(norm(arm)):.3g} m off its centre of mass and turns '
                    f'it, and the body has {what}: give it an inertia, or attach {name} at its centre of mass'
                )
                break
    return found


def _without_inertia(body: RigidBodySpec) -> np.ndarray:
    """(n, 3) unit vectors of the axes through the centre of mass about which a body has no moment of inertia, in its
    axes."""
    moments, axes = np.linalg.eigh(body.inertia_matrix())
    return axes.T[moments <= NOTHING * moments[-1]]


def _held(spec: ModelSpec, name: str) -> bool:
    """True where something other than forces at points is at the body: a joint, a bushing, a coordinate with an
    element."""
    for section, elements in spec.sections().items():
        if section == 'bodies' or section in PULLING:
            continue
        for element in elements:
            if any((isinstance(v, Marker) and v.body == name) or v == name for v in vars(element).values()):
                return True
    return False


def _pulls(spec: ModelSpec, body: RigidBodySpec) -> Iterator[tuple[str, np.ndarray]]:
    """(name of an element that pulls at a body, from the centre of mass to where it does [m], in the axes of the
    body)."""
    for section in PULLING:
        for element in spec.sections()[section]:
            for value in vars(element).values():
                if isinstance(value, Marker) and value.body == body.name:
                    yield f'{section[:-1]} {element.name!r}', np.subtract(value.position, body.com)
