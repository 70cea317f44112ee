"""Settings of the time integration, as they stand in a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from solver.dimensions import PerSecond, Time
from solver.validate import finite, require

WHERE = 'integrator'
# s, of a step: 30 years; time is counted in nanoseconds, with 63 bits, and stamps of messages have 31 bits of seconds
LONGEST = 1e9
# relative rounding of a step in seconds, two units in its last place; ten times as much is a ns of a step of 5 days
ROUNDED = 4.4e-16
SMALLEST_PART = 1024  # a step that fails is halved ten times: more costs more than it saves


@dataclass(frozen=True, kw_only=True)
class IntegratorSettings:
    """Settings of the integrator (equations and choices: docs/formulation.md).

    kind: 'alf' is the augmented-Lagrangian integrator, 'm_alf' the same code as the usual augmented Lagrangian of
    multibody codes [Bayo1988] (h_R = lam_R, m_R = 1), 'reference_*' independent slow solutions of the same model. h:
    step [s], a whole number of nanoseconds. rho_inf: spectral radius at infinite frequency, 0 (strong damping) to 1
    (none). order: 2, or 4 by extrapolation of steps of h and h / 2 (needs rho_inf 1): three times the work for accuracy
    where motions are smooth and nothing stiff is left unresolved, with three iterations at least. Motions are
    prescribed with that accuracy, force-like inputs are held over a step. mode: 'fixed' spends `iterations` Newton
    iterations per step, and more, up to 20, only where they do not contract (a stop is hit, a wheel lands), leave more
    than the step itself loses, or where the last one was above 0.01 of the largest velocity (a torque that is there at
    once); 'tolerance' iterates until the relative residual and increment are below `tolerance` or `max_iterations` is
    reached. penalty: xi, dimensionless. form: 'condensed' factorizes the n x n matrix with penalties added, 'block'
    keeps the multipliers. augmentation: 'combined' closes constraints that one augmentation of an iteration leaves open
    by a combination of further ones, 'plain' leaves them to the next iteration. effective_mass: what a penalty
    multiplies, m_R of a constraint by itself ('isolated') or with the others in force ('coupled'). coefficients: 'mass'
    uses m_R alone, 'full' adds what c_R and k_R contribute in one step. mass_factor: multiplies m_R, one number or a
    mapping from constraints (a joint, a coupler or one row) to numbers; with kind 'm_alf' it multiplies m_R = 1.
    penalty_policy: 'adaptive' raises the penalties of the slowest constraints, up to `penalty_cap`, in a step that does
    not converge, and relaxes them after easy steps. step_policy: 'constant' keeps h; 'rescue' halves a step that fails,
    down to `h_min`, and doubles it after easy steps; 'error' also keeps the estimated local error below
    `error_tolerance` per second: positions in m or rad, velocities relative to the largest one. h is then the grid of
    inputs and outputs and the largest step. 'auto' is 'rescue' where nothing waits for a step, and 'constant' in the
    node, whose steps have their time. Error control and adaptive penalties need mode 'tolerance'. h_min: the smallest
    step; where it is not given (0) h / 1024 with 'rescue', 1e-8 with 'error'.
    """

    kind: Literal['alf', 'm_alf', 'reference_bdf', 'reference_radau', 'reference_ida', 'reference_kkt'] = 'alf'
    h: Time = 1e-3
    rho_inf: float = 0.8
    order: int = 2
    mode: Literal['fixed', 'tolerance'] = 'fixed'
    iterations: int = 3
    tolerance: float = 1e-8
    max_iterations: int = 20
    penalty: float = 1e6
    form: Literal['condensed', 'block'] = 'condensed'
    augmentation: Literal['combined', 'plain'] = 'combined'
    effective_mass: Literal['isolated', 'coupled'] = 'isolated'
    coefficients: Literal['mass', 'full'] = 'mass'
    mass_factor: float | dict[str, float] = 1.0
    penalty_policy: Literal['constant', 'adaptive'] = 'constant'
    penalty_cap: float = 1e8
    step_policy: Literal['auto', 'constant', 'rescue', 'error'] = 'auto'
    h_min: Time = 0.0
    error_tolerance: PerSecond = 1e-3

    def __post_init__(self) -> None:
        finite(WHERE, 'h', self.h, low=1e-9, high=LONGEST)
        require(
            abs(self.h * 1e9 - round(self.h * 1e9)) < 1e-6 + ROUNDED * self.h * 1e9,
            WHERE,
            'h',
            self.h,
            f'must be a whole number of nanoseconds; the nearest is {round(self.h * 1e9) * 1e-9:.9f}',
        )
        finite(WHERE, 'rho_inf', self.rho_inf, low=0.0, high=1.0)
        require(self.order in (2, 4), WHERE, 'order', self.order, 'must be 2 or 4')
        if self.order == 4:
            remedy = 'needs integrator.rho_inf: 1 (numerical damping brings odd powers of h into the error)'
            require(self.rho_inf == 1.0, WHERE, 'order', self.order, remedy)
        finite(WHERE, 'iterations', self.iterations, low=1, high=100)
        finite(WHERE, 'tolerance', self.tolerance, low=1e-14, high=1e-1)
        finite(WHERE, 'max_iterations', self.max_iterations, low=1, high=1000)
        finite(WHERE, 'penalty', self.penalty, low=0.0, high=1e15, strict=True)
        for factor in self.mass_factors.values():
            finite(WHERE, 'mass_factor', factor, low=0.0, high=1e6, strict=True)
        finite(WHERE, 'penalty_cap', self.penalty_cap, low=0.0, high=1e15, strict=True)
        if self.h_min:
            finite(WHERE, 'h_min', self.h_min, low=1e-12, high=LONGEST)
        finite(WHERE, 'error_tolerance', self.error_tolerance, low=1e-12, high=1e3)
        for name, value, any_mode in (
            ('penalty_policy', self.penalty_policy, ('constant',)),
            ('step_policy', self.step_policy, ('auto', 'constant', 'rescue')),
        ):
            remedy = (
                'needs integrator.mode: tolerance (a fixed number of iterations has no measured accuracy to adapt to)'
            )
            require(value in any_mode or self.mode == 'tolerance', WHERE, name, value, remedy)
        if self.penalty_policy == 'adaptive':
            remedy = f'must be at least integrator.penalty = {self.penalty:g}'
            require(self.penalty_cap >= self.penalty, WHERE, 'penalty_cap', self.penalty_cap, remedy)
        if self.step_policy in ('rescue', 'error'):
            require(self.h_min <= self.h, WHERE, 'h_min', self.h_min, f'must be at most integrator.h = {self.h:g}')

    @property
    def mass_factors(self) -> dict[str, float]:
        """mass_factor by constraint; '' stands for all."""
        return self.mass_factor if isinstance(self.mass_factor, dict) else {'': self.mass_factor}

    @property
    def adapts(self) -> bool:
        """True where penalties or step may change in the course of a run, or steps are taken together."""
        return self.order != 2 or self.penalty_policy != 'constant' or self.step_policy != 'constant'

    @property
    def smallest_step(self) -> float:
        """Down to which a step may be divided [s]."""
        if self.step_policy == 'constant':
            return self.h
        return self.h_min or (min(1e-8, self.h) if self.step_policy == 'error' else self.h / SMALLEST_PART)

    @property
    def h_ns(self) -> int:
        """The step in nanoseconds."""
        return round(self.h * 1e9)
