"""The full car in motion: mirror symmetry, modes found again in a run, second order, maneuvers that end as they
must."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
import scipy.linalg
from saloon import full_car, mirrored

from solver.analysis.modes import linearised
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.errors import StepError
from solver.files.scene import load_scene
from solver.inputs.maneuver import Maneuver
from solver.inputs.signals import Sine
from solver.scene import Scene, StartSettings
from solver.simulation import Simulation
from solver.start.newton import ConsistentState
from solver.step.settings import IntegratorSettings
from solver.vehicle.full_car import FullCar, full_car_model

FX, FY, FZ = (TIRE_COLUMNS.index(name) for name in ('fx', 'fy', 'fz'))
SIDES = {'left': 'right', 'right': 'left'}


def slalom(car: FullCar, steering: float, penalty: float, mode: Literal['fixed', 'tolerance']) -> Simulation:
    """The car at 20 m/s in its design position, about to drive a slalom."""
    maneuver = Maneuver(steering=Sine(amplitude=steering, frequency=1.0, start=0.1), drive_torque=200.0)
    settings = IntegratorSettings(h=2e-3, iterations=3, penalty=penalty, mode=mode, tolerance=1e-12)
    return Simulation(
        Scene(
            name='slalom',
            model=full_car_model(car),
            start=StartSettings(speed=20.0),
            maneuver=maneuver,
            integrator=settings,
        )
    )


def across(name: str) -> str:
    """The part on the other side."""
    axle, _, side = name.rpartition('_')
    return f'{axle}_{SIDES[side]}' if side in SIDES else name


@pytest.mark.parametrize(
    ('penalty', 'mode', 'place', 'force'),
    [
        (1e2, 'fixed', 1e-13, 1e-8),
        (1e4, 'fixed', 5e-12, 1e-8),
        (1e6, 'fixed', 3e-8, 3e-5),
        (1e6, 'tolerance', 5e-12, 2e-7),
    ],
)
def test_mirrored_car_gives_the_mirrored_run(
    penalty: float, mode: Literal['fixed', 'tolerance'], place: float, force: float
) -> None:
    """From mirrored velocities, 500 steps: to rounding. A fixed number of iterations leaves what its last solution
    rounded, which grows with the penalty (docs/formulation.md, Rounding; the bounds are ten times what is measured
    there); to tolerance it does not.

    The start is mirrored by hand because its search ends at 3e-9 m/s.
    """
    car = full_car()
    one, other = slalom(car, 0.8, penalty, mode), slalom(mirrored(car), -0.8, penalty, mode)
    swap = [other.model.body_names.index(across(name)) for name in one.model.body_names]
    assert np.array_equal(other.state.q[swap], one.state.q[:-1] * (1, -1, 1, -1, 1, -1, 1))
    other.state.v[swap] = one.state.v[:-1] * (1, -1, 1, -1, 1, -1)
    for s in (one, other):
        c = s.scheme
        ConsistentState(s.model).start_integrator(s.state, s.snapshot().inputs, s.h, c.am, c.af)
    a, b = one.advance(500), other.advance(500)
    assert abs(a.pose[0, 1]) > 0.1
    assert b.pose[0] == pytest.approx(a.pose[0] * (1, -1, 1, -1, 1, -1, 1), abs=place)
    assert b.tire[[1, 0, 3, 2], FZ] == pytest.approx(a.tire[:, FZ], abs=force)
    assert -b.tire[[1, 0, 3, 2], FY] == pytest.approx(a.tire[:, FY], abs=force)


@pytest.mark.slow
def test_run_shows_the_frequencies_of_the_linear_model() -> None:
    """A small push on the standing car: chassis and engine follow the solution of the linearised model, exp of its
    state matrix.

    Its wheels have no rolling resistance: the linear model is that of wheels that roll, and on resistance a wheel
    stands.
    """
    tires = [f'vehicle.{axle}.tire={{<<: tires/205_55R16.tir, values: {{LMY: 0}}}}' for axle in ('front', 'rear')]
    standing = ['start={kind: equilibrium}', 'maneuver=maneuvers/straight_ahead.yaml', 'integrator.h=1e-3']
    scene = load_scene('car_swept_steer', [*standing, *tires])
    simulation = Simulation(scene)
    model = simulation.model
    linear = linearised(model, simulation.state, np.zeros(len(scene.model.inputs)))
    Z = scipy.linalg.null_space(linear.A)
    M, C, K = (Z.T @ X @ Z for X in (linear.M, linear.C, linear.K))
    n = len(M)
    S = np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), -np.linalg.solve(M, np.hstack([K, C]))])
    rows = [6 * model.body_names.index(name) + 2 for name in ('chassis', 'engine')] + [4]
    push = np.zeros(6 * model.n_bodies)
    push[2::6], push[4] = 1e-3, 1e-3  # everything upwards and the chassis nose down, as far as the joints allow
    w = np.linalg.solve(M, Z.T @ linear.M @ push)

    def respond(velocity: np.ndarray) -> np.ndarray:
        simulation.reset()
        state, u = simulation.state, np.zeros(len(scene.model.inputs))
        state.v[:-1] = velocity.reshape(-1, 6)
        c = simulation.scheme
        ConsistentState(model).start_integrator(state, u, simulation.h, c.am, c.af)
        start = state.q.copy()
        out = []
        for _ in range(40):
            simulation.advance(20)
            q = simulation.state.q
            out.append([*(q[r // 6, 2] - start[r // 6, 2] for r in rows[:2]), 2.0 * (q[0, 4] - start[0, 4])])
        return np.array(out)

    motion = respond(Z @ w) - respond(0.0 * (Z @ w))
    step = scipy.linalg.expm(S * 0.02)
    x, expected = np.concatenate([np.zeros(n), w]), []
    for _ in range(40):
        x = step @ x
        expected.append((Z @ x[:n])[rows])
    for column in range(3):
        size = np.abs(np.array(expected)[:, column]).max()
        assert motion[:, column] == pytest.approx(np.array(expected)[:, column], abs=0.03 * size)


@pytest.mark.slow
def test_swept_steering_converges_with_second_order() -> None:
    """First 2.4 s at h = 4, 2, 1 ms in fixed mode: differences of place, yaw rate and front-left lateral force fall by
    four."""
    results = []
    for h in (4e-3, 2e-3, 1e-3):
        simulation = Simulation(load_scene('car_swept_steer', [f'integrator.h={h}']))
        s = simulation.advance(round(2.4 / h))
        results.append(np.array([*s.pose[0, :2], s.twist[0, 5], s.tire[0, FY]]))
    coarse, fine = np.abs(results[0] - results[1]), np.abs(results[1] - results[2])
    order = np.log2(coarse / fine)
    assert np.all(order > 1.7)


@pytest.mark.parametrize('h', [1e-3, 5e-3])
def test_swept_steering_runs_at_both_steps_without_drift(h: float) -> None:
    simulation = Simulation(load_scene('car_swept_steer', [f'integrator.h={h}']))
    s = simulation.advance(round(6.0 / h))
    assert simulation.totals()['position_drift_max'] < 1e-7
    assert np.isfinite(s.tire).all()
    assert s.twist[0, 0] > 20.0  # it has accelerated


def test_drive_torque_is_halved_by_the_open_differential() -> None:
    """The moments about the two output axes are equal while one wheel stands on ice, until it spins and takes its share
    to accelerate."""
    road = 'road={patches: [{center: [0, -5], size: [400, 10], factor: 0.1}]}'
    torque = 'maneuver={drive_torque: {kind: step, value: 900, start: 0.2, rise: 0.3}}'
    simulation = Simulation(load_scene('car_acceleration', [road, torque]))
    names = simulation.channels.joints
    spins = [names.index(f'wheel_rear_{side}') for side in ('left', 'right')]
    outputs = [names.index(f'output_shaft_rear_{side}/angle') for side in ('left', 'right')]
    for _ in range(14):  # before the speed limiter
        s = simulation.advance(100)
        efforts = s.joint_effort[outputs]
        assert efforts[0] == pytest.approx(efforts[1], rel=1e-12)
    assert efforts.sum() == pytest.approx(900.0, rel=0.2)  # less what the propeller shaft takes to spin up
    assert s.joint_velocity[spins[1]] > 1.5 * s.joint_velocity[spins[0]]


def test_braked_car_stands_still_on_a_slope() -> None:
    """10 %, wheels locked by the brakes: no creep, no chatter."""
    overrides = ['road={normal: [-0.0995, 0, 0.995]}', 'start={kind: equilibrium}', 'maneuver={brake_torque: 4000}']
    simulation = Simulation(load_scene('car_step_steer', overrides))
    before = simulation.snapshot()
    after = simulation.advance(3000)
    assert np.abs(after.pose[0, :3] - before.pose[0, :3]).max() < 1e-5
    assert np.abs(after.twist[0]).max() < 1e-5


def test_braking_to_rest_ends_at_rest() -> None:
    """From 20 km/h with wheels that lock: within 5 s nothing moves any more, and the wheels stay where they are."""
    torque = 'maneuver={brake_torque: {kind: step, value: 4500, start: 0.2, rise: 0.2}}'
    simulation = Simulation(
        load_scene('car_step_steer', ['start={kind: equilibrium, speed_kmh: 20}', torque, 'integrator.h=2e-3'])
    )
    before = simulation.advance(2000)
    after = simulation.advance(500)
    assert before.pose[0, 0] < 5.0
    assert np.abs(after.twist[0]).max() < 2e-3
    assert np.abs(after.pose[0, :3] - before.pose[0, :3]).max() < 1e-3


@pytest.mark.parametrize(
    ('depth', 'h', 'policy'),
    [(0.3, 1e-3, 'constant'), (1.0, 1e-3, 'constant'), (1.0, 2e-3, 'constant'), (1.0, 5e-3, 'rescue')],
)
def test_car_lands_from_a_drop(depth: float, h: float, policy: str) -> None:
    """The wheels leave the road, land with 2.4 or 4.4 m/s on the bump rubbers (60 kN at one wheel), and the car settles
    at its height."""
    start = 'start={kind: as_placed, speed: 15}'
    changes = [
        f'road={{point: [0, 0, {-depth}]}}',
        start,
        'maneuver=maneuvers/straight_ahead.yaml',
        f'integrator.h={h}',
    ]
    simulation = Simulation(load_scene('car_step_steer', [*changes, f'integrator.step_policy={policy}']))
    falling = simulation.advance(round(0.1 / h))
    assert not falling.tire[:, FZ].any()
    landed = simulation.advance(round((4.0 if depth < 1.0 else 7.0) / h))
    assert landed.pose[0, 2] == pytest.approx(-depth, abs=0.005)
    assert landed.tire[:, FZ].sum() == pytest.approx(1576.0 * 9.81, rel=0.01)
    assert abs(landed.pose[0, 1]) < 2e-3 * landed.pose[0, 0]


@pytest.mark.slow
def test_a_locked_wheel_regains_grip_as_physics_has_it() -> None:
    """It comes off the slippery strip at 3.7 s, spins up from rest within 0.1 s and overshoots; the chassis nods with
    -12 m/s^2 on the fore-and-aft compliance. Half the step shows the same to 2 %, and all bodies together never slow
    down by more than the tires push."""
    peaks = []
    for h in (1e-3, 5e-4):
        simulation = Simulation(load_scene('car_split_mu_brake', [f'integrator.h={h}']))
        mass = np.array([body.mass for body in simulation.model.spec.bodies])
        simulation.advance(round(3.7 / h))
        chassis, whole, grip = [], [], []
        for _ in range(600):
            before = mass @ np.array([v[0] for v in simulation.state.v[:-1, :3]]) / mass.sum()
            s = simulation.advance(round(1e-3 / h))
            whole.append((mass @ simulation.state.v[:-1, 0] / mass.sum() - before) / 1e-3)
            chassis.append(s.imu[0])
            grip.append(np.linalg.norm(s.tire[:, [FX, FY]], axis=1).sum() / mass.sum())
        peaks.append(min(chassis))
        # drag: 0.06 m/s^2; tires turned by the steering and the camber of the road wheels
        assert min(whole) > -max(grip) - 0.3
        assert max(grip) < 8.0
    assert peaks[0] < -11.0
    assert peaks[0] == pytest.approx(peaks[1], rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('h', 'mode', 'policy'),
    [
        (1e-3, 'fixed', 'constant'),
        (1e-3, 'tolerance', 'constant'),
        pytest.param(5e-4, 'tolerance', 'constant', marks=pytest.mark.long),
        pytest.param(2e-3, 'fixed', 'constant', marks=pytest.mark.long),
        (2e-3, 'tolerance', 'rescue'),
        (5e-3, 'fixed', 'rescue'),
    ],
)
def test_rollover_runs_on(h: float, mode: str, policy: str) -> None:
    """With 2.5 times the friction a step steer at 110 km/h lifts the inner wheels and turns the car over in the air; it
    lands on an inverted wheel with 30 kN to 170 kN and tumbles on. Nothing feeds energy into it but the steering wheel,
    and nothing breaks."""
    steering = 'maneuver={steering: {kind: step, value: 5, start: 0.2, rise: 0.3}}'
    changes = ['road={friction: 2.5}', 'start={kind: equilibrium, speed_kmh: 110}', steering, f'integrator.h={h}']
    changes += [f'integrator.mode={mode}', f'integrator.step_policy={policy}']
    simulation = Simulation(load_scene('car_step_steer', changes))
    lifted = simulation.advance(round(0.7 / h))
    assert (lifted.tire[[0, 2], FZ] == 0.0).all()
    assert (lifted.tire[[1, 3], FZ] > 5000.0).all()
    over = simulation.advance(round(0.7 / h))
    x, y, _, _ = over.pose[0, 3:]
    assert 1.0 - 2.0 * (x * x + y * y) < 0.0  # z of the chassis points down
    energy = simulation.last_step.account.energy[0]
    landing = 0.0
    for _ in range(70):
        now = simulation.advance(round(0.05 / h))
        # of 580 kJ: treads return what they stored (30 kN on 120 kN/m: 3.8 kJ), and the account is as wrong as the step
        assert simulation.last_step.account.energy[0] < energy + 6e3 + simulation.totals()['energy_error_max']
        energy = min(energy, simulation.last_step.account.energy[0])
        landing = max(landing, now.tire[:, FZ].max())
        assert np.isfinite(now.pose).all() and np.isfinite(now.elements).all()
    assert landing > 3e4
    assert np.linalg.norm(now.twist[0, :3]) < 20.0  # it has lost most of its speed


@pytest.mark.parametrize(
    ('scene', 'axle', 'h'),
    [('car_acceleration', 'rear', 1e-3), ('car_acceleration', 'rear', 2e-3), ('light_car_brake', 'front', 2e-3)],
)
def test_wheels_spin_up_to_the_limiter(scene: str, axle: str, h: float) -> None:
    """6000 N m on friction 0.3: the limiter holds the mean speed of the driven wheels, and they push."""
    torque = 'maneuver={drive_torque: {kind: step, value: 6000, start: 0.1, rise: 0.1}}'
    simulation = Simulation(
        load_scene(
            scene, ['road={friction: 0.3}', 'start={kind: equilibrium, speed_kmh: 20}', torque, f'integrator.h={h}']
        )
    )
    names = simulation.channels.joints
    spins = [names.index(f'wheel_{axle}_{side}') for side in ('left', 'right')]
    driven = [simulation.channels.wheels.index(f'{axle}_{side}') for side in ('left', 'right')]
    for _ in range(4):
        s = simulation.advance(round(0.5 / h))
    assert 0.95 * 230 < s.joint_velocity[spins].mean() < 230
    push = s.tire[driven, FX] / s.tire[driven, FZ]
    assert np.all((push > 0.1) & (push < 0.3 * 1.2))
    assert simulation.totals()['position_drift_max'] < 1e-5


def test_a_shaft_too_fast_for_the_step_is_named() -> None:
    """The same at 5 ms: the propeller shaft turns by more than half a turn per step, which no step of this kind can
    follow."""
    torque = 'maneuver={drive_torque: {kind: step, value: 6000, start: 0.1, rise: 0.1}}'
    changes = [
        'road={friction: 0.3}',
        'start={kind: equilibrium, speed_kmh: 20}',
        torque,
        'integrator={h: 5e-3, step_policy: constant}',
    ]
    simulation = Simulation(load_scene('car_acceleration', changes))
    with pytest.raises(
        StepError,
        match=r"body '(drive_pinion|propshaft_\w+)' turns by 3\.\d rad per step of integrator\.h = 0\.005; no "
        r'convergence.*rescue',
    ):
        simulation.advance(400)


@pytest.mark.parametrize('kmh', [200, 300])
def test_it_starts_settled_at_speeds_where_its_shafts_turn_by_radians_in_a_step_of_settling(kmh: float) -> None:
    """At 200 km/h the propshaft turns by 2.9 rad in 5 ms. Loads of the wheels stay what they are at the start but for
    what the car loses of its speed: lift and growth of the tires go with its square."""
    s = Simulation(load_scene('car_step_steer', [f'start.speed_kmh={kmh}', 'maneuver={}', 'require={}']))
    chassis = s.channels.chassis or 0
    first, speed = s.snapshot().tire[:, FZ].copy(), s.snapshot().twist[chassis, 0]
    assert speed == pytest.approx(kmh / 3.6, rel=1e-6)
    last = s.advance(300)
    lost = 1.0 - (last.twist[chassis, 0] / speed) ** 2
    assert 0.0 < lost < 0.02
    np.testing.assert_allclose(last.tire[:, FZ], first, rtol=lost)
