"""The test of the toy element of the recipe in docs/contributing.md, as it would stand in test/elements/."""

from __future__ import annotations

import numpy as np
import pytest
from contract import ContractContext, Element, check_contract, forcing, kinematics, random_kinematics
from solver.elements.pusher import OUTPUTS, PusherSpec, compile_pushers, pusher_forces

from solver.elements.marker import Marker
from solver.errors import SpecError


def pushers(specs):
    context = ContractContext(bodies=2, inputs=('drive',))
    table, laws = compile_pushers(specs, context), context.laws()
    return Element(forcing(pusher_forces, table, laws), context, n=len(specs), outputs=OUTPUTS)


@pytest.mark.parametrize('other', ['b1', 'world'])
def test_contract(rng, other):
    """Tangents, action = reaction and power balance hold anywhere."""
    i, j = Marker(body='b0', position=rng.normal(size=3)), Marker(body=other, position=rng.normal(size=3))
    element = pushers([PusherSpec(name='p', i=i, j=j, input='drive', gain=3.0, lag=0.2)])
    for _ in range(3):
        check_contract(element, random_kinematics(rng, 2), zp=rng.normal(size=1), cz=0.01, u=(0.7,))


def test_it_pushes_apart():
    """Gain 3 N, state 2, along x: 6 N on j, as much on i against it."""
    spec = PusherSpec(name='p', i=Marker(body='b0'), j=Marker(body='b1'), input='drive', gain=3.0, lag=0.2)
    kin = kinematics([((0, 0, 0), (0, 0, 0)), ((2, 0, 0), (0, 0, 0))], np.zeros((2, 6)))
    result = pushers([spec]).evaluate(kin, zp=(2.0,), u=(5.0,))  # cz = 0: the state is that given
    np.testing.assert_allclose(result.f, [[-6, 0, 0, 0, 0, 0], [6, 0, 0, 0, 0, 0], [0] * 6], atol=1e-12)


def test_refuses_a_lag_of_zero():
    with pytest.raises(SpecError, match="Pusher 'p': lag"):
        PusherSpec(name='p', i=Marker(body='b0'), j=Marker(body='b1'), input='drive', gain=1.0, lag=0.0)
