"""Servos: an elastic mesh with a motor that has a map over torque and speed, a limit and a lag."""

from __future__ import annotations

import math

import numpy as np
import pytest
from contract import ContractContext, Element, check_contract, forcing, kinematics, random_kinematics, random_marker

from solver.elements.coordinate import CoordinateSpec
from solver.elements.laws import Law
from solver.elements.marker import Marker
from solver.elements.servo import OUTPUTS, ServoSpec, compile_servos, servo_forces
from solver.elements.transmission import OUTPUTS as OF_TRANSMISSION
from solver.elements.transmission import TransmissionSpec, compile_transmissions, transmission_forces
from solver.errors import SpecError

MAP = {
    'speeds': (0.0, 10.0, 30.0),
    'torques': (1.0, 3.0, 5.0),
    'forces': ((400.0, 3000.0, 6000.0), (200.0, 1500.0, 4000.0), (100.0, 600.0, 1500.0)),
}
ALONG_Y = (-math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))


def servo(given, *, com=None, **changed):
    """A servo on the rack b1 of a chassis b0, with the wind-up between the rack and a wheel b2; the speed is that of
    b0."""
    data = {
        'terms': (('rack', -2.0), ('wheel', 1.0)),
        'stiffness': 3.0,
        'marker': Marker(body='b0'),
        'limit': 1e6,
        'lag': 0.01,
    }
    spec = ServoSpec(name='s', **{**data, **MAP, **changed})
    context = ContractContext(bodies=3, com=com, coordinates=given)
    x = context.coordinate_table()
    table = compile_servos([spec], context)
    laws, angle = context.laws(), np.zeros(len(given))
    return Element(forcing(servo_forces, table, laws, x, angle), context, n=1, outputs=OUTPUTS)


def coordinates(rng):
    return [
        CoordinateSpec(name='rack', kind='translation', i=random_marker(rng, 'b0'), j=random_marker(rng, 'b1')),
        CoordinateSpec(name='wheel', kind='rotation', i=random_marker(rng, 'b0'), j=random_marker(rng, 'b2')),
    ]


@pytest.mark.parametrize(('limit', 'factor'), [(1e6, -2.0), (2.0, 1.7), (0.5, -2.0)])
def test_contract(rng, limit, factor):
    """Speeds within the map, forwards and backwards; below, across and above the limit; both senses of the mesh."""
    given = coordinates(rng)
    element = servo(
        given, com=rng.normal(size=(3, 3)), terms=(('rack', factor), ('wheel', 0.8)), marker=random_marker(rng, 'b0'),
        damping=0.7,
        harmonics=(0.2, -0.15, 0.05, 0.03), limit=limit,
        speeds=(0.0, 0.8, 2.0), torques=(1.0, 4.0, 9.0), forces=((0.5, 3.0, 7.0), (0.3, 2.0, 5.0), (0.1, 1.0, 2.0)),
    )  # fmt: skip
    for _ in range(4):
        check_contract(element, random_kinematics(rng, 3), zp=[0.7], cz=0.02)


def straight():
    """Rack along y, steering wheel about z, both on b0."""
    return [
        CoordinateSpec(
            name='rack',
            kind='translation',
            i=Marker(body='b0', orientation=ALONG_Y),
            j=Marker(body='b1', orientation=ALONG_Y),
        ),
        CoordinateSpec(name='wheel', kind='rotation', i=Marker(body='b0'), j=Marker(body='b2')),
    ]


def at(wheel, rack, speed):
    return kinematics(
        [((0, 0, 0), (0, 0, 0)), ((0, rack, 0), (0, 0, 0)), ((0, 0, 0), (0, 0, wheel))],
        [[speed, 0.0, 0.0, 0.0, 0.0, 0.0]] * 3,
    )


def test_without_help_it_is_a_transmission(rng):
    """A motor whose map has no force: the same forces, tangents and first outputs, to the rounding of linear laws."""
    given, com = coordinates(rng), rng.normal(size=(3, 3))
    terms, harmonics = (('rack', -1.7), ('wheel', 0.8)), (0.2, -0.15, 0.05, 0.03)
    element = servo(
        given, com=com, terms=terms, harmonics=harmonics, damping=0.7, speeds=(0.0,), torques=(1.0,), forces=((0.0,),)
    )
    context = ContractContext(bodies=3, com=com, coordinates=given)
    spec = TransmissionSpec(name='t', terms=terms, harmonics=harmonics, spring=Law.linear(3.0), damper=Law.linear(0.7))
    table, x, angle = compile_transmissions([spec], context), context.coordinate_table(), np.zeros(2)
    laws = context.laws()
    other = Element(forcing(transmission_forces, table, laws, x, angle), context, n=1, outputs=OF_TRANSMISSION)
    kin = random_kinematics(rng, 3)
    found, expected = element.evaluate(kin, zp=[0.0], cz=0.02, tangents=True), other.evaluate(kin, tangents=True)
    for name in ('f', 'Kq', 'Kv'):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(found.out[:, :5], expected.out, rtol=1e-13)


@pytest.mark.parametrize('speed', [20.0, -20.0])
@pytest.mark.parametrize('sense', [1.0, -1.0])
@pytest.mark.parametrize('turned', [1.0, -1.0])
def test_the_motor_gets_what_the_map_says(speed, sense, turned):
    """Wind-up of sense * 1 rad at 1.5 N m/rad and 6 rad/s at 0.25 N m s/rad: a torque of 3 N m; half way between 10 and
    30 m/s; the motor after one stage of 0.02 s with a lag of 0.01 s. A mesh whose terms have the other signs pushes and
    helps the same way."""
    element = servo(straight(), terms=(('rack', -2.0 * turned), ('wheel', turned)), stiffness=1.5, damping=0.25)
    kin = at(0.6 * sense, -0.2 * sense, speed)
    kin.v[1, 1] = -3.0 * sense
    result = element.evaluate(kin, zp=[30.0], cz=0.02)
    wanted = 0.5 * (1500.0 + 600.0) * sense
    expected = (30.0 + 2.0 * wanted) / 3.0
    assert element.output(result, 'force') == pytest.approx(-3.0 * sense * turned, rel=1e-12)
    assert element.output(result, 'speed') == pytest.approx(speed, rel=1e-12)
    assert element.output(result, 'motor') == result.z == pytest.approx(expected, rel=1e-12)
    assert element.output(result, 'energy') == pytest.approx(0.75, rel=1e-12)
    assert element.output(result, 'dissipation') == pytest.approx(0.25 * 36.0 + 3.0 * sense * expected, rel=1e-12)
    np.testing.assert_allclose(result.f[1], (0.0, expected + 6.0 * sense, 0.0, 0.0, 0.0, 0.0), atol=1e-9)
    np.testing.assert_allclose(result.f[2], (0.0, 0.0, 0.0, 0.0, 0.0, -3.0 * sense), atol=1e-12)


def test_no_force_without_torque_and_the_limit_at_most():
    element = servo(straight(), limit=2000.0)
    assert element.evaluate(at(0.2, 0.1, 5.0), zp=[0.0], cz=1e9).z == pytest.approx(0.0, abs=1e-12)
    assert element.evaluate(at(9.0, 0.0, 50.0), zp=[0.0], cz=1e9).z == pytest.approx(2000.0, rel=1e-9)
    assert element.evaluate(at(9.0, 0.0, 50.0), zp=[5.0], cz=0.0).z == 5.0


def test_at_a_speed_it_is_the_same_without_the_others():
    spec = ServoSpec(
        name='s',
        terms=(('rack', 1.0), ('wheel', 1.0)),
        stiffness=1.0,
        marker=Marker(body='b0'),
        limit=1.0,
        lag=1.0,
        **MAP,
    )
    assert spec.at_speed(20.0).forces == ((150.0, 1050.0, 2750.0),)
    assert spec.at_speed(99.0).forces == ((100.0, 600.0, 1500.0),)
    assert spec.at_speed(10.0).law(0) == spec.law(1)


@pytest.mark.parametrize(
    ('changed', 'match'),
    [
        ({'lag': 0.0}, "Servo 's': lag = 0.0"),
        ({'limit': -1.0}, "Servo 's': limit"),
        (
            {'speeds': (0.0, 30.0, 10.0)},
            r"Servo 's': speeds\[2\] = 10.0: must be greater than the one before it \(30\)",
        ),
        ({'torques': (0.0, 3.0, 5.0)}, r"Servo 's': torques\[0\]"),
        ({'torques': (1.0, 3.0)}, r"Servo 's': forces\[0\] = 3: must have one value for each of the 2 torques"),
        ({'forces': ((1.0, 2.0, 3.0),)}, "Servo 's': forces = 1: must have one row for each of the 3 speeds"),
        ({'forces': ((1.0, -2.0, 3.0),) * 3}, r"Servo 's': forces\[0\]\[1\] = -2.0"),
        ({'terms': (('rack', 1.0),)}, "Servo 's': terms"),
        ({'terms': (('rack', 0.0), ('wheel', 1.0))}, "Servo 's': factor of rack = 0.0"),
    ],
)
def test_refusals(changed, match):
    with pytest.raises(SpecError, match=match):
        servo(straight(), **changed)
