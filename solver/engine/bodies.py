"""The state of a model of bodies, its start, and what of it is shown: the common part of the engines that move
bodies."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from typing import Any, cast

import numpy as np

from solver.checks.motion import BRANCH_SWITCHES
from solver.compiled.by_reference import Ref, nbytes
from solver.compiled.kernel import address_of
from solver.engine.ahead import Ahead
from solver.files.urdf import robot_description
from solver.inputs.driver import Sight
from solver.model.compile import compile_model
from solver.model.evaluate import constraint_input_rates, evaluate_constraints, evaluate_forces, prepare
from solver.model.saddle import new_saddle
from solver.model.scale import slow_speed
from solver.model.state import State, copy_state, fill_kinematics, fitting, kinematics_of, new_state
from solver.model.tables import Model
from solver.output.account import Account, require_account
from solver.output.branches import BranchSwitch, BranchWatch, switches_before
from solver.output.collect import channels_of, collect
from solver.output.dependence import describe, scaled_jacobian
from solver.output.energy import show_energies, update_energy
from solver.output.snapshot import OutputArrays, layout_of, new_numbers, output_arrays
from solver.scene import Scene
from solver.start.displacement import displace, require_free, require_near, sight
from solver.start.initial_conditions import InitialConditions
from solver.start.known import start_of
from solver.start.newton import ConsistentState
from solver.start.placement import Changes
from solver.start.reach import beyond_reach
from solver.step.augmented_lagrangian import perform
from solver.step.constraint_coefficients import ConstraintCoefficients, coefficients_of, weigh
from solver.step.failure import sentence
from solver.step.scheme import scheme_of
from solver.step.settings import IntegratorSettings
from solver.step.work import NOT_CONVERGED, LastStep, Scheme, StepResult, new_work
from solver.vehicle.size import scale_of


class Bodies:
    """Model, state and outputs of a scene of bodies (solver.engine.Shown). Raises SpecError or SceneError.

    states: the current one, and room for the next. scheme: the settings of the step as it takes them. branches: looks
    for branch switches where the scene asks for them. rescued: branch switches across steps that failed and were
    divided. ahead: compiles the kernel of the step as its first part. bound: False for types alone, for a step that is
    compiled and never made.
    """

    def __init__(self, scene: Scene, *, ahead: Ahead | None = None, bound: bool = True) -> None:
        self.scene = scene
        self.model: Model = prepare(scene.model) if bound else compile_model(scene.model)
        if ahead is not None:
            ahead.ready(1)
        record = scene.record
        self.channels = channels_of(self.model, motions=record.motions > 0.0, energies=record.energies > 0.0)
        self.chassis = self.channels.chassis or 0
        self.settings: IntegratorSettings = scene.integrator
        if self.settings.step_policy == 'auto':
            self.settings = dataclasses.replace(self.settings, step_policy='rescue')
        values = scheme_of(self.model, self.settings)
        self.outputs = self.model.new_outputs()
        self.layout = layout_of(self.channels)
        self.numbers = new_numbers(self.layout)
        frame = output_arrays(self.numbers, self.layout)
        self.work = self._scratch(values, self.outputs, frame)
        # what a step is compiled for
        shapes = (*(Ref(new_state(self.model)) for _ in range(2)), np.zeros(len(scene.model.inputs)))
        self.step_arguments = self.model.tables, Ref(values), *shapes
        values = values._replace(step=address_of(perform, *self.step_arguments, True, self.work))
        if values.coupled or values.full:
            values = values._replace(weigh=address_of(weigh, self.model.tables, Ref(values), self.work))
        self.scheme = Ref(values)
        self.kin = Ref(self.work.kin_end)
        self._account = Ref(self.work.account)
        self._frame = Ref(frame)
        self.states = [Ref(new_state(self.model)), Ref(new_state(self.model))]
        self._initial, self._consistent = new_state(self.model), new_state(self.model)
        self._first: tuple[bytes, list[np.ndarray]] | None = None  # inputs and outputs of the start
        # inputs of a state that was taken up and not looked at, and where its outputs are kept
        self._due: tuple[np.ndarray, MutableMapping[Any, Sequence[np.ndarray]]] | None = None
        watched = scene.record.branches or BRANCH_SWITCHES.require in scene.require.limits
        self.branches = BranchWatch() if watched else None
        self.rescued: list[BranchSwitch] = []

    def _scratch(self, values: Scheme, outputs: np.ndarray, frame: OutputArrays) -> Ref:
        """Scratch of a step, which fills these outputs and the frame."""
        return new_work(self.model, new_saddle(self.model, values.form), outputs, frame)

    @property
    def h(self) -> float:
        """Step of the grid [s]."""
        return self.scene.integrator.h_ns * 1e-9

    @property
    def state(self) -> State:
        """The current state (the arrays themselves)."""
        return cast(State, self.states[0].value)

    @property
    def account(self) -> Account:
        """The running account."""
        return cast(Account, self.work.account)

    def start(self, u: np.ndarray, explain: Callable[[StepResult], str]) -> Changes:
        """Find the consistent state at t = 0 and keep it. explain: says why a step that seeks it failed. Raises
        ConsistencyError."""
        values = cast(Scheme, self.scheme.value)

        def find() -> Changes:
            # scratch of its own: an engine is the same, to its last byte, whether its start was found or known
            frame = output_arrays(new_numbers(self.layout), self.layout)
            conditions = InitialConditions(
                self.scene.start, self.model, self.states, values, u, chassis=self.chassis,
                work=self._scratch(values, self.model.new_outputs(), frame), explain=explain,
            )  # fmt: skip
            found = conditions.find()
            copy_state(conditions.consistent, self._consistent)
            copy_state(self.state, self._initial)
            return found

        found = start_of(self.scene, self.model.spec, values, u, (self._consistent, self._initial), find)
        self._first = None
        for state in self.states:
            copy_state(self._initial, cast(State, state.value))
        self._know_slow()
        return found

    def start_like(self, other: Bodies, u: np.ndarray) -> None:
        """Take the start that other bodies of the same model have found; the integrator begins from it with the step of
        these."""
        values = cast(Scheme, self.scheme.value)
        self._first = None
        copy_state(other._consistent, self._consistent)
        copy_state(other._consistent, self.state)
        ConsistentState(self.model).start_integrator(self.state, u, values.h, values.am, values.af)
        copy_state(self.state, self._initial)
        self._know_slow()

    def _know_slow(self) -> None:
        """Set the speed below which motions count as slow from the start, where nothing weighs (solver.model.scale)."""
        length, slow = scale_of(self.model.spec)
        if not slow > 0.0:
            largest = lambda x: max(np.abs(x[:-1, :3]).max(initial=0.0), length * np.abs(x[:-1, 3:]).max(initial=0.0))  # noqa: E731
            slow = slow_speed(length, 0.0, float(largest(self.state.v)), float(largest(self.state.a_stage)), self.h)
        self.work.slow[0] = slow

    def reset(self) -> None:
        """Back to the state that start() found."""
        copy_state(self._initial, self.state)
        self.rescued.clear()
        self._due = None

    def show_start(self, u: np.ndarray) -> None:
        """As show() at the state that start() found, whose outputs are evaluated once."""
        if self._first is None or self._first[0] != u.tobytes():
            self.show(u)
            self._first = u.tobytes(), [array.copy() for array in (*self._visible, self.account.numbers)]
        for array, kept in zip((*self._visible, self.account.numbers), self._first[1], strict=True):
            np.copyto(array, kept)

    def show_later(self, u: np.ndarray, kept: MutableMapping[Any, Sequence[np.ndarray]]) -> None:
        """The current state under the inputs u (nu,) is shown when somebody looks; the account stands. kept: where its
        outputs are found, or kept."""
        self._due = u.copy(), kept
        self.work.u_before[:] = u

    @property
    def due(self) -> bool:
        """True where the outputs are not those of the present state yet."""
        return self._due is not None

    def overtaken(self) -> None:
        """A step shows another state than that which was left until somebody looks."""
        self._due = None

    def current(self) -> None:
        """Evaluate the outputs of the present state where that has been left until somebody looks."""
        if self._due is None:
            return
        (u, kept), self._due = self._due, None
        if self not in kept:
            account = self.account.numbers.copy()
            self.show(u)
            self.take_account(account)
            kept[self] = [array.copy() for array in self._visible]
        for array, copy in zip(self._visible, kept[self], strict=True):
            np.copyto(array, copy)

    @property
    def _visible(self) -> tuple[np.ndarray, ...]:
        """Everything that show() assigns but the account."""
        w, kin = self.work, self.work.kin_end
        motion = (kin.R, kin.p, kin.v, w.v_out, w.a_out, w.lam_out)
        rows = (w.phi_end, w.J_end, w.phi_t, w.phi_tt)
        return (*motion, *rows, w.f, w.z_stage, w.u_before, self.outputs, self.numbers)

    def show(self, u: np.ndarray) -> None:
        """Show the current state under the inputs u (nu,) where no step has led to it; the energy account begins."""
        self._due = None
        w, t, s, kin = self.work, self.model.tables, self.state, self.kin
        fill_kinematics(s.q, s.v, kin)
        evaluate_constraints(t, kin, s.angle, u, True, w.phi_end, w.J_end)
        constraint_input_rates(t, u, w.phi_t, w.phi_tt)
        start = ConsistentState(self.model)
        start.project_velocity(projected := s._replace(v=s.v.copy()), u)
        w.v_out[:] = projected.v
        w.a_out[:], w.lam_out[:] = start.acceleration(s.q, projected.v, s.z, s.angle, u)
        fill_kinematics(s.q, projected.v, kin)
        evaluate_forces(t, kin, s.angle, s.z, 0.0, u, False, w.f, w.Kq, w.Kv, w.z_stage, self.outputs)
        self.keep_account(0.0)
        w.u_before[:] = u
        w.marks[:] = 0.0
        self.collect(u)

    def take_account(self, numbers: np.ndarray) -> None:
        """Go on with the numbers of an account of the state that is shown, and show its energies."""
        self.account.numbers[:] = numbers
        show_energies.py_func(self.account, self._frame.value)

    def keep_account(self, h: float) -> None:
        """Advance the energy balance by a step of h [s] that led to the state that is shown; 0 begins it."""
        w = self.work
        update_energy(self.model.tables, self.kin, self.outputs, w.lam_out, w.phi_t, h, self._account)

    def collect(self, u: np.ndarray) -> None:
        """Show the current state and the outputs that were evaluated last."""
        w = self.work
        collect(
            self.model.tables, w.chassis, self.kin, w.a_out, w.lam_out, w.marks, u, self.states[0], self.outputs,
            self._account, self._frame,
        )  # fmt: skip

    def look(self, t: float) -> None:
        """Look for a branch switch at time t [s], where the scene asks for it."""
        if self.branches is not None:
            self.branches.look(t, scaled_jacobian(self.model, self.work.J_end))

    @property
    def switches(self) -> list[BranchSwitch]:
        """Branch switches so far: all of them if the scene asks for that, else those across steps that failed and were
        divided."""
        return self.rescued if self.branches is None else self.branches.events

    def place(self, x: float, y: float, heading: float) -> None:
        """Move everything so that the chassis stands at x, y [m] with a heading [rad]. Raises SpecError for a model
        that is connected to the world, on a road that is not the same everywhere, and for a place too far off."""
        require_free(self.scene.model)
        require_near(x, y)
        displace(self.state, self.sight(), (x, y, heading))

    def sight(self) -> Sight:
        """Motion of the vehicle that a driver sees now."""
        return sight(self.state.q[self.chassis], self.state.v[self.chassis], self.model.spec.bodies[self.chassis].com)

    def failure(self, result: StepResult, when: str, u: np.ndarray | None = None) -> str:
        """Why a step failed, in one sentence that begins with `when`. u (nu,): the inputs of that step, where a driver
        may have asked for more than the mechanism can do."""
        why = (
            beyond_reach(self.model, self.state, u, self.h) if u is not None and result.status == NOT_CONVERGED else ''
        )
        if why:
            return f'{when}: {why}'
        return sentence(self.model, self.scene.integrator, self.scheme, self.state, self.work, result, when)

    def arrays(self) -> dict[str, np.ndarray]:
        """State and branch switches, for fit()."""
        watched = {} if self.branches is None else self.branches.memory()
        return {**self.state._asdict(), 'switches': np.array(self.switches).reshape(-1, 2), **watched}

    def fit(self, saved: Mapping[str, np.ndarray]) -> Callable[[], None]:
        """Function that takes up arrays(). Raises SpecError where they are of another model."""
        state = State(*(fitting(name, saved.get(name), array) for name, array in self.state._asdict().items()))
        require_account(saved.get('audit'), self.account)
        past = switches_before(saved)
        watch = BranchWatch() if self.branches is not None else None
        if watch is not None:
            watch.recall(dict(saved), past)

        def take_up() -> None:
            copy_state(state, self.state)
            self._due = None
            self.rescued[:] = past
            self.branches = watch

        return take_up

    def last_step(self) -> LastStep:
        """Data that the last step worked with."""
        w = self.work
        return LastStep(w.phi_end, w.J_end, w.J_stage, w.phi_t, w.lam_out, w.saddle.W, w.account)

    def constraint_coefficients(self, u: np.ndarray, *, coupled: bool = False) -> dict[str, ConstraintCoefficients]:
        """m, c, k, f of every constraint row at the current state under the inputs u (nu,)."""
        return coefficients_of(self.model, self.state, u, self.model.new_outputs(), coupled=coupled)

    def describe(self, u: np.ndarray) -> dict[str, Any]:
        """Counts, degrees of freedom, redundancy and reactions that are not unique, at the current configuration."""
        kin = kinematics_of(self.state.q, self.state.v)  # not that of the outputs
        phi, J = np.zeros(self.model.n_rows), np.zeros_like(self.work.J_end)
        evaluate_constraints(self.model.tables, kin, self.state.angle, u, True, phi, J)
        return describe(self.model, J)

    def urdf(self, joints: Mapping[str, float], pose: np.ndarray) -> str:
        """The spanning tree of the model as URDF."""
        return robot_description(self.model.spec, pose, dict(joints), self.scene.name)

    def nbytes(self) -> int:
        """Memory of the tables of the model, of the scratch of a step and of a state."""
        return nbytes(
            (
                self.model.tables.value,
                *(table.value for table in self.model.elements.values()),
                self.work.value,
                self.state,
            )
        )
