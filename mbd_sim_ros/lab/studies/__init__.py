"""Studies: a question put to many runs, answered by a report with pictures and tables. `mbd study NAME` runs one.

STUDIES names the module of every study. Such a module has

    SUMMARY: str
        One line of the source for `mbd study --help` and `mbd list studies`, without a full stop.

    def study(out: Path, *, quick: bool, progress: Callable[[str, float], None]) -> dict Write report.md, pictures
        (.png) and tables (.csv) into the existing directory `out` and return the figures as a dict that JSON can hold
        (numbers of numpy are fine). Its entry 'checks' is a list of dicts with the keys name, value, limit, met, as
        report.check() makes them: requirements, each with the number it was judged by. quick: the same program on a few
        runs, a few seconds after compilation, for a first look and for tests. progress(text, done): say what is being
        done and which share of the work is behind, 0 to 1; call it before every piece of work that takes more than a
        second.

A study of a scene of the user's choice has OF_SCENE = True, and study() takes scene (a Scene) and workers (runs at a
time, None for as many as there are cores) too.

A study of recordings that this project does not hold has OF_DATA = True, and study() takes data, their directory.

One that draws random samples has DRAWS = True, and study() takes n and seed, their number (None: its own) and that of
their series. Studies that take minutes keep their results in cells.py, cell by cell, so that they go on where they were
interrupted.

Conclusions in a report are computed from the numbers beside them. A study that needs an optional package and cannot do
without it raises SpecError with one sentence that says how to install it; one that can leaves the part out and says so
in the report. Errors of the user are MbdError; failures of single runs are results and belong into the tables. Nothing
depends on the clock except where CPU time is what is measured. Random numbers come from an explicit seed that stands in
the report.

The tools of all studies are in report.py: Report (markdown with tables, pictures, CSV files, checks) and the style of
pictures.
"""

from __future__ import annotations

import ast
import importlib
import importlib.util
import re
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

from solver.errors import SpecError, suggestion

Progress = Callable[[str, float], None]

STUDIES: dict[str, str] = {  # name: module
    'slider_crank': 'mbd_sim_ros.lab.studies.slider_crank',
    'work_precision': 'mbd_sim_ros.lab.studies.work_precision',
    'penalty_map': 'mbd_sim_ros.lab.studies.penalty_map',
    'slider_crank_phases': 'mbd_sim_ros.lab.studies.slider_crank_phases',
    'kandc': 'mbd_sim_ros.lab.studies.kandc',
    'car': 'mbd_sim_ros.lab.studies.car',
    'trade': 'mbd_sim_ros.lab.studies.trade',
    'car_cost': 'mbd_sim_ros.lab.studies.car_cost',
    'validation': 'mbd_sim_ros.lab.studies.validation',
    'levels': 'mbd_sim_ros.lab.studies.levels',
    'plan': 'mbd_sim_ros.lab.studies.plan',
    'mechanisms': 'mbd_sim_ros.lab.studies.mechanisms',
    'verdicts': 'mbd_sim_ros.lab.studies.verdicts',
    'stability': 'mbd_sim_ros.lab.studies.stability',
    'error_bars': 'mbd_sim_ros.lab.studies.error_bars',
    'drives': 'mbd_sim_ros.lab.studies.drives',
    'constants': 'mbd_sim_ros.lab.studies.constants',
    'fit_coverage': 'mbd_sim_ros.lab.studies.fit_coverage',
    'reality': 'mbd_sim_ros.lab.studies.reality',
    'change_points': 'mbd_sim_ros.lab.studies.change_points',
}


def installed() -> list[str]:
    """The studies that are here: those of users, and in a checkout of the source all of them (LAB in setup.py)."""
    return [name for name, path in STUDIES.items() if importlib.util.find_spec(path) is not None]


def module(name: str) -> ModuleType:
    """The module of a study. Raises SpecError for an unknown name, and for one that is not installed."""
    if name not in STUDIES:
        raise SpecError(f'study {name!r}: no such study{suggestion(name, STUDIES)}')
    if name not in installed():
        raise SpecError(
            f'study {name!r}: proves the program to itself and is not installed; run it in a checkout of the source '
            f'of mbd_sim_ros, after make setup there; installed: {", ".join(installed())}'
        )
    return importlib.import_module(STUDIES[name])


def summary(name: str) -> str:
    """The SUMMARY of a study that is installed, read from the source: to import all of their modules takes two
    seconds."""
    spec = importlib.util.find_spec(STUDIES[name])
    text = Path(spec.origin).read_text(encoding='utf-8') if spec is not None and spec.origin else ''
    text_of_it = re.search(r'^SUMMARY = (\(\n(?:.*\n)*?\)|.+)$', text, re.MULTILINE)
    return ast.literal_eval(text_of_it[1]) if text_of_it is not None else module(name).SUMMARY


def of_scene(name: str) -> bool:
    """True where a study wants a scene. Raises SpecError for an unknown name."""
    return getattr(module(name), 'OF_SCENE', False)


def of_data(name: str) -> bool:
    """True where a study wants recordings of others. Raises SpecError for an unknown name."""
    return getattr(module(name), 'OF_DATA', False)


def draws(name: str) -> bool:
    """True where a study draws samples. Raises SpecError for an unknown name."""
    return getattr(module(name), 'DRAWS', False)


def run(name: str, out: Path, *, quick: bool, progress: Progress, **options: Any) -> dict:
    """Run a study into the directory `out`, made if need be; options: scene and workers of those that want a scene, n
    and seed of those that draw samples, data of those of recordings.

    Raises SpecError, OSError and what the study raises.
    """
    chosen = module(name)
    out.mkdir(parents=True, exist_ok=True)
    return chosen.study(out, quick=quick, progress=progress, **options)
