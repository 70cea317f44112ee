"""The page of a plan."""

from __future__ import annotations

from mbd_sim_ros.analysis.plan_page import error_rows


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
