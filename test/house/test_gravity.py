"""Gravity has one source: solver.units holds its two values, and says where each is used."""

from __future__ import annotations

import ast

import pytest
from processes import ROOT

from solver.units import MODEL_GRAVITY, STANDARD_GRAVITY, UNITS

VALUES = (9.8, 9.81, 9.807, 9.8066, 9.80665, 9.806)


def written(source: str) -> list[int]:
    """Lines of a program in which a number is a value of gravity."""
    return [
        node.lineno for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Constant) and node.value in VALUES
    ]


def test_gravity_is_written_in_one_file() -> None:
    found = [
        f'{path.relative_to(ROOT)}:{line}'
        for folder in ('solver', 'mbd_sim_ros', 'docs/tools')
        for path in sorted((ROOT / folder).rglob('*.py'))
        if path != ROOT / 'solver/units.py'
        for line in written(path.read_text(encoding='utf-8'))
    ]
    assert not found, 'take STANDARD_GRAVITY or MODEL_GRAVITY of solver.units'


@pytest.mark.parametrize(
    'source', ['G = 9.81', 'def f(x: float = 9.80665) -> None: ...', 'a = (0.0, -9.81)', 'b = 0.3 * 9.81']
)
def test_a_number_written_elsewhere_is_found(source: str) -> None:
    assert written(source) == [1]


def test_both_commands_read_gradients_by_standard_gravity() -> None:
    """`mbd info` and `mbd evaluate` give an understeer gradient in deg/g; the unit g of files is the same."""
    from mbd_sim_ros.analysis.evaluation.figures import SHOWN
    from solver.analysis.typical_values import TEXTS

    assert UNITS['g'][1] == STANDARD_GRAVITY and MODEL_GRAVITY != STANDARD_GRAVITY
    for name in ('understeer_gradient', 'roll_gradient'):
        unit, factor = TEXTS[name][1:]
        assert unit == SHOWN['rad s^2/m'][0] and factor == pytest.approx(SHOWN['rad s^2/m'][1], rel=1e-15)
