"""Snapshots: plain arrays that a simulation hands out after a step, and the names that belong to them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.elements.tire_pacejka import TIRE_COLUMNS


class Counters(NamedTuple):
    """Work and residuals of a step, or sums and maxima over several: the same from the step to the bag."""

    iterations: int
    factorizations: int
    evaluations: int  # of all forces
    stagnated: int  # steps accepted although their iteration stopped gaining before the tolerance
    # largest last increment of an iteration, or violation of a position over h, relative to the largest velocity [-]
    residual: float
    position_drift: float  # largest |phi| after a step [m or rad]
    velocity_drift: float  # largest |A v + phi_t| in the output [m/s or rad/s]

    @classmethod
    def of(cls, numbers: np.ndarray) -> Counters:
        """Inverse of np.array()."""
        i, f, e, s, *largest = numbers.tolist()
        return cls(int(i), int(f), int(e), int(s), *largest)

    def followed_by(self, later: Counters) -> Counters:
        """Sums and maxima over these steps and later ones."""
        i, f, e, s, r, p, v = self
        i1, f1, e1, s1, r1, p1, v1 = later
        # Every call of Simulation.advance() adds: written with max() and by keywords it takes 0.3 us more.
        return Counters._make(
            (i + i1, f + f1, e + e1, s + s1, r1 if r1 > r else r, p1 if p1 > p else p, v1 if v1 > v else v)
        )

    def report(self) -> dict[str, float]:
        """By the names of reports and recordings."""
        return {name if k < 4 else f'{name}_max': value for k, (name, value) in enumerate(self._asdict().items())}


NO_STEPS = Counters(0, 0, 0, 0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class Channels:
    """Names of everything in a Snapshot, in order: a field here names the entries of the array beside it."""

    joints: tuple[str, ...]  # joint coordinates
    joint_kinds: tuple[str, ...]  # 'rotation' | 'translation'
    bodies: tuple[str, ...]
    wheels: tuple[str, ...]  # tires
    inputs: tuple[str, ...]  # as applied
    elements: tuple[str, ...]  # '<element>/<column>' of every force element
    reactions: tuple[str, ...]  # '<joint>/<row>' of every constraint row
    chassis: int | None  # index into bodies of the body that odom and imu describe
    moving: tuple[str, ...] = ()  # bodies whose accelerations are shown: all or none
    energies: tuple[str, ...] = ()  # ENERGIES, or none


# Energies of a run [J] since its account began: of motion, in gravity and elements, lost in elements, the work from
# outside (ForceKind.feeds and imposed motions), and the error of their balance.
ENERGIES = ('kinetic', 'potential', 'dissipated', 'exchanged', 'error')


class OutputArrays(NamedTuple):
    """The numbers of a Snapshot. Units in docs/conventions.md."""

    joint_position: np.ndarray  # (nx,) [rad or m], unwrapped
    joint_velocity: np.ndarray  # (nx,)
    # (nx,) generalized force of elements, of a coordinate with a prescribed motion that of its driver [N m or N]
    joint_effort: np.ndarray
    pose: np.ndarray  # (nb, 7) reference frame of every body in the world: p [m], quaternion xyzw
    # (nb, 6) velocity of that frame's origin and angular velocity, both expressed in the body [m/s, rad/s]
    twist: np.ndarray
    imu: np.ndarray  # (6,) chassis centre of mass: specific force in B [m/s^2], angular velocity in B [rad/s]
    tire: np.ndarray  # (nt, len(TIRE_COLUMNS))
    inputs: np.ndarray  # (nu,) as applied in the step
    elements: np.ndarray  # (ne,)
    reactions: np.ndarray  # (nc,)
    # (nb or 0, 6) of that frame's origin, and angular, both expressed in the body [m/s^2, rad/s^2]
    acceleration: np.ndarray
    energies: np.ndarray  # (5 or 0,) ENERGIES [J]


# fields that may be NaN, where the motion does not determine them (solver.output.undetermined)
UNDETERMINED = ('joint_effort', 'reactions')
Layout = dict[str, tuple[slice, tuple[int, ...]]]  # of every field of OutputArrays: where in the numbers, and its shape


def layout_of(channels: Channels) -> Layout:
    """Order of the numbers of a Snapshot."""
    nx, nb = (len(channels.joints),), len(channels.bodies)
    rest = ((len(names),) for names in (channels.inputs, channels.elements, channels.reactions))
    shapes: list[tuple[int, ...]] = [
        nx,
        nx,
        nx,
        (nb, 7),
        (nb, 6),
        (6,),
        (len(channels.wheels), len(TIRE_COLUMNS)),
        *rest,
    ]
    shapes += [(len(channels.moving), 6), (len(channels.energies),)]
    ends = np.cumsum([math.prod(shape) for shape in shapes]).tolist()
    return {
        name: (slice(end - math.prod(shape), end), shape)
        for name, shape, end in zip(OutputArrays._fields, shapes, ends, strict=True)
    }


def new_numbers(layout: Layout) -> np.ndarray:
    """Room for the numbers of a Snapshot."""
    return np.zeros(max(place.stop for place, _ in layout.values()))


def output_arrays(numbers: np.ndarray, layout: Layout) -> OutputArrays:
    """The fields of OutputArrays as views."""
    return OutputArrays(**{name: numbers[place].reshape(shape) for name, (place, shape) in layout.items()})


class Snapshot(NamedTuple):
    """The output of step k at time t_ns [ns], a copy that the caller may keep.

    numbers: (n,) all arrays one behind the other, which compare as one; every array is a property. counters: work and
    residuals of the last call of advance().
    """

    k: int
    t_ns: int
    numbers: np.ndarray  # (n,) all of them: copied as one, and cut into fields only where one is asked for
    layout: Layout
    counters: Counters

    def is_finite(self) -> bool:
        """True where every number is finite, but for reactions and efforts that the motion does not determine (NaN)."""
        if np.isfinite(self.numbers).all():
            return True
        open_ = np.zeros(self.numbers.size, bool)
        for name in UNDETERMINED:
            open_[self.layout[name][0]] = True
        return bool(np.isfinite(self.numbers[~(open_ & np.isnan(self.numbers))]).all())

    def _field(self, name: str) -> np.ndarray:
        place, shape = self.layout[name]
        return self.numbers[place].reshape(shape)

    @property
    def joint_position(self) -> np.ndarray:
        """(nx,) joint coordinates, in the order of Channels.joints [rad or m]; angles are unwrapped."""
        return self._field('joint_position')

    @property
    def joint_velocity(self) -> np.ndarray:
        """(nx,) their rates [rad/s or m/s]."""
        return self._field('joint_velocity')

    @property
    def joint_effort(self) -> np.ndarray:
        """(nx,) generalized forces of elements on them [N m or N]; of a prescribed motion that of its driver alone."""
        return self._field('joint_effort')

    @property
    def pose(self) -> np.ndarray:
        """(nb, 7) reference frame of every body in the world: position [m], orientation as quaternion x y z w."""
        return self._field('pose')

    @property
    def twist(self) -> np.ndarray:
        """(nb, 6) velocity of that frame's origin [m/s] and angular velocity [rad/s], both expressed in the body."""
        return self._field('twist')

    @property
    def imu(self) -> np.ndarray:
        """(6,) specific force [m/s^2] at the centre of mass of the chassis and its angular velocity [rad/s], both in
        the chassis."""
        return self._field('imu')

    @property
    def tire(self) -> np.ndarray:
        """(nt, len(TIRE_COLUMNS)) contact of every tire: forces [N], moments [N m], slips [-]; docs/conventions.md."""
        return self._field('tire')

    @property
    def inputs(self) -> np.ndarray:
        """(nu,) inputs as they were applied in the step, in the order of Channels.inputs."""
        return self._field('inputs')

    @property
    def elements(self) -> np.ndarray:
        """(ne,) outputs of force elements, in the order of Channels.elements, each in the unit of its column."""
        return self._field('elements')

    @property
    def reactions(self) -> np.ndarray:
        """(nc,) forces of constraint rows, in the order of Channels.reactions [N or N m]; NaN where the motion does not
        determine them (solver.output.undetermined)."""
        return self._field('reactions')

    @property
    def acceleration(self) -> np.ndarray:
        """(nb or 0, 6) acceleration of every body's origin [m/s^2] and angular acceleration [rad/s^2], in the body;
        where asked for."""
        return self._field('acceleration')

    @property
    def energies(self) -> np.ndarray:
        """(5 or 0,) kinetic, potential, dissipated and exchanged energy, and the error of their balance [J], in the
        order of Channels.energies; where asked for."""
        return self._field('energies')
