"""A consistent start: assembly of positions, projection of velocities, accelerations and multipliers.

All of them are Newton iterations on the same saddle system as the step (solver.model.saddle), in its n x n form with
repeated augmentation [Bayo1996], so redundant constraints are harmless here too.

The file is long because positions, velocities and accelerations are found by one system, whose parts they share.
"""

from __future__ import annotations

import math
from contextlib import suppress

import numpy as np

from solver.compiled.by_reference import Ref
from solver.compiled.kernel import kernel
from solver.compiled.portable import inverse, norm
from solver.compiled.so3 import quaternion_exp, quaternion_normalized, quaternion_product
from solver.errors import ConsistencyError
from solver.linear.gmres import gmres
from solver.model.evaluate import (
    add_constraint_forces,
    constraint_input_rates,
    constraint_rates,
    evaluate_constraints,
    evaluate_forces,
    turning_rows,
)
from solver.model.saddle import (
    CONDENSED,
    assemble_tangent,
    effective_masses,
    factorize_saddle,
    new_saddle,
    solve_saddle,
)
from solver.model.state import State, fill_kinematics, new_kinematics, update_angles
from solver.model.tables import Model
from solver.vehicle.size import scale_of

PENALTY = 1e6  # above it rounding of small inertias beside large ones shows
# 1/s^2; PENALTY times it is above the square of the highest natural frequency, also when the pseudo-mass has faded
STIFFEST = 1e4
# kg of the effective mass of a row, from which on held velocities have smaller penalties; 1/s^2
HEAVY, SOFTER = 100.0, 1e2
SOFTEST = 1.0  # 1/s^2, where rounding of larger ones moves a part that is light and not damped
AUGMENTATIONS = 400  # at most; each gains a factor 1 + PENALTY s_min, little where a light body carries a heavy one
PLAIN, COMBINED = 10, 2  # augmentations for accelerations: first one by one, then combined by GMRES
# Part of the slow speed of the model by which velocities may violate constraints at the start; a start with more is
# refused. Where nothing weighs it is that of the fastest: of what is given, of drivers, of what their accelerations
# make of a length of the model and of what the first step brings: where all rests, rates are rounding alone.
OPEN = 1e-8
STAGNATION = 0.5  # change over the one before, above which an iteration has come to rounding and ends
KRYLOV = 40  # augmentations that GMRES combines at most; ten times as many need ten times the memory
# Lengths of the model, or rad, by which constraints may be open after the assembly, where positions have so many
# digits.
ASSEMBLY_TOLERANCE = 1e-12
POSITION_ROUNDING = 1e-15  # relative rounding of a position: far from the origin no constraint closes any better
CONTRADICTING = 1e-5  # lengths of the model, or rad, that stay open where joints are nearly right
# rad, or lengths of the model, per iteration of the assembly, so that no coordinate turns by pi at once
LARGEST_TURN = 0.3
FARTHEST = 10000  # such iterations that a start may be away: 3000 rad
CLEARANCE = 10.0  # height at which no tire touches any road [m]
CLOSING = 10  # iterations that close constraints beside the start
UNRESOLVED = 0.5  # part of the change of an acceleration over a step that a Taylor polynomial may miss
# lengths of the model, or rad, in a step: a change of acceleration that moves a body by less is not sudden
UNSEEN = 1e-9


class ConsistentState:
    """Scratch for the start calculations of one model (not a state: every method says what it changes)."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.t = model.tables
        nb, ns = model.n_bodies, model.n_slots
        self.outputs = model.new_outputs()
        self.saddle = Ref(new_saddle(model, CONDENSED))
        self.coordinates = Ref(self.t.coordinates)
        self.constraints = Ref(self.t.constraints)
        self._kin = Ref(new_kinematics(nb))
        self.identity = np.tile(np.eye(3), (nb + 1, 1, 1))
        self.Kq = np.zeros((ns + 1, 6, 6))
        self.Kv = np.zeros((ns + 1, 6, 6))
        self.f = np.zeros((nb + 1, 6))
        self.dw = np.zeros((nb + 1, 6))
        self.dlam = np.zeros(model.n_rows)
        self.phi = np.zeros(model.n_rows)
        self.phi_t = np.zeros(model.n_rows)
        self.phi_tt = np.zeros(model.n_rows)
        self.J = np.zeros((model.n_entries + 1, 6, 6))
        self.z = np.zeros(model.n_internal)
        self.length, self.slow = scale_of(model.spec)
        self.by_length = np.array([1.0] * 3 + [self.length] * 3)  # makes lengths of turns
        self.row_length = np.where(turning_rows(model), self.length, 1.0)
        # massless bodies get the floor that the penalties use, here as inertia of the metric only
        self.metric = np.zeros((nb, 6, 6))
        self.metric[:, :3, :3] = np.eye(3) / self.t.penalty_inverse_mass[:, None, None]
        self.metric[:, 3:, 3:] = inverse(self.t.penalty_inverse_inertia)

    def _factorize(
        self, cm: float, cq: float, cv: float, metric: bool, holonomic: bool = False, stiffest: float = STIFFEST
    ) -> None:
        """Factorize cm M - cq Kq - cv Kv with the constraints at self.J; metric: use the floored masses instead of M.

        holonomic: leave out rows that constrain velocities only. stiffest [1/s^2]: smallest factor of the penalties
        beside stiffness.
        """
        self.saddle.J_force[:] = self.J
        self.saddle.J_row[:, :, :6] = self.J
        effective_masses(self.t, self.J, self.saddle.W)
        self.saddle.W[:] *= PENALTY * (cm if cq == cv == 0.0 else max(cm, stiffest))
        if holonomic:
            self.saddle.W[self.t.constraints.holonomic == 0] = 0.0
        assemble_tangent(self.t, 0.0 if metric else cm, cq, cv, self.Kq, self.Kv, self.identity, self.saddle.B)
        if metric:
            self.saddle.B[self.t.bodies.slot, :, :6] += cm * self.metric
        bad = factorize_saddle(self.t, CONDENSED, self.saddle)
        if bad >= 0:
            raise ConsistencyError(
                f'start: the system is singular at body {self.model.body_names[bad]!r}; give it a mass and inertia or '
                'constrain it'
            )

    def _at(self, q: np.ndarray, v: np.ndarray) -> Ref:
        """Kinematics (by reference) of a configuration and twist, until the next call: a new Ref takes as long as an
        evaluation."""
        fill_kinematics(q, v, self._kin)
        return self._kin

    def _constraints(self, q: np.ndarray, v: np.ndarray, angle: np.ndarray, u: np.ndarray) -> Ref:
        kin = self._at(q, v)
        evaluate_constraints(self.t, kin, angle, u, True, self.phi, self.J)
        return kin

    def _largest(self, x: np.ndarray) -> float:
        """Largest magnitude in x (nb + 1, 6), of turns times the length of the model."""
        return float(np.abs(x * self.by_length).max())

    def _violated(self, rate: np.ndarray) -> float:
        """Largest violation of a velocity in rate (nc,) [m/s]."""
        return float(np.abs(self.row_length * rate).max(initial=0.0))

    def _worst_row(self, residual: np.ndarray) -> str:
        return self.model.row_names[int(np.argmax(np.abs(residual)))] if len(residual) else 'none'

    def assemble(self, state: State, u: np.ndarray, offsets: np.ndarray | None = None, limit: int = 200) -> None:
        """Move state.q onto phi = 0 by damped Gauss-Newton in the metric of the masses; updates state.angle.

        state.angle follows every move, so a start or a gear may wind a coordinate by any number of turns. offsets
        (nc,): added to phi. limit: iterations, besides those that the first correction takes in parts of LARGEST_TURN.
        Raises ConsistencyError naming the constraint that stays open.
        """
        self.Kq[:] = 0.0
        self.Kv[:] = 0.0
        zero = np.zeros_like(self.f)
        made, most = 0, limit
        while made < most:
            kin = self._constraints(state.q, state.v, state.angle, u)
            update_angles(self.coordinates, kin, state.angle)
            residual = self.t.constraints.holonomic * (self.phi + (offsets if offsets is not None else 0.0))
            if not len(residual) or np.abs(self.row_length * residual).max() < ASSEMBLY_TOLERANCE * self.length:
                break
            self._factorize(1.0, 0.0, 0.0, metric=True, holonomic=True)
            solve_saddle(self.t, CONDENSED, self.saddle, zero, residual, self.dw, self.dlam)
            far = self._largest(self.dw) / self.length
            if made == 0 and far < np.inf:
                most += int(min(far / LARGEST_TURN, FARTHEST))
            move(state.q, self.dw * min(1.0, LARGEST_TURN / max(far, 1e-300)))
            made += 1
        else:
            worst = np.abs(self.row_length * residual).max() / self.length
            if not worst < max(1e-9, POSITION_ROUNDING * np.abs(state.q[:, :3]).max() / self.length):
                remedy = 'place the bodies nearer to a closed configuration or check the joint data'
                if worst < CONTRADICTING:
                    remedy = (
                        'redundant joints contradict each other by this small amount, and their forces would have no '
                        'bound: give markers and axes with more digits (or by `at`, in the world), or replace a joint '
                        'by one with fewer rows (spherical, point_on_line)'
                    )
                raise ConsistencyError(
                    'start: the mechanism cannot be assembled from the given placement: constraint '
                    f'{self._worst_row(residual)!r} stays open by {np.abs(residual).max():.3g}; {remedy}'
                )
        update_angles(self.coordinates, self._at(state.q, state.v), state.angle)

    def project_velocity(
        self,
        state: State,
        u: np.ndarray,
        extra: np.ndarray | None = None,
        hold: float = 0.0,
        begun: float = 0.0,
    ) -> None:
        """Make state.v satisfy A v + phi_t = 0 with the smallest change of kinetic energy; extra (nc,) is added to
        phi_t.

        begun [m/s]: a speed that the motion has soon, beside what is given and driven.

        Augmentations go on, from the residual of M (v - given) = A^T lam too, until only rounding is left.

        hold [s]: what dampers dissipate in this time counts as much as kinetic energy. So parts that only elastic
        elements connect start to move together: shafts turn with the wheels they drive, and do not turn what carries
        them. Not the tires. A row between two heavy bodies (a trailer on its ball) has smaller penalties: beside the
        usual ones rounding took more than an augmentation gave. So have all where light parts are not damped, and the
        usual ones diverge.
        """
        self._constraints(state.q, state.v, state.angle, u)
        constraint_input_rates(self.t, u, self.phi_t, self.phi_tt)
        if extra is not None:
            self.phi_t += extra
        self.Kq[:] = 0.0
        self.Kv[:] = 0.0
        if hold > 0.0:
            in_the_air = state.q.copy()
            in_the_air[:-1, 2] += CLEARANCE
            at_rest = self._at(in_the_air, np.zeros_like(state.v))
            evaluate_forces(
                self.t, at_rest, state.angle, state.z, 0.0, u, True, self.f, self.Kq, self.Kv, self.z, self.outputs
            )
        effective_masses(self.t, self.J, self.saddle.W)
        heavy = self.saddle.W.max(initial=0.0) > HEAVY
        given, rate = state.v.copy(), np.zeros(self.model.n_rows)
        driven = max(self._violated(self.phi_t), math.sqrt(self.length * self._violated(self.phi_tt)))
        slow = self.slow or max(self._largest(given), driven, begun)
        for stiffest in (SOFTER, SOFTEST) if heavy else (STIFFEST, SOFTER, SOFTEST):
            self._factorize(1.0, 0.0, hold, metric=True, stiffest=stiffest)
            state.v[:] = given
            done = self._augment_velocity(state, slow, hold, rate)
            if done or hold == 0.0:  # without dampers the penalties do not depend on it
                break
        else:
            raise ConsistencyError(
                'start: no velocity satisfies the constraints to rounding; give light parts more mass and inertia'
            )
        if hold == 0.0 and not (done and self._violated(rate) <= OPEN * slow):  # a light chain carries something heavy
            constraint_rates(self.constraints, self.J, given, rate)
            state.v[:] = given + self._constrained(0.0, rate + self.phi_t)[0]
            constraint_rates(self.constraints, self.J, state.v, rate)
            rate += self.phi_t
        if not self._violated(rate) <= OPEN * slow:
            raise ConsistencyError(
                f'start: no velocity satisfies the constraints: {self._worst_row(rate)!r} is violated by '
                f'{np.abs(rate).max():.3g}; remove contradicting initial rates'
            )

    def _augment_velocity(self, state: State, slow: float, hold: float, rate: np.ndarray) -> bool:
        """Augment the velocities until only rounding is left, and assign what is left of the constraints' rates (nc,).

        slow [m/s]: speed of the model. False where a correction is larger than all velocities before: the rounding of
        the penalties moves a part that is so light.
        """
        given, lam = state.v.copy(), np.zeros(self.model.n_rows)
        last, largest = np.inf, max(slow, self._largest(given))
        for k in range(AUGMENTATIONS):
            constraint_rates(self.constraints, self.J, state.v, rate)
            rate += self.phi_t
            closed = self._violated(rate) <= 1e-13 * max(slow, self._largest(state.v))
            if closed and k == 0 and hold == 0.0:
                return True
            r = -hold * self._block_product(self.Kv, state.v)
            r[:-1] += np.add.reduce(self.metric * (state.v - given)[:-1, None, :], axis=2)
            add_constraint_forces(self.constraints, self.J, lam, -1.0, r)
            r[-1] = 0.0
            solve_saddle(self.t, CONDENSED, self.saddle, r, rate, self.dw, self.dlam)
            change = self._largest(self.dw)
            if closed and (change == 0.0 or change > STAGNATION * last):
                return True  # what is left is rounding, of the residuals now
            if not (k == 0 or change <= largest):
                return False
            state.v[:] += self.dw
            lam += self.dlam
            last, largest = change, max(largest, change)
        return True

    def _block_product(self, K: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(nb + 1, 6) product of blocks K (ns + 1, 6, 6) with v (nb + 1, 6)."""
        product = np.zeros_like(v)
        np.add.at(product, self.t.block_row[1:], np.add.reduce(K[1:] * v[self.t.block_col[1:], None, :], axis=2))
        return product

    def acceleration(self, q, v, z, angle, u) -> tuple[np.ndarray, np.ndarray]:
        """(a (nb+1, 6), lam (nc,)) with M a = f + A^T lam and d/dt (A v + phi_t) = 0.

        By augmentation, which adds nothing to the multipliers of redundant constraints that balance each other. It
        gains little where a light body carries a heavy one or turns freely about an axis; what is left there GMRES
        finds as a combination of augmentations.
        """
        kin = self._constraints(q, v, angle, u)
        evaluate_forces(self.t, kin, angle, z, 0.0, u, False, self.f, self.Kq, self.Kv, self.z, self.outputs)
        constraint_input_rates(self.t, u, self.phi_t, self.phi_tt)
        bias = self._acceleration_bias(q, v, angle, u) + self.phi_tt
        return self._constrained(self.f, bias)

    def _constrained(self, f: np.ndarray | float, bias: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(a (nb+1, 6), lam (nc,)) with M a = f + A^T lam and A a + bias = 0, for the constraints at self.J."""
        self.Kq[:] = 0.0
        self.Kv[:] = 0.0
        self._factorize(1.0, 0.0, 0.0, metric=True)
        a = np.zeros_like(self.f)
        lam = np.zeros(self.model.n_rows)
        for k in range(PLAIN + COMBINED):
            self._augment(a, lam, f, bias)
            if k >= PLAIN:
                self._combine()
            a += self.dw
            lam += self.dlam
            if self._largest(self.dw) <= 1e-13 * max(self.slow * self.slow / self.length, self._largest(a)):
                break
        return a, lam

    def _augment(self, a: np.ndarray, lam: np.ndarray, f: np.ndarray | float, bias: np.ndarray | float) -> None:
        """Assign dw and dlam, what an augmentation adds to a (nb+1, 6) and lam (nc,)."""
        r = self._mass_times(a) - f
        add_constraint_forces(self.constraints, self.J, lam, -1.0, r)
        r[-1] = 0.0
        rate = np.zeros_like(lam)
        constraint_rates(self.constraints, self.J, a, rate)
        solve_saddle(self.t, CONDENSED, self.saddle, r, rate + bias, self.dw, self.dlam)

    def _combine(self) -> None:
        """Replace dw and dlam by the combination of augmentations, from them on, after which least is left to
        augment."""
        n = self.dw.size
        masses = np.diagonal(self.metric, axis1=1, axis2=2)
        # both parts of the vector as energies
        weight = np.sqrt(np.concatenate([masses.ravel(), np.ones(6), 1.0 / self.saddle.W]))

        def parts(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return (x / weight)[:n].reshape(-1, 6), (x / weight)[n:]

        def product(x: np.ndarray) -> np.ndarray:
            self._augment(*parts(x), 0.0, 0.0)
            return -weight * np.concatenate([self.dw.ravel(), self.dlam])

        right = weight * np.concatenate([self.dw.ravel(), self.dlam])
        self.dw[:], self.dlam[:] = parts(gmres(product, right, 1e-8, KRYLOV))

    def _mass_times(self, a: np.ndarray) -> np.ndarray:
        out = np.zeros_like(a)
        out[:-1, :3] = self.t.bodies.mass[:, None] * a[:-1, :3]
        out[:-1, 3:] = np.add.reduce(self.t.bodies.inertia * a[:-1, None, 3:], axis=2)
        return out

    def _acceleration_bias(self, q, v, angle, u) -> np.ndarray:
        """(dA/dt) v by the fourth-order central difference of A v along the motion with frozen v."""
        bias = np.zeros(self.model.n_rows)
        if not v.any():
            return bias
        d = 1e-3 * self.length / max(self.slow, self._largest(v))
        rate = np.zeros(self.model.n_rows)
        J = np.zeros_like(self.J)
        phi = np.zeros_like(self.phi)
        for s, weight in ((-2, 1 / 12), (-1, -2 / 3), (1, 2 / 3), (2, -1 / 12)):
            moved = q.copy()
            move(moved, s * d * v)
            evaluate_constraints(self.t, self._at(moved, v), angle, u, True, phi, J)
            constraint_rates(self.constraints, J, v, rate)
            bias += weight / d * rate
        return bias

    def start_integrator(self, state: State, u: np.ndarray, h: float, am: float, af: float) -> None:
        """Assign state.a, a_stage, lam, lam_before and zd, and adjust state.v, so that every step is second order from
        the first one on.

        The scheme's a_n belongs to t_n + (am - af) h and its multipliers to t_n - af h; both are reached by a central
        difference along the motion. Its velocity satisfies A v + phi_t = -h^2 A e, with e h^3 the local error of the
        increment of a step: started with A v + phi_t = 0, it would jump there by O(h^2) in the first step and disturb
        the multipliers by O(h), which rho_inf = 1 never forgets [Arnold2015]. The increment of the exact motion is h v
        + h^2/2 a + h^3/6 da/dt, in rotations plus h^3/12 w x dw/dt; the scheme has h v + h^2 ((1/2 - beta) a_n + beta
        a_n+1).

        The uncorrected values are taken where the motion is too fast for the step to resolve (h |da/dt| > |a|). The
        acceleration over the step is taken where an element is so stiff that its acceleration at the first instant
        would give a body more speed in the step than there is: the predictor would else throw the body past the element
        (beyond the anchor of a spring between points, to where it is in equilibrium as well).
        """
        a, lam = self.acceleration(state.q, state.v, state.z, state.angle, u)
        kin = self._at(state.q, state.v)
        cz = 1e-3 * h
        evaluate_forces(self.t, kin, state.angle, state.z, cz, u, False, self.f, self.Kq, self.Kv, self.z, self.outputs)
        state.zd[:] = (self.z - state.z) / cz
        d = 0.1 * h
        sides = []
        constraint_input_rates(self.t, u, self.phi_t, self.phi_tt)
        phi_t, phi_tt = self.phi_t.copy(), self.phi_tt.copy()
        for s in (d, -d):
            q = state.q.copy()
            move(q, s * state.v + 0.5 * s * s * a)
            # Where they are open redundant constraints seem to hold what nothing needs to (solver.step.augmentation),
            # with multipliers that mean nothing and are divided by d.
            closed = state._replace(q=q.copy(), angle=state.angle.copy())
            # next to a singular position that may take long, and nothing is redundant there
            with suppress(ConsistencyError):
                self.assemble(closed, u, s * phi_t + 0.5 * s * s * phi_tt, limit=CLOSING)
                q = closed.q
            sides.append(self.acceleration(q, state.v + s * a, state.z + s * state.zd, state.angle, u))
        a_rate = (sides[0][0] - sides[1][0]) / (2 * d)
        lam_rate = (sides[0][1] - sides[1][1]) / (2 * d)
        smooth = h * norm(a_rate * self.by_length) <= norm(a * self.by_length)
        over, forces = self._acceleration_over_a_step(state, u, h)
        missed, rate = norm((over - (a + h * a_rate)) * self.by_length), norm(a_rate * self.by_length)
        stiff = missed > UNRESOLVED * max(norm(a * self.by_length), h * rate)
        least = max(self._largest(over), self._largest(state.v) / h, UNSEEN * self.length / (h * h))
        sudden = self._largest(over - a) > least  # never if not finite
        if stiff and sudden:
            a, lam, smooth = over, forces, False
        state.a[:] = a + ((am - af) * h * a_rate if smooth else 0.0)
        state.a_stage[:] = a - (af * h * a_rate if smooth else 0.0)
        state.lam[:] = lam - (af * h * lam_rate if smooth else 0.0)
        state.lam_before[:] = state.lam - (h * lam_rate if smooth else 0.0)
        state.a_stage_before[:] = state.a_stage - (h * a_rate if smooth else 0.0)
        if smooth:
            # beta + (am - af) / 2 - 1/6, with beta = (1 - (am - af))^2 / 4
            e = (0.25 * (1.0 + (am - af) ** 2) - 1 / 6) * a_rate
            e[:, 3:] -= np.cross(state.v[:, 3:], a[:, 3:]) / 12
            self._constraints(state.q, state.v, state.angle, u)
            excess = np.zeros(self.model.n_rows)
            constraint_rates(self.constraints, self.J, e, excess)
            self.project_velocity(state, u, h * h * excess * self.t.constraints.holonomic, begun=h * self._largest(a))

    def _acceleration_over_a_step(self, state: State, u: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
        """(a (nb+1, 6), lam (nc,)) of a linearised backward Euler step of h [s]: M a = f(q + h (v + h a), v + h a) +
        A^T lam.

        Constraints are those of acceleration(). It is the acceleration at the end of the step for resolved motions;
        stiff elements relax.
        """
        kin = self._constraints(state.q, state.v, state.angle, u)
        evaluate_forces(self.t, kin, state.angle, state.z, h, u, True, self.f, self.Kq, self.Kv, self.z, self.outputs)
        constraint_input_rates(self.t, u, self.phi_t, self.phi_tt)
        Kq, Kv, J = self.Kq.copy(), self.Kv.copy(), self.J.copy()
        bias = self._acceleration_bias(state.q, state.v, state.angle, u) + self.phi_tt
        self.J[:], self.Kq[:], self.Kv[:] = J, Kq, Kv
        f = self.f + h * self._block_product(Kq, state.v)
        self._factorize(1.0, h * h, h, metric=True, stiffest=1.0)
        a, lam = np.zeros_like(self.f), np.zeros(self.model.n_rows)
        rate = np.zeros_like(lam)
        for _ in range(AUGMENTATIONS):
            r = self._mass_times(a) - self._block_product(h * h * Kq + h * Kv, a) - f
            add_constraint_forces(self.constraints, self.J, lam, -1.0, r)
            r[-1] = 0.0
            constraint_rates(self.constraints, self.J, a, rate)
            solve_saddle(self.t, CONDENSED, self.saddle, r, rate + bias, self.dw, self.dlam)
            a += self.dw
            lam += self.dlam
            if self._largest(self.dw) <= 1e-10 * max(self.slow * self.slow / self.length, self._largest(a)):
                break
        return a, lam


@kernel(borrow=True)
def move(q, dq):
    """q <- q o exp(dq) for all bodies; dq (nb + 1, 6) is a variation (docs/conventions.md)."""
    for b in range(q.shape[0] - 1):
        turn = quaternion_exp((dq[b, 3], dq[b, 4], dq[b, 5]))
        turned = quaternion_normalized(quaternion_product((q[b, 3], q[b, 4], q[b, 5], q[b, 6]), turn))
        for i in range(3):
            q[b, i] += dq[b, i]
        for i in range(4):
            q[b, 3 + i] = turned[i]
