"""What a plan promises of `mbd run` is measured by the function that `mbd run` calls, with the same arguments."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from mbd_sim_ros import batch
from mbd_sim_ros.commands.main import main
from mbd_sim_ros.commands.plan import as_run
from solver import load_scene


def test_a_plan_times_its_scene_as_mbd_run_does(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    calls: list[tuple[Any, ...]] = []
    simulate = batch.simulate

    def counted(simulation: Any, steps: int, **options: Any) -> dict[str, Any]:
        recorded = options.get('directory') is not None
        calls.append((simulation.scene.name, steps, recorded, simulation.scene.record, options.get('source')))
        return simulate(simulation, steps, **options)

    monkeypatch.setattr(batch, 'simulate', counted)
    found = as_run(load_scene('pendulum', ['duration=0.05']))
    assert main(['run', 'pendulum', '--set', 'duration=0.05', '--out', str(tmp_path / 'run')]) in (0, 1)
    assert main(['run', 'pendulum', '--set', 'duration=0.05', '--no-record']) in (0, 1)
    assert calls[:2] == calls[2:]
    assert set(found) == {'recorded', 'unrecorded'}
    assert min(found.values()) > 0.0
