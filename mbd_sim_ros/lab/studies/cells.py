"""Results of long studies, cell by cell on disk, so that a study that was interrupted goes on where it was."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mbd_sim_ros import interrupts
from solver.disk import Store, digest, plain, sources

ROOT = Path(__file__).resolve().parents[3]
SOURCES = ('solver', 'config', 'mbd_sim_ros/lab/mechanisms', 'mbd_sim_ros/lab/studies/crank.py')


class Cells:
    """Finished cells of a study in a directory. Those of another program are others. more: files and folders of the
    program that they depend on beside SOURCES, or beside `base`."""

    def __init__(self, directory: Path, more: Sequence[str] = (), base: Sequence[str] | None = None) -> None:
        self._store = Store(directory)
        self._program = sources(
            *(ROOT / place for place in (*(SOURCES if base is None else base), *more)),
            suffixes=('.py', '.yaml', '.tir'),
        )

    def cell(self, name: str, compute: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """The row of a cell, computed if it is not there. Between two cells a signal ends the study."""

        def row() -> dict[str, Any]:
            interrupts.now(
                f'computing {name}; what is finished is in {self._store.directory} and is not computed again'
            )
            interrupts.check()
            return plain({'cell': name, **compute()})

        return self._store.made(f'{digest(self._program, name).hex()}.json', row)


def number(value: float | None) -> float:
    """A number of a row: null is nan."""
    return math.nan if value is None else float(value)
