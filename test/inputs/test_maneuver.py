"""Signals are what they claim: exact derivatives, continuity, known values; sources are pure functions of the step."""

from __future__ import annotations

import numpy as np
import pytest

from solver.errors import SceneError, SpecError
from solver.files.scene import load_scene
from solver.inputs.command_filter import CommandSource
from solver.inputs.maneuver import Maneuver, ManeuverSource, ReplaySource
from solver.inputs.recorded import Reach, Recorded, RecordedSource, Track
from solver.inputs.signals import Constant, Ramp, Signal, Sine, SineWithDwell, Step, Sum, Sweep, Table

SMOOTH: list[Signal] = [
    Constant(value=2.0),
    Ramp(slope=-3.0, start=0.5, initial=1.0),
    Ramp(slope=2.0, start=0.5, final=4.0, blend=0.3),
    Step(value=1.5, initial=-0.5, start=0.7, rise=0.4),
    Sine(amplitude=2.0, frequency=0.7, phase=0.4, offset=-1.0, start=0.3, cycles=2.0),
    Sine(amplitude=2.0, frequency=0.7),
    SineWithDwell(amplitude=1.5, start=0.4),
    Sweep(amplitude=0.5, final_amplitude=2.0, frequency=0.5, final_frequency=2.0, duration=2.0, repeats=2, start=0.5),
    Sum(terms=(1.0, Step(value=1.0), Sine(amplitude=1.0, frequency=1.0))),
]
IDS = [f'{type(s).__name__}{k}' for k, s in enumerate(SMOOTH)]
MOTION = ('steering', 'steering_rate', 'steering_acceleration', 'drive_torque', 'brake_torque')


@pytest.mark.parametrize(
    'signal', [*SMOOTH, Table(points=((0.5, 0.0), (1.5, 2.0), (2.2, -1.0), (4.0, 0.5)))], ids=[*IDS, 'Table']
)
def test_rate_and_acceleration_are_derivatives_of_the_value(signal: Signal, rng: np.random.Generator) -> None:
    t, h = rng.uniform(0.01, 6.0, 200), 1e-4
    jet, ahead, behind = signal.jet(t), signal.jet(t + h), signal.jet(t - h)
    # central differences: h^2/6 times the third derivative, which is below 1e4 here, or a jump of the third derivative
    # times h
    np.testing.assert_allclose((ahead.value - behind.value) / (2 * h), jet.rate, atol=1e-4)
    np.testing.assert_allclose((ahead.rate - behind.rate) / (2 * h), jet.acceleration, atol=5e-2)


@pytest.mark.parametrize('signal', SMOOTH, ids=IDS)
def test_signals_are_twice_continuously_differentiable(signal: Signal) -> None:
    """A jump does not shrink with the sampling interval, a continuous function's increment does."""
    coarse, fine = (
        max(np.max(np.abs(np.diff(part))) for part in signal.jet(np.linspace(0.0, 6.0, n))) for n in (6001, 60001)
    )
    assert fine <= 0.15 * coarse + 1e-12


def test_step_has_the_stated_ends_and_midpoint() -> None:
    s = Step(value=3.0, initial=1.0, start=2.0, rise=0.5)
    np.testing.assert_allclose(s.jet(np.array([0.0, 2.0, 2.25, 2.5, 9.0])).value, [1.0, 1.0, 2.0, 3.0, 3.0], rtol=1e-15)


def test_ramp_follows_its_slope_between_rounded_corners() -> None:
    s = Ramp(slope=2.0, start=1.0, initial=-1.0, final=5.0, blend=0.2)
    np.testing.assert_allclose(s.jet(np.array([0.0, 2.0, 3.5, 9.0])).value, [-1.0, 1.0, 4.0, 5.0], rtol=1e-14)


def test_sine_is_a_sine_away_from_its_ends() -> None:
    s = Sine(amplitude=2.0, frequency=0.5, start=1.0, cycles=3.0, blend=0.1)
    t = np.linspace(1.1, 6.9, 50)
    np.testing.assert_allclose(s.jet(t).value, 2.0 * np.sin(np.pi * (t - 1.0)), atol=1e-14)
    np.testing.assert_allclose(s.jet(np.array([0.0, 7.1, 20.0])).value, 0.0, atol=1e-14)


def test_sine_with_dwell_stands_still_at_its_second_peak() -> None:
    s = SineWithDwell(amplitude=1.5, frequency=0.7, dwell=0.5, start=1.0, blend=0.1)
    peak = 1.0 + 0.75 / 0.7
    assert s.jet(np.array([1.0 + 0.25 / 0.7])).value[0] == pytest.approx(1.5, rel=1e-14)
    dwell = s.jet(np.linspace(peak + 0.05, peak + 0.45, 20))
    np.testing.assert_allclose(dwell.value, -1.5, rtol=1e-14)
    np.testing.assert_allclose(dwell.rate, 0.0, atol=1e-14)
    np.testing.assert_allclose(s.jet(np.array([0.9, peak + 0.5 + 0.25 / 0.7 + 0.05, 9.0])).value, 0.0, atol=1e-14)


def test_sweep_repeats_and_grows() -> None:
    s = Sweep(
        amplitude=1.0, final_amplitude=3.0, frequency=0.5, final_frequency=2.0, duration=4.0, repeats=2, start=1.0
    )
    t = np.linspace(1.0 + 1.0, 1.0 + 3.0, 400)  # inside the fades of the first sweep
    phase = 2.0 * np.pi * (0.5 * (t - 1.0) + 1.5 / 8.0 * (t - 1.0) ** 2)
    np.testing.assert_allclose(s.jet(t).value, (1.0 + 0.25 * (t - 1.0)) * np.sin(phase), atol=1e-12)
    grown = (1.0 + 0.25 * (t + 3.0)) / (1.0 + 0.25 * (t - 1.0))
    np.testing.assert_allclose(s.jet(t + 4.0).value, grown * s.jet(t).value, atol=1e-12)
    np.testing.assert_allclose(s.jet(np.array([0.5, 1.0, 5.0, 9.0, 12.0])).value, 0.0, atol=1e-12)


def test_table_passes_through_its_points_and_holds_the_ends() -> None:
    points = ((0.5, 0.0), (1.5, 2.0), (2.2, -1.0), (4.0, 0.5))
    t = np.array([0.0, *(p[0] for p in points), 9.0])
    for interpolation in ('cubic', 'linear'):
        values = Table(points=points, interpolation=interpolation).jet(t).value  # type: ignore[arg-type]
        np.testing.assert_allclose(values, [0.0, 0.0, 2.0, -1.0, 0.5, 0.5], atol=1e-14)
    linear = Table(points=points, interpolation='linear').jet(np.array([1.0, 3.1]))
    np.testing.assert_allclose([linear.value, linear.rate], [[1.0, -0.25], [2.0, 1.5 / 1.8]], rtol=1e-14)


@pytest.mark.parametrize(
    ('make', 'says'),
    [
        (lambda: Step(value=1.0, rise=0.0), 'rise = 0: must be > 0'),
        (lambda: Ramp(slope=1.0, final=-1.0), 'never reached'),
        (lambda: Ramp(slope=10.0, final=0.1), 'blend = 0.1'),
        (lambda: Sine(amplitude=1.0, frequency=0.0), 'frequency'),
        (lambda: SineWithDwell(amplitude=1.0, dwell=0.05), 'blend'),
        (lambda: Sweep(amplitude=1.0, frequency=1.0, duration=1.0, fade=0.6), 'fade'),
        (lambda: Table(points=((0.0, 1.0),)), 'at least two'),
        (lambda: Table(points=((0.0, 1.0), (0.0, 2.0))), r'points\[1\]\[0\]'),
    ],
)
def test_impossible_signals_are_refused(make, says: str) -> None:
    with pytest.raises(SpecError, match=says):
        make()


def maneuver() -> Maneuver:
    return Maneuver(
        steering=Sine(amplitude=0.5, frequency=0.8, start=0.1),
        drive_torque=Step(value=300.0, start=0.05, rise=0.1),
        brake_torque=0.0,
    )


def test_forces_are_sampled_at_the_stage_and_motions_at_the_end_of_the_step() -> None:
    source = ManeuverSource(maneuver(), MOTION, 2_000_000, 0.6)
    k = 61
    stage, end = np.array([(k + 0.6) * 2e-3]), np.array([(k + 1) * 2e-3])
    steering, drive = (
        Sine(amplitude=0.5, frequency=0.8, start=0.1).jet(end),
        Step(value=300.0, start=0.05, rise=0.1).jet(stage),
    )
    expected = [steering.value[0], steering.rate[0], steering.acceleration[0], drive.value[0], 0.0]
    np.testing.assert_allclose(source.sample(k), expected, rtol=1e-12, atol=1e-12)


def test_inputs_of_a_step_are_the_same_bits_however_they_are_asked_for() -> None:
    source = ManeuverSource(maneuver(), MOTION, 1_000_000, 0.5556)
    whole = source.table(0, 1000)
    single = np.array([source.sample(k) for k in range(1000)])
    parts = np.concatenate([source.table(k, 7) for k in range(0, 994, 7)])
    assert whole.tobytes() == single.tobytes()
    assert whole[:994].tobytes() == parts.tobytes()
    for k in (990, 3, 250, 249, 251, 0):
        assert source.sample(k).tobytes() == whole[k].tobytes()


def test_inputs_handed_out_may_be_changed() -> None:
    source = ManeuverSource(maneuver(), MOTION, 1_000_000, 0.5556)
    first = source.table(100, 3)
    kept = first.tobytes()
    first[:] = 7.0
    assert source.table(100, 3).tobytes() == kept


def test_channel_the_model_does_not_have_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(SpecError, match=r"no input 'moter'.*did you mean 'motor'"):
        ManeuverSource(Maneuver(signals={'moter': 1.0}), ('motor',), 1_000_000)


def test_commands_are_the_signals_themselves() -> None:
    steering, drive, brake = maneuver().commands(1.0)
    assert (steering, drive, brake) == pytest.approx((0.5 * np.sin(2 * np.pi * 0.8 * 0.9), 300.0, 0.0), rel=1e-13)


def advance(source: CommandSource, command: float, steps: int) -> np.ndarray:
    return np.array([source.advance(command, 10.0, 0.0) for _ in range(steps)])


def test_steering_filter_is_the_critically_damped_step_response() -> None:
    """Without rate limit: x = 1 - (1 + w t) exp(-w t); closed form, so rounding errors only."""
    source = CommandSource(MOTION, 1_000_000, bandwidth=5.0, rate_limit=1e9)
    u = advance(source, 1.0, 400)
    t, w = np.arange(1, 401) * 1e-3, 10.0 * np.pi
    # 1e-9 s of rate limit at 1 rad
    np.testing.assert_allclose(u[:, 0], 1.0 - (1.0 + w * t) * np.exp(-w * t), atol=2e-7)
    np.testing.assert_allclose(u[:, 1], w * w * t * np.exp(-w * t), atol=2e-6)
    np.testing.assert_allclose(u[:, 3], 10.0)


def test_inputs_that_nobody_commands_are_held() -> None:
    source = CommandSource((*MOTION, 'motor', 'pump'), 1_000_000, others={'motor': 0.7})
    np.testing.assert_array_equal(advance(source, 0.0, 3), [[0.0, 0.0, 0.0, 10.0, 0.0, 0.7, 0.0]] * 3)


def test_steering_filter_does_not_depend_on_the_step() -> None:
    fine = advance(CommandSource(MOTION, 500_000, rate_limit=3.0), 0.7, 1000)
    coarse = advance(CommandSource(MOTION, 2_000_000, rate_limit=3.0), 0.7, 250)
    np.testing.assert_allclose(fine[3::4, :3], coarse[:, :3], rtol=1e-10, atol=1e-10)


def test_steering_rate_never_exceeds_its_limit_and_arrives() -> None:
    source = CommandSource(MOTION, 1_000_000, bandwidth=8.0, rate_limit=2.0)
    u = np.concatenate([advance(source, c, 800) for c in (1.2, -0.9, 0.3)])
    assert np.max(np.abs(u[:, 1])) <= 2.0 * (1.0 + 1e-12)
    assert np.max(np.abs(u[:, 1])) > 1.99
    assert u[-1, 0] == pytest.approx(0.3, abs=1e-6)


def test_angle_rate_and_acceleration_of_the_steering_filter_belong_together() -> None:
    h = 1e-4
    source = CommandSource(MOTION, 100_000, rate_limit=5.0)
    u = np.concatenate([advance(source, c, 2000) for c in (0.5, -0.2)])
    # trapezoidal rule: h^2/12 times the variation of the integrand's slope; w = 31 1/s
    np.testing.assert_allclose(np.diff(u[:, 0]), 0.5 * h * (u[1:, 1] + u[:-1, 1]), atol=1e-9)
    np.testing.assert_allclose(np.diff(u[:, 1]), 0.5 * h * (u[1:, 2] + u[:-1, 2]), atol=5e-6)


def test_restored_command_source_continues_with_the_same_bits() -> None:
    source = CommandSource(MOTION, 1_000_000)
    advance(source, 0.8, 50)
    saved = source.state.copy()
    expected = advance(source, -0.3, 50)
    again = CommandSource(MOTION, 1_000_000)
    again.state = saved
    assert advance(again, -0.3, 50).tobytes() == expected.tobytes()


def test_replayed_inputs_are_the_recorded_bits(rng: np.random.Generator) -> None:
    values = rng.standard_normal((20, 2))
    source = ReplaySource(('b', 'a'), {'a': values[:, 0], 'b': values[:, 1]}, np.arange(5, 25))
    assert source.table(5, 20).tobytes() == np.ascontiguousarray(values[:, ::-1]).tobytes()
    assert source.sample(11).tobytes() == np.ascontiguousarray(values[6, ::-1]).tobytes()


@pytest.mark.parametrize(('k0', 'n'), [(4, 1), (24, 2), (30, 1)])
def test_replay_outside_the_recording_is_refused(k0: int, n: int) -> None:
    source = ReplaySource(('a',), {'a': np.zeros(20)}, np.arange(5, 25))
    with pytest.raises(SpecError, match='not in the recording'):
        source.table(k0, n)


def test_replay_of_a_recording_with_holes_is_refused() -> None:
    with pytest.raises(SpecError, match='not consecutive after step 2'):
        ReplaySource(('a',), {'a': np.zeros(4)}, np.array([1, 2, 4, 5]))
    with pytest.raises(SpecError, match="no input 'a'"):
        ReplaySource(('a',), {'b': np.zeros(4)}, np.arange(4))


def recorded(h_ns: int = 2_000_000, steps: int = 50) -> Recorded:
    """A motion x = 1 + t^2 + t^5 and a force that grows with every step."""
    t = (1 + np.arange(steps)) * h_ns * 1e-9
    rows = {
        'x': 1.0 + t**2 + t**5,
        'x_rate': 2.0 * t + 5.0 * t**4,
        'x_acceleration': 2.0 + 20.0 * t**3,
        'force': np.arange(steps, dtype=float),
    }
    return Recorded(
        'bag b', h_ns, 7, rows, {'x': 1.0, 'x_rate': 0.0, 'x_acceleration': 2.0, 'force': 0.0}, {}, len(rows['x'])
    )


NAMES = ('force', 'x', 'x_rate', 'x_acceleration')


def test_recorded_inputs_with_the_same_step_are_the_same_bits():
    given = recorded()
    source = RecordedSource(given, NAMES, given.h_ns)
    assert source.steps == 50
    table = source.table(3, 10)
    for column, name in enumerate(NAMES):
        np.testing.assert_array_equal(table[:, column], given.rows[name][3:13])
    np.testing.assert_array_equal(source.start, [0.0, 1.0, 0.0, 2.0])


@pytest.mark.parametrize('h_ns', [500_000, 3_000_000, 7_000_000])
def test_recorded_motions_pass_through_quintics_and_forces_keep_their_impulse(h_ns):
    """A polynomial of degree five is its own quintic; the sum of force times step is that of the recorded one up to any
    common instant."""
    given = recorded()
    source = RecordedSource(given, NAMES, h_ns)
    n = source.steps
    assert n == 100_000_000 // h_ns
    table = source.table(0, n)
    t = (1 + np.arange(n)) * h_ns * 1e-9
    np.testing.assert_allclose(table[:, 1], 1.0 + t**2 + t**5, rtol=1e-14)
    np.testing.assert_allclose(table[:, 2], 2.0 * t + 5.0 * t**4, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(table[:, 3], 2.0 + 20.0 * t**3, rtol=0.0, atol=1e-8)  # eps / h^2
    common = np.lcm(h_ns, given.h_ns)
    ours, theirs = np.cumsum(table[:, 0]) * h_ns, np.cumsum(given.rows['force']) * given.h_ns
    for end in range(common, n * h_ns + 1, common):
        assert ours[end // h_ns - 1] == pytest.approx(theirs[end // given.h_ns - 1], rel=1e-13)
    np.testing.assert_array_equal(source.table(2, 5), table[2:7])


def test_recorded_inputs_that_cannot_be_used_are_refused():
    given = recorded()
    with pytest.raises(SpecError, match="bag b: the model has no input 'force'; allowed: x"):
        RecordedSource(given, NAMES[1:], given.h_ns)
    with pytest.raises(SpecError, match=r'beyond its end at 0\.1 s'):
        RecordedSource(given, NAMES, given.h_ns).table(45, 6)
    del given.rows['x_rate']
    with pytest.raises(SpecError, match='the recording has no rates of it'):
        RecordedSource(given, NAMES, given.h_ns)


def test_samples_of_others_become_motions_and_forces():
    t_ns = 5_000_000_000 + 10_000_000 * np.arange(11)
    track = Track(t_ns, np.linspace(0.0, 2.0, 11))
    given = Recorded('bag b', 0, 0, {}, {}, {'x': track, 'force': track})
    source = RecordedSource(given, NAMES, 1_000_000, stage=0.5)
    assert source.steps == 100
    table = source.table(0, 100)
    np.testing.assert_allclose(table[:, 0], 20.0 * (np.arange(100) + 0.5) * 1e-3, rtol=1e-12)
    np.testing.assert_allclose(table[9::10, 1], np.linspace(0.2, 2.0, 10), rtol=1e-12)
    x, v, a = table[:-1, 1:].T  # at the end it is held, without acceleration
    h = 1e-3  # the rule below is exact for the cubic between two samples: rates and accelerations belong to the values
    np.testing.assert_allclose(
        np.diff(x), h / 2.0 * (v[1:] + v[:-1]) - h * h / 12.0 * (a[1:] - a[:-1]), rtol=0.0, atol=1e-14
    )


def test_samples_of_others_that_would_be_misread_are_refused():
    seconds = 1_000_000_000 * np.arange(4)
    track, late = Track(seconds, np.arange(4.0)), Track(1_700_000_000_000_000_000 + seconds, np.arange(4.0))
    with pytest.raises(
        SpecError, match=r'map: force begins at 1\.7e\+09 s, behind the end of x at 3 s: .* different clocks'
    ):
        RecordedSource(Recorded('bag b', 0, 0, {}, {}, {'x': track, 'force': late}), NAMES, 1_000_000)
    for name in ('x_rate', 'x_acceleration'):
        with pytest.raises(
            SpecError, match=f"bag b: map: {name}: follows from the motion 'x', which can be mapped; remove this one"
        ):
            RecordedSource(Recorded('bag b', 0, 0, {}, {}, {'x': track, name: track}), NAMES, 1_000_000)


def test_a_recorded_pedal_in_per_cent_is_refused_and_one_that_was_applied_is_not():
    reaches = {'force': Reach(-0.1, 1.1, 'must be a position of the pedal, 0 to 1, not per cent')}
    t_ns, values = 1_000_000_000 * np.arange(3), np.array([0.0, 35.0, 20.0])
    theirs = RecordedSource(Recorded('bag b', 0, 0, {}, {}, {'force': Track(t_ns, values)}), NAMES, 1_000_000)
    with pytest.raises(
        SpecError, match=r'bag b: map: force = 35: must be a position of the pedal, .* give it another scale'
    ):
        theirs.require_within(reaches)
    RecordedSource(
        Recorded('bag b', 0, 0, {}, {}, {'force': Track(t_ns, values / 100.0)}), NAMES, 1_000_000
    ).require_within(reaches)
    ours = Recorded('bag b', 1_000_000, 0, {'force': values}, {}, {}, steps=3)
    RecordedSource(ours, NAMES, 1_000_000).require_within(reaches)


def test_brakes_with_the_wrong_sign_are_refused_and_those_that_release_are_not():
    t_ns = 1_000_000_000 * np.arange(3)
    for values, good in (((0.0, -5.0, 0.0), False), ((-1.0, 5.0, 0.0), True), ((0.0, 0.0, 0.0), True)):
        given = Recorded('bag b', 0, 0, {}, {}, {'brake_torque': Track(t_ns, np.array(values))})
        points = [[t, value] for t, value in enumerate(values)]
        scene = [f'maneuver={{brake_torque: {{kind: table, points: {points}}}}}']
        if good:
            RecordedSource(given, MOTION, 1_000_000)
            load_scene('light_car_straight', scene)
            continue
        with pytest.raises(SpecError, match=r'bag b: map: brake_torque: nothing is braked, .* give it a scale below 0'):
            RecordedSource(given, MOTION, 1_000_000)
        with pytest.raises(
            SceneError, match=r'maneuver.brake_torque = -5\.0: nothing is braked, for it is nowhere above 0'
        ):
            load_scene('light_car_straight', scene)
        # it may take from the torques of single wheels
        load_scene('light_car_straight', [*scene, 'actuation={wheels: true}'])


@pytest.mark.parametrize(('largest', 'good'), [(1.0, True), (1.09, True), (1.2, False)])
def test_a_map_is_not_followed_far_beyond_its_points(largest, good):
    """From -1 to 1, which is 2 wide: 0.1 beyond is as far as it may be followed."""
    step = f'{{kind: step, value: {largest}, start: 0.1}}'
    mapped = f'{{kind: mapped, of: {step}, points: [[-1, 2], [0, 0], [1, -2]]}}'
    for one in (
        mapped,
        f'{{kind: sum, terms: [0.1, {mapped}]}}',
        f'{{kind: mapped, of: {mapped}, points: [[-3, 0], [3, 1]]}}',
    ):
        if good:
            load_scene('light_car_straight', [f'maneuver={{steering: {one}}}'])
            continue
        with pytest.raises(
            SceneError,
            match=r"'steering': a map is asked 0\.2 beyond its points, -1 to 1, where the polynomial means nothing",
        ):
            load_scene('light_car_straight', [f'maneuver={{steering: {one}}}'])


@pytest.mark.parametrize('at', [-10, 1, 100])
def test_a_single_sample_holds_all_the_time_and_its_instant_counts_for_nothing(at):
    seconds = 5_000_000_000 + 1_000_000_000 * np.arange(3)
    tracks = {
        'x': Track(seconds, np.array([0.0, 1.0, 2.0])),
        'force': Track(seconds[:1] + at * 1_000_000_000, np.array([7.0])),
    }
    source = RecordedSource(Recorded('bag b', 0, 0, {}, {}, tracks), NAMES, 500_000_000)
    assert source.steps == 4
    np.testing.assert_array_equal(source.table(0, 4)[:, 0], 7.0)
    np.testing.assert_allclose(source.table(0, 4)[1::2, 1], [1.0, 2.0], rtol=1e-12)
