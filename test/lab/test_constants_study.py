"""mbd study constants: it finds numbers, changes exactly what depends on one, and tells rounding from what matters."""

from __future__ import annotations

import importlib
import json
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbd_sim_ros.lab.studies import constants
from mbd_sim_ros.lab.studies.constants import MATTERS, NOTHING, ROUNDING, WITHIN, Variant, compared
from mbd_sim_ros.lab.studies.constants_changed import Changed, Member, Outcome, outcome
from mbd_sim_ros.lab.studies.constants_found import EXACT, FROM_ONE, LABEL, Constant
from solver.compiled.contents import contents

NUMBERS = '''
"""Numbers."""

import numpy as np

SLOW = 0.25  # of the largest
FEW, MANY = 2, 7.5  # of two kinds
A, B = range(2)
AFTER = B + 1
HALF: float = SLOW * 2.0
# Above it,
# in two lines.
TURN = -np.float64(3.0)
NAME, LIST, FLAG = 'text', (1.0, 2.0), True
'''
USERS = """
import toy_numbers
from solver.compiled.kernel import kernel
from toy_numbers import HALF, MANY, SLOW


@kernel
def by_name(x):
    return SLOW * x


@kernel
def by_module(x):
    return toy_numbers.SLOW * x


@kernel
def derived(x):
    return HALF * x


@kernel
def caller(x):
    return by_name(x) + 1.0


@kernel
def other(x):
    SLOWER = MANY * x
    return SLOWER
"""
KERNELS = ('by_name', 'by_module', 'derived', 'caller', 'other')


@pytest.fixture
def toy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with a module of numbers, and one of kernels that use them."""
    (tmp_path / 'toy_numbers.py').write_text(NUMBERS)
    (tmp_path / 'toy_users.py').write_text(USERS)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(sys, 'meta_path', list(sys.meta_path))
    yield tmp_path
    forget()


def forget() -> None:
    for name in ('toy_numbers', 'toy_users'):
        sys.modules.pop(name, None)


def digests() -> dict[str, bytes]:
    """What the toy kernels are made of, imported anew."""
    forget()
    users = importlib.import_module('toy_users')
    return {name: contents(getattr(users, name), ())[0] for name in KERNELS}


def test_numbers_are_found_with_value_line_and_comment(toy: Path) -> None:
    found = {one.name: one for one in constants.constants(['.'], toy)}
    assert found['SLOW'] == Constant('toy_numbers', 'SLOW', 6, 0.25, 'of the largest')
    assert (found['FEW'].value, found['MANY'].value, found['MANY'].comment) == (2, 7.5, 'of two kinds')
    assert (found['HALF'].value, found['HALF'].comment) == (0.5, '')
    assert (found['TURN'].value, found['TURN'].comment) == (-3.0, 'Above it, in two lines.')
    assert {name for name, one in found.items() if one.kept == LABEL} == {'A', 'B', 'AFTER'}
    assert found.keys() == {'SLOW', 'FEW', 'MANY', 'A', 'B', 'AFTER', 'HALF', 'TURN'}


def test_all_numbers_of_the_solver_that_are_named_here_are_there() -> None:
    found = {one.key: one for one in constants.constants(constants.FOLDERS)}
    assert EXACT.keys() | FROM_ONE.keys() <= found.keys()
    assert all(0.0 < found[key].value < 1.0 for key in FROM_ONE)
    assert 'solver.start.rolling.SETTLE_RHO' in found and 'solver.step.interval.LARGEST_FACTOR' in found
    assert found['solver.step.control.PROGRESS'].kept == LABEL


@pytest.mark.parametrize(
    ('key', 'value', 'third', 'three'),
    [
        ('a.X', 9.0, 3.0, 27.0),
        ('a.X', -3.0, -1.0, -9.0),
        ('a.X', 40, 13, 120),
        ('a.X', 1, 0, 3),
        ('a.X', 2, 1, 6),
        ('solver.start.rolling.ALIGNED', 0.7, 0.9, 0.1),
    ],
)
def test_a_third_and_three_times(key: str, value: float, third: float, three: float) -> None:
    module, _, name = key.rpartition('.')
    one = Constant(module, name, 1, value, '')
    assert [one.times(factor) for factor in constants.FACTORS] == pytest.approx([third, three], rel=1e-15)
    assert one.times(1.0) == value and type(one.times(3.0)) is type(value)


@pytest.mark.parametrize(
    ('name', 'value', 'uses'),
    [
        ('SLOW', 0.75, {'by_name', 'by_module', 'derived', 'caller'}),
        ('MANY', 2.5, {'other'}),
        ('HALF', 1.5, {'derived'}),
        ('FEW', 6, set()),
    ],
)
def test_a_changed_number_changes_exactly_the_kernels_that_use_it(
    toy: Path, name: str, value: float, uses: set[str]
) -> None:  # fmt: skip
    """These numba compiles again; the others keep their identity, and numbers that are computed from it follow."""
    before = digests()
    sys.meta_path.insert(0, Changed('toy_numbers', name, value))
    after = digests()
    assert {kernel for kernel in KERNELS if after[kernel] != before[kernel]} == uses
    numbers = sys.modules['toy_numbers']
    assert getattr(numbers, name) == value
    assert (value if name == 'HALF' else 2.0 * numbers.SLOW) == numbers.HALF


def test_a_number_that_is_not_there_is_no_change(toy: Path) -> None:
    sys.meta_path.insert(0, Changed('toy_numbers', 'SLOWER', 1.0))
    with pytest.raises(ImportError, match='toy_numbers assigns SLOWER 0 times, not once'):
        digests()


def run(numbers: Any, **more: Any) -> Outcome:
    """A run with two fields of one and two columns."""
    values = np.array(numbers, float)
    known = {'counters': [['iterations', 20]], 'fields': [['tire', 1], ['elements', 2]]}
    return Outcome(**{'status': 'ok', 'digest': values.tobytes().hex(), **known, 'numbers': values.tolist(), **more})


BASE = [[0.0, 1.0, 1e3], [1.0, 2.0, -1e3]]
ERRORS = {'tire': np.array([1e-3]), 'elements': np.array([1e-2, 1.0])}


@pytest.mark.parametrize(
    ('numbers', 'word', 'field'),
    [
        (BASE, NOTHING, ''),
        ([[0.0, 1.0, 1e3], [1.0 + 5e-10, 2.0, -1e3]], ROUNDING, ''),
        ([[0.0, 1.0 + 2.5e-9, 1e3], [1.0, 2.0, -1e3]], ROUNDING, ''),  # 1e-9 of 2 and 1e-12 of 1000
        ([[0.0, 1.0 + 3.5e-9, 1e3], [1.0, 2.0, -1e3]], WITHIN, 'elements'),
        ([[0.0, 1.0, 1e3], [1.0005, 2.0, -1e3]], WITHIN, 'tire'),
        ([[0.0, 1.0, 1e3], [1.002, 2.0, -1e3]], MATTERS, 'tire'),
        ([[0.0, 1.0, 1e3], [np.nan, 2.0, -1e3]], MATTERS, 'tire'),
    ],
)
def test_departures_are_held_against_rounding_and_the_error_of_the_run(numbers: Any, word: str, field: str) -> None:
    row = compared(run(numbers), run(BASE), ERRORS)
    assert (row['word'], row['field']) == (word, field)
    if word == WITHIN and field == 'tire':
        assert row['errors'] == pytest.approx(0.5, rel=1e-9)


def test_another_status_a_finding_and_a_failure_matter_and_counters_are_told() -> None:
    base = run(BASE)
    told = run(BASE, status='suspect'), run(BASE, findings=['energy'])
    for changed in (*told, Outcome('error', 'no'), Outcome('no end')):
        assert compared(changed, base, ERRORS)['word'] == MATTERS
    row = compared(run(BASE, counters=[['iterations', 30]]), base, ERRORS)
    assert (row['word'], row['counters']) == (ROUNDING, {'iterations': [20, 30]})
    refused = Outcome('refused', 'no')
    assert compared(refused, refused, None)['word'] == NOTHING
    assert compared(Outcome('refused', 'no, never'), refused, None)['word'] == WITHIN


def test_the_error_of_a_run_is_that_of_second_order() -> None:
    """x = 1 + h^2 with h = 0.3: off by 0.09, and by 0.0225 with half the step."""
    wide, half = run([[1.09, 0.0, 0.0]]), run([[1.0225, 0.0, 0.0]])
    errors = constants.errors_of(wide, half)
    assert errors is not None and errors['tire'] == pytest.approx([0.09], rel=1e-12)
    assert constants.errors_of(wide, Outcome('error')) is None


def test_a_direction_without_an_error_has_that_of_its_vector() -> None:
    """Two bodies: positions off by 3e-6 and 6e-6 along x alone, an orientation by 9e-6."""
    wide, half = np.zeros((2, 14)), np.zeros((2, 14))
    half[1, [0, 7, 13]] = 3e-6, 6e-6, 9e-6
    errors = constants.errors_of(run(wide, fields=[['pose', 14]]), run(half, fields=[['pose', 14]]))
    assert errors is not None
    assert errors['pose'] == pytest.approx([4e-6] * 3 + [0.0] * 4 + [8e-6] * 3 + [12e-6] * 4, rel=1e-12)


DEATHS = [(-signal.SIGPROF, 'no end'), (-signal.SIGSEGV, 'crashed'), (1, 'crashed')]


@pytest.mark.parametrize(('code', 'status'), DEATHS)
def test_a_process_that_ends_is_an_outcome(monkeypatch: pytest.MonkeyPatch, code: int, status: str) -> None:
    died = f'import os; os.kill(os.getpid(), {-code})' if code < 0 else f'raise SystemExit({code})'
    start, other = constants.subprocess.Popen, [sys.executable, '-I', '-S', '-c', died]
    monkeypatch.setattr(constants.subprocess, 'Popen', lambda command, **options: start(other, **options))
    with Variant(Constant('solver.start.newton', 'PENALTY', 1, 1e6, ''), 3.0) as variant:
        assert variant.run(Member('pendulum', 0.1)).status == status
        assert variant.run(Member('pendulum', 0.1)).status == status  # in another process


def test_a_run_that_is_refused_is_told_through_the_pipe() -> None:
    found = outcome(Member('no_such_scene', 0.1))
    assert (found.status, 'no_such_scene' in found.text) == ('refused', True)
    assert tuple(json.loads(json.dumps(found))[:2]) == found[:2]
