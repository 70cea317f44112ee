"""Many snapshots encoded together are the bytes of each encoded alone."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from synthetic import channels, snapshot

from mbd_sim_ros.messages.encode import Messages
from solver.output.sensors import Sensors
from solver.output.snapshot import layout_of

WAYS: dict[str, dict[str, Any]] = {
    'all at every step': {'element_states': True, 'reactions': True},
    'some seldom': {'element_states': True, 'elements_every': 3, 'poses_every': 4, 'links': ('one', 'two', 'three')},
    'a long period': {
        'element_states': True,
        'elements_every': 97,
        'poses_every': 89,
        'links': ('one', 'two', 'three'),
    },
    'motions': {'motions_every': 2},
    'a prefix': {'frame_prefix': 'left/'},
    'noise': {'sensors': Sensors(seed=3, noise=True)},
    'kinds': {'element_states': True, 'kinds': {'spring': 'spring_dampers', 'damper': 'dampers'}, 'elements_every': 2},
}


@pytest.mark.parametrize('vehicle', [True, False])
@pytest.mark.parametrize('way', WAYS)
def test_rows_are_encoded_as_snapshots(way: str, vehicle: bool) -> None:
    """Calls of several lengths, from several steps on; times beyond a second and beyond 2^31 s."""
    if way == 'noise' and not vehicle:
        pytest.skip('a mechanism has no sensors')
    names = channels(vehicle=vehicle)
    if way == 'motions':
        names = dataclasses.replace(names, moving=names.bodies)
    alone, together = Messages(names, **WAYS[way]), Messages(names, **WAYS[way])
    for first, n, h_ns in ((1, 7, 2_000_000), (8, 1, 2_000_000), (9, 40, 999_999_999), (60, 12, 40_000_000_000_000)):
        shots = [snapshot(names, k, h_ns=h_ns) for k in range(first, first + n)]
        expected = [alone.encode(shot) for shot in shots]
        steps = np.arange(first, first + n)
        assert together.encode_rows(steps, steps * h_ns, np.array([shot.numbers for shot in shots])) == expected
    shot = snapshot(names, 200)
    assert together.encode(shot) == alone.encode(shot)  # which has the same buffer as before


@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf])
def test_rows_end_before_one_that_is_not_finite(bad: float) -> None:
    names = channels()
    messages = Messages(names)
    rows = np.array([snapshot(names, k).numbers for k in range(5)])
    rows[3, 2] = bad
    steps = np.arange(5)
    assert messages.encode_rows(steps, steps, rows) == messages.encode_rows(steps[:3], steps[:3], rows[:3])
    rows[3, 2], at = 0.0, layout_of(names)['reactions'][0].start
    rows[3, at] = np.nan  # which says that it is not determined, and is shown
    assert len(messages.encode_rows(steps, steps, rows)) == 5
    rows[3, at] = bad
    assert len(messages.encode_rows(steps, steps, rows)) == (5 if np.isnan(bad) else 3)
    large = np.full_like(rows, 1e308)  # whose sum is not
    assert len(messages.encode_rows(steps, steps, large)) == 5
    assert messages.encode_rows(steps[:0], steps[:0], rows[:0]) == []
