"""The preview driver: geometry of the track, the law, lane changes inside the cones, exact replay and exact
checkpoints."""

from __future__ import annotations

import math

import numpy as np
import pytest

from solver import simulation_of
from solver.errors import SceneError, SpecError
from solver.files.scene import load_scene, load_scene_text
from solver.inputs.driver import Circle, Course, DoubleLaneChange, PreviewDriver, Sight, SpeedControl, Waypoints
from solver.inputs.maneuver import DriverSource, Maneuver
from solver.inputs.signals import Ramp
from solver.simulation import Simulation

LENGTH = 4.6  # of the body of a mid-size car [m]


def test_track_of_iso_3888() -> None:
    """Part 1: 125 m with lanes 1.1 w + 0.25, 1.2 w + 0.25, 1.3 w + 0.25; part 2: 61 m, w + 1 in the middle, 3 m or more
    at the end."""
    first, second, third = DoubleLaneChange(width=1.8, start=10.0).gates
    assert np.diff([*first[:2], *second[:2], *third[:2]]) == pytest.approx([15, 30, 25, 25, 30])
    assert [g.left - g.right for g in (first, second, third)] == pytest.approx([2.23, 2.41, 2.59])
    assert second.right - first.right == pytest.approx(3.5)
    first, second, third = DoubleLaneChange(standard='iso_3888_2', width=1.8).gates
    assert third.end - first.begin == pytest.approx(61.0)
    assert np.diff([*first[:2], *second[:2], *third[:2]]) == pytest.approx([12, 13.5, 11, 12.5, 12])
    assert [g.left - g.right for g in (first, second, third)] == pytest.approx([2.23, 2.8, 3.0])
    assert second.right - first.left == pytest.approx(1.0)


def test_path_runs_through_the_middle_of_the_lanes() -> None:
    track = DoubleLaneChange(width=1.8, start=10.0)
    for gate in track.gates:
        for x in (gate.begin, 0.5 * (gate.begin + gate.end), gate.end):
            assert track.lateral(x) == pytest.approx(gate.middle)
    assert track.lateral(-5.0) == 0.0


def test_law_is_the_steady_state_on_the_arc_through_the_preview_point() -> None:
    """On a circle of radius 200 m, tangent to it: steering = ratio (L + K v^2)/R, to the arc's (l/R)^2/4."""
    R = 200.0
    x = np.linspace(0.0, 60.0, 601)
    path = Waypoints(points=tuple((float(a), float(R - np.sqrt(R * R - a * a))) for a in x))
    driver = PreviewDriver(path=path, preview=0.8, wheelbase=2.7, ratio=15.0, understeer=0.002)
    expected = 15.0 * (2.7 + 0.002 * 20.0**2) / R
    assert driver.steering(Sight(0.0, 0.0, 0.0, 20.0)) == pytest.approx(expected, rel=(16.0 / R) ** 2)
    straight = PreviewDriver(path=Waypoints(points=((0.0, 0.0), (100.0, 0.0))))
    assert straight.steering(Sight(10.0, 0.0, 0.0, 20.0)) == 0.0
    assert straight.steering(Sight(10.0, 0.5, 0.0, 20.0)) < 0.0  # left of the path: steer to the right
    assert straight.steering(Sight(10.0, 0.0, -0.1, 20.0)) > 0.0  # heading to the right: steer to the left
    assert straight.steering(Sight(10.0, 50.0, 0.0, 0.0)) == -straight.limit


def margins(scene: str) -> tuple[Simulation, list[float], np.ndarray]:
    """The run of a scene, distance [m] of the body's corners to the cones of each lane, and lateral acceleration
    [m/s^2]."""
    loaded = load_scene(scene)
    simulation, path = Simulation(loaded), loaded.maneuver.driver.path  # type: ignore[union-attr]
    track = []
    while simulation.k < loaded.steps:
        s = simulation.advance(10)
        x, y, _, qx, qy, qz, qw = s.pose[0]
        track.append(
            [
                x,
                y,
                np.arctan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz)),
                s.twist[0, 0] * s.twist[0, 5],
            ]
        )
    x, y, heading, acceleration = np.array(track).T
    found = []
    for gate in path.gates:
        worst = np.inf
        for along in (-0.5 * LENGTH, 0.5 * LENGTH):
            for side in (-0.5 * path.width, 0.5 * path.width):
                X = x + along * np.cos(heading) - side * np.sin(heading)
                Y = y + along * np.sin(heading) + side * np.cos(heading)
                between = (gate.begin <= X) & (gate.end >= X)
                assert between.any()
                worst = min(worst, (gate.left - Y[between]).min(), (Y[between] - gate.right).min())
        found.append(float(worst))
    return simulation, found, acceleration


@pytest.mark.slow
@pytest.mark.parametrize(
    ('scene', 'least'), [('car_lane_change', 6.0), ('car_obstacle_avoidance', 6.0), ('light_car_lane_change', 5.0)]
)
def test_lane_change_stays_between_the_cones(scene: str, least: float) -> None:
    """No corner of the body touches a cone, at lateral accelerations beyond the linear range, and the car runs straight
    afterwards."""
    simulation, margin, acceleration = margins(scene)
    assert min(margin) > 0.0
    assert np.abs(acceleration).max() > least
    assert abs(simulation.snapshot().twist[0, 5]) < 0.06


@pytest.mark.slow
def test_replay_of_what_was_applied_is_exact() -> None:
    """One step at a time, many at once, the recorded inputs played back, and a run continued from a saved state give
    the same bits."""
    scene = load_scene('light_car_lane_change', ['maneuver.driver.path.start=5'])
    single, chunked, replayed, continued = (Simulation(scene) for _ in range(4))
    inputs, saved = [], b''
    for k in range(1500):
        if k == 700:
            saved = single.save()
        inputs.append(single.advance(1).inputs)
    end = single.snapshot()
    assert np.abs(np.array(inputs)[:, scene.model.inputs.index('steering')]).max() > 0.3
    chunked.advance(1500)
    replayed.advance(1500, np.array(inputs))
    continued.restore(saved)
    continued.advance(800)
    for other in (chunked, replayed, continued):
        for name in ('pose', 'twist', 'tire', 'inputs'):
            assert np.array_equal(getattr(other.snapshot(), name), getattr(end, name))
    single.reset()
    single.advance(1500)
    assert np.array_equal(single.snapshot().pose, end.pose)


def test_refusals() -> None:
    driver = PreviewDriver(path=DoubleLaneChange())
    with pytest.raises(SpecError, match='the driver steers'):
        Maneuver(driver=driver, steering=0.3)
    with pytest.raises(SpecError, match='sees the motion'):
        Maneuver(driver=driver).commands(0.0)
    with pytest.raises(SpecError, match='preview'):
        PreviewDriver(path=DoubleLaneChange(), preview=0.0)
    with pytest.raises(SpecError, match='two'):
        Waypoints(points=((0.0, 0.0),))
    with pytest.raises(SpecError, match=r'width of a vehicle, 0\.03 to 3 m'):
        DoubleLaneChange(width=18.0)  # in dm
    with pytest.raises(SpecError, match=r'path.radius = 3: .* 3.51 m: 1.3 times its wheelbase = 2.7 m, or more'):
        PreviewDriver(path=Circle(radius=3.0))
    with pytest.raises(SpecError, match='radius = 0: must not be 0'):
        Circle(radius=0.0)
    with pytest.raises(SceneError, match='standard'):
        load_scene('light_car_lane_change', ['maneuver.driver.path.standard=iso_3888'])
    with pytest.raises(SpecError, match='functions of time'):
        simulation_of(load_scene('light_car_lane_change', ['integrator={kind: reference_kkt}']))


@pytest.mark.parametrize(
    ('speed', 'kept', 'says'),
    [
        ('-5', 'speed: {}', r'start\.speed = -5\.0: a driver looks ahead.*take 0 or more'),
        ('0', 'speed: {target: -5}', r'maneuver\.speed\.target = -5.*: a driver looks ahead.*take 0 or more'),
    ],
)
def test_a_driver_who_would_go_backwards_is_refused_where_the_scene_is_read(speed: str, kept: str, says: str) -> None:
    """He looks ahead, which turns the car round in reverse; without him it may go backwards."""
    driver = 'driver: {path: {kind: circle, radius: 30}}'
    with pytest.raises(SceneError, match=says) as refused:
        load_scene('car_step_steer', [f'start.speed={speed}', f'maneuver={{{kept}, {driver}}}'])
    assert '\n' not in str(refused.value)
    load_scene('car_step_steer', [f'start.speed={speed}', f'maneuver={{{kept}}}'])
    load_scene('car_step_steer', ['start.speed=0', f'maneuver={{speed: {{}}, {driver}}}'])


@pytest.mark.parametrize('scale', [1.0, 0.1, 0.03, 2.5])
def test_lanes_and_circles_are_those_of_a_car_of_any_size(scale: float) -> None:
    """1:10 and 1:30 models and a lorry: the lanes by the width, the tightest circle by the wheelbase."""
    first = DoubleLaneChange(width=min(1.8 * scale, 3.0)).gates[0]
    assert first.left - first.right == pytest.approx(1.1 * min(1.8 * scale, 3.0) + 0.25)
    assert PreviewDriver(path=Circle(radius=-4.0 * scale), wheelbase=2.65 * scale).path.radius == -4.0 * scale
    with pytest.raises(SpecError, match='must be a radius that a car can drive'):
        PreviewDriver(path=Circle(radius=3.4 * scale), wheelbase=2.65 * scale)


def test_circle_is_left_of_who_runs_inside_to_the_right() -> None:
    """On the circle nothing to correct, wherever; 1 m outside a left-hand circle it lies 1 m to the left, inside 1 m to
    the right."""
    for radius in (100.0, -100.0):
        path = Circle(radius=radius, start=10.0)
        for angle in np.linspace(0.0, 2.0 * np.pi, 9):
            for out in (-1.0, 0.0, 1.0):
                R = abs(radius) + out
                x, y = 10.0 + R * np.sin(angle), radius - np.sign(radius) * R * np.cos(angle)
                assert path.left_of(x, y, np.sign(radius) * angle) == pytest.approx(np.sign(radius) * out, abs=1e-9)


def point_mass(
    control: SpeedControl, *, mass: float, resistance: float, speed: float, seconds: float, h: float = 1e-3
) -> np.ndarray:
    """(n, 4) time, speed, drive and brake torque of mass * dv/dt = T - resistance under the control, as DriverSource
    calls it; brakes and resistance act against the speed that it begins with."""
    ahead = np.sign(speed)
    names = ('drive_torque', 'brake_torque')
    source = DriverSource(Maneuver(speed=control), names, round(h * 1e9), start=speed)
    v, rows = speed, []
    for k in range(round(seconds / h)):
        drive, brake = source.sample(k, Sight(0.0, 0.0, 0.0, v))
        rows.append((k * h, v, drive, brake))
        v += h * (drive - ahead * (brake + resistance)) / mass
    return np.array(rows)


def test_speed_returns_as_a_critically_damped_loop_does() -> None:
    """A resistance R that begins at once: e'' + 2 w e' + w^2 e = 0 with e'(0) = R/m, so e = R/m t exp(-w t); the step
    is 1 ms of 530 ms."""
    mass, resistance, bandwidth = 450.0, 150.0, 0.3
    t, v, drive, brake = point_mass(
        SpeedControl(inertia=mass, bandwidth=bandwidth), mass=mass, resistance=resistance, speed=20.0, seconds=8.0
    ).T
    w = 2.0 * np.pi * bandwidth
    expected = 20.0 - resistance / mass * t * np.exp(-w * t)
    assert np.abs(v - expected).max() < 2.0 * w * 1e-3 * (20.0 - expected).max()
    assert drive[-1] == pytest.approx(resistance, rel=1e-4)
    assert not brake.any()


def test_a_ramp_of_speed_is_followed_without_lag() -> None:
    target = Ramp(initial=10.0, slope=0.5, start=1.0, final=15.0)
    control = SpeedControl(target=target, inertia=450.0, first=100.0)
    t, v, *_ = point_mass(control, mass=450.0, resistance=100.0, speed=10.0, seconds=14.0).T
    assert np.abs(v - target.jet(t).value).max() < 1e-3  # half a step of the ramp is 0.25 mm/s
    heavier = point_mass(control, mass=500.0, resistance=100.0, speed=10.0, seconds=14.0)
    # the integral finds what the inertia lacks
    assert abs(heavier[10000, 1] - target.jet(np.array([10.0])).value[0]) < 0.01


def test_engine_and_brakes_have_their_limits_and_the_integral_does_not_run_away() -> None:
    """From 20 to 10 m/s: the engine drags with 300 N m, the brakes add what they may, and 10 m/s is not undershot by
    more than 2 %."""
    slower = Ramp(initial=20.0, slope=-10.0, start=0.5, final=10.0)
    coasting = point_mass(SpeedControl(target=slower), mass=450.0, resistance=0.0, speed=20.0, seconds=20.0)
    assert coasting[:, 2].min() == -300.0
    assert not coasting[:, 3].any()
    braking = point_mass(
        SpeedControl(target=slower, brakes=2000.0), mass=450.0, resistance=0.0, speed=20.0, seconds=20.0
    )
    assert braking[:, 3].max() == 2000.0
    for found in (coasting, braking):
        assert found[-1, 1] == pytest.approx(10.0, abs=0.02)
        assert found[:, 1].min() > 9.8
    t10 = [rows[np.argmax(rows[:, 1] < 11.0), 0] for rows in (coasting, braking)]
    assert t10[1] < 0.5 * t10[0]
    away = point_mass(SpeedControl(target=10.0, most=100.0), mass=450.0, resistance=200.0, speed=10.0, seconds=5.0)
    assert away[:, 2].max() == 100.0


@pytest.mark.parametrize(('begin', 'end'), [(2.0, 6.0), (20.0, 10.0), (5.0, 0.0)])
def test_a_car_in_reverse_is_kept_as_the_mirror_image_of_one_that_drives_forwards(begin: float, end: float) -> None:
    slope = np.copysign(1.0, end - begin)
    there, back = (
        point_mass(
            SpeedControl(target=Ramp(initial=s * begin, slope=s * slope, start=0.2, final=s * end), first=s * 50.0,
            brakes=3000.0),
            mass=450.0, resistance=100.0, speed=s * begin, seconds=15.0,
        )
        for s in (1.0, -1.0)
    )  # fmt: skip
    assert there[-1, 1] == pytest.approx(end, abs=0.05)
    np.testing.assert_array_equal(back[:, 1:3], -there[:, 1:3])
    np.testing.assert_array_equal(back[:, 3], there[:, 3])


def test_a_car_that_rolls_backwards_and_shall_stand_is_braked_as_one_that_rolls_forwards() -> None:
    control = SpeedControl(brakes=3000.0)
    drive, brake, kept = control.torques(0.0, 0.0, 0.0, 2.0, 30.0, 1e-3)
    assert drive == -300.0 and brake > 0.0
    assert control.torques(0.0, 0.0, 0.0, -2.0, -30.0, 1e-3) == (-drive, brake, -kept)


def test_released_throttle_gives_no_torque() -> None:
    control = SpeedControl(until=1.0, release=0.2, first=100.0)
    # so heavy that its speed does not change
    rows = point_mass(control, mass=1e9, resistance=0.0, speed=10.0, seconds=2.0)
    t, drive = rows[:, 0], rows[:, 2]
    assert drive[t <= 1.0] == pytest.approx(100.0, rel=1e-5)
    assert drive[np.argmin(np.abs(t - 1.1))] == pytest.approx(50.0, abs=0.6)
    assert not drive[t > 1.2].any()


HOLD = """
vehicle: vehicles/light_car.yaml
start: {kind: equilibrium, speed: 10}
maneuver:
  speed: {target: {kind: ramp, initial: 10, slope: 1, start: 0.2, final: 11}, first: 40}
  driver: {path: {kind: circle, radius: 60}, wheelbase: 2.65, ratio: 17.9}
integrator: {h: 1.0e-3, iterations: 1}
duration: 2
"""


@pytest.mark.slow
def test_a_car_keeps_radius_and_speed_and_goes_on_from_a_saved_state_bit_for_bit() -> None:
    scene = load_scene_text(HOLD)
    straight, continued = Simulation(scene), Simulation(scene)
    straight.advance(700)
    saved = straight.save()
    s = straight.advance(1300)
    continued.restore(saved)
    assert np.array_equal(continued.advance(1300).numbers, s.numbers)
    assert s.twist[0, 0] == pytest.approx(11.0, abs=0.05)
    x, y = s.pose[0, :2]
    assert np.hypot(x, y - 60.0) == pytest.approx(60.0, abs=0.2)
    straight.reset()
    assert np.array_equal(straight.advance(2000).numbers, s.numbers)
    assert s.inputs[scene.model.inputs.index('drive_torque')] > 0.0


def test_refusals_of_who_keeps_a_speed() -> None:
    with pytest.raises(SpecError, match='drive_torque is given'):
        Maneuver(speed=SpeedControl(), drive_torque=100.0)
    with pytest.raises(SpecError, match='brake_torque is given'):
        Maneuver(speed=SpeedControl(brakes=100.0), brake_torque=100.0)
    assert Maneuver(speed=SpeedControl(), brake_torque=100.0).closed_loop
    with pytest.raises(SpecError, match='no input drive_torque'):
        DriverSource(Maneuver(speed=SpeedControl()), ('steering',), 1_000_000)
    with pytest.raises(SpecError, match='least'):
        SpeedControl(least=10.0)
    with pytest.raises(SpecError, match='bandwidth'):
        SpeedControl(bandwidth=0.0)
    with pytest.raises(SpecError, match='radius'):
        Circle(radius=0.0)
    for far, where in (
        (lambda: DoubleLaneChange(start=1e40), r'start = 1e\+40: must be within 1e\+07 m'),
        (lambda: Circle(radius=1e200), r'radius = 1e\+200'),
        (lambda: Waypoints(points=((0.0, 0.0), (10.0, -1e9))), r'points\[1\]\[1\] = -1e\+09'),
        (lambda: Course(points=((0.0, 0.0), (1e300, 0.0))), r'points\[1\]\[0\] = 1e\+300'),
    ):
        with pytest.raises(SpecError, match=where):
            far()
    with pytest.raises(SpecError, match='sees the motion'):
        Maneuver(speed=SpeedControl()).commands(0.0)
    with pytest.raises(SpecError, match="'speed' is given too"):
        Maneuver(speed=SpeedControl(), bag='bags/first')


def test_a_course_of_points_on_a_circle_is_that_circle() -> None:
    """32 points on a radius of 40 m: between them the cubic departs by less than the fourth order of their distance
    allows (2 mm)."""
    radius, n = 40.0, 32
    angles = 2.0 * np.pi * np.arange(n) / n
    points = tuple((radius * np.sin(a), radius * (1.0 - np.cos(a))) for a in angles.tolist())
    course, circle = Course(points=points, closed=True), Circle(radius=radius)
    for angle in np.linspace(0.0, 2.0 * np.pi, 37):
        for out in (-3.0, 0.0, 2.0):
            x, y = (radius + out) * np.sin(angle), radius - (radius + out) * np.cos(angle)
            assert course.left_of(x, y, angle) == pytest.approx(circle.left_of(x, y, angle), abs=5e-3)


def test_an_open_course_goes_straight_on_and_its_own_crossings_are_told_apart() -> None:
    """A loop that crosses itself at right angles: on each branch the one that is driven is followed."""
    loop = ((50.0, 10.0), (40.0, 20.0), (30.0, 10.0))
    course = Course(points=(*((x, 0.0) for x in range(0, 45, 5)), *loop, *((30.0, y) for y in range(5, -35, -5))))
    assert course.left_of(-50.0, 1.0, 0.0) == pytest.approx(-1.0)
    assert course.left_of(29.9, 0.5, 0.0) == pytest.approx(-0.5, abs=0.1)
    assert course.left_of(30.5, -5.0, -0.5 * np.pi) == pytest.approx(-0.5, abs=0.1)
    assert course.left_of(31.0, -200.0, -0.5 * np.pi) == pytest.approx(-1.0, abs=0.1)


@pytest.mark.parametrize('closed', [False, True])
def test_a_long_course_is_looked_at_in_pieces_and_the_same_is_found(rng, closed: bool) -> None:
    """Beside a look at every piece of a random way that crosses itself: 40 points 10 m apart, seen from on it, beside
    it and far away."""
    points = tuple((float(x), float(y)) for x, y in np.cumsum(10.0 * rng.normal(size=(40, 2)), axis=0))
    course = Course(points=points, closed=closed)
    (ax, ay), (bx, by) = course.line[:-1].T, course.line[1:].T
    crossed = 0
    for away in (0.0, 3.0, 300.0):
        for x, y in np.array(points) + away * rng.normal(size=(40, 2)):
            heading = float(rng.uniform(-np.pi, np.pi))
            c, s = math.cos(heading), math.sin(heading)
            a, b = c * (ax - x) + s * (ay - y), c * (bx - x) + s * (by - y)
            left = c * (ay - y) - s * (ax - x)
            k = np.flatnonzero((a <= 0.0) & (b > 0.0))
            if len(k):
                crossed += 1
                across = left[k] - a[k] * (c * (by - ay) - s * (bx - ax))[k] / (b - a)[k]
                expected = across[np.argmin(np.abs(across))]
                assert course.left_of(x, y, heading) == pytest.approx(expected, rel=1e-9, abs=1e-9)
            else:
                nearest = np.hypot(course.line[:, 0] - x, course.line[:, 1] - y).min()
                assert abs(course.left_of(x, y, heading)) == pytest.approx(nearest, rel=1e-12)
    assert crossed > 30


@pytest.mark.parametrize(
    ('points', 'closed', 'says'),
    [
        (((0.0, 0.0),), False, 'at least 2'),
        (((0.0, 0.0), (1.0, 0.0)), True, 'at least 3'),
        (((0.0, 0.0), (0.1, 0.0)), False, r'points\[1\]'),
    ],
)
def test_courses_that_cannot_be(points, closed, says) -> None:
    with pytest.raises(SpecError, match=says):
        Course(points=points, closed=closed)
