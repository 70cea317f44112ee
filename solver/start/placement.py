"""Checks of a start, and a report of its changes.

The refuse_...() functions raise ConsistencyError for a placement from which no run can begin: open joints, elements
whose force has no direction, a vehicle on its roof. changes() says by how much the start moved bodies and changed
velocities.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from solver.compiled.portable import norm, norms, product
from solver.compiled.so3 import matrix_of_quaternion
from solver.elements.coordinate import ROTATION
from solver.elements.joint import AXES, DISTANCE, KINDS, PX, TWIST
from solver.elements.marker import Marker
from solver.elements.spring_damper import SPRING_DAMPERS
from solver.elements.tire_pacejka import TIRES
from solver.errors import ConsistencyError
from solver.model.evaluate import evaluate_constraints, evaluate_forces, turning_rows
from solver.model.state import State, kinematics_of
from solver.model.tables import Model
from solver.units import shown
from solver.vehicle.size import scale_of

# Residual of a joint that counts as closed, in lengths of the model or rad; change that counts as none, in the same,
# and of velocities in slow speeds of the model (solver.model.scale). Files have numbers with finitely many digits,
# which leave less than that. Ten times as much would hide a visible misplacement.
OPEN = 1e-6
# Distance, in lengths of the model, of two points that count as one; ten times as much is still far below any length
# that is written.
COINCIDING = 1e-12
PARALLEL = ('fixed', 'prismatic')  # kinds of joints that keep the axes of their two markers parallel
# 1 + the cosine between two axes that count as opposite: they are less than 3e-5 rad from it. Ten times as much: 1e-4
# rad.
OPPOSED = 1e-9
UNLOADED = 1e-3  # load of a wheel that counts as none, relative to the mean load of all wheels


@dataclass(frozen=True, kw_only=True)
class Changes:
    """Largest changes that a start made to the placement and the velocities that were given.

    moved, distance: the body whose centre of mass moved most, and by how much [m]. turned, turn: the body that turned
    most [rad]. placed_by: the cause of both. faster, velocity: the body whose centre of mass changed its velocity most
    [m/s], start.speed included. spun, rate: the body whose angular velocity changed most [rad/s]. set_by: the cause of
    both. wheels: names of the bodies that are wheels, which turn as they are placed and spin as they roll. corrected,
    correction: the body whose velocity in the file was changed most [m/s or rad/s]. obstacle: a sentence about a kerb
    or a step at the wheels, or ''. A name is '' where nothing was changed.
    """

    kind: str
    moved: str = ''
    distance: float = 0.0
    turned: str = ''
    turn: float = 0.0
    placed_by: str = ''
    faster: str = ''
    velocity: float = 0.0
    spun: str = ''
    rate: float = 0.0
    set_by: str = ''
    corrected: str = ''
    correction: float = 0.0
    obstacle: str = ''
    wheels: tuple[str, ...] = ()

    def report(self) -> dict[str, Any]:
        """The changes as an object for JSON."""
        return {key: value for key, value in asdict(self).items() if key != 'wheels'}

    def __str__(self) -> str:
        parts = []
        if self.placed_by:
            turned = '' if self.turned in self.wheels else self.turned
            by = [_said(self.distance, 'm', self.moved), _said(self.turn, 'rad', turned)]
            how = f': bodies moved by up to {" and ".join(filter(None, by))}' if any(by) else ''
            parts.append(f'{self.placed_by}{" found" if self.kind == "equilibrium" else ""}{how}')
        if self.set_by:
            rolls = self.spun in self.wheels
            faster, spun = _said(self.velocity, 'm/s', self.faster), _said(self.rate, 'rad/s', self.spun)
            changed = f'{self.set_by}: velocities changed by up to {" and ".join(filter(None, (faster, spun)))}'
            parts.append('wheels spun up to the start speed' if rolls else changed)
        if self.corrected:
            parts.append(
                f'the velocity given for {self.corrected} does not fit the constraints and was changed by '
                f'{self.correction:.3g}'
            )
        if self.obstacle:
            parts.append(self.obstacle)
        return '; '.join(parts) or 'as given'


def changes(
    model: Model, kind: str, placed: np.ndarray, given: np.ndarray, state: State, *, wanted: bool, speed: float
) -> Changes:
    """Compare the state of a start with what was given.

    kind: start.kind. placed: placement (nb + 1, 7). given: velocities (nb + 1, 6). wanted: whether the scene asks for
    rates of coordinates. speed: of the chassis [m/s]. A change below OPEN counts as none.
    """
    names = model.body_names
    length, slow = scale_of(model.spec)
    slow = slow or max(np.abs(given[:-1, :3]).max(initial=0.0), length * np.abs(given[:-1, 3:]).max(initial=0.0))
    distance = norms(state.q[:-1, :3] - placed[:-1, :3])
    cosine = np.abs(np.add.reduce(state.q[:-1, 3:] * placed[:-1, 3:], axis=1))
    turn = np.array([2.0 * math.acos(min(c, 1.0)) for c in cosine.tolist()])
    turn[turn < OPEN] = 0.0
    velocity, rate = norms(state.v[:-1, :3] - given[:-1, :3]), norms(state.v[:-1, 3:] - given[:-1, 3:])
    by = 'static equilibrium' if kind == 'equilibrium' else 'assembly'
    causes = (['rolling at start.speed'] if speed else []) + (['rates wanted in start.coordinates'] if wanted else [])
    found: dict[str, Any] = {}
    if max(distance.max(initial=0.0) / length, turn.max(initial=0.0)) > OPEN:
        moved, turned = (
            _largest(names, distance, 'moved', 'distance', OPEN * length),
            _largest(names, turn, 'turned', 'turn', OPEN),
        )
        found |= moved | turned | {'placed_by': by}
    faster = OPEN * slow
    if max(velocity.max(initial=0.0), length * rate.max(initial=0.0)) > faster:
        set_by = ' and '.join(causes) or 'the constraints'
        found |= _largest(names, velocity, 'faster', 'velocity', faster) | _largest(
            names, rate, 'spun', 'rate', faster / length
        )
        found |= {'set_by': set_by}
        own = np.array([any((*body.velocity, *body.angular_velocity)) for body in model.spec.bodies])
        found |= _largest(
            names, own * np.maximum(velocity, rate), 'corrected', 'correction', faster * min(1.0, 1.0 / length)
        )
    return Changes(kind=kind, wheels=tuple({tire.marker.body: None for tire in model.spec.tires}), **found)


def _said(value: float, unit: str, body: str) -> str:
    return f'{shown(value, unit)} ({body})' if body else ''


def _largest(
    names: list[str] | tuple[str, ...], values: np.ndarray, body: str, value: str, least: float
) -> dict[str, Any]:
    """{body: name of the body with the largest value, value: that value}, or {} if it is below `least`."""
    worst = int(np.argmax(values))
    return {body: names[worst], value: float(values[worst])} if values[worst] > least else {}


def refuse_open_joints(model: Model, state: State, u: np.ndarray) -> None:
    """Raise ConsistencyError if a constraint is open by more than OPEN; the sentence names the one that is open
    most."""
    phi = _residuals(model, state, u)
    length, _ = scale_of(model.spec)
    open_ = np.abs(phi) * np.where(turning_rows(model), 1.0, 1.0 / length)
    if not len(phi) or open_.max() <= OPEN:
        return
    row = int(np.argmax(open_))
    remedy = 'set start.kind: assemble, or correct the placement of its bodies or markers (as_placed changes nothing)'
    raise ConsistencyError(f'start: {_described(model, phi, row)} as the bodies are placed; {remedy}')


def _residuals(model: Model, state: State, u: np.ndarray) -> np.ndarray:
    """(nc,) residuals of all constraints [m or rad]; zero for a constraint of velocities, which no position can
    violate."""
    t = model.tables
    phi, J = np.zeros(model.n_rows), np.zeros((model.n_entries + 1, 6, 6))
    evaluate_constraints(t, kinematics_of(state.q, np.zeros_like(state.v)), state.angle, u, False, phi, J)
    return phi * t.constraints.holonomic


def _described(model: Model, phi: np.ndarray, row: int) -> str:
    """Words 'joint X is open by ...' about the joint or constraint to which a row of phi (nc,) belongs."""
    first = 0
    for joint in model.spec.joints:
        codes = KINDS[joint.kind]
        if first <= row < first + len(codes):
            own = phi[first : first + len(codes)]
            apart = [x for x, code in zip(own, codes, strict=True) if code >= PX or code in (DISTANCE, *range(AXES))]
            angle = [
                0.5 * x if code == TWIST else x for x, code in zip(own, codes, strict=True) if AXES <= code <= TWIST
            ]
            parts = [f'{norm(np.array(apart)):.6g} m'] if norm(np.array(apart)) > OPEN * scale_of(model.spec)[0] else []
            if norm(np.array(angle)) > OPEN:
                parts.append(f'{math.degrees(math.asin(min(1.0, norm(np.array(angle))))):.4g} deg')
            return f'joint {joint.name!r} is open by {" and ".join(parts)}'
        first += len(codes)
    return f'constraint {model.row_names[row]!r} is open by {abs(phi[row]):.6g} (m or rad)'


def refuse_flat_discs(model: Model, state: State) -> None:
    """Raise ConsistencyError for a rolling disc that lies flat on its plane: it has no lowest point to roll on."""
    for contact in model.spec.contacts:
        axis, normal = (_axes(model, state, marker)[:, 2] for marker in (contact.j, contact.i))
        if contact.kind == 'rolling' and norm(np.cross(axis, normal)) < COINCIDING:
            raise ConsistencyError(
                f'start: the disc of contact {contact.name!r} lies flat on its plane, where it has no lowest point to '
                f'roll on; tilt the body {contact.j.body!r}, or give the axis of the disc in its marker j'
            )


def refuse_points_without_distance(model: Model, state: State) -> None:
    """Raise ConsistencyError for a distance joint whose points coincide: it has no direction there."""
    length, _ = scale_of(model.spec)
    for joint in model.spec.joints:
        if (
            joint.kind == 'distance'
            and norm(_point(model, state, joint.j) - _point(model, state, joint.i)) < COINCIDING * length
        ):
            raise ConsistencyError(
                f'start: the points of joint {joint.name!r} (distance) coincide, so it has no direction; place one of '
                'its bodies elsewhere'
            )


def refuse_links_without_length(model: Model, state: State) -> None:
    """Raise ConsistencyError for a rod or strut whose points coincide: its force has no direction there."""
    length, _ = scale_of(model.spec)
    for element, links in (('rod', model.spec.rods), ('strut', model.spec.struts)):
        for link in links:
            if norm(_point(model, state, link.j) - _point(model, state, link.i)) < COINCIDING * length:
                raise ConsistencyError(
                    f'start: {element} {link.name!r} has length zero, so its force has no direction; place its bodies '
                    'apart'
                )


def refuse_turned_over(model: Model, state: State) -> None:
    """Raise ConsistencyError for a fixed or prismatic joint whose markers are half a turn apart: its residuals are zero
    there too."""
    for joint in model.spec.joints:
        if joint.kind not in PARALLEL:
            continue
        F, G = _axes(model, state, joint.i), _axes(model, state, joint.j)
        # 3 where parallel, -1 else
        if float(product(F[:, 0], G[:, 0]) + product(F[:, 1], G[:, 1]) + product(F[:, 2], G[:, 2])) < 0.0:
            raise ConsistencyError(
                f'start: the markers of joint {joint.name!r} ({joint.kind}) are turned by 180 deg against each other; '
                'turn one of the two markers by 180 deg, or, where start.kind: assemble turned them over, place its '
                'bodies nearer to their assembled positions'
            )


def refuse_overturned(model: Model, state: State, chassis: int, speed: float) -> None:
    """Raise ConsistencyError for a vehicle that lies on its roof after it has settled at a speed [m/s]."""
    up = matrix_of_quaternion(tuple(state.q[chassis, 3:]))[8]  # component zz
    if model.spec.tires and up < 0.0:
        raise ConsistencyError(
            f'start: the vehicle turns over while it settles at {speed:g} m/s; place it where the road is flatter'
        )


def _axes(model: Model, state: State, marker: Marker) -> np.ndarray:
    """(3, 3) axes of a marker in the world, as columns."""
    own = np.array(matrix_of_quaternion(tuple(marker.orientation))).reshape(3, 3)
    if marker.body not in model.body_names:
        return own
    body = np.array(matrix_of_quaternion(tuple(state.q[model.body_names.index(marker.body), 3:]))).reshape(3, 3)
    return product(body, own)


def _point(model: Model, state: State, marker: Marker) -> np.ndarray:
    """(3,) origin of a marker in the world [m]."""
    if marker.body not in model.body_names:
        return np.array(marker.position)
    b = model.body_names.index(marker.body)
    R = np.array(matrix_of_quaternion(tuple(state.q[b, 3:]))).reshape(3, 3)
    return state.q[b, :3] + product(R, np.array(marker.position) - np.array(model.spec.bodies[b].com))


def refuse_undirected(model: Model, state: State, u: np.ndarray) -> None:
    """Raise ConsistencyError for a spring with a force at length zero, and for a rotation whose two axes are opposite.

    The force has no direction, and the angle no value.
    """
    t = model.tables
    kin = kinematics_of(state.q, state.v)
    axes = t.coordinates
    for k in np.flatnonzero(axes.kind == ROTATION):
        i, j = axes.body[k]
        n, m = product(kin.R[i], axes.F[k, :, 2]), product(kin.R[j], axes.G[k, :, 2])
        if 1.0 + float(product(n, m)) < OPPOSED:
            raise ConsistencyError(
                f'start: the axes of the two markers of {model.coordinate_names[k]!r} point in opposite directions, '
                'where its angle is not defined; turn one of the two markers by 180 deg'
            )
    if not model.spec.spring_dampers:
        return
    for spec, out in zip(
        model.spec.spring_dampers, model.outputs(SPRING_DAMPERS.name, _outputs(model, state, u)), strict=True
    ):
        length, force = out[SPRING_DAMPERS.column('length')], out[SPRING_DAMPERS.column('force')]
        if length < COINCIDING * scale_of(model.spec)[0] and force != 0.0:
            raise ConsistencyError(
                f'start: spring-damper {spec.name!r} has length zero, so its force of {force:.3g} N has no direction; '
                'place its bodies apart, or give it no force at length zero (free_length: 0, no preload)'
            )


def _outputs(model: Model, state: State, u: np.ndarray) -> np.ndarray:
    """Outputs of all force elements in a state under the inputs u (nu,)."""
    outputs = model.new_outputs()
    f, z = np.zeros((model.n_bodies + 1, 6)), np.zeros(model.n_internal)
    none = np.zeros((model.n_slots + 1, 6, 6))
    evaluate_forces(
        model.tables, kinematics_of(state.q, state.v), state.angle, state.z, 0.0, u, False, f, none, none, z, outputs
    )
    return outputs


def refuse_unloaded_wheels(model: Model, state: State, u: np.ndarray) -> None:
    """Raise ConsistencyError for a static equilibrium in which a wheel carries no load."""
    if not model.spec.tires:
        return
    loads = model.outputs(TIRES.name, _outputs(model, state, u))[:, TIRES.column('fz')]
    free = [tire.name for tire, load in zip(model.spec.tires, loads, strict=True) if load < UNLOADED * loads.mean()]
    if free:
        raise ConsistencyError(
            f'start: the static equilibrium that was found leaves {", ".join(free)} without load: the vehicle '
            'stands on its other wheels only; place it nearer to its equilibrium, on a gentler slope, or with less '
            'or no brake_torque at t = 0'
        )
