"""Errors of one run by origin, against the error bar of the same run and a closed form."""

from __future__ import annotations

import json
import math

import pytest

from mbd_sim_ros.commands.main import main
from solver import load_scene_text
from solver.errors import SpecError
from solver.trade.origins import origins_of

OSCILLATOR = """
mechanism:
  gravity: [0, 0, 0]
  bodies: {b: {mass: 1, inertia: [1, 1, 1]}}
  joints: {g: {kind: prismatic, i: world, j: b, at: [0, 0, 0], axis: [0, 0, 1]}}
  coordinate_forces: {s: {terms: [[g, 1]], spring: 400}}
start: {coordinates: {g: {value: 0.1}}}
duration: 2
"""


def test_the_step_of_an_oscillator_costs_its_phase_and_the_model_nothing() -> None:
    """Of the generalized-alpha scheme with rho_inf 1, the midpoint rule, a phase of (w h)^3 / 12 a step: t w^3 h^2 / 12
    in all."""
    scene = load_scene_text(OSCILLATOR, 'scene', ['integrator={h: 0.004, rho_inf: 1}'])
    (found,) = origins_of(scene).values()
    late = 2.0 * 20.0**3 * 0.004**2 / 12.0
    model, step, iteration, band = found.parts
    assert (found.unit, model) == ('m', 0.0)
    assert step == pytest.approx(0.1 * late, rel=0.03)
    assert found.whole == pytest.approx(step, rel=0.01)
    assert max(iteration, band) < 0.01 * step


@pytest.mark.parametrize(
    'setting', ['order: 4, rho_inf: 1', 'step_policy: error, mode: tolerance', 'kind: reference_kkt']
)
def test_settings_that_a_bench_does_not_have_are_refused(setting: str) -> None:
    with pytest.raises(SpecError, match='errors by origin are those of constant steps of second order'):
        origins_of(load_scene_text(OSCILLATOR, 'scene', [f'integrator={{h: 0.004, {setting}}}']))


def test_mbd_run_shows_them_beside_the_error_bar(tmp_path, capsys) -> None:
    path = tmp_path / 'scene.yaml'
    path.write_text(OSCILLATOR)
    assert main(['run', str(path), '--no-record', '--accuracy', '--json']) == 0
    data = json.loads(capsys.readouterr().out)
    (found,) = data['origins'].values()
    assert math.isclose(found['whole'], data['errors']['position']['value'], rel_tol=0.1)
    assert main(['run', str(path), '--no-record', '--accuracy']) == 0
    assert 'largest error' in capsys.readouterr().out
