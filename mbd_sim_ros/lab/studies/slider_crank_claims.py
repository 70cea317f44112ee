"""The claims of the chapter about the slider-crank, each judged by the numbers of the runs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbd_sim_ros.lab.studies import crank
from mbd_sim_ros.lab.studies.crank_history import Run

CONFIRMED, CONDITION, NOT_REPRODUCED = 'confirmed', 'confirmed with a condition', 'not reproduced'
LARGE = 2.0  # a factor from which on a variation is called significant
MORE = 1.2  # a factor from which on a number of iterations is called larger
RELATIVE_LOSS = 1e-8  # relative error of a solution that spoils an iteration to the default tolerance
SAME = 1e-9  # J, between runs that differ by rounding only


class Claim(NamedTuple):
    """What the chapter says, the verdict, and the numbers behind it."""

    claim: str
    verdict: str
    why: str


def judge(
    isolated: np.ndarray, coupled: np.ndarray, runs: dict[str, Run], conditions: list[dict[str, float]], duration: float
) -> list[Claim]:
    """All claims. isolated, coupled: (angles, rows) effective masses; runs by the labels of slider_crank.study.

    conditions: numbers of condition by penalty, condensed and block.
    """
    penalties = np.array([row['penalty'] for row in conditions])
    return [
        _masses(isolated, coupled),
        _right_mass(runs['m']),
        _wrong_mass(runs, duration),
        _range(runs, penalties),
        _small(runs, penalties),
        _excessive(runs, conditions),
        _m_alf(runs),
    ]


def _verdict(whole: bool, partly: bool) -> str:
    return CONFIRMED if whole else CONDITION if partly else NOT_REPRODUCED


def _masses(isolated: np.ndarray, coupled: np.ndarray) -> Claim:
    over = {name: float((m.max(axis=0) / m.min(axis=0)).max()) for name, m in (('isolated', isolated), ('coupled', coupled))}
    between = {name: float((m.max(axis=1) / m.min(axis=1)).max()) for name, m in (('isolated', isolated), ('coupled', coupled))}
    holds = {name: over[name] > LARGE and between[name] > over[name] for name in over}
    numbers = '; '.join(f'{name}: up to {over[name]:.3g} over a revolution, {between[name]:.3g} between constraints' for name in over)
    which = ' and '.join(name for name, yes in holds.items() if yes) or 'neither'
    return Claim(
        'm_R varies significantly over a revolution, and much more from one constraint to another',
        _verdict(all(holds.values()), any(holds.values())),
        f'Factors, {numbers}. It holds for: {which}.',
    )


def _right_mass(run: Run) -> Claim:
    gentle = run.largest_penalty <= 2000.0
    return Claim(
        'With the right m_R the step stays at its first value and the penalties within 1000 and 2000',
        _verdict(run.kept_step and gentle, run.kept_step),
        f'{run.outcome} after {run.until:g} s, smallest step {run.smallest_step * 1e3:.3g} of {run.h * 1e3:g} ms, largest penalty '
        f'{run.largest_penalty:g}, {len(run.penalties)} changes of penalties, {run.iterations:.2f} iterations per step.',
    )


def _wrong_mass(runs: dict[str, Run], duration: float) -> Claim:
    right, wrong = runs['m'], runs['m/10']
    a, b = runs['m/10, constant'].energy, runs['xi/10, constant'].energy
    n = min(len(a), len(b))
    difference = float(np.abs(a[:n, 1] - b[:n, 1]).max())
    ends, shrinks = wrong.outcome != 'ok', wrong.smallest_step < 0.999 * wrong.h
    grows = wrong.largest_penalty >= 10.0 * right.largest_penalty
    worse = wrong.iterations > MORE * right.iterations
    disguise = (
        'the same run as xi/10 with constant penalties (energies differ by ' + f'{difference:.1e} J): a small penalty in disguise'
        if difference <= SAME
        else f'not the same run as xi/10 (energies differ by {difference:.1e} J)'
    )
    constant = runs['m/10, constant']
    condition = ''
    if constant.outcome != 'ok' and not ends:
        condition = 'The collapse is there only while penalties are constant: raising them is enough to prevent it. '
    return Claim(
        'With m_R/10 the step falls until the run stops near 16 s, energy drops and penalties grow a hundredfold',
        _verdict(ends and shrinks and grows, shrinks or grows or worse or constant.outcome != 'ok'),
        f'{wrong.outcome} after {wrong.until:g} of {duration:g} s, smallest step {wrong.smallest_step * 1e3:.3g} ms, largest penalty '
        f'{wrong.largest_penalty:g} ({right.largest_penalty:g} with m_R), energy error {wrong.energy_error:.1e} J '
        f'({right.energy_error:.1e} with m_R), {wrong.iterations:.2f} iterations per step ({right.iterations:.2f}). With constant '
        f'penalties: {constant.outcome} after {constant.until:g} s, smallest step '
        f'{constant.smallest_step * 1e3:.3g} ms. {condition}It is {disguise}.',
    )


def _names(penalties: list[float]) -> str:
    return ', '.join(f'{p:g}' for p in penalties) or 'none'


def _good(run: Run) -> bool:
    """Kept its step and its energy."""
    return run.kept_step and run.energy_error <= crank.limit(crank.LIMITS['damped'].energy, run.h)


def _range(runs: dict[str, Run], penalties: np.ndarray) -> Claim:
    good = {form: [float(p) for p in penalties if _good(runs[f'xi {p:g}{form}'])] for form in ('', ', block')}
    done = {form: [float(p) for p in penalties if runs[f'xi {p:g}{form}'].outcome == 'ok'] for form in ('', ', block')}
    within = [p for p in good[''] if 1e3 <= p <= 1e4]
    outside = [p for p in good[''] if not 1e3 <= p <= 1e4]
    failing = [float(p) for p in penalties if not 1e3 <= p <= 1e4 and p not in good['']]
    return Claim(
        'Constant penalties converge only within an interval, 1e3 to 1e4',
        _verdict(bool(within) and not outside, bool(within) and bool(failing)),
        f'At the first step throughout and with an energy error within the limit of the damped setting: condensed {_names(good[""])}; '
        f'block {_names(good[", block"])}. On their branch at the end, with smaller steps where needed: condensed {_names(done[""])}; '
        f'block {_names(done[", block"])}.',
    )


def _small(runs: dict[str, Run], penalties: np.ndarray) -> Claim:
    counts = [(float(p), runs[f'xi {p:g}'].iterations) for p in penalties if runs[f'xi {p:g}'].kept_step]
    table = '; '.join(f'{p:g}: {n:.2f}' for p, n in counts)
    lost = [float(p) for p in penalties if p < 1e3 and not runs[f'xi {p:g}'].kept_step]
    least = min((n for _, n in counts), default=np.nan)
    falls = len(counts) > 1 and counts[0][1] > MORE * least
    return Claim(
        'Small penalties need more iterations',
        _verdict(falls and counts[0][0] <= 1e3, bool(lost) or falls),
        f'Iterations per step of runs that kept the step, by penalty: {table}. Below 1e3 the step was reduced or the run lost at: '
        f'{_names(lost)}.',
    )


def _excessive(runs: dict[str, Run], conditions: list[dict[str, float]]) -> Claim:
    large = [row['penalty'] for row in conditions if row['penalty'] > 1e4]
    bad = {form: [p for p in large if not _good(runs[f'xi {p:g}{form}'])] for form in ('', ', block')}
    at = {row['penalty']: row for row in conditions}
    worst = {form: max(at[p][form] for p in large) for form in ('condensed', 'block')}
    suffers = {form: min((at[p][form] for p in bad[key]), default=np.inf) for form, key in (('condensed', ''), ('block', ', block'))}
    # ill-conditioning explains a failure only where rounding times the condition number is not small
    rounding = {form: np.finfo(float).eps * number for form, number in suffers.items() if np.isfinite(number)}
    explained = [form for form, loss in rounding.items() if loss > RELATIVE_LOSS]
    spared = [p for p in large if p not in bad[''] and at[p]['condensed'] >= suffers['block']]
    limited = (
        f' The condensed matrix is as ill-conditioned at {_names(spared)} and does not fail, so the number alone does not decide.'
        if spared
        else ''
    )
    return Claim(
        'Excessive penalties fail because they make the matrix ill-conditioned',
        _verdict('condensed' in explained, bool(explained)),
        f'Step reduced, run lost or energy limit missed above 1e4: condensed {_names(bad[""])}; block {_names(bad[", block"])}. '
        f'Largest condition numbers: condensed {worst["condensed"]:.1e}, block {worst["block"]:.1e}. '
        'Rounding times the condition number at the first failure: '
        + (', '.join(f'{form} {loss:.1e}' for form, loss in rounding.items()) or 'no failure')
        + f'; above {RELATIVE_LOSS:g} it counts as the cause.{limited} With redundant rows the block matrix tends to a singular one as '
        '1/xi goes to 0, so that form is not better here. What a large penalty does beside a singular position: `mbd study penalty_map`.',
    )


def _m_alf(runs: dict[str, Run]) -> Claim:
    alf, same, fair = (runs[label] for label in ('ALF, same xi', 'M-ALF, same xi', 'M-ALF, fair xi'))

    def worse(run: Run) -> bool:
        return (alf.kept_step and not run.kept_step) or run.until < alf.until or run.iterations > MORE * alf.iterations

    def said(run: Run) -> str:
        return f'{run.outcome} after {run.until:g} s, {run.iterations:.2f} iterations, smallest step {run.smallest_step * 1e3:.3g} ms'

    verdict = NOT_REPRODUCED if not worse(same) else CONFIRMED if worse(fair) else CONDITION
    condition = {
        CONFIRMED: 'It is worse at the fair penalty too.',
        CONDITION: 'Only because the same number means a far smaller penalty there: at the fair penalty it is not worse.',
        NOT_REPRODUCED: 'It is not worse even at the same number.',
    }[verdict]
    return Claim(
        'M-ALF performs worse than the method with m_R',
        verdict,
        f'ALF: {said(alf)}. M-ALF at the same number: {said(same)}; at the fair penalty: {said(fair)}. {condition}',
    )
