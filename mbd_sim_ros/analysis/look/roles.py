"""Roles that the names of columns propose: a role for the first look (relations.py), which the data then confirm or
not.

A name is a set of words (`yawRate`, `Yaw_Velocity`, `imu/wz`, `W (IMU)`); a role is taken where its words are there and
those of no other quantity. A name alone never decides: the same word stands for many units and both signs.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from mbd_sim_ros.analysis.stamps import words

CORNERS = {
    'front_left': ({'fl'}, {'lf'}, {'vl'}, {'front', 'left'}),
    'front_right': ({'fr'}, {'rf'}, {'vr'}, {'front', 'right'}),
    'rear_left': ({'rl'}, {'hl'}, {'rear', 'left'}), 'rear_right': ({'rr'}, {'hr'}, {'rear', 'right'}),
}  # fmt: skip
RATES = {'rate', 'velocity', 'vel', 'speed', 'dot', 'gyro', 'omega', 'angular', 'rotation', 'd'}
ACCELERATION = {'acc', 'accel', 'acceleration', 'accelerometer', 'beschleunigung', 'force', 'g'}
SPEED = {'speed', 'velocity', 'vel', 'v', 'geschwindigkeit', 'spd', 'vehspd', 'speedo', 'u'}
STEERING = {
    'steering',
    'steer',
    'swa',
    'lenkradwinkel',
    'lenkwinkel',
    'handwheel',
    'steerangle',
    'steeringangle',
    'stw',
    'stwhl',
}
HAND = {'wheel', 'whl', 'swa', 'lenkradwinkel', 'handwheel', 'stw', 'stwhl', 'stwhlang'}  # the steering wheel
WHOLE = {
    'yaw_rate': {'yawrate', 'wz', 'gierrate', 'gierwinkelgeschwindigkeit', 'psidot', 'dpsi', 'gyroz', 'yawvel'},
    'ay': {'ay', 'latacc', 'lataccel', 'glat', 'latg', 'querbeschleunigung', 'accy', 'accely'},
    'ax': {'ax', 'longacc', 'longaccel', 'glong', 'longg', 'laengsbeschleunigung', 'längsbeschleunigung', 'accx',
    'accelx'},
    'az': {'az', 'accz', 'accelz', 'vertacc'},
    'speed': {'vx', 'velx', 'speedx'}, 'vy': {'vy', 'vely'}, 'sideslip': {'beta', 'sideslip', 'schwimmwinkel'},
}  # fmt: skip
AXES = {'x': {'x', 'lon', 'long', 'longitudinal'}, 'y': {'y', 'lat', 'lateral'}, 'z': {'z', 'vert', 'vertical'}}
POSITION = {
    'pos',
    'position',
    'pose',
    'place',
    'x',
    'y',
    'rel',
    'east',
    'north',
    'vicon',
    'gps',
    'odom',
    'local',
    'enu',
    'translation',
}
NEVER = {
    'target', 'desired', 'reference', 'error', 'std', 'cov', 'covariance', 'variance', 'sigma', 'wind', 'engine',
    'motor', 'lap', 'torque',
    'jerk', 'effort', 'temperature', 'temp', 'pressure', 'limit', 'max', 'min', 'raw', 'count', 'bias', 'status',
    'valid', 'quality',
    'slip', 'acceleration_rate', 'power', 'setpoint', 'demand', 'average', 'fx', 'fy', 'fz', 'load', 'damper', 'spring',
    'shaft', 'travel',
    'rack', 'slide', 'pinion',
}  # fmt: skip
UNITS_IN_NAMES = {
    ('kmh',): 'km/h', ('kph',): 'km/h', ('km', 'h'): 'km/h', ('mph',): 'mph', ('m', 's'): 'm/s', ('mps',): 'm/s',
    ('rpm',): 'rpm',
    ('deg', 's'): 'deg/s', ('degs',): 'deg/s', ('dps',): 'deg/s', ('rad', 's'): 'rad/s', ('rads',): 'rad/s',
    ('deg',): 'deg',
    ('rad',): 'rad', ('mps', '2'): 'm/s^2', ('m', 's', '2'): 'm/s^2', ('ms', '2'): 'm/s^2',
}  # fmt: skip


class Role(NamedTuple):
    """Role that a name proposes. unit: at the end of the name, '' where there is none. hand: true where the name says
    that steering is that of the steering wheel."""

    what: str
    corner: str = ''
    unit: str = ''
    hand: bool = False


def role_of(name: str) -> Role:
    """The role of a column by its name, '' where it has none."""
    parts = [re.sub(r'\W', '', word) for word in words(name)]
    unit = next(
        (UNITS_IN_NAMES[t] for k in (3, 2, 1) if len(parts) > k and (t := tuple(parts[-k:])) in UNITS_IN_NAMES), ''
    )
    found = set(parts)
    corner = next((c for c, ways in CORNERS.items() if any(way <= found for way in ways)), '')
    own = set(words(name.split('/', 1)[-1]))  # without the topic
    what = _what(found, own, corner)
    return Role(what, corner, unit, what == 'steering' and bool(found & HAND))


def _what(found: set[str], own: set[str], corner: str) -> str:
    axis = next((a for a in 'xyz' if AXES[a] & found), '')
    slip_angle = 'slip' in found and 'angle' in found and not corner
    if found & (NEVER - {'slip'} if slip_angle else NEVER):
        return ''
    if found & {'wheel', 'whl', 'wheels', 'wheelspeed'} and corner and not found & STEERING:
        return 'wheel' if found & (SPEED | RATES | {'w', 'rpm', 'wheelspeed'}) else ''
    if found & {'delta'} | (STEERING & found if corner else set()):
        return '' if found & (RATES - {'d'}) else 'road_angle'
    if corner and found & {'v', 'omega', 'w', 'n'}:
        return 'wheel'
    if found & STEERING or found >= {'st', 'whl', 'ang'}:
        return '' if found & (RATES - {'d', 'rotation'} | ACCELERATION) else 'steering'
    if corner or found & {'wheel', 'whl', 'tire', 'tyre'}:
        return ''
    if found & {'roll', 'pitch', 'phi', 'theta', 'rolling'}:
        return ''
    whole = next((role for role, names in WHOLE.items() if names & found), '')
    if slip_angle or (whole == 'sideslip' and not found & RATES):
        return 'sideslip'
    if found & {'yaw', 'psi', 'heading', 'gier'}:
        return 'yaw_rate' if found & RATES or whole == 'yaw_rate' else 'yaw' if not found & ACCELERATION else ''
    if whole:
        return whole
    if found & {'gyro', 'omega', 'angular'}:
        return 'yaw_rate' if axis == 'z' else ''
    if found & {'w', 'r'} and found <= {'w', 'r', 'imu', 'gyro'}:
        return 'yaw_rate'
    if found & ACCELERATION and axis:
        return f'a{axis}'
    if found & SPEED and not found & {'cov', 'angle', 'rate'}:
        return {'': 'speed', 'x': 'speed', 'y': 'vy', 'z': ''}[axis]
    if axis in ('x', 'y') and axis in own and own <= POSITION | {'m'}:
        return axis
    return ''
