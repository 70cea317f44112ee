"""What moves with the wheels of an axle, as masses of both wheels and one that they share and that moves with the mean of their travels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

SHARED = 0.05  # of the mass that moves with a wheel: below it what moves with both wheels of an axle is no body of its own


class AxleMasses(NamedTuple):
    """Masses [kg] of the left and the right wheel, and what moves with the mean of their travels."""

    wheels: tuple[float, float]
    shared: float


def divided(J: np.ndarray, own: np.ndarray, other: np.ndarray, moved: np.ndarray, beside: float) -> AxleMasses:
    """The masses that have a given mass matrix over both travels.

    J (2,): inertia of a wheel about a diameter [kg m^2]. own, other (2, 4): slopes of x, y, psi, gamma of a wheel over its own travel s and
    over that of the other one, o. moved (2,), beside: the mass matrix, on its diagonal and beside it [kg]. On its diagonal wheels have
    m (1 + X_s^2 + Y_s^2 + X_o^2 + Y_o^2) + J (Psi_s^2 + Gamma_s^2 + Psi_o^2 + Gamma_o^2) + shared/4, slopes over o of the other wheel, and
    beside it shared/4 and the sum over both of m (X_s X_o + Y_s Y_o) + J (Psi_s Psi_o + Gamma_s Gamma_o).
    """
    squares = [np.add.reduce(x * x, axis=1) for x in (own[:, :2], own[:, 2:], other[::-1, :2], other[::-1, 2:])]
    along, turned = 1.0 + squares[0] + squares[2], J * squares[1] + J[::-1] * squares[3]
    cross = np.add.reduce(own * other, axis=0)
    across = float(np.add.reduce(J * np.add.reduce(own[:, 2:] * other[:, 2:], axis=1)))
    moving = float(cross[0] + cross[1])
    mass = (0.5 * float(moved[0] + moved[1] - turned[0] - turned[1]) - beside + across) / (0.5 * float(along[0] + along[1]) - moving)
    shared = 4.0 * (beside - mass * moving - across)
    if shared < SHARED * float(moved[0] + moved[1]):
        shared = 0.0
    left, right = ((moved - turned - 0.25 * shared) / along).tolist()
    return AxleMasses((left, right), shared)
