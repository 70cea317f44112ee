"""The cases of `mbd bench` and one run over all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol

from mbd_sim_ros.lab.benchmarks import (
    endurance,
    growth,
    lanes,
    levels,
    linkage,
    node_levels,
    overhead,
    rigs,
    single,
    start,
    stepping,
    threads,
)
from mbd_sim_ros.lab.benchmarks.machine import Watch, fingerprint, on_one_core
from solver.dimensions import Time
from solver.errors import MbdError, SceneError, suggestion
from solver.files.scene import config_directories
from solver.files.schema import Builder
from solver.files.yaml_tree import find, read
from solver.validate import finite, require

ROUNDS, QUICK_ROUNDS = 5, 2
QUICK_SECONDS = 10.0  # of a run of the node


class Measurement(Protocol):
    """One case being measured. Made with what it needs; whatever it raises that is an MbdError makes the case
    unavailable."""

    def round(self, steps: int) -> None:
        """Measure some steps."""

    def figures(self) -> dict[str, Any]:
        """The part of the report that belongs to this case; 'figures' holds those of Measure.figures by name."""

    def close(self) -> None:
        """End what was started."""


class Measure(NamedTuple):
    """One way of measuring: the meaning of its figures by name, its steps per round, and what makes a Measurement."""

    figures: Mapping[str, str]
    steps: int
    quick_steps: int
    make: Callable[[BenchmarkCase, bool], Measurement]  # (case, quick)
    once: bool = False  # one round only, whatever the others need


def _steps(name: str, quick: bool) -> int:
    return MEASURES[name].quick_steps if quick else MEASURES[name].steps


def _overhead(case: BenchmarkCase) -> Measurement:
    publish = case.measure == 'publish'
    return overhead.Overhead(case.scene, case.set, publish=publish, publish_every=case.publish_every)


def _endurance(case: BenchmarkCase, quick: bool) -> Measurement:
    seconds = min(case.duration, QUICK_SECONDS) if quick else case.duration
    return endurance.Endurance(case.scene, case.set, seconds, with_reader=case.measure == 'node_and_reader')


def _node_levels(case: BenchmarkCase, quick: bool) -> Measurement:
    seconds = min(case.duration, QUICK_SECONDS) if quick else case.duration
    return node_levels.NodeLevels(case.scene, case.set, seconds, publish_every=case.publish_every)


MEASURES: dict[str, Measure] = {
    'steps': Measure(stepping.FIGURES, 4000, 500, lambda case, _: stepping.Stepping(case.scene, case.set)),
    'single': Measure(single.FIGURES, 12000, 500, lambda case, _: single.Single(case.scene, case.set)),
    'growth': Measure(growth.FIGURES, 1000, 200, lambda case, _: growth.Growth(case.scene, case.set)),
    'threads': Measure(threads.FIGURES, 4000, 500, lambda case, _: threads.Threads(case.scene, case.set)),
    'peers': Measure(
        rigs.FIGURES, 500, 100, lambda case, quick: rigs.Peers(case.scene, case.set, _steps('peers', quick))
    ),
    'linkage': Measure(
        linkage.FIGURES, 100, 20, lambda case, quick: linkage.Linkage(case.scene, case.set, _steps('linkage', quick))
    ),
    'record': Measure(overhead.FIGURES, 2000, 500, lambda case, _: _overhead(case)),
    'publish': Measure(overhead.FIGURES, 2000, 500, lambda case, _: _overhead(case)),
    'start': Measure(start.FIGURES, 1, 1, lambda case, _: start.StartUp(case.scene, case.set), once=True),
    'levels': Measure(levels.FIGURES, 4000, 400, lambda case, _: levels.Levels(case.scene, case.set)),
    'lanes': Measure(lanes.FIGURES, 4096, 512, lambda case, _: lanes.Lanes(case.scene, case.set)),
    'node_levels': Measure(node_levels.FIGURES, 1, 1, _node_levels, once=True),
    'node': Measure(endurance.FIGURES, 1, 1, _endurance, once=True),
    'node_and_reader': Measure(endurance.FIGURES, 1, 1, _endurance, once=True),
}


@dataclass(frozen=True, kw_only=True)
class BenchmarkCase:
    """One line of the benchmark.

    measure: 'steps' times advance(), 'single' steps one at a time beside an idle loop; 'growth' is for scenes of
    several sizes, 'threads' for several simulations at once, 'levels' for the levels of detail of a vehicle, 'lanes'
    for eight cars in the lanes of a core, 'peers' for the car on a rig and 'linkage' for N four-bar linkages here and
    in other programs; 'record' and 'publish' tell what encoding, recording and publishing add to a step of a paced
    loop, 'start' how long a start takes; 'node' is the real node for `duration` [s], commanded, publishing and
    recording every step, 'node_and_reader' the same with a reader of every topic, 'node_levels' how much of a core it
    takes at each level. set: changes to the scene, as `--set`. publish_every: of 'record', 'publish' and 'node_levels',
    messages after every n-th step, as the parameter of the node. targets: limits of figures, by name."""

    name: str
    scene: str
    measure: Literal[
        'steps',
        'single',
        'growth',
        'threads',
        'levels',
        'lanes',
        'peers',
        'linkage',
        'record',
        'publish',
        'start',
        'node',
        'node_and_reader',
        'node_levels',
    ] = 'steps'
    set: tuple[str, ...] = ()
    duration: Time = 600.0
    publish_every: int = 1
    targets: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        known = MEASURES[self.measure].figures
        finite(f'case {self.name!r}', 'duration', self.duration, low=0.0, strict=True)
        finite(f'case {self.name!r}', 'publish_every', self.publish_every, low=1)
        for figure, limit in self.targets.items():
            if figure not in known:
                require(False, f'case {self.name!r}', 'targets', figure, 'no such figure' + suggestion(figure, known))
            finite(f'case {self.name!r}', f'targets.{figure}', limit, low=0.0)


@dataclass(frozen=True, kw_only=True)
class Suite:
    """All cases, in the order in which they are shown."""

    cases: tuple[BenchmarkCase, ...]


def load_suite(file: str | Path = 'benchmarks.yaml', names: Sequence[str] = ()) -> tuple[BenchmarkCase, ...]:
    """The cases of a file (a path, or a name in config/), or those called `names`. Raises SceneError."""
    root = read(_suite_file(file), config_directories())
    cases = {case.name: case for case in Builder().build(Suite, root).cases}
    for name in names:
        if name not in cases:
            raise SceneError(f'--cases {name}: no such case{suggestion(name, cases)}')
    return tuple(case for name, case in cases.items() if not names or name in names)


def _suite_file(file: str | Path) -> Path:
    """The file of a suite. Raises SceneError with the nearest name."""
    roots = config_directories()
    found = find(str(file), [Path(), *roots]) or find(f'{file}.yaml', roots)
    if found is None:
        known = {path.name for root in roots if root.name == 'config' for path in root.glob('*.yaml')} - {'node.yaml'}
        problem = 'is a directory, not a file' if Path(file).is_dir() else 'no such file, here or in config'
        raise SceneError(f'--suite {str(file)!r}: {problem}{suggestion(str(file), known)}')
    return found


def run(
    cases: Sequence[BenchmarkCase], *, quick: bool = False, say: Callable[[str], None] = lambda _: None
) -> dict[str, Any]:
    """Measure all cases in one run on one core and return the report (see docs/performance.md for what the figures
    are).

    The cases take turns, round by round, so that all share the good and the bad minutes of the machine. A case whose
    scene cannot be loaded or simulated, or whose packages are missing, is 'unavailable' with the reason. say: receives
    progress lines.
    """
    rounds = QUICK_ROUNDS if quick else ROUNDS
    machine = fingerprint()
    reports = [{**asdict(case), 'status': 'ok', 'reason': ''} for case in cases]
    measurements: dict[str, Measurement] = {}

    def attempt(report: dict[str, Any], action: Callable[[], None]) -> None:
        try:
            action()
        except (MbdError, ImportError) as error:
            measurements.pop(report['name'], None)
            report |= {'status': 'unavailable', 'reason': ' '.join(str(error).split())}

    def prepare(case: BenchmarkCase) -> None:
        measurement = MEASURES[case.measure].make(case, quick)
        resources.callback(measurement.close)
        measurements[case.name] = measurement

    with on_one_core() as core, ExitStack() as resources:
        for case, report in zip(cases, reports, strict=True):
            say(f'preparing {case.name}')
            attempt(report, lambda case=case: prepare(case))  # type: ignore[misc]
        watch = Watch(core)
        for k in range(rounds):
            for case, report in zip(cases, reports, strict=True):
                measurement = measurements.get(case.name)
                if measurement is None or (k and MEASURES[case.measure].once):
                    continue
                say(f'round {k + 1} of {rounds}: {case.name}')
                steps = _steps(case.measure, quick)
                attempt(report, lambda m=measurement, n=steps: m.round(n))  # type: ignore[misc]
        disturbance = watch.read()
    for report in reports:
        if report['name'] in measurements:
            report |= measurements[report['name']].figures()
        report['targets'] = [
            {'figure': figure, 'limit': limit, 'value': value, 'met': None if value is None else bool(value <= limit)}
            for figure, limit in report['targets'].items()
            for value in [report.get('figures', {}).get(figure)]
        ]
    return {
        'rounds': rounds,
        'core': core,
        'machine': machine,
        'disturbance': disturbance,
        'warnings': warnings(machine, disturbance),
        'cases': reports,
        'growth': growth.exponents(
            [report for report in reports if report['measure'] == 'growth' and report['status'] == 'ok']
        ),
    }


def warnings(machine: dict[str, Any], disturbance: dict[str, float]) -> list[str]:
    """Sentences about why the figures may be too high."""
    found = []
    if machine['load_average'] > 0.25 * machine['cores']:
        found.append(
            f'the machine was busy before the run: load average {machine["load_average"]:.2f} on {machine["cores"]} '
            'cores'
        )
    if disturbance['waited'] > 0.02:
        found.append(
            f'the measuring thread waited for its core {disturbance["waited"]:.1%} of the time: other processes ran on '
            'it'
        )
    if disturbance['stolen'] > 0.01:
        found.append(f'the hypervisor took {disturbance["stolen"]:.1%} of the core')
    return found
