"""The newest commands, as they hold: latched when they come, zero when they drive and are old, and in lockstep answers
to a state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from mbd_sim_ros.node.pace import Pace
from solver.inputs.command_filter import COMMANDS

DRIVING = ('drive_torque', 'accelerator')  # beginnings of commands that drive: the watchdog ends them


class Timed(Protocol):
    """Parts of solver.simulation.Simulation that a latch needs: step number, step and time [ns]."""

    h_ns: int
    k: int

    @property
    def t_ns(self) -> int: ...


class Latched(NamedTuple):
    """The newest commands, in the order of Latch.commands: one tuple, swapped as a whole."""

    values: tuple[float, ...]
    times: tuple[int, ...]  # simulation time of arrival [ns]; -1: none came yet
    counts: tuple[int, ...]

    @classmethod
    def none(cls, values: Sequence[float]) -> Latched:
        """Commands of which none came yet; values: what counts until then."""
        return cls(tuple(values), (-1,) * len(values), (0,) * len(values))


class Answers(NamedTuple):
    """Counts of stamped commands and of plain ones in lockstep, since the start, by what became of them."""

    taken: int = 0  # states that a stamped command answered
    refused: int = 0  # stamped commands that answered another state than the one that is waiting
    surplus: int = 0  # plain commands that came twice for one step: whoever sends them may be a step behind


class Latch:
    """Keeps the newest command of each name, and which state of lockstep they answer; for the simulation thread.

    commands: names, steering first. Drive torques and the accelerator among them count as zero when they are older than
    pace.command_timeout; `stale` names those that do now. In lockstep an answer makes pace.lockstep_every steps, and
    the states between are not waited for (`waits`).
    """

    def __init__(self, simulation: Timed, pace: Pace | None = None, commands: tuple[str, ...] = COMMANDS) -> None:
        self.pace, self.commands = pace or Pace(), commands
        self.answers = Answers()
        self.stale: tuple[str, ...] = ()
        self._simulation = simulation
        self._drives = [i for i, name in enumerate(commands) if name.startswith(DRIVING)]
        self.forget()

    def forget(self) -> None:
        """Forget what was commanded, and which states were answered."""
        self.newest = Latched.none((0.0,) * len(self.commands))
        self._used = self.newest.counts  # counts of the commands that the last step used
        self._answered = -1  # step index of the state that a stamped command has answered
        self._until = self._simulation.k  # step index of the state to which the newest answer leads

    def command(self, index: int, value: float) -> None:
        """Latch a command by its place in `commands`."""
        old = self.newest
        put = lambda values, new: (*values[:index], new, *values[index + 1 :])  # noqa: E731
        self.newest = Latched(
            put(old.values, value), put(old.times, self._simulation.t_ns), put(old.counts, old.counts[index] + 1)
        )

    def answer(self, t_ns: int, values: dict[int, float]) -> bool:
        """Take commands (index -> value) that answer the state of simulation time `t_ns` [ns].

        In lockstep only the answer to the state that is waiting counts, and only the first one; others are refused
        (False). In the other modes the commands are latched like plain ones.
        """
        simulation, lockstep = self._simulation, self.pace.lockstep
        if lockstep and (t_ns != simulation.t_ns or self._answered == simulation.k or not self.waits):
            self.answers = self.answers._replace(refused=self.answers.refused + 1)
            return False
        for index, value in values.items():
            self.command(index, value)
        if lockstep:
            self._answered = simulation.k
            self.answers = self.answers._replace(taken=self.answers.taken + 1)
        return True

    @property
    def waits(self) -> bool:
        """True where lockstep waits for an answer to the present state."""
        return self.pace.lockstep and self.ahead == 0

    @property
    def ahead(self) -> int:
        """Steps to the state to which the newest answer leads."""
        return max(self._until - self._simulation.k, 0)

    @property
    def waiting_ns(self) -> int:
        """Simulation time of the state that lockstep waits to have answered, or comes to next [ns]."""
        return self._simulation.t_ns + self.ahead * self._simulation.h_ns

    def is_answered(self) -> bool:
        """True where the state that is waiting has been answered: then the next pace.lockstep_every steps are to be
        made."""
        pace, counts, k = self.pace, self.newest.counts, self._simulation.k
        if self._answered != k:
            if not all(counts[i] > self._used[i] for i in pace.lockstep_commands):
                return False
            surplus = sum(counts[i] - self._used[i] - 1 for i in pace.lockstep_commands)
            self.answers = self.answers._replace(surplus=self.answers.surplus + surplus)
        self._used, self._until = counts, k + pace.lockstep_every
        return True

    def use(self) -> None:
        """Note that a step uses the newest commands; those that lockstep takes for an answer have to be newer."""
        self._used = self.newest.counts

    def at(self, t_ns: int) -> tuple[float, ...]:
        """The commands at a simulation time [ns]: those that drive, came and are too old are zero; notes which are."""
        newest, old = self.newest, []
        if self.pace.command_timeout > 0.0:
            times, youngest = newest.times, t_ns - self.pace.command_timeout * 1e9
            old = [i for i in self._drives if 0 <= times[i] < youngest]
        self.stale = tuple([self.commands[i] for i in old])
        return tuple([0.0 if i in old else value for i, value in enumerate(newest.values)]) if old else newest.values

    def age(self, t_ns: int) -> float:
        """Simulation time [s] since the oldest of the newest commands came; -1: none came."""
        came = [t for t in self.newest.times if t >= 0]
        return (t_ns - min(came)) * 1e-9 if came else -1.0
