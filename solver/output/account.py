"""The running account of a run as named views over one buffer: saved, restored and taken back as one, read and written
by name.

The order of the fields is the order in the buffer, and so that of saved states. solver.output.energy keeps the account.
"""

from __future__ import annotations

from math import prod
from typing import NamedTuple

import numpy as np

from solver.compiled.memory import zeros


class Account(NamedTuple):
    """Energies, and what was largest so far. A number is a view of length one; `noted` is a row of (value, time [s],
    index)."""

    numbers: np.ndarray  # (n,) the buffer, which all that follow are views of
    reference: np.ndarray  # (1,) energy at the start [J]
    power: np.ndarray  # (1,) dissipated less supplied now [W]
    work: np.ndarray  # (1,) its integral [J]
    worst: np.ndarray  # (1,) largest error of the balance [J]
    energy: np.ndarray  # (1,) kinetic and potential now [J]
    worst_at: np.ndarray  # (1,) when the error was largest [s]
    time: np.ndarray  # (1,) since the account began [s]
    gross: np.ndarray  # (1,) integral of all magnitudes of power [J]
    gross_power: np.ndarray  # (1,) their sum now [W]
    kinetic: np.ndarray  # (2,) smallest, largest kinetic energy [J]
    potential: np.ndarray  # (2,) the same of potential energy [J]
    turning: np.ndarray  # (1,) largest sum over bodies of kinetic energy * (turn in a step)^2 [J]
    speed: np.ndarray  # (1,) largest |component| of a twist [m/s or rad/s]
    residual: np.ndarray  # noted: last increment of an iteration, relative to the velocity; a body
    position: np.ndarray  # noted: |phi| [m or rad]; a row of constraints
    velocity: np.ndarray  # noted: |A v + phi_t| [m/s or rad/s]; a row of constraints
    turn: np.ndarray  # noted: turn in a step [rad]; a body
    steps: np.ndarray  # (1,) steps noted
    unsettled: np.ndarray  # (1,) those of them with a residual above SETTLED_INCREMENT
    swing: np.ndarray  # (2,) half the widest range of a component: of a velocity of a centre of mass [m/s], angular [rad/s]
    kick: np.ndarray  # (2, 3) the same, noted: change of an acceleration in a step, times the step [m/s, rad/s]; a body
    phase: np.ndarray  # (2,) of the same: phase that steps have cost the motion, less what it has forgotten [rad]
    wound: np.ndarray  # noted: turn of an element that acts on a rotation vector [rad]; the place of its outputs
    swayed: np.ndarray  # (1,) kinetic energy of all those ranges, each as the amplitude of a vibration [J]
    contradiction: np.ndarray  # noted: energy of rows that contradict each other [J] (solver.output.contradiction); a row
    twist: np.ndarray  # (bodies, 2, 6) smallest and largest of every component of a twist [m/s, rad/s]
    peak: np.ndarray  # (elements that have one, 2) largest value, its time [s]


NOTED = (3,)
SHAPES: dict[str, tuple[int, ...]] = {  # of what does not depend on the model, where it is not a number
    'kinetic': (2,), 'potential': (2,), 'residual': NOTED, 'position': NOTED, 'velocity': NOTED, 'turn': NOTED,
    'swing': (2,), 'kick': (2, 3), 'phase': (2,), 'wound': NOTED, 'contradiction': NOTED,
}  # fmt: skip


def new_account(bodies: int, peaks: int) -> Account:
    """The account of a model with so many bodies, and elements that have a peak; nothing is in it yet."""
    shapes = {**SHAPES, 'twist': (bodies, 2, 6), 'peak': (peaks, 2)}
    fields = {name: shapes.get(name, (1,)) for name in Account._fields[1:]}
    ends = np.cumsum([prod(shape) for shape in fields.values()])
    numbers = zeros(int(ends[-1]))
    views = np.split(numbers, ends[:-1])
    return Account(numbers, *(view.reshape(shape) for view, shape in zip(views, fields.values(), strict=True)))


def noted(row: np.ndarray) -> tuple[float, float, int]:
    """(value, time [s], index) of what was noted."""
    value, time, index = row.tolist()
    return value, time, int(index)
