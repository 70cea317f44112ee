"""Allowed differences per channel: from a file, or one for all.

tolerances:                       # the first pattern that fits a channel counts
  'imu/w*': {rtol: 0.05, atol: 0.01, rating: 0.8}
  'odom/pose/*': {rtol: 0.02, shift: 0.05}
floor: 1.0e-6                     # optional
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from mbd_sim_ros.bags.patterns import fits
from solver.dimensions import Time
from solver.files.schema import Builder
from solver.files.yaml_tree import read
from solver.validate import finite

FLOOR = 1e-6


@dataclass(frozen=True, kw_only=True)
class Tolerance:
    """Limits of one channel; what is None is not judged.

    The largest difference may be atol (in the unit of the channel) + rtol * scale, the scale being the largest value of
    the reference. rms and peak: limits of the RMS difference and of the difference of the peaks, relative to the scale.
    shift: largest time shift [s]. rating: least rating after ISO/TS 18571.
    """

    rtol: float = 1e-6
    atol: float = 1e-9
    rms: float | None = None
    peak: float | None = None
    shift: Time | None = None
    rating: float | None = None

    def __post_init__(self) -> None:
        for name in ('rtol', 'atol', 'rms', 'peak', 'shift', 'rating'):
            value = getattr(self, name)
            if value is not None:
                finite('tolerance', name, value, low=0.0, high=1.0 if name == 'rating' else math.inf)


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """All limits. tolerances: pattern of channels -> limits; others have `default`.

    floor: the scale of a channel is at least this part of the largest one among the channels of the same kind (topic
    and unit): what is zero but for rounding is not judged relative to itself.
    """

    tolerances: dict[str, Tolerance] = field(default_factory=dict)
    default: Tolerance = Tolerance()
    floor: float = FLOOR

    def __post_init__(self) -> None:
        finite('tolerances', 'floor', self.floor, low=0.0, high=1.0)

    def of(self, channel: str) -> Tolerance:
        """Limits of a channel."""
        return next((t for pattern, t in self.tolerances.items() if fits(channel, pattern)), self.default)

    def unused(self, channels: Iterable[str]) -> list[str]:
        """Patterns that none of these channels is judged by: no name fits, or an earlier pattern takes it."""
        used = {next((p for p in self.tolerances if fits(channel, p)), None) for channel in channels}
        return [pattern for pattern in self.tolerances if pattern not in used]

    @property
    def rated(self) -> bool:
        """True where any limit needs the rating of a channel."""
        return any(t.rating is not None or t.shift is not None for t in (*self.tolerances.values(), self.default))


def load_tolerances(file: str | Path) -> Tolerances:
    """Read a tolerance file. Raises SceneError (file, line, remedy)."""
    return Builder().build(Tolerances, read(Path(file), ()))
