"""A car with a torque converter: stall by its K-factor, creeping, lock-up, an automatic gearbox, and the account of
energy."""

from __future__ import annotations

import numpy as np
import pytest

from solver.errors import MbdError
from solver.files.scene import load_scene_text
from solver.scene import Scene
from solver.simulation import Simulation

POWER = (
    'vehicle.engine.power=docs/examples/power.yaml',
    'vehicle.engine.power.converter=docs/examples/converter.yaml',
    'vehicle.engine.power.capacity=700',
)
RPM, FINAL, FIRST = 2.0 * np.pi / 60.0, 4.06, 3.73
NAMES = {
    'engines': ('energy', 'dissipation', 'rate', 'torque', 'pedal'),
    'converters': ('energy', 'dissipation', 'pump', 'turbine', 'on_pump', 'on_turbine'),
    'clutches': ('energy', 'dissipation', 'windup', 'rate', 'torque', 'ratio'),
}


def scene(maneuver: str, *changes: str, speed: float = 0.0, vehicle: str = 'compact_fwd') -> Scene:
    text = (
        f'vehicle: vehicles/{vehicle}.yaml\nstart: {{kind: equilibrium, speed: {speed}}}\nintegrator: {{h: '
        f'0.002}}\nmaneuver: {maneuver}\n'
    )
    return load_scene_text(text, 'converter', (*POWER, *changes))


def outputs(simulation: Simulation, kind: str, k: int = 0) -> dict[str, float]:
    """Outputs by name of the k-th element of a kind."""
    return dict(zip(NAMES[kind], simulation.model.outputs(kind, simulation.outputs)[k].tolist(), strict=False))


def speed_of(simulation: Simulation) -> float:
    return float(simulation.snapshot().twist[simulation.channels.chassis or 0, 0])


def test_at_stall_the_engine_turns_as_its_k_factor_says():
    """Brakes on, full accelerator: K = 1 / sqrt(3.77e-3), and the engine turns K sqrt(200 N m); the turbine stands and
    gets twice the torque, and the half shafts that times the gear. All power of the engine heats the oil. What is left
    after 4 s, some 40 time constants J / (2 T / rate), is the yield of brakes and tires."""
    simulation = Simulation(scene('{signals: {gear: 1, accelerator: 1.0}, brake_torque: 9000.0}'))
    simulation.advance(2000)
    found, engine, clutch = (
        outputs(simulation, 'converters'),
        outputs(simulation, 'engines'),
        outputs(simulation, 'clutches'),
    )
    K = 3.77e-3**-0.5

    stall = K * np.sqrt(200.0)  # 2199 rpm, where the map says 200 N m
    assert found['pump'] == pytest.approx(stall, rel=1e-3)
    assert found['turbine'] == pytest.approx(0.0, abs=0.05)
    assert found['on_turbine'] == pytest.approx(400.0, rel=2e-3)
    assert clutch['torque'] == pytest.approx(400.0, rel=2e-3)
    names = simulation.channels.joints
    efforts = dict(zip(names, simulation.snapshot().joint_effort.tolist(), strict=True))
    assert efforts['output_shaft_front_left/angle'] == pytest.approx(0.5 * FIRST * FINAL * clutch['torque'], rel=1e-6)
    assert (
        found['dissipation']
        == pytest.approx(-engine['dissipation'], rel=1e-3)
        == pytest.approx(200.0 * stall, rel=3e-3)
    )
    assert abs(speed_of(simulation)) < 0.02


def test_without_pedals_it_creeps():
    """In gear the idling engine drives the car, in neutral not."""
    creeping, standing = (Simulation(scene(f'{{signals: {{gear: {gear}}}}}')) for gear in (1, 0))
    creeping.advance(2000)
    standing.advance(2000)
    assert 0.5 < speed_of(creeping) < 3.0
    assert abs(speed_of(standing)) < 0.02


@pytest.mark.slow
def test_locked_up_nothing_slips_and_coasting_the_engine_brakes():
    """At 25 m/s in fourth gear: the lock-up clutch carries all that the converter did, and is cooler by what that lost;
    without accelerator the turbine drives the engine."""
    at = 'start.speed=25.0'
    found = {}
    for locked in (0, 1):
        simulation = Simulation(scene(f'{{signals: {{gear: 4, accelerator: 0.3, lock_up: {locked}}}}}', at))
        simulation.advance(2500)
        found[locked] = (outputs(simulation, 'converters'), outputs(simulation, 'clutches', 1))
    (slipping, open_), (none, closed) = found[0], found[1]
    assert 0.85 < slipping['turbine'] / slipping['pump'] < 0.99 and slipping['dissipation'] > 300.0
    assert open_['torque'] == 0.0
    assert none['turbine'] == pytest.approx(none['pump'], rel=1e-3) and abs(none['dissipation']) < 1.0
    assert closed['torque'] > 10.0
    coasting = Simulation(scene('{signals: {gear: 3}}', at))
    coasting.advance(1000)
    now = outputs(coasting, 'converters')
    assert now['turbine'] > now['pump'] > 1000.0 * RPM
    assert now['on_turbine'] == pytest.approx(-now['on_pump']) and now['on_turbine'] < -5.0


@pytest.mark.slow
@pytest.mark.parametrize('vehicle', ['compact_fwd', 'full_car'])
def test_an_automatic_gearbox_starts_it_by_the_converter_and_the_account_closes(vehicle):
    """From rest with full accelerator, into gears and lock-up: the losses of oil and clutches are named, and nothing
    else is missing."""
    box = (
        '{shift: {pedals: [0, 1], up_kmh: [[12, 45], [25, 85], [40, 125], [55, 165]], down_kmh: [[6, 28], [16, 60], '
        '[30, 95], [42, 135]], launch: 0, lock_up: 16.7}}'
    )
    behind = () if vehicle == 'compact_fwd' else ('vehicle.engine.power.final=1', 'vehicle.driveline.top_speed=null')
    simulation = Simulation(
        scene('{signals: {gear: 1, accelerator: 1.0}}', f'assistance={box}', *behind, vehicle=vehicle)
    )
    column, lock = (simulation.model.spec.inputs.index(name) for name in ('gear', 'lock_up'))
    gears, locked, lost = [], [], 0.0
    for _ in range(250):
        shot = simulation.advance(20)
        gears.append(shot.inputs[column])
        locked.append(shot.inputs[lock])
        lost += 0.04 * outputs(simulation, 'converters')['dissipation']
    assert sorted(set(gears)) == [1.0, 2.0, 3.0] if vehicle == 'compact_fwd' else gears[-1] >= 2.0
    assert locked[0] == 0.0 and locked[-1] == 1.0
    assert (np.diff(locked) >= 0.0).all()
    kinetic = 0.5 * 1354.0 * speed_of(simulation) ** 2
    assert 5e3 < lost < 5e4  # of launch and shifts [J]
    assert simulation.totals()['energy_error_max'] < 0.01 * kinetic


def test_an_automatic_gearbox_begins_at_speed_in_the_gear_of_that_speed():
    """At 25 m/s with little accelerator the last gear, 0.76, and locked up: the crankshaft turns 0.76 times 4.06 as
    fast as the wheels, whose radius is between that under load and that without. In the first gear, 3.73, it would turn
    at 1240 rad/s, and found no start."""
    shifts = 'pedals: [0, 1], up: [[3, 12], [7, 24], [11, 35], [15, 46]], down: [[2, 8], [4, 17], [8, 26], [12, 37]]'
    box = f'{{shift: {{{shifts}, launch: 0, lock_up: 17}}}}'
    simulation = Simulation(scene('{signals: {gear: 1, accelerator: 0.2}}', f'assistance={box}', speed=25.0))
    for steps in (0, 1, 250):
        shot = simulation.advance(steps)
        inputs = dict(zip(simulation.channels.inputs, shot.inputs.tolist(), strict=True))
        assert (inputs['gear'], inputs['clutch'], inputs['lock_up'], inputs['accelerator']) == (5.0, 0.0, 1.0, 0.2)
        assert 0.76 * FINAL * 25.0 / 0.316 < outputs(simulation, 'engines')['rate'] < 0.76 * FINAL * 25.0 / 0.295
        assert speed_of(simulation) == pytest.approx(25.0, abs=0.1)


@pytest.mark.parametrize(
    ('change', 'sentence'),
    [
        ('vehicle.engine.power.converter.capacities=[1e-3, 0]', r'converter\.capacities = 2: must be 10 numbers'),
        ('vehicle.engine.power.converter.inertia=0', r'converter\.inertia = 0\.0: must be > 0'),
        ('vehicle.engine.power.converter.lock_up.capacity=0', r'lock_up\.capacity = 0\.0: must be > 0'),
    ],
)
def test_what_cannot_be_is_one_sentence(change, sentence):
    with pytest.raises(MbdError, match=sentence):
        scene('{}', change)


def test_a_lock_up_needs_a_converter_that_has_one():
    box = 'assistance={shift: {pedals: [0], up: [[5]], down: [[3]], lock_up: 15}}'
    with pytest.raises(MbdError, match='lock_up = 15: the vehicle has no converter with a lock_up'):
        Simulation(scene('{}', box, 'vehicle.engine.power.converter.lock_up=null'))
