"""Drive torque at the level kc where it acts between wheels and what carries them: motors in the hubs, the differential
of a live axle."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from live_axle_cars import off_roader
from live_axle_cars import scene as of_vehicle

from solver import simulation_of
from solver.analysis.kinematics_and_compliance import CORNERS
from solver.errors import SpecError
from solver.files.scene import load_scene_text
from solver.levels import derive
from solver.levels.kc import kc_model
from solver.scene import Scene

HUBS = tuple(f'vehicle.axles.{axle}.drive.on=upright' for axle in ('front', 'rear'))


def scene(*changes: str, vehicle: str, drive: float) -> Scene:
    text = (
        f'vehicle: vehicles/{vehicle}.yaml\nstart: {{kind: equilibrium, speed: 15}}\nintegrator: {{h: 0.002}}\n'
        f'maneuver: {{drive_torque: {{kind: step, value: {drive}, start: 0.1, rise: 0.3}}}}\n'
    )
    return load_scene_text(text, 'drive', changes)


def test_guides_carry_what_acts_on_carriers() -> None:
    """Motors in the hubs and the differential of a live axle do; half shafts from the chassis do not, nor do those
    behind a gearbox."""
    hubs = kc_model(scene(*HUBS, vehicle='electric_4wd', drive=0.0).model)
    assert [len(guide.drives) for guide in hubs.guides] == [2, 2]
    assert [guide.drives for guide in kc_model(scene(vehicle='electric_4wd', drive=0.0).model).guides] == [(), ()]
    front, rear = kc_model(scene(vehicle='pickup_awd', drive=0.0).model).guides
    assert (front.drives, rear.drives) == ((), ((0.5, 0.5, 0.6, 120.0),))


def test_carriers_that_two_inputs_drive_are_refused() -> None:
    """A guide has one input of its drives: the second would act by the first."""
    model = scene(*HUBS, vehicle='electric_4wd', drive=0.0).model
    forces = tuple(
        force.replace(input='boost') if force.name == 'motor_rear_left' else force for force in model.coordinate_forces
    )
    assert forces != model.coordinate_forces
    boosted = dataclasses.replace(model, coordinate_forces=forces, inputs=(*model.inputs, 'boost'))
    with pytest.raises(
        SpecError, match='wheels of the rear axle are driven from their carriers by several inputs; use full'
    ):
        kc_model(boosted)


def test_what_a_pinion_does_to_the_housing_of_a_live_axle_behind_a_gearbox_is_said() -> None:
    lost = derive(scene('fidelity=kc', vehicle='pickup_awd', drive=0.0)).report.lost
    assert not [text for text in lost if 'housing' in text or 'kingpins' in text]
    given = {'maneuver': {'signals': {'gear': 2}}, 'start': {'kind': 'equilibrium', 'speed': 8.0}, 'duration': 5.0}
    lost = derive(of_vehicle(off_roader(power=True), fidelity='kc', **given)).report.lost
    assert [text.partition(':')[0] for text in lost if 'housing' in text] == [
        f'what the drive torque of the {axle} axle does to its housing' for axle in ('front', 'rear')
    ]
    assert (
        sum('front axle turns its knuckles by about their kingpins' in text for text in lost)
        == sum('kingpins' in text for text in lost)
        == 1
    )


@pytest.mark.parametrize('level', ['condensed', 'kc'])
def test_what_half_shafts_at_an_angle_do_to_the_steering_is_said(level: str) -> None:
    """Of those in front alone: in a bend at 3 m/s^2 of drive 0.7 of the 4.8 N m at the steering wheel of the
    compact."""
    said = {
        vehicle: any(
            text.startswith('what the drive torque turns steered wheels by') for text in derive(given).report.lost
        )
        for vehicle in ('compact_fwd', 'full_car', 'light_car')
        if (given := scene(f'fidelity={level}', vehicle=vehicle, drive=0.0))
    }
    assert said == {'compact_fwd': True, 'full_car': False, 'light_car': False}


@pytest.mark.slow
@pytest.mark.parametrize(
    ('vehicle', 'changes', 'wheel'), [('light_car', (), 'wheel_front_left'), ('electric_4wd', HUBS, None)]
)
def test_efforts_of_driven_wheels_are_those_of_the_whole_vehicle_or_told(
    vehicle: str, changes: tuple[str, ...], wheel: str | None
) -> None:
    """Half of 600 N m at a front wheel that shafts drive, 0 in the whole vehicle; as there where motors in the hubs
    do."""
    given = [scene(*changes, f'fidelity={level}', vehicle=vehicle, drive=600.0) for level in ('full', 'kc')]
    shown = []
    for one in given:
        simulation = simulation_of(one)
        shot = simulation.advance(round(0.6 / simulation.h))
        shown.append(
            {
                name: float(shot.joint_effort[simulation.channels.joints.index(name)])
                for name in map('wheel_{}'.format, CORNERS)
            }
        )
    apart = {name for name, effort in shown[0].items() if abs(effort - shown[1][name]) > 1.0}
    assert (wheel in apart) == (wheel is not None)
    assert bool(apart) == any(text.startswith('efforts of shafts') for text in derive(given[1]).report.lost)
    if wheel is not None:
        assert (shown[0][wheel], shown[1][wheel]) == pytest.approx((0.0, 300.0), abs=1e-6)


def moved(given: Scene) -> np.ndarray:
    """(4,) what the travels of the wheels change within 1.4 s [m]."""
    simulation = simulation_of(given)
    at = [simulation.channels.joints.index(f'travel_{corner}') for corner in CORNERS]
    before = simulation.snapshot().joint_position[at]
    return simulation.advance(round(1.4 / simulation.h)).joint_position[at] - before


@pytest.mark.slow
@pytest.mark.parametrize(
    'vehicle',
    [
        pytest.param('motors in hubs', id='hubs'),  # against the chassis it would be 15 % off
        pytest.param('pickup_awd', id='leaf springs'),
        pytest.param('off_roader', id='links'),  # 20 %, and both sides alike
    ],
)
def test_it_lifts_and_squats_as_the_whole_vehicle(vehicle: str) -> None:
    """What travels change, within 3 % of the largest one."""

    def given(level: str) -> Scene:
        if vehicle == 'off_roader':
            push = {'drive_torque': {'kind': 'step', 'value': 1500.0, 'start': 0.1, 'rise': 0.3}}
            return of_vehicle(
                off_roader(), fidelity=level, start={'kind': 'equilibrium', 'speed': 15.0}, maneuver=push, duration=5.0
            )
        hubs = () if vehicle == 'pickup_awd' else HUBS
        return scene(f'fidelity={level}', *hubs, vehicle='electric_4wd' if hubs else vehicle, drive=1500.0)

    full, kc = moved(given('full')), moved(given('kc'))
    assert np.abs(kc - full).max() < 0.03 * np.abs(full).max()


@pytest.mark.slow
def test_energy_closes_with_second_order() -> None:
    errors = []
    for h in (2e-3, 1e-3):
        simulation = simulation_of(
            scene('fidelity=kc', f'integrator.h={h}', *HUBS, vehicle='electric_4wd', drive=3000.0)
        )
        simulation.advance(round(1.0 / h))
        errors.append(simulation.totals()['energy_error_max'])
    assert errors[0] / errors[1] > 3.0
