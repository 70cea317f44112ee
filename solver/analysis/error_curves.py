"""Curves that two runs of a scene are compared by: quantities of a vehicle, motions of the bodies of a mechanism.

Of a mechanism the error of a position is related to the largest way that any of its centres of mass goes in the run,
that of an orientation to the largest turn of any of its bodies, half a turn at most: what else a body does hardly moves
the picture. Errors of rounding count as none. Of a vehicle it is related to the peak of the quantity, at least to that
of an ordinary maneuver.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from solver.quantities import Quantity, lengths, names, quantity
from solver.simulation import Simulation
from solver.vehicle.named_quantities import NAMED
from solver.vehicle.size import size_of
from solver.vehicle.trailer import ARTICULATION

# Part of the size of a mechanism, and rad, that rounding of steps adds up to; ten times as much would hide the motion
# of what hardly moves.
ROUNDING = 1e-9

# times the least peak of a quantity, below which a plan asks for no percentages (solver.quantities): that of a maneuver
ORDINARY = 10.0
BESIDE = (
    ('roll', 'pitch'),
    ('lateral_acceleration', 'longitudinal_acceleration'),
)  # components of one thing: a small one is held to the other


class Curve(NamedTuple):
    """A quantity that two runs are compared by, at one place or several.

    places: wheels or bodies that it is of, m of them; one without a name where it is of the vehicle. apart: numbers of
    both runs (n, numbers) -> (n, m) distances [unit]. peaks: numbers of the run -> (m,) what shares refer to [unit].
    """

    name: str
    unit: str
    places: tuple[str, ...]
    apart: Callable[[np.ndarray, np.ndarray], np.ndarray]
    peaks: Callable[[np.ndarray], np.ndarray]


def curves_of(simulation: Simulation) -> list[Curve]:
    """The curves of a simulation."""
    channels = simulation.channels
    groups: dict[str, dict[str, Quantity]] = {}
    for name in names(channels):
        where = next((wheel for wheel in channels.wheels if wheel in name.split('.')), '')
        shown = '.'.join(part for part in name.split('.') if part != where)
        groups.setdefault(shown, {})[where] = quantity(name, channels, size_of(simulation.scene.model))
    found = _together([_of_vehicle(name, of) for name, of in groups.items()])
    if found and ARTICULATION in channels.joints:
        angle = quantity(f'joint_states/{ARTICULATION}/position', channels)
        found.append(_of_vehicle(ARTICULATION, {'': angle._replace(least=ORDINARY * NAMED['heading'].least)}))
    found = found or _of_mechanism(simulation)
    return [*found, *_of_reactions(simulation)] if simulation.scene.record.reactions else found


def _together(curves: list[Curve]) -> list[Curve]:
    """Curves of which those that BESIDE names have the largest peak of any of them."""
    by_name = {curve.name: curve for curve in curves}

    def shared(names: tuple[str, ...]) -> Callable[[np.ndarray], np.ndarray]:
        return lambda rows: np.max([by_name[name].peaks(rows) for name in names], axis=0)

    return [next((c._replace(peaks=shared(group)) for group in BESIDE if c.name in group), c) for c in curves]


def _of_vehicle(name: str, of: Mapping[str, Quantity]) -> Curve:
    """A named quantity of a vehicle, of all wheels that have it."""
    ordinary = ORDINARY if name in NAMED else 1.0
    found = [q._replace(least=ordinary * q.least) for q in of.values()]

    def apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.column_stack([lengths(q.of(a[:, q.places]) - q.of(b[:, q.places])) for q in found])

    def peaks(rows: np.ndarray) -> np.ndarray:
        return np.array([q.peak(q.of(rows[:, q.places])) for q in found])

    return Curve(name, found[0].unit, tuple(of), apart, peaks)


class _Bodies:
    """Motions of bodies, read from the numbers of snapshots (n, m)."""

    def __init__(self, simulation: Simulation) -> None:
        layout, self._n = simulation.snapshot().layout, len(simulation.channels.bodies)
        self._pose, self._twist = layout['pose'][0], layout['twist'][0]
        self._h = simulation.h
        self._com = np.array([body.com for body in simulation.model.spec.bodies])

    def turns(self, rows: np.ndarray) -> np.ndarray:
        """(n, nb, 4) quaternions."""
        return rows[:, self._pose].reshape(len(rows), self._n, 7)[:, :, 3:]

    def places(self, rows: np.ndarray) -> np.ndarray:
        """(n, nb, 3) centres of mass in the world [m]."""
        q = self.turns(rows)
        across = 2.0 * np.cross(q[:, :, :3], self._com)
        arm = self._com + q[:, :, 3:] * across + np.cross(q[:, :, :3], across)
        return rows[:, self._pose].reshape(len(rows), self._n, 7)[:, :, :3] + arm

    def velocities(self, rows: np.ndarray) -> np.ndarray:
        """(n, nb, 3) of the centres of mass, in the bodies [m/s]."""
        twist = rows[:, self._twist].reshape(len(rows), self._n, 6)
        return twist[:, :, :3] + np.cross(twist[:, :, 3:], self._com)

    def rates(self, rows: np.ndarray) -> np.ndarray:
        """(n, nb, 3) angular velocities, in the bodies [rad/s]."""
        return rows[:, self._twist].reshape(len(rows), self._n, 6)[:, :, 3:]

    def way(self, rows: np.ndarray) -> float:
        """The largest distance of a centre of mass from where it starts [m]."""
        places = self.places(rows)
        return max(float(_length(places - places[0]).max()), ROUNDING * self._size(rows))

    def turn(self, rows: np.ndarray) -> float:
        """The largest angle by which a body is turned from its start [rad]."""
        turns = self.turns(rows)
        return max(float(_angle(turns, turns[0]).max()), ROUNDING)

    def speed(self, rows: np.ndarray) -> float:
        """The largest velocity of a centre of mass [m/s]."""
        return max(float(_length(self.velocities(rows)).max()), ROUNDING * self._size(rows) / self._h)

    def rate(self, rows: np.ndarray) -> float:
        """The largest angular velocity [rad/s]."""
        return max(float(_length(self.rates(rows)).max()), ROUNDING / self._h)

    def _size(self, rows: np.ndarray) -> float:
        """The largest coordinate of a centre of mass [m]."""
        return max(float(np.abs(self.places(rows)).max()), np.finfo(float).tiny)


def _length(vectors: np.ndarray) -> np.ndarray:
    """(...) lengths of (..., 3)."""
    return np.sqrt((vectors * vectors).sum(-1))


def _angle(q: np.ndarray, r: np.ndarray) -> np.ndarray:
    """(...) angle of the turn between quaternions (..., 4) [rad], exact for small ones too."""
    apart = np.minimum(((q - r) ** 2).sum(-1), ((q + r) ** 2).sum(-1))
    return 4.0 * np.arcsin(np.minimum(0.5 * np.sqrt(apart), 1.0))


def _of_reactions(simulation: Simulation) -> list[Curve]:
    """Reactions that the constraints determine, as forces, beside the largest of them. Instants at which one of both
    runs does not determine a reaction (solver.output.undetermined) count as none."""
    if not (simulation.of_bodies and simulation.model.n_rows):
        return []
    shared = {*simulation.describe()['reactions_not_unique']}
    used = [k for k, row in enumerate(simulation.model.row_names) if row not in shared]
    if not used:
        return []
    at = np.arange(*simulation.snapshot().layout['reactions'][0].indices(len(simulation.snapshot().numbers)))[used]
    lengths_ = simulation.bodies.work.row_length[used]

    def forces(rows: np.ndarray) -> np.ndarray:
        return rows[:, at] / lengths_

    def apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.nan_to_num(np.abs(forces(a) - forces(b)))

    def peaks(rows: np.ndarray) -> np.ndarray:
        largest = float(np.nan_to_num(np.abs(forces(rows))).max())
        return np.full(len(used), max(largest, np.finfo(float).tiny))

    return [Curve('reactions', 'N', tuple(simulation.model.row_names[k] for k in used), apart, peaks)]


def _of_mechanism(simulation: Simulation) -> list[Curve]:
    """Position, orientation and velocities of all bodies."""
    s, bodies = _Bodies(simulation), simulation.channels.bodies

    def apart(of: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
        return lambda a, b: _length(of(a) - of(b))

    def same(of: Callable[[np.ndarray], float]) -> Callable[[np.ndarray], np.ndarray]:
        return lambda rows: np.full(len(bodies), of(rows))

    return [
        Curve('position', 'm', bodies, apart(s.places), same(s.way)),
        Curve('orientation', 'rad', bodies, lambda a, b: _angle(s.turns(a), s.turns(b)), same(s.turn)),
        Curve('velocity', 'm/s', bodies, apart(s.velocities), same(s.speed)),
        Curve('angular_velocity', 'rad/s', bodies, apart(s.rates), same(s.rate)),
    ]
