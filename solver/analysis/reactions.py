"""Reactions of a joint on its bodies: the multipliers of its rows as one force and one torque (docs/conventions.md:
what each row means)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.elements.joint import AXES, DISTANCE, DZ, PX, TWIST
from solver.errors import SpecError, suggestion
from solver.simulation import Simulation


class Reaction(NamedTuple):
    """A joint acting on body j: force [N] and its torque about `point` [N m], the origin of marker F on body i [m], all
    in W.

    Body i takes the opposite force and the opposite torque about the same point.
    """

    force: np.ndarray  # (3,)
    torque: np.ndarray  # (3,)
    point: np.ndarray  # (3,)

    def about(self, point: np.ndarray) -> np.ndarray:
        """(3,) the torque about another point [N m]."""
        return self.torque + np.cross(self.point - point, self.force)


def joint_reaction(simulation: Simulation, name: str) -> Reaction:
    """The reaction of a joint in the state that the last Snapshot shows. Raises SpecError for a name that is no
    joint."""
    names = [joint.name for joint in simulation.scene.model.joints]
    if name not in names:
        raise SpecError(f'joint_reaction: name = {name!r}: no such joint{suggestion(name, names)}')
    e = names.index(name)
    table, kin = simulation.model.elements['joints'], simulation.kinematics
    lam = simulation.last_step.lam
    i, j = table.body[e]
    F, G = kin.R[i] @ table.F[e], kin.R[j] @ table.G[e]
    p_F, p_G = kin.p[i] + kin.R[i] @ table.r_i[e], kin.p[j] + kin.R[j] @ table.r_j[e]
    force, torque = np.zeros(3), np.zeros(3)
    for r in range(table.rows[e]):
        code, m = table.code[e, r], lam[table.row[e] + r]
        if code <= DZ:
            force += m * F[:, code]
        elif code < TWIST:
            a, b = divmod(code - AXES, 3)
            torque -= m * np.cross(F[:, a], G[:, b])
        elif code == TWIST:
            torque -= m * (np.cross(F[:, 0], G[:, 1]) - np.cross(F[:, 1], G[:, 0]))
        elif code == DISTANCE:
            force += m * (p_G - p_F) / np.linalg.norm(p_G - p_F)
        else:
            force[code - PX] += m
    return Reaction(force, torque + np.cross(p_G - p_F, force), p_F)
