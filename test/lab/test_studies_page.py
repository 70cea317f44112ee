"""docs/tools/studies.py: the page takes sections of reports, without their pictures, and leaves alone what has not been
run."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
REPORT = (
    '# Title\n\nabove\n\n## First\n\ntext\n\n![a caption](a.png)\n\n*a caption*\n\n| x |\n| --- |\n\n## '
    'Checks\n\nlast\n'
)


@pytest.fixture(scope='module')
def studies():
    spec = importlib.util.spec_from_file_location('studies_page', ROOT / 'docs' / 'tools' / 'studies.py')
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_part_is_a_section_without_pictures(studies, tmp_path):
    (tmp_path / 'some').mkdir()
    (tmp_path / 'some' / 'report.md').write_text(REPORT)
    document = (
        'a <!-- begin some: First -->\nold\n<!-- end --> b <!-- begin some -->\n<!-- end --> c <!-- begin '
        'other: X -->\nkept\n<!-- end -->'
    )
    expected = (
        'a <!-- begin some: First -->\ntext\n\n| x |\n| --- |\n<!-- end --> b <!-- begin some -->\nabove\n<!-- '
        'end --> c'
    )
    assert (
        studies.fill(document, tmp_path, ['some', 'other']) == expected + ' <!-- begin other: X -->\nkept\n<!-- end -->'
    )


def test_the_pages_show_small_pictures_that_are_there(studies):
    for file in studies.FILES:
        shown = studies.PICTURE.findall(file.read_text(encoding='utf-8'))
        assert shown or file.name == 'scene.md'  # it has a table of limits only
        for name in shown:
            picture = file.with_name('pictures') / name
            assert 1_000 < picture.stat().st_size < 150_000, name
