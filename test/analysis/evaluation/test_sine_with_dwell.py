"""Sine with dwell: ratios, displacement, limits and series."""

from __future__ import annotations

import math

import numpy as np
import pytest
from drives import dwelling, weaving

from mbd_sim_ros.analysis.evaluation import sine_with_dwell
from mbd_sim_ros.analysis.evaluation.signals import Signals
from solver.errors import BagError, SpecError


@pytest.mark.parametrize('side', [1.0, -1.0])
def test_ratios_and_displacement_of_a_sine_with_dwell(side: float) -> None:
    r = sine_with_dwell.judge(dwelling(side=side), sine_with_dwell.SineWithDwell(reference=0.25, mass=1500.0))
    assert r['amplitude'] == pytest.approx(side * 1.5, rel=2e-3)
    assert r['over_reference'] == pytest.approx(6.0, rel=2e-3)
    assert r['speed'] == pytest.approx(22.2)
    assert r['peak_yaw_rate'] == pytest.approx(0.6, rel=5e-3)
    assert r['yaw_rate_ratio_100'] == pytest.approx(0.3, rel=0.01)  # the 6 Hz filter rounds the corners of the lines
    assert r['yaw_rate_ratio_175'] == pytest.approx(0.1, rel=0.02)
    assert r['displacement'] == pytest.approx(6.0 * 1.07**3 / 6.0, rel=0.01)
    verdicts = {f.name: f.ok for f in r.figures}
    assert verdicts['yaw_rate_ratio_100'] is True
    assert verdicts['displacement'] is False  # 1.23 m
    assert r.passed is False


def test_limits_of_a_sine_with_dwell() -> None:
    def verdicts(s: Signals, **given: float) -> dict[str, bool | None]:
        return {
            f.name: f.ok for f in sine_with_dwell.judge(s, sine_with_dwell.SineWithDwell(**given)).figures if f.limit
        }

    near = {'reference': 0.25, 'mass': 1500.0}
    assert all(verdicts(dwelling(push=9.1), **near).values())  # 1.86 m
    assert verdicts(dwelling(push=8.8), **near)['displacement'] is False  # 1.80 m
    # 1.52 m are enough for a heavy one
    assert verdicts(dwelling(push=8.8), reference=0.25, mass=4000.0)['displacement'] is True
    assert verdicts(dwelling(push=1.0), reference=0.4)['displacement'] is None  # 3.75 A
    assert verdicts(dwelling(push=1.0))['displacement'] is None  # A is not known
    assert verdicts(dwelling(ratios=(0.37, 0.1)))['yaw_rate_ratio_100'] is False
    assert verdicts(dwelling(ratios=(0.33, 0.22))) == {
        'yaw_rate_ratio_100': True,
        'yaw_rate_ratio_175': False,
        'displacement': None,
    }


def test_a_car_that_spins_to_its_first_side_has_no_second_peak_and_fails() -> None:
    """It goes on turning to the left, at 1.2 rad/s in the end, whatever the steering wheel does."""
    spun = dwelling()
    spun.values['yaw_rate'] = np.interp(spun.t, [2.0, 2.4, 4.0, 9.0], [0.0, 0.6, 1.2, 1.2])
    r = sine_with_dwell.judge(spun, sine_with_dwell.SineWithDwell())
    assert math.isnan(r['peak_yaw_rate'])
    assert [f.ok for f in r.figures if f.name.startswith('yaw_rate_ratio')] == [False, False]
    assert r.passed is False
    assert any('does not follow the steering wheel to its other side' in note for note in r.notes)
    stable = sine_with_dwell.judge(dwelling(), sine_with_dwell.SineWithDwell())
    for runs in ([r, stable], [stable, r]):
        found = {f.name: f for f in sine_with_dwell.together(runs)}
        assert found['worst_ratio_100'].ok is False
        assert found['worst_ratio_175'].ok is False
        assert found['stable_up_to'].value == 0.0


def test_another_speed_than_that_of_the_norm_is_told() -> None:
    def told(kmh: float) -> list[str]:
        s = dwelling()
        s.values['speed'][:] = kmh / 3.6
        return [
            note
            for note in sine_with_dwell.judge(s, sine_with_dwell.SineWithDwell(reference=0.25)).notes
            if 'km/h' in note
        ]

    assert told(78.1) == told(81.9) == []
    assert told(60.0) == ['steered at 60 km/h; the norm wants 80 km/h, to 2 km/h']
    assert len(told(82.5)) == 1


def test_an_angle_a_in_degrees_is_told() -> None:
    """14.3 deg given as rad: the sine of 86 deg would be one of 0.1 A, of which no displacement is asked, and the run
    passed."""

    def told(reference: float) -> list[str]:
        notes = sine_with_dwell.judge(dwelling(push=1.0), sine_with_dwell.SineWithDwell(reference=reference)).notes
        return [note.partition(',')[0] for note in notes if 'check reference' in note]

    assert told(14.3) == ['the amplitude is 0.105 A']
    assert told(0.25) == told(1.0) == []


@pytest.mark.parametrize(('rate', 'told'), [(50.0, False), (20.0, True)])
def test_samples_too_far_apart_for_the_filters_are_told(rate: float, told: bool) -> None:
    for s in (dwelling(rate=rate), dwelling()):
        s.spacing['yaw_rate'] = 1.0 / rate
        notes = sine_with_dwell.judge(s, sine_with_dwell.SineWithDwell(reference=0.3)).notes
        assert any('need 25 a second at least' in note for note in notes) == told


@pytest.mark.parametrize('side', [1.0, -1.0])
def test_a_steering_wheel_that_comes_to_rest_beside_zero_is_back_when_it_comes(side: float) -> None:
    """0.4 deg short of zero, through which it creeps 0.8 s later: half of the peak a second after it came is too much,
    although 1.8 s after it, at 0.1, all is well. Where it never comes through, the figures are the same."""
    came = 2.0 + 1.0 / 0.7 + 0.5
    for end in (0.1, -0.4):
        s = dwelling(0.6, side=side, ratios=(0.5, 0.1))
        s.values['steering'] += side * np.radians(np.interp(s.t, [came - 0.02, came, came + 1.0], [0.0, -0.4, end]))
        r = sine_with_dwell.judge(s, sine_with_dwell.SineWithDwell(reference=0.3))
        assert r['yaw_rate_ratio_100'] == pytest.approx(0.5, abs=0.01)
        assert r['yaw_rate_ratio_175'] == pytest.approx(0.1, abs=0.01)
        assert r.passed is False


def test_the_series_of_amplitudes() -> None:
    """From 1.5 A by 0.5 A to the greater of 6.5 A and 270 deg, at most 300 deg."""
    found = np.degrees(sine_with_dwell.series(math.radians(30.0)))
    assert found == pytest.approx([*np.arange(45.0, 270.0, 15.0), 270.0])
    assert np.degrees(sine_with_dwell.series(math.radians(45.0)))[-1] == pytest.approx(292.5)
    last = np.degrees(sine_with_dwell.series(math.radians(50.0)))
    assert last[-1] == pytest.approx(300.0)
    assert np.diff(last).max() == pytest.approx(25.0)


def test_a_steering_too_direct_for_the_series_is_told() -> None:
    """0.7 Hz with 1.5 A: the rate 2 pi 0.7 1.5 A cos(2 pi 0.7 t) is above 75 deg/s for 0.2 s from A = 17.8 deg on."""
    least = 75.0 / (2.0 * math.pi * 0.7 * math.cos(2.0 * math.pi * 0.7 * 0.2)) / 1.5
    assert least == pytest.approx(17.84, abs=0.01)
    assert len(sine_with_dwell.series(math.radians(least + 0.01))) > 20
    with pytest.raises(SpecError, match=r'A, its angle at 0\.3 g, is 3\.5 deg, .* that takes A = 17\.8 deg'):
        sine_with_dwell.series(math.radians(3.5))


def test_a_series_is_as_good_as_its_worst_run() -> None:
    p = sine_with_dwell.SineWithDwell(reference=0.25)
    runs = [
        sine_with_dwell.judge(dwelling(a, ratios=(q, 0.1), push=9.5), p)
        for a, q in ((1.0, 0.1), (1.25, 0.2), (1.5, 0.4))
    ]
    found = {f.name: f for f in sine_with_dwell.together(runs)}
    assert found['worst_ratio_100'].value == pytest.approx(0.4, rel=0.01)
    assert found['worst_ratio_100'].ok is False
    assert found['worst_ratio_175'].ok is True
    assert found['stable_up_to'].value == pytest.approx(1.25, rel=2e-3)
    assert found['least_displacement'].ok is True
    assert found['least_displacement'].value == pytest.approx(9.5 * 1.07**3 / 6.0, rel=0.01)
    assert found['runs'].value == 3.0


def test_what_is_no_sine_with_dwell_is_refused() -> None:
    sine = dwelling()
    sine.values['steering'] = 1.5 * np.sin(2.0 * np.pi * 0.7 * np.clip(sine.t - 2.0, 0.0, 1.0 / 0.7))
    with pytest.raises(BagError, match='stays at its second peak'):
        sine_with_dwell.judge(sine, sine_with_dwell.SineWithDwell())
    with pytest.raises(BagError, match='75 deg/s'):
        sine_with_dwell.judge(weaving(), sine_with_dwell.SineWithDwell())
    sine.values['steering'] = np.interp(sine.t, [2.0, 2.5], [0.0, 1.5])
    with pytest.raises(BagError, match='one side'):
        sine_with_dwell.judge(sine, sine_with_dwell.SineWithDwell())
