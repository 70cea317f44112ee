"""A gearbox with several outputs, as in front of several driven axles: contract, and shares by hand."""

from __future__ import annotations

import numpy as np
import pytest
from contract import ContractContext, Element, check_contract, forcing, kinematics, random_kinematics, random_marker

from solver.elements.clutch import OUTPUTS, ClutchSpec, clutch_forces, compile_clutches
from solver.elements.coordinate import CoordinateSpec
from solver.elements.marker import Marker
from solver.errors import SpecError

BODIES = 7
SHARES = (0.1, 0.15, 0.2, 0.25, 0.3)


def gearbox(shares, rng=None):
    """Shaft x0 and outputs x1, x2, ... on a carrier b0."""

    def marker(body):
        return Marker(body=body) if rng is None else random_marker(rng, body)

    turning = [
        CoordinateSpec(name=f'x{k}', kind='rotation', i=marker('b0'), j=marker(f'b{k + 1}')) for k in range(BODIES - 1)
    ]
    com = None if rng is None else rng.normal(size=(BODIES, 3))
    context = ContractContext(bodies=BODIES, com=com, coordinates=turning, inputs=('clutch', 'gear'))
    spec = ClutchSpec(
        name='c', shaft='x0', outputs=tuple((f'x{k + 1}', share) for k, share in enumerate(shares)), ratios=(4.0,),
        capacity=200.0,
        stiffness=3000.0, damping=5.0, input='clutch', gear='gear',
    )  # fmt: skip
    table, x = compile_clutches([spec], context), context.coordinate_table()
    laws, angle = context.laws(), np.zeros(len(turning))
    return Element(forcing(clutch_forces, table, laws, x, angle), context, n=1, outputs=OUTPUTS)


@pytest.mark.parametrize('shares', [SHARES, SHARES[:3], (0.4, -0.6)])
def test_contract(rng, shares):
    unit = gearbox(shares, rng)
    for u in ((0.0, 1.0), (0.95, 1.0), (0.0, 0.0)):
        check_contract(unit, random_kinematics(rng, BODIES), zp=[0.002], cz=0.001, u=u)


def test_each_output_gets_its_share_however_fast_it_turns():
    """Half pressed, 100 N m in a gear of 4: shares of 400 N m; the carrier takes the sum less what the shaft is braked
    by; what goes in is what comes out and what the clutch heats."""
    rates = np.array([500.0, 10.0, -20.0, 30.0, 45.0, 0.0])
    still = ((0, 0, 0), (0, 0, 0))
    unit = gearbox(SHARES)
    at = kinematics([still] * BODIES, [[0.0] * 6, *([0.0] * 5 + [rate] for rate in rates)])
    result = unit.evaluate(at, zp=[0.0], cz=0.001, u=(0.5, 1.0))
    torques = np.array([-100.0, *(400.0 * share for share in SHARES)])
    np.testing.assert_allclose(result.f[1:BODIES, 5], torques, atol=1e-9)
    assert result.f[0, 5] == pytest.approx(-torques.sum())
    assert unit.output(result, 'rate') == pytest.approx(500.0 - 4.0 * np.dot(SHARES, rates[1:]))
    named = ('on_shaft', 'on_first', 'on_second', 'on_third', 'on_fourth', 'on_fifth')
    assert [unit.output(result, name).item() for name in named] == pytest.approx(torques)
    assert torques @ rates == pytest.approx(-100.0 * unit.output(result, 'rate'))


def test_six_outputs_are_refused():
    with pytest.raises(SpecError, match=r'outputs .*needs 1 to 5'):
        gearbox((*SHARES, 0.0))
