"""Patterns of channels."""

from __future__ import annotations

import pytest

from mbd_sim_ros.bags.patterns import fits, fits_any, nearest

PLACE = 'tf/transforms[0]/transform/translation/x'


@pytest.mark.parametrize('pattern', [PLACE, 'tf/transforms[0]/*', 'tf/*/x', 'tf/transforms[[]0]/*'])
def test_an_index_in_a_pattern_is_the_index_in_a_name(pattern: str) -> None:
    """The name of a channel, given as it is, was refused, and suggested."""
    assert fits(PLACE, pattern) and not fits(PLACE.replace('0', '1').replace('/x', '/y'), pattern)


def test_sets_of_characters_are_those_of_the_shell() -> None:
    assert fits('imu/wx', 'imu/[wa]x') and fits('wheel_2/x', 'wheel_[12]/x') and not fits('wheel_3/x', 'wheel_[12]/x')
    assert fits_any('imu/wx', ['odom/*', 'imu/*']) and not fits_any('imu/wx', ['Imu/*'])


NAMES = [f'odom/twist/v{axis}' for axis in 'xyz'] + [
    'imu/wz',
    'imu/ax',
    'cmd_applied/steering',
    'joint_states/steering_wheel/position',
]
NAMES += [f'tire/{wheel}/force/fz' for wheel in ('front_left', 'front_right')]


@pytest.mark.parametrize(
    ('wanted', 'first'),
    [
        ('odo/twist/vx', 'odom/twist/vx'),
        ('/odom/twist/vx', 'odom/twist/vx'),
        ('ODOM/twist/vx', 'odom/twist/vx'),
        ('odom.twist.vx', 'odom/twist/vx'),
        ('odm/*', 'odom/*'),
        ('odom', 'odom/*'),
        ('tre/*/force/fz', 'tire/*/force/fz'),
        ('tire/front_lft/force/*', 'tire/front_left/force/*'),
        ('joint_state/steering_wheel/position', 'joint_states/steering_wheel/position'),
        ('wz', 'imu/wz'),
        ('steering', 'cmd_applied/steering'),
        ('odom/vx', 'odom/twist/vx'),
    ],
)
def test_a_name_that_is_not_there_suggests_the_nearest_with_its_wildcards(wanted: str, first: str) -> None:
    assert nearest(wanted, NAMES).startswith(f'; did you mean {first!r}')


def test_topics_are_listed_where_no_name_is_near() -> None:
    assert nearest('lidar/points', NAMES) == '; there are odom/*, imu/*, cmd_applied/*, joint_states/*, tire/*'
    assert nearest('x', [f'topic_{k}/a' for k in range(10)]).endswith('topic_7/* and 2 more')
    assert nearest('x', []) == '; it has none'
