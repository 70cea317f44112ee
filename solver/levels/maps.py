"""Maps of the axles of a vehicle, measured on the bench: the numbers of guides (solver.elements.guide) and of their
wheels.

The bench (solver.analysis.kinematics_and_compliance) holds the chassis of the full model in its design position.
Measured are

- both wheels of an axle at travels and angles of the steering wheel up to RANGES to either side: the maps over travel
and steering;
- one wheel alone, the other one held: the force of springs, stops and anti-roll bar over either travel, the change of
  the maps by the travel of the other wheel, and the lengths of the dampers; by both, in opposite directions and
  steered, how steering changes that; of a loaded vehicle the same about where it stands (solver.levels.other_wheel);
- a pull of the dampers with travels and steering held: the stiffness of their mounts;
- loads at the wheel centres with travels (those of a loaded vehicle that stands) and steering held: the compliance,
  gear and subframe included; and by the difference of all bodies' places the masses that move with a wheel and the
  inertia that turns with it.

Travels, loads and the lengths below are those of passenger cars and grow with the vehicle (solver.vehicle.size).

All fits are sums in a fixed order, so they have the same bits everywhere.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from solver.analysis.kinematics_and_compliance import CORNERS, Rig
from solver.compiled.portable import inverse, product
from solver.elements.guide_map import BESIDE, QUANTITIES
from solver.errors import ConsistencyError, SpecError
from solver.levels.bench import Bench, Stand
from solver.levels.loaded_position import loaded_position
from solver.levels.map_fits import least_squares, spline
from solver.levels.other_wheel import FITTED_LOADS, NO_INFLUENCE, OtherWheel, terms, where_it_stands
from solver.model.frames import matrix
from solver.model.spec import ModelSpec
from solver.vehicle.hardpoints import SIDES
from solver.vehicle.size import size_of

# ranges of the maps to either side, the first that is reached: travel [m], steering wheel [rad]; the last one is that
# of a racing car
RANGES = ((0.10, 8.0), (0.09, 8.0), (0.08, 8.0), (0.07, 8.0), (0.03, 2.0))
# m and rad of the road wheels: of a car that reaches none of these
TRAVELS, TURNED = (0.10, 0.08, 0.06, 0.05, 0.04, 0.03, 0.02), 0.42
ROLL = 0.06  # of both wheels in opposite directions [m]
ROLLED, STEERED = 1, 4  # nodes from the middle, of travels in opposite directions where the axle is steered too
MAP_TRAVEL, MAP_STEERING, FORCE_TRAVEL = 11, 33, 41  # nodes
# [N], [N m]: of a tire under 2 kN along or across
LOADS = {'cx': 2000.0, 'cy': 2000.0, 'mz': 100.0, 'mx': 600.0, 'my': 600.0}
STEP = 1e-3  # of travels and spins, for masses [m], [rad]
# Hz; a guide gives at least as much as lets its wheel vibrate so: rigid links have no stiffness to measure
STIFFEST = 3000.0
PULL, RIGID = 500.0, 3e7  # of the dampers [N]; a mount that is stiffer is none [N/m]
SAME = 1e-6  # m and rad, of an equilibrium found again
# measured changes by the other wheel for a cubic: below five travels, which stiff springs leave, there is a quadratic
ENOUGH = 3 * 5
POWERS = 5  # of the polynomial that is the slope of a damper's length


def require_return(bench: Bench, rest: Stand) -> None:
    """Raises ConsistencyError unless the design position has the equilibrium that it had: what stands on soft rubber
    may have another one, and from far away the bench may have come to that."""
    back = bench.stand()
    if max(np.abs(back.x[c] - rest.x[c]).max() for c in CORNERS) > SAME * max(1.0, bench.size.length):
        raise ConsistencyError(
            'the bench of the level kc found another equilibrium of the vehicle after its travels than before; use '
            'condensed or full'
        )


def measured(spec: ModelSpec, progress: Callable[[float], None] = lambda done: None) -> dict[str, Any]:
    """Everything that the level kc needs to know of a vehicle, as lists and numbers: by axle the fields of a GuideSpec
    that are measured, by corner the mass that moves with 'travel', that between it and the travel of the wheel 'beside'
    [kg], the inertia that turns with 'spin' and its angular 'momentum' at a unit spin [kg m^2]; 'travel', 'steering':
    the range of the maps [m], [rad]; 'coordinates': by name their slopes over the spins of the corners; 'gear':
    'inertia' [kg m^2] that turns with the steering wheel besides itself and the wheels with their carriers, 'lengths':
    by index of a damper without a spring its slope over that turn [m/rad], 'torque': that holds the steering wheel over
    the steering angles [N m].
    """
    every = [(travel * size_of(spec).length, turned) for travel, turned in RANGES]
    for reach in every:
        with suppress(ConsistencyError):
            return _measured(spec, *reach, progress)
    *every, last = _own_ranges(spec)
    for reach in every:
        with suppress(ConsistencyError):
            return _measured(spec, *reach, progress)
    return _measured(spec, *last, progress)


def _own_ranges(spec: ModelSpec) -> list[tuple[float, float]]:
    """(travel [m], angle of the steering wheel [rad]) for a vehicle whose gear is so direct, or whose springs are so
    short, that it reaches none of RANGES: its steering wheel turns as far as its road wheels do by TURNED."""
    rig, steering = Rig(spec), RANGES[-1][1]
    if 'steering' in rig.inputs:
        steers = rig.steering([-STEP, STEP])
        mean = 0.5 * (steers['front_left']['steer'] + steers['front_right']['steer'])
        steering = min(RANGES[0][1], abs(2.0 * STEP * TURNED / float(mean[1] - mean[0])))
    return [(travel * rig.size.length, steering) for travel in TRAVELS]


def _measured(spec: ModelSpec, travel: float, turned: float, progress: Callable[[float], None]) -> dict[str, Any]:
    """The same with maps up to `travel` [m] and `turned` [rad]. Raises ConsistencyError where a place is not
    reached."""
    bench = Bench(spec)
    axles = {axle: (f'{axle}_left', f'{axle}_right') for axle in ('front', 'rear')}
    rest = bench.stand()
    z = np.linspace(-travel, travel, MAP_TRAVEL)
    steering = np.linspace(-turned, turned, MAP_STEERING)
    grid = np.zeros((2, 2, MAP_TRAVEL, MAP_STEERING, len(QUANTITIES)))  # over axle, side
    torque = np.zeros(MAP_STEERING)
    for j, angle in enumerate(steering.tolist()):
        for i in range(MAP_TRAVEL)[:: 1 if j % 2 == 0 else -1]:
            s = bench.stand(steering=angle, **{f'travel_{c}': float(z[i]) for c in CORNERS})
            for a, corners in enumerate(axles.values()):
                for k, corner in enumerate(corners):
                    grid[a, k, i, j] = s.x[corner]
            if i == MAP_TRAVEL // 2:
                torque[j] = s.torque
        progress(0.8 * (j + 1) / MAP_STEERING)
    fine = np.linspace(-travel, travel, FORCE_TRAVEL)
    require_return(bench, rest)
    against = np.full((2, 2, MAP_TRAVEL, len(QUANTITIES)), np.nan)
    for i in np.flatnonzero(np.abs(z) < 1.001 * ROLL * bench.size.length).tolist():
        v = float(z[i])
        for k, sign in enumerate(SIDES.values()):
            s = bench.stand(**{f'travel_{c}': sign * SIDES[c.partition('_')[2]] * v for c in CORNERS})
            for a, corners in enumerate(axles.values()):
                against[a, k, i] = s.x[corners[k]]
    apart = _steered_apart(bench, z, steering, grid, against)
    alone = {corner: [bench.stand(**{f'travel_{corner}': float(v)}) for v in fine] for corner in CORNERS}
    loaded = loaded_position(spec)
    leant = {
        axle: where_it_stands(bench, fine, alone, corners, loaded.get(f'travel_{corners[0]}'))
        for axle, corners in axles.items()
    }
    require_return(bench, rest)
    progress(0.9)
    try:
        compliance, mounts, masses = _compliance(bench, loaded), _mounts(spec, rest), _masses(bench, rest)
        turning, gear = _driven(bench), _gear(bench)
    except ConsistencyError as error:  # that is the same within any range
        raise SpecError(
            f'the bench finds no equilibrium of the vehicle under loads at its wheels ({error}); use full'
        ) from error
    result: dict[str, Any] = {
        'coordinates': turning,
        'gear': gear | {'torque': torque.tolist()},
        'travel': travel,
        'steering': turned,
    }
    for a, (axle, corners) in enumerate(axles.items()):
        steered = bool(
            np.abs(grid[a, :, :, :, 2] - grid[a, :, :, MAP_STEERING // 2 : MAP_STEERING // 2 + 1, 2]).max() > 1e-3
        )
        found = _axle(corners, z, steering, grid[a], against[a], apart[a], fine, alone, steered, leant[axle])
        result[axle] = found | compliance[axle] | {'mounts': mounts}
    for corner in CORNERS:
        result[corner] = masses[corner]
    progress(1.0)
    return result


def _steered_apart(
    bench: Bench, z: np.ndarray, steering: np.ndarray, grid: np.ndarray, against: np.ndarray
) -> np.ndarray:
    """(2, 2, 5) over axle, side: b_6, what the travel of the other wheel adds to the slopes over the steering. With
    both at the same travel it is part of the slopes of the grid, so at the opposite one they differ from those by twice
    as much."""
    found = np.zeros((2, 2, len(QUANTITIES)))
    n, middle = len(z) // 2, len(steering) // 2
    for up in (-ROLLED, ROLLED):
        for turn in (-STEERED, STEERED):
            angle = float(steering[middle + turn])
            s = bench.stand(
                steering=angle, **{f'travel_{c}': SIDES[c.partition('_')[2]] * float(z[n + up]) for c in CORNERS}
            )
            for a, axle in enumerate(('front', 'rear')):
                for k, (side, sign) in enumerate(SIDES.items()):
                    i = n + round(sign) * up
                    alike = grid[a, k, i, middle + turn] - grid[a, k, i, middle]
                    found[a, k] -= (s.x[f'{axle}_{side}'] - against[a, k, i] - alike) / (8.0 * float(z[i]) * angle)
    return found


def _axle(
    corners: Sequence[str],
    z: np.ndarray,
    steering: np.ndarray,
    grid: np.ndarray,
    against: np.ndarray,
    apart: np.ndarray,
    fine: np.ndarray,
    alone: dict[str, list[Stand]],
    steered: bool,
    leant: Sequence[OtherWheel] = NO_INFLUENCE,
) -> dict[str, Any]:
    """Maps, springs and dampers of an axle; grid (2, travel, steering, 5) with both wheels at the same travel, against
    (2, travel, 5) with the other wheel at the opposite one, apart (2, 5) of _steered_apart(), leant by wheel what the
    other one does to it where it stands."""
    middle = grid.shape[2] // 2
    every = (len(fine) - 1) // (len(z) - 1)
    loads = [np.array([s.load[corner] for s in alone[corner]]) for corner in corners]
    usual = np.all(
        [
            (FITTED_LOADS[0] * load[len(load) // 2] <= load) & (load <= FITTED_LOADS[1] * load[len(load) // 2])
            for load in loads
        ],
        axis=0,
    )
    # of the stiffest car at least the nodes beside the middle
    usual[len(fine) // 2 - every : len(fine) // 2 + every + 1] = True
    own = [np.array([s.x[corners[k]] for s in alone[corners[k]]]) for k in range(2)]
    other = [np.array([s.x[corners[1 - k]] for s in alone[corners[k]]]) for k in range(2)]
    shape, opposite = [], []
    for k in range(2):
        beside = other[1 - k][::every]  # this wheel held, the other one at z
        rows = np.concatenate([terms(s, o) for s, o in ((0.0 * z, z), (z, z), (z, -z))])
        changes = [beside - beside[len(z) // 2], grid[k, :, middle] - own[k][::every], against[k] - own[k][::every]]
        known = np.tile(np.isfinite(against[k, :, 0]) & (usual & usual[::-1])[::every], 3)  # as far to either side
        b, n = np.zeros((BESIDE, 5)), 6 if np.add.reduce(known) >= ENOUGH else 3
        rows = np.concatenate([rows[known], leant[k].terms])[:, :n]
        b[:n] = least_squares(rows, np.concatenate([np.concatenate(changes)[known], leant[k].change]))
        b[6] = apart[k] if steered else 0.0
        alone_here = grid[k] - product(terms(z, z), b[:6])[:, None] - (z[:, None] * steering)[:, :, None] * b[6]
        surface = spline(alone_here)
        if steered:
            surface = spline(np.moveaxis(surface, 1, 0)).swapaxes(0, 1)
        else:
            surface = surface[:, middle : middle + 1]
        shape += surface.ravel().tolist()
        opposite += b.T.ravel().tolist()
    crossed = [np.array([s.load[corners[1 - k]] for s in alone[corners[k]]]) for k in range(2)]
    n = len(fine) // 2
    cubic = np.column_stack([fine, fine**2, fine**3])[usual]
    coupling = least_squares(np.concatenate([cubic] * 2), np.concatenate([(c - c[n])[usual] for c in crossed]))
    dampers = [_damper(alone[corner], fine, n) for corner in corners]
    torques = [np.array([s.torque for s in alone[corner]]) for corner in corners]
    jacking = [least_squares(cubic, (torque - torque[n])[usual]).tolist() for torque in torques]
    return {
        'shape': shape,
        'opposite': opposite,
        'steered': steered,
        'loads': [load.tolist() for load in loads],
        'coupling': [*coupling.tolist(), 0.0],
        'jacking': jacking[0] + jacking[1],
        'dampers': dampers,
    }


def _damper(stands: Sequence[Stand], travel: np.ndarray, n: int) -> dict[int, list[float]]:
    """By index of a spring-damper the polynomial (POWERS,) that is the slope of its length over the travel, of those
    that move with it."""
    lengths = np.array([s.lengths for s in stands])
    found = {}
    for k in np.flatnonzero(np.abs(lengths - lengths[n]).max(axis=0) > 0.01 * travel[-1]):
        powers = np.column_stack([travel**p / p for p in range(1, POWERS + 1)])
        found[int(k)] = least_squares(powers, lengths[:, k] - lengths[n, k]).tolist()
    return found


def _mounts(spec: ModelSpec, rest: Stand) -> list[float]:
    """By spring-damper the stiffness [N/m] of what a damper stands on, 0 for none: its pull over what it shortens."""
    size = size_of(spec)
    pull, rigid = PULL * size.mass, RIGID * size.stiffness
    pulled = tuple(e.replace(preload=e.preload + pull) if e.damper is not None else e for e in spec.spring_dampers)
    lengths = Bench(dataclasses.replace(spec, spring_dampers=pulled)).stand().lengths
    return [pull / x if x > pull / rigid else 0.0 for x in (rest.lengths - lengths).tolist()]


def _compliance(bench: Bench, at: Mapping[str, float]) -> dict[str, dict[str, Any]]:
    """By axle 'compliance' (8, 8) of x, y, psi, gamma left and right, 'by_brake' (2, 8) of them by a moment about the
    spin axis, 'winding' (2,) of the carriers about it by that moment [rad/(N m)]; at: travels, by input of the
    bench."""
    rest, scale = bench.stand(**at), {'c': bench.size.mass, 'm': bench.size.torque}  # of forces, of moments
    found = {}
    for axle in ('front', 'rear'):
        corners = [f'{axle}_{side}' for side in SIDES]
        response = np.zeros((10, 10))
        for k, corner in enumerate(corners):
            b = bench.wheels[corner]
            a = matrix(tuple(rest.q[b, 3:]))[:, 1]
            p, g = np.array([-a[2] * a[0], -a[2] * a[1], 1.0]), np.array([a[1], -a[0], 0.0])
            # generalized forces of the loads: moments along psi, gamma and the spin axis
            moments = np.array([[p[2], g[2], a[2]], [p[0], g[0], a[0]], [p[1], g[1], a[1]]]).T  # columns mz, mx, my
            to_loads = np.zeros((5, 5))
            to_loads[:2, :2] = np.eye(2)
            to_loads[2:, 2:] = inverse(moments)
            columns = np.zeros((10, 5))
            for m, (load, size) in enumerate((name, value * scale[name[0]]) for name, value in LOADS.items()):
                high, low = (
                    bench.stand(**at, **{f'{load}_{corner}': size}),
                    bench.stand(**at, **{f'{load}_{corner}': -size}),
                )
                columns[:, m] = np.concatenate([high.x[c] - low.x[c] for c in corners]) / (2.0 * size)
            response[:, 5 * k : 5 * k + 5] = product(columns, to_loads)
        response = 0.5 * (response + response.T)  # reciprocity
        d, w = [0, 1, 2, 3, 5, 6, 7, 8], [4, 9]
        found[axle] = {
            'compliance': response[np.ix_(d, d)].tolist(),
            'by_brake': response[np.ix_(w, d)].tolist(),
            'winding': response[np.ix_(w, w)].diagonal().tolist(),
        }
    return found


def _moved(low: np.ndarray, high: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray]:
    """(velocities (nb, 3), rotations in B (nb, 3)) of all bodies per unit between two configurations."""
    a, b = low[:-1], high[:-1]
    sign = np.where(np.add.reduce(a[:, 3:] * b[:, 3:], axis=1) < 0.0, -1.0, 1.0)[:, None]
    v, w = a[:, 3:6], sign * b[:, 3:6]
    turn = 2.0 * (a[:, 6:] * w - sign * b[:, 6:] * v - np.cross(v, w))
    return (b[:, :3] - a[:, :3]) / width, turn / width


def _masses(bench: Bench, rest: Stand) -> dict[str, dict[str, float]]:
    """By corner the mass that its travel moves, that between it and the travel of the other wheel, and the inertia that
    its spin turns: twice the kinetic energies at unit rates, where the wheels of an axle spin together and share what
    turns with both; and its angular momentum at a unit spin."""
    bodies, travel_step = bench.rig.model.tables.bodies, STEP * bench.size.length
    found = {}

    def moving(*corners: str) -> float:
        low, high = (
            bench.stand(**{f'travel_{corner}': step for corner in corners}) for step in (-travel_step, travel_step)
        )
        v, w = _moved(low.q, high.q, 2.0 * travel_step)
        w[list(bench.wheels.values()), 1] = 0.0  # wheels do not turn with their carriers
        return float(np.add.reduce(bodies.mass * np.add.reduce(v * v, axis=1)) + _turning(bodies.inertia, w))

    for corner in CORNERS:
        axle = corner.partition('_')[0]
        travel = moving(corner)
        spins = {f'spin_{axle}_{side}': STEP for side in SIDES}
        low, high = bench.stand(**{name: -angle for name, angle in spins.items()}), bench.stand(**spins)
        v, w = _moved(low.q, high.q, 2.0 * STEP)
        spin = 0.5 * float(np.add.reduce(bodies.mass * np.add.reduce(v * v, axis=1)) + _turning(bodies.inertia, w))
        axis = matrix(tuple(rest.q[bench.wheels[corner], 3:]))[:, 1]
        momentum = 0.5 * float(product(axis, np.add.reduce(_momenta(bench, rest.q, w))))
        found[corner] = {'travel': travel, 'spin': spin, 'momentum': momentum}
    for axle in ('front', 'rear'):
        corners = [f'{axle}_{side}' for side in SIDES]
        beside = 0.5 * (moving(*corners) - sum(found[corner]['travel'] for corner in corners))
        for corner in corners:
            found[corner]['beside'] = beside
    return found


def _momenta(bench: Bench, q: np.ndarray, w: np.ndarray) -> np.ndarray:
    """(nb, 3) angular momenta [kg m^2] of all bodies about their centres of mass by rotations w (nb, 3) in B, in the
    design frame."""
    inertia = bench.rig.model.tables.bodies.inertia
    return np.array(
        [product(matrix(tuple(at[3:])), product(J, turn)) for at, J, turn in zip(q[:-1], inertia, w, strict=True)]
    )


def _gear(bench: Bench) -> dict[str, Any]:
    """Data of the steering gear, see measured()."""
    spec, names = bench.spec, bench.rig.model.body_names
    low, high = bench.stand(steering=-STEP), bench.stand(steering=STEP)
    v, w = _moved(low.q, high.q, 2.0 * STEP)
    bearings = {f'wheel_{c}' for c in CORNERS} | {c.terms[0][0] for c in spec.couplers if c.input is not None}
    ends = {end.body for joint in spec.joints if joint.name in bearings for end in (joint.i, joint.j)}
    apart = [k for k, name in enumerate(names) if name in ends]
    v[apart], w[apart] = 0.0, 0.0
    bodies = bench.rig.model.tables.bodies
    inertia = float(np.add.reduce(bodies.mass * np.add.reduce(v * v, axis=1)) + _turning(bodies.inertia, w))
    slopes = ((high.lengths - low.lengths) / (2.0 * STEP)).tolist()
    moved = [
        k
        for k, e in enumerate(spec.spring_dampers)
        if e.spring is None and e.damper is not None and abs(slopes[k]) > 1e-6 * bench.size.length
    ]
    return {'inertia': inertia, 'lengths': {k: slopes[k] for k in moved}}


def _turning(inertia: np.ndarray, w: np.ndarray) -> float:
    return float(np.add.reduce(np.add.reduce(w * np.add.reduce(inertia * w[:, None, :], axis=2), axis=1)))


def _driven(bench: Bench) -> dict[str, dict[str, float]]:
    """By name the slopes of joint coordinates over the spins of the corners, of those that have one."""
    found: dict[str, dict[str, float]] = {}
    for corner in CORNERS:
        low, high = bench.stand(**{f'spin_{corner}': -STEP}), bench.stand(**{f'spin_{corner}': STEP})
        slopes = (high.angles - low.angles) / (2.0 * STEP)
        for name, slope in zip(bench.rig.model.coordinate_names, slopes.tolist(), strict=True):
            if abs(slope) > 1e-6:
                found.setdefault(name, {})[corner] = slope
    if not found:
        raise SpecError('kc: no coordinate turns with the wheels')
    return found
