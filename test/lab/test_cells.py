"""What a study keeps: a cell that is there is not computed again, in the same program."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from mbd_sim_ros.lab.studies import cells
from mbd_sim_ros.lab.studies.cells import Cells, number


def filled(directory: Path, *names: str) -> list[str]:
    """Open the cells of a study that needs these; the ones that were computed."""
    computed, kept = [], Cells(directory)
    for name in names:

        def compute(name: str = name) -> dict[str, object]:
            computed.append(name)
            return {'value': name, 'none': math.nan}

        row = kept.cell(name, compute)
        assert (row['cell'], row['value']) == (name, name) and math.isnan(number(row['none']))
    return computed


def test_cells_are_computed_once_and_again_where_they_are_damaged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert filled(tmp_path, 'a', 'b') == ['a', 'b']
    assert filled(tmp_path, 'a', 'b', 'c') == ['c']
    for file in tmp_path.iterdir():
        if b'"b"' in file.read_bytes():
            file.write_bytes(file.read_bytes()[:-5])
    assert filled(tmp_path, 'a', 'b', 'c') == ['b']
    monkeypatch.setattr(cells, 'SOURCES', ('solver/disk.py',))  # another program
    assert filled(tmp_path, 'a') == ['a']
