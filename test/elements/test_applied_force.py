"""Applied force."""

from __future__ import annotations

import numpy as np
import pytest
from contract import (
    ContractContext,
    Element,
    check_action_reaction,
    check_contract,
    forcing,
    kinematics,
    random_kinematics,
    random_marker,
)

from solver.elements.applied_force import OUTPUTS, AppliedForceSpec, applied_force_forces, compile_applied_forces
from solver.elements.marker import Marker
from solver.errors import SpecError


def applied_forces(specs, *, com=None, inputs=()):
    context = ContractContext(com=com, inputs=inputs)
    table = compile_applied_forces(specs, context)
    laws = context.laws()
    return Element(forcing(applied_force_forces, table, laws), context, n=len(specs), outputs=OUTPUTS)


@pytest.mark.parametrize(
    ('frame', 'reaction'),
    [('world', None), ('body', None), ('world', 'b0'), ('body', 'b0'), ('reaction', 'b0'), ('reaction', 'world')],
)
def test_contract(rng, frame, reaction):
    """In all axes, with and without reaction, scaled by an input; the power of the force is negative dissipation."""
    spec = AppliedForceSpec(
        name='a',
        marker=random_marker(rng, 'b1'),
        reaction=reaction and random_marker(rng, reaction, position=(0, 0, 0)),
        force=rng.normal(size=3),
        torque=rng.normal(size=3),
        frame=frame,
        input='push',
    )
    element = applied_forces([spec, spec.replace(name='c', input=None)], com=rng.normal(size=(2, 3)), inputs=('push',))
    for _ in range(3):
        kin = random_kinematics(rng, 2)
        check_contract(element, kin, u=[-1.7])
        check_action_reaction(element, kin, u=[0.0])


def test_force_acts_at_the_marker_in_its_axes():
    """Body turned by 90 deg about z: 10 N along its x act along world y at the arm (0, 0.5, 0) in B: -5 N m about z,
    all scaled by 3.

    The world takes the reaction at the same point (3.5, 5, 6) m: moment -(3.5, 5, 6) x (0, 30, 0) - (0, 0, 6).
    """
    marker = Marker(body='b0', position=(0, 0.5, 0))
    spec = AppliedForceSpec(name='a', marker=marker, force=(10, 0, 0), torque=(0, 0, 2), frame='body', input='u')
    element = applied_forces([spec], inputs=('u',))
    kin = kinematics([((4, 5, 6), (0, 0, np.pi / 2)), ((0, 0, 0), (0, 0, 0))], [[0, 2, 0, 0, 0, 0], [0] * 6])
    result = element.evaluate(kin, u=[3.0])
    np.testing.assert_allclose(
        result.f, [[0, 30, 0, 0, 0, -15 + 6], [0] * 6, [0, -30, 0, 180, 0, -105 - 6]], atol=1e-12
    )
    np.testing.assert_allclose(result.out[0], [0, -60, 0, 30, 0, 0, 0, 6], atol=1e-12)


def test_reaction_acts_at_the_same_point():
    """10 N along x on b1 at (1, 2, 0); the reaction on b0 at the origin has the moment -(1, 2, 0) x (10, 0, 0) = (0, 0,
    20)."""
    spec = AppliedForceSpec(name='a', marker=Marker(body='b1'), reaction=Marker(body='b0'), force=(10, 0, 0))
    result = applied_forces([spec]).evaluate(kinematics([((0, 0, 0), (0, 0, 0)), ((1, 2, 0), (0, 0, 0.3))]))
    np.testing.assert_allclose(result.f, [[-10, 0, 0, 0, 0, 20], [10, 0, 0, 0, 0, 0], [0] * 6], atol=1e-12)


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'frame': 'chassis'}, 'frame .* must be world, body or reaction'),
        ({'frame': 'reaction'}, "frame .* needs a 'reaction' marker"),
        ({'reaction': Marker(body='b0', position=(1, 0, 0))}, 'reaction.position .* leave it out'),
        ({'force': (1, 2)}, 'force .* list of 3 numbers'),
    ],
)
def test_refusals_name_element_field_and_remedy(changes, message):
    with pytest.raises(SpecError, match="AppliedForce 'a': " + message):
        AppliedForceSpec(**{'name': 'a', 'marker': Marker(body='b1'), **changes})
