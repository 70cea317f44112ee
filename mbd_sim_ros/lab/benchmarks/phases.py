"""Phases of a step and their times: its compiled pieces, each repeated on the data that a real step left behind.

A clock between the pieces would cost as much as the smaller ones and would keep the compiler from what it does in the
step. So every piece runs a few hundred times in one compiled loop, and the time per call is multiplied by the calls a
step makes. Repeated pieces find their data in the cache, and the compiler joins them differently than inside a step:
the sum is an estimate, and its difference to the measured step is reported as `rest`.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from statistics import median
from typing import Any

from solver.compiled.by_reference import Ref
from solver.compiled.kernel import address_of, kernel
from solver.elements.registry import FORCES as FORCE_KINDS
from solver.model.evaluate import add_constraint_forces, evaluate_constraints, evaluate_forces
from solver.model.saddle import CONDENSED, factorize_saddle, new_saddle, solve_saddle
from solver.model.state import copy_state, new_state, update_angles
from solver.model.tables import FACTORIZE
from solver.output.energy import update_energy
from solver.output.snapshot import layout_of, new_numbers, output_arrays
from solver.simulation import Simulation
from solver.step.augmented_lagrangian import advance, project_velocity, step
from solver.step.iteration import assemble
from solver.step.stage import AT_END, BOTH, WITH_TANGENTS, momentum_residual, place
from solver.step.work import new_work

PLACE_TANGENTS, PLACE, PLACE_END, TANGENTS, FORCES, CONSTRAINTS, RESIDUALS, RESIDUAL, ASSEMBLE = range(9)
FACTORIZE_ALL, SOLVE, PROJECT, OUTPUTS = range(9, 13)
PHASES = {
    'placement': 'configuration, rotation tangents and velocities of the stage and the end',
    'forces and tangents': 'all force elements with Kq and Kv',
    'forces alone': 'all force elements, without tangents',
    'constraints': 'residuals and Jacobian blocks at the stage and at the end',
    'residual': 'constraint forces and momentum residual',
    'assembly': 'constraint stiffness, effective masses, step matrix without constraints',
    'penalties': 'constraints into the step matrix',
    'elimination': 'block LU',
    'solution': 'right-hand side, back-substitution, multipliers',
    'projection': 'unwrapped angles, constraints at the end, projected velocity',
    'outputs': 'forces at the end of the step and the energy balance',
    'rest': 'the measured step less the sum of the above',
}


@kernel(borrow=True)
def repeat(phase, count, tables, c, s0, s1, u, work):
    """Run one piece of a step `count` times; s0, s1 and work as a step from s0 to s1 left them."""
    h = c.h
    s = 1.0 - c.af
    cz = s * c.gamma1 * h / (1.0 - c.am1)
    saddle = work.saddle
    to_g = (1.0 / (c.gamma * h), 1.0 / (c.beta * h * h))
    for _ in range(count):
        if phase == PLACE_END:
            place(tables, c, s0, s1.a, s1.q, AT_END, work)
        elif phase in (PLACE_TANGENTS, PLACE):
            place(tables, c, s0, s1.a, s1.q, WITH_TANGENTS if phase == PLACE_TANGENTS else BOTH, work)
        elif phase in (TANGENTS, FORCES):
            tangents = phase == TANGENTS
            evaluate_forces(
                tables,
                work.kin_stage,
                s0.angle,
                work.zp,
                cz,
                u,
                tangents,
                work.f,
                work.Kq,
                work.Kv,
                work.z_stage,
                work.outputs,
            )
        elif phase in (CONSTRAINTS, RESIDUALS):
            evaluate_constraints(tables, work.kin_stage, s0.angle, u, True, work.phi_stage, work.J_stage)
            evaluate_constraints(tables, work.kin_end, s0.angle, u, phase == CONSTRAINTS, work.phi_end, saddle.J_force)
        elif phase == RESIDUAL:
            add_constraint_forces(tables.constraints, work.J_stage, s1.lam, 1.0, work.f)
            momentum_residual(tables, c, s0.a, s1.a, work.f, work.r)
        elif phase in (ASSEMBLE, FACTORIZE_ALL):
            assemble(tables, c, s1.lam, to_g, work)
            if phase == FACTORIZE_ALL:
                factorize_saddle(tables, c.form, saddle)
        elif phase == SOLVE:
            solve_saddle(tables, c.form, saddle, work.r, work.g, work.dw, work.dlam)
        elif phase == PROJECT:
            update_angles(tables.coordinates, work.kin_end, s1.angle)
            evaluate_constraints(tables, work.kin_end, s1.angle, u, True, work.phi_end, work.J_end)
            project_velocity(tables, c, s1.v, u, 1 if c.fixed == 1 else 3, work)
        else:
            evaluate_forces(
                tables,
                work.kin_end,
                s1.angle,
                s1.z,
                0.0,
                u,
                False,
                work.f,
                work.Kq,
                work.Kv,
                work.z_stage,
                work.outputs,
            )
            update_energy(tables, work.kin_end, work.outputs, work.lam_out, work.phi_t, h, work.account)


@kernel(borrow=True)
def _eliminate_nothing(plan, B, T):
    """Stands in for solver.linear.elimination.factorize, so that what comes before it can be timed alone."""
    T[0, 0] = -1.0


def _no_elimination(simulation: Simulation, saddle: Any) -> Ref:
    """The tables of the model with a factorization that does nothing."""
    tables = simulation.model.tables
    plan = tables.condensed if simulation.scheme.form == CONDENSED else tables.block
    linear = tables.linear.copy()
    linear[FACTORIZE] = address_of(_eliminate_nothing, Ref(plan), saddle.B, saddle.T)
    return Ref(tables.value._replace(linear=linear))


def phase_times(simulation: Simulation, rounds: int, count: int = 200) -> tuple[dict[str, float], dict[str, float]]:
    """CPU times [us] at the current state, medians over `rounds`: of every phase per step, and of every kind of force
    element per call.

    Measured is a step with outputs and audit (`whole`, its mean over the next `count` steps); element kinds with
    tangents. The simulation is left as it was.
    """
    model, c, layout = simulation.model, simulation.scheme, layout_of(simulation.channels)
    work = new_work(model, new_saddle(model, c.form), model.new_outputs(), output_arrays(new_numbers(layout), layout))
    whole_tables, plain, bodies_alone = model.tables, _no_elimination(simulation, work.saddle), model.only(None)
    kinds = {kind.name: model.only(kind.name) for kind in FORCE_KINDS if getattr(model.spec, kind.name)}
    inputs = simulation.source.table(simulation.k, count)
    start = new_state(simulation.model)
    copy_state(simulation.state, start)
    first = new_state(simulation.model)
    s0, s1 = Ref(first), Ref(new_state(simulation.model))

    def piece(phase: int, tables: Ref = whole_tables) -> float:
        copy_state(start, first)
        step(whole_tables, c, s0, s1, inputs[0], True, work)  # repeated pieces may add up what a step clears
        begin = time.thread_time_ns()
        repeat(phase, count, tables, c, s0, s1, inputs[0], work)
        return (time.thread_time_ns() - begin) / count * 1e-3

    def one_round() -> dict[str, float]:
        copy_state(start, first)
        begin = time.thread_time_ns()
        result, _ = advance(whole_tables, c, s0, s1, inputs, 0, count, True, work)
        whole = (time.thread_time_ns() - begin) / count * 1e-3
        n, factorizations = result.counters.iterations / count, result.counters.factorizations / count
        assembly, complete = piece(ASSEMBLE), piece(FACTORIZE_ALL)
        before_elimination = piece(FACTORIZE_ALL, plain)
        found = {
            'placement': factorizations * piece(PLACE_TANGENTS)
            + (n - factorizations) * piece(PLACE)
            + piece(PLACE_END),
            'forces and tangents': factorizations * piece(TANGENTS),
            'forces alone': (n - factorizations) * piece(FORCES),
            'constraints': factorizations * piece(CONSTRAINTS) + (n - factorizations) * piece(RESIDUALS),
            'residual': n * piece(RESIDUAL),
            'assembly': factorizations * assembly,
            'penalties': factorizations * (before_elimination - assembly),
            'elimination': factorizations * (complete - before_elimination),
            'solution': n * piece(SOLVE),
            'projection': piece(PROJECT),
            'outputs': piece(OUTPUTS),
        }
        return {**found, 'rest': whole - sum(found.values()), 'whole': whole}

    def elements() -> dict[str, float]:
        none = piece(TANGENTS, bodies_alone)
        return {**{name: piece(TANGENTS, alone) - none for name, alone in kinds.items()}, 'bodies': none}

    saved = simulation.save()
    try:
        one_round()  # warm
        measured = [(one_round(), elements()) for _ in range(rounds)]
    finally:
        simulation.restore(saved)
    phases, per_kind = zip(*measured, strict=True)
    return _medians(phases), _medians(per_kind)


def _medians(rows: Sequence[dict[str, float]]) -> dict[str, float]:
    return {name: float(median(row[name] for row in rows)) for name in rows[0]}
