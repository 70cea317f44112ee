"""Who sees a step: subscribers of topics, a recording, those who follow /clock, and a plan that is watched. Others are
hidden."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbd_sim_ros.messages.encode import Messages, require_finite
from mbd_sim_ros.node.commands import Commands
from mbd_sim_ros.node.latch import Latch
from mbd_sim_ros.node.periods import before_next, due
from mbd_sim_ros.node.publish import Publication
from mbd_sim_ros.node.recording import Recording
from mbd_sim_ros.node.ticks import Ticks
from solver.analysis.envelope import Envelope
from solver.output.snapshot import Snapshot

if TYPE_CHECKING:
    from solver.simulation import Simulation


class Audience:
    """Shows the steps of a simulation to whom they concern; on the simulation thread.

    Each of those who look says at which steps, by periods: a step is seen whose number is a multiple of one of them.
    assisted: whether somebody looks at every step to help the driver. budget: seconds that publishing a step may take
    in real time; 0: as long as it takes.
    """

    def __init__(
        self,
        simulation: Simulation,
        messages: Messages,
        latch: Latch,
        *,
        publication: Publication,
        recording: Recording,
        ticks: Ticks | None,
        envelope: Envelope,
        commands: Commands,
        assisted: bool,
    ) -> None:
        self.budget = 0.0
        self._simulation, self._messages, self._latch, self._pace = simulation, messages, latch, latch.pace
        self._publication, self._recording, self._ticks, self._envelope = publication, recording, ticks, envelope
        self._commands, self._assisted = commands, assisted

    def hidden(self, most: int) -> int:
        """Number of the next steps, at most so many, that nobody sees, while nobody commands or assists."""
        lockstep = self._pace.lockstep  # which does not look for commands in these steps
        if self._assisted or (self._commands.commanded and not lockstep):
            return 0
        seen = {*self._publication.periods(lockstep=lockstep), *self._recording.periods}
        if self._ticks is not None and self._ticks.heard:
            seen.add(self._ticks.every)
        return before_next(self._simulation.k, most, seen)

    def show(self, snapshot: Snapshot) -> None:
        """Show a step that may be seen. Raises StepError for one that is not finite, seen or not."""
        self._envelope.look(snapshot)
        k, pace = snapshot.k, self._pace
        waits = self._latch.waits if pace.lockstep else None
        channels = self._publication.due(k, waits=waits)
        records = due(k, self._recording.periods)
        if channels or records:
            only = None if records else [channel.place for channel in channels]
            messages = self._messages.encode(snapshot, only=only)
            self._publication.publish(messages, channels, self.budget if pace.mode == 'realtime' else 0.0)
            if records:
                self._recording.take(snapshot, messages)
        else:
            require_finite(snapshot, self._messages.channels)
        self._tick(snapshot, anyway=bool(waits))

    def repeat(self) -> None:
        """Publish the present state, all of it, whoever hears it and whatever the rates."""
        snapshot = self._simulation.snapshot()
        self._publication.publish(self._messages.encode(snapshot, whole=True), self._publication.channels)
        self._tick(snapshot, anyway=True)

    def record(self) -> None:
        """Record the present state, if it is its turn."""
        if due(self._simulation.k, self._recording.periods):
            self._recording.take(self._simulation.snapshot())

    def passed(self) -> None:
        """Note the inputs of the steps that were made in one call."""
        applied = self._simulation.applied
        assert applied is not None  # a node steps with engines that take inputs
        self._recording.note(self._simulation.k, applied)

    def restart(self) -> None:
        """Time begins anew."""
        self._envelope.restart()
        if self._ticks is not None:
            self._ticks.restart()

    def _tick(self, snapshot: Snapshot, *, anyway: bool) -> None:
        """Tell the time; anyway: in lockstep the others wait for the tick of every state that waits."""
        ticks = self._ticks
        if ticks is None:
            return
        anyway = anyway or not ticks.began
        if anyway or (due(snapshot.k, (ticks.every,)) and ticks.heard):
            ticks.publish(snapshot, anyway=anyway)
