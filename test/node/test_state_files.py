"""State files carry over between scenes of a vehicle; those that are none, or were damaged, are refused in one
sentence."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from synthetic import Synthetic, scene

from mbd_sim_ros.commands.main import main
from mbd_sim_ros.node import state_files
from mbd_sim_ros.node.state_files import restore, save
from solver.errors import SpecError
from solver.files.scene import load_scene
from solver.inputs.command_filter import CommandSource
from solver.model.state import fitting, load_arrays
from solver.simulation import Simulation

CONTENT = {
    'no zip': b'hello',
    'a zip that is cut off': b'PK\x03\x04' + bytes(40),
    'nothing': b'',
}


@pytest.mark.parametrize('name', CONTENT)
def test_a_file_that_is_no_state_is_refused(name: str, tmp_path: Path) -> None:
    file = tmp_path / 'state.npz'
    file.write_bytes(CONTENT[name])
    with pytest.raises(SpecError, match='no file is there'):
        restore(tmp_path / 'none', SimpleNamespace(hash='x'), Synthetic(), {})
    for path in (file, tmp_path / 'none', Path('/dev/zero')):
        with pytest.raises(SpecError, match='is not a state file') as caught:
            restore(path, SimpleNamespace(hash='x'), Synthetic(), {})
        assert '\n' not in str(caught.value)


def test_arrays_that_claim_more_than_a_state_has_are_not_unpacked(tmp_path: Path) -> None:
    file = tmp_path / 'bomb.npz'
    np.savez_compressed(file, k=np.zeros(10_000_000))
    assert file.stat().st_size < 1_000_000
    with pytest.raises(SpecError, match=r'claims to hold 8000\d\d\d\d bytes'):
        load_arrays(file.read_bytes())
    for saved in (None, np.zeros(3), np.zeros(2, np.float32)):
        with pytest.raises(SpecError, match='of another model'):
            fitting('inputs', saved, np.zeros(2))


def test_a_file_holds_the_commands_and_one_of_another_version_is_refused_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    simulation, parts = Synthetic(), {'steering': SimpleNamespace(state=np.array([0.1, 0.2, 0.3]))}
    simulation.advance(5)
    path = save(scene(), simulation, parts, {'steering': 0.4, 'brake_torque': 30.0})
    began, found = Synthetic(), {'steering': SimpleNamespace(state=np.zeros(3))}
    assert restore(path, scene(), began, found) == {'steering': 0.4, 'brake_torque': 30.0}
    assert began.k == 5
    np.testing.assert_array_equal(found['steering'].state, [0.1, 0.2, 0.3])
    content = load_arrays(path.read_bytes())
    older = tmp_path / 'older.npz'
    # as mbd_sim_ros 0.1 wrote them
    np.savez(older, **{name: value for name, value in content.items() if name != 'format'})
    with pytest.raises(
        SpecError, match=rf'restore: {older} has format 1, and this version of mbd_sim_ros reads format 3: save it anew'
    ):
        restore(older, scene(), Synthetic(), found)
    for wrong, says in (
        (np.zeros(3), 'latched has shape'),
        (np.array([0.4, np.nan]), 'holds commands that are not finite'),
    ):
        np.savez(older, **{**content, 'latched': wrong})
        with pytest.raises(SpecError, match=says):
            restore(older, scene(), Synthetic(), found)


def test_a_state_that_cannot_be_written_leaves_no_file_and_two_of_a_second_are_two(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    parts = {'steering': SimpleNamespace(state=np.zeros(3))}
    saved = {save(scene(), Synthetic(), parts, {}) for _ in range(5)}
    assert len(saved) == 5 and saved == set(tmp_path.iterdir())

    def full(path: Path, **content: np.ndarray) -> None:
        path.write_bytes(b'PK')
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(np, 'savez', full)
    with pytest.raises(
        SpecError, match=r'the state cannot be saved in /.*-step0-.*: No space left on device; make room, or'
    ):
        save(scene(), SimpleNamespace(k=0, h_ns=1, save=lambda: b'x'), parts, {})
    assert saved == set(tmp_path.iterdir())


def parts_of(scene, simulation: Simulation) -> dict[str, state_files.Part]:
    """What makes the inputs of a node and has a memory."""
    found: dict[str, state_files.Part] = {'steering': CommandSource(simulation.channels.inputs, simulation.h_ns)}
    if scene.actuation.actuators:
        found['actuators'] = simulation.sources.new_actuators()
    return found


def test_a_state_carries_over_to_every_scene_of_the_same_vehicle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Saved in a curve by a node whose topics drive; whoever drives afterwards, a driver who looks ahead too, has the
    wheel where it is."""
    monkeypatch.chdir(tmp_path)
    before = load_scene('light_car_step_steer')
    curve = Simulation(before)
    assert not state_files.jump(curve, 20.0)
    at = {name: place for place, name in enumerate(curve.channels.inputs)}
    source = CommandSource(curve.channels.inputs, curve.h_ns)
    for _ in range(400):
        curve.advance(1, source.advance(0.5, 200.0, 0.0))
    there = curve.snapshot()
    assert there.inputs[at['steering']] == pytest.approx(0.5, abs=1e-3)
    path = save(before, curve, {'steering': source}, {'steering': 0.5, 'drive_torque': 200.0, 'brake_torque': 0.0})
    for name in ('brake', 'circle', 'lane_change', 'straight', 'swept_steer'):
        after = load_scene(f'light_car_{name}')
        simulation = Simulation(after)
        parts = parts_of(after, simulation)
        assert restore(path, after, simulation, parts)['steering'] == 0.5
        for one in ('q', 'v', 'a', 'lam', 'angle'):
            np.testing.assert_array_equal(getattr(simulation.state, one), getattr(curve.state, one), err_msg=name)
        np.testing.assert_array_equal(simulation.snapshot().inputs, there.inputs)
        np.testing.assert_array_equal(parts['steering'].state, source.state)
        jumps = state_files.jump(simulation, 20.0)
        if after.maneuver.driver is None:
            assert jumps.startswith(
                'the steering wheel stands at 0.5 rad, and the maneuver has it at 0 rad behind t = 0.4 s'
            )
        else:
            assert not jumps
            most = after.maneuver.driver.rate_limit * 1e-9 * simulation.h_ns
            moved = abs(simulation.advance(1).inputs[at['steering']] - there.inputs[at['steering']])
            assert moved <= most


@pytest.mark.parametrize('recorded', [False, True], ids=['driver', 'recording'])
def test_topics_go_on_where_a_maneuver_is_and_a_maneuver_where_topics_are(
    recorded: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In one scene. What did not act before was where the scene begins: the wheel would turn by a tenth of a radian in
    a step, and the brakes be off. Hands and actuators are where they were, and the steering wheel goes on."""
    monkeypatch.chdir(tmp_path)
    name, overrides = 'light_car_lane_change', ['actuation.actuators.brake_torque.lag=0.1']
    braking = [*overrides, 'maneuver.brake_torque=100']
    if recorded:
        assert (
            main(
                [
                    'run',
                    name,
                    '--duration',
                    '2',
                    '--out',
                    'drive',
                    '--json',
                    *(w for text in braking for w in ('--set', text)),
                ]
            )
            == 0
        )
    driven = load_scene(name, [*overrides, "maneuver={bag: 'drive'}", 'duration=2'] if recorded else braking)
    simulation = Simulation(driven)
    names = simulation.channels.inputs
    simulation.advance(1900)
    there = dict(zip(names, simulation.inputs.tolist()))
    assert abs(there['steering']) > 0.1 and there['brake_torque'] == pytest.approx(100.0)
    own = simulation.sources.actuators
    parts = {'steering': CommandSource(names, simulation.h_ns), 'actuators': own or simulation.sources.new_actuators()}
    state_files.hand_over(simulation, parts, commanded=False)
    path = save(driven, simulation, parts, {})
    other = Simulation(driven)
    commanded = {
        'steering': CommandSource(names, other.h_ns),
        'actuators': other.sources.actuators or other.sources.new_actuators(),
    }
    assert restore(path, driven, other, commanded) == {}
    row = commanded['actuators'].advance(commanded['steering'].advance(there['steering'], 0.0, there['brake_torque']))
    at = dict(zip(names, row.tolist()))
    h = 1e-9 * other.h_ns
    assert abs(at['steering'] - there['steering']) <= abs(there['steering_rate']) * h
    assert at['brake_torque'] == there['brake_torque']
    if recorded:
        return
    other.advance(1, row)
    state_files.hand_over(other, commanded, commanded=True)
    back = Simulation(driven)
    restore(save(driven, other, commanded, {}), driven, back, parts_of(driven, back))
    assert (
        abs(back.advance(1).inputs[names.index('steering')] - at['steering']) <= driven.maneuver.driver.rate_limit * h
    )


def test_actuators_of_another_scene_begin_at_the_inputs_in_force(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their memory has one number in both scenes: there the torque of the drive, here that of the brakes."""
    monkeypatch.chdir(tmp_path)
    driven, braked = (
        load_scene('light_car_straight', [f'actuation.actuators.{n}_torque.lag=0.1']) for n in ('drive', 'brake')
    )
    simulation = Simulation(driven)
    parts = parts_of(driven, simulation)
    parts['actuators'].state = np.array([300.0])
    simulation.advance(
        2,
        np.array([{'drive_torque': 300.0, 'brake_torque': 40.0}.get(name, 0.0) for name in simulation.channels.inputs]),
    )
    path = save(driven, simulation, parts, {})
    for after, expected in ((braked, [40.0]), (driven, [300.0]), (load_scene('light_car_straight'), None)):
        other = Simulation(after)
        found = parts_of(after, other)
        restore(path, after, other, found)
        if expected is not None:
            np.testing.assert_array_equal(found['actuators'].state, expected)


def test_a_state_whose_wheels_would_begin_in_a_higher_road_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the tread to the rim there are 112.8 mm, of which standing takes some 20. With the road 0.3 m higher the car
    rose by a metre."""
    monkeypatch.chdir(tmp_path)
    before = load_scene('light_car_straight')
    standing = Simulation(before)
    path = save(before, standing, parts_of(before, standing), {})
    for height, fits in ((-0.5, True), (0.05, True), (0.13, False), (0.3, False)):
        after = load_scene('light_car_straight', [f'road.point=[0, 0, {height}]'])
        simulation = Simulation(after)
        if fits:
            restore(path, after, simulation, parts_of(after, simulation))
            continue
        with pytest.raises(
            SpecError,
            match=r'restore: .*: the tire \w+ would begin \S+ m deep in the road of this scene, and its rim .* 0.113 m',
        ):
            restore(path, after, simulation, parts_of(after, simulation))
