"""The bench that a vehicle is measured on for the level kc."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from solver.analysis.kinematics_and_compliance import CORNERS, Rig
from solver.elements.spring_damper import SPRING_DAMPERS
from solver.errors import ConsistencyError
from solver.model.frames import matrix
from solver.model.spec import ModelSpec

APPROACH = 8  # equilibria on the way to a place that is not found at once


class Stand(NamedTuple):
    """A state of the bench. q (nb + 1, 7); x: by corner (5,) x, y, psi, gamma, theta; load: by corner, vertical [N];
    lengths: of the spring-dampers [m]; angles: of the joint coordinates; torque: that holds the steering wheel [N
    m]."""

    q: np.ndarray
    x: dict[str, np.ndarray]
    load: dict[str, float]
    lengths: np.ndarray
    angles: np.ndarray
    torque: float


class Bench:
    """The rig with everything that a wheel can be loaded with and moved by."""

    def __init__(self, spec: ModelSpec) -> None:
        self.rig = Rig(spec, at_center=True)
        self.spec, self.size = spec, self.rig.size
        self.wheels = {tire.name: self.rig.model.body_names.index(tire.marker.body) for tire in spec.tires}
        self.drivers = [c for c in spec.couplers if c.input is not None]

    def stand(self, **inputs: float) -> Stand:
        """The equilibrium under inputs of the rig."""
        try:
            corners = self.rig.settle(inputs)
        except ConsistencyError:
            corners = self._approached(inputs)
        loads = {c: corner['load'] for c, corner in corners.items()}
        model, state = self.rig.model, self.rig.state
        lengths = model.outputs(SPRING_DAMPERS.name, self.rig.start.outputs)[:, SPRING_DAMPERS.column('length')].copy()
        return Stand(
            state.q.copy(),
            {c: self._wheel(c, state.q) for c in CORNERS},
            loads,
            lengths,
            state.angle.copy(),
            self._torque(),
        )

    def _torque(self) -> float:
        row_names = self.rig.model.row_names
        return sum(float(self.rig.state.lam[row_names.index(c.name)]) * c.terms[0][1] for c in self.drivers)

    def _approached(self, inputs: dict[str, float]) -> dict[str, dict[str, float]]:
        """The same from the design position, by equilibria on the way."""
        self.rig.reset()
        for k in range(1, APPROACH):
            self.rig.settle({name: value * k / APPROACH for name, value in inputs.items()})
        return self.rig.settle(inputs)

    def _wheel(self, corner: str, q: np.ndarray) -> np.ndarray:
        b = self.wheels[corner]
        R = matrix(tuple(q[b, 3:]))
        place = q[b, :3] - self.rig.centers[corner]
        psi, gamma = math.atan2(-R[0, 1], R[1, 1]), float(R[2, 1])
        # R = Rz(psi) Rx(asin gamma) Ry(theta)
        level = math.sqrt(1.0 - gamma * gamma)
        theta = math.atan2(-R[2, 0] / level, R[2, 2] / level)
        return np.array([place[0], place[1], psi, gamma, theta])
