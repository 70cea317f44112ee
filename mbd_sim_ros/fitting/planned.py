"""Delivered maneuvers as recordings of the vehicle that a fit begins with: what they would tell, before anyone drives
them."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from mbd_sim_ros.fitting.car import Car
from mbd_sim_ros.fitting.driving import CHUNK
from mbd_sim_ros.fitting.file import Drive, FitFile, Windows
from mbd_sim_ros.fitting.problem import Problem
from mbd_sim_ros.fitting.recordings import Data, Track
from solver.errors import MbdError, SpecError, suggestion
from solver.files.scene import load_scene_text
from solver.levels import simulation_of
from solver.levels.road_wheel import steering_map


class Plan(NamedTuple):
    """A maneuver of config/maneuvers: its words, duration [s] and speed [m/s] of a passenger car, and KEY=VALUE."""

    words: str
    maneuver: str
    duration: float
    speed: float = 22.0
    settings: tuple[str, ...] = ()


PLANS = {
    'steady_circle': Plan('steady circle', 'circle', 25.0, 15.0),
    'step_steer': Plan('step steer', 'step_steer', 8.0),
    'lane_change': Plan('double lane change of ISO 3888-1', 'iso3888_1', 10.0),
    'sine_with_dwell': Plan('sine with dwell', 'sine_with_dwell', 7.0),
    'swept_steer': Plan('swept steering', 'swept_steer', 20.0, 20.0),
    'accelerate_brake': Plan('accelerating and braking', 'accelerate_brake', 12.0, 10.0),
}
# from the least to the most demanding: the first one that tells a number is named
STRAIGHT = 3.0  # s of straight driving before the maneuver, of a passenger car; ten times as much only costs runs


def data_of(car: Car, drive: Drive, channels: dict[str, str], plan: Plan) -> Data:
    """The inputs that a maneuver gives the vehicle, as a recording. Raises MbdError."""
    time, speed = car.size.time, plan.speed * car.size.speed
    settings = [f'maneuver=maneuvers/{plan.maneuver}.yaml', f'start.speed={speed!r}']
    scene = load_scene_text(car.text, 'plan', settings)
    if scene.maneuver.driver is not None:
        road_map = car.road_map or steering_map(scene.model)
        points = np.array(road_map.points)
        ratio = float(np.gradient(points[:, 1], points[:, 0])[len(points) // 2])
        x = {
            t.name: next(b for b in scene.model.bodies if b.name == t.marker.body).position[0]
            for t in scene.model.tires
        }
        own = dataclasses.replace(scene.maneuver.driver, wheelbase=x['front_left'] - x['rear_left'], ratio=ratio)
        scene = dataclasses.replace(scene, maneuver=dataclasses.replace(scene.maneuver, driver=own))
    simulation = simulation_of(scene)
    chassis, names = simulation.channels.chassis or 0, simulation.channels.inputs
    rows = []
    chunk = max(CHUNK // 2, 1)
    for k in range(int(plan.duration * time / (chunk * car.h))):
        shot = simulation.advance(chunk)
        rows.append((k * chunk * car.h, shot.inputs[names.index('steering')], shot.twist[chassis, 0],
                     shot.inputs[names.index('drive_torque')], shot.inputs[names.index('brake_torque')]))  # fmt: skip
    t, angle, v, power, brake = np.array(rows).T
    straight = np.arange(-STRAIGHT * time, -1e-9, chunk * car.h)
    t = np.concatenate([straight, t]) + STRAIGHT * time
    angle, v = (np.concatenate([np.full(straight.size, one[0]), one]) for one in (angle, v))
    power, brake = (np.concatenate([np.full(straight.size, one[0]), one]) for one in (power, brake))
    if car.road_map is not None:
        points = np.array(car.road_map.points)
        angle = np.interp(angle, points[:, 1], points[:, 0])
    tracks = {name: Track(t, drive.channel(angle)) for name in (drive.road_wheel or (drive.steering_wheel,))}
    tracks[drive.speed] = Track(t, v)
    for name, values in ((drive.drive_torque, power), (drive.brake_torque, brake)):
        if name:
            tracks[name] = Track(t, values)
    for name in channels.values():
        tracks.setdefault(name, Track(t, 1e-9 * t))  # until it is predicted; what stands still would be left out
    return Data(plan.words, 'fit', tracks)


def plan_of(name: str) -> Plan:
    """A plan by its name. Raises SpecError."""
    if name not in PLANS:
        raise SpecError(f'recordings: maneuver = {name!r}: no such planned maneuver{suggestion(name, PLANS)}')
    return PLANS[name]


def planned(file: FitFile, base: Problem | None, home: object, plans: list[Plan]) -> Problem:
    """The problem of a fit whose recordings are planned maneuvers; its measured values are those of the vehicle. Raises
    MbdError."""
    car = base.car if base is not None else Car(file, home)  # type: ignore[arg-type]
    time = car.size.time
    channels = {name: one.channel for name, one in file.channels.items()}
    data = []
    for plan in plans:
        data.append(data_of(car, file.drive, channels, plan))
    file = dataclasses.replace(
        file, windows=Windows(length=min(p.duration for p in plans) * time, run_in=1.5 * time, slowest=0.0)
    )
    problem = Problem(file, home, data=data, car=car)  # type: ignore[arg-type]
    which = problem.of('fit')
    x = problem.start
    motions = problem.motions(x, which)
    values = problem.signals(x, motions, which)
    problem.pieces = [p._replace(y=s) for p, s in zip(problem.pieces, values, strict=True)]
    problem.reset_noise()
    return problem


__all__ = ['PLANS', 'MbdError', 'Plan', 'data_of', 'plan_of', 'planned']
