"""Start of a vehicle: what it needs beyond the start of a mechanism.

The vehicle is laid onto the road (lay_on_road), held on a slope while its equilibrium is sought (held_body), its wheels
are made to roll at the start speed (roll_wheels), and it settles in its suspension at that speed (settle_rolling).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import cast

import numpy as np

from solver.compiled.by_reference import Ref
from solver.compiled.portable import norm, norms, product
from solver.elements.clutch import CLUTCHES
from solver.elements.registry import FORCES
from solver.elements.road import surface_at
from solver.elements.tire_pacejka import TIRES, rolling_radius
from solver.errors import ConsistencyError
from solver.inputs.command_filter import STEERING
from solver.model.evaluate import evaluate_forces
from solver.model.frames import matrix, quaternion
from solver.model.state import State, kinematics_of
from solver.model.tables import Model
from solver.step.augmented_lagrangian import advance
from solver.step.work import OK, Scheme, StepResult, scheme_parameters
from solver.vehicle.size import size_of

# Angle [rad] between floor and road that is left to the search for static equilibrium, which turns a body by so much in
# one iteration. From ten times as much, links turn over on the way.
STEEP = 0.05
# The lengths and times of REACH, SETTLE_TIME, SETTLE_EVERY and SETTLE_STEP are those of a passenger car. They scale
# with the vehicle (solver.vehicle.size).
# Distance [m] from the road that is left to the search for static equilibrium: the travel of a suspension. From further
# away the search ends with wheels that have turned or slipped.
REACH = 0.1
SETTLE_TIME = 5.0  # duration [s] of settling at speed: some ten periods of a suspension mode
SETTLE_EVERY = 0.05  # interval [s] after which the vehicle is put back to its place and speed
SETTLE_PENALTY = 1e6  # penalty of the constraints while settling, in place of that of the scene
SETTLE_RHO = 0.8  # spectral radius at infinite frequency while settling, in place of that of the scene
# step [s] while settling, in place of that of the scene: a start does not depend on the step of the scene
SETTLE_STEP = 5e-3
# Change of speed of a driven vehicle in SETTLE_EVERY, relative to its speed, from which on it is not steady. Put back
# by more than that, the rates of shafts would not fit those of the wheels.
UNSTEADY = 0.1
SPINNING = 1.3  # rate of a wheel, relative to that of rolling, from which on it has lost its grip
ALIGNED = 0.9  # least cosine between the axis of a coordinate and the axis of the wheel that turns in it
# Speed of a braked vehicle after SETTLE_EVERY, relative to the start speed: if less is left, the brakes hold the
# wheels, and the wheels are not made to turn again.
STOPPED = 0.5
SLIPPING = 0.05  # slip of a clutch, relative to the rate of its shaft, from which on it does not hold the shaft
# duration [s] of the short steps for wheels in guides: ten times the lag of a guide (solver.levels.kc)
GUIDED_TIME = 0.02
GUIDED_STEP = 1e-4  # those steps [s]
# angle [rad] that a shaft may turn in one step of settling, or the step is divided; from 3 on steps failed
SETTLE_TURN = 2.0
SETTLE_AGAIN = 2.3  # the angle [rad] from which on it is divided again, because an engine turns faster than it did


def _heights(model: Model, places: np.ndarray) -> np.ndarray:
    """(n,) heights [m] of the road, grids included, at places (n, 2) [m]."""
    road = Ref(model.elements[TIRES.name].value.road)
    return np.array([surface_at(road, float(x), float(y))[0] for x, y in places])


def ground(model: Model, state: State) -> tuple[np.ndarray, np.ndarray]:
    """(point (3,) [m], normal (3,)) of the plane that a vehicle stands on: the base plane of the road. If the road has
    grids, it is the plane of least squares through the road below the wheels."""
    road = model.spec.road
    if not road.grids:
        return np.array(road.point), np.array(road.normal)
    places = state.q[[model.body_names.index(tire.marker.body) for tire in model.spec.tires], :2]
    z = _heights(model, places)
    point = np.array([*np.mean(places, axis=0), np.mean(z)])
    (x, y), z = (places - point[:2]).T, z - point[2]
    xx, xy, yy = float(product(x, x)), float(product(x, y)), float(product(y, y))
    determinant = xx * yy - xy * xy
    if determinant < 1e-6 * (xx + yy) ** 2:  # wheels in one line
        return point, np.array(road.normal)
    xz, yz = float(product(x, z)), float(product(y, z))
    slopes = np.array([(yy * xz - xy * yz) / determinant, (xx * yz - xy * xz) / determinant, -1.0])
    return point, -slopes / norm(slopes)


def lay_on_road(model: Model, state: State, chassis: int) -> None:
    """Turn and lift a whole vehicle as one rigid body, until its floor is parallel to the road below it. Changes
    `state`.

    It turns about the centre of mass of its chassis, and keeps its height above the road. If that height is above
    REACH, the vehicle is put onto the road. A smaller angle than STEEP and a smaller height than REACH are left to the
    search for equilibrium. From a level placement on a steeper slope, the wheels of one side would be so deep in the
    road that links turn over on the way out.
    """
    if not model.spec.tires:
        return
    point, n = ground(model, state)
    body = model.spec.bodies[chassis]
    R = matrix(tuple(state.q[chassis, 3:]))
    axis, cosine = np.cross(R[:, 2], n), float(product(R[:, 2], n))
    com = state.q[chassis, :3].copy()
    floor = product(R, -np.array(body.com))  # from the centre of mass to the reference frame
    above = float(product(n, com + floor - point)) / n[2]  # vertically
    if abs(above) > REACH * size_of(model.spec).length:
        state.q[:-1, 2] -= above
        com[2] -= above
        above = 0.0
    if norm(axis) < STEEP or cosine < 0.0:
        return
    half = float(np.sqrt(0.5 * (1.0 + cosine)))  # cosine of half the angle
    turn = matrix((*(axis / (2.0 * half)).tolist(), half))
    lift = above - float(product(n, com + product(turn, floor) - point))
    for b in range(model.n_bodies):
        state.q[b, :3] = com + product(turn, state.q[b, :3] - com) + lift * n
        state.q[b, 3:] = quaternion(product(turn, matrix(tuple(state.q[b, 3:]))))


def held_body(model: Model, chassis: int, u: np.ndarray) -> int | None:
    """The body that the search for static equilibrium holds along its x axis: the chassis of a vehicle without brakes
    applied.

    None for a mechanism, or if the inputs u (nu,) apply a brake. On a slope the equilibrium is then found where the
    vehicle was placed, and the vehicle rolls away from there.
    """
    braked = any(kind.capacities(model.elements[kind.name].value, u).any() for kind in FORCES if kind.capacities)
    return chassis if model.spec.tires and not braked else None


def without_brakes(model: Model, u: np.ndarray) -> np.ndarray:
    """The inputs u (nu,) with all brakes released."""
    released = u.copy()
    for kind in FORCES:
        if kind.capacities:
            released[model.inputs_of(kind.name)] = 0.0
    return released


def without_hands(model: Model, u: np.ndarray) -> np.ndarray:
    """The inputs u (nu,) with zero torque at a free steering wheel. The torque acts from the first step of the run on.

    Sliding tires do not resist the torque: a car that settled under it would have its steering wheel at the stop.
    """
    released = u.copy()
    for k, name in enumerate(model.spec.inputs):
        if name == STEERING['torque']:
            released[k] = 0.0
    return released


def _evaluated(model: Model, state: State, u: np.ndarray) -> np.ndarray:
    """Outputs of the forces in a state under the inputs u (nu,)."""
    kin = kinematics_of(state.q, state.v)
    outputs = model.new_outputs()
    f, z = np.zeros((model.n_bodies + 1, 6)), np.zeros(model.n_internal)
    no_tangents = np.zeros((model.n_slots + 1, 6, 6))
    evaluate_forces(model.tables, kin, state.angle, state.z, 0.0, u, False, f, no_tangents, no_tangents, z, outputs)
    return outputs


def held_shafts(model: Model, state: State, u: np.ndarray) -> list[int]:
    """Body indices of the shafts that a clutch without slip connects to the wheels, under the inputs u (nu,)."""
    clutches = model.spec.clutches
    if not clutches:
        return []
    bodies = {joint.name: model.body_names.index(joint.j.body) for joint in model.spec.joints}
    # the world's for one without a bearing: it does not turn
    shafts = [bodies.get(clutch.shaft, -1) for clutch in clutches]
    found = model.outputs(CLUTCHES.name, _evaluated(model, state, u))
    slip, ratio = (found[:, CLUTCHES.column(name)] for name in ('rate', 'ratio'))
    return [
        shaft
        for shaft, w, R in zip(shafts, slip, ratio, strict=True)
        if R and abs(w) < SLIPPING * norm(state.v[shaft, 3:])
    ]


def roll_wheels(
    model: Model, state: State, speed: float, u: np.ndarray, wanted: Mapping[str, float]
) -> dict[str, float]:
    """Let the wheels roll at `speed` [m/s]: sets their angular velocities in state.v.

    wanted: coordinate of a wheel -> rate [rad/s] that it has instead. Returns coordinate -> rate [rad/s] of all wheels.
    """
    loads = model.outputs(TIRES.name, _evaluated(model, state, u))[:, TIRES.column('fz')]
    turns = [j for j in model.spec.joints if j.kind == 'revolute'] + [
        c for c in model.spec.coordinates if c.kind == 'rotation'
    ]
    rates = {}
    for e, tire in enumerate(model.spec.tires):
        rate = speed / rolling_radius(model.elements[TIRES.name].value.c[e], loads[e], speed)
        spin = matrix(tire.marker.orientation)[:, 1]
        for turn in turns:
            if tire.marker.body in (turn.i.body, turn.j.body):
                side = 1.0 if turn.j.body == tire.marker.body else -1.0
                own = turn.j if side > 0 else turn.i
                along = float(product(matrix(own.orientation)[:, 2], spin))
                if abs(along) < ALIGNED:
                    continue
                sign = side if along > 0.0 else -side
                rates[turn.name] = wanted.get(turn.name, sign * rate)
                rate = sign * rates[turn.name]
                break
        # The wheel has to turn already when velocities are projected: otherwise the projection would turn its carrier.
        state.v[model.body_names.index(tire.marker.body), 3:] += rate * spin
    return rates


def settle_rolling(
    model: Model,
    states: list[Ref],
    method: Scheme,
    speed: float,
    u: np.ndarray,
    chassis: int,
    work: Ref,
    explain: Callable[[StepResult], str],
    *,
    driven: bool,
) -> bool:
    """Let a vehicle settle in its suspension at `speed` [m/s], at the place where it starts. states[0] is its state,
    and changes.

    The equilibrium at speed is another than that at rest: rolling tires grow and stiffen, drag and drive torque act. So
    the vehicle is simulated for SETTLE_TIME, from the equilibrium at rest, without accelerations at first. Every
    SETTLE_EVERY it is put back to its speed and, along the road, to its place and heading. Along the road, because a
    car on a slope that is put back horizontally would stand in the road or above it. To its heading, because a car that
    steers or stands on a bank would otherwise start on another course than it was placed on.

    Guides (solver.elements.guide) hold their wheels by stiff springs, where other wheels have joints. In a bend the
    long steps leave an error in the path of such a wheel that the springs turn into large accelerations (4e-5 rad made
    18 000 rad/s^2). So vehicles with guides settle for GUIDED_TIME more, in steps of GUIDED_STEP.

    driven: whether a drive torque acts. explain: sentence about a failed step. Returns False if the vehicle is driven
    by more than a steady state has: a wheel spins, or the speed changes by more than UNSTEADY in SETTLE_EVERY. (A
    steady state with spinning wheels would be one with the engine at its limiter.) Raises ConsistencyError when a step
    fails.
    """
    # Settings of its own: all integration methods start from the same state, so that their runs can be compared.
    own = {
        'penalty': np.full(model.n_rows, SETTLE_PENALTY),
        'factor': np.ones(model.n_rows),
        'm_alf': 0,
        'weigh': 0,
        'coupled': 0,
        'full': 0,
        'combined': 1,
    }
    h, slower = 0.0, size_of(model.spec).time
    start = cast(State, states[0].value).q[chassis].copy()
    place, ahead = start[:2], matrix(tuple(start[3:]))[:, 0]
    nx, ny, nz = model.spec.road.normal
    n = ground(model, cast(State, states[0].value))[1]
    wheels = [model.body_names.index(tire.marker.body) for tire in model.spec.tires]
    # Spin axis of each wheel in a guide. Only its rate about this axis is put back: its other rates have settled with
    # the chassis, and no joint would correct them.
    guided = {
        wheel: matrix(t.marker.orientation)[:, 1]
        for wheel, t in zip(wheels, model.spec.tires, strict=True)
        if model.spec.guides
    }
    rolling = norms(cast(State, states[0].value).v[wheels, 3:]) / abs(speed)
    for last in (False,) * round(SETTLE_TIME / SETTLE_EVERY) + (True,) * bool(model.spec.guides):
        fastest = float(norms(cast(State, states[0].value).v[:-1, 3:]).max())
        if last or not h or h * fastest > SETTLE_AGAIN:
            longest, time = (GUIDED_STEP, GUIDED_TIME) if last else (SETTLE_STEP * slower, SETTLE_EVERY * slower)
            h = longest / max(1, int(np.ceil(longest * fastest / SETTLE_TURN)))
            settling = Ref(method._replace(fixed=1, iterations=2, **own, **scheme_parameters(h, SETTLE_RHO)))  # type: ignore[arg-type]
            steps = round(time / h)
            inputs = np.repeat(without_hands(model, u)[None, :], steps, axis=0)
        result, done = advance(model.tables, settling, *states, inputs, 0, steps, False, work)
        if done % 2 == 1:
            states.reverse()
        if result.status != OK:
            raise ConsistencyError(f'start: the vehicle does not settle at {speed:g} m/s: {explain(result)}')
        state = cast(State, states[0].value)
        turn_over_road(state, chassis, n, ahead)
        q, v = state.q, state.v
        forward = matrix(tuple(q[chassis, 3:]))[:, 0]
        now = float(product(v[chassis, :3], forward))
        spins = np.any(norms(v[wheels, 3:]) > SPINNING * rolling * norms(v[wheels, :3]))
        if driven and (spins or abs(now - speed) > UNSTEADY * abs(speed)):
            return False
        back = place - q[chassis, :2]
        if model.spec.road.grids:  # the wheels keep their mean height above the road
            q[:-1, 2] += np.mean(_heights(model, q[wheels, :2] + back) - _heights(model, q[wheels, :2]))
        else:
            q[:-1, 2] -= (nx * back[0] + ny * back[1]) / nz
        q[:-1, :2] += back
        v[:-1, :3] += (speed - now) * forward
        for body in (*wheels, *held_shafts(model, state, u)) if now / speed > STOPPED else ():
            axis = guided.get(body)
            if axis is None:
                v[body, 3:] *= speed / now
            else:
                v[body, 3:] += (speed / now - 1.0) * float(product(axis, v[body, 3:])) * axis
    return True


def turn_over_road(state: State, chassis: int, n: np.ndarray, ahead: np.ndarray) -> None:
    """Turn a whole vehicle, with all its velocities and accelerations, until its chassis heads in the direction `ahead`
    (3,).

    The axis of the turn is the normal n (3,) of the road through the centre of mass of the chassis. The heading is the
    x axis of the chassis, projected onto the plane of the road. Changes `state`.
    """
    forward = matrix(tuple(state.q[chassis, 3:]))[:, 0]
    across = float(product(n, np.cross(forward, ahead)))
    along = float(product(forward, ahead) - product(n, forward) * product(n, ahead))
    half = 0.5 * math.atan2(across, along)
    u, c = math.sin(half) * n, math.cos(half)
    R = matrix((*u.tolist(), c))
    com = state.q[chassis, :3].copy()
    bodies = slice(0, len(state.q) - 1)  # the last one is the world
    state.q[bodies, :3] = com + product(state.q[bodies, :3] - com, R.T)
    w, d = state.q[bodies, 3:6].copy(), state.q[bodies, 6].copy()
    state.q[bodies, 3:6] = c * w + d[:, None] * u + np.cross(u, w)  # the product of the quaternions, the turn first
    state.q[bodies, 6] = c * d - product(w, u)
    # linear parts in the world (docs/conventions.md)
    for rates in (state.v, state.a, state.a_stage, state.a_stage_before):
        rates[bodies, :3] = product(rates[bodies, :3], R.T)
