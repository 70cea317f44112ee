"""A merge key in quotes, as dumpers of YAML and JSON write it, is named; without the sentence two errors about other
keys misled."""

from __future__ import annotations

import pytest

from solver.errors import SceneError
from solver.files.scene import load_scene, load_scene_text


@pytest.mark.parametrize(
    ('text', 'line'),
    [
        ("'<<': scenes/light_car_straight.yaml\nduration: 1\n", 1),
        ('duration: 1\n"<<": scenes/light_car_straight.yaml\n', 2),
        ('{"<<": "scenes/light_car_straight.yaml", "duration": 1}', 1),
        ("duration: 1\nvehicle:\n  '<<': vehicles/light_car.yaml\n", 3),
    ],
)
def test_a_quoted_merge_key_is_named(text: str, line: int) -> None:
    with pytest.raises(
        SceneError, match=rf"scene:{line}: .*<<: the key '<<' is in quotes: write it, and the name of its file, without"
    ):
        load_scene_text(text)


def test_one_in_an_override_too_and_without_quotes_it_merges() -> None:
    with pytest.raises(SceneError, match='is in quotes'):
        load_scene('light_car_straight', ["vehicle={'<<': vehicles/light_car.yaml}"])
    assert load_scene_text('<<: scenes/light_car_straight.yaml\nduration: 1\n').duration == 1.0
