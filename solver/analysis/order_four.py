"""Order four on trial: whether `integrator.order: 4` is the cheaper way to accuracy for a scene, measured on the scene.

A step of order four takes three times the work of one of order two (docs/decisions/0017), so with steps that are
RATIO times as long it takes about as much. It pays where its error is smaller than that of order two with the same
work, which falls with the square of that. Smooth motions have it so. The errors of both are measured, each by a second
run with another step; work is counted in evaluations of all forces. Two reasons against it are known without a run: a
driver or an assistance looks once a step, so every method is of first order, and vibrations on bushings that a step
does not resolve grow.
"""

from __future__ import annotations

import numpy as np

from solver.analysis.error_bar import order
from solver.analysis.error_curves import curves_of
from solver.checks.error import LIMITS
from solver.errors import MbdError
from solver.simulation import Simulation
from solver.step.extrapolation import SHAKEN, fastest_on_bushings

RATIO = 4  # steps of order four over those of order two; with ten times as much a car would turn by radians in a step
LEAST_ITERATIONS = 3  # of order four
MOST = 5000  # steps of a trial; ten times as many take ten times as long and change no answer that was tried
FEWEST = 64  # steps of a trial: with fewer nothing falls as it should


def order_four(simulation: Simulation) -> str:
    """Sentence on whether order four pays; nothing where the integrator is no candidate: another kind, order four
    already, error control, or a level without bodies."""
    given = simulation.scene.integrator
    if not simulation.of_bodies or given.kind != 'alf' or given.order == 4 or given.step_policy == 'error':
        return ''
    if order(simulation) == 1:
        return 'does not pay: a driver or an assistance looks once a step, so errors fall with the step alone'
    frequency, body = fastest_on_bushings(simulation.model)
    if frequency * RATIO * given.h > SHAKEN:
        return (
            f'does not pay: body {body!r} vibrates on its bushings with {frequency:.3g} rad/s, which takes steps of '
            f'{1e3 * SHAKEN / frequency:.2g} ms'
        )
    steps = min(simulation.scene.steps, MOST) // (2 * RATIO) * (2 * RATIO)
    return _tried(simulation, steps) if steps >= FEWEST else ''


def _tried(s: Simulation, steps: int) -> str:
    """The sentence by four runs of so many steps h: order two with h and 2 h, order four with RATIO h and half of
    it."""
    h, given = s.h, s.scene.integrator
    four = {'order': 4, 'rho_inf': 1.0, 'iterations': max(LEAST_ITERATIONS, given.iterations)}
    ways = {
        'two': {},
        'coarse': {'h': 2.0 * h},
        'four': {'h': RATIO * h, **four},
        'finer': {'h': RATIO / 2 * h, **four},
    }
    rows, work = {}, {}
    for name, way in ways.items():
        settings = {key: round(value * 1e9) * 1e-9 if key == 'h' else value for key, value in way.items()}
        try:
            twin = s.twin(steps * h, **settings)
            each = round(RATIO * h / twin.h)
            rows[name] = np.array(
                [twin.snapshot().numbers] + [twin.advance(each).numbers for _ in range(steps // RATIO)]
            )
        except MbdError as error:
            return '' if 'order' not in way else f'does not pay: {error}'
        work[name] = twin.totals()['evaluations']
    errors = {}
    for name, other, part in (('two', 'coarse', 1.0 / 3.0), ('four', 'finer', 16.0 / 15.0)):
        shares = [
            (part * c.apart(rows[name], rows[other]) / c.peaks(rows['two'])).max()
            for c in curves_of(s)
            if c.name in LIMITS
        ]
        errors[name] = float(max(shares))
    cost = work['four'] / work['two']
    alike = errors['two'] / cost**2  # order two with so much work
    pays = errors['four'] < alike
    how = f' (integrator: {{order: 4, rho_inf: 1, iterations: {four["iterations"]}, h: {RATIO * h:.6g}}})'
    return (
        f'{"pays" if pays else "does not pay"}: in {steps * h:.3g} s steps of {1e3 * RATIO * h:.3g} ms are right to '
        f'{errors["four"]:.1e} of the peak, order two to {alike:.1e} with the same work, {cost:.2g} times that of '
        f'steps of {1e3 * h:.3g} ms{how if pays else ""}'
    )
