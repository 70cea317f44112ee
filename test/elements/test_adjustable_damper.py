"""Adjustable dampers: between two characteristics, by a valve that follows its command."""

from __future__ import annotations

import numpy as np
import pytest
from contract import ContractContext, Element, check_contract, forcing, kinematics, random_kinematics, random_marker

from solver.elements.adjustable_damper import (
    OUTPUTS,
    AdjustableDamperSpec,
    adjustable_dampers,
    compile_adjustable_dampers,
)
from solver.elements.coordinate import CoordinateSpec
from solver.elements.laws import Law
from solver.elements.marker import Marker
from solver.errors import SpecError

SOFT, FIRM = Law.linear(300.0), Law.table([[-1.0, -900.0], [0.0, 0.0], [1.0, 3000.0]])
SLIDE = CoordinateSpec(name='slide', kind='translation', i=Marker(body='world'), j=Marker(body='b0'))


def dampers(specs, coordinates, bodies=1):
    context = ContractContext(bodies=bodies, inputs=('valve',), coordinates=coordinates)
    x, table = context.coordinate_table(), compile_adjustable_dampers(specs, context)
    acts = forcing(adjustable_dampers, table, context.laws(), x, np.zeros(len(coordinates)))
    return Element(acts, context, n=len(specs), outputs=OUTPUTS)


def damper(**changes):
    return AdjustableDamperSpec(
        **{'name': 'd', 'terms': (('slide', 1.0),), 'soft': SOFT, 'firm': FIRM, 'input': 'valve', 'lag': 0.02} | changes
    )


@pytest.mark.parametrize('terms', [(('slide', 1.0),), (('left', 0.7), ('right', -1.2), ('slide', 0.4))])
def test_contract(rng, terms):
    """Tangents, action = reaction and power balance hold for one to three terms of both kinds, at any valve and
    command."""
    coordinates = [
        CoordinateSpec(name='left', kind='rotation', i=random_marker(rng, 'b0'), j=random_marker(rng, 'b1')),
        CoordinateSpec(name='right', kind='rotation', i=random_marker(rng, 'b0'), j=random_marker(rng, 'b2')),
        CoordinateSpec(name='slide', kind='translation', i=random_marker(rng, 'world'), j=random_marker(rng, 'b2')),
    ]
    element = dampers([damper(terms=terms)], coordinates, bodies=3)
    for command in (0.0, 0.4, 1.0):
        check_contract(element, random_kinematics(rng, 3), zp=rng.uniform(size=1), cz=0.01, u=(command,))


@pytest.mark.parametrize(('command', 'held'), [(-3.0, 0.0), (0.25, 0.25), (7.0, 1.0)])
def test_force_lies_between_the_characteristics(command, held):
    """At 1 m/s soft gives 300 N and firm 3000 N; a command beyond 0 and 1 is the nearest of them."""
    kin = kinematics([((0, 0, 0), (0, 0, 0))], np.array([[0, 0, 1.0, 0, 0, 0]]))
    result = dampers([damper()], [SLIDE]).evaluate(kin, zp=(0.1,), cz=0.03, u=(command,))
    valve = (0.1 + 0.03 / 0.02 * held) / (1.0 + 0.03 / 0.02)  # of the stage: z = zp + cz dz/dt, lag dz/dt = u - z
    force = 300.0 + valve * 2700.0
    np.testing.assert_allclose(result.f[0], [0, 0, -force, 0, 0, 0], rtol=1e-12)
    np.testing.assert_allclose(result.out[0], [0.0, force, 1.0, -force, valve], rtol=1e-12)


def test_a_lag_of_zero_is_refused():
    with pytest.raises(SpecError, match="AdjustableDamper 'd': lag"):
        damper(lag=0.0)


def test_terms_are_checked():
    with pytest.raises(SpecError, match='needs 1 to 3'):
        damper(terms=())
