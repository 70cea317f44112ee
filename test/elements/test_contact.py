"""Nonholonomic contacts: what they hold, their rows and the derivative of their forces."""

from __future__ import annotations

import numpy as np
import pytest
from contract import STEP, ContractContext, displaced, kinematics, random_kinematics
from scipy.spatial.transform import Rotation

from solver.elements.contact import KINDS, ContactSpec, add_contact_gradients, compile_contacts, evaluate_contacts
from solver.elements.marker import Marker
from solver.errors import SpecError

BODIES = [('b0', 'b1'), ('world', 'b1'), ('b0', 'world')]


def random_marker(rng, body):
    return Marker(body=body, position=rng.normal(size=3), orientation=Rotation.random(random_state=rng).as_quat())


def contact(kind, i, j, **fields):
    return ContactSpec(name='contact', kind=kind, i=i, j=j, **({'radius': 0.4} if kind == 'rolling' else {}), **fields)


class Rows:
    """The rows of one contact between two bodies (index 2: the world) as functions of the kinematics."""

    def __init__(self, spec: ContactSpec, com=None) -> None:
        context = ContractContext(com=com)
        self.n = len(KINDS[spec.kind])
        self.bodies = [context.body('test', m.body) for m in (spec.i, spec.j)]
        self.table = compile_contacts([spec], context, [0], [(1, 2)])

    def evaluate(self, kin) -> tuple[np.ndarray, np.ndarray]:
        """phi (rows,) and A (rows, 18): columns of b0, b1, world."""
        phi = np.full(self.n, np.nan, kin.p.dtype)
        blocks = np.full((3, 6, 6), np.nan, kin.p.dtype)
        evaluate_contacts(self.table, kin, True, phi, blocks)
        A = np.zeros((self.n, 3, 6), kin.p.dtype)
        for block, b in zip(blocks[1:], self.bodies, strict=True):
            A[:, b] += block[: self.n]
        return phi, A.reshape(self.n, 18)

    def gradient(self, kin, lam: np.ndarray) -> np.ndarray:
        """d(A^T lam)/dq, (12, 12)."""
        blocks = np.zeros((5, 6, 6))
        add_contact_gradients(self.table, kin, lam, blocks)
        return blocks[1:].reshape(2, 2, 6, 6).transpose(0, 2, 1, 3).reshape(12, 12)


@pytest.mark.parametrize(('i', 'j'), BODIES)
@pytest.mark.parametrize('kind', KINDS)
def test_rows_and_their_derivatives_are_those_of_the_complex_step(rng, kind, i, j):
    """A = d phi/dq of holonomic rows, d phi/dv of the others; d(A^T lam)/dq of all: to rounding (1e-12 of the largest entry)."""
    rows = Rows(contact(kind, random_marker(rng, i), random_marker(rng, j)), com=rng.normal(size=(2, 3)))
    holonomic = np.array([flag for _, flag in KINDS[kind]]) == 1
    still = np.zeros((2, 6))
    for _ in range(5):
        kin = random_kinematics(rng, 2)
        lam = rng.normal(size=rows.n)
        phi, A = rows.evaluate(kin)
        assert np.isfinite(phi).all()
        K = rows.gradient(kin, lam)
        A_exact, K_exact = np.zeros((rows.n, 12)), np.zeros((12, 12))
        for k, e in enumerate(np.eye(12).reshape(12, 2, 6)):
            phi_moved, A_moved = rows.evaluate(displaced(kin, e, still))
            phi_pushed, _ = rows.evaluate(displaced(kin, still, e))
            A_exact[:, k] = np.where(holonomic, phi_moved.imag, phi_pushed.imag) / STEP
            K_exact[:, k] = (A_moved.T @ lam)[:12].imag / STEP
        np.testing.assert_allclose(A[:, :12], A_exact, rtol=0, atol=1e-12 * max(1.0, np.abs(A_exact).max()))
        np.testing.assert_allclose(K, K_exact, rtol=0, atol=1e-12 * max(1.0, np.abs(K_exact).max()))
        np.testing.assert_allclose(phi[~holonomic], (A @ kin.v.ravel())[~holonomic], rtol=0, atol=1e-12 * max(1.0, np.abs(A).max()))


@pytest.mark.parametrize('kind', KINDS)
def test_contact_forces_are_opposite_and_do_no_net_moment(rng, kind):
    rows = Rows(contact(kind, random_marker(rng, 'b0'), random_marker(rng, 'b1')), com=rng.normal(size=(2, 3)))
    kin = random_kinematics(rng, 2)
    f = (rows.evaluate(kin)[1].T @ rng.normal(size=rows.n)).reshape(3, 6)
    moments = np.cross(kin.p, f[:, :3]) + np.einsum('bij,bj->bi', kin.R, f[:, 3:])
    np.testing.assert_allclose(f[:, :3].sum(0), 0.0, atol=1e-13 * np.abs(f).max())
    np.testing.assert_allclose(moments.sum(0), 0.0, atol=1e-13 * np.abs(f).max() * (1 + np.abs(kin.p).max()))


def test_upright_disc_rolls_forward_with_radius_times_spin_and_leans_onto_its_lowest_point():
    """Axis along y at a height of 0.4 m: phi = 0, contact below; v_x = 0.4 w_y rolls, 0.1 m/s more slips by 0.1; v_y slips sideways."""
    disc = Rows(contact('rolling', Marker(body='world'), Marker(body='b1', orientation=(-np.sqrt(0.5), 0, 0, np.sqrt(0.5)))))
    still = ((0, 0, 0), (0, 0, 0))
    for v, slip in (((0.8, 0, 0), (0, 0)), ((0.9, 0, 0), (0.1, 0)), ((0.8, 0.2, 0), (0, 0.2))):
        kin = kinematics([still, ((3, 5, 0.4), (0, 0, 0))], [np.zeros(6), [*v, 0, 2.0, 7.0]])
        phi, A = disc.evaluate(kin)
        np.testing.assert_allclose(phi, [0.0, *slip], atol=1e-15)
    force = A.T @ [10.0, 2.0, 3.0]
    np.testing.assert_allclose(force[6:12], [2.0, 3.0, 10.0, 0.4 * 3.0, -0.4 * 2.0, 0.0], atol=1e-14)
    lean = 0.3
    kin = kinematics([still, ((0, 0, 0.4 * np.cos(lean)), (lean, 0, 0))])
    assert disc.evaluate(kin)[0][0] == pytest.approx(0.0, abs=1e-15)


def test_knife_edge_moves_along_its_blade_only():
    """Blade along x of the body, turned by 90 deg in the world, 0.5 m ahead of the centre of mass: sideways velocity -v_x + 0.5 w."""
    edge = Rows(contact('knife_edge', Marker(body='world'), Marker(body='b1', position=(0.5, 0, 0))))
    kin = kinematics([((0, 0, 0), (0, 0, 0)), ((0, 0, 0), (0, 0, np.pi / 2))], [np.zeros(6), [0.3, 4.0, 0, 0, 0, 2.0]])
    np.testing.assert_allclose(edge.evaluate(kin)[0], [-0.3 + 1.0], atol=1e-15)


@pytest.mark.parametrize(
    ('fields', 'message'),
    [
        ({'kind': 'roling', 'radius': 1.0}, "kind = 'roling': unknown kind of contact; did you mean 'rolling'"),
        ({'kind': 'rolling'}, 'radius = None: a rolling contact needs the radius'),
        ({'kind': 'rolling', 'radius': 0.0}, 'radius = 0'),
        ({'kind': 'knife_edge', 'radius': 1.0}, 'radius = 1.0: only a rolling contact has a radius'),
        ({'kind': 'knife_edge', 'j': Marker(body='b0')}, "j.body = 'b0': must differ from i.body"),
    ],
)
def test_refusals_name_contact_field_and_remedy(fields, message):
    with pytest.raises(SpecError, match="Contact 'contact': " + message):
        ContactSpec(**{'name': 'contact', 'i': Marker(body='b0'), 'j': Marker(body='b1'), **fields})
