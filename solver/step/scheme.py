"""The scheme of a model: parameters of the step from the settings of a scene."""

from __future__ import annotations

import numpy as np

from solver.model.saddle import BLOCK, CONDENSED
from solver.model.tables import Model
from solver.step.constraint_coefficients import mass_factors
from solver.step.settings import IntegratorSettings
from solver.step.work import Scheme, scheme_parameters

# Iterations of a step of order four, at least: with two its order falls to 2.5 (double pendulum), with one to two; six
# change nothing.
FEWEST_OF_FOUR = 3


def scheme_of(model: Model, settings: IntegratorSettings) -> Scheme:
    """The scheme of these settings, without the addresses of kernels."""
    iterations = settings.iterations if settings.mode == 'fixed' else settings.max_iterations
    if settings.order == 4:
        iterations = max(iterations, FEWEST_OF_FOUR)
    return Scheme(
        **scheme_parameters(settings.h_ns * 1e-9, settings.rho_inf),
        penalty=np.full(model.n_rows, settings.penalty),
        factor=mass_factors(model, settings.mass_factors),
        m_alf=int(settings.kind == 'm_alf'),
        weigh=0,
        coupled=int(settings.effective_mass == 'coupled'),
        full=int(settings.coefficients == 'full'),
        form=BLOCK if settings.form == 'block' else CONDENSED,
        fixed=int(settings.mode == 'fixed'),
        iterations=iterations,
        tolerance=settings.tolerance,
        combined=int(settings.augmentation == 'combined'),
        step=0,
    )
