"""The load of a tire: stiffness, damping and their energy, from upright to lying on the sidewall."""

from __future__ import annotations

import numpy as np
import pytest
from tire_bench import CAR, load_at, tire, value, wheel

from solver.elements.road import RoadSpec
from solver.elements.tire_pacejka import TireData


def test_load_deflection_and_its_energy() -> None:
    """10 mm: Fz = Fz0 (QFZ1 x + QFZ2 x^2), x = rho/R0, with QFZ1 so that the slope at nominal load is
    VERTICAL_STIFFNESS."""
    element = tire()
    result = element.evaluate(wheel(position=(0, 0, 0.306)), zp=(0, 0))
    q1 = np.sqrt((215e3 * 0.316 / 4200) ** 2 - 4 * 15.0)
    x = 0.01 / 0.316
    assert value(element, result, 'fz') == pytest.approx(4200 * (q1 * x + 15.0 * x * x), rel=1e-12)
    assert value(element, result, 'deflection') == pytest.approx(0.01, abs=1e-15)
    # the energy starts with the parabolic beginning: its excess over the integral is k1 e^2/6 + k2 e^3/15, e = 0.5 mm
    k1, k2, e = 4200 * q1 / 0.316, 4200 * 15.0 / 0.316**2, 5e-4
    assert value(element, result, 'energy') == pytest.approx(
        k1 * (0.01**2 / 2 + e * e / 6) + k2 * (0.01**3 / 3 + e**3 / 15), rel=1e-12
    )
    rho = np.roots([4200 * 15.0 / 0.316**2, 4200 * q1 / 0.316, -4200.0]).max()
    slope = [
        value(element, element.evaluate(wheel(position=(0, 0, 0.316 - rho - d)), zp=(0, 0)), 'fz')
        for d in (-1e-5, 1e-5)
    ]
    assert (slope[1] - slope[0]) / 2e-5 == pytest.approx(215e3, rel=1e-6)


def test_load_never_pulls_and_begins_smoothly() -> None:
    """From 2 mm above the road to 20 mm below, sinking and rising fast: Fz >= 0, once differentiable, zero in the
    air."""
    element = tire(damping=3000.0)
    heights = np.linspace(0.318, 0.296, 2201)
    for rise in (-3.0, 0.0, 3.0):
        fz = np.array([load_at(element, z, rise) for z in heights])
        assert fz.min() >= 0.0
        assert fz[heights > 0.3165].max() == 0.0
        slope = np.diff(fz) / 1e-5
        assert np.abs(np.diff(slope)).max() < 0.03 * max(slope.max(), 1.0)  # a kink would be 1.0
    assert fz.max() == 0.0  # rising at 3 m/s the damper would pull harder than the spring pushes


def test_damping_is_the_stated_one_at_nominal_load() -> None:
    element = tire(damping=500.0)
    z = next(z for z in np.linspace(0.31, 0.28, 3001) if load_at(element, z) > 4200)
    fz = [load_at(element, z, v) for v in (0.1, -0.1)]
    assert (fz[1] - fz[0]) / 0.2 == pytest.approx(500.0, rel=1e-3)


def test_a_wheel_that_lies_flat_stands_on_its_sidewall() -> None:
    """It touches at half its width, 0.1025 m; at 0.09 m the deflection is R0 (1 - 0.09/0.1025), and the load is 1/flat
    of the spring."""
    element = tire()
    above = element.evaluate(wheel(position=(0, 0, 0.1031), camber=np.pi / 2), zp=(0, 0))
    assert not np.any(above.f)
    pressed = element.evaluate(wheel(position=(0, 0, 0.09), camber=np.pi / 2), zp=(0, 0))
    rho = 0.316 * (1.0 - 0.09 / 0.1025)
    assert value(element, pressed, 'deflection') == pytest.approx(rho, rel=1e-9)
    assert value(element, pressed, 'fz') == pytest.approx(load_at(element, 0.316 - rho) * 0.316 / 0.1025, rel=1e-9)


def test_the_load_of_a_leaning_wheel_has_a_potential() -> None:
    """From upright to flat, without damper: what sinking and leaning take from the motion is stored, but for the work
    of the side force."""
    data = TireData(
        name='elastic',
        version=61,
        values={**CAR.values, 'QSX2': 0.0, 'QSX3': 0.0, 'Q_V1': 0.0, 'Q_V2': 0.0},
        side='symmetric',
    )
    element = tire(data, RoadSpec(friction=1e-3), damping=0.0)
    for camber in (0.0, 0.4, 0.8, 1.0, 1.2, 1.4, np.pi / 2, 2.0, -1.0):
        height = 0.27 * max(abs(np.cos(camber)), 0.3)
        for motion in (dict(velocity=(0, 0, 0.3)), dict(rates=(1.0, 0, 0))):
            r = element.evaluate(wheel(position=(0, 0, height), camber=camber, **motion), zp=(0, 0))
            fz = value(element, r, 'fz')
            assert fz > 3000.0
            # of the contact point, along y of the frame
            side_velocity = height * np.sign(np.cos(camber)) if 'rates' in motion else 0.0
            loss = -value(element, r, 'fy') * side_velocity
            assert value(element, r, 'dissipation') == pytest.approx(loss, rel=1e-9, abs=1e-9 * fz)


def test_the_load_never_leaves_the_contact_patch() -> None:
    """110 kN on one wheel, sliding: the overturning moment is at most half the width times the load; in normal driving
    nothing is cut."""
    element = tire()
    for side in (-8.0, 8.0):
        r = element.evaluate(
            wheel(position=(0, 0, 0.17), velocity=(20.0, side, -1.0), spin=60.0, camber=0.3), zp=(0, 0), cz=1e6
        )
        fz, mx = value(element, r, 'fz'), value(element, r, 'mx')
        assert fz > 1e5
        assert abs(mx) <= 0.1025 * fz * (1 + 1e-12)
    assert abs(mx) > 0.09 * fz  # it is reached
    free = element.evaluate(wheel(velocity=(20.0, -1.0, 0.0), spin=60.0), zp=(0, 0), cz=1e6)
    fy, fz = value(element, free, 'fy'), value(element, free, 'fz')
    assert value(element, free, 'mx') == pytest.approx(0.316 * fz * 0.03 * fy / 4200.0, rel=1e-12)


def test_growth_and_stiffening_with_speed_of_rotation() -> None:
    """At 60 rad/s: radius + R0 QV1 (omega R0/V0)^2, stiffness times 1 + QV2 omega R0/V0."""
    element = tire()
    turn = 60.0 * 0.316 / 16.7
    r = element.evaluate(wheel(position=(0, 0, 0.3), spin=60.0), zp=(0, 0))
    rho = 0.016 + 0.316 * 7e-4 * turn**2
    assert value(element, r, 'deflection') == pytest.approx(rho, rel=1e-12)
    q1, x = np.sqrt((215e3 * 0.316 / 4200) ** 2 - 60.0), rho / 0.316
    assert value(element, r, 'fz') == pytest.approx((1 + 0.045 * turn) * 4200 * (q1 * x + 15 * x * x), rel=1e-6)


def test_pressure_stiffens_the_tire() -> None:
    """20 % more pressure: PFZ1 * 0.2 = 14 % more load at the same deflection."""
    soft, hard = tire(), tire(pressure=1.2 * 230e3)
    load = [value(e, e.evaluate(wheel(), zp=(0, 0)), 'fz') for e in (soft, hard)]
    assert load[1] / load[0] == pytest.approx(1.14, rel=1e-12)


def test_a_tire_wider_than_its_radius_stands_on_its_radius() -> None:
    """Half the width over the radius holds the cosine of camber of a wheel that lies flat; an upright wheel has nothing
    of it."""
    narrow, wide = (
        tire(TireData(name='kart', version=61, values={**CAR.values, 'WIDTH': width})) for width in (0.2, 0.5)
    )
    assert load_at(wide, 0.3) == load_at(narrow, 0.3) > 0.0
