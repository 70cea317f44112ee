"""What there is by name, and the line that says what it is: the title, or the first sentence of the comment at the head
of a file."""

from __future__ import annotations

from pathlib import Path

import pytest

from solver.files import catalogue
from solver.files.scene import find_file, known_names


@pytest.mark.parametrize(
    ('text', 'says'),
    [
        ('title: A car\nvehicle: x\n', 'A car'),
        ("# A comment.\ntitle: 'It''s: a car'  # not this\n", "It's: a car"),
        ('\ufefftitle: With a mark\r\nvehicle: x\r\n', 'With a mark'),
        (
            '# First sentence, over\n# two lines. Second one.\n#\n# Third.\nkind: car\n',
            'First sentence, over two lines',
        ),
        (
            '# yaml-language-server: $schema=https://x/y.json\n# SPDX-License-Identifier: MIT\n\n# Mine. More.\nkind: '
            'car\n',
            'Mine',
        ),
        ('%YAML 1.2\n---\n# Below the head.\nkind: car\n', 'Below the head'),
        ('#####\n# -----\n# Ruled.\nkind: car\n', 'Ruled'),
        ('# 1.5 m wide, e.g. this one (docs/x.md).\nkind: car\n', '1.5 m wide, e.g. this one (docs/x.md)'),
        ('kind: car\n# Not at the head.\n', ''),
        ('vehicle:\n  title: of something else\n', ''),
        ('title: {a: 1}\n', ''),
        ('title: [unclosed\n', '[unclosed'),
        ('', ''),
        ('\0\1\2\n', ''),
    ],
)
def test_a_file_says_what_it_is(text: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / 'file.yaml'
    file.write_bytes(text.encode())
    assert catalogue.described(file) == says


@pytest.mark.parametrize(
    ('text', 'says'),
    [
        ('! A slick. Not measured.\n[UNITS]\n', 'A slick'),
        (
            "$------------MDI_HEADER\n[MDI_HEADER]\nFILE_TYPE = 'tir'\n! : TIRE_VERSION : PAC2002\n! : COMMENT : Tire "
            '235/60 R16\n',
            'Tire 235/60 R16',
        ),
        ("[MDI_HEADER]\nFILE_TYPE = 'tir'\n", ''),
    ],
)
def test_a_tire_file_says_what_it_is(text: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / 'file.tir'
    file.write_text(text)
    assert catalogue.described(file) == says


def test_every_delivered_file_says_what_it_is() -> None:
    for kind in catalogue.KINDS:
        found = catalogue.entries(kind)
        assert found and all(entry.text and not entry.text.endswith('.') for entry in found), kind
    assert [entry.name for entry in catalogue.entries('scenes')] == known_names()


def test_of_two_files_with_one_name_the_one_that_is_loaded_is_listed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Files of the current directory come first, those below config/ before those beside it; what cannot be loaded is
    no scene."""
    monkeypatch.chdir(tmp_path)
    for folder, text in (('config/scenes', '# Mine, below config.\n'), ('scenes', '# Mine, beside.\n')):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / 'pendulum.yaml').write_text(text)
    (tmp_path / 'scenes' / 'other.yaml').write_text('title: Another one\n')
    (tmp_path / 'scenes' / 'folder.yaml').mkdir()
    (tmp_path / 'scenes' / 'broken.yaml').symlink_to('nowhere')
    found = {entry.name: entry for entry in catalogue.entries('scenes')}
    assert found['pendulum'].text == 'Mine, below config' and found['pendulum'].include == 'scenes/pendulum.yaml'
    assert found['other'].text == 'Another one'
    assert 'car_step_steer' in found and not found.keys() & {'folder', 'broken'}
    for name in ('pendulum', 'other', 'car_step_steer'):
        assert found[name].file == find_file(name, 'scenes')


def test_a_file_that_cannot_be_read_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / 'file.yaml'
    file.write_text('title: x\n')

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, 'Permission denied')

    monkeypatch.setattr(Path, 'open', refuse)
    assert catalogue.described(file) == 'cannot be read: Permission denied'
