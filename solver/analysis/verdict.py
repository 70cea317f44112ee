"""The verdict on a run: 'ok', or 'suspect' with findings that say what is beyond what a sound run of this method shows.

Where the scene requires a limit itself (`require`), it replaces the default of that quantity. The defaults follow from the method:

*Energy.* A second-order method that takes a period in twenty steps (omega h = 0.31) misses (omega h)^2/12 = 0.8 % of the energy that
moves to and fro. So 1 % of what was exchanged may be missing (solver.output.energy), besides (turn in a step)^2/12 of the kinetic energy of
bodies that turn, in which energy goes from axis to axis unseen by that account, and what numbers written with six digits leave open.
*Iteration.* A step is accepted when what its iteration leaves is below LARGEST_STAGNATION of the velocity; over a step that is a
distance. Residual, drift of velocities and drift of positions must not show more than that, and all but few steps a digit less.
*Turn.* The iteration contracts by about the turn of a body per step (docs/decisions/0002).
*Road.* A tire touches the road at one point. Of a hollow that is rounder than the wheel, an edge above all, a wheel makes a profile
no rounder than itself (Pacejka 2012, 10.1.5); without that the point of contact jumps, and loads are many times too large.
*Validity.* A level of detail says where it holds (solver.levels); a run that it follows says how far it went.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from solver.compiled.portable import norm
from solver.elements.road import HeightGrid
from solver.output import energy as account
from solver.simulation import Simulation
from solver.step.failure import LARGEST_TURN_PER_STEP
from solver.step.iteration import LARGEST_STAGNATION

SHARE = 0.01  # of the exchanged energy
TRUNCATION = 1.0 / 12.0  # of (turn in a step)^2
WRITTEN = 1e-6  # relative, and m: what numbers written with finitely many digits leave open
UNSETTLED_SHARE = 0.01  # of the steps: an impact may leave a step a digit less exact, the motion between may not
SUSPECT, OK = 'suspect', 'ok'


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What makes a run suspect.

    quantity: as in `require` where there is such a limit. time: of the worst instant [s], None when it has none. where: the body or
    constraint row that is worst, or empty. required: whether the limit is one that the scene requires.
    """

    quantity: str
    value: float
    limit: float
    unit: str
    time: float | None
    where: str
    required: bool
    text: str

    def __str__(self) -> str:
        return self.text


def findings(simulation: Simulation, real_time_factor: float | None = None) -> list[Finding]:
    """Everything that makes the run so far suspect, from the running account of steps advanced with audit."""
    s = simulation
    found = [_energy(s), *_iteration(s), _turn(s), _road(s), _branches(s), _speed(s, real_time_factor), *_validity(s)]
    return [finding for finding in found if finding]


def passes(simulation: Simulation, found: list[Finding]) -> bool:
    """Whether a run with these findings is one the scene allows."""
    return all(simulation.scene.require.allow_suspect and not finding.required for finding in found)


def report(found: list[Finding]) -> list[dict[str, Any]]:
    """Findings as objects for JSON."""
    return [asdict(finding) for finding in found]


def exchanged(simulation: Simulation) -> float:
    """Energy [J] that was exchanged so far: supplied and dissipated, and the ranges of kinetic and potential energy."""
    a = simulation.last_step.energy
    kinetic, potential = a[account.KINETIC_HIGH] - a[account.KINETIC_LOW], a[account.POTENTIAL_HIGH] - a[account.POTENTIAL_LOW]
    return float(a[account.GROSS] + kinetic + potential)


def allowed_energy_error(simulation: Simulation) -> float:
    """The default limit of the energy error [J]."""
    a, bodies = simulation.last_step.energy, simulation.model.tables.bodies
    weight = float(np.add.reduce(bodies.mass)) * norm(bodies.gravity)
    open_ = WRITTEN * (weight + a[account.KINETIC_HIGH])
    return SHARE * exchanged(simulation) + TRUNCATION * float(a[account.TURNING]) + float(open_)


def _finding(
    quantity: str, value: float, default: float, required: float | None, unit: str, time: float | None, where: str, text: str, remedy: str
) -> Finding | None:
    limit = default if required is None else required
    if value <= limit:
        return None
    at = '' if time is None else f' at t = {time:.6g} s'
    place = f', {where}' if where else ''
    of = 'the limit' if required is None else 'the limit required in the scene,'
    sentence = f'{text} {value:.3g} {unit}'.rstrip() + f'{at}{place}; {of} {limit:.3g} {unit}'.rstrip() + f'; {remedy}'
    return Finding(
        quantity=quantity, value=float(value), limit=float(limit), unit=unit, time=time, where=where, required=required is not None,
        text=sentence,
    )  # fmt: skip


def _energy(s: Simulation) -> Finding | None:
    a, moved = s.last_step.energy, exchanged(s)
    worst = float(a[account.WORST])
    remedy = f'{moved:.3g} J were exchanged in all; reduce integrator.h, or find what is stiffer or faster than the step resolves'
    return _finding(
        'energy_error_max', worst, allowed_energy_error(s), s.scene.require.energy_error_max, 'J', float(a[account.WORST_AT]), '',
        'the energy account misses', remedy,
    )  # fmt: skip


def _iteration(s: Simulation) -> list[Finding | None]:
    a, need = s.last_step.energy, s.scene.require
    speed = max(1.0, float(a[account.SPEED]))
    rows, bodies = s.model.row_names, s.model.body_names
    fixed = s.scene.integrator.mode == 'fixed'
    finer = 'take more integrator.iterations, or integrator.mode: tolerance' if fixed else 'let integrator.step_policy divide such steps'
    unsettled = f'the last increment of the iteration is above {account.SETTLED:g} of the velocity in'

    def noted(entry: int, names: list[str] | tuple[str, ...], what: str) -> tuple[float, float, str]:
        value, time, index = (float(x) for x in a[entry : entry + 3])
        return value, time, f'{what} {names[int(index)]!r}' if value > 0.0 and names else ''

    residual = noted(account.RESIDUAL, bodies, 'most in body')
    position = noted(account.POSITION, rows, 'constraint')
    velocity = noted(account.VELOCITY, rows, 'constraint')
    steps = max(float(a[account.STEPS]), 1.0)
    return [
        _finding('residual_max', residual[0], LARGEST_STAGNATION, need.residual_max, '', *residual[1:],
                 'a step did not settle: the last increment of its iteration is of the velocity', f'reduce integrator.h, or {finer}'),
        _finding('unsettled', float(a[account.UNSETTLED]) / steps, UNSETTLED_SHARE, None, 'of the steps', None, '',
                 unsettled, f'reduce integrator.h, or {finer}'),
        _finding('position_drift_max', position[0], LARGEST_STAGNATION * speed * s.h, need.position_drift_max, 'm or rad', *position[1:],
                 'a constraint is open by', 'reduce integrator.h, raise integrator.penalty, or check whether joints contradict each other'),
        _finding('velocity_drift_max', velocity[0], LARGEST_STAGNATION * speed, need.velocity_drift_max, 'm/s or rad/s', *velocity[1:],
                 'a velocity violates its constraint by', 'reduce integrator.h or raise integrator.penalty'),
    ]  # fmt: skip


def _turn(s: Simulation) -> Finding | None:
    if s.scene.integrator.kind.startswith('reference_'):
        return None  # these choose their own steps
    turn, time, body = (float(x) for x in s.last_step.energy[account.TURN : account.TURN + 3])
    place = f'body {s.model.body_names[int(body)]!r}'
    return _finding('turn_per_step', turn, LARGEST_TURN_PER_STEP, None, 'rad per step', time, place, 'a body turns by',
                    'reduce integrator.h')  # fmt: skip


def _road(s: Simulation) -> Finding | None:
    if not s.model.spec.tires:
        return None
    worst, place = 0.0, ''
    for k, grid in enumerate(s.model.spec.road.grids):
        if not isinstance(grid, HeightGrid):
            continue  # the spectrum of a random road ends where the tire envelops
        for axis, step in enumerate(grid.step):
            hollow = np.diff(np.array(grid.height), 2, axis=axis) / step**2
            if hollow.size and hollow.max() > worst:
                worst, (i, j) = float(hollow.max()), np.unravel_index(int(np.argmax(hollow)), hollow.shape)
                place = f'road.grids[{k}].height[{i + (axis == 0)}][{j + (axis == 1)}]'
    smallest = min(tire.data.values['UNLOADED_RADIUS'] for tire in s.model.spec.tires)
    return _finding('road_curvature', worst, 1.0 / smallest, None, '1/m', None, place, 'a hollow of the road is rounder than the wheels:',
                    'give the profile that the wheel makes of the obstacle (scene car_cleat)')  # fmt: skip


def _branches(s: Simulation) -> Finding | None:
    events = s.switches
    if not events:
        return None
    remedy = 'reduce integrator.h, or give integrator.rho_inf some damping'
    if s.branches is None:
        remedy = f'a step that failed was divided, and the steps after it went another way; {remedy}'
    return _finding('branch_switches', len(events), 0, s.scene.require.branch_switches_max, '', events[0].t, '', 'branch switches:', remedy)


def _speed(s: Simulation, factor: float | None) -> Finding | None:
    limit = s.scene.require.real_time_factor_min
    if limit is None or factor is None or factor >= limit:
        return None
    text = f'the real-time factor is {factor:.3g}; the scene requires at least {limit:.3g}; take a larger integrator.h or a faster machine'
    return Finding(quantity='real_time_factor_min', value=factor, limit=limit, unit='', time=None, where='', required=True, text=text)


def _validity(s: Simulation) -> list[Finding | None]:
    """What left the limits of the level."""
    found: list[Finding | None] = []
    for limit in s.level.validity if s.level is not None else ():
        if limit.quantity not in s.reached:
            continue
        value, time = s.reached[limit.quantity]
        high = limit.high if limit.high is not None else np.inf
        text = f'the run leaves where its level of detail holds ({limit.why}): {limit.quantity}'
        found.append(
            _finding('validity', value, high, None, limit.unit, time, '', text, 'take a level with more detail, or fidelity: full')
        )
    return found
