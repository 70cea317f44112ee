"""Impossible states of a vehicle, whatever the equations say: its parts would stand within each other, or inside out.

Nothing but tires touches anything in these models, so nothing stops a motion there: a trailer that folds into its car,
wheels whose centre is below the road, axles whose wheels change sides or leave their suspension, a steering wheel
beyond its end stops. A run goes on, and what comes after the time that is told is none of a vehicle. Leaning over is
possible, and told elsewhere (solver.analysis.envelope).

*Folded.* A trailer is folded from a right angle on. Before that, where the triangle of its ball and its first wheels
meets the rectangle between the wheels of the car. *Under the road.* The centre of a wheel is on the other side of the
tangent plane of the road at its contact. *Crossed.* The left wheel of an axle is to the right of the right one. *Torn
off.* The centre of a wheel is further than its own radius from where it stands in its chassis by design, or its spin
axis has turned by more than a right angle, so that its outside is inside. Suspensions of cars and trucks travel by less
than two thirds of a radius to either side, and wheels steer by less than 70 degrees. *Beyond the end.* The steering
wheel is further than PRESSED times the angle of its end stops: a maneuver is held there, and a free steering wheel
presses them in; inputs that somebody gives step by step are not.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from solver.checks.check import Check, Measured
from solver.checks.vehicle import ARTICULATION as FOLDED
from solver.checks.vehicle import CROSSED, PRESSED, STEERING_END, SUSPENSION, UNDER_ROAD, WHEEL_AXIS
from solver.compiled.portable import product
from solver.elements.rigid_body import RigidBodySpec
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.findings import Finding
from solver.model.frames import matrix
from solver.model.spec import ModelSpec
from solver.output.snapshot import layout_of
from solver.validate import Vector
from solver.vehicle.trailer import ARTICULATION, HITCH, TRAILER

if TYPE_CHECKING:
    from solver.simulation import Simulation

SIDES = ('left', 'right')


class _Watch(NamedTuple):
    """A limit of one thing. sign: 1 where what is more is beyond, -1 what is less."""

    check: Check
    where: str
    limit: float
    sign: float


class Impossible:
    """Follows rows of snapshots: fold(), from any state; findings() says what was. A copy of it goes its own way.

    It is there for vehicles, which have a category and a chassis; of others nothing is followed. joints: place of a
    joint among the numbers of a snapshot, and its limit; wheels: of the vehicle; watches: limits, of joints first.
    """

    def __init__(self, simulation: Simulation) -> None:
        model, channels = simulation.model.spec, simulation.channels
        self._layout, self.watches = layout_of(channels), []
        self._worst: np.ndarray = np.zeros(0)
        self._first: np.ndarray = np.zeros(0)
        self.joints: list[tuple[int, float]] = []
        if 'steering_wheel' in channels.joints and model.lock is not None:
            self._joint(channels.joints.index('steering_wheel'), STEERING_END, 'steering_wheel', PRESSED * model.lock)
        if ARTICULATION in channels.joints:
            self._joint(channels.joints.index(ARTICULATION), FOLDED, TRAILER, folded_at(model))
        self.wheels = _Wheels(model, simulation) if simulation.of_bodies else None
        if self.wheels is not None:
            self.watches += self.wheels.watches
        self._worst, self._first = np.zeros(len(self.watches)), np.full(len(self.watches), math.inf)

    def _joint(self, k: int, check: Check, where: str, limit: float) -> None:
        self.joints.append((self._layout['joint_position'][0].start + k, limit))
        self.watches.append(_Watch(check, where, limit, 1.0))

    def __bool__(self) -> bool:
        return bool(self.watches)

    def fold(self, rows: np.ndarray, times: np.ndarray) -> None:
        """Follow snapshots, rows of numbers (n, size), at times (n,) [s]."""
        columns = [np.abs(rows[:, [place for place, _ in self.joints]])]
        if self.wheels is not None:
            columns.append(self.wheels.values(rows))
        values = np.concatenate(columns, axis=1)
        sign, limit = (np.array([getattr(watch, name) for watch in self.watches]) for name in ('sign', 'limit'))
        beyond = sign * (values - limit)
        worst, first = self._worst.copy(), self._first.copy()
        for k in np.flatnonzero((beyond > 0.0).any(axis=0)).tolist():
            worst[k] = max(worst[k], float(beyond[:, k].max()))
            first[k] = min(first[k], float(times[np.argmax(beyond[:, k] > 0.0)]))
        self._worst, self._first = worst, first

    def findings(self) -> list[Finding]:
        """Findings, of every kind the one that began first, with the worst value and the time at which it began."""
        found: dict[str, Finding] = {}
        begun: dict[str, float] = {}
        for watch, worst, first in zip(self.watches, self._worst.tolist(), self._first.tolist(), strict=True):
            name = watch.check.name
            if first < begun.get(name, math.inf):
                value = watch.limit + watch.sign * worst
                begun[name] = first
                found[name] = watch.check.finding(
                    Measured(value=value, limit=watch.limit, time=first, where=watch.where)
                )
        return list(found.values())


class _Wheels:
    """Places of the wheels of a vehicle, in their chassis and over the road."""

    def __init__(self, model: ModelSpec, simulation: Simulation) -> None:
        channels, layout = simulation.channels, layout_of(simulation.channels)
        self.pose, self.tire = layout['pose'][0], layout['tire'][0]
        self._bodies, self._tires = len(channels.bodies), len(channels.wheels)
        bodies = {body.name: body for body in model.bodies}
        whole = bool(model.category) and model.chassis is not None
        self.names = [tire.name for tire in model.tires]
        self.own = np.array([channels.bodies.index(tire.marker.body) for tire in model.tires], int)
        self.rows = np.array([channels.wheels.index(name) for name in self.names], int)
        self.centre = np.array([tire.marker.position for tire in model.tires]).reshape(-1, 3)
        self.axis = np.array([matrix(tire.marker.orientation)[:, 1] for tire in model.tires]).reshape(-1, 3)
        radii = [float(tire.data['UNLOADED_RADIUS']) for tire in model.tires]
        carriers = [
            TRAILER if TRAILER in bodies and tire.name.startswith(TRAILER) else model.chassis or ''
            for tire in model.tires
        ]
        self.watches = [_Watch(UNDER_ROAD, name, 0.0, 1.0) for name in self.names]
        self.whole, self.pairs = whole, []
        if not whole:
            return
        self.carrier = np.array([channels.bodies.index(name) for name in carriers], int)
        self.design = np.array(
            [_within(bodies[c], bodies[t.marker.body], t.marker.position) for c, t in zip(carriers, model.tires)]
        )
        self.watches += [_Watch(SUSPENSION, name, radius, 1.0) for name, radius in zip(self.names, radii, strict=True)]
        self.watches += [_Watch(WHEEL_AXIS, name, 0.5 * math.pi, 1.0) for name in self.names]
        stems = {name[: -len(SIDES[0])] for name in self.names if name.endswith(SIDES[0])}
        self.pairs = [
            (self.names.index(stem + SIDES[0]), self.names.index(stem + SIDES[1]))
            for stem in sorted(stems)
            if stem + SIDES[1] in self.names
        ]
        self.watches += [_Watch(CROSSED, self.names[left], 0.0, -1.0) for left, _ in self.pairs]

    def values(self, rows: np.ndarray) -> np.ndarray:
        """(n, watches) of rows (n, size)."""
        poses = rows[:, self.pose].reshape(len(rows), self._bodies, 7)
        tires = rows[:, self.tire].reshape(len(rows), self._tires, -1)[:, self.rows]
        place, turn = poses[:, self.own, :3], _matrices(poses[:, self.own, 3:])
        centre = place + np.einsum('nwij,wj->nwi', turn, self.centre)
        at, over = TIRE_COLUMNS.index('px'), TIRE_COLUMNS.index('qx')
        normal = _matrices(tires[:, :, over : over + 4])[..., 2]
        columns = [-np.einsum('nwi,nwi->nw', normal, centre - tires[:, :, at : at + 3])]
        if self.whole:
            frame = _matrices(poses[:, self.carrier, 3:])
            within = np.einsum('nwji,nwj->nwi', frame, centre - poses[:, self.carrier, :3])
            columns.append(np.sqrt(np.square(within - self.design).sum(axis=2)))
            axis = np.einsum('nwij,wj->nwi', turn, self.axis)
            columns.append(np.arccos(np.clip(np.einsum('nwi,nwi->nw', axis, frame[..., 1]), -1.0, 1.0)))
            columns.append(
                np.array([within[:, left, 1] - within[:, right, 1] for left, right in self.pairs])
                .reshape(-1, len(rows))
                .T
            )
        return np.concatenate(columns, axis=1)


def _within(carrier: RigidBodySpec, body: RigidBodySpec, point: Vector) -> np.ndarray:
    """(3,) a point of a body [m] in the frame of another one, in the design position."""
    at = np.array(body.position) + product(matrix(body.orientation), np.array(point)) - np.array(carrier.position)
    return product(matrix(carrier.orientation).T, at)


def _matrices(q: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4), x, y, z, w."""
    x, y, z, w = np.moveaxis(q, -1, 0)
    rows = (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
        (2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
        (2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def folded_at(model: ModelSpec) -> float:
    """Articulation [rad] from which a trailer is folded into its car: see the module. Both point along x in the design
    position."""
    bodies = {body.name: body for body in model.bodies}
    ball = next(joint for joint in model.joints if joint.name == HITCH).i
    hitch = (np.array(bodies[ball.body].position) + ball.position)[:2]
    own = [np.array(bodies[tire.marker.body].position)[:2] for tire in model.tires if not tire.name.startswith(TRAILER)]
    drawn = [
        np.array(bodies[tire.marker.body].position)[:2] - hitch for tire in model.tires if tire.name.startswith(TRAILER)
    ]
    if not own or not drawn:
        return 0.5 * math.pi
    low, high = np.min(own, axis=0) - hitch, np.max(own, axis=0) - hitch
    first = max(float(at[0]) for at in drawn)
    wheels = [at for at in drawn if at[0] >= first - 1e-6]
    for angle in np.linspace(0.0, 0.5 * math.pi, 181):
        c, s = math.cos(angle), math.sin(angle)
        for x, y in wheels:
            edge = np.linspace(0.0, 1.0, 51)[:, None] * (c * x - s * y, s * x + c * y)
            if ((edge > low) & (edge < high)).all(axis=1).any():
                return float(angle)
    return 0.5 * math.pi
