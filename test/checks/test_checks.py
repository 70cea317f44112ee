"""What follows from the records of checks: sentences, limits that a scene may require, and what a record must
promise."""

from __future__ import annotations

import dataclasses
import math
import re

import pytest

from solver.analysis.verdict import status_of
from solver.checks import registry
from solver.checks.check import Check, Measured
from solver.checks.registry import BY_NAME, CHECKS, LIMITS
from solver.errors import SceneError, SpecError
from solver.files.scene import load_scene_text
from solver.findings import Finding
from solver.scene import Require

BODY = 'mechanism: {bodies: {b: {mass: 1, inertia: [1, 1, 1]}}}\nduration: 1\n'


def check(**changes) -> Check:
    given = {
        'name': 'size', 'unit': 'm', 'limit': 1.0, 'rule': '1 '
            'm', 'measure': lambda e: [Measured(value=2.0, where="body 'b'")],
        'reason': '{where} is too large', 'remedy': 'Take a smaller one',
    }  # fmt: skip
    return Check(**{**given, **changes})


def found(one: Check, **required: float) -> list[Finding]:
    return list(one.findings(None, required))  # type: ignore[arg-type]


@pytest.mark.parametrize('one', CHECKS, ids=lambda one: one.name)
def test_a_finding_names_check_value_limit_instant_and_place_and_ends_with_a_remedy(one: Check) -> None:
    limit = 2.0 if one.limit is None else one.limit
    told = one.finding(Measured(value=3e8, limit=limit, time=0.5, where="{body} 'b'", of='roll'))
    unit = f' {one.unit}' if one.unit else ''
    least = 'at least ' if one.least else ''
    numbers = (
        re.escape(f'({one.name} 3e+08{unit}, limit {least}{limit:.3g}{unit}, t = 0.5 s') + r'(, \{body\} \'b\')?\)'
    )
    assert re.fullmatch(rf'[^a-z].*[^.] {numbers}\. {re.escape(one.remedy)}', told.text), told.text
    assert told.text.count("{body} 'b'") == 1
    assert told.text == f'{told.fact}. {one.remedy}'
    assert not re.search(r'reduce|take|give', told.fact, re.IGNORECASE)  # a fact advises nothing
    assert one.remedy[0].isupper()


def test_a_limit_of_the_scene_counts_in_place_of_that_of_the_run() -> None:
    own = check(require='size_max')
    (told,) = found(own)
    assert (told.value, told.limit, told.required) == (2.0, 1.0, False)
    assert told.text == "Body 'b' is too large (size 2 m, limit 1 m). Take a smaller one"
    (told,) = found(own, size_max=1.5)
    assert told.required and 'size 2 m, required 1.5 m' in told.text
    assert found(own, size_max=2.0) == found(check(limit=2.0)) == []
    assert len(found(check(), size_max=3.0)) == 1  # the key of another
    of_run = check(limit=None, measure=lambda e: [Measured(value=2.0, limit=limit) for limit in (1.0, 3.0)])
    assert [told.limit for told in found(of_run)] == [1.0]


def test_without_any_limit_nothing_is_told_and_from_below_what_is_less() -> None:
    least = check(limit=None, least=True, require='size_min')
    assert found(least) == found(least, size_min=2.0) == found(least, size_min=1.0) == []
    (told,) = found(least, size_min=2.5)
    assert 'size 2 m, required at least 2.5 m' in told.text


def test_what_is_no_number_is_told() -> None:
    assert len(found(check(measure=lambda e: [Measured(value=math.nan)]))) == 1


@pytest.mark.parametrize(
    ('changes', 'why'),
    [
        ({'measure': lambda e, more: []}, "check 'size': <lambda> must take the evidence and nothing else"),
        ({'reason': ''}, "check 'size': reason is empty"),
        ({'rule': ''}, "check 'size': rule is empty"),
        ({'remedy': 'Take a smaller one.'}, 'end without a full stop'),
        ({'reason': '{where} is too large.'}, 'end without a full stop'),
        ({'least': True}, 'only a limit of `require` is one from below'),
        ({'name': 'a size'}, 'one that a key may have'),
    ],
)
def test_a_record_that_promises_too_little_is_an_error_when_it_is_made(changes: dict, why: str) -> None:
    with pytest.raises(TypeError, match=re.escape(why)):
        check(**changes)


@pytest.mark.parametrize('more', [check(name=CHECKS[0].name), check(require=next(iter(LIMITS)))])
def test_a_name_that_is_used_twice_is_an_error(more: Check, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, 'CHECKS', (*CHECKS, more))
    with pytest.raises(TypeError, match='is used twice'):
        registry._limits()


@pytest.mark.parametrize('key', LIMITS)
def test_a_scene_may_require_every_limit_that_has_a_key(key: str) -> None:
    assert load_scene_text(f'{BODY}require: {{{key}: 3}}\n').require == Require(limits={key: 3})
    assert load_scene_text(f'{BODY}require: {{{key}: null}}\n').require == Require()
    (own,) = [one for one in CHECKS if one.require == key]
    if own.count:
        with pytest.raises(SceneError, match='must be a whole number'):
            load_scene_text(f'{BODY}require: {{{key}: 1.5}}\n')


@pytest.mark.parametrize('name', ['residual_mux', 'turn_per_step', 'branch_switches', 'limits'])
def test_a_key_that_no_check_has_is_refused_in_files_and_from_python(name: str) -> None:
    with pytest.raises(SceneError, match=rf'require(\.{name})?: ?'):
        load_scene_text(f'{BODY}require: {{{name}: 1}}\n')
    with pytest.raises(SpecError, match=f'require: {name}: no check has such a limit'):
        Require(limits={name: 1.0})


def test_one_rule_for_the_status() -> None:
    told = [BY_NAME['unseen'].finding(Measured(value=1.0, limit=0.0))]
    assert [status_of(found) for found in ([], told)] == ['ok', 'suspect']
    assert [status_of(found, interrupted=True) for found in ([], told)] == ['interrupted'] * 2
    assert [
        status_of(found, failed=True, interrupted=stopped) for found in ([], told) for stopped in (False, True)
    ] == ['error'] * 4


def test_findings_that_were_kept_without_what_they_are_of_are_read() -> None:
    kept = dataclasses.asdict(found(check())[0])
    del kept['of']
    assert Finding(**kept).of == ''
