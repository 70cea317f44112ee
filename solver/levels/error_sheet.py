"""The error sheet of a level: six maneuvers of a vehicle at the level and as a whole, side by side.

    step steer at 0.4 g, sine with dwell at three times the reference angle [ISO19365], swept sine 0.2 to 2 Hz at 0.3 g,
    all at 80 km/h; braking with 0.5 g from 100 km/h; pulling with 0.2 g from 50 km/h, unless pedal and gear drive the
    vehicle; a road of 2 m wavelength, 5 mm high, left and right alike, at 20 m/s

Angles of the steering wheel follow from a slow ramp of the whole vehicle (13.5 deg/s at 80 km/h, as ISO 19365 asks
for): the reference angle is that at 0.3 g. Speeds, times and lengths are those of passenger cars and grow with the
vehicle (solver.vehicle.size).

Errors are root mean squares and largest differences over the run, in parts of the peak of the whole vehicle; of
the wheels that with the largest is shown. A quantity that a level does not publish has no figure.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np

from solver.analysis.departures import departure
from solver.analysis.driven import DIRECT
from solver.disk import derived
from solver.elements.road import HeightGrid, RoadSpec
from solver.findings import ErrorFigure
from solver.inputs.maneuver import Maneuver
from solver.inputs.signals import Ramp, SineWithDwell, Step, Sweep
from solver.levels import simulation_of
from solver.levels.track_straight import gear_of
from solver.model.spec import ModelSpec
from solver.quantities import names, published, quantity
from solver.scene import Fidelity, Scene, StartSettings
from solver.simulation import Simulation
from solver.step.settings import IntegratorSettings
from solver.units import MODEL_GRAVITY
from solver.vehicle.size import size_of

NO_SWITCHES: Mapping[str, Literal['on', 'off']] = MappingProxyType({})
SPEED = 80.0 / 3.6  # m/s
H = 1e-3  # s
EVERY = 10  # steps between samples
RAMP = math.radians(13.5)  # rad/s
REST = 1.0  # s straight on
WAVE, AMPLITUDE, ROAD_SPEED = 2.0, 0.005, 20.0  # m, m, m/s
OF_BODY = ('longitudinal_velocity', 'yaw_rate', 'sideslip_velocity', 'roll', 'pitch')
BY_WHEEL = ('wheel_load',)


class Course(NamedTuple):
    """A maneuver of the sheet on its road."""

    name: str
    speed: float  # at the start [m/s]
    maneuver: Maneuver
    duration: float  # [s]
    road: RoadSpec = RoadSpec()


def course_scene(
    model: ModelSpec,
    course: Course,
    fidelity: Fidelity,
    switches: Mapping[str, Literal['on', 'off']] = NO_SWITCHES,
    h: float | None = None,
) -> Scene:
    """The scene of a course; h [s]: None for that of the sheet."""
    h = step_of(model) if h is None else h
    return Scene(
        name=course.name, model=dataclasses.replace(model, road=course.road), maneuver=course.maneuver,
        duration=course.duration,
        start=StartSettings(kind='equilibrium', speed=course.speed), integrator=IntegratorSettings(h=h, iterations=2),
        fidelity=fidelity,
        switches=dict(switches),
    )  # fmt: skip


def step_of(model: ModelSpec) -> float:
    """H of a vehicle [s], in whole nanoseconds."""
    return round(H * size_of(model).time, 9)


def angles(model: ModelSpec, accelerations: tuple[float, ...]) -> list[float]:
    """Angles of the steering wheel [rad] at lateral accelerations [m/s^2], from a slow ramp of the whole vehicle at
    SPEED."""
    t = size_of(model).time
    slower = min(1.0, gear_of(model) / DIRECT) / t
    ramp = Course('slow ramp', SPEED * t, Maneuver(steering=Ramp(slope=RAMP * slower, start=0.5 * t)), 8.0 * t)
    simulation = simulation_of(course_scene(model, ramp, 'full', h=2.0 * step_of(model)))
    column, chassis = simulation.channels.inputs.index('steering'), simulation.channels.chassis or 0
    wheel, lateral = [0.0], [0.0]
    while simulation.t_ns < ramp.duration * 1e9 and lateral[-1] < max(accelerations):
        shot = simulation.advance(EVERY)
        wheel.append(float(shot.inputs[column]))
        lateral.append(float(shot.twist[chassis, 0] * shot.twist[chassis, 5]))
    rising = np.maximum.accumulate(np.array(lateral))
    return [float(np.interp(a, rising, wheel)) for a in accelerations]


def dwell(amplitude: float, start: float, t: float) -> SineWithDwell:
    """Sine with dwell [rad] from start [s], of a vehicle whose times are t times those of a passenger car."""
    usual = SineWithDwell(amplitude=amplitude, start=start)
    return dataclasses.replace(usual, frequency=usual.frequency / t, dwell=usual.dwell * t)


def courses(model: ModelSpec) -> tuple[Course, ...]:
    """The maneuvers of the sheet for a vehicle."""
    reference, step = angles(model, (0.3 * MODEL_GRAVITY, 0.4 * MODEL_GRAVITY))
    mass = sum(body.mass for body in model.bodies)
    radius = float(np.mean([tire.data.values['UNLOADED_RADIUS'] for tire in model.tires]))
    t, length = size_of(model).time, size_of(model).length
    rest = REST * t
    x = np.arange(0.0, 120.0 + 0.05, 0.05) - 10.0  # of a passenger car
    rise = np.clip((x - 10.0) / 5.0, 0.0, 1.0)
    wave = [
        length * AMPLITUDE * r * r * (3.0 - 2.0 * r) * math.sin(2.0 * math.pi * at / WAVE)
        for r, at in zip(rise.tolist(), x.tolist(), strict=True)
    ]
    road = RoadSpec(
        grids=(
            HeightGrid(
                origin=(-10.0 * length, -10.0 * length),
                step=(0.05 * length, 20.0 * length),
                height=tuple((z, z) for z in wave),
            ),
        )
    )
    pull = Course(
        'pulling 0.2 g',
        50.0 / 3.6 * t,
        Maneuver(drive_torque=Step(value=0.2 * MODEL_GRAVITY * mass * radius, start=rest, rise=0.3 * t)),
        5.0 * t,
    )
    return (
        Course('step steer 0.4 g', SPEED * t,
        Maneuver(steering=Step(value=step, start=rest, rise=0.15 * t), drive_torque=0.0), 5.0 * t),
        Course('sine with dwell 3 A', SPEED * t, Maneuver(steering=dwell(3.0 * reference, rest, t)), 5.0 * t),
        Course(
            'swept sine 0.3 g', SPEED * t,
            Maneuver(steering=Sweep(amplitude=reference, frequency=0.2 / t, final_frequency=2.0 / t, duration=14.0 * t,
            start=rest)),
            15.5 * t,
        ),
        Course(
            'braking 0.5 g', 100.0 / 3.6 * t,
            Maneuver(brake_torque=Step(value=0.5 * MODEL_GRAVITY * mass * 0.95 * radius, start=rest, rise=0.3 * t)),
            5.0 * t,
        ),
        *((pull,) if 'drive_torque' in model.inputs else ()),
        Course('road of 2 m', ROAD_SPEED * t, Maneuver(), 4.0 * t, road),
    )  # fmt: skip


def shown(simulation: Simulation, course: Course, h: float) -> dict[str, np.ndarray]:
    """Quantity -> its values at the samples of a course (n, components) of steps h [s], of those the simulation
    publishes."""
    rows = np.array([simulation.advance(EVERY).numbers for _ in range(round(course.duration / (h * EVERY)))])
    there = names(simulation.channels)
    wanted = [name for name in there if name in OF_BODY or name.partition('.')[0] in BY_WHEEL]
    return {name: (q := quantity(name, simulation.channels)).of(rows[:, q.places]) for name in wanted}


def compared(
    model: ModelSpec, course: str, ours: dict[str, np.ndarray], theirs: dict[str, np.ndarray]
) -> list[ErrorFigure]:
    """Figures of every quantity that both have and that moves in the course; of those of the wheels the worst."""
    channels, size, h = published(model), size_of(model), step_of(model)
    worst: dict[str, ErrorFigure] = {}
    for name, reference in theirs.items():
        q = quantity(name, channels, size)
        if name not in ours or q.peak(reference) <= q.least:
            continue
        time_ = np.arange(1, len(reference) + 1) * (h * EVERY)
        found = departure(q, time_, ours[name], reference)
        shown_as = name.partition('.')[0]
        figure = ErrorFigure(
            maneuver=course,
            quantity=shown_as,
            rms=found.share('rms'),
            largest=found.share('max'),
            peak=found.peak,
            unit=q.unit,
        )
        if shown_as not in worst or figure.rms > worst[shown_as].rms:
            worst[shown_as] = figure
    return list(worst.values())


def error_sheet(
    model: ModelSpec,
    fidelity: Fidelity,
    switches: Mapping[str, Literal['on', 'off']] = NO_SWITCHES,
    progress: Callable[[str, float], None] = lambda text, done: None,
) -> tuple[ErrorFigure, ...]:
    """The error sheet of a level of a vehicle, measured once (solver.disk.derived). Raises MbdError."""
    bare = dataclasses.replace(model, road=RoadSpec())

    def measure() -> list[dict[str, Any]]:
        found: list[ErrorFigure] = []
        h = step_of(bare)
        progress('slow ramp', 0.0)
        every = courses(bare)
        for k, course in enumerate(every):
            progress(course.name, (k + 0.5) / len(every))
            whole = shown(simulation_of(course_scene(bare, course, 'full')), course, h)
            ours = shown(simulation_of(course_scene(bare, course, fidelity, switches)), course, h)
            found += compared(bare, course.name, ours, whole)
        return [dataclasses.asdict(figure) for figure in found]

    return tuple(
        ErrorFigure(**figure)
        for figure in derived(f'errors-{fidelity}', repr((bare, sorted(switches.items()))), measure)
    )
