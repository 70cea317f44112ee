"""Nonholonomic contacts: what they hold, their rows and the derivative of their forces."""

from __future__ import annotations

import numpy as np
import pytest
from constraint_rows import BODIES, Rows, check_derivatives, check_reactions
from contract import kinematics, random_kinematics, random_marker

from solver.elements.contact import CONTACTS, KINDS, ContactSpec
from solver.elements.marker import Marker
from solver.errors import SpecError


def contact(kind, i, j, **fields):
    return ContactSpec(name='contact', kind=kind, i=i, j=j, **({'radius': 0.4} if kind == 'rolling' else {}), **fields)


@pytest.mark.parametrize(('i', 'j'), BODIES)
@pytest.mark.parametrize('kind', KINDS)
def test_rows_and_their_derivatives_are_those_of_the_complex_step(rng, kind, i, j):
    """A = d phi/dq of holonomic rows, d phi/dv of the others; d(A^T lam)/dq of all: to rounding."""
    rows = Rows(CONTACTS, contact(kind, random_marker(rng, i), random_marker(rng, j)), com=rng.normal(size=(2, 3)))
    for _ in range(5):
        check_derivatives(rows, random_kinematics(rng, 2), rng.normal(size=rows.n))


@pytest.mark.parametrize('kind', KINDS)
def test_contact_forces_are_opposite_and_do_no_net_moment(rng, kind):
    rows = Rows(
        CONTACTS, contact(kind, random_marker(rng, 'b0'), random_marker(rng, 'b1')), com=rng.normal(size=(2, 3))
    )
    check_reactions(rows, random_kinematics(rng, 2), rng.normal(size=rows.n))


def test_upright_disc_rolls_forward_with_radius_times_spin_and_leans_onto_its_lowest_point():
    """Axis along y at a height of 0.4 m: phi = 0, contact below; v_x = 0.4 w_y rolls, 0.1 m/s more slips by 0.1; v_y
    slips sideways."""
    disc = Rows(
        CONTACTS,
        contact('rolling', Marker(body='world'), Marker(body='b1', orientation=(-np.sqrt(0.5), 0, 0, np.sqrt(0.5)))),
    )
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
    """Blade along x of the body, turned by 90 deg in the world, 0.5 m ahead of the centre of mass: sideways velocity
    -v_x + 0.5 w."""
    edge = Rows(CONTACTS, contact('knife_edge', Marker(body='world'), Marker(body='b1', position=(0.5, 0, 0))))
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
