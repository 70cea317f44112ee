"""Derived data on disk: the same value comes back, of the same subject only, and never from a damaged file."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from solver.disk import derived


class Maker:
    """Counts how often a value is made."""

    def __init__(self, value: object) -> None:
        self.value = value
        self.made = 0

    def __call__(self) -> object:
        self.made += 1
        return self.value


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv('MBD_CACHE_DIR', str(tmp_path))
    return tmp_path / 'levels'


def test_a_value_is_made_once_and_comes_back_with_the_same_bits(cache: Path) -> None:
    value = {'map': [[0.1, 1.0 / 3.0], [math.pi, 5e-324]], 'name': 'ä', 'count': 3, 'there': None}
    make = Maker(value)
    assert derived('maps', 'car', make) == value
    assert derived('maps', 'car', make) == value
    assert make.made == 1
    assert len(list(cache.iterdir())) == 1


def test_other_data_and_other_subjects_are_others() -> None:
    make = Maker(1.0)
    for what, subject in (('maps', 'car'), ('maps', 'other car'), ('axles', 'car')):
        derived(what, subject, make)
    assert make.made == 3


def test_fresh_and_kept_values_are_alike() -> None:
    """A tuple would be a list only the second time."""
    make = Maker((1, (2, 3)))
    assert derived('maps', 'car', make) == derived('maps', 'car', make) == [1, [2, 3]]


@pytest.mark.parametrize('damage', [b'', b'\xff\xfe', b'0\n[1]', b'[1]'])
def test_a_damaged_file_is_made_anew(cache: Path, damage: bytes) -> None:
    make = Maker([1.5])
    derived('maps', 'car', make)
    (file,) = cache.iterdir()
    file.write_bytes(damage)
    assert derived('maps', 'car', make) == [1.5]
    assert make.made == 2
    derived('maps', 'car', make)
    assert make.made == 2


def test_a_changed_number_in_a_file_is_noticed(cache: Path) -> None:
    make = Maker([1.5])
    derived('maps', 'car', make)
    (file,) = cache.iterdir()
    file.write_bytes(file.read_bytes().replace(b'1.5', b'2.5'))
    assert derived('maps', 'car', make) == [1.5]


def test_where_nothing_can_be_written_values_are_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocked = tmp_path / 'a file'
    blocked.write_text('')
    monkeypatch.setenv('MBD_CACHE_DIR', str(blocked))
    make = Maker(2)
    assert [derived('maps', 'car', make), derived('maps', 'car', make)] == [2, 2]
    assert make.made == 2


def test_what_is_no_number_is_not_kept() -> None:
    with pytest.raises(ValueError, match='JSON'):
        derived('maps', 'car', Maker([math.nan]))
