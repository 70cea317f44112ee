"""The check of the speed of a run, where a scene asks for one."""

from __future__ import annotations

from collections.abc import Iterator

from solver.checks.check import Check, Evidence, Measured


def real_time_factor_min(e: Evidence) -> Iterator[Measured]:
    """Simulated seconds per second, where somebody measured them."""
    if e.real_time_factor is not None:
        yield Measured(value=e.real_time_factor)


REAL_TIME_FACTOR_MIN = Check(
    name='real_time_factor_min',
    rule='none; simulated seconds per second',
    measure=real_time_factor_min,
    reason='the run is too slow',
    remedy='Take a larger integrator.h or a faster machine',
    require='real_time_factor_min',
    least=True,
)
