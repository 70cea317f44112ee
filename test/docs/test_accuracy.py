"""docs/accuracy.md is drawn from the rows of studies: what it concludes follows from them."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]


def tool() -> ModuleType:
    spec = importlib.util.spec_from_file_location('accuracy', ROOT / 'docs' / 'tools' / 'accuracy.py')
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def row(level: str, h: float, cost: float | None, yaw: float, off: str = '', failure: str = '') -> dict:
    parts = {'rms_share': 0.9 * yaw, 'model_share': 0.5 * yaw, 'step_share': 0.3 * yaw, 'iteration_share': 0.2 * yaw}
    errors = {'yaw_rate': {**parts, 'max': yaw}, 'position': {**parts, 'max': 10.0 * yaw}} if not failure else {}
    return {
        'setting': f'{level} {off} {h}', 'level': level, 'off': off, 'h': h, 'iterations': 2, 'rho_inf': 0.8,
        'errors': errors,
        'failure': failure, **({} if cost is None else {'cost_median': cost}),
    }  # fmt: skip


def test_the_rule_names_the_cheapest_that_keeps_each_wish_on_every_scene(tmp_path, monkeypatch) -> None:
    module = tool()
    monkeypatch.setattr(module, 'PICTURES', tmp_path / 'pictures')
    first = [
        row('full', 1e-3, 0.1, 1e-6),
        row('kc', 5e-3, 0.002, 8e-3),
        row('full', 4e-3, 0.03, 4e-4),
        row('full', 4e-3, 0.02, 2e-2, off='drag'),
    ]
    second = [
        row('full', 1e-3, 0.2, 1e-6),
        row('kc', 5e-3, 0.004, 2e-2),
        row('condensed', 2e-3, 0.05, 5e-3),
        row('full', 8e-3, None, 1.0, failure='no'),
    ]
    for name, rows in (('one', first), ('two', second)):
        (tmp_path / name).mkdir()
        (tmp_path / name / 'trade.json').write_text(json.dumps({'rows': rows, 'duration': 5.0}))
    text = module.write(tmp_path)
    assert '**yaw rate within 5 %**: `kc` at 5 ms, for 2 % of what' in text
    assert '**yaw rate within 1 %**: `condensed` or `kc` at 2 to 5 ms, for 2 to 25 % of what' in text
    assert '**lateral velocity within 1 %**: no setting of the grid reaches it on `one`, `two`' in text
    assert '1 of 4 settings failed' in text
    assert '| full | drag | 33 % | yaw_rate | 1.8 % |' in text


def test_without_studies_it_says_what_to_do(tmp_path) -> None:
    with pytest.raises(SystemExit, match='mbd study trade SCENE'):
        tool().write(tmp_path)
