"""The JSON Schemas take what the loader takes, and refuse the keys, forms and choices that it refuses."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from textwrap import indent
from typing import Any

import numpy as np
import pytest

from mbd_sim_ros.commands.main import main
from solver.elements.road import RoadSpec
from solver.errors import SceneError, SpecError
from solver.files.json_schema import DRAFT, KINDS, files, schema_of
from solver.files.mechanism import MechanismReader
from solver.files.scene import config_directories, load_scene_text
from solver.files.schema import is_number
from solver.files.vehicle import build_vehicle
from solver.files.yaml_tree import MappingNode, Node, ScalarNode, SequenceNode, include, parse, text_of
from solver.inputs.maneuver import Maneuver
from solver.vehicle.trailer import Trailer

jsonschema = pytest.importorskip('jsonschema', reason='comes with the extra test')

ROOT = Path(__file__).parents[2]
DELIVERED = [
    (kind, file) for kind, (_, folder) in KINDS.items() for file in sorted((ROOT / 'config' / folder).glob('*.yaml'))
]
EXAMPLES = {  # file in docs/examples -> where it stands in a vehicle that changes another one
    'van.yaml': (),
    'power.yaml': ('engine', 'power'),
    'converter.yaml': ('engine', 'power', 'converter'),
    'steering_box.yaml': ('steering',),
    'drag_link_steering.yaml': ('steering',),
    'front_shaft.yaml': ('axles', 'front', 'drive'),
    'steered_live_axle.yaml': ('axles', 'front', 'suspension'),
}


def value(node: Node) -> Any:
    """What an editor sees: scalars as YAML 1.2 reads them."""
    if isinstance(node, MappingNode):
        return {key.value: value(one) for key, one in node.value}
    if isinstance(node, SequenceNode):
        return [value(one) for one in node.value]
    text = node.value
    if node.style is not None:
        return text
    if text in ('', '~', 'null'):
        return None
    if text in ('true', 'false'):
        return text == 'true'
    return json.loads(repr(float(text))) if is_number(text) else text


@cache
def validator(kind: str) -> Any:
    schema = schema_of(kind)
    jsonschema.Draft7Validator.check_schema(schema)
    return jsonschema.Draft7Validator(schema)


def takes(kind: str, text: str) -> bool:
    return validator(kind).is_valid(value(parse(text, 'file')))


def names(paths: list[tuple[str, Path]]) -> list[str]:
    return [f'{kind}-{file.stem}' for kind, file in paths]


@pytest.mark.parametrize(('kind', 'file'), DELIVERED, ids=names(DELIVERED))
def test_every_delivered_file_is_valid(kind: str, file: Path) -> None:
    """As it stands, with names of files in it; scenes and vehicles also with all that they include."""
    node = parse(file.read_text(encoding='utf-8'), file.name)
    errors = [
        f'{"/".join(map(str, e.absolute_path))}: {e.message[:200]}' for e in validator(kind).iter_errors(value(node))
    ]
    assert errors == []
    if kind == 'vehicle':
        assert validator(kind).is_valid(value(include(node, [file.parent.parent])))


@pytest.mark.parametrize('name', EXAMPLES)
def test_examples_of_the_documents_are_valid(name: str) -> None:
    """Where they stand; with a key that nothing has they are not."""
    content = value(parse((ROOT / 'docs' / 'examples' / name).read_text(encoding='utf-8'), name))
    for more, right in (({}, True), ({'unheard_of': 1}, False)):
        whole = {**content, **more}
        for key in reversed(EXAMPLES[name]):
            whole = {key: whole}
        assert validator('vehicle').is_valid({'<<': 'vehicles/pickup_awd.yaml', **whole}) == right


def mappings(node: Node, path: str = '') -> Iterator[tuple[str, MappingNode]]:
    """Every mapping in a file, with its path."""
    if isinstance(node, MappingNode):
        yield path, node
        for key, one in node.value:
            yield from mappings(one, f'{path}.{key.value}' if path else key.value)
    elif isinstance(node, SequenceNode):
        for k, one in enumerate(node.value):
            yield from mappings(one, f'{path}[{k}]')


HINTS = {'maneuver': Maneuver, 'road': RoadSpec, 'trailer': Trailer}


def refused(kind: str, text: str) -> str:
    """Why the loader refuses a text; '' where it takes it."""
    try:
        if kind in ('scene', 'mechanism'):
            load_scene_text(text if kind == 'scene' else 'mechanism:\n' + indent(text, '  '))
        elif kind in HINTS:
            MechanismReader().builder().build(HINTS[kind], include(parse(text, 'file'), config_directories()))
        else:
            build_vehicle(MechanismReader().builder(), include(parse(text, 'file'), config_directories()), 'vehicle')
    except (SceneError, SpecError) as error:
        return str(error)
    return ''


VEHICLES = [(kind, file) for kind, file in DELIVERED if kind == 'vehicle']
SCENES = [
    (kind, file)
    for kind, file in DELIVERED
    if kind == 'scene' and file.stem in ('car_split_mu_brake', 'slider_crank', 'car_lane_change')
]


@pytest.mark.slow
@pytest.mark.parametrize(('kind', 'file'), VEHICLES + SCENES, ids=names(VEHICLES + SCENES))
def test_an_unknown_key_is_refused_where_the_loader_refuses_it(kind: str, file: Path, rng: np.random.Generator) -> None:
    """A key that nothing has in mappings all over the file with its includes, one at a time: both refuse it, or both
    take it."""
    root = include(parse(file.read_text(encoding='utf-8'), file.name), config_directories())
    found = list(mappings(root))
    judged = 0
    for k in rng.permutation(len(found))[:10].tolist():
        path, node = found[k]
        entry = (ScalarNode('tag:yaml.org,2002:str', 'unheard_of'), ScalarNode('tag:yaml.org,2002:int', '1'))
        node.value.append(entry)
        says, taken = refused(kind, text_of(root)), validator(kind).is_valid(value(root))
        node.value.remove(entry)
        if 'unknown key' in says:
            judged += 1
            assert not taken, f'{path}: {says}'
        if not says:
            assert taken, f'{path}: the loader takes it'
    assert judged > 3


BODY = 'bodies: {a: {mass: 1, inertia: [1, 1, 1]}}\n'
CAR = '{kind: light_car, <<: vehicles/light_car.yaml'
GOOD = {
    'a number with an exponent': ('scene', 'mechanism: mechanisms/pendulum.yaml\nintegrator: {h: 1e-3}'),
    'a name that is a number': ('scene', 'name: 7\nmechanism: mechanisms/pendulum.yaml'),
    'a key with its unit': ('scene', 'vehicle: vehicles/light_car.yaml\nstart: {speed_kmh: 80}'),
    'a bound in its unit': ('vehicle', f'{CAR}, rear: {{wheel: {{toe_deg: 4.9}}}}}}'),
    'part of a part': ('scene', 'vehicle: {<<: vehicles/full_car.yaml, chassis: {mass: 1500}}'),
    'another hitch': ('scene', 'vehicle: {<<: vehicles/compact_fwd.yaml, hitch_mm: [-2200, 0, 400]}'),
    'a scene that changes one': ('scene', '<<: scenes/car_step_steer.yaml\nduration: 2'),
    'a quantity': (
        'scene',
        'vehicle: vehicles/full_car.yaml\nrequire: {yaw_rate: {rms: 2 %}, wheel_load: {front_left: {max: 100 N}}}',
    ),
    'quantities under accuracy': (
        'scene',
        'vehicle: vehicles/full_car.yaml\nrequire: {accuracy: {odom/pose/x: {max: 0.1}}}',
    ),
    'a signal and a number': (
        'maneuver',
        'steering: {kind: ramp, start: 1, slope: 0.2, final: 0.5}\ndrive_torque: 100',
    ),
    'a law as points': (
        'mechanism',
        BODY + 'spring_dampers: {s: {i: world, j: a, free_length: 1, spring: [[-1, -5], [1, 5]]}}',
    ),
    'a marker in the world': (
        'mechanism',
        BODY + 'joints: {j: {kind: revolute, i: world, j: a, at: [0, 0, 1], axis: [0, 1, 0]}}',
    ),
    'a marker of its own': (
        'mechanism',
        'bodies: {a: {mass: 1, inertia: [1, 1, 1, 0, 0, 0], rpy_deg: [0, 0, 90]}}\n'
        'joints: {j: {kind: fixed, i: world, j: {body: a, position: [0, 0, 1]}}}',
    ),
    'entries as a list': ('mechanism', 'bodies: [{name: a, mass: 1, inertia: [1, 1, 1]}]'),
    'a linkage by kind': ('mechanism', 'kind: chain\nlinks: 4'),
    'a random road': (
        'road',
        'grids: [{kind: random_road, origin: [5, -6], length: 20, width: 12, quality: C, seed: 7}]',
    ),
}
BAD = {
    'no model': ('scene', 'duration: 5'),
    'two models': ('scene', 'vehicle: vehicles/full_car.yaml\nmechanism: mechanisms/pendulum.yaml'),
    'a key misspelt': ('scene', 'vehicle: vehicles/full_car.yaml\ndurration: 5'),
    'a key misspelt in a part': ('scene', 'vehicle: vehicles/full_car.yaml\nintegrator: {step: 0.001}'),
    'a key in a unit that is none of it': ('scene', 'vehicle: vehicles/full_car.yaml\nduration_deg: 5'),
    'text for a number': ('scene', 'vehicle: vehicles/full_car.yaml\nduration: long'),
    'quoted digits': ('scene', "vehicle: vehicles/full_car.yaml\nduration: '5'"),
    'a fraction for a count': ('scene', 'vehicle: vehicles/full_car.yaml\nrecord: {every: 2.5}'),
    'yes for true': ('scene', 'vehicle: vehicles/full_car.yaml\nrecord: {reactions: yes}'),
    'another choice': ('scene', 'vehicle: vehicles/full_car.yaml\nfidelity: coarse'),
    'a file that cannot stand there': ('scene', 'vehicle: vehicles/full_car.json'),
    'a requirement misspelt': ('scene', 'vehicle: vehicles/full_car.yaml\nrequire: {energy_eror_max: 0.1}'),
    'a measure that is none': ('scene', 'vehicle: vehicles/full_car.yaml\nrequire: {yaw_rate: {mean: 2 %}}'),
    'a kind of vehicle that is none': ('vehicle', 'kind: lorry'),
    'a vehicle without a kind': ('vehicle', 'chassis: {mass: 1000}'),
    'a key misspelt in what changes a vehicle': ('vehicle', f'{CAR}, chassis: {{weight: 1500}}}}'),
    'an angle beyond its bound': ('vehicle', f'{CAR}, rear: {{wheel: {{toe: 0.2}}}}}}'),
    'and in degrees': ('vehicle', f'{CAR}, rear: {{wheel: {{toe_deg: 5.1}}}}}}'),
    'two numbers for a point': ('vehicle', f'{CAR}, hitch: [1, 2]}}'),
    'a signal of no kind': ('maneuver', 'steering: {kind: wave, t: 1}'),
    'a rate below zero': (
        'mechanism',
        BODY + 'spring_dampers: {s: {i: world, j: a, free_length: 1, spring: -5}}',
    ),
    'a body without mass': ('mechanism', 'bodies: {a: {inertia: [1, 1, 1]}}'),
    'a name in an entry that has one': ('mechanism', 'bodies: {a: {name: b, mass: 1, inertia: [1, 1, 1]}}'),
    'five numbers of inertia': ('mechanism', 'bodies: {a: {mass: 1, inertia: [1, 1, 1, 0, 0]}}'),
    'a linkage of no kind': ('mechanism', 'kind: ladder'),
    'a list for a mapping': ('road', '[1, 2]'),
}


@pytest.mark.parametrize('name', GOOD)
def test_what_is_right_is_taken(name: str) -> None:
    kind, text = GOOD[name]
    assert refused(kind, text) == ''
    assert takes(kind, text), [e.message[:300] for e in validator(kind).iter_errors(value(parse(text, 'file')))]


@pytest.mark.parametrize('name', BAD)
def test_what_is_wrong_is_refused_by_both(name: str) -> None:
    kind, text = BAD[name]
    assert refused(kind, text) != ''
    assert not takes(kind, text)


def test_the_files_in_config_are_those_of_the_code() -> None:
    for name, text in files().items():
        assert (ROOT / 'config' / 'schema' / name).read_text(encoding='utf-8') == text, (
            'run `python docs/tools/tables.py`'
        )


def test_references_lead_somewhere_and_nothing_is_left_over() -> None:
    for kind in KINDS:
        schema = schema_of(kind)
        text = json.dumps(schema)
        assert schema['$schema'] == DRAFT
        assert set(re.findall(r'"#/definitions/([^"]+)"', text)) == set(schema['definitions'])
    shared = json.loads(files()['definitions.json'])['definitions']
    assert all(schema_of(kind)['definitions'].items() <= shared.items() for kind in ('vehicle', 'road'))


def test_the_command_prints_one_and_writes_all(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['schema', 'road']) == 0
    assert json.loads(capsys.readouterr().out) == schema_of('road')
    assert main(['schema', '--out', str(tmp_path / 'new' / 'schema')]) == 0
    assert {file.name for file in (tmp_path / 'new' / 'schema').iterdir()} == {*files()}
    capsys.readouterr()
    for words, says in (
        (['schema', 'raod'], "no such kind of file; did you mean 'road'?"),
        (['schema'], 'give a kind of file'),
        (['schema', 'road', '--out', 'x'], 'give a kind of file'),
    ):
        assert main(words) == SpecError.exit_code
        assert says in capsys.readouterr().err
    (tmp_path / 'file').write_text('')
    assert main(['schema', '--out', str(tmp_path / 'file' / 'x')]) != 0
    assert 'choose another place' in capsys.readouterr().err
