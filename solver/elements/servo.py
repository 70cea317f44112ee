"""Servo: an elastic mesh whose torque a motor amplifies, as torsion bar and motor of an electric power steering do.

The mesh is a spring and a damper between two joint coordinates x_1 and x_2. The motor pushes x_1, with a force z that
follows the measured torque of the mesh with a lag.

    s = factor_1 x_1 + factor_2 path(x_2)         wind-up of the mesh; path: see solver.elements.transmission
    T = stiffness s + damping ds/dt               torque of the mesh, which a sensor measures
    T' = -sgn(factor_1) T                         the same, with the sign with which the mesh pushes x_1
    lag dz/dt = held(map(T', |v|), limit) - z     force z of the motor; v: forward speed of the body of the marker
    Q_1 = z - factor_1 T                          generalized force on x_1
    Q_2 = -factor_2 path'(x_2) T                  generalized force on x_2

The map is odd in T' and zero at T' = 0. At each of its speeds it is the monotone cubic through the points of that speed
(solver.elements.laws). Between two speeds it is linear; beyond the last speed it stays as it is there. held() limits
the force smoothly (solver.elements.smooth). The mesh stores the energy stiffness s^2/2; the power of the motor is
counted as negative dissipation.

Stability: an inertia J behind a mesh of stiffness k and damping c, with the gain g of the motor, has the characteristic
equation J p^2 + (k + c p) (1 + g / (1 + lag p)) = 0. By Routh's criterion it is stable at every gain if lag < c / k.
That is because the sensor sees the damping torque too (the phase lead of a controller); a sensor of k s alone would be
stable only up to a gain that is too small for a good steering.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.vec import col, cross, dot, load33, mv, scale, tmv
from solver.dimensions import Angle, Speed, Time, Torque, TurnDamping, TurnStiffness
from solver.elements.coordinate import add_dyad, add_gradient, scale6
from solver.elements.coordinate_force import OUTPUTS as OF_MESH
from solver.elements.instant import sums
from solver.elements.kind import ForceKind
from solver.elements.law_map import evaluate_map
from solver.elements.laws import Law
from solver.elements.marker import Context, Marker, Spec, slots
from solver.elements.point_pair import linear_velocity
from solver.elements.smooth import held, held_slope
from solver.elements.transmission import add_wind_up, require_wind_up, wind_up
from solver.validate import finite, require, require_grid, require_rising

OUTPUTS = {**OF_MESH, 'speed': 'm/s', 'motor': 'N or N m'}
BODIES = 5  # bodies of a servo: two of each coordinate of the mesh, and the body of the marker


def require_map(
    where: str, speeds: Sequence[float], torques: Sequence[float], forces: Sequence[Sequence[float]]
) -> None:
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
    """An elastic mesh with a motor on its first coordinate; see the module for the formula.

    terms: two (coordinate name, factor), whose sum is the wind-up. harmonics: a_2, b_2, a_4, b_4 [rad] of
    solver.elements.transmission, where the second coordinate is a rotation behind universal joints. stiffness [N
    m/rad], positive, and damping [N m s/rad] of the mesh. marker: the forward speed is that of its body, along the x
    axis of the marker. speeds [m/s] and torques [N m] of the map: both rising, torques positive. forces: a row for each
    speed, with the force at each torque [N or N m]. limit: largest force of the motor [N or N m], positive. lag: time
    constant of the motor [s], positive.
    """

    terms: tuple[tuple[str, float], ...]
    harmonics: tuple[Angle, Angle, Angle, Angle] = (0.0, 0.0, 0.0, 0.0)
    stiffness: TurnStiffness
    damping: TurnDamping = 0.0
    marker: Marker
    speeds: tuple[Speed, ...]
    torques: tuple[Torque, ...]
    forces: tuple[tuple[float, ...], ...]
    limit: float
    lag: Time

    def __post_init__(self) -> None:
        require_wind_up(self)
        first, factor = self.terms[0]
        require(
            factor != 0.0, self.where, f'factor of {first}', factor, 'must not be 0: the motor pushes this coordinate'
        )
        for field in ('stiffness', 'limit', 'lag'):
            self.set(field, finite(self.where, field, getattr(self, field), low=0.0, strict=True))
        self.set('damping', finite(self.where, 'damping', self.damping, low=0.0))
        require_map(self.where, self.speeds, self.torques, self.forces)

    def law(self, row: int) -> Law:
        """Force [N or N m] over torque [N m] at speeds[row]."""
        points = list(zip(self.torques, self.forces[row], strict=True))
        return Law.table([(-x, -y) for x, y in reversed(points)] + [(0.0, 0.0), *points], self.where, 'forces')

    def at_speed(self, speed: float) -> ServoSpec:
        """A servo that acts at every speed as this one does at `speed` [m/s]."""
        forces = tuple(float(np.interp(speed, self.speeds, column)) for column in zip(*self.forces, strict=True))
        return self.replace(speeds=(0.0,), forces=(forces,))


class ServoTable(NamedTuple):
    """Compiled data of n servos; m is the number of speeds of all maps together."""

    # (n, 3) coordinates at which efforts are shown: mesh at x_1, mesh at x_2 (-1 behind universal joints), motor at x_1
    coordinate: np.ndarray
    factor: np.ndarray  # (n, 3) factors of these efforts; the first two are factor_1 and factor_2 of the wind-up
    term: np.ndarray  # (n, 2) indices of the coordinates x_1 and x_2
    harmonics: np.ndarray  # (n, 4)
    stiffness: np.ndarray  # (n,)
    damping: np.ndarray  # (n,)
    forward: np.ndarray  # (n, 3, 3) axes of the marker in its body
    start: np.ndarray  # (n + 1,) the map of servo e has the rows start[e]:start[e + 1] of speed and law
    speed: np.ndarray  # (m,) [m/s]
    law: np.ndarray  # (m,) index of the law of force over torque at this speed
    limit: np.ndarray  # (n,) [N or N m]
    lag: np.ndarray  # (n,) [s]
    chord: np.ndarray  # (n,) 1: the tangent is at least the slope of the line to the origin, see approached()
    state: np.ndarray  # (n,) index of the internal state z, the force of the motor
    body: np.ndarray  # (n, BODIES) i and j of the first coordinate, i and j of the second one, body of the marker
    slot: np.ndarray  # (n, BODIES, BODIES) matrix block of (row body, column body)


def compile_servos(specs: Sequence[ServoSpec], context: Context) -> ServoTable:
    """Resolve the names of coordinates and bodies into a table, and reserve one internal state per servo."""
    n = len(specs)
    term = np.array([[context.coordinate(s.where, name) for name, _ in s.terms] for s in specs], np.int64).reshape(n, 2)
    table = ServoTable(
        coordinate=np.array(
            [[a, -1 if any(s.harmonics) else b, a] for s, (a, b) in zip(specs, term, strict=True)], np.int64
        ).reshape(n, 3),
        factor=np.array([[*(f for _, f in s.terms), 1.0] for s in specs], float).reshape(n, 3),
        term=term,
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
        state=np.array([context.internal_states(s.where, 1, s.limit) for s in specs], np.int64),
        body=np.zeros((n, BODIES), np.int64),
        slot=np.zeros((n, BODIES, BODIES), np.int64),
    )
    for e, spec in enumerate(specs):
        placed = context.marker(spec.where, spec.marker)
        table.forward[e] = placed.R
        table.body[e] = [*(b for k in term[e] for b in context.coordinate_bodies(int(k))), placed.body]
        table.slot[e] = slots(table.body[e].tolist(), context)
    return table


@kernel(borrow=True)
def servo_forces(table, now, effects, out):
    """Accumulate forces and tangents of all servos, assign their states (contract: solver/elements/__init__.py)."""
    f, Kq, Kv = sums(effects)
    coordinates, kin, angle = now.coordinates, now.kin, now.angle
    for e in range(table.term.shape[0]):
        n = table.state[e]
        b = table.body[e, 4]
        value, rate, g, change = wind_up(table, coordinates, kin, angle, e)
        torque = table.stiffness[e] * value + table.damping[e] * rate
        R = load33(kin.R, b)
        forward = col(load33(table.forward, e), 0)
        velocity = linear_velocity(kin, b)
        speed = dot(mv(R, forward), velocity)
        ahead = 1.0 if speed.real >= 0.0 else -1.0
        first = table.factor[e, 0]
        pushing = torque if first < 0.0 else -torque
        demand, by_torque, by_speed = evaluate_map(
            now.laws, table.start, table.speed, table.law, e, pushing, ahead * speed
        )
        share = now.cz / table.lag[e]
        force = (now.zp[n] + share * held(demand, table.limit[e])) / (1.0 + share)
        # Q_1 here is the force of mesh and motor on x_1, divided by factor_1
        Q_1 = force / first - torque
        for a in range(2):
            add_gradient(Q_1, g[a], table.body[e, a], f)
            add_gradient(-torque, g[2 + a], table.body[e, 2 + a], f)
        if now.tangents:
            followed = held_slope(demand, table.limit[e])
            steepness = by_torque * followed
            if table.chord[e] and pushing.real != 0.0:
                chord = held(demand, table.limit[e]) / pushing
                if chord.real > steepness.real:
                    steepness = chord
            gain = share / (1.0 + share)
            helped = 1.0 + gain * steepness / abs(first)
            rows = (scale6(helped, g[0]), scale6(helped, g[1]), g[2], g[3])
            add_wind_up(
                table, coordinates, kin, e, rows, g, change, Q_1, -torque, table.stiffness[e], table.damping[e], Kq, Kv
            )
            faster = gain * by_speed * followed * ahead / first
            none = scale(0.0, forward)
            turned = (none, scale(faster, cross(forward, tmv(R, velocity))))
            moved = (scale(faster, mv(R, forward)), none)
            for a in range(2):
                add_dyad(g[a], turned, table.slot[e, a, 4], Kq)
                add_dyad(g[a], moved, table.slot[e, a, 4], Kv)
        effects.z[n] = force
        out[e, 0] = 0.5 * table.stiffness[e] * value * value
        out[e, 1] = table.damping[e] * rate * rate - force * change[0]
        out[e, 2] = value
        out[e, 3] = rate
        out[e, 4] = -torque
        out[e, 5] = speed
        out[e, 6] = force


def approached(table: ServoTable) -> ServoTable:
    """Servos with which the search for static equilibrium begins: the tangent is at least the slope of the chord to the
    origin.

    At a wind-up far beyond the limit the force is constant and the true tangent is zero: Newton's method would
    oscillate. The chord leads it towards the origin.
    """
    return table._replace(chord=np.ones_like(table.chord))


SERVOS = ForceKind(
    name='servos',
    spec=ServoSpec,
    compile=compile_servos,
    kernel=servo_forces,
    outputs=OUTPUTS,
    active=True,
    effort=('force', 'force', 'motor'),
    approach=approached,
)
