"""Parts of the study of stability that count: singular passages, linkages of many loops, and runs of ten million
steps."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbd_sim_ros.lab.studies import crank
from solver.analysis.verdict import findings, status_of
from solver.errors import MbdError, StepError
from solver.files.scene import load_scene
from solver.simulation import Simulation

PASSAGES = 2500  # at each step of the slider-crank
PASSAGE_STEPS = (10e-3, 5e-3, 2e-3, 1e-3)  # s
PHASES = 25
LOOK = 0.05  # s, a small part of the time between two passages
LOOPS, QUICK_LOOPS = (1, 2, 3, 4, 5, 7, 10, 15, 20, 30, 40), (1, 2)
LOOP_STEPS = np.round(np.geomspace(1e-3, 20e-3, 30), 9)  # s
LOOP_ITERATIONS = (3, 4, 6)
LOOP_DURATION = 5.0  # s
LOOP_LIMIT = 250.0  # J of energy error over loops h^2 [s^2]: away from the horizontal it is about 40
LONG = {
    'pendulum': 'a pendulum, from the horizontal',
    'spinning_top': 'a heavy top',
    'slider_crank': 'the slider-crank',
}


def passages(h: float, count: int) -> dict[str, Any]:
    """Singular passages of the slider-crank at a step, from PHASES starting angles: how many were made, lost, and left
    on a wrong branch.

    The angle of the crank passes pi/2 + n pi. On the right branch the angle between rod and crank is -2 times that of
    the crank.
    """
    made = lost = wrong = told = 0
    worst = 0.0
    messages: list[str] = []
    for theta in crank.phases(PHASES):
        done = 0
        try:
            s = Simulation(crank.scene_at(float(theta), h, {}))
            start = s.snapshot().joint_position.copy()
            turns = _half_turns(theta)
            while done < count / PHASES:
                now = s.advance(max(1, round(LOOK / h))).joint_position - start
                passed = abs(_half_turns(theta + now[0]) - turns)
                if not abs(2 * now[0] + now[1]) < crank.ON_BRANCH:
                    wrong += 1
                    messages.append(f'wrong branch at {s.t_ns * 1e-9:g} s from theta = {theta:.6f}')
                    break
                done = passed
                if s.t_ns * 1e-9 > 4.0 * count / PHASES:  # it swings, and does not come round any more
                    break
            told += bool(findings(s))
            worst = max(worst, s.totals()['energy_error_max'])
        except (StepError, MbdError) as error:
            lost += 1
            messages.append(str(error))
        made += done
    return {
        'h': h,
        'passages': made,
        'lost': lost,
        'wrong_branch': wrong,
        'suspect': told,
        'energy_error': worst,
        'messages': messages[:5],
    }


def _half_turns(theta: float) -> int:
    return int(np.floor((theta - np.pi / 2) / np.pi))


def loops(count: int, iterations: int) -> dict[str, Any]:
    """four_bar_n with so many loops at LOOP_STEPS: failures, and energy errors over loops h^2."""
    failed, suspect, ratios = 0, 0, []
    for h in LOOP_STEPS:
        sets = [f'mechanism.loops={count}', f'integrator={{h: {h}, iterations: {iterations}}}', 'require={}']
        try:
            s = Simulation(load_scene('four_bar_n', sets))
            s.advance(round(LOOP_DURATION / s.h))
            ratios.append(s.totals()['energy_error_max'] / (count * h**2))
            suspect += bool(findings(s))
        except StepError:
            failed += 1
            ratios.append(np.nan)
    return {'loops': count, 'iterations': iterations, 'failed': failed, 'suspect': suspect, 'ratios': ratios}


def long_run(name: str, steps: int) -> dict[str, Any]:
    """A run of many steps of 1 ms: what its energy, from places and velocities alone, has become, and what the run says
    of itself."""
    s = Simulation(load_scene(name, ['integrator={h: 0.001}', 'require={}']))
    start = s.last_step.account.energy[0]
    try:
        while s.k < steps:
            s.advance(min(100_000, steps - s.k))
    except StepError as error:
        return {
            'scene': name,
            'steps': s.k,
            'status': 'error',
            'text': str(error),
            'lost': None,
            'kinetic': None,
            'drift': None,
        }
    found = findings(s)
    a = s.last_step.account
    return {
        'scene': name,
        'steps': s.k,
        'status': status_of(found),
        'text': '; '.join(map(str, found)),
        'lost': float(start - a.energy[0]),
        'kinetic': float(a.kinetic[1]),
        'drift': s.totals()['position_drift_max'],
    }
