"""A car that is driven: what is held moves it, and the recording holds the inputs of every step: the same bits come
again."""

from __future__ import annotations

import json
import math
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbd_sim_ros.analysis.view.ground import Ground
from mbd_sim_ros.analysis.view.motion import read_motion
from mbd_sim_ros.bags import reader
from mbd_sim_ros.commands.main import main
from mbd_sim_ros.drive import hands as of_hands
from mbd_sim_ros.drive.frame import HEAD, Around, Head, course_of
from mbd_sim_ros.drive.hands import DRIVE, LET_GO, Hands, Held, Seat
from mbd_sim_ros.drive.session import Session
from solver import load_scene, simulation_of
from solver.errors import BagError
from solver.inputs.command_filter import commands_of
from solver.inputs.driver import Circle, Course, DoubleLaneChange, Waypoints
from solver.scene import Scene

LIGHT = ('vehicle=vehicles/light_car.yaml', 'actuation.wheels=true', 'integrator.iterations=1')


def scene() -> Scene:
    return load_scene('handling_course', LIGHT)


def session(out: Path | None, duration: float = 2.0, **options: Any) -> Session:
    """A session as fast as it goes: its end does not depend on the machine."""
    simulation = simulation_of(scene())
    names = commands_of(simulation.channels.inputs)
    one = Session(
        simulation, names, Hands(Seat.of(simulation.scene, names)), title='x', out=out, recording=out is not None,
        duration=duration, **options,
    )  # fmt: skip
    one.latch.pace.mode = 'fast'
    return one


def head_of(picture: bytes) -> Head:
    return Head(*struct.unpack_from(f'<{len(HEAD)}d', picture))


def driven(one: Session, plan: Callable[[Head], Held | None]) -> list[bytes]:
    """Pictures of a session to its end; plan: what is held behind each of them."""
    pictures: list[bytes] = []

    def show(picture: bytes) -> None:
        pictures.append(picture)
        one.hold(plan(head_of(picture)))

    one.show = show
    one.start()
    one.hold(Held(gas=1.0))
    assert one.loop.done.wait(60.0)
    one.close('stopped')
    return pictures


@pytest.mark.slow
def test_a_drive_is_recorded_and_its_replay_has_the_same_bits(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """From rest with full throttle, steering, brake and handbrake, with a wheel that is let go between."""

    def plan(head: Head) -> Held | None:
        if head.t < 1.0:
            return Held(number=1, gas=1.0)
        if head.t < 1.4:
            return Held(number=2, left=1.0, gas=1.0)
        return None if head.t < 1.6 else Held(number=3, right=1.0, brake=1.0, hand=1.0)

    one = session(tmp_path / 'run')
    pictures = driven(one, plan)
    heads = [head_of(picture) for picture in pictures]
    assert one.verdict['status'] == 'ok' and not one.failed
    assert np.diff([head.t for head in heads]).max() <= 1.0 / 60.0 + 1e-12  # at least 60 pictures a second
    assert {head.number for head in heads} == {0, 1, 2, 3}
    # the pedal is down after 0.4 s: a little less than the acceleration, for wheels and tires that turn and roll
    speed = {round(head.t, 3): head.speed for head in heads}
    gained = (speed[0.992] - speed[0.592]) / 0.4
    assert 0.85 * DRIVE < gained < DRIVE
    assert max(head.steering for head in heads) > 0.5 and heads[-1].steering < 0.3
    assert heads[-1].brake > 0.9 and heads[-1].hand == 1.0 and heads[-1].speed < speed[1.392]
    run = reader.read(tmp_path / 'run')
    assert run.metadata['end'] == 'duration reached' and run.metadata['status'] == 'ok'
    assert run['cmd_applied/brake_torque_rear_left'][-1] > 100.0
    assert main(['replay', str(tmp_path / 'run')]) == 0
    assert 'identical: 2000 steps' in capsys.readouterr().out


def test_a_picture_holds_the_bodies_and_the_forces_on_the_tires(tmp_path: Path) -> None:
    one = session(tmp_path / 'run', 0.5)
    pictures = driven(one, lambda head: Held(gas=1.0))
    motion, nb, nw = read_motion(tmp_path / 'run'), len(one._drawing.bodies), len(one._drawing.wheels)
    numbers = np.frombuffer(pictures[-1], '<f8')
    at = np.argmin(np.abs(motion.time - numbers[0]))
    pose, contact, force, load = np.split(numbers[len(HEAD) :], np.cumsum([7 * nb, 3 * nw, 3 * nw]))
    assert len(load) == nw
    if abs(motion.time[at] - numbers[0]) < 1e-9:
        np.testing.assert_allclose(pose.reshape(nb, 7), motion.pose[at], atol=1e-12)
    foot = contact.reshape(nw, 3)
    assert np.abs(foot[:, 2]).max() < 1e-6  # on the road
    np.testing.assert_allclose(force.reshape(nw, 3)[:, 2], load, rtol=1e-6)
    weight = 9.81 * sum(body.mass for body in one.simulation.scene.model.bodies)
    assert load.sum() == pytest.approx(weight, rel=0.02)


def test_who_says_nothing_any_more_holds_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [100.0]
    monkeypatch.setattr(of_hands.time, 'monotonic', lambda: clock[0])
    one = session(None)
    one.hold(Held(gas=1.0, number=4))
    simulation, hands = one.simulation, one.hands

    def gas() -> float:
        one._poll()
        simulation.advance(500, inputs=simulation.snapshot().inputs)
        one._poll()
        return hands.pedals['gas']

    assert gas() == 1.0
    clock[0] += 0.9 * LET_GO
    assert gas() == 1.0
    clock[0] += 0.2 * LET_GO
    assert gas() == 0.0
    one.hold(Held(gas=1.0))
    assert gas() == 1.0
    one.hold(None)  # the page has gone
    assert gas() == 0.0
    one.close('stopped')


@pytest.mark.slow
def test_a_reset_goes_on_in_a_new_recording_and_both_replay(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one = session(tmp_path / 'run', 1.0)
    resets = []

    def plan(head: Head) -> Held:
        if head.t > 0.5 and not resets:
            resets.append(head.t)
            for _ in range(100):
                one.act('reset', 1)  # a flood of them is one
        return Held(gas=1.0, left=1.0)

    heads = [head_of(picture) for picture in driven(one, plan)]
    assert one.runs == [tmp_path / 'run', tmp_path / 'run-2'] and one.run == 2
    assert [head.t for head in heads if head.t == 0.0] == [0.0, 0.0]
    for name, steps, end in (('run', 512, 'reset'), ('run-2', 1000, 'duration reached')):
        assert reader.read(tmp_path / name).metadata['end'] == end
        assert main(['replay', str(tmp_path / name)]) == 0
        assert f'identical: {steps} steps' in capsys.readouterr().out


def test_pause_holds_the_time_and_the_lever_shifts() -> None:
    one = session(None, 1.0)
    one.start()
    one.act('shift', -1)
    one.act('resume', 1)
    one.act('pause', 1)
    one._asked['pause'].result(10.0)
    k = one.simulation.k
    assert one.loop.paused and one.status()['paused'] and one.hands.gear == 0
    assert one.simulation.k == k
    one.act('resume', 1)
    assert one.loop.done.wait(30.0)
    one.close('stopped')
    assert one.status()['notice'] == 'duration reached'


def test_a_drive_begins_when_somebody_drives() -> None:
    one = session(None, 1.0)
    one.start()
    one.hold(Held())
    one.hold(Held(hand=1.0))
    one.loop.ask(lambda: None).result(10.0)
    assert one.simulation.k == 0 and not one.status()['begun']
    one.hold(Held(left=1.0))
    assert one.loop.done.wait(30.0)
    one.close('stopped')


def test_a_recording_that_fails_is_told_and_the_drive_goes_on(tmp_path: Path) -> None:
    one = session(tmp_path / 'run', 1.0)
    recorder = one._writing[1]
    notices: list[str] = []

    def plan(head: Head) -> Held:
        if head.t > 0.5:
            recorder.error = BagError('the disk is full')
            notices.append(one.status()['notice'])
        return Held(gas=1.0)

    heads = [head_of(picture) for picture in driven(one, plan)]
    assert one.failed == 'the disk is full' and 'the disk is full' in notices
    assert heads[-1].t > 0.95
    recorder.error = None
    recorder.close()


def test_the_road_around_is_that_of_the_solver_and_a_plane_needs_none() -> None:
    height = [[0.25 - 0.25 * math.cos(math.tau * k / 40.0)] * 2 for k in range(41)]
    grid = f'{{kind: height_grid, origin: [2, -50], step: [1, 100], height: {height}}}'
    road = f'{{point: [0, 0, 3], normal: [-0.1, 0.05, 1], grids: [{grid}]}}'
    spec = load_scene('light_car_straight', [f'road={road}']).model.road
    around = Around(spec)
    text = around.at(20.3, -1.6)
    squares = json.loads(text)['ground']
    assert [(one['x'], one['y'], one['apart'], len(one['z'])) for one in squares] == [
        (3, -19, 1, 35**2), (-240, -260, 10, 53**2),
    ]  # fmt: skip
    for one in squares:
        side = math.isqrt(len(one['z']))
        k = np.arange(side**2)
        x, y = one['x'] + one['apart'] * (k // side), one['y'] + one['apart'] * (k % side)
        np.testing.assert_allclose(one['z'], Ground(spec).at(x.astype(float), y.astype(float)), atol=6e-4)
    assert max(squares[0]['z']) > 3.0 + 0.1 * 20.0 + 0.3  # on the hill
    assert around.at(22.0, -1.6) is text  # near enough
    assert around.at(25.0, -1.6) is not text
    assert Around(scene().model.road).at(20.3, -1.6) == ''


def test_the_scripts_of_the_page_declare_every_name_once() -> None:
    """They share one scope: a name that two of them declare is an error that stops the second one whole."""
    page = session(None).page()
    script = page[page.rindex('<script>') :]
    declared: list[str] = []
    for line in script.splitlines():
        if first := re.match(r'(?:const|let|class|function) (.*)', line):  # not indented: at the top
            plain = re.sub(r"\([^()]*\)|\[[^\[\]]*\]|\{[^{}]*\}|'[^']*'", '', first[1])
            more = re.findall(r'(?:^|, )(\w+) = ', plain) if line.startswith(('const', 'let')) else []
            declared += more or re.findall(r'^\w+', first[1])
    assert {'data', 'floats', 'Picture', 'COLOURS', 'INKS', 'drawn', 'hold'} <= set(declared)
    assert [name for name in set(declared) if declared.count(name) > 1] == []
    assert '@' not in re.sub(r'@media', '', page[: page.index('<script')])  # every part is filled in


def test_the_lane_of_a_course_lies_to_both_sides_of_it() -> None:
    square = Course(points=tuple((30.0 * x, 30.0 * y) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))), closed=True)
    for path in (square, Circle(radius=-20.0, start=3.0), Course(points=((0.0, 0.0), (50.0, 0.0), (80.0, 30.0)))):
        left, right = (np.array(edge) for edge in course_of(path)['edges'])
        np.testing.assert_allclose(np.linalg.norm(left - right, axis=1), 5.0, atol=2e-3)
        middle = 0.5 * (left + right)
        apart = np.linalg.norm(np.diff(middle, axis=0), axis=1)
        assert apart.min() > 0.0 and apart.max() < 1.5
        if path is not square and isinstance(path, Circle):
            np.testing.assert_allclose(np.linalg.norm(middle - [3.0, -20.0], axis=1), 20.0, atol=2e-3)
        along = np.diff(middle, axis=0)
        across = (left - right)[:-1]
        assert (along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0] > 0.0).all()  # the first one is the left one
    straight = course_of(Waypoints(points=((0.0, 0.0), (10.0, 0.0))))
    assert straight['edges'][0][3] == [3.0, 2.5] and straight['cones'] == []
    gates = course_of(DoubleLaneChange(start=0.0))
    assert gates['edges'] == [] and len(gates['cones']) == 30 and gates['cones'][0][0] == 0.0
    assert course_of(None) == {'edges': [], 'cones': []}
