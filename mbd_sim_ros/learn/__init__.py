"""Driving as tasks to be learned: environments for Gymnasium over cars of this program (docs/learning.md).

Importing this registers them with Gymnasium (extra `learn`).
"""

from __future__ import annotations

try:
    import gymnasium
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        "mbd_sim_ros.learn needs Gymnasium: pip install 'mbd_sim_ros[learn]'", name=error.name
    ) from None

from mbd_sim_ros.learn.environments import DrivingEnv, DrivingVectorEnv, single, vector
from mbd_sim_ros.learn.tasks import TASKS, Task

__all__ = ['TASKS', 'DrivingEnv', 'DrivingVectorEnv', 'Task', 'single', 'vector']

for _name in TASKS:
    gymnasium.register(
        id=f'mbd/{"".join(part.capitalize() for part in _name.split("_"))}-v0',
        entry_point='mbd_sim_ros.learn.environments:DrivingEnv',
        vector_entry_point='mbd_sim_ros.learn.environments:DrivingVectorEnv',
        kwargs={'task': _name},
    )
