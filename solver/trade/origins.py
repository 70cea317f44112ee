"""Errors of one run by their origin: model, step and iteration, against the converged full vehicle or mechanism.

The reference is Richardson's limit of runs with the step of the scene, its half and its quarter, iterated to tolerance
(solver.trade.reference). This costs some twelve times the run; `mbd run --accuracy` asks for it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from solver.errors import SpecError
from solver.quantities import names, published
from solver.scene import Scene
from solver.trade.bench import AS_GIVEN, Bench, errors_of, truth_of
from solver.trade.errors import ORIGINS
from solver.trade.setting import Setting

PARTS = (1, 2, 4)  # of the step of the scene, of the runs of the reference
MANY = 40  # quantities of a mechanism; ten times as many are no table any more


class Origins(NamedTuple):
    """Largest errors of a quantity, in its unit: the whole, by ORIGINS, and the peak that percentages refer to."""

    unit: str
    whole: float
    parts: tuple[float, ...]
    peak: float


def origins_of(scene: Scene, stop: Callable[[], bool] | None = None) -> dict[str, Origins]:
    """The errors of a run of a scene by quantity. stop: says that runs shall end, by Stopped. Raises SpecError where
    the settings of the integrator are not those of a constant step of second order, and StepError where the reference
    fails."""
    given = scene.integrator
    for key, constant in (
        ('kind', ('alf',)),
        ('order', (2,)),
        ('step_policy', ('auto', 'constant', 'rescue')),
        ('penalty_policy', ('constant',)),
    ):
        if getattr(given, key) not in constant:
            raise SpecError(
                f'integrator.{key} = {getattr(given, key)!r}: errors by origin are those of constant steps of second '
                'order'
            )
    if scene.fidelity == 'auto':
        raise SpecError("fidelity = 'auto': its plan has measured the errors by origin (mbd plan)")
    setting = Setting(
        level=scene.fidelity,
        off=tuple(name for name, state in scene.switches.items() if state == 'off'),
        h=given.h,
        iterations=given.iterations if given.mode == 'fixed' else None,
        rho_inf=given.rho_inf,
        tolerance=given.tolerance,
    )
    bench = Bench(
        scene=scene,
        names=tuple(_named(scene)),
        steps=tuple(round(given.h_ns / n) * 1e-9 for n in PARTS),
        stop=None if stop is None else lambda ahead=0.0: stop(),
    )
    errors, truth = errors_of(bench, AS_GIVEN, setting), truth_of(bench, AS_GIVEN)
    found = {}
    for name, error in errors.items():
        band = truth.band[name].max
        parts = (error.model.max, error.step.max, error.iteration.max, band)
        found[name] = Origins(truth.quantities[name].unit, error.whole.max, parts, truth.peaks[name])
    return found


def _named(scene: Scene) -> list[str]:
    """Quantities of a vehicle; of a mechanism its coordinates, or the place of its first body."""
    channels = published(scene.model)
    coordinates = [f'joint_states/{joint}/position' for joint in channels.joints][:MANY]
    return names(channels) or coordinates or [f'odom/pose/{axis}' for axis in 'xyz']


def report(found: dict[str, Origins]) -> dict[str, Any]:
    """As objects for JSON."""
    return {
        name: {'unit': one.unit, 'peak': one.peak, 'whole': one.whole, **dict(zip(ORIGINS, one.parts, strict=True))}
        for name, one in found.items()
    }


def rows(found: dict[str, Origins]) -> list[tuple[str, ...]]:
    """A table for people: largest errors, in % of the peak."""
    table: list[tuple[str, ...]] = [('largest error', 'whole', *ORIGINS, 'of the peak')]
    for name, one in found.items():
        shares = [f'{100.0 * error / one.peak:.2g} %' for error in (one.whole, *one.parts)]
        table.append((name, *shares, f'{one.peak:.4g} {one.unit}'.removesuffix(' 1')))
    return table
