"""Guide: an axle of two wheels whose places follow smooth maps over travel, travel of the other wheel and steering, and
give elastically.

The effect of arms, links, rubbers and rack on two wheels is a force between them and the chassis; none of these parts
is a body. Of each wheel, relative to the chassis and along its axes:

    x, y    wheel centre from its place in the design position [m]         s = z    travel [m]
    psi     turn of the spin axis about z, arctan(-a_x/a_y) [rad]          gamma    its lift, a_z [-]

The wheel turns about its axis freely. Unloaded it stands at (X, Y, Psi, Gamma)(s, o, sigma), with the travel o of the
other wheel and the rotation sigma that steers; delta (8,) are the departures of both wheels from there. With the energy

    U = 1/2 delta' K delta + spring_l(s_l) + spring_r(s_r) + s_l s_r (c_0 + c_1 (s_l + s_r) + c_2 (s_l^2 + s_r^2) + c_3
        s_l s_r) + sigma (P_l(s_l) + P_r(s_r)) + gear(sigma)

all forces are its gradient: the map carries a load at the wheel to the travel (its slope X_s is the anti-dive of the
wheel centre) and to the steering (its slope over sigma is what the driver feels). P, a cubic without a constant, is the
torque of springs that steering winds up, and what it shifts of their load; the steering gear has springs and dampers of
its own. K lags: it acts on delta + lag d(delta)/dt. A damper of the length L(s) + c o pulls the travel with the force
-F L', and the other wheel of a dependent axle with -F c. It stands on a mount k, which takes the part w = F/k of its
way, an internal state:

    F = law(L' ds/dt + c do/dt - dw/dt),     k = 0: F = law(L' ds/dt + c do/dt)

A brake acts between the wheel and its carrier (the law of solver.elements.brake), whose turn about the spin axis is

    theta = Theta(s, o, sigma) + w' delta

so a braked wheel lifts or lowers the chassis and winds its suspension up. A drive between wheels and what carries them
(a motor in the hub, the differential of a live axle) turns that back alike: of its torque Q on the sum of factors times
the turns of the wheels (the input under the limiter of solver.elements.coordinate_force, which acts on the wheels
themselves) the part -factor Q is on theta. Maps are cubic B-splines, continued linearly, and cubic in o, that of Theta
too:

    Q(s, o, sigma) = Q(s, 0, sigma) + o (b_0 + b_1 s + b_2 o + b_3 s^2 + b_4 s o + b_5 o^2 + b_6 sigma)

All is measured on a bench: solver.levels.kc.

Tangents are exact at rest, and over velocities; left out is how rates change with the position, which is of the order
of rate times lag, and what a limiter that fades takes from theta.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.dimensions import Point, Stiffness, Time, TurnDamping, TurnStiffness
from solver.elements.brake import HOLD, RELEASED
from solver.elements.guide_forces import DRIVES, guide_forces
from solver.elements.guide_map import BESIDE, COLUMNS, QUANTITIES, Nodes
from solver.elements.kind import ForceKind, Held
from solver.elements.laws import Law
from solver.elements.marker import Context, Marker, Spec, slots
from solver.validate import Vector, finite, require

SIDES = ('left', 'right')
OUTPUTS = {
    'energy': 'J',
    'dissipation': 'W',
    **{
        f'{name}_{side}': unit
        for side in SIDES
        for name, unit in (('steer', 'rad'), ('camber', ''), ('spring_force', 'N'))
    },
    **{
        f'{name}_{side}': unit
        for side in SIDES
        for name, unit in (('damper_force', 'N'), ('windup', 'rad'), ('brake_torque', 'N m'))
    },
    'steering_torque': 'N m',
    'gear_torque': 'N m',
}
STATES = 4
SYMMETRIC = 1e-9  # relative: what rounding may leave of the difference of a stiffness and its transpose


@dataclass(frozen=True, kw_only=True)
class GuideSpec(Spec):
    """The guide of an axle; made by the level kc of a vehicle, see the module.

    chassis, left, right: bodies; the reference frames of the wheels are at their centres of mass, which are the wheel
    centres. centers: these in the chassis, in the design position [m]. axes: spin axes in the wheels. travel, steering:
    nodes (first, step, count) of the maps [m], [unit of the coordinate]. shape: coefficients of the maps, over side,
    travel, steering, quantity (x, y, psi, gamma, theta); opposite: b_0 ... b_6 over side, quantity. coordinate: the
    rotation that steers. stiffness: K (8, 8) over (x, y, psi, gamma) of left and right. lag [s]. windup: w over side,
    (8,). springs: force against travel of either side; coupling: c_0 ... c_3; jacking: coefficients of P over side.
    gear: laws of the torque of springs over the coordinate, of dampers over its rate [N m]. dampers: laws of either
    side; ratios: coefficients of the powers of s in L', over side; crossings: c of either side. mounts: their k [N/m],
    0 for none; yields: with a mount the inverse of the damper's law, rate over force. wheels: coordinates of the
    turning wheels, to show the brake torque at. input: of the brakes; shares of either wheel in it; brake_stiffness [N
    m/rad], brake_damping [N m s/rad] of a stuck wheel. drive: input of what drives the wheels from their carriers [N
    m]; drives: up to two, (factor of the left wheel, of the right one, gain of the input, rate at which it ends [rad/s]
    or 0).
    """

    chassis: str
    left: str
    right: str
    centers: tuple[Point, Point]
    axes: tuple[Vector, Vector] = ((0.0, 1.0, 0.0), (0.0, 1.0, 0.0))
    travel: tuple[float, float, int]
    steering: tuple[float, float, int] = (0.0, 1.0, 1)
    shape: tuple[float, ...]
    opposite: tuple[float, ...] = (0.0,) * 10 * BESIDE
    coordinate: str | None = None
    stiffness: tuple[float, ...]
    lag: Time = 0.0
    windup: tuple[float, ...] = (0.0,) * 16
    springs: tuple[Law, Law]
    coupling: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    jacking: tuple[float, ...] = (0.0,) * 6
    gear: tuple[Law | None, Law | None] = (None, None)
    dampers: tuple[Law, Law]
    ratios: tuple[float, ...]
    crossings: tuple[float, float] = (0.0, 0.0)
    mounts: tuple[Stiffness, Stiffness] = (0.0, 0.0)
    yields: tuple[Law, Law] | None = None
    wheels: tuple[str, str]
    input: str
    shares: tuple[float, float]
    brake_stiffness: TurnStiffness
    brake_damping: TurnDamping = 0.0
    drive: str | None = None
    drives: tuple[tuple[float, float, float, float], ...] = ()

    def __post_init__(self) -> None:
        where = self.where
        for name, nodes in (('travel', self.travel), ('steering', self.steering)):
            require(nodes[1] > 0.0 and nodes[2] >= 1, where, name, nodes, 'must be (first, step > 0, count >= 1)')
        require(self.travel[2] > 1, where, 'travel', self.travel, 'needs two nodes or more')
        require(
            self.coordinate is not None or self.steering[2] == 1, where, 'steering', self.steering, 'needs a coordinate'
        )
        require(self.coordinate is not None or not any(self.gear), where, 'gear', self.gear, 'needs a coordinate')
        count = 2 * Nodes(*self.travel).coefficients * Nodes(*self.steering).coefficients * len(QUANTITIES)
        lengths = {'shape': count, 'opposite': 10 * BESIDE, 'stiffness': 64, 'windup': 16, 'jacking': 6, 'ratios': 10}
        for name, length in lengths.items():
            values = getattr(self, name)
            require(len(values) == length, where, name, len(values), f'must be {length} numbers')
            self.set(name, tuple(finite(where, name, v) for v in values))
        K = np.array(self.stiffness).reshape(8, 8)
        apart, largest = float(np.abs(K - K.T).max()), float(np.abs(K).max())
        require(
            apart <= SYMMETRIC * largest,
            where,
            'stiffness',
            apart,
            'is how far it is from its transpose; it must be symmetric',
        )
        self.set('crossings', tuple(finite(where, 'crossings', c) for c in self.crossings))
        self.set('mounts', tuple(finite(where, 'mounts', k, low=0.0) for k in self.mounts))
        require(self.yields is not None or not any(self.mounts), where, 'yields', self.yields, 'is needed with mounts')
        self.set('lag', finite(where, 'lag', self.lag, low=0.0))
        self.set('brake_stiffness', finite(where, 'brake_stiffness', self.brake_stiffness, low=0.0, strict=True))
        self.set('brake_damping', finite(where, 'brake_damping', self.brake_damping, low=0.0))
        require(len(self.drives) <= DRIVES, where, 'drives', len(self.drives), f'must be {DRIVES} at most')
        require(self.drive is not None or not self.drives, where, 'drive', self.drive, 'is needed with drives')
        self.set('drives', tuple(tuple(finite(where, 'drives', x) for x in one) for one in self.drives))


class GuideTable(NamedTuple):
    """Columns of all guides. Bodies are chassis, left, right, and the two of the steering coordinate (the world without
    one)."""

    body: np.ndarray  # (n, 5)
    slot: np.ndarray  # (n, 5, 5)
    # (2 n, 3) wheel centres in the design position from the centre of mass of the chassis, along its axes [m]
    origin: np.ndarray
    axis: np.ndarray  # (2 n, 3) spin axes in the wheels
    nodes: np.ndarray  # (n, 4) first and step of travel and steering
    number: np.ndarray  # (n, 2) of them
    start: np.ndarray  # (2 n,) first row in shape of either side
    shape: np.ndarray  # (rows, COLUMNS)
    opposite: np.ndarray  # (2 n, 5, 7)
    steering: np.ndarray  # (n,) coordinate, -1 for none
    K: np.ndarray  # (n, 8, 9), its last column empty (solver.compiled.rows)
    lag: np.ndarray  # (n,)
    windup: np.ndarray  # (2 n, 8)
    law: np.ndarray  # (2 n, 3) spring, damper, its inverse
    gear: np.ndarray  # (n, 2) laws of springs and dampers of the steering
    mount: np.ndarray  # (2 n,)
    coupling: np.ndarray  # (n, 4)
    jacking: np.ndarray  # (2 n, 3)
    ratio: np.ndarray  # (2 n, 5)
    crossing: np.ndarray  # (2 n,)
    coordinate: np.ndarray  # (n, 3) that efforts are shown at: the turning wheels, steering
    state: np.ndarray  # (n,) wind-up of the left brake; that of the right one and both mounts follow
    input: np.ndarray  # (n,)
    gain: np.ndarray  # (n, 2)
    stiffness: np.ndarray  # (n,) of a stuck brake
    damping: np.ndarray  # (n,)
    drive: np.ndarray  # (n,) input
    drives: np.ndarray  # (DRIVES n, 4), zeros for those that there are not


def _padded(values: Sequence[float], columns: int, wanted: int) -> np.ndarray:
    """Rows of so many columns as rows of more, zeros in the new ones."""
    return np.pad(np.array(values, float).reshape(-1, columns), ((0, 0), (0, wanted - columns)))


def compile_guides(specs: Sequence[GuideSpec], context: Context) -> GuideTable:
    """Resolve names and laws into a table."""
    n = len(specs)
    rows = [Nodes(*s.travel).coefficients * Nodes(*s.steering).coefficients for s in specs for _ in SIDES]
    table = GuideTable(
        body=np.full((n, 5), context.n_bodies, np.int64),
        slot=np.zeros((n, 5, 5), np.int64),
        origin=np.zeros((2 * n, 3)),
        axis=np.array([a for s in specs for a in s.axes], float).reshape(-1, 3),
        nodes=np.array([[*s.travel[:2], *s.steering[:2]] for s in specs], float).reshape(-1, 4),
        number=np.array([[s.travel[2], s.steering[2]] for s in specs], np.int64).reshape(-1, 2),
        start=np.array([0, *np.cumsum(rows)[:-1]] if rows else [], np.int64),
        shape=_padded([v for s in specs for v in s.shape], len(QUANTITIES), COLUMNS),
        opposite=np.array([s.opposite for s in specs], float).reshape(2 * n, 5, BESIDE),
        steering=np.full(n, -1, np.int64),
        K=_padded([v for s in specs for v in s.stiffness], 8, 9).reshape(-1, 8, 9),
        lag=np.array([s.lag for s in specs], float),
        windup=np.array([s.windup for s in specs], float).reshape(-1, 8),
        law=np.zeros((2 * n, 3), np.int64),
        gear=np.array([[context.law(law) for law in s.gear] for s in specs], np.int64).reshape(-1, 2),
        mount=np.array([k for s in specs for k in s.mounts], float),
        coupling=np.array([s.coupling for s in specs], float).reshape(-1, 4),
        jacking=np.array([s.jacking for s in specs], float).reshape(-1, 3),
        ratio=np.array([s.ratios for s in specs], float).reshape(-1, 5),
        crossing=np.array([c for s in specs for c in s.crossings], float),
        coordinate=np.full((n, 3), -1, np.int64),
        state=np.zeros(n, np.int64),
        input=np.zeros(n, np.int64),
        gain=np.array([s.shares for s in specs], float).reshape(-1, 2),
        stiffness=np.array([s.brake_stiffness for s in specs], float),
        damping=np.array([s.brake_damping for s in specs], float),
        drive=np.zeros(n, np.int64),
        drives=np.array(
            [s.drives[k] if k < len(s.drives) else (0.0,) * 4 for s in specs for k in range(DRIVES)], float
        ).reshape(-1, 4),
    )
    for e, spec in enumerate(specs):
        chassis = context.marker(spec.where, Marker(body=spec.chassis))
        table.body[e, 0] = chassis.body
        for k, name in enumerate((spec.left, spec.right)):
            wheel = context.marker(spec.where, Marker(body=name))
            require(not wheel.r.any(), spec.where, SIDES[k], name, 'must have its centre of mass at its origin')
            table.body[e, 1 + k] = wheel.body
            table.origin[2 * e + k] = chassis.r + spec.centers[k]
            yields = None if spec.yields is None else spec.yields[k]
            table.law[2 * e + k] = context.law(spec.springs[k]), context.law(spec.dampers[k]), context.law(yields)
            table.coordinate[e, k] = context.coordinate(spec.where, spec.wheels[k])
        if spec.coordinate is not None:
            table.steering[e] = context.coordinate(spec.where, spec.coordinate)
            table.coordinate[e, 2] = table.steering[e]
            table.body[e, 3:] = context.coordinate_bodies(int(table.steering[e]))
        table.slot[e] = slots(table.body[e].tolist(), context)
        table.state[e] = context.internal_states(spec.where, STATES)
        table.input[e] = context.input(spec.where, spec.input)
        table.drive[e] = table.input[e] if spec.drive is None else context.input(spec.where, spec.drive)
    return table


def held_guides(table: GuideTable, u: np.ndarray) -> Held:
    """Brakes hold in the search for static equilibrium, those that are released softly: see
    solver.elements.brake.held_brakes."""
    capacity = guide_capacities(table, u)
    released = (capacity == 0.0).all(axis=1)
    soft = table._replace(
        stiffness=np.where(released, RELEASED * table.stiffness, table.stiffness),
        damping=np.where(released, 0.0, table.damping),
    )
    inputs = u.copy()
    inputs[table.input] = HOLD
    limits = capacity / table.stiffness[:, None]
    return Held(soft, inputs, {int(n) + k: float(limits[e, k]) for e, n in enumerate(table.state) for k in range(2)})


def guide_capacities(table: GuideTable, u: np.ndarray) -> np.ndarray:
    """(n, 2) largest torques of the brakes [N m] under the inputs u (nu,)."""
    return np.maximum(table.gain * u[table.input][:, None], 0.0)


GUIDES = ForceKind(
    name='guides',
    spec=GuideSpec,
    compile=compile_guides,
    kernel=guide_forces,
    outputs=OUTPUTS,
    effort=('brake_torque_left', 'brake_torque_right', 'gear_torque'),
    held=held_guides,
    capacities=guide_capacities,
)
