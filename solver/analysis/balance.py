"""Balances of energy and momentum of a run, separately for each kind of element.

At the end of every step the forces of each kind are evaluated alone, on the motion that the run shows (with projected
velocities). Over time then holds

    work on the bodies + change of the stored energy + dissipated energy = energy supplied by inputs    for every kind
    change of kinetic energy = work of all kinds, of gravity and of the constraints
    change of momentum       = impulse of all of these; the impulse of a kind that acts between bodies is zero

The integrals over time follow the trapezoidal rule. So the balances close to second order of the step, except at
instants where a force jumps (a brake that begins to stick). A balance does not change the run.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from solver.compiled.by_reference import Ref
from solver.elements.registry import FORCE_BY_NAME, FORCES
from solver.inputs.maneuver import is_motion_part
from solver.model.evaluate import add_constraint_forces, evaluate_forces
from solver.simulation import Simulation


class Balance:
    """The balances of a simulation from its present state on. update() must be called after every single step."""

    def __init__(self, simulation: Simulation) -> None:
        """Raises SpecError for a level of detail that has no bodies."""
        _ = simulation.state
        self._simulation = simulation
        spec, tables = simulation.model.spec, simulation.model.tables
        kinds = [kind.name for kind in FORCES if getattr(spec, kind.name)]
        self._alone = {kind: simulation.model.only(kind) for kind in kinds}
        self._no_elements = simulation.model.only(None)
        self._fed = {kind: np.array([FORCE_BY_NAME[kind].feeds(e) for e in getattr(spec, kind)]) for kind in kinds}
        self._constraints = Ref(tables.constraints)
        self.rows = (*kinds, 'gravity', 'constraints')
        model = simulation.model
        self._f, self._z = np.zeros((model.n_bodies + 1, 6)), np.zeros(model.n_internal)
        self._no_tangents, self._outputs = np.zeros((model.n_slots + 1, 6, 6)), model.new_outputs()
        self._time = simulation.k
        self._inputs = simulation.inputs.copy()
        # The inputs of forces are those at the stage within the step. They are extrapolated to its end, as
        # accelerations are.
        names = spec.inputs
        self._ahead = np.array([0.0 if is_motion_part(name, names) else simulation.scheme.af for name in names])
        self._rates = self._evaluate()
        self._start = self._now
        # (rows, 9) integrals over time of: power on the bodies, dissipation, supply, force (3), moment about the origin
        # (3)
        self.total = np.zeros_like(self._rates)

    def update(self) -> None:
        """Add the step that was just made. Raises ValueError if more or less than one step was made since the last
        call."""
        if self._simulation.k != self._time + 1:
            raise ValueError(
                f'balance: from step {self._time} to step {self._simulation.k}; it has to be updated after every step'
            )
        self._time += 1
        before, self._rates = self._rates, self._evaluate()
        self._inputs = self._simulation.inputs.copy()
        self.total += 0.5 * self._simulation.h * (before + self._rates)

    def _evaluate(self) -> np.ndarray:
        """(rows, 9) rates of all integrals now; sets _now: (stored energies, kinetic energy, momentum)."""
        s = self._simulation
        last, kin, state, bodies = s.last_step, s.kinematics, s.state, s.model.tables.bodies
        inputs = s.inputs + self._ahead * (s.inputs - self._inputs)
        stored, dissipated, supplied = np.zeros((3, len(self.rows)))
        acting = np.zeros((len(self.rows), *self._f.shape))

        def forces(tables: Ref) -> np.ndarray:
            none, out = self._no_tangents, self._outputs
            evaluate_forces(tables, kin, state.angle, state.z, 0.0, inputs, False, self._f, none, none, self._z, out)
            return self._f.copy()

        base = forces(self._no_elements)  # gravity and gyroscopic torques, which are in every evaluation
        for row, kind in enumerate(self.rows[:-2]):
            acting[row] = forces(self._alone[kind]) - base
            out = s.model.outputs(kind, self._outputs)
            stored[row] = out[:, 0].sum()
            fed = -out[self._fed[kind], 1].sum()
            dissipated[row], supplied[row] = out[:, 1].sum() + fed, fed
        weight, reaction = acting[-2:]
        weight[:-1, :3] = bodies.mass[:, None] * bodies.gravity
        stored[-2] = -float((weight[:, :3] * kin.p).sum())
        add_constraint_forces(self._constraints, last.J, last.lam, 1.0, reaction)
        reaction[-1] = 0.0
        supplied[-1] = -float(last.lam @ last.phi_t)
        moment = np.cross(kin.p, acting[..., :3]) + np.einsum('bij,kbj->kbi', kin.R, acting[..., 3:])
        power = (acting * kin.v).sum(axis=(1, 2))
        rates = np.column_stack([power, dissipated, supplied, acting[..., :3].sum(axis=1), moment.sum(axis=1)])
        v = kin.v[:-1]
        spin = np.einsum('bij,bj->bi', bodies.inertia, v[:, 3:])
        p = bodies.mass[:, None] * v[:, :3]
        kinetic = 0.5 * float((p * v[:, :3]).sum() + (spin * v[:, 3:]).sum())
        angular = np.cross(kin.p[:-1], p) + np.einsum('bij,bj->bi', kin.R[:-1], spin)
        self._now = stored, kinetic, np.concatenate([p.sum(axis=0), angular.sum(axis=0)])
        return rates

    @property
    def momentum_error(self) -> np.ndarray:
        """(6,) change of momentum [N s] and of angular momentum about the origin [N m s], minus the impulse of all
        forces."""
        return self._now[2] - self._start[2] - self.total[:, 3:].sum(axis=0)

    def report(self) -> dict[str, Any]:
        """Balances since the start as an object for JSON.

        `energy_by_kind`: kind -> energies [J]: work on the bodies, change of the stored energy, dissipated, supplied by
        inputs, and error = work + stored + dissipated - supplied. The entry 'bodies' has the kinetic energy as stored,
        and its error is kinetic energy - work of all kinds. `momentum_error`: see there [N s, N m s].
        """
        stored = self._now[0] - self._start[0]
        table: dict[str, Any] = {}
        for row, kind in enumerate(self.rows):
            work, dissipated, supplied = (float(x) for x in self.total[row, :3])
            error = work + float(stored[row]) + dissipated - supplied
            table[kind] = {
                'work': work,
                'stored': float(stored[row]),
                'dissipated': dissipated,
                'supplied': supplied,
                'error': error,
            }
        kinetic, work = self._now[1] - self._start[1], float(self.total[:, 0].sum())
        table['bodies'] = {
            'work': -work,
            'stored': kinetic,
            'dissipated': 0.0,
            'supplied': 0.0,
            'error': kinetic - work,
        }
        return {'energy_by_kind': table, 'momentum_error': self.momentum_error.tolist()}
