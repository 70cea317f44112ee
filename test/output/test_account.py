"""The running account: every number has one name, in the order of saved states."""

from __future__ import annotations

import numpy as np
import pytest

from solver.output.account import new_account, noted

# Where names begin in saved states; what lies between follows from the shapes.
FIRST = {
    'worst': 3,
    'time': 6,
    'kinetic': 9,
    'residual': 16,
    'turn': 25,
    'steps': 28,
    'swing': 30,
    'phase': 38,
    'contradiction': 53,
}


@pytest.mark.parametrize(('bodies', 'peaks', 'tires'), [(0, 0, 0), (3, 0, 2), (2, 4, 0)])
def test_the_views_are_the_buffer_each_number_once_and_in_order(bodies: int, peaks: int, tires: int) -> None:
    account = new_account(bodies, peaks, tires)
    assert not account.numbers.any()
    account.numbers[:] = np.arange(len(account.numbers))
    views = account._asdict()
    del views['numbers']
    assert (np.concatenate([view.ravel() for view in views.values()]) == account.numbers).all()
    for name, view in views.items():
        assert view.size == 0 or np.shares_memory(view, account.numbers), name
        assert view.flags.c_contiguous and view.flags.writeable
    assert {name: int(getattr(account, name).flat[0]) for name in FIRST} == FIRST
    assert account.twist.shape == (bodies, 2, 6) and account.peak.shape == (peaks, 2)
    assert len(account.numbers) == 64 + (12 + 6 + 4) * bodies + 2 * peaks + 12 * tires


def test_what_is_written_by_name_is_in_the_copy_of_the_buffer() -> None:
    account, other = new_account(1, 1), new_account(1, 1)
    account.turn[:] = 0.5, 1.25, 3.0
    account.peak[0, 1] = 7.0
    other.numbers[:] = account.numbers
    assert noted(other.turn) == (0.5, 1.25, 3)
    assert other.peak[0].tolist() == [0.0, 7.0]
