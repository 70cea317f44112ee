"""Settings of the time integration, as they stand in a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from solver.elements.marker import finite, require

WHERE = 'integrator'


@dataclass(frozen=True, kw_only=True)
class IntegratorSettings:
    """How a model is advanced in time.

    kind: 'alf' is the augmented-Lagrangian integrator, 'm_alf' the same code with the modified coefficients of the chapter
    (h_R = lam_R, m_R = 1), 'reference_*' independent slow solutions of the same model.
    h: step [s], a whole number of nanoseconds. rho_inf: spectral radius at infinite frequency, 0 (strong damping) to 1 (none).
    mode: 'fixed' spends `iterations` Newton iterations per step whatever the residual, 'tolerance' iterates until the relative
    residual and increment are below `tolerance` or `max_iterations` is reached.
    penalty: xi, dimensionless. form: 'condensed' factorizes the n x n matrix with penalties added, 'block' keeps the
    multipliers. adaptive: let the step (down from h) and the penalties follow the convergence.
    """

    kind: Literal['alf', 'm_alf', 'reference_bdf', 'reference_radau', 'reference_ida', 'reference_kkt'] = 'alf'
    h: Annotated[float, 's'] = 1e-3
    rho_inf: float = 0.8
    mode: Literal['fixed', 'tolerance'] = 'fixed'
    iterations: int = 2
    tolerance: float = 1e-8
    max_iterations: int = 20
    penalty: float = 1e6
    form: Literal['condensed', 'block'] = 'condensed'
    adaptive: bool = False

    def __post_init__(self) -> None:
        finite(WHERE, 'h', self.h, low=1e-9, high=1.0)
        require(
            abs(self.h * 1e9 - round(self.h * 1e9)) < 1e-6,
            WHERE,
            'h',
            self.h,
            f'must be a whole number of nanoseconds; the nearest is {round(self.h * 1e9) * 1e-9:.9f}',
        )
        finite(WHERE, 'rho_inf', self.rho_inf, low=0.0, high=1.0)
        finite(WHERE, 'iterations', self.iterations, low=1, high=100)
        finite(WHERE, 'tolerance', self.tolerance, low=1e-14, high=1e-1)
        finite(WHERE, 'max_iterations', self.max_iterations, low=1, high=1000)
        finite(WHERE, 'penalty', self.penalty, low=0.0, high=1e15, strict=True)

    @property
    def h_ns(self) -> int:
        """The step in nanoseconds."""
        return round(self.h * 1e9)
