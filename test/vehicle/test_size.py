"""Froude similarity: a light car at s times its size is measured, and drives, as the light car does, with times and
speeds by s^(1/2).

What differs are floors that are not those of a car alone: a step of whole nanoseconds, the smallest force that an
iteration leaves, and speeds below which the contact of a tire is that of a standing one (SMALL_TIRE is no part of the
light car's). So what is driven agrees to 1e-5, what the bench finds to 1e-8, and only damping at rest, of the contact,
within a tenth.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import yaml
from similar import similar_car

import solver.analysis.figures
from mbd_sim_ros.commands import info
from solver import simulation_of
from solver.analysis.figures import Figures, all_figures, standing
from solver.errors import SpecError
from solver.files.scene import load_scene, load_scene_text
from solver.quantities import quantity
from solver.vehicle.size import Size, size_of

SCALES = (0.1, 0.03, 2.5)
EXPONENTS = {  # of the factor of lengths; what is not here is an angle, a share, or one of these per acceleration: 0
    'mass': 3.0, 'wheelbase': 1.0, 'inertia': 5.0, 'track_': 1.0, 'com_': 1.0, 'frequency': -0.5,
    'wheel_rate_': 2.0, 'roll_stiffness_': 4.0,
    'roll_center_': 1.0, 'bump_': -1.0, 'sag_': 1.0, 'response_time': 0.5,
}  # fmt: skip
# where the contact of standing tires counts
AT_REST = ('bounce_', 'pitch_', 'roll_frequency', 'roll_damping', 'wheel_hop_', 'sag_')
DRIVEN = ('understeer_gradient', 'roll_gradient', 'steering_sensitivity', 'response_time')


def exponent(name: str) -> float:
    """By what power of the lengths a figure grows."""
    return next((power for part, power in EXPONENTS.items() if part in name), 0.0)


def found(directory: Path, s: float) -> Figures:
    """All figures of the light car at s times its size."""
    return all_figures(
        standing(
            load_scene_text(
                f'vehicle: {similar_car(directory / f"{s:g}", s)}\nstart: {{kind: equilibrium}}\n', 'similar'
            )
        )
    )


@pytest.fixture(scope='module')
def original(tmp_path_factory: pytest.TempPathFactory) -> dict[str, float]:
    """Of the car itself, that none of which fails."""
    figures, failed = found(tmp_path_factory.mktemp('original'), 1.0)
    assert not failed
    return figures


@pytest.mark.slow
@pytest.mark.parametrize('s', SCALES)
def test_figures_of_a_similar_car_are_those_of_the_car(original, tmp_path, s):
    """Every one, by the exponent of its unit."""
    figures, failed = found(tmp_path, s)
    assert not failed and figures.keys() == original.keys()
    for name, value in figures.items():
        # zero by symmetry and by design, but for rounding and the tires' stiffness
        if name in ('com_y', 'sag_front', 'sag_rear'):
            assert abs(value) < 1e-3 * figures['wheelbase']
            continue
        if name.startswith(('toe_', 'camber_')):  # of wheels that stand: as nearly as these
            assert abs(value - original[name]) < 1e-4, name
            continue
        tolerance = 1e-5 if name in DRIVEN else (0.1 if name.startswith(AT_REST) else 1e-8)
        assert value / s ** exponent(name) == pytest.approx(original[name], rel=tolerance), name


def test_sizes_and_what_follows_from_them(tmp_path):
    """By hand, at 1/10: 1e-3 of the mass, so 1e-4 of the moments and 1e-2 of the stiffnesses. Passenger cars are all of
    one size."""
    model = load_scene_text(f'vehicle: {similar_car(tmp_path, 0.1)}\nstart: {{kind: equilibrium}}\n', 'similar').model
    size = size_of(model)
    assert size == pytest.approx((0.1, 1e-3), rel=1e-3)
    assert (size.time, size.torque, size.stiffness) == pytest.approx((0.1**0.5, 1e-4, 1e-2), rel=1e-3)
    for car in (
        'light_car',
        'full_car',
        'compact_fwd',
        'formula_student',
        'pickup_awd',
        'electric_4wd',
        'wishbone_car',
    ):
        assert (
            size_of(load_scene_text(f'vehicle: vehicles/{car}.yaml\nstart: {{kind: equilibrium}}\n', car).model)
            == Size()
        ), car
    channels = simulation_of(load_scene_text('vehicle: vehicles/light_car.yaml\nduration: 0.01\n', 'car')).channels
    assert quantity('wheel_load.front_left', channels, size).least == pytest.approx(0.1, rel=1e-3)  # of 100 N
    assert quantity('yaw_rate', channels, size).least == pytest.approx(0.01 / 0.1**0.5, rel=1e-3)
    assert quantity('roll', channels, size).least == 0.001


def test_figures_of_a_standing_car_stay_where_a_drive_fails(monkeypatch):
    """The row of what failed has the reason, that of what depends on it too; `mbd info` shows both and all others."""
    model = load_scene('light_car_straight')
    why = 'a slow ramp of the steering wheel to 1.6 rad at 22 m/s reaches 0.1 m/s^2 across'

    def fails(*_: object) -> dict[str, float]:
        raise SpecError(why)

    monkeypatch.setattr(solver.analysis.figures, 'steady_figures', fails)
    figures, failed = all_figures(standing(model))
    assert failed == dict.fromkeys((*DRIVEN,), why)
    assert {'mass', 'bounce_frequency', 'wheel_rate_front', 'steering_ratio', 'sag_rear'} <= figures.keys()
    data, rows = info._figures(model)
    assert data['understeer_gradient'] == {'error': why}
    assert ('understeer gradient', 'none', '', 'FAILED', why) in rows
    assert [row[1] for row in rows if row[0] == 'wheelbase'] == ['2.65 m']


@pytest.mark.slow
def test_a_lorry_of_forty_tons_has_figures_and_maps(tmp_path):
    """The light car 2.4 times as large, with 1.15 of its body as load more, springs and tires for it (twin tires
    behind, as one).

    Masses and rates by hand; the level kc keeps the load that its front wheels carry.
    """
    path = lorry(tmp_path)
    scene = load_scene_text(f'vehicle: {path}\nstart: {{kind: equilibrium}}\n', 'lorry')
    figures, failed = all_figures(standing(scene))
    assert not failed
    assert figures['mass'] == pytest.approx(2.4**3 * (1413 + 1.15 * 1250), rel=1e-3)
    assert figures['wheelbase'] == pytest.approx(2.4 * 2.65, rel=1e-12)
    assert figures['steering_ratio'] == pytest.approx(17.9, rel=0.01)  # that of the light car: angles stay
    kc = dataclasses.replace(scene, fidelity='kc')
    loads = [simulation_of(one).snapshot().tire[:, 2] for one in (scene, kc)]
    np.testing.assert_allclose(loads[1], loads[0], rtol=1e-3)
    assert loads[0].sum() == pytest.approx(9.81 * figures['mass'], rel=1e-3)


def lorry(directory: Path) -> Path:
    """Its file."""
    path = similar_car(directory, 2.4)
    data = yaml.safe_load(path.read_text())
    data['chassis']['mass'] *= 2.15
    data['chassis']['inertia'] = [2.15 * x for x in data['chassis']['inertia']]
    data['chassis']['com'][0] = -0.9
    for axle, more in (('front', 2.0), ('rear', 3.4)):
        data[axle]['spring']['rate'] *= more
        data[axle]['damper']['law'] = [[v, more * f] for v, f in data[axle]['damper']['law']]
        data[axle]['stops'] = [[z, more * f] for z, f in data[axle]['stops']]
        data[axle]['tire'] = f'{axle}.tir'
    for axle, more in (('front', 1.7), ('rear', 3.0)):
        lines = [line.split(' = ') for line in (directory / 'similar.tir').read_text().splitlines()]
        heavier = ('FNOMIN', 'FZMAX', 'VERTICAL_STIFFNESS', 'VERTICAL_DAMPING', 'BOTTOM_STIFF')
        text = [' = '.join([n, *(f'{more * float(x)!r}' if n in heavier else x for x in rest)]) for n, *rest in lines]
        (directory / f'{axle}.tir').write_text('\n'.join(text) + '\n')
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return path


def driven(directory: Path, s: float, fidelity: str) -> np.ndarray:
    """(n, 4) yaw rate times s^(1/2), velocities over it, lateral specific force of the car at a level, in a step of the
    steering wheel."""
    t = s**0.5
    scene = f"""
vehicle: {similar_car(directory / f'{s:g}', s)}
fidelity: {fidelity}
start: {{kind: equilibrium, speed: {22.0 * t!r}}}
maneuver: {{steering: {{kind: step, value: 0.6, start: {0.2 * t!r}, rise: {0.2 * t!r}}}}}
integrator: {{h: {round(1e-3 * t, 9)!r}, iterations: 3}}
duration: {round(1.5 * t, 6)!r}
"""
    simulation = simulation_of(load_scene_text(scene, 'similar'))
    chassis = simulation.channels.chassis
    shots = [simulation.advance(100) for _ in range(15)]
    return np.array(
        [(t * x.twist[chassis, 5], x.twist[chassis, 0] / t, x.twist[chassis, 1] / t, x.imu[1]) for x in shots]
    )


@pytest.mark.slow
@pytest.mark.parametrize('fidelity', ['full', 'condensed', 'kc', pytest.param('single_track', marks=pytest.mark.long)])
def test_a_similar_car_drives_as_the_car_at_every_level(tmp_path, fidelity):
    """To 1e-5 of the peaks; the level single_track is identified while creeping, too, where the contact of standing
    tires counts: 2e-3."""
    wanted = driven(tmp_path, 1.0, fidelity)
    for s in SCALES if fidelity != 'single_track' else SCALES[:1]:
        error = np.abs(driven(tmp_path, s, fidelity) - wanted).max(axis=0) / np.abs(wanted).max(axis=0)
        assert error.max() < (2e-3 if fidelity == 'single_track' else 2e-5), s
