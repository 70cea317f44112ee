"""Units in the hints of specifications: every number has one or is known to have none, and every key may be written in
what it allows."""

from __future__ import annotations

import dataclasses
import importlib.util
import sys
import types
import typing
from collections import Counter
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest

from solver.dimensions import Length, Point, Speed, Torque, Within
from solver.elements.marker import Marker
from solver.errors import SceneError
from solver.files.mechanism import MechanismReader
from solver.files.scene import config_directories, find_file, load_scene, load_scene_and_units, load_scene_text
from solver.files.schema import Builder, is_number, parts_of, unit_of
from solver.files.vehicle import TEMPLATES
from solver.files.yaml_tree import MappingNode, Node, ScalarNode, SequenceNode, parse, read
from solver.inputs.maneuver import Maneuver
from solver.units import SUFFIXES, UNITS
from solver.vehicle.powertrain import Shaft

ROOT = Path(__file__).resolve().parents[2]
CONVERTIBLE = {UNITS[written][0] for written in SUFFIXES.values()}
WITHOUT = {
    # directions, and a rotation as a quaternion
    *('axes', 'axis', 'column_axis', 'normal', 'RigidBodySpec.orientation'),
    # parts of something, factors and ratios
    *(
        'share',
        'shares',
        'outputs',
        'ratio',
        'reverse',
        'Power.final',
        'speed_ratios',
        'torque_ratios',
        'crossings',
        'pedals',
    ),
    *('bite', 'slip'),
    *(
        'RoadSpec.friction',
        'StabilityControl.friction',
        'factor',
        'FrictionMap.scale',
        'FrictionMap.offset',
        'coherence',
        'cycles',
    ),
    *('ClutchSpec.ratios', 'Power.ratios', 'real_time_factor', 'real_time_factor_min'),
    # settings of the integrator, all relative
    *('rho_inf', 'tolerance', 'penalty', 'penalty_cap', 'mass_factor', 'residual_max'),
    # several units in one list, or those of the names that its numbers go by
    *(
        'BushingSpec.stiffness',
        'BushingSpec.damping',
        'BushingSpec.preload',
        'Bushing.stiffness',
        'values',
        'extra',
        'evaluate_with',
        'Controller.parameters',
    ),
    *(
        'Table.points',
        'Mapped.points',
        'GuideSpec.travel',
        'GuideSpec.steering',
        'shape',
        'opposite',
        'GuideSpec.stiffness',
        'windup',
    ),
    *('GuideSpec.coupling', 'jacking', 'GuideSpec.ratios', 'drives'),
    # those of coordinates, inputs, channels, signals or rasters
    *(
        'terms',
        'reference',
        'CoordinateForceSpec.preload',
        'input_gain',
        'top_rate',
        'CouplerSpec.offset',
        'BrakeSpec.gain',
    ),
    *(
        'CoordinateStart.rate',
        'value',
        'slope',
        'initial',
        'Ramp.final',
        'amplitude',
        'final_amplitude',
        'Sine.offset',
        'of',
        'signals',
    ),
    *('Actuator.rate_limit', 'BagChannel.scale', 'BagChannel.offset', 'low', 'resolution'),
    # of a motor on the rack or on the pitman arm
    *('forces', 'ServoSpec.limit', 'PowerSteering.limit'),
}


def printed() -> list[type]:
    """The dataclasses of the tables of docs/scene.md, and the marker, which is described beside them."""
    spec = importlib.util.spec_from_file_location('tables', ROOT / 'docs' / 'tools' / 'tables.py')
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    found: list[type] = []
    block = module.block
    module.block = lambda cls, **how: found.append(cls) or block(cls, **how)
    module.render(module.FILE.read_text(encoding='utf-8'))
    return [*dict.fromkeys(found), Marker]


def fields(cls: type) -> dict[str, Any]:
    """Field -> hint, without those that no file has."""
    hints = typing.get_type_hints(cls, include_extras=True)
    own = [field for field in dataclasses.fields(cls) if field.repr]
    plain = {field.name: hints[field.name] for field in own if 'keys' not in field.metadata}
    return plain | {key: hint for field in own for key, hint in field.metadata.get('keys', {}).items()}


def parts(hint: Any) -> list[Any]:
    """What a hint is made of."""
    return [a for a in typing.get_args(hint) if a not in (Ellipsis, types.NoneType) and not isinstance(a, str | Within)]


def numeric(hint: Any) -> bool:
    """Whether numbers stand in it that are no counts; those of other specifications are theirs."""
    return any(map(numeric, parts(hint))) if parts(hint) else hint is float


def only_numbers(hint: Any) -> bool:
    """Whether nothing else stands in it."""
    return all(map(only_numbers, parts(hint))) if parts(hint) else hint is float


def checked(name: str, qualified: str, hint: Any) -> list[str]:
    """The entries of WITHOUT that exempt this field; a field has either a unit or such an entry."""
    exempt = [key for key in (name, qualified) if key in WITHOUT]
    assert bool(unit_of(hint)) != bool(exempt), (
        f'{qualified}: give its unit in the hint (solver.dimensions), or name it in WITHOUT'
    )
    return exempt


@pytest.mark.parametrize('module', ['level', 'pusher', 'sliding_pillar'])
def test_the_recipes_give_their_units(module: str) -> None:
    spec = importlib.util.spec_from_file_location(module, ROOT / 'test' / 'data' / 'recipe' / f'{module}.py')
    assert spec and spec.loader
    recipe = importlib.util.module_from_spec(spec)
    sys.modules[module] = recipe  # dataclasses look their module up
    try:
        spec.loader.exec_module(recipe)
        own = [
            c
            for c in vars(recipe).values()
            if dataclasses.is_dataclass(c) and isinstance(c, type) and c.__module__ == module
        ]
        for cls in own:
            for name, hint in fields(cls).items():
                if numeric(hint):
                    checked(name, f'{cls.__name__}.{name}', hint)
    finally:
        del sys.modules[module]
    assert own


def test_every_angle_has_a_range_in_which_it_means_something() -> None:
    """Degrees would pass for radians otherwise."""
    angles = [
        (cls.__name__, name, hint) for cls in printed() for name, hint in fields(cls).items() if unit_of(hint) == 'rad'
    ]
    assert len(angles) > 10
    assert not [
        (cls, name) for cls, name, hint in angles if not any(isinstance(part, Within) for part in parts_of(hint))
    ]


def test_every_number_has_a_unit_or_is_known_to_have_none() -> None:
    used: Counter[str] = Counter()
    units: dict[str, set[str]] = {}
    for cls in printed():
        for name, hint in fields(cls).items():
            if not numeric(hint) or (cls, name) == (Marker, 'orientation'):
                continue
            qualified = f'{cls.__name__}.{name}'
            units.setdefault(name, set()).add(unit_of(hint))
            used.update(checked(name, qualified, hint))
    assert set(used) == WITHOUT, 'none of the files has them'
    assert all(units[name] == {''} for name in WITHOUT if '.' not in name)


def test_no_key_with_a_suffix_means_two_fields_and_what_is_converted_is_made_of_numbers() -> None:
    for cls in printed():
        hints = fields(cls)
        for name, hint in hints.items():
            assert name.rpartition('_')[0] not in hints or name.rpartition('_')[2] not in SUFFIXES, f'{cls}: {name}'
            # a number, or refused: the test below
            if unit_of(hint) in CONVERTIBLE and (cls.__name__, name) != ('SpeedControl', 'target'):
                assert only_numbers(hint), f'{cls}: {name}'


def test_a_signal_under_a_key_with_a_suffix_is_refused() -> None:
    maneuver = Builder().build(Maneuver, parse('speed: {target_kmh: 72}', 'm.yaml'))
    assert maneuver.speed.target == pytest.approx(20.0)
    with pytest.raises(SceneError, match=r'm\.yaml:1: speed\.target_kmh = .*: must be a number'):
        Builder().build(Maneuver, parse('speed: {target_kmh: {kind: ramp, slope: 1}}', 'm.yaml'))


@pytest.mark.parametrize(
    ('hint', 'unit'),
    [
        (float, ''),
        (Length, 'm'),
        (Length | None, 'm'),
        (Annotated[float | None, 'm'], 'm'),
        (Point, 'm'),
        (Point | None, 'm'),
        (tuple[tuple[Point, ...], ...], 'm'),
        (tuple[Length, Torque], ''),
        (tuple[Length, Length, int], ''),
        (tuple[Speed, ...] | float, ''),
        (dict[str, Length], ''),
    ],
)
def test_the_unit_of_a_hint_is_that_of_all_its_numbers(hint: Any, unit: str) -> None:
    assert unit_of(hint) == unit


def in_millimetres(node: Node, names: set[str]) -> int:
    """Write every length of a file in millimetres, exactly; how many keys."""
    if isinstance(node, SequenceNode):
        return sum(in_millimetres(item, names) for item in node.value)
    if not isinstance(node, MappingNode):
        return 0
    count = 0
    for key, value in node.value:
        numbers = list(leaves(value))
        if key.value in names and all(isinstance(one, ScalarNode) and is_number(one.value) for one in numbers):
            key.value += '_mm'
            count += 1
            for one in numbers:
                one.value = str(1000 * Decimal(one.value))
        else:
            count += in_millimetres(value, names)
    return count


def leaves(node: Node) -> typing.Iterator[Node]:
    """The scalars of a list of lists, or the node itself."""
    if isinstance(node, SequenceNode):
        for item in node.value:
            yield from leaves(item)
    else:
        yield node


def floats(value: object) -> typing.Iterator[float]:
    """All numbers of a specification."""
    if isinstance(value, float):
        yield value
    elif isinstance(value, tuple | list):
        for one in value:
            yield from floats(one)
    elif isinstance(value, dict):
        yield from floats(list(value.values()))
    elif dataclasses.is_dataclass(value):
        yield from floats([getattr(value, field.name) for field in dataclasses.fields(value)])


@pytest.mark.parametrize(('name', 'least'), [('light_car', 20), ('full_car', 50), ('pickup_awd', 50)])
def test_a_vehicle_in_millimetres_is_the_one_in_metres(name: str, least: int) -> None:
    """Hardpoints, lists of them (pivots) and lists of those (groups of mounts)."""
    units = {(key, unit_of(hint)) for cls in printed() for key, hint in fields(cls).items() if numeric(hint)}
    lengths = {key for key, unit in units if unit == 'm'} - {key for key, unit in units if unit != 'm'}

    def data(convert: bool) -> Any:
        builder = MechanismReader().builder()
        root = read(find_file(name, 'vehicles'), config_directories())
        assert not convert or in_millimetres(root, lengths) >= least
        given = builder.mapping(root, '')
        cls, _ = TEMPLATES[given.pop('kind')[1].value]
        return builder.construct(cls, given, root, '', extra=('kind',))

    metres, millimetres = (np.array(list(floats(data(convert)))) for convert in (False, True))
    assert metres.size > 100
    np.testing.assert_allclose(millimetres, metres, rtol=1e-15, atol=0.0)
    assert np.mean(millimetres == metres) > 0.9  # only where a thousandth is not a number of the machine


def test_a_refused_value_is_found_under_its_key_with_a_suffix() -> None:
    with pytest.raises(SceneError, match=r's\.yaml:2: radius = -0\.02: must be >'):
        Builder().build(Shaft, parse('mass: 1\nradius_mm: -20\n', 's.yaml'))


MECHANISM = """
mechanism:
  bodies:
    a: {mass: 1, inertia: [1, 1, 1], position_mm: [100, 0, 0]}
    b: {mass: 1, inertia: [1, 1, 1], position: [2, 0, 0]}
  joints:
    rod: {kind: distance, i: {body: a, position_mm: [0, 250, 0]}, j: b, LENGTH}
    hinge: {kind: spherical, i: a, j: world, at: [0, 0, 0]}
duration: 1
"""


def test_keys_that_are_no_fields_tell_their_units_too() -> None:
    text = MECHANISM.replace('LENGTH', 'length: 2').replace(
        'position: [2, 0, 0]', 'position: [2, 0, 0], rpy_deg: [90, 0, 0]'
    )
    units = load_scene_and_units(text)[1]
    body = 'mechanism.bodies.b'
    assert (units[f'{body}.inertia'], units[f'{body}.rpy_deg'], units[f'{body}.position']) == ('kg m^2', 'deg', 'm')
    assert units['mechanism.joints.hinge.at'] == 'm'
    assert units['mechanism.bodies.a.position_mm'] == 'mm'
    towing = load_scene_and_units(load_scene('saloon_with_trailer').resolved)[1]
    assert towing['trailer.chassis.mass'] == 'kg'


def test_a_mechanism_may_be_written_in_millimetres_too() -> None:
    scene = load_scene_text(MECHANISM.replace('LENGTH', 'length_mm: 1900'))
    assert scene.model.bodies[0].position == (0.1, 0.0, 0.0)
    assert scene.model.joints[0].i.position == (0.0, 0.25, 0.0)
    assert scene.model.joints[0].length == pytest.approx(1.9, rel=1e-15)
    placed = load_scene_text(MECHANISM.replace(', LENGTH', ''))
    assert placed.model.joints[0].length == pytest.approx(float(np.hypot(1.9, 0.25)))
    with pytest.raises(SceneError, match=r"position_mm = \[0, 250, 0\]: give either 'at'"):
        load_scene_text(MECHANISM.replace('LENGTH', 'length: 1').replace('body: a, ', 'body: a, at: [0, 0, 0], '))


@pytest.mark.parametrize(
    ('override', 'length'),
    [('length=2.5', 2.5), ('length_mm=2500', 2.5), ('length_mm=1950', 1.95)],
)
@pytest.mark.parametrize('given', ['length: 1.9', 'length_mm: 1900'])
def test_an_override_replaces_what_stands_there_with_another_unit(given: str, override: str, length: float) -> None:
    scene = load_scene_text(MECHANISM.replace('LENGTH', given), overrides=[f'mechanism.joints.rod.{override}'])
    assert scene.model.joints[0].length == pytest.approx(length, rel=1e-15)
    assert load_scene_text(scene.resolved) == scene


def test_a_part_whose_name_ends_like_a_unit_is_a_part_of_its_own() -> None:
    """A body called b_mm beside one called b."""
    new = 'mechanism.bodies.b_mm={mass: 3, inertia: [1, 1, 1], position: [3, 0, 0]}'
    scene = load_scene_text(MECHANISM.replace('LENGTH', 'length: 1.9'), overrides=[new])
    assert [(body.name, body.mass) for body in scene.model.bodies] == [('a', 1.0), ('b', 1.0), ('b_mm', 3.0)]
