"""The light car braking: distance, locking, order of locking."""

from __future__ import annotations

import numpy as np
import pytest

from solver.elements.magic_formula import load_increment, magic_formula, slip_stiffness
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.files.scene import load_scene
from solver.simulation import Simulation

G = 9.81
SPIN = TIRE_COLUMNS.index('spin')


def braking(torque: float, *overrides: str, speed: float = 25.0, rise: float = 0.1) -> Simulation:
    maneuver = f'{{brake_torque: {{kind: step, value: {torque}, start: 0.0, rise: {rise}}}}}'
    return Simulation(
        load_scene(
            'light_car_brake', [f'maneuver={maneuver}', f'start={{kind: equilibrium, speed: {speed}}}', *overrides]
        )
    )


def wheel_rates(sim: Simulation) -> np.ndarray:
    """(4,) rotation of the wheels on their knuckles [rad/s]."""
    snapshot = sim.snapshot()
    return np.array([snapshot.joint_velocity[sim.channels.joints.index(f'wheel_{w}')] for w in sim.channels.wheels])


def slip_of_brakes(sim: Simulation) -> np.ndarray:
    """(4,) rotation of the wheels less the elastic wind-up of their brakes [rad]: where the dry friction has let go
    to."""
    snapshot, names = sim.snapshot(), sim.channels
    turned = [snapshot.joint_position[names.joints.index(f'wheel_{w}')] for w in names.wheels]
    elastic = [snapshot.elements[names.elements.index(f'brake_{w}/windup')] for w in names.wheels]
    return np.subtract(turned, elastic)


def sliding_friction(sim: Simulation, load: float, slip: float) -> float:
    """|Fx|/Fz of a tire at a longitudinal slip."""
    c = sim.model.elements['tires'].c[0]
    dfz = load_increment(c, load)
    Kx, Ky = slip_stiffness(c, 0.0, load, dfz)
    return abs(magic_formula(c, slip, 0.0, 0.0, load, dfz, 1.0, 15.0, Kx, Ky, 1.0, 0.0)[0]) / load


def test_braking_below_the_limit_decelerates_by_the_torque():
    sim = braking(2400.0)
    sim.advance(1000)
    v0 = sim.snapshot().twist[0, 0]
    v1 = sim.advance(500).twist[0, 0]
    # m_eff a = T / r + rolling resistance + drag; m_eff includes the spin of the wheels. r between loaded and rolling
    # radius
    mass = 1413.0 + 4 * 0.9 / 0.30**2
    mean = 0.5 * (v0 + v1)
    other = 0.011 * 1413.0 * G + 0.5 * 1.2 * 0.65 * mean**2
    low, high = ((2400.0 / radius + factor * other) / mass for radius, factor in ((0.311, 0.8), (0.289, 1.2)))
    assert low < (v0 - v1) / 0.5 < high


def test_locked_wheels_stand_still_and_the_distance_is_that_of_sliding_friction():
    speed = 25.0
    sim = braking(12000.0, speed=speed)
    frictions = [sliding_friction(sim, load, -1.0) for load in (1500.0, 5500.0)]
    x0 = sim.snapshot().pose[0, 0]
    sim.advance(400)
    slider = slip_of_brakes(sim)
    for _ in range(4):
        sim.advance(400)
        assert np.abs(wheel_rates(sim)).max() < 0.5  # of 80 rad/s: the brakes' elastic wind-up under changing load
        # true stick: beyond the wind-up no wheel turns at all
        assert slip_of_brakes(sim) == pytest.approx(slider, abs=1e-4)
    while np.linalg.norm(sim.snapshot().twist[0, :2]) > 0.05:
        sim.advance(50)
    distance = sim.snapshot().pose[0, 0] - x0
    # friction falls with load, so the axles' mean lies between the values at the extreme loads; before the wheels lock
    # the brakes take 0.1 s to build up, and pass the peak, which is up to 30 % higher
    low = speed**2 / (2.0 * max(frictions) * G)
    high = speed**2 / (2.0 * min(frictions) * G) + 0.1 * speed
    assert 0.95 * low < distance < high
    assert abs(sim.snapshot().pose[0, 1]) < 1e-6  # four locked wheels steer nothing


def test_hardest_braking_without_lock_lies_below_peak_friction():
    sim = braking(3900.0, speed=30.0, rise=1.5)  # just below lock
    peak = max(sliding_friction(sim, 1500.0, slip) for slip in -np.linspace(0.02, 0.3, 57))
    begin = sim.advance(1700)
    end = begin
    while end.twist[0, 0] > 5.0:
        assert wheel_rates(sim).min() > 0.5 * end.twist[0, 0] / 0.31
        end = sim.advance(50)
    distance = end.pose[0, 0] - begin.pose[0, 0]
    at_peak = (begin.twist[0, 0] ** 2 - end.twist[0, 0] ** 2) / (2.0 * peak * G)
    # the heavily loaded front tires have 10 % less friction than `peak`, that of a tire at 1.5 kN, and the rear is not
    # used fully
    assert at_peak < distance < 1.3 * at_peak


@pytest.mark.parametrize('friction', [1.0, 0.4])
def test_front_axle_locks_first(friction):
    overrides = [] if friction == 1.0 else [f'road.friction={friction}']
    sim = braking(9000.0, *overrides, speed=30.0, rise=3.0)
    locked: dict[str, float] = {}
    while len(locked) < 2 and sim.t_ns < 3e9:
        sim.advance(10)
        rates = wheel_rates(sim)
        for axle, pair in (('front', rates[:2]), ('rear', rates[2:])):
            if pair.max() < 1.0:
                locked.setdefault(axle, sim.t_ns * 1e-9)
    assert locked['front'] < locked.get('rear', np.inf)
