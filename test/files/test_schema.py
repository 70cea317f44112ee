"""The strict loader: what values mean, and that every mistake is refused in one sentence that names the place."""

from __future__ import annotations

import dataclasses
import math
import re
from typing import Annotated, Literal

import pytest

from solver.errors import SceneError
from solver.files.scene import load_scene
from solver.files.schema import Builder
from solver.files.yaml_tree import parse, text_of


@dataclasses.dataclass(frozen=True, kw_only=True)
class Round:
    radius: Annotated[float, 'm']


@dataclasses.dataclass(frozen=True, kw_only=True)
class Flat:
    kind: Literal['flat', 'level'] = 'flat'
    tilt: Annotated[float, 'rad'] = 0.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class Named:
    name: str
    size: float = 1.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class Thing:
    mass: float
    count: int = 0
    title: str = ''
    on: bool = False
    choice: Literal['a', 'b'] = 'a'
    number: Literal[52, 61] = 52
    vector: Annotated[tuple[float, float, float], 'm'] = (0.0, 0.0, 0.0)
    shape: float | Round | Flat = 0.0
    maybe: Annotated[float | None, 'rad'] = None
    parts: tuple[Named, ...] = ()
    pairs: tuple[tuple[str, float], ...] = ()
    values: dict[str, float] = dataclasses.field(default_factory=dict)


def thing(text: str) -> Thing:
    return Builder().build(Thing, parse('mass: 1\n' + text, 'file.yaml'))


@pytest.mark.parametrize(
    ('text', 'field', 'value'),
    [
        ('count: 3', 'count', 3),
        ('count: 1e3', 'count', 1000),
        ('maybe: 1e-3', 'maybe', 1e-3),
        ('maybe: -.5E+2', 'maybe', -50.0),
        ('maybe: null', 'maybe', None),
        ('maybe_deg: 180', 'maybe', math.pi),
        ('title: no', 'title', 'no'),
        ('title: 1e3', 'title', '1e3'),
        ("title: ''", 'title', ''),
        ('on: true', 'on', True),
        ('number: 61', 'number', 61),
        ('vector: [1, 2.5, -3e0]', 'vector', (1.0, 2.5, -3.0)),
        ('vector_mm: [1, 2.5, -3]', 'vector', (0.001, 0.0025, -0.003)),
        ('shape: 4', 'shape', 4.0),
        ('shape: {kind: round, radius: 2}', 'shape', Round(radius=2.0)),
        ('shape: {kind: round, radius_mm: 2}', 'shape', Round(radius=0.002)),
        ('shape: {kind: level, tilt_deg: 90}', 'shape', Flat(kind='level', tilt=math.pi / 2)),
        ('parts: {x: {size: 2}, y: {}}', 'parts', (Named(name='x', size=2.0), Named(name='y'))),
        ('parts: [{name: x}]', 'parts', (Named(name='x'),)),
        ('pairs: {x: 1, y: 2}', 'pairs', (('x', 1.0), ('y', 2.0))),
        ('pairs: [[x, 1], [x, 2]]', 'pairs', (('x', 1.0), ('x', 2.0))),
        ('values: {x: 1}', 'values', {'x': 1.0}),
    ],
)
def test_a_value_is_read_by_the_type_of_its_field(text: str, field: str, value: object) -> None:
    got = getattr(thing(text), field)
    assert got == pytest.approx(value) if isinstance(value, float) else got == value
    assert type(got) is type(value)


@pytest.mark.parametrize(
    ('text', 'says'),
    [
        ('mas: 2', "file.yaml:2: mas: unknown key; did you mean 'mass'?"),
        ('mass: 2', 'file.yaml:2: mass: the key is given twice (first in line 1)'),
        ('count: 1.5', 'file.yaml:2: count = 1.5: must be a whole number'),
        ('maybe: .nan', 'file.yaml:2: maybe = .nan: must be finite'),
        ('vector: [1, 2, .inf]', 'file.yaml:2: vector[2] = .inf: must be finite'),
        ('vector: [1, 2, 1e999]', 'file.yaml:2: vector[2] = 1e999: must be finite'),
        ('vector: [1, 2]', 'file.yaml:2: vector = [1, 2]: must be a list of 3 values'),
        ("vector: [1, 2, '3']", "file.yaml:2: vector[2] = '3': is quoted text; must be a number"),
        (
            'vector: [1, 2, 3 mm]',
            'file.yaml:2: vector[2] = 3 mm: must be a number, in decimal digits and without a unit',
        ),
        ('vector: [1, 2, 0x1F]', 'must be a number'),
        ('vector: [1, 2, 1_000]', 'must be a number'),
        ('vector: [1, 2, 010]', 'must be a number'),
        ('vector: [1, 2, 1:30]', 'must be a number'),
        ('vector: [1, 2, true]', 'must be a number'),
        ('vector_deg: [1, 2, 3]', "file.yaml:2: vector_deg: unknown key; did you mean 'vector'?"),
        ('vector: [1, 2, 3]\nvector_mm: [1, 2, 3]', "file.yaml:3: vector_mm: 'vector' is given twice"),
        ('mass_mm: 2', "file.yaml:2: mass_mm: unknown key; did you mean 'mass'?"),
        ('on: yes', 'file.yaml:2: on = yes: must be true or false'),
        ('title:', 'file.yaml:2: title = : is empty'),
        ('title: [a]', 'file.yaml:2: title = [a]: must be text'),
        ('choice: c', 'file.yaml:2: choice = c: is not one of the choices; allowed: a, b'),
        ('number: 53', 'file.yaml:2: number = 53: is not one of the choices'),
        ('shape: big', 'file.yaml:2: shape = big: must be a number or a mapping'),
        ('shape: {radius: 2}', "file.yaml:2: shape: the key 'kind' is missing; one of: round, flat, level"),
        ('shape: {kind: rund}', "file.yaml:2: shape.kind = rund: unknown kind; did you mean 'round'?"),
        ('shape:\n  kind: round', "file.yaml:3: shape: the key 'radius' is missing"),
        ('parts: {x: {name: y}}', 'file.yaml:2: parts.x.name: the name is the key of the entry'),
        ('parts: {x: {siz: 2}}', "file.yaml:2: parts.x.siz: unknown key; did you mean 'size'?"),
        ('parts:\n  x:', 'file.yaml:3: parts.x = : is empty; a mapping of keys is wanted here'),
        ('parts: {x: {}, x: {}}', 'file.yaml:2: parts.x: the key is given twice'),
        ('values: 3', 'file.yaml:2: values = 3: must be a mapping of keys'),
        (
            "values: 'a/b.yaml'",
            "file.yaml:2: values = 'a/b.yaml': must be a mapping of keys; without quotes it is that of the file",
        ),
        ('title: !!python/object:os.system x', 'file.yaml:2: title = x: the tag'),
        ('values: &a {x: *a}', 'contains itself'),
        ('? [1, 2]\n: 3', 'a key must be a word'),
        ('values: {x: 1', 'file.yaml:2: not readable as YAML'),
        ('\tvalues: 2', 'not readable as YAML'),
        ('--- \na: 2', 'not readable as YAML'),
    ],
)
def test_a_mistake_is_refused_in_one_sentence_with_its_place(text: str, says: str) -> None:
    with pytest.raises(SceneError, match=re.escape(says)) as caught:
        thing(text)
    assert '\n' not in str(caught.value)


def test_missing_key_and_empty_file_are_refused() -> None:
    with pytest.raises(SceneError, match=r"f.yaml:1: the key 'mass' is missing"):
        Builder().build(Thing, parse('count: 1', 'f.yaml'))
    for text in ('', '# nothing\n'):
        with pytest.raises(SceneError, match=r'f\.yaml: the file is empty'):
            parse(text, 'f.yaml')
    with pytest.raises(SceneError, match='must be a mapping of keys'):
        Builder().build(Thing, parse('[1, 2]', 'f.yaml'))


def test_text_of_a_node_parses_to_the_same_values() -> None:
    text = 'mass: 1e-3\ntitle: "1.0"\nvector: [1, 2, 3]\nvalues: &v {a b: 1}\n'
    builder = Builder()
    assert builder.build(Thing, parse(text_of(parse(text, 'a')), 'b')) == builder.build(Thing, parse(text, 'a'))


@pytest.mark.parametrize(
    ('written', 'meant'),
    [
        ('record.energy=true', 'energies'),  # and not every, which has as many letters of it
        ('record.elments=true', 'elements'),
        ('integrator.iteration=2', 'iterations'),
        ('integrator.penalties=1e4', 'penalty'),
    ],
)
def test_a_misspelt_key_leads_to_the_nearest(written: str, meant: str) -> None:
    with pytest.raises(SceneError, match=f"did you mean '{meant}'"):
        load_scene('pendulum', [written])
