"""Simulation: a scene in motion. Keeps time, inputs and totals; an engine keeps the state and steps it
(solver.engine).

The file is long because whatever is asked of a running scene is asked of one class.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, cast, final

import numpy as np

from solver.compiled.by_reference import Ref
from solver.engine import Engine, Moved
from solver.engine.bodies import Bodies
from solver.engine.stepping import Stepping
from solver.errors import SpecError, StepError
from solver.findings import LevelReport
from solver.inputs.assistance import Feel, feel_of
from solver.inputs.controllers import Controlled, Controller, unit_of
from solver.inputs.driving import Driven
from solver.inputs.maneuver import ManeuverSource
from solver.inputs.recorded import RecordedSource
from solver.inputs.sources import Sources
from solver.model.state import FORMAT, Saved, State, fitting, require_format, step_of
from solver.model.tables import Model
from solver.output.branches import BranchSwitch, BranchWatch
from solver.output.seen import Seen
from solver.output.snapshot import NO_STEPS, Channels, Counters, Snapshot
from solver.quantities import quantity
from solver.scene import Scene
from solver.step.adaptation import Adaptation
from solver.step.constraint_coefficients import ConstraintCoefficients
from solver.step.control import Event
from solver.step.work import LastStep
from solver.vehicle.actuation import assisted_wheels, reaches, steering_reaches


@final
class Simulation:
    """Compile a scene, find its consistent start, advance it in whole steps.

    make: the engine of the scene; solver.simulation_of() chooses it. level: what the model leaves out of the vehicle it
    was derived from (None: it is the model of the scene as given). channels: the names of what a Snapshot holds. k:
    steps since the start. h: step [s]. displaced: it was placed somewhere, renumbered or restored since its start, so
    not even step 0 need be that of the scene. start: what the search for the start changed. like: a simulation of this
    scene with other settings of the integrator, whose start is taken instead of sought. Raises SpecError, SceneError or
    ConsistencyError on construction and StepError from advance(); each is one sentence.
    """

    def __init__(
        self,
        scene: Scene,
        make: Callable[[Scene], Engine] = Stepping,
        *,
        level: LevelReport | None = None,
        like: Simulation | None = None,
    ) -> None:
        if scene.reduced:
            raise SpecError(
                f'fidelity = {scene.fidelity!r}: Simulation simulates models as given; use simulation_of(scene)'
            )
        self.scene, self.level, self._make = scene, level, make
        self.h_ns = scene.integrator.h_ns
        self.h = self.h_ns * 1e-9
        self.engine = make(scene)
        self._shown = self.engine.shown
        self.model: Model = self._shown.model
        self.channels: Channels = self._shown.channels
        wheels = assisted_wheels(scene.model) if scene.assistance else ()
        self.sources = Sources(
            scene.maneuver, scene.actuation, scene.assistance, scene.model.inputs, wheels, self.h_ns, self.engine.stage,
            speed=scene.start.speed, duration=scene.duration, lock=scene.model.lock,
            reaches=reaches(scene.model) | steering_reaches(scene.model),
            controllers=[self._controlled(controller) for controller in scene.controllers],
        )  # fmt: skip
        self._require_followed()
        self._applied: np.ndarray | None = None
        self._restored: Saved | None = None  # from bytes of a file, for the next time
        inputs = np.array(self.sources.reset(), float)
        if like is None:
            self.start = self.engine.start(inputs)
        else:
            self.start = like.start
            self.engine.start_like(like.engine, inputs)
        self.reset()

    def _controlled(self, controller: Controller) -> Controlled:
        """A controller of the scene, with what it measures in this simulation."""
        names, inputs = controller.inputs.values(), self.scene.model.inputs
        looked = [quantity(name, self.channels) for name in names]
        units = dict(zip(names, (one.unit for one in looked), strict=True)) | {name: unit_of(name) for name in inputs}

        def measured() -> np.ndarray:
            numbers = self.snapshot().numbers
            return np.array([one.of(numbers[one.places][None, :])[0, 0] for one in looked])

        return Controlled(controller, inputs, self.h_ns, measured, units)

    def _require_followed(self) -> None:
        """Refuse what an engine that follows the maneuver by itself cannot see."""
        if self.engine.follows:
            given = {'driver': self.scene.maneuver.closed_loop, 'bag': self.scene.maneuver.bag}
            if self.scene.controllers:
                raise SpecError('controllers: a reference integrator takes none; use integrator.kind alf')
            for what in (name for name, there in given.items() if there):
                raise SpecError(
                    f'maneuver: {what}: a reference integrator follows functions of time; use integrator.kind alf'
                )

    @property
    def source(self) -> ManeuverSource | RecordedSource:
        """Source of the inputs that depend on time alone."""
        return self.sources.of_time

    def twin(self, duration: float, **settings: Any) -> Simulation:
        """A simulation of the same scene from the same start, of another duration [s] and with other settings of the
        integrator. Raises SpecError."""
        integrator = dataclasses.replace(self.scene.integrator, **settings)
        return Simulation(
            dataclasses.replace(self.scene, duration=duration, integrator=integrator),
            self._make,
            level=self.level,
            like=self,
        )

    # -- time ---------------------------------------------------------------------------------------------------------

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
        """(n, nu) inputs of the n steps of the last advance(), as applied; None when the integrator looks at any time
        it likes."""
        return self._applied

    def reset(self) -> None:
        """Back to the start, bit for bit."""
        self.k, self.displaced = 0, False
        self._totals = self._counters = NO_STEPS
        self._inputs = np.array(self.sources.reset(), float)
        self.engine.reset(self._inputs)

    def seen(self, every: int, most: int) -> Seen:
        """Table for the numbers of every so many steps, of at most so many rows (Simulation.advance)."""
        return Seen(every, most, len(self._shown.numbers))

    def advance(
        self, n: int = 1, inputs: np.ndarray | None = None, *, audit: bool = True, seen: Seen | None = None
    ) -> Snapshot:
        """Advance n steps and return the Snapshot after the last.

        inputs: (nu,) held for all steps, or (n, nu) one row a step, in SI units and the order of channels.inputs; None
        samples maneuver and driver of the scene, behind its actuators. audit: evaluate forces after every step, keep
        the energy balance and look for branch switches if the scene asks for them. seen: takes the numbers of the steps
        that it is to see, the same as those of a call for each of them. Raises StepError; the state is that of the last
        good step then.
        """
        audit = audit or bool(self.channels.energies)  # which are those of the account
        if seen is not None:
            seen.clear()
            if not seen.fits(self.k, n):
                raise ValueError(f'advance: {n} steps have more rows than {seen.most}')
        if self.engine.follows:
            if inputs is not None:
                raise SpecError(
                    'advance: a reference integrator follows the maneuver of its scene and takes no other inputs'
                )
            self._advance(n, np.empty((1, len(self._inputs))), audit, seen)
            return self.snapshot()
        if inputs is None and self.sources.drives and n > 1:  # one alone takes less in Python, with the same bits
            before = self.k
            with self.sources.driven(before, n) as (rows, driven):
                try:
                    self._advance(n, rows, audit, seen, driven)
                finally:
                    self._applied = rows[: self.k - before]
            return self.snapshot()
        if inputs is None and self.sources.step_by_step:
            rows = np.empty((n, len(self._inputs)))
            for i in range(n):
                self._applied = rows[:i]
                rows[i] = self.sources.sample(self.k, self._shown.sight, self.feel)
                self._advance(1, rows[i : i + 1], audit, seen)
            self._applied = rows
            return self.snapshot()
        if inputs is None:
            inputs = self.source.table(self.k, n)
        elif inputs.ndim == 1:
            inputs = inputs[None, :]
        inputs = np.ascontiguousarray(inputs, float)
        if not inputs.flags.writeable:
            inputs = inputs.copy()  # kernels are compiled for arrays that can be written
        if seen is not None and not np.isfinite(inputs).all():
            seen = None  # the engine refuses the whole call; with rows to take it would make the steps up to there
        before = self.k
        try:
            self._advance(n, inputs, audit, seen)
        finally:
            done = self.k - before
            self._applied = inputs[:done] if len(inputs) == n else np.broadcast_to(inputs, (done, inputs.shape[1]))
        return self.snapshot()

    def _advance(
        self, n: int, inputs: np.ndarray, audit: bool, seen: Seen | None, driven: Driven | None = None
    ) -> None:
        self._inputs = self._inputs.copy()  # those shown before stay as they were
        self._follow(self.engine.advance(self.k, inputs, n, audit, self._inputs, seen, driven))

    def moved(self, moved: Moved, inputs: np.ndarray, last: np.ndarray) -> None:
        """Follow what the engine was moved by others than advance(), with rows of inputs (n, nu), or (1, nu) held; last
        (nu,): those of the last step. Raises StepError."""
        self._inputs = last.copy()
        done = moved.steps
        held = len(inputs) == 1
        self._applied = np.broadcast_to(inputs, (done, inputs.shape[1])) if held else inputs[:done]
        self._follow(moved)

    def _follow(self, moved: Moved) -> None:
        self.k += moved.steps
        self._counters = moved.counters
        self._totals = self._totals.followed_by(moved.counters)
        if moved.failure:
            raise StepError(moved.failure)

    def feel(self) -> Feel:
        """Measurements that an assistance takes now."""
        bodies = self.bodies
        return feel_of(bodies.sight().speed, bodies.state.v, bodies.chassis, self.sources.wheels)

    def place(self, x: float, y: float, heading: float) -> None:
        """Move everything so that the chassis stands at x, y [m] with a heading [rad]; its motion goes on as it was, in
        its own axes.

        Raises SpecError for a model that is connected to the world, on a road that is not the same everywhere, and for
        a place too far off.
        """
        self._shown.place(x, y, heading)
        self.displaced = True
        seen = float(self._shown.account.time[0])
        self.engine.begin(self.k, self._inputs)
        self._shown.account.time[0] = seen  # the account begins anew, and of what was before was one

    def renumber(self, k: int) -> None:
        """Go on as step k: at another time, in motion as it is. Outputs are those of its state, not of the step that
        led to it."""
        self.k, self.displaced = k, True
        self.engine.show(k, self._inputs)
        self._shown.account.time[0] = k * self.h  # of steps that are not made nothing is to be known

    def snapshot(self) -> Snapshot:
        """The outputs of the last step, as a copy; after a failure those of the last call of advance() that
        succeeded."""
        self._shown.current()
        return Snapshot(self.k, self.t_ns, self._shown.numbers.copy(), self._shown.layout, self._counters)

    def snapshot_of(self, k: int, numbers: np.ndarray) -> Snapshot:
        """Snapshot of step k, whose numbers (n,) are taken as they are."""
        return Snapshot(k, k * self.h_ns, numbers, self._shown.layout, self._counters)

    # -- state and reports --------------------------------------------------------------------------------------------

    def save(self) -> bytes:
        """Everything the future depends on, and what the run so far is judged by, as bytes for restore()."""
        return Saved.of(self.arrays())

    def arrays(self) -> dict[str, np.ndarray]:
        """Copies of the arrays that save() makes bytes of (solver.model.state.Saved)."""
        envelope = {'inputs': self._inputs, 'audit': self._shown.account.numbers, 'totals': np.array(self._totals)}
        head = {'format': np.array(FORMAT), 'k': np.array(self.k, np.int64)}
        parts = {**head, **self.engine.arrays(), **envelope, **self.sources.memory()}
        return {name: np.array(array) for name, array in parts.items()}

    def restore(self, data: bytes, *, elsewhere: bool = False) -> None:
        """Continue from save(). elsewhere: it is that of another scene of the vehicle. Raises SpecError if it belongs
        to another model, or another version saved it.

        What save() returned holds its arrays in memory, which are copied; outputs are evaluated when somebody looks at
        them, and kept with it for the next time.
        """
        if not isinstance(data, Saved):
            if self._restored is None or self._restored != data:
                self._restored = Saved(data)
            data = self._restored
        saved = data.arrays
        k = step_of(saved.get('k'))
        require_format(saved, 'restore: the saved state')
        take_up = self.engine.fit(saved, k)
        inputs = fitting('inputs', saved.get('inputs'), self._inputs).copy()
        totals = Counters.of(fitting('totals', saved.get('totals'), np.zeros(len(NO_STEPS))))
        self.sources.recall(saved, inputs, elsewhere=elsewhere)
        self.k, self.displaced = k, True
        self._inputs, self._totals = inputs, totals
        take_up(inputs, data.shown)

    def __reduce__(self) -> tuple:
        """As its scene and save(): another process compiles the model anew, finds the same start, and goes on with the
        same bits."""
        return _resumed, (self._make, self.scene, self.save(), self._counters, self.level, self.displaced)

    def totals(self) -> dict[str, float]:
        """Counters and largest residuals since the start, the error of the energy account [J] and, if watched, branch
        switches."""
        return {
            **self._totals.report(),
            'energy_error_max': float(self._shown.account.worst[0]),
            **self.engine.totals(self.k),
        }

    def urdf(self) -> str:
        """The spanning tree of the model at the current configuration as URDF (solver.files.urdf)."""
        now = self.snapshot()
        return self._shown.urdf(dict(zip(self.channels.joints, now.joint_position.tolist(), strict=True)), now.pose)

    def describe(self) -> dict:
        """Counts, degrees of freedom, redundancy and reactions that are not unique, at the current configuration."""
        return self._shown.describe(self._inputs)

    @property
    def last_step(self) -> LastStep:
        """Data that the last step worked with."""
        self._shown.current()
        return self._shown.last_step()

    @property
    def reached(self) -> dict[str, tuple[float, float | None]]:
        """Quantities that the limits of a level are about -> the largest value so far, and its time [s] where it has
        one."""
        return self.engine.reached()

    @property
    def nbytes(self) -> int:
        """Memory of the tables of the model, of the scratch of a step and of a state."""
        return self._shown.nbytes()

    # -- of bodies ----------------------------------------------------------------------------------------------------

    @property
    def of_bodies(self) -> bool:
        """True where the states are those of bodies."""
        return isinstance(self._shown, Bodies)

    @property
    def bodies(self) -> Bodies:
        """Its bodies. Raises SpecError where there are none; all that needs bodies asks for them here."""
        if not isinstance(self._shown, Bodies):
            raise SpecError(
                "fidelity = 'single_track': this looks at the bodies of a model, and the level has none; take another "
                'level'
            )
        self._shown.current()
        return self._shown

    @property
    def state(self) -> State:
        """The current state of the bodies (the arrays themselves). Raises SpecError."""
        return self.bodies.state

    @property
    def kinematics(self) -> Ref:
        """Placement and velocities that the outputs show: of the end of the last step, projected onto the constraints.
        Raises SpecError."""
        return self.bodies.kin

    @property
    def outputs(self) -> np.ndarray:
        """Outputs of all force elements at the state that is shown, for Model.outputs(). Raises SpecError."""
        return self.bodies.outputs

    @property
    def scheme(self) -> Ref:
        """The settings of the step as it takes them. Raises SpecError."""
        return self.bodies.scheme

    def constraint_coefficients(self, *, coupled: bool = False) -> dict[str, ConstraintCoefficients]:
        """m, c, k, f of every constraint row at the current state; of a model without bodies there are none."""
        return (
            self._shown.constraint_coefficients(self._inputs, coupled=coupled)
            if isinstance(self._shown, Bodies)
            else {}
        )

    @property
    def adaptation(self) -> Adaptation | None:
        """Control of steps and penalties; None where both are constant."""
        return self.engine.adaptation if isinstance(self.engine, Stepping) else None

    @property
    def events(self) -> list[Event]:
        """Every change of step and penalties that this simulation made; totals() counts those of the run before a
        restored state too."""
        return [] if self.adaptation is None else self.adaptation.events

    @property
    def branches(self) -> BranchWatch | None:
        """Looks for branch switches; None where nobody asked for it."""
        return self._shown.branches if isinstance(self._shown, Bodies) else None

    @property
    def switches(self) -> list[BranchSwitch]:
        """Branch switches so far: all of them if the scene asks for that, else those across steps that failed and were
        divided."""
        return cast(list[BranchSwitch], self._shown.switches) if isinstance(self._shown, Bodies) else []


def _resumed(
    make: Callable[[Scene], Engine],
    scene: Scene,
    state: bytes,
    counters: Counters,
    level: LevelReport | None,
    displaced: bool,
) -> Simulation:
    """Inverse of Simulation.__reduce__()."""
    simulation = Simulation(scene, make, level=level)
    simulation.restore(state)
    simulation._counters, simulation.displaced = counters, displaced
    return simulation
