"""Adjustable damper: a semi-active damper, whose valve follows a command with a lag.

    s' = sum of factor_k dx_k/dt                         rate of its length, of joint coordinates x_k
    lag dz/dt = u - z                                    valve: 0 is soft, 1 is firm; u: the command, held within 0 and
                                                         1
    Q = -(soft(s') + z (firm(s') - soft(s')))            generalized force; on coordinate k: factor_k Q

Between both characteristics the force is linear in the valve, as of a damper with a proportional valve. The damper
takes energy from the motion at every command as long as soft and firm do: it is no actuator.

In full_car a damper at the front left wheel, over the travel of that wheel, is {terms: {travel_front_left: 1}, ...}:
the travel is a coordinate at full, condensed and kc.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
from solver.dimensions import Time
from solver.elements.coordinate import add_coordinate_hessian, add_generalized, add_gradient
from solver.elements.coordinate_force import checked_terms, compile_combinations, rate_gradient, term
from solver.elements.instant import sums
from solver.elements.kind import ForceKind
from solver.elements.laws import Law, evaluate_law
from solver.elements.marker import Context, Spec
from solver.validate import finite

OUTPUTS = {'energy': 'J', 'dissipation': 'W', 'rate': 'm/s or rad/s', 'force': 'N or N m', 'valve': ''}


@dataclass(frozen=True, kw_only=True)
class AdjustableDamperSpec(Spec):
    """Damper over s' = sum of factor * rate of a coordinate, between two characteristics; see the module for the
    formula.

    terms: up to three (coordinate name, factor). soft, firm: laws of the resisting force [N or N m] over s' [m/s or
    rad/s] at the commands 0 and 1. input: channel of the command. lag: time constant of the valve [s], > 0. Raises
    SpecError.
    """

    terms: tuple[tuple[str, float], ...]
    soft: Law
    firm: Law
    input: str
    lag: Time

    def __post_init__(self) -> None:
        self.set('terms', checked_terms(self.where, self.terms))
        self.set('lag', finite(self.where, 'lag', self.lag, low=0.0, strict=True))


class AdjustableDamperTable(NamedTuple):
    """Columns of all adjustable dampers; the first five are those of Combination (solver.elements.coordinate_force)."""

    terms: np.ndarray  # (n,)
    coordinate: np.ndarray  # (n, 3)
    factor: np.ndarray  # (n, 3)
    body: np.ndarray  # (n, 6)
    slot: np.ndarray  # (n, 6, 6)
    law: np.ndarray  # (n, 2) soft, firm
    input: np.ndarray  # (n,)
    state: np.ndarray  # (n,) index of z
    lag: np.ndarray  # (n,)


def compile_adjustable_dampers(specs: Sequence[AdjustableDamperSpec], context: Context) -> AdjustableDamperTable:
    """Resolve names and laws into a table; one internal state each, the valve."""
    return AdjustableDamperTable(
        **compile_combinations(specs, context)._asdict(),
        law=np.array([(context.law(s.soft), context.law(s.firm)) for s in specs], np.int64).reshape(-1, 2),
        input=np.array([context.input(s.where, s.input) for s in specs], np.int64),
        state=np.array([context.internal_states(s.where, 1) for s in specs], np.int64),
        lag=np.array([s.lag for s in specs], float),
    )


@kernel(borrow=True)
def adjustable_dampers(table, now, effects, out):
    """Accumulate forces and tangents of all adjustable dampers, assign their valves (contract:
    solver/elements/__init__.py)."""
    f, Kq, Kv = sums(effects)
    coordinates, kin, angle = now.coordinates, now.kin, now.angle
    for e in range(table.terms.shape[0]):
        _, v0, g0, g1 = term(table, coordinates, kin, angle, e, 0)
        _, v1, g2, g3 = term(table, coordinates, kin, angle, e, 1)
        _, v2, g4, g5 = term(table, coordinates, kin, angle, e, 2)
        g = (g0, g1, g2, g3, g4, g5)
        rate = v0 + v1 + v2
        k, share = table.state[e], now.cz / table.lag[e]
        command = min(max(now.u[table.input[e]], 0.0), 1.0)
        valve = (now.zp[k] + share * command) / (1.0 + share)
        effects.z[k] = valve + 0.0 * rate
        soft, soft_damping, _ = evaluate_law(now.laws, table.law[e, 0], rate)
        firm, firm_damping, _ = evaluate_law(now.laws, table.law[e, 1], rate)
        Q = -(soft + valve * (firm - soft))
        damping = soft_damping + valve * (firm_damping - soft_damping)
        for a in range(2 * table.terms[e]):
            add_gradient(Q, g[a], table.body[e, a], f)
        if now.tangents:
            h0, h1 = rate_gradient(table, coordinates, kin, e, 0, True)
            h2, h3 = rate_gradient(table, coordinates, kin, e, 1, True)
            h4, h5 = rate_gradient(table, coordinates, kin, e, 2, True)
            add_generalized(
                g, (h0, h1, h2, h3, h4, h5), 2 * table.terms[e], 0.0 * damping, damping, table.slot, e, Kq, Kv
            )
            for t in range(table.terms[e]):
                add_coordinate_hessian(coordinates, kin, table.coordinate[e, t], table.factor[e, t] * Q, Kq)
        out[e, 0] = 0.0
        out[e, 1] = -Q * rate
        out[e, 2] = rate
        out[e, 3] = Q
        out[e, 4] = effects.z[k]


ADJUSTABLE_DAMPERS = ForceKind(
    name='adjustable_dampers',
    spec=AdjustableDamperSpec,
    compile=compile_adjustable_dampers,
    kernel=adjustable_dampers,
    outputs=OUTPUTS,
    effort='force',
)
