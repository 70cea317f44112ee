"""Rigid bodies: weight and gyroscopic torque."""

from __future__ import annotations

import numpy as np
import pytest
from contract import ContractContext, Element, check_purity, check_tangents, kinematics, random_kinematics

from solver.elements.rigid_body import RigidBodySpec, body_forces, compile_bodies
from solver.errors import SpecError

INERTIA = (2.0, 3.0, 4.0, 0.3, -0.2, 0.1)


def bodies(specs, gravity=(0.0, 0.0, -9.81)):
    """The bodies as an element kind without outputs."""
    context = ContractContext(bodies=len(specs))
    table = compile_bodies(specs, gravity, [context.slot(b, b) for b in range(len(specs))])

    def call(kin, zp, cz, u, tangents, f, Kq, Kv, z, out):
        body_forces(table, kin, tangents, f, Kv)

    return Element(call, context, n=0, outputs=())


def test_contract(rng):
    """Tangents are exact; calls are pure."""
    element = bodies(
        [RigidBodySpec(name='b0', mass=3.0, inertia=INERTIA), RigidBodySpec(name='b1', mass=1.0, inertia=INERTIA)]
    )
    kin = random_kinematics(rng, 2)
    check_purity(element, kin)
    check_tangents(element, kin)


def test_gyroscopic_torque_does_no_work_and_conserves_momentum(rng):
    """w . (w x J w) = 0; without gravity the angular momentum R J w is constant: J wdot = f."""
    spec = RigidBodySpec(name='b0', mass=3.0, inertia=INERTIA)
    element = bodies([spec], gravity=(0.0, 0.0, 0.0))
    kin = random_kinematics(rng, 1)
    w, J = kin.v[0, 3:], spec.inertia_matrix()
    torque = element.evaluate(kin).f[0, 3:]
    assert abs(torque @ w) < 1e-13 * np.abs(torque) @ np.abs(w) + 1e-13
    momentum_rate = kin.R[0] @ (np.cross(w, J @ w) + J @ np.linalg.solve(J, torque))
    np.testing.assert_allclose(momentum_rate, 0.0, atol=1e-13 * np.abs(torque).max())


def test_weight_and_gyroscopic_torque_of_a_spinning_wheel():
    """Wheel J = diag(1, 2, 1) spinning at 50 rad/s about y and yawing at 1 rad/s about z: -w x Jw = (50*1 - 1*100, 0,
    0)*-1."""
    element = bodies([RigidBodySpec(name='b0', mass=3.0, inertia=(1, 2, 1, 0, 0, 0))])
    result = element.evaluate(kinematics([((0, 0, 0), (0.3, 0.2, 0.1))], [[1, 2, 3, 0, 50, 1]]))
    np.testing.assert_allclose(result.f[0], [0, 0, -29.43, 50, 0, 0], atol=1e-12)
    assert not np.any(result.f[1])


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'mass': -1.0}, 'mass = -1.0: must be >= 0'),
        ({'inertia': (1, 1, 3, 0, 0, 0)}, 'no body has these principal moments'),
        ({'inertia': (1, 1, 1, 2, 0, 0)}, 'must be positive semidefinite'),
        ({'orientation': (0, 0, 0, 2)}, 'must be a unit quaternion'),
        ({'name': 'world'}, 'reserved'),
    ],
)
def test_refusals_name_element_field_and_remedy(changes, message):
    with pytest.raises(SpecError, match=message):
        RigidBodySpec(**{'name': 'b0', 'mass': 1.0, 'inertia': (1, 1, 1, 0, 0, 0), **changes})
