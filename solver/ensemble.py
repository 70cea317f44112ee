"""Several simulations of one topology, eight of them in the SIMD lanes of a core, each with the bits of its single run.

    ensemble = Ensemble([scene] * 8)
    frames = ensemble.advance(100, inputs)      # (8, 100, nu), or what holds for all
    ensemble.quantity('yaw_rate')               # (8,)
    ensemble.reset([3])

An Ensemble owns nothing: its simulations are ordinary ones, and between two calls each is as if it had stepped alone.
So totals, verdicts, saved states, levels and accounts are asked of `ensemble.simulations[k]`. What in lanes must be the
same is the topology: bodies, joints, elements, their kinds and connections, levels, inputs, the step, the integrator.
All numbers may differ: parameters, starts, inputs, roads of the same layout."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from solver.engine.stepping import Stepping
from solver.errors import SpecError, StepError, suggestion
from solver.levels import simulation_of
from solver.levels.single_track_engine import SingleTrack
from solver.output.seen import Seen
from solver.output.snapshot import Channels, Snapshot
from solver.quantities import quantity
from solver.scene import Scene
from solver.simulation import Simulation

# Simulations that step in lanes, at least. All lanes take the time of about three single simulations, whatever they
# hold; ten times as many would leave no group in lanes.
FEWEST = 4
# engine -> module and class of its group (solver.engine.lanes.Group), which nothing imports before it is asked for
GROUPS: dict[type, tuple[str, str]] = {
    SingleTrack: ('solver.levels.track_lanes', 'TrackGroup'),
    Stepping: ('solver.engine.stepping_lanes', 'BodyGroup'),
}
Rows = list[np.ndarray | None]


class Ensemble:
    """simulations: one of each scene, in their order; simulations may be given instead, each once. failures: why each
    can go no further, '' of those that can.

    in_lanes: True where they step in lanes; where False, `why` says in one sentence what keeps them from it, and they
    step one after the other, with the same results. Raises SpecError where scenes do not fit together, and what
    simulation_of() raises.
    """

    def __init__(self, scenes: Sequence[Scene | Simulation]) -> None:
        if not isinstance(scenes, Sequence) or not all(isinstance(one, Scene | Simulation) for one in scenes):
            raise SpecError('Ensemble: give a list of scenes (load_scene) or of simulations')
        if not scenes:
            raise SpecError('Ensemble: there is no scene; give one at least')
        self.simulations = _made(scenes)
        if len({id(simulation) for simulation in self.simulations}) != len(scenes):
            raise SpecError('Ensemble: the same simulation is there twice; make one for each')
        _require_alike(self.simulations)
        self.failures = [''] * len(self.simulations)
        self._groups: list[tuple[Any, list[Simulation]]] = []
        self.why = self._obstacle()
        if not self.why:
            self._make_groups()
        self.in_lanes = bool(self._groups)

    def _make_groups(self) -> None:
        from solver.compiled.lanes import LANES

        for first in range(0, len(self.simulations), LANES):
            members = self.simulations[first : first + LANES]
            if len(members) >= FEWEST:
                home, name = GROUPS[type(members[0].engine)]
                make = getattr(importlib.import_module(home), name)
                self._groups.append((make([s.engine for s in members], [s.inputs.copy() for s in members]), members))
        if not self._groups:
            self.why = f'{len(self.simulations)} simulations take less time one after the other than in {LANES} lanes'

    def __len__(self) -> int:
        return len(self.simulations)

    @property
    def sees(self) -> bool:
        """True where rows of what is shown (advance) are filled in lanes."""
        return self.in_lanes and all(group.sees for group, _ in self._groups)

    def load(self) -> None:
        """Load the kernels of lanes, or compile them, now and not with the first step."""
        for group, _ in self._groups:
            group.load()

    @property
    def channels(self) -> Channels:
        """The names in what is shown, which all have in common."""
        return self.simulations[0].channels

    def _obstacle(self) -> str:
        """Reason why these simulations cannot step in lanes; '' where they can."""
        for k, simulation in enumerate(self.simulations):
            why = simulation.engine.alone
            if why:
                return f'simulation {k}: {why}'
        return ''

    def advance(
        self,
        n: int = 1,
        inputs: np.ndarray | None = None,
        *,
        audit: bool = True,
        seen: Sequence[Seen] | None = None,
    ) -> list[Snapshot]:
        """Advance all that did not fail n steps; the Snapshot of each, of those that failed the last good one.

        inputs: (nu,) held by all, (n, nu) a row a step for all, (N, n, nu) rows of each, or (N, 1, nu) held by each; in
        SI units and the order of channels.inputs. None samples the maneuver of each. Simulations with a driver or an
        assistance that look at every step go one after the other. audit: see Simulation.advance(). seen: a table for
        each that takes rows of what it shows (Simulation.seen()). What fails is noted in `failures`, and goes on after
        reset() or restore() of its simulation and a failure set to ''. Raises SpecError for inputs of another shape,
        for a number of steps that is none, and for tables that do not fit.
        """
        if not isinstance(n, int | np.integer) or n < 0:
            raise SpecError(f'Ensemble: n = {n!r}: steps are a whole number, 0 at least')
        audit = audit or bool(self.channels.energies)  # which are those of the account
        self._clear(seen, n)
        rows = self._rows(n, inputs)
        waiting = {k for k, failure in enumerate(self.failures) if not failure}
        size = max((len(members) for _, members in self._groups), default=0)
        for at, (group, members) in enumerate(self._groups):
            lanes = [k for k in range(len(members)) if at * size + k in waiting and rows[at * size + k] is not None]
            alike = seen is None or (group.sees and len({one.every for one in seen}) == 1)
            if len(lanes) >= FEWEST and alike:
                self._advance_group(at * size, group, members, lanes, rows, n, audit, seen)
                waiting.difference_update(at * size + k for k in lanes)
        for k in sorted(waiting):
            with self._noting(k):
                self.simulations[k].advance(n, rows[k], audit=audit, seen=None if seen is None else seen[k])
        return [simulation.snapshot() for simulation in self.simulations]

    def _clear(self, seen: Sequence[Seen] | None, n: int) -> None:
        """Make tables ready for n steps. Raises SpecError where one is missing or too small."""
        if seen is None:
            return
        if len(seen) != len(self):
            raise SpecError(f'Ensemble: {len(seen)} tables of rows for {len(self)} simulations; give one for each')
        for k, (one, simulation) in enumerate(zip(seen, self.simulations, strict=True)):
            if not one.fits(simulation.k, n):
                raise SpecError(f'Ensemble: {n} steps of simulation {k} have more than {one.most} rows; give it more')
        for one in seen:
            one.clear()

    def _advance_group(
        self,
        first: int,
        group: Any,
        members: list[Simulation],
        lanes: list[int],
        rows: Rows,
        n: int,
        audit: bool,
        seen: Sequence[Seen] | None,
    ) -> None:
        """Advance these lanes of a group, whose first simulation is the one with the index `first`."""
        from solver.engine.lanes import advance_group

        given = {k: row for k in lanes if (row := rows[first + k]) is not None}
        tables = None if seen is None else {k: seen[first + k] for k in given}
        for k in given:
            group.lasts[k][:] = members[k].inputs
        for k, moved in advance_group(group, [s.k for s in members], given, n, audit, tables).items():
            with self._noting(first + k):
                members[k].moved(moved, given[k], group.lasts[k])

    @contextmanager
    def _noting(self, k: int) -> Iterator[None]:
        """Note a failure of simulation k."""
        try:
            yield
        except StepError as error:
            self.failures[k] = str(error)

    def _rows(self, n: int, inputs: np.ndarray | None) -> Rows:
        """Rows of inputs, (n, nu) or (1, nu), of each simulation; None of one whose inputs depend on the steps before.
        Raises SpecError."""
        if inputs is None:
            return [None if s.sources.step_by_step else _writeable(s.source.table(s.k, n)) for s in self.simulations]
        given, count, width = np.asarray(inputs, float), len(self), len(self.channels.inputs)
        if given.ndim == 1:
            given = given[None, :]
        shape = given.shape[-2:]
        fits = given.ndim == 2 or (given.ndim == 3 and len(given) == count)
        if not fits or shape not in ((n, width), (1, width)):
            raise SpecError(
                f'Ensemble: inputs of shape {np.shape(inputs)}; give ({width},), ({n}, {width}), '
                f'({count}, {n}, {width}) or ({count}, 1, {width}): {count} simulations, {n} steps, {width} inputs'
            )
        return [_writeable(given[k] if given.ndim == 3 else given) for k in range(count)]

    def reset(self, which: Iterable[int] | None = None) -> None:
        """Back to the start: all, or those with these indices. They may have failed. Raises SpecError for an index that
        no simulation has, before any goes back."""
        indices = range(len(self)) if which is None else [*which]
        if bad := [k for k in indices if not -len(self) <= k < len(self)]:
            raise SpecError(f'Ensemble: there is no simulation {bad[0]}; the last one is {len(self) - 1}')
        for k in indices:
            self.simulations[k].reset()
            self.failures[k] = ''

    def field(self, name: str) -> np.ndarray:
        """(N, ...) a field of all Snapshots, by its name there: pose, twist, joint_position, tire, imu, elements ...
        Raises SpecError for an unknown one."""
        known = {*Snapshot._fields[:2], *self.simulations[0].snapshot().layout}  # k, t_ns and all arrays
        if name not in known:
            raise SpecError(f'Ensemble: field {name!r}: no such field{suggestion(name, known)}')
        return np.stack([getattr(simulation.snapshot(), name) for simulation in self.simulations])

    def quantity(self, name: str) -> np.ndarray:
        """(N,) or (N, components) a quantity of interest by its name (docs/accuracy.md): yaw_rate, lateral_acceleration
        ..., or a column of a recording. In SI units. Raises SpecError for an unknown one."""
        wanted = quantity(name, self.channels)
        rows = np.stack([simulation.snapshot().numbers[wanted.places] for simulation in self.simulations])
        values = np.stack([wanted.of(row[None, :])[0] for row in rows])  # each by itself: angles are not unwrapped
        return values[:, 0] if values.shape[1] == 1 else values


def _made(scenes: Sequence[Scene | Simulation]) -> list[Simulation]:
    """A simulation of each; of a scene that is there several times the start is found once."""
    made: list[Simulation] = []
    known: dict[int, Simulation] = {}
    for scene in scenes:
        if isinstance(scene, Simulation):
            made.append(scene)
        elif id(scene) in known:
            made.append(known[id(scene)].twin(scene.duration))
        else:
            made.append(known.setdefault(id(scene), simulation_of(scene)))
    return made


def _require_alike(simulations: list[Simulation]) -> None:
    """Refuse simulations that are no ensemble. Raises SpecError."""
    first = simulations[0]
    for k, other in enumerate(simulations):
        if not isinstance(other.engine, SingleTrack | Stepping):
            raise SpecError(
                f'Ensemble: simulation {k}: integrator.kind = {other.scene.integrator.kind!r} is a reference '
                'integrator, which steps by itself; use alf'
            )
        if type(other.engine) is not type(first.engine):
            raise SpecError(f'Ensemble: simulations 0 and {k} are of different levels; make one Ensemble of each level')
        if other.h_ns != first.h_ns:
            raise SpecError(
                f'Ensemble: integrator.h = {other.h:g} in simulation {k}, {first.h:g} in simulation 0; '
                'give all the same'
            )
        if other.channels != first.channels:
            raise SpecError(
                f'Ensemble: simulations 0 and {k} are of different topologies: '
                f'{_unlike(first.channels, other.channels)}; make one Ensemble of each topology'
            )


def _unlike(a: Channels, b: Channels) -> str:
    """The first difference of what two simulations show."""
    for field in dataclasses.fields(a):
        one, two = getattr(a, field.name), getattr(b, field.name)
        if one != two:
            only = set(one).symmetric_difference(two) if isinstance(one, tuple) else set()
            return f'{field.name} ({min(only)})' if only else field.name
    return ''


def _writeable(rows: np.ndarray) -> np.ndarray:
    """Contiguous rows that kernels take."""
    rows = np.ascontiguousarray(rows, float)
    return rows if rows.flags.writeable else rows.copy()
