"""The vehicle of a fit: its numbers by name, and simulations of it with other ones."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.fitting.file import FitFile
from mbd_sim_ros.fitting.similar import read_back, vehicle_like, yaml_of
from mbd_sim_ros.fitting.tracks import LinearTrack
from solver.elements.rigid_body import RigidBodySpec
from solver.errors import SpecError, suggestion
from solver.files.naming import included
from solver.files.overrides import keys_of
from solver.files.scene import find_file, load_scene_text
from solver.levels import derive
from solver.levels.road_wheel import steering_map
from solver.levels.single_track_engine import SPIN, VX, SingleTrack
from solver.scene import Scene
from solver.simulation import Simulation
from solver.vehicle.size import size_of

TIRES = ('front.tire.values', 'rear.tire.values')
FACTORS = ('LMUX', 'LMUY', 'LKX', 'LKY', 'LCX', 'LCY', 'LEX', 'LEY', 'LTR', 'LRES', 'LXAL', 'LYKA', 'LMX', 'LMY')


@dataclasses.dataclass(frozen=True)
class Number:
    """A number of the vehicle under a short name: its keys, all of which take the same value, and the standard
    deviation of its class, as a part of the value or absolute."""

    keys: tuple[str, ...]
    of_class: float
    relative: bool = True
    unit: str = ''


def _tire(factors: tuple[str, ...], places: tuple[str, ...] = TIRES, sd: float = 0.1) -> Number:
    return Number(tuple(f'{place}.{name}' for place in places for name in factors), sd, unit='1')


# Scatter of passenger cars of one class about what their data say. Ten times as much would say nothing of a car: 100 %
# of a mass. Masses and inertias: [Heydinger1999]; tires: of two makes of one size
SHORT = {
    'mass': Number(('chassis.mass',), 0.1, unit='kg'),
    'center_x': Number(('chassis.com.0',), 0.05, relative=False, unit='m'),
    'height': Number(('chassis.com.2',), 0.08, unit='m'),
    'roll_inertia': Number(('chassis.inertia.0',), 0.2, unit='kg m^2'),
    'pitch_inertia': Number(('chassis.inertia.1',), 0.15, unit='kg m^2'),
    'yaw_inertia': Number(('chassis.inertia.2',), 0.1, unit='kg m^2'),
    'friction': _tire(('LMUX', 'LMUY')),
    'friction_front': _tire(('LMUX', 'LMUY'), TIRES[:1]),
    'friction_rear': _tire(('LMUX', 'LMUY'), TIRES[1:]),
    'cornering_stiffness': _tire(('LKY',), sd=0.15),
    'cornering_stiffness_front': _tire(('LKY',), TIRES[:1], 0.15),
    'cornering_stiffness_rear': _tire(('LKY',), TIRES[1:], 0.15),
    'slip_stiffness': _tire(('LKX',), sd=0.2),
    'slip_stiffness_front': _tire(('LKX',), TIRES[:1], 0.2),
    'slip_stiffness_rear': _tire(('LKX',), TIRES[1:], 0.2),
    'lateral_stiffness_front': Number(('front.tire.values.LATERAL_STIFFNESS',), 0.2, unit='N/m'),
    'lateral_stiffness_rear': Number(('rear.tire.values.LATERAL_STIFFNESS',), 0.2, unit='N/m'),
    'drag_area': Number(('aero.drag_area',), 0.2, unit='m^2'),
    'steering_ratio': Number(('steering.rack_per_turn',), 0.02, unit='m'),
    'anti_roll_bar_front': Number(('front.anti_roll_bar',), 0.2, unit='N/m'),
    'anti_roll_bar_rear': Number(('rear.anti_roll_bar',), 0.2, unit='N/m'),
}
OTHER = 0.2  # of a number by its key: relative; ten times as much would say nothing
# Numbers that every interval takes into account although nobody seeks them, as sd of their class
CONSTANTS = (
    'mass', 'center_x', 'height', 'yaw_inertia', 'roll_inertia', 'friction_front', 'friction_rear',
    'cornering_stiffness_front', 'cornering_stiffness_rear',
)  # fmt: skip
SPEED = 20.0  # m/s of the start, of a passenger car; windows begin with their own


class Car:
    """See the module. size: beside a passenger car. keys: of the vehicle by name."""

    def __init__(self, file: FitFile, home: Path) -> None:
        self.level = file.level
        if file.like is not None:
            node: Any = vehicle_like(file.like)
            text = yaml_of({'vehicle': node})
        else:
            beside = home / file.vehicle
            place = beside if beside.is_file() else find_file(file.vehicle, 'vehicles')
            text = f'vehicle: {included(place)}\n'
        first = load_scene_text(text + 'duration: 1\n', 'fit', file.set)
        self.size = size_of(first.model)
        h = 1e-3 * round(1e3 * file.step * 1e6) * 1e-6 if file.step else 4e-3 * self.size.time
        self.h = max(round(h * 1e9 / 1000.0), 1) * 1000.0 * 1e-9
        self.speed = SPEED * self.size.speed
        setting = f'start: {{kind: equilibrium, speed: {self.speed!r}}}\n'
        # to tolerance: a fixed number of iterations has more of them in some steps and not in others, as torques change
        # between samples, and a run jumps by 1e-4 of its size where a number moves by 1e-6 (decision 0034)
        setting += f'integrator: {{h: {self.h!r}, mode: tolerance, step_policy: constant}}\n'
        scene = load_scene_text(text + setting + 'duration: 1000\n', 'fit', file.set)
        if file.loads is not None:
            scene = load_scene_text(scene.resolved, 'fit', _loaded(scene, file.loads.front, file.loads.rear))
        self.text = scene.resolved
        self.data = read_back(self.text)['vehicle']
        self.base = scene
        self.loads = file.loads
        self._tracks: LinearTrack | None = None
        self.road_map = steering_map(scene.model) if file.drive.road_wheel else None
        chassis = next(b for b in scene.model.bodies if b.name == (scene.model.chassis or scene.model.bodies[0].name))
        x, y, z = (p + c for p, c in zip(chassis.position, chassis.com, strict=True))
        self.com = x, y, z
        self.lock = scene.model.lock

    def number(self, name: str) -> Number:
        """The number of a name: a short one, 'tire.KEY' of both axles, or a key of the vehicle file. Raises
        SpecError."""
        if name in SHORT:
            return SHORT[name]
        path = name.removeprefix('vehicle.')
        head, _, last = path.rpartition('.')
        if head == 'tire':
            keys: tuple[str, ...] = tuple(f'{place}.{last}' for place in TIRES)
        elif head in ('front.tire', 'rear.tire'):
            keys = (f'{head}.values.{last}',)
        else:
            keys = ('.'.join(keys_of(path)),)
        factor = last in FACTORS
        for key in keys:
            self._at(key, name)
        return Number(keys, 0.1 if factor else OTHER, unit='1' if factor else '')

    def value(self, name: str) -> float:
        """Value of a number in the vehicle as it is given: the mean of its keys. Raises SpecError."""
        number = self.number(name)
        return float(np.mean([self._at(key, name) for key in number.keys]))

    def class_sd(self, name: str) -> float:
        """Standard deviation of the class of a number, in its unit."""
        number = self.number(name)
        if not number.relative:
            return number.of_class * self.size.length
        return number.of_class * abs(self.value(name)) or number.of_class

    def _at(self, key: str, name: str) -> float:
        here: Any = self.data
        words = keys_of(key)
        for k, word in enumerate(words):
            if isinstance(here, Mapping) and word in here:
                here = here[word]
            elif isinstance(here, list) and word.isdigit() and int(word) < len(here):
                here = here[int(word)]
            elif k == len(words) - 1 and word in FACTORS and isinstance(here, Mapping):
                return 1.0
            else:
                known = [*SHORT, *(here if isinstance(here, Mapping) else ())]
                raise SpecError(
                    f'parameters: {name}: the vehicle has no number {key}{suggestion(name, known)}; mbd info of the '
                    'vehicle lists its keys'
                )
        if isinstance(here, bool) or not isinstance(here, int | float):
            raise SpecError(f'parameters: {name}: {key} of the vehicle is no number; name one, e.g. {key}.0 of a list')
        return float(here)

    def assignments(self, values: Mapping[str, float]) -> list[str]:
        """KEY=VALUE of a scene with other numbers."""
        found = []
        for name, value in values.items():
            number = self.number(name)
            own = self.value(name)
            for key in number.keys:
                # a shared name moves all its keys by the same factor
                at = self._at(key, name)
                new = value if len(number.keys) == 1 or own == 0.0 else at * (value / own)
                found.append(f'vehicle.{key}={new!r}')
        return found

    def scene(self, values: Mapping[str, float]) -> Scene:
        """The scene with other numbers. Raises SceneError and SpecError for what is no vehicle."""
        scene = load_scene_text(self.text, 'fit', self.assignments(values))
        if self.loads is not None:
            scene = load_scene_text(scene.resolved, 'fit', _loaded(scene, self.loads.front, self.loads.rear))
        return scene

    def simulation(self, values: Mapping[str, float]) -> Simulation:
        """A simulation with other numbers, at rest in its start. Raises MbdError."""
        scene = dataclasses.replace(self.scene(values), fidelity=self.level)
        if self.level == 'single_track' and self._tracks is not None:
            return self._tracks.simulation(scene, values)
        derived = derive(scene)
        level = None if derived.as_given else derived.report
        return Simulation(derived.scene, level=level) if derived.engine is None else Simulation(
            derived.scene, derived.engine, level=level
        )  # fmt: skip

    @property
    def centre(self) -> str:
        """The numbers at which a level that is linear in them was derived, and its slopes; '' of the others."""
        return '' if self._tracks is None else repr((self._tracks.centre, self._tracks.origin))

    def linearize(self, values: Mapping[str, float], widths: Mapping[str, float]) -> None:
        """Derive the level single_track at values and at either side of them, once: see LinearTrack."""
        if self.level == 'single_track':
            self._tracks = LinearTrack(self.scene, dict(values), dict(widths), self._tracks)


def begin(simulation: Simulation, speed: float) -> None:
    """Back to the start, at another speed straight ahead: all velocities in proportion, which constraints allow."""
    simulation.reset()
    factor = speed / simulation.scene.start.speed
    engine = simulation.engine
    if isinstance(engine, SingleTrack):
        engine.y[VX] *= factor
        engine.y[SPIN : SPIN + 2] *= factor
    else:
        simulation.state.v[...] *= factor


def _loaded(scene: Scene, front: float, rear: float) -> list[str]:
    """KEY=VALUE by which the chassis gives the whole vehicle these masses on its axles [kg]."""
    model = scene.model
    chassis: RigidBodySpec = next(b for b in model.bodies if b.name == (model.chassis or model.bodies[0].name))
    wheels = {t.name: next(b for b in model.bodies if b.name == t.marker.body).position[0] for t in model.tires}
    ahead = 0.5 * (wheels['front_left'] + wheels['front_right'])
    behind = 0.5 * (wheels['rear_left'] + wheels['rear_right'])
    others = [b for b in model.bodies if b is not chassis]
    mass = front + rear - math.fsum(b.mass for b in others)
    if not mass > 0.0:
        rest = math.fsum(b.mass for b in others)
        raise SpecError(
            f'loads: front: {front:g} kg and rear: {rear:g} kg leave no mass for the chassis, for all other parts '
            f'of the vehicle weigh {rest:.4g} kg; give the masses on both axles in kg, or another vehicle'
        )
    moment = front * ahead + rear * behind - math.fsum(b.mass * (b.position[0] + b.com[0]) for b in others)
    return [f'vehicle.chassis.mass={mass!r}', f'vehicle.chassis.com.0={moment / mass - chassis.position[0]!r}']
