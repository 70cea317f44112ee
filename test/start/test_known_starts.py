"""A start that was found before is taken from memory or disk, bit for bit, and only where nothing that it depends on
has changed."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from solver import simulation_of
from solver.disk import Store
from solver.errors import ConsistencyError
from solver.files.scene import load_scene
from solver.scene import Scene
from solver.start import known
from solver.start.initial_conditions import InitialConditions

NAME = 'light_car_step_steer'


@pytest.fixture
def searches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A process that knows no start, with a store of its own; every search adds the kind of its start."""
    monkeypatch.setattr(known, '_remembered', type(known._remembered)())
    monkeypatch.setattr(known, 'store_of', lambda name: Store(tmp_path / name))
    found: list[str] = []
    find = InitialConditions.find

    def counted(self: InitialConditions) -> object:
        found.append(self.wanted.kind)
        return find(self)

    monkeypatch.setattr(InitialConditions, 'find', counted)
    return found


def scene(*sets: str) -> Scene:
    return load_scene(NAME, ['duration=0.1', *sets])


def bits(of: Scene) -> tuple[bytes, bytes, str]:
    """The start, a short run from it, and what is said of the start."""
    simulation = simulation_of(of)
    return simulation.snapshot().numbers.tobytes(), simulation.advance(20).numbers.tobytes(), str(simulation.start)


@pytest.mark.parametrize('forget', [False, True])
def test_a_scene_that_differs_in_its_maneuver_begins_where_another_one_did(forget: bool, searches: list[str]) -> None:
    """From memory, and in another process from disk."""
    other = scene('maneuver.steering.value=0.4', 'duration=0.2')
    searched = bits(other)
    assert len(searches) == 1
    known._remembered.clear()
    simulation_of(scene())
    assert len(searches) == 1  # the store of the first one
    if forget:
        known._remembered.clear()
    assert bits(other) == searched and len(searches) == 1


@pytest.mark.parametrize('change', [
    'start.speed=21', 'vehicle.chassis.mass=1201', 'integrator.h=0.002', 'integrator.iterations=4', 'road.friction=0.8',
    'maneuver.steering.initial=0.02', 'maneuver.drive_torque=10', 'start.kind=assemble', 'integrator.penalty=1e5',
    'integrator.rho_inf=0.5', 'integrator.mass_factor=0.5', 'road.normal=[0.01,0,1]', 'switches={drag: off}',
])  # fmt: skip
def test_every_other_change_is_another_start(change: str, searches: list[str]) -> None:
    before, after = bits(scene()), bits(scene(change))
    assert len(searches) == 2 and before[1] != after[1]


def test_what_is_said_of_a_known_start_is_what_was_found(searches: list[str]) -> None:
    """Equal object by object, not only in words."""
    found = simulation_of(scene()).start
    known._remembered.clear()
    from_disk, from_memory = simulation_of(scene()).start, simulation_of(scene()).start
    assert from_disk == from_memory == found and found.wheels and len(searches) == 1


def test_a_model_that_was_changed_in_python_is_another_one(searches: list[str]) -> None:
    """Whatever the text says that a scene was read from."""
    one = scene()
    (first, *rest) = one.model.bodies
    heavier = dataclasses.replace(one.model, bodies=(first.replace(mass=first.mass * 1.01), *rest))
    assert bits(one)[0] != bits(dataclasses.replace(one, model=heavier))[0]
    assert len(searches) == 2


def test_what_is_damaged_is_found_anew(tmp_path: Path, searches: list[str]) -> None:
    first = bits(scene())
    (file,) = (tmp_path / 'starts').iterdir()
    whole = file.read_bytes()
    for broken in (whole[:-8], whole[:40] + bytes([whole[40] ^ 1]) + whole[41:], b''):
        known._remembered.clear()
        file.write_bytes(broken)
        assert bits(scene()) == first
    assert len(searches) == 4
    known._remembered.clear()
    assert file.read_bytes() == whole and bits(scene()) == first and len(searches) == 4


def test_a_directory_that_cannot_be_written_costs_nothing_but_time(
    searches: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(known, 'store_of', lambda name: Store(Path('/dev/null/none') / name))
    first = bits(scene())
    known._remembered.clear()
    assert bits(scene()) == first and len(searches) == 2


def test_a_start_that_fails_is_sought_again_and_says_the_same(searches: list[str]) -> None:
    falling = scene('vehicle.chassis.mass=1e9')
    said = []
    for _ in range(2):
        with pytest.raises(ConsistencyError) as error:
            simulation_of(falling)
        said.append(str(error.value))
    assert said[0] == said[1] and len(searches) == 2


def test_starts_of_mechanisms_are_not_kept(tmp_path: Path, searches: list[str]) -> None:
    for _ in range(2):
        simulation_of(load_scene('pendulum'))
    assert len(searches) == 2 and not (tmp_path / 'starts').exists()


def test_a_process_remembers_few(searches: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(known, 'MOST', 2)
    for speed in (10, 11, 12, 11):
        simulation_of(scene(f'start.speed={speed}'))
    assert len(known._remembered) == 2 and len(searches) == 3


def test_the_content_of_a_specification_is_its_numbers_not_its_objects() -> None:
    """A scene read twice, and one read from its own text, in which other objects are shared."""
    from solver.files.scene import load_scene_text

    one = scene()
    content: Callable[[Scene], bytes] = lambda s: known._content(s.model)  # noqa: E731
    assert content(one) == content(load_scene_text(one.resolved)) == content(scene('duration=3'))
    assert content(one) != content(scene('vehicle.chassis.mass=1200.0000000000002'))
    assert np.array_equal(np.zeros(1), -np.zeros(1)) and known._content(-0.0) != known._content(0.0)  # type: ignore[arg-type]
