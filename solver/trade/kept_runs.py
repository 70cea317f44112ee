"""Runs of a plan on disk, so that one that was interrupted, or whose time was up, goes on where it was.

A file holds one run. It is named after the scene of the plan, the sources of the solver, the maneuver and the setting, so nothing in it can
be out of date; the bits of a run do not depend on when it was made. What cannot be read is as good as not there, and where nothing can be
written every run is made anew.
"""

from __future__ import annotations

import json
import uuid
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from solver.compiled.cache import digest
from solver.findings import Finding
from solver.trade.runs import Run
from solver.trade.setting import Setting
from solver.trade.variations import Variation

Judged = tuple[Run, tuple[Finding, ...]]
TIME, TOLD, CURVE = 'time', 'told', 'curve '


class KeptRuns:
    """The whole runs of one plan. directory: none keeps nothing. subject: says all that a run depends on besides maneuver and setting (the
    key of a plan, solver.levels.auto.key). names: of the quantities that runs are seen through."""

    def __init__(self, directory: Path | None, subject: str, names: Sequence[str]) -> None:
        self._directory, self._subject = directory, repr((subject, sorted(names)))
        self.found = 0  # runs that were there

    def get(self, v: Variation, setting: Setting, *, judged: bool = False) -> Judged | None:
        """A run, and with `judged` what makes it suspect; None where it is not there."""
        path = self._file(v, setting, judged)
        if path is None:
            return None
        with suppress(OSError, ValueError, KeyError, TypeError, BadZipFile), np.load(path, allow_pickle=False) as file:
            told = json.loads(str(file[TOLD]))
            curves = {name.removeprefix(CURVE): file[name] for name in file.files if name.startswith(CURVE)}
            findings = tuple(Finding(**one) for one in told['findings'])
            self.found += 1
            return Run(setting, file[TIME], curves, told['counters'], told['failure']), findings
        return None

    def made(self, v: Variation, setting: Setting, make: Callable[[], Run]) -> Run:
        """A run that is there, or is made and kept."""
        there = self.get(v, setting)
        if there is not None:
            return there[0]
        run = make()
        self.put(v, setting, run)
        return run

    def put(self, v: Variation, setting: Setting, run: Run, findings: Sequence[Finding] | None = None) -> None:
        """Keep a run; findings: what makes it suspect, of one that was made with that in view."""
        path = self._file(v, setting, findings is not None)
        if path is None:
            return
        told = {'failure': run.failure, 'counters': run.counters, 'findings': [asdict(one) for one in findings or ()]}
        arrays: dict[str, Any] = {TIME: run.time, TOLD: np.array(json.dumps(told))}
        arrays |= {CURVE + name: values for name, values in run.curves.items()}
        fresh = path.with_name(f'.{uuid.uuid4().hex}.npz')
        with suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            try:
                np.savez(fresh, **arrays)
                fresh.replace(path)
            finally:
                fresh.unlink(missing_ok=True)

    def _file(self, v: Variation, setting: Setting, judged: bool) -> Path | None:
        if self._directory is None:
            return None
        parts = (self._subject, repr(v), repr(setting), repr(judged))
        return self._directory / f'{digest(*(part.encode() for part in parts)).hex()}.npz'
