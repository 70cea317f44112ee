"""The level kc of axles whose wheels share mass: live axles, a twist beam."""

from __future__ import annotations

import dataclasses
import functools

import live_axle_cars
import numpy as np
import pytest

import solver
from solver.analysis.driven import steady_figures
from solver.analysis.kinematics_and_compliance import Rig, kinematic_figures
from solver.analysis.modes import named_modes
from solver.elements.applied_force import AppliedForceSpec
from solver.elements.marker import Marker
from solver.elements.rigid_body import RigidBodySpec
from solver.elements.road import RoadSpec
from solver.inputs.maneuver import Maneuver
from solver.inputs.signals import Step
from solver.levels import derive, maps
from solver.levels.axle_masses import beam, divided
from solver.model.spec import ModelSpec
from solver.scene import Scene, StartSettings
from solver.simulation import Simulation
from solver.step.settings import IntegratorSettings

TWISTED, LIVE, BOTH = 'compact_fwd', 'pickup_awd', 'live axles, the front one steered'


@functools.cache
def levels(name: str) -> tuple[Scene, Scene]:
    """(a scene on a flat road, what is simulated of it at the level kc)."""
    if name == BOTH:
        full = live_axle_cars.scene(live_axle_cars.off_roader())
    else:
        full = solver.load_scene('car_swept_steer', [f'vehicle=vehicles/{name}.yaml'])
    full = dataclasses.replace(full, model=dataclasses.replace(full.model, road=RoadSpec()))
    return full, derive(dataclasses.replace(full, fidelity='kc')).scene


def test_a_live_axle_is_divided_into_wheels_and_what_they_share():
    """By hand: 200 kg on a track of 1.6 m, wheels of 30 kg and 1.2 kg m^2 about a diameter at its ends, a beam of 140
    kg and 8 kg m^2. It turns by (s_l - s_r)/1.6, so the mass matrix has 200/4 +- I/1.6^2 with I = 2 (30 0.8^2 + 1.2) +
    8 = 48.8; wheels have to make what of I is not theirs by turning, 2 (48.8 - 2.4)/1.6^2 = 36.25 kg each, and the rest
    is shared."""
    own, other = (np.array([[0.0, 0.0, 0.0, side / 1.6], [0.0, 0.0, 0.0, -side / 1.6]]) for side in (1.0, -1.0))
    wheels, shared = divided(np.full(2, 1.2), own, other, np.full(2, 50.0 + 48.8 / 2.56), 50.0 - 48.8 / 2.56)
    assert [*wheels, shared] == pytest.approx([36.25, 36.25, 127.5])


@pytest.mark.slow
def test_a_rolled_live_axle_steers_as_that_of_the_vehicle() -> None:
    """Up on one side, down on the other, and steered to either side: turn and lift of both wheels within 1 % of the
    largest. Bump turns its kingpins, roll does not: as if it did, they were 2 % off."""
    places = [(turn, up) for turn in (-2.0, 2.0) for up in (-0.04, 0.04)]
    wanted, found = (
        np.array([
            [stood.x[corner][2:4] for corner in ('front_left', 'front_right')]
            for stood in (bench.stand(steering=turn, travel_front_left=up, travel_front_right=-up) for turn,
            up in places)
        ])
        for bench in (maps.Bench(scene.model) for scene in levels(BOTH))
    )  # fmt: skip
    assert (np.abs(found - wanted) <= 0.01 * np.abs(wanted).max(axis=(0, 1))).all()


@pytest.mark.slow
@pytest.mark.parametrize('name', [TWISTED, LIVE])
def test_wheels_that_share_mass_move_with_it(name):
    """The mass that the travel of one wheel moves and that between both, and with them the modes of the car: roll
    within 1 % of its frequency, bounce and pitch, in which the engine moves on its mounts, within 4 %."""
    full, kc = levels(name)
    assert any(body.name == 'bounce_rear' for body in kc.model.bodies)
    benches = [maps.Bench(dataclasses.replace(scene.model, road=RoadSpec())) for scene in (full, kc)]
    wanted, found = (maps._masses(bench, bench.stand())['rear_left'] for bench in benches)
    assert found['travel'] == pytest.approx(wanted['travel'], rel=0.01)
    assert found['beside'] == pytest.approx(wanted['beside'], abs=0.01 * wanted['travel'])
    wanted, found = (
        named_modes(Simulation(dataclasses.replace(scene, start=StartSettings(kind='equilibrium'))))
        for scene in (full, kc)
    )
    for mode, share in (('bounce', 0.04), ('pitch', 0.04), ('roll', 0.01)):
        assert found[mode].frequency == pytest.approx(wanted[mode].frequency, rel=share), mode


def test_a_live_axle_off_its_design_height_steers_as_it_does_there():
    """Raised and rolled, in bump and in rebound: places and angles of its wheels within 2 % of the largest, as motions
    have to be. Maps linear in the travel of the other wheel were off by half of the steer."""
    stood = [(0.06, 0.02), (0.02, 0.06), (-0.06, -0.02), (-0.02, -0.06), (0.06, 0.06), (-0.06, -0.06), (0.06, -0.06)]
    wanted, found = (
        np.array([
            [bench.stand(travel_rear_left=left, travel_rear_right=right).x[corner][:4] for corner in ('rear_left',
            'rear_right')]
            for left, right in stood
        ])
        for bench in (maps.Bench(scene.model) for scene in levels(LIVE))
    )  # fmt: skip
    assert (np.abs(found - wanted) <= 0.02 * np.abs(wanted).max(axis=(0, 1))).all()


@pytest.mark.slow
def test_dampers_of_a_live_axle_move_with_both_wheels() -> None:
    """They stand at 0.46 m of the half track of 0.79 m: that of the other wheel moves by (1 - 0.58)/(1 + 0.58) = 27 %
    of the own one."""
    guide = next(g for g in levels(LIVE)[1].model.guides if g.name == 'rear')
    for crossing, ratio in zip(guide.crossings, guide.ratios[::5]):
        assert crossing / ratio == pytest.approx((1.0 - 0.46 / 0.79) / (1.0 + 0.46 / 0.79), rel=0.05)
    assert all(
        abs(crossing) < 1e-2
        for crossing in next(g for g in levels(LIVE)[1].model.guides if g.name == 'front').crossings
    )


@pytest.mark.parametrize('axis', [0, 1, 2])
def test_what_both_wheels_share_is_pushed_by_each_of_them_in_every_direction(axis: int) -> None:
    """Wheels of 10 kg and 40 kg in the middle between them: m = [[20, 10], [10, 20]] over both, so 30 N on the left one
    alone make 30/300 (20, -10) = (2, -1) m/s^2, 0.5 in the middle, and nothing at the chassis."""
    chassis, *wheels = (RigidBodySpec(name=n, mass=m, inertia=(1.0, 1.0, 1.0, 0.0, 0.0, 0.0),
    position=(0.0, y, 0.0)) for n, m, y in
                        (('chassis', 1000.0, 0.0), ('left', 10.0, 0.8), ('right', 10.0, -0.8)))  # fmt: skip
    one = beam('beam', 40.0, chassis, [(wheel, np.array(wheel.position)) for wheel in wheels])
    force = tuple(30.0 * (k == axis) for k in range(3))
    model = ModelSpec(
        bodies=(chassis, *wheels, one.body), joints=one.joints, couplers=(one.coupler,), coordinates=one.coordinates,
        applied_forces=(AppliedForceSpec(name='push', marker=Marker(body='left'), force=force),),
        gravity=(0.0, 0.0, 0.0), chassis='chassis',
    )  # fmt: skip
    h = 1e-4
    shot = Simulation(Scene(name='beam', model=model, integrator=IntegratorSettings(h=h, iterations=3))).advance(1)
    np.testing.assert_allclose(shot.twist[:, axis] / h, [0.0, 2.0, -1.0, 0.5], atol=1e-6)
    np.testing.assert_allclose(np.delete(shot.twist[:, :3], axis, axis=1) / h, 0.0, atol=1e-4)


def test_a_live_axle_carries_itself_sideways() -> None:
    """On the bench at 1 m/s^2 to the side: its wheels give way by their compliance under the mass of both and of what
    they share, of which nothing hangs on the chassis."""
    kc = levels(LIVE)[1].model
    mass = {body.name: body.mass for body in kc.bodies}
    each = mass['wheel_rear_left'] + 0.5 * mass['bounce_rear']
    assert mass['bounce_rear'] > 80.0
    guide = next(g for g in kc.guides if g.name == 'rear')
    C = np.linalg.inv(np.array(guide.stiffness).reshape(8, 8))
    left, right = (maps.Bench(dataclasses.replace(kc, gravity=(0.0, g, kc.gravity[2]))).stand() for g in (1.0, -1.0))
    found = np.concatenate([0.5 * (left.x[c] - right.x[c])[:4] for c in ('rear_left', 'rear_right')])
    wanted = each * (C[:, 1] + C[:, 5])
    np.testing.assert_allclose(found[[1, 2, 5, 6]], wanted[[1, 2, 5, 6]], rtol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize('name', [LIVE, BOTH])
def test_gradients_of_understeer_and_roll_are_those_of_the_vehicle(name: str) -> None:
    """A slow ramp of the steering wheel (ISO 4138): within 1 %. With what moves with both wheels on the chassis
    sideways the understeer of the pickup was 2 % off, and the roll of the car on two live axles 4 %; with steering that
    is the same in roll and in bump its understeer 2 %."""
    ratio = kinematic_figures(Rig(levels(name)[0].model))['steering_ratio']
    wanted, found = (steady_figures(scene.model, ratio) for scene in levels(name))
    for figure in ('understeer_gradient', 'roll_gradient'):
        assert found[figure] == pytest.approx(wanted[figure], rel=0.01), figure


def bent(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """(loads of the wheels at rest, load moved to the outer wheel by either axle per lateral acceleration [N s^2/m]) in
    a steady bend."""
    maneuver = Maneuver(steering=Step(value=0.5, start=0.2, rise=1.0), drive_torque=200.0)
    settings = IntegratorSettings(h=2e-3, iterations=2)
    start = StartSettings(kind='equilibrium', speed=20.0)
    run = Simulation(dataclasses.replace(scene, maneuver=maneuver, start=start, integrator=settings))
    rest = Simulation(dataclasses.replace(scene, start=StartSettings(kind='equilibrium'))).snapshot().tire[:, 2]
    shot = run.advance(2000)
    load, chassis = shot.tire[:, 2], run.channels.chassis
    aside = float(np.hypot(*shot.twist[chassis, :2]) * shot.twist[chassis, 5])
    assert aside > 2.0
    return rest, np.array([load[1] - load[0], load[3] - load[2]]) / aside


@pytest.mark.slow
@pytest.mark.parametrize('name', [LIVE, BOTH])
def test_axles_take_their_part_of_the_load_that_a_bend_moves(name: str) -> None:
    """Wheel loads at rest and what a bend at 20 m/s moves on either axle within 1 %: of an axle that is pushed where it
    is nothing goes through its springs."""
    (rest, moved), (rest_kc, moved_kc) = (bent(scene) for scene in levels(name))
    np.testing.assert_allclose(rest_kc, rest, rtol=0.01)
    np.testing.assert_allclose(moved_kc, moved, rtol=0.01)
