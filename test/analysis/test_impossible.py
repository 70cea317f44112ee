"""What no vehicle can do is told with the time at which it began, and what a vehicle can do is not."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

import solver
from solver.analysis.envelope import Envelope
from solver.analysis.impossible import folded_at
from solver.checks.vehicle import PRESSED
from solver.findings import Finding
from solver.output.snapshot import Snapshot
from solver.simulation import Simulation

TRAILER = 'saloon_with_trailer'


def car(scene: str = 'light_car_straight', *settings: str) -> Simulation:
    found = solver.simulation_of(solver.load_scene(scene, ['maneuver={}', 'start.speed=5', *settings]))
    assert isinstance(found, Simulation)
    return found


def told(simulation: Simulation, *shown: Snapshot) -> list[Finding]:
    """What is found in snapshots, one every 20 ms."""
    watch = Envelope(simulation)
    for k, one in enumerate(shown):
        watch.look(
            dataclasses.replace(one, t_ns=20_000_000 * k)
            if dataclasses.is_dataclass(one)
            else one._replace(t_ns=20_000_000 * k)
        )
    return watch.findings(ended=False)


def changed(
    simulation: Simulation, body: str, by: tuple[float, float, float] = (0.0, 0.0, 0.0), yaw: float = 0.0
) -> Snapshot:
    """What a simulation shows, with a body moved [m] and turned about the vertical [rad] from where it is."""
    shown = simulation.snapshot()
    pose = shown.pose[simulation.channels.bodies.index(body)]
    pose[:3] += by
    x, y, z, w = pose[3:].tolist()
    c, s = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    pose[3:] = [c * x - s * y, c * y + s * x, c * z + s * w, c * w - s * z]
    return shown


@pytest.mark.parametrize('scene', ['light_car_straight', TRAILER])
def test_each_state_that_no_vehicle_is_in_is_told_with_its_beginning(scene: str) -> None:
    s = car(scene)
    wheel, other = 'wheel_front_left', 'wheel_rear_right'
    cases = {
        'under_road': (changed(s, wheel, (0.0, 0.0, -0.3)), 0.0),
        'suspension': (changed(s, other, (0.0, 0.0, 0.33)), s.model.spec.tires[0].data['UNLOADED_RADIUS']),
        'wheel_axis': (changed(s, wheel, yaw=1.7), 0.5 * math.pi),
    }
    for quantity, (shown, limit) in cases.items():
        found = told(s, s.snapshot(), s.snapshot(), shown, s.snapshot())
        assert [f.quantity for f in found] == [quantity]
        assert (found[0].time, found[0].limit) == (0.04, limit)
        assert found[0].where == ('rear_right' if quantity == 'suspension' else 'front_left')
        assert found[0].value > limit
    both = {f.quantity: f for f in told(s, changed(s, wheel, (0.0, -1.7, 0.0)))}
    assert both.keys() == {'crossed', 'suspension'}
    assert -0.5 < both['crossed'].value < 0.0


def test_what_a_vehicle_can_do_is_not_told() -> None:
    """Full steer, full bump and droop, the wheels of one side in the air, and a car on its roof, which is another
    finding."""
    s = car()
    able = [changed(s, 'wheel_front_left', yaw=a) for a in (0.8, -0.8)] + [
        changed(s, 'wheel_rear_left', (0.0, 0.0, z)) for z in (0.12, -0.12)
    ]
    assert told(s, *able) == []
    over = s.snapshot()
    turn = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    for pose in over.pose:
        x, y, z, w = pose[3:].tolist()
        pose[:3] = turn @ pose[:3] + (0.0, 0.0, 3.0)
        pose[3:] = [w, -z, y, -x]  # half a turn about x before it
    assert {f.quantity for f in told(s, over)} <= {'rollover', 'under_road'}


def test_a_steering_wheel_beyond_its_stops_is_told_whoever_turned_it() -> None:
    """Inputs that are given step by step pass no hands."""
    s = car('light_car_straight', 'vehicle.steering.lock=4')
    names, wanted = list(s.channels.inputs), 6.0
    watch = Envelope(s)
    for k in range(150):
        angle = min(0.05 * k, wanted)
        u = np.zeros(len(names))
        u[names.index('steering')] = angle
        watch.look(s.advance(20, u))
    (found,) = watch.findings(ended=False)
    assert found.quantity == 'steering_end'
    assert found.limit == PRESSED * 4.0
    assert found.value == pytest.approx(wanted)
    assert found.time == pytest.approx(0.02 * 85, abs=0.021)


@pytest.mark.slow
def test_a_trailer_that_is_pushed_back_folds_and_is_told() -> None:
    """Reversing with the steering held: the articulation grows exponentially, and is told from a right angle on;
    driving on it is not."""
    backwards = [
        'start.speed=-2',
        'maneuver={steering: {kind: step, value: 0.3, start: 0.5, rise: 1}, speed: {target: -2}}',
        'duration=12',
    ]
    s = solver.simulation_of(solver.load_scene(TRAILER, backwards))
    watch, k, first = Envelope(s), s.channels.joints.index('articulation'), 0.0
    for _ in range(550):
        shown = s.advance(20)
        watch.look(shown)
        if not first and abs(shown.joint_position[k]) > 0.5 * math.pi:
            first = shown.t_ns * 1e-9
    (found,) = [f for f in watch.findings() if f.quantity == 'articulation']
    assert found.time == first > 5.0
    assert found.limit == folded_at(s.model.spec) == 0.5 * math.pi
    assert 'No vehicle can do that' in found.text


def test_a_short_drawbar_folds_before_the_right_angle() -> None:
    """Its ball between the rear wheels: the wheel on the inside is between them from the angle on where its drawbar has
    turned so far."""
    model = car(TRAILER).model.spec
    bodies = {body.name: body for body in model.bodies}
    hitch = next(joint for joint in model.joints if joint.name == 'hitch')
    rear = bodies['wheel_rear_left'].position
    ahead = rear[0] + 0.4 - (bodies[hitch.i.body].position[0] + hitch.i.position[0])
    moved = dataclasses.replace(hitch.i, position=(hitch.i.position[0] + ahead, *hitch.i.position[1:]))
    joints = tuple(dataclasses.replace(joint, i=moved) if joint is hitch else joint for joint in model.joints)
    assert folded_at(dataclasses.replace(model, joints=joints)) < 0.5 * math.pi


def test_mechanisms_are_not_followed() -> None:
    s = solver.simulation_of(solver.load_scene('slider_crank'))
    assert Envelope(s).every(s.h_ns) == 0
