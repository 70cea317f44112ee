"""Scene files: found, composed, overridden, resolved into one text, and refused with the place of a mistake."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from solver.elements.joint import JointSpec
from solver.errors import SceneError
from solver.files.naming import included
from solver.files.scene import known_names, load_maneuver, load_scene, load_scene_text
from solver.files.yaml_tree import read
from solver.model.frames import matrix

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize('name', known_names())
def test_resolved_scene_loads_again_to_the_same_scene(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = load_scene(name)
    monkeypatch.chdir(tmp_path)  # nothing but the text is needed
    again = load_scene_text(scene.resolved, 'elsewhere')
    assert again == scene
    assert again.resolved == scene.resolved


@pytest.mark.parametrize('name', known_names('maneuvers'))
def test_maneuver_files_load(name: str) -> None:
    maneuver = load_maneuver(name)
    assert maneuver.name == name
    if not maneuver.closed_loop:  # the others depend on the motion
        assert np.isfinite(maneuver.commands(3.0)).all()


def test_slider_crank_is_the_one_of_the_chapter() -> None:
    model_ = load_scene('slider_crank').model
    assert len(model_.bodies) == 4
    assert sorted(j.kind for j in model_.joints) == ['fixed', 'prismatic', 'revolute', 'revolute', 'revolute']
    assert sum(len(JointSpec.row_names(j)) for j in model_.joints) == 26


def test_overrides_are_checked_like_the_file_and_are_in_the_resolved_text() -> None:
    scene = load_scene(
        'slider_crank',
        ['integrator.h=2e-3', 'mechanism.bodies.slider.mass=0.02', 'mechanism.bodies.crank.com[0]=0.4', 'title=other'],
    )
    assert (scene.integrator.h_ns, scene.model.bodies[3].mass, scene.model.bodies[1].com[0], scene.title) == (
        2_000_000,
        0.02,
        0.4,
        'other',
    )
    assert load_scene_text(scene.resolved) == scene
    assert load_scene('slider_crank', ['start={}']).start.coordinates == {}


@pytest.mark.parametrize(
    ('override', 'says'),
    [
        ('integrator.hh=1', "--set integrator.hh: integrator.hh: unknown key; did you mean 'h'?"),
        ('integrator.h=fast', '--set integrator.h: integrator.h = fast: must be a number'),
        ('integrator.h=1.5e-9', 'must be a whole number of nanoseconds'),
        ('integrator.rho_inf=1.2', '--set integrator.rho_inf: integrator.rho_inf = 1.2: must be in [0, 1]'),
        ('duration', 'write it as path.to.key=value'),
        ('duration.x=1', 'is a plain value'),
        (
            'duration=0.0004',
            '--set duration: duration = 0.0004: makes no step of 0.001 s; take longer, or a smaller integrator.h',
        ),
        ('mechanism.bodies.crank.com[3]=1', 'is a list of 3'),
        ('start.coordinates.slid.rate=1', "did you mean 'slide'?"),
        ('maneuver=maneuvers/step_stear.yaml', "did you mean 'maneuvers/step_steer.yaml'?"),
        ('maneuver=maneuvers/step_steer.yaml', "step_steer.yaml:2: maneuver = 'steering': the model has no such input"),
        ('maneuver.signals.moter=1', 'the model has no such input'),
        ('vehicle={}', 'exactly one of the keys'),
        (
            'mechanism.bodies.crnk.mass=1',
            "mechanism.bodies.crnk: the key 'inertia' is missing in what is new there; did you mean 'crank'?",
        ),
        (
            'maneuver.signals={motor: drive.csv}',
            'motor = drive.csv: must be a number or a mapping; files that can stand for their content end',
        ),
        ('start.speed_kph=50', "start.speed_kph: unknown key; did you mean 'speed_kmh'?"),
        ('mechanism.bodies.crank.com_mm[0]=1', "'com' is given twice, as 'com' and as 'com_mm'; keep one of them"),
    ],
)
def test_a_wrong_override_is_refused(override: str, says: str) -> None:
    with pytest.raises(SceneError, match=re.escape(says)):
        load_scene('slider_crank', [override])


TWINS = """
mechanism:
  bodies:
    left: &arm {mass: 1, inertia: [0.01, 0.01, 0.01], com: [0, 0, -1]}
    right: *arm
  joints:
    a: &hinge {kind: revolute, i: world, j: left, at: [0, 0, 0], axis: [0, 1, 0]}
    b: {kind: revolute, i: world, j: right, at: &place [0, 1, 0], axis: *place}
"""


def test_an_override_changes_one_place_and_no_alias_of_it() -> None:
    overrides = ['mechanism.bodies.left.mass=5', 'mechanism.bodies.right.com[2]=-2', 'mechanism.joints.b.at.0=0.5']
    scene = load_scene_text(TWINS, 'twins', overrides)
    left, right = scene.model.bodies
    assert (left.mass, left.com[2], right.mass, right.com[2]) == (5.0, -1.0, 1.0, -2.0)
    hinge = scene.model.joints[1].i
    assert hinge.position == (0.5, 1.0, 0.0)
    # the axis is the alias of the place
    np.testing.assert_allclose(matrix(hinge.orientation)[:, 2], [0.0, 1.0, 0.0], atol=1e-15)
    assert load_scene_text(scene.resolved) == scene


def test_a_path_that_begins_at_the_root_may_hold_anything(tmp_path: Path) -> None:
    folder = tmp_path / 'my data (new), 50 % é'
    folder.mkdir()
    shutil.copy(ROOT / 'config' / 'maneuvers' / 'step_steer.yaml', folder / 'steer it.yaml')
    scene = load_scene('light_car_straight', [f'maneuver={included(folder / "steer it.yaml")}'])
    assert scene.maneuver == load_maneuver('step_steer')
    for name in ('steer.yml', 'a #b.yaml', 'a: b.yaml'):
        with pytest.raises(SceneError, match='a scene cannot include it; move it to a path without'):
            included(folder / name)
    with pytest.raises(SceneError, match=r"no such file; did you mean '.*/steer it\.yaml'"):
        load_scene('light_car_straight', [f'maneuver={folder / "steer at.yaml"}'])


def test_a_scene_that_is_called_like_a_file_loads_again(tmp_path: Path) -> None:
    shutil.copy(ROOT / 'config' / 'scenes' / 'pendulum.yaml', tmp_path / 'first.yaml.yaml')
    scene = load_scene(tmp_path / 'first.yaml.yaml')
    assert scene.name == 'first.yaml'
    assert load_scene_text(scene.resolved) == scene


@pytest.mark.parametrize(
    ('bodies', 'chassis', 'says'),
    [
        (
            ('arm', 'base_link'),
            '',
            "body = 'base_link': is the frame of the chassis (the first body, unless the model names one) in /tf",
        ),
        (('base_link', 'arm'), 'arm', "body = 'base_link': is the frame of the chassis"),
        (('arm', 'odom'), '', "body = 'odom': is the frame of the world in /tf and robot_description; rename the body"),
        (('arm', 'imu_link'), 'arm', "body = 'imu_link': is the frame of the IMU"),
        (('odom',), '', "body = 'odom': is the frame of the world"),
        (("''",), '', "body = '': a frame needs a name"),
        (('/arm',), '', "body = '/arm': a frame needs a name that does not begin with /"),
        (('base_link', 'arm'), '', ''),
        (('arm', 'base_link'), 'base_link', ''),
    ],
)
def test_bodies_do_not_take_the_frames_of_others(bodies: tuple[str, ...], chassis: str, says: str) -> None:
    lines = ''.join(f'    {name}: {{mass: 1, inertia: [1, 1, 1]}}\n' for name in bodies)
    text = f'mechanism:\n  bodies:\n{lines}' + f'  chassis: {chassis}\n' * bool(chassis)
    if not says:
        load_scene_text(text)
        return
    with pytest.raises(SceneError, match=re.escape(says)):
        load_scene_text(text)


@pytest.mark.parametrize(
    ('sections', 'says'),
    [
        (
            '  spring_dampers: {s: {i: a, j: b, spring: 1, free_length: 1}}\n  applied_forces: {s: {marker: a}}\n',
            "SpringDamper 's' and AppliedForce 's' have outputs of the same name; rename one of them",
        ),
        (
            '  joints: {s: {kind: spherical, i: a, j: b}}\n  contacts: {s: {kind: knife_edge, i: world, j: b}}\n',
            "Joint 's' and Contact 's' have reactions of the same name; rename one of them",
        ),
        (
            '  joints: {s: {kind: spherical, i: a, j: b}}\n  spring_dampers: {s: {i: a, j: b, spring: 1, free_length: '
            '1}}\n',
            '',
        ),
    ],
)
def test_no_two_columns_of_a_recording_have_the_same_name(sections: str, says: str) -> None:
    bodies = '  bodies: {a: {mass: 1, inertia: [1, 1, 1]}, b: {mass: 1, inertia: [1, 1, 1]}}\n'
    text = f'mechanism:\n{bodies}{sections}'
    if not says:
        load_scene_text(text)
        return
    with pytest.raises(SceneError, match=re.escape(says)):
        load_scene_text(text)


def test_a_wrong_scene_name_suggests_the_nearest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SceneError, match=r"no such file.*did you mean 'slider_crank'\?"):
        load_scene('slidercrank')
    with pytest.raises(SceneError, match=r'allowed: .*pendulum'):
        load_scene('zzz')
    with pytest.raises(
        SceneError, match=r"'full_car': is a vehicle; put it into a scene by --set vehicle=vehicles/full_car.yaml"
    ):
        load_scene('full_car')
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'pendulum.yaml').write_text('')
    with pytest.raises(SceneError, match=r"scene 'pendulum.yml': no such file.*did you mean 'pendulum.yaml'\?"):
        load_scene('pendulum.yml')


def test_a_part_that_is_taken_for_a_whole_is_refused_for_what_it_is(tmp_path: Path) -> None:
    file = tmp_path / 's.yaml'
    with pytest.raises(SceneError, match=r'here are 0; this is a vehicle: put it into a scene by --set vehicle=FILE'):
        load_scene('vehicles/compact_fwd.yaml')
    file.write_text('vehicle: mine.yaml\n')
    (tmp_path / 'mine.yaml').write_text('title: a whole scene\nvehicle: vehicles/compact_fwd.yaml\n')
    with pytest.raises(
        SceneError, match=r"'kind' is missing; one of: .*; this is a scene: give what stands under its key vehicle"
    ):
        load_scene(file)


def test_scenes_are_found_by_path_by_name_and_in_the_current_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    by_name = load_scene('pendulum')
    assert load_scene(ROOT / 'config' / 'scenes' / 'pendulum.yaml') == by_name
    (tmp_path / 'scenes').mkdir()
    (tmp_path / 'scenes' / 'mine.yaml').write_text('mechanism: mechanisms/pendulum.yaml\nduration: 3\n')
    monkeypatch.chdir(tmp_path)
    assert load_scene('mine').duration == 3.0
    assert load_scene('mine').model == by_name.model
    assert load_scene('pendulum') == by_name


def test_a_file_that_includes_itself_and_a_missing_one_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'loop.yaml').write_text('title: x\nmechanism: loop.yaml\n')
    with pytest.raises(SceneError, match=r'loop.yaml:2: mechanism = loop.yaml: the file includes itself'):
        load_scene('loop.yaml')
    (tmp_path / 'gone.yaml').write_text('mechanism: mechanisms/pendulun.yaml\n')
    with pytest.raises(SceneError, match=r"gone.yaml:1: .*did you mean 'mechanisms/pendulum.yaml'"):
        load_scene('gone.yaml')
    (tmp_path / 'binary.yaml').write_bytes(b'\xff\xfe\x00')
    with pytest.raises(SceneError, match=r'binary.yaml: cannot be read: is not UTF-8 text'):
        load_scene('binary.yaml')


def test_an_error_inside_an_included_file_names_that_file_and_the_whole_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'm.yaml').write_text('bodies:\n  a: {mass: -1, inertia: [1, 1, 1]}\n')
    (tmp_path / 's.yaml').write_text('mechanism: m.yaml\n')
    with pytest.raises(SceneError, match=r'^m.yaml:2: mechanism.bodies.a.mass = -1.0: must be >= 0$'):
        load_scene('s.yaml')


@pytest.mark.parametrize('name', known_names('roads'))
def test_road_files_load(name: str) -> None:
    scene = load_scene('pendulum', [f'road=roads/{name}.yaml'])
    assert load_scene_text(scene.resolved) == scene


def test_a_name_that_no_file_can_have_is_refused() -> None:
    with pytest.raises(SceneError, match=r"'a\\x00b': no file has a NUL in its name"):
        read(Path('a\0b'), ())
