"""Snaking of car and trailer: frequency and damping of the simulated car against a linear single-track model of it on
its own paper."""

from __future__ import annotations

import pytest
from towing import single_track, snaking

SUSPENSION = 'vehicle.trailer.axles.axle.suspension'
# The linear model does not roll: the load lies low and stands stiff, and so does that of the car
FLAT = (
    f'{SUSPENSION}.spring.rate=620000',
    f'{SUSPENSION}.damper.law=[[-1, -40000], [1, 40000]]',
    'vehicle.trailer.chassis.com[2]=0.2',
    'vehicle.chassis.com[2]=0.25',
)
IDENTIFIED = 20.0  # m/s


@pytest.mark.slow
def test_frequency_and_damping_are_those_of_the_linear_model() -> None:
    """Identified at one speed, from steady turns; compared from 72 to 144 km/h, with and without a damper in the
    coupling."""
    track = single_track('light_car', IDENTIFIED, *FLAT)
    for u in (20.0, 40.0):
        frequency, damping = track.snaking(u)
        found = snaking('light_car', u, *FLAT)
        assert found[0] == pytest.approx(frequency, rel=0.01)
        assert found[1] == pytest.approx(damping, abs=0.01)
    frequency, damping = track.snaking(30.0, damping=2000.0)
    found = snaking('light_car', 30.0, *FLAT, 'vehicle.trailer.stabilizer={damping: 2000}')
    assert damping > track.snaking(30.0)[1] + 0.1
    assert found[0] == pytest.approx(frequency, rel=0.01)
    assert found[1] == pytest.approx(damping, abs=0.01)


@pytest.mark.slow
def test_loaded_behind_it_snakes_by_itself_from_the_critical_speed_on() -> None:
    """The load over the axle: the critical speed of the linear model is that at which the simulated one stops to calm
    down."""
    loaded = (*FLAT, 'vehicle.trailer.chassis.com[0]=0')
    critical = single_track('light_car', IDENTIFIED, *loaded).critical_speed(15.0, 60.0)
    assert 25.0 < critical < 35.0
    below, above = (snaking('light_car', factor * critical, *loaded)[1] for factor in (0.95, 1.05))
    assert below > 0.0 > above
    assert 0.95 + 0.1 * below / (below - above) == pytest.approx(1.0, abs=0.01)


@pytest.mark.long
@pytest.mark.slow
def test_damping_falls_with_speed_and_with_load_behind() -> None:
    """The saloon with the caravan as delivered, and with the same load further back [Darling2009]."""
    found = {
        (x, u): snaking('full_car', u, f'vehicle.trailer.chassis.com[0]={x}')[1]
        for x in (0.243, 0.0)
        for u in (20.0, 30.0)
    }
    for u in (20.0, 30.0):
        assert found[0.243, u] > found[0.0, u]
    assert all(found[x, 20.0] > found[x, 30.0] for x in (0.243, 0.0))
    assert found[0.243, 30.0] > 0.1 and found[0.0, 30.0] < 0.03
