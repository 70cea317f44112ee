"""A vehicle that is placed elsewhere goes on as it would have, turned and moved: a symmetry of the equations on a flat
road."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest

import solver
from mbd_sim_ros.bags.applied import begin_of
from solver.analysis.verdict import findings
from solver.elements.aero_drag import AeroDragSpec
from solver.elements.applied_force import AppliedForceSpec
from solver.elements.bushing import BushingSpec
from solver.elements.contact import ContactSpec
from solver.elements.coordinate import CoordinateSpec
from solver.elements.joint import JointSpec
from solver.elements.laws import Law
from solver.elements.marker import Marker
from solver.elements.rigid_body import RigidBodySpec
from solver.elements.road import RoadSpec
from solver.elements.road_grids import FrictionMap, Raster
from solver.elements.rod import RodSpec
from solver.elements.spring_damper import SpringDamperSpec
from solver.errors import SpecError
from solver.files.scene import load_scene
from solver.model.spec import ModelSpec
from solver.start.displacement import require_free, require_uniform, sight

THERE = (120.0, -40.0, 2.2)


def turned(numbers: np.ndarray, by: float) -> np.ndarray:
    """Vectors (n, 3) turned about the vertical."""
    c, s = math.cos(by), math.sin(by)
    return numbers @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T


def test_a_driver_sees_the_reference_frame_and_not_the_centre_of_mass():
    """Turned by 90 degrees to the left, centre of mass at (0.5, 0.2, 0.3) in the body: (-0.2, 0.5) from the frame in
    the world. Its x axis is y of the world: 2 m/s, and 0.02 more because the frame turns about the centre of mass:
    -(0.2 0.3 - 0.4 0.2)."""
    q = np.array([10.0, 20.0, 1.0, 0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)])
    seen = sight(q, np.array([1.0, 2.0, 3.0, 0.1, 0.2, 0.4]), (0.5, 0.2, 0.3))
    assert seen == pytest.approx((10.2, 19.5, 0.5 * math.pi, 2.02), rel=1e-14)


@pytest.mark.parametrize('overrides', [[], ['fidelity=single_track']], ids=['whole', 'single_track'])
def test_a_place_at_which_the_parts_would_lose_their_lengths_is_refused_and_changes_nothing(overrides):
    """At 1e300 m all parts would be in one point, and stay so when the vehicle is placed back. At 1e7 m lengths are
    rounded to 2e-9 m."""
    sim = solver.simulation_of(load_scene('light_car_step_steer', overrides))
    saved = sim.save()
    for x, y in ((1e300, 0.0), (0.0, -1.1e7), (math.inf, 0.0), (math.nan, 0.0)):
        with pytest.raises(SpecError, match=r'a vehicle can be placed within 1e\+07 m of the origin'):
            sim.place(x, y, 0.0)
    assert sim.save() == saved
    sim.place(1e7, -1e7, 0.0)
    assert sim.snapshot().pose[sim.channels.chassis, :2].tolist() == pytest.approx([1e7, -1e7], abs=1e-8)


@pytest.mark.parametrize('overrides', [[], ['fidelity=single_track']], ids=['whole', 'single_track'])
def test_the_motion_goes_on_in_its_own_axes(overrides):
    sims = [solver.simulation_of(load_scene('light_car_step_steer', overrides)) for _ in range(2)]
    for sim in sims:
        sim.advance(1300)  # it turns
    before = sims[0].snapshot()
    chassis = sims[0].channels.chassis
    x, y, *_ = before.pose[chassis]
    qx, qy, qz, qw = before.pose[chassis, 3:]
    heading = math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
    sims[1].place(*THERE)
    placed = sims[1].snapshot()
    np.testing.assert_allclose(placed.pose[chassis, :2], THERE[:2], atol=1e-12)
    one, other = (sim.advance(400) for sim in sims)
    by = THERE[2] - heading
    expected = turned(one.pose[:, :3] - (x, y, 0.0), by) + (THERE[0], THERE[1], 0.0)
    # rounding of places of 100 m, and its growth in 0.4 s
    np.testing.assert_allclose(other.pose[:, :3], expected, atol=1e-9)
    np.testing.assert_allclose(other.twist, one.twist, atol=1e-8)
    np.testing.assert_allclose(other.tire[:, :6], one.tire[:, :6], atol=1e-3)
    np.testing.assert_allclose(other.imu, one.imu, atol=1e-6)


@pytest.mark.parametrize('overrides', [[], ['fidelity=single_track']], ids=['whole', 'single_track'])
def test_what_is_placed_or_renumbered_is_not_suspect_for_it(overrides):
    """Of every step there was an account: that of before, which ended, and that of now. A saved state tells of both."""
    sim, again = (solver.simulation_of(load_scene('light_car_step_steer', overrides)) for _ in range(2))
    sim.advance(1300)
    sim.place(*THERE)
    sim.advance(100)
    again.restore(sim.save())
    assert findings(sim) == findings(again) == []
    sim.advance(100, audit=False)
    assert [finding.quantity for finding in findings(sim)] == ['unseen']
    again.reset()
    again.renumber(1400)
    assert again.t_ns == 1400 * again.h_ns and again.displaced
    again.advance(100)
    assert findings(again) == []


@pytest.mark.parametrize('overrides', [[], ['fidelity=single_track']], ids=['whole', 'single_track'])
def test_a_restored_state_is_none_of_the_start_although_its_step_is_0(overrides):
    """A recording that begins with it has to hold it. What comes out of another process is as it was."""
    sims = [solver.simulation_of(load_scene('light_car_step_steer', overrides)) for _ in range(2)]
    sims[0].place(*THERE)
    sims[1].restore(sims[0].save())
    assert sims[1].k == 0 and 'start_state' in begin_of(sims[1])
    for sim in sims:
        again = pickle.loads(pickle.dumps(sim))
        assert again.displaced
        again.reset()
        assert not again.displaced and 'start_state' not in begin_of(pickle.loads(pickle.dumps(again)))


@pytest.mark.parametrize('overrides', [[], ['fidelity=single_track']], ids=['whole', 'single_track'])
def test_a_motion_at_another_time_shows_what_its_saved_state_shows(overrides):
    """What a recording begins with is shown by a step in the one, and by nothing but the state in the other."""
    sim, again = (solver.simulation_of(load_scene('light_car_step_steer', overrides)) for _ in range(2))
    sim.advance(1300)
    sim.renumber(0)
    again.restore(sim.save())
    assert again.snapshot().numbers.tobytes() == sim.snapshot().numbers.tobytes()
    assert again.advance(20).numbers.tobytes() == sim.advance(20).numbers.tobytes()
    assert findings(sim) == findings(again) == []


def test_a_road_that_is_not_the_same_everywhere_is_refused():
    sim = solver.simulation_of(
        load_scene('light_car_straight', ['road={patches: [{center: [15, 0], size: [10, 4], factor: 0.5}]}'])
    )
    with pytest.raises(SpecError, match='on a flat road only'):
        sim.place(0.0, 0.0, 0.0)


def test_so_is_one_whose_friction_is_mapped():
    ice = FrictionMap(origin=(0.0, 0.0), step=(10.0, 10.0), raster=Raster.of(np.array([[1.0, 0.2], [1.0, 0.2]])))
    with pytest.raises(SpecError, match='this one has a slope, patches, maps or grids'):
        require_uniform(RoadSpec(maps=(ice,)))


@pytest.mark.parametrize(
    ('scene', 'by'),
    [
        ('pendulum', "Joint 'pivot'"),
        ('four_bar', "Joint 'crank'"),
        ('slider_crank', "Joint 'base'"),
        ('spring_mass', "Joint 'guide'"),
        ('spinning_top', "Joint 'tip'"),
    ],
)
def test_what_is_connected_to_the_world_is_refused_and_stays(scene, by):
    sim, undisturbed = (solver.simulation_of(load_scene(scene)) for _ in range(2))
    with pytest.raises(SpecError, match=f'it is attached to the world by {by}; give its place in the scene instead'):
        sim.place(*THERE)
    assert not sim.displaced
    assert sim.advance(20).numbers.tobytes() == undisturbed.advance(20).numbers.tobytes()


def tied(body: str = 'body', **elements: object) -> ModelSpec:
    bodies = (RigidBodySpec(name=body, mass=1.0, inertia=(1.0, 1.0, 1.0, 0.0, 0.0, 0.0)),)
    return ModelSpec(bodies=bodies, **elements)


WORLD, BODY = Marker(body='world'), Marker(body='body')
LEANING = Marker(body='world', orientation=(math.sin(0.05), 0.0, 0.0, math.cos(0.05)))  # 0.1 rad about x


@pytest.mark.parametrize(
    ('elements', 'by'),
    [
        ({'spring_dampers': (SpringDamperSpec(name='s', i=WORLD, j=BODY, free_length=1.0),)}, "SpringDamper 's'"),
        ({'bushings': (BushingSpec(name='b', i=BODY, j=WORLD, stiffness=(1.0,) * 6),)}, "Bushing 'b'"),
        ({'rods': (RodSpec(name='r', i=BODY, j=WORLD, length=1.0, law=Law.linear(1.0)),)}, "Rod 'r'"),
        ({'coordinates': (CoordinateSpec(name='x', kind='translation', i=WORLD, j=BODY),)}, "Coordinate 'x'"),
        ({'joints': (JointSpec(name='p', kind='point_on_plane', i=LEANING, j=BODY),)}, "Joint 'p'"),
        ({'joints': (JointSpec(name='p', kind='point_on_plane', i=BODY, j=WORLD),)}, "Joint 'p'"),
        ({'contacts': (ContactSpec(name='c', kind='rolling', i=LEANING, j=BODY, radius=0.5),)}, "Contact 'c'"),
    ],
)
def test_every_element_with_a_side_in_the_world_is_named(elements, by):
    with pytest.raises(SpecError, match=by):
        require_free(tied(**elements))


@pytest.mark.parametrize(
    'elements',
    [
        {'contacts': (ContactSpec(name='c', kind='rolling', i=WORLD, j=BODY, radius=0.5),)},
        {'joints': (JointSpec(name='p', kind='perpendicular', i=BODY, j=WORLD),)},
        {'applied_forces': (AppliedForceSpec(name='wind', marker=BODY, reaction=WORLD, force=(0.0, 5.0, 0.0)),)},
        {'aero_drags': (AeroDragSpec(name='air', marker=BODY, drag_area=0.7),)},
    ],
)
def test_what_a_level_ground_and_the_air_do_is_the_same_everywhere(elements):
    require_free(tied(**elements))


@pytest.mark.parametrize('scene', ['rolling_disc', 'chaplygin_sleigh'])
def test_what_rolls_or_slides_on_a_level_ground_goes_on_in_its_own_axes(scene):
    """Under gravity along z alone; the disc nods, the sleigh stops turning."""
    one, other = (solver.simulation_of(load_scene(scene)) for _ in range(2))
    for sim in (one, other):
        sim.advance(200)
    before = one.snapshot().pose[0]
    seen = sight(one.state.q[0], one.state.v[0], one.model.spec.bodies[0].com)
    other.place(*THERE)
    after = [sim.advance(200) for sim in (one, other)]
    expected = turned(after[0].pose[:, :3] - (*before[:2], 0.0), THERE[2] - seen.heading) + (THERE[0], THERE[1], 0.0)
    np.testing.assert_allclose(after[1].pose[:, :3], expected, atol=1e-7)
    np.testing.assert_allclose(after[1].twist, after[0].twist, atol=1e-6)


def test_on_an_inclined_plane_a_plate_on_a_blade_can_be_placed():
    """The slope is in gravity: the plate stands on it wherever it is, and goes another way with another heading."""
    sim = solver.simulation_of(load_scene('knife_edge'))
    sim.advance(100)
    sim.place(*THERE)
    pose = sim.advance(100).pose[0]
    assert np.hypot(*(pose[:2] - THERE[:2])) < 1.0
    assert abs(pose[2]) < 1e-6


def test_a_reset_leads_back_to_the_start():
    sim = solver.simulation_of(load_scene('light_car_straight'))
    expected = sim.advance(20).numbers
    sim.place(*THERE)
    sim.reset()
    assert not sim.displaced
    assert sim.advance(20).numbers.tobytes() == expected.tobytes()
