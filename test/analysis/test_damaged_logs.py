"""MDF files that are damaged so that the library still reads them: what it says is told, times that are none are
dropped and counted."""

from __future__ import annotations

import gc
import logging
import sys
from pathlib import Path

import numpy as np
import pytest

from mbd_sim_ros.analysis import logs
from mbd_sim_ros.analysis.tables import Table
from solver.errors import BagError

FILE = Path('drive.mf4')


@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf, 1e300, 1e10])
def test_samples_whose_time_is_none_are_dropped_and_counted(bad: float) -> None:
    """They became any number at all, by a cast that overflowed."""
    time = np.arange(20) * 0.01
    time[7] = bad
    table = Table()
    logs._add(table, 'group_0', FILE, time, {'speed': np.arange(20.0)})
    assert table.series['group_0'].columns['speed'].tolist() == [*range(7), *range(8, 20)]
    assert table.series['group_0'].time_ns.tolist() == [k * 10_000_000 for k in range(20) if k != 7]
    assert table.told == ['1 of 20 samples of group_0 have a time that is no number below 4.61e+09 s, and are dropped']
    with pytest.raises(BagError, match=r'drive\.mf4: 20 of 20 times of group_0 are no numbers of seconds'):
        logs._add(table, 'group_0', FILE, np.full(20, bad), {'speed': np.arange(20.0)})


def test_what_the_library_logs_is_told_once_and_not_printed(capfd: pytest.CaptureFixture[str]) -> None:
    table, logger = Table(), logging.getLogger('asammdf')
    before = list(logger.handlers)
    with logs._told(table):
        for _ in range(2):
            logger.error('Expected "##FH" block\n@0x1b90')
    assert table.told == ['Expected "##FH" block @0x1b90'] and logger.handlers == before
    assert capfd.readouterr().err == ''


def test_what_is_left_of_an_object_that_failed_says_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    """It was deleted after the sentence had been told, in a traceback."""

    class Half:
        def __init__(self) -> None:
            self.me = self
            raise ValueError('seek out of range')

        def __del__(self) -> None:
            raise AttributeError('_file')

    with pytest.raises(BagError, match='cannot read: seek out of range'), logs._one_sentence('cannot read'):
        Half()
    gc.collect()
    assert 'AttributeError' not in capfd.readouterr().err and sys.unraisablehook is not None
