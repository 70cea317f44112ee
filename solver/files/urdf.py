"""A model as URDF: the spanning tree that `robot_description` shows, with the joints of `joint_states`.

URDF knows trees of joints with one coordinate each; a car has loops, ball joints and bushings. The tree is grown from
the root, always along the connection that says most about the relative motion:

    revolute, prismatic, cylindrical   exact; the coordinates of these joints
    other joint coordinates            e.g. travel_front_left: only this part of the motion is shown; of a guided wheel
                                       travel and spin
    any other joint, bushing, spring   'fixed' as at the start

so every body has a link, every moving joint bears the name of a joint coordinate, and at the start all links are where
the bodies are. The true motion of the bodies, loops and bushings included, is in /tf under the names of the links.
`imu_link` is where the IMU is. The root is `base_link`, the chassis, or `odom`, the world, in a model without one.
Inertias are those of the bodies; a body is drawn as the box with its inertia, a wheel as a cylinder.
"""

from __future__ import annotations

import heapq
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from solver.elements.coordinate import CoordinateSpec
from solver.elements.marker import WORLD, Marker
from solver.model.compile import joint_coordinates
from solver.model.frames import matrix
from solver.model.spec import ModelSpec

ON_AXIS = 1e-9  # m: a body whose origin is nearer to the axis of its joint needs no link of its own for the axis
THINNEST = 0.01  # m, of a drawn box
# turns the axis of a cylinder, z, to the spin axis of a wheel
ALONG_Y = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
EXACT, COORDINATE, JOINT, BUSHING, OTHER = range(5)  # connections, in the order in which they are chosen


class Pose(NamedTuple):
    """Placement of a frame: p (3,) [m], R (3, 3)."""

    p: np.ndarray
    R: np.ndarray

    def to(self, other: Pose) -> Pose:
        """The other placement as seen from this one."""
        return Pose(self.R.T @ (other.p - self.p), self.R.T @ other.R)


class Edge(NamedTuple):
    """A connection of two bodies; coordinates: those of the motion of body j relative to i that it shows."""

    choice: int
    name: str
    i: str
    j: str
    coordinates: tuple[CoordinateSpec, ...]


def _edges(spec: ModelSpec) -> list[Edge]:
    edges = []
    for joint in spec.joints:
        coordinates = tuple(joint_coordinates(joint))
        edges.append(Edge(EXACT if coordinates else JOINT, joint.name, joint.i.body, joint.j.body, coordinates))
    for guide in spec.guides:
        for wheel in (guide.left, guide.right):
            own = [c for c in spec.coordinates if {c.i.body, c.j.body} == {guide.chassis, wheel}]
            # travel, then spin
            moving = sorted((c for c in own if c.i.body == guide.chassis), key=lambda c: c.kind == 'rotation')
            edges.append(Edge(COORDINATE, wheel, guide.chassis, wheel, tuple(moving)))
    edges += [Edge(COORDINATE, c.name, c.i.body, c.j.body, (c,)) for c in spec.coordinates]
    edges += [Edge(BUSHING, e.name, e.i.body, e.j.body, ()) for e in spec.bushings]
    edges += [Edge(OTHER, e.name, e.i.body, e.j.body, ()) for e in spec.spring_dampers]
    return edges


def spanning_tree(spec: ModelSpec, root: str) -> list[tuple[str, str, Edge]]:
    """(parent, child, edge) of every body but the root, parents first. Bodies that nothing connects to the root hang on
    it as they are."""
    around: dict[str, list[tuple[int, int, Edge]]] = {}
    for order, edge in enumerate(_edges(spec)):
        for body in (edge.i, edge.j):
            around.setdefault(body, []).append((edge.choice, order, edge))
    reached = {root, WORLD}  # the world is the root or, where a chassis moves in it, no part of the robot

    def grow(body: str) -> list[tuple[str, str, Edge]]:
        tree, grown, front = [], {body}, list(around.get(body, []))
        reached.add(body)
        heapq.heapify(front)
        while front:
            edge = heapq.heappop(front)[2]
            parent, child = (edge.i, edge.j) if edge.i in grown else (edge.j, edge.i)
            if child in reached:
                continue
            tree.append((parent, child, edge))
            grown.add(child)
            reached.add(child)
            for entry in around[child]:
                heapq.heappush(front, entry)
        return tree

    tree = grow(root)
    for spec_of_body in spec.bodies:
        body = spec_of_body.name
        if body not in reached:
            tree += [(root, body, Edge(OTHER, f'{body}_placement', root, body, ())), *grow(body)]
    return tree


def link_of(spec: ModelSpec, body: str) -> str:
    """The name of the link that stands for a body."""
    return 'odom' if body == WORLD else 'base_link' if body == spec.chassis else body


class _Writer:
    def __init__(self, spec: ModelSpec, poses: dict[str, Pose], values: dict[str, float], root: str, name: str) -> None:
        self.spec, self.poses, self.values = spec, poses, values
        self.robot = ElementTree.Element('robot', name=name)
        self.links = {root: link_of(spec, root)}
        self.wheels = {tire.marker.body: tire for tire in spec.tires}
        self.bodies = {body.name: body for body in spec.bodies}
        self.link(root)

    def link(self, body: str) -> str:
        name = self.links.setdefault(body, body)
        link = ElementTree.SubElement(self.robot, 'link', name=name)
        if body == WORLD:
            return name
        spec = self.bodies[body]
        if spec.mass > 0.0:
            inertial = ElementTree.SubElement(link, 'inertial')
            _origin(inertial, np.array(spec.com), np.eye(3))
            ElementTree.SubElement(inertial, 'mass', value=_number(spec.mass))
            I = spec.inertia_matrix()  # noqa: E741
            entries = {'ixx': I[0, 0], 'ixy': I[0, 1], 'ixz': I[0, 2], 'iyy': I[1, 1], 'iyz': I[1, 2], 'izz': I[2, 2]}
            ElementTree.SubElement(inertial, 'inertia', {key: _number(value) for key, value in entries.items()})
        visual = ElementTree.SubElement(link, 'visual')
        if body in self.wheels:
            tire = self.wheels[body]
            _origin(visual, np.array(tire.marker.position), matrix(tire.marker.orientation) @ ALONG_Y)
            geometry = ElementTree.SubElement(visual, 'geometry')
            radius = tire.data['UNLOADED_RADIUS']
            width = tire.data['WIDTH'] or 0.65 * radius
            ElementTree.SubElement(geometry, 'cylinder', radius=_number(radius), length=_number(width))
        elif spec.mass > 0.0:
            _origin(visual, np.array(spec.com), np.eye(3))
            d = np.diag(spec.inertia_matrix())
            sides = np.sqrt(np.maximum(6.0 * (d.sum() - 2.0 * d) / spec.mass, THINNEST**2))
            geometry = ElementTree.SubElement(visual, 'geometry')
            ElementTree.SubElement(geometry, 'box', size=_numbers(sides))
        else:
            link.remove(visual)
        return name

    def joint(
        self, kind: str, name: str, parent: str, child: str, origin: Pose, axis: np.ndarray | None = None
    ) -> None:
        joint = ElementTree.SubElement(self.robot, 'joint', name=name, type=kind)
        _origin(joint, *origin)
        ElementTree.SubElement(joint, 'parent', link=parent)
        ElementTree.SubElement(joint, 'child', link=child)
        if axis is not None:
            ElementTree.SubElement(joint, 'axis', xyz=_numbers(axis / np.linalg.norm(axis)))
        if kind == 'prismatic':
            ElementTree.SubElement(joint, 'limit', lower='-100', upper='100', effort='1e9', velocity='1e3')

    def connect(self, parent: str, child: str, edge: Edge) -> None:
        """Joints from the link of parent to that of child so that they stand where the bodies stand, at the values of
        the start."""
        here, link, goal = self.poses[parent], self.links[parent], self.poses[child]
        name = self.link(child)
        forward = edge.i == parent
        coordinates = edge.coordinates if forward else edge.coordinates[::-1]
        for k, c in enumerate(coordinates):
            x = self.values[c.name]
            marker: Marker = c.i
            body = self.poses[marker.body]
            n = body.R @ matrix(marker.orientation)[:, 2]
            point = body.p + body.R @ np.array(marker.position)
            direction = n if forward else -n
            last = k == len(coordinates) - 1
            if c.kind == 'rotation':
                foot = point + n * (n @ (goal.p - point))
                direct = last and bool(np.linalg.norm(goal.p - foot) < ON_AXIS)
                after = Pose(goal.p if direct else foot, goal.R)
                before = Pose(after.p, _turn(direction, -x) @ after.R)
            else:
                direct = last
                after = Pose(goal.p if direct else here.p, goal.R)
                before = Pose(after.p - x * direction, after.R)
            next_link = name if direct else self._massless(c.name)
            kind = 'continuous' if c.kind == 'rotation' else 'prismatic'
            self.joint(kind, c.name, link, next_link, here.to(before), after.R.T @ direction)
            here, link = after, next_link
        if link != name:
            self.joint('fixed', f'{edge.name}/fixed', link, name, here.to(goal))

    def sensor(self, name: str, place: np.ndarray) -> None:
        """A frame fixed on the root [m]."""
        ElementTree.SubElement(self.robot, 'link', name=name)
        self.joint('fixed', f'{name}/fixed', 'base_link', name, Pose(place, np.eye(3)))

    def _massless(self, coordinate: str) -> str:
        name = f'{coordinate}/axis'
        ElementTree.SubElement(self.robot, 'link', name=name)
        return name


def robot_description(spec: ModelSpec, pose: np.ndarray, values: dict[str, float], name: str) -> str:
    """URDF of a model. pose (nb, 7): reference frames of the bodies at the start (Snapshot.pose); values: joint
    coordinates there, by name [rad or m]; name: of the robot."""
    root = spec.chassis or WORLD
    poses = {b.name: Pose(p[:3], matrix(p[3:].tolist())) for b, p in zip(spec.bodies, pose, strict=True)}
    poses[WORLD] = Pose(np.zeros(3), np.eye(3))
    writer = _Writer(spec, poses, values, root, name)
    for parent, child, edge in spanning_tree(spec, root):
        writer.connect(parent, child, edge)
    if root != WORLD:
        writer.sensor('imu_link', np.array(writer.bodies[root].com))
    ElementTree.indent(writer.robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(writer.robot, encoding='unicode') + '\n'


def _origin(parent: ElementTree.Element, p: np.ndarray, R: np.ndarray) -> None:
    level = np.hypot(R[0, 0], R[1, 0])
    if level > 1e-9:
        rpy = np.array([np.arctan2(R[2, 1], R[2, 2]), np.arctan2(-R[2, 0], level), np.arctan2(R[1, 0], R[0, 0])])
    else:  # x points up or down: roll and yaw are about the same axis
        rpy = np.array([0.0, np.arctan2(-R[2, 0], level), np.arctan2(-R[0, 1], R[1, 1])])
    ElementTree.SubElement(parent, 'origin', xyz=_numbers(p), rpy=_numbers(rpy))


def _turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """(3, 3) rotation about a unit axis by an angle [rad]."""
    return matrix([*(np.sin(0.5 * angle) * axis).tolist(), float(np.cos(0.5 * angle))])


def _number(x: float) -> str:
    return repr(float(x) + 0.0)


def _numbers(values: np.ndarray) -> str:
    return ' '.join(_number(v) for v in values)
