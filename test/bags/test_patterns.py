"""Patterns of channels."""

from __future__ import annotations

import pytest

from mbd_sim_ros.bags.patterns import fits, fits_any

PLACE = 'tf/transforms[0]/transform/translation/x'


@pytest.mark.parametrize('pattern', [PLACE, 'tf/transforms[0]/*', 'tf/*/x', 'tf/transforms[[]0]/*'])
def test_an_index_in_a_pattern_is_the_index_in_a_name(pattern: str) -> None:
    """The name of a channel, given as it is, was refused, and suggested."""
    assert fits(PLACE, pattern) and not fits(PLACE.replace('0', '1').replace('/x', '/y'), pattern)


def test_sets_of_characters_are_those_of_the_shell() -> None:
    assert fits('imu/wx', 'imu/[wa]x') and fits('wheel_2/x', 'wheel_[12]/x') and not fits('wheel_3/x', 'wheel_[12]/x')
    assert fits_any('imu/wx', ['odom/*', 'imu/*']) and not fits_any('imu/wx', ['Imu/*'])
