"""Environments for Gymnasium (extra `learn`): one car, or many at once in the lanes of a core.

    env = mbd_sim_ros.learn.single('lane_keeping')
    envs = mbd_sim_ros.learn.vector('lane_keeping', 32, vary={'vehicle.chassis.mass': (1100, 1500)})
    gymnasium.make('mbd_sim_ros.learn:mbd/LaneKeeping-v0')

Car k of `vector` with seed s has the bits of `single` with seed s + k.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from mbd_sim_ros.learn.fleet import LIMIT, Fleet
from mbd_sim_ros.learn.tasks import TASKS, Task
from solver.errors import SpecError, suggestion
from solver.validate import require


def task_of(task: str | Task, **changes: Any) -> Task:
    """A task by its name, with other fields. Raises SpecError for a name or field that there is not."""
    if not isinstance(task, Task):
        if task not in TASKS:
            raise SpecError(f'task {task!r}: no such task{suggestion(str(task), TASKS)}; or give a Task')
        task = TASKS[task]
    return task.replace(**changes) if changes else task


def _spaces(task: Task) -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
    seen, done = (len(task.observations),), (task.actions,)
    return gymnasium.spaces.Box(-LIMIT, LIMIT, seen, np.float32), gymnasium.spaces.Box(-1.0, 1.0, done, np.float32)


class DrivingEnv(gymnasium.Env):
    """One car in a task. variation: seed of what is varied of the car; an episode is varied by the seed of reset()."""

    metadata: dict[str, Any] = {'render_modes': []}  # noqa: RUF012  # as Gymnasium has it

    def __init__(self, task: str | Task, variation: int = 0, render_mode: str | None = None, **changes: Any) -> None:
        self.task, self.render_mode = task_of(task, **changes), render_mode
        self.fleet = Fleet(self.task, 1, variation)
        self.observation_space, self.action_space = _spaces(self.task)

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Start of an episode: (observation, facts)."""
        super().reset(seed=seed)
        self.fleet.reset(0, self.np_random)
        return self.fleet.observe()[0], self.fleet.told(0)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        """A decision: (observation, reward, ended, cut off, facts). Raises SpecError for another kind of action."""
        o = self.fleet.step(np.asarray(action)[None])
        ended = bool(o.bad[0] or o.well[0])
        return o.observations[0], float(o.rewards[0]), ended, bool(o.cut[0]), self.fleet.told(0)


class DrivingVectorEnv(VectorEnv):
    """Many cars in a task, each as DrivingEnv has it; one that has ended is reset by the step that follows."""

    metadata: dict[str, Any] = {'render_modes': [], 'autoreset_mode': AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self, task: str | Task, num_envs: int = 8, variation: int = 0, render_mode: str | None = None, **changes: Any
    ) -> None:
        self.task, self.num_envs, self.render_mode = task_of(task, **changes), num_envs, render_mode
        self.fleet = Fleet(self.task, num_envs, variation)
        self.single_observation_space, self.single_action_space = _spaces(self.task)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._chances: list[np.random.Generator] = []
        self._over = np.zeros(num_envs, bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[np.ndarray, dict]:
        """Start of episodes of all cars: (observations, facts). seed: of car k it is seed + k, or one for each."""
        if isinstance(seed, int | np.integer):
            seed = [int(seed) + k for k in range(self.num_envs)]
        if seed is not None or not self._chances:
            seeds = [None] * self.num_envs if seed is None else list(seed)
            many = f'give one, or one for each of the {self.num_envs} cars'
            require(len(seeds) == self.num_envs, f'task {self.task.name}', 'seed', seed, many)
            self._chances = [gymnasium.utils.seeding.np_random(one)[0] for one in seeds]
        for k, chance in enumerate(self._chances):
            self.fleet.reset(k, chance)
        self._over[:] = False
        return self.fleet.observe(), self._told()

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict]:
        """A decision of each: (observations, rewards, ended, cut off, facts). Raises SpecError for other actions."""
        if not self._chances:
            raise gymnasium.error.ResetNeeded('call reset() before the first step()')
        o = self.fleet.step(np.asarray(actions))
        seen, rewards, ended, cut = o.observations, o.rewards, o.bad | o.well, o.cut
        again = np.flatnonzero(self._over)
        for k in again.tolist():
            self.fleet.reset(k, self._chances[k])
        if len(again):
            seen[again] = self.fleet.observe()[again]
            rewards[again], ended[again], cut[again] = 0.0, False, False
        self._over = ended | cut
        return seen, rewards, ended, cut, self._told()

    def _told(self) -> dict[str, Any]:
        told = [self.fleet.told(k) for k in range(self.num_envs)]
        return {name: np.array([one[name] for one in told]) for name in told[0]}


def single(task: str | Task, variation: int = 0, **changes: Any) -> DrivingEnv:
    """One car in a task, by its name or a Task; changes: other fields of it. Raises SpecError or SceneError."""
    return DrivingEnv(task, variation, **changes)


def vector(task: str | Task, count: int, variation: int = 0, **changes: Any) -> DrivingVectorEnv:
    """So many cars in a task. Raises SpecError or SceneError."""
    return DrivingVectorEnv(task, count, variation, **changes)
