"""Distance of two recordings where nobody says what is allowed: by quantity, in percent of the peak.

A percentage of a peak that is next to nothing says nothing: a car that drives straight ahead has a lateral acceleration
of 1e-12 m/s^2, and twice of it is no difference. So percentages refer to the peak, but at least to the least peak of a
known quantity of a vehicle (solver.vehicle.named_quantities), or of others to a thousandth of the largest peak among
channels of the same topic and unit. Of a mechanism, velocities and places that are a millionth of what its
accelerations make in the time of the recording are rounding, and have no percentage.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from mbd_sim_ros.analysis.difference import Difference
from solver.vehicle.named_quantities import BY_WHEEL, NAMED

# channels that are shown first, in this order: their words, and the quantity of docs/scene.md; * is a wheel
KNOWN = {
    'imu/wz': ('yaw rate', 'yaw_rate'),
    'imu/ay': ('lateral acceleration', 'lateral_acceleration'),
    'imu/ax': ('longitudinal acceleration', 'longitudinal_acceleration'),
    'odom/twist/vx': ('longitudinal velocity', 'longitudinal_velocity'),
    'odom/twist/vy': ('sideslip velocity', 'sideslip_velocity'),
    'odom/pose/x': ('position x', 'position'),
    'odom/pose/y': ('position y', 'position'),
    'odom/pose/orientation': ('orientation', 'heading'),
    'joint_states/steering_wheel/position': ('steering wheel angle', 'steering_wheel_angle'),
    'joint_states/steering_wheel/effort': ('steering torque', 'steering_torque'),
    'tire/*/force/fx': ('longitudinal tire force', 'tire_force'),
    'tire/*/force/fy': ('lateral tire force', 'tire_force'),
    'tire/*/force/fz': ('wheel load', 'wheel_load'),
    'tire_states/*/alpha': ('slip angle', 'slip_angle'),
    'joint_states/travel_*/position': ('suspension travel', 'suspension_travel'),
}
CORNER = re.compile(r'(?:front|rear)_(?:left|right)')  # wheels, also where a recording has no tires
NAMED_MOST = 3  # quantities in the verdict
OTHERS = 6  # quantities that are shown besides, those that differ most
# Part of the largest peak of its kind below which a channel is held to that; with ten times as much the moment of a
# soft bushing would be held to that of a stiff one.
SMALL = 1e-3
# Part of what accelerations make in the time of a recording, below which a motion is rounding; a closed joint leaves
# 1e-8 to 1e-7. Ten times as much would hide the motion of what is ten times stiffer.
ROUNDING = 1e-6


class Quantity(NamedTuple):
    """Channels that differ in their wheel alone: words, the channel that differs most, its share of a scale (None: it
    has none), what that scale is where it is not the peak, and what else is wrong with one of them."""

    name: str
    worst: Difference
    share: float | None
    of: str
    doubt: str


def _kind(d: Difference) -> tuple[str, str]:
    return d.channel.partition('/')[0], d.unit or d.channel.rpartition('/')[2]


class _Scales:
    """Scales that percentages of channels refer to."""

    def __init__(self, differences: Sequence[Difference]) -> None:
        self._largest: dict[tuple[str, str], float] = {}
        for d in differences:
            self._largest[_kind(d)] = max(self._largest.get(_kind(d), 0.0), self._peak(d))
        self._vehicle = any(d.channel.startswith(('tire/', 'joint_states/steering_wheel/')) for d in differences)
        accelerations = [self._peak(d) for d in differences if d.channel.startswith('imu/a')]
        time = max((max(d.time, *d.peak_time) for d in differences), default=0.0)
        pull = 0.0 if self._vehicle else ROUNDING * max(accelerations, default=0.0)
        self._least = {'odom/twist/v': pull * time, 'odom/pose/': pull * time * time}

    @staticmethod
    def _peak(d: Difference) -> float:
        return max(abs(d.peak[0]), abs(d.peak[1]))

    def share(self, pattern: str, d: Difference) -> tuple[float | None, str]:
        """(largest difference as a share of the scale, what that scale is where it is not the peak)."""
        if d.unit != 'rad' and any(
            d.channel.startswith(head) and self._peak(d) < least for head, least in self._least.items()
        ):
            return None, 'rounding'
        _, quantity = KNOWN.get(pattern, ('', ''))
        meaning = NAMED.get(quantity) or BY_WHEEL.get(quantity)
        least = meaning.least if self._vehicle and meaning else 0.0
        # a wheel turns by hundreds of radians, which says nothing of the angle of another joint
        alike = 0.0 if least or d.channel.startswith('joint_states/') else SMALL * self._largest[_kind(d)]
        scale = max(d.scale, alike, least)
        if not scale > 0.0:
            return d.normalised, ''
        return d.max / scale, '' if scale == d.scale else f'of {scale:.3g} {d.unit}; its peak is {d.scale:.2g}'


def quantities(differences: Sequence[Difference]) -> list[Quantity]:
    """Channels that differ in their wheel alone are one quantity. Known quantities come first, then the others by their
    difference."""
    wheels = {d.channel.split('/')[1] for d in differences if d.channel.startswith('tire/')}
    corner = re.compile('|'.join([*map(re.escape, sorted(wheels, key=len, reverse=True)), CORNER.pattern]))
    groups: dict[str, list[Difference]] = {}
    for d in differences:
        groups.setdefault(corner.sub('*', d.channel), []).append(d)
    scales = _Scales(differences)
    found = []
    for pattern, members in groups.items():
        each = [(*scales.share(pattern, d), d) for d in members]
        share, of, worst = max(each, key=lambda one: -1.0 if one[0] is None else one[0])
        # the size, if it is one, is the first reason
        doubt = next((text for d in members for text in d.reasons[d.max > d.limit :]), '')
        name, _ = KNOWN.get(pattern, (pattern, ''))
        found.append((pattern, Quantity(name, worst, share, of, doubt)))
    order = list(KNOWN)
    found.sort(key=lambda one: (order.index(one[0]) if one[0] in KNOWN else len(order), -(one[1].share or 0.0)))
    return [one for _, one in found]


def most(differences: Sequence[Difference]) -> str:
    """The quantities that differ most, known ones if there are any, in percent of their peaks; and how many are not
    compared throughout."""
    found = quantities(differences)
    words = {name for name, _ in KNOWN.values()}
    apart = [one for one in found if one.share]
    named = [one for one in apart if one.name in words] or apart
    first = sorted(named, key=lambda one: -(one.share or 0.0))[:NAMED_MOST]
    parted = sum(bool(one.doubt) for one in found)
    parts = (
        [', '.join(f'{one.name} {100.0 * (one.share or 0.0):.3g} %' for one in first) + ' of their peaks']
        if first
        else []
    )
    return '; '.join([*parts, *([f'{parted} quantities are not in both for the whole time'] if parted else [])])


def rows(differences: Sequence[Difference]) -> list[tuple[str, ...]]:
    """The rows of a table for people, its head first: all known quantities, the others that differ most, and all about
    which there is a doubt."""
    found = quantities(differences)
    known = {name for name, _ in KNOWN.values()}
    others = [one for one in found if one.name not in known and one.share][:OTHERS]
    table: list[tuple[str, ...]] = [('quantity', 'of the peak', 'most', 'unit', 'at [s]', 'RMS', 'channel', '')]
    for one in found:
        if one.name in known or one.doubt or any(one is other for other in others):
            d = one.worst
            share = '-' if one.share is None else f'{100.0 * one.share:.3g} %'
            numbers = (share, f'{d.max:.3g}', d.unit, f'{d.time:.6g}', f'{d.rms:.3g}')
            table.append((one.name, *numbers, d.channel, '; '.join(filter(None, (one.doubt, one.of)))))
    return table
