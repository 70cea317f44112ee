"""A driver in compiled code does what the one in Python does, bit for bit, however many steps are made at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from solver import simulation_of
from solver.compiled.kernel import kernel
from solver.errors import StepError
from solver.files.scene import load_scene
from solver.inputs.driver import Circle, DoubleLaneChange, PreviewDriver, Sight, SpeedControl, Waypoints
from solver.inputs.driving import drive, driving_of
from solver.inputs.maneuver import DriverSource, Maneuver
from solver.inputs.signals import Ramp
from solver.simulation import Simulation

NAMES = ('steering', 'steering_rate', 'steering_acceleration', 'drive_torque', 'brake_torque')
H_NS = 2_000_000
LANES = PreviewDriver(path=DoubleLaneChange(start=5.0))
OBSTACLE = PreviewDriver(path=DoubleLaneChange(standard='iso_3888_2', start=2.0), preview=0.5, understeer=0.002)
POINTS = PreviewDriver(path=Waypoints(points=((0.0, 0.0), (20.0, 1.5), (31.0, -2.0), (60.0, 4.0))), rate_limit=2.0)
TWO = PreviewDriver(path=Waypoints(points=((0.0, 0.0), (20.0, 1.5))), limit=0.3)
BRAKING = SpeedControl(target=Ramp(slope=-20.0, initial=9.0, start=0.1, final=-5.0), brakes=4000.0, most=900.0)
ROLLING_OUT = SpeedControl(target=12.0, until=0.5, release=0.3)
DRIVERS: dict[str, Maneuver] = {
    'lanes': Maneuver(driver=LANES),
    'obstacle': Maneuver(driver=OBSTACLE, speed=SpeedControl(first=30.0)),
    'points': Maneuver(driver=POINTS, drive_torque=50.0),
    'two points': Maneuver(driver=TWO, speed=BRAKING),
    'speed': Maneuver(speed=BRAKING, steering=0.2),
    'rolls out': Maneuver(speed=ROLLING_OUT),
}


@kernel
def _drive(driver, k, wanted, x, y, heading, speed, row):
    drive(driver, k, wanted[0], wanted[1], (x, y, heading, speed), row)


@pytest.mark.parametrize('lock', [None, 0.25])
@pytest.mark.parametrize('name', DRIVERS)
def test_the_laws_are_those_of_python(name: str, lock: float | None, rng: np.random.Generator) -> None:
    """Along a random way, at any speed, forwards and backwards, behind both ends of the path."""
    maneuver = DRIVERS[name]
    source = DriverSource(maneuver, NAMES, H_NS, 0.5, 15.0, lock)
    driving = driving_of(maneuver.driver, maneuver.speed, NAMES, H_NS * 1e-9, source.lock)
    assert driving is not None
    hands = slice(0 if maneuver.driver else 3, 4 if maneuver.speed else 3)
    driving.state[hands] = source.state
    for k in range(600):
        sight = Sight(*(rng.normal(size=4) * (30.0, 3.0, 0.5, 12.0) + (30.0, 0.0, 0.0, 8.0)).tolist())
        row = source.open_loop.table(k, 1)[0]
        _drive(driving, k, source.wanted(k, 1)[0].copy(), *sight, row)
        assert row.tobytes() == source.sample(k, sight).tobytes(), k
        assert driving.state[hands].tobytes() == source.state.tobytes(), k


def test_a_path_that_only_python_knows_is_left_to_it() -> None:
    assert driving_of(PreviewDriver(path=Circle(radius=50.0)), None, NAMES, 0.002, np.inf) is None


def made(name: str, *sets: str) -> Callable[[], Simulation]:
    return lambda: simulation_of(load_scene(name, list(sets)))


CARS = {
    'adapting': made('light_car_lane_change', 'maneuver.driver.path.start=5'),
    'constant': made('light_car_lane_change', 'maneuver.driver.path.start=5', 'integrator.step_policy=constant'),
    'by error': made('light_car_lane_change', 'integrator.mode=tolerance', 'integrator.step_policy=error',
                     'integrator.error_tolerance=1e-6', 'integrator.h=0.02'),
    'branches': made('light_car_lane_change', 'record.branches=true'),
    'single_track': made('car_lane_change', 'fidelity=single_track', 'maneuver.driver.path.start=5'),
    'ice': made('car_lane_change', 'fidelity=single_track',
                'road.patches=[{center: [15, 0], size: [20, 10], factor: 0.3}]'),
}  # fmt: skip


@pytest.mark.parametrize('audit', [True, False])
@pytest.mark.parametrize('name', CARS)
def test_steps_made_at_once_have_the_bits_of_steps_made_alone(name: str, audit: bool) -> None:
    """States, accounts, applied inputs, rows that are seen; across calls and a saved state."""
    alone, together = CARS[name](), CARS[name]()
    assert together.sources.drives
    alone.sources._driving = None
    for n, every in ((30, 0), (7, 3), (1, 1), (40, 8)):
        seen = together.seen(every, n) if every else None
        rows = []
        for _ in range(n):
            shot = alone.advance(1, audit=audit)
            rows += [shot.numbers] if every and alone.k % every == 0 else []
            if _ == 0:
                applied = [alone.applied]
            else:
                applied.append(alone.applied)
        last = together.advance(n, audit=audit, seen=seen)
        if audit:  # else what is seen is evaluated in fewer steps
            assert together.last_step.account.numbers.tobytes() == alone.last_step.account.numbers.tobytes()
        assert last.numbers.tobytes() == shot.numbers.tobytes()
        assert np.concatenate(applied).tobytes() == together.applied.tobytes()  # type: ignore[arg-type, union-attr]
        if seen is not None:
            assert seen.numbers.tobytes() == b''.join(row.tobytes() for row in rows)
        assert together.sources.memory()['driver'].tobytes() == alone.sources.memory()['driver'].tobytes()
        assert together.reached == alone.reached
    saved = together.save()
    ahead = together.advance(25).numbers.tobytes()
    together.restore(saved)
    assert together.advance(25).numbers.tobytes() == ahead


def test_a_failure_leaves_driver_and_state_at_the_step_that_failed() -> None:
    found = []
    for compiled in (True, False):
        s = CARS['constant']()
        if not compiled:
            s.sources._driving = None
        s.advance(10)
        s.state.v[0, 0] = 1e200  # nothing can be done with it
        with pytest.raises(StepError) as error:
            s.advance(5)
        found.append((s.k, str(error.value), s.applied.tobytes(), s.sources.memory()['driver'].tobytes()))  # type: ignore[union-attr]
    assert found[0] == found[1]


def test_what_lies_behind_a_driver_stays_with_python() -> None:
    s = made('light_car_lane_change', 'actuation.actuators={drive_torque: {lag: 0.1}}')()
    assert s.sources.step_by_step and not s.sources.drives
    s.advance(3)
