"""Guide: two wheels on smooth maps, elastic, braked."""

from __future__ import annotations

import numpy as np
import pytest
from contract import (
    ContractContext,
    Element,
    check_action_reaction,
    check_contract,
    check_power_balance,
    check_states,
    complex_step_tangents,
    forcing,
    kinematics,
)
from scipy.spatial.transform import Rotation

from solver.elements.coordinate import CoordinateSpec
from solver.elements.guide import OUTPUTS, GuideSpec, compile_guides, guide_forces
from solver.elements.laws import Law
from solver.elements.marker import Marker
from solver.errors import SpecError

H = 1e-3  # stage step cz [s]
SPRING, DAMPER = (
    Law.table([[-0.1, -900.0], [0.0, 0.0], [0.05, 700.0], [0.1, 2500.0]]),
    Law.table([[-1.0, -300.0], [0.0, 0.0], [1.0, 700.0]]),
)

YIELD = Law.table([[-300.0, -1.0], [0.0, 0.0], [700.0, 1.0]])


def guide(rng, *, steered=True, mounted=True, **changes):
    """A guide of wheels b1 and b2 on the chassis b0, steered by the coordinate of b3 on b0, with random maps of
    sensible size."""
    nodes = {'travel': (-0.1, 0.05, 5), 'steering': (-2.0, 1.0, 5) if steered else (0.0, 1.0, 1)}
    rows = 2 * 7 * (7 if steered else 1)
    half = rng.normal(size=(8, 8))
    values = {
        'shape': tuple((rng.normal(size=(rows, 5)) * (0.01, 0.01, 0.05, 0.05, 0.05)).ravel()),
        'opposite': tuple(0.05 * rng.normal(size=70)),
        'stiffness': tuple((1e3 * (half @ half.T + np.eye(8))).ravel()),
        'lag': 0.003,
        'windup': tuple(0.2 * rng.normal(size=16)),
        'springs': (SPRING, Law.linear(2e4)),
        'coupling': (-300.0, 40.0, 500.0, -700.0),
        'jacking': (20.0, -30.0, 40.0, -20.0, 30.0, 50.0),
        'dampers': (DAMPER, Law.linear(200.0)),
        **({'mounts': (3e4, 0.0), 'yields': (YIELD, YIELD)} if mounted else {}),
        'ratios': tuple(rng.normal(size=10) + [-0.7, 0, 0, 0, 0, -0.7, 0, 0, 0, 0]),
        'crossings': (-0.2, 0.15),
        'drive': 'drive',
        'drives': ((0.5, 0.5, 0.6, 0.0), (1.0, 0.0, -0.2, 40.0)),
        'gear': (SPRING, DAMPER) if steered else (None, None),
        **nodes,
        **changes,
    }
    spec = GuideSpec(
        name='g', chassis='b0', left='b1', right='b2', centers=((1.4, 0.75, 0.3), (1.4, -0.75, 0.31)),
        coordinate='steer' if steered else None,
        wheels=('left', 'right'), input='brake', shares=(0.4, 0.3), brake_stiffness=50.0, brake_damping=0.7, **values,
    )  # fmt: skip
    turning = [
        CoordinateSpec(name=n, kind='rotation', i=Marker(body='b0'), j=Marker(body=b))
        for n, b in (('left', 'b1'), ('right', 'b2'))
    ]
    hands = CoordinateSpec(name='steer', kind='rotation', i=Marker(body='b0'), j=Marker(body='b3'))
    context = ContractContext(
        bodies=4, com=[[0.2, 0.1, 0.4], *[[0, 0, 0]] * 3], inputs=('brake', 'drive'), coordinates=[*turning, hands]
    )
    x, table, angle = context.coordinate_table(), compile_guides([spec], context), np.zeros(3)
    laws = context.laws()
    return Element(forcing(guide_forces, table, laws, x, angle), context, n=1, outputs=OUTPUTS)


def placed(rng, speed=0.0, travel=0.0):
    """A chassis anywhere, its wheels near their places (raised by `travel`), the steering wheel turned, all moving at
    random."""
    R = Rotation.from_rotvec(rng.normal(size=3))
    at = rng.normal(size=3)
    poses = [(at + R.apply([0.2, 0.1, 0.4]), R.as_matrix())]
    for side in (1, -1):
        turned = R * Rotation.from_euler('ZX', 0.1 * rng.normal(size=2)) * Rotation.from_rotvec([0, rng.normal(), 0])
        poses.append((at + R.apply([1.4, 0.75 * side, 0.3 + travel] + 0.03 * rng.normal(size=3)), turned.as_matrix()))
    poses.append(
        (
            rng.normal(size=3),
            (R * Rotation.from_rotvec([0, 0, 0.7]) * Rotation.from_rotvec(0.1 * rng.normal(size=3))).as_matrix(),
        )
    )
    return kinematics(poses, speed * rng.normal(size=(4, 6)))


@pytest.mark.parametrize('steered', [True, False])
@pytest.mark.parametrize('brake', [0.0, 20.0, 1e6])
@pytest.mark.parametrize('travel', [0.0, 0.13])
def test_at_rest_the_contract_is_met_exactly(rng, steered, brake, travel):
    """Released, slipping and stuck brakes; inside the maps and beyond their ends."""
    element, kin = guide(rng, steered=steered), placed(rng, travel=travel)
    arguments = {'zp': (0.3, -0.2, 0.004, 0.0), 'cz': H, 'u': (brake, 7.0)}
    check_contract(element, kin, **arguments)


@pytest.mark.parametrize('brake', [0.0, 20.0, 1e6])
def test_moving_it_balances_power_and_forces(rng, brake):
    """f . v = -dE/dt - dissipation with everything in motion; tangents over velocities stay exact."""
    element, kin = guide(rng), placed(rng, speed=1.0)
    arguments = {'zp': (0.3, -0.2, 0.004, 0.0), 'cz': H, 'u': (brake, 7.0)}
    check_states(element, kin, **arguments)
    check_power_balance(element, kin, **arguments)
    check_action_reaction(element, kin, **arguments)
    exact, found = (
        complex_step_tangents(element, kin, **arguments)[1],
        element.evaluate(kin, tangents=True, **arguments).Kv,
    )
    np.testing.assert_allclose(found, exact, rtol=0.0, atol=1e-11 * np.abs(exact).max())


def test_signs_of_a_guided_wheel():
    """By hand: with straight maps of slope 0.1 in x over travel and K = 1000 in x of the left wheel alone, this wheel
    10 mm up and 3 mm ahead is pushed back by 1000 (0.003 - 0.001) = 2 N and up by 0.1 of that less the spring's 200 N;
    the other one, in its place, feels nothing; the chassis gets the reaction at the lever of the wheel centre.
    """
    K = np.zeros((8, 8))
    K[0, 0] = 1000.0
    nodes = np.array([-0.15, -0.1, -0.05, 0.0, 0.05, 0.1, 0.15])
    shape = np.zeros((2, 7, 5))
    shape[:, :, 0] = 0.1 * nodes  # splines with coefficients on a straight line are that line
    element = guide(
        np.random.default_rng(0), steered=False, shape=tuple(shape.ravel()), opposite=(0.0,) * 70,
        stiffness=tuple(K.ravel()),
        windup=(0.0,) * 16, springs=(Law.linear(2e4),) * 2, coupling=(0.0,) * 4, ratios=(0.0,) * 10,
    )  # fmt: skip
    kin = kinematics(
        [
            ((0.2, 0.1, 0.4), (0, 0, 0)),
            ((1.403, 0.75, 0.31), (0, 0, 0)),
            ((1.4, -0.75, 0.31), (0, 0, 0)),
            ((0, 0, 0), (0, 0, 0)),
        ]
    )
    result = element.evaluate(kin, zp=(0.0,) * 4, u=(0.0, 0.0))
    left, right = result.f[1], result.f[2]
    np.testing.assert_allclose(left, [-2.0, 0, 0.2 - 200.0, 0, 0, 0], atol=1e-9)
    np.testing.assert_allclose(right, 0.0, atol=1e-9)
    r = np.array([1.203, 0.65, -0.09])
    np.testing.assert_allclose(result.f[0], [*-left[:3], *-np.cross(r, left[:3])], atol=1e-9)


def test_brake_torque_acts_between_wheel_and_carrier():
    """The carrier turns by 0.5 rad per metre of travel: a wheel that slips under 8 N m is lifted by 4 N, and the
    chassis turned back."""
    shape = np.zeros((2, 7, 5))
    shape[:, :, 4] = 0.5 * np.array([-0.15, -0.1, -0.05, 0.0, 0.05, 0.1, 0.15])
    element = guide(
        np.random.default_rng(0), steered=False, shape=tuple(shape.ravel()), opposite=(0.0,) * 70,
        stiffness=(0.0,) * 64,
        windup=(0.0,) * 16, springs=(Law.linear(0.0),) * 2, coupling=(0.0,) * 4, ratios=(0.0,) * 10,
    )  # fmt: skip
    twists = np.zeros((4, 6))
    twists[1, 4] = 30.0  # the left wheel rolls forwards
    poses = [
        ((0.2, 0.1, 0.4), (0, 0, 0)),
        ((1.4, 0.75, 0.3), (0, 0, 0)),
        ((1.4, -0.75, 0.31), (0, 0, 0)),
        ((0, 0, 0), (0, 0, 0)),
    ]
    result = element.evaluate(kinematics(poses, twists), zp=(0.0,) * 4, cz=H, u=(20.0, 0.0))
    np.testing.assert_allclose(result.f[1], [0, 0, 4.0, 0, -8.0, 0], atol=1e-12)
    assert element.output(result, 'brake_torque_left')[0] == pytest.approx(-8.0)
    np.testing.assert_allclose(
        result.f[0][3:], np.array([0, 8.0, 0]) - np.cross([1.2, 0.65, -0.1], [0, 0, 4.0]), atol=1e-12
    )


def test_a_drive_turns_the_carrier_back():
    """Half of 40 N m on the left wheel, whose carrier turns by 0.5 rad/m: it is pushed down by 10 N. On the wheel acts
    another element, and above the speed of the limiter nothing."""
    shape = np.zeros((2, 7, 5))
    shape[:, :, 4] = 0.5 * np.array([-0.15, -0.1, -0.05, 0.0, 0.05, 0.1, 0.15])
    element = guide(
        np.random.default_rng(0), steered=False, shape=tuple(shape.ravel()), opposite=(0.0,) * 70,
        stiffness=(0.0,) * 64,
        windup=(0.0,) * 16, springs=(Law.linear(0.0),) * 2, coupling=(0.0,) * 4, ratios=(0.0,) * 10,
        drives=((0.5, 0.0, 1.0, 50.0),),
    )  # fmt: skip
    poses = [
        ((0.2, 0.1, 0.4), (0, 0, 0)),
        ((1.4, 0.75, 0.3), (0, 0, 0)),
        ((1.4, -0.75, 0.31), (0, 0, 0)),
        ((0, 0, 0), (0, 0, 0)),
    ]
    for spin, force in ((30.0, -10.0), (101.0, 0.0)):
        twists = np.zeros((4, 6))
        twists[1, 4] = spin
        result = element.evaluate(kinematics(poses, twists), zp=(0.0,) * 4, cz=H, u=(0.0, 40.0))
        np.testing.assert_allclose(result.f[1], [0, 0, force, 0, 0, 0], atol=1e-12)
        np.testing.assert_allclose(
            result.f[0], [0, 0, -force, *np.cross([1.2, 0.65, -0.1], [0, 0, -force])], atol=1e-12
        )


def test_refuses_drives_without_an_input_and_more_than_two(rng):
    with pytest.raises(SpecError, match=r"Guide 'g': drives = 3: must be 2 at most"):
        guide(rng, drives=((1.0, 0.0, 1.0, 0.0),) * 3)
    with pytest.raises(SpecError, match=r"Guide 'g': drive = None: is needed with drives"):
        guide(rng, drive=None)


def test_a_damper_on_a_stiff_mount_is_the_damper(rng):
    """With a mount of 1e9 N/m forces differ from those without one by no more than the mount's way in a step, F/(k cz),
    tells."""
    law = Law.linear(500.0)
    same = {'dampers': (law, law), 'yields': (Law.linear(1.0 / 500.0),) * 2}
    rigid, stiff = (guide(np.random.default_rng(3), mounts=k, **same) for k in ((0.0, 0.0), (1e9, 1e9)))
    kin = placed(rng, speed=1.0)
    a, b = (element.evaluate(kin, zp=(0.0,) * 4, cz=H, u=(0.0, 0.0)) for element in (rigid, stiff))
    force = np.abs([rigid.output(a, f'damper_force_{side}')[0] for side in ('left', 'right')]).max()
    assert force > 10.0
    assert np.abs(a.f - b.f).max() < 10.0 * 500.0 * force / (1e9 * H)


def test_springs_and_dampers_of_the_gear_hold_the_steering():
    """By hand: turned by 0.2 rad and turning at 3 rad/s, springs of 40 N m/rad and dampers of 2 N m s/rad turn back
    with 14 N m."""
    element = guide(
        np.random.default_rng(0), shape=(0.0,) * 490, opposite=(0.0,) * 70, stiffness=(0.0,) * 64, windup=(0.0,) * 16,
        springs=(Law.linear(0.0),) * 2, coupling=(0.0,) * 4, jacking=(0.0,) * 6, ratios=(0.0,) * 10,
        gear=(Law.linear(40.0), Law.linear(2.0)),
    )  # fmt: skip
    twists = np.zeros((4, 6))
    twists[3, 5] = 3.0
    poses = [
        ((0.2, 0.1, 0.4), (0, 0, 0)),
        ((1.4, 0.75, 0.3), (0, 0, 0)),
        ((1.4, -0.75, 0.31), (0, 0, 0)),
        ((0, 0, 0), (0, 0, 0.2)),
    ]
    result = element.evaluate(kinematics(poses, twists), zp=(0.0,) * 4, cz=H, u=(0.0, 0.0))
    np.testing.assert_allclose(result.f[3], [0, 0, 0, 0, 0, -14.0], atol=1e-12)
    np.testing.assert_allclose(result.f[0], [0, 0, 0, 0, 0, 14.0], atol=1e-12)
    assert element.output(result, 'gear_torque')[0] == pytest.approx(-14.0)
    assert element.output(result, 'energy')[0] == pytest.approx(0.5 * 40.0 * 0.2**2)
    assert element.output(result, 'dissipation')[0] == pytest.approx(2.0 * 3.0**2)


def test_refuses_maps_of_another_size(rng):
    with pytest.raises(SpecError, match="Guide 'g': shape = 3: must be 490 numbers"):
        guide(rng, shape=(1.0, 2.0, 3.0))


def test_refuses_a_stiffness_that_is_not_symmetric(rng):
    skew = np.eye(8)
    skew[0, 3] = 0.5
    with pytest.raises(
        SpecError, match=r"Guide 'g': stiffness = 0.5: is how far it is from its transpose; it must be symmetric"
    ):
        guide(rng, stiffness=tuple(skew.ravel()))
