"""What a plan has measured is no reason to suspect its run; what is worse, new or broken is."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

import solver
import solver.files.scene
from mbd_sim_ros.commands.run import rows_of
from solver.analysis.certificate_coverage import certified_of, covers, is_broken, is_of_scene, weighed
from solver.analysis.envelope import Envelope
from solver.analysis.verdict import findings
from solver.checks.registry import CHECKS
from solver.findings import Finding
from solver.levels import auto
from solver.levels.auto import chosen
from solver.scene import Scene
from solver.simulation import Simulation

COARSE = [check.name for check in CHECKS if check.plan == 'coarse']
OF_SCENE = [check.name for check in CHECKS if check.plan == 'scene']
# s: too long for the steering wheel, which swings on its column, and for the rack too: the numerical damping of
# rho_inf = 0 delays vibrations five times as much as that of 0.8
H = 0.02
PLAN: dict[str, Any] = {
    'status': 'ok', 'hash': 'abc', 'fidelity': 'full', 'envelope': [],
    'settings': {'switches': {}, 'integrator': {'h': H, 'rho_inf': 0.0, 'mode': 'fixed', 'iterations': 2}},
}  # fmt: skip
SCENE = ['duration=0.4', 'maneuver.steering.start=0.1', 'require={yaw_rate: {rms: 5 %}}']


def finding(
    quantity: str = 'turn_per_step', value: float = 1.3, where: str = '', *, limit: float = 1.0, required: bool = False
) -> Finding:
    text = f'A body turns too far in a step ({quantity} {value:.3g} rad, limit {limit:g} rad). Reduce integrator.h'
    return Finding(
        quantity=quantity, value=value, limit=limit, unit='rad', time=0.0, where=where, required=required, text=text
    )


def run(scene: Scene) -> Simulation:
    simulation = solver.simulation_of(scene)
    simulation.advance(simulation.scene.steps)
    return simulation


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Scene]:
    """Loads the scene with fidelity auto, a plan with these findings being kept for it."""
    monkeypatch.setattr(auto, 'location', lambda: tmp_path)

    def load(found: list[Finding]) -> Scene:
        scene = solver.load_scene('light_car_step_steer', [*SCENE, 'fidelity=auto'])
        auto.keep(scene, {**PLAN, 'findings': [asdict(one) for one in certified_of(found)]})
        return scene

    return load


@pytest.mark.slow
def test_what_the_certified_runs_had_is_noted_and_what_they_had_not_is_suspect(kept: Callable[..., Scene]) -> None:
    alone = findings(run(chosen(kept([]), PLAN)))
    assert [(one.where, one.of) for one in alone] == [
        ("body 'rack'", 'translation'),
        ("body 'steering_wheel'", 'rotation'),
    ]
    assert {one.quantity for one in alone} <= set(COARSE)
    for scene in (kept(alone), solver.files.scene.load_scene_text(chosen(kept(alone), PLAN).resolved, 'scene.yaml')):
        simulation = run(scene)
        suspect, covered, _ = weighed(simulation, Envelope(simulation))
        assert suspect == []
        assert covered == alone
    for one in alone:
        others = [other for other in alone if other is not one]
        assert weighed(run(kept(others)))[:2] == ([one], others)


@pytest.mark.slow
def test_an_older_plan_covers_nothing_of_what_is_measured_anew(kept: Callable[..., Scene]) -> None:
    from solver.trade.setting import Setting

    alone = findings(run(chosen(kept([]), PLAN)))
    scene = kept([dataclasses.replace(one, value=2.0 * one.value) for one in alone])
    assert weighed(run(scene))[:2] == ([], alone)
    setting = Setting(h=H, iterations=2, rho_inf=0.0)
    assert setting.keys()['integrator'] == PLAN['settings']['integrator']
    assert weighed(run(setting.of(dataclasses.replace(scene, fidelity='full'))))[:2] == (alone, [])


@pytest.mark.parametrize(
    ('later', 'covered'),
    [
        (finding(value=1.2), True),
        (finding(value=1.42), True),  # less than a tenth more
        (finding(value=1.44), False),
        (finding(value=1.3, where="body 'other'"), True),  # of four wheels it is now one, now another that turns most
        (finding('resolution', 1.3), False),
        (finding(value=1.3, required=True), False),
    ],
)
def test_a_finding_is_covered_up_to_a_tenth_more_than_it_was(later: Finding, covered: bool) -> None:
    (certified,) = certified_of([finding(value=1.1), finding(value=1.3)])
    assert covers(certified, later) == covered


def test_places_and_sides_count() -> None:
    (certified,) = certified_of([finding('resolution', 0.6, "body 'a'", limit=0.4)])
    assert covers(certified, finding('resolution', 0.6, "body 'a'", limit=0.4))
    assert not covers(certified, finding('resolution', 0.5, "body 'b'", limit=0.4))
    (low,) = certified_of([finding('envelope', -3.0, 'slip', limit=-2.0)])  # beyond the lower end: worse is less
    assert covers(low, finding('envelope', -2.5, 'slip', limit=-2.0))
    assert covers(low, finding('envelope', -3.2, 'slip', limit=-2.0))
    assert not covers(low, finding('envelope', -3.4, 'slip', limit=-2.0))
    assert not covers(low, finding('envelope', 2.1, 'slip', limit=2.0))  # beyond the upper end nothing was measured


def test_both_ends_of_a_range_are_certified_each_by_itself() -> None:
    left, right = finding('envelope', 10.0, 'slip', limit=9.0), finding('envelope', -9.5, 'slip', limit=-9.0)
    assert [one.value for one in certified_of([left, right, finding('envelope', 9.5, 'slip', limit=9.0)])] == [
        10.0,
        -9.5,
    ]
    (certified,) = certified_of([left])
    assert covers(certified, left)
    assert not covers(certified, right)


@pytest.mark.parametrize(
    'quantity', ['energy_error_max', 'residual_max', 'unsettled', 'position_drift_max', 'branch_switches', 'input']
)
def test_what_is_broken_is_never_covered_and_forbids_a_setting(quantity: str) -> None:
    assert certified_of([finding(quantity)]) == ()
    assert is_broken(finding(quantity))
    assert not any(is_broken(finding(name)) for name in (*COARSE, *OF_SCENE))
    assert all(is_broken(finding(name, required=True)) for name in COARSE)
    assert [name for name in (*COARSE, *OF_SCENE) if is_of_scene(finding(name))] == OF_SCENE


def test_what_is_covered_is_told_with_its_numbers_and_without_a_remedy() -> None:
    one = finding(value=1.3)
    told = {'findings': [], 'explaining': [], 'error_text': '', 'reactions_text': ''}
    data = {
        'status': 'ok',
        'rejected': 0,
        'out': None,
        **told,
        'accuracy': {'required': ['yaw_rate'], 'certificate': 'abc'},
    }
    (note,) = [text for name, text in rows_of(data, 'as placed', [asdict(one)]) if name == 'note']
    said = (
        'A body turns too far in a step (turn_per_step 1.3 rad, limit 1 rad): covered by the certificate, whose '
        'plan has measured'
    )
    assert note.removeprefix('note').strip() == f'{said} the effect on yaw_rate'
