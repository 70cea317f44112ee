"""Torque converter: what a pump, a turbine and a stator between them do by the flow of oil, from its measured tables.

    nu = rate of the turbine / rate of the pump          speed ratio
    driving, nu <= 1:     T_pump = capacity(nu) rate_pump^2,        T_turbine = ratio(nu) T_pump
    coasting, nu > 1:     both torques are -capacity(1/nu) rate_turbine^2: the turbine drives the pump as a plain
                          coupling
    on the pump -T_pump, on the turbine T_turbine; what both turn in takes the difference: it carries the stator

capacity is 1/K^2 of the K-factor K = rate_pump / sqrt(T_pump), with which stall speed and torque are tabulated [rad/s /
sqrt(N m)]. Both tables are monotone cubics through their points (solver.elements.laws) from nu = 0, the stall, to nu =
1, where the capacity ends. A part that turns backwards counts as standing, so nothing flows where neither turns
forwards. The heat of the oil is its dissipation: T_pump rate_pump - T_turbine rate_turbine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.portable import piecewise_cubic
from solver.dimensions import ConverterCapacity
from solver.elements.coordinate import (
    add_coordinate_hessian,
    add_generalized_on,
    add_gradient,
    coordinate_rate,
    coordinate_rate_gradient,
    evaluate_coordinate,
    scale6,
)
from solver.elements.instant import sums
from solver.elements.kind import ForceKind
from solver.elements.laws import Law, evaluate_law
from solver.elements.marker import Context, Spec, slots
from solver.validate import finite, require, require_rising

BETWEEN = 64  # places between two points of the tables at which the efficiency is looked at
ROUNDING = 1e-9  # of an efficiency
OUTPUTS = {
    'energy': 'J',
    'dissipation': 'W',
    'pump': 'rad/s',
    'turbine': 'rad/s',
    'on_pump': 'N m',
    'on_turbine': 'N m',
}


def require_converter(
    where: str, speed_ratios: Sequence[float], torque_ratios: Sequence[float], capacities: Sequence[float]
) -> None:
    """Check the tables of a torque converter. Raises SpecError."""
    require_rising(where, 'speed_ratios', speed_ratios, 2)
    ends = (speed_ratios[0], speed_ratios[-1])
    require(ends == (0.0, 1.0), where, 'speed_ratios', ends, 'must begin with 0, the stall, and end with 1')
    for name, values in (('torque_ratios', torque_ratios), ('capacities', capacities)):
        require(
            len(values) == len(speed_ratios),
            where,
            name,
            len(values),
            f'must be {len(speed_ratios)} numbers, as speed_ratios',
        )
        for k, value in enumerate(values):
            finite(where, f'{name}[{k}]', value, low=0.0)
    require(capacities[0] > 0.0, where, 'capacities[0]', capacities[0], 'must be > 0')
    require(
        capacities[-1] == 0.0,
        where,
        f'capacities[{len(capacities) - 1}]',
        capacities[-1],
        'must be 0: no oil flows where pump and turbine turn alike',
    )
    for k, (nu, ratio) in enumerate(zip(speed_ratios, torque_ratios, strict=True)):
        require(
            nu * ratio <= 1.0,
            where,
            f'torque_ratios[{k}]',
            ratio,
            f'times the speed ratio {nu:g} must be at most 1: its efficiency',
        )
    law = Law.table(list(zip(speed_ratios, torque_ratios, strict=True)), where, 'torque_ratios')
    for k, (low, high) in enumerate(pairwise(speed_ratios), start=1):
        at = low + (high - low) * np.arange(1, BETWEEN) / BETWEEN
        efficiency = at * piecewise_cubic(np.array(law.x), np.array(law.y), np.array(law.slope), at)[0]
        m = int(np.argmax(efficiency))
        passes = (
            f'with the point before it gives an efficiency of {efficiency[m]:.3f} at the speed ratio {at[m]:.3g}: '
            'give more points'
        )
        require(bool(efficiency[m] <= 1.0 + ROUNDING), where, f'torque_ratios[{k}]', torque_ratios[k], passes)


@dataclass(frozen=True, kw_only=True)
class ConverterSpec(Spec):
    """A torque converter between two rotation coordinates; see the module. speed_ratios: rising from 0 to 1; at these
    torque_ratios [-] and capacities [N m s^2/rad^2], the last one 0."""

    pump: str
    turbine: str
    speed_ratios: tuple[float, ...]
    torque_ratios: tuple[float, ...]
    capacities: tuple[ConverterCapacity, ...]

    def __post_init__(self) -> None:
        require_converter(self.where, self.speed_ratios, self.torque_ratios, self.capacities)


class ConverterTable(NamedTuple):
    """Columns of all torque converters; pump first, then turbine."""

    coordinate: np.ndarray  # (n, 2)
    body: np.ndarray  # (n, 4)
    slot: np.ndarray  # (n, 4, 4)
    law: np.ndarray  # (n, 2) torque ratio, capacity


def compile_converters(specs: Sequence[ConverterSpec], context: Context) -> ConverterTable:
    """Resolve names and laws into a table."""
    n = len(specs)
    table = ConverterTable(
        coordinate=np.array(
            [[context.coordinate(s.where, name) for name in (s.pump, s.turbine)] for s in specs], np.int64
        ).reshape(n, 2),
        body=np.zeros((n, 4), np.int64),
        slot=np.zeros((n, 4, 4), np.int64),
        law=np.zeros((n, 2), np.int64),
    )
    for e, spec in enumerate(specs):
        for k, name in enumerate(('torque_ratios', 'capacities')):
            points = list(zip(spec.speed_ratios, getattr(spec, name), strict=True))
            table.law[e, k] = context.law(Law.table(points, spec.where, name))
        bodies = [b for c in table.coordinate[e] for b in context.coordinate_bodies(int(c))]
        table.body[e] = bodies
        table.slot[e] = slots(bodies, context)
    return table


@kernel(inline=True)
def _flow(laws, ratios, capacities, pump, turbine):
    """(torque of the pump, its derivatives by both rates, torque of the turbine, its derivatives by both)."""
    zero = 0.0 * pump
    if pump.real >= turbine.real:
        if pump.real <= 0.0:
            return zero, zero, zero, zero, zero, zero
        nu = turbine / pump
        moves = 1.0
        if nu.real < 0.0:
            nu = 0.0 * nu
            moves = 0.0
        ratio, ratio_slope, _ = evaluate_law(laws, ratios, nu)
        capacity, slope, _ = evaluate_law(laws, capacities, nu)
        slope = moves * slope
        ratio_slope = moves * ratio_slope
        torque = capacity * pump * pump
        by_pump = (2.0 * capacity - slope * nu) * pump
        by_turbine = slope * pump
        leans = ratio_slope * capacity * pump
        return torque, by_pump, by_turbine, ratio * torque, ratio * by_pump - leans * nu, ratio * by_turbine + leans
    if turbine.real <= 0.0:
        return zero, zero, zero, zero, zero, zero
    nu = pump / turbine
    moves = 1.0
    if nu.real < 0.0:
        nu = 0.0 * nu
        moves = 0.0
    capacity, slope, _ = evaluate_law(laws, capacities, nu)
    slope = moves * slope
    torque = -capacity * turbine * turbine
    by_pump = -slope * turbine
    by_turbine = -(2.0 * capacity - slope * nu) * turbine
    return torque, by_pump, by_turbine, torque, by_pump, by_turbine


@kernel(borrow=True)
def converter_forces(table, now, effects, out):
    """Accumulate forces and tangents of all torque converters (contract: solver/elements/__init__.py)."""
    f, Kq, Kv = sums(effects)
    coordinates, kin, angle = now.coordinates, now.kin, now.angle
    for e in range(table.coordinate.shape[0]):
        p = table.coordinate[e, 0]
        t = table.coordinate[e, 1]
        _, g0, g1 = evaluate_coordinate(coordinates, kin, p, angle)
        _, g2, g3 = evaluate_coordinate(coordinates, kin, t, angle)
        pump = coordinate_rate(coordinates, kin, p, g0, g1)
        turbine = coordinate_rate(coordinates, kin, t, g2, g3)
        T_p, p_p, p_t, T_t, t_p, t_t = _flow(now.laws, table.law[e, 0], table.law[e, 1], pump, turbine)
        add_gradient(-T_p, g0, table.body[e, 0], f)
        add_gradient(-T_p, g1, table.body[e, 1], f)
        add_gradient(T_t, g2, table.body[e, 2], f)
        add_gradient(T_t, g3, table.body[e, 3], f)
        if now.tangents:
            h0, h1 = coordinate_rate_gradient(coordinates, kin, p)
            h2, h3 = coordinate_rate_gradient(coordinates, kin, t)
            none = scale6(0.0, g0)
            rows = (scale6(-1.0, g0), scale6(-1.0, g1), none, none)
            g = (scale6(p_p, g0), scale6(p_p, g1), scale6(p_t, g2), scale6(p_t, g3))
            h = (scale6(p_p, h0), scale6(p_p, h1), scale6(p_t, h2), scale6(p_t, h3))
            add_generalized_on(rows, g, h, 4, 0.0, -1.0, table.slot, e, Kq, Kv)
            rows = (none, none, g2, g3)
            g = (scale6(t_p, g0), scale6(t_p, g1), scale6(t_t, g2), scale6(t_t, g3))
            h = (scale6(t_p, h0), scale6(t_p, h1), scale6(t_t, h2), scale6(t_t, h3))
            add_generalized_on(rows, g, h, 4, 0.0, -1.0, table.slot, e, Kq, Kv)
            add_coordinate_hessian(coordinates, kin, p, -T_p, Kq)
            add_coordinate_hessian(coordinates, kin, t, T_t, Kq)
        out[e, 0] = 0.0
        out[e, 1] = T_p * pump - T_t * turbine
        out[e, 2] = pump
        out[e, 3] = turbine
        out[e, 4] = -T_p
        out[e, 5] = T_t


CONVERTERS = ForceKind(
    name='converters',
    spec=ConverterSpec,
    compile=compile_converters,
    kernel=converter_forces,
    outputs=OUTPUTS,
    effort=('on_pump', 'on_turbine'),
)
