"""Anti-lock and stability control: their laws, that they keep what they promise on a car, and that they are recorded
and replayed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from solver import simulation_of
from solver.elements.tire_pacejka import TIRE_COLUMNS, TIRE_UNITS
from solver.errors import SceneError, SpecError
from solver.files.scene import load_scene
from solver.inputs.assistance import AntiLock, Assistance, Assistant, AssistedWheel, Feel, StabilityControl
from solver.model.frames import matrix

WHEELS = tuple(
    AssistedWheel(f'{axle}_{side}', 0.25, 0.3, y, 1 + k, np.array((0.0, 1.0, 0.0)))
    for k, (axle, side, y) in enumerate(
        (axle, side, y) for axle in ('front', 'rear') for side, y in (('left', 0.75), ('right', -0.75))
    )
)
FNOMIN, PDX1, PDX2 = 4200.0, 1.12, -0.08  # of the light car's tires
FRICTION = np.array([1.0, 0.3, 1.0, 0.3])  # of the road under them
NAMES = ('steering', 'drive_torque', 'brake_torque', *(f'brake_torque_{wheel.name}' for wheel in WHEELS))


def commands(**values: float) -> np.ndarray:
    return np.array([values.get(name, 0.0) for name in NAMES])


def test_a_locked_wheel_is_released_at_the_rate_of_the_law_and_no_other() -> None:
    """One wheel stands, three roll: its share falls by release h a step, and after 1 / release seconds it has no
    torque."""
    assistant = Assistant(Assistance(anti_lock=AntiLock(release=20.0)), NAMES, WHEELS, 1e-3)
    feel = Feel(20.0, 0.0, (0.0, 20.0 / 0.3, 20.0 / 0.3, 20.0 / 0.3))
    for k in range(1, 51):
        row = assistant.act(commands(brake_torque=4000.0), feel)
        assert row[3] == pytest.approx(-1000.0 * 20.0 * k * 1e-3)
        assert not row[4:].any()
    assert assistant.state.tolist() == pytest.approx([0.0, 1.0, 1.0, 1.0])
    row = assistant.act(commands(brake_torque=4000.0), Feel(1.0, 0.0, (0.0,) * 4))  # slower than it acts
    assert row[3] == pytest.approx(-1000.0 * (1.0 - 4.0 * 1e-3))


def test_a_wheel_that_locks_in_reverse_is_released_as_one_that_locks_forward() -> None:
    """20 m/s backwards, 1 rad/s to the left: the left wheels' places move at -20.75 m/s. One wheel stands and loses
    release h a step; three roll with -v / R and lose nothing. At -1 m/s, slower than it acts, it gets its torque back
    with apply h."""
    assistant = Assistant(Assistance(anti_lock=AntiLock(release=20.0)), NAMES, WHEELS, 1e-3)
    feel = Feel(-20.0, 1.0, (0.0, *((-20.0 - wheel.left) / 0.3 for wheel in WHEELS[1:])))
    for k in range(1, 51):
        row = assistant.act(commands(brake_torque=4000.0), feel)
        assert row[3] == pytest.approx(-1000.0 * 20.0 * k * 1e-3)
        assert not row[4:].any()
    row = assistant.act(commands(brake_torque=4000.0), Feel(-1.0, 0.0, (0.0,) * 4))
    assert row[3] == pytest.approx(-1000.0 * (1.0 - 4.0 * 1e-3))


def test_stability_control_is_off_in_reverse() -> None:
    """The yaw rate is far off what it asks for, at any speed backwards: the inputs are those commanded."""
    assistant = Assistant(Assistance(stability=StabilityControl()), NAMES, WHEELS, 1e-3)
    given = commands(steering=0.9, drive_torque=-500.0, brake_torque=100.0)
    for v in (-1.0, -20.0):
        assert assistant.act(given, Feel(v, 0.9, (v / 0.3,) * 4)).tolist() == given.tolist()


def test_wheels_of_a_turning_car_have_speeds_of_their_own() -> None:
    """20 m/s, 1 rad/s to the left: the left wheels' places move at 19.25 m/s, the right ones' at 20.75; rolling so,
    none slips."""
    assistant = Assistant(Assistance(anti_lock=AntiLock()), NAMES, WHEELS, 1e-3)
    spins = tuple((20.0 - wheel.left) / 0.3 for wheel in WHEELS)
    for _ in range(100):
        row = assistant.act(commands(brake_torque=4000.0), Feel(20.0, 1.0, spins))
    assert not row[3:].any()


@pytest.mark.parametrize(
    ('steering', 'yaw_rate', 'wheel'),
    [
        (0.9, 0.9, 'front_right'),  # turns too much to the left: the outer front wheel
        (0.9, 0.0, 'rear_left'),  # too little: the inner rear one
        (-0.9, -0.9, 'front_left'),
        (-0.9, 0.0, 'rear_right'),
        (0.0, 0.3, 'front_right'),  # spins although nobody steers
    ],
)
def test_the_wheel_that_turns_the_car_back_is_braked(steering: float, yaw_rate: float, wheel: str) -> None:
    control = StabilityControl(gain=12000.0, threshold=0.04)
    assistant = Assistant(Assistance(stability=control), NAMES, WHEELS, 1e-3)
    v = 20.0
    wanted = v * steering / 15.0 / (2.7 + 0.003 * v * v)
    row = assistant.act(commands(steering=steering, drive_torque=500.0), Feel(v, yaw_rate, (v / 0.3,) * 4))
    torque = min(12000.0 * (abs(yaw_rate - wanted) - 0.04), 2500.0)
    assert {name: x for name, x in zip(NAMES, row, strict=True) if name.startswith('brake_torque_') and x} == {
        f'brake_torque_{wheel}': pytest.approx(torque)
    }
    assert row[1] == pytest.approx(500.0 * (1.0 - torque / 2500.0))
    assert not assistant.act(commands(steering=steering), Feel(v, wanted, (v / 0.3,) * 4))[3:].any()


def test_stability_control_takes_back_whatever_drives() -> None:
    """Half of the largest torque is wanted at a wheel: half of what drives is left. What brakes, and the clutch,
    stay."""
    control = StabilityControl(gain=12500.0, threshold=0.1, torque=2500.0)
    names = (*NAMES, 'accelerator', 'clutch', 'drive_torque_front_left', 'drive_torque_front_right')
    given = np.array([0.0, 500.0, *[0.0] * 5, 0.8, 0.4, 300.0, -100.0])
    row = Assistant(Assistance(stability=control), names, WHEELS, 1e-3).act(given, Feel(20.0, 0.2, (20.0 / 0.3,) * 4))
    assert row[names.index('brake_torque_front_right')] == pytest.approx(1250.0)
    assert row[1] == pytest.approx(250.0)
    assert row[7:].tolist() == pytest.approx([0.4, 0.4, 150.0, -100.0])


def test_what_it_needs_is_said() -> None:
    with pytest.raises(SceneError, match=r'actuation: \{wheels: true\}'):
        load_scene('light_car_brake', ['assistance={anti_lock: {}}'])
    with pytest.raises(SpecError, match='brake_torque_front_left'):
        Assistant(Assistance(anti_lock=AntiLock()), ('brake_torque',), WHEELS, 1e-3)


def test_rear_wheels_share_the_smaller_torque() -> None:
    """One rear wheel stands: both lose their torque; one front wheel stands: it alone does."""
    for standing, losing in ((0, {0}), (2, {2, 3}), (3, {2, 3})):
        assistant = Assistant(Assistance(anti_lock=AntiLock()), NAMES, WHEELS, 1e-3)
        spins = tuple(0.0 if k == standing else 20.0 / 0.3 for k in range(4))
        row = assistant.act(commands(brake_torque=4000.0), Feel(20.0, 0.0, spins))
        assert {k for k in range(4) if row[3 + k] < 0.0} == losing


@pytest.mark.parametrize('speed', [15.0, -15.0])
def test_the_compact_brakes_on_a_wet_road_without_locking_forward_and_in_reverse(speed: float) -> None:
    """12 kN m where 2 kN m lock all wheels: half a second after the pedal they turn, with a slip about the 0.1 that is
    kept."""
    scene = load_scene(
        'car_step_steer',
        [
            'vehicle=vehicles/compact_fwd.yaml',
            'road.friction=0.4',
            f'start.speed={speed}',
            'maneuver={brake_torque: {kind: step, value: 12000, start: 0.1}}',
            'actuation.wheels=true',
            'assistance={anti_lock: {}}',
        ],
    )
    simulation = simulation_of(scene)
    simulation.advance(600)
    slips = []
    for _ in range(30):
        simulation.advance(20)
        slips.append(simulation.snapshot().tire[:, TIRE_COLUMNS.index('kappa')])
    assert np.mean(slips, axis=0) == pytest.approx(np.full(4, -0.1 if speed > 0.0 else 0.1), abs=0.025)  # of the tires


class _Stop(NamedTuple):
    """A stop: way [m], largest departure of the heading [rad], share of the time that wheels stand, and means over the
    time that the control is at work: braking force, load of all wheels, and the braking force that there is, at the
    rear axle of both wheels that of the lower side, as they are held together [N]."""

    way: float
    heading: float
    standing: float
    force: float
    load: float
    there: float


def _stop(changes: list[str]) -> _Stop:
    """Full braking of the light car from 80 km/h, where the right wheels have 0.3 of the friction, with a driver who
    keeps the lane."""
    brake = '{kind: step, value: 7000, start: 1.6, rise: 0.1}'
    driver = '{path: {kind: waypoints, points: [[0, 0], [500, 0]]}, wheelbase: 2.65, ratio: 17.9, preview: 0.3}'
    common = ['road=roads/mu_split.yaml', 'start.speed_kmh=80', f'maneuver={{brake_torque: {brake}, driver: {driver}}}']
    simulation = simulation_of(load_scene('light_car_brake', [*common, 'actuation={wheels: true}', *changes]))
    chassis, channels = simulation.channels.chassis or 0, simulation.channels
    spins = [channels.joints.index(f'wheel_{wheel}') for wheel in channels.wheels]
    column = list(TIRE_UNITS).index
    way = heading = 0.0
    standing: list[float] = []
    at_work: list[tuple[float, float, float]] = []
    for n in range(160, 760):
        shot = simulation.advance(1600 if n == 160 else 10)
        speed = float(np.hypot(*shot.twist[chassis, :2]))
        way += 0.01 * speed
        heading = max(heading, abs(float(2.0 * np.arctan2(shot.pose[chassis, 5], shot.pose[chassis, 6]))))
        standing.append(float((shot.joint_velocity[spins] * 0.3 < 0.1 * speed).mean()))
        if n > 190 and speed > 15.0 / 3.6:
            load = shot.tire[:, column('fz')]
            there = FRICTION * (PDX1 + PDX2 * (load / FNOMIN - 1.0)) * load
            there[2:] = there[2:].min()
            at_work.append((-float(shot.tire[:, column('fx')].sum()), float(load.sum()), float(there.sum())))
        if speed < 0.5:
            break
    return _Stop(way, heading, float(np.mean(standing)), *np.mean(at_work, axis=0).tolist())


@pytest.mark.slow
def test_the_light_car_stops_earlier_and_straight_on_split_friction() -> None:
    """Without anti-lock control every wheel stands and the car spins; with it wheels turn, the heading stays within 10
    deg, the car stops earlier, and as UN Regulation No. 13-H, annex 6, wants it: on split friction the rate of braking
    is at least 0.75 (4 kL + kH) / 5, and kL, and of the adhesion that there is at least 0.75 is used."""
    without, held = _stop([]), _stop(['assistance={anti_lock: {}}'])
    assert without.standing > 0.8
    assert held.standing < 0.1
    assert without.heading > 1.0
    assert held.heading < np.radians(10.0)
    assert held.way < without.way
    high = PDX1 + PDX2 * (held.load / 4.0 / FNOMIN - 1.0)
    low = 0.3 * high
    rate = held.force / held.load
    assert rate > max(0.75 * (4.0 * low + high) / 5.0, low)
    assert held.force > 0.75 * held.there


def test_runs_with_assistance_go_on_from_a_saved_state_bit_for_bit() -> None:
    """Also its own state is saved: a run that is restored in the middle of a braking ends with the same bits."""
    changes = [
        'road.friction=0.3',
        'start.speed_kmh=60',
        'maneuver={brake_torque: 5000}',
        'actuation={wheels: true}',
        'assistance={anti_lock: {}}',
    ]
    whole = simulation_of(load_scene('light_car_brake', changes))
    whole.advance(200)
    saved = whole.save()
    end = whole.advance(200)
    assert end.inputs[whole.channels.inputs.index('brake_torque_front_left')] < 0.0
    other = simulation_of(load_scene('light_car_brake', changes))
    other.restore(saved)
    assert np.array_equal(other.advance(200).pose, end.pose)


@pytest.mark.slow
def test_a_turning_car_feels_how_fast_each_wheel_goes() -> None:
    """Speed less yaw rate times the distance to the left is the forward speed of each wheel's own body, within the
    motion of its suspension; freely rolling wheels spin with it over their radius, within the slip of a tire."""
    changes = [
        'actuation={wheels: true}',
        'assistance={anti_lock: {}}',
        'start.speed_kmh=40',
        'maneuver={steering: 1.5}',
    ]
    simulation = simulation_of(load_scene('light_car_step_steer', changes))
    shot = simulation.advance(1500)
    feel, channels = simulation.feel(), simulation.channels
    ahead = matrix(tuple(shot.pose[channels.chassis or 0, 3:]))[:, 0]
    assert feel.yaw_rate == pytest.approx(shot.twist[channels.chassis or 0, 5], abs=1e-4) and feel.yaw_rate > 0.2
    assert np.hypot(*shot.twist[channels.chassis or 0, :2]) == pytest.approx(feel.speed, abs=0.2)
    seen = {}
    for wheel, spin in zip(simulation.sources.wheels, feel.spins, strict=True):
        own = float(ahead @ matrix(tuple(shot.pose[wheel.body, 3:])) @ shot.twist[wheel.body, :3])
        assert feel.speed - feel.yaw_rate * wheel.left == pytest.approx(own, abs=0.05)
        assert spin * wheel.radius == pytest.approx(own, rel=0.03)
        seen[wheel.name] = own
    assert seen['front_left'] + 0.2 < seen['front_right'] and seen['rear_left'] + 0.2 < seen['rear_right']
