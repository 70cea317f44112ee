"""The page of a plan."""

from __future__ import annotations

import pytest

from mbd_sim_ros.analysis.plan_page import elsewhere, error_rows


def test_errors_have_the_units_of_their_quantities() -> None:
    """0.1 rad/s are 5.73 deg/s; what is not known is a dash."""
    parts = {'model': 0.1, 'step': 0.1, 'iteration': None, 'reference': 0.0, 'sum': None, 'limit': 0.2, 'share': None}
    data = {
        'errors': {'yaw_rate': {'rms': parts, 'delay': {**parts, 'model': 2e-3}}, 'imu/ay': {'max': parts}},
        'units': {'yaw_rate': 'rad/s', 'imu/ay': 'm/s^2'},
    }
    head, *rows = error_rows(data)
    assert head == ('error', 'model', 'step', 'iteration', 'reference', 'sum', 'limit')
    assert rows == [
        ('yaw_rate rms', '5.73 deg/s', '5.73 deg/s', '-', '0 deg/s', '-', '11.5 deg/s'),
        ('yaw_rate delay', '2 ms', '0.1 s', '-', '0 s', '-', '0.2 s'),
        ('imu/ay max', '0.1 m/s^2', '0.1 m/s^2', '-', '0 m/s^2', '-', '0.2 m/s^2'),
    ]


CONFIDENCE = '(Statistically: with 95 % confidence at most {} % could fail.)'


@pytest.mark.parametrize(
    ('passed', 'failed', 'bound', 'largest', 'text'),
    [
        (
            12,
            0,
            1.0 - 0.05 ** (1 / 12),
            0.851,
            '12 of 12 other maneuvers passed, the worst at 85 % of the limit. ' + CONFIDENCE.format(22),
        ),
        (
            59,
            0,
            1.0 - 0.05 ** (1 / 59),
            0.04,
            '59 of 59 other maneuvers passed, the worst at 4 % of the limit. ' + CONFIDENCE.format(5),
        ),
        (1, 1, None, 1.3, '1 of 2 other maneuvers passed, the worst at 130 % of the limit'),
        (0, 0, None, None, 'not checked on other maneuvers'),
    ],
)
def test_checks_are_told_in_the_words_of_an_engineer(passed, failed, bound, largest, text) -> None:
    assert elsewhere({'passed': passed, 'failed': failed, 'bound': bound, 'largest': largest}) == text
