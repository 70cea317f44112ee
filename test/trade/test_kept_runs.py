"""Runs of a plan that is not finished are kept on disk, and the next one goes on from them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import solver
from solver.findings import Finding
from solver.trade import bench, cost
from solver.trade.certificate import plan
from solver.trade.cost import PerStep
from solver.trade.kept_runs import KeptRuns
from solver.trade.runs import Run
from solver.trade.search import Search
from solver.trade.setting import Setting
from solver.trade.variations import AS_GIVEN, Variation

NAMES = ['yaw_rate', 'tire_force.front_left.y']
FAST = Setting(h=5e-3, iterations=1)
FINDING = Finding(
    quantity='phase', value=0.2, limit=0.1, unit='rad', time=None, where='chassis', required=False, text='it is off'
)


def a_run() -> Run:
    curves = {'yaw_rate': np.array([[0.1], [1.0 / 3.0]]), 'tire_force.front_left.y': np.array([[np.pi], [-0.0]])}
    return Run(FAST, np.array([0.0, 5e-3]), curves, {'steps': 1.0, 'evaluations': 2.5}, '')


def test_a_run_comes_back_with_its_bits_and_what_makes_it_suspect(tmp_path: Path) -> None:
    kept = KeptRuns(tmp_path / 'runs', 'scene', NAMES)
    assert kept.get(AS_GIVEN, FAST) is None
    kept.put(AS_GIVEN, FAST, a_run())
    kept.put(AS_GIVEN, FAST, a_run(), [FINDING])
    found = kept.get(AS_GIVEN, FAST)
    assert found is not None and found[1] == ()
    assert (found[0].setting, found[0].counters, found[0].failure) == (FAST, a_run().counters, '')
    for name, values in a_run().curves.items():
        assert found[0].curves[name].tobytes() == values.tobytes()
    judged = kept.get(AS_GIVEN, FAST, judged=True)
    assert judged is not None and judged[1] == (FINDING,)
    assert kept.found == 2


def test_another_maneuver_setting_scene_or_quantity_is_another_run(tmp_path: Path) -> None:
    kept = KeptRuns(tmp_path, 'scene', NAMES)
    kept.put(AS_GIVEN, FAST, a_run())
    assert kept.get(Variation(speed=0.9), FAST) is None
    assert kept.get(AS_GIVEN, Setting(h=5e-3, iterations=1, off=('drag',))) is None
    assert kept.get(AS_GIVEN, FAST, judged=True) is None
    assert KeptRuns(tmp_path, 'another scene', NAMES).get(AS_GIVEN, FAST) is None
    assert KeptRuns(tmp_path, 'scene', [*NAMES, 'roll']).get(AS_GIVEN, FAST) is None
    assert KeptRuns(tmp_path, 'scene', NAMES[::-1]).get(AS_GIVEN, FAST) is not None


@pytest.mark.parametrize('damage', ['cut', 'flipped', 'other'])
def test_a_file_that_cannot_be_read_is_as_good_as_none(tmp_path: Path, damage: str) -> None:
    kept = KeptRuns(tmp_path, 'scene', NAMES)
    kept.put(AS_GIVEN, FAST, a_run())
    (file,) = tmp_path.glob('*.npz')
    content = bytearray(file.read_bytes())
    at = content.find(np.float64(np.pi).tobytes())
    content[at] ^= 1
    file.write_bytes({'cut': content[: len(content) // 2], 'flipped': content, 'other': b'no archive'}[damage])
    assert kept.get(AS_GIVEN, FAST) is None


def test_where_nothing_can_be_written_every_run_is_made(tmp_path: Path) -> None:
    (tmp_path / 'runs').write_text('a file where the directory should be')
    for directory in (None, tmp_path / 'runs'):
        kept = KeptRuns(directory, 'scene', NAMES)
        kept.put(AS_GIVEN, FAST, a_run())
        assert kept.get(AS_GIVEN, FAST) is None and kept.found == 0


def test_an_interrupted_plan_goes_on_and_ends_as_one_that_was_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    price = PerStep(14e-6, 5e-6, 1.0, 3.0)  # as it was measured once: two measurements might order settings differently
    monkeypatch.setattr(cost, 'per_step', lambda scene, setting, **_: price)
    scene = solver.load_scene('spring_mass', ['duration=0.3', 'require={joint_states/guide/position: {rms: 5 %}}'])
    settings = {'unseen': 2, 'workers': 1, 'longest': 600.0, 'levels': ()}

    def interrupt(text: str, done: float) -> None:
        if text.startswith('checking'):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        plan(Search(scene, **settings, progress=interrupt, keep_in=tmp_path))
    there, made = {file.name for file in tmp_path.iterdir()}, []
    plain = bench.run
    monkeypatch.setattr(
        bench, 'run', lambda scene, *given, **more: made.append(given[0]) or plain(scene, *given, **more)
    )
    search = Search(scene, **settings, keep_in=tmp_path)
    data = plan(search)
    assert search.kept.found >= len(there) > 10
    again, made = made, []
    anew = plan(Search(scene, **settings))
    assert len(again) < len(made)
    for name in ('status', 'fidelity', 'settings', 'errors', 'unseen', 'reference', 'envelope'):
        assert data[name] == anew[name], name
