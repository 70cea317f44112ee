"""Quantities of interest: named signals with units, computed from the snapshots of any run, by which runs are compared.

The axes of a vehicle are the intermediate axes of [ISO8855]: X and Y are horizontal, X along the vehicle. Velocities
and positions are those of base_link, accelerations those of the centre of mass of the chassis. Besides the named
quantities every recorded number is one, under the name of its column in a recording (bags/README.md). A quantity that a
level of detail does not publish is absent there, and nothing takes its place.

A percentage of a quantity refers to the peak of the reference, its largest absolute value in the time that is compared,
but at least to the `least` of the quantity: an error of a car that drives straight ahead is not compared with nothing.
The `least` is that of passenger cars, and grows with the vehicle (solver.vehicle.size).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from solver.elements.registry import FORCES
from solver.elements.tire_pacejka import TIRE_COLUMNS, TIRE_UNITS
from solver.errors import SpecError, suggestion
from solver.model.compile import joint_coordinates
from solver.model.spec import ModelSpec
from solver.output.snapshot import NO_STEPS, Channels, Snapshot, layout_of, new_numbers
from solver.vehicle.named_quantities import BY_WHEEL, NAMED
from solver.vehicle.size import Size

POSE, TWIST, FORCE = ('x', 'y', 'z', 'qx', 'qy', 'qz', 'qw'), ('vx', 'vy', 'vz', 'wx', 'wy', 'wz'), TIRE_COLUMNS[:6]
TIRE_STATES = ('fz', *TIRE_COLUMNS[6 : TIRE_COLUMNS.index('px')])
LEAST = 1e-9  # `least` of a recorded number without a name here, in its unit

Numbers = Callable[[np.ndarray], np.ndarray]


class Quantity(NamedTuple):
    """A signal with one or several components; the error of several is the length of their difference."""

    name: str
    unit: str  # SI unit, '1' for a number without a unit
    least: float  # smallest peak to which percentages refer
    places: np.ndarray  # (m,) indices of the numbers of a snapshot from which it is computed
    of: Numbers  # function: (n, m) rows of these numbers, in the order of time -> (n, components)
    from_start: bool  # whether the peak is the largest distance from the first value

    def peak(self, values: np.ndarray) -> float:
        """Largest absolute value of the signal (n, components), but at least `least`."""
        return max(self.least, float(lengths(values - values[0] if self.from_start else values).max()))


def lengths(values: np.ndarray) -> np.ndarray:
    """(n,) absolute values, or lengths, of a signal (n, components)."""
    return np.abs(values[:, 0]) if values.shape[1] == 1 else np.sqrt((values * values).sum(axis=1))


ORDINARY = Size()
GROWS: dict[str, Callable[[Size], float]] = {  # unit -> factor by which `least` grows with the vehicle
    'm': lambda size: size.length,
    'm/s': lambda size: size.speed,
    'rad/s': lambda size: 1.0 / size.time,
    'N': lambda size: size.mass,
    'N m': lambda size: size.torque,
}
OF_TIRE = {
    'wheel_load': 'fz',
    'slip_angle': 'alpha',
    'slip': 'kappa',
    'tire_force.x': 'fx',
    'tire_force.y': 'fy',
    'tire_force.z': 'fz',
}
OF_STEERING = ('steering_wheel_angle', 'steering_torque')
JOINT_UNITS = {'rotation': ('rad', 'rad/s', 'N m'), 'translation': ('m', 'm/s', 'N')}
UNITS_OF = {**dict.fromkeys('xyz', 'm'), **dict.fromkeys(TWIST[:3], 'm/s'), **dict.fromkeys(TWIST[3:], 'rad/s')}
RATES = ('position', 'velocity', 'effort')


def _same_for_all(size: Size) -> float:
    return 1.0


def published(model: ModelSpec) -> Channels:
    """Names of the channels of a model, without compiling it; reactions are left out."""
    coordinates = [c for joint in model.joints for c in joint_coordinates(joint)] + [*model.coordinates]
    wheels = [kind for kind in FORCES if kind.wheels]
    others = [kind for kind in FORCES if not kind.wheels]
    bodies = tuple(body.name for body in model.bodies)
    return Channels(
        joints=tuple(c.name for c in coordinates),
        joint_kinds=tuple(c.kind for c in coordinates),
        bodies=bodies,
        wheels=tuple(e.name for kind in wheels for e in getattr(model, kind.name)),
        inputs=model.inputs,
        elements=tuple(
            f'{e.name}/{column}' for kind in others for e in getattr(model, kind.name) for column in kind.outputs
        ),
        reactions=(),
        chassis=bodies.index(model.chassis) if model.chassis else 0,
    )


def names(channels: Channels) -> list[str]:
    """Names of the quantities of a vehicle with these channels, even if its level has no tires; [] for a mechanism."""
    if not channels.wheels and 'steering_wheel' not in channels.joints:
        return []
    wheels = [f'{name}.{wheel}' for name in ('wheel_load', 'slip_angle', 'slip') for wheel in channels.wheels]
    wheels += [f'tire_force.{wheel}.{axis}' for wheel in channels.wheels for axis in 'xyz']
    wheels += [f'suspension_travel.{wheel}' for wheel in channels.wheels if f'travel_{wheel}' in channels.joints]
    body = [name for name in NAMED if name not in OF_STEERING or 'steering_wheel' in channels.joints]
    return body + wheels


def quantity(name: str, channels: Channels, size: Size = ORDINARY) -> Quantity:
    """The quantity `name` in snapshots with these channels, for a vehicle of that size. Raises SpecError if they do not
    have it."""
    found = _quantity(name, channels)
    return found if size.ordinary else found._replace(least=found.least * GROWS.get(found.unit, _same_for_all)(size))


def _quantity(name: str, channels: Channels) -> Quantity:
    layout = layout_of(channels)
    # each number is its own place
    s = Snapshot(0, 0, np.arange(new_numbers(layout).size, dtype=float), layout, NO_STEPS)
    if name in names(channels):
        return _named(name, channels, s)
    for column, unit, place in _columns(channels, s):
        if column == name:
            return Quantity(name, unit, LEAST, np.array([place], int), _same, False)
    known = [*names(channels), *(column for column, *_ in _columns(channels, s))]
    raise SpecError(f'{name}: no such quantity{suggestion(name, known)}')


def _named(name: str, channels: Channels, s: Snapshot) -> Quantity:
    head, _, rest = name.partition('.')
    places: np.ndarray
    if head in NAMED:
        meaning = NAMED[head]
        # a hand torque that is an input is taken from there: the effort of the wheel contains the steering damper too
        if head in channels.inputs:
            return Quantity(
                name, meaning.unit, meaning.least, s.inputs[[channels.inputs.index(head)]].astype(int), _same, False
            )
        if head in OF_STEERING:
            places = (s.joint_position, s.joint_effort)[OF_STEERING.index(head)][
                [channels.joints.index('steering_wheel')]
            ]
            return Quantity(name, meaning.unit, meaning.least, places.astype(int), _same, False)
        chassis = channels.chassis or 0
        places = np.concatenate([s.pose[chassis], s.twist[chassis], s.imu[:3]])
        return Quantity(
            name, meaning.unit, meaning.least, places.astype(int), OF_BODY[head], head in ('position', 'heading')
        )
    meaning = BY_WHEEL[head]
    wheel, _, axis = rest.partition('.')
    if head == 'suspension_travel':
        places = s.joint_position[[channels.joints.index(f'travel_{wheel}')]]
    else:
        column = TIRE_COLUMNS.index(OF_TIRE[f'{head}.{axis}' if axis else head])
        places = s.tire[channels.wheels.index(wheel), [column]]
    return Quantity(name, meaning.unit, meaning.least, places.astype(int), _same, False)


def _same(rows: np.ndarray) -> np.ndarray:
    return rows


def _rotation(rows: np.ndarray) -> np.ndarray:
    """(n, 3, 3) R_WB of the quaternions xyzw in columns 3 to 6."""
    x, y, z, w = rows[:, 3:7].T
    R = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.array(R).transpose(2, 0, 1)


def _column(values: np.ndarray) -> np.ndarray:
    return values[:, None]


def _position(rows: np.ndarray) -> np.ndarray:
    return rows[:, :2]


def _heading(rows: np.ndarray) -> np.ndarray:
    R = _rotation(rows)
    return _column(np.unwrap(np.arctan2(R[:, 1, 0], R[:, 0, 0])))


def _yaw_rate(rows: np.ndarray) -> np.ndarray:
    """d/dt atan2(R_10, R_00), with dR/dt = R [w]."""
    R, w = _rotation(rows), rows[:, 10:13]
    a, b = R[:, 0, 0], R[:, 1, 0]
    a_dot = R[:, 0, 1] * w[:, 2] - R[:, 0, 2] * w[:, 1]
    b_dot = R[:, 1, 1] * w[:, 2] - R[:, 1, 2] * w[:, 1]
    return _column((a * b_dot - b * a_dot) / (a * a + b * b))


def _roll(rows: np.ndarray) -> np.ndarray:
    R = _rotation(rows)
    return _column(np.arctan2(R[:, 2, 1], R[:, 2, 2]))


def _pitch(rows: np.ndarray) -> np.ndarray:
    return _column(-np.arcsin(np.clip(_rotation(rows)[:, 2, 0], -1.0, 1.0)))


def _horizontal(rows: np.ndarray, first: int, axis: int) -> np.ndarray:
    """(n,) component along X (axis 0) or Y (1) of the vector in the body whose components begin in column `first`."""
    R = _rotation(rows)
    vector = np.einsum('nij,nj->ni', R, rows[:, first : first + 3])
    along = R[:, :2, 0] / np.sqrt(R[:, 0, 0] ** 2 + R[:, 1, 0] ** 2)[:, None]
    if axis == 0:
        return along[:, 0] * vector[:, 0] + along[:, 1] * vector[:, 1]
    return along[:, 0] * vector[:, 1] - along[:, 1] * vector[:, 0]


def _sideslip(rows: np.ndarray) -> np.ndarray:
    return _column(np.arctan2(_horizontal(rows, 7, 1), _horizontal(rows, 7, 0)))


OF_BODY: dict[str, Numbers] = {
    'position': _position,
    'heading': _heading,
    'yaw_rate': _yaw_rate,
    'longitudinal_velocity': lambda rows: _column(_horizontal(rows, 7, 0)),
    'sideslip_velocity': lambda rows: _column(_horizontal(rows, 7, 1)),
    'sideslip_angle': _sideslip,
    # the specific force is acceleration less gravity, which is vertical
    'longitudinal_acceleration': lambda rows: _column(_horizontal(rows, 13, 0)),
    'lateral_acceleration': lambda rows: _column(_horizontal(rows, 13, 1)),
    'roll': _roll,
    'pitch': _pitch,
}


def columns(channels: Channels) -> list[tuple[str, str, int]]:
    """(column name in recordings, unit, index in the numbers of a snapshot) of every recorded number, inputs left
    out."""
    layout = layout_of(channels)
    places = Snapshot(0, 0, np.arange(new_numbers(layout).size, dtype=float), layout, NO_STEPS)
    return [(name, unit, int(place)) for name, unit, place in _columns(channels, places)]


def _columns(channels: Channels, s: Snapshot) -> Iterator[tuple[str, str, float]]:
    """(column name in recordings, unit, index in a snapshot) of every recorded number."""
    for k, (joint, kind) in enumerate(zip(channels.joints, channels.joint_kinds, strict=True)):
        for rate, unit, values in zip(
            RATES, JOINT_UNITS[kind], (s.joint_position, s.joint_velocity, s.joint_effort), strict=True
        ):
            yield f'joint_states/{joint}/{rate}', unit, values[k]
    if channels.chassis is not None:
        for name, value in zip(POSE, s.pose[channels.chassis], strict=True):
            yield f'odom/pose/{name}', UNITS_OF.get(name, '1'), value
        for name, value in zip(TWIST, s.twist[channels.chassis], strict=True):
            yield f'odom/twist/{name}', UNITS_OF[name], value
        for name, value in zip(('ax', 'ay', 'az', *TWIST[3:]), s.imu, strict=True):
            yield f'imu/{name}', UNITS_OF.get(name, 'm/s^2'), value
    for k, wheel in enumerate(channels.wheels):
        for name in FORCE:
            yield f'tire/{wheel}/force/{name}', TIRE_UNITS[name], s.tire[k, TIRE_COLUMNS.index(name)]
        for name in TIRE_STATES:
            yield f'tire_states/{wheel}/{name}', TIRE_UNITS[name] or '1', s.tire[k, TIRE_COLUMNS.index(name)]
    outputs: dict[str, list[str]] = {}
    for name in channels.elements:
        element, _, output = name.rpartition('/')
        outputs.setdefault(element, []).append(output)
    for name, value in zip(channels.elements, s.elements, strict=True):
        element, _, output = name.rpartition('/')
        yield f'element_states/{name}', _unit_of_output(tuple(outputs[element]), output), value
    for name, value in zip(channels.energies, s.energies, strict=True):
        yield f'energies/{name}', 'J', value
    for name, value in zip(channels.reactions, s.reactions, strict=True):
        yield f'reactions/{name}', '1', value


@functools.cache
def _unit_of_output(outputs: tuple[str, ...], output: str) -> str:
    """Unit of an output of an element with these outputs, if all kinds with these outputs agree in it; else '1'."""
    units = {kind.outputs[output] or '1' for kind in FORCES if tuple(kind.outputs) == outputs}
    unit = units.pop() if len(units) == 1 else '1'
    return '1' if ' or ' in unit else unit
