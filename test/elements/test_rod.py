"""Massless rods: the laws of every element, signs by hand, and the link with mass that a rod stands for."""

from __future__ import annotations

import numpy as np
import pytest
from contract import ContractContext, Element, check_contract, forcing, kinematics, random_kinematics, random_marker

from solver.elements.laws import Law
from solver.elements.marker import Marker
from solver.elements.rod import OUTPUTS, RodSpec, compile_rods, rod_forces
from solver.errors import SpecError

LAW = Law.table([[-0.5, -900.0], [0.0, 0.0], [0.8, 600.0], [1.5, 3000.0]])


def rods(specs, *, bodies=2, com=None):
    context = ContractContext(bodies=bodies, com=com)
    table = compile_rods(specs, context)
    laws = context.laws()
    return Element(forcing(rod_forces, table, laws), context, n=len(specs), outputs=OUTPUTS)


@pytest.mark.parametrize('other', ['b1', 'world'])
def test_contract(rng, other):
    """Tangents, action = reaction and power balance hold anywhere, with a nonlinear law and unequal resistance against
    swing."""
    spec = RodSpec(
        name='s',
        i=random_marker(rng, 'b0'),
        j=random_marker(rng, other),
        length=0.7,
        law=LAW,
        damping=30.0,
        swing=(80.0, 170.0),
        across=7.0,
    )
    reverse = spec.replace(name='r', i=spec.j, j=spec.i, length=2.5)
    element = rods([spec, reverse], com=rng.normal(size=(2, 3)))
    for _ in range(3):
        check_contract(element, random_kinematics(rng, 2))


def test_a_stretched_rod_pulls_along_its_line():
    """Along its design direction, 1.5 m long: stretched by 0.5 m at 40 N/m and at 3 m/s with 2 N s/m, 26 N of
    tension."""
    spec = RodSpec(
        name='s', i=Marker(body='b0', position=(0.0, 0.2, 0.0)), j=Marker(body='b1'),
        length=1.5, law=Law.linear(40.0), damping=2.0, swing=(100.0, 300.0), across=5.0,
    )  # fmt: skip
    kin = kinematics([((0, 0, 0), (0, 0, 0)), ((0, 0.2, 2), (0, 0, 0))], [[0, 0, 0, 0, 0, 0], [0, 0, 3, 0, 0, 0]])
    result = rods([spec]).evaluate(kin)
    np.testing.assert_allclose(result.f, [[0, 0, 26, 0.2 * 26, 0, 0], [0, 0, -26, 0, 0, 0], [0] * 6], atol=1e-12)
    np.testing.assert_allclose(result.out[0], [0.5 * 40 * 0.5**2, 2 * 3**2, 2.0, 3.0, 26.0], atol=1e-12)


def test_a_rod_out_of_its_direction_is_turned_back():
    """Towards +x by 0.01 rad at 2 m: a moment of 3 N m about y, a force of 1.5 N at Q; about x only a third of it, and
    the moment on i."""
    for at, force, torque in (
        ((0.02, 0.0, 2.0), (-1.5, 0, 0), (0, 3.0, 0)),
        ((0.0, 0.02, 2.0), (0, -0.5, 0), (-1.0, 0, 0)),
    ):
        spec = RodSpec(
            name='s',
            i=Marker(body='b0'),
            j=Marker(body='b1'),
            length=float(np.hypot(0.02, 2.0)),
            law=Law.linear(1e5),
            swing=(100.0, 300.0),
        )
        result = rods([spec]).evaluate(kinematics([((0, 0, 0), (0, 0, 0)), (at, (0, 0, 0))], np.zeros((2, 6))))
        np.testing.assert_allclose(result.f[1, :3], force, rtol=2e-4, atol=2e-2)
        np.testing.assert_allclose(result.f[0, 3:], torque, rtol=2e-4, atol=2e-4)


def test_motion_across_the_rod_is_damped_apart_from_motion_along_it():
    spec = RodSpec(
        name='s', i=Marker(body='b0'), j=Marker(body='b1'), length=2.0, law=Law.linear(1.0), damping=10.0, across=3.0
    )
    kin = kinematics([((0, 0, 0), (0, 0, 0)), ((0, 0, 2), (0, 0, 0))], [[0] * 6, [0.5, 0.0, 2.0, 0, 0, 0]])
    result = rods([spec]).evaluate(kin)
    np.testing.assert_allclose(result.f[1, :3], [-1.5, 0.0, -20.0], atol=1e-12)
    assert result.out[0, 1] == pytest.approx(3.0 * 0.5**2 + 10.0 * 2.0**2)


@pytest.mark.parametrize(('field', 'value'), [('length', 0.0), ('damping', -1.0), ('across', -1.0), ('swing', (1.0,))])
def test_refusals_name_rod_and_field(field, value):
    with pytest.raises(SpecError, match=f"Rod 's': {field}"):
        RodSpec(
            **{'name': 's', 'i': Marker(body='b0'), 'j': Marker(body='b1'), 'length': 1.0, 'law': LAW, field: value}
        )
