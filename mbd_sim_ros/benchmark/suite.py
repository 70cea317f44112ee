"""The cases of `mbd bench` and one run over all of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from mbd_sim_ros.benchmark import overhead, stepping
from mbd_sim_ros.benchmark.machine import Watch, fingerprint, on_one_core
from solver.elements.marker import finite, require
from solver.errors import MbdError, SceneError, suggestion
from solver.load import Builder
from solver.nodes import read
from solver.scene import config_directories, find_file

ROUNDS, QUICK_ROUNDS = 5, 2
STEPS, QUICK_STEPS = 4000, 500  # of every way of stepping, per round
PACED_STEPS, QUICK_PACED_STEPS = 500, 100  # per round, in real time


@dataclass(frozen=True, kw_only=True)
class Case:
    """One line of the benchmark.

    measure: 'steps' times advance(), 'record' and 'publish' what encoding, recording and publishing add to a step of a loop paced at
    the step of the scene. set: changes to the scene, as `--set`. targets: limits [us] of figures, by name (FIGURES).
    """

    name: str
    scene: str
    measure: Literal['steps', 'record', 'publish'] = 'steps'
    set: tuple[str, ...] = ()
    targets: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        known = stepping.FIGURES if self.measure == 'steps' else overhead.FIGURES
        for figure, limit in self.targets.items():
            require(figure in known, f'case {self.name!r}', 'targets', figure, 'no such figure' + suggestion(figure, known))
            finite(f'case {self.name!r}', f'targets.{figure}', limit, low=0.0, strict=True)


@dataclass(frozen=True, kw_only=True)
class Suite:
    """All cases, in the order in which they are shown."""

    cases: tuple[Case, ...]


def load_suite(file: str | Path = 'benchmarks.yaml', names: Sequence[str] = ()) -> tuple[Case, ...]:
    """The cases of a file (a path, or a name in config/), or those called `names`. Raises SceneError."""
    root = read(find_file(file, 'benchmarks'), config_directories())
    cases = {case.name: case for case in Builder().build(Suite, root).cases}
    for name in names:
        if name not in cases:
            raise SceneError(f'--cases {name}: no such case{suggestion(name, cases)}')
    return tuple(case for name, case in cases.items() if not names or name in names)


def run(cases: Sequence[Case], *, quick: bool = False, say: Callable[[str], None] = lambda _: None) -> dict[str, Any]:
    """Measure all cases in one run on one core and return the report (see docs/performance.md for what the figures are).

    The cases take turns, round by round, so that all share the good and the bad minutes of the machine. A case whose scene cannot be
    loaded or simulated, or whose packages are missing, is 'unavailable' with the reason. say: receives progress lines.
    """
    rounds = QUICK_ROUNDS if quick else ROUNDS
    machine = fingerprint()
    reports = [{**asdict(case), 'status': 'ok', 'reason': ''} for case in cases]
    measurements: dict[str, stepping.Stepping | overhead.Overhead] = {}

    def attempt(report: dict[str, Any], action: Callable[[], None]) -> None:
        try:
            action()
        except (MbdError, ImportError) as error:
            measurements.pop(report['name'], None)
            report |= {'status': 'unavailable', 'reason': ' '.join(str(error).split())}

    def prepare(case: Case) -> None:
        if case.measure == 'steps':
            measurements[case.name] = stepping.Stepping(case.scene, case.set)
        else:
            made = overhead.Overhead(case.scene, case.set, publish=case.measure == 'publish')
            resources.callback(made.close)
            measurements[case.name] = made

    with on_one_core() as core, ExitStack() as resources:
        for case, report in zip(cases, reports, strict=True):
            say(f'preparing {case.name}')
            attempt(report, lambda case=case: prepare(case))  # type: ignore[misc]
        watch = Watch(core)
        for k in range(rounds):
            for report in reports:
                measurement = measurements.get(report['name'])
                if measurement is None:
                    continue
                say(f'round {k + 1} of {rounds}: {report["name"]}')
                if isinstance(measurement, stepping.Stepping):
                    n = QUICK_STEPS if quick else STEPS
                else:
                    n = QUICK_PACED_STEPS if quick else PACED_STEPS
                attempt(report, lambda m=measurement, n=n: m.round(n))  # type: ignore[misc]
        disturbance = watch.read()
    for report in reports:
        if report['name'] in measurements:
            report |= measurements[report['name']].figures()
        report['targets'] = [
            {'figure': figure, 'limit': limit, 'value': value, 'met': None if value is None else bool(value <= limit)}
            for figure, limit in report['targets'].items()
            for value in [report.get('us', {}).get(figure)]
        ]
    return {
        'rounds': rounds,
        'core': core,
        'machine': machine,
        'disturbance': disturbance,
        'warnings': warnings(machine, disturbance),
        'cases': reports,
    }


def warnings(machine: dict[str, Any], disturbance: dict[str, float]) -> list[str]:
    """Sentences about why the figures may be too high."""
    found = []
    if machine['load_average'] > 0.25 * machine['cores']:
        found.append(f'the machine was busy before the run: load average {machine["load_average"]:.2f} on {machine["cores"]} cores')
    if disturbance['waited'] > 0.02:
        found.append(f'the measuring thread waited for its core {disturbance["waited"]:.1%} of the time: other processes ran on it')
    if disturbance['stolen'] > 0.01:
        found.append(f'the hypervisor took {disturbance["stolen"]:.1%} of the core')
    return found
