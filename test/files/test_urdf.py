"""The URDF of a model: a tree, with the joints of joint_states, whose links stand where the bodies stand."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mbd_sim_ros.commands.main import main
from solver.files.scene import load_scene
from solver.files.urdf import robot_description
from solver.simulation import Simulation

SCENES = [
    'car_swept_steer',
    'light_car_step_steer',
    'slider_crank',
    'four_bar',
    'andrews',
    'flyball_governor',
    'double_pendulum',
]


def described(simulation: Simulation) -> ElementTree.Element:
    s = simulation.snapshot()
    values = dict(zip(simulation.channels.joints, s.joint_position, strict=True))
    return ElementTree.fromstring(robot_description(simulation.model.spec, s.pose, values, 'robot'))


def numbers(element: ElementTree.Element, key: str) -> np.ndarray:
    return np.array([float(x) for x in element.attrib[key].split()])


def transform(joint: ElementTree.Element, values: dict[str, float]) -> np.ndarray:
    """(4, 4) placement of the child in the parent, by the definition of URDF: origin, then the motion along or about
    the axis."""
    T, M = np.eye(4), np.eye(4)
    origin = joint.find('origin')
    assert origin is not None
    T[:3, :3] = Rotation.from_euler('xyz', numbers(origin, 'rpy')).as_matrix()
    T[:3, 3] = numbers(origin, 'xyz')
    if joint.attrib['type'] != 'fixed':
        axis = joint.find('axis')
        assert axis is not None
        motion = numbers(axis, 'xyz') * values[joint.attrib['name']]
        if joint.attrib['type'] == 'continuous':
            M[:3, :3] = Rotation.from_rotvec(motion).as_matrix()
        else:
            M[:3, 3] = motion
    return T @ M


def forward_kinematics(
    robot: ElementTree.Element, values: dict[str, float], root_pose: np.ndarray
) -> dict[str, np.ndarray]:
    """(4, 4) placement of every link in the world; checks that the joints form a tree with one root."""
    links = [link.attrib['name'] for link in robot.findall('link')]
    assert len(links) == len(set(links))
    joints = {}
    for joint in robot.findall('joint'):
        parent, child = joint.find('parent'), joint.find('child')
        assert parent is not None and child is not None
        assert child.attrib['link'] not in joints  # one parent each
        joints[child.attrib['link']] = (parent.attrib['link'], joint)
    roots = [name for name in links if name not in joints]
    assert len(roots) == 1
    at = {roots[0]: root_pose}

    def place(name: str, depth: int = 0) -> np.ndarray:
        assert depth <= len(links)  # no loop
        if name not in at:
            parent, joint = joints[name]
            at[name] = place(parent, depth + 1) @ transform(joint, values)
        return at[name]

    for name in links:
        place(name)
    return at


def body_poses(simulation: Simulation) -> dict[str, np.ndarray]:
    poses = {'odom': np.eye(4)}
    for name, p in zip(simulation.channels.bodies, simulation.snapshot().pose, strict=True):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = Rotation.from_quat(p[3:]).as_matrix(), p[:3]
        poses['base_link' if name == simulation.model.spec.chassis else name] = T
    return poses


def values_of(simulation: Simulation) -> dict[str, float]:
    return dict(zip(simulation.channels.joints, simulation.snapshot().joint_position, strict=True))


@pytest.mark.parametrize('scene', SCENES)
def test_links_of_the_tree_stand_where_the_bodies_stand(scene: str) -> None:
    simulation = Simulation(load_scene(scene))
    robot = described(simulation)
    poses = body_poses(simulation)
    chassis = simulation.model.spec.chassis
    at = forward_kinematics(robot, values_of(simulation), poses['base_link' if chassis else 'odom'])
    for name, T in poses.items():
        if chassis and name == 'odom':
            assert name not in at
            continue
        np.testing.assert_allclose(at[name], T, atol=1e-9)
    moving = {joint.attrib['name'] for joint in robot.findall('joint') if joint.attrib['type'] != 'fixed'}
    assert moving <= set(simulation.channels.joints)
    assert moving


@pytest.mark.parametrize('scene', ['double_pendulum', 'flyball_governor', 'slider_crank'])
def test_tree_of_exact_joints_follows_the_motion(scene: str) -> None:
    """Written at the start, moved by joint_states: bodies that hang on exact joints are where the simulation has them,
    to its drift."""
    simulation = Simulation(load_scene(scene))
    robot = described(simulation)
    simulation.advance(300)
    poses = body_poses(simulation)
    root = poses['base_link'] if simulation.model.spec.chassis else np.eye(4)
    at = forward_kinematics(robot, values_of(simulation), root)
    parents = {
        j.find('child').attrib['link']: (j.find('parent').attrib['link'], j.attrib['type'])
        for j in robot.findall('joint')
    }  # type: ignore[union-attr]

    def shown(name: str) -> bool:
        """Whether only exact joints lead to a link (an axis has a fixed body, which is no approximation)."""
        parent, kind = parents.get(name, ('', ''))
        return not parent or ((kind != 'fixed' or parent.endswith('/axis')) and shown(parent))

    compared = [name for name in at if name in poses and name in parents and shown(name)]
    assert compared
    for name in compared:
        np.testing.assert_allclose(at[name], poses[name], atol=1e-5)


def test_wheels_turn_and_masses_are_those_of_the_model() -> None:
    simulation = Simulation(load_scene('car_swept_steer'))
    robot = described(simulation)
    masses = {
        link.attrib['name']: float(link.find('inertial/mass').attrib['value'])
        for link in robot.findall('link[inertial]')
    }  # type: ignore[union-attr]
    assert sum(masses.values()) == pytest.approx(sum(b.mass for b in simulation.model.spec.bodies))
    assert len(masses) == 53
    joints = {joint.attrib['name']: joint.attrib['type'] for joint in robot.findall('joint')}
    for corner in ('front_left', 'front_right', 'rear_left', 'rear_right'):
        assert joints[f'wheel_{corner}'] == 'continuous'
        assert joints[f'travel_{corner}'] == 'prismatic'
    assert robot.find("link[@name='wheel_front_left']/visual/geometry/cylinder") is not None


def test_info_writes_the_urdf(tmp_path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / 'crank.urdf'
    assert main(['info', 'slider_crank', '--urdf', str(file)]) == 0
    assert ElementTree.parse(file).getroot().attrib['name'] == 'slider_crank'
    capsys.readouterr()
    assert main(['info', 'slider_crank', '--urdf', str(tmp_path)]) != 0
    assert 'cannot write' in capsys.readouterr().err
