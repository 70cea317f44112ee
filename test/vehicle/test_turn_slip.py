"""Turn slip in a car: `turn_slip: true` of an axle. A car that is steered where it stands, and on a circle."""

from __future__ import annotations

import numpy as np
import pytest

from solver.elements.magic_formula import load_increment
from solver.elements.tire_data import I
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.elements.turn_slip import saturated_moment
from solver.files.scene import load_scene
from solver.simulation import Simulation

ON, OFF = (tuple(f'vehicle.{axle}.turn_slip={value}' for axle in ('front', 'rear')) for value in ('true', 'false'))
FY, FZ, MZ = (TIRE_COLUMNS.index(key) for key in ('fy', 'fz', 'mz'))


def car(*overrides: str, maneuver: str, start: str) -> Simulation:
    return Simulation(load_scene('light_car_circle', [f'maneuver={maneuver}', f'start={start}', *overrides]))


def test_parking_moment_of_a_standing_car() -> None:
    """Steered left 6 rad in 2 s at rest: the front tires resist with 0.8 to 1 of M_z phi infinity each, keep it when
    the wheel is held, and the car does not turn; without turn slip nothing resists."""
    parked = dict(
        maneuver='{steering: {kind: step, value: 6.0, start: 0.2, rise: 2.0}, drive_torque: 0}',
        start='{kind: equilibrium, speed: 0}',
    )
    on, off = car(*ON, **parked), car(*OFF, **parked)
    on.advance(2300)
    moment = on.snapshot().tire[:2, MZ].copy()
    for e in range(2):
        c = on.model.elements['tires'].c[e]
        Fz = on.snapshot().tire[e, FZ]
        peak = (c[I.PDY1] + c[I.PDY2] * load_increment(c, Fz)) * Fz
        assert 0.8 < -moment[e] / saturated_moment(c, peak, Fz) < 1.0
    on.advance(1000)
    np.testing.assert_allclose(on.snapshot().tire[:2, MZ], moment, rtol=0.1)
    assert abs(2.0 * on.snapshot().pose[0, 5]) < 0.01  # heading [rad]
    off.advance(2300)
    assert np.abs(off.snapshot().tire[:2, MZ]).max() < 0.2 * np.abs(moment).min()


def test_tight_circle_needs_more_steering() -> None:
    """At 3 m/s and the same steering the car with turn slip yaws less: spin moments of all wheels and the side forces
    of the front against those of the rear turn it back. At 20 m/s on a wide bend nearly nothing is left of it."""
    rate = {}
    for speed, steering in ((3.0, 4.0), (20.0, 0.3)):
        bend = dict(
            maneuver=f'{{steering: {{kind: step, value: {steering}, start: 0.2, rise: 1.0}}, drive_torque: 60}}'
        )
        bend['start'] = f'{{kind: equilibrium, speed: {speed}}}'
        for name, overrides in (('on', ON), ('off', OFF)):
            sim = car(*overrides, **bend)
            sim.advance(4000)
            shot = sim.snapshot()
            rate[speed, name] = shot.twist[0, 5] / np.linalg.norm(shot.twist[0, :2])
    tight = rate[3.0, 'on'] / rate[3.0, 'off']
    wide = rate[20.0, 'on'] / rate[20.0, 'off']
    assert 0.99 < tight < 0.999
    assert wide == pytest.approx(1.0, abs=0.01)
