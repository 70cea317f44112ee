"""The free body of an ideal live axle on four links: what acts on it besides, by the six equations of equilibrium."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from live_axle_cars import forces
from scipy.spatial.transform import Rotation

from solver.elements.marker import Marker
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.simulation import Simulation

GRAVITY = np.array([0.0, 0.0, -9.81])
FORWARD, LEFT = np.eye(3)[0], np.eye(3)[1]


class Loads(NamedTuple):
    """along, across: torque about x and about y that the housing gets from elsewhere than tires, springs, links, weight
    and inertia [N m]; links: forces in the links [N]."""

    along: float
    across: float
    links: np.ndarray


def links(axle: str) -> tuple[str, ...]:
    """Of an axle of live_axle_cars."""
    return f'lower_link_{axle}_left', f'lower_link_{axle}_right', f'upper_link_{axle}', f'panhard_rod_{axle}'


def loads(run: Simulation, axle: str, rods: tuple[str, ...], steps: int = 100) -> Loads:
    """Of a car that drives straight on along x, from its motion over some steps. rods: names of its four links.

    Unknown are four forces along links and two torques. Links and propeller shaft share their weight and inertia
    between their ends.
    """
    before = run.snapshot().twist.copy()
    shot = run.advance(steps)
    change = (shot.twist - before) / (steps * run.h)
    faster = np.array([change[run.channels.chassis or 0, 0], 0.0, 0.0])  # all of the car, steadily
    spec = run.model.spec
    names = [body.name for body in spec.bodies]
    joints = {joint.name: joint for joint in spec.joints}
    total = np.zeros(6)  # of what is known, with inertia, about the origin

    def placed(marker: Marker) -> np.ndarray:
        pose = shot.pose[names.index(marker.body)]
        return pose[:3] + Rotation.from_quat(pose[3:7]).apply(marker.position)

    def add(point: np.ndarray, force: np.ndarray, torque: np.ndarray | None = None) -> None:
        total[:3] += force
        total[3:] += np.cross(point, force) + (0.0 if torque is None else torque)

    own = [f'axle_{axle}', *(f'wheel_{axle}_{side}' for side in ('left', 'right')), f'drive_pinion_{axle}']
    for name in own:
        body, k = spec.bodies[names.index(name)], names.index(name)
        add(
            placed(Marker(body=name, position=body.com)),
            body.mass * (GRAVITY - faster),
            -body.inertia[1] * change[k, 4] * LEFT,
        )
    column = {name: k for k, name in enumerate(TIRE_COLUMNS)}
    for tire, row in zip(spec.tires, shot.tire, strict=True):
        if tire.name.startswith(axle):
            frame = Rotation.from_quat(row[column['qx'] : column['qw'] + 1])
            place = row[column['px'] : column['pz'] + 1]
            add(
                place,
                frame.apply(row[column['fx'] : column['fz'] + 1]),
                frame.apply(row[column['mx'] : column['mz'] + 1]),
            )
    for name, element in forces(run, 'spring_dampers').items():
        spring = next(s for s in spec.spring_dampers if s.name == name)
        if axle in name:
            top, foot = placed(spring.i), placed(spring.j)
            add(foot, element['force'] * (top - foot) / np.linalg.norm(top - foot))
    unknown = np.zeros((6, 6))
    for k, link in enumerate(rods):
        inner, outer = placed(joints[f'{link}_inner'].i), placed(joints[f'{link}_outer'].j)
        along = (inner - outer) / np.linalg.norm(inner - outer)
        unknown[:3, k], unknown[3:, k] = along, np.cross(outer, along)
        half = 0.5 * spec.bodies[names.index(link)].mass
        add(outer, half * (GRAVITY - faster))
    for joint in spec.joints:  # a shaft that ends, and one that begins at the axle
        ends = (joint.j, joint.i.body) if joint.name == f'propshaft_pinion_{axle}' else (joint.i, joint.j.body)
        if ends[0].body in (own[0], own[3]) and joint.name.startswith(('propshaft_pinion', 'propshaft_flange')):
            add(placed(ends[0]), 0.5 * spec.bodies[names.index(ends[1])].mass * GRAVITY)
    unknown[3:, 4], unknown[3:, 5] = FORWARD, LEFT
    found = np.linalg.solve(unknown, -total)
    return Loads(float(found[4]), float(found[5]), found[:4])
