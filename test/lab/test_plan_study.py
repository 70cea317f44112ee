"""The study of the plans: a quick one is whole, goes on where it was, and finds nothing cheaper than what its plan has
found."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mbd_sim_ros.lab.studies import plan


@pytest.mark.long
@pytest.mark.slow
def test_a_quick_study_is_whole_and_goes_on_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = plan.study(tmp_path, quick=True, progress=lambda text, done: None)
    (row,) = found['plans']
    assert (row['status'], row['level'], row['passed'], row['failed']) == ('ok', 'full', 2, 0)
    assert row['h'] > 1e-3
    assert 1.0 <= row['dearer'] <= plan.DEAREST
    assert all(check['met'] for check in found['checks'])
    assert '| level cruise |' in (tmp_path / 'report.md').read_text()
    assert len(list((tmp_path / 'cells').iterdir())) == 1
    monkeypatch.setattr(plan, 'made', None)
    again = plan.study(tmp_path, quick=True, progress=lambda text, done: None)
    assert json.dumps(again) == json.dumps(found)


def test_every_scene_has_three_requirements() -> None:
    assert len(set(plan.WISHES)) == 18
    for scene in plan.SCENES:
        assert sum(wish.scene == scene for wish in plan.WISHES) == 3, scene
    assert {plan.HOP, plan.TURN, plan.TIGHT} <= set(plan.WISHES)
