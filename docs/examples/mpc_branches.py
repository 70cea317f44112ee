"""Model predictive control by branches from a saved state: a car follows a winding road.

    python docs/examples/mpc_branches.py

Every decision saves the plant, restores eight branches from that state, drives each for a second with another angle
of the steering wheel in the lanes of a core, and gives the plant the angle of the branch that costs least. The plant is
the same model here, so a branch that is followed is the future itself, to the bit; `restore` takes states of the same
model alone.
"""

from __future__ import annotations

import numpy as np

from mbd_sim_ros.learn import TASKS
from mbd_sim_ros.learn.fleet import Fleet

BRANCHES = 8  # lanes of a core
# Decisions of 0.1 s that a branch looks ahead, with one angle held. Ten times as many take ten times as long, and no
# single angle keeps the lane for 10 s.
AHEAD = 10
TURNS = np.linspace(-0.15, 0.15, BRANCHES - 1)  # changes of the action [-]; with 0 a second time, towards straight on


def drive(decisions: int = 60, seed: int = 0) -> tuple[np.ndarray, bool]:
    """(offsets from the line [m] after each decision, whether every chosen branch was the future to the bit)."""
    task = TASKS['lane_keeping']
    plant, branches = Fleet(task, 1), Fleet(task, BRANCHES)
    plant.reset(0, np.random.default_rng(seed))
    place = list(task.observations).index('offset')
    action, offsets, same, promised = 0.0, [], True, None
    for _ in range(decisions):
        state = plant.save(0)
        for k in range(BRANCHES):
            branches.restore(k, state)
        tried = np.clip(np.append(action + TURNS, 0.5 * action), -1.0, 1.0)
        cost = np.zeros(BRANCHES)
        for ahead in range(AHEAD):
            cost -= branches.step(tried[:, None]).rewards
            if ahead == 0:
                first = np.stack([s.snapshot().numbers for s in branches.ensemble.simulations])
        best = int(np.argmin(cost + 0.02 * np.abs(tried - action)))
        action, promised = float(tried[best]), first[best]
        seen = plant.step(np.array([[action]])).observations
        same = same and bool((plant.ensemble.simulations[0].snapshot().numbers == promised).all())
        offsets.append(float(seen[0, place]) * task.observations['offset'])
    return np.array(offsets), same


if __name__ == '__main__':
    found, to_the_bit = drive()
    print(f'{len(found)} decisions: largest offset {np.abs(found).max():.2f} m, at the end {found[-1]:+.2f} m')
    print('every branch that was followed came to the bit' if to_the_bit else 'branches were not the future')
