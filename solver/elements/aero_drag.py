"""Aerodynamic drag and lift of a body in still air, quadratic in the velocity of one point.

    F = -1/2 rho A_D |v| v + 1/2 rho A_L v_x^2 e_z

v is the velocity of the marker's origin (the centre of pressure), v_x its component along the x axis of the marker, e_z
the z axis of the marker. A_D = C_d A and A_L = C_l A are areas (drag and lift coefficient times frontal area);
downforce has A_L < 0. Front and rear lift are two elements at the axles. The force is continuously differentiable, also
at rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.vec import (
    add,
    add3,
    cross,
    cross_m,
    dot,
    load3,
    load33,
    m_cross,
    minus,
    mm,
    mscale,
    msub,
    mv,
    outer,
    put66,
    scale,
    skew,
    tmv,
    transpose,
)
from solver.dimensions import Area, Density
from solver.elements.instant import sums
from solver.elements.kind import ForceKind
from solver.elements.marker import Context, Marker, Spec
from solver.elements.point_pair import angular_velocity, linear_velocity
from solver.validate import finite

OUTPUTS = {'energy': 'J', 'dissipation': 'W', 'fx': 'N', 'fy': 'N', 'fz': 'N', 'speed': 'm/s'}


@dataclass(frozen=True, kw_only=True)
class AeroDragSpec(Spec):
    """Drag and lift at the origin of a marker; see the module for the force.

    drag_area [m^2] >= 0, lift_area [m^2] (positive lifts along z of the marker), air_density [kg/m^3] >= 0. The outputs
    fx..fz are along the axes of the marker. Dissipation is the power taken by drag and lift.
    """

    counted_as = 'external_forces'
    marker: Marker
    drag_area: Area
    lift_area: Area = 0.0
    air_density: Density = 1.2

    def __post_init__(self) -> None:
        self.set('drag_area', finite(self.where, 'drag_area', self.drag_area, low=0.0))
        self.set('lift_area', finite(self.where, 'lift_area', self.lift_area))
        self.set('air_density', finite(self.where, 'air_density', self.air_density, low=0.0))


class AeroDragTable(NamedTuple):
    """Columns of all drags."""

    body: np.ndarray  # (n,)
    r: np.ndarray  # (n, 3) centre of pressure from the centre of mass, in B [m]
    axes: np.ndarray  # (n, 3, 3) axes of the marker in B
    drag: np.ndarray  # (n,) rho A_D / 2 [kg/m]
    lift: np.ndarray  # (n,) rho A_L / 2 [kg/m]
    slot: np.ndarray  # (n,) diagonal block


def compile_aero_drags(specs: Sequence[AeroDragSpec], context: Context) -> AeroDragTable:
    """Resolve names into a table."""
    n = len(specs)
    table = AeroDragTable(
        body=np.zeros(n, np.int64),
        r=np.zeros((n, 3)),
        axes=np.zeros((n, 3, 3)),
        drag=np.array([0.5 * s.air_density * s.drag_area for s in specs], float),
        lift=np.array([0.5 * s.air_density * s.lift_area for s in specs], float),
        slot=np.zeros(n, np.int64),
    )
    for e, spec in enumerate(specs):
        placed = context.marker(spec.where, spec.marker)
        table.body[e], table.r[e], table.axes[e] = placed
        table.slot[e] = context.slot(placed.body, placed.body)
    return table


@kernel(borrow=True)
def aero_drag_forces(table, now, effects, out):
    """Accumulate forces and tangents of all drags (contract: solver/elements/__init__.py)."""
    f, Kq, Kv = sums(effects)
    kin = now.kin
    for e in range(table.body.shape[0]):
        b = table.body[e]
        R = load33(kin.R, b)
        r = load3(table.r, e)
        axes = load33(table.axes, e)
        x = (axes[0], axes[3], axes[6])
        up = (axes[2], axes[5], axes[8])
        drag = table.drag[e]
        lift = table.lift[e]
        # everything along B, where the force depends on the velocity V of the point only
        v = tmv(R, linear_velocity(kin, b))
        V = add(v, cross(angular_velocity(kin, b), r))
        speed = np.sqrt(dot(V, V))
        forward = dot(x, V)
        F = add(scale(-drag * speed, V), scale(lift * forward * forward, up))
        add3(f, b, 0, mv(R, F))
        add3(f, b, 3, cross(r, F))
        if now.tangents:
            D = outer(scale(2.0 * lift * forward, up), x)  # dF/dV
            if speed.real > 0.0:
                D = msub(D, outer(scale(drag / speed, V), V))
            s = -drag * speed
            D = (D[0] + s, D[1], D[2], D[3], D[4] + s, D[5], D[6], D[7], D[8] + s)
            # dV = R^T dv + v x dtheta - r x dw
            Dr = m_cross(D, r)
            Dv = m_cross(D, v)
            DR = mm(D, transpose(R))
            zero = mscale(0.0, R)
            put66(Kq, table.slot[e], zero, mm(R, msub(Dv, skew(F))), zero, cross_m(r, Dv))
            put66(Kv, table.slot[e], mm(R, DR), minus(mm(R, Dr)), cross_m(r, DR), minus(cross_m(r, Dr)))
        out[e, 0] = 0.0
        out[e, 1] = -dot(F, V)
        o = tmv(axes, F)
        out[e, 2] = o[0]
        out[e, 3] = o[1]
        out[e, 4] = o[2]
        out[e, 5] = speed


AERO_DRAGS = ForceKind(
    name='aero_drags', spec=AeroDragSpec, compile=compile_aero_drags, kernel=aero_drag_forces, outputs=OUTPUTS
)
