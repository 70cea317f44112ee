"""A wheel on its rolling resistance: it stands where it is pushed by less, and rolls against the whole of it where it
is pushed by more."""

from __future__ import annotations

import numpy as np
import pytest
from contract import check_contract
from interpreted import interpreted
from tire_bench import CAR, EXAMPLE, FLAT, HILLY, SEDAN, Tire, tire, value, wheel

from solver.elements.magic_formula import SLOWEST
from solver.elements.tire_data import I, TireData, pack
from solver.elements.tread import GIVE, give_of, rolling_part
from solver.units import MODEL_GRAVITY

rolling = interpreted(rolling_part)
STATES = {  # motion, and how far the tread has given, of what it can
    'rolling': (dict(velocity=(12.0, 0.1, 0.0), spin=39.0), 1.0),
    'reversing': (dict(velocity=(-3.0, 0.1, 0.0), spin=-9.0), -1.0),
    'standing': (dict(spin=0.002), 0.4),
    'giving back': (dict(velocity=(-0.002, 0.0, 0.0), spin=-0.006), 0.9),
    'beginning to roll': (dict(velocity=(0.02, 0.0, 0.0), spin=0.06), 0.7),
    'spinning on the spot': (dict(spin=60.0), -0.3),
    'flying': (dict(position=(0.0, 0.0, 0.5), spin=0.01), 0.5),
}


def way(element: Tire) -> float:
    """Of what the tread can give [m]."""
    return GIVE * CAR['UNLOADED_RADIUS']


@pytest.mark.parametrize('state', STATES)
@pytest.mark.parametrize('road', [FLAT, HILLY], ids=['flat', 'hilly'])
@pytest.mark.parametrize('turn_slip', [False, None, True])
@pytest.mark.parametrize('cz', [0.0, 5e-4])
def test_contract_of_force_elements(state: str, road, turn_slip: bool | None, cz: float) -> None:
    motion, given = STATES[state]
    element = tire(road=road, turn_slip=turn_slip)
    zp = (0.001, 0.002, *([] if turn_slip is False else [0.003]), given * way(element))
    check_contract(element, wheel(**motion), pair=False, power=cz > 0.0, tolerance=1e-10, zp=zp, cz=cz)


@pytest.mark.parametrize('data', [CAR, EXAMPLE, SEDAN], ids=['car', 'example', 'sedan'])
def test_above_the_creep_the_resistance_is_that_of_the_file_to_the_last_bit(data: TireData) -> None:
    """From SLOWEST on, whatever the tread has given: what stood there before is not changed."""
    element, b0 = tire(data), GIVE * data['UNLOADED_RADIUS']
    for speed in (SLOWEST / 0.9, 3.0, 25.0, -SLOWEST / 0.9, -8.0):
        found = set()
        for part in (-1.0, 0.0, 1.0):
            r = element.evaluate(
                wheel(velocity=(speed, 0.1, 0.0), spin=speed / 0.3), zp=(0.001, 0.002, part * b0), cz=5e-4
            )
            found.add(value(element, r, 'my'))
        (my,) = found
        assert my * speed <= 0.0


def test_a_standing_wheel_resists_by_what_its_tread_has_given() -> None:
    """My = -(b/b0) My of rolling, at any load; none of a wheel that has just come to rest there."""
    element = tire()
    for z in (0.28, 0.29, 0.30):
        rolling = value(element, element.evaluate(wheel(position=(0, 0, z), spin=1e-9), zp=(0.0, 0.0, 1.0)), 'my')
        assert rolling < 0.0
        for part in (-1.0, -0.5, 0.0, 0.25):
            r = element.evaluate(wheel(position=(0, 0, z)), zp=(0.0, 0.0, part * way(element)))
            assert value(element, r, 'my') == pytest.approx(part * rolling, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize('h', [1e-3, 1e-2])
@pytest.mark.parametrize('radius', [0.03, 0.55])
@pytest.mark.parametrize('resistance', [0.004, 0.05])
def test_a_mass_on_a_slope_stands_or_rolls_as_dry_friction_says(h: float, radius: float, resistance: float) -> None:
    """x'' = g (s - f m), by backward Euler: at rest with b = b0 s/f below f; g (s - f) above it; from speed it comes to
    a stop, within the way that it rolls in a step, and back by b0 and no more."""
    g, (b0, t) = MODEL_GRAVITY, give_of(radius, resistance)

    def run(slope: float, v: float, seconds: float) -> np.ndarray:
        """(n, 3) of place [m], velocity [m/s] and give [m]."""
        x, b, rows = 0.0, 0.0, []
        for _ in range(round(seconds / h)):
            drag = h * g * resistance
            new = (v + h * g * slope - drag * b / b0) / (1.0 + drag * (h + t) / b0)  # if it sticks
            beyond = (b + (h + t) * new) / b0
            if abs(beyond) > 1.0:
                new = v + h * g * slope - np.copysign(drag, beyond)
            b, part = rolling(b, h, new, b0, t)
            assert new == pytest.approx(v + h * g * slope - drag * part, abs=1e-12)
            v, x = new, x + h * new
            rows.append((x, v, b))
        return np.array(rows)

    for part in (0.5, 0.9):
        x, v, b = run(part * resistance, 0.0, 12.0 * t)[-1]
        assert b == pytest.approx(part * b0, rel=1e-3)
        assert b * 0.999 < x < 1.2 * b0  # the damper makes it slide a little on the way
        assert abs(v) < 1e-3 * b0 / t
    v = run(2.0 * resistance, 0.0, 10.0 * t)[-2:, 1]
    assert (v[1] - v[0]) / h == pytest.approx(g * resistance, rel=1e-6)
    speed = 20.0 * b0 / t
    path = run(0.0, speed, speed / (g * resistance) + 12.0 * t)
    stop = int(np.argmax(path[:, 1] <= 0.0))
    assert path[stop, 0] == pytest.approx(0.5 * speed * speed / (g * resistance), abs=speed * h + b0)
    assert path[stop, 0] - path[-1, 0] == pytest.approx(b0, rel=0.1)
    assert abs(path[-1, 1]) < 1e-3 * b0 / t


def test_damping_of_the_tread_is_critical_whatever_the_size() -> None:
    for radius in (0.02, 0.3, 0.6):
        for resistance in (1e-3, 0.0085, 0.03):
            b0, t = give_of(radius, resistance)
            assert 0.5 * t * np.sqrt(resistance * MODEL_GRAVITY / b0) == pytest.approx(1.0)
            assert 2.0 * b0 / t < SLOWEST  # of a wheel that turned the other way a moment ago
    assert give_of(0.3, 0.0) == give_of(0.3, 1e-4)


def test_a_tire_without_rolling_resistance_has_none() -> None:
    values = {k: v for k, v in CAR.values.items() if not k.startswith('QSY')}
    element = tire(TireData(name='x', version=61, values=values))
    r = element.evaluate(wheel(velocity=(5.0, 0.0, 0.0), spin=16.0), zp=(0.0, 0.0, 0.003), cz=1e-3)
    assert value(element, r, 'my') == 0.0
    assert pack(values, 61)[I.QSY1] == 0.0
