"""A recording with a clock that was set, or a few far apart samples, asks for no more memory and time than it has."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from mbd_sim_ros.analysis.evaluation.grid import shared_grid
from mbd_sim_ros.analysis.view.picture import write_film
from solver.errors import BagError


def test_a_clock_that_was_set_makes_no_grid_of_years() -> None:
    t = np.arange(2000, dtype=np.int64) * 10_000_000
    grid, _, notes = shared_grid({'x': t}, 'bag', frozenset())
    assert grid.size == t.size and not notes
    t[1000:] += 30 * 365 * 86_400 * 1_000_000_000
    with pytest.raises(
        BagError,
        match=r'bag: from 0 to 9\.46\d+e\+08 s there are more than 5000000 samples at steps of 0\.01 s; a clock was '
        r'set',
    ) as caught:
        shared_grid({'x': t}, 'bag', frozenset())
    assert '\n' not in str(caught.value)


def test_a_film_of_days_is_refused_before_it_is_begun(tmp_path: Path) -> None:
    motion = cast(Any, SimpleNamespace(time=np.array([0.0, 86_400.0])))
    with pytest.raises(BagError, match=r'film\.mp4 would have 2\.16e\+06 pictures'):
        write_film([motion], tmp_path / 'film.mp4', rate=25.0, speed=1.0, progress=False)
