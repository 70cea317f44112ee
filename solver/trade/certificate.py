"""The certificate, all that a search has found as one object: the setting, what proves it, and where it holds."""

from __future__ import annotations

import json
import math
from contextlib import suppress
from dataclasses import asdict
from typing import Any

from solver import units
from solver.analysis.certificate_coverage import certified_of, is_of_scene
from solver.checks.speed import REAL_TIME_FACTOR_MIN
from solver.disk import digest, plain
from solver.errors import MbdError
from solver.levels.auto import INCOMPLETE, OK, key
from solver.scene import Scene
from solver.trade.bench import findings_of, known, truth_of
from solver.trade.elsewhere import SMALL_THERE
from solver.trade.errors import ORIGINS
from solver.trade.first import Answer
from solver.trade.judging import MARGIN, Verdict, nearest
from solver.trade.runs import Stopped
from solver.trade.search import Search
from solver.trade.setting import Setting, baseline
from solver.trade.variations import AS_GIVEN, ranges_of

NO = 'no'
CERTIFIED, MEASURED, CLOSEST = 'certified', 'measured, not checked elsewhere', 'the closest that was tried'
UNTRIED, UNREACHED = 'not looked at: what is cheaper keeps everything', 'not looked at'
# Passes that a certificate rests on at least: of settings that fail on one maneuver in four, one in ten passes eight,
# and more than half pass two. Ten times as many are dearer than what most plans save.
LEAST = 8
DOUBT = 0.05  # probability that the bound of the rate of failures does not hold


def plan(search: Search) -> dict[str, Any]:
    """Run the search and describe its result.

    `status` is 'ok', 'no' (nothing fits) or 'incomplete' (time was up before anything was found and checked, or there
    is no maneuver to check it on). Errors are in SI units; `share` is of the limit. `unseen`: different maneuvers that
    had no part in the choice, and the ranges of what is varied. Raises MbdError where the full vehicle itself cannot be
    simulated.
    """
    best = search.find()
    scene = search.scene
    shown = best or nearest(search.tried)
    data: dict[str, Any] = {'status': NO, 'scene': scene.name, 'fidelity': None, 'settings': None, 'cost_ratio': None}
    slow = False
    if shown is not None:
        of, full = search.costs(shown.setting)
        slow = best is not None and 1.0 / of.median < least_speed(scene)[0]
        data |= {
            'fidelity': shown.setting.level,
            'settings': {key_: value for key_, value in shown.setting.keys().items() if key_ != 'fidelity'},
            'cost_ratio': of.median / full.median,
            'cost': {
                'median': of.median,
                'p99': of.p99,
                'full_median': full.median,
                'full_p99': full.p99,
                'real_time_factor': 1.0 / of.median,
            },
        }
    data['findings'] = []
    if best is not None:
        search.notes += still(search) + idle(search)
        data['findings'] = certified(search, best.setting)
    data['errors'] = {} if shown is None else errors(shown)
    data['units'] = (
        {}
        if shown is None or not shown.bounds
        else {name: truth_of(search.bench, AS_GIVEN).quantities[name].unit for name in search.names}
    )
    passed, failed = sum(c.passed for c in search.checks), sum(not c.passed for c in search.checks)
    data['unseen'] = {
        'passed': passed,
        'failed': failed,
        'bound': 1.0 - DOUBT ** (1.0 / passed) if passed and not failed else None,
        'ranges': ranges_of(scene),
        'largest': max((c.used for c in search.checks), default=None),
    }
    if best is not None and not slow:
        data['status'] = OK if not failed and 0 < passed >= least_passes(search) else INCOMPLETE
    elif best is None and search.ended:
        data['status'] = INCOMPLETE
    data['interrupted'] = search.allowance.ended()
    data['first'] = [first(search, answer, shown) for answer in search.answers]
    data['basis'] = (
        CERTIFIED if data['status'] == OK else None if shown is None else MEASURED if best is not None else CLOSEST
    )
    if shown is None and data['status'] == INCOMPLETE and search.answers:
        data |= {name: data['first'][-1][name] for name in ('fidelity', 'settings', 'cost_ratio', 'basis')}
    data['give'] = [] if data['status'] == OK else what_has_to_give(search, shown, slow, data)
    data['margin'] = MARGIN
    data['largest_error'] = None if shown is None else shown.error
    data['reference'] = reference_of(search)
    data['envelope'] = envelope_of(search)
    untried = UNREACHED if best is None else UNTRIED
    data['levels'] = {level: search.levels.get(level, untried) or 'kept' for level in search.candidate_levels}
    data['subsystems'] = [influence._asdict() for influence in search.influences]
    data['tried'] = [
        {'setting': str(t.setting), 'used': t.used, 'cost': t.cost, 'dropped': t.dropped, 'worst': t.worst}
        for t in search.tried
    ]
    data['checks'] = [
        {'variation': str(c.variation), 'used': c.used, 'worst': c.worst, 'failure': c.failure} for c in search.checks
    ]
    data['notes'] = search.notes
    data['baseline'] = str(baseline(scene))
    data['key'] = key(scene)
    data['took'] = search.took
    data['price'] = price(search, None if best is None else best.setting)
    data = plain(data)
    data['hash'] = digest(json.dumps(data, sort_keys=True)).hex()[:16]
    return data


def least_passes(search: Search) -> int:
    """Unseen maneuvers that a setting has to pass to be certified: LEAST, as far as there are so many and so many are
    asked for."""
    return min(LEAST, search.unseen, max(1, len(search.points(LEAST)) - len(search.unchecked)))


def first(search: Search, answer: Answer, shown: Verdict | None) -> dict[str, Any]:
    """A first answer: what it said, when, on what basis, and whether the last one is the same."""
    return {
        'setting': str(answer.setting),
        'fidelity': answer.setting.level,
        'settings': {name: value for name, value in answer.setting.keys().items() if name != 'fidelity'},
        'cost_ratio': answer.cost,
        'basis': answer.basis,
        'why': answer.why,
        'used': answer.used,
        'after': answer.after,
        'agrees': None if search.result is None or shown is None else agreed(answer.setting, shown.setting),
    }


def agreed(a: Setting, b: Setting) -> bool:
    """True where two settings are of one level with one step: iterations, damping and subsystems change costs by some
    per cent."""
    return (a.level, a.h) == (b.level, b.h)


def price(search: Search, setting: Setting | None) -> dict[str, Any]:
    """Price of the plan: what it took, in CPU seconds and full runs, what its runs were made for, and from how many
    runs on it pays (None: never). `once`: CPU seconds besides, for levels that are derived once for the vehicle."""
    cpu, full_run, saves = search.allowance.cpu, search.allowance.full_run, 0.0
    if not math.isfinite(full_run):
        full_run = math.nan
    elif setting is not None:
        with suppress(MbdError, Stopped):
            saves = search.saves(setting)
    return {
        'cpu': cpu,
        'once': search.ledger.once,
        'full_run': full_run,
        'full_runs': cpu / full_run,
        'saves': saves,
        'pays_from': math.ceil(cpu / saves) if saves > 0.0 else None,
        'runs': search.ledger.table(),
        'runs_found': search.kept.found,
    }


def least_speed(scene: Scene) -> tuple[float, str]:
    """(simulated seconds per second that are asked for at least, by what): by the budget, or of every run, which is no
    faster than its steps are. 0 where nothing asks."""
    asked = {
        'the budget': scene.budget.real_time_factor,
        'require.real_time_factor_min': scene.require.limits.get(REAL_TIME_FACTOR_MIN.require),
    }
    return max(((factor or 0.0, who) for who, factor in asked.items()), key=lambda each: each[0])


def certified(search: Search, setting: Setting) -> list[dict[str, Any]]:
    """Findings that the certificate covers (solver.analysis.certificate_coverage): of the maneuvers that served to
    choose and of those that were passed. The note on each says what that means for a run; another one says what makes a
    run suspect all the same."""
    maneuvers = [*search.bench.seen, *(c.variation for c in search.checks if c.passed)]
    found = [
        finding
        for v in maneuvers
        for finding in findings_of(search.bench, v, setting)
        if finding.quantity not in search.coarse
    ]
    names = ', '.join(search.names)
    for finding in findings_of(search.bench, AS_GIVEN, setting):
        if is_of_scene(finding) or finding.quantity in search.coarse:
            search.notes.append(f'a run of {setting} is suspect all the same (mbd run): {finding.text}')
        else:
            search.notes.append(finding.covered_for(names))
    for finding in search.coarse.values():
        search.notes.append(
            f'not covered by the certificate, for the reference itself ({1e3 * search.bench.steps[-1]:g} ms) has it: '
            f'{finding.text}'
        )
    return [asdict(one) for one in certified_of(found)]


def still(search: Search) -> list[str]:
    """Sentences on required shares of a peak that the maneuver of the scene leaves without one."""
    truth = truth_of(search.bench, AS_GIVEN)
    shares = dict.fromkeys(r.quantity for r in search.bench.requirements if r.share)
    found = [(name, truth.quantities[name]) for name in shares if truth.peaks[name] <= truth.quantities[name].least]
    return [
        f'{name} does not get beyond {q.least:g} {q.unit} in the maneuver of the scene; its percentages are of that'
        for name, q in found
    ]


def idle(search: Search) -> list[str]:
    """Limits as large as all that there is on the maneuver of the scene, which a run keeps that has nothing of it, in
    words: a bare number is in SI units, and 2 is not 2 %."""
    truth, found = truth_of(search.bench, AS_GIVEN), []
    for r in search.bench.requirements:
        delay, q = r.measure == 'delay', truth.quantities[r.quantity]
        most, unit = (search.scene.duration, 's') if delay else (truth.peaks[r.quantity], q.unit)
        limit = r.limit(most)
        if limit >= most:
            text = 'the time of the scene' if delay else f'its peak, {units.shown(most, unit)}'
            remedy = 'a run without any keeps it; give its unit, or a smaller one'
            found.append(f'{r}: the limit of {units.shown(limit, unit)} is no less than {text}: {remedy}')
    return found


def errors(verdict: Verdict) -> dict[str, dict[str, Any]]:
    """By quantity and measure: bounds by origin, their sum, the limit."""
    found: dict[str, dict[str, Any]] = {}
    for bound in verdict.bounds.values():
        r = bound.requirement
        parts = dict(zip(ORIGINS, bound.parts, strict=True))
        found.setdefault(r.quantity, {})[r.measure] = {
            **parts,
            'sum': sum(bound.parts),
            'limit': bound.limit,
            'share': bound.used,
        }
    return found


def reference_of(search: Search) -> dict[str, Any]:
    """The way in which the converged full vehicle was found and confirmed: RMS errors as shares of the peak by
    quantity."""
    try:
        truth = truth_of(search.bench, AS_GIVEN)
    except (MbdError, Stopped):
        return {}
    band = {name: d.share('rms') for name, d in truth.band.items() if name in search.shown}
    second = {name: d.share('rms') for name, d in search.second.items() if name in search.shown}
    elsewhere = [str(setting) for setting in search.bench.apart]
    return {'steps': list(search.bench.steps), 'band': band, 'second_formulation': second, 'elsewhere': elsewhere}


def envelope_of(search: Search) -> list[dict[str, Any]]:
    """The ranges of the maneuvers that were passed: by quantity, of all wheels together, the smallest and the largest
    value of the full vehicle and of the setting that was found. So a run of what is certified does not leave its own
    certificate."""
    found: dict[str, tuple[str, float, float]] = {}
    bench = search.bench if search.result is None else search.judged_by(search.result.setting, SMALL_THERE)
    for v in [*bench.seen, *(c.variation for c in search.checks if c.passed)]:
        try:
            truth = truth_of(bench, v)
        except (MbdError, Stopped):
            continue
        own = known(search.bench, v, search.result.setting) if search.result is not None else None
        curves = [truth.curves] if own is None else [truth.curves, own.curves]
        for name, values in ((name, each[name]) for each in curves for name in search.watched if name in each):
            head = name.partition('.')[0]
            _, low, high = found.get(head, ('', math.inf, -math.inf))
            found[head] = truth.quantities[name].unit, min(low, float(values.min())), max(high, float(values.max()))
    return [{'quantity': name, 'unit': unit, 'low': low, 'high': high} for name, (unit, low, high) in found.items()]


def what_has_to_give(search: Search, closest: Verdict | None, slow: bool, data: dict[str, Any]) -> list[str]:
    """Sentences: what comes closest, and which limit it would need."""
    if closest is None:
        if data['status'] == INCOMPLETE and search.answers:
            answer = search.answers[-1]
            return [
                f'{answer.setting} is what was known by then, from the {answer.basis} ({answer.why}); nothing of it is '
                'checked'
            ]
        return [*search.notes, 'no setting could be tried'] if not search.notes else search.notes
    if slow:
        (factor, who), found = least_speed(search.scene), data['cost']['real_time_factor']
        best = nearest(t for t in search.tried if t.cost > 0.0 and 1.0 / t.cost >= factor)
        sentences = [
            f'{closest.setting} keeps the accuracy, steps alone at {found:.3g} times real time; {who} asks for '
            f'{factor:g}'
        ]
        if best is not None:
            sentences.append(f'of what is as fast {best.setting} comes closest: {how_near(best)}')
        return sentences
    if data['status'] == INCOMPLETE and search.result is not None:
        why = (
            'there was no time to check it on others'
            if search.points(1)
            else 'nothing in the scene can be varied to check it on others'
        )
        if passed := len(search.checks):
            why = f'it passed {passed} others, too few for a certificate, which takes {least_passes(search)}'
        elif search.unchecked:
            why = 'on the others that were tried the full vehicle itself cannot be simulated'
        return [f'{closest.setting} keeps the accuracy on the maneuvers it was chosen on; {why}']
    early = ['time was up before everything was tried (mbd plan --time)'] if data['status'] == INCOMPLETE else []
    if closest.broken:
        sentences = [*early, f'{closest.setting} keeps the accuracy, but its run is not sound: {closest.broken}']
        other = nearest(t for t in search.tried if not t.broken)
        if other is not None:
            sentences.append(f'of the others {other.setting} comes closest: {how_near(other)}')
        return sentences
    sentences = [f'{closest.setting} comes closest: {how_near(closest)}']
    for bound in closest.bounds.values():
        if bound.used > 1.0:
            largest = max(zip(bound.parts, ORIGINS, strict=True))
            sentences.append(
                f'{bound.requirement}: the limit would have to be {bound.used:.3g} times as large; most of it is error '
                f'of the {largest[1]}'
            )
    needed = max(closest.used, closest.error / (1.0 - MARGIN))
    if len(sentences) == 1 and math.isfinite(needed) and needed > 1.0:
        sentences.append(f'{closest.worst}: the limit would have to be {needed:.3g} times as large')
    return early + sentences


def how_near(verdict: Verdict) -> str:
    """The share of a limit that a setting uses, in words; where its bounds keep all limits, what it was dropped for."""
    if verdict.used <= 1.0 and verdict.dropped:
        return verdict.dropped
    return f'{verdict.worst} at {verdict.used:.3g} of its limit'
