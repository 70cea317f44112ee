"""The engine of the reference integrators (solver.reference.methods)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from solver.compiled.by_reference import Ref
from solver.engine import Kept, Moved, instant
from solver.engine.bodies import Bodies
from solver.errors import SpecError, StepError
from solver.inputs.driving import Driven
from solver.model.evaluate import constraint_input_rates, evaluate_constraints, evaluate_forces
from solver.model.state import fill_kinematics, update_angles
from solver.output.seen import Seen
from solver.output.snapshot import NO_STEPS, Counters
from solver.reference.dense import Equations, MotionState
from solver.reference.methods import METHODS, Kkt, Stabilised
from solver.scene import Scene
from solver.start.placement import Changes

KINDS = ('reference_kkt', *METHODS)  # of integrators


class Following:
    """See solver.engine.Engine. integrator.h is the output grid, integrator.tolerance the relative and absolute
    tolerance of the integrator, which chooses its own steps; the other settings mean nothing here.

    Outputs are projected onto the constraints; accelerations and multipliers are those that belong to the projected
    motion (of redundant constraints the smallest set). Counters: force evaluations and factorizations. A restored run
    begins the integrator anew, so it agrees to the tolerance, not bit by bit. Raises SpecError when the package of the
    integrator is missing.
    """

    follows = True
    alone = 'a reference integrator steps by itself'

    def __init__(self, scene: Scene) -> None:
        if scene.integrator.kind not in KINDS:
            raise SpecError(
                f'integrator: kind = {scene.integrator.kind!r}: this engine knows {", ".join(KINDS)}; use '
                'simulation_of(scene)'
            )
        self.scene = scene
        self.shown = Bodies(scene)
        self.stage = 1.0 - self.shown.scheme.af
        self.solver: Kkt | Stabilised | None = None

    def start(self, u: np.ndarray) -> Changes:
        """Find the consistent state at t = 0. Raises ConsistencyError."""
        return self.shown.start(u, lambda result: self.shown.failure(result, instant(self.scene, 0)))

    def start_like(self, other: Following, u: np.ndarray) -> None:
        """See Engine.start_like()."""
        self.shown.start_like(other.shown, u)

    def reset(self, u: np.ndarray) -> None:
        """Back to the start."""
        self.shown.reset()
        self.begin(0, u)

    def begin(self, k: int, u: np.ndarray) -> None:
        """Begin the integrator at the present state."""
        if self.shown.branches is not None:
            self.shown.branches.reset()
        self.shown.show(u)
        kind, tolerance, s = self.scene.integrator.kind, self.scene.integrator.tolerance, self.shown.state
        self.equations = Equations(self.shown.model, self.shown.outputs, self._inputs_at, s.angle)
        motion = MotionState(s.q.copy(), self.shown.work.v_out.copy(), s.z.copy())
        t = k * self.scene.integrator.h_ns * 1e-9
        if kind == 'reference_kkt':
            self.solver = Kkt(self.equations, t, motion, tolerance)
        else:
            self.solver = Stabilised(self.equations, t, motion, tolerance, kind)
        self._counted = (0, 0)

    def show(self, k: int, u: np.ndarray) -> None:
        """Begin the integrator at the present state, which is now another time's; the account goes on."""
        kept = self.shown.account.numbers.copy()
        self.begin(k, u)
        self.shown.account.numbers[:] = kept

    def _inputs_at(self, t: float) -> np.ndarray:
        at = np.array([t])
        return self.scene.maneuver.inputs(self.scene.model.inputs, at, at)[0]

    def advance(
        self,
        k: int,
        inputs: np.ndarray,
        n: int,
        audit: bool,
        last: np.ndarray,
        seen: Seen | None = None,
        driven: Driven | None = None,
    ) -> Moved:
        """n steps of the output grid; the inputs are those of the maneuver."""
        assert self.solver is not None
        position = velocity = 0.0
        for done in range(n):
            t = (k + done + 1) * self.scene.integrator.h_ns * 1e-9
            try:
                raw = self.solver.advance(t)
            except StepError as error:
                kind, step = self.scene.integrator.kind, k + done
                why = (
                    f't = {self.solver.t:.6f} s, step {step}: {kind} stopped: {error} (it cannot pass singular '
                    'positions)'
                )
                return Moved(done, NO_STEPS, why)
            self.equations.move_to(raw.q, raw.v)
            rows = self.equations.constraints(t)
            position = max(position, float(np.abs(rows.phi[self.equations.holonomic]).max(initial=0.0)))
            velocity = max(velocity, float(np.abs(rows.A @ raw.v[:-1].ravel() + rows.phi_t).max(initial=0.0)))
            self._take(t, self.equations.project(t, raw), last)
            if audit:
                self.shown.look(t)
            if seen is not None:
                seen.look(k + done + 1, self.shown.numbers)
        now = (self.equations.evaluations, self.solver.factorizations)
        evaluations, factorizations = (a - b for a, b in zip(now, self._counted, strict=True))
        self._counted = now
        return Moved(n, Counters(0, factorizations, evaluations, 0, 0.0, position, velocity))

    def _take(self, t: float, motion: MotionState, last: np.ndarray) -> None:
        """Make a motion the current state, with all its outputs."""
        bodies = self.shown
        s, w, tables, kin = bodies.state, bodies.work, bodies.model.tables, bodies.kin
        s.q[:], s.v[:], s.z[:] = motion
        last[:] = self._inputs_at(t)
        fill_kinematics(s.q, s.v, kin)
        update_angles(Ref(tables.coordinates), kin, s.angle)
        a, lam, _ = self.equations.acceleration(t, motion)
        w.v_out[:], w.lam_out[:] = motion.v, lam
        w.a_out[:-1] = a.reshape(-1, 6)
        evaluate_constraints(tables, kin, s.angle, last, True, w.phi_end, w.J_end)
        constraint_input_rates(tables, last, w.phi_t, w.phi_tt)
        evaluate_forces(tables, kin, s.angle, s.z, 0.0, last, False, w.f, w.Kq, w.Kv, w.z_stage, bodies.outputs)
        bodies.keep_account(bodies.h)
        bodies.collect(last)

    def arrays(self) -> dict[str, np.ndarray]:
        """Those of its bodies."""
        return self.shown.arrays()

    def fit(self, saved: Mapping[str, np.ndarray], k: int) -> Callable[[np.ndarray, Kept], None]:
        """See Engine.fit()."""
        bodies = self.shown.fit(saved)

        def take_up(u: np.ndarray, _: Kept) -> None:
            bodies()
            watch = self.shown.branches
            self.shown.branches = None  # it goes on from what was saved
            self.begin(k, u)
            self.shown.branches = watch
            self.shown.take_account(saved['audit'])

        return take_up

    def reached(self) -> dict[str, tuple[float, float | None]]:
        """Nothing is followed of a model as given."""
        return {}

    def totals(self, k: int) -> dict[str, Any]:
        """Its own steps are not those of the grid, and are not counted."""
        watch = self.shown.branches
        grid = {'substeps': k, 'rejected': 0, 'smallest_step': self.shown.h, 'events': 0}
        return {**grid, **({} if watch is None else {'branch_switches': len(watch.events)})}
