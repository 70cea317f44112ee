"""Cars that do a task, all at once in an Ensemble: actions in, observations, rewards and ends out."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mbd_sim_ros.learn.tasks import ON_LINE, Task
from solver import Ensemble, load_scene
from solver.errors import SpecError, suggestion
from solver.inputs.command_filter import COMMANDS, CommandSource, commands_of, filter_state_at
from solver.inputs.recorded import ACCELERATION, RATE
from solver.output.snapshot import Snapshot
from solver.quantities import Quantity, quantity
from solver.validate import require

# Largest observation, in multiples of its scale: larger ones are cut to it. Ten times as much would let a spinning car
# outweigh all that a policy has seen before.
LIMIT = 10.0


class Outcome(NamedTuple):
    """observations (n, signals), rewards (n,); bad: it ended badly, well: it ended well, cut: its time is over (n,)."""

    observations: np.ndarray
    rewards: np.ndarray
    bad: np.ndarray
    well: np.ndarray
    cut: np.ndarray


class Fleet:
    """count cars in a task; seed: of what is varied, the k-th car is drawn with seed + k.

    Raises SpecError or SceneError for a task that does not fit its scene.
    """

    def __init__(self, task: Task, count: int, seed: int = 0) -> None:
        self.task = task
        for name, value, least in (('count', count, 1), ('variation', seed, 0)):
            whole = isinstance(value, int | np.integer) and value >= least
            require(whole, f'task {task.name}', name, value, f'give a whole number of at least {least}')
        if task.vary:
            scenes = [load_scene(task.scene, [*task.changes, *task.drawn(seed + k)]) for k in range(count)]
        else:
            scenes = [load_scene(task.scene, list(task.changes))] * count
        self.ensemble = Ensemble(scenes)
        first = self.ensemble.simulations[0]
        self.steps = round(task.every / first.h)
        if self.steps < 1 or abs(self.steps * first.h - task.every) > 1e-9:
            raise SpecError(
                f'task {task.name}: every = {task.every:g}: must be a multiple of integrator.h = {first.h:g}'
            )
        names = self.ensemble.channels.inputs
        missing = [name for name in COMMANDS if name not in names]
        if missing:
            raise SpecError(f'task {task.name}: the car has no input {missing[0]}; take one with angle and torques')
        self._steering = [names.index('steering' + end) for end in ('', RATE, ACCELERATION)]
        self._torques = [names.index(name) for name in COMMANDS[1:]]
        self._filters = [CommandSource(names, first.h_ns, commands=commands_of(names)) for _ in range(count)]
        self.line = task.line(first.scene)
        self._quantities = {name: self._quantity(name) for name in (*task.observations, *task.costs)}
        self._where = {name: quantity(name, self.ensemble.channels) for name in ('position', 'heading')}
        self._speed = quantity('longitudinal_velocity', self.ensemble.channels)
        self._at = [0] * count
        self._way, self._decisions = np.zeros(count), np.zeros(count, int)

    def _quantity(self, name: str) -> Quantity | tuple[str, float]:
        """Meaning of a signal: a quantity, or one of ON_LINE and the way ahead [m]. Raises SpecError."""
        head, plus, ahead = name.partition('+')
        if head not in ON_LINE:
            try:
                return quantity(name, self.ensemble.channels)
            except SpecError as error:
                raise SpecError(f'task {self.task.name}: {error}{suggestion(name, ON_LINE)}') from None
        try:
            way = float(ahead) if plus else 0.0
        except ValueError:
            way = math.nan
        if not 0.0 <= way < math.inf or (plus and head != 'curvature'):
            raise SpecError(f'task {self.task.name}: {name}: only curvature is seen ahead: write curvature+20 for 20 m')
        return head, way

    def __len__(self) -> int:
        return len(self._filters)

    def reset(self, k: int, chance: np.random.Generator) -> None:
        """Car k goes back to its start, beside the line by what `chance` gives it."""
        simulation = self.ensemble.simulations[k]
        self.ensemble.reset([k])
        side, turn = (size * chance.uniform(-1.0, 1.0) for size in self.task.start)
        sight = simulation.engine.shown.sight()
        at = self.line.nearest(sight.x, sight.y)
        if any(self.task.start):
            ahead = self.line.heading[at]
            place = self.line.points[at] + side * np.array([-np.sin(ahead), np.cos(ahead)])
            simulation.place(float(place[0]), float(place[1]), float(ahead + turn))
        self._at[k], self._way[k], self._decisions[k] = at, 0.0, 0
        self._filters[k].state = filter_state_at(self.ensemble.channels.inputs, simulation.inputs)

    def observe(self) -> np.ndarray:
        """(n, signals) what is seen now."""
        return self._seen(self._signals([s.snapshot() for s in self.ensemble.simulations]))

    def step(self, actions: np.ndarray) -> Outcome:
        """A decision of every car: actions (n, task.actions) between -1 and 1, beyond which they are cut.

        Raises SpecError for actions of another shape, and for what is no number; no car has moved then.
        """
        task = self.task
        self.ensemble.advance(self.steps, self._rows(self._accepted(actions)))
        self._decisions += 1
        before = self._way.copy()
        signals = self._signals([s.snapshot() for s in self.ensemble.simulations], move=True)
        cost = np.zeros(len(self))
        for name, (scale, weight) in task.costs.items():
            u = (signals[name] / scale) ** 2
            cost += weight * u / (1.0 + u)
        bad = np.abs(signals['offset']) > task.width
        bad |= np.abs(signals['heading_error']) > task.turned
        bad |= np.array([bool(failure) for failure in self.ensemble.failures])
        well = ~bad & (signals['speed'] < task.slow)
        rewards = task.every * (task.alive - cost) + task.progress * (self._way - before) - task.crash * bad
        cut = ~bad & ~well & (self._decisions >= round(task.duration / task.every))
        return Outcome(self._seen(signals), rewards, bad, well, cut)

    def _accepted(self, actions: np.ndarray) -> np.ndarray:
        """(n, task.actions) actions, cut at -1 and 1. Raises SpecError."""
        where, shape = f'task {self.task.name}', (len(self), self.task.actions)
        try:
            given = np.asarray(actions, float)
        except (TypeError, ValueError):
            raise SpecError(f'{where}: actions = {actions!r}: give an array of numbers') from None
        require(given.shape == shape, where, 'shape of actions', given.shape, f'must be {shape}: cars, numbers of each')
        bad = np.flatnonzero(np.isnan(given).any(axis=1))
        if len(bad):
            raise SpecError(f'{where}: action of car {bad[0]} = {given[bad[0]].tolist()}: NaN is no action')
        return np.clip(given, -1.0, 1.0)

    def _rows(self, actions: np.ndarray) -> np.ndarray:
        """(n, steps, nu) inputs: those of the maneuver by the clock, with what is commanded instead."""
        rows = np.stack([s.source.table(s.k, self.steps) for s in self.ensemble.simulations])
        for k, follow in enumerate(self._filters):
            wanted = self.task.steering * float(actions[k, 0])
            rows[k][:, self._steering] = [follow.turn(wanted) for _ in range(self.steps)]
        if self.task.actions > 1:
            pedal = actions[:, 1:2]
            rows[:, :, self._torques[0]] = self.task.drive * np.maximum(pedal, 0.0)
            rows[:, :, self._torques[1]] = self.task.brake * np.maximum(-pedal, 0.0)
        return rows

    def _signals(self, shots: list[Snapshot], *, move: bool = False) -> dict[str, np.ndarray]:
        """Signals by name (n,), with `offset`, `heading_error` and `speed` in any case."""
        numbers, line = np.stack([shot.numbers for shot in shots]), self.line
        of = lambda q: np.stack([q.of(row[None, q.places])[0] for row in numbers])  # noqa: E731
        places, headings = of(self._where['position']), of(self._where['heading'])[:, 0]
        found = {'speed': of(self._speed)[:, 0]}
        for k, (x, y) in enumerate(places.tolist()):
            now = line.nearest(x, y, self._at[k])
            way = line.s[now] - line.s[self._at[k]]
            if line.closed:
                way = (way + 0.5 * line.length) % line.length - 0.5 * line.length
            if move:
                self._way[k] += way
                self._at[k] = now
        at = self._at
        found['offset'] = np.array([line.offset(i, *place) for i, place in zip(at, places.tolist(), strict=True)])
        found['heading_error'] = np.array([line.turn_to(i, h) for i, h in zip(at, headings.tolist(), strict=True)])
        for name, meant in self._quantities.items():
            if isinstance(meant, Quantity):
                found[name] = of(meant)[:, 0]
            elif meant[0] == 'curvature':
                found[name] = np.array([line.curvature[line.ahead(i, meant[1])] for i in at])
            elif meant[0] == 'progress':
                found[name] = self._way.copy()
        return found

    def _seen(self, signals: dict[str, np.ndarray]) -> np.ndarray:
        scaled = [signals[name] / scale for name, scale in self.task.observations.items()]
        return np.clip(np.column_stack(scaled), -LIMIT, LIMIT).astype(np.float32)

    def save(self, k: int) -> tuple[bytes, np.ndarray, int, float, int]:
        """All that the future of car k depends on, for restore() of any car of the same task and vehicle."""
        simulation = self.ensemble.simulations[k]
        return simulation.save(), self._filters[k].state, self._at[k], float(self._way[k]), int(self._decisions[k])

    def restore(self, k: int, saved: tuple[bytes, np.ndarray, int, float, int]) -> None:
        """Car k goes on from save(), bit for bit. Raises SpecError for a state of another model."""
        state, steering, self._at[k], self._way[k], self._decisions[k] = saved
        self.ensemble.simulations[k].restore(state)
        self.ensemble.failures[k] = ''
        self._filters[k].state = steering

    def told(self, k: int) -> dict[str, object]:
        """Facts on car k beside its observation: way along the line [m], and why it failed ('': it did not)."""
        return {'progress': float(self._way[k]), 'failure': self.ensemble.failures[k]}
