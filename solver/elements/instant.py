"""Arguments of every force kernel: an instant of the whole model, and the arrays for its effects."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.compiled.by_reference import Ref
from solver.compiled.kernel import kernel, sixes
from solver.elements.coordinate import CoordinateTable
from solver.elements.laws import LawTable
from solver.elements.point_pair import Kinematics


class Instant(NamedTuple):
    """A model at one instant; kernels never write into it.

    Internal states are solved as z = zp + cz dz/dt(z, q, v); cz = 0 means z = zp.
    """

    coordinates: CoordinateTable | Ref  # joint coordinates
    laws: LawTable | Ref  # force laws of all elements
    kin: Kinematics | Ref
    angle: np.ndarray  # (nx,) joint coordinates, continued over full turns [rad or m]
    zp: np.ndarray  # (nz,) explicit part of the internal states
    cz: float  # [s]
    u: np.ndarray  # (nu,) inputs
    tangents: bool  # whether Kq and Kv are wanted


class Effects(NamedTuple):
    """Effects of force kernels: f, Kq and Kv are added to, z is assigned."""

    f: np.ndarray  # (nb + 1, 6) generalized forces: force in W [N], torque about the centre of mass in B [N m]
    Kq: np.ndarray  # (ns + 1, 6, 6) df / d(variation), by slots
    Kv: np.ndarray  # (ns + 1, 6, 6) df / d(twist)
    z: np.ndarray  # (nz,) internal states at this instant


@kernel(inline=True)
def sums(effects):
    """(f, Kq, Kv) with their inner lengths known to the compiler (solver.compiled.kernel.sixes)."""
    return sixes(effects.f), sixes(effects.Kq), sixes(effects.Kv)
