"""An engine that turns: idling, torque and power at the wheels, a clutch that slips, and where it is refused."""

from __future__ import annotations

import numpy as np
import pytest

import solver
from solver.elements.clutch import ClutchSpec
from solver.elements.joint import JointSpec
from solver.elements.marker import WORLD, Marker
from solver.elements.rigid_body import RigidBodySpec
from solver.errors import MbdError
from solver.files.scene import load_scene_text
from solver.inputs.maneuver import Maneuver
from solver.levels import derive
from solver.model.spec import ModelSpec
from solver.scene import Scene
from solver.simulation import Simulation
from solver.step.settings import IntegratorSettings

POWER = 'vehicle.engine.power=docs/examples/power.yaml'
RPM = 2.0 * np.pi / 60.0
SIX = '{shift: {pedals: [0], up: [[5], [9], [14], [20], [30]], down: [[3], [6], [9], [14], [20]]}}'
FINAL, GEARS = 4.06, (3.73, 1.96, 1.32, 0.95, 0.76)


def scene(*changes: str, vehicle: str = 'vehicles/compact_fwd.yaml', speed: float = 0.0, maneuver: str = '{}') -> Scene:
    text = (
        f'vehicle: {vehicle}\nstart: {{kind: equilibrium, speed: {speed}}}\nintegrator: {{h: 0.002}}\nmaneuver: '
        f'{maneuver}\n'
    )
    return load_scene_text(text, 'power', (POWER, *changes))


def outputs(simulation: Simulation, kind: str) -> dict[str, float]:
    """Outputs by name of the one element of a kind."""
    names = {
        'engines': ('energy', 'dissipation', 'rate', 'torque', 'pedal'),
        'clutches': ('energy', 'dissipation', 'windup', 'rate', 'torque', 'ratio'),
    }
    return dict(zip(names[kind], simulation.model.outputs(kind, simulation.outputs)[0].tolist(), strict=False))


def test_a_closing_clutch_dissipates_what_the_two_inertias_must_lose() -> None:
    """J1 = 0.2 at 100 rad/s, J2 = 9 behind a gear of 3, so 1 at the clutch; 40 N m: together after 100 / (40 (5 + 1)) s
    at 100/6 rad/s, and half of 1/6 of 100^2 J is lost, whatever the torque."""
    about_x, spinning = (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)), (100.0, 0.0, 0.0)
    bodies = (
        RigidBodySpec(name='crank', mass=1.0, inertia=(0.2, 0.1, 0.1, 0.0, 0.0, 0.0), angular_velocity=spinning),
        RigidBodySpec(name='load', mass=1.0, inertia=(9.0, 5.0, 5.0, 0.0, 0.0, 0.0)),
    )
    joints = tuple(
        JointSpec(
            name=b.name,
            kind='revolute',
            i=Marker(body=WORLD, orientation=about_x),
            j=Marker(body=b.name, orientation=about_x),
        )
        for b in bodies
    )
    clutch = ClutchSpec(
        name='clutch', shaft='crank', outputs=(('load', 1.0),), ratios=(3.0,), capacity=40.0, stiffness=2e4,
        damping=20.0,
        input='pedal', gear='gear',
    )  # fmt: skip
    model = ModelSpec(
        bodies=bodies, joints=joints, clutches=(clutch,), gravity=(0.0, 0.0, 0.0), inputs=('pedal', 'gear')
    )
    settings = IntegratorSettings(h=1e-3, rho_inf=0.8)
    simulation = Simulation(
        Scene(name='clutch', model=model, maneuver=Maneuver(signals={'gear': 1.0}), integrator=settings)
    )
    lost, rates = 0.0, []
    for _ in range(600):
        rates.append(simulation.advance(1).joint_velocity.copy())
        lost += 1e-3 * simulation.model.outputs('clutches', simulation.outputs)[0, 1]
    assert np.array(rates[199]) == pytest.approx((100.0 - 200.0 * 0.2, 120.0 / 9.0 * 0.2), rel=0.01)
    assert rates[-1] == pytest.approx((100.0 / 6.0, 100.0 / 18.0), rel=1e-3)
    assert lost == pytest.approx(1e4 / 12.0, rel=0.01)


def test_it_idles_where_the_torque_without_pedal_ends() -> None:
    """In neutral, from standing still: the car stays, the engine turns where its map is zero between 700 and 1000
    rpm."""
    simulation = Simulation(scene())
    shot = simulation.advance(3000)
    found = outputs(simulation, 'engines')
    assert found['torque'] == pytest.approx(0.0, abs=0.2)
    assert 700.0 < found['rate'] / RPM < 1000.0
    assert abs(shot.twist[simulation.channels.chassis or 0, 0]) < 0.02


@pytest.mark.slow
@pytest.mark.parametrize(('gear', 'speed'), [(3, 27.714), (4, 32.02)])  # near where it settles
def test_at_a_steady_speed_power_balances_and_torques_stand_in_the_ratio(gear: int, speed: float) -> None:
    """What the engine delivers is what air, tires and the rest take; the crankshaft turns by the ratios faster than the
    wheels, the clutch sticks, and the outputs get its torque times the ratios."""
    simulation = Simulation(scene(speed=speed, maneuver=f'{{signals: {{gear: {gear}, accelerator: 0.3}}}}'))
    simulation.advance(5000)
    powers = []
    for _ in range(500):
        simulation.advance(1)
        per_kind = {
            kind: simulation.model.outputs(kind, simulation.outputs)[:, 1].sum()
            for kind in ('engines', 'clutches', 'tires', 'aero_drags')
        }
        powers.append(tuple(per_kind.values()))
    engine, clutch, tires, air = np.mean(powers, axis=0)
    shot = simulation.advance(0)
    names = simulation.channels.joints
    rates = dict(zip(names, shot.joint_velocity.tolist(), strict=True))
    efforts = dict(zip(names, shot.joint_effort.tolist(), strict=True))
    found, coupled = outputs(simulation, 'engines'), outputs(simulation, 'clutches')
    ratio = GEARS[gear - 1] * FINAL
    wheels = 0.5 * (rates['wheel_front_left'] + rates['wheel_front_right'])
    assert found['rate'] == pytest.approx(ratio * wheels, rel=1e-3)
    assert coupled['ratio'] == pytest.approx(ratio, rel=1e-12)
    assert coupled['torque'] == pytest.approx(found['torque'], abs=0.5)
    assert abs(coupled['rate']) < 0.05
    assert efforts['output_shaft_front_left/angle'] == pytest.approx(0.5 * ratio * coupled['torque'], rel=1e-9)
    assert engine < -3000.0
    assert tires + air + clutch == pytest.approx(-engine, rel=0.02)
    v = shot.twist[simulation.channels.chassis or 0, :2]
    assert air == pytest.approx(0.5 * 1.2 * 0.66 * np.hypot(*v) ** 3, rel=0.01)


def test_a_rear_driven_car_gets_it_through_its_propeller_shaft() -> None:
    """The full car: crankshaft along the car, the torque of the gear at the pinion, times its final drive at the
    wheels."""
    changes = ('vehicle.engine.power.final=1', 'vehicle.driveline.top_speed=null')
    simulation = Simulation(
        scene(*changes, vehicle='vehicles/full_car.yaml', speed=20.0, maneuver='{signals: {gear: 3, accelerator: 0.6}}')
    )
    counts = simulation.describe()
    assert (counts['bodies'], counts['joints']) == (54, 50)
    simulation.advance(1500)
    shot = simulation.advance(0)
    rates = dict(zip(simulation.channels.joints, shot.joint_velocity.tolist(), strict=True))
    found, coupled = outputs(simulation, 'engines'), outputs(simulation, 'clutches')
    wheels = 0.5 * (rates['wheel_rear_left'] + rates['wheel_rear_right'])
    assert found['rate'] == pytest.approx(GEARS[2] * 3.2 * wheels, rel=5e-3)
    assert shot.twist[simulation.channels.chassis or 0, 0] > 20.5
    # the torque of the final drive acts on the outputs
    drive = simulation.model.outputs('coordinate_forces', simulation.outputs)
    final = drive[[f.name for f in simulation.model.spec.coordinate_forces].index('final_drive'), 4]
    assert final == pytest.approx(3.2 * GEARS[2] * coupled['torque'], rel=0.05)


def test_it_starts_from_rest_and_shifts() -> None:
    """First gear by releasing the clutch pedal, then the second one with it pressed; the account of energy closes."""
    table = (
        '{kind: table, interpolation: linear, points: [[0, 1], [0.5, 1], [1.5, 0], [3.5, 0], [3.6, 1], [3.9, 1], '
        '[4.1, 0]]}'
    )
    gear = '{kind: table, interpolation: linear, points: [[0, 0], [0.3, 0], [0.31, 1], [3.7, 1], [3.71, 2]]}'
    simulation = Simulation(scene(maneuver=f'{{signals: {{clutch: {table}, gear: {gear}, accelerator: 0.5}}}}'))
    simulation.advance(1700)
    first = outputs(simulation, 'clutches')
    assert first['ratio'] == pytest.approx(GEARS[0] * FINAL)
    assert abs(first['rate']) < 1.0
    shot = simulation.advance(1800)
    second = outputs(simulation, 'clutches')
    assert second['ratio'] == pytest.approx(GEARS[1] * FINAL)
    assert abs(second['rate']) < 1.0
    assert shot.twist[simulation.channels.chassis or 0, 0] > 8.0
    assert (
        simulation.totals()['energy_error_max']
        < 0.01 * 0.5 * 1330.0 * shot.twist[simulation.channels.chassis or 0, 0] ** 2
    )


@pytest.mark.parametrize(
    ('vehicle', 'change', 'sentence'),
    [
        ('compact_fwd', 'vehicle.engine.power.ratios=[3, -1]', r'power\.ratios\[1\] = -1\.0: must be > 0'),
        ('compact_fwd', 'vehicle.engine.power.inertia=0', r'power\.inertia = 0\.0: must be > 0'),
        (
            'compact_fwd',
            'vehicle.engine.power.pedals=[0, 1]',
            r'power\.torques = 3: must have one row for each of the 2 pedals',
        ),
        (
            'compact_fwd',
            'vehicle.engine.power.pedals=[0, 30, 100]',
            r'power\.pedals\[1\] = 30\.0: must be in \[0, 1\]: .* not per cent',
        ),
        (
            'compact_fwd',
            'maneuver.signals={accelerator: 30}',
            r'maneuver\.signals\.accelerator = 30\.0: must be a position .* 0 to 1',
        ),
        (
            'compact_fwd',
            'maneuver.signals={clutch: -2}',
            r'maneuver\.signals\.clutch = -2\.0: must be a position of the pedal, 0 to 1',
        ),
        (
            'compact_fwd',
            'maneuver.signals={gear: 6}',
            r'maneuver\.signals\.gear = 6\.0: is no gear: there are 1 to 5, 0 is neutral, -1',
        ),
        (
            'compact_fwd',
            f'assistance={SIX}',
            r'assistance\.shift\.up = 5: the last shift is into gear 6, and the gearbox has 5',
        ),
        (
            'pickup_awd',
            'name=x',
            "power: drive of axle front = 'half_shafts': a gearbox drives propeller shafts, and half shafts",
        ),
        ('full_car', 'name=x', 'power: final = 4.06: belongs to a differential in the gearbox'),
        ('formula_student', 'name=x', "vehicle.engine.*'part' is missing"),
    ],
)
def test_what_cannot_be_is_one_sentence(vehicle: str, change: str, sentence: str) -> None:
    with pytest.raises(MbdError, match=sentence):
        scene(change, vehicle=f'vehicles/{vehicle}.yaml')


def test_a_car_without_a_reverse_gear_is_not_put_into_it() -> None:
    with pytest.raises(
        MbdError, match=r'signals\.gear = -1\.0: is no gear: there are 1 to 5, 0 is neutral; there is no reverse gear'
    ):
        scene('vehicle.engine.power.reverse=null', maneuver='{signals: {gear: -1}}')


def test_a_spline_through_positions_of_a_pedal_may_swing_a_little_beyond_them() -> None:
    """From 0 to 1 within 0.3 s it swings to -0.39 and 1.79, and the pedal is held at its stops."""
    scene(maneuver='{signals: {gear: 2, accelerator: {kind: table, points: [[0, 0], [1, 0], [1.3, 1], [3, 1]]}}}')


def test_the_level_without_an_engine_says_so() -> None:
    with pytest.raises(MbdError, match='an engine with a gearbox, which this level does not have'):
        derive(scene('fidelity=single_track'))


def test_the_level_condensed_keeps_engine_and_gearbox() -> None:
    """The full car, accelerating in its third gear: as fast after 3 s."""
    found = []
    for level in ('full', 'condensed'):
        given = scene(
            f'fidelity={level}',
            'vehicle.engine.power.final=1',
            vehicle='vehicles/full_car.yaml',
            speed=20.0,
            maneuver='{signals: {gear: 3, accelerator: 0.6}}',
        )
        simulation = solver.simulation_of(given)
        shot = simulation.advance(1500)
        found.append((shot.twist[simulation.channels.chassis or 0, 0], outputs(simulation, 'engines')['rate']))
    assert found[1] == pytest.approx(found[0], rel=1e-3)


def test_an_automatic_gearbox_takes_the_car_from_rest_into_its_third_gear() -> None:
    """Full accelerator: the gears one after the other, and no faster than the power of the engine allows."""
    box = (
        '{shift: {pedals: [0, 1], up_kmh: [[12, 45], [25, 85], [40, 125], [55, 165]], down_kmh: [[6, 28], [16, 60], '
        '[30, 95], [42, 135]]}}'
    )
    simulation = Simulation(scene(f'assistance={box}', maneuver='{signals: {gear: 1, accelerator: 1.0}}'))
    gears, chassis = [], simulation.channels.chassis or 0
    column = simulation.model.spec.inputs.index('gear')
    for _ in range(240):
        shot = simulation.advance(25)
        gears.append(shot.inputs[column])
    assert sorted(set(gears)) == [1.0, 2.0, 3.0]
    assert (np.diff(gears) >= 0.0).all()
    speed = shot.twist[chassis, 0]
    assert speed > 85.0 / 3.6
    assert 0.5 * 1354.0 * speed * speed < 87e3 * 12.0


@pytest.mark.slow
@pytest.mark.parametrize('speed', [2.0, 5.0, 8.0])
def test_a_car_begins_in_first_gear_with_its_accelerator_down(speed: float) -> None:
    """Its wheels roll and its crankshaft turns as its gears say; it was refused below 6 m/s, and above one wheel span
    at 58 rad/s."""
    car = Simulation(scene(speed=speed, maneuver='{signals: {accelerator: 1, gear: 1}}'))
    wheels = [car.model.body_names.index(tire.marker.body) for tire in car.model.spec.tires]
    rates = np.linalg.norm(car.state.v[wheels, 3:], axis=1)
    np.testing.assert_allclose(rates, np.mean(rates), rtol=0.05)
    assert np.mean(rates) == pytest.approx(speed / 0.31, rel=0.05)
    crankshaft = car.channels.joints.index('crankshaft')
    assert abs(car.snapshot().joint_velocity[crankshaft]) == pytest.approx(3.73 * 4.06 * np.mean(rates), rel=0.05)
    car.advance(200)
    assert car.state.v[car.channels.chassis, 0] > speed


def test_a_car_that_accelerates_begins_as_it_goes_on() -> None:
    """Put back to its speed while it settles it takes crankshaft and wheels along: the clutch neither slips nor swings
    at the start."""
    simulation = Simulation(scene(speed=10.0, maneuver='{signals: {gear: 2, accelerator: 0.6}}'))
    crankshaft, wheels = (
        simulation.channels.joints.index('crankshaft'),
        [simulation.channels.joints.index(f'wheel_front_{s}') for s in ('left', 'right')],
    )
    rates = []
    for _ in range(30):
        turning = simulation.advance(10).joint_velocity
        rates.append((abs(turning[crankshaft]), FINAL * GEARS[1] * np.mean(np.abs(turning[wheels]))))
    engine, gearbox = np.array(rates).T
    np.testing.assert_allclose(engine, gearbox, rtol=2e-3)
    assert np.ptp(np.diff(engine)) < 0.1 * np.mean(np.diff(engine))


@pytest.mark.parametrize(('speed', 'gear', 'clutch'), [(5.0, 2, 0.9), (-3.0, -1, 0.0)])
def test_it_begins_with_its_clutch_half_open_and_backwards(speed: float, gear: int, clutch: float) -> None:
    """With the clutch nearly open the engine runs up to its limiter while the car settles: its shaft then turns by too
    much for the steps that did for the others."""
    simulation = Simulation(
        scene(speed=speed, maneuver=f'{{signals: {{gear: {gear}, clutch: {clutch}, accelerator: 0.8}}}}')
    )
    rate, chassis = outputs(simulation, 'engines')['rate'], simulation.channels.chassis or 0
    assert simulation.snapshot().twist[chassis, 0] == pytest.approx(speed, rel=0.01)
    if clutch:
        assert 6200 * RPM < rate < 6600 * RPM
    else:
        assert np.sign(simulation.advance(500).twist[chassis, 0] - speed) == np.sign(speed)
