"""The level `condensed` against the whole vehicle: statics, kinematics and compliance, maneuvers, energy, cost."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest

import solver
from solver.analysis.balance import Balance
from solver.analysis.driven import steady_figures
from solver.analysis.kinematics_and_compliance import Rig, kinematic_figures
from solver.analysis.modes import modes
from solver.elements.road import HeightGrid, RoadSpec
from solver.errors import SpecError
from solver.files.scene import load_scene, load_scene_text
from solver.levels.condensed import condensed
from solver.scene import Scene
from solver.simulation import Simulation

SECOND_CAR = 'vehicles/wishbone_car.yaml'
CARS = ('vehicles/full_car.yaml', SECOND_CAR)
TOLERANCE = 0.005  # of the peak, root mean square
WAVE, AMPLITUDE = 2.0, 0.005  # m
ROAD = RoadSpec(
    grids=(
        HeightGrid(
            origin=(5.0, -5.0), step=(0.05, 10.0),
            height=tuple((AMPLITUDE * min(k / 100.0, 1.0) * math.sin(2.0 * math.pi * 0.05 * k / WAVE),
            ) * 2 for k in range(1600)),
        ),
    )
)  # fmt: skip
SWEEP = '{kind: sweep, amplitude: 0.364, frequency: 0.2, final_frequency: 2.0, duration: 6, start: 0.2}'
# maneuver -> speed [km/h], keys of the maneuver, duration [s]; 0.364 rad at the wheel of the full car are 0.3 g
MANEUVERS = {
    'step steer, 0.4 g': (80, '{steering: {kind: step, value: 0.485, start: 0.5, rise: 0.15}}', 2.5),
    'sine with dwell': (80, '{steering: {kind: sine_with_dwell, amplitude: 1.09, start: 0.3}}', 3.0),
    'swept sine, 0.3 g': (
        80,
        '{steering: {kind: sweep, amplitude: 0.364, frequency: 0.2, final_frequency: 2.0, duration: 6, start: 0.2}}',
        6.5,
    ),
    'braking, 0.5 g': (100, '{brake_torque: {kind: step, value: 2300, start: 0.3, rise: 0.3}}', 2.5),
    'road of 2 m': (72, '{}', 3.0),
}


def scene(car: str, maneuver: str) -> Scene:
    speed, keys, duration = MANEUVERS[maneuver]
    start = f'start: {{kind: equilibrium, speed_kmh: {speed}}}'
    text = (
        f'vehicle: {car}\n{start}\nmaneuver: {keys}\nduration: {duration}\nintegrator: {{h: 2.0e-3, iterations: 2}}\n'
    )
    given = load_scene_text(text, maneuver)
    if maneuver != 'road of 2 m':
        return given
    return dataclasses.replace(given, model=dataclasses.replace(given.model, road=ROAD))


def course(given: Scene) -> tuple[Simulation, dict[str, np.ndarray]]:
    """The simulation at its end, and what the level is to be judged by, every 10 ms."""
    simulation = solver.simulation_of(given)
    chassis = simulation.channels.chassis or 0
    shots = [simulation.advance(5) for _ in range(given.steps // 5)]
    twist = np.array([s.twist[chassis] for s in shots])
    turned = np.array([s.pose[chassis, 3:] for s in shots])
    return simulation, {
        'yaw rate': twist[:, 5],
        'sideslip velocity': twist[:, 1],
        'roll': 2.0 * (turned[:, 0] * turned[:, 3] + turned[:, 1] * turned[:, 2]),
        'wheel loads': np.array([s.tire[:, 2] for s in shots]),
    }


USUAL = {(CARS[0], maneuver) for maneuver in MANEUVERS} | {(SECOND_CAR, 'sine with dwell'), (SECOND_CAR, 'road of 2 m')}


@pytest.mark.slow
@pytest.mark.parametrize(
    ('car', 'maneuver'),
    [
        pytest.param(*case, marks=() if case in USUAL else pytest.mark.long)
        for case in itertools.product(CARS, MANEUVERS)
    ],
)
def test_it_moves_like_the_whole_car(car: str, maneuver: str) -> None:
    """Within half a percent of the peak, root mean square; what hardly moves in a maneuver is not compared."""
    given = scene(car, maneuver)
    _, whole = course(given)
    simulation, less = course(dataclasses.replace(given, fidelity='condensed'))
    for name, reference in whole.items():
        peak = float(np.abs(reference).max())
        if peak < 0.01:
            continue
        error = math.sqrt(float(np.mean((less[name] - reference) ** 2)))
        assert error < TOLERANCE * peak, f'{name}: {error / peak:.2%} of {peak:.3g}'
    exchanged = 0.5 * sum(body.mass for body in given.model.bodies) * 22.0**2
    assert simulation.totals()['energy_error_max'] < 1e-4 * exchanged
    assert simulation.totals()['position_drift_max'] < 1e-6
    assert simulation.urdf().startswith('<?xml') or '<robot' in simulation.urdf()


@pytest.mark.slow
def test_energy_and_momentum_close() -> None:
    """As well as those of the whole car, to the error of the trapezoidal rule with which impulses and works are added
    up."""
    reports = []
    for level in ('full', 'condensed'):
        simulation = solver.simulation_of(dataclasses.replace(scene(CARS[0], 'sine with dwell'), fidelity=level))
        balance = Balance(simulation)
        for _ in range(600):  # the first half of the swing
            simulation.advance(1)
            balance.update()
        reports.append(balance.report())
    whole, less = reports
    errors = [np.abs(report['momentum_error']).max() for report in reports]
    assert errors[1] < 2.0 * errors[0] + 0.01
    assert {'rods', 'servos'} <= set(less['energy_by_kind'])
    most = max(abs(row['error']) for row in whole['energy_by_kind'].values())
    assert all(abs(row['error']) < 2.0 * most for row in less['energy_by_kind'].values())


@pytest.mark.slow
@pytest.mark.parametrize('car', CARS)
def test_static_loads_kinematics_and_compliance_are_those_of_the_whole_car(car: str) -> None:
    """Figures within 1 %; what is small by design (toe by bump, steer by load) within 1 % of what a passenger car has
    at most."""
    model = load_scene_text(f'vehicle: {car}').model
    figures = [kinematic_figures(Rig(m)) for m in (model, condensed(model)[0])]
    small = {'bump_toe': 0.1, 'roll_center': 0.15, 'lateral_steer': 4e-6, 'aligning_steer': 5e-5}
    for name, value in figures[0].items():
        scale = max(abs(value), small.get(name.rsplit('_', 1)[0], 0.0))
        assert abs(figures[1][name] - value) < 0.01 * scale, f'{name}: {value:.4g}, {figures[1][name]:.4g}'
    texts = [f'vehicle: {car}\nstart: {{kind: equilibrium}}\nfidelity: {level}\n' for level in ('full', 'condensed')]
    stands = [solver.simulation_of(load_scene_text(text)) for text in texts]
    loads = [s.snapshot().tire[:, 2] for s in stands]
    np.testing.assert_allclose(loads[1], loads[0], rtol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize('car', CARS)
def test_its_understeer_is_that_of_the_whole_car(car: str) -> None:
    """Within 1 %, by a slow ramp of the steering wheel; its modes are not asked for, and a linear model of bodies alone
    is refused."""
    model = load_scene_text(f'vehicle: {car}').model
    less = condensed(model)[0]
    found = [steady_figures(spec, 14.7) for spec in (model, less)]
    for name, value in found[0].items():
        assert found[1][name] == pytest.approx(value, rel=0.01), name
    stand = solver.simulation_of(
        load_scene_text(f'vehicle: {car}\nstart: {{kind: equilibrium}}\nfidelity: condensed\n')
    )
    with pytest.raises(SpecError, match='fidelity: full for modes'):
        modes(stand)


@pytest.mark.slow
def test_a_step_does_less_than_half_of_the_work_of_the_whole_car() -> None:
    """No more evaluations and factorizations, and of each less than half of the operations on blocks, of the gradients,
    of the bodies. What it costs is measured by `mbd bench --cases car_levels`."""
    steps, counted = [], []
    for level in ('full', 'condensed'):
        s = solver.simulation_of(load_scene('car_step_steer', [f'fidelity={level}']))
        s.advance(200, audit=False)
        totals, plan = s.totals(), s.model.tables.condensed
        steps.append((totals['evaluations'], totals['factorizations']))
        counted.append((len(plan.update) + len(plan.lower) + len(plan.node), s.model.n_entries, s.model.n_bodies))
    assert all(few <= many for many, few in zip(*steps, strict=True)), steps
    assert all(few < 0.5 * many for many, few in zip(*counted, strict=True)), counted
