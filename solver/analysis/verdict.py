"""The verdict on a run: 'ok', or 'suspect' with findings that say what is beyond what a sound run of this method shows.

Where the scene requires a limit itself (`require`), it replaces the default of that quantity. The defaults follow from the method:

*Energy.* A second-order method that takes a period in twenty steps (omega h = 0.31) misses (omega h)^2/12 = 0.8 % of the energy that
moves to and fro. So 1 % of what was exchanged may be missing (solver.output.energy), besides (turn in a step)^2/12 of the kinetic energy of
bodies that turn, in which energy goes from axis to axis unseen by that account, and what numbers leave open.
*Iteration.* A step is accepted when what its iteration leaves is below LARGEST_STAGNATION of the velocity; over a step that is a
distance. Residual, drift of velocities and drift of positions must not show more than that, and all but few steps a digit less.
*Resolution.* Of a motion that takes a period in N steps an acceleration changes, over a step and times the step, by (2 pi / N)^2 of the
amplitude of its velocity. So it must not change by more than (2 pi / 10)^2 of half the widest range that a velocity had in the run, which a
steady motion in common does not widen: with fewer than ten steps a period, positions are off by 3 % of what they do. Translation and
rotation are looked at apart. What vibrates fast but little passes, a stiff transient that sets the whole motion going does not. After
fewer steps than half such a period nothing can be said.
*Phase.* Of such a motion with the frequency w a step h costs (w h)^3 / 12 of phase. Added up over all steps, with (w h)^2 as above at the
time, that must stay below 0.1 rad; what is really lost is up to twice that, a fifth of the amplitude. Where it is more, amplitudes may be
right, but not where something is at an instant. A motion forgets its phase with its energy: of the largest kinetic energy so much as is
dissipated takes half as much of the phase with it; and where it swings wider, what it was late by before is so much less of it.
*Spin.* A step gives a body that spins with s, its moment of inertia across the spin A, A s^3 h^2 / 12 of a rate of its axis too much.
A disc hardly feels that. It can be many times what a thin rod has of gyroscopic torque, and in the axes of the world nothing shows.
What that turns of the motion counts as phase of angular velocities, too.
*Damping.* Both are the midpoint rule's, rho_inf = 1. Numerical damping makes more of the same step: late_by() times the phase, so that as
much accuracy takes more steps a period, by the root of it.
*Inputs.* A step takes one value of every signal: of one that swings with the steps, or nearly, it makes a constant or a slow beat, which
no motion shows (solver.inputs.unresolved). Of recorded ones nothing may be left out, merged or put in another order.
*Rounding.* A penalty multiplies the rounding of the condensed matrix; the block form does not care (docs/formulation.md, "Rounding"). It is
told where iterations do not settle with one that is too large.
*Light bodies.* Penalties take a body for no lighter than 1e-4 of the mean: of one with less mass m they add eps penalty 1e-4 mean / m of
rounding to its own acceleration. Beside 1 kg a pendulum of 1e-8 kg is right, one of 1e-10 kg was off by 0.03 m and nothing else told it.
*Distance.* A place at the distance D is rounded by eps D in every step, and a velocity of the step by eps D / h: over n steps these walk to
sqrt(n) times as much, of which 3e-5 of half that widest range (at least 1 m/s) is left to be. Regular motions hardly feel it; at a
singular position it chooses how a mechanism passes: of twelve slider-cranks with 4e-5 the worst was off by 1.7e-4 m after a second.
*Account.* Of steps that were advanced without it nothing is known, nor of a run whose forces or energies are too large for numbers: it
compares with nothing then.
*Contradiction.* Redundant rows that cannot all be closed, as axes that are parallel to seven digits, hold each other with multipliers that
grow from step to step: those of a four-bar linkage out by 1e-7 came to 5e5 N and turned it 2 rad too far, with its energy kept. What
multipliers that balance each other have in rows that stay open is below 1e-10 of what is exchanged in sound runs.
*Turn.* The iteration contracts by about the turn of a body per step (docs/decisions/0002).
*Rotation.* A bushing acts on its rotation vector, which is the short way round: where it turns by pi that jumps, and the torque with it,
without a trace in the account of energy. It is told from 3 rad on, which no step of less than 0.28 rad leaps over, where
bushings resist turning.
*Road.* A tire touches the road at one point. Of a hollow that is rounder than the wheel, an edge above all, a wheel makes a profile
no rounder than itself (Pacejka 2012, 10.1.5); without that the point of contact jumps, and loads are many times too large.
*Tires.* A tire cannot be pressed in by more than what is between its tread and the rim, without rim data than its radius. Its spring and
the rim go on beyond that, along straight lines that nobody has measured.
*Steering.* A steering ends at its stops, before its tie rods pass their dead centres (solver.vehicle.end_stops); there it is held.
What else no vehicle can do is seen in its motion (solver.analysis.impossible).
*Validity.* A level of detail says where it holds (solver.levels); a run that it follows says how far it went.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import asdict
from typing import Any

import numpy as np

from solver.analysis.exchange import allowed_energy_error
from solver.analysis.turned import caused
from solver.compiled.portable import norm
from solver.elements.bushing import BushingSpec
from solver.elements.road import RandomRoad, edge, envelops
from solver.findings import Finding
from solver.inputs.maneuver import ManeuverSource
from solver.inputs.recorded import RecordedSource
from solver.inputs.unresolved import LARGEST
from solver.model.saddle import CONDENSED
from solver.output.account import noted
from solver.output.energy import SETTLED, SLOWEST, contradicts, exchanged
from solver.simulation import Simulation
from solver.start.reach import beyond_reach
from solver.step.failure import LARGEST_TURN_PER_STEP, MORE_DIGITS, ROUNDING_PENALTY
from solver.step.iteration import LARGEST_STAGNATION

SPOILT = 1e-4  # last increment of an iteration, relative to the velocity, which three iterations bring below 1e-6 where nothing spoils them
LARGEST_WOUND = 3.0  # rad
HIDDEN = 3e-5  # of an acceleration
ROUNDED = 3e-5  # of half the widest range of a velocity
LARGEST_PHASE = 0.1  # rad
FEWEST = 10  # steps a period
UNSETTLED_SHARE = 0.01  # of the steps: an impact may leave a step a digit less exact, the motion between may not
STEERING_END = 'steering_end'
SUSPECT, OK = 'suspect', 'ok'


def findings(simulation: Simulation, real_time_factor: float | None = None) -> list[Finding]:
    """Everything that makes the run so far suspect, from the running account of steps advanced with audit."""
    s = simulation
    looked = [
        _endless(s),
        _energy(s),
        *_iteration(s),
        _contradiction(s),
        *_resolution(s),
        *_inputs(s),
        _steered_beyond(s),
        _rounding(s),
        _light(s),
        _distance(s),
        _unseen(s),
        _turn(s),
        _wound(s),
        _road(s),
        _pressed(s),
        _branches(s),
    ]
    found = [*looked, _speed(s, real_time_factor), *_validity(s)]
    told = [finding for finding in found if finding]
    return caused(s.model.spec, told) if s.of_bodies else told


def passes(simulation: Simulation, found: list[Finding]) -> bool:
    """Whether a run with these findings is one the scene allows."""
    return all(simulation.scene.require.allow_suspect and not finding.required for finding in found)


def report(found: list[Finding]) -> list[dict[str, Any]]:
    """Findings as objects for JSON."""
    return [asdict(finding) for finding in found]


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


def _endless(s: Simulation) -> Finding | None:
    """Energies that numbers do not hold. Sums over the steps do not come back from there."""
    a = s.last_step.account
    energies = (a.energy[0], a.work[0], a.gross[0], a.worst[0], a.kinetic[1], *a.potential)
    lost = [energy for energy in energies if not math.isfinite(energy)]
    text, remedy = 'the energy account overflows: energies in it that are too large for numbers:', 'look for a value of a wrong size'
    return _finding('not_finite', len(lost), 0.0, None, '', None, '', text, remedy)


def _energy(s: Simulation) -> Finding | None:
    a, moved = s.last_step.account, exchanged(s.last_step.account)
    if not math.isfinite(moved):
        return None  # of which _endless tells
    worst = float(a.worst[0])
    remedy = f'{moved:.3g} J were exchanged in all; reduce integrator.h, or find what is stiffer or faster than the step resolves'
    return _finding(
        'energy_error_max', worst, allowed_energy_error(s), s.scene.require.energy_error_max, 'J', float(a.worst_at[0]), '',
        'the energy account misses', remedy,
    )  # fmt: skip


def _iteration(s: Simulation) -> list[Finding | None]:
    a, need = s.last_step.account, s.scene.require
    speed = max(1.0, float(a.speed[0]))
    rows, bodies = s.model.row_names, s.model.body_names
    fixed = s.scene.integrator.mode == 'fixed'
    finer = 'take more integrator.iterations, or integrator.mode: tolerance' if fixed else 'let integrator.step_policy divide such steps'
    unsettled = f'the last increment of the iteration is above {SETTLED:g} of the velocity in'

    def worst(row: np.ndarray, names: list[str] | tuple[str, ...], what: str) -> tuple[float, float, str]:
        value, time, index = noted(row)
        return value, time, f'{what} {names[index]!r}' if value > 0.0 and names else ''

    residual = worst(a.residual, bodies, 'most in body')
    position = worst(a.position, rows, 'constraint')
    velocity = worst(a.velocity, rows, 'constraint')
    steps = max(float(a.steps[0]), 1.0)
    return [
        _finding('residual_max', residual[0], LARGEST_STAGNATION, need.residual_max, '', *residual[1:],
                 'a step did not settle: the last increment of its iteration is of the velocity', f'reduce integrator.h, or {finer}'),
        _finding('unsettled', float(a.unsettled[0]) / steps, UNSETTLED_SHARE, None, 'of the steps', None, '',
                 unsettled, f'reduce integrator.h, or {finer}'),
        _finding('position_drift_max', position[0], LARGEST_STAGNATION * speed * s.h, need.position_drift_max, 'm or rad', *position[1:],
                 'a constraint is open by', 'reduce integrator.h, raise integrator.penalty, or check whether joints contradict each other'),
        _finding('velocity_drift_max', velocity[0], LARGEST_STAGNATION * speed, need.velocity_drift_max, 'm/s or rad/s', *velocity[1:],
                 'a velocity violates its constraint by', 'reduce integrator.h or raise integrator.penalty'),
    ]  # fmt: skip


def late_by(rho_inf: float) -> float:
    """The phase that a step of the scheme loses, over the (w h)^3 / 12 of the midpoint rule: 1 + 9/2 ((1 - rho_inf) / (1 + rho_inf))^2.

    From the principal root exp(i w h (1 - c (w h)^2 + ...)) of the scheme [Chung1993] for an oscillator.
    """
    return 1.0 + 4.5 * ((1.0 - rho_inf) / (1.0 + rho_inf)) ** 2


def _resolution(s: Simulation) -> list[Finding | None]:
    """Motions that the step does not resolve."""
    a, falling = s.last_step.account, s.h * norm(s.model.tables.bodies.gravity)
    if a.steps[0] < FEWEST / 2:
        return []
    remedy = 'reduce integrator.h'
    if s.scene.integrator.order == 4:
        remedy += ', or take integrator.order: 2 (extrapolation amplifies vibrations that steps do not resolve)'
    late = late_by(s.scene.integrator.rho_inf)
    if late > 2.0:
        remedy += ', or take a larger integrator.rho_inf (numerical damping delays vibrations)'
    found = []
    for k, name in enumerate(('a velocity', 'an angular velocity')):
        change, time, body = noted(a.kick[k])
        part = change / max(float(a.swing[k]), falling, SLOWEST)
        text = f'the step does not resolve the motion: what it adds to {name} changes in a step, relative to its swing, by'
        place = f'body {s.model.body_names[body]!r}' if change > 0.0 else ''
        limit = (2.0 * math.pi / FEWEST) ** 2 / late
        found.append(_finding('resolution', part, limit, None, '', time, place, text, remedy))
        text = f'{name} of what vibrates is out of step with the motion: small errors of every period have grown to a phase of'
        found.append(_finding('phase', late * float(a.phase[k]), LARGEST_PHASE, None, 'rad', None, '', text, remedy))
    return found


def _inputs(s: Simulation) -> list[Finding | None]:
    """Signals of the maneuver that change faster than the steps, and recorded ones of which something was lost."""
    found = s.source.unresolved(s.k, s.scene.duration) if isinstance(s.source, ManeuverSource) else {}
    text = 'a signal of the maneuver swings between the steps that sample it; of its range it departs from their values by'
    remedy = 'reduce integrator.h'
    if isinstance(s.source, RecordedSource) and (doubts := s.source.given.doubts):
        text = f'the inputs are not all that was recorded: {s.source.given.where}: {"; ".join(doubts)}'
        recording = Finding(
            quantity='recorded_inputs', value=float(len(doubts)), limit=0.0, unit='', time=None, where='', required=False, text=text
        )
        return [recording]
    return [_finding('input', largest, LARGEST, None, '', first, name, text, remedy) for name, (largest, first) in found.items()]


def _steered_beyond(s: Simulation) -> Finding | None:
    """A maneuver that turns the steering wheel further than it goes."""
    found = s.source.beyond_end(s.k) if isinstance(s.source, ManeuverSource) else None
    if found is None:
        return None
    lock = s.model.spec.lock
    assert lock is not None
    text = (
        f'the maneuver asks for a steering wheel angle of {found[0]:.3g} rad, and from t = {found[1]:.6g} s on for more than the end stops '
        f'of the steering leave, where it is held; the limit {lock:.4g} rad; steer less, or give the vehicle its steering.lock'
    )
    return Finding(quantity=STEERING_END, value=found[0], limit=lock, unit='rad', time=found[1], where='', required=False, text=text)


def _contradiction(s: Simulation) -> Finding | None:
    """Redundant joints that cannot all be closed, by so little that neither their drift nor the account of energy says anything."""
    if not s.of_bodies or not s.model.n_rows:
        return None
    energy, time, row = noted(s.last_step.account.contradiction)
    text = 'redundant joints contradict each other, and the forces in which they do hold, beside what moves,'
    place = f'constraint {s.model.row_names[row]!r}'
    _, limit = contradicts(s.last_step.account, s.model.tables.bodies)
    found = _finding('contradiction', energy, limit, None, 'J', time, place, text, MORE_DIGITS)
    why = beyond_reach(s.model, s.state, s.snapshot().inputs) if found else ''
    return dataclasses.replace(found, text=why) if found and why else found


def _condensed(s: Simulation) -> bool:
    """Whether the steps solve a condensed matrix with penalties; those of a single track have no matrix."""
    return s.of_bodies and s.scene.integrator.kind == 'alf' and s.scheme.form == CONDENSED


def _rounding(s: Simulation) -> Finding | None:
    """Penalties whose rounding spoils the condensed matrix so that its iteration does not settle: of a car 1e7 leave 3e-10 m after 2 s, and
    1e8 1e-3 m."""
    spoilt = s.last_step.account.residual[0] > SPOILT and s.model.n_rows > 0
    if not spoilt or not _condensed(s):
        return None
    row = int(np.argmax(s.scheme.penalty))
    place = f'constraint {s.model.row_names[row]!r}'
    text = 'iterations do not settle because rounding of the condensed matrix shows with a penalty of'
    remedy = 'reduce integrator.penalty, or take integrator.form: block'
    return _finding('penalty', float(s.scheme.penalty[row]), ROUNDING_PENALTY, None, '', None, place, text, remedy)


def _light(s: Simulation) -> Finding | None:
    """Bodies so light beside the others that penalties on them, which have a floor, hide their inertia in the condensed matrix."""
    if s.last_step.account.steps[0] == 0.0 or not _condensed(s) or not s.model.n_rows:
        return None
    bodies = s.model.tables.bodies
    mass = np.where(bodies.mass > 0.0, bodies.mass, np.inf)  # without any mass nothing is hidden
    hidden = np.finfo(float).eps * float(s.scheme.penalty.max()) / (s.model.tables.penalty_inverse_mass * mass)
    body = int(np.argmax(hidden))
    penalty = s.scene.integrator.penalty
    text = 'rounding of the condensed matrix hides the inertia of a light body; of an acceleration of it that makes'
    remedy = f'give it {mass[body] * hidden[body] / HIDDEN:.2g} kg or more, or none where constraints determine its motion'
    if penalty > ROUNDING_PENALTY:  # the penalty is to blame, not the body
        text = f'the penalty {penalty:g} is so large that rounding hides the inertia of bodies; of an acceleration that makes'
        below = 10.0 ** math.floor(math.log10(penalty * HIDDEN / hidden[body])) if hidden[body] > HIDDEN else penalty
        remedy = f'reduce integrator.penalty to {below:.0e} or less, or take integrator.form: block'
    place = '' if penalty > ROUNDING_PENALTY else f'body {s.model.body_names[body]!r}'
    return _finding('light_body', hidden[body], HIDDEN, None, '', None, place, text, remedy)


def _distance(s: Simulation) -> Finding | None:
    """Places so far from the origin that their rounding shows."""
    a = s.last_step.account
    if a.steps[0] == 0.0 or not s.of_bodies:
        return None
    far = np.abs(s.state.q[:-1, :3]).max(axis=1)
    body = int(np.argmax(far))
    kick = np.finfo(float).eps * float(far[body]) / s.h
    text, place = 'places far from the origin are rounded; of the largest velocity that makes', f'body {s.model.body_names[body]!r}'
    value = kick * max(float(a.steps[0]), 1.0) ** 0.5 / max(1.0, float(a.swing[0]))
    remedy = 'move the model nearer to the origin, or take a larger integrator.h'
    return _finding('distance', value, ROUNDED, None, '', None, place, text, remedy)


def _unseen(s: Simulation) -> Finding | None:
    """Time that the account does not cover."""
    unseen = s.t_ns * 1e-9 - float(s.last_step.account.time[0])
    return _finding('unseen', unseen, 0.5 * s.h, None, 's', None, '', 'steps were advanced without an account, and nothing is known of',
                    'advance them with audit')  # fmt: skip


def _turn(s: Simulation) -> Finding | None:
    if s.scene.integrator.kind.startswith('reference_'):
        return None  # these choose their own steps
    turn, time, body = noted(s.last_step.account.turn)
    place = f'body {s.model.body_names[body]!r}'
    return _finding('turn_per_step', turn, LARGEST_TURN_PER_STEP, None, 'rad per step', time, place, 'a body turns by',
                    'reduce integrator.h')  # fmt: skip


def _wound(s: Simulation) -> Finding | None:
    if not s.of_bodies or not any(_resists_turning(bushing) for bushing in s.model.spec.bushings):
        return None
    angle, time, at = noted(s.last_step.account.wound)
    place = s.channels.elements[at].rpartition('/')[0] if angle > 0.0 else ''
    return _finding('rotation', angle, LARGEST_WOUND, None, 'rad', time, place, 'a bushing, whose torque changes sides at pi, turns by',
                    'take a joint for what turns so far, and a coordinate_force on its angle')  # fmt: skip


def _resists_turning(bushing: BushingSpec) -> bool:
    """Whether a bushing has a torque that depends on how far it is turned."""
    return any((*bushing.stiffness[3:], *bushing.preload[3:])) or any(law is not None for law in bushing.laws[3:])


def _road(s: Simulation) -> Finding | None:
    if not s.model.spec.tires:
        return None
    radius = min(tire.data.values['UNLOADED_RADIUS'] for tire in s.model.spec.tires)
    road, worst, place = s.model.spec.road, 0.0, ''
    for k, (grid, enveloped) in enumerate(zip(road.grids, envelops(road, radius), strict=True)):
        if enveloped or isinstance(grid, RandomRoad):
            continue  # the spectrum of a random road ends where the tire envelops
        found = edge(grid)
        if found.curvature > worst:
            worst, (i, j), (x, y) = found.curvature, found.node, found.place
            place = f'road.grids[{k}].height[{i}][{j}] at x = {x:.4g} m, y = {y:.4g} m'
    return _finding('road_curvature', worst, 1.0 / radius, None, '1/m', None, place, 'a hollow of the road is rounder than the wheels:',
                    'take road.contact: enveloping, or give the profile that the wheel makes of the obstacle')  # fmt: skip


def _pressed(s: Simulation) -> Finding | None:
    tires = s.model.spec.tires
    if not s.of_bodies or not tires:
        return None
    peaks = s.last_step.account.peak  # of tires alone
    walls = [tire.data.values['UNLOADED_RADIUS'] - tire.data.values.get('RIM_RADIUS', 0.0) for tire in tires]
    worst = int(np.argmax(peaks[:, 0] - np.array(walls)))
    value, time = (float(x) for x in peaks[worst])
    text = 'a tire is pressed in beyond its rim, by'
    remedy = 'its load means nothing there: reduce what loads it, or take a tire for such loads'
    return _finding('tire_deflection', value, walls[worst], None, 'm', time, tires[worst].name, text, remedy)


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
        if limit.quantity not in s.reached or limit.low is not None:  # ranges are followed by solver.analysis.envelope
            continue
        value, time = s.reached[limit.quantity]
        high = limit.high if limit.high is not None else np.inf
        text = f'the run leaves where its level of detail holds ({limit.why}): {limit.quantity}'
        found.append(
            _finding('validity', value, high, None, limit.unit, time, '', text, 'take a level with more detail, or fidelity: full')
        )
    return found
