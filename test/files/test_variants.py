"""Files that take another one and change a part of it, by the key <<."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from mbd_sim_ros.commands.main import main
from solver.errors import SceneError
from solver.files.scene import load_scene
from solver.files.yaml_tree import include, parse, text_of

BASE = """\
kind: car
wheels: {count: 4, width_mm: 205, rim: {kind: steel, holes: 5}}
seats: [1, 2, 3]
left: &side {door: 2, window: 1}
right: *side
"""


def variant(text: str, tmp_path: Path) -> Any:
    """What a text stands for beside a file base.yaml."""
    (tmp_path / 'base.yaml').write_text(BASE)
    return yaml.safe_load(text_of(include(parse(text, 'mine.yaml'), [tmp_path])))


def test_mappings_are_changed_key_by_key_and_everything_else_is_replaced(tmp_path: Path) -> None:
    base = yaml.safe_load(BASE)
    assert variant('<<: base.yaml', tmp_path) == base
    found = variant('<<: base.yaml\nwheels: {count: 3, rim: {holes: 4}}\nseats: [7]\nroof: 1\n', tmp_path)
    wheels = {'count': 3, 'width_mm': 205, 'rim': {'kind': 'steel', 'holes': 4}}
    assert found == {**base, 'wheels': wheels, 'seats': [7], 'roof': 1}


def test_where_the_key_stands_does_not_matter_and_variants_have_variants(tmp_path: Path) -> None:
    (tmp_path / 'second.yaml').write_text('seats: [7]\n<<: base.yaml\nroof: 1\n')
    found = variant('car: {roof: 2, <<: second.yaml}', tmp_path)
    assert found == {'car': {**yaml.safe_load(BASE), 'seats': [7], 'roof': 2}}


def test_another_kind_begins_anew_and_another_unit_replaces_the_first(tmp_path: Path) -> None:
    found = variant('<<: base.yaml\nwheels: {width: 0.195, rim: {kind: alloy, spokes: 10}}\n', tmp_path)
    assert found['wheels'] == {'count': 4, 'width': 0.195, 'rim': {'kind': 'alloy', 'spokes': 10}}


def test_a_change_of_one_side_leaves_the_other_that_was_its_alias(tmp_path: Path) -> None:
    found = variant('<<: base.yaml\nleft: {window: 0}\n', tmp_path)
    assert found['left'] == {'door': 2, 'window': 0}
    assert found['right'] == {'door': 2, 'window': 1}


@pytest.mark.parametrize(
    ('text', 'sentence'),
    [
        ('<<: {count: 3}', r'mine.yaml:1: << = \{count: 3\}: must be the name of a file, without quotes'),
        ("<<: 'base.yaml'", r"mine.yaml:1: << = 'base.yaml': must be the name of a file, without quotes"),
        ('<<: base.yaml\n<<: base.yaml', r'mine.yaml:2: <<: the key is given twice'),
        ('<<: bas.yaml', r"mine.yaml:1: << = bas.yaml: no such file; did you mean 'base.yaml'\?"),
        ('<<: list.yaml', r'list.yaml:1: << = \[1, 2\]: must be a file of keys and values'),
        ('<<: itself.yaml', r'itself.yaml:1: << = itself.yaml: the file includes itself'),
    ],
)
def test_what_no_variant_can_be_made_of_is_refused_in_one_sentence(text: str, sentence: str, tmp_path: Path) -> None:
    (tmp_path / 'list.yaml').write_text('[1, 2]')
    (tmp_path / 'itself.yaml').write_text('<<: itself.yaml')
    with pytest.raises(SceneError, match=sentence):
        variant(text, tmp_path)


def test_a_car_that_takes_another_and_a_scene_that_takes_a_scene(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same scene as by --set; a key that there is not is refused with the place where it was written."""
    (tmp_path / 'mine.yaml').write_text('<<: vehicles/compact_fwd.yaml\nchassis: {mass: 1010}\n')
    scene = tmp_path / 'scene.yaml'
    scene.write_text('<<: scenes/car_step_steer.yaml\nvehicle: mine.yaml\nduration: 2\n')
    one, other = (
        load_scene(scene),
        load_scene('car_step_steer', ['vehicle=vehicles/compact_fwd.yaml', 'vehicle.chassis.mass=1010']),
    )
    assert one.duration == 2.0
    assert yaml.safe_load(one.resolved)['vehicle'] == yaml.safe_load(other.resolved)['vehicle']
    assert main(['info', str(tmp_path / 'mine.yaml'), '--json']) == 0
    assert json.loads(capsys.readouterr().out)['status'] == 'ok'
    page = (Path(__file__).parents[2] / 'docs' / 'vehicle.md').read_text(encoding='utf-8')
    shown = re.search(r'```yaml\n(<<: .*?)```', page, re.DOTALL)
    assert shown
    (tmp_path / 'mine.yaml').write_text(shown[1])
    front = yaml.safe_load(load_scene(scene).resolved)['vehicle']['axles']['front']['suspension']
    assert (front['kind'], front['strut']['spring']) == ('macpherson', {'rate': 28000, 'load': 3750})
    (tmp_path / 'mine.yaml').write_text('<<: vehicles/compact_fwd.yaml\nchassis: {\n  mas: 1010}\n')
    with pytest.raises(SceneError, match=r"mine.yaml:3: vehicle.chassis.mas: unknown key; did you mean 'mass'"):
        load_scene(scene)
