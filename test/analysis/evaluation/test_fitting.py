"""What `mbd maneuver` composes: roads, times and places follow from the speed and the friction that are set; nothing is
driven here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from drives import even, made

from mbd_sim_ros.analysis.evaluation import driving
from mbd_sim_ros.analysis.evaluation.driving import Driving, scene_text
from mbd_sim_ros.analysis.evaluation.registry import called
from mbd_sim_ros.analysis.evaluation.signals import Signals
from solver.elements.road_grids import RandomRoad
from solver.errors import SpecError
from solver.files.scene import load_scene_text
from solver.inputs.signals import Ramp
from solver.levels import auto
from solver.scene import Scene


def composed(monkeypatch: pytest.MonkeyPatch, name: str, *overrides: str) -> Scene:
    """The scene that would be driven with the light car."""
    scenes: list[Scene] = []

    def run(self: Driving, label: str, text: str, settings: list[str], **_: bool) -> Path:
        scenes.append(load_scene_text(text, label, [*settings, *self.overrides]))
        return Path(label)

    monkeypatch.setattr(Driving, '_run', run)
    monkeypatch.setattr(Driving, '_clearance', lambda *_: 1.0)
    monkeypatch.setattr(Driving, '_reaching', lambda *_: 0.4)
    monkeypatch.setattr(Driving, '_hardest', lambda self, label, text, start, settings: start)
    Driving('light_car', Path('out'), overrides).drive(called(name)[0])
    return scenes[-1]


def test_a_run_by_another_plan_is_another_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A plan that is made anew is not in the text of a scene with fidelity auto; the run of the older one was taken for
    its own."""
    monkeypatch.setattr(auto, 'location', lambda: tmp_path)
    monkeypatch.setattr(driving, 'simulation_of', lambda scene: None)
    monkeypatch.setattr(
        driving, 'simulate', lambda simulation, steps, *, directory, progress: directory.mkdir(parents=True)
    )
    settings = ['fidelity=auto', 'require={yaw_rate: {rms: 2 %}}']
    one = Driving('light_car', tmp_path / 'out', settings)
    text = scene_text(called('iso21994')[0].drive, one.vehicle, 'x', settings)
    plan = {
        'status': 'ok',
        'fidelity': 'full',
        'settings': {'switches': {}, 'integrator': {'h': 4e-3}},
        'envelope': [],
        'findings': [],
    }
    places = []
    for h in (4e-3, 2e-3, 2e-3):
        auto.keep(load_scene_text(text, 'x', settings), plan | {'settings': {'switches': {}, 'integrator': {'h': h}}})
        places.append(one._run('x', text, []))
    assert places[0] != places[1]
    assert places[1] == places[2]


@pytest.mark.parametrize(
    ('overrides', 'length'),
    [((), 220.0), (('start.speed_kmh=130',), 410.0), (('duration=21',), 420.0), (('start.speed=5',), 220.0)],
)  # m: 36.11 m/s * 11 s = 397.2 m and 6 m for the front wheels; 19.44 m/s * 21 s = 408.3 m and 6 m
def test_the_rough_road_is_as_long_as_the_way_of_the_car(
    overrides: tuple[str, ...], length: float, monkeypatch
) -> None:
    grid = composed(monkeypatch, 'iso2631', *overrides).model.road.grids[0]
    assert isinstance(grid, RandomRoad)
    assert grid.length == length
    user = composed(monkeypatch, 'iso2631', 'road.grids[0].length=300', *overrides).model.road.grids[0]
    assert isinstance(user, RandomRoad)
    assert user.length == 300.0


@pytest.mark.parametrize('speed', [50.0 / 3.6, 80.0 / 3.6])
def test_the_slippery_strip_begins_before_the_brakes_and_does_not_end(speed: float, monkeypatch) -> None:
    """Brakes at 2 s, the rear axle 1.33 m behind base_link; nothing is further away than speed times duration."""
    scene = composed(monkeypatch, 'iso14512', f'start.speed={speed}')
    (patch,) = scene.model.road.patches
    begin, end = (patch.center[0] + side * 0.5 * patch.size[0] for side in (-1.0, 1.0))
    assert begin == pytest.approx(1.35 * speed, abs=0.01)
    assert begin < 2.0 * speed - 1.33 - 5.0
    assert end == pytest.approx(7.0 * speed, abs=0.01)
    assert patch.center[1] + 0.5 * patch.size[1] == 0.0


@pytest.mark.parametrize('name', ['iso4138_constant_radius', 'iso4138_constant_steering'])
@pytest.mark.parametrize(('speed', 'final'), [(8.0, 21.5), (60.0 / 3.6, 21.5), (25.0, 26.0)])
def test_the_speed_of_a_circle_rises_from_that_of_the_start(name: str, speed: float, final: float, monkeypatch) -> None:
    control = composed(monkeypatch, name, f'start.speed={speed!r}').maneuver.speed
    assert control is not None
    assert isinstance(control.target, Ramp)
    assert (control.target.initial, control.target.final) == (speed, final)


@pytest.mark.parametrize(('radius', 'final', 'seconds'), [(-40.0, 13.6, 32.0), (200.0, 30.4, 49.8)])
def test_the_speed_of_a_circle_suits_its_radius(radius: float, final: float, seconds: float, monkeypatch) -> None:
    """4.62 m/s^2 as in 100 m at 21.5 m/s; from 8 m/s on at 0.5 m/s^2, 4 s after the start."""
    scene = composed(monkeypatch, 'iso4138_constant_radius', f'maneuver.driver.path.radius={radius}')
    control = scene.maneuver.speed
    assert control is not None
    assert isinstance(control.target, Ramp)
    assert control.target.final == pytest.approx(final, abs=0.05)
    assert scene.duration == pytest.approx(seconds, abs=0.1)


@pytest.mark.parametrize(('speed', 'start'), [(50.0, 25.0), (65.0, 25.0), (40.0, 50.0)])
def test_the_throttle_is_released_two_metres_behind_the_first_cones(speed: float, start: float, monkeypatch) -> None:
    scene = composed(monkeypatch, 'iso3888_2', f'start.speed_kmh={speed}', f'maneuver.driver.path.start={start}')
    control = scene.maneuver.speed
    assert control is not None
    assert control.until == pytest.approx((start + 2.0) / (speed / 3.6), abs=1e-3)


@pytest.mark.parametrize(
    ('name', 'overrides', 'seconds'),
    [
        ('iso21994', (), 9.0),
        ('iso21994', ('road.friction=0.3',), 20.9),  # 2 s and 27.78 m/s at 0.3 * 0.5 g
        ('iso21994', ('road.friction=0.3', 'duration=16'), 16.0),
        ('iso21994', ('road.friction=0.001',), 120.0),  # the longest
        ('iso3888_1', (), 8.5),
        ('iso3888_1', ('start.speed_kmh=60',), 11.3),  # 1.21 times 155 m at 16.67 m/s
        ('iso3888_2', (), 8.0),
        ('iso3888_2', ('start.speed_kmh=30',), 13.3),  # 1.29 times 86 m at 8.333 m/s
    ],
)
def test_a_maneuver_lasts_as_long_as_it_takes(
    name: str, overrides: tuple[str, ...], seconds: float, monkeypatch
) -> None:
    assert composed(monkeypatch, name, *overrides).duration == pytest.approx(seconds, abs=0.051)


@pytest.mark.parametrize('name', ['iso21994', 'iso14512', 'iso3888_1'])
def test_a_car_with_a_trailer_is_refused_for_its_trailer(name: str, tmp_path: Path) -> None:
    one = Driving('full_car', tmp_path, ['vehicle.trailer=vehicles/trailers/caravan.yaml'])
    with pytest.raises(
        SpecError, match=r'full_car pulls a trailer, and the norm is for cars alone: remove vehicle\.trailer'
    ):
        one.drive(called(name)[0])
    assert not list(tmp_path.iterdir())


class Ramps:
    """Ramps of the steering wheel at 13.5 deg/s that are not driven: a grows by 0.03 m/s^2 per degree up to `most`, in
    runs of any length.

    They keep what was asked for."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, most: float) -> None:
        self.most = most
        self.settings: list[list[str]] = []
        monkeypatch.setattr(Driving, '_run', self.run)
        monkeypatch.setattr(driving.runs, 'read', lambda place, _: float(place.name))
        monkeypatch.setattr(driving, 'signals', self.signals)
        self.driving = Driving('light_car', Path('out'))
        self.text = driving.scene_text(called('iso7401_step')[0].drive, self.driving.vehicle, 'step')

    @property
    def seconds(self) -> list[float]:
        return [
            float(setting.removeprefix('duration='))
            for settings in self.settings
            for setting in settings
            if 'duration' in setting
        ]

    def run(self, label: str, text: str, settings: list[str], **_: bool) -> Path:
        self.settings.append(list(settings))
        return Path(str(self.seconds[-1]))

    def signals(self, duration: float, *_: object) -> Signals:
        t = even(duration, 100.0)
        angle = np.radians(13.5) * np.clip(t - 1.0, 0.0, None)
        return made(t, steering=angle, lateral_acceleration=np.minimum(0.03 * np.degrees(angle), self.most))


def test_a_ramp_goes_on_while_the_car_answers(monkeypatch) -> None:
    """4 m/s^2 at 133 deg, and 4.2 at 140 deg: 11.4 s. At 0.02 m/s^2 per degree 210 deg, 16.6 s, which is the ramp of 20
    s."""
    ramps = Ramps(monkeypatch, 8.0)
    assert np.degrees(ramps.driving._reaching(ramps.text, 4.0)) == pytest.approx(4.0 / 0.03, rel=0.02)
    assert ramps.seconds == [5.0, 8.0, 12.0]
    ramps = Ramps(monkeypatch, 8.0)
    assert np.degrees(ramps.driving._reaching(ramps.text, 6.0)) == pytest.approx(6.0 / 0.03, rel=0.02)
    assert ramps.seconds == [5.0, 8.0, 12.0, 20.0]


def test_a_car_that_has_done_its_best_is_told_after_twelve_seconds(monkeypatch) -> None:
    ramps = Ramps(monkeypatch, 3.0)
    with pytest.raises(
        SpecError, match=r'light_car does not reach a lateral acceleration of 4 m/s\^2 at this speed: 3 m/s\^2 at'
    ):
        ramps.driving._reaching(ramps.text, 4.0)
    assert ramps.seconds == [5.0, 8.0, 12.0]


def test_the_amplitude_is_sought_on_the_friction_of_the_road(monkeypatch) -> None:
    """Also where the road is replaced as a whole; the rest of it is for the maneuver alone."""
    for override in ('road.friction=0.45', 'road={friction: 0.45}'):
        ramps = Ramps(monkeypatch, 3.0)
        ramps.driving.overrides = [override]
        with pytest.raises(SpecError, match=r'at this speed on a road of friction 0\.45: 3 m/s'):
            ramps.driving._reaching(ramps.text, 4.0)
        assert all('road.friction=0.45' in settings for settings in ramps.settings)


def test_a_ramp_that_ends_while_the_car_answers_says_so(monkeypatch) -> None:
    """31 s at 13.5 deg/s: 418.5 deg, 12.6 m/s^2."""
    ramps = Ramps(monkeypatch, 20.0)
    said = r': 12\.[56] m/s\^2 at 41[89] deg of the steering wheel, where the ramp ended; give the steering'
    with pytest.raises(SpecError, match=said):
        ramps.driving._reaching(ramps.text, 15.0)
    assert ramps.seconds == [5.0, 8.0, 12.0, 20.0, 32.0]
