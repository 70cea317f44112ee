"""The file of a sweep, and the cases it asks for.

scene: light_car_step_steer
set: [duration=3.0]                                  # for every case
parameters:                                          # keys of the scene, as for --set
  vehicle.chassis.mass: {low: 1000, high: 1400}
  integrator.h: {values: [0.001, 0.002]}
  maneuver: {values: [maneuvers/step_steer.yaml, maneuvers/brake.yaml]}
design: {kind: latin_hypercube, samples: 64, seed: 1}
figures:                                             # what is kept of a run
  yaw_rate_peak: {quantity: yaw_rate, take: peak}
  response: {evaluation: iso7401_step, figure: yaw_rate_response_time}
  understeer: {info: understeer_gradient}
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mbd_sim_ros.analysis.evaluation.registry import called
from mbd_sim_ros.analysis.vehicle_figures import unit_of
from solver.errors import SceneError, SpecError
from solver.files.naming import find, names_file
from solver.files.overrides import keys_of, overtaken
from solver.files.scene import config_directories, find_file
from solver.files.schema import Builder
from solver.files.yaml_tree import MappingNode, Node, SequenceNode, bare, displayed, include, parse, read_text
from solver.output.snapshot import Channels
from solver.quantities import quantity
from solver.validate import finite, require

TAKES = ('peak', 'rms', 'min', 'max', 'mean', 'final', 'peak_time')
SENSITIVITY = ('morris', 'saltelli')  # designs from which indices of sensitivity follow
MOST_CASES = 1_000_000
ERRORS, UNITS = 'errors', 'units'  # what rows hold beside the columns of the table


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """Values that one key of the scene takes: those of a list, or numbers from low to high (in a grid so many, ends
    included)."""

    values: tuple[float | str, ...] = ()
    low: float | None = None
    high: float | None = None
    steps: int = 5

    def __post_init__(self) -> None:
        ranged = self.low is not None and self.high is not None
        one_kind = ranged if not self.values else self.low is None and self.high is None
        require(one_kind, 'sweep', 'parameters', self.values or (self.low, self.high), 'give values, or low and high')
        require(not ranged or self.low < self.high, 'sweep', 'low', self.low, f'must be below high = {self.high}')  # type: ignore[operator]
        finite('sweep', 'steps', self.steps, low=2)

    @property
    def ranged(self) -> bool:
        """True where it is a range of numbers."""
        return not self.values

    def at(self, share: float) -> float | str:
        """The value at a share of the range or list, 0 to 1."""
        if self.ranged:
            assert self.low is not None
            assert self.high is not None
            return float(self.low + share * (self.high - self.low))
        return self.values[min(int(share * len(self.values)), len(self.values) - 1)]

    @property
    def grid(self) -> list[float | str]:
        """Its values in a grid."""
        return (
            [self.at(share) for share in np.linspace(0.0, 1.0, self.steps).tolist()]
            if self.ranged
            else list(self.values)
        )


@dataclass(frozen=True, kw_only=True)
class Design:
    """Which cases. kind: 'grid' is every combination; the others take `samples` of the space: 'latin_hypercube',
    'sobol' (a power of two), and for indices of sensitivity 'morris' (as many trajectories) and 'saltelli' (a base of
    as many; [Herman2017]). 'samples' are those of a table, `file`: a header of keys of the scene, and a case a row, as
    mbd fit writes its distribution."""

    kind: Literal['grid', 'latin_hypercube', 'sobol', 'morris', 'saltelli', 'samples'] = 'grid'
    samples: int = 16
    seed: int = 0
    file: str = ''

    def __post_init__(self) -> None:
        finite('sweep', 'samples', self.samples, low=1, high=MOST_CASES)
        # that all samplers take
        require(0 <= self.seed < 2**32, 'sweep', 'seed', self.seed, 'must be a whole number from 0 to 4294967295')
        one = self.kind == 'morris' and self.samples == 1
        require(not one, 'sweep', 'samples', self.samples, 'must be 2 at least: sigma is the spread of trajectories')
        tabled = self.kind == 'samples'
        require(
            tabled == bool(self.file), 'sweep', 'file', self.file, 'goes with a design of kind samples, and only there'
        )
        power = self.samples & (self.samples - 1) == 0
        require(
            self.kind not in ('sobol', 'saltelli') or power, 'sweep', 'samples', self.samples, 'must be a power of two'
        )

    @property
    def text(self) -> str:
        """Kind of the design with what it depends on, for people."""
        if self.kind == 'samples':
            return f'rows of {self.file}'
        if self.kind == 'grid':
            return 'grid, every combination'
        return f'{self.kind}, samples {self.samples}, seed {self.seed}'


@dataclass(frozen=True, kw_only=True)
class SweepFigure:
    """A number kept of a case, one of three kinds.

    quantity, take: of a quantity of interest (docs/scene.md) or a recorded channel of the run; peak: the largest
    absolute value. figure: name of a figure (docs/evaluating.md) of `evaluation`, or without one of the evaluation that
    the maneuver of the scene states; SI units. info: name of a figure of the vehicle in `mbd info`; SI units.
    """

    quantity: str = ''
    take: Literal['peak', 'rms', 'min', 'max', 'mean', 'final', 'peak_time'] = 'peak'
    evaluation: str = ''
    figure: str = ''
    info: str = ''

    def __post_init__(self) -> None:
        whole = bool(self.figure) or not self.evaluation
        require(whole, 'sweep', 'evaluation', self.evaluation, 'needs the name of a figure')
        given = [name for name in ('quantity', 'figure', 'info') if getattr(self, name)]
        remedy = 'give one of quantity (of the run), figure (of an evaluation) or info (of the vehicle)'
        require(len(given) == 1, 'sweep', 'figures', given, remedy)

    @property
    def text(self) -> str:
        """Its origin, for people."""
        if self.info:
            return f'{self.info} of the vehicle'
        if self.figure:
            return f'{self.figure} of {self.evaluation or "the maneuver"}'
        return f'{self.take} of {self.quantity}'


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """A sweep. set: KEY=VALUE for every case. record: keep the bag of every case. errors: whose numerical error is
    measured, by a twin with another step: of a `sample` of the cases, evenly over the design, `all`, whose errors
    decide their status then, or `none`."""

    scene: str
    figures: dict[str, SweepFigure]
    parameters: dict[str, Parameter] = field(default_factory=dict)
    set: tuple[str, ...] = ()
    design: Design = field(default_factory=Design)
    record: bool = False
    errors: Literal['sample', 'all', 'none'] = 'sample'

    def __post_init__(self) -> None:
        named = bool(self.parameters) or self.design.kind == 'samples'
        require(named, 'sweep', 'parameters', {}, 'must name at least one key of the scene')
        require(bool(self.figures), 'sweep', 'figures', {}, 'must name at least one number to keep')
        taken = {'case', 'bag', 'status', 'message', ERRORS, UNITS, *self.parameters} & self.figures.keys()
        require(not taken, 'sweep', 'figures', sorted(taken), 'is another column of the table; take another name')
        places: dict[tuple[str, ...], str] = {}
        for name in self.parameters:
            *above, last = keys_of(name) or ('',)
            other = places.setdefault((*above, bare(last)), name)
            require(other is name, 'sweep', 'parameters', name, f'is the same key as {other}; keep one of them')
            if (lost := overtaken([*self.set, name])) is not None:
                require(
                    False,
                    'sweep',
                    'set',
                    lost[0],
                    f'has no effect, because the parameter {lost[1]} replaces all around it; make it a parameter too',
                )
        if self.design.kind in SENSITIVITY:
            for name, parameter in self.parameters.items():
                require(
                    parameter.ranged,
                    'sweep',
                    name,
                    parameter.values,
                    f'a design of kind {self.design.kind} needs low and high',
                )

    @property
    def fewest(self) -> int:
        """Least number of cases: all of a grid, the samples of a design."""
        if self.design.kind == 'samples':
            return len(next(iter(self.parameters.values())).values)
        if self.design.kind != 'grid':
            return self.design.samples
        return math.prod(
            parameter.steps if parameter.ranged else len(parameter.values) for parameter in self.parameters.values()
        )


def load_sweep(file: str | Path) -> Sweep:
    """Read the file of a sweep; a file as `scene` is looked up beside it first. Raises SceneError (file, line,
    remedy)."""
    path = Path(file)
    if not path.is_file():
        path = find_file(file, 'sweeps')
    root = parse(read_text(path), displayed(path))
    _keep_names(root)
    beside = [path.parent, path.parent.parent]
    sweep = Builder().build(Sweep, include(root, [*beside, *config_directories()]))
    if sweep.design.kind == 'samples':
        sweep = _tabled(sweep, beside)
    scene = find(sweep.scene, beside)
    return sweep if scene is None else replace(sweep, scene=displayed(scene))


def _tabled(sweep: Sweep, directories: Sequence[Path]) -> Sweep:
    """The sweep with the parameters of its table. Raises SceneError."""
    name = sweep.design.file
    place = find(name, directories) or Path(name)
    lines = [(k, line) for k, line in enumerate(read_text(place).splitlines(), 1) if line.strip()]
    if sweep.parameters:
        raise SceneError(f'sweep: parameters: those of {name} are in its header; remove them, or the table')
    if len(lines) < 2:
        raise SceneError(f'{place}: a table of samples needs a header of keys, and rows')
    head = lines[0][0]
    names = [name.strip() for name in lines[0][1].split(',')]
    if '' in names:
        raise SceneError(f'{place}:{head}: column {names.index("") + 1} of the header has no key')
    rows = []
    for k, line in lines[1:]:
        cells = line.split(',')
        try:
            row = [float(cell) for cell in cells]
        except ValueError:
            row = [math.nan]
        if not all(map(math.isfinite, row)):
            raise SceneError(f'{place}:{k}: {line.strip()[:60]!r}: every cell must be a finite number')
        if len(row) != len(names):
            raise SceneError(f'{place}:{k}: {len(row)} cells, but the header has {len(names)}')
        rows.append(row)
    if len(set(names)) < len(names):
        raise SceneError(f'{place}:{head}: a key stands twice in the header')
    columns = zip(*rows, strict=True)
    return replace(sweep, parameters={n: Parameter(values=tuple(c)) for n, c in zip(names, columns, strict=True)})


def _keep_names(root: Node) -> None:
    """Names of files that are values of a sweep (its scene, what parameters take) stay text: what reads the scene
    includes them."""
    if not isinstance(root, MappingNode):
        return
    entries = {key.value: value for key, value in root.value}
    parameters = entries.get('parameters')
    described = [value for _, value in parameters.value] if isinstance(parameters, MappingNode) else []
    taken = [
        value for one in described if isinstance(one, MappingNode) for key, value in one.value if key.value == 'values'
    ]
    texts = [item for value in taken if isinstance(value, SequenceNode) for item in value.value]
    design = entries.get('design')
    if isinstance(design, MappingNode):
        texts += [value for key, value in design.value if key.value == 'file']
    for node in (entries.get('scene'), *texts):
        if node is not None and names_file(node):
            node.style = "'"


def cases(sweep: Sweep) -> list[dict[str, float | str]]:
    """The values of all parameters, case by case. Raises SceneError for too many, SpecError without SALib where it is
    needed."""
    names, parameters = list(sweep.parameters), list(sweep.parameters.values())
    design = sweep.design
    if design.kind == 'samples':
        if sweep.fewest > MOST_CASES:
            raise SceneError(f'sweep: the table has {sweep.fewest} rows, more than {MOST_CASES}; take fewer')
        return [dict(zip(names, row, strict=True)) for row in zip(*(p.values for p in parameters), strict=True)]
    if design.kind == 'grid':
        if sweep.fewest > MOST_CASES:
            raise SceneError(
                f'sweep: the grid has {sweep.fewest} cases, more than {MOST_CASES}; take fewer values or design.kind: '
                'sobol'
            )
        grids = [parameter.grid for parameter in parameters]
        return [dict(zip(names, values, strict=True)) for values in itertools.product(*grids)]
    if design.kind in SENSITIVITY:
        table = np.asarray(_salib(sweep)(problem(sweep)))
        return [dict(zip(names, row, strict=True)) for row in table.tolist()]
    from scipy.stats import qmc  # half a second, which no worker needs

    sampler = qmc.LatinHypercube if design.kind == 'latin_hypercube' else qmc.Sobol
    shares = sampler(len(names), seed=design.seed).random(design.samples)
    return [{n: p.at(share) for n, p, share in zip(names, parameters, row, strict=True)} for row in shares.tolist()]


def problem(sweep: Sweep) -> dict[str, Any]:
    """The parameters as SALib wants them."""
    bounds = [[parameter.low, parameter.high] for parameter in sweep.parameters.values()]
    return {'num_vars': len(bounds), 'names': list(sweep.parameters), 'bounds': bounds}


def _salib(sweep: Sweep) -> Any:
    try:
        from SALib.sample import morris, sobol
    except ImportError:
        raise SpecError(
            f"sweep: design.kind = {sweep.design.kind!r} needs SALib: pip install 'mbd_sim_ros[sweep]'"
        ) from None
    n, seed = sweep.design.samples, sweep.design.seed
    if sweep.design.kind == 'morris':
        return lambda asked: morris.sample(asked, n, seed=seed)
    return lambda asked: sobol.sample(asked, n, calc_second_order=False, seed=seed)


def units_of(sweep: Sweep, channels: Channels, keys: Mapping[str, str]) -> dict[str, str]:
    """Units of parameters and figures, where they have one; those of evaluations come with the rows. keys: units of the
    keys of the scene. Raises SceneError for a quantity that the scene does not have, an evaluation or a figure of the
    vehicle that nobody has."""
    # of a list it is said once
    of = {name: keys.get(name) or keys.get(re.sub(r'(\[\d+\])+$', '', name)) for name in sweep.parameters}
    units = {name: unit for name, unit in of.items() if unit}
    for name, figure in sweep.figures.items():
        part = 'info' if figure.info else 'evaluation' if figure.figure else 'quantity'
        try:
            if figure.info:
                units[name] = unit_of(figure.info)
            elif figure.evaluation:
                require(
                    len(called(figure.evaluation)) == 1, 'sweep', part, figure.evaluation, _which(figure.evaluation)
                )
            elif figure.quantity:
                units[name] = 's' if figure.take == 'peak_time' else quantity(figure.quantity, channels).unit
        except SpecError as error:
            raise SceneError(f'sweep: figures.{name}.{part}: {error}') from None
    return units


def _which(norm: str) -> str:
    return f'is a norm of several maneuvers; take one of {", ".join(one.name for one in called(norm))}'
