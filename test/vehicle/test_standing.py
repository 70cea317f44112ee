"""A vehicle on its rolling resistance: it stands where the slope is less, rolls where it is more, and coasts to a
standstill."""

from __future__ import annotations

import numpy as np
import pytest

from solver import load_scene, simulation_of
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.elements.tread import GIVE
from solver.simulation import Simulation

MY, SPIN, DEFLECTION = (TIRE_COLUMNS.index(name) for name in ('my', 'spin', 'deflection'))
RESISTANCE, RADIUS = 0.0085, 0.316  # of the tires of light_car and full_car: QSY1 [-], UNLOADED_RADIUS [m]
G = 9.81


def car(
    slope: float, *settings: str, speed: float = 0.0, vehicle: str = 'light_car', level: str = 'full'
) -> Simulation:
    """A free car that faces up a slope, without brakes."""
    given = [
        f'vehicle=vehicles/{vehicle}.yaml',
        f'start.speed={speed}',
        f'road.normal=[{-slope}, 0, 1]',
        f'fidelity={level}',
    ]
    found = simulation_of(load_scene('light_car_straight', [*given, 'maneuver={}', *settings]))
    assert isinstance(found, Simulation)
    return found


def place(s: Simulation) -> tuple[float, float]:
    """(x of the chassis [m], its speed [m/s])."""
    shot = s.snapshot()
    return float(shot.pose[s.channels.chassis or 0, 0]), float(shot.twist[s.channels.chassis or 0, 0])


CARS = [
    ('light_car', 'full', 1e-3),
    ('light_car', 'kc', 1e-3),
    ('light_car', 'full', 5e-3),
    pytest.param('full_car', 'full', 1e-3, marks=pytest.mark.slow),
    pytest.param('full_car', 'condensed', 1e-3, marks=pytest.mark.slow),
]


@pytest.mark.parametrize(('vehicle', 'level', 'h'), CARS)
def test_a_free_car_stands_on_less_than_its_rolling_resistance(vehicle: str, level: str, h: float) -> None:
    """0.5 % against 0.85 %: it gives way by what its treads give of that, tires and suspension by less than a
    millimetre, and stands."""
    s = car(0.005, f'integrator.h={h}', vehicle=vehicle, level=level)
    begin, _ = place(s)
    s.advance(round(8.0 / h))
    x, v = place(s)
    give = GIVE * RADIUS * 0.005 / RESISTANCE
    assert -1.2 * give - 1e-3 < x - begin < 0.0
    assert abs(v) < 1e-7
    assert s.totals()['energy_error_max'] < 1e-3


@pytest.mark.parametrize(('vehicle', 'level', 'h'), CARS[:2])
def test_beyond_it_rolls_against_the_whole_of_it(vehicle: str, level: str, h: float) -> None:
    """Each wheel: I dw/dt = My - Fx R_l, the whole: m a = sum Fx - m g sin(slope). Drag at 1 m/s is a thousandth of
    that."""
    slope = 3.0 * RESISTANCE
    s = car(slope, f'integrator.h={h}', vehicle=vehicle, level=level)
    s.advance(round(2.0 / h))
    (_, before), shot = place(s), s.advance(round(1.0 / h))
    _, after = place(s)
    mass = sum(body.mass for body in s.model.spec.bodies)
    spins, loaded = shot.tire[:, SPIN], RADIUS - shot.tire[:, DEFLECTION]
    turning = (
        sum(body.inertia[1] for body in s.model.spec.bodies if body.name.startswith('wheel_'))
        * (spins / after / loaded).mean()
    )
    lost = float((shot.tire[:, MY] / loaded).sum())
    assert np.all(shot.tire[:, MY] * spins < 0.0)
    assert after - before == pytest.approx(
        (lost - mass * G * slope / np.hypot(1.0, slope)) / (mass + turning), rel=5e-3
    )
    assert lost == pytest.approx(RESISTANCE * mass * G, rel=0.1)  # of the loaded radius, over the unloaded one
    assert abs(after - before) == pytest.approx(G * (slope - RESISTANCE), rel=0.1)


@pytest.mark.parametrize('way', [1.0, -1.0])
def test_a_car_coasts_to_a_standstill(way: float) -> None:
    """From 0.4 m/s on the flat, forwards and in reverse: half a metre or more at f g, back by what the treads give, and
    it stands."""
    s = car(0.0, speed=way * 0.4)
    begin, _ = place(s)
    track = []
    for _ in range(100):
        s.advance(100)
        track.append(place(s))
    x, v = np.array(track).T
    far = float((way * (x - begin)).max())
    assert far == pytest.approx(0.5 * 0.4**2 / (G * RESISTANCE), rel=0.15)
    assert far - way * (x[-1] - begin) == pytest.approx(GIVE * RADIUS, rel=0.2)
    assert abs(v[-1]) < 1e-5
    assert s.totals()['energy_error_max'] < 0.01


def test_a_single_track_coasts_to_a_standstill() -> None:
    s = car(0.0, 'integrator.h=5e-4', speed=0.4, level='single_track')
    s.advance(14000)
    stood, _ = place(s)
    s.advance(6000)
    x, v = place(s)
    assert abs(v) < 1e-5
    assert x == pytest.approx(stood, abs=1e-4)
    assert s.totals()['energy_error_max'] < 0.01 * 0.5 * s.describe()['mass'] * 0.4**2


@pytest.mark.slow
def test_the_step_is_of_second_order_where_a_wheel_gives_and_stands() -> None:
    """On 0.5 %, within the first half second, in which the treads only give: halving the step leaves a quarter of the
    error."""
    ends = []
    for h in (4e-3, 2e-3, 1e-3, 0.5e-3):
        s = car(0.001, f'integrator.h={h}', 'integrator.iterations=8')
        s.advance(round(0.4 / h))
        ends.append(place(s)[0])
    errors = np.abs(np.diff(ends))
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.2)
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.3)
