"""Couplers and drivers: residual, Jacobian, geometric stiffness, gear ratio."""

from __future__ import annotations

import numpy as np
import pytest
from contract import STEP, ContractContext, acting, displaced, random_kinematics
from scipy.spatial.transform import Rotation

from solver.compiled.so3 import exp
from solver.elements.coordinate import CoordinateSpec
from solver.elements.coupler import CouplerSpec, add_coupler_hessians, compile_couplers, evaluate_couplers
from solver.elements.marker import Marker
from solver.errors import SpecError

BODIES = 3
ANGLE = np.zeros(3)


def coordinates(rng):
    """A rotation and two translations between a chassis b0, b1, b2 and the world: terms share bodies, as in a
    differential."""

    def marker(body):
        return Marker(body=body, position=rng.normal(size=3), orientation=Rotation.random(random_state=rng).as_quat())

    return [
        CoordinateSpec(name='turn', kind='rotation', i=marker('b0'), j=marker('b1')),
        CoordinateSpec(name='slide', kind='translation', i=marker('b0'), j=marker('b2')),
        CoordinateSpec(name='lift', kind='translation', i=marker('b2'), j=marker('world')),
    ]


class Row:
    """The row of one coupler as a function of the kinematics of three bodies."""

    def __init__(self, specs, terms, offset=0.0, channel=None) -> None:
        context = ContractContext(bodies=BODIES, coordinates=specs, inputs=('other', 'u', 'u_rate', 'u_acceleration'))
        x = context.coordinate_table()
        self.table = compile_couplers(
            [CouplerSpec(name='row', terms=tuple(terms), offset=offset, input=channel)], context
        )
        self.residuals, self.hessians = (
            acting(evaluate_couplers, self.table, x),
            acting(add_coupler_hessians, self.table, x),
        )

    def evaluate(self, kin, u=()):
        phi = np.full(1, np.nan, kin.p.dtype)
        J = np.full((BODIES + 2, 6, 6), np.nan, kin.p.dtype)
        self.residuals(kin, ANGLE, np.array(u, float), True, phi, J)
        used = np.unique(self.table.entry[0, : self.table.terms[0]])
        gradient = np.zeros((BODIES + 2, 6), kin.p.dtype)
        gradient[used] = J[used, 0]
        return phi[0], gradient[1 : BODIES + 1].ravel()

    def stiffness(self, kin, lam):
        blocks, trash = (np.zeros((BODIES * BODIES + 1, 6, 6)) for _ in range(2))
        self.hessians(kin, np.array([lam]), blocks, trash)
        return blocks[1:].reshape(BODIES, BODIES, 6, 6).transpose(0, 2, 1, 3).reshape(6 * BODIES, 6 * BODIES)


@pytest.mark.parametrize('terms', [('turn',), ('turn', 'slide'), ('lift', 'turn', 'slide')])
def test_jacobian_and_geometric_stiffness_are_the_complex_step_derivatives(rng, terms):
    """To rounding (1e-12 of the largest entry); terms that share a body add up in its block."""
    row = Row(coordinates(rng), [(name, float(f)) for name, f in zip(terms, rng.normal(size=len(terms)), strict=True)])
    still = np.zeros((BODIES, 6))
    for _ in range(3):
        kin = random_kinematics(rng, BODIES)
        _, gradient = row.evaluate(kin)
        K = row.stiffness(kin, 0.7)
        n = 6 * BODIES
        exact, K_exact = np.zeros(n), np.zeros((n, n))
        for k, e in enumerate(np.eye(n)):
            phi, moved = row.evaluate(displaced(kin, e.reshape(BODIES, 6), still))
            exact[k] = phi.imag / STEP
            K_exact[:, k] = 0.7 * moved.imag / STEP
        np.testing.assert_allclose(gradient, exact, rtol=0, atol=1e-12 * max(1.0, np.abs(exact).max()))
        np.testing.assert_allclose(K, K_exact, rtol=0, atol=1e-12 * max(1.0, np.abs(K_exact).max()))


def test_rack_and_pinion_closes_at_its_ratio():
    """x - 0.05 m/rad * angle = offset: 0.4 rad and 0.02 m close it, a lever of 1 N on the rack is 0.05 N m on the
    pinion."""
    specs = [
        CoordinateSpec(name='angle', kind='rotation', i=Marker(body='world'), j=Marker(body='b0')),
        CoordinateSpec(name='x', kind='translation', i=Marker(body='world'), j=Marker(body='b1')),
    ]
    row = Row(specs, [('x', 1.0), ('angle', -0.05)])
    kin = random_kinematics(np.random.default_rng(0), BODIES)
    kin.R[0] = np.array(exp((0.0, 0.0, 0.4))).reshape(3, 3)
    kin.R[1], kin.p[1] = np.eye(3), (0.0, 0.0, 0.02)
    phi, gradient = row.evaluate(kin)
    assert phi == pytest.approx(0.0, abs=1e-16)
    force = gradient.reshape(BODIES, 6)
    np.testing.assert_allclose(force[0], [0, 0, 0, 0, 0, -0.05], atol=1e-16)
    np.testing.assert_allclose(force[1], [0, 0, 1, 0, 0, 0], atol=1e-16)


def test_driver_subtracts_its_input(rng):
    """phi = x - offset - u: the coordinate is driven to offset + u."""
    specs = coordinates(rng)
    kin = random_kinematics(rng, BODIES)
    free, _ = Row(specs, [('slide', 1.0)]).evaluate(kin)
    driven, _ = Row(specs, [('slide', 1.0)], offset=0.25, channel='u').evaluate(kin, [9.0, 0.5])
    assert driven == pytest.approx(free - 0.75, abs=1e-14)


@pytest.mark.parametrize(
    ('fields', 'message'),
    [
        ({'terms': ()}, 'terms .* needs 1 to 3'),
        ({'terms': (('a', 1.0),) * 4}, 'terms .* needs 1 to 3'),
        ({'terms': (('a', float('inf')),)}, 'factor of a'),
        ({'offset': float('nan')}, 'offset'),
    ],
)
def test_refusals_name_coupler_field_and_remedy(fields, message):
    with pytest.raises(SpecError, match="Coupler 'c': " + message):
        CouplerSpec(**{'name': 'c', 'terms': (('a', 1.0),), **fields})
