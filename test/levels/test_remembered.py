"""What is remembered is of the same object, and of nothing that only looks like it."""

from __future__ import annotations

import pytest

from solver import remembered
from solver.files.scene import load_scene
from solver.levels import derive
from solver.model.evaluate import prepare


def test_the_same_object_with_equal_arguments_is_asked_once() -> None:
    asked: list[tuple] = []

    @remembered.of_same
    def measure(first: list, second: float = 0.0, *, third: str = '') -> int:
        asked.append((first, second, third))
        return len(asked)

    one, alike = [1], [1]
    assert [measure(one), measure(one), measure(alike), measure(one)] == [1, 1, 2, 1]
    assert [measure(one, 2.0), measure(one, third='a'), measure(one, 2.0), measure(one, third='a')] == [3, 4, 3, 4]
    for k in range(remembered.MOST):
        measure([k])
    assert measure(one) == len(asked)


def test_a_refusal_is_not_kept() -> None:
    calls: list[object] = []

    @remembered.of_same
    def refuse(first: object) -> None:
        calls.append(first)
        raise ValueError('no')

    for _ in range(2):
        with pytest.raises(ValueError, match='no'):
            refuse(calls)
    assert len(calls) == 2


def test_scenes_of_one_vehicle_share_its_model_and_its_tables() -> None:
    """Whatever their maneuvers; one with another number does not."""
    sets = ['fidelity=condensed']
    one, other, heavier = (
        load_scene('car_step_steer', [*sets, more])
        for more in ('maneuver.steering.value=0.2', 'maneuver.steering.value=0.3', 'vehicle.chassis.mass=1500')
    )
    assert one.model is other.model and one.resolved != other.resolved and heavier.model is not one.model
    less = derive(one).scene.model
    assert less is derive(other).scene.model and prepare(less) is prepare(derive(other).scene.model)
    assert derive(heavier).scene.model != less
