"""A light car at another size, as files: Froude similarity, all lengths times s, densities and gravity the same.

The exponents are those of the units: a length grows with s, a mass with s^3, a time with s^(1/2), so a force with s^3,
a rate of a spring with s^2, of a damper with s^(5/2), a moment with s^4, an inertia with s^5. Coefficients of the Magic
Formula are numbers.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from solver.files.tir import read_tir

CONFIG = Path(__file__).resolve().parents[2] / 'config'
LENGTH, TIME, MASS = 1.0, 0.5, 3.0
SPEED, FORCE, MOMENT, INERTIA = LENGTH - TIME, MASS + LENGTH - 2 * TIME, MASS + 2 * LENGTH - 2 * TIME, MASS + 2 * LENGTH
RATE, DAMPING = FORCE - LENGTH, FORCE - SPEED
KEYS: dict[
    str, float | tuple[float, float]
] = {  # of a light car, by the name of the key or, where that is not enough, with the one around it
    **dict.fromkeys(
        ('com', 'center', 'top_mount', 'strut', 'ball_joint', 'arm_pivots', 'tie_rod_knuckle', 'tie_rod_rack'), LENGTH
    ),
    **dict.fromkeys(
        ('spring.chassis', 'spring.knuckle', 'damper.chassis', 'damper.knuckle', 'pivot_inner', 'pivot_outer'), LENGTH
    ),
    **dict.fromkeys(('rack_per_turn', 'hitch', 'point'), LENGTH),
    **{'mass': MASS, 'inertia': INERTIA, 'spin_inertia': INERTIA, 'products': INERTIA},
    **{'rate': RATE, 'anti_roll_bar': RATE, 'rack_damping': DAMPING, 'drag_area': 2 * LENGTH, 'top_speed': -TIME},
    **{'stiffness': MOMENT, 'damping': MOMENT + TIME, 'damper.law': (SPEED, FORCE), 'stops': (LENGTH, FORCE)},
    **dict.fromkeys(
        ('toe_deg', 'camber_deg', 'column_axis', 'driven', 'ratio', 'share', 'kind', 'tire', 'category'), 0.0
    ),
}
TIRE = {
    **dict.fromkeys(('UNLOADED_RADIUS', 'WIDTH', 'RIM_RADIUS', 'BOTTOM_OFFST'), LENGTH),
    **dict.fromkeys(('FNOMIN', 'FZMIN', 'FZMAX'), FORCE),
    **dict.fromkeys(('VERTICAL_STIFFNESS', 'BOTTOM_STIFF', 'LONGITUDINAL_STIFFNESS', 'LATERAL_STIFFNESS'), RATE),
    **{'VERTICAL_DAMPING': DAMPING, 'LONGVL': SPEED},
    **dict.fromkeys(('INFLPRES', 'NOMPRES'), FORCE - 2 * LENGTH),
}


def scaled(value: Any, s: float, exponent: float | tuple[float, float]) -> Any:
    """A number, or all of a list of them; of a law both columns by their own exponents."""
    if isinstance(exponent, tuple):
        return [[scaled(x, s, e) for x, e in zip(row, exponent, strict=True)] for row in value]
    if isinstance(value, list):
        return [scaled(x, s, exponent) for x in value]
    return value if exponent == 0.0 else float(value) * s**exponent


def similar_data(data: dict[str, Any], s: float, around: str = '') -> dict[str, Any]:
    """The data of a light car at s times its size. Raises KeyError for a key that is not in KEYS."""
    found = {}
    for key, value in data.items():
        if isinstance(value, dict):
            found[key] = similar_data(value, s, key)
        else:
            within = f'{around}.{key}'
            found[key] = scaled(value, s, KEYS[within if within in KEYS else key])
    return found


def write_similar_tire(source: Path, target: Path, s: float) -> None:
    """A tire file at s times the size of another one."""
    data = read_tir(source)
    values = {'LONGVL': 16.7, **data.values}
    lines = ['[MODEL]', f'FITTYP = {data.version}', "TYRESIDE = 'SYMMETRIC'", '[ALL]']
    lines += [f'{name} = {scaled(value, s, TIRE.get(name, 0.0))!r}' for name, value in values.items()]
    target.write_text('\n'.join(lines) + '\n')


def similar_car(directory: Path, s: float, change: dict[str, Any] | None = None) -> Path:
    """The file of the delivered light car at s times its size, beside its tire. change: of the data, before they are
    scaled."""
    directory.mkdir(parents=True, exist_ok=True)
    data = yaml.safe_load((CONFIG / 'vehicles' / 'light_car.yaml').read_text()) | (change or {})
    write_similar_tire(CONFIG / 'tires' / '205_55R16.tir', directory / 'similar.tir', s)
    data = similar_data(data, s)
    data['front']['tire'] = data['rear']['tire'] = 'similar.tir'
    path = directory / 'similar_car.yaml'
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return path
