"""Where a steering ends: by its file, or at a distance from the dead centre of its tie rods; and what is held there."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.optimize import brentq

from solver import load_scene, simulation_of
from solver.analysis.verdict import findings
from solver.checks.vehicle import STEERING_END
from solver.errors import SceneError
from solver.inputs.end_stops import GIVE, hold
from solver.inputs.recorded import ACCELERATION, RATE
from solver.model.spec import ModelSpec
from solver.vehicle.end_stops import LOCK_ROUNDED_TO, MARGIN, Linkage, lock_of

NAMES = ('steering', 'steering' + RATE, 'steering' + ACCELERATION, 'drive_torque')
RACK = 0.05  # m per turn
FAR = '{steering: {kind: ramp, slope: 4.0, start: 0.2, final: %s}}'


def vehicle(name: str, *settings: str) -> ModelSpec:
    return load_scene('light_car_straight', [f'vehicle=vehicles/{name}.yaml', 'maneuver={}', *settings]).model


@pytest.mark.parametrize(
    ('arm', 'rod', 'offset'), [(-0.13, 0.30, 0.0), (-0.13, 0.30, -0.02), (0.12, 0.25, 0.01), (-0.02, 0.05, 0.0)]
)
def test_a_plane_linkage_ends_where_rod_and_arm_keep_the_angle(arm: float, rod: float, offset: float) -> None:
    """A vertical axis, an arm along x, a rod to a ball that moves along y: the angle of transmission is found from the
    triangle, by bisection over the angle of the arm, in both directions; the nearer end counts."""
    inner = np.array([arm + offset, -math.sqrt(rod * rod - offset * offset), 0.2])
    linkage = Linkage((0.0, 0.0, 0.1), (0.0, 0.0, 0.6), tuple(inner), (arm, 0.0, 0.2))  # type: ignore[arg-type]

    def state(turn: float) -> tuple[float, float]:
        """(way of the inner ball along y, sine of the least angle of transmission)."""
        x, y = arm * math.cos(turn), arm * math.sin(turn)
        along = x - inner[0]
        across = math.sqrt(rod * rod - along * along)
        # velocity (-y, x) of the outer ball, rod (along, across)
        at_arm = abs(-y * along + x * across) / (abs(arm) * rod)
        return y - across - inner[1], min(at_arm, across / rod)

    ends = []
    for way in (1.0, -1.0):
        turns = way * np.linspace(0.0, math.pi, 2000)
        low = next(
            i
            for i, turn in enumerate(turns)
            if abs(arm * math.cos(turn) - inner[0]) >= rod or state(turn)[1] < math.sin(MARGIN)
        )
        end = brentq(lambda turn: state(turn)[1] - math.sin(MARGIN), turns[low - 1], turns[low], xtol=1e-13)
        ends.append(abs(state(end)[0]) * 2.0 * math.pi / RACK)
    found = lock_of([linkage], lambda angle: np.array([0.0, angle * RACK / (2.0 * math.pi), 0.0]))
    assert found is not None
    assert min(ends) - LOCK_ROUNDED_TO - 1e-9 <= found <= min(ends) + 1e-9
    assert lock_of([linkage.mirrored()], lambda angle: np.array([0.0, angle * RACK / (2.0 * math.pi), 0.0])) == found


def test_a_linkage_without_dead_centre_has_no_end() -> None:
    assert lock_of([], lambda angle: np.zeros(3)) is None
    linkage = Linkage((0.0, 0.0, 0.1), (0.0, 0.0, 0.6), (-0.13, -0.3, 0.2), (-0.13, 0.0, 0.2))
    assert lock_of([linkage], lambda angle: np.array([0.0, 1e-5 * angle, 0.0])) is None


@pytest.mark.parametrize(
    'name', ['light_car', 'full_car', 'compact_fwd', 'electric_4wd', 'formula_student', 'pickup_awd', 'wishbone_car']
)
def test_delivered_cars_end_between_half_a_turn_and_three(name: str) -> None:
    model = vehicle(name)
    assert model.lock is not None
    assert math.pi < model.lock < 6.0 * math.pi


def test_a_file_may_say_where_its_steering_ends() -> None:
    assert vehicle('light_car', 'vehicle.steering.lock=7.5').lock == 7.5
    assert vehicle('full_car', 'vehicle.steering.lock_deg=450').lock == pytest.approx(math.radians(450.0))
    for name in ('light_car', 'full_car'):
        with pytest.raises(SceneError, match=r'lock = -1\.0: must be > 0'):
            vehicle(name, 'vehicle.steering.lock=-1')


def test_what_is_held_is_a_motion_and_what_does_not_reach_the_stops_keeps_its_bits() -> None:
    """The rate is the derivative of the angle, the acceleration that of the rate, through the stop; central differences
    of 1e-4 s."""
    h, lock = 1e-4, 5.0
    t = np.arange(0.0, 6.0, h)
    u = np.column_stack([7.0 * np.sin(t), 7.0 * np.cos(t), -7.0 * np.sin(t), t])
    asked = u.copy()
    hold(u, NAMES, lock)
    inside = np.abs(asked[:, 0]) <= lock
    np.testing.assert_array_equal(u[inside], asked[inside])
    assert np.abs(u[:, 0]).max() == pytest.approx((1.0 + GIVE) * lock, rel=1e-12)
    np.testing.assert_allclose((u[2:, 0] - u[:-2, 0]) / (2.0 * h), u[1:-1, 1], atol=1e-3)
    np.testing.assert_allclose((u[2:, 1] - u[:-2, 1]) / (2.0 * h), u[1:-1, 2], atol=2.0)  # of 500 rad/s^2
    for other in (('motor',), ('steering',)):
        v = np.full((3, 1), 9.0)
        hold(v, other, lock)
        assert (v == (9.0 if other == ('motor',) else (1.0 + GIVE) * lock)).all()
    hold(asked, NAMES, None)
    assert asked[:, 0].max() > 6.9


@pytest.mark.parametrize('fidelity', ['full', 'kc', pytest.param('single_track', marks=pytest.mark.slow)])
@pytest.mark.parametrize('closed', ['', 'speed: {}, '])
def test_a_car_that_is_steered_past_its_end_is_held_there_and_told(fidelity: str, closed: str) -> None:
    """It turns to the left for good; without end stops it turned to the right beyond the dead centre of its tie
    rods."""
    maneuver = (FAR % 18).replace('{steering', '{' + closed + 'steering', 1)
    s = simulation_of(
        load_scene('light_car_straight', ['start.speed=2', f'maneuver={maneuver}', f'fidelity={fidelity}'])
    )
    lock = s.model.spec.lock
    assert lock is not None
    wheel, rates = s.channels.joints.index('steering_wheel'), []
    for _ in range(12):
        shot = s.advance(round(0.5 / s.h))
        rates.append(float(shot.twist[s.channels.chassis or 0, 5]))
    assert shot.joint_position[wheel] == pytest.approx((1.0 + GIVE) * lock, rel=1e-6)
    assert min(rates[2:]) > 0.0
    (told,) = [f for f in findings(s) if f.quantity == STEERING_END.name]
    assert told.value == pytest.approx(18.0, abs=1e-6)
    assert told.time == pytest.approx(0.2 + lock / 4.0, abs=2e-3)
    assert told.limit == lock


def test_a_car_that_stays_within_its_end_is_not_told() -> None:
    s = simulation_of(load_scene('light_car_straight', ['start.speed=2', f'maneuver={FAR % 9}']))
    s.advance(4000)
    assert not [f for f in findings(s) if f.quantity == STEERING_END.name]


def test_a_free_steering_wheel_comes_to_rest_on_its_stops() -> None:
    """40 N m turn it, and press the stops in by their stiffness; the account of energy closes over the impact."""
    given = [
        'actuation.steering=torque',
        'vehicle.steering.lock=3',
        'maneuver={signals: {steering_torque: 40}, brake_torque: 2000}',
    ]
    s = simulation_of(load_scene('light_car_straight', ['start.speed=0', *given]))
    wheel = s.channels.joints.index('steering_wheel')
    angle = np.array([float(s.advance(20).joint_position[wheel]) for _ in range(250)])
    assert 3.0 < angle[-1] < 1.05 * 3.0
    assert angle.max() < 1.1 * 3.0
    assert abs(angle[-1] - angle[-25]) < 1e-3
    assert s.totals()['energy_error_max'] < 0.5


def test_the_end_of_a_model_is_positive() -> None:
    with pytest.raises(Exception, match=r'model: lock = 0\.0: must be > 0'):
        dataclasses.replace(vehicle('light_car'), lock=0.0)
