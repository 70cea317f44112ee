"""mbd study trade SCENE: every setting is a row with its errors by origin, failures too; what is kept is not computed
again."""

from __future__ import annotations

import csv
import json
import math

import pytest

from mbd_sim_ros.commands.main import main
from mbd_sim_ros.lab.studies import trade

SCENE = ['light_car_step_steer', '--set', 'duration=0.6', '--set', 'maneuver.steering.start=0.1']


@pytest.mark.slow
@pytest.mark.long
def test_a_quick_trade_has_all_rows_marks_its_front_and_can_be_resumed(capsys, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(trade, 'LEVELS', {})  # deriving the others takes longer than everything else here
    argv = ['study', 'trade', *SCENE, '--quick', '--workers', '1', '--out', str(tmp_path), '--json']
    assert main(argv) == 0
    data = json.loads(capsys.readouterr().out)
    assert data['missed'] == []
    rows = data['rows']
    assert len(rows) == len({row['setting'] for row in rows}) >= 8
    good = {row['setting']: row for row in rows if not row['failure']}
    for row in good.values():
        assert row['cost_p99'] >= row['cost_median'] > 0.0
        assert row['counters']['evaluations'] > 1.0
        for errors in row['errors'].values():
            assert (errors['model_share'] == 0.0) or 'without' in row['setting']
            assert (
                errors['rms_share'] <= 1.001 * sum(errors[f'{o}_share'] for o in ('model', 'step', 'iteration')) + 1e-9
            )
            assert errors['rms'] <= errors['max']
    # the square of the step
    step = {h: good[f'full, {h} ms, 3 iterations, rho 0.8']['errors']['yaw_rate']['step_share'] for h in (4, 8)}
    assert 3.0 < step[8] / step[4] < 6.0
    assert {'report.md', 'cost.png', 'steps.png', 'origins.png', 'trade.json', 'settings.csv', 'errors.csv'} <= {
        f.name for f in tmp_path.iterdir()
    }
    with (tmp_path / 'errors.csv').open() as file:
        assert len(list(csv.DictReader(file))) == sum(len(row['errors']) for row in rows)
    monkeypatch.setattr(trade, 'row_of', lambda bench, setting: pytest.fail('computed again'))
    monkeypatch.setattr(trade, 'cost_of', lambda scene, setting, seconds: pytest.fail('measured again'))
    assert main(argv) == 0
    assert json.loads(capsys.readouterr().out)['rows'] == rows


def test_the_front_holds_what_nothing_beats() -> None:
    def row(cost: float, error: float | None, failure: str = '') -> dict:
        return {'cost_median': cost, 'errors': {'yaw_rate': {'rms_share': error}}, 'failure': failure}

    rows = [row(1.0, 0.1), row(2.0, 0.05), row(2.0, 0.2), row(3.0, 0.05), row(0.1, None), row(0.1, 0.0, 'failed')]
    trade.mark_front(rows)
    assert [r['front'] for r in rows] == [True, True, False, False, False, False]
    assert math.isinf(trade.judged(rows[4], ['yaw_rate']))


def test_a_study_of_a_scene_needs_one_and_the_others_take_none(capsys, tmp_path) -> None:
    assert main(['study', 'trade']) == 2
    assert 'the scene is missing' in capsys.readouterr().err
    assert main(['study', 'penalty_map', 'light_car_step_steer', '--out', str(tmp_path / 'new')]) == 2
    assert 'takes no scene' in capsys.readouterr().err
    assert not (tmp_path / 'new').exists()
