"""Static equilibrium, by Newton's iteration on forces and constraints together."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np

from solver.compiled.by_reference import Ref
from solver.compiled.portable import norm, product
from solver.compiled.so3 import matrix_of_quaternion
from solver.elements.registry import FORCES
from solver.errors import ConsistencyError
from solver.model.evaluate import add_constraint_forces, add_constraint_stiffness, evaluate_forces
from solver.model.saddle import CONDENSED, solve_saddle
from solver.model.state import State, update_angles
from solver.start.equilibrium_stability import refuse_unstable
from solver.start.newton import ConsistentState, move

EQUILIBRIUM_TOLERANCE = 1e-11  # relative to the weight of the model, of torques times its length
# Times EQUILIBRIUM_TOLERANCE: residual that stiff elements may leave when the search has stalled.
ROUNDING = 1e2
# Iterations in a row that do not halve the least residual: the search has stalled; ten times as many only take longer.
STALLED = 8
# Time that an iteration stands for, in dampers and internal states [s, of a model that falls as one of 1 m]: long
# against every time constant in a model.
SETTLING = 1.0
# Iterations at most of a first search, with elements in the form that leads nearer to the equilibrium (approach).
APPROACH = 40
# Lengths of the model by which the hold of a body gives way under its whole weight; ten times as much holds it less
# firmly.
GIVE = 1e-4


class Equilibrium(ConsistentState):
    """A consistent start that may be sought at rest."""

    @property
    def fall(self) -> float:
        """Time [s] that the model takes to fall by its length, over that of a model of 1 m; 1 where nothing weighs."""
        return self.length / self.slow if self.slow > 0.0 else 1.0

    def equilibrium(
        self, state: State, u: np.ndarray, limit: int = 400, *, hold: int | None = None, stable: bool = False
    ) -> float:
        """Static equilibrium: Newton on f(q, 0) + A^T lam = 0, phi = 0 with a pseudo-mass M/tau^2 that fades.

        Changes state.q, state.lam, state.z, state.angle; state.v is set to zero. Returns the largest generalized force
        left [N or N m]. Internal states follow the motion towards the equilibrium as if an iteration took SETTLING
        seconds: tires at rest and brakes are springs between that motion and their force. Kinds of elements may act
        otherwise during the search (ForceKind.held) or at its beginning (ForceKind.approach). hold: a body that is held
        along its x axis, at the place where it is. Other directions without stiffness stay where they are. Raises
        ConsistencyError if it does not settle, and with `stable` if the model would leave what was found.
        """
        changed: dict[str, Any] = {}
        nearer: dict[str, Any] = {}
        limits: dict[int, float] = {}
        for kind in FORCES:
            if kind.held is not None and getattr(self.model.spec, kind.name):
                held = kind.held(self.model.elements[kind.name].value, u)
                changed[kind.name], u = held.table, held.inputs
                limits |= held.limits
            if kind.approach is not None and getattr(self.model.spec, kind.name):
                nearer[kind.name] = kind.approach(self.model.elements[kind.name].value)
        place = state.q[0 if hold is None else hold, :3].copy()
        if nearer:
            tables, kept = self.model.with_tables(changed | nearer)
            with suppress(ConsistencyError):
                self._settle(tables, state, u, APPROACH, hold)
        tables, kept = self.model.with_tables(changed)
        left = self._settle(tables, state, u, limit, hold)
        if stable:
            kin, settling = self._constraints(state.q, np.zeros_like(state.v), state.angle, u), SETTLING * self.fall
            evaluate_forces(
                tables, kin, state.angle, state.z, settling, u, True, self.f, self.Kq, self.Kv, self.z, self.outputs
            )
            add_constraint_stiffness(self.t, kin, state.lam, self.Kq, self.Kv)
            if hold is not None:
                self._hold(hold, state.q, place, self._weight() / (GIVE * self.length))
            refuse_unstable(self.model, self.Kq + self.Kv / settling, self.J, self.metric, self.fall)
        del kept
        for index, largest in limits.items():
            state.z[index] = np.clip(state.z[index], -largest, largest)
        return left

    def _hold(self, b: int, q: np.ndarray, start: np.ndarray, stiffness: float) -> None:
        """Add a spring along the x axis of body b, from its place p (3,) at the start, to the forces and their
        tangent."""
        R = np.array(matrix_of_quaternion(tuple(q[b, 3:]))).reshape(3, 3)
        d, moved = R[:, 0], q[b, :3] - start
        s = product(d, moved)
        self.f[b, :3] -= stiffness * s * d
        slot = self.t.bodies.slot[b]
        self.Kq[slot, :3, :3] -= stiffness * np.outer(d, d)
        turned = np.column_stack([np.zeros(3), -R[:, 2], R[:, 1]])  # of d by a rotation in B
        self.Kq[slot, :3, 3:] -= stiffness * (np.outer(d, product(moved, turned)) + s * turned)

    def _weight(self) -> float:
        """Weight of the whole model [N]; where nothing weighs, its elements' largest force where it is [N], or 1 N."""
        weight = float((self.t.bodies.mass * norm(self.t.bodies.gravity)).sum())
        return weight or self._left(self.f) or 1.0

    def _left(self, r: np.ndarray) -> float:
        """Largest generalized force in r (nb + 1, 6) [N], of torques over the length of the model."""
        return float(np.abs(r / self.by_length).max())

    def _settle(self, tables: Ref, state: State, u: np.ndarray, limit: int, hold: int | None) -> float:
        place = state.q[0 if hold is None else hold, :3].copy()
        state.v[:] = 0.0
        tau, scale = 0.01 * self.fall, 0.0
        last = least = np.inf
        stalled, settling = 0, SETTLING * self.fall
        at_rest = np.zeros_like(state.v)
        for _ in range(limit):
            kin = self._constraints(state.q, at_rest, state.angle, u)
            evaluate_forces(
                tables, kin, state.angle, state.z, settling, u, True, self.f, self.Kq, self.Kv, self.z, self.outputs
            )
            scale = scale or self._weight()
            if hold is not None:
                self._hold(hold, state.q, place, scale / (GIVE * self.length))
            r = -self.f
            add_constraint_forces(self.constraints, self.J, state.lam, -1.0, r)
            r[-1] = 0.0
            left = self._left(r)
            open_ = float(np.abs(self.row_length * self.phi).max(initial=0.0)) / self.length
            stalled = 0 if left < 0.5 * least else stalled + 1
            least = min(least, left)
            enough = EQUILIBRIUM_TOLERANCE * (ROUNDING * scale if stalled >= STALLED else scale)
            if left <= enough and open_ < 1e-11:
                return left
            # a slow rise is not divergence: while a car rolls to where its brakes hold it, the residual grows before it
            # falls
            tau = min(tau * (2.0 if left < 2.0 * last else 0.5), 1e2 * self.fall)
            tau = max(tau, 1e-3 * self.fall)
            last = left
            add_constraint_stiffness(self.t, kin, state.lam, self.Kq, self.Kv)
            self._factorize(1.0 / tau**2, 1.0, 1.0 / settling, metric=True)
            solve_saddle(self.t, CONDENSED, self.saddle, r, self.phi, self.dw, self.dlam)
            factor = min(1.0, 0.05 * self.length / max(self._largest(self.dw), 1e-300))
            kin = self._at(state.q, factor / settling * self.dw)
            evaluate_forces(
                tables, kin, state.angle, state.z, settling, u, False, self.f, self.Kq, self.Kv, self.z, self.outputs
            )
            state.z[:] = self.z
            move(state.q, factor * self.dw)
            state.lam[:] += factor * self.dlam
            update_angles(self.coordinates, self._at(state.q, at_rest), state.angle)
        if left < ROUNDING * EQUILIBRIUM_TOLERANCE * scale:
            return left
        b, c = np.unravel_index(np.argmax(np.abs(r / self.by_length)), r.shape)
        raise ConsistencyError(
            f'start: no static equilibrium was found: {left:.3g} N (or N m) remain on body '
            f'{self.model.body_names[b]!r} (component {"xyz"[c % 3]} of the {"force" if c < 3 else "torque"}); check '
            f'springs, tires and the initial height'
        )
