"""What a simulation hands out after a step: plain arrays, and the names that belong to them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

TIRE_COLUMNS = (
    'fx', 'fy', 'fz', 'mx', 'my', 'mz',  # force [N] and moment [N m] on the wheel at the contact point, contact frame
    'kappa', 'alpha', 'gamma', 'spin',  # slip [-], slip angle [rad], camber [rad], spin velocity about +y [rad/s]
    'deflection', 'friction',  # vertical deflection [m], road friction factor [-]
    'px', 'py', 'pz', 'qx', 'qy', 'qz', 'qw',  # contact frame in the world: position [m], orientation xyzw
)  # fmt: skip


class StepStats(NamedTuple):
    """Counters and residuals of the last step (or the sums and maxima over the steps of one advance call)."""

    status: int
    iterations: int
    factorizations: int
    evaluations: int
    residual: float  # momentum residual left [-], relative to the largest force in the step
    position_drift: float  # max |phi| after the step [m or rad]
    velocity_drift: float  # max |A v + phi_t| in the output [m/s or rad/s]

    def followed_by(self, later) -> StepStats:
        """Sums and maxima over these steps and later ones (anything with the same fields), with the status of the later."""
        sums = (self.iterations + later.iterations, self.factorizations + later.factorizations, self.evaluations + later.evaluations)
        drift = max(self.position_drift, later.position_drift), max(self.velocity_drift, later.velocity_drift)
        return StepStats(later.status, *sums, max(self.residual, later.residual), *drift)


@dataclass(frozen=True, kw_only=True)
class Channels:
    """Names of everything in a Snapshot, in order."""

    joints: tuple[str, ...]  # joint coordinates
    joint_kinds: tuple[str, ...]  # 'rotation' | 'translation'
    bodies: tuple[str, ...]
    wheels: tuple[str, ...]  # tires
    inputs: tuple[str, ...]  # as applied
    elements: tuple[str, ...]  # '<element>/<column>' of every force element
    reactions: tuple[str, ...]  # '<joint>/<row>' of every constraint row
    chassis: int | None  # index into bodies of the body that odom and imu describe


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """The output of step k at time t_ns. All arrays are copies; the caller may keep them. Units in docs/conventions.md."""

    k: int
    t_ns: int
    joint_position: np.ndarray  # (nx,) [rad or m], unwrapped
    joint_velocity: np.ndarray  # (nx,)
    joint_effort: np.ndarray  # (nx,) applied generalized force [N m or N]
    pose: np.ndarray  # (nb, 7) reference frame of every body in the world: p [m], quaternion xyzw
    twist: np.ndarray  # (nb, 6) velocity of that frame's origin and angular velocity, both expressed in the body [m/s, rad/s]
    imu: np.ndarray  # (6,) chassis centre of mass: specific force in B [m/s^2], angular velocity in B [rad/s]
    tire: np.ndarray  # (nt, len(TIRE_COLUMNS))
    inputs: np.ndarray  # (nu,)
    elements: np.ndarray  # (ne,)
    reactions: np.ndarray  # (nc,)
    stats: StepStats
