"""Aerodynamic drag and lift."""

from __future__ import annotations

import numpy as np
import pytest
from contract import ContractContext, Element, check_contract, forcing, kinematics, random_kinematics
from scipy.spatial.transform import Rotation

from solver.elements.aero_drag import OUTPUTS, AeroDragSpec, aero_drag_forces, compile_aero_drags
from solver.elements.marker import Marker
from solver.errors import SpecError


def drags(specs, *, com=None):
    context = ContractContext(bodies=1, com=com)
    table = compile_aero_drags(specs, context)
    laws = context.laws()
    return Element(forcing(aero_drag_forces, table, laws), context, n=len(specs), outputs=OUTPUTS)


def test_contract(rng):
    """Tangents are exact and the power of the force is the dissipation; there is no reaction on the air."""
    marker = Marker(body='b0', position=rng.normal(size=3), orientation=Rotation.random(random_state=rng).as_quat())
    spec = AeroDragSpec(name='d', marker=marker, drag_area=0.7, lift_area=-0.4)
    element = drags([spec, spec.replace(name='e', lift_area=0.0)], com=rng.normal(size=(1, 3)))
    for _ in range(3):
        check_contract(element, random_kinematics(rng, 1), pair=False)


def test_contract_at_rest(rng):
    """At rest force and tangents vanish, without a division by zero."""
    element = drags(
        [AeroDragSpec(name='d', marker=Marker(body='b0', position=(1, 2, 3)), drag_area=0.7, lift_area=0.2)]
    )
    kin = random_kinematics(rng, 1, speed=0.0)
    check_contract(element, kin, pair=False)
    result = element.evaluate(kin, tangents=True)
    assert not np.any(result.f) and not np.any(result.Kq) and not np.any(result.Kv)


def test_drag_of_a_moving_car():
    """20 m/s along world y, the car heading along it: 0.5*1.2*0.75*400 = 180 N against the motion, 36 N down; moments
    of the arm.

    The arm (0, 0, 0.5) in B gives a pitch moment of (0, 0, 0.5) x (-180, 0, -36) = (0, -90, 0) N m.
    """
    marker = Marker(body='b0', position=(0, 0, 0.5))
    element = drags([AeroDragSpec(name='d', marker=marker, drag_area=0.75, lift_area=-0.15)])
    result = element.evaluate(kinematics([((0, 0, 0), (0, 0, np.pi / 2))], [[0, 20, 0, 0, 0, 0]]))
    np.testing.assert_allclose(result.f[0], [0, -180, -36, 0, -90, 0], atol=1e-12)
    np.testing.assert_allclose(result.out[0], [0, 3600, -180, 0, -36, 20], atol=1e-12)


def test_drag_is_quadratic_and_odd():
    element = drags([AeroDragSpec(name='d', marker=Marker(body='b0'), drag_area=0.75)])
    forces = [
        element.evaluate(kinematics([((0, 0, 0), (0, 0, 0))], [[v, 0, 0, 0, 0, 0]])).f[0, 0]
        for v in (10.0, 20.0, -20.0)
    ]
    np.testing.assert_allclose(forces, [-45.0, -180.0, 180.0], rtol=1e-14)


def test_refuses_a_negative_drag_area():
    with pytest.raises(SpecError, match=r"AeroDrag 'd': drag_area = -1.0: must be >= 0"):
        AeroDragSpec(name='d', marker=Marker(body='b0'), drag_area=-1.0)
