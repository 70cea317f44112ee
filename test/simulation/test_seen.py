"""Rows that a call of many steps takes are the snapshots of a call for each of them, bit for bit."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from single_tracks import simulation as single_track

from solver import simulation_of
from solver.errors import StepError
from solver.files.scene import load_scene
from solver.inputs.maneuver import Maneuver
from solver.simulation import Simulation


def scene(name: str, *sets: str) -> Callable[[], Simulation]:
    return lambda: simulation_of(load_scene(name, list(sets)))


MADE: dict[str, Callable[[], Simulation]] = {
    'adapting': scene('light_car_step_steer'),
    'constant': scene('light_car_step_steer', 'integrator.step_policy=constant'),
    'by error': scene('double_pendulum', 'integrator.mode=tolerance', 'integrator.step_policy=error'),
    'order four': scene('double_pendulum', 'integrator.mode=tolerance', 'integrator.step_policy=error',
                        'integrator.order=4', 'integrator.rho_inf=1'),
    'branches': scene('four_bar', 'record.branches=true'),
    'driver': scene('light_car_lane_change'),
    'divided': scene('slider_crank', 'integrator.iterations=1', 'integrator.h=0.02'),
    'following': scene('pendulum', 'integrator.kind=reference_kkt', 'integrator.h=0.01'),
    'single_track': lambda: single_track(Maneuver(steering=0.3)),
}  # fmt: skip


@pytest.mark.parametrize('audit', [True, False])
@pytest.mark.parametrize('name', MADE)
def test_rows_are_snapshots(name: str, audit: bool) -> None:
    """Whatever the number of steps between them and the step at which a call begins; the account is the same too."""
    for every, begin, n in ((1, 0, 6), (4, 3, 30), (7, 7, 20), (50, 2, 10)):
        calls, one = MADE[name](), MADE[name]()
        for simulation in (calls, one):
            if begin:
                simulation.advance(begin, audit=audit)
        rows, steps = [], []
        for k in range(begin + 1, begin + n + 1):
            if k % every == 0 or k == begin + n:
                snapshot = calls.advance(k - calls.k, audit=audit)
                if k % every == 0:
                    rows.append(snapshot.numbers.tobytes())
                    steps.append(k)
        seen = one.seen(every, n)
        last = one.advance(n, audit=audit, seen=seen)
        assert seen.steps.tolist() == steps and [row.tobytes() for row in seen.numbers] == rows
        assert (last.k, last.numbers.tobytes()) == (snapshot.k, snapshot.numbers.tobytes())
        assert one.last_step.account.numbers.tobytes() == calls.last_step.account.numbers.tobytes()
        assert one.totals() == calls.totals()


@pytest.mark.parametrize('name', ['adapting', 'constant', 'driver', 'single_track'])
def test_a_failure_keeps_the_rows_before_it(name: str) -> None:
    simulation = MADE[name]()
    rows = np.tile(simulation.inputs, (12, 1))
    rows[9, simulation.channels.inputs.index('drive_torque')] = 1e300
    seen = simulation.seen(2, 8)
    with pytest.raises(StepError):
        simulation.advance(12, rows, seen=seen)
    assert simulation.k == 9 and seen.steps.tolist() == [2, 4, 6, 8]
    again = MADE[name]()
    for row in seen.numbers:
        assert again.advance(2, rows[:2]).numbers.tobytes() == row.tobytes()


@pytest.mark.parametrize('name', ['adapting', 'constant', 'branches', 'single_track'])
def test_an_input_that_is_not_finite_is_refused_before_a_step_whatever_is_seen(name: str) -> None:
    """In the tenth row, far behind the first row that is to be seen."""
    simulation, other = MADE[name](), MADE[name]()
    rows = np.tile(simulation.inputs, (12, 1))
    wrong = rows.copy()
    wrong[9, 0] = np.nan
    for seen in (None, simulation.seen(2, 6)):
        with pytest.raises(StepError, match=r'step 0: input .* is not finite; nothing was advanced'):
            simulation.advance(12, wrong, seen=seen)
        assert simulation.k == 0 and simulation.applied is not None and len(simulation.applied) == 0
        assert seen is None or len(seen.steps) == 0
        assert simulation.save() == other.save()
    assert simulation.advance(12, rows).numbers.tobytes() == other.advance(12, rows).numbers.tobytes()


def test_a_table_that_is_too_small_is_refused_before_a_step() -> None:
    simulation = MADE['constant']()
    with pytest.raises(ValueError, match='advance: 9 steps have more rows than 2'):
        simulation.advance(9, seen=simulation.seen(3, 2))
    assert simulation.k == 0
    simulation.advance(8, seen=simulation.seen(3, 2))
    with pytest.raises(ValueError, match='seen: every = 0: must be 1 at least'):
        simulation.seen(0, 2)
