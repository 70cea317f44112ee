"""Rotations without inertia that nothing acts on: those of point masses, and of thin rods about themselves.

A body without moment of inertia about an axis that feels no moment about it either has any rotation about it. It stands
still there: it gets a moment of inertia, which changes no other motion. With one more moment j about the axis d,
Euler's equation along d is j dw_d/dt = 0, so w_d, zero at the start, stays zero; and with it j appears nowhere else,
neither in a gyroscopic torque nor in the energy.

Forces at points alone have no moment about the line through all of these points: about any axis through the centre of
mass where they all act there (a point mass), about the line where it passes through the centre of mass (a thin rod) or
where the body has no mass.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from solver.compiled.portable import norm, norms, product
from solver.elements.marker import Marker
from solver.elements.rigid_body import RigidBodySpec
from solver.errors import SpecError
from solver.model.scale import length_of
from solver.model.spec import ModelSpec

# joints: forces at points
POINTS = {'spherical': ('i', 'j'), 'distance': ('i', 'j'), 'point_on_line': ('j',), 'point_on_plane': ('j',)}
STRAIGHT = 1e-9  # relative: what points that are written with sixteen digits may be off the line through them
# of the length of a model, that of bodies among which none has a moment of inertia; ten times as much changes no motion
SIZE = 0.1


def standing_inertia(spec: ModelSpec) -> np.ndarray:
    """(nb, 3, 3) moments of inertia [kg m^2] to add, about every axis about which a body has none and nothing turns it;
    in B.

    Raises SpecError for a body that is given an angular velocity about such an axis.
    """
    added = np.zeros((len(spec.bodies), 3, 3))
    usual = 0.0
    for J, body in zip(added, spec.bodies, strict=True):
        axes = _free(spec, body)
        if axes.any():
            spin = float(norm(product(axes, np.array(body.angular_velocity))))
            if spin > STRAIGHT * norm(np.array(body.angular_velocity)):
                raise SpecError(
                    f'{body.where}: angular_velocity = {list(body.angular_velocity)}: the body has no moment of '
                    'inertia about that axis, '
                    'and nothing acts on such a rotation: leave that component out, or give the body an inertia'
                )
            usual = usual or _usual(spec)
            J[:] = usual * axes
    return added


def _usual(spec: ModelSpec) -> float:
    """A moment of inertia [kg m^2] as others in the model: nothing depends on it but how well equations are scaled."""
    moments = [float(np.trace(b.inertia_matrix())) / 3.0 for b in spec.bodies]
    some = [moment for moment in moments if moment > 0.0]
    return sum(some) / len(some) if some else max(b.mass for b in spec.bodies) * (SIZE * length_of(spec)) ** 2


def _free(spec: ModelSpec, body: RigidBodySpec) -> np.ndarray:
    """(3, 3) projector onto the axes in B about which a body neither has inertia nor feels a moment; zero where it has
    none of them."""
    nothing = np.zeros((3, 3))
    J = body.inertia_matrix()
    if any(body.inertia) and not _thin(J):
        return nothing
    points = []
    for marker, alone in _holds(spec, body.name):
        if marker is None or not alone:
            return nothing
        points.append(np.subtract(marker.position, body.com))
    arms = np.array(points).reshape(-1, 3)
    if any(body.inertia):
        d = _axis(J)
        return np.outer(d, d) if _along(arms, d) else nothing
    if not arms.any():
        return np.eye(3)
    from_one = arms - (0.0 if body.mass > 0.0 else arms[0])
    far = from_one[int(np.argmax(norms(from_one)))]
    if not far.any():  # of no mass, held at one point
        return np.eye(3)
    d = far / norm(far)
    return np.outer(d, d) if _along(from_one, d) else nothing


def _thin(J: np.ndarray) -> bool:
    """True where an inertia is that of a thin rod: none about one axis, and by that equal ones across it."""
    d = _axis(J)
    return bool(np.abs(product(J, d)).max() <= STRAIGHT * np.trace(J))


def _axis(J: np.ndarray) -> np.ndarray:
    """(3,) unit vector along a thin rod of inertia J = A (1 - d d^T): the largest column of d d^T."""
    dd = np.eye(3) - 2.0 * J / np.trace(J)
    column = dd[:, int(np.argmax(norms(dd.T)))]
    return column / max(norm(column), 1e-300)


def _along(arms: np.ndarray, d: np.ndarray) -> bool:
    across = np.cross(arms, d)
    return bool(np.abs(across).max(initial=0.0) <= STRAIGHT * np.abs(arms).max(initial=0.0))


def _holds(spec: ModelSpec, name: str) -> Iterator[tuple[Marker | None, bool]]:
    """By element at a body (its marker there, whether it does nothing but pull at that point); no marker where it acts
    otherwise."""
    ours = {c.name for c in spec.coordinates if name in (c.i.body, c.j.body)}
    for section, elements in spec.sections().items():
        if section in ('bodies', 'coordinates'):
            continue
        element: Any
        for element in elements:
            for field, value in vars(element).items():
                if isinstance(value, Marker) and value.body == name:
                    alone = (
                        field in POINTS.get(element.kind, ()) if section == 'joints' else section == 'spring_dampers'
                    )
                    if section == 'applied_forces':
                        alone = field == 'marker' and not any(element.torque)
                    yield value, alone
                elif field != 'name' and _acts(field, value, name, ours):
                    yield None, False


def _acts(field: str, value: Any, name: str, coordinates: set[str]) -> bool:
    """True where a field of an element names the body, or one of its coordinates."""
    if field == 'terms':
        return any(term in coordinates for term, _ in value)
    return isinstance(value, str) and (value == name or (field == 'coordinate' and value in coordinates))
