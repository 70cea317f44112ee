"""Branch check across a divided step: a motion that was divided into smaller steps must end on the branch of the
mechanism that it began on."""

from __future__ import annotations

import numpy as np

from solver.model.evaluate import evaluate_constraints
from solver.model.state import State, kinematics_of
from solver.model.tables import Model
from solver.output.branches import unexplained_turn
from solver.output.dependence import scaled_jacobian
from solver.start.newton import move


def turn_across(model: Model, begin: State, end: State, inputs: np.ndarray, h: float, J: np.ndarray) -> float:
    """Turn of the constraints [rad] between two states one step of h [s] apart, beyond what the motion to either side
    explains.

    J: a Jacobian; only its shape is used.
    """
    return unexplained_turn(
        *(
            _jacobian(model, s, t, inputs, np.zeros_like(J))
            for s, t in ((begin, -h), (begin, 0.0), (end, 0.0), (end, h))
        )
    )


def _jacobian(model: Model, s: State, later: float, inputs: np.ndarray, J: np.ndarray) -> np.ndarray:
    """Scaled constraint Jacobian J of a state moved by so many seconds."""
    q = s.q.copy()
    move(q, later * s.v + 0.5 * later**2 * s.a_stage)
    evaluate_constraints(model.tables, kinematics_of(q, s.v), s.angle, inputs, True, np.zeros(model.n_rows), J)
    return scaled_jacobian(model, J)
