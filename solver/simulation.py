"""Simulation: a scene in motion. Owns the two state buffers; hands out Snapshots."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, cast

import numpy as np

from solver.compiled.by_reference import Ref, nbytes
from solver.compiled.kernel import address_of
from solver.errors import SpecError, StepError
from solver.files.urdf import robot_description
from solver.inputs.assistance import Feel, feel_of
from solver.inputs.driver import Sight
from solver.inputs.maneuver import ManeuverSource
from solver.inputs.recorded import RecordedSource
from solver.inputs.sources import Sources
from solver.model.evaluate import constraint_input_rates, evaluate_constraints, evaluate_forces, prepare
from solver.model.saddle import CONDENSED, new_saddle
from solver.model.state import State, copy_state, fill_kinematics, fitting, kinematics_of, load_state, new_state, save_state
from solver.model.tables import Model
from solver.output.branches import BranchSwitch, BranchWatch, past_of
from solver.output.collect import channels_of, collect
from solver.output.dependence import describe, scaled_jacobian
from solver.output.energy import TIME, WORST, update_energy
from solver.output.snapshot import NO_STEPS, Counters, Snapshot, layout_of, new_numbers, output_arrays
from solver.scene import Scene
from solver.start.displacement import displace, require_free, require_near, sight
from solver.start.initial_conditions import InitialConditions
from solver.start.newton import ConsistentState
from solver.start.reach import beyond_reach
from solver.start.rescue import turn_across
from solver.step.adaptation import Adaptation, is_idle
from solver.step.augmented_lagrangian import advance, perform
from solver.step.constraint_coefficients import ConstraintCoefficients, coefficients_of, weigh
from solver.step.control import Event
from solver.step.extrapolation import extrapolate, require_resolved_friction
from solver.step.failure import sentence
from solver.step.scheme import scheme_of
from solver.step.work import NOT_CONVERGED, OK, LastStep, StepResult, new_work
from solver.vehicle.actuation import assisted_wheels, reaches, steering_reaches

if TYPE_CHECKING:
    from solver.levels.derived import LevelReport


class Simulation:
    """Compile a scene, find its consistent start, advance it in whole steps.

    Raises SpecError, SceneError or ConsistencyError on construction and StepError from advance(); each is one sentence.
    level: what the model leaves out of the vehicle it was derived from (None: it is the model of the scene as given). displaced: it was
    placed somewhere, renumbered or restored since its start, so not even step 0 need be that of the scene. of_bodies: whether its states
    are those of bodies.
    """

    KINDS: tuple[str, ...] = ('alf', 'm_alf')  # of integrators
    level: LevelReport | None = None
    displaced = False
    of_bodies = True

    def __init__(self, scene: Scene) -> None:
        if scene.reduced:
            raise SpecError(f'fidelity = {scene.fidelity!r}: {type(self).__name__} simulates models as given; use simulation_of(scene)')
        self.scene = scene
        self.model: Model = prepare(scene.model)
        self.channels = channels_of(self.model, motions=scene.record.motions > 0.0)
        self._chassis = self.channels.chassis or 0
        settings = scene.integrator
        if settings.step_policy == 'auto':
            settings = dataclasses.replace(settings, step_policy='rescue')
        self.h_ns = settings.h_ns
        self.h = self.h_ns * 1e-9
        if settings.kind not in self.KINDS:
            raise SpecError(
                f'integrator: kind = {settings.kind!r}: {type(self).__name__} knows {", ".join(self.KINDS)}; use simulation_of(scene)'
            )
        values = scheme_of(self.model, settings)
        self.outputs = self.model.new_outputs()
        self._layout = layout_of(self.channels)
        self._numbers = new_numbers(self._layout)
        frame = output_arrays(self._numbers, self._layout)
        self._work = new_work(self.model, new_saddle(self.model, values.form), self.outputs, frame)
        arguments = self.model.tables, Ref(values), *(Ref(new_state(self.model)) for _ in range(2)), np.zeros(len(scene.model.inputs))
        values = values._replace(step=address_of(perform, *arguments, True, self._work))
        if values.coupled or values.full:
            values = values._replace(weigh=address_of(weigh, self.model.tables, Ref(values), self._work))
        self.scheme = Ref(values)
        # A force-like input is held over the interval of the grid: with steps of any size inside, its mean is what matters.
        hold = 0.5 if settings.step_policy == 'error' else values.af
        self.stage = 1.0 - hold
        self._kin = Ref(self._work.kin_end)
        self._take_inputs(scene)
        self._frame = Ref(frame)
        self.adaptation: Adaptation | None = None
        if settings.adapts and settings.kind in Simulation.KINDS:
            fourth = 0
            if settings.order == 4:
                require_resolved_friction(self.model, settings.h)
                masses = Ref(new_saddle(self.model, CONDENSED))
                fourth = address_of(extrapolate, self.model.tables, masses, *arguments[2:], True, True, self._work)
            self.adaptation = Adaptation(self.model, settings, self.scheme, self._work, hold, fourth)
        self._states = [Ref(new_state(self.model)), Ref(new_state(self.model))]
        self._initial = new_state(self.model)
        self._inputs = np.zeros(len(scene.model.inputs))
        self._applied: np.ndarray | None = None
        self._totals = NO_STEPS
        self._rescued: list[BranchSwitch] = []
        watched = scene.record.branches or scene.require.branch_switches_max is not None
        self.branches = BranchWatch() if watched else None
        self.k = 0
        self.start = InitialConditions(
            scene, self.model, self._states, values, self.sources.reset(),
            chassis=self._chassis, work=self._work, explain=self._failure,
        ).find()  # fmt: skip
        copy_state(self.state, self._initial)
        self.reset()

    def _take_inputs(self, scene: Scene) -> None:
        """Prepare the sources of the inputs, sampled at the instant `stage` of a step. Raises SpecError."""
        wheels = assisted_wheels(scene.model) if scene.assistance else ()
        self.sources = Sources(
            scene.maneuver, scene.actuation, scene.assistance, scene.model.inputs, wheels, self.h_ns, self.stage,
            speed=scene.start.speed, duration=scene.duration, lock=scene.model.lock,
            reaches=reaches(scene.model) | steering_reaches(scene.model),
        )  # fmt: skip

    @property
    def source(self) -> ManeuverSource | RecordedSource:
        """Of the inputs that depend on time alone."""
        return self.sources.of_time

    @property
    def state(self) -> State:
        """The current state (the arrays themselves)."""
        return cast(State, self._states[0].value)

    # -- time ----------------------------------------------------------------------------------------------------------

    @property
    def t_ns(self) -> int:
        """Simulation time [ns]."""
        return self.k * self.h_ns

    @property
    def inputs(self) -> np.ndarray:
        """(nu,) inputs of the last step."""
        return self._inputs

    @property
    def applied(self) -> np.ndarray | None:
        """(n, nu) inputs of the n steps of the last advance(), as applied; None when the integrator looks at any time it likes."""
        return self._applied

    @property
    def kinematics(self) -> Ref:
        """Placement and velocities that the outputs show: of the end of the last step, projected onto the constraints."""
        return self._kin

    @property
    def last_step(self) -> LastStep:
        """What the last step worked with."""
        w = self._work
        return LastStep(w.phi_end, w.J_end, w.J_stage, w.phi_t, w.lam_out, w.saddle.W, w.energy)

    @property
    def reached(self) -> dict[str, tuple[float, float | None]]:
        """Quantities that the limits of a level are about -> the largest value so far, and its time [s] where it has one.

        Of a model as given nothing is followed.
        """
        return {}

    @property
    def nbytes(self) -> int:
        """Memory of the tables of the model, of the scratch of a step and of a state."""
        return nbytes((self.model.tables.value, *(table.value for table in self.model.elements.values()), self._work.value, self.state))

    def reset(self) -> None:
        """Back to the start, bit for bit."""
        copy_state(self._initial, self.state)
        self.k, self.displaced = 0, False
        self._totals = self._counters = NO_STEPS
        self._rescued.clear()
        self._inputs = self.sources.reset()
        self._refresh()
        if self.adaptation is not None:
            self.adaptation.start(self.state)

    def _refresh(self) -> None:
        """Begin anew at the current state: no step has produced its outputs, and the audit starts."""
        if self.branches is not None:
            self.branches.reset()
        self._show_present()

    def _show_present(self) -> None:
        """Outputs of the current state when no step has produced them; restarts the audit."""
        w, t, s = self._work, self.model.tables, self.state
        fill_kinematics(s.q, s.v, self._kin)
        kin = self._kin
        evaluate_constraints(t, kin, s.angle, self._inputs, True, w.phi_end, w.J_end)
        constraint_input_rates(t, self._inputs, w.phi_t, w.phi_tt)
        start = ConsistentState(self.model)
        start.project_velocity(projected := s._replace(v=s.v.copy()), self._inputs)
        w.v_out[:] = projected.v
        w.a_out[:], w.lam_out[:] = start.acceleration(s.q, projected.v, s.z, s.angle, self._inputs)
        fill_kinematics(s.q, projected.v, kin)
        evaluate_forces(t, kin, s.angle, s.z, 0.0, self._inputs, False, w.f, w.Kq, w.Kv, w.z_stage, self.outputs)
        update_energy(t, kin, self.outputs, w.lam_out, w.phi_t, 0.0, w.energy)
        w.u_before[:] = self._inputs
        self._collect()

    def _collect(self) -> None:
        """Show the current state and the outputs that were evaluated last."""
        w = self._work
        tables, states = self.model.tables, self._states
        collect(tables, w.chassis, self._kin, w.a_out, w.lam_out, self._inputs, states[0], self.outputs, self._frame)

    def advance(self, n: int = 1, inputs: np.ndarray | None = None, *, audit: bool = True) -> Snapshot:
        """Advance n steps and return the Snapshot after the last.

        inputs: (nu,) held for all steps, or (n, nu) one row a step; None samples maneuver and driver of the scene, behind its actuators.
        audit: evaluate forces after every step, keep the energy balance and look for branch switches if the scene asks for them. On
        failure the state is that of the last good step.
        """
        if inputs is None and self.sources.step_by_step:
            rows = np.empty((n, len(self._inputs)))
            for i in range(n):
                self._applied = rows[:i]
                rows[i] = self.sources.sample(self.k, self._sight, self.feel)
                self._advance(1, rows[i : i + 1], audit)
            self._applied = rows
            return self.snapshot()
        if inputs is None:
            inputs = self.source.table(self.k, n)
        elif inputs.ndim == 1:
            inputs = inputs[None, :]
        inputs = np.ascontiguousarray(inputs, float)
        if not inputs.flags.writeable:
            inputs = inputs.copy()  # kernels are compiled for arrays that can be written
        before = self.k
        try:
            self._advance(n, inputs, audit)
        finally:
            done = self.k - before
            self._applied = inputs[:done] if len(inputs) == n else np.broadcast_to(inputs, (done, inputs.shape[1]))
        return self.snapshot()

    def _advance(self, n: int, inputs: np.ndarray, audit: bool) -> None:
        watch = self.branches if audit else None
        part = n if watch is None else 1
        self._counters = NO_STEPS
        held = len(inputs) == 1
        for first in range(0, n, max(part, 1)):
            if self.adaptation is not None:
                result, done = self.adaptation.advance(self._states, inputs, first, part, self.k, audit, self._look_at_rescue)
            else:
                result, done = advance(self.model.tables, self.scheme, *self._states, inputs, first, part, audit, self._work)
                if done % 2 == 1:
                    self._states.reverse()
            self.k += done
            if done:
                self._inputs = inputs[0 if held else first + done - 1].copy()
            self._count(result.counters)
            if result.status != OK:
                raise StepError(self._failure(result, inputs[0 if held else first + done]))
            if done < part:  # somebody asks for an end
                energy = self._work.energy.copy()
                self._show_present()
                self._work.energy[:] = energy
                break
            if watch is not None:
                watch.look(self.t_ns * 1e-9, scaled_jacobian(self.model, self._work.J_end))

    def _look_at_rescue(self, k: int) -> None:
        """Note whether the steps that replaced one that failed, up to step k of the grid, left on another branch than they came."""
        assert self.adaptation is not None
        turn = turn_across(self.model, self.adaptation.values.begin, self.state, self._inputs, self.h, self._work.J_end)
        if turn > 0.0:
            self._rescued.append(BranchSwitch((k - 1) * self.h_ns * 1e-9, turn))

    def _sight(self) -> Sight:
        """What a driver sees now."""
        return sight(self.state.q[self._chassis], self.state.v[self._chassis], self.model.spec.bodies[self._chassis].com)

    def feel(self) -> Feel:
        """What an assistance measures now."""
        return feel_of(self._sight().speed, self.state.v, self._chassis, self.sources.wheels)

    def place(self, x: float, y: float, heading: float) -> None:
        """Move everything so that the chassis stands at x, y [m] with a heading [rad]; its motion goes on as it was, in its own axes.

        Raises SpecError for a model that is connected to the world, on a road that is not the same everywhere, and for a place too far off.
        """
        require_free(self.scene.model)
        require_near(x, y)
        displace(self.state, self._sight(), (x, y, heading))
        self.displaced = True
        seen = float(self.last_step.energy[TIME])
        self._refresh()
        self.last_step.energy[TIME] = seen  # the account begins anew, and of what was before was one
        if self.adaptation is not None:
            self.adaptation.start(self.state)

    def renumber(self, k: int) -> None:
        """Go on as step k: at another time, in motion as it is. What it shows is that of its state, not of the step that led to it."""
        self.k, self.displaced = k, True
        if self.of_bodies:
            energy = self.last_step.energy.copy()
            self._show_present()
            self.last_step.energy[:] = energy
        self.last_step.energy[TIME] = k * self.h  # of steps that are not made nothing is to be known

    def _count(self, counters: Counters) -> None:
        self._counters = counters if self._counters is NO_STEPS else self._counters.followed_by(counters)
        self._totals = self._totals.followed_by(counters)

    def _failure(self, result: StepResult, inputs: np.ndarray | None = None) -> str:
        """Why a step failed. inputs (nu,): those of that step, where a driver may have asked for more than the mechanism can do."""
        when = f't = {self.t_ns * 1e-9:.6f} s, step {self.k}'
        why = beyond_reach(self.model, self.state, inputs, self.h) if inputs is not None and result.status == NOT_CONVERGED else ''
        if why:
            return f'{when}: {why}'
        return sentence(self.model, self.scene.integrator, self.scheme, self.state, self._work, result, when)

    def snapshot(self) -> Snapshot:
        """The outputs of the last step, as a copy; after a failure those of the last call of advance() that succeeded."""
        return Snapshot(self.k, self.t_ns, self._numbers.copy(), self._layout, self._counters)

    # -- state and reports ---------------------------------------------------------------------------------------------

    def save(self) -> bytes:
        """Everything the future depends on, and what the run so far is judged by."""
        adapted = {} if self.adaptation is None else {**self.adaptation.memory(), **self.adaptation.past()}
        watched = {} if self.branches is None else self.branches.memory()
        past = {'totals': np.array(self._totals), 'switches': np.array(self.switches).reshape(-1, 2)}
        memory = {**past, **watched, **adapted, **self.sources.memory()}
        return save_state(self.state, self.k, {'inputs': self._inputs, 'audit': self._work.energy, **memory})

    def restore(self, data: bytes, *, elsewhere: bool = False) -> None:
        """Continue from save(); raises SpecError if it belongs to another model. elsewhere: it is that of another scene of the vehicle."""
        state, k, extra = load_state(data)
        for name, a, b in zip(State._fields, state, self.state, strict=True):
            fitting(name, a, b)
        adapted = 'adaptation' in extra and not is_idle(extra, self.h, self.scheme.penalty)
        if self.adaptation is None and adapted:
            raise SpecError(
                'restore: the state was saved while step or penalties were not those of the setting; set integrator.step_policy and '
                'penalty_policy as they were'
            )
        if extra.get('audit', np.zeros(0)).shape != self._work.energy.shape:
            raise SpecError('restore: the state was saved by another version of the solver; save it anew')
        inputs = fitting('inputs', extra.get('inputs'), self._inputs)
        past = past_of(extra, self._totals, self._rescued, k * self.h_ns * 1e-9)
        watch = BranchWatch() if self.branches is not None else None
        if watch is not None:
            watch.recall(extra, past[1])
        self.sources.recall(extra, inputs, elsewhere=elsewhere)
        copy_state(state, self.state)
        self.k, self.displaced = k, True
        self._inputs = inputs
        self._refresh()
        self._work.energy[:] = extra['audit']
        if self.adaptation is not None:
            if 'adaptation' in extra:
                self.adaptation.recall(extra, self.t_ns * 1e-9)
            else:
                self.adaptation.start(self.state, k)
        self._totals, self._rescued[:] = past
        self.branches = watch

    def __reduce__(self) -> tuple:
        """As its scene and save(): another process compiles the model anew, finds the same start, and goes on with the same bits."""
        return _resumed, (self._made(), self.scene, self.save(), self._counters, self.level, self.displaced)

    def _made(self) -> Callable[[Scene], Simulation]:
        """What makes a simulation like this of a scene."""
        return type(self)

    @property
    def events(self) -> list[Event]:
        """Every change of step and penalties that this simulation made; totals() counts those of the run before a restored state too."""
        return self.adaptation.events if self.adaptation is not None else []

    @property
    def switches(self) -> list[BranchSwitch]:
        """Branch switches so far: all of them if the scene asks for that, else those across steps that failed and were divided."""
        return self._rescued if self.branches is None else self.branches.events

    def constraint_coefficients(self, *, coupled: bool = False) -> dict[str, ConstraintCoefficients]:
        """m, c, k, f of every constraint row at the current state."""
        return coefficients_of(self.model, self.state, self._inputs, self.model.new_outputs(), coupled=coupled)

    def totals(self) -> dict[str, float]:
        """Counters and largest residuals since the start, the error of the energy account [J] and, if watched, branch switches."""
        return {
            **self._totals.report(),
            'energy_error_max': float(self._work.energy[WORST]),
            'substeps': self.k if self.adaptation is None else self.adaptation.substeps,
            'rejected': 0 if self.adaptation is None else self.adaptation.rejected,
            'smallest_step': self.h if self.adaptation is None else min(self.h, self.adaptation.smallest),
            'events': 0 if self.adaptation is None else self.adaptation.noted,
            **({} if self.branches is None else {'branch_switches': len(self.branches.events)}),
        }

    def urdf(self) -> str:
        """The spanning tree of the model at the current configuration as URDF (solver.files.urdf)."""
        now = self.snapshot()
        values = dict(zip(self.channels.joints, now.joint_position.tolist(), strict=True))
        return robot_description(self.model.spec, now.pose, values, self.scene.name)

    def describe(self) -> dict:
        """Counts, degrees of freedom, redundancy and reactions that are not unique, at the current configuration."""
        kin = kinematics_of(self.state.q, self.state.v)  # not that of the outputs
        phi, J = np.zeros(self.model.n_rows), np.zeros_like(self._work.J_end)
        evaluate_constraints(self.model.tables, kin, self.state.angle, self._inputs, True, phi, J)
        return describe(self.model, J)


def _resumed(
    make: Callable[[Scene], Simulation], scene: Scene, state: bytes, counters: Counters, level: LevelReport | None, displaced: bool
) -> Simulation:
    """Inverse of Simulation.__reduce__()."""
    simulation = make(scene)
    simulation.restore(state)
    simulation._counters, simulation.level, simulation.displaced = counters, level, displaced
    return simulation
