"""Speed against accuracy on one scene: runs of every way to simulate it (trade_grid.py), and their report (trade_report.py)."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from mbd_sim_ros.analysis.pages import write_text
from mbd_sim_ros.lab.studies import trade_report
from mbd_sim_ros.lab.studies.report import Report
from mbd_sim_ros.lab.studies.trade_grid import Grid
from solver.disk import plain
from solver.scene import Scene

SUMMARY = 'speed against accuracy of one SCENE: level, switches, step, iterations, damping, tolerance'
OF_SCENE = True  # study() takes scene and workers


def study(out: Path, *, quick: bool, progress: Callable[[str, float], None], scene: Scene, workers: int | None = None) -> dict:
    """See mbd_sim_ros.lab.studies. scene: what is simulated, its fidelity, switches and integrator apart. workers: runs at a time."""
    grid = Grid(scene, out, quick=quick, workers=workers, progress=progress)
    grid.run()
    report = Report(out, f'Speed against accuracy: {scene.title or scene.name}')
    data = trade_report.write(report, grid)
    write_text(out / 'trade.json', json.dumps(plain(data), indent=1, allow_nan=False) + '\n')
    return data
