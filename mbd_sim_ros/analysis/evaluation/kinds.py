"""Kinds of evaluations: one object per maneuver of a norm, made in the file of its family and listed in registry.py."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from mbd_sim_ros.analysis.evaluation.figures import Figure, Result
from mbd_sim_ros.analysis.evaluation.signals import Signals
from solver.errors import SpecError
from solver.scene import Scene

SLOWEST = 1.0  # m/s at the start, below which nothing is made longer


@dataclass(frozen=True, kw_only=True)
class Drive:
    """Drive of a maneuver by `mbd maneuver`.

    maneuver: file in config/maneuvers. speed [m/s]: at the start. duration [s]. every: steps between two instants that
    are recorded. road: file in config/roads. amplitude: the key of the scene that is set to the angle of the steering
    wheel with which the car reaches, in a slow ramp of it at this speed, the lateral acceleration `reaches` [m/s^2].
    driver: tell the preview driver the wheelbase and the ratio of the car; cones: its width and length too, and have
    him practise. brakes: deceleration [m/s^2] whose torque brakes the car; hardest: a search from there on for the
    largest one with which every wheel still rolls; 0: the torque of the file. fitted: from the scene with all that the
    user sets to what follows from it (a longer road at a higher speed): key -> value, before what the user sets.
    series: from the angle (mean of a ramp to the left and one to the right, by a straight line) to the amplitudes of
    all runs.
    """

    maneuver: str
    speed: float
    duration: float
    every: int = 10
    road: str = ''
    amplitude: str = ''
    reaches: float = 0.0
    driver: bool = False
    cones: bool = False
    brakes: float = 0.0
    hardest: bool = False
    fitted: Callable[[Scene], Mapping[str, object]] | None = None
    series: Callable[[float], list[float]] | None = None


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """One maneuver of a norm.

    name: on the command line and in `maneuver.evaluation`. norm: what it follows, with its key in docs/references.md.
    needs, also: signals without which it cannot be, and such that give more figures. parameters: a dataclass of numbers
    that may be set. judge: signals and parameters -> Result; raises BagError where the maneuver is not in the
    recording. drive: how `mbd maneuver` drives it; None of evaluations that no maneuver belongs to. together: figures
    of a whole series. judges_sensors: it names wrong units and signs itself.
    """

    name: str
    title: str
    norm: str
    needs: tuple[str, ...]
    also: tuple[str, ...] = ()
    parameters: type
    judge: Callable[[Signals, Any], Result]
    drive: Drive | None = None
    together: Callable[[list[Result]], tuple[Figure, ...]] | None = None
    aliases: tuple[str, ...] = ()
    judges_sensors: bool = False

    @property
    def driven(self) -> Drive:
        """Drive by `mbd maneuver`. Raises SpecError where no maneuver belongs to it."""
        if self.drive is None:
            raise SpecError(
                f'{self.name}: no maneuver belongs to it, it judges recordings: mbd evaluate BAG --as {self.name}'
            )
        return self.drive


def speed_of(scene: Scene) -> float:
    """Speed at the start [m/s] by which a maneuver is fitted: SLOWEST at least."""
    return max(scene.start.speed, SLOWEST)
