"""The claims of the chapter about the slider-crank, each divided into parts that the figures of the runs decide.

One rule judges all claims. The first part of a claim is its core: without it nothing of the claim is left.

- confirmed: every part holds;
- not reproduced: the core does not hold;
- confirmed in part: the core holds, another part does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_sim_ros.lab.studies import crank
from mbd_sim_ros.lab.studies.crank_history import CrankRun

CONFIRMED, IN_PART, NOT_REPRODUCED = 'confirmed', 'confirmed in part', 'not reproduced'
LARGE = 2.0  # factor from which on a variation is called significant; with 20 only the coupled masses would vary
MORE = 1.2  # factor from which on a number of iterations is called larger; with 12 no setting would ever need more
HUNDREDFOLD = 100.0  # growth of a penalty that the chapter reports
# relative error of a solution that spoils an iteration to the default tolerance; with 1e-7 the block form is spared
RELATIVE_LOSS = 1e-8
SAME = 1e-9  # J: energies of runs that differ by rounding only; 1e-8 would judge alike


class Part(NamedTuple):
    """A statement that the figures decide."""

    text: str
    holds: bool


class Claim(NamedTuple):
    """Claim of the chapter, its parts, and the figures that decided them."""

    claim: str
    parts: tuple[Part, ...]
    figures: str

    @property
    def verdict(self) -> str:
        """By the rule of this module."""
        if all(part.holds for part in self.parts):
            return CONFIRMED
        return IN_PART if self.parts[0].holds else NOT_REPRODUCED

    def row(self) -> dict[str, Any]:
        """For the table of the report."""
        decided = '; '.join(f'{part.text}: {"yes" if part.holds else "NO"}' for part in self.parts)
        return {'claim': self.claim, 'verdict': self.verdict, 'parts': decided, 'figures': self.figures}


def judge(
    isolated: np.ndarray,
    coupled: np.ndarray,
    runs: dict[str, CrankRun],
    conditions: list[dict[str, float]],
    duration: float,
) -> list[Claim]:
    """All claims. isolated, coupled: (angles, rows) effective masses; runs by the labels of slider_crank.study.

    conditions: numbers of condition by penalty, condensed and block.
    """
    penalties = [row['penalty'] for row in conditions]
    return [
        _masses(isolated, coupled),
        _right_mass(runs['m']),
        _wrong_mass(runs, duration),
        _range(runs, penalties),
        _small(runs, penalties),
        _excessive(runs, conditions),
        _m_alf(runs),
    ]


def _masses(isolated: np.ndarray, coupled: np.ndarray) -> Claim:
    parts, numbers = [], []
    for name, m in (('isolated', isolated), ('coupled', coupled)):
        over = float((m.max(axis=0) / m.min(axis=0)).max())
        between = float((m.max(axis=1) / m.min(axis=1)).max())
        parts += [
            Part(f'{name}, a factor above {LARGE:g} over a revolution', over > LARGE),
            Part(f'{name}, a larger one between constraints', between > over),
        ]
        numbers.append(f'{name}: up to {over:.3g} over a revolution, {between:.3g} between constraints')
    return Claim(
        'm_R varies significantly over a revolution, and much more from one constraint to another',
        tuple(parts),
        '; '.join(numbers),
    )


def _right_mass(run: CrankRun) -> Claim:
    return Claim(
        'With the right m_R the step stays at its first value and the penalties within 1000 and 2000',
        (Part('the step stays', run.kept_step), Part('no penalty above 2000', run.largest_penalty <= 2000.0)),
        f'{_said(run)}, largest penalty {run.largest_penalty:g}, {len(run.penalties)} changes of penalties.',
    )


def _wrong_mass(runs: dict[str, CrankRun], duration: float) -> Claim:
    right, wrong, constant = runs['m'], runs['m/10'], runs['m/10, constant']
    a, b = constant.energy, runs['xi/10, constant'].energy
    n = min(len(a), len(b))
    difference = float(np.abs(a[:n, 1] - b[:n, 1]).max())
    disguise = 'the same run as' if difference <= SAME else 'not the same run as'
    return Claim(
        'With m_R/10 the step falls until the run stops near 16 s, energy drops and penalties grow a hundredfold',
        (
            Part(f'the run ends before {duration:g} s', wrong.outcome != 'ok'),
            Part('the step falls', wrong.smallest_step < 0.999 * wrong.h),
            Part(
                f'the energy error is more than {LARGE:g} times that with m_R',
                wrong.energy_error > LARGE * right.energy_error,
            ),
            Part('penalties grow a hundredfold', wrong.largest_penalty >= HUNDREDFOLD * wrong.penalty),
        ),
        f'{_said(wrong)}, largest penalty {wrong.largest_penalty:g} ({right.largest_penalty:g} with m_R), energy error '
        f'{wrong.energy_error:.1e} J ({right.energy_error:.1e} with m_R). With constant penalties: {_said(constant)}; '
        f'it is {disguise} xi/10 (energies differ by {difference:.1e} J).',
    )


def _names(penalties: Sequence[float]) -> str:
    return ', '.join(f'{p:g}' for p in penalties) or 'none'


def _said(run: CrankRun) -> str:
    return (
        f'{run.outcome} after {run.until:g} s, smallest step {run.smallest_step * 1e3:.3g} ms, {run.iterations:.2f} '
        'iterations per step'
    )


def _good(run: CrankRun) -> bool:
    """Kept its step and its energy."""
    return run.kept_step and run.energy_error <= crank.limit(crank.LIMITS['damped'].energy, run.h)


def _range(runs: dict[str, CrankRun], penalties: Sequence[float]) -> Claim:
    good = {form: [p for p in penalties if _good(runs[f'xi {p:g}{form}'])] for form in ('', ', block')}
    done = {form: [p for p in penalties if runs[f'xi {p:g}{form}'].outcome == 'ok'] for form in ('', ', block')}
    inside = [p for p in penalties if 1e3 <= p <= 1e4]
    return Claim(
        'Constant penalties converge only within an interval, 1e3 to 1e4',
        (
            Part('those from 1e3 to 1e4 converge', bool(inside) and all(p in good[''] for p in inside)),
            Part('none below', not any(p < 1e3 for p in good[''])),
            Part('none above', not any(p > 1e4 for p in good[''])),
        ),
        'At the first step throughout and with an energy error within the limit of the damped setting: condensed '
        f'{_names(good[""])}; block {_names(good[", block"])}. On their branch at the end, with smaller steps where '
        f'needed: condensed {_names(done[""])}; block {_names(done[", block"])}.',
    )


def _small(runs: dict[str, CrankRun], penalties: Sequence[float]) -> Claim:
    counts = [(p, runs[f'xi {p:g}'].iterations) for p in penalties if runs[f'xi {p:g}'].kept_step]
    small = [n for p, n in counts if p <= 1e3]
    least = min((n for _, n in counts), default=np.nan)
    return Claim(
        'Small penalties need more iterations',
        (
            Part(
                f'penalties up to 1e3 need more than {MORE:g} times the fewest',
                bool(small) and min(small) > MORE * least,
            ),
        ),
        'Iterations per step of runs that kept the step, by penalty: '
        f'{"; ".join(f"{p:g}: {n:.2f}" for p, n in counts)}.',
    )


def _excessive(runs: dict[str, CrankRun], conditions: list[dict[str, float]]) -> Claim:
    large = [row['penalty'] for row in conditions if row['penalty'] > 1e4]
    at = {row['penalty']: row['condensed'] for row in conditions}
    bad = {form: [p for p in large if not _good(runs[f'xi {p:g}{form}'])] for form in ('', ', block')}
    first = min((at[p] for p in bad['']), default=np.inf)
    loss = np.finfo(float).eps * first
    spared = [p for p in large if p not in bad[''] and at[p] >= first]
    return Claim(
        'Excessive penalties fail because they make the matrix ill-conditioned',
        (
            Part('some penalty above 1e4 fails', bool(bad[''])),
            Part(
                f'rounding times the condition number is above {RELATIVE_LOSS:g} there',
                bool(bad[''] and loss > RELATIVE_LOSS),
            ),
            Part('none passes that is as ill-conditioned', bool(bad['']) and not spared),
        ),
        f'Step reduced, run lost or energy limit missed above 1e4: condensed {_names(bad[""])}; block '
        f'{_names(bad[", block"])}. Rounding times the smallest condition number of a failure (condensed): '
        f'{f"{loss:.1e}" if bad[""] else "no failure"}; as ill-conditioned and good: {_names(spared)}. What a large '
        f'penalty does beside a singular position: `mbd study penalty_map`.',
    )


def _m_alf(runs: dict[str, CrankRun]) -> Claim:
    alf, same, fair = (runs[label] for label in ('ALF, same xi', 'M-ALF, same xi', 'M-ALF, fair xi'))

    def worse(run: CrankRun) -> bool:
        return (alf.kept_step and not run.kept_step) or run.until < alf.until or run.iterations > MORE * alf.iterations

    return Claim(
        'M-ALF performs worse than the method with m_R',
        (Part('at the same number xi', worse(same)), Part('at the fair penalty', worse(fair))),
        f'ALF: {_said(alf)}. M-ALF at the same number: {_said(same)}; at the fair penalty: {_said(fair)}.',
    )
