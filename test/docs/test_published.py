"""Published figures know what they depend on: what is older is named, and what was changed by hand is an error."""

from __future__ import annotations

import importlib.util
import re
import shutil
import sys
from pathlib import Path
from types import ModuleType

import pytest

from mbd_sim_ros.lab.studies import STUDIES
from mbd_sim_ros.lab.studies.slider_crank_claims import CONFIRMED, IN_PART, NOT_REPRODUCED, Claim, Part

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope='module')
def published() -> ModuleType:
    spec = importlib.util.spec_from_file_location('published', ROOT / 'docs' / 'tools' / 'published.py')
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules['published'] = module
    spec.loader.exec_module(module)
    return module


def test_a_product_depends_on_what_its_programs_import_at_any_depth(published) -> None:
    found = {path.relative_to(ROOT).as_posix() for path in published.sources(published.PRODUCTS['slider_crank'])}
    assert {
        'solver/step/iteration.py',
        'solver/levels/kc.py',  # imported by its name
        'mbd_sim_ros/lab/studies/slider_crank_claims.py',
        'config/mechanisms/slider_crank.yaml',
    } <= found
    assert not any(path.startswith(('mbd_sim_ros/commands', 'mbd_sim_ros/node', 'test')) for path in found)


def test_an_edit_makes_older_what_depends_on_it_and_nothing_else(published, monkeypatch) -> None:
    """An edit of a file of studies; the cars have nothing to do with it."""
    noted = {name: {'sources': published.digest(product)} for name, product in published.PRODUCTS.items()}
    assert published.older(noted) == []
    edited, plain = ROOT / 'mbd_sim_ros' / 'lab' / 'studies' / 'crank_history.py', published._digest_of
    monkeypatch.setattr(published, '_digest_of', lambda file: b'edited' if file == edited else plain(file))
    assert published.older(noted) == ['slider_crank', 'work_precision']  # the other one that runs the crank by it
    assert published.older({}) == list(published.PRODUCTS)


def test_what_was_changed_by_hand_is_named(published, monkeypatch, tmp_path, capsys) -> None:
    docs = tmp_path / 'docs'
    (docs / 'pictures').mkdir(parents=True)
    shutil.copy(ROOT / 'docs' / 'studies.md', docs)
    shutil.copy(ROOT / 'docs' / 'pictures' / 'slider_crank_figure_1.png', docs / 'pictures')
    shutil.copy(ROOT / 'docs' / 'pictures' / 'slider_crank_phases_phases.png', docs / 'pictures')
    monkeypatch.setattr(published, 'DOCS', docs)
    product = published.PRODUCTS['slider_crank']
    holds = published.held(product)
    assert set(holds) == {
        'studies.md: slider_crank',
        'studies.md: slider_crank: What becomes of the claims of the chapter',
        'pictures/slider_crank_figure_1.png',
    }
    noted = {'slider_crank': {'sources': published.digest(product), 'holds': holds}}
    assert list(published.changed_by_hand(noted)) == []
    text = (docs / 'studies.md').read_text()
    (docs / 'studies.md').write_text(text.replace('Four bodies, 26 constraints', 'Four bodies, 27 constraints'))
    (docs / 'pictures' / 'slider_crank_figure_1.png').write_bytes(b'drawn by hand')
    monkeypatch.setattr(published, 'manifest', lambda: noted)
    assert published.check() == 1
    told = capsys.readouterr().out
    assert (
        'docs/pictures/slider_crank_figure_1.png: changed by hand' in told
        and 'docs/studies.md: slider_crank: changed' in told
    )
    assert f'older than their sources, {len(published.PRODUCTS) - 1} of' in told


def test_every_study_and_every_picture_is_a_product(published) -> None:
    pictures = {
        place
        for product in published.PRODUCTS.values()
        for place in published.held(product)
        if place.startswith('pictures/')
    }
    assert pictures == {f'pictures/{file.name}' for file in (ROOT / 'docs' / 'pictures').iterdir()}
    patterns = [product.parts for product in published.PRODUCTS.values() if product.parts]
    for page in sorted((ROOT / 'docs').glob('*.md')):
        for match in published.HELD.finditer(page.read_text(encoding='utf-8')):
            if match['name'].split(':')[0] in STUDIES or match['name'].startswith('bench'):
                assert any(re.fullmatch(pattern, match['name']) for pattern in patterns), (
                    f'{page.name}: {match["name"]}'
                )
    assert published.held(published.PRODUCTS['bench']).keys() == {'performance.md: bench'}


@pytest.mark.parametrize(
    ('parts', 'verdict'),
    [
        ((True, True), CONFIRMED),
        ((True, False), IN_PART),
        ((False, True), NOT_REPRODUCED),
        ((False, False), NOT_REPRODUCED),
        ((True,), CONFIRMED),
    ],
)
def test_the_verdict_of_a_claim_follows_from_its_parts_by_one_rule(parts, verdict) -> None:
    claim = Claim('it is so', tuple(Part(f'part {k}', holds) for k, holds in enumerate(parts)), '1 and 2')
    assert claim.row()['verdict'] == verdict
    assert claim.row()['parts'].count('NO') == parts.count(False)


def test_a_page_is_not_made_anew_without_the_programs_that_it_compares_with(published, monkeypatch, capsys) -> None:
    monkeypatch.setenv('MBD_EXUDYN_PYTHON', '/nowhere/python')
    monkeypatch.setenv('MBD_MUJOCO_PYTHON', '/nowhere/python')
    monkeypatch.setattr(published, '_run', lambda command: pytest.fail(f'{command} was run'))
    assert published.make(['work_precision']) == 1
    said = capsys.readouterr().out
    assert 'exudyn and mujoco cannot be imported' in said and 'MBD_MUJOCO_PYTHON' in said
