"""Scenes solved by the reference integrators (solver.reference.methods), with the outward interface of Simulation."""

from __future__ import annotations

import numpy as np

from solver.compiled.by_reference import Ref
from solver.errors import SpecError, StepError
from solver.model.evaluate import constraint_input_rates, evaluate_constraints, evaluate_forces
from solver.model.state import fill_kinematics, update_angles
from solver.output.dependence import scaled_jacobian
from solver.output.energy import update_energy
from solver.output.snapshot import Counters, Snapshot
from solver.reference.dense import Equations, Motion
from solver.reference.methods import METHODS, Kkt, Stabilised
from solver.scene import Scene
from solver.simulation import Simulation


class ReferenceSimulation(Simulation):
    """A scene with integrator.kind 'reference_*': integrator.h is the output grid, integrator.tolerance the relative and absolute
    tolerance of the integrator, which chooses its own steps; the other settings mean nothing here.

    Outputs are projected onto the constraints; accelerations and multipliers are those that belong to the projected motion (of
    redundant constraints the smallest set). Counters: force evaluations and factorizations. restore() starts the integrator anew, so
    a restored run agrees to the tolerance, not bit by bit. Raises SpecError when the package of the integrator is missing.
    """

    KINDS = ('reference_kkt', *METHODS)

    def __init__(self, scene: Scene) -> None:
        if scene.maneuver.closed_loop:
            raise SpecError('maneuver: driver: a reference integrator follows functions of time; use integrator.kind alf')
        if scene.maneuver.bag:
            raise SpecError('maneuver: bag: a reference integrator follows functions of time; use integrator.kind alf')
        self._solver: Kkt | Stabilised | None = None
        super().__init__(scene)

    def _refresh(self) -> None:
        super()._refresh()
        kind, tolerance = self.scene.integrator.kind, self.scene.integrator.tolerance
        s = self.state
        self.equations = Equations(self.model, self.outputs, self._inputs_at, s.angle)
        motion = Motion(s.q.copy(), self._work.v_out.copy(), s.z.copy())
        t = self.t_ns * 1e-9
        if kind == 'reference_kkt':
            self._solver = Kkt(self.equations, t, motion, tolerance)
        else:
            self._solver = Stabilised(self.equations, t, motion, tolerance, kind)
        self._counted = (0, 0)

    def _inputs_at(self, t: float) -> np.ndarray:
        at = np.array([t])
        return self.scene.maneuver.inputs(self.scene.model.inputs, at, at)[0]

    def advance(self, n: int = 1, inputs: np.ndarray | None = None, *, audit: bool = True) -> Snapshot:
        """Advance n steps of the output grid. inputs are refused: these integrators look at the maneuver at any time they like."""
        if inputs is not None:
            raise SpecError('advance: a reference integrator follows the maneuver of its scene and takes no other inputs')
        assert self._solver is not None
        position = velocity = 0.0
        for _ in range(n):
            t = (self.t_ns + self.h_ns) * 1e-9
            try:
                raw = self._solver.advance(t)
            except StepError as error:
                kind = self.scene.integrator.kind
                raise StepError(
                    f't = {self._solver.t:.6f} s, step {self.k}: {kind} stopped: {error} (it cannot pass singular positions)'
                ) from None
            self.equations.move_to(raw.q, raw.v)
            rows = self.equations.constraints(t)
            position = max(position, float(np.abs(rows.phi[self.equations.holonomic]).max(initial=0.0)))
            velocity = max(velocity, float(np.abs(rows.A @ raw.v[:-1].ravel() + rows.phi_t).max(initial=0.0)))
            self.k += 1
            self._show(t, self.equations.project(t, raw))
            if audit and self.branches is not None:
                self.branches.look(t, scaled_jacobian(self.model, self._work.J_end))
        now = (self.equations.evaluations, self._solver.factorizations)
        evaluations, factorizations = (a - b for a, b in zip(now, self._counted, strict=True))
        self._counted = now
        self._counters = Counters(0, factorizations, evaluations, 0, 0.0, position, velocity)
        self._totals = self._totals.followed_by(self._counters)
        return self.snapshot()

    def _show(self, t: float, motion: Motion) -> None:
        """Make a motion the current state, with all its outputs."""
        s, w, tables = self.state, self._work, self.model.tables
        s.q[:], s.v[:], s.z[:] = motion
        self._inputs = self._inputs_at(t)
        kin = self._kin
        fill_kinematics(s.q, s.v, kin)
        update_angles(Ref(tables.coordinates), kin, s.angle)
        a, lam, _ = self.equations.acceleration(t, motion)
        w.v_out[:], w.lam_out[:] = motion.v, lam
        w.a_out[:-1] = a.reshape(-1, 6)
        evaluate_constraints(tables, kin, s.angle, self._inputs, True, w.phi_end, w.J_end)
        constraint_input_rates(tables, self._inputs, w.phi_t, w.phi_tt)
        evaluate_forces(tables, kin, s.angle, s.z, 0.0, self._inputs, False, w.f, w.Kq, w.Kv, w.z_stage, self.outputs)
        update_energy(tables, kin, self.outputs, w.lam_out, w.phi_t, self.h, w.energy)
        self._collect()
