"""Actuators: dead time, lag and rate limit by their closed forms; motions stay motions; what waits is part of the
state."""

from __future__ import annotations

import numpy as np
import pytest

from solver.errors import SpecError
from solver.inputs.actuation import Actuator, Chain
from solver.inputs.signals import Mapped, Sine

NAMES = ('steering', 'steering_rate', 'steering_acceleration', 'brake_torque')
H_NS = 1_000_000


def chain(stage: float = 1.0, **actuators: Actuator) -> Chain:
    made = Chain(actuators, NAMES, H_NS, stage)
    made.start(np.zeros(4))
    return made


def driven(actuators: Chain, commands: np.ndarray) -> np.ndarray:
    return np.array([actuators.advance(row) for row in commands])


def brake(values: np.ndarray) -> np.ndarray:
    rows = np.zeros((len(values), 4))
    rows[:, 3] = values
    return rows


@pytest.mark.parametrize('stage', [0.5, 1.0])
def test_a_lag_of_a_torque_is_the_exponential_at_the_instant_where_forces_balance(stage):
    applied = driven(chain(stage, brake_torque=Actuator(lag=0.05)), brake(np.full(300, 800.0)))[:, 3]
    t = (np.arange(300) + stage) * 1e-3
    np.testing.assert_allclose(applied, 800.0 * -np.expm1(-t / 0.05), rtol=1e-12)


def test_dead_time_delays_by_whole_steps():
    commands = brake(np.arange(50.0))
    applied = driven(chain(brake_torque=Actuator(dead_time=0.0072)), commands)[:, 3]
    np.testing.assert_array_equal(applied, np.r_[np.zeros(7), np.arange(43.0)])


def test_a_rate_limit_holds_and_the_exponential_begins_where_it_ends():
    """|gap| shrinks at 4000 N m/s down to rate_limit * lag = 80 N m at t = 0.08 s, and then by the exponential."""
    applied = driven(chain(brake_torque=Actuator(lag=0.02, rate_limit=4000.0)), brake(np.full(200, 400.0)))[:, 3]
    t = np.arange(1, 201) * 1e-3
    expected = np.where(t <= 0.08, 4000.0 * t, 400.0 - 80.0 * np.exp(-(t - 0.08) / 0.02))
    np.testing.assert_allclose(applied, expected, rtol=1e-10)
    ramp = driven(chain(brake_torque=Actuator(rate_limit=4000.0)), brake(np.full(200, -400.0)))[:, 3]
    np.testing.assert_allclose(ramp, -np.minimum(4000.0 * t, 400.0), rtol=1e-10)


def moved(h: float, n: int) -> np.ndarray:
    t = np.arange(1, n + 1) * h
    rows = np.zeros((n, 4))
    rows[:, 0] = 0.8 * np.sin(6.0 * t)
    return rows


def test_a_motion_behind_its_actuator_is_a_motion():
    """Angle, rate and acceleration belong together (trapezoidal rule), the rate keeps its limit."""
    u = driven(chain(steering=Actuator(lag=0.06, rate_limit=3.0)), moved(1e-3, 3000))
    np.testing.assert_allclose(np.diff(u[:, 0]), 0.5e-3 * (u[1:, 1] + u[:-1, 1]), atol=2e-6)
    np.testing.assert_allclose(np.diff(u[:, 1]), 0.5e-3 * (u[1:, 2] + u[:-1, 2]), atol=3e-4)
    assert 2.8 < np.max(np.abs(u[:, 1])) <= 3.0 * (1 + 1e-12)  # the command has 4.8 rad/s


def test_a_motion_runs_behind_a_ramp_by_its_lag():
    rows = np.zeros((1000, 4))
    rows[:, 0] = 0.5 * np.arange(1, 1001) * 1e-3
    u = driven(chain(steering=Actuator(lag=0.06, dead_time=0.01)), rows)
    assert rows[-1, 0] - u[-1, 0] == pytest.approx(0.5 * 0.07, rel=1e-9)
    assert u[-1, 1] == pytest.approx(0.5, rel=1e-9)


def test_the_state_goes_on_with_the_same_bits():
    def new() -> Chain:
        return chain(
            steering=Actuator(lag=0.05, dead_time=0.004),
            brake_torque=Actuator(lag=0.02, dead_time=0.003, rate_limit=1e4),
        )

    commands = moved(1e-3, 200)
    commands[:, 3] = 500.0 * np.sign(np.sin(40.0 * commands[:, 0]))
    one, other = new(), new()
    driven(one, commands[:90])
    other.state = one.state
    assert driven(one, commands[90:]).tobytes() == driven(other, commands[90:]).tobytes()
    with pytest.raises(SpecError, match='the actuators have'):
        chain().state = one.state


def test_a_start_is_at_rest():
    made = chain(steering=Actuator(lag=0.05), brake_torque=Actuator(lag=0.02, dead_time=0.01))
    at = made.start(np.array([0.3, 1.0, 2.0, 700.0]))
    np.testing.assert_array_equal(at, [0.3, 0.0, 0.0, 700.0])
    np.testing.assert_allclose(driven(made, np.tile(at, (30, 1))), np.tile(at, (30, 1)), atol=1e-12)


@pytest.mark.parametrize(
    ('make', 'says'),
    [
        (lambda: chain(steering=Actuator(rate_limit=1.0)), 'rate_limit without lag'),
        (lambda: Actuator(lag=-1.0), 'lag'),
        (lambda: Actuator(dead_time=20.0), 'dead_time'),
        (lambda: Actuator(rate_limit=0.0), 'rate_limit'),
        (lambda: Mapped(of=1.0, points=((0.0, 0.0),)), 'needs 2 to 64'),
        (lambda: Mapped(of=1.0, points=((1.0, 0.0), (0.0, 1.0))), 'must be greater'),
    ],
)
def test_impossible_actuators_and_maps_are_refused(make, says):
    with pytest.raises(SpecError, match=says):
        make()


def test_a_map_is_the_polynomial_through_its_points_with_its_derivatives():
    """Through four points of 2 - x + 3 x^3 goes that cubic and no other; rate and acceleration by the chain rule, by
    hand."""
    x = np.array([-1.0, -0.2, 0.5, 1.5])
    mapped = Mapped(
        of=Sine(amplitude=0.7, frequency=1.0),
        points=tuple(zip(x.tolist(), (2.0 - x + 3.0 * x**3).tolist(), strict=True)),
    )
    t = np.linspace(0.5, 2.0, 40)
    inner, jet = mapped.of.jet(t), mapped.jet(t)
    slope = 9.0 * inner.value**2 - 1.0
    np.testing.assert_allclose(jet.value, 2.0 - inner.value + 3.0 * inner.value**3, rtol=1e-12)
    np.testing.assert_allclose(jet.rate, slope * inner.rate, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(
        jet.acceleration, slope * inner.acceleration + 18.0 * inner.value * inner.rate**2, rtol=1e-10, atol=1e-9
    )
