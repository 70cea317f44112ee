"""Facts of pages: names and hashes of scene and vehicle, and the keys in which they differ from delivered files."""

from __future__ import annotations

from pathlib import Path

import pytest
from scalars import run

from mbd_sim_ros.analysis.provenance import facts_of_run, facts_of_runs, facts_of_scene
from solver import load_scene


def facts(name: str, *overrides: str) -> dict[str, str]:
    scene = load_scene(name, overrides)
    found = facts_of_scene(scene.resolved, scene.name)
    assert found[0] == ('scene', f'{scene.name}, hash {scene.hash}')  # as recordings and --json name it
    return dict(found)


def test_a_delivered_scene_has_no_changed_keys() -> None:
    found = facts('car_step_steer')
    assert found['changed keys'] == 'none' and found['vehicle'].startswith('full_car, hash ')
    assert 'changed keys of the vehicle' not in found
    assert 'vehicle' not in facts('pendulum')


@pytest.mark.parametrize(
    ('override', 'fact', 'said'),
    [
        ('integrator.h=0.002', 'changed keys', 'integrator.h: 0.001 \u2192 0.002'),
        ('integrator.h=1e-3', 'changed keys', 'none'),  # the same number
        ('record.every=5', 'changed keys', 'record'),
        ('vehicle.chassis.mass=1111', 'changed keys of the vehicle', 'chassis.mass: 1250 \u2192 1111'),
        ('vehicle.chassis.com[2]=0.61', 'changed keys of the vehicle', 'chassis.com[2]: 0.59 \u2192 0.61'),
        ('vehicle.front.wheel.toe_deg=0.2', 'changed keys of the vehicle', 'front.wheel.toe_deg: - \u2192 0.2'),
    ],
)
def test_changed_keys_are_named_with_both_values(override: str, fact: str, said: str) -> None:
    assert said in facts('light_car_step_steer', override)[fact]


def test_another_vehicle_has_its_own_name(tmp_path: Path) -> None:
    """The delivered file that is nearest: of a van that takes a compact car, the compact car."""
    found = facts('light_car_step_steer', 'vehicle=vehicles/compact_fwd.yaml')
    assert found['vehicle'].startswith('compact_fwd, hash ') and found['changed keys'] == 'none'
    van = tmp_path / 'van.yaml'
    van.write_text('<<: vehicles/compact_fwd.yaml\nchassis: {mass: 1100}\n')
    found = facts('light_car_step_steer', f'vehicle={van}')
    assert found['vehicle'].startswith('compact_fwd, changed, hash ')
    assert found['changed keys of the vehicle'] == 'chassis.mass: 965 \u2192 1100'


def test_a_car_is_the_same_wherever_the_program_is_started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Paths of tire files are told from the current directory; they are no change of the car, and not in its hash."""
    here = facts('car_step_steer')
    monkeypatch.chdir(tmp_path)
    there = facts('car_step_steer')
    assert there['vehicle'] == here['vehicle'] and there['changed keys'] == 'none'
    assert 'changed keys of the vehicle' not in there


def test_recordings_beside_each_other_say_in_which_keys_they_differ(tmp_path: Path) -> None:
    """Also of a car of one's own, which is near to no delivered one."""
    own = tmp_path / 'own.yaml'
    own.write_text(
        '<<: docs/examples/van.yaml\nchassis: {mass: 1410, com: [0.3, 0.01, 0.7], inertia: [600, 2900, 3000]}\n'
    )
    runs = []
    for overrides in ((), ('vehicle.axles.front.anti_roll_bar.stiffness=1200', 'integrator.h=0.002'), ()):
        runs.append(run(n=3, x=lambda t: t))
        scene = load_scene('car_step_steer', [f'vehicle={own}', *overrides])
        runs[-1].metadata.update(resolved_scene=scene.resolved, scene=scene.name)
    found = facts_of_runs([*runs, run(n=3, x=lambda t: t)], ['base', 'stiff', 'again', 'theirs.csv'])
    said = [text for name, text in found if name == 'differs from base']
    assert said == [
        'vehicle.axles.front.anti_roll_bar.stiffness: 900 \u2192 1200, integrator.h: 0.001 \u2192 0.002',
        'none',
    ]
    assert found[-1] == ('recording', 'theirs.csv')
    assert dict(found)['vehicle'].startswith('your own, of kind car, hash ')


def test_a_recording_of_others_has_the_facts_that_are_known() -> None:
    other = run(n=3, x=lambda t: t)
    assert facts_of_run(other, 'theirs.csv') == [('recording', 'theirs.csv')]
    other.metadata['resolved_scene'] = ': no yaml: ['
    assert facts_of_run(other, 'theirs.csv') == [('recording', 'theirs.csv')]
