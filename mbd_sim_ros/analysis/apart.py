"""Distance of two recordings where nobody says what is allowed: by quantity, in percent of the peak."""

from __future__ import annotations

import re
from collections.abc import Sequence

from mbd_sim_ros.analysis.difference import Difference

KNOWN = {  # channels that are shown first, in this order, by the words of docs/scene.md; * is a wheel
    'imu/wz': 'yaw rate',
    'imu/ay': 'lateral acceleration',
    'imu/ax': 'longitudinal acceleration',
    'odom/twist/vx': 'longitudinal velocity',
    'odom/twist/vy': 'sideslip velocity',
    'odom/pose/x': 'position x',
    'odom/pose/y': 'position y',
    'odom/pose/orientation': 'orientation',
    'joint_states/steering_wheel/position': 'steering wheel angle',
    'joint_states/steering_wheel/effort': 'steering torque',
    'tire/*/force/fx': 'longitudinal tire force',
    'tire/*/force/fy': 'lateral tire force',
    'tire/*/force/fz': 'wheel load',
    'tire_states/*/alpha': 'slip angle',
    'joint_states/travel_*/position': 'suspension travel',
}
CORNER = re.compile(r'(?:front|rear)_(?:left|right)')  # wheels, also where a recording has no tires
NAMED = 3  # quantities in the verdict
OTHERS = 6  # quantities that are shown besides, those that differ most


def quantities(differences: Sequence[Difference]) -> list[tuple[str, Difference, str]]:
    """Channels that differ in their wheel alone are one quantity: (its name, the channel that differs most relative to
    its peak, what else is wrong with one of them).

    Known quantities come first, then the others by their difference.
    """
    wheels = {d.channel.split('/')[1] for d in differences if d.channel.startswith('tire/')}
    corner = re.compile('|'.join([*map(re.escape, sorted(wheels, key=len, reverse=True)), CORNER.pattern]))
    groups: dict[str, list[Difference]] = {}
    for d in differences:
        groups.setdefault(corner.sub('*', d.channel), []).append(d)
    found = []
    for pattern, members in groups.items():
        worst = max(members, key=lambda d: d.normalised)
        # the size, if it is one, is the first reason
        doubt = next((text for d in members for text in d.reasons[d.max > d.limit :]), '')
        found.append((pattern, KNOWN.get(pattern, pattern), worst, doubt))
    order = list(KNOWN)
    found.sort(key=lambda one: (order.index(one[0]) if one[0] in KNOWN else len(order), -one[2].normalised))
    return [(name, worst, doubt) for _, name, worst, doubt in found]


def most(differences: Sequence[Difference]) -> str:
    """The quantities that differ most, known ones if there are any, in percent of their peaks; and how many are not
    compared throughout."""
    found = quantities(differences)
    named = [one for one in found if one[0] in KNOWN.values() and one[1].max > 0.0] or [
        one for one in found if one[1].max > 0.0
    ]
    first = sorted(named, key=lambda one: -one[1].normalised)[:NAMED]
    parted = sum(bool(doubt) for _, _, doubt in found)
    parts = (
        [', '.join(f'{name} {100.0 * d.normalised:.3g} %' for name, d, _ in first) + ' of their peaks'] if first else []
    )
    return '; '.join([*parts, *([f'{parted} quantities are not in both for the whole time'] if parted else [])])


def rows(differences: Sequence[Difference]) -> list[tuple[str, ...]]:
    """The rows of a table for people, its head first: all known quantities, the others that differ most, and all about
    which there is a doubt."""
    found = quantities(differences)
    known = set(KNOWN.values())
    others = [one for one in found if one[0] not in known and one[1].max > 0.0][:OTHERS]
    table: list[tuple[str, ...]] = [('quantity', 'of the peak', 'most', 'unit', 'at [s]', 'RMS', 'channel', '')]
    for name, d, doubt in found:
        if name in known or doubt or any(d is other for _, other, _ in others):
            numbers = (f'{100.0 * d.normalised:.3g} %', f'{d.max:.3g}', d.unit, f'{d.time:.6g}', f'{d.rms:.3g}')
            table.append((name, *numbers, d.channel, doubt))
    return table
