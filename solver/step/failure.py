"""Why a step failed, as a sentence that names the place and a remedy."""

from __future__ import annotations

import numpy as np

from solver.compiled.by_reference import Ref
from solver.compiled.portable import norm, norms, product
from solver.model.state import State, kinematics_of
from solver.model.tables import Model
from solver.output.account import noted
from solver.output.dependence import hardly_held
from solver.output.energy import contradicts
from solver.step.iteration_fixed import MOST_ITERATIONS
from solver.step.settings import IntegratorSettings
from solver.step.work import BAD_INPUT, INACCURATE, NON_FINITE, NOT_CONVERGED, SINGULAR, StepResult

# with larger ones solutions of the condensed form of a car have errors that show (docs/formulation.md, "Rounding")
ROUNDING_PENALTY = 1e7
MORE_DIGITS = 'give their markers and axes with more digits, or a joint with fewer rows'
FLAT = 0.03  # rad that a disc leans from its plane
LARGEST_TURN_PER_STEP = 1.0  # rad; the iteration contracts by about the turn of a body per step (docs/decisions/0002)


def sentence(
    model: Model, settings: IntegratorSettings, scheme: Ref, state: State, work: Ref, result: StepResult, when: str
) -> str:
    """Sentence on a step that failed. state: from which it started; work: as the step and those before it left it;
    when: instant and number of the step."""
    when = f'{when}: {_fast_turn(model, settings.h, state)}'
    where = result.where
    if result.status == NON_FINITE:
        body = model.body_names[where]
        return (
            when
            + f'the motion of body {body!r} is no longer finite; reduce integrator.h or check the loads on that body'
        )
    if result.status == SINGULAR:
        if where >= model.n_bodies:
            name = model.group_names[where - model.n_bodies]
            return when + (
                f'the step matrix is singular at constraint {name!r}; use integrator.form: condensed or a smaller '
                'integrator.penalty'
            )
        return when + (
            f'the step matrix is singular at body {model.body_names[where]!r}: a part of its motion has neither '
            'inertia nor constraint nor stiffness; give the body mass and inertia, or constrain that motion'
        )
    if result.status == BAD_INPUT:
        return when + f'input {model.spec.inputs[where]!r} is not finite; nothing was advanced'
    smallest, remedy = f'{settings.smallest_step:g} s, a small part of integrator.h', 'reduce integrator.h'
    if settings.h_min:
        smallest, remedy = f'the smallest step integrator.h_min = {settings.h_min:g}', 'reduce it'
    if result.status == INACCURATE:
        tolerance = settings.error_tolerance
        said = f'the error stays above integrator.error_tolerance = {tolerance:g} with {smallest}'
        row = hardly_held(model, work.J_end)
        if row:
            return when + (
                f'{said}: the mechanism passes next to a singular position, where constraint {row!r} hardly holds it '
                'and rounding alone leaves more; take integrator.step_policy: rescue, the default, which passes it'
            )
        return when + f'{said}; {remedy} or allow more'
    assert result.status == NOT_CONVERGED
    phi, account = work.phi_end, work.account
    worst = int(np.argmax(np.abs(phi))) if model.n_rows else -1
    name = f', worst constraint {model.row_names[worst]!r} ({abs(phi[worst]):.2g})' if worst >= 0 else ''
    if settings.step_policy == 'constant':
        remedy = 'reduce integrator.h, or let such steps be divided (integrator.step_policy: rescue)'
    else:
        remedy = f'not even with {smallest}: {remedy} or raise the penalties'
    if settings.form == 'condensed' and scheme.penalty.max(initial=0.0) > ROUNDING_PENALTY:
        remedy = (
            f'the penalty {scheme.penalty.max():.3g} is so large that its rounding spoils the condensed matrix: reduce '
            f'integrator.penalty to {ROUNDING_PENALTY:.0e} or less, or take integrator.form: block'
        )
    if contradicts(account, model.tables.bodies, work.length)[0]:
        row = model.row_names[noted(account.contradiction)[2]]
        remedy = f'redundant joints contradict each other, most at constraint {row!r}: {MORE_DIGITS}'
    fallen = _fallen_disc(model, state)
    if fallen:
        remedy = (
            f'the disc of contact {fallen!r} has fallen flat on its plane, where it has no lowest point to roll '
            'on: end the run before'
        )
    tried = max(scheme.iterations, MOST_ITERATIONS if scheme.fixed == 1 else 0)
    return when + f'no convergence in {tried} iterations (residual {result.counters.residual:.2g}{name}); {remedy}'


def _fallen_disc(model: Model, state: State) -> str:
    """The contact whose rolling disc lies nearly flat, or nothing."""
    R, contacts = kinematics_of(state.q, state.v).R, model.elements['contacts']
    for k, spec in enumerate(model.spec.contacts):
        i, j = contacts.body[k]
        normal, axis = product(R[i], contacts.F[k][:, 2]), product(R[j], contacts.G[k][:, 2])
        if spec.kind == 'rolling' and norm(np.cross(normal, axis)) < FLAT:
            return spec.name
    return ''


def _fast_turn(model: Model, h: float, state: State) -> str:
    """The body that turns too far in a step of h [s] for the iteration to follow, or nothing."""
    turns = h * norms(state.v[:-1, 3:])
    body = int(np.argmax(turns))
    if not turns[body] > LARGEST_TURN_PER_STEP:
        return ''
    return f'body {model.body_names[body]!r} turns by {turns[body]:.2g} rad per step of integrator.h = {h:g}; '
