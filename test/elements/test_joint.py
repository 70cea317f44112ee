"""Joints: residuals, Jacobian, geometric stiffness, freedoms."""

from __future__ import annotations

import numpy as np
import pytest
from constraint_rows import BODIES, Rows, check_derivatives, check_reactions
from contract import kinematics, random_kinematics, random_marker
from scipy.spatial.transform import Rotation

from solver.elements.joint import JOINTS, KINDS, JointSpec
from solver.elements.marker import Marker
from solver.errors import SpecError


def joint(kind, i, j, **fields):
    return JointSpec(name='joint', kind=kind, i=i, j=j, **({'length': 0.7} if kind == 'distance' else {}), **fields)


@pytest.mark.parametrize(('i', 'j'), BODIES)
@pytest.mark.parametrize('kind', KINDS)
def test_jacobian_and_geometric_stiffness_are_the_complex_step_derivatives(rng, kind, i, j):
    """A = d phi/dq and d(A^T lam)/dq, to rounding, in open joints."""
    rows = Rows(JOINTS, joint(kind, random_marker(rng, i), random_marker(rng, j)), com=rng.normal(size=(2, 3)))
    for _ in range(3):
        check_derivatives(rows, random_kinematics(rng, 2), rng.normal(size=rows.n))


# motions of marker G in marker F (translations along and rotations about x, y, z of F) that a closed joint leaves free
FREE = {
    'fixed': (),
    'revolute': ('rz',),
    'prismatic': ('z',),
    'cylindrical': ('z', 'rz'),
    'universal': ('rx', 'ry'),
    'constant_velocity': ('rx', 'ry'),
    'spherical': ('rx', 'ry', 'rz'),
    'distance': ('y', 'z', 'rx', 'ry', 'rz'),
    'point_on_line': ('z', 'rx', 'ry', 'rz'),
    'point_on_plane': ('x', 'y', 'rx', 'ry', 'rz'),
    'perpendicular': ('x', 'y', 'z', 'ry', 'rz'),
}
# placement of G in F where the joint is closed, unless they coincide
CLOSED = {'distance': ((0.7, 0, 0), (0, 0, 0)), 'perpendicular': ((0, 0, 0), (np.pi / 2, 0, 0))}


def closed(rng, kind):
    """A joint of two randomly placed bodies that closes it: (rows, kinematics, axes of F in the world, position of G in
    the world)."""
    F, G = random_marker(rng, 'b0'), random_marker(rng, 'b1')
    kin = random_kinematics(rng, 2)
    R_F = kin.R[0] @ Rotation.from_quat(F.orientation).as_matrix()
    d, turn = CLOSED.get(kind, ((0, 0, 0), (0, 0, 0)))
    R_G = R_F @ Rotation.from_rotvec(turn).as_matrix()
    p_G = kin.p[0] + kin.R[0] @ np.array(F.position) + R_F @ np.array(d)
    kin.R[1] = R_G @ Rotation.from_quat(G.orientation).as_matrix().T
    kin.p[1] = p_G - kin.R[1] @ np.array(G.position)
    return Rows(JOINTS, joint(kind, F, G)), kin, R_F, p_G


@pytest.mark.parametrize('kind', KINDS)
def test_closed_joint_blocks_all_motions_but_its_freedoms(rng, kind):
    """phi = 0, the rows are independent, and their null space is spanned by the free motions of G in F."""
    rows, kin, R_F, p_G = closed(rng, kind)
    phi, A = rows.evaluate(kin)
    np.testing.assert_allclose(phi, 0.0, atol=1e-14)
    assert np.linalg.matrix_rank(A[:, 6:12], tol=1e-8) == rows.n
    assert rows.n + len(FREE[kind]) == 6
    for motion in FREE[kind]:
        axis = R_F[:, 'xyz'.index(motion[-1])]
        turning = motion.startswith('r')
        w = axis if turning else np.zeros(3)
        v = np.cross(w, kin.p[1] - p_G) + (0.0 if turning else axis)
        np.testing.assert_allclose(A[:, 6:12] @ np.concatenate([v, kin.R[1].T @ w]), 0.0, atol=1e-13)


@pytest.mark.parametrize('kind', KINDS)
def test_reactions_of_a_closed_joint_are_opposite_and_do_no_net_moment(rng, kind):
    rows, kin, _, _ = closed(rng, kind)
    check_reactions(rows, kin, rng.normal(size=rows.n))


def test_constant_velocity_joint_turns_both_shafts_alike(rng):
    """Shafts bent by up to 1 rad, each turned about its own axis by the same angle: closed at every angle (a universal
    joint is not)."""
    F, G = Marker(body='b0'), Marker(body='b1')
    bend = Rotation.from_rotvec([0.6, -0.8, 0.0])
    for angle in np.linspace(0.0, 2 * np.pi, 9):
        spin = Rotation.from_rotvec([0, 0, angle])
        R = (bend * spin).as_matrix()
        kin = kinematics([((0, 0, 0), spin.as_matrix()), ((0, 0, 0), R)])
        np.testing.assert_allclose(Rows(JOINTS, joint('constant_velocity', F, G)).evaluate(kin)[0], 0.0, atol=1e-14)
    kin = kinematics([((0, 0, 0), (0, 0, 0.3)), ((0, 0, 0), (bend * Rotation.from_rotvec([0, 0, 0.3])).as_matrix())])
    assert abs(Rows(JOINTS, joint('universal', F, G)).evaluate(kin)[0][3]) > 1e-2


def test_positive_multiplier_pushes_towards_larger_residuals():
    """G 0.1 m ahead of F along x: phi_x of a revolute and of a distance joint is +0.1; lam = 2 N pulls b1 along +x, b0
    along -x."""
    kin = kinematics([((0, 0, 0), (0, 0, 0)), ((0.8, 0, 0), (0, 0, 0))])
    for kind, position in (('revolute', (0.7, 0, 0)), ('distance', (0, 0, 0))):
        rows = Rows(JOINTS, joint(kind, Marker(body='b0', position=position), Marker(body='b1')))
        phi, A = rows.evaluate(kin)
        assert phi[0] == pytest.approx(0.1, abs=1e-15)
        f = 2.0 * A[0].reshape(3, 6)
        np.testing.assert_allclose(f[:, :3], [[-2, 0, 0], [2, 0, 0], [0, 0, 0]], atol=1e-15)


@pytest.mark.parametrize(
    ('fields', 'message'),
    [
        ({'kind': 'revolut'}, "kind = 'revolut': unknown kind of joint; did you mean 'revolute'"),
        ({'kind': 'distance'}, 'length = None: a distance joint needs a length'),
        ({'kind': 'distance', 'length': 0.0}, 'length = 0'),
        ({'kind': 'fixed', 'length': 1.0}, 'length = 1.0: only a distance joint has a length'),
        ({'kind': 'fixed', 'j': Marker(body='b0')}, "j.body = 'b0': must differ from i.body"),
    ],
)
def test_refusals_name_joint_field_and_remedy(fields, message):
    with pytest.raises(SpecError, match="Joint 'joint': " + message):
        JointSpec(**{'name': 'joint', 'i': Marker(body='b0'), 'j': Marker(body='b1'), **fields})
