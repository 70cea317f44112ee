"""Runs of plans on disk, so that one that was interrupted, or whose time was up, goes on where it was, and one that
requires something else of the same scene begins with what is there.

A file holds one run. It is named after the scene, the sources of the solver, the maneuver and the setting, so nothing
in it can be out of date; the bits of a run do not depend on when it was made. Where nothing can be written every run is
made anew.
"""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from solver.disk import Store, digest
from solver.findings import Finding
from solver.levels.auto import key
from solver.scene import Budget, Scene
from solver.trade.runs import Run
from solver.trade.setting import Setting
from solver.trade.variations import Variation

Judged = tuple[Run, tuple[Finding, ...]]
TIME, TOLD, CURVE = 'time', 'told', 'curve '


class KeptRuns:
    """The whole runs of a scene, whatever is required of it. directory: none keeps nothing; what nobody uses is removed
    from it. subject: says all that a run depends on besides maneuver and setting (runs_of). names: of the quantities
    that runs are seen through."""

    def __init__(self, directory: Path | None, subject: str, names: Sequence[str]) -> None:
        self._store = None if directory is None else Store(directory, bounded=True)
        self._subject = repr((subject, sorted(names)))
        self.found = 0  # runs that were there

    def get(self, v: Variation, setting: Setting, *, judged: bool = False) -> Judged | None:
        """A run, and with `judged` what makes it suspect; None where it is not there."""
        content = None
        for kind in (True,) if judged else (False, True):
            name = self._name(v, setting, kind)
            if self._store is not None and content is None:
                content = self._store.read(name, name)
        if content is None:
            return None
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            told = json.loads(str(file[TOLD]))
            curves = {name.removeprefix(CURVE): file[name] for name in file.files if name.startswith(CURVE)}
            findings = tuple(Finding(**one) for one in told['findings']) if judged else ()
            self.found += 1
            return Run(setting, file[TIME], curves, told['counters'], told['failure']), findings

    def put(self, v: Variation, setting: Setting, run: Run, findings: Sequence[Finding] | None = None) -> None:
        """Keep a run; findings: what makes it suspect, of one that was made with that in view."""
        if self._store is None:
            return
        told = {'failure': run.failure, 'counters': run.counters, 'findings': [asdict(one) for one in findings or ()]}
        arrays: dict[str, Any] = {TIME: run.time, TOLD: np.array(json.dumps(told))}
        arrays |= {CURVE + name: values for name, values in run.curves.items()}
        content, name = io.BytesIO(), self._name(v, setting, findings is not None)
        np.savez(content, **arrays)
        with suppress(OSError):
            self._store.write(name, content.getvalue(), name)

    def _name(self, v: Variation, setting: Setting, judged: bool) -> str:
        return f'{digest(self._subject, repr(v), repr(setting), repr(judged)).hex()}.npz'


def runs_of(scene: Scene) -> str:
    """Digest of all that runs of a scene, and the findings on them, depend on besides maneuver and setting: everything
    that a plan depends on but the errors that are allowed."""
    return key(dataclasses.replace(scene, require=dataclasses.replace(scene.require, accuracy={}), budget=Budget()))


NOWHERE = KeptRuns(None, '', ())
