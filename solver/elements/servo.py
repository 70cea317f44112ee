"""Servo: a motor that helps where a hand turns against an elastic member, as electric power steering does at its torsion bar.

    s = factor_1 x_1 + factor_2 path(x_2)         wind-up of the member; path: that of solver.elements.transmission
    T = stiffness s + damping ds/dt               torque that its sensor measures
    lag dz/dt = held(map(T, |v|), limit) - z      v: forward speed of the body of the marker
    Q = z                                         generalized force on the coordinate

The map is odd in T and zero without it: at each of its speeds the monotone cubic through its points (solver.elements.laws), linear
between the speeds, and beyond the last speed that of the last. The force is held smoothly at its limit (solver.elements.smooth). The
power that the motor supplies is negative dissipation; it stores nothing.

An inertia J behind a member with stiffness k and damping c, helped with the gain g, swings by J s^2 + (k + c s) (1 + g / (1 + lag s)) = 0.
By Routh's criterion that dies out at every gain if lag < c / k. Without the damping in what is measured, which is the phase lead of a
controller, it would only up to a gain that good steering needs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from solver.compiled.kernel import kernel, sixes
from solver.compiled.vec import col, cross, dot, load33, mv, scale, tmv
from solver.elements.coordinate import (
    add6,
    add_coordinate_hessian,
    add_dyad,
    add_gradient,
    coordinate_rate,
    coordinate_rate_gradient,
    evaluate_coordinate,
    scale6,
)
from solver.elements.kind import ForceKind
from solver.elements.law_map import evaluate_map
from solver.elements.laws import Law
from solver.elements.marker import Context, Marker, Spec, slots
from solver.elements.point_pair import linear_velocity
from solver.elements.smooth import held, held_slope
from solver.elements.transmission import path_of
from solver.validate import finite, require, require_grid, require_rising, vector

OUTPUTS = {'energy': 'J', 'dissipation': 'W', 'torque': 'N m', 'speed': 'm/s', 'rate': 'm/s or rad/s', 'force': 'N or N m'}
BODIES = 7  # of the coordinate (2), of the two terms (4), and of the marker


def require_map(where: str, speeds: Sequence[float], torques: Sequence[float], forces: Sequence[Sequence[float]]) -> None:
    """Check a map of forces over speeds (rows) and torques (columns). Raises SpecError."""
    require_rising(where, 'speeds', speeds)
    require_rising(where, 'torques', torques)
    finite(where, 'speeds[0]', speeds[0], low=0.0)
    finite(where, 'torques[0]', torques[0], low=0.0, strict=True)
    require_grid(where, 'forces', forces, ('speeds', len(speeds)), ('torques', len(torques)))
    for k, row in enumerate(forces):
        for m, force in enumerate(row):
            finite(where, f'forces[{k}][{m}]', force, low=0.0)


@dataclass(frozen=True, kw_only=True)
class ServoSpec(Spec):
    """A motor on a joint coordinate; see the module for the formula.

    coordinate: what it moves. terms: two (coordinate name, factor), whose sum is the wind-up; the second may be a rotation behind universal
    joints with the harmonics a_2, b_2, a_4, b_4 [rad] of solver.elements.transmission. stiffness [N m/rad] > 0 and damping [N m s/rad] of
    the member. marker: whose body's speed counts, along its x axis. speeds [m/s] and torques [N m], rising, torques above 0; forces: for
    each speed those at the torques [N or N m]. limit: largest force [N or N m]; lag: time constant of the motor [s], both > 0.
    """

    coordinate: str
    terms: tuple[tuple[str, float], ...]
    harmonics: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    stiffness: float
    damping: float = 0.0
    marker: Marker
    speeds: Annotated[tuple[float, ...], 'm/s']
    torques: tuple[float, ...]
    forces: tuple[tuple[float, ...], ...]
    limit: float
    lag: float

    def __post_init__(self) -> None:
        require(len(self.terms) == 2, self.where, 'terms', self.terms, 'needs two [coordinate, factor] pairs')
        self.set('terms', tuple((str(c), finite(self.where, f'factor of {c}', f)) for c, f in self.terms))
        self.set('harmonics', vector(self.where, 'harmonics', self.harmonics, 4))
        for field in ('stiffness', 'limit', 'lag'):
            self.set(field, finite(self.where, field, getattr(self, field), low=0.0, strict=True))
        self.set('damping', finite(self.where, 'damping', self.damping, low=0.0))
        require_map(self.where, self.speeds, self.torques, self.forces)

    def law(self, row: int) -> Law:
        """Force over torque at a speed of the map."""
        points = list(zip(self.torques, self.forces[row], strict=True))
        return Law.table([(-x, -y) for x, y in reversed(points)] + [(0.0, 0.0), *points], self.where, 'forces')

    def at_speed(self, speed: float) -> ServoSpec:
        """The servo as it acts at a speed [m/s], at every speed."""
        forces = tuple(float(np.interp(speed, self.speeds, column)) for column in zip(*self.forces, strict=True))
        return self.replace(speeds=(0.0,), forces=(forces,))


class ServoTable(NamedTuple):
    """Columns of all servos; body: i and j of the coordinate, of the first and of the second term, and of the marker."""

    coordinate: np.ndarray  # (n,) what it moves
    term: np.ndarray  # (n, 2) coordinates of the wind-up
    share: np.ndarray  # (n, 2) their factors
    harmonics: np.ndarray  # (n, 4)
    stiffness: np.ndarray  # (n,)
    damping: np.ndarray  # (n,)
    forward: np.ndarray  # (n, 3, 3) axes of the marker in its body
    start: np.ndarray  # (n + 1,) rows of the map of servo e: start[e]:start[e + 1]
    speed: np.ndarray  # (m,)
    law: np.ndarray  # (m,)
    limit: np.ndarray  # (n,)
    lag: np.ndarray  # (n,)
    chord: np.ndarray  # (n,) whether tangents are at least those of the chord to the origin (approach)
    state: np.ndarray  # (n,) internal state: the force of the motor
    body: np.ndarray  # (n, 7)
    slot: np.ndarray  # (n, 7, 7) block (row body, column body)


def compile_servos(specs: Sequence[ServoSpec], context: Context) -> ServoTable:
    """Resolve names, laws and bodies into a table; one internal state per servo."""
    n = len(specs)
    table = ServoTable(
        coordinate=np.array([context.coordinate(s.where, s.coordinate) for s in specs], np.int64),
        term=np.array([[context.coordinate(s.where, name) for name, _ in s.terms] for s in specs], np.int64).reshape(n, 2),
        share=np.array([[f for _, f in s.terms] for s in specs], float).reshape(n, 2),
        harmonics=np.array([s.harmonics for s in specs], float).reshape(n, 4),
        stiffness=np.array([s.stiffness for s in specs], float),
        damping=np.array([s.damping for s in specs], float),
        forward=np.zeros((n, 3, 3)),
        start=np.cumsum([0, *(len(s.speeds) for s in specs)]).astype(np.int64),
        speed=np.array([speed for s in specs for speed in s.speeds], float),
        law=np.array([context.law(s.law(k)) for s in specs for k in range(len(s.speeds))], np.int64),
        limit=np.array([s.limit for s in specs], float),
        lag=np.array([s.lag for s in specs], float),
        chord=np.zeros(n, np.int64),
        state=np.array([context.internal_states(s.where, 1) for s in specs], np.int64),
        body=np.zeros((n, BODIES), np.int64),
        slot=np.zeros((n, BODIES, BODIES), np.int64),
    )
    for e, spec in enumerate(specs):
        placed = context.marker(spec.where, spec.marker)
        table.forward[e] = placed.R
        used = (table.coordinate[e], *table.term[e])
        table.body[e] = [*(b for k in used for b in context.coordinate_bodies(int(k))), placed.body]
        table.slot[e] = slots(table.body[e].tolist(), context)
    return table


@kernel(borrow=True)
def servo_forces(table, coordinates, laws, kin, angle, zp, cz, u, tangents, f, Kq, Kv, z, out):
    """Accumulate forces and tangents of all servos, assign their states (contract: solver/elements/__init__.py, on coordinates)."""
    f = sixes(f)
    Kq = sixes(Kq)
    Kv = sixes(Kv)
    for e in range(table.coordinate.shape[0]):
        k = table.coordinate[e]
        n = table.state[e]
        b = table.body[e, 6]
        _, g_i, g_j = evaluate_coordinate(coordinates, kin, k, angle)
        x0, g0, g1 = evaluate_coordinate(coordinates, kin, table.term[e, 0], angle)
        x1, g2, g3 = evaluate_coordinate(coordinates, kin, table.term[e, 1], angle)
        v0 = coordinate_rate(coordinates, kin, table.term[e, 0], g0, g1)
        v1 = coordinate_rate(coordinates, kin, table.term[e, 1], g2, g3)
        path, slope, curvature = path_of(table, e, x1)
        first = table.share[e, 0]
        second = table.share[e, 1] * slope
        torque = table.stiffness[e] * (first * x0 + table.share[e, 1] * path) + table.damping[e] * (first * v0 + second * v1)
        R = load33(kin.R, b)
        forward = col(load33(table.forward, e), 0)
        velocity = linear_velocity(kin, b)
        sense = 1.0
        speed = dot(mv(R, forward), velocity)
        if speed.real < 0.0:
            sense = -1.0
        demand, by_torque, by_speed = evaluate_map(laws, table.start, table.speed, table.law, e, torque, sense * speed)
        share = cz / table.lag[e]
        force = (zp[n] + share * held(demand, table.limit[e])) / (1.0 + share)
        add_gradient(force, g_i, table.body[e, 0], f)
        add_gradient(force, g_j, table.body[e, 1], f)
        if tangents:
            steepness = by_torque * held_slope(demand, table.limit[e])
            if table.chord[e] and torque.real != 0.0:
                chord = held(demand, table.limit[e]) / torque
                if chord.real > steepness.real:
                    steepness = chord
            gain = share / (1.0 + share)
            k0, c0 = gain * steepness * table.stiffness[e], gain * steepness * table.damping[e]
            bent = table.share[e, 1] * curvature * v1
            faster = gain * by_speed * held_slope(demand, table.limit[e]) * sense
            h0, h1 = coordinate_rate_gradient(coordinates, kin, table.term[e, 0])
            h2, h3 = coordinate_rate_gradient(coordinates, kin, table.term[e, 1])
            own = (g_i, g_j)
            wound = (scale6(first, g0), scale6(first, g1), scale6(second, g2), scale6(second, g3))
            turning = (
                scale6(first, h0),
                scale6(first, h1),
                add6(scale6(second, h2), scale6(bent, g2)),
                add6(scale6(second, h3), scale6(bent, g3)),
            )
            none = scale(0.0, forward)
            turned = (none, scale(faster, cross(forward, tmv(R, velocity))))
            moved = (scale(faster, mv(R, forward)), none)
            for a in range(2):
                for c in range(4):
                    add_dyad(own[a], add6(scale6(k0, wound[c]), scale6(c0, turning[c])), table.slot[e, a, 2 + c], Kq)
                    add_dyad(own[a], scale6(c0, wound[c]), table.slot[e, a, 2 + c], Kv)
                add_dyad(own[a], turned, table.slot[e, a, 6], Kq)
                add_dyad(own[a], moved, table.slot[e, a, 6], Kv)
            add_coordinate_hessian(coordinates, kin, k, force, Kq)
        rate = coordinate_rate(coordinates, kin, k, g_i, g_j)
        z[n] = force
        out[e, 0] = 0.0
        out[e, 1] = -force * rate
        out[e, 2] = torque
        out[e, 3] = speed
        out[e, 4] = rate
        out[e, 5] = force


def approached(table: ServoTable) -> ServoTable:
    """Servos with which the search for static equilibrium begins. From a wind-up far beyond the limit, where the force does not change any
    more, Newton's method would go to and fro; with the chord, which leads towards the origin, it comes near."""
    return table._replace(chord=np.ones_like(table.chord))


SERVOS = ForceKind(
    name='servos',
    spec=ServoSpec,
    compile=compile_servos,
    kernel=servo_forces,
    outputs=OUTPUTS,
    on_coordinates=True,
    effort='force',
    approach=approached,
)
