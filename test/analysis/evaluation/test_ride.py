"""ISO 2631: weights, running RMS and doses of sines and bursts."""

from __future__ import annotations

import math

import numpy as np
import pytest
from drives import even, made

from mbd_sim_ros.analysis.evaluation import ride
from mbd_sim_ros.analysis.evaluation.signals import Vehicle
from solver.errors import BagError
from solver.files.scene import load_scene_text

# Weights x 1000 at one-third-octave frequencies as tables of the standard give them.
TABLE = {
    'wk': {
        0.5: 418, 1.0: 482, 2.0: 531, 2.5: 631, 3.15: 804, 4.0: 967, 5.0: 1039, 6.3: 1054, 8.0: 1036, 10.0: 988,
        12.5: 902, 16.0: 768,
        20.0: 636, 31.5: 405, 50.0: 246, 80.0: 132,
    },
    'wd': {0.5: 853, 1.0: 1011, 1.25: 1008, 2.0: 890, 2.5: 776, 4.0: 512, 8.0: 253, 16.0: 125, 31.5: 63.2, 80.0: 21.1},
}  # fmt: skip


@pytest.mark.parametrize('key', ['wk', 'wd'])
def test_weightings_are_those_of_the_tables(key: str) -> None:
    """At the nominal one-third-octave frequencies, to the rounding of the table (one entry, 16 Hz, is rounded down
    there)."""
    f, expected = np.array(list(TABLE[key])), np.array(list(TABLE[key].values()))
    unit = np.where(expected < 100.0, 0.1, 1.0)
    assert np.all(np.abs(1e3 * np.abs(ride.WEIGHTINGS[key].response(f)) - expected) < 0.75 * unit)


@pytest.mark.parametrize(
    ('axis', 'name', 'key'), [('x', 'ax', 'wd'), ('y', 'ay', 'wd'), ('z', 'az', 'wk'), ('z', 'az', 'wb')]
)
def test_a_sine_has_the_weight_of_its_frequency(axis: str, name: str, key: str) -> None:
    """RMS A |H|/sqrt(2), dose A |H| (3/8 T)^(1/4), crest factor sqrt(2), running RMS the RMS once it has settled."""
    t = even(32.0, 400.0)
    f, A = 5.0, 1.3
    s = made(t, ax=0.0, ay=0.0, az=9.81)
    s.values[name] = s.values[name] + A * np.sin(2.0 * np.pi * f * t)
    r = ride.judge(s, ride.Ride())
    weight = abs(ride.WEIGHTINGS[key].response(np.array([f]))[0])
    assert r[f'{axis}_{key}_rms'] == pytest.approx(A * weight / math.sqrt(2.0), rel=2e-3)
    assert r[f'{axis}_{key}_vdv'] == pytest.approx(A * weight * (0.375 * 30.0) ** 0.25, rel=2e-3)
    if key != 'wb':
        assert r[f'{axis}_{key}_crest'] == pytest.approx(math.sqrt(2.0), rel=0.01)
        # ripple of 1/(4 pi f T) of the mean square
        assert r[f'{axis}_{key}_mtvv'] == pytest.approx(A * weight / math.sqrt(2.0), rel=0.06)
        assert r['total'] == pytest.approx(A * weight / math.sqrt(2.0), rel=2e-3)


def test_running_rms_of_a_burst() -> None:
    """y = 1 from t = 0 on: sqrt(1 - exp(-t/T)); off again it fades with exp(-t/2T)."""
    t = even(10.0, 100.0)
    found = ride.running_rms(np.where(t <= 5.0, 1.0, 0.0), 100.0, 1.0)
    on, off = (t > 0.1) & (t <= 5.0), t > 5.1
    assert found[on] == pytest.approx(np.sqrt(1.0 - np.exp(-t[on])), abs=1e-9)
    assert found[off] == pytest.approx(math.sqrt(1.0 - math.exp(-5.0)) * np.exp(-0.5 * (t[off] - 5.0)), rel=5e-3)


def test_a_weighting_is_causal() -> None:
    """Nothing comes before a shock but the ringing of the band limit at half the sampling rate."""
    y = np.zeros(4000)
    y[2000] = 1.0
    found = ride.weighted(y, 400.0, ride.WEIGHTINGS['wk'])
    assert np.abs(found[:1950]).max() < 1e-2 * np.abs(found).max()
    with pytest.raises(BagError, match='no vibration in the recording'):
        ride.judge(made(even(8.0), ax=0.0, ay=0.0, az=9.81), ride.Ride())


@pytest.mark.parametrize(
    ('speed', 'told'), [(19.0, ''), (130.0 / 3.6, 'only from t = 0.18 to 6.19'), (3.0, 'only from t = 2.11 to 11')]
)
def test_a_road_that_ends_within_what_is_averaged_is_told(speed: float, told: str) -> None:
    """x from 5 to 225 m, wheels 1.325 m ahead of base_link and behind it: front wheels at 225 m after 6.19 s, rear ones
    at 5 m after 0.18 s at 130 km/h; at 3 m/s after 2.11 s."""
    scene = load_scene_text('vehicle: vehicles/light_car.yaml\nroad: roads/class_c.yaml')
    t = even(11.0, 100.0)
    s = made(t, ax=0.0, ay=0.0, az=9.81 + np.sin(10.0 * t), x=speed * t, y=0.0, heading=0.0)
    s.vehicle = Vehicle(scene=scene)
    notes = [note for note in ride.judge(s, ride.Ride()).notes if 'rough part of the road' in note]
    assert len(notes) == bool(told)
    assert all(f'{told} s, and the figures are of t = 2 to 11 s' in note for note in notes)
    s.values['y'] = s['y'] + 100.0
    assert any('the rough part of the road at no time' in note for note in ride.judge(s, ride.Ride()).notes)


def test_the_band_is_that_of_the_accelerometer_and_not_of_a_topic_beside_it() -> None:
    t = even(8.0, 1000.0)
    s = made(t, ax=0.0, ay=0.0, az=9.81 + np.sin(10.0 * t), x=20.0 * t, y=0.0, heading=0.0)
    assert not [note for note in ride.judge(s, ride.Ride()).notes if 'recorded at' in note]
    s.notes.clear()
    s.spacing['az'] = 0.01
    assert any(
        'recorded at 100 Hz: nothing above 50 Hz is in the figures' in note for note in ride.judge(s, ride.Ride()).notes
    )


@pytest.mark.parametrize(
    ('name', 'push', 'told'), [('ax', -6.0, True), ('ay', 3.0, True), ('ay', 1.5, False), ('az', 6.0, False)]
)
def test_horizontal_accelerations_of_driving_are_told(name: str, push: float, told: bool) -> None:
    """A lane change was extremely uncomfortable, and a stop fairly, without a word."""
    t = even(12.0, 250.0)
    s = made(t, ax=0.3 * np.sin(9.0 * t), ay=0.0, az=9.81 + np.sin(9.0 * t))
    s.values[name] = s.values[name] + np.where(t > 6.0, push, 0.0)
    notes = ' '.join(ride.judge(s, ride.Ride()).notes)
    assert ('the car accelerates, brakes or turns: its horizontal acceleration below 0.5 Hz' in notes) is told
