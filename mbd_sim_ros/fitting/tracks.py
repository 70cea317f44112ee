"""The level single_track at other numbers of the vehicle, without its derivation: its tables, of which a derivation
takes seconds, are linear in the numbers near those at which it was derived.

They are derived at the centre and at either side of it for every number, and kept on disk. A fit derives them again at
its result and goes on from there until that is the centre, so that the result is that of the level itself; only the
direction in which it seeks is that of the linear tables. Slopes serve again as long as the centre is near to where they
were derived: those of another car lead past the result, from one side to the other.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from solver.errors import MbdError, SceneError, SpecError
from solver.levels import derive
from solver.levels.single_track_engine import SingleTrack
from solver.scene import Scene
from solver.simulation import Simulation

Tables = dict[str, dict[str, float]]
SceneOf = Callable[[Mapping[str, float]], Scene]
# widths of the numbers, by which a centre may be away from where slopes were derived; ten times as much is another car
NEAR = 3.0
PART = 0.5  # of the sd of a number, by which it is moved to either side; ten times as much is no derivative


class LinearTrack:
    """See the module. scene_of: the scene with other numbers. centre: the numbers at which it was derived."""

    def __init__(
        self, scene_of: SceneOf, centre: dict[str, float], widths: dict[str, float], before: LinearTrack | None = None
    ) -> None:
        self.centre = centre
        self.tables = self._derived(scene_of, centre)
        near = before is not None and all(
            name in before.origin and abs(value - before.origin[name]) <= NEAR * widths[name]
            for name, value in centre.items()
        )
        self.origin: dict[str, float] = before.origin if before is not None and near else dict(centre)  # of the slopes
        self.slopes: dict[str, Tables] = before.slopes if before is not None and near else {}
        for name in centre:
            if name not in self.slopes:
                self.slopes[name] = self._slope(scene_of, name, PART * widths[name])
        self._scene = derive(dataclasses.replace(scene_of(centre), fidelity='single_track'))

    def _slope(self, scene_of: SceneOf, name: str, step: float) -> Tables:
        """Derivatives of the tables by a number, from either side; where no vehicle has the number on one side, as an
        inertia beyond the sum of both others, from the other one. Raises SceneError and SpecError where none has it on
        both."""
        sides: list[tuple[float, Tables]] = []
        failed: MbdError | None = None
        for moved in (step, -step):
            try:
                sides.append((moved, self._derived(scene_of, {**self.centre, name: self.centre[name] + moved})))
            except (SceneError, SpecError) as error:
                failed = error
        if len(sides) < 2:
            if not sides and failed is not None:
                raise failed
            sides.append((0.0, self.tables))
        (a, above), (b, below) = sides
        return {
            group: {key: (numbers[key] - below[group][key]) / (a - b) for key in numbers}
            for group, numbers in above.items()
        }

    @staticmethod
    def _derived(scene_of: SceneOf, values: Mapping[str, float]) -> Tables:
        found: Any = derive(dataclasses.replace(scene_of(values), fidelity='single_track')).engine
        return {group: dict(numbers) for group, numbers in found.keywords['parameters'].items()}

    def at(self, values: Mapping[str, float]) -> Tables:
        """The tables at other numbers."""
        tables = {group: dict(numbers) for group, numbers in self.tables.items()}
        for name, centre in self.centre.items():
            away = values.get(name, centre) - centre
            if away:
                for group, numbers in self.slopes[name].items():
                    for key, slope in numbers.items():
                        tables[group][key] += slope * away
        return tables

    def simulation(self, scene: Scene, values: Mapping[str, float]) -> Simulation:
        """A simulation with other numbers. scene: is not derived."""
        tables = self.at(values)
        return Simulation(
            self._scene.scene, lambda given: SingleTrack(given, parameters=tables), level=self._scene.report
        )
