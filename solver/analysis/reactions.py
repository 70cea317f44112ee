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


def undetermined(simulation: Simulation) -> str:
    """Sentence on reactions that the motion did not determine so far (solver.output.undetermined), or nothing."""
    time, first, row, rows = simulation.last_step.account.undetermined.tolist()
    if not (time > 0.0 and simulation.of_bodies):
        return ''
    part = 100.0 * time / max(time, simulation.t_ns * 1e-9)
    name, others = simulation.model.row_names[int(row)], int(rows) - 1
    of = f'{name!r}' if others == 0 else f'{name!r} and up to {others} more rows'
    return (
        f'Reactions of {of} are not determined for {time:.3g} s ({part:.2g} % of the time), first at t = {first:.6g} '
        's, next to a singular position: any value moves the mechanism alike. They are shown as NaN'
    )


def joint_reaction(simulation: Simulation, name: str) -> Reaction:
    """The reaction of a joint in the state that the last Snapshot shows, NaN where the motion does not determine it.
    Raises SpecError for a name that is no joint."""
    names = [joint.name for joint in simulation.scene.model.joints]
    if name not in names:
        raise SpecError(f'joint_reaction: name = {name!r}: no such joint{suggestion(name, names)}')
    e = names.index(name)
    table, kin = simulation.model.elements['joints'], simulation.kinematics
    lam = simulation.snapshot().reactions
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
