"""Scene: what is simulated, how it starts, what drives it, how it is integrated, recorded and judged, as data. Format:
docs/scene.md.

The file is long because it lists every key of a scene, with its unit, its bounds and its meaning.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from solver.checks.registry import LIMITS
from solver.dimensions import Frequency, Speed, Time
from solver.elements.coordinate import CoordinateSpec
from solver.elements.marker import Spec
from solver.elements.registry import CONSTRAINTS, FORCES
from solver.errors import SpecError, suggestion
from solver.inputs.actuation import Actuation
from solver.inputs.assistance import Assistance
from solver.inputs.command_filter import BY_WHEEL, STEERING
from solver.inputs.controllers import Controller
from solver.inputs.maneuver import Maneuver, base_names
from solver.inputs.recorded import Reach
from solver.inputs.signals import maps_in, signal
from solver.model.compile import joint_coordinates
from solver.model.spec import ModelSpec
from solver.output.sensors import Sensors
from solver.quantities import published, quantity
from solver.step.settings import IntegratorSettings
from solver.validate import finite, require
from solver.vehicle.actuation import forward_gears, reaches

SAMPLES = 1001  # of an input, where a look at the whole of it is enough
# of the width of a map: so far its polynomial may be followed, and so far beyond the zeros of Chebyshev's the ends are
BEYOND = 0.05
LONGEST = 9e9  # s: time is counted in nanoseconds, with 63 bits
CHASSIS_FRAME = 'base_link'
OF_FRAMES = {
    CHASSIS_FRAME: 'the chassis (the first body, unless the model names one)',
    'imu_link': 'the IMU',
    'odom': 'the world',
}
Fidelity = Literal['full', 'condensed', 'kc', 'single_track', 'auto']
SUBSYSTEMS = (
    'engine_mounts',
    'subframes',
    'steering_column',
    'driveline_torsion',
    'anti_roll_bars',
    'stops',
    'relaxation',
    'turn_slip',
    'camber',
    'drag',
    'road_unevenness',
)


@dataclass(frozen=True, kw_only=True)
class CoordinateStart:
    """Initial value [rad or m] and rate [rad/s or m/s] wanted of one joint coordinate; None leaves it to the
    assembly."""

    value: float | None = None
    rate: float | None = None


@dataclass(frozen=True, kw_only=True)
class StartSettings:
    """The state at t = 0.

    kind: 'as_placed' takes the placement in the file, which must satisfy the joints to 1e-6; 'assemble' moves the
    bodies as little as possible until it does; 'equilibrium' seeks static equilibrium under gravity (a vehicle whose
    brakes are all released is held along the x axis of its chassis meanwhile, and rolls away from a slope at t = 0).
    Velocities are made to fit in every case. stable: refuse an equilibrium that the model would leave by itself. speed:
    along the x axis of the chassis [m/s], rolling wheels included; a vehicle that starts so from its equilibrium has
    settled at this speed with drag, drive, brakes and its angle of steering, on the course it was placed on (a torque
    at the steering wheel acts from t = 0 on, and so does a drive under which wheels spin or the speed changes by a
    tenth in 50 ms). coordinates: joint coordinates that are wanted; the rate of a wheel's goes before rolling, and what
    has settled keeps none.
    """

    kind: Literal['as_placed', 'assemble', 'equilibrium'] = 'as_placed'
    stable: bool = True
    speed: Speed = 0.0
    coordinates: dict[str, CoordinateStart] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Record:
    """Contents of a recording besides the standard topics.

    every: one message set per so many steps. elements: force element columns, elements_rate: how often (0: in every
    message set); they are most of a recording. reactions: constraint forces of all rows. branches: look at every step
    whether the mechanism leaves a singular position on another branch than it came in on (slow: a dense decomposition
    of all constraints); the run reports `branch_switches`. poses: how often /tf places all bodies, at most 100 times a
    second; motions: how often velocities and accelerations of all bodies are shown, energies: how often those of the
    energy account are; 0: never.
    """

    every: int = 1
    elements: bool = True
    elements_rate: Frequency = 100.0
    reactions: bool = False
    branches: bool = False
    poses: Frequency = 50.0
    motions: Frequency = 0.0
    energies: Frequency = 0.0

    def __post_init__(self) -> None:
        finite('record', 'every', self.every, low=1)
        finite('record', 'elements_rate', self.elements_rate, low=0.0)
        finite('record', 'poses', self.poses, low=0.0, high=100.0)
        finite('record', 'motions', self.motions, low=0.0)
        finite('record', 'energies', self.energies, low=0.0)
        for name in ('elements_rate', 'poses', 'motions', 'energies'):
            rate = getattr(self, name)
            require(
                rate == 0.0 or rate >= 1.0 / LONGEST,
                'record',
                name,
                rate,
                f'must be 0, or once in {LONGEST:g} s at least',
            )

    def poses_every(self, h: float) -> int:
        """Steps of h [s] between two instants at which all bodies are placed, a multiple of `every`; 0: there are
        none."""
        return self._apart(self.poses, h) if self.poses > 0.0 else 0

    def motions_every(self, h: float) -> int:
        """Steps of h [s] between two instants at which the motions of all bodies are shown, a multiple of `every`; 0:
        there are none."""
        return self._apart(self.motions, h) if self.motions > 0.0 else 0

    def energies_every(self, h: float) -> int:
        """Steps of h [s] between two instants at which energies are shown, a multiple of `every`; 0: there are
        none."""
        return self._apart(self.energies, h) if self.energies > 0.0 else 0

    def elements_every(self, h: float) -> int:
        """Steps of h [s] between two instants at which force elements are recorded, a multiple of `every`."""
        return self._apart(self.elements_rate, h) if self.elements_rate > 0.0 else self.every

    def _apart(self, rate: float, h: float) -> int:
        return self.every * max(1, math.ceil(round(1.0 / (rate * h * self.every), 6)))


@dataclass(frozen=True)
class Bound:
    """A limit of an error: absolute in SI units, or as part of the peak of the reference. In files '0.1 m' and '2 %'.

    unit: in SI, that the limit was given with, '' without one. The quantity that it limits must have the same unit.
    """

    value: float
    share: bool = False
    unit: str = field(default='', repr=False, compare=False)  # 0.1 m and 100 mm are one limit, and one plan

    def of(self, peak: float) -> float:
        """The limit in SI units."""
        return self.value * peak if self.share else self.value


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """Largest errors of one quantity against the converged full vehicle: max over time, rms its root mean square, delay
    in time.

    Each with its unit, or (max and rms) in % of the peak of the quantity.
    """

    max: Bound | None = None
    rms: Bound | None = None
    delay: Bound | None = None

    def __post_init__(self) -> None:
        if not self.bounds:
            raise SpecError('require: a quantity needs at least one of max, rms and delay')
        if self.delay is not None and self.delay.share:
            raise SpecError('delay: must be a time, e.g. 5 ms')
        for name, bound in self.bounds.items():
            finite('require', name, bound.value, low=0.0, strict=True)

    @property
    def bounds(self) -> dict[str, Bound]:
        """Those that are given, by measure."""
        given = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        return {name: bound for name, bound in given.items() if bound is not None}


@dataclass(frozen=True, kw_only=True)
class Budget:
    """Largest cost of a run. real_time_factor: at least so many simulated seconds per second of one core."""

    real_time_factor: float | None = None

    def __post_init__(self) -> None:
        if self.real_time_factor is not None:
            finite('budget', 'real_time_factor', self.real_time_factor, low=0.0, strict=True)


@dataclass(frozen=True, kw_only=True)
class Require:
    """Limits a run must keep; it is suspect otherwise, and `mbd run` ends with a code that is not 0.

    limits: of checks, each with a key of its own beside the others (docs/stability.md says what they are of). One that
    is given replaces the limit that follows from the method; `mbd run` shows figure and limit of everything that is
    beyond. branch_switches_max looks for them as record.branches does. allow_suspect: a run that is suspect by limits
    that are not given here ends with code 0; it is called suspect all the same. accuracy: errors that a level of detail
    and a coarse integration may make, by quantity, which `mbd plan` keeps; a quantity may also stand beside the other
    keys: `require: {yaw_rate: {rms: 2 %}}`.
    """

    limits: dict[str, float] = field(default_factory=dict, metadata={'keys': LIMITS})
    allow_suspect: bool = False
    accuracy: dict[str, Accuracy] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in (n for n in self.limits if n not in LIMITS):
            raise SpecError(f'require: {name}: no check has such a limit{suggestion(name, LIMITS)}')


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A complete simulation task.

    name, title: for people. model: the mechanism or vehicle on its road. actuation: which commands a vehicle takes, and
    the actuators between them and its inputs. assistance: anti-lock and stability control at the brakes, an automatic
    gearbox. controllers: units of co-simulation that see the motion and command inputs, before assistance and
    actuators. duration: simulated time [s]. seed: added to those of random roads; 0 leaves them as they are. sensors:
    accuracy and noise of odom and imu. fidelity: how much of a vehicle is simulated (solver.levels); 'auto' is what the
    plan of this scene says. switches: subsystems of a vehicle that are 'off', at every level (SUBSYSTEMS,
    docs/scene.md). resolved: the scene as YAML text with every include and override expanded; load_scene_text() of it
    gives the same scene ('' for a scene made in Python).
    """

    name: str
    model: ModelSpec
    title: str = ''
    start: StartSettings = StartSettings()
    maneuver: Maneuver = field(default_factory=Maneuver)
    actuation: Actuation = field(default_factory=Actuation)
    assistance: Assistance = field(default_factory=Assistance)
    controllers: tuple[Controller, ...] = ()
    integrator: IntegratorSettings = field(default_factory=IntegratorSettings)
    fidelity: Fidelity = 'full'
    switches: dict[str, Literal['on', 'off']] = field(default_factory=dict)
    duration: Time = 10.0
    record: Record = Record()
    sensors: Sensors = field(default_factory=Sensors)
    require: Require = Require()
    budget: Budget = Budget()
    seed: int = 0
    resolved: str = field(default='', repr=False, compare=False)

    def __post_init__(self) -> None:
        where_ = f'scene {self.name!r}'
        finite(where_, 'duration', self.duration, low=0.0, strict=True)
        finite(where_, 'duration', self.duration, high=LONGEST)
        require(self.seed >= 0, where_, 'seed', self.seed, 'must be 0 or more')
        none = f'makes no step of {self.integrator.h_ns * 1e-9:g} s; take longer, or a smaller integrator.h'
        require(self.steps > 0, where_, 'duration', self.duration, none)
        _check_frames(where_, self.model)
        _check_channels(where_, self.model)
        known = [c.name for c in coordinates_of(self.model)]
        for name in (n for n in self.start.coordinates if n not in known):
            require(False, where_, 'start.coordinates', name, 'no such coordinate' + suggestion(name, known))
        names = base_names(self.model.inputs)
        for name in (n for n in self.maneuver.channels if n not in names):
            require(
                False,
                where_,
                'maneuver',
                name,
                'the model has no such input' + (_actuated(name) or suggestion(name, names)),
            )
        _check_inputs(where_, self.maneuver, np.linspace(0.0, self.duration, SAMPLES), self.actuation.wheels)
        _check_reaches(where_, self.maneuver, np.linspace(0.0, self.duration, SAMPLES), reaches(self.model))
        shifts = 0 if self.assistance.shift is None else len(self.assistance.shift.up)
        gears = forward_gears(self.model) or shifts + 1
        more = (
            f'the last shift is into gear {shifts + 1}, and the gearbox has {gears}: give a row less for each that '
            'there is not'
        )
        require(shifts < gears, where_, 'assistance.shift.up', shifts, more)
        if self.maneuver.by_road_wheel:
            require(
                'steering' in names,
                where_,
                'maneuver.road_wheel',
                '...',
                'needs the input steering: an angle, of a vehicle',
            )
        if self.maneuver.driver is not None:
            ahead = (
                'a driver looks ahead, and steers a vehicle that goes backwards off his path; take 0 or more, or '
                'maneuver.steering'
            )
            require(self.start.speed >= 0.0, where_, 'start.speed', self.start.speed, ahead)
            target = None if self.maneuver.speed is None else self.maneuver.speed.target
            require(
                not isinstance(target, float | int) or target >= 0.0, where_, 'maneuver.speed.target', target, ahead
            )
        commanded = [name for controller in self.controllers for name in controller.outputs.values()]
        for name in commanded:
            require(name in names, where_, 'controllers', name, 'the model has no such input' + suggestion(name, names))
            require(
                commanded.count(name) == 1, where_, 'controllers', name, 'two controllers command it: take one away'
            )
        for name in (n for n in self.actuation.actuators if n not in names):
            require(False, where_, 'actuation.actuators', name, 'the model has no such input' + suggestion(name, names))
        needs = 'works on the brakes of single wheels: set actuation: {wheels: true}'
        require(self.actuation.wheels or not self.assistance.brakes, where_, 'assistance', 'given', needs)
        _check_accuracy(where_, self.require.accuracy, self.model)
        for name in (n for n in self.switches if n not in SUBSYSTEMS):
            require(False, where_, 'switches', name, 'no such subsystem' + suggestion(name, SUBSYSTEMS))
        vehicle = bool(self.model.tires)
        require(
            vehicle or self.fidelity == 'full',
            where_,
            'fidelity',
            self.fidelity,
            'only a vehicle has levels; remove this key',
        )
        require(
            vehicle or not self.switches,
            where_,
            'switches',
            [*self.switches],
            'only a vehicle has subsystems; remove this key',
        )

    @property
    def steps(self) -> int:
        """Number of steps of the whole duration."""
        return round(self.duration * 1e9 / self.integrator.h_ns)

    @property
    def reduced(self) -> bool:
        """True where a derived model is to be simulated instead of the model as given (solver.levels.derive)."""
        return self.fidelity != 'full' or 'off' in self.switches.values()

    @property
    def hash(self) -> str:
        """Short hash of the resolved text."""
        return hashlib.sha256(self.resolved.encode()).hexdigest()[:16]


def coordinates_of(model: ModelSpec) -> list[CoordinateSpec]:
    """All coordinates of a model: those of its joints, and those between markers."""
    return [c for joint in model.joints for c in joint_coordinates(joint)] + list(model.coordinates)


def _actuated(name: str) -> str:
    """The actuation that makes a command an input of a vehicle, or nothing."""
    if name == STEERING['torque']:
        return '; a torque turns the steering wheel with actuation: {steering: torque}'
    if name.startswith(BY_WHEEL):
        return '; single wheels are driven and braked with actuation: {wheels: true}'
    return '; give it as maneuver.road_wheel, not under signals' if name == STEERING['road_wheel'] else ''


def _check_inputs(where_: str, maneuver: Maneuver, t: np.ndarray, wheels: bool) -> None:
    """Refuse brakes with the wrong sign, and maps that are asked far beyond their points.

    t: instants [s]. wheels: whether there are brakes of single wheels, which may be taken from.
    """
    torque = signal(maneuver.brake_torque).jet(t).value
    brakes = wheels or not np.max(torque) <= 0.0 or np.min(torque) >= 0.0
    positive = 'nothing is braked, for it is nowhere above 0: a brake torque is positive whichever way the wheels turn'
    require(bool(brakes), where_, 'maneuver.brake_torque', float(np.min(torque)), positive)
    for name, one in maneuver.channels.items():
        for mapped in maps_in(one):
            low, high = mapped.points[0][0], mapped.points[-1][0]
            x = signal(mapped.of).jet(t).value
            beyond = float(np.max(np.maximum(low - x, x - high)))
            far = (
                f'a map is asked {beyond:g} beyond its points, {low:g} to {high:g}, where the polynomial means '
                'nothing; give more points'
            )
            require(not beyond > BEYOND * (high - low), where_, 'maneuver', name, far)


def _check_reaches(where_: str, maneuver: Maneuver, t: np.ndarray, reaches: Mapping[str, Reach]) -> None:
    """Refuse pedals and gears beyond those that there are, at instants t [s]."""
    for name, one in maneuver.channels.items():
        reach = reaches.get(name)
        worst = None if reach is None else reach.beyond(one.jet(t).value)
        if reach is not None and worst is not None:
            require(False, where_, f'maneuver.signals.{name}', worst, reach.remedy)


def _check_frames(where_: str, model: ModelSpec) -> None:
    """Refuse bodies whose names cannot be those of frames in /tf, or are those of others there."""
    chassis = model.chassis or model.bodies[0].name
    for name in (body.name for body in model.bodies if body.name != chassis or chassis != CHASSIS_FRAME):
        remedy = f'is the frame of {OF_FRAMES.get(name)} in /tf and robot_description; rename the body'
        require(name not in OF_FRAMES, where_, 'body', name, remedy)
        require(
            bool(name) and not name.startswith('/'),
            where_,
            'body',
            name,
            'a frame needs a name that does not begin with /',
        )


def _check_channels(where_: str, model: ModelSpec) -> None:
    """Refuse elements of different kinds whose outputs, and constraints whose rows, would have the same names."""
    columns = [(element.name, element) for kind in FORCES if not kind.wheels for element in getattr(model, kind.name)]
    rows = [
        (row, element) for kind in CONSTRAINTS for element in getattr(model, kind.name) for row in element.row_names()
    ]
    for what, named in (('outputs', columns), ('reactions', rows)):
        first: dict[str, Spec] = {}
        for name, element in named:
            other = first.setdefault(name, element)
            if other is not element:
                raise SpecError(
                    f'{where_}: {other.where} and {element.where} have {what} of the same name; rename one of them'
                )


def _check_accuracy(where_: str, accuracy: dict[str, Accuracy], model: ModelSpec) -> None:
    channels = published(model) if accuracy else None
    for name, asked in accuracy.items():
        assert channels is not None
        try:
            unit = quantity(name, channels).unit
        except SpecError as error:
            raise SpecError(f'{where_}: require.{error}') from None
        if unit == '1' and name.startswith('element_states/'):
            continue  # one of which nothing is known
        for measure, bound in asked.bounds.items():
            must = f'is in {bound.unit}; the unit of this quantity is {"none" if unit == "1" else unit} (or %)'
            require(
                measure == 'delay' or bound.unit in ('', unit), where_, f'require.{name}.{measure}', bound.value, must
            )
