"""Files that ask for more than they are: one sentence, at once, whatever stands in them."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from mbd_sim_ros.commands.main import main
from solver.elements.road import MOST_NODES, HeightGrid, RandomRoad, RoadSpec
from solver.errors import SceneError, SpecError
from solver.files import yaml_tree
from solver.files.overrides import override
from solver.files.scene import load_scene, load_scene_text
from solver.files.yaml_tree import parse, read, text_of

CRANK = 'mechanism: {kind: slider_crank}\n'


def refused(text: str, match: str) -> str:
    begin = time.process_time()
    with pytest.raises((SceneError, SpecError), match=match) as caught:
        load_scene_text(text)
    assert time.process_time() - begin < 5.0
    sentence = str(caught.value)
    assert '\n' not in sentence and len(sentence) < 400
    return sentence


ALIASES = 'a0: &a0 [1, 2, 3, 4, 5, 6, 7, 8]\n' + ''.join(
    f'a{k}: &a{k} [{", ".join([f"*a{k - 1}"] * 8)}]\n' for k in range(1, 30)
)


def test_aliases_that_multiply_are_counted_not_followed() -> None:
    refused(ALIASES + CRANK, r'scene:\d+: with every alias and include in place there are more than 100000 values')


def test_a_refusal_shows_the_beginning_of_an_endless_value() -> None:
    refused('a: &a !odd [*a, *a]\n', 'the tag !odd is not allowed')
    refused('x: &x {y: [*x]}\n', 'contains itself through an alias')
    refused(ALIASES + 'name: !odd *a29\n', 'not readable as YAML')
    refused('? [1, 2]\n: 3\n', 'a key must be a word')


@pytest.mark.parametrize('text', ['[' * 3000, '{a: ' * 3000, '- ' * 3000, 'a: ' + '[' * 100 + ']' * 100])
def test_values_in_each_other_are_bounded(text: str) -> None:
    refused(text, 'values are nested more than 64 deep')


def test_texts_and_includes_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(yaml_tree, 'MOST_VALUES', 1000)
    for k in range(12):
        (tmp_path / f'f{k}.yaml').write_text(f'[f{k + 1}.yaml, f{k + 1}.yaml]\n')
    (tmp_path / 'f12.yaml').write_text('1\n')
    with pytest.raises(SceneError, match='more than 1000 values'):
        read(tmp_path / 'f0.yaml', ())
    monkeypatch.setattr(yaml_tree, 'MOST_FILES', 20)
    with pytest.raises(SceneError, match='more than 20 files are included'):
        read(tmp_path / 'f0.yaml', ())
    monkeypatch.setattr(yaml_tree, 'MOST_INCLUDED', 5)
    with pytest.raises(SceneError, match='more than 5 files include each other'):
        read(tmp_path / 'f0.yaml', ())
    with pytest.raises(SceneError, match='too long'):
        parse('#' * (yaml_tree.MOST_CHARACTERS + 1), 'scene')
    (tmp_path / 'long.yaml').write_bytes(b'#' * (4 * yaml_tree.MOST_CHARACTERS + 1))
    (tmp_path / 'long.tir').write_bytes(b'!' * (yaml_tree.MOST_CHARACTERS + 1))
    for name in ('long.yaml', 'long.tir'):
        with pytest.raises(SceneError, match='too long'):
            read(tmp_path / name, ())


def test_an_alias_of_an_include_counts_each_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(yaml_tree, 'MOST_VALUES', 1000)
    (tmp_path / 'many.yaml').write_text(f'[{", ".join("0" * 300)}]\n')
    (tmp_path / 'top.yaml').write_text('a: &a [many.yaml]\nb: [*a, *a, *a]\n')
    with pytest.raises(SceneError, match='more than 1000 values'):
        read(tmp_path / 'top.yaml', ())


def test_an_override_is_bounded_too() -> None:
    root = parse(CRANK, 'scene')
    with pytest.raises(SceneError, match='values are nested more than 64 deep'):
        override(root, 'mechanism=' + '[' * 3000, ())


@pytest.mark.parametrize(
    ('scene', 'override', 'match'),
    [
        ('slider_crank', 'mechanism.kind={a: 1}', 'unknown kind of mechanism'),
        ('slider_crank', 'mechanism.kind=[1]', 'unknown kind of mechanism'),
        ('car_step_steer', 'vehicle.kind={a: 1}', 'unknown kind of vehicle'),
        ('car_step_steer', 'vehicle.rear.kind={a: 1}', 'unknown kind'),
        ('car_step_steer', 'vehicle.front.kind={a: 1}', 'unknown kind|is not one of the choices'),
        ('slider_crank', 'fidelity={a: 1}', 'is not one of the choices'),
        ('slider_crank', 'maneuver={name: {a: 1}}', 'must be text'),
        ('slider_crank', 'name={a: 1}', 'must be text'),
        ('slider_crank', 'start.kind=[assemble]', 'is not one of the choices'),
        ('car_step_steer', 'require={yaw_rate: {rms: {a: 1}}}', 'yaw_rate.rms'),
        ('slider_crank', 'duration=1e300', 'duration = 1e'),
        ('slider_crank', 'duration=1e10', 'duration = 1'),
        ('slider_crank', 'record.poses=1e-320', 'record.poses = 1e-320: must be 0, or once in 9e'),
        ('slider_crank', 'record.elements_rate=1e-320', 'record.elements_rate = 1e-320: must be 0, or once in 9e'),
        ('car_rough_road', 'road.grids.0.length=1e7', 'heights, more than'),
    ],
)
def test_what_no_key_can_hold_is_refused(scene: str, override: str, match: str) -> None:
    """A mapping or a list where a word is due, a number beyond all measure."""
    with pytest.raises(SceneError, match=match) as caught:
        load_scene(scene, [override])
    assert '\n' not in str(caught.value)


def test_roads_larger_than_memory_are_refused() -> None:
    road = {'origin': (0.0, 0.0), 'width': 10.0, 'quality': 'C', 'seed': 1}
    with pytest.raises(SpecError, match=r'needs 2\.2e\+09 heights'):
        RandomRoad(length=1e7, **road)  # type: ignore[arg-type]
    with pytest.raises(SpecError, match='heights, more than'):
        RandomRoad(length=1e300, **road, step=(1e-300, 1e-300))  # type: ignore[arg-type]
    one = RandomRoad(length=4000.0, **road)  # type: ignore[arg-type]
    assert 0.4 * MOST_NODES < one.nodes < 0.5 * MOST_NODES
    with pytest.raises(SpecError, match='all of them together'):
        RoadSpec(grids=(one, one, one))
    assert HeightGrid(origin=(0.0, 0.0), step=(1.0, 1.0), height=((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))).nodes == 6


@pytest.mark.parametrize('name', ['../../outside', '/tmp/outside', '..', 'a/../../b', '~', 'a\tb', 'x' * 300])
def test_the_name_of_a_scene_is_no_path(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from mbd_sim_ros.bags.recorder import new_directory

    base = tmp_path / 'here' / 'bags'
    directory = new_directory(name, base)
    assert directory.parent == base and directory.is_dir()
    assert [path.name for path in tmp_path.iterdir()] == ['here']


def test_a_plan_is_written_below_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        'solver.trade.certificate.plan', lambda _: {'status': 'ok', 'settings': None, 'price': {}, 'notes': []}
    )
    monkeypatch.setattr('solver.levels.auto.keep', lambda *_: True)
    monkeypatch.setattr('mbd_sim_ros.commands.plan._time', lambda *_: None)
    monkeypatch.setattr('mbd_sim_ros.commands.plan.describe', str)
    monkeypatch.setattr('mbd_sim_ros.analysis.plan_page.write_page', lambda _search, _data, file, _scene: file.touch())
    monkeypatch.chdir(tmp_path)
    asked = ['--set', 'name="../../../outside"', '--set', 'require={yaw_rate: {rms: 2 %}}']
    assert main(['plan', 'light_car_straight', *asked, '--json']) == 0
    assert sorted(path.name for path in (tmp_path / 'out' / 'plan').iterdir()) == ['_.._.._outside']
    assert [path.name for path in tmp_path.iterdir()] == ['out']


def test_scenes_that_are_there_are_within_the_bounds() -> None:
    assert load_scene('car_rough_road').model.road.grids[0].nodes < MOST_NODES


def test_a_text_that_is_read_again_has_nodes_of_its_own() -> None:
    """The nodes of short texts are kept; what is changed in one copy must not be in the next. What an alias shares is
    shared in each."""
    text = 'a: &a {b: [1, 2], c: "x"}\nd: *a\n'
    first, second = parse(text, 'f.yaml'), parse(text, 'f.yaml')
    override(first, 'a.b.0=7', [])
    assert text_of(parse(text, 'f.yaml')) == text_of(second) != text_of(first)
    (_, a), (_, d) = second.value
    assert a is d and a is not first.value[0][1]
    assert second.value[1][0].start_mark.line == 1 and second.value[1][0].start_mark.name == 'f.yaml'
    assert a.value[1][1].style == '"' and a.value[0][1].flow_style
    assert parse(text, 'other.yaml').start_mark.name == 'other.yaml'
