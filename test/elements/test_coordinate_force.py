"""Coordinate forces: torsional spring, anti-roll bar, drive torque, bump stop."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from contract import (
    ContractContext,
    Element,
    check_contract,
    check_power_balance,
    check_tangents,
    forcing,
    kinematics,
    random_kinematics,
    random_marker,
)

from solver.elements.coordinate import CoordinateSpec
from solver.elements.coordinate_force import OUTPUTS, CoordinateForceSpec, compile_coordinate_forces, coordinate_forces
from solver.elements.laws import Law
from solver.elements.marker import Marker
from solver.errors import SpecError

LAW = Law.table([[-2.0, -9.0], [0.0, 0.0], [1.0, 2.0], [3.0, 12.0]])


def forces(specs, coordinates, *, bodies=2, inputs=(), com=None):
    context = ContractContext(bodies=bodies, com=com, inputs=inputs, coordinates=coordinates)
    x = context.coordinate_table()
    table = compile_coordinate_forces(specs, context)
    laws = context.laws()
    angle = np.zeros(len(coordinates))
    return Element(forcing(coordinate_forces, table, laws, x, angle), context, n=len(specs), outputs=OUTPUTS)


def chassis_coordinates(rng):
    """Three coordinates between a chassis b0 and b1, b2, and the world: the terms share bodies as in an anti-roll
    bar."""
    return [
        CoordinateSpec(name='left', kind='rotation', i=random_marker(rng, 'b0'), j=random_marker(rng, 'b1')),
        CoordinateSpec(name='right', kind='rotation', i=random_marker(rng, 'b0'), j=random_marker(rng, 'b2')),
        CoordinateSpec(name='slide', kind='translation', i=random_marker(rng, 'world'), j=random_marker(rng, 'b2')),
    ]


@pytest.mark.parametrize('names', [('left',), ('slide',), ('left', 'right'), ('right', 'left', 'slide')])
def test_contract(rng, names):
    """One to three terms of both kinds that share bodies, with nonlinear spring and damper and a preload."""
    terms = tuple((name, float(f)) for name, f in zip(names, rng.normal(size=len(names)), strict=True))
    spec = CoordinateForceSpec(name='c', terms=terms, spring=LAW, damper=LAW, reference=0.3, preload=1.5)
    element = forces([spec], chassis_coordinates(rng), bodies=3, com=rng.normal(size=(3, 3)))
    for _ in range(3):
        check_contract(element, random_kinematics(rng, 3))


def test_input_power_is_negative_dissipation(rng):
    spec = CoordinateForceSpec(name='c', terms=(('left', 1.0),), input='drive', input_gain=-3.0, damper=LAW)
    element = forces([spec], chassis_coordinates(rng), bodies=3, inputs=('other', 'drive'))
    kin = random_kinematics(rng, 3)
    check_tangents(element, kin, u=[1.0, 2.0])
    check_power_balance(element, kin, u=[1.0, 2.0])
    with_input, without = (element.evaluate(kin, u=[1.0, value]) for value in (2.0, 0.0))
    rate = element.output(without, 'rate')[0]
    difference = element.output(with_input, 'dissipation')[0] - element.output(without, 'dissipation')[0]
    assert difference == pytest.approx(6.0 * rate, rel=1e-12)
    assert element.output(with_input, 'force')[0] - element.output(without, 'force')[0] == pytest.approx(
        -6.0, rel=1e-12
    )


@pytest.mark.parametrize(
    ('torque', 'rate', 'share'),
    [(60, 19.0, 1.0), (60, 19.5, 0.5), (60, 20.0, 0.0), (60, 30.0, 0.0), (60, -30.0, 1.0), (-60, -19.75, 0.15625)],
)
def test_limiter_ends_the_drive_at_the_top_rate(torque, rate, share):
    """20 rad/s: full torque up to 19 rad/s, a cubic to zero at 20, in both directions; a braking torque is never
    limited."""
    c = CoordinateSpec(name='a', kind='rotation', i=Marker(body='world'), j=Marker(body='b0'))
    element = forces(
        [CoordinateForceSpec(name='c', terms=(('a', 1.0),), input='drive', top_rate=20.0)],
        [c],
        bodies=1,
        inputs=('drive',),
    )
    kin = kinematics([((0, 0, 0), (0, 0, 0.4))], [[0, 0, 0, 0, 0, rate]])
    assert element.output(element.evaluate(kin, u=[torque]), 'force')[0] == pytest.approx(torque * share, abs=1e-12)
    check_power_balance(element, kin, u=[torque])


@pytest.mark.parametrize('damper', [LAW, None])
def test_limiter_has_exact_tangents(rng, damper):
    spec = CoordinateForceSpec(name='c', terms=(('left', 1.0), ('right', 0.5)), input='drive', damper=damper)
    coordinates, kin = chassis_coordinates(rng), random_kinematics(rng, 3)
    free = forces([spec], coordinates, bodies=3, inputs=('drive',))
    rate = free.output(free.evaluate(kin, u=[2.0]), 'rate')[0]
    element = forces([dataclasses.replace(spec, top_rate=abs(rate) / 0.97)], coordinates, bodies=3, inputs=('drive',))
    torque = [2.0 * np.sign(rate)]
    assert element.evaluate(kin, u=torque).f[1] != pytest.approx(free.evaluate(kin, u=torque).f[1])
    check_tangents(element, kin, u=torque)
    check_power_balance(element, kin, u=torque)


def test_torsional_spring_turns_back():
    """0.4 rad about z beyond a free angle of 0.1 at 50 N m/rad, turning at 2 rad/s at 3 N m s/rad: Q = -15 - 6 = -21 N
    m on j."""
    c = CoordinateSpec(name='a', kind='rotation', i=Marker(body='b0'), j=Marker(body='b1'))
    spec = CoordinateForceSpec(
        name='c', terms=(('a', 1.0),), spring=Law.linear(50.0), damper=Law.linear(3.0), reference=0.1
    )
    element = forces([spec], [c])
    result = element.evaluate(
        kinematics([((0, 0, 0), (0, 0, 0)), ((1, 0, 0), (0, 0, 0.4))], [[0] * 6, [0, 0, 0, 0, 0, 2.0]])
    )
    np.testing.assert_allclose(result.f[:2], [[0, 0, 0, 0, 0, 21], [0, 0, 0, 0, 0, -21]], atol=1e-12)
    np.testing.assert_allclose(result.out[0], [0.5 * 50 * 0.3**2, 12.0, 0.4, 2.0, -21.0], atol=1e-12)


def test_anti_roll_bar_opposes_opposite_motion_only():
    """Terms +1, -1 at 100 N m/rad: (0.2, 0.2) rad gives nothing; (0.2, -0.1) rad gives -30 and +30 N m."""
    coordinates = [
        CoordinateSpec(name=n, kind='rotation', i=Marker(body='world'), j=Marker(body=b))
        for n, b in (('l', 'b0'), ('r', 'b1'))
    ]
    spec = CoordinateForceSpec(name='bar', terms=(('l', 1.0), ('r', -1.0)), spring=Law.linear(100.0))
    element = forces([spec], coordinates)
    equal = element.evaluate(kinematics([((0, 0, 0), (0, 0, 0.2)), ((0, 1, 0), (0, 0, 0.2))]))
    np.testing.assert_allclose(equal.f, 0.0, atol=1e-12)
    opposite = element.evaluate(kinematics([((0, 0, 0), (0, 0, 0.2)), ((0, 1, 0), (0, 0, -0.1))]))
    np.testing.assert_allclose(opposite.f[:2, 5], [-30.0, 30.0], atol=1e-12)
    np.testing.assert_allclose(opposite.f[2], [0, 0, 0, 0, 0, 0], atol=1e-12)


def test_preload_acts_towards_smaller_values():
    c = CoordinateSpec(name='s', kind='translation', i=Marker(body='world'), j=Marker(body='b0'))
    element = forces([CoordinateForceSpec(name='c', terms=(('s', 2.0),), preload=5.0)], [c], bodies=1)
    result = element.evaluate(kinematics([((0, 0, 0.5), (0, 0, 0))]))
    np.testing.assert_allclose(result.f[0], [0, 0, -10, 0, 0, 0], atol=1e-14)
    assert element.output(result, 'energy')[0] == pytest.approx(5.0)


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'terms': ()}, 'terms .* needs 1 to 3'),
        ({'terms': (('a', 1.0),) * 4}, 'terms .* needs 1 to 3'),
        ({'terms': (('a', float('nan')),)}, 'factor of a .* finite'),
        ({'preload': 'x'}, 'preload .* finite'),
        ({'top_rate': 10.0}, 'top_rate .* limits an input'),
        ({'top_rate': -1.0, 'input': 'u'}, 'top_rate'),
    ],
)
def test_refusals_name_element_field_and_remedy(changes, message):
    with pytest.raises(SpecError, match="CoordinateForce 'c': " + message):
        CoordinateForceSpec(**{'name': 'c', 'terms': (('a', 1.0),), **changes})


def test_unknown_coordinate_is_refused_with_a_suggestion():
    c = CoordinateSpec(name='steer', kind='rotation', i=Marker(body='b0'), j=Marker(body='b1'))
    with pytest.raises(SpecError, match="did you mean 'steer'"):
        forces([CoordinateForceSpec(name='c', terms=(('ster', 1.0),))], [c])
