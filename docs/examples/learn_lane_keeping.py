"""Lane keeping is learned on the single-track level of the full car, and certified on the full car itself.

    python docs/examples/learn_lane_keeping.py       # two minutes; prints the return of every tenth generation
    python docs/examples/learn_lane_keeping.py 20    # 20 generations instead of 80

The policy is linear: the action is W times what is seen. An evolution strategy with mirrored samples improves W
(Salimans et al. 2017, docs/references.md); the cars of a generation drive in the lanes of a core. Certified means:
driven again by the full car with its bushings, bars and steering, from starts that no car has learned from, within the
lane.
"""

from __future__ import annotations

import argparse
import sys
from typing import NamedTuple

import numpy as np

from mbd_sim_ros.learn import TASKS, single, vector

PAIRS = 16  # of mirrored samples; ten times as many cost as much time and follow the slope of the mean more closely
SPREAD, RATE = 0.1, 0.03  # of samples about W, and of a step of it [-]; ten times as much jumps over what keeps a lane
TASK = TASKS['lane_keeping']
CHANGES = ('vehicle=vehicles/full_car.yaml', 'integrator.iterations=2')
SMALL = TASK.replace(changes=(*CHANGES, 'fidelity=single_track', 'integrator.h=0.005'), width=4.0, duration=10.0)
FULL = TASK.replace(changes=(*CHANGES, 'fidelity=full', 'integrator.h=0.001'))


class Certificate(NamedTuple):
    """Largest offset [m] of the drives from unseen starts, their returns, and whether all of them stayed in the lane to
    the end."""

    offset: float
    returns: list[float]
    held: bool


def learn(generations: int, seed: int = 0, say=None) -> tuple[np.ndarray, list[float]]:
    """(W (actions, signals), mean return of each generation)."""
    cars = vector(SMALL, 2 * PAIRS)
    chance = np.random.default_rng(seed)
    W = np.zeros((SMALL.actions, len(SMALL.observations)))
    returns = []
    for generation in range(generations):
        half = chance.standard_normal((PAIRS, *W.shape))
        tried = np.concatenate([half, -half])
        starts = int(chance.integers(1 << 30))
        gained = drive(cars, W + SPREAD * tried, [starts + k % PAIRS for k in range(2 * PAIRS)])
        ranks = np.argsort(np.argsort(gained)) / (2 * PAIRS - 1.0) - 0.5  # a wreck counts as much as any last place
        W = W + RATE * np.einsum('k,kij->ij', ranks, tried) / (PAIRS * SPREAD)
        returns.append(float(gained.mean()))
        if say is not None and generation % 10 == 0:
            say(f'generation {generation}: mean return {returns[-1]:.2f}')
    return W, returns


def drive(cars, policies: np.ndarray, seeds: list[int]) -> np.ndarray:
    """(n,) returns of one episode of each car with its policy (n, actions, signals)."""
    seen, _ = cars.reset(seed=seeds)
    gained, running = np.zeros(len(policies)), np.ones(len(policies), bool)
    while running.any():
        seen, rewards, ended, cut, _ = cars.step(np.einsum('kij,kj->ki', policies, seen))
        gained += rewards * running
        running &= ~(ended | cut)
    return gained


def certify(W: np.ndarray, starts: int = 3) -> Certificate:
    """The full car, with a policy, from starts of its own."""
    env, worst, returns, held = single(FULL), 0.0, [], True
    place = list(FULL.observations).index('offset')
    for seed in range(starts):
        seen, _ = env.reset(seed=(1 << 31) + seed)
        gained, over = 0.0, False
        while not over:
            seen, reward, ended, cut, _ = env.step(W @ seen)
            gained, over = gained + reward, ended or cut
            worst, held = max(worst, abs(float(seen[place])) * FULL.observations['offset']), held and not ended
        returns.append(gained)
    return Certificate(worst, returns, held)


if __name__ == '__main__':
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('generations', type=int, nargs='?', default=80, help='of the evolution strategy (default: 80)')
    try:
        learned, _ = learn(parser.parse_args().generations, say=print)
        found = certify(learned)
    except KeyboardInterrupt:
        sys.exit('interrupted: nothing is kept')
    print(f'full car: largest offset {found.offset:.2f} m, returns', ' '.join(f'{r:.2f}' for r in found.returns))
    print('held its lane in all drives' if found.held else 'left its lane')
