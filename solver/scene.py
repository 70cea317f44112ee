"""Scenes: what is simulated, how it starts, what drives it, how it is integrated, recorded and judged. Format: docs/scene.md."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from solver.elements.marker import finite, require
from solver.elements.road import RoadSpec
from solver.errors import SceneError, suggestion
from solver.integrators.settings import IntegratorSettings
from solver.load import Builder
from solver.maneuver import Maneuver, base_names
from solver.mechanism import MechanismReader
from solver.model.compile import joint_coordinates
from solver.model.spec import ModelSpec
from solver.nodes import READERS, MappingNode, Node, ScalarNode, include, override, parse, read, text_of, where
from solver.vehicle.load import build_vehicle
from solver.vehicle.tir import read_tir

PACKAGE = 'mbd_sim_ros'
READERS['.tir'] = read_tir


@dataclass(frozen=True, kw_only=True)
class CoordinateStart:
    """Initial value [rad or m] and rate [rad/s or m/s] wanted of one joint coordinate; None leaves it to the assembly."""

    value: float | None = None
    rate: float | None = None


@dataclass(frozen=True, kw_only=True)
class Start:
    """The state at t = 0.

    kind: 'as_placed' takes the placement in the file, which must satisfy the joints; 'assemble' moves the bodies as little as
    possible until it does; 'equilibrium' seeks static equilibrium under gravity (a vehicle whose brakes are all released is held along
    the x axis of its chassis meanwhile, and rolls away from a slope at t = 0). Velocities are made to fit in every case.
    speed: along the x axis of the chassis [m/s], rolling wheels included. coordinates: joint coordinates that are wanted.
    """

    kind: Literal['as_placed', 'assemble', 'equilibrium'] = 'as_placed'
    speed: Annotated[float, 'm/s'] = 0.0
    coordinates: dict[str, CoordinateStart] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Record:
    """What a recording holds besides the standard topics.

    every: one message set per so many steps. elements: force element columns. reactions: constraint forces of all rows.
    branches: look at every step whether the mechanism leaves a singular position on another branch than it came in on (slow: a dense
    decomposition of all constraints); the run reports `branch_switches`.
    """

    every: int = 1
    elements: bool = True
    reactions: bool = False
    branches: bool = False

    def __post_init__(self) -> None:
        finite('record', 'every', self.every, low=1)


@dataclass(frozen=True, kw_only=True)
class Require:
    """Limits a run must keep; it fails otherwise. None: not judged. branch_switches_max looks for them as record.branches does."""

    energy_error_max: Annotated[float | None, 'J'] = None
    position_drift_max: Annotated[float | None, 'm or rad'] = None
    velocity_drift_max: Annotated[float | None, 'm/s or rad/s'] = None
    real_time_factor_min: float | None = None
    branch_switches_max: int | None = None

    def violations(self, result: dict[str, float]) -> list[str]:
        """One sentence per limit that a run's figures (by the names without _min, or with _max) do not keep."""
        found = []
        for f in dataclasses.fields(self):
            limit, minimum = getattr(self, f.name), f.name.endswith('_min')
            value = result.get(f.name.removesuffix('_min') if minimum else f.name)
            if limit is None or value is None:
                continue
            if not (value >= limit if minimum else value <= limit):
                found.append(f'{f.name}: {value:.6g} is {"below" if minimum else "above"} the limit {limit:g}')
        return found


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A complete simulation task.

    name, title: for people. model: the mechanism or vehicle on its road. duration: simulated time [s]. seed: of everything random.
    resolved: the scene as YAML text with every include and override expanded; load_scene_text() of it gives the same scene ('' for a
    scene made in Python).
    """

    name: str
    model: ModelSpec
    title: str = ''
    start: Start = Start()
    maneuver: Maneuver = field(default_factory=Maneuver)
    integrator: IntegratorSettings = field(default_factory=IntegratorSettings)
    duration: Annotated[float, 's'] = 10.0
    record: Record = Record()
    require: Require = Require()
    seed: int = 0
    resolved: str = field(default='', repr=False, compare=False)

    def __post_init__(self) -> None:
        where_ = f'scene {self.name!r}'
        finite(where_, 'duration', self.duration, low=0.0, strict=True)
        known = [c.name for joint in self.model.joints for c in joint_coordinates(joint)] + [c.name for c in self.model.coordinates]
        for name in (n for n in self.start.coordinates if n not in known):
            require(False, where_, 'start.coordinates', name, 'no such coordinate' + suggestion(name, known))
        names = base_names(self.model.inputs)
        for name in (n for n in self.maneuver.channels if n not in names):
            require(False, where_, 'maneuver', name, 'the model has no such input' + suggestion(name, names))

    @property
    def steps(self) -> int:
        """Number of steps of the whole duration."""
        return round(self.duration * 1e9 / self.integrator.h_ns)

    @property
    def hash(self) -> str:
        """Short hash of the resolved text."""
        return hashlib.sha256(self.resolved.encode()).hexdigest()[:16]


def config_directories() -> list[Path]:
    """Where scene names and includes are looked up: the current directory, this checkout, installed share directories."""
    prefixes = [*filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)), sys.prefix]
    candidates = [
        Path.cwd() / 'config',
        Path.cwd(),
        Path(__file__).resolve().parent.parent / 'config',
        *(Path(prefix) / 'share' / PACKAGE / 'config' for prefix in prefixes),
    ]
    return [directory for directory in dict.fromkeys(candidates) if directory.is_dir()]


def find_file(name: str | Path, folder: str) -> Path:
    """The file that a path, or a name under <config>/<folder>, stands for. Raises SceneError with the nearest known name."""
    path = Path(name)
    if path.is_file():
        return path
    roots = config_directories()
    stem = path.name.removesuffix('.yaml')
    for root in roots:
        for candidate in (root / path, root / folder / f'{path.as_posix().removesuffix(".yaml")}.yaml'):
            if candidate.is_file():
                return candidate
    what = 'directory' if path.is_dir() else 'file'
    known = known_names(folder)
    problem = 'is a directory, not a file' if what == 'directory' else 'no such file'
    raise SceneError(f'{folder.removesuffix("s")} {str(name)!r}: {problem}, and no name in config/{folder}{suggestion(stem, known)}')


def known_names(folder: str = 'scenes') -> list[str]:
    """Names of the files in <config>/<folder> of every config directory."""
    return sorted({file.stem for root in config_directories() for file in (root / folder).glob('*.yaml')})


def load_scene(name: str | Path, overrides: Sequence[str] = ()) -> Scene:
    """Load a scene by path or name. overrides: 'a.b.c=value' assignments. Raises SceneError (one sentence: place, value, remedy)."""
    file = find_file(name, 'scenes')
    return _scene(read(file, config_directories()), file.stem, overrides)


def load_scene_text(text: str, name: str = 'scene', overrides: Sequence[str] = ()) -> Scene:
    """Load a scene from YAML text, e.g. the resolved text in a recording; `name` is what error sentences call it."""
    directories = config_directories()
    return _scene(include(parse(text, name), directories), name, overrides)


def load_maneuver(name: str | Path, overrides: Sequence[str] = ()) -> Maneuver:
    """Load a maneuver by path or name. Raises SceneError."""
    file = find_file(name, 'maneuvers')
    root = read(file, config_directories())
    _apply(root, overrides)
    return Builder().build(Maneuver, root)


def _apply(root: Node, overrides: Sequence[str]) -> None:
    for assignment in overrides:
        override(root, assignment, config_directories())


def _scene(root: Node, name: str, overrides: Sequence[str]) -> Scene:
    _apply(root, overrides)
    builder = MechanismReader().builder()
    fields = builder.mapping(root, '')
    if 'name' not in fields:
        assert isinstance(root, MappingNode)
        node = ScalarNode('tag:yaml.org,2002:str', name, root.start_mark, root.end_mark)
        root.value.insert(0, (ScalarNode(node.tag, 'name', root.start_mark, root.end_mark), node))
        fields = builder.mapping(root, '')
    model = _model(builder, fields, root)
    given = {'model': model, 'resolved': text_of(root)}
    return builder.construct(Scene, fields, root, '', given=given, extra=MODEL_KEYS)


MODEL_KEYS = ('mechanism', 'vehicle', 'road')


def _model(builder: Builder, fields: dict, root: Node) -> ModelSpec:
    """The model from the keys mechanism or vehicle, on the road of the scene; takes them out of fields."""
    sources = [key for key in ('mechanism', 'vehicle') if key in fields]
    if len(sources) != 1:
        raise SceneError(f"{where(root)}: a scene needs exactly one of the keys 'mechanism' and 'vehicle', here are {len(sources)}")
    key = sources[0]
    node = fields.pop(key)[1]
    model = build_vehicle(builder, node, key) if key == 'vehicle' else builder.build(ModelSpec, node, key)
    if 'road' in fields:
        model = dataclasses.replace(model, road=builder.build(RoadSpec, fields.pop('road')[1], 'road'))
    return model
