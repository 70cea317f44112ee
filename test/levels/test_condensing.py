"""The rules of the level `condensed`: what they keep exactly, whatever the vehicle, and what each makes of the parts it
finds."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from solver.analysis.figures import mass_figures
from solver.elements.bushing import BushingSpec
from solver.elements.joint import JointSpec
from solver.elements.laws import Law
from solver.elements.marker import Marker
from solver.elements.rigid_body import RigidBodySpec
from solver.files.scene import load_scene, load_scene_text
from solver.levels.columns import _all_columns, _harmonics
from solver.levels.compliance import in_series
from solver.levels.condensed import condensed
from solver.levels.derived import channels
from solver.levels.draft import Draft
from solver.levels.merging import merge_stiff, slowest
from solver.model.compile import compile_model
from solver.model.spec import ModelSpec

SECOND_CAR = 'vehicles/wishbone_car.yaml'


def vehicle(name: str) -> ModelSpec:
    if name == 'wishbone_car':
        return load_scene_text(f'vehicle: {SECOND_CAR}', 'wishbone car').model
    return load_scene(name).model


@pytest.fixture(scope='module', params=['car_step_steer', 'wishbone_car', 'light_car_step_steer'])
def pair(request: pytest.FixtureRequest) -> tuple[ModelSpec, ModelSpec]:
    """(a vehicle, the same condensed)."""
    full = vehicle(request.param)
    return full, condensed(full)[0]


def test_mass_first_moment_and_inertia_are_kept(pair: tuple[ModelSpec, ModelSpec]) -> None:
    """Mass and centre of mass to rounding; inertia but for what shafts lose that are not parallel to what they turn
    with: 1e-6."""
    before, after = (mass_figures(model) for model in pair)
    for name in ('mass', 'com_x', 'com_y', 'com_z', 'wheelbase', 'track_front', 'track_rear', 'front_share'):
        assert after[name] == pytest.approx(before[name], rel=1e-12, abs=1e-12), name
    for name in ('roll_inertia', 'pitch_inertia', 'yaw_inertia'):
        assert after[name] == pytest.approx(before[name], rel=1e-6), name


def test_wheels_steering_and_travels_are_published_as_by_the_vehicle(pair: tuple[ModelSpec, ModelSpec]) -> None:
    full, less = (set(channels(model)) for model in pair)
    corners = [f'{axle}_{side}' for axle in ('front', 'rear') for side in ('left', 'right')]
    wanted = {
        f'{what}{corner}'
        for what in ('joint wheel_', 'joint travel_', 'wheel ', 'element brake_')
        for corner in corners
    }
    assert wanted | {'joint rack', 'joint steering_wheel', 'body chassis'} <= less
    if 'element rack_and_pinion' in full:
        assert {
            'element damper_front_left',
            'element damper_rear_right',
            'element rack_and_pinion',
            'element anti_roll_bar_front',
        } <= less


def test_it_compiles_to_fewer_of_everything_and_twice_to_the_same(pair: tuple[ModelSpec, ModelSpec]) -> None:
    full, less = pair
    assert condensed(full)[0] == less
    large, small = compile_model(full), compile_model(less)
    assert small.n_bodies <= large.n_bodies
    assert small.n_rows <= large.n_rows
    if full.bushings:
        assert small.n_bodies <= 0.45 * large.n_bodies
        assert small.n_rows <= 0.3 * large.n_rows
        assert small.n_slots <= 0.5 * large.n_slots


def test_nothing_is_left_for_a_second_pass(pair: tuple[ModelSpec, ModelSpec]) -> None:
    assert condensed(pair[1])[0] == pair[1]


def test_what_is_lost_is_named() -> None:
    lost = condensed(vehicle('car_step_steer'))[1]
    for part in (
        'differential',
        'half_shaft_rear_left',
        'propshaft_rear',
        'steering_pinion',
        'anti_roll_bar_front_left',
        'tie_rod_front_left',
    ):
        assert any(part in text for text in lost), part


def test_a_bar_without_stiffness_is_slack_and_one_with_little_nearly_so() -> None:
    """A spring of no rate in series with the bending of the bar has no rate; one of 1e-3 N m/rad keeps it to the
    softness of the rest."""
    rates = []
    for stiffness in ('0', '1e-3'):
        scene = load_scene(
            'car_step_steer',
            ['vehicle=vehicles/compact_fwd.yaml', f'vehicle.axles.front.anti_roll_bar.stiffness={stiffness}'],
        )
        (bar,) = (force for force in condensed(scene.model)[0].coordinate_forces if force.name == 'anti_roll_bar_front')
        assert bar.spring is not None
        rates.append(bar.spring.slope[0])
    assert rates[0] == 0.0
    assert rates[1] == pytest.approx(1e-3, rel=1e-5)


def test_a_rigid_and_a_stiff_mounting_are_merged_and_a_soft_one_is_not() -> None:
    """10 kg on 4e6 N/m: sqrt(4e5)/2 pi = 100.7 Hz; in rotation 1 kg m^2 on 9e5 N m/rad: 151 Hz."""
    bodies = (
        RigidBodySpec(name='base', mass=1000.0, inertia=(100.0, 200.0, 200.0, 0.0, 0.0, 0.0)),
        RigidBodySpec(name='part', mass=10.0, inertia=(1.0, 1.0, 1.0, 0.0, 0.0, 0.0), position=(1.0, 0.0, 0.0)),
    )
    mount = BushingSpec(
        name='mount',
        i=Marker(body='base', position=(1.0, 0.0, 0.0)),
        j=Marker(body='part'),
        stiffness=(4e6, 5e6, 6e6, 9e5, 9e5, 9e5),
    )
    model = ModelSpec(bodies=bodies, bushings=(mount,), chassis='base')
    assert slowest(Draft(model), 'part', ['mount']) == pytest.approx(math.sqrt(4e5) / (2.0 * math.pi), rel=1e-9)
    for mass, inertia, free, wanted in (
        (0.0, 1.0, {}, math.sqrt(9e5)),  # what has no mass does not vibrate in translation
        (10.0, 0.0, {}, math.sqrt(4e5)),
        (0.0, 0.0, {}, math.inf),
        (0.0, 1.0, {'stiffness': (4e6, 5e6, 6e6, 9e5, 9e5, 0.0)}, 0.0),  # nor where next to nothing holds it
        (10.0, 0.0, {'stiffness': (4e6, 5e6, 6e6, 9e5, 9e5, 0.0)}, 0.0),
    ):
        part = dataclasses.replace(bodies[1], mass=mass, inertia=(inertia, inertia, inertia, 0.0, 0.0, 0.0))
        draft = Draft(
            ModelSpec(bodies=(bodies[0], part), bushings=(dataclasses.replace(mount, **free),), chassis='base')
        )
        assert 2.0 * math.pi * slowest(draft, 'part', ['mount']) == pytest.approx(wanted, rel=1e-9, abs=1e-4)
    for threshold, left in ((100.0, 1), (101.0, 2)):
        draft = Draft(model)
        merge_stiff(draft, threshold)
        assert len(draft.bodies) == left
    ideal = ModelSpec(
        bodies=bodies, joints=(JointSpec(name='weld', kind='fixed', i=mount.i, j=mount.j),), chassis='base'
    )
    merged, _ = condensed(ideal)
    (body,) = merged.bodies
    assert body.mass == 1010.0
    assert body.com[0] == pytest.approx(10.0 / 1010.0)
    # reduced mass times the square of the distance
    assert body.inertia[1] == pytest.approx(200.0 + 1.0 + 10.0 * 1000.0 / 1010.0)


def test_equal_mounts_are_one_at_their_centre() -> None:
    """Two of 1e5 N/m 0.6 m apart: 2e5 N/m, and about the other two axes 2 * 1e5 * 0.3^2 = 1.8e4 N m/rad more."""
    bodies = tuple(
        RigidBodySpec(name=name, mass=mass, inertia=(mass, mass, mass, 0.0, 0.0, 0.0))
        for name, mass in (('base', 1000.0), ('engine', 200.0))
    )
    law = Law.table([[-0.01, -3e3], [0.0, 0.0], [0.01, 3e3]])
    mounts = tuple(
        BushingSpec(
            name=side, i=Marker(body='base', position=(0.0, y, 0.1)), j=Marker(body='engine', position=(0.0, y, 0.1)),
            stiffness=(1e5,) * 3 + (50.0,) * 3, damping=(100.0,) * 3 + (1.0,) * 3,
            laws=(None, None, law, None, None, None),
        )
        for side, y in (('left', 0.4), ('right', -0.2))
    )  # fmt: skip
    model, _ = condensed(ModelSpec(bodies=bodies, bushings=mounts, chassis='base'))
    (joined,) = model.bushings
    assert joined.i.position == pytest.approx((0.0, 0.1, 0.1))
    across = law.slope[1] * 2 * 0.3**2
    assert joined.stiffness == pytest.approx((2e5, 2e5, 2e5, 100.0 + across, 100.0, 100.0 + 1.8e4))
    assert joined.damping[5] == pytest.approx(2.0 + 2 * 100.0 * 0.3**2)
    assert joined.laws[2].y[-1] == pytest.approx(6e3)


def test_laws_in_series_add_extensions_under_a_common_force() -> None:
    """Along a line between two axes: a force of 100 N puts 60 N on one axis and 80 N on the other."""
    stop = Law.table([[-2.0, -300.0], [-1.0, -100.0], [0.0, 0.0], [1.0, 100.0], [2.0, 300.0]])
    law = in_series([(stop, 0.6), (Law.linear(200.0), 0.8)])
    knot = 100.0 / 0.6
    at = law.y.index(pytest.approx(knot))
    assert law.x[at] == pytest.approx(0.6 * 1.0 + 0.8 * 0.8 * knot / 200.0)
    assert law.x[law.y.index(0.0)] == pytest.approx(0.0, abs=1e-12)
    straight = in_series([(Law.linear(200.0), 0.6), (Law.linear(50.0), 0.8)])
    assert straight.slope[0] == pytest.approx(1.0 / (0.36 / 200.0 + 0.64 / 50.0))


def test_two_universal_joints_lead_and_lag_as_their_closed_form() -> None:
    """With angles b, c of the shaft to wheel and pinion, pins normal to the planes of the joints: tan(pinion) =
    cos(b)/cos(c) tan(wheel), which is x + q sin 2x + q^2/2 sin 4x + ... with q = (r - 1)/(r + 1), r = cos(b)/cos(c)."""
    draft = Draft(vehicle('wishbone_car'))
    (column,) = _all_columns(draft)
    shaft = draft.placed(column.upper.i).p - draft.placed(column.lower.i).p
    r = abs(column.near.frame.R[:, 2] @ shaft) / abs(column.far.frame.R[:, 2] @ shaft)
    q = (r - 1.0) / (r + 1.0)
    harmonics, sense = _harmonics(draft, column)
    assert sense == 1.0
    assert abs(q) > 0.01
    np.testing.assert_allclose(harmonics, [q, 0.0, 0.5 * q * q, 0.0], atol=1e-12)


def test_a_steering_column_that_no_rule_reduces_stays_whole() -> None:
    """A telescope between two universal joints is no strut: what it turns would be cut off."""
    full = vehicle('wishbone_car')
    forces = tuple(f.replace(preload=1.0) if f.name == 'rack_and_pinion' else f for f in full.coordinate_forces)
    less, _ = condensed(dataclasses.replace(full, coordinate_forces=forces))
    assert {'steering_joint_lower', 'steering_slide', 'steering_joint_upper', 'steering_pinion'} <= {
        joint.name for joint in less.joints
    }
    assert {'steering_shaft_lower', 'steering_shaft_upper', 'steering_pinion'} <= {body.name for body in less.bodies}


def test_it_needs_no_names_of_templates() -> None:
    """All bodies and joints renamed: the same numbers of parts."""
    full = vehicle('car_step_steer')

    def renamed(value: object, names: dict[str, str]) -> object:
        if isinstance(value, Marker):
            return dataclasses.replace(value, body=names.get(value.body, value.body))
        return value

    names = {body.name: f'b{k}' for k, body in enumerate(full.bodies)}
    sections = {
        section: tuple(
            spec.replace(
                **{f.name: renamed(getattr(spec, f.name), names) for f in dataclasses.fields(spec) if f.name != 'name'}
            )
            for spec in specs
        )
        for section, specs in full.sections().items()
    }
    sections['bodies'] = tuple(body.replace(name=names[body.name]) for body in full.bodies)
    other = dataclasses.replace(full, **sections, chassis=names[str(full.chassis)])
    counts = [
        {section: len(specs) for section, specs in condensed(model)[0].sections().items()} for model in (full, other)
    ]
    assert counts[0] == counts[1]
