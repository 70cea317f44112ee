"""Transmissions: an elastic mesh behind universal joints."""

from __future__ import annotations

import numpy as np
import pytest
from contract import ContractContext, Element, check_contract, forcing, random_kinematics, random_marker

from solver.elements.coordinate import CoordinateSpec
from solver.elements.coordinate_force import CoordinateForceSpec, compile_coordinate_forces, coordinate_forces
from solver.elements.laws import Law
from solver.elements.transmission import OUTPUTS, TransmissionSpec, compile_transmissions, transmission_forces
from solver.errors import SpecError

LAW = Law.table([[-2.0, -9.0], [0.0, 0.0], [1.0, 2.0], [3.0, 12.0]])


def coordinates(rng):
    """A rack and a steering wheel on a chassis b0: the terms share it."""
    return [
        CoordinateSpec(name='rack', kind='translation', i=random_marker(rng, 'b0'), j=random_marker(rng, 'b1')),
        CoordinateSpec(name='wheel', kind='rotation', i=random_marker(rng, 'b0'), j=random_marker(rng, 'b2')),
    ]


def transmission(spec, given, *, com=None):
    context = ContractContext(bodies=3, com=com, coordinates=given)
    x = context.coordinate_table()
    table = compile_transmissions([spec], context)
    laws = context.laws()
    angle = np.zeros(len(given))
    return Element(forcing(transmission_forces, table, laws, x, angle), context, n=1, outputs=OUTPUTS)


def test_contract(rng):
    spec = TransmissionSpec(
        name='t', terms=(('rack', -1.7), ('wheel', 0.8)), harmonics=(0.2, -0.15, 0.05, 0.03), spring=LAW, damper=LAW
    )
    element = transmission(spec, coordinates(rng), com=rng.normal(size=(3, 3)))
    for _ in range(3):
        check_contract(element, random_kinematics(rng, 3))


def test_without_harmonics_it_is_a_coordinate_force(rng):
    given, com = coordinates(rng), rng.normal(size=(3, 3))
    terms = (('rack', -1.7), ('wheel', 0.8))
    element = transmission(
        TransmissionSpec(name='t', terms=terms, harmonics=(0.0,) * 4, spring=LAW, damper=LAW), given, com=com
    )
    context = ContractContext(bodies=3, com=com, coordinates=given)
    x, table = (
        context.coordinate_table(),
        compile_coordinate_forces([CoordinateForceSpec(name='t', terms=terms, spring=LAW, damper=LAW)], context),
    )
    laws, angle = context.laws(), np.zeros(2)
    straight = Element(forcing(coordinate_forces, table, laws, x, angle), context, n=1, outputs=OUTPUTS)
    kin = random_kinematics(rng, 3)
    a, b = element.evaluate(kin), straight.evaluate(kin)
    for name in ('f', 'Kq', 'Kv', 'out'):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-12, atol=1e-12)


def test_it_needs_two_terms():
    with pytest.raises(SpecError, match="Transmission 't': terms"):
        TransmissionSpec(name='t', terms=(('rack', 1.0),), harmonics=(0.0,) * 4)
