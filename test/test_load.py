"""What files mean, and that every mistake in them is refused in one sentence that names the place."""

from __future__ import annotations

import dataclasses
import importlib.util
import math
import re
import typing
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pytest

from solver.elements.joint import JointSpec
from solver.elements.laws import Law
from solver.elements.marker import Marker
from solver.errors import SceneError
from solver.load import Builder
from solver.mechanism import MechanismReader, frame_of_axis, frame_of_rpy, matrix
from solver.model.spec import ModelSpec
from solver.nodes import parse, text_of
from solver.scene import Scene, known_names, load_maneuver, load_scene, load_scene_text
from solver.vehicle.load import TEMPLATES

ROOT = Path(__file__).resolve().parent.parent


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
        ('vector: [1, 2, 3 mm]', 'file.yaml:2: vector[2] = 3 mm: must be a number, in decimal digits and without a unit'),
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


# -- mechanisms --------------------------------------------------------------------------------------------------------


def model(text: str) -> ModelSpec:
    return MechanismReader().builder().build(ModelSpec, parse(text, 'file.yaml'))


TWO_BODIES = """
bodies:
  a: {mass: 1, inertia: [1, 1, 1], position: [1, 2, 3], rpy_deg: [0, 0, 90]}
  b: {mass: 1, inertia: [1, 1, 1, 0.1, 0, 0], position: [0, 1, 0], rpy: [0.3, -0.2, 0.5]}
"""


def placed(spec: ModelSpec, marker: Marker) -> tuple[np.ndarray, np.ndarray]:
    body = next(b for b in spec.bodies if b.name == marker.body)
    R = matrix(body.orientation)
    return np.array(body.position) + R @ marker.position, R @ matrix(marker.orientation)


def test_markers_given_in_the_world_coincide_there() -> None:
    spec = model(TWO_BODIES + 'joints:\n  j: {kind: revolute, i: a, j: b, at: [0.5, 0.6, 0.7], axis: [1, 2, 2], x_axis: [0, 0, 1]}')
    for marker in (spec.joints[0].i, spec.joints[0].j):
        p, R = placed(spec, marker)
        np.testing.assert_allclose(p, [0.5, 0.6, 0.7], atol=1e-15)
        np.testing.assert_allclose(R[:, 2], np.array([1, 2, 2]) / 3.0, atol=1e-15)
        np.testing.assert_allclose(R[:, 0] @ [0, 0, 1], math.sqrt(1.0 - 4.0 / 9.0), atol=1e-15)  # as near to z as it can be
    p, R = placed(
        spec, model(TWO_BODIES + 'joints:\n  j: {kind: fixed, i: {body: a, at: [4, 5, 6], rpy_deg: [90, 0, 0]}, j: b}').joints[0].i
    )
    np.testing.assert_allclose(p, [4, 5, 6], atol=1e-15)
    np.testing.assert_allclose(R, frame_of_rpy([math.pi / 2, 0, 0]), atol=1e-15)


def test_local_and_bare_markers_are_taken_as_they_stand() -> None:
    joint = model(TWO_BODIES + 'joints:\n  j: {kind: fixed, i: a, j: {body: b, position: [1, 0, 0], axis: [0, 0, 2]}}').joints[0]
    assert joint.i == Marker(body='a')
    assert joint.j == Marker(body='b', position=(1.0, 0.0, 0.0))


@pytest.mark.parametrize('axis', [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, 1, 0), (1, 1, 1), (-3, 0.1, 0), (1e-9, 0, 5)])
def test_frame_of_axis_is_a_rotation_with_its_z_along_the_axis(axis) -> None:
    R = frame_of_axis(axis)
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-15)
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_allclose(R[:, 2], np.array(axis) / np.linalg.norm(axis), atol=1e-15)


def test_axis_z_changes_nothing() -> None:
    assert np.array_equal(frame_of_axis((0, 0, 1)), np.eye(3))


def test_rpy_turns_about_x_then_y_then_z_of_the_world() -> None:
    turn = frame_of_rpy([0.0, 0.0, math.pi / 2]) @ frame_of_rpy([0.0, math.pi / 2, 0.0]) @ frame_of_rpy([math.pi / 2, 0.0, 0.0])
    np.testing.assert_allclose(frame_of_rpy([math.pi / 2] * 3), turn, atol=1e-15)
    np.testing.assert_allclose(frame_of_rpy([math.pi / 2, 0, 0]) @ [0, 1, 0], [0, 0, 1], atol=1e-15)
    np.testing.assert_allclose(frame_of_rpy([0, 0, math.pi / 2]) @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(frame_of_rpy([0, math.pi / 2, 0]) @ [1, 0, 0], [0, 0, -1], atol=1e-15)


def test_distance_joint_takes_the_placed_distance() -> None:
    spec = model(TWO_BODIES + 'joints:\n  j: {kind: distance, i: {body: a, at: [1, 0, 0]}, j: {body: world, position: [1, 3, 4]}}')
    assert spec.joints[0].length == pytest.approx(5.0, rel=1e-15)


def test_laws_are_a_rate_or_a_table() -> None:
    text = TWO_BODIES + 'spring_dampers:\n  s: {i: a, j: b, free_length: 1, spring: 1e3, damper: [[-1, -500], [0, 0], [1, 900]]}'
    spring = model(text).spring_dampers[0]
    assert spring.spring == Law.linear(1000.0)
    assert spring.damper == Law.table([[-1, -500], [0, 0], [1, 900]])


def test_inputs_are_those_that_elements_name_and_drivers_bring_their_derivatives() -> None:
    text = TWO_BODIES + 'joints:\n  j: {kind: revolute, i: a, j: b, at: [0, 0, 0]}\ncouplers:\n  c: {terms: {j: 1}, input: motor}'
    assert model(text).inputs == ('motor', 'motor_rate', 'motor_acceleration')
    assert model(text + '\ninputs: [motor, motor_rate, motor_acceleration, spare]').inputs[-1] == 'spare'


@pytest.mark.parametrize(
    ('text', 'says'),
    [
        ('joints:\n  j: {kind: fixed, i: a, j: c}', 'file.yaml:6: joints.j.j = c: no such body; allowed: a, b, world'),
        ('joints:\n  j: {kind: hinge, i: a, j: b}', "file.yaml:6: joints.j.kind = 'hinge': unknown kind of joint"),
        ('joints:\n  j: {kind: fixed, i: a, j: a}', 'must differ from i.body'),
        ('joints:\n  j: {kind: fixed, i: a, j: b, axis: [1, 0, 0]}', "file.yaml:6: joints.j.axis: needs the key 'at' beside it"),
        ('joints:\n  j: {kind: fixed, i: a, j: b, at: [0, 0, 0], axis: [0, 0, 0]}', 'joints.j.axis = [0, 0, 0]: the axis must not be zero'),
        ('joints:\n  j: {kind: fixed, i: a, j: b, at: [0, 0, 0], axis: [1, 0, 0], x_axis: [2, 0, 0]}', 'must not be parallel'),
        ('joints:\n  j: {kind: fixed, i: a, j: b, at: [0, 0, 0], x_axis: [2, 0, 0]}', "needs the key 'axis'"),
        ('joints:\n  j: {kind: fixed, i: a, j: b, at: [0, 0, 0], axis: [1, 0, 0], rpy: [0, 0, 0]}', 'keep one of them'),
        ('joints:\n  j: {kind: fixed, i: {body: a, at: [0, 0, 0], position: [0, 0, 0]}, j: b}', "either 'at'"),
        ('joints:\n  j: {kind: fixed, i: {body: a, at: [0, 0, 0], foo: 1}, j: b}', 'joints.j.i.foo: unknown key'),
        ('joints:\n  j: {kind: fixed, i: {body: a, positon: [0, 0, 0]}, j: b}', "did you mean 'position'"),
        ('spring_dampers:\n  s: {i: a, j: b, free_length: 1, spring: [[0, 0], [0, 1]]}', 'spring_dampers.s.spring'),
        ('spring_dampers:\n  s: {i: a, j: b, free_length: -1}', 'file.yaml:6: spring_dampers.s.free_length = -1.0: must be >= 0'),
        ('bushing: {}', "file.yaml:5: bushing: unknown key; did you mean 'bushings'?"),
        ('gravity: [0, 0]', 'file.yaml:5: gravity = [0, 0]: must be a list of 3 values'),
    ],
)
def test_a_mistake_in_a_mechanism_is_refused_with_its_place(text: str, says: str) -> None:
    with pytest.raises(SceneError, match=re.escape(says)):
        model(TWO_BODIES.lstrip('\n') + '\n' + text)


# -- scenes ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize('name', known_names())
def test_resolved_scene_loads_again_to_the_same_scene(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = load_scene(name)
    monkeypatch.chdir(tmp_path)  # nothing but the text is needed
    again = load_scene_text(scene.resolved, 'elsewhere')
    assert again == scene
    assert again.resolved == scene.resolved


@pytest.mark.parametrize('name', known_names('maneuvers'))
def test_maneuver_files_load(name: str) -> None:
    maneuver = load_maneuver(name)
    assert maneuver.name == name
    assert np.isfinite(maneuver.commands(3.0)).all()


def test_slider_crank_is_the_one_of_the_chapter() -> None:
    model_ = load_scene('slider_crank').model
    assert len(model_.bodies) == 4
    assert sorted(j.kind for j in model_.joints) == ['fixed', 'prismatic', 'revolute', 'revolute', 'revolute']
    assert sum(len(JointSpec.row_names(j)) for j in model_.joints) == 26


def test_overrides_are_checked_like_the_file_and_are_in_the_resolved_text() -> None:
    scene = load_scene(
        'slider_crank', ['integrator.h=2e-3', 'mechanism.bodies.slider.mass=0.02', 'mechanism.bodies.crank.com[0]=0.4', 'title=other']
    )
    assert (scene.integrator.h_ns, scene.model.bodies[3].mass, scene.model.bodies[1].com[0], scene.title) == (2_000_000, 0.02, 0.4, 'other')
    assert load_scene_text(scene.resolved) == scene
    assert load_scene('slider_crank', ['start={}']).start.coordinates == {}


@pytest.mark.parametrize(
    ('override', 'says'),
    [
        ('integrator.hh=1', "--set integrator.hh: integrator.hh: unknown key; did you mean 'h'?"),
        ('integrator.h=fast', '--set integrator.h: integrator.h = fast: must be a number'),
        ('integrator.h=1.5e-9', 'must be a whole number of nanoseconds'),
        ('integrator.rho_inf=1.2', '--set integrator.rho_inf: integrator.rho_inf = 1.2: must be in [0, 1]'),
        ('duration', 'write it as path.to.key=value'),
        ('duration.x=1', 'is a plain value'),
        ('mechanism.bodies.crank.com[3]=1', 'is a list of 3'),
        ('start.coordinates.slid.rate=1', "did you mean 'slide'?"),
        ('maneuver=maneuvers/step_stear.yaml', "did you mean 'maneuvers/step_steer.yaml'?"),
        ('maneuver=maneuvers/step_steer.yaml', "step_steer.yaml:2: maneuver = 'steering': the model has no such input"),
        ('maneuver.signals.moter=1', 'the model has no such input'),
        ('vehicle={}', 'exactly one of the keys'),
    ],
)
def test_a_wrong_override_is_refused(override: str, says: str) -> None:
    with pytest.raises(SceneError, match=re.escape(says)):
        load_scene('slider_crank', [override])


def test_a_wrong_scene_name_suggests_the_nearest() -> None:
    with pytest.raises(SceneError, match=r"no such file.*did you mean 'slider_crank'\?"):
        load_scene('slidercrank')
    with pytest.raises(SceneError, match=r'allowed: .*pendulum'):
        load_scene('zzz')


def test_scenes_are_found_by_path_by_name_and_in_the_current_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    by_name = load_scene('pendulum')
    assert load_scene(ROOT / 'config' / 'scenes' / 'pendulum.yaml') == by_name
    (tmp_path / 'scenes').mkdir()
    (tmp_path / 'scenes' / 'mine.yaml').write_text('mechanism: mechanisms/pendulum.yaml\nduration: 3\n')
    monkeypatch.chdir(tmp_path)
    assert load_scene('mine').duration == 3.0
    assert load_scene('mine').model == by_name.model
    assert load_scene('pendulum') == by_name


def test_a_file_that_includes_itself_and_a_missing_one_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'loop.yaml').write_text('title: x\nmechanism: loop.yaml\n')
    with pytest.raises(SceneError, match=r'loop.yaml:2: mechanism = loop.yaml: the file includes itself'):
        load_scene('loop.yaml')
    (tmp_path / 'gone.yaml').write_text('mechanism: mechanisms/pendulun.yaml\n')
    with pytest.raises(SceneError, match=r"gone.yaml:1: .*did you mean 'mechanisms/pendulum.yaml'"):
        load_scene('gone.yaml')
    (tmp_path / 'binary.yaml').write_bytes(b'\xff\xfe\x00')
    with pytest.raises(SceneError, match=r'binary.yaml: cannot be read: is not UTF-8 text'):
        load_scene('binary.yaml')


def test_an_error_inside_an_included_file_names_that_file_and_the_whole_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'm.yaml').write_text('bodies:\n  a: {mass: -1, inertia: [1, 1, 1]}\n')
    (tmp_path / 's.yaml').write_text('mechanism: m.yaml\n')
    with pytest.raises(SceneError, match=r'^m.yaml:2: mechanism.bodies.a.mass = -1.0: must be >= 0$'):
        load_scene('s.yaml')


def test_text_of_a_node_parses_to_the_same_values() -> None:
    text = 'mass: 1e-3\ntitle: "1.0"\nvector: [1, 2, 3]\nvalues: &v {a b: 1}\n'
    builder = Builder()
    assert builder.build(Thing, parse(text_of(parse(text, 'a')), 'b')) == builder.build(Thing, parse(text, 'a'))


# -- the document ------------------------------------------------------------------------------------------------------


def tables():
    spec = importlib.util.spec_from_file_location('tables', ROOT / 'docs' / 'tables.py')
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_document_agrees_with_the_code() -> None:
    module = tables()
    text = module.FILE.read_text(encoding='utf-8')
    assert module.render(text) == text, 'run `python docs/tables.py`'


def test_every_field_that_a_file_may_hold_is_in_the_document() -> None:
    text = tables().FILE.read_text(encoding='utf-8')
    seen: set[type] = set()

    def visit(hint: object) -> None:
        for argument in typing.get_args(hint):
            visit(argument)
        if not dataclasses.is_dataclass(hint) or hint in seen or hint in (Law, Marker):
            return
        seen.add(typing.cast(type, hint))
        for field in dataclasses.fields(hint):
            if hint is Scene and field.name in ('model', 'resolved'):
                continue
            assert field.name == 'name' or f'| `{field.name}`' in text, f'{hint}: {field.name}'
            visit(typing.get_type_hints(hint, include_extras=True)[field.name])

    visit(Scene)
    visit(ModelSpec)
    for data, _ in TEMPLATES.values():
        visit(data)
    assert len(seen) > 20


def minimal_example() -> str:
    found = re.search(r'```yaml\n# minimal scene.*?\n(.*?)```', tables().FILE.read_text(encoding='utf-8'), re.DOTALL)
    assert found
    return found[1]


def test_the_example_in_the_document_loads_and_runs() -> None:
    from solver.simulation import Simulation

    simulation = Simulation(load_scene_text(minimal_example()))
    snapshot = simulation.advance(simulation.scene.steps)
    assert snapshot.t_ns == 1_000_000_000
    # one metre, started at 1 rad/s from the lowest point: the amplitude of the pendulum bounds its angle
    J = 1.0 + 0.01
    assert 0.0 < abs(snapshot.joint_position[0]) < math.acos(1.0 - 0.5 * J / 9.81) + 1e-6


@pytest.mark.parametrize('name', known_names('roads'))
def test_road_files_load(name: str) -> None:
    scene = load_scene('pendulum', [f'road=roads/{name}.yaml'])
    assert load_scene_text(scene.resolved) == scene
