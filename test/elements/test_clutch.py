"""Clutches with gearboxes, and engines with maps: contract, closed forms of one evaluation, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from contract import ContractContext, Element, check_contract, forcing, kinematics, random_kinematics, random_marker

from solver.elements import clutch, engine_map
from solver.elements.clutch import ClutchSpec, clutch_forces, compile_clutches
from solver.elements.coordinate import CoordinateSpec
from solver.elements.engine_map import EngineSpec, compile_engines, engine_forces, held_engines
from solver.elements.marker import Marker
from solver.errors import SpecError

INPUTS = ('pedal', 'clutch', 'gear')
GIVEN = {
    'shaft': 'x0',
    'outputs': (('x1', 0.5), ('x2', 0.5)),
    'ratios': (4.0, 2.0),
    'capacity': 200.0,
    'stiffness': 3000.0,
    'damping': 5.0,
}


def rotations(rng=None):
    """Three rotations on a carrier b0: random ones, or all about its z axis."""

    def marker(body):
        return Marker(body=body) if rng is None else random_marker(rng, body)

    return [CoordinateSpec(name=f'x{k}', kind='rotation', i=marker('b0'), j=marker(f'b{k + 1}')) for k in range(3)]


def element(specs, compile_specs, kernel, outputs, given, com=None):
    context = ContractContext(bodies=4, com=com, coordinates=given, inputs=INPUTS)
    x = context.coordinate_table()
    table = compile_specs(specs, context)
    laws, angle = context.laws(), np.zeros(len(given))
    return Element(forcing(kernel, table, laws, x, angle), context, n=len(specs), outputs=outputs)


def a_clutch(given, com=None, **changed):
    spec = ClutchSpec(name='c', input='clutch', gear='gear', **{**GIVEN, **changed})
    return element([spec], compile_clutches, clutch_forces, clutch.OUTPUTS, given, com)


def an_engine(given, com=None, **changed):
    data = {
        'speeds': (0.0, 100.0, 300.0),
        'pedals': (0.0, 1.0),
        'torques': ((10.0, -10.0, -40.0), (100.0, 150.0, 120.0)),
    }
    spec = EngineSpec(name='e', coordinate='x0', input='pedal', **{**data, **changed})
    return element([spec], compile_engines, engine_forces, engine_map.OUTPUTS, given, com)


@pytest.mark.parametrize('u', [(0.0, 0.0, 1.0), (0.0, 0.95, 2.0), (0.0, 0.0, -1.0), (0.0, 0.0, 0.0)])
@pytest.mark.parametrize('outputs', [GIVEN['outputs'], (('x1', 1.0),)])
def test_contract_of_clutches(rng, u, outputs):
    """Stick, slip, reverse and neutral."""
    unit = a_clutch(rotations(rng), com=rng.normal(size=(4, 3)), outputs=outputs, reverse=3.0)
    for _ in range(3):
        check_contract(unit, random_kinematics(rng, 4), zp=[0.002], cz=0.001, u=u)


def test_contract_of_engines(rng):
    unit = an_engine(rotations(rng), com=rng.normal(size=(4, 3)), speeds=(-2.0, 0.0, 2.0))
    for pedal in (0.0, 0.3, 1.0):
        check_contract(unit, random_kinematics(rng, 4), u=(pedal, 0.0, 0.0))


def turning(*rates):
    """The carrier at rest, shafts turning about z."""
    still = ((0, 0, 0), (0, 0, 0))
    return kinematics([still] * 4, [[0.0] * 6, *([0.0] * 5 + [rate] for rate in rates)])


@pytest.mark.parametrize(
    ('gear', 'ratio'), [(1.0, 4.0), (2.0, 2.0), (7.0, 2.0), (1e300, 2.0), (0.4, 0.0), (-1.0, -3.0)]
)
def test_a_slipping_clutch_gives_its_capacity_times_the_ratio(gear, ratio):
    """Shaft at 500 rad/s, outputs at 10 and 20: half pressed the clutch carries 100 N m, the carrier takes what is
    over."""
    unit = a_clutch(rotations(), reverse=3.0)
    result = unit.evaluate(turning(500.0, 10.0, 20.0), zp=[0.0], cz=0.001, u=(0.0, 0.5, gear))
    torque = 100.0 if ratio else 0.0
    assert unit.output(result, 'rate') == pytest.approx(500.0 - ratio * 15.0, rel=1e-12)
    np.testing.assert_allclose(
        result.f[:4, 5], (torque - ratio * torque, -torque, 0.5 * ratio * torque, 0.5 * ratio * torque), atol=1e-9
    )


@pytest.mark.parametrize(
    ('speeds', 'row', 'backwards'),
    [
        ((0.0, 100.0, 300.0), (0.0, 80.0, 60.0), 0.0),  # rises from nothing
        ((0.0, 100.0, 300.0), (50.0, 80.0, 60.0), 49.0),  # rises from something: less by its slope over 1 rad/s
        ((80.0, 200.0, 300.0), (100.0, 150.0, 140.0), 44.0),  # rises from the idle speed: 0.699 N m s there
        ((0.0, 100.0, 300.0), (-10.0, -20.0, -40.0), 10.0),  # drag from rest on: as large the other way
        ((80.0, 200.0, 300.0), (-10.0, -20.0, -40.0), 10.0),  # drag from the idle speed on
        ((80.0, 200.0, 300.0), (-30.0, -20.0, -40.0), 30.0),  # drag that becomes smaller first
        ((0.0, 100.0, 300.0), (50.0, 30.0, -40.0), 50.0),  # falls: along its slope
        ((80.0, 200.0, 300.0), (-1.0, -20.0, -40.0), 0.0),  # idles just below its first speed
    ],
)
def test_an_engine_that_is_turned_backwards_resists(speeds, row, backwards):
    """No torque below zero at any speed below zero (but within 1 rad/s of a first speed of zero), so it cannot run away
    backwards."""
    unit = an_engine(rotations(), speeds=speeds, pedals=(0.0,), torques=(row,))

    def torque(rate):
        return float(unit.output(unit.evaluate(turning(rate, 0.0, 0.0), u=(0.0, 0.0, 0.0)), 'torque')[0])

    found = [torque(rate) for rate in (-1.0, -10.0, -50.0, -100.0, -1000.0, -10000.0)]
    assert found[0] >= 0.0 and found[3] >= backwards
    assert np.all(np.diff(found) >= 0.0)
    for rate, here in zip(speeds, row, strict=True):
        assert torque(rate) == pytest.approx(here, abs=1e-12)
    at = np.linspace(min(-speeds[0], speeds[0] - 1.0) - 5.0, speeds[0] + 5.0, 4001)
    values = np.array([torque(rate) for rate in at.tolist()])
    assert np.max(np.abs(np.diff(values, 2))) < 0.01 * (1.0 + np.max(np.abs(values)))  # no jump and no kink


def test_an_engine_that_pulls_does_not_drag_below_its_first_speed():
    """Its torque rises so steeply that its slope meets zero above rest: below its first speed it ends as a parabola.
    The slope there is (250 5 + 50 0.4)/200 = 6.35 N m s, so that begins at 100 - 20/6.35 rad/s and is 6.35^2/40 times
    the square of the way from there."""
    unit = an_engine(rotations(), speeds=(100.0, 150.0, 300.0), pedals=(0.0,), torques=((10.0, 260.0, 200.0),))
    at = np.linspace(-5.0, 100.0, 421)
    found = np.array(
        [
            float(unit.output(unit.evaluate(turning(rate, 0.0, 0.0), u=(0.0, 0.0, 0.0)), 'torque')[0])
            for rate in at.tolist()
        ]
    )
    np.testing.assert_allclose(found, 6.35**2 / 40.0 * np.maximum(at - (100.0 - 20.0 / 6.35), 0.0) ** 2, atol=1e-9)


def test_an_engine_gives_what_its_map_says_and_nothing_in_statics():
    unit = an_engine(rotations())
    for rate, pedal, torque in ((100.0, 0.0, -10.0), (100.0, 0.25, 30.0), (300.0, 1.0, 120.0), (0.0, 2.0, 100.0)):
        result = unit.evaluate(turning(rate, 0.0, 0.0), u=(pedal, 0.0, 0.0))
        np.testing.assert_allclose(result.f[:2, 5], (-torque, torque), rtol=1e-12)
        assert unit.output(result, 'dissipation') == pytest.approx(-torque * rate)
    context = ContractContext(bodies=4, coordinates=rotations(), inputs=INPUTS)
    table = compile_engines(
        [EngineSpec(name='e', coordinate='x0', input='pedal', speeds=(0.0, 1.0), pedals=(0.0,), torques=((9.0, 9.0),))],
        context,
    )
    x, off, laws = context.coordinate_table(), held_engines(table, np.zeros(3)).table, context.laws()
    still = Element(forcing(engine_forces, off, laws, x, np.zeros(3)), context, n=1, outputs=engine_map.OUTPUTS)
    assert not still.evaluate(turning(5.0, 0.0, 0.0), u=(1.0, 0.0, 0.0)).f.any()


@pytest.mark.parametrize(
    ('make', 'changed', 'match'),
    [
        (a_clutch, {'ratios': ()}, "Clutch 'c': ratios"),
        (a_clutch, {'ratios': (3.0, 0.0)}, r"Clutch 'c': ratios\[1\] = 0.0: must be > 0"),
        (a_clutch, {'reverse': -3.0}, "Clutch 'c': reverse = -3.0: must be > 0"),
        (a_clutch, {'capacity': -1.0}, "Clutch 'c': capacity"),
        (a_clutch, {'stiffness': 0.0}, "Clutch 'c': stiffness"),
        (a_clutch, {'outputs': ()}, "Clutch 'c': outputs"),
        (an_engine, {'speeds': (0.0, 300.0, 100.0)}, r"Engine 'e': speeds\[2\] = 100.0: must be greater"),
        (
            an_engine,
            {'torques': ((1.0, 2.0, 1.0),)},
            "Engine 'e': torques = 1: must have one row for each of the 2 pedals",
        ),
        (
            an_engine,
            {'torques': ((1.0, 2.0, 3.0),) * 2},
            r"Engine 'e': torques\[0\] = 3.0: must not rise towards the last speed",
        ),
    ],
)
def test_refusals(make, changed, match):
    with pytest.raises(SpecError, match=match):
        make(rotations(), **changed)
