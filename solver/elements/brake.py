"""Brake: dry friction with true stick on a rotation coordinate.

A spring and a damper in parallel (wind-up angle z) are in series with a Coulomb slider of capacity T = max(gain * u,
0):

    torque on the coordinate Q = -tau     tau = k z + d zdot     |tau| <= T
    stick: |tau| < T and zdot = omega     slip: tau = +-T, and omega - zdot has the sign of tau

The wind-up z is an internal state. In a stage of the integrator z = zp + cz zdot, with given zp and cz. The kernel
tries tau = k zp + (k cz + d) omega, the torque of a brake that sticks. If that exceeds T, the slider slips until tau =
+-T (return mapping). The result is exact, without a regularised zero crossing: a locked wheel neither creeps nor
chatters.

- |Q| <= T always; T = 0 gives Q = 0 exactly. - The wind-up is bounded: k |z| <= max(T, k |zp|). It decays with the time
constant d/k when the capacity falls. - The energy is E = k z^2/2. With zdot = (z - zp)/cz, as in the stage, Q omega =
-k z zdot - dissipation holds exactly, and
  dissipation = d zdot^2 + tau (omega - zdot) is never negative.
- Tangents are those of the branch taken: dtau/domega = k cz + d in stick, 0 in slip.

With cz = 0 the wind-up is given: z = zp. Without a damper (d = 0) it is clipped to +-T/k. A brake that has slid then
stands at +-T/k but for rounding (SLIDING), and goes on sliding.

While the brake slips, its wind-up follows a change of the capacity within d/k. In a step that is longer than d/k, the
wind-up is mirrored about T/k (by R = -rho_inf). The motion is still that of the capacity, but torque and dissipation at
the end of the steps are those of a swinging wind-up. So a brake has a damper unless `damping: 0` is given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
from solver.dimensions import TurnDamping, TurnStiffness
from solver.elements.coordinate import (
    add_coordinate_hessian,
    add_generalized,
    add_gradient,
    coordinate_rate,
    coordinate_rate_gradient,
    evaluate_coordinate,
)
from solver.elements.instant import sums
from solver.elements.kind import ForceKind, Held
from solver.elements.marker import Context, Spec, slots
from solver.validate import finite

OUTPUTS = {'energy': 'J', 'dissipation': 'W', 'windup': 'rad', 'rate': 'rad/s', 'torque': 'N m', 'capacity': 'N m'}
HOLD = 1e9  # input of all brakes in the search for equilibrium [N m per unit of gain]: larger than any capacity
# Time [s] in which the wind-up relaxes where no damping is given: a few steps of usual length. Ten times as much would
# delay the brake visibly.
RELAXATION = 2e-3
# torque, relative to the capacity, from which on a brake slides if cz = 0 and d = 0: rounding of T/k
SLIDING = 1.0 - 1e-9
RELEASED = 1e-6  # stiffness of a released brake in the search for equilibrium, relative to its own stiffness


def damping_of(where: str, stiffness: float, damping: float | None) -> float:
    """Damping of a wind-up [N m s/rad]: the given one, or that of RELAXATION. Raises SpecError if it is negative."""
    return RELAXATION * stiffness if damping is None else finite(where, 'damping', damping, low=0.0)


@dataclass(frozen=True, kw_only=True)
class BrakeSpec(Spec):
    """Brake on a rotation coordinate, with capacity max(gain * u[input] + u[own_input], 0) [N m].

    gain: [N m per unit of the input], not negative. own_input: input of this brake alone [N m]; a negative one reduces
    the capacity from `input`; None: there is none. stiffness [N m/rad], positive, and damping [N m s/rad], not
    negative, of the wind-up while the brake sticks; damping None: the wind-up relaxes within 2 ms.
    """

    coordinate: str
    input: str
    gain: float
    own_input: str | None = None
    stiffness: TurnStiffness
    damping: TurnDamping | None = None

    def __post_init__(self) -> None:
        self.set('gain', finite(self.where, 'gain', self.gain, low=0.0))
        self.set('stiffness', finite(self.where, 'stiffness', self.stiffness, low=0.0, strict=True))
        self.set('damping', damping_of(self.where, self.stiffness, self.damping))


class BrakeTable(NamedTuple):
    """Compiled data of n brakes; see BrakeSpec for units."""

    coordinate: np.ndarray  # (n,) index of the coordinate
    body: np.ndarray  # (n, 2) bodies i and j of the coordinate
    slot: np.ndarray  # (n, 2, 2) matrix block of (row body, column body)
    state: np.ndarray  # (n,) index of the internal state, the wind-up [rad]
    input: np.ndarray  # (n,) index of the input
    own: np.ndarray  # (n,) index of the input of this brake alone, -1: none
    gain: np.ndarray  # (n,)
    stiffness: np.ndarray  # (n,)
    damping: np.ndarray  # (n,)


def compile_brakes(specs: Sequence[BrakeSpec], context: Context) -> BrakeTable:
    """Resolve names into a table, and reserve one internal state per brake."""
    n = len(specs)
    table = BrakeTable(
        coordinate=np.zeros(n, np.int64),
        body=np.zeros((n, 2), np.int64),
        slot=np.zeros((n, 2, 2), np.int64),
        state=np.zeros(n, np.int64),
        input=np.zeros(n, np.int64),
        own=np.full(n, -1, np.int64),
        gain=np.array([s.gain for s in specs], float),
        stiffness=np.array([s.stiffness for s in specs], float),
        damping=np.array([s.damping for s in specs], float),
    )
    for e, spec in enumerate(specs):
        table.coordinate[e] = context.coordinate(spec.where, spec.coordinate)
        bodies = context.coordinate_bodies(int(table.coordinate[e]))
        table.body[e] = bodies
        table.slot[e] = slots(bodies, context)
        table.state[e] = context.internal_states(spec.where, 1)
        table.input[e] = context.input(spec.where, spec.input)
        if spec.own_input is not None:
            table.own[e] = context.input(spec.where, spec.own_input)
    return table


@kernel(inline=True)
def friction(zp, cz, omega, T, k, d):
    """(z, tau, dtau/domega, dissipation) of one brake at the rate omega, by the return mapping of the module
    docstring."""
    stiff = k * cz + d
    tau = k * zp + stiff * omega
    # strictly below the capacity, so that T = 0 is free of stick and of its tangent
    bound = T if stiff > 0.0 else SLIDING * T
    if tau.real < bound and tau.real > -bound:
        return zp + cz * omega, tau, stiff, d * omega * omega
    limit = T if tau.real > 0.0 else -T
    if stiff > 0.0:
        slip = (tau - limit) / stiff
        rate = omega - slip
        return zp + cz * rate, limit + 0.0 * tau, 0.0, d * rate * rate + limit * slip
    # no step and no damper: the slider follows at once; it does not slip while the motion unloads the spring
    loading = limit * omega
    if loading.real < 0.0:
        loading = 0.0 * loading
    return limit / k + 0.0 * tau, limit + 0.0 * tau, 0.0, loading


@kernel(borrow=True)
def brake_forces(table, now, effects, out):
    """Accumulate forces and tangents of all brakes, assign their wind-up (contract: solver/elements/__init__.py)."""
    f, Kq, Kv = sums(effects)
    coordinates, kin, angle = now.coordinates, now.kin, now.angle
    for e in range(table.coordinate.shape[0]):
        c = table.coordinate[e]
        n = table.state[e]
        k = table.stiffness[e]
        _, g_i, g_j = evaluate_coordinate(coordinates, kin, c, angle)
        omega = coordinate_rate(coordinates, kin, c, g_i, g_j)
        T = table.gain[e] * now.u[table.input[e]]
        if table.own[e] >= 0:
            T += now.u[table.own[e]]
        T = max(T, 0.0)
        wound, torque, slope, dissipation = friction(now.zp[n], now.cz, omega, T, k, table.damping[e])
        g = (g_i, g_j)
        for a in range(2):
            add_gradient(-torque, g[a], table.body[e, a], f)
        if now.tangents:
            if slope > 0.0:
                h_i, h_j = coordinate_rate_gradient(coordinates, kin, c)
                add_generalized(g, (h_i, h_j), 2, 0.0, slope, table.slot, e, Kq, Kv)
            add_coordinate_hessian(coordinates, kin, c, -torque, Kq)
        effects.z[n] = wound
        out[e, 0] = 0.5 * k * wound * wound
        out[e, 1] = dissipation
        out[e, 2] = wound
        out[e, 3] = omega
        out[e, 4] = -torque
        out[e, 5] = T


def held_brakes(table: BrakeTable, u: np.ndarray) -> Held:
    """Brakes and inputs in the search for static equilibrium: all brakes hold, or the toe of the wheels would roll the
    car away.

    At the end the wind-up is cut to the capacity under the inputs u (nu,). Released brakes hold softly (RELEASED), so
    that their cut does not matter. Locked firmly, their wheels would carry a part of the load of a suspension that
    moves wheels lengthwise.
    """
    capacity = capacities(table, u)
    released = capacity == 0.0
    soft = table._replace(
        stiffness=np.where(released, RELEASED * table.stiffness, table.stiffness),
        damping=np.where(released, 0.0, table.damping),
    )
    inputs = u.copy()
    inputs[table.input] = HOLD
    return Held(soft, inputs, dict(zip(table.state.tolist(), (capacity / table.stiffness).tolist(), strict=True)))


def capacities(table: BrakeTable, u: np.ndarray) -> np.ndarray:
    """(n,) largest torques of the brakes [N m] under the inputs u (nu,)."""
    return np.maximum(table.gain * u[table.input] + np.where(table.own >= 0, u[table.own], 0.0), 0.0)


BRAKES = ForceKind(
    name='brakes',
    spec=BrakeSpec,
    compile=compile_brakes,
    kernel=brake_forces,
    outputs=OUTPUTS,
    effort='torque',
    held=held_brakes,
    capacities=capacities,
)
