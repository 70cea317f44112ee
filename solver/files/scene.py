"""Scene files: finds them by path or name, and makes a Scene of their YAML text. Format: docs/scene.md."""

from __future__ import annotations

import dataclasses
import math
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from solver.dimensions import BOUND_ROUNDING, LOCK
from solver.elements.road import RoadSpec
from solver.elements.road_grids import RandomRoad
from solver.errors import SceneError, SpecError, suggestion
from solver.files import requirements
from solver.files.mechanism import MechanismReader
from solver.files.naming import names_file
from solver.files.overrides import override
from solver.files.schema import Builder, Fields
from solver.files.search_path import config_directories
from solver.files.vehicle import TEMPLATES, build_vehicle
from solver.files.yaml_tree import MappingNode, Node, ScalarNode, content_of, include, parse, read, text_of, where
from solver.inputs.actuation import Actuation
from solver.inputs.maneuver import Maneuver
from solver.inputs.signals import signal
from solver.model.spec import ModelSpec
from solver.scene import SAMPLES, Bound, Require, Scene, coordinates_of
from solver.vehicle.actuation import IN_DEGREES, actuated, steering_reaches


def find_file(name: str | Path, folder: str) -> Path:
    """The file of a path, or of a name in config/<folder>. Raises SceneError that suggests the nearest known name."""
    path = Path(name)
    if path.is_file():
        return path
    roots = config_directories()
    stem = path.name.removesuffix('.yaml')
    for root in roots:
        for candidate in (root / path, root / folder / f'{path.as_posix().removesuffix(".yaml")}.yaml'):
            if candidate.is_file():
                return candidate
    known = known_names(folder)
    other = 'a directory' if path.is_dir() else 'a pipe or a device' if path.exists() else ''
    problem = f'is {other}, not a file' if other else 'no such file'
    if not str(name):  # Path('') would be the current directory
        raise SceneError(f'{folder.removesuffix("s")}: its name is empty{suggestion("", known)}')
    beside = path.with_suffix('.yaml') if path.suffix else None
    if folder == 'scenes' and stem in known_names('vehicles'):
        raise SceneError(
            f'scene {str(name)!r}: is a vehicle; put it into a scene by --set vehicle=vehicles/{stem}.yaml '
            '(in a node: the parameter overrides)'
        )
    remedy = f'; did you mean {str(beside)!r}?' if beside is not None and beside.is_file() else suggestion(stem, known)
    raise SceneError(f'{folder.removesuffix("s")} {str(name)!r}: {problem}, and no name in config/{folder}{remedy}')


def known_names(folder: str = 'scenes') -> list[str]:
    """Names of the files in config/<folder> of all config directories, sorted."""
    return sorted({file.stem for root in config_directories() for file in (root / folder).glob('*.yaml')})


def load_scene(name: str | Path, overrides: Sequence[str] = ()) -> Scene:
    """Load a scene by path or name. overrides: 'a.b.c=value' assignments. Raises SceneError (one sentence: place,
    value, remedy)."""
    file = find_file(name, 'scenes')
    return _scene(read(file, config_directories()), file.stem, overrides)[0]


def load_scene_text(text: str, name: str = 'scene', overrides: Sequence[str] = ()) -> Scene:
    """Load a scene from YAML text, e.g. the resolved text in a recording; `name` is what error sentences call it."""
    return load_scene_and_units(text, name, overrides)[0]


def load_scene_and_units(text: str, name: str = 'scene', overrides: Sequence[str] = ()) -> tuple[Scene, dict[str, str]]:
    """(the scene as of load_scene_text(), path of a key -> unit in which its value is written, e.g. 'deg' of
    toe_deg)."""
    return _scene(include(parse(text, name), config_directories()), name, overrides)


def load_maneuver(name: str | Path, overrides: Sequence[str] = ()) -> Maneuver:
    """Load a maneuver by path or name. Raises SceneError."""
    file = find_file(name, 'maneuvers')
    root = read(file, config_directories())
    _apply(root, overrides)
    return Builder().build(Maneuver, root)


def _apply(root: Node, overrides: Sequence[str]) -> None:
    """Apply overrides to a tree, in place and in their order."""
    for assignment in overrides:
        override(root, assignment, config_directories())


def _scene(root: Node, name: str, overrides: Sequence[str]) -> tuple[Scene, dict[str, str]]:
    """(the scene of a tree with overrides, path of a key -> unit)."""
    _apply(root, overrides)
    builder = MechanismReader().builder()
    builder.hooks |= {Require: requirements.require, Bound: requirements.bound}
    fields = builder.mapping(root, '')
    if 'name' not in fields:
        assert isinstance(root, MappingNode)
        node = ScalarNode('tag:yaml.org,2002:str', name, root.start_mark, root.end_mark)
        # a name like tire.yaml gets quotes: without them the resolved text would include the file of that name
        node.style = "'" if names_file(node) else None
        root.value.insert(0, (ScalarNode(node.tag, 'name', root.start_mark, root.end_mark), node))
        fields = builder.mapping(root, '')
    model = _model_known(builder, fields, root)
    given = {'model': model, 'resolved': text_of(root)}
    scene = builder.construct(Scene, fields, root, '', given=given, extra=MODEL_KEYS)
    _require_angles(scene, fields)
    if scene.seed:
        scene = dataclasses.replace(scene, model=_seeded(scene.model, scene.seed))
    beside = {
        key.removeprefix('vehicle.'): unit for key, unit in builder.units.items() if key.startswith('vehicle.trailer.')
    }
    return scene, builder.units | beside  # a trailer may stand beside the vehicle


def _require_angles(scene: Scene, fields: Fields) -> None:
    """Raise SceneError for an angle that seems to be in degrees: of the steering at any instant, of a joint at the
    start.

    These numbers have the unit of their input or coordinate, so that the type hints cannot check them.
    """
    t = np.linspace(0.0, scene.duration, SAMPLES)
    for name, reach in steering_reaches(scene.model).items():
        worst = reach.beyond(signal(getattr(scene.maneuver, name)).jet(t).value)
        if worst is not None:
            node = next(value for key, value in fields['maneuver'][1].value if key.value == name)
            raise SceneError(f'{where(node)}: maneuver.{name} = {worst:g}: {reach.remedy}')
    model = scene.model
    turning = {c.name for c in coordinates_of(model) if c.kind == 'rotation'}
    if not model.tires:  # of a mechanism, a spring or a gear may be wound by any number of turns
        turning -= {
            name for one in (*model.couplers, *model.coordinate_forces, *model.transmissions) for name, _ in one.terms
        }
    most, what = (LOCK, '20 rad') if model.tires else (2.0 * math.pi, 'one turn')  # a steering wheel may start turned
    for name, wanted in scene.start.coordinates.items():
        if name in turning and abs(wanted.value or 0.0) > most * (1.0 + BOUND_ROUNDING):
            text = f'is too large in rad for an angle at the start ({what} at most); {IN_DEGREES}'
            raise SceneError(f'{where(fields["start"][1])}: start.coordinates.{name}.value = {wanted.value:g}: {text}')


def _seeded(model: ModelSpec, seed: int) -> ModelSpec:
    """The model with other random roads: `seed` is added to their seeds."""
    grids = tuple(
        dataclasses.replace(grid, seed=grid.seed + seed) if isinstance(grid, RandomRoad) else grid
        for grid in model.road.grids
    )
    return dataclasses.replace(model, road=dataclasses.replace(model.road, grids=grids))


_models: OrderedDict[tuple, tuple[ModelSpec, dict[str, str]]] = OrderedDict()
MOST_MODELS = 4  # that a process remembers; ten times as many hold 20 MB, and no sweep changes so many by turns


def _model_known(builder: Builder, fields: dict, root: Node) -> ModelSpec:
    """As _model(): the same object for a scene that says the same of it, so that levels and starts know it again."""
    used = [(key, fields[key][1]) for key in (*MODEL_KEYS, 'actuation') if key in fields]
    content = tuple((key, content_of(node)) for key, node in used)
    if any(one is None for _, one in content):
        return _model(builder, fields, root)
    if content in _models:
        _models.move_to_end(content)
        model, units = _models[content]
        builder.units |= units
        for key in MODEL_KEYS:
            fields.pop(key, None)
        return model
    before = set(builder.units)
    model = _model(builder, fields, root)
    _models[content] = model, {key: unit for key, unit in builder.units.items() if key not in before}
    while len(_models) > MOST_MODELS:
        _models.popitem(last=False)
    return model


MODEL_KEYS = ('mechanism', 'vehicle', 'trailer', 'road')  # keys of a scene that make its model


def _model(builder: Builder, fields: dict, root: Node) -> ModelSpec:
    """The model of a scene, from its keys mechanism or vehicle, trailer, actuation and road. Removes MODEL_KEYS from
    fields."""
    sources = [key for key in ('mechanism', 'vehicle') if key in fields]
    if len(sources) != 1:
        kind = fields['kind'][1].value if 'kind' in fields else ''
        remedy = '; this is a vehicle: put it into a scene by --set vehicle=FILE' if kind in list(TEMPLATES) else ''
        raise SceneError(
            f"{where(root)}: a scene needs exactly one of the keys 'mechanism' and 'vehicle', here are "
            f'{len(sources)}{remedy}'
        )
    key = sources[0]
    node = fields.pop(key)[1]
    if 'trailer' in fields:
        node = _with_trailer(builder, node, key, *fields.pop('trailer'))
    model = build_vehicle(builder, node, key) if key == 'vehicle' else builder.build(ModelSpec, node, key)
    if 'actuation' in fields:
        node = fields['actuation'][1]
        try:
            model = actuated(model, builder.build(Actuation, node, 'actuation'))
        except SpecError as error:
            raise SceneError(f'{where(node)}: {error}') from None
    if 'road' in fields:
        model = dataclasses.replace(model, road=builder.build(RoadSpec, fields.pop('road')[1], 'road'))
    return model


def _with_trailer(builder: Builder, node: Node, key: str, name: Node, trailer: Node) -> Node:
    """The node of a vehicle, with the key `trailer` of the scene moved into it. Raises SceneError if the vehicle has
    its own."""
    if key != 'vehicle':
        raise SceneError(f"{where(name)}: trailer: only a vehicle pulls one; remove it, or take the key 'vehicle'")
    own = builder.mapping(node, key).get('trailer')
    if own is None:
        return MappingNode(node.tag, [*node.value, (name, trailer)], node.start_mark, node.end_mark)
    if not isinstance(own[1], MappingNode) and not isinstance(trailer, MappingNode):
        return node  # both say that there is none
    if not isinstance(own[1], MappingNode):
        clash = 'the vehicle says that it has none (vehicle.trailer: null), and the scene gives one'
    else:
        given = 'another one' if isinstance(trailer, MappingNode) else 'none'
        clash = f'the vehicle has one ({where(own[1])}), and the scene gives {given}'
    remedy = 'remove one of the two keys, or give both as null for none'
    raise SceneError(f'{where(name)}: trailer: {clash}; {remedy}')
