"""Struts: a damper in a row with a rubber mount, against hand-computed cases and against a small mass between the
two."""

from __future__ import annotations

import numpy as np
import pytest
from contract import ContractContext, Element, check_contract, forcing, kinematics, random_kinematics

from solver.elements.laws import Law
from solver.elements.marker import Marker
from solver.elements.strut import OUTPUTS, StrutSpec, compile_struts, strut_forces
from solver.errors import SpecError

STOPS = Law.table([[-0.5, -9000.0], [-0.1, 0.0], [0.8, 0.0], [1.5, 3000.0]])
DAMPER = Law.table([[-2.0, -1800.0], [-0.3, -900.0], [0.0, 0.0], [0.2, 1400.0], [2.0, 2400.0]])
MOUNT = Law.table([[-1.0, -9000.0], [0.0, 0.0], [0.5, 3000.0], [1.0, 9000.0]])


def struts(specs, *, bodies=2, com=None):
    context = ContractContext(bodies=bodies, com=com)
    table = compile_struts(specs, context)
    laws = context.laws()
    return Element(forcing(strut_forces, table, laws), context, n=len(specs), outputs=OUTPUTS)


@pytest.mark.parametrize('other', ['b1', 'world'])
def test_contract(rng, other):
    """Tangents with the mount's state eliminated, action = reaction, power balance, purity; with steep knees in every
    law."""
    spec = StrutSpec(
        name='s', i=Marker(body='b0', position=rng.normal(size=3)), j=Marker(body=other, position=rng.normal(size=3)),
        free_length=1.7, spring=Law((-0.3,), (0.0,), (400.0,)), stops=STOPS, damper=DAMPER, mount=MOUNT,
        mount_damping=300.0,
    )  # fmt: skip
    reverse = spec.replace(name='r', i=spec.j, j=spec.i, free_length=2.5, spring=None)
    element = struts([spec, reverse], com=rng.normal(size=(2, 3)))
    for _ in range(3):
        check_contract(element, random_kinematics(rng, 2), zp=rng.normal(size=2) * 0.1, cz=2e-3)


def test_spring_and_mount_share_a_stretch_by_their_softness():
    """At rest for long: 0.3 m over 400 N/m and 1200 N/m in a row are 90 N, of which the mount takes 0.075 m."""
    spec = StrutSpec(
        name='s',
        i=Marker(body='b0'),
        j=Marker(body='b1'),
        free_length=1.0,
        spring=Law.linear(400.0),
        mount=Law.linear(1200.0),
        mount_damping=5.0,
    )
    kin = kinematics([((0, 0, 0), (0, 0, 0)), ((1.3, 0, 0), (0, 0, 0))], np.zeros((2, 6)))
    result = struts([spec]).evaluate(kin, zp=np.zeros(1), cz=1e9)
    np.testing.assert_allclose(result.f[0], [90.0, 0, 0, 0, 0, 0], rtol=1e-6, atol=1e-9)
    assert result.z[0] == pytest.approx(0.075, rel=1e-6)
    assert result.out[0, 5] == pytest.approx(90.0, rel=1e-6)


def test_a_quick_motion_is_shared_by_damper_and_mount():
    """With the mount's extension held at 0.01 m: 12 N and 5 N s/m times its rate w balance 20 N s/m times (3 m/s - w):
    w = 1.92 m/s."""
    spec = StrutSpec(
        name='s',
        i=Marker(body='b0'),
        j=Marker(body='b1'),
        free_length=1.0,
        damper=Law.linear(20.0),
        mount=Law.linear(1200.0),
        mount_damping=5.0,
    )
    kin = kinematics([((0, 0, 0), (0, 0, 0)), ((1.01, 0, 0), (0, 0, 0))], [[0] * 6, [3.0, 0, 0, 0, 0, 0]])
    result = struts([spec]).evaluate(kin, zp=np.array([0.01]), cz=0.0)
    force = 12.0 + 5.0 * 1.92
    np.testing.assert_allclose(result.f[0], [force, 0, 0, 0, 0, 0], atol=1e-9)
    np.testing.assert_allclose(result.out[0, 1:5], [20.0 * 1.08**2 + 5.0 * 1.92**2, 1.0, 1.08, force], atol=1e-9)


def test_a_mount_needs_damping():
    with pytest.raises(SpecError, match="Strut 's': mount_damping"):
        StrutSpec(name='s', i=Marker(body='b0'), j=Marker(body='b1'), free_length=1.0, mount=MOUNT, mount_damping=0.0)
