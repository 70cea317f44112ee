"""The running account of a run: energies, and the largest value so far of every quantity that the checks judge.

An Account is a set of named views over one buffer. The buffer is saved, restored and copied as a whole; the numbers are
read and written by name. The order of the fields is that of the buffer, and so that of saved states.
solver.output.energy updates the account after every step.
"""

from __future__ import annotations

from math import prod
from typing import NamedTuple

import numpy as np

from solver.compiled.memory import zeros
from solver.errors import SpecError
from solver.model.state import fitting


class Account(NamedTuple):
    """Energies and largest values of a run so far. "Noted" is a row (3,) of the largest value, its time [s] and an
    index.

    Where two rows or numbers are given, the first is of translation, the second of rotation.
    """

    numbers: np.ndarray  # (n,) the buffer; all other fields are views of it
    reference: np.ndarray  # (1,) energy at the start [J]
    power: np.ndarray  # (1,) power dissipated minus power supplied, now [W]
    work: np.ndarray  # (1,) integral of `power` [J]
    worst: np.ndarray  # (1,) largest error of the energy balance [J]
    energy: np.ndarray  # (1,) kinetic and potential energy now [J]
    worst_at: np.ndarray  # (1,) time of the largest error [s]
    time: np.ndarray  # (1,) since the account began [s]
    gross: np.ndarray  # (1,) integral of `gross_power` [J]
    gross_power: np.ndarray  # (1,) sum of the magnitudes of all powers, now [W]
    kinetic: np.ndarray  # (2,) smallest and largest kinetic energy [J]
    potential: np.ndarray  # (2,) smallest and largest potential energy [J]
    turning: np.ndarray  # (1,) largest sum over bodies of kinetic energy * (turn in a step)^2 [J]
    speed: np.ndarray  # (2,) largest |component| of a velocity [m/s], of an angular velocity [rad/s]
    residual: np.ndarray  # noted: last increment of an iteration, relative to the velocity; index of the body
    position: np.ndarray  # noted: |phi| [m or rad]; index of the row of constraints
    velocity: np.ndarray  # noted: |A v + phi_t| [m/s or rad/s]; index of the row of constraints
    # noted: turn in a step [rad] of the body whose axis a step turned wrong by most; index of the body
    turn: np.ndarray
    steps: np.ndarray  # (1,) number of steps
    unsettled: np.ndarray  # (1,) number of steps with a residual above SETTLED_INCREMENT
    swing: np.ndarray  # (2,) half the widest range of a component of a velocity [m/s], of an angular velocity [rad/s]
    # (2, 3) noted: change of an acceleration in a step, times the step [m/s, rad/s]; index of the body
    kick: np.ndarray
    phase: np.ndarray  # (2,) phase error of vibrations so far, less the part that has died out with its energy [rad]
    wound: np.ndarray  # noted: rotation angle in an element that acts on a rotation vector [rad]; index of its outputs
    # (2, 2) recent squares of second differences of an acceleration, and of first differences
    bend: np.ndarray
    # (2,) error of the directions of spin axes so far, less the part that has died out; largest of a body in a step
    # [rad]
    astray: np.ndarray
    shake: np.ndarray  # noted: chatter of a tire's force, over its load (solver.output.shake); index of the tire
    swayed: np.ndarray  # (1,) kinetic energy of vibrations whose amplitudes are the ranges in `swing` [J]
    # noted: energy of rows that contradict each other [J] (solver.output.contradiction); a row
    contradiction: np.ndarray
    # (4,) memory of solver.output.undetermined: largest smooth reaction [N], share of it in forces that do something,
    # state of a series of rough steps, 1 while multipliers are looked at
    doubt: np.ndarray
    # (4,) time of steps whose reactions the motion does not determine [s], time of the first [s], row with most of it
    # there, most rows of a step
    undetermined: np.ndarray
    twist: np.ndarray  # (bodies, 2, 6) smallest and largest value of every component of a twist [m/s, rad/s]
    # (bodies, 6) violation of the constraints by the velocities of the scheme, one step before [m/s, rad/s]
    offset: np.ndarray
    # (bodies, 4) axis of a body's spin in the world where it began, largest distance of the axis from it since [rad]
    axis: np.ndarray
    peak: np.ndarray  # (elements with a peak, 2) largest value of that output, its time [s]
    trace: np.ndarray  # (tires, TRACE) memory of solver.output.shake [N]
    # (0 or 3,) where energies are shown: power from outside now [W], its integral [J], kinetic energy now [J]
    flow: np.ndarray


NOTED = (3,)
FLOW = (3,)
TRACE = 12  # numbers that solver.output.shake keeps of a tire
SHAPES: dict[str, tuple[int, ...]] = {  # field -> shape, where that is neither (1,) nor depends on the model
    'kinetic': (2,), 'potential': (2,), 'residual': NOTED, 'position': NOTED, 'velocity': NOTED, 'turn': NOTED,
    'speed': (2,), 'swing': (2,), 'kick': (2, 3), 'phase': (2,), 'wound': NOTED, 'contradiction': NOTED,
    'bend': (2, 2), 'astray': (2,), 'shake': NOTED, 'doubt': (4,), 'undetermined': (4,),
}  # fmt: skip


def new_account(bodies: int, peaks: int, tires: int = 0, *, flow: bool = False) -> Account:
    """An empty account of so many bodies, elements with a peak output (ForceKind.peak) and tires. flow: with the
    numbers that energies are shown from."""
    shapes = {
        **SHAPES,
        'twist': (bodies, 2, 6),
        'offset': (bodies, 6),
        'axis': (bodies, 4),
        'peak': (peaks, 2),
        'trace': (tires, TRACE),
        'flow': FLOW if flow else (0,),
    }
    fields = {name: shapes.get(name, (1,)) for name in Account._fields[1:]}
    ends = np.cumsum([prod(shape) for shape in fields.values()])
    numbers = zeros(int(ends[-1]))
    views = np.split(numbers, ends[:-1])
    return Account(numbers, *(view.reshape(shape) for view, shape in zip(views, fields.values(), strict=True)))


def require_account(saved: np.ndarray | None, account: Account) -> np.ndarray:
    """The numbers of a saved account, which must be like this one. Raises SpecError."""
    if saved is not None and abs(saved.size - account.numbers.size) == prod(FLOW):
        had, now = ('without', 'with') if account.flow.size else ('with', 'without')
        raise SpecError(
            f'restore: the state was saved {had} record.energies, and this scene is {now}: the energy exchanged so far '
            'is part of a state; set record.energies as it was'
        )
    return fitting('audit', saved, account.numbers)


def noted(row: np.ndarray) -> tuple[float, float, int]:
    """A noted row as (value, time [s], index)."""
    value, time, index = row.tolist()
    return value, time, int(index)
