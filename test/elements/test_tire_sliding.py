"""A tire that slides: its friction opposes the sliding whichever way that goes, and holds no more than the road can
carry."""

from __future__ import annotations

import numpy as np
import pytest
from contract import ContractContext, check_contract
from tire_bench import CAR, EXAMPLE, HILLY, H, drop, march, settled, tire, value, wheel

from solver.elements.magic_formula import slip_stiffness
from solver.elements.marker import Marker
from solver.elements.road import RoadSpec
from solver.elements.tire_data import I
from solver.elements.tire_pacejka import TireSpec, compile_tires

RADIUS = 0.3075  # m, effective, of the wheel of the bench at 0.3 m
# deg: how far the Magic Formula itself, at speed, is off the direction of sliding (11.1 at 60 degrees and friction 1);
# on friction 0.2 slips are small where it saturates, and the weights of combined slip, which do not know of the
# friction, take little from either force
LAW = {1.0: 12.5, 0.2: 22.0}


def bounds() -> tuple[float, float]:
    """(k_x, k_y): slips to which a standing tire saturates on a road of friction 1: twice peak force over slip
    stiffness."""
    c = compile_tires([TireSpec(name='t', marker=Marker(body='b0'), data=CAR)], ContractContext(bodies=1)).c[0]
    Kx, Ky = slip_stiffness(c, 0.0, 4200.0, 0.0)
    return 2.0 * c[I.PDX1] * 4200.0 / Kx, 2.0 * c[I.PDY1] * 4200.0 / Ky


def misdirection(element, vx: float, vy: float, spin: float = 0.0) -> float:
    """Angle [deg] between the friction of a wheel and the opposite of its sliding velocity, settled."""
    r = settled(element, wheel(velocity=(vx, vy, 0.0), spin=spin))
    fx, fy = value(element, r, 'fx'), value(element, r, 'fy')
    sx, sy = vx - RADIUS * spin, vy
    return float(np.degrees(np.arctan2(fx * sy - fy * sx, -fx * sx - fy * sy)))


@pytest.mark.parametrize('friction', [1.0, 0.2])
@pytest.mark.parametrize('angle', [0.0, 45.0, 60.0, 80.0, 85.0, 88.0, 89.0, 90.0])
def test_friction_of_a_locked_wheel_opposes_its_sliding(angle: float, friction: float) -> None:
    """At 10 m/s, at this angle [deg] to the heading, on every side."""
    element = tire(road=RoadSpec(friction=friction))
    vx, vy = 10.0 * np.cos(np.radians(angle)), 10.0 * np.sin(np.radians(angle))
    for along, across in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
        assert abs(misdirection(element, along * vx, across * vy)) < LAW[friction]


@pytest.mark.parametrize('vx', [-3.0, -1.0, 0.0, 0.5, 1.0, 2.0, 3.0])
def test_friction_of_a_spinning_wheel_opposes_its_sliding(vx: float) -> None:
    """Sideways at 10 m/s, spinning at 30 rad/s."""
    assert abs(misdirection(tire(), vx, 10.0, 30.0)) < LAW[1.0]


@pytest.mark.parametrize('velocity', [(1.5, 10.0), (1.9, 20.0)])
def test_a_locked_wheel_that_slides_sideways_keeps_the_direction_of_its_sliding(velocity: tuple[float, float]) -> None:
    """400 kg on it, half a second: as with dry friction the path is straight, and the heading of the motion never
    swings across."""
    trace = drop(tire(), mass=400.0, gravity=(0, 0, -9.81), seconds=0.5, velocity=(*velocity, 0.0))
    v = np.array([v for _, v, _ in trace])
    heading = np.degrees(np.arctan2(v[:, 0], v[:, 1]))
    assert v[:, 0].min() > 0.0
    np.testing.assert_allclose(heading, np.degrees(np.arctan2(*velocity)), atol=2.0)


def test_a_spinning_wheel_loses_its_side_force() -> None:
    """60 rad/s on the spot slide 18.8 m/s: what was stored sideways is gone after 0.1 s, some three relaxation lengths
    of 0.6 m."""
    element = tire()
    trace = march(element, wheel(spin=60.0), 100, z=(0.0, 0.015))
    assert abs(value(element, trace[0], 'fy')) > 0.2 * value(element, trace[0], 'fz')
    assert abs(value(element, trace[-1], 'fy')) < 0.01 * value(element, trace[-1], 'fz')


def test_a_wheel_that_slides_sideways_loses_its_longitudinal_force() -> None:
    """Locked, 5 m/s across: what was stored along it is gone after 2 m."""
    element = tire()
    trace = march(element, wheel(velocity=(0.0, 5.0, 0.0)), 400, z=(0.01, 0.0))
    assert abs(value(element, trace[0], 'fx')) > 0.2 * value(element, trace[0], 'fz')
    assert abs(value(element, trace[-1], 'fx')) < 0.01 * value(element, trace[-1], 'fz')


def test_pure_sliding_on_the_spot_saturates_at_the_bounds() -> None:
    """1/slip^2 = 1/5^2 + 1/k^2."""
    k_x, k_y = bounds()
    element = tire()
    along, across = settled(element, wheel(spin=60.0)), settled(element, wheel(velocity=(0.0, 5.0, 0.0)))
    assert value(element, along, 'kappa') == pytest.approx((1 / 25 + k_x**-2) ** -0.5, rel=1e-6)
    assert np.tan(value(element, across, 'alpha')) == pytest.approx(-((1 / 25 + k_y**-2) ** -0.5), rel=1e-6)


def test_slips_go_on_without_a_jump_through_the_low_speed() -> None:
    element = tire()
    for edge in (-2.0, 2.0):
        below, above = (settled(element, wheel(velocity=(edge + d, 8.0, 0.0), spin=20.0)) for d in (-1e-5, 1e-5))
        for name in ('kappa', 'alpha'):
            assert value(element, below, name) == pytest.approx(value(element, above, name), rel=2e-5)


def test_a_wheel_that_rolls_slowly_has_the_slips_of_rolling() -> None:
    """0.5 m/s with 1 % of slip each way: kappa = tan alpha = -Vs/Vx, but for (slip/k)^2/2 of either."""
    element = tire(standstill_damping=0.0)
    r = settled(element, wheel(velocity=(0.5, 0.005, 0.0), spin=0.505 / RADIUS))
    assert value(element, r, 'kappa') == pytest.approx(0.01, rel=0.03)
    assert value(element, r, 'alpha') == pytest.approx(-0.01, rel=0.03)


@pytest.mark.parametrize('friction', [0.5, 0.1])
@pytest.mark.parametrize('motion', [dict(spin=20.0), dict(velocity=(0.0, 3.0, 0.0))], ids=['along', 'across'])
def test_what_a_sliding_tire_stores_goes_with_the_friction_of_the_road(motion, friction: float) -> None:
    full, less = (
        np.abs(settled(tire(road=RoadSpec(friction=f)), wheel(**motion)).z[:2]).max() for f in (1.0, friction)
    )
    assert less == pytest.approx(friction * full, rel=0.01)


@pytest.mark.parametrize('turn_slip', [None, True])
def test_what_a_turned_contact_patch_stores_goes_with_the_friction_of_the_road(turn_slip: bool | None) -> None:
    """1/twist^2 = 1/5^2 + 1/(mu k)^2."""
    bound = []
    for friction in (1.0, 0.1):
        element = tire(EXAMPLE, RoadSpec(friction=friction), turn_slip=turn_slip)
        twist = element.evaluate(wheel(rates=(0.0, 0.0, 1.0)), zp=(0.0, 0.0, 0.0), cz=1e6).z[2] / (
            0.17 * EXAMPLE['UNLOADED_RADIUS']
        )
        bound.append((twist**-2 - 1 / 25) ** -0.5)
    assert bound[1] == pytest.approx(0.1 * bound[0], rel=3e-3)


@pytest.mark.parametrize(
    ('direction', 'way'), [((1.0, 0.0, 0.0), 0.003), ((0.0, 1.0, 0.0), 0.008)], ids=['along', 'across']
)
def test_on_a_slippery_road_a_wheel_recoils_less(direction: tuple[float, float, float], way: float) -> None:
    """Sliding to rest from 1 m/s on friction 0.1, it goes back [m] by a tenth of the 22 mm along and 68 mm across on
    friction 1."""
    element = tire(road=RoadSpec(friction=0.1))
    trace = drop(element, mass=400.0, gravity=(0, 0, -9.81), seconds=2.0, velocity=direction)
    x = np.array([x @ direction for x, _, _ in trace])
    first = int(np.argmax([v @ direction < 0.0 for _, v, _ in trace]))
    assert 0.8 < first * H < 1.3  # 1 m/s over 0.08 to 0.12 g
    assert x.max() - x[first:].min() < way


@pytest.mark.parametrize('turn_slip', [False, None, True])
@pytest.mark.parametrize('motion', [((0.7, 4.0, 0.0), 0.0), ((-0.5, 0.3, 0.0), 12.0), ((1.9, -9.0, 0.0), 30.0)])
def test_tangents_of_a_sliding_tire_on_a_road_of_varying_friction(motion, turn_slip: bool | None) -> None:
    velocity, spin = motion
    kin = wheel(velocity=velocity, spin=spin, camber=0.03, rates=(0.0, 0.0, 0.6))
    states = (0.004, -0.006, 0.01)[: 2 if turn_slip is False else 3]
    element = tire(EXAMPLE, HILLY, turn_slip=turn_slip)
    check_contract(element, kin, pair=False, tolerance=1e-10, zp=element.states(states), cz=5e-4)
