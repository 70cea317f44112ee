"""The automatic gearbox: shifts over speed and pedal with hysteresis, the clutch during a shift and at launch,
restoring, refusals."""

from __future__ import annotations

import numpy as np
import pytest

from solver.errors import SpecError
from solver.inputs.assistance import Assistance, Assistant, Feel
from solver.inputs.shifting import Shifting

NAMES = ('accelerator', 'clutch', 'gear')
H = 0.01
BOX = {
    'pedals': (0.0, 1.0),
    'up': ((5.0, 15.0), (10.0, 30.0)),
    'down': ((3.0, 9.0), (7.0, 20.0)),
    'duration': 0.4,
    'launch': 2.0,
    'bite': 0.25,
}


def assistant(**changed) -> Assistant:
    return Assistant(Assistance(shift=Shifting(**{**BOX, **changed})), NAMES, (), H)


def drive(box: Assistant, speeds, pedal: float = 0.5, lever: float = 1.0) -> np.ndarray:
    """(n, 3) accelerator, clutch, gear at these speeds."""
    return np.array([box.act(np.array([pedal, 0.0, lever]), Feel(float(v), 0.0, ())) for v in speeds])


def test_it_shifts_at_the_speeds_of_its_map_and_back_below() -> None:
    """At half pedal up at 10 and 20 m/s, down at 13.5 and 6: to and fro in steps so small that the threshold is met to
    10 mm/s."""
    box, there = assistant(), np.arange(4.0, 25.0, 0.01)
    gears = drive(box, there)[:, 2]
    back = drive(box, there[::-1])[:, 2]
    assert [there[np.argmax(gears == g)] for g in (2, 3)] == pytest.approx([10.0, 20.0], abs=0.02)
    assert [there[::-1][np.argmax(back == g)] for g in (2, 1)] == pytest.approx([13.5, 6.0], abs=0.02)
    assert (np.diff(gears) >= 0).all()
    assert (np.diff(back) <= 0).all()


def test_between_the_thresholds_it_does_not_hunt() -> None:
    box = assistant()
    gears = drive(box, 8.0 + 1.9 * np.sin(np.arange(0.0, 60.0, 0.05)))[:, 2]
    assert (gears == 1.0).all()
    drive(box, [10.5])
    assert (drive(box, 8.0 + 1.9 * np.sin(np.arange(0.0, 60.0, 0.05)))[:, 2] == 2.0).all()


def test_the_clutch_opens_for_half_a_shift_and_takes_the_accelerator_with_it() -> None:
    rows = drive(assistant(), [9.0] * 5 + [11.0] * 60)
    clutch = np.zeros(65)
    clutch[5:] = np.clip(2.0 - 2.0 * np.minimum(H * np.arange(60), 0.4) / 0.4, 0.0, 1.0)
    assert rows[:, 1] == pytest.approx(clutch, abs=1e-9)
    assert rows[:, 0] == pytest.approx(0.5 * (1.0 - clutch), abs=1e-9)


def test_at_launch_it_slips_and_waits_without_accelerator() -> None:
    speeds = [0.0, 1.0, 2.0, 4.0]
    assert drive(assistant(), speeds)[:, 1] == pytest.approx([0.75, 0.375, 0.0, 0.0])
    assert drive(assistant(), speeds, pedal=0.0)[:, 1] == pytest.approx([1.0, 1.0, 0.0, 0.0])
    assert drive(assistant(), [-1.0], lever=-1.0)[0, 1:] == pytest.approx([0.375, -1.0])


@pytest.mark.parametrize(
    ('speed', 'lever', 'gear'),
    [(0.0, 1.0, 1.0), (9.9, 1.0, 1.0), (10.1, 1.0, 2.0), (25.0, 1.0, 3.0), (-25.0, -1.0, -1.0), (25.0, 0.0, 0.0)],
)
def test_it_begins_in_the_gear_of_its_speed_and_does_not_shift_there(speed: float, lever: float, gear: float) -> None:
    """At half pedal it shifts up at 10 and 20 m/s."""
    box = assistant()
    commands = np.array([0.5, 0.0, lever])
    begins = box.start(commands, speed)
    assert begins[2] == gear
    assert np.array_equal(drive(box, [speed] * 3, lever=lever), [begins] * 3)
    assert np.array_equal(commands, [0.5, 0.0, lever])


@pytest.mark.parametrize(('speed', 'gear'), [(5.0, 1.0), (12.0, 2.0), (25.0, 3.0)])
def test_out_of_neutral_it_goes_into_the_gear_of_its_speed(speed: float, gear: float) -> None:
    """At half pedal, where it shifts up at 10 and 20 m/s: through the lower gears its clutch would turn the engine far
    too fast. Out of reverse it is in the first one."""
    box = assistant()
    drive(box, [speed] * 5, pedal=0.5, lever=0.0)
    assert drive(box, [speed] * 3, pedal=0.5)[:, 1:] == pytest.approx(np.array([[0.0, gear]] * 3))
    drive(box, [-1.0], lever=-1.0)
    assert drive(box, [speed])[0, 2] <= 2.0


def test_at_rest_it_begins_with_the_clutch_as_it_is_held_there() -> None:
    assert assistant().start(np.array([0.0, 0.0, 1.0]), 0.0)[1] == 1.0
    assert assistant().start(np.array([0.5, 0.0, 1.0]), 0.0)[1] == 0.75


def test_it_goes_on_from_where_it_was() -> None:
    box, other = assistant(), assistant()
    drive(box, [11.0] * 20)
    other.state = box.state
    assert np.array_equal(drive(other, [9.0] * 50), drive(box, [9.0] * 50))
    with pytest.raises(SpecError, match='the assistance has 2 states here, 4 are saved'):
        other.state = np.ones(4)


@pytest.mark.parametrize(
    ('changed', 'sentence'),
    [
        ({'down': ((3.0, 9.0),)}, 'shift: down = 1: must have one row for each of the 2 shifts'),
        ({'up': ((5.0,), (10.0, 30.0))}, r'shift: up\[0\] = 1: must have 2 speeds, one for each of `pedals`'),
        ({'down': ((3.0, 16.0), (7.0, 20.0))}, r'shift: down\[0\]\[1\] = 16.0: must be at least 0 and below up.*15'),
        ({'pedals': (1.0, 0.0)}, r'shift: pedals\[1\] = 0.0: must be greater'),
        (
            {'pedals': (0.0, 100.0)},
            r'shift: pedals\[1\] = 100.0: must be in \[0, 1\]: a position of the pedal, not per cent',
        ),
        ({'duration': 0.0}, 'shift: duration = 0.0'),
        ({'bite': 1.5}, 'shift: bite = 1.5'),
    ],
)
def test_refusals(changed, sentence) -> None:
    with pytest.raises(SpecError, match=sentence):
        assistant(**changed)


def test_a_car_without_an_engine_is_refused() -> None:
    with pytest.raises(
        SpecError,
        match='assistance: shift: the model has no input accelerator: give the engine of the vehicle a `power`',
    ):
        Assistant(Assistance(shift=Shifting(**BOX)), ('steering', 'drive_torque'), (), H)


def test_a_gearbox_that_was_shifted_by_hand_in_another_scene_begins_in_the_gear_that_is_in() -> None:
    """At 30 m/s the first gear would turn the engine far too fast. What an automatic gearbox of another scene was in is
    kept."""
    box, at = assistant(), {name: place for place, name in enumerate(NAMES)}
    row = np.zeros(len(NAMES))
    for gear, expected in ((2.0, 2.0), (0.0, 1.0), (-1.0, 1.0), (9.0, len(BOX['up']) + 1.0)):
        row[at['gear']] = gear
        box.begin(row, None)
        np.testing.assert_array_equal(box.state, [expected, BOX['duration']])
        box.begin(row, np.zeros(7))
        assert box.state[0] == expected
    box.begin(row, np.array([2.0, 0.1]))
    np.testing.assert_array_equal(box.state, [2.0, 0.1])
