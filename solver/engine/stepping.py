"""The engine of bodies: steps of the augmented Lagrangian, constant or adapting (solver.step)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from solver.compiled.by_reference import Ref
from solver.compiled.kernel import address_of
from solver.elements.registry import CONSTRAINTS, FORCES
from solver.engine import Kept, Moved, instant
from solver.engine.ahead import Ahead
from solver.engine.bodies import Bodies
from solver.errors import SpecError
from solver.inputs.driving import Driven
from solver.model.saddle import CONDENSED, new_saddle
from solver.model.state import State, copy_state
from solver.output.branches import BranchSwitch
from solver.output.seen import Seen
from solver.output.snapshot import NO_STEPS
from solver.scene import Scene
from solver.start.branch_check import turn_across
from solver.start.placement import Changes
from solver.step.adaptation import Adaptation, is_idle
from solver.step.augmented_lagrangian import advance
from solver.step.control import Event
from solver.step.driven import advance_driven
from solver.step.extrapolation import extrapolate, require_resolved_bushings, require_resolved_friction
from solver.step.seen import advance_seen
from solver.step.work import OK

KINDS = ('alf', 'm_alf')  # of integrators
# Kinds of elements whose kernels are compiled for lanes (solver.engine.stepping_lanes); the next ones are listed here
# once a test has their bits.
IN_LANES = ('aero_drags', 'coordinate_forces', 'couplers', 'guides', 'joints', 'servos', 'tires')


class Stepping:
    """See solver.engine.Engine. adaptation: chooses steps and penalties, where the settings let them change."""

    follows = False

    def __init__(self, scene: Scene, *, bound: bool = True) -> None:
        if scene.integrator.kind not in KINDS:
            raise SpecError(
                f'integrator: kind = {scene.integrator.kind!r}: this engine knows {", ".join(KINDS)}; use '
                'simulation_of(scene)'
            )
        self.scene = scene
        self._ahead = Ahead(lambda: Bodies(scene, bound=False), lambda: Stepping(scene, bound=False).compile())
        if bound:
            with self._ahead:
                self.shown = bodies = Bodies(scene, ahead=self._ahead)
        else:
            self.shown = bodies = Bodies(scene, bound=False)
        self._h, self._tables = bodies.h, bodies.model.tables
        settings = bodies.settings
        # A force-like input is held over the interval of the grid: with steps of any size inside, its mean is what
        # matters.
        hold = 0.5 if settings.step_policy == 'error' else bodies.scheme.af
        self.stage = 1.0 - hold
        self.adaptation: Adaptation | None = None
        if settings.adapts:
            fourth = 0
            if settings.order == 4:
                require_resolved_friction(self.shown.model, settings.h)
                require_resolved_bushings(self.shown.model, settings.h)
                masses = Ref(new_saddle(self.shown.model, CONDENSED))
                fourth = address_of(
                    extrapolate, self.shown.model.tables, masses, *bodies.step_arguments[2:], True, True, bodies.work
                )
            self.adaptation = Adaptation(self.shown.model, settings, bodies.scheme, bodies.work, hold, fourth)

    @property
    def alone(self) -> str:
        """See Engine.alone."""
        settings, scheme = self.shown.settings, self.shown.scheme
        reasons = {
            'step_policy: error and order: 4 choose other steps in each': settings.step_policy == 'error'
            or settings.order == 4,
            'penalty_policy: adaptive chooses other penalties in each': settings.penalty_policy == 'adaptive',
            'effective masses that are coupled, or have stiffness': scheme.weigh != 0,
            'constraints in block form': scheme.form != CONDENSED,
        }
        why = next((f'integrator: {why}' for why, here in reasons.items() if here), '')
        if self.shown.branches is not None:
            why = 'branch switches are looked for behind every step'
        spec = self.shown.model.spec
        names = [*(kind.name for kind in FORCES), *(kind.name for kind in CONSTRAINTS)]
        kinds = (name for name in names if getattr(spec, name))
        return why or next((f'{kind} do not step in lanes' for kind in kinds if kind not in IN_LANES), '')

    def start(self, u: np.ndarray) -> Changes:
        """Find the consistent state at t = 0. Raises ConsistencyError."""
        found = self.shown.start(u, lambda result: self.shown.failure(result, instant(self.scene, 0)))
        self._ahead.ready(2)
        return found

    def compile(self) -> None:
        """Compile the kernels that advance, and make no step."""
        none = np.zeros((1, len(self.scene.model.inputs)))
        if self.adaptation is not None:
            self.adaptation.advance(self.shown.states, none, 0, 0, 0, False, lambda k: None)
        else:
            advance(self._tables, self.shown.scheme, *self.shown.states, none, 0, 0, False, self.shown.work)

    def start_like(self, other: Stepping, u: np.ndarray) -> None:
        """See Engine.start_like()."""
        self.shown.start_like(other.shown, u)

    def reset(self, u: np.ndarray) -> None:
        """Back to the start, bit for bit."""
        self.shown.reset()
        if self.shown.branches is not None:
            self.shown.branches.reset()
        self.shown.show_start(u)
        if self.adaptation is not None:
            self.adaptation.start(self.shown.state)

    def _show(self, u: np.ndarray) -> None:
        if self.shown.branches is not None:
            self.shown.branches.reset()
        self.shown.show(u)

    def begin(self, k: int, u: np.ndarray) -> None:
        """Go on from the present state."""
        self._show(u)
        if self.adaptation is not None:
            self.adaptation.start(self.shown.state)

    def show(self, k: int, u: np.ndarray) -> None:
        """Show the present state; the account goes on."""
        kept = self.shown.account.numbers.copy()
        self.shown.show(u)
        self.shown.take_account(kept)

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
        """See Engine.advance(). Every step is a call of its own while branches are looked for."""
        bodies, adaptation, held = self.shown, self.adaptation, len(inputs) == 1
        # what is not finite is refused before anything is advanced
        looks = audit and bodies.branches is not None and bool(np.isfinite(inputs).all())
        part = 1 if looks else n
        total, done = NO_STEPS, 0
        begin = State(*map(np.copy, bodies.state)) if bodies.due else None
        while done < n:
            if adaptation is not None:
                result, steps = adaptation.advance(
                    bodies.states, inputs, done, part, k + done, audit, lambda k: self._look_at_rescue(k, last), seen,
                    bodies.numbers, driven,
                )  # fmt: skip
            elif driven is not None:
                every, rows = (0, bodies.numbers[None]) if seen is None else (seen.every, seen.free)
                result, steps, taken = advance_driven(
                    self._tables, bodies.scheme, *bodies.states, driven.driver, driven.wanted[done:], inputs[done:],
                    part, k + done, audit, every, bodies.numbers, rows, bodies.work,
                )  # fmt: skip
                if seen is not None:
                    seen.took(k + done, taken)
                if steps % 2 == 1:
                    bodies.states.reverse()
            elif seen is not None:
                result, steps, taken = advance_seen(
                    self._tables, bodies.scheme, *bodies.states, inputs, done, part, k + done, audit, seen.every,
                    bodies.numbers, seen.free, bodies.work,
                )  # fmt: skip
                seen.took(k + done, taken)
                if steps % 2 == 1:
                    bodies.states.reverse()
            else:
                result, steps = advance(
                    self._tables, bodies.scheme, *bodies.states, inputs, done, part, audit, bodies.work
                )
                if steps % 2 == 1:
                    bodies.states.reverse()
            done += steps
            if steps:
                last[:] = inputs if held else inputs[done - 1]
            total = result.counters if total is NO_STEPS else total.followed_by(result.counters)
            if result.status != OK:
                why = bodies.failure(result, instant(self.scene, k + done), inputs[0 if held else done])
                if begin is not None and done:
                    self._show_as_before(begin)
                return Moved(done, total, why)
            if steps < part:  # somebody asks for an end
                self.show(k + done, last)
                break
            if looks:
                bodies.look((k + done) * self.scene.integrator.h_ns * 1e-9)
        if done:
            bodies.overtaken()
        return Moved(done, total)

    def _show_as_before(self, begin: State) -> None:
        """After a failure outputs stay those before the call, here of a state that nobody has looked at."""
        now = State(*map(np.copy, self.shown.state))
        copy_state(begin, self.shown.state)
        self.shown.current()
        copy_state(now, self.shown.state)

    def _look_at_rescue(self, k: int, u: np.ndarray) -> None:
        """Note whether the steps that replaced one that failed, up to step k of the grid, left on another branch than
        they came."""
        assert self.adaptation is not None
        bodies = self.shown
        turn = turn_across(self.shown.model, self.adaptation.values.begin, bodies.state, u, self._h, bodies.work.J_end)
        if turn > 0.0:
            bodies.rescued.append(BranchSwitch((k - 1) * self.scene.integrator.h_ns * 1e-9, turn))

    def arrays(self) -> dict[str, np.ndarray]:
        """Bodies, and what adaptation remembers."""
        adapted = {} if self.adaptation is None else {**self.adaptation.memory(), **self.adaptation.past()}
        return {**self.shown.arrays(), **adapted}

    def fit(self, saved: Mapping[str, np.ndarray], k: int) -> Callable[[np.ndarray, Kept], None]:
        """See Engine.fit()."""
        adapted = 'adaptation' in saved and not is_idle(dict(saved), self._h, self.shown.scheme.penalty)
        if self.adaptation is None and adapted:
            raise SpecError(
                'restore: the state was saved while step or penalties were not those of the setting; set '
                'integrator.step_policy and penalty_policy as they were'
            )
        bodies = self.shown.fit(saved)

        def take_up(u: np.ndarray, kept: Kept) -> None:
            bodies()
            self.shown.account.numbers[:] = saved['audit']
            self.shown.show_later(u, kept)
            if self.adaptation is not None:
                if 'adaptation' in saved:
                    self.adaptation.recall(dict(saved), k * self.scene.integrator.h_ns * 1e-9)
                else:  # which begins with the velocity that is shown
                    self.shown.current()
                    self.adaptation.start(self.shown.state, k)

        return take_up

    @property
    def events(self) -> list[Event]:
        """Every change of step and penalties."""
        return self.adaptation.events if self.adaptation is not None else []

    def reached(self) -> dict[str, tuple[float, float | None]]:
        """Nothing is followed of a model as given."""
        return {}

    def totals(self, k: int) -> dict[str, Any]:
        """See Engine.totals()."""
        a, watch = self.adaptation, self.shown.branches
        return {
            'substeps': k if a is None else a.substeps,
            'rejected': 0 if a is None else a.rejected,
            'smallest_step': self._h if a is None else min(self._h, a.smallest),
            'events': 0 if a is None else a.noted,
            **({} if watch is None else {'branch_switches': len(watch.events)}),
        }
