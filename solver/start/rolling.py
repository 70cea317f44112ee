"""Start of a vehicle, beside that of a mechanism: something that holds it on a slope, wheels that roll, settling at
speed."""

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

STEEP = 0.05  # rad, what the search for static equilibrium turns a body in one iteration
# lengths and times of REACH and SETTLE are those of a passenger car, and scaled with the vehicle (solver.vehicle.size)
REACH = 0.1  # m, the travel of a suspension: from further away than that the search ends with wheels that have turned or slipped
SETTLE_TIME = 5.0  # s, some ten periods of a suspension mode
SETTLE_EVERY = 0.05  # s
SETTLE_PENALTY = 1e6
SETTLE_RHO = 0.8  # spectral radius at infinite frequency, whatever that of the scene
SETTLE_STEP = 5e-3  # s, whatever the step of the scene, so that a start does not depend on it; where it settles does not depend on the step
UNSTEADY = 0.1  # of its speed, by which that of a driven vehicle may change in SETTLE_EVERY; put back by more, shafts misfit wheels
SPINNING = 1.3  # times the rate of rolling at which a wheel has lost its grip
ALIGNED = 0.9  # cosine between the axis of a coordinate and that of a wheel which turns in it
STOPPED = 0.5  # of its speed: brakes that leave a vehicle less of it at once hold its wheels, which are not made to turn as fast as before
SLIPPING = 0.05  # of the rate of its shaft: slip of a clutch that does not hold it
GUIDED_TIME = 0.02  # s, ten times the lag of what guides hold wheels by (solver.levels.kc)
GUIDED_STEP = 1e-4  # s
SETTLE_TURN = 2.0  # rad that a shaft may turn in such a step, or steps are divided: from 3 on they were seen to fail
SETTLE_AGAIN = 2.3  # rad from which on steps are divided again, for an engine that is driven faster meanwhile


def _heights(model: Model, places: np.ndarray) -> np.ndarray:
    """(n,) heights [m] of the road, grids included, at places (n, 2) [m]."""
    road = Ref(model.elements[TIRES.name].value.road)
    return np.array([surface_at(road, float(x), float(y))[0] for x, y in places])


def ground(model: Model, state: State) -> tuple[np.ndarray, np.ndarray]:
    """(point (3,) [m], normal (3,)) of the plane that a vehicle stands on: the base plane of the road or, where it has grids, the one that
    lies nearest to the road below its wheels."""
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
    """Turn a whole vehicle, joints and all, about the centre of mass of its chassis until its floor is parallel to the road below it, as
    far from it as it was placed above it; further from it than REACH it is put onto it.

    Nothing is done if the two differ by less than STEEP and REACH: the search for equilibrium goes that far by itself.
    From a level placement on a steeper slope the wheels of one side would stand so deep in the road that links turn
    over on the way out.
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
    """The chassis of a vehicle whose brakes are all released under the inputs u (nu,), else None.

    It is held along its x axis while static equilibrium is sought: on a slope it is found where it was placed, resting in its suspension,
    and rolls away from there.
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
    """The inputs u (nu,) without a torque at a free steering wheel: it acts from the first step on.

    Tires that slide hold no torque, and a car that settled under it would have its steering wheel at the stop.
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
    """Bodies of the shafts that clutches without slip hold to what turns with the wheels, under the inputs u (nu,)."""
    clutches = model.spec.clutches
    if not clutches:
        return []
    bodies = {joint.name: model.body_names.index(joint.j.body) for joint in model.spec.joints}
    shafts = [bodies.get(clutch.shaft, -1) for clutch in clutches]  # the world's for one without a bearing: it does not turn
    found = model.outputs(CLUTCHES.name, _evaluated(model, state, u))
    slip, ratio = (found[:, CLUTCHES.column(name)] for name in ('rate', 'ratio'))
    return [shaft for shaft, w, R in zip(shafts, slip, ratio, strict=True) if R and abs(w) < SLIPPING * norm(state.v[shaft, 3:])]


def roll_wheels(model: Model, state: State, speed: float, u: np.ndarray, wanted: Mapping[str, float]) -> dict[str, float]:
    """Let the wheels roll at `speed` [m/s], in state.v, or turn by the rate that is wanted of their coordinate; returns the rates [rad/s]
    of the coordinates in which they turn."""
    loads = model.outputs(TIRES.name, _evaluated(model, state, u))[:, TIRES.column('fz')]
    turns = [j for j in model.spec.joints if j.kind == 'revolute'] + [c for c in model.spec.coordinates if c.kind == 'rotation']
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
        # the wheel itself has to turn before velocities are projected, or the projection would turn what carries it
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
    """Let a vehicle that starts at `speed` [m/s] come to rest in its suspension, on the spot and at its speed; states[0] is its state.

    Rolling tires grow and stiffen, drag and drive torque act: a car that stands in equilibrium does not roll in it. It begins without
    accelerations, with the constraint forces of that equilibrium; what this disturbs dies away with the rest. Every SETTLE_EVERY
    seconds it is put back to its speed and, along the road, to its place and heading: put back level, a car on a slope would stand in the
    road or above it, and one that steers or is on a bank would else begin on another course than it was placed on.
    Wheels that joints hold turn as joints allow; those that guides hold stand where springs have them, whose forces feel what so long a
    step leaves of a wheel's path in a bend (4e-5 rad made 18 000 rad/s^2). They settle in short steps at the end.

    Returns False if it is `driven` by more than a steady state has: a wheel spins or the speed changes by more than UNSTEADY at once.
    (Where wheels spin the steady state is one with the engine at its limiter.) Raises ConsistencyError with the sentence of `explain`
    when a step fails.
    """
    # with settings of its own: every method of a comparison starts from the same state
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
    # a guided wheel is put back to its speed about its axis alone: it turns with the body as it has settled, and no joint sees to that
    guided = {wheel: matrix(t.marker.orientation)[:, 1] for wheel, t in zip(wheels, model.spec.tires, strict=True) if model.spec.guides}
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
        if model.spec.road.grids:  # as high above the road below its wheels as it was
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
    """Turn a whole vehicle with its motion about the centre of mass of its chassis and the normal n (3,) of the road, until the x axis of
    its chassis, in the plane of the road, is in the direction `ahead` (3,).
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
    for rates in (state.v, state.a, state.a_stage, state.a_stage_before):  # linear parts in the world (docs/conventions.md)
        rates[bodies, :3] = product(rates[bodies, :3], R.T)
