"""Bushing."""

from __future__ import annotations

import numpy as np
import pytest
from contract import ContractContext, Element, check_contract, forcing, kinematics, random_kinematics, random_marker
from scipy.spatial.transform import Rotation

from solver.elements.bushing import OUTPUTS, BushingSpec, bushing_forces, compile_bushings
from solver.elements.laws import Law
from solver.elements.marker import Marker
from solver.errors import SpecError


def bushings(specs, *, bodies=2, com=None):
    context = ContractContext(bodies=bodies, com=com)
    table = compile_bushings(specs, context)
    laws = context.laws()
    return Element(forcing(bushing_forces, table, laws), context, n=len(specs), outputs=OUTPUTS)


def random_spec(rng, i='b0', j='b1', **changes):
    return BushingSpec(
        name='b',
        i=random_marker(rng, i),
        j=random_marker(rng, j),
        stiffness=rng.uniform(1, 5, 6),
        damping=rng.uniform(1, 5, 6),
        preload=rng.normal(size=6),
        **changes,
    )


@pytest.mark.parametrize(('i', 'j'), [('b0', 'b1'), ('world', 'b1'), ('b0', 'world')])
def test_contract_of_linear_bushings(rng, i, j):
    """Tangents, action = reaction and power balance hold at any displacement and rotation."""
    element = bushings([random_spec(rng, i, j)], com=rng.normal(size=(2, 3)))
    for _ in range(3):
        check_contract(element, random_kinematics(rng, 2))


def test_contract_of_nonlinear_bushings(rng):
    """Laws may replace the stiffness of any axis, in translation and rotation."""
    stop = Law.table([[-1.0, -9.0], [-0.2, -0.4], [0.0, 0.0], [0.3, 0.5], [1.0, 7.0]])
    element = bushings(
        [random_spec(rng, laws=(None, stop, None, stop, None, stop)), random_spec(rng)], com=rng.normal(size=(2, 3))
    )
    for _ in range(3):
        check_contract(element, random_kinematics(rng, 2))


@pytest.mark.parametrize('angle', [0.0, 1e-9, 1e-4, 0.4999, 0.5001, 2.0, 2.5, 3.1])
def test_contract_through_the_branches_of_the_rotation_vector(rng, angle):
    """Series and closed forms, and all pivots of the rotation vector, meet the contract."""
    spec = random_spec(rng)
    spec = spec.replace(i=Marker(body='b0'), j=Marker(body='b1'))
    element = bushings([spec])
    for axis in np.vstack([np.eye(3), rng.normal(size=3)]):
        kin = random_kinematics(rng, 2)
        kin.R[1] = kin.R[0] @ Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
        check_contract(element, kin)


def test_force_opposes_the_displacement_in_the_axes_of_marker_i():
    """Marker i turned by 90 deg about z: its x axis is the world's y. 2 mm along world y is 2 mm along x of the
    bushing.

    Force: 1000 N/m * 2 mm + 10 N s/m * 0.3 m/s = 5 N along -y, at the arm (0.5, 0, 0) from b1: moment -2.5 N m about z
    on b1; the reaction acts at the same point, 0.502 m - 0.5 m off along y and 0.25 m along x from b0: +1.25 N m.
    """
    quarter = tuple(Rotation.from_rotvec([0, 0, np.pi / 2]).as_quat())
    spec = BushingSpec(
        name='b',
        i=Marker(body='b0', position=(0.25, 0.5, 0.0), orientation=quarter),
        j=Marker(body='b1', position=(0.5, 0.0, 0.0), orientation=quarter),
        stiffness=(1000, 2000, 3000, 4, 5, 6),
        damping=(10, 20, 30, 0.4, 0.5, 0.6),
    )
    element = bushings([spec])
    kin = kinematics([((0, 0, 0), (0, 0, 0)), ((-0.25, 0.502, 0), (0, 0, 0))], [[0] * 6, [0, 0.3, 0, 0, 0, 0]])
    result = element.evaluate(kin)
    np.testing.assert_allclose(result.f, [[0, 5, 0, 0, 0, 1.25], [0, -5, 0, 0, 0, -2.5], [0] * 6], atol=1e-12)
    expected = [0.5 * 1000 * 0.002**2, 10 * 0.3**2, -5, 0, 0, 0, 0, 0, 0.002, 0, 0, 0, 0, 0]
    np.testing.assert_allclose(result.out[0], expected, atol=1e-12)


def test_torque_opposes_the_rotation():
    """0.1 rad about x at 4 N m/rad and 2 rad/s about y at 0.5 N m s/rad: torque (-0.4, -1, 0) plus the geometric part.

    The rotation vector changes only along x, so the elastic torque is exactly along x.
    """
    spec = BushingSpec(
        name='b',
        i=Marker(body='b0'),
        j=Marker(body='b1'),
        stiffness=(0, 0, 0, 4, 5, 6),
        damping=(0, 0, 0, 0.4, 0.5, 0.6),
    )
    kin = kinematics([((0, 0, 0), (0, 0, 0)), ((0, 0, 0), (0.1, 0, 0))], [[0, 0, 0, 0, -2, 0], [0] * 6])
    element = bushings([spec])
    result = element.evaluate(kin)
    torque = np.array([-0.4, -1.0, 0.0])
    np.testing.assert_allclose(result.out[0, 5:8], torque, atol=1e-12)
    np.testing.assert_allclose(result.f[0, 3:], -torque, atol=1e-12)
    np.testing.assert_allclose(kin.R[1] @ result.f[1, 3:], torque, atol=1e-12)
    np.testing.assert_allclose(result.out[0, 11:], [0.1, 0, 0], atol=1e-12)


def test_no_work_on_a_closed_path_of_large_rotations(rng):
    """The elastic torque is conservative: the work along a closed path of rotations up to 2 rad vanishes.

    The integrand is smooth and periodic, so the trapezoidal rule converges faster than any power: 1e-10 of the energy.
    """
    spec = BushingSpec(name='b', i=Marker(body='world'), j=Marker(body='b0'), stiffness=(0, 0, 0, 1, 4, 9))
    element = bushings([spec], bodies=1)
    n = 400
    phases = rng.uniform(0, 2 * np.pi, 3)
    work, energy = 0.0, 0.0
    for k in range(n):
        s = 2 * np.pi * k / n
        theta = 1.1 * np.sin(np.array([s, 2 * s, 3 * s]) + phases)
        rate = 1.1 * np.array([1, 2, 3]) * np.cos(np.array([s, 2 * s, 3 * s]) + phases)
        h = 1e-6
        R = Rotation.from_rotvec(theta)
        w = (Rotation.from_rotvec(theta - h * rate).inv() * Rotation.from_rotvec(theta + h * rate)).as_rotvec() / (
            2 * h
        )
        result = element.evaluate(kinematics([((0, 0, 0), R.as_matrix())]))
        work += result.f[0, 3:] @ w * 2 * np.pi / n
        energy = max(energy, result.out[0, 0])
    assert abs(work) < 1e-8 * energy  # h^2-error of the central difference of w: 1e-11 relative, rounding 1e-10


def test_frame_indifference(rng):
    """Moving the whole scene rigidly moves the forces with it and changes no output."""
    element = bushings([random_spec(rng)])
    kin = random_kinematics(rng, 2)
    Q = Rotation.random(random_state=rng).as_matrix()
    shift = rng.normal(size=3)
    moved = kinematics(
        [(Q @ kin.p[b] + shift, Q @ kin.R[b]) for b in range(2)],
        [np.r_[Q @ kin.v[b, :3], kin.v[b, 3:]] for b in range(2)],
    )
    a, b = element.evaluate(kin), element.evaluate(moved)
    np.testing.assert_allclose(b.out, a.out, rtol=0, atol=1e-12 * np.abs(a.out).max())
    np.testing.assert_allclose(b.f[:2, 3:], a.f[:2, 3:], rtol=0, atol=1e-12 * np.abs(a.f).max())
    np.testing.assert_allclose(b.f[:2, :3], a.f[:2, :3] @ Q.T, rtol=0, atol=1e-12 * np.abs(a.f).max())


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'stiffness': (1, 2, 3)}, 'stiffness .* list of 6 numbers'),
        ({'damping': (0, 0, -1, 0, 0, 0)}, r'damping\[2\] = -1.0: must be >= 0'),
        ({'laws': (None,)}, 'laws .* six entries'),
    ],
)
def test_refusals_name_element_field_and_remedy(rng, changes, message):
    with pytest.raises(SpecError, match="Bushing 'b': " + message):
        random_spec(rng).replace(**changes)
