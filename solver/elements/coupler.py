"""Couplers and drivers: one constraint row that is linear in joint coordinates.

phi = sum_k factor_k x_k - offset - u(t). Rack and pinion, gears and the open differential (three terms) are couplers;
a driver (prescribed motion) is a coupler with an input u, whose rate and acceleration are inputs too.
"""

from __future__ import annotations

from dataclasses import dataclass

from solver.elements.marker import Spec, finite, require

MAX_TERMS = 3


@dataclass(frozen=True, kw_only=True)
class CouplerSpec(Spec):
    """sum of factor * coordinate = offset + input.

    terms: up to three (coordinate name, factor). offset: None takes the value that holds in the placed (initial) configuration.
    input: name of the channel of u; channels '<input>_rate' and '<input>_acceleration' must exist beside it.
    """

    terms: tuple[tuple[str, float], ...]
    offset: float | None = None
    input: str | None = None

    def __post_init__(self) -> None:
        require(1 <= len(self.terms) <= MAX_TERMS, self.where, 'terms', self.terms, f'needs 1 to {MAX_TERMS} [coordinate, factor] pairs')
        self.set('terms', tuple((str(c), finite(self.where, f'factor of {c}', f)) for c, f in self.terms))
        if self.offset is not None:
            self.set('offset', finite(self.where, 'offset', self.offset))
