"""Which steps are seen: those whose number is a multiple of a period of somebody who looks."""

from __future__ import annotations

from collections.abc import Iterable


def due(k: int, periods: Iterable[int]) -> bool:
    """True where step k is a multiple of one of the periods."""
    for period in periods:  # noqa: SIM110  # no generator: this is asked of every topic at every step
        if k % period == 0:
            return True
    return False


def before_next(k: int, most: int, periods: Iterable[int]) -> int:
    """Number of the steps k + 1 .. k + most that come before the first that is due."""
    for period in periods:
        most = min(most, period - k % period - 1)
    return most
