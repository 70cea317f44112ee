"""Runs of a whole vehicle on a flat road that show its axles: what a single-track model of it is identified from."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.compiled.portable import norms
from solver.elements.road import RoadSpec
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.errors import SpecError, StepError
from solver.inputs.maneuver import Maneuver
from solver.levels.fitting import each
from solver.model.spec import ModelSpec
from solver.scene import Scene, StartSettings
from solver.simulation import Simulation
from solver.step.failure import LARGEST_TURN_PER_STEP
from solver.step.settings import IntegratorSettings
from solver.vehicle.size import size_of

# s, of a passenger car, as all times and speeds of these runs: they grow with the vehicle (solver.vehicle.size)
H = 2e-3
PARTS = (1, 2, 4, 5, 8, 10)  # of H, in whole nanoseconds
SPEED = 22.0  # m/s
EVERY = 5  # steps between samples
LEAST_SAMPLES = 20
CORNERS = ('front_left', 'front_right', 'rear_left', 'rear_right')


@dataclass(frozen=True, kw_only=True)
class Drive:
    """A run: speed at its start [m/s], inputs, duration [s], all of the vehicle itself."""

    speed: float
    maneuver: Maneuver
    duration: float


class IdentificationRun(NamedTuple):
    """Curves of a run, one row per sample; axles: front, rear."""

    time: np.ndarray  # (n,) [s]
    inputs: np.ndarray  # (n EVERY, nu) of every step of h
    names: tuple[str, ...]  # of the inputs
    vx: np.ndarray  # (n,) of the origin of the chassis, along it [m/s]
    vy: np.ndarray
    yaw_rate: np.ndarray  # [rad/s]
    height: np.ndarray  # of that origin [m]
    pose: np.ndarray  # (n, 4) quaternion of the chassis
    effort: np.ndarray  # at the steering wheel [N m]
    spin: np.ndarray  # (n, 2) mean of an axle [rad/s]
    tire: dict[str, np.ndarray]  # column -> (n, 4), wheels in the order of CORNERS
    h: float  # H of the vehicle [s]

    def axle(self, column: str) -> np.ndarray:
        """(n, 2) sums of both wheels of each axle."""
        four = self.tire[column]
        return np.stack([four[:, 0] + four[:, 1], four[:, 2] + four[:, 3]], axis=1)


def step_of(model: ModelSpec) -> float:
    """H of a vehicle [s], a whole number of PARTS in nanoseconds."""
    return H if (time := size_of(model).time) == 1.0 else 4e-8 * round(H * time / 4e-8)


def whole_vehicle(model: ModelSpec, drive: Drive) -> Simulation:
    """The simulation of a run of the vehicle on a flat road. Its step is H, or a part of that in which no rotor behind
    a gear turns further than a verdict wants of bodies."""
    h = step_of(model)
    scene = Scene(
        name='identification', model=dataclasses.replace(model, road=RoadSpec()), maneuver=drive.maneuver,
        duration=drive.duration,
        start=StartSettings(kind='equilibrium', speed=drive.speed), integrator=IntegratorSettings(h=h, iterations=2),
    )  # fmt: skip
    simulation = Simulation(scene)
    turn = h * float(norms(simulation.state.v[:-1, 3:]).max())
    parts = next((n for n in PARTS if turn <= n * LARGEST_TURN_PER_STEP), PARTS[-1])
    return (
        simulation
        if parts == 1
        else Simulation(dataclasses.replace(scene, integrator=IntegratorSettings(h=h / parts, iterations=2)))
    )


def driven(model: ModelSpec, drive: Drive) -> IdentificationRun:
    """Run the vehicle; a run that fails ends where it failed. Raises SpecError where that is at once."""
    simulation = whole_vehicle(model, drive)
    h = step_of(model)
    channels, parts = simulation.channels, round(h / simulation.h)
    wheels = [channels.wheels.index(corner) for corner in CORNERS]
    joint = channels.joints.index('steering_wheel') if 'steering_wheel' in channels.joints else -1
    chassis = channels.chassis or 0
    shots, inputs = [], []
    for _ in range(round(drive.duration / (h * EVERY))):
        try:
            shot = simulation.advance(EVERY * parts)
        except StepError:
            break
        assert simulation.applied is not None
        shots.append(shot)
        inputs.append(simulation.applied[parts - 1 :: parts])
    if len(shots) < LEAST_SAMPLES:
        after = simulation.t_ns * 1e-9
        raise SpecError(
            f'the vehicle as a whole fails after {after:.3g} s of a run at {drive.speed:g} m/s; see why with fidelity: '
            'full'
        )
    tires = np.array([s.tire[wheels] for s in shots])
    twist = np.array([s.twist[chassis] for s in shots])
    pose = np.array([s.pose[chassis] for s in shots])
    tire = {name: tires[:, :, k].copy() for k, name in enumerate(TIRE_COLUMNS)}
    spin = 0.5 * np.stack([tire['spin'][:, 0] + tire['spin'][:, 1], tire['spin'][:, 2] + tire['spin'][:, 3]], axis=1)
    return IdentificationRun(
        time=np.array([s.t_ns for s in shots]) * 1e-9,
        inputs=np.concatenate(inputs),
        names=channels.inputs,
        vx=twist[:, 0], vy=twist[:, 1], yaw_rate=twist[:, 5], height=pose[:, 2], pose=pose[:, 3:],
        effort=np.array([s.joint_effort[joint] if joint >= 0 else 0.0 for s in shots]),
        spin=spin, tire=tire, h=h,
    )  # fmt: skip


def heading(qx: np.ndarray, qy: np.ndarray, qz: np.ndarray, qw: np.ndarray) -> np.ndarray:
    """Yaw of quaternions [rad]."""
    return each(math.atan2, 2.0 * (qx * qy + qz * qw), 1.0 - 2.0 * (qy * qy + qz * qz))


def roll_of(run: IdentificationRun) -> np.ndarray:
    """Roll of the chassis [rad]."""
    x, y, z, w = run.pose.T
    return each(math.atan2, 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))


def pitch_of(run: IdentificationRun) -> np.ndarray:
    """Pitch of the chassis [rad]."""
    x, y, z, w = run.pose.T
    return each(math.asin, 2.0 * (w * y - z * x))
