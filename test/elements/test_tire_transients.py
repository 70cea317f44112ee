"""What takes its time: relaxation over the way, standing on a slope, sliding to rest, spinning up, flying."""

from __future__ import annotations

import numpy as np
import pytest
from contract import ContractContext
from tire_bench import CAR, H, drop, march, settled, tire, value, wheel

from solver.elements.magic_formula import slip_stiffness
from solver.elements.marker import Marker
from solver.elements.road import RoadSpec
from solver.elements.tire_data import I
from solver.elements.tire_pacejka import TireSpec, compile_tires


@pytest.mark.parametrize('direction', ['lateral', 'longitudinal'])
def test_63_percent_after_one_relaxation_length(direction: str) -> None:
    """A step of small slip at 20 m/s: 1 - 1/e after sigma of travel. Step of implicit Euler 0.1 ms = 2 mm: error 2
    mm/sigma/2/e."""
    element = tire()
    side, spin = (-0.1, 20.0 / 0.3137) if direction == 'lateral' else (0.0, 1.005 * 20.0 / 0.3137)
    motion = dict(velocity=(20, side, 0), spin=spin)
    name = 'alpha' if direction == 'lateral' else 'kappa'
    final = value(element, settled(element, wheel(**motion)), name)
    Fz = value(element, settled(element, wheel(**motion)), 'fz')
    c = compile_tires([TireSpec(name='t', marker=Marker(body='b0'), data=CAR)], ContractContext(bodies=1)).c[0]
    dfz = Fz / 4200 - 1.0
    Kx, Ky = slip_stiffness(c, 0.0, Fz, dfz)
    sigma = -Ky / (120e3 * (1 + 0.10 * dfz)) if direction == 'lateral' else Kx / (380e3 * (1 + 0.17 * dfz))
    trace = march(element, wheel(**motion), 400, h=1e-4)
    travel = 20.0 * 1e-4 * np.arange(1, 401)
    history = np.array([value(element, r, name) for r in trace]) / final
    assert np.interp(sigma, travel, history) == pytest.approx(1.0 - np.exp(-1.0), abs=0.01)
    assert c[I.IS_61] == 1.0


def slope_gravity(grade: float, heading: float = 0.0) -> tuple[float, float, float]:
    """Gravity seen from a road inclined by `grade` [rad], downhill direction at `heading` from x."""
    g = 9.81
    return (g * np.sin(grade) * np.cos(heading), g * np.sin(grade) * np.sin(heading), -g * np.cos(grade))


@pytest.mark.slow
def test_a_braked_wheel_on_a_slope_stands_without_creeping() -> None:
    """11.3 degrees, downhill obliquely: after 6 s the velocity is rounding error (a viscous tire model would creep by
    mm/s).

    The large vertical damping stands for the suspension, so that the bounce has died away."""
    element = tire(damping=6000.0)
    gravity = slope_gravity(0.2, 0.6)
    trace = drop(element, mass=400.0, gravity=gravity, seconds=6.0)
    x, v, r = trace[-1]
    assert np.abs(v).max() < 1e-9
    assert np.linalg.norm(x - trace[-1000][0]) < 1e-9
    np.testing.assert_allclose(r.f[0, :3], -400.0 * np.array(gravity), rtol=1e-8)
    assert np.linalg.norm(x[:2]) < 0.03  # it sagged by the contact deflection


def test_on_a_slope_steeper_than_friction_the_wheel_slides_with_bounded_force() -> None:
    element = tire(road=RoadSpec(friction=0.2))
    trace = drop(element, mass=400.0, gravity=slope_gravity(0.35), seconds=1.5)
    fx = np.array([value(element, r, 'fx') for _, _, r in trace])
    fz = np.array([value(element, r, 'fz') for _, _, r in trace])
    assert trace[-1][1][0] > 1.0
    assert (np.abs(fx) < 0.2 * 1.2 * fz + 1.0).all()
    assert fx[-1] < -0.5 * 0.2 * fz[-1]


def test_a_locked_wheel_slides_to_rest_and_recoils_little() -> None:
    """From 3 m/s: it stops, swings back by no more than the energy of the contact spring allows (0.5 m/s), and ends at
    rest."""
    element = tire()
    trace = drop(element, mass=400.0, gravity=(0, 0, -9.81), seconds=3.0, velocity=(3.0, 0.0, 0.0))
    v = np.array([v[0] for _, v, _ in trace])
    assert v.min() > -0.5
    assert abs(v[-1]) < 1e-6
    first = int(np.argmax(v < 0.0))
    assert 0.25 < first * H < 0.45  # 3 m/s over 0.8 to 1.1 g
    kappa = np.array([value(element, r, 'kappa') for _, _, r in trace])
    assert np.abs(kappa).max() < 1.0


def test_wheel_spin_at_standstill_has_bounded_slip_and_force() -> None:
    element = tire()
    trace = march(element, wheel(spin=200.0), 2000)
    kappa = np.array([value(element, r, 'kappa') for r in trace])
    fx, fz = (np.array([value(element, r, k) for r in trace]) for k in ('fx', 'fz'))
    assert 0.0 < kappa[-1] < 0.5
    assert (fx < 1.2 * fz).all()
    assert fx[-1] > 0.8 * fz[-1]


def test_deflections_vanish_in_the_air() -> None:
    """After 0.5 s at 20/s nothing is left: factor (1 + 0.02)^-500 = 5e-5; faster when the wheel turns."""
    element = tire()
    trace = march(element, wheel(position=(0, 0, 1.0)), 500, z=(0.02, -0.03))
    assert not np.any(trace[0].f)
    np.testing.assert_allclose(trace[-1].z[:2], np.array([0.02, -0.03]) * 1.02**-500, rtol=1e-9)
