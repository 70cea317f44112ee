"""Stability of a static equilibrium: its stiffness on the constraints must be positive.

A calculation that only judges, in dense matrices: no number of it enters a run.
"""

from __future__ import annotations

import numpy as np

from solver.errors import ConsistencyError
from solver.model.tables import Model
from solver.output.dependence import RANK_TOLERANCE, dense_jacobian

# Rate of growth from rest [1/s, of a model that falls as one of 1 m]: a slower one is friction or rounding; ten times
# as much would pass a fall in 1 s.
FASTEST_FALL = 0.1
# stiffness of constraints over the largest one of the model, in the quick test; ten times as much changes no answer
STIFFER = 10.0


def refuse_unstable(model: Model, K: np.ndarray, J: np.ndarray, metric: np.ndarray, fall: float = 1.0) -> None:
    """Raise ConsistencyError when a motion that keeps the constraints grows from rest faster than FASTEST_FALL.

    K (ns + 1, 6, 6): blocks of the derivative of the forces, those of constraints included, with respect to the motion.
    J: blocks of the constraints; those of velocities only count all the same. metric (nb, 6, 6): masses. fall: time
    that the model takes to fall, over that of one of 1 m.
    """
    n, fastest = 6 * model.n_bodies, FASTEST_FALL / fall
    stiffness = np.zeros((n + 6, n + 6))
    for s in range(1, len(K)):
        r, c = 6 * model.tables.block_row[s], 6 * model.tables.block_col[s]
        stiffness[r : r + 6, c : c + 6] -= K[s]
    scale = np.zeros((n, n))
    for b, block in enumerate(metric):
        scale[6 * b : 6 * b + 6, 6 * b : 6 * b + 6] = np.linalg.inv(np.linalg.cholesky(block)).T
    A = dense_jacobian(model, J) @ scale
    size = np.sqrt((A * A).sum(axis=1))
    A = A[size > 0.0] / size[size > 0.0, None]
    S = scale.T @ stiffness[:n, :n] @ scale
    stiff = np.abs(S).max(initial=fall**-2)
    try:  # positive with the constraints as stiff springs is positive on them, and quickly seen
        np.linalg.cholesky(0.5 * (S + S.T) + STIFFER * stiff * (A.T @ A) + fastest**2 * np.eye(n))
        return
    except np.linalg.LinAlgError:
        pass
    free = scale
    if len(A):
        _, singular, Vt = np.linalg.svd(A)
        free = scale @ Vt[int((singular > RANK_TOLERANCE).sum()) :].T
    if not free.shape[1]:
        return
    squares, shapes = np.linalg.eig(free.T @ stiffness[:n, :n] @ free)
    rates = np.sqrt(np.maximum(-squares.real, 0.0)) * (np.abs(squares.imag) <= 0.1 * np.abs(squares.real))
    worst = int(np.argmax(rates))
    if rates[worst] > fastest:
        motion = (free @ shapes[:, worst].real).reshape(-1, 6)
        energy = (motion[:, None, :] @ metric @ motion[:, :, None]).ravel()
        raise ConsistencyError(
            f'start: the static equilibrium that was found is unstable: body '
            f'{model.body_names[int(np.argmax(energy))]!r} falls away from it with exp({rates[worst]:.3g} t), t in s; '
            f'place the bodies nearer to a stable one, or set start.stable: false'
        )
