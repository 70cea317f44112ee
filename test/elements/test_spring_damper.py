"""Point-to-point spring-damper."""

from __future__ import annotations

import numpy as np
import pytest
from contract import ContractContext, Element, check_contract, forcing, kinematics, random_kinematics

from solver.elements.laws import Law
from solver.elements.marker import Marker
from solver.elements.spring_damper import OUTPUTS, SpringDamperSpec, compile_spring_dampers, spring_damper_forces
from solver.errors import SpecError

BUMP = Law.table([[-0.5, -900.0], [0.0, 0.0], [0.8, 600.0], [1.5, 3000.0]])
DAMPER = Law.table([[-2.0, -800.0], [0.0, 0.0], [2.0, 2400.0]])


def spring_dampers(specs, *, bodies=2, com=None):
    context = ContractContext(bodies=bodies, com=com)
    table = compile_spring_dampers(specs, context)
    laws = context.laws()
    return Element(forcing(spring_damper_forces, table, laws), context, n=len(specs), outputs=OUTPUTS)


@pytest.mark.parametrize('other', ['b1', 'world'])
def test_contract(rng, other):
    """Tangents, action = reaction and power balance hold anywhere, with nonlinear laws and preload."""
    spec = SpringDamperSpec(
        name='s', i=Marker(body='b0', position=rng.normal(size=3)), j=Marker(body=other, position=rng.normal(size=3)),
        free_length=0.7, spring=BUMP, damper=DAMPER, preload=130.0,
    )  # fmt: skip
    reverse = spec.replace(name='r', i=spec.j, j=spec.i, free_length=2.5)
    element = spring_dampers([spec, reverse], com=rng.normal(size=(2, 3)))
    for _ in range(3):
        check_contract(element, random_kinematics(rng, 2))


def test_tension_pulls_the_points_together():
    """Stretched by 0.5 m at 40 N/m and lengthened at 3 m/s with 2 N s/m: 26 N of tension, and the torque of its lever
    arm."""
    spec = SpringDamperSpec(
        name='s', i=Marker(body='b0', position=(0.0, 0.2, 0.0)), j=Marker(body='b1'),
        free_length=1.5, spring=Law.linear(40.0), damper=Law.linear(2.0),
    )  # fmt: skip
    element = spring_dampers([spec])
    kin = kinematics([((0, 0, 0), (0, 0, 0)), ((2, 0.2, 0), (0, 0, 0))], [[0, 0, 0, 0, 0, 0], [3, 0, 0, 0, 0, 0]])
    result = element.evaluate(kin)
    np.testing.assert_allclose(result.f, [[26, 0, 0, 0, 0, -0.2 * 26], [-26, 0, 0, 0, 0, 0], [0] * 6], atol=1e-12)
    np.testing.assert_allclose(result.out[0], [0.5 * 40 * 0.5**2, 2 * 3**2, 2.0, 3.0, 26.0], atol=1e-12)


def test_refuses_a_negative_free_length():
    with pytest.raises(SpecError, match="SpringDamper 's': free_length"):
        SpringDamperSpec(name='s', i=Marker(body='b0'), j=Marker(body='b1'), free_length=-1.0)
