"""Moving a whole mechanism over the ground to another place and heading, while it moves on as before in its own axes.

On a flat road that is the same everywhere this is a symmetry of the equations: gravity and road do not change under a
shift or a turn about the vertical. The linear parts of velocities and accelerations are vectors in the world
(docs/conventions.md), so displace() turns them too. Angular velocities, internal states, joint coordinates and
multipliers are relative to the bodies, and stay.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from solver.compiled.portable import product
from solver.compiled.so3 import matrix_of_quaternion
from solver.elements.applied_force import AppliedForceSpec
from solver.elements.guide import GuideSpec
from solver.elements.marker import WORLD, Marker, Spec
from solver.elements.road import RoadSpec
from solver.errors import SpecError
from solver.inputs.driver import FURTHEST, Sight
from solver.model.frames import matrix
from solver.model.spec import ModelSpec
from solver.model.state import State

LEVEL = 1e-9  # sine of the slope of a plane that counts as level; ten times as much: 0.01 m of height in 1000 km
# Kind of joint or contact that may connect a mechanism to the world -> the sides (i, j) that may be the world, if z of
# the marker there is vertical. Level ground makes such an element the same in every place and heading.
ON_THE_GROUND = {
    'rolling': 'i',
    'knife_edge': 'i',
    'point_on_plane': 'i',
    'perpendicular': 'ij',
}


def sight(q: np.ndarray, v: np.ndarray, com: Sequence[float]) -> Sight:
    """Place, heading and speed of the reference frame of a body, as a driver sees them.

    q: configuration (7,). v: twist (6,). com: centre of mass in the reference frame (3,) [m].
    """
    x, y, _, *quaternion = q.tolist()
    vx, vy, vz, _, wy, wz = v.tolist()
    cx, cy, cz = com
    a, b, c, d, e, f, g, _, _ = matrix_of_quaternion(tuple(quaternion))
    speed = a * vx + d * vy + g * vz - (wy * cz - wz * cy)
    return Sight(x - (a * cx + b * cy + c * cz), y - (d * cx + e * cy + f * cz), math.atan2(d, a), speed)


def require_uniform(road: RoadSpec) -> None:
    """Raise SpecError for a road that differs from place to place: a vehicle cannot be moved on it."""
    if road.grids or road.patches or road.maps or tuple(road.normal) != (0.0, 0.0, 1.0):
        raise SpecError('a vehicle can be placed on a flat road only; this one has a slope, patches, maps or grids')


def require_near(x: float, y: float) -> None:
    """Raise SpecError for a place x, y [m] so far away that rounding of its coordinates would change the lengths of
    parts."""
    if not (abs(x) <= FURTHEST and abs(y) <= FURTHEST):
        raise SpecError(
            f'x = {x:g} m, y = {y:g} m: a vehicle can be placed within {FURTHEST:g} m of the origin, where its parts '
            'keep their lengths'
        )


def require_free(model: ModelSpec) -> None:
    """Raise SpecError for a model that is attached to a place of the world, or on a road that require_uniform()
    refuses.

    Elements of ON_THE_GROUND are no attachment, and neither is a force in the axes of the world (`applied_forces`),
    which has no place.
    """
    require_uniform(model.road)
    for section, specs in model.sections().items():
        for spec in specs if section != 'bodies' else ():
            if _attached(spec):
                raise SpecError(
                    f'the model cannot be placed elsewhere: it is attached to the world by {spec.where}; '
                    'give its place in the scene instead'
                )


def _attached(spec: Spec) -> bool:
    """True where an element connects a body to a place of the world, or to a direction of the world that is not
    vertical."""
    if isinstance(spec, GuideSpec):
        return WORLD in (spec.chassis, spec.left, spec.right)
    if isinstance(spec, AppliedForceSpec):
        return False
    for side in 'ij':
        marker = getattr(spec, side, None)
        if isinstance(marker, Marker) and marker.body == WORLD:
            x, y, _ = matrix(marker.orientation)[:, 2]
            if side not in ON_THE_GROUND.get(getattr(spec, 'kind', ''), '') or math.hypot(x, y) > LEVEL:
                return True
    return False


def displace(state: State, now: Sight, then: tuple[float, float, float]) -> None:
    """Move a state in place, so that the frame that is at `now` comes to `then` (x [m], y [m], heading [rad])."""
    x, y, heading = then
    turn = heading - now.heading
    R = np.array([[math.cos(turn), -math.sin(turn), 0.0], [math.sin(turn), math.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    z, w = math.sin(0.5 * turn), math.cos(0.5 * turn)
    bodies = slice(0, len(state.q) - 1)  # the last one is the world
    state.q[bodies, :3] = product(state.q[bodies, :3] - (now.x, now.y, 0.0), R.T) + (x, y, 0.0)
    a, b, c, d = state.q[bodies, 3:].T.copy()
    state.q[bodies, 3:] = np.column_stack([w * a - z * b, w * b + z * a, w * c + z * d, w * d - z * c])
    for rates in (state.v, state.a, state.a_stage, state.a_stage_before):
        rates[bodies, :3] = product(rates[bodies, :3], R.T)
