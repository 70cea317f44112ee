"""Brake: dry friction with true stick."""

from __future__ import annotations

import numpy as np
import pytest
from contract import (
    ContractContext,
    Element,
    check_contract,
    check_purity,
    check_tangents,
    forcing,
    kinematics,
    random_kinematics,
)
from scipy.spatial.transform import Rotation

from solver.elements.brake import OUTPUTS, BrakeSpec, brake_forces, compile_brakes
from solver.elements.coordinate import CoordinateSpec
from solver.elements.marker import Marker
from solver.errors import SpecError

H = 1e-3  # stage step cz [s]


def brakes(specs, coordinates, *, bodies=2, com=None):
    context = ContractContext(bodies=bodies, com=com, inputs=('brake',), coordinates=coordinates)
    x = context.coordinate_table()
    table = compile_brakes(specs, context)
    laws = context.laws()
    angle = np.zeros(len(coordinates))
    return Element(forcing(brake_forces, table, laws, x, angle), context, n=len(specs), outputs=OUTPUTS)


def random_brake(rng, *, j='b1', **changes):
    def marker(body):
        return Marker(body=body, position=rng.normal(size=3), orientation=Rotation.random(random_state=rng).as_quat())

    spec = BrakeSpec(
        name='b', coordinate='wheel', input='brake', gain=2.0, **{'stiffness': 30.0, 'damping': 0.4, **changes}
    )
    return brakes(
        [spec],
        [CoordinateSpec(name='wheel', kind='rotation', i=marker('b0'), j=marker(j))],
        com=rng.normal(size=(2, 3)),
    )


def wheel_brake(**values):
    """Brake of capacity u [N m] between the world and a wheel b0 that turns about z."""
    coordinate = CoordinateSpec(name='wheel', kind='rotation', i=Marker(body='world'), j=Marker(body='b0'))
    spec = BrakeSpec(name='b', coordinate='wheel', input='brake', gain=1.0, **values)
    return brakes([spec], [coordinate], bodies=1)


def turning(omega):
    return kinematics([((0, 0, 0), (0, 0, 0))], [[0, 0, 0, 0, 0, omega]])


@pytest.mark.parametrize(('capacity', 'branch'), [(1e3, 'stick'), (0.05, 'slip'), (0.0, 'free')])
@pytest.mark.parametrize('j', ['b1', 'world'])
def test_contract_in_every_branch(rng, capacity, branch, j):
    """Tangents are exact for the branch taken; action = reaction; Q omega = -k z zdot - dissipation with zdot = (z -
    zp)/cz."""
    element = random_brake(rng, j=j)
    for zp in (0.02, -0.3):
        kin = random_kinematics(rng, 2)
        arguments = {'zp': [zp], 'cz': H, 'u': [capacity / 2.0]}
        result = element.evaluate(kin, **arguments)
        omega, torque = element.output(result, 'rate')[0], element.output(result, 'torque')[0]
        if branch == 'stick':
            assert result.z[0] == zp + H * omega
        else:
            assert abs(torque) == capacity
        check_contract(element, kin, **arguments)
        assert element.output(result, 'dissipation')[0] >= 0.0


def test_contract_without_a_step(rng):
    """cz = 0 evaluates at z = zp: torque k zp + d omega within the capacity; purity and tangents hold."""
    element = random_brake(rng)
    kin = random_kinematics(rng, 2)
    for capacity in (1e3, 0.01):
        check_purity(element, kin, zp=[0.1], u=[capacity])
        check_tangents(element, kin, zp=[0.1], u=[capacity])
        result = element.evaluate(kin, zp=[0.1], u=[capacity])
        assert result.z[0] == 0.1
        expected = 30.0 * 0.1 + 0.4 * element.output(result, 'rate')[0]
        assert -element.output(result, 'torque')[0] == pytest.approx(
            np.clip(expected, -2 * capacity, 2 * capacity), rel=1e-12
        )
    undamped = random_brake(rng, damping=0.0)
    result = undamped.evaluate(kin, zp=[0.1], u=[0.75])
    assert result.z[0] == pytest.approx(1.5 / 30.0)  # clipped to T/k
    check_purity(undamped, kin, zp=[0.1], u=[0.75])


def test_brake_torque_opposes_the_rotation():
    """Wound up by 0.01 rad at 1000 N m/rad and turning at 2 rad/s at 1 N m s/rad, cz = 1 ms: z = 0.012, Q = -12 - 2 =
    -14 N m."""
    result = wheel_brake(stiffness=1000.0, damping=1.0).evaluate(turning(2.0), zp=[0.01], cz=1e-3, u=[50.0])
    np.testing.assert_allclose(result.f[0], [0, 0, 0, 0, 0, -14.0], atol=1e-12)
    np.testing.assert_allclose(result.f[1], [0, 0, 0, 0, 0, 14.0], atol=1e-12)
    np.testing.assert_allclose(result.out[0], [0.5 * 1000 * 0.012**2, 4.0, 0.012, 2.0, -14.0, 50.0], rtol=1e-12)


def test_released_brake_gives_exactly_no_torque():
    """Capacity 0, also from a negative input and with wind-up left over: zero force, zero tangents."""
    element = wheel_brake(stiffness=1000.0, damping=1.0)
    for u in (0.0, -3.0):
        for omega in (0.0, 40.0):
            for zp in (0.0, 0.05):
                result = element.evaluate(turning(omega), zp=[zp], cz=H, u=[u], tangents=True)
                assert not np.any(result.f) and not np.any(result.Kq) and not np.any(result.Kv)


def test_branches_join_continuously(rng):
    """Torque and wind-up as functions of the rate have no jump where stick becomes slip."""
    element = wheel_brake(stiffness=1000.0, damping=1.0)
    limit = (20.0 - 1000.0 * 0.003) / (1000.0 * H + 1.0)  # rate at which the trial torque reaches 20 N m
    inside, outside = (element.evaluate(turning(limit * (1 + s)), zp=[0.003], cz=H, u=[20.0]) for s in (-1e-12, 1e-12))
    assert inside.f[0, 5] == pytest.approx(outside.f[0, 5], rel=1e-11)
    assert inside.z[0] == pytest.approx(outside.z[0], rel=1e-11)


def test_dissipation_is_never_negative_and_windup_is_bounded(rng):
    """k |z| <= max(T, k |zp|), |Q| <= T and dissipation >= 0 for random states, capacities and dampers."""
    for damping in (0.0, 0.4):
        element = wheel_brake(stiffness=30.0, damping=damping)
        for _ in range(300):
            zp, omega, capacity = rng.normal(scale=0.1), rng.normal(scale=5.0), rng.uniform(0, 5)
            cz = float(rng.choice([0.0, 1e-4, 1e-2]))
            result = element.evaluate(turning(omega), zp=[zp], cz=cz, u=[capacity])
            z = result.z[0]
            assert 30.0 * abs(z) <= max(capacity, 30.0 * abs(zp)) * (1 + 1e-12)
            assert abs(result.f[0, 5]) <= capacity
            assert element.output(result, 'dissipation')[0] >= -1e-12


def spin(element, *, inertia, omega, drive, capacity, steps, z=0.0):
    """Backward-Euler motion of the wheel under a drive torque [N m]; yields (time, angle, omega, wind-up, torque) per
    step."""
    angle = 0.0
    for n in range(steps):
        t = (n + 1) * H
        new = omega
        for _ in range(20):
            result = element.evaluate(turning(new), zp=[z], cz=H, u=[capacity(t)], tangents=True)
            residual = inertia * (new - omega) / H - result.f[0, 5] - drive(t)
            if abs(residual) < 1e-10:
                break
            new -= residual / (inertia / H - result.Kv[5, 5])
        else:
            pytest.fail('the Newton iteration of a scalar friction problem did not converge')
        omega, z = new, result.z[0]
        angle += H * omega
        yield t, angle, omega, z, result.f[0, 5]


def test_locked_wheel_holds_without_creep_or_chatter():
    """A wheel at 30 rad/s is braked to a stop by 100 N m and then held against 60 N m: it rests at wind-up 60 N m / k.

    Stopping time I omega/(T - drive) = 0.5*30/40 = 0.375 s (backward Euler: one step). Resting: after 2 s, forty times
    the decay time of the wind-up oscillation 2 I/d = 0.05 s, rate and torque are steady to 1e-9, with no drift of the
    angle.
    """
    element = wheel_brake(stiffness=5000.0, damping=20.0)
    history = np.array(
        list(spin(element, inertia=0.5, omega=30.0, drive=lambda t: 60.0, capacity=lambda t: 100.0, steps=2400))
    )
    t, angle, omega, z, torque = history.T
    stop = t[np.argmax(omega <= 0.0)]
    # the wind-up at the end, T/k = 0.02 rad, adds less than a period of the oscillation
    assert stop == pytest.approx(0.375, abs=0.02)
    assert np.all(np.abs(torque) <= 100.0)
    rest = t > 2.0
    np.testing.assert_allclose(torque[rest], -60.0, rtol=0, atol=1e-9)
    np.testing.assert_allclose(omega[rest], 0.0, atol=1e-9)
    np.testing.assert_allclose(z[rest], 60.0 / 5000.0, rtol=1e-9)
    assert np.ptp(angle[rest]) < 1e-11


def test_locked_wheel_breaks_loose_above_the_capacity_and_locks_again():
    """Drive 60 N m against capacity 100, then 40, then 100 N m: rest, acceleration 20 N m / I, rest again."""
    element = wheel_brake(stiffness=5000.0, damping=20.0)

    def capacity(t):
        return 40.0 if 0.5 < t <= 0.7 else 100.0

    history = np.array(list(spin(element, inertia=0.5, omega=0.0, drive=lambda t: 60.0, capacity=capacity, steps=2400)))
    t, _, omega, z, torque = history.T
    loose = (t > 0.55) & (t <= 0.7)
    np.testing.assert_allclose(np.diff(omega[loose]) / H, 20.0 / 0.5, rtol=1e-9)
    np.testing.assert_allclose(torque[loose], -40.0)
    assert np.abs(z).max() <= 100.0 / 5000.0 * (1 + 1e-12)
    np.testing.assert_allclose(omega[t > 2.2], 0.0, atol=1e-9)


def test_a_brake_without_a_damping_relaxes_within_two_milliseconds():
    assert BrakeSpec(name='b', coordinate='c', input='u', gain=1.0, stiffness=500.0).damping == 1.0
    assert BrakeSpec(name='b', coordinate='c', input='u', gain=1.0, stiffness=500.0, damping=0.0).damping == 0.0


@pytest.mark.parametrize('windup', [0.02, 0.02 * (1.0 - 1e-15), 0.02 * (1.0 + 1e-15)])
def test_a_wind_up_without_step_and_damper_slides_at_its_capacity_whatever_rounding_left(windup: float):
    """10 N m at 500 N m/rad and 30 rad/s: 300 W are lost, and none where it sticks."""
    element = wheel_brake(stiffness=500.0, damping=0.0)
    sliding = element.evaluate(turning(30.0), zp=[windup], u=[10.0])
    assert element.output(sliding, 'torque')[0] == -10.0
    assert element.output(sliding, 'dissipation')[0] == 300.0
    assert element.output(element.evaluate(turning(30.0), zp=[0.99 * windup], u=[10.0]), 'dissipation')[0] == 0.0
    # it unloads
    assert element.output(element.evaluate(turning(-30.0), zp=[windup], u=[10.0]), 'dissipation')[0] == 0.0


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'gain': -1.0}, 'gain = -1.0: must be >= 0'),
        ({'stiffness': 0.0}, 'stiffness = 0.0: must be > 0'),
        ({'damping': -1.0}, 'damping'),
    ],
)
def test_refusals_name_element_field_and_remedy(changes, message):
    with pytest.raises(SpecError, match="Brake 'b': " + message):
        BrakeSpec(**{'name': 'b', 'coordinate': 'c', 'input': 'u', 'gain': 1.0, 'stiffness': 1.0, **changes})
