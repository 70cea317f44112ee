"""Cars on live axles with ideal joints, as a user would write their files: an off-roader with both axles driven, and a
truck on three."""

from __future__ import annotations

from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from solver.elements.registry import FORCE_BY_NAME
from solver.files.scene import load_scene_text
from solver.scene import Scene
from solver.simulation import Simulation

EXAMPLES = Path(__file__).parents[2] / 'docs' / 'examples'
AXLE, BOX, POWER = (
    yaml.safe_load((EXAMPLES / f'{name}.yaml').read_text(encoding='utf-8'))
    for name in ('steered_live_axle', 'drag_link_steering', 'power')
)
PLACES = ('center', 'com', 'inner', 'outer', 'chassis', 'axle', 'damper_chassis', 'damper_axle')
RATIO, STIFFNESS, DAMPING = 3.7, 22000.0, 60.0  # of a final drive: [-], [N m/rad], [N m s/rad]
GEARS = (3.73, 1.96, 1.32, 0.95, 0.76)  # of power.yaml
SHAFT, PINION = {'mass': 6.0, 'radius': 0.04}, {'mass': 2.0, 'radius': 0.028}
# inertia of both about the shaft [kg m^2]
SPINNING = sum(0.5 * one['mass'] * one['radius'] ** 2 for one in (SHAFT, PINION))
FLANGE = 0.31  # of a drive pinion before its axle [m]
LOADS = {2: (4040.0, 3410.0), 3: (4500.0, 3700.0, 3700.0)}  # of the springs of two and of three axles [N]


def moved(value: Any, back: float) -> Any:
    """A part of a file with all its points `back` [m] behind where they were."""
    if isinstance(value, dict):
        shift = [back, 0.0, 0.0]
        return {
            key: np.subtract(one, shift).tolist() if key in PLACES else moved(one, back) for key, one in value.items()
        }
    return value


def shaft(begin: list[float], end: list[float], **more: Any) -> dict[str, Any]:
    """The drive of a live axle by a propeller shaft of one part."""
    return {
        'kind': 'live_axle', 'ratio': RATIO, 'stiffness': STIFFNESS, 'damping': DAMPING, 'engine_flange': begin,
        'pinion_flange': end,
        'propshaft_front': SHAFT, 'pinion': PINION, **more,
    }  # fmt: skip


def car(at: dict[str, float], drives: dict[str, Any], mass: float, *, power: bool, **more: Any) -> dict[str, Any]:
    """A car on live axles `at` their x [m], the first one steered. power: engine map, clutch and gearbox in front of
    the drives."""
    axles = {}
    for k, (name, x) in enumerate(at.items()):
        suspension = moved(deepcopy(AXLE), 1.6 - x)
        suspension['coil']['spring']['load'] = LOADS[len(at)][k]
        suspension['brake']['share'] = 0.5 / len(at)
        if k > 0:
            suspension.pop('kingpins')
        axles[name] = {'suspension': suspension} | ({'drive': drives[name]} if name in drives else {})
    engine: dict[str, Any] = {
        'part': {'mass': 200, 'com': [0.7, 0.0, 0.6], 'inertia': [10, 15, 14]},
        'mounts': {'middle': {'point': [0.7, 0.0, 0.5]}},
    }  # fmt: skip
    if power:
        engine['power'] = deepcopy(POWER) | {'final': 1.0}
    middle = 0.5 * (max(at.values()) + min(at.values()))
    chassis = {'mass': mass, 'com': [middle + 0.12, 0, 0.76], 'inertia': [620, 3500, 3700]}
    return {'kind': 'car', 'chassis': chassis, 'steering': deepcopy(BOX), 'axles': axles, 'engine': engine, **more}


def off_roader(*, power: bool = False, shares: tuple[float, float] = (0.5, 0.5), **more: Any) -> dict[str, Any]:
    """Two driven live axles, 3.2 m apart, each by a shaft from the transfer case."""
    drives = {
        'front': shaft([0.55, 0.25, 0.47], [1.6 - FLANGE, 0.25, 0.42], share=shares[0]),
        'rear': shaft([0.30, 0.0, 0.50], [FLANGE - 1.6, 0.0, 0.42], share=shares[1]),
    }
    return car({'front': 1.6, 'rear': -1.6}, drives, 1500, power=power, **more)


def truck(*, power: bool = True, **more: Any) -> dict[str, Any]:
    """Six by four: a steered front axle, and two driven axles behind, the last one by a shaft through the one before
    it."""
    drives = {
        'middle': shaft([0.30, 0.0, 0.50], [FLANGE - 1.2, 0.0, 0.42], share=0.5),
        'rear': shaft([-1.45, 0.0, 0.42], [FLANGE - 2.4, 0.0, 0.42], share=0.5, through='middle'),
    }
    return car({'front': 1.6, 'middle': -1.2, 'rear': -2.4}, drives, 2400, power=power, **more)


def scene(vehicle: dict[str, Any], *changes: str, **more: Any) -> Scene:
    """Such a car from rest in its equilibrium unless told otherwise."""
    text = {'vehicle': vehicle, 'start': {'kind': 'equilibrium'}, **more}
    return load_scene_text(yaml.safe_dump(text), 'off-roads', changes)


def forces(simulation: Simulation, kind: str = 'coordinate_forces') -> dict[str, dict[str, float]]:
    """Outputs by name of all force elements of a kind, by name."""
    elements = getattr(simulation.model.spec, kind)
    rows = simulation.model.outputs(kind, simulation.outputs)
    columns = FORCE_BY_NAME[kind].outputs
    return {
        element.name: dict(zip(columns, row.tolist(), strict=True)) for element, row in zip(elements, rows, strict=True)
    }


def rates(simulation: Simulation) -> dict[str, float]:
    """Velocities of the joint coordinates by name."""
    return dict(zip(simulation.channels.joints, simulation.snapshot().joint_velocity.tolist(), strict=True))
