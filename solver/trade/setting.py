"""A way to simulate a scene: how much of the vehicle, and how finely."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from solver.scene import Fidelity, Scene
from solver.step.settings import IntegratorSettings

ITERATIONS = (1, 2, 3)
RHOS = (0.8, 0.5)


@dataclass(frozen=True, kw_only=True)
class Setting:
    """level: of detail. off: subsystems that are left out. h: step [s]. iterations: per step; None iterates to
    `tolerance`.

    rho_inf: spectral radius at infinite frequency. other: further keys of the integrator, for a second formulation.
    """

    level: Fidelity = 'full'
    off: tuple[str, ...] = ()
    h: float = 1e-3
    iterations: int | None = None
    rho_inf: float = 0.8
    tolerance: float = 1e-10
    other: tuple[tuple[str, Any], ...] = ()

    def __str__(self) -> str:
        how = (
            f'{self.iterations} iteration{"s" * (self.iterations > 1)}'
            if self.iterations
            else f'tolerance {self.tolerance:g}'
        )
        off = f' without {", ".join(self.off)}' if self.off else ''
        return f'{self.level}{off}, {self.h * 1e3:g} ms, {how}, rho {self.rho_inf:g}'

    @property
    def model(self) -> tuple[str, tuple[str, ...]]:
        """Level and subsystems that are off: they decide about the model."""
        return self.level, self.off

    def of(self, scene: Scene) -> Scene:
        """The scene simulated this way, with constant step and penalties and the method of second order. It requires no
        accuracy: what is measured here is not what an older plan certifies."""
        integrator = dataclasses.replace(scene.integrator, **self.integrator(scene))
        require = dataclasses.replace(scene.require, accuracy={})
        switches = dict.fromkeys(self.off, 'off')
        return dataclasses.replace(
            scene,
            fidelity=self.level,
            switches=switches,  # type: ignore[arg-type]
            integrator=integrator,
            require=require,
        )

    def integrator(self, scene: Scene) -> dict[str, Any]:
        """The settings of the integrator that differ from those of the scene."""
        mode: dict[str, Any] = {'mode': 'fixed', 'iterations': self.iterations}
        if self.iterations is None:
            # fewer would be no reference
            most = max(scene.integrator.max_iterations, IntegratorSettings().max_iterations)
            mode = {'mode': 'tolerance', 'tolerance': self.tolerance, 'max_iterations': most}
        mode |= {
            'kind': 'alf',
            'h': self.h,
            'rho_inf': self.rho_inf,
            'step_policy': 'constant',
            'penalty_policy': 'constant',
            'order': 2,
        }
        return mode | dict(self.other)

    def keys(self) -> dict[str, Any]:
        """The keys of a scene that this setting is, as they stand in a file."""
        integrator: dict[str, Any] = {'h': self.h, 'rho_inf': self.rho_inf}
        if self.iterations:
            integrator |= {'mode': 'fixed', 'iterations': self.iterations}
        else:
            integrator |= {'mode': 'tolerance', 'tolerance': self.tolerance}
        return {'fidelity': self.level, 'switches': dict.fromkeys(self.off, 'off'), 'integrator': integrator}


def baseline(scene: Scene) -> Setting:
    """The full vehicle at 1 ms with the iterations of the scene, to which costs are related."""
    settings = scene.integrator
    if settings.mode == 'fixed':
        return Setting(h=1e-3, iterations=settings.iterations, rho_inf=settings.rho_inf)
    return Setting(h=1e-3, rho_inf=settings.rho_inf, tolerance=settings.tolerance)


def grid(
    model: Setting, steps: Sequence[float], iterations: Sequence[int] = ITERATIONS, rhos: Sequence[float] = RHOS
) -> list[Setting]:
    """All combinations of these, with level and switches of `model`."""
    return [
        dataclasses.replace(model, h=h, iterations=n, rho_inf=rho)
        for h, n, rho in itertools.product(steps, iterations, rhos)
    ]
