"""What is remembered is of the same object, and of nothing that only looks like it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from solver import remembered, simulation_of
from solver.compiled.by_reference import Ref
from solver.files.scene import load_scene
from solver.levels import derive
from solver.levels.switches import switched
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


def test_another_argument_may_be_changed_by_who_gave_it() -> None:
    """A mapping that was given is the same object afterwards, and no longer what was asked."""

    @remembered.of_same
    def names(first: str, second: dict[str, str], *, third: list[str]) -> list[str]:
        return [first, *second.values(), *third]

    switches, more = {'drag': 'off'}, ['a']
    assert names('car', switches, third=more) == ['car', 'off', 'a']
    switches['drag'] = 'on'
    assert names('car', switches, third=more) == ['car', 'on', 'a']
    more[0] = 'b'
    assert names('car', switches, third=more) == ['car', 'on', 'b']


def test_a_subsystem_that_is_switched_off_later_is_off() -> None:
    model, switches = load_scene('light_car_step_steer').model, {'drag': 'on'}
    with_drag, _ = switched(model, switches)
    switches['drag'] = 'off'
    without, _ = switched(model, switches)
    assert with_drag != without


def arrays(value: Any) -> Iterator[np.ndarray]:
    """All arrays in nested tuples, mappings and what is given by reference."""
    value = value.value if isinstance(value, Ref) else value
    if isinstance(value, np.ndarray):
        yield value
    for one in value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else ():
        yield from arrays(one)


def test_what_simulations_share_is_never_written() -> None:
    """Two simulations of one model have the same tables: steps, saved states, twins and places change none of them."""
    scene = load_scene('light_car_step_steer', ['duration=0.1'])
    one, other = simulation_of(scene), simulation_of(scene)
    assert one.model is other.model
    shared = [*arrays((one.model.tables, one.model.elements))]
    before = [array.tobytes() for array in shared]
    one.advance(5)
    saved = one.save()
    one.place(30.0, -2.0, 0.5)
    one.advance(5)
    one.restore(saved)
    one.twin(0.01, h=0.0005).advance(10)
    one.constraint_coefficients()
    one.reset()
    assert len(shared) > 100 and [array.tobytes() for array in shared] == before


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
