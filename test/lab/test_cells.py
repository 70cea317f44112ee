"""What a study keeps survives a kill at any instant, a full disk and damage: at most the cell in progress is computed again."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mbd_sim_ros.lab.studies import work_precision
from mbd_sim_ros.lab.studies.cells import Cells, replace_text


def filled(file: Path, *names: str) -> list[str]:
    """Open the cells of a study that needs these; the ones that were computed."""
    computed = []
    with Cells(file) as cells:
        for name in names:

            def compute(name: str = name) -> dict[str, str]:
                computed.append(name)
                return {'value': name}

            assert cells.cell(name, compute)['value'] == name
    return computed


def test_cells_survive_a_line_that_is_not_whole_and_bytes_that_are_no_text(tmp_path: Path) -> None:
    file = tmp_path / 'cells.jsonl'
    assert filled(file, 'a', 'b') == ['a', 'b']
    file.write_bytes(file.read_bytes() + b'{"cell": "c", "val')
    assert filled(file, 'a', 'b', 'c') == ['c']
    lines = file.read_bytes().split(b'\n')
    lines[2] = b'\xff\xfe' + lines[2][2:]
    file.write_bytes(b'\n'.join(lines))
    assert filled(file, 'a', 'b', 'c') == ['b']


def test_a_study_that_cannot_begin_its_file_anew_keeps_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk that is full, or a kill, while the cells that are kept are written again."""
    file = tmp_path / 'cells.jsonl'
    filled(file, 'a', 'b')
    before = file.read_bytes()

    def full(path: Path, text: str, **_: object) -> int:
        path.write_bytes(text.encode()[:20])
        raise OSError(28, 'No space left on device', str(path))

    with monkeypatch.context() as patch, pytest.raises(OSError, match='No space left'):
        patch.setattr(Path, 'write_text', full)
        Cells(file)
    assert file.read_bytes() == before and list(tmp_path.iterdir()) == [file]
    assert filled(file, 'a', 'b') == []


@pytest.mark.parametrize('text', ['', '{"points": [', '[]', '{"points": []}', '\udcff'])
def test_a_kept_problem_that_is_damaged_is_solved_again(text: str, tmp_path: Path) -> None:
    file = tmp_path / 'problem.json'
    file.write_bytes(text.encode('utf-8', 'surrogateescape'))
    assert work_precision._kept(file) is None
    assert work_precision._kept(tmp_path / 'none') is None
    replace_text(file, json.dumps({'points': [], 'notes': [], 'estimate': 1.0}))
    assert work_precision._kept(file) == {'points': [], 'notes': [], 'estimate': 1.0}
