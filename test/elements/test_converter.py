"""Torque converters: contract, stall, coupling and coasting by hand, and refusals."""

from __future__ import annotations

import numpy as np
import pytest
from contract import ContractContext, Element, check_contract, forcing, kinematics, random_kinematics, random_marker

from solver.elements.converter import OUTPUTS, ConverterSpec, compile_converters, converter_forces
from solver.elements.coordinate import CoordinateSpec
from solver.elements.marker import Marker
from solver.errors import SpecError

GIVEN = {
    'speed_ratios': (0.0, 0.5, 0.85, 1.0),
    'torque_ratios': (2.0, 1.5, 1.0, 1.0),
    'capacities': (2e-3, 1.9e-3, 1.5e-3, 0.0),
}


def rotations(rng=None):
    """Two rotations on a carrier b0: random ones, or both about its z axis."""

    def marker(body):
        return Marker(body=body) if rng is None else random_marker(rng, body)

    return [CoordinateSpec(name=f'x{k}', kind='rotation', i=marker('b0'), j=marker(f'b{k + 1}')) for k in range(2)]


def a_converter(given, com=None, **changed):
    context = ContractContext(bodies=3, com=com, coordinates=given)
    x = context.coordinate_table()
    table = compile_converters([ConverterSpec(name='c', pump='x0', turbine='x1', **{**GIVEN, **changed})], context)
    laws, angle = context.laws(), np.zeros(2)
    return Element(forcing(converter_forces, table, laws, x, angle), context, n=1, outputs=OUTPUTS)


def turning(pump, turbine):
    """The carrier at rest, shafts turning about z."""
    still = ((0, 0, 0), (0, 0, 0))
    return kinematics([still] * 3, [[0.0] * 6, *([0.0] * 5 + [rate] for rate in (pump, turbine))])


def test_contract(rng):
    """Driving, coasting, and with either turning backwards: whatever comes of random motions."""
    unit = a_converter(rotations(rng), com=rng.normal(size=(3, 3)))
    for _ in range(12):
        check_contract(unit, random_kinematics(rng, 3))


@pytest.mark.parametrize(
    ('pump', 'turbine', 'taken', 'given'),
    [
        (200.0, 0.0, 80.0, 160.0),  # stall: capacity 2e-3 of the square, twice the torque
        (200.0, -50.0, 80.0, 160.0),
        (200.0, 100.0, 76.0, 114.0),
        (200.0, 170.0, 60.0, 60.0),  # it couples
        (200.0, 200.0, 0.0, 0.0),
        (170.0, 200.0, -60.0, -60.0),  # the turbine drives
        (0.0, 200.0, -80.0, -80.0),
        (-10.0, 200.0, -80.0, -80.0),
        (-100.0, -20.0, 0.0, 0.0),
        (0.0, 0.0, 0.0, 0.0),
    ],
)
def test_torques_are_those_of_its_tables(pump, turbine, taken, given):
    unit = a_converter(rotations())
    result = unit.evaluate(turning(pump, turbine))
    np.testing.assert_allclose(result.f[:3, 5], (taken - given, -taken, given), atol=1e-9)
    assert unit.output(result, 'dissipation') == pytest.approx(taken * pump - given * turbine, abs=1e-6)


def test_it_never_gives_power(rng):
    """Over all speeds, as the efficiency is at most 1 at every point of the tables."""
    unit = a_converter(rotations())
    for pump, turbine in rng.uniform(-300.0, 300.0, (300, 2)):
        assert unit.output(unit.evaluate(turning(pump, turbine)), 'dissipation') >= 0.0


@pytest.mark.parametrize(
    ('changed', 'match'),
    [
        ({'speed_ratios': (0.1, 0.5, 0.85, 1.0)}, r"Converter 'c': speed_ratios = \(0.1, 1.0\): must begin with 0"),
        ({'torque_ratios': (2.0, 1.5)}, "Converter 'c': torque_ratios = 2: must be 4 numbers"),
        ({'capacities': (2e-3, 2e-3, 1e-3, 1e-4)}, r"Converter 'c': capacities\[3\] = 0.0001: must be 0"),
        ({'capacities': (0.0, 2e-3, 1e-3, 0.0)}, r"Converter 'c': capacities\[0\] = 0.0: must be > 0"),
        (
            {'torque_ratios': (2.0, 1.5, 1.3, 1.0)},
            r"Converter 'c': torque_ratios\[2\] = 1.3: times the speed ratio 0.85 must be at most 1",
        ),
        # 0.9 and 1 at its points, and between them a cubic with the slopes -1.0135 and -1.4167: 0.875 times 1.1725
        (
            {'speed_ratios': (0.0, 0.6, 1.0), 'torque_ratios': (2.0, 1.5, 1.0), 'capacities': (2e-3, 1.9e-3, 0.0)},
            r"Converter 'c': torque_ratios\[2\] = 1.0: with the point before it gives an efficiency of 1.026 at the "
            r'speed ratio 0.875',
        ),
    ],
)
def test_refusals(changed, match):
    with pytest.raises(SpecError, match=match):
        a_converter(rotations(), **changed)
