"""Switches: subsystems of a vehicle that are left out of its model, at every level.

    engine_mounts       the engine is a part of the chassis
    subframes           so are the subframes
    steering_column     no shafts and universal joints: the gear turns with the steering wheel
    driveline_torsion   no elasticity of the final drive: half of the propeller shaft's inertia turns with each output
    anti_roll_bars      no bars and drop links
    stops               no bump rubbers and rebound buffers
    relaxation          tires that build up their force over the shortest length there is; their states stay, a standing
                        tire is a spring
    turn_slip           no turn slip, none against parking either, and one state less per tire
    camber              no forces from camber
    drag                no forces of the air
    road_unevenness     no height grids

What is off is not in the model: bodies, rows and entries of tables are gone. Parts are found by what they are joined
with, elements by the names that the templates give them (docs/vehicle.md).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from itertools import pairwise

from solver.elements.tire_pacejka import TireSpec
from solver.findings import Switched
from solver.levels.bars import drop_bars
from solver.levels.columns import straight_columns
from solver.levels.draft import Draft
from solver.levels.shafts import elastic_drives, without_torsion
from solver.model.spec import ModelSpec
from solver.remembered import of_same
from solver.scene import SUBSYSTEMS

NO_CAMBER = 1e-9  # rad: the range of the fit, where camber has no effect
# what relaxation lengths of 6.1 follow from, where a file has them
STIFFNESSES = ('LONGITUDINAL_STIFFNESS', 'LATERAL_STIFFNESS')
SHORT = 1e-3  # of the relaxation lengths in the file


@of_same
def switched(model: ModelSpec, switches: Mapping[str, str]) -> tuple[ModelSpec, tuple[Switched, ...]]:
    """(the model without the subsystems that are off, every subsystem: whether it is on, and why)."""
    draft = Draft(model)
    report = []
    for name in SUBSYSTEMS:
        there, leave_out = RULES[name]
        if not there(draft):
            report.append(Switched(subsystem=name, on=False, why='the vehicle or its road has none'))
        elif switches.get(name) == 'off':
            before = draft.model()
            leave_out(draft)
            gone = draft.model() != before
            why = (
                'switched off in the scene'
                if gone
                else 'switched off in the scene, but no rule takes it out of this vehicle'
            )
            report.append(Switched(subsystem=name, on=not gone, why=why))
        else:
            report.append(
                Switched(
                    subsystem=name,
                    on=True,
                    why='switched on in the scene' if name in switches else 'part of the vehicle',
                )
            )
    changed = any(switches.get(s.subsystem) == 'off' for s in report if not s.on)
    return (draft.model() if changed else model), tuple(report)


# -- parts -----------------------------------------------------------------------------------------------------------


def _mounts(draft: Draft, of: str) -> list[str]:
    """Names of the bushings of mounts whose name has this part."""
    return [name for name in draft.sections['bushings'] if f'{of}_mount' in name]


def _mounted(of: str) -> Callable[[Draft], bool]:
    return lambda draft: bool(_mounts(draft, of))


def _merged(of: str) -> Callable[[Draft], None]:
    """Every body on mounts of this name becomes a part of the chassis, or, without a mount there, of what the first
    mount stands on."""

    def leave_out(draft: Draft) -> None:
        while names := _mounts(draft, of):
            ends = {name: [getattr(draft.sections['bushings'][name], end).body for end in 'ij'] for name in names}
            first = ends[names[0]]
            body = next((end for end in first if of in end), min(first, key=lambda end: draft.bodies[end].mass))
            bases = [end for pair in ends.values() if body in pair for end in pair if end != body]
            for name, pair in ends.items():
                if body in pair:
                    draft.drop('bushings', name)
            draft.merge(body, draft.chassis if draft.chassis in bases else bases[0])

    return leave_out


# -- elements --------------------------------------------------------------------------------------------------------


def _is_stop(spring: object) -> bool:
    """True where a law has no force over an interval: it acts at the ends of a travel alone."""
    y = getattr(spring, 'y', ())
    return any(a == b == 0.0 for a, b in pairwise(y))


def _with_stops(draft: Draft) -> list[tuple[str, str]]:
    return [
        (s, spec.name)
        for s in ('spring_dampers', 'coordinate_forces')
        for spec in draft.sections[s].values()
        if _is_stop(spec.spring)
    ]


def _without_stops(draft: Draft) -> None:
    for section, name in _with_stops(draft):
        spec = draft.sections[section][name]
        if spec.damper is None and getattr(spec, 'input', None) is None and not spec.preload:
            draft.drop(section, name)
        else:
            draft.put(section, spec.replace(spring=None))


def _each_tire(change: Callable[[TireSpec], TireSpec]) -> Callable[[Draft], None]:
    def leave_out(draft: Draft) -> None:
        for tire in list(draft.sections['tires'].values()):
            draft.put('tires', change(tire))

    return leave_out


def _with_values(tire: TireSpec, **values: float) -> TireSpec:
    data = tire.data
    return tire.replace(data=dataclasses.replace(data, values={**data.values, **values}))


def _unrelaxed(tire: TireSpec) -> TireSpec:
    stiffer = {name: tire.data.values[name] / SHORT for name in STIFFNESSES if tire.data.values.get(name)}
    return _with_values(tire, LSGKP=SHORT, LSGAL=SHORT, **stiffer)


def _dropped(section: str) -> Callable[[Draft], None]:
    return lambda draft: draft.sections[section].clear()


def _flat(draft: Draft) -> None:
    draft.road = dataclasses.replace(draft.road, grids=())


def _any_tire(draft: Draft) -> bool:
    return bool(draft.sections['tires'])


def _bars(draft: Draft) -> bool:
    return any(name.startswith('anti_roll_bar') for name in draft.sections['coordinate_forces'])


RULES: dict[str, tuple[Callable[[Draft], object], Callable[[Draft], object]]] = {
    'engine_mounts': (_mounted('engine'), _merged('engine')),
    'subframes': (_mounted('subframe'), _merged('subframe')),
    'steering_column': (lambda draft: straight_columns(draft, look=True), straight_columns),
    'driveline_torsion': (elastic_drives, without_torsion),
    'anti_roll_bars': (_bars, drop_bars),
    'stops': (lambda draft: bool(_with_stops(draft)), _without_stops),
    'relaxation': (_any_tire, _each_tire(_unrelaxed)),
    'turn_slip': (
        lambda draft: any(tire.twists for tire in draft.sections['tires'].values()),
        _each_tire(lambda tire: tire.replace(turn_slip=False)),
    ),
    'camber': (_any_tire, _each_tire(lambda tire: _with_values(tire, CAMMIN=-NO_CAMBER, CAMMAX=NO_CAMBER))),
    'drag': (lambda draft: bool(draft.sections['aero_drags']), _dropped('aero_drags')),
    'road_unevenness': (lambda draft: bool(draft.road.grids), _flat),
}
"""Subsystem -> (whether a model has it, what takes it out)."""
