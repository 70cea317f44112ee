"""Several simulations in threads."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from solver.errors import StepError
from solver.files.scene import load_scene
from solver.parallel import advance_all
from solver.simulation import Simulation

# with and without a driver; one twice
SCENES = ('light_car_step_steer', 'light_car_circle', 'slider_crank', 'slider_crank')


def test_threads_change_no_bits():
    alone, together = ([Simulation(load_scene(name)) for name in SCENES] for _ in range(2))
    for n in (1, 40, 100):
        one = [simulation.advance(n) for simulation in alone]
        other = advance_all(together, n, threads=4)
        for a, b in zip(one, other, strict=True):
            assert (a.k, a.counters) == (b.k, b.counters)
            assert a.numbers.tobytes() == b.numbers.tobytes()
    assert [s.save() for s in alone] == [s.save() for s in together]


def test_inputs_belong_to_their_simulation():
    one, other = (Simulation(load_scene('light_car_step_steer')) for _ in range(2))
    rows = [one.inputs + 0.1, None]
    snapshots = advance_all([one, other], 3, rows)
    assert snapshots[0].inputs.tolist() == rows[0].tolist()
    assert snapshots[1].inputs.tolist() == other.source.table(2, 1)[0].tolist()


def test_a_failure_stops_only_its_own_simulation():
    good, bad = (Simulation(load_scene('slider_crank')) for _ in range(2))
    bad.state.v[0, 0] = np.nan
    with pytest.raises(StepError, match=r't = 0\.000000 s, step 0'):
        advance_all([bad, good], 5)
    assert (good.k, bad.k) == (5, 0)
    with pytest.raises(ValueError, match='twice'):
        advance_all([good, good], 1)


def test_a_step_in_a_batch_does_not_hold_the_interpreter_lock():
    """While one thread is in the compiled steps of one call, this one gets on: it sees the call begun and not yet
    ended."""
    simulation = Simulation(load_scene('slider_crank', ['duration=1000']))
    inputs = simulation.inputs.copy()
    simulation.advance(1, inputs)
    steps = 20000  # some tenths of a second
    begun = threading.Event()

    def run() -> None:
        begun.set()
        simulation.advance(steps, inputs, audit=False)

    thread = threading.Thread(target=run)
    thread.start()
    begun.wait()
    looks = 0
    while thread.is_alive():
        looks += 1
        time.sleep(1e-3)
    assert looks > 10
    assert simulation.k == steps + 1
