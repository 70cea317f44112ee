"""A vehicle like a delivered one, of another size: what a fit begins with where nobody has hardpoints.

Froude similarity, with lengths and masses by factors of their own: gravity stays, so that a time grows with the root of
a length, a force with a mass, a stiffness with mass over length, a moment with both, an inertia with mass and length
squared; coefficients of the Magic Formula are numbers ([Buckingham1914]; solver.vehicle.size).
"""

from __future__ import annotations

import copy
from contextlib import suppress
from typing import Any, NamedTuple

import yaml

from mbd_sim_ros.fitting.file import Like
from solver.errors import SpecError
from solver.files.scene import load_scene_text
from solver.files.yaml_tree import node_of, text_of


class Power(NamedTuple):
    """Powers of length, mass and time by which a quantity grows."""

    length: float = 0.0
    mass: float = 0.0
    time: float = 0.0


LENGTH, MASS = Power(1.0), Power(0.0, 1.0)
INERTIA, FORCE, MOMENT = Power(2.0, 1.0), Power(1.0, 1.0, -2.0), Power(2.0, 1.0, -2.0)
RATE, DAMPING, SPEED = Power(0.0, 1.0, -2.0), Power(0.0, 1.0, -1.0), Power(1.0, 0.0, -1.0)
NUMBER = Power()
# of a light car, by the name of a key or, where that is not enough, with the one around it
KEYS: dict[str, Power | tuple[Power, Power]] = {
    **dict.fromkeys(
        ('com', 'center', 'top_mount', 'strut', 'ball_joint', 'arm_pivots', 'tie_rod_knuckle', 'tie_rod_rack'), LENGTH
    ),
    **dict.fromkeys(
        ('spring.chassis', 'spring.knuckle', 'damper.chassis', 'damper.knuckle', 'pivot_inner', 'pivot_outer'), LENGTH
    ),
    **dict.fromkeys(('rack_per_turn', 'hitch', 'point'), LENGTH),
    **{'mass': MASS, 'inertia': INERTIA, 'spin_inertia': INERTIA, 'products': INERTIA},
    **{'rate': RATE, 'anti_roll_bar': RATE, 'rack_damping': DAMPING, 'top_speed': Power(time=-1.0)},
    'drag_area': Power(0.0, 1.0, 0.0),  # force over the square of a speed, with air as it is
    **{'stiffness': MOMENT, 'damping': Power(2.0, 1.0, -1.0), 'damper.law': (SPEED, FORCE), 'stops': (LENGTH, FORCE)},
    **dict.fromkeys(('toe_deg', 'camber_deg', 'column_axis', 'driven', 'ratio', 'share', 'kind', 'category'), NUMBER),
}
TIRE = {
    **dict.fromkeys(('UNLOADED_RADIUS', 'WIDTH', 'RIM_RADIUS', 'BOTTOM_OFFST'), LENGTH),
    **dict.fromkeys(('FNOMIN', 'FZMIN', 'FZMAX'), FORCE),
    **dict.fromkeys(('VERTICAL_STIFFNESS', 'BOTTOM_STIFF', 'LONGITUDINAL_STIFFNESS', 'LATERAL_STIFFNESS'), RATE),
    **{'VERTICAL_DAMPING': DAMPING, 'LONGVL': SPEED},
    **dict.fromkeys(('INFLPRES', 'NOMPRES'), Power(-1.0, 1.0, -2.0)),
}


def vehicle_like(like: Like) -> dict[str, Any]:
    """The data of a vehicle like a delivered light car, as its file holds them. Raises SpecError."""
    data = data_of(like.vehicle)
    if data.get('kind') != 'light_car':
        raise SpecError(
            f'like.vehicle = {like.vehicle!r}: only a light_car can be scaled; take vehicles/light_car.yaml'
        )
    base = data['front']['wheel']['center'][0] - data['rear']['wheel']['center'][0]
    length, mass = like.wheelbase / base, like.mass / total_mass(like.vehicle)
    made = _scaled(data, length, mass)
    if like.driven:
        made['driveline']['driven'] = like.driven
    if like.front_share is not None or like.height is not None:
        _place(made, like)
    return made


def data_of(vehicle: str) -> dict[str, Any]:
    """The data of a vehicle file with all that it includes. Raises SceneError."""
    return dict(read_back(load_scene_text(f'vehicle: {vehicle}\nduration: 1\n').resolved)['vehicle'])


def read_back(text: str) -> dict[str, Any]:
    """The data in a resolved text. Numbers like 6e-05 have no point, and are text to YAML 1.1."""

    def numbers(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: numbers(one) for key, one in value.items()}
        if isinstance(value, list):
            return [numbers(one) for one in value]
        if isinstance(value, str) and value[:1] in '+-.0123456789':
            with suppress(ValueError):
                return float(value)
        return value

    return dict(numbers(yaml.safe_load(text)))


def yaml_of(data: dict[str, Any]) -> str:
    """Data as YAML in which no text is taken for the name of a file."""
    return str(text_of(node_of(data, None)))


def total_mass(vehicle: str) -> float:
    """Mass of a vehicle file [kg]."""
    return sum(b.mass for b in load_scene_text(f'vehicle: {vehicle}\nduration: 1\n').model.bodies)


def _place(data: dict[str, Any], like: Like) -> None:
    """Move the centre of mass of the chassis so that the whole car has the share in front and the height."""
    scene = load_scene_text(yaml_of({'vehicle': data, 'duration': 1}))
    bodies = scene.model.bodies
    mass = sum(b.mass for b in bodies)
    front, rear = data['front']['wheel']['center'][0], data['rear']['wheel']['center'][0]
    chassis = next(b for b in bodies if b.name == (scene.model.chassis or bodies[0].name))
    places = [(b.mass, [p + c for p, c in zip(b.position, b.com, strict=True)]) for b in bodies]
    x, z = (sum(m * p[k] for m, p in places) / mass for k in (0, 2))
    com = data['chassis']['com']
    if like.front_share is not None:
        com[0] += (rear + like.front_share * (front - rear) - x) * mass / chassis.mass
    if like.height is not None:
        com[2] += (like.height - z) * mass / chassis.mass


def _scaled(data: dict[str, Any], length: float, mass: float, around: str = '') -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in data.items():
        if key == 'tire':
            found[key] = copy.deepcopy(value)
            values = {'LONGVL': 16.7, **value['values']}
            found[key]['values'] = {n: _times(v, TIRE.get(n, NUMBER), length, mass) for n, v in values.items()}
        elif isinstance(value, dict):
            found[key] = _scaled(value, length, mass, key)
        else:
            within = f'{around}.{key}'
            power = KEYS.get(within, KEYS.get(key))
            if power is None:
                raise SpecError(
                    f'like: the vehicle has {within}, and how that scales with size is not known; remove it, or take '
                    'vehicle instead of like'
                )
            found[key] = _times(value, power, length, mass)
    return found


def _times(value: Any, power: Power | tuple[Power, Power], length: float, mass: float) -> Any:
    if isinstance(power, tuple) and not isinstance(power, Power):
        return [[_times(x, p, length, mass) for x, p in zip(row, power, strict=True)] for row in value]
    if isinstance(value, list):
        return [_times(x, power, length, mass) for x in value]
    if power == NUMBER or not isinstance(value, int | float) or isinstance(value, bool):
        return value
    return float(value) * length ** (power.length + 0.5 * power.time) * mass**power.mass
