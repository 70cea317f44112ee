"""Engines: what moves a scene. A Simulation keeps time, inputs and totals, and drives one of them through this
contract.

| engine | step | state |
|---|---|---|
| solver.engine.stepping | augmented Lagrangian, constant or adapting | solver.engine.bodies |
| solver.reference.engine | an independent integrator | solver.engine.bodies |
| solver.levels.single_track_engine | solver.levels.track_step | its own |

Several of one class step at once as a group (solver.engine.lanes), which changes nothing of them but the time they
take.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, MutableMapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from solver.inputs.driver import Sight
from solver.inputs.driving import Driven
from solver.model.tables import Model
from solver.output.account import Account
from solver.output.seen import Seen
from solver.output.snapshot import Channels, Counters, Layout
from solver.scene import Scene
from solver.start.placement import Changes
from solver.step.work import LastStep


class Moved(NamedTuple):
    """Result of a call of Engine.advance(): whole steps of the grid, their work, and why the next one failed ('': it
    did not)."""

    steps: int
    counters: Counters
    failure: str = ''


# Outputs of a saved state, by what shows them (solver.model.state.Saved.shown).
Kept = MutableMapping[Any, Sequence[np.ndarray]]


class Shown(Protocol):
    """Data behind the outputs of an engine: model, present state and account. Bodies are one such class; the single
    track has its own."""

    model: Model
    channels: Channels  # names in what is shown
    numbers: np.ndarray  # what is shown, as in a Snapshot
    layout: Layout

    @property
    def account(self) -> Account:
        """The running account."""

    def current(self) -> None:
        """Evaluate the outputs of the present state where that has been left until somebody looks."""

    def sight(self) -> Sight:
        """Motion of the vehicle that a driver sees now."""

    def place(self, x: float, y: float, heading: float) -> None:
        """Move the vehicle to x, y [m] with a heading [rad]; Engine.begin() follows. Raises SpecError where it cannot
        stand there."""

    def last_step(self) -> LastStep:
        """Data that the last step worked with."""

    def describe(self, u: np.ndarray) -> dict[str, Any]:
        """Counts, degrees of freedom and what else there is to say of the model, at the present state under the inputs
        u (nu,)."""

    def urdf(self, joints: Mapping[str, float], pose: np.ndarray) -> str:
        """The model as URDF (solver.files.urdf), with these coordinates [rad or m] and body poses (nb, 7)."""

    def nbytes(self) -> int:
        """Memory of tables, scratch and state."""


class Engine(Protocol):
    """The state of a scene and its step. Made with the scene, and without a state until start().

    All arrays of inputs are (nu,) or (n, nu), in the order of channels.inputs. A step has the length of the scene's
    grid, integrator.h. Every refusal is a SpecError of one sentence.
    """

    stage: float  # instant of a step at which its inputs are sampled: 0 at its beginning, 1 at its end
    follows: bool  # it looks at the maneuver at any time it likes, and takes no other inputs

    @property
    def shown(self) -> Shown:
        """Data behind the outputs."""

    @property
    def alone(self) -> str:
        """Reason why it cannot step in a group (solver.engine.lanes); '' where it can."""

    def start(self, u: np.ndarray) -> Changes:
        """Find the state at t = 0 under the inputs there, and what that changed. Raises ConsistencyError."""

    def start_like(self, other: Any, u: np.ndarray) -> None:
        """Take the start that another engine of this class has found for the same scene with another step."""

    def reset(self, u: np.ndarray) -> None:
        """Back to the state that start() found, bit for bit."""

    def begin(self, k: int, u: np.ndarray) -> None:
        """Go on from the present state as step k: it is shown, the account begins, and so does what an integrator
        remembers."""

    def show(self, k: int, u: np.ndarray) -> None:
        """Show the present state as step k; the account goes on."""

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
        """n steps from step k on, with a row of inputs each; a single row holds for all. last (nu,): becomes the inputs
        of the last step.

        audit: keep the energy account, and look for branch switches where the scene asks for them. seen: takes what is
        shown after the steps that it is to see. driven: the driver, who adds what he does to the inputs of each step.
        After a failure the state is that of the last good step. Fewer steps than asked for, without a failure, are done
        when somebody asks for an end.
        """

    def arrays(self) -> dict[str, np.ndarray]:
        """Everything the future depends on beside time, inputs and account, and what a run is judged by, for fit()."""

    def fit(self, saved: Mapping[str, np.ndarray], k: int) -> Callable[[np.ndarray, Kept], None]:
        """Function that takes up the arrays() of step k, given the inputs (nu,) then, and outputs that have been
        evaluated before. Raises SpecError where they are of another model."""

    def reached(self) -> dict[str, tuple[float, float | None]]:
        """Quantities that the limits of a level are about -> the largest value so far, and its time [s] where it has
        one."""

    def totals(self, k: int) -> dict[str, Any]:
        """Substeps, rejected attempts, smallest step [s], events and, if watched, branch switches, until step k."""


def instant(scene: Scene, k: int) -> str:
    """The head of a sentence about step k."""
    return f't = {k * scene.integrator.h_ns * 1e-9:.6f} s, step {k}'
