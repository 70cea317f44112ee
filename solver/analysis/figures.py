"""Figures of a vehicle, computed from its own model.

Masses from the specification, modes from the linearised model (solver.analysis.modes), kinematics and compliance from a
bench (solver.analysis.kinematics_and_compliance), what comes out of driving from runs (solver.analysis.driven). Angles
in rad, SI units. Typical values of them: solver.analysis.typical_values.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection
from typing import NamedTuple

import numpy as np

from solver.analysis.driven import parking_figures, steady_figures, step_figures
from solver.analysis.kinematics_and_compliance import CORNERS, Rig, kinematic_figures, wheel_centers
from solver.analysis.modes import AXLES, named_modes
from solver.elements.road import RoadSpec
from solver.errors import MbdError, SpecError
from solver.inputs.maneuver import Maneuver
from solver.model.frames import matrix
from solver.model.spec import ModelSpec
from solver.scene import Scene, StartSettings
from solver.simulation import Simulation
from solver.step.settings import IntegratorSettings
from solver.vehicle.hardpoints import SIDES

ANGLE_DECIMALS = 12  # decimals of an angle [rad]: what is beyond is rounding of the equilibrium
# what comes from where, first of all what tells that it is missing
MODES = ('bounce_frequency', 'bounce_damping', 'pitch_frequency', 'roll_frequency')
BENCH = ('wheel_rate_front', 'wheel_rate_rear', 'roll_stiffness_front', 'roll_stiffness_rear', 'steering_ratio')
STANDS = ('sag_front', 'sag_rear', 'toe_front', 'toe_rear', 'camber_front', 'camber_rear')
MASSES = (
    'mass', 'com_x', 'com_y', 'com_z', 'roll_inertia', 'pitch_inertia', 'yaw_inertia', 'wheelbase', 'track_front',
    'track_rear', 'front_share',
)  # fmt: skip
STEADY, STEP, PARKED = (
    ('understeer_gradient', 'roll_gradient', 'steering_sensitivity'),
    ('response_time',),
    ('parking_rack_force',),
)


def mass_figures(spec: ModelSpec) -> dict[str, float]:
    """Mass [kg], centre of mass [m], principal directions' inertia about it [kg m^2], wheelbase, tracks [m], share of
    the front axle."""
    placed = [(b, np.array(b.position) + matrix(b.orientation) @ np.array(b.com)) for b in spec.bodies]
    mass = sum(b.mass for b, _ in placed)
    com = sum(b.mass * p for b, p in placed) / mass
    inertia = np.zeros((3, 3))
    for b, p in placed:
        R, d = matrix(b.orientation), p - com
        inertia += R @ b.inertia_matrix() @ R.T + b.mass * (d @ d * np.eye(3) - np.outer(d, d))
    at = wheel_centers(spec)
    x = {axle: 0.5 * (at[f'{axle}_left'][0] + at[f'{axle}_right'][0]) for axle in AXLES}
    track = {axle: at[f'{axle}_left'][1] - at[f'{axle}_right'][1] for axle in AXLES}
    wheelbase = x['front'] - x['rear']
    return {
        'mass': float(mass),
        'com_x': float(com[0]), 'com_y': float(com[1]), 'com_z': float(com[2]),
        'roll_inertia': float(inertia[0, 0]), 'pitch_inertia': float(inertia[1, 1]),
        'yaw_inertia': float(inertia[2, 2]),
        'wheelbase': float(wheelbase), 'track_front': float(track['front']), 'track_rear': float(track['rear']),
        'front_share': float((com[0] - x['rear']) / wheelbase),
    }  # fmt: skip


def sag(simulation: Simulation) -> dict[str, float]:
    """Height [m] by which the vehicle stands lower than designed, per axle: the mean travel of its wheels."""
    names = simulation.channels.joints
    x = simulation.advance(0).joint_position
    return {
        f'sag_{axle}': float(np.mean([x[names.index(f'travel_{axle}_{side}')] for side in SIDES])) for axle in AXLES
    }


def alignment(simulation: Simulation) -> dict[str, float]:
    """Static toe (positive: toe-in) and camber (negative: top inwards) [rad] as the vehicle stands, by corner and as
    mean per axle."""
    spec, pose, found = simulation.model.spec, simulation.advance(0).pose, {}
    places = {body.name: k for k, body in enumerate(spec.bodies)}
    for tire in spec.tires:
        axis = matrix(tuple(pose[places[tire.marker.body], 3:])) @ matrix(tire.marker.orientation)[:, 1]
        side = SIDES[tire.name.rpartition('_')[2]]
        found[f'toe_{tire.name}'] = side * round(float(np.arctan2(axis[0], axis[1])), ANGLE_DECIMALS)
        found[f'camber_{tire.name}'] = -side * round(float(np.arcsin(axis[2])), ANGLE_DECIMALS)
    means = {
        f'{a}_{axle}': float(np.mean([found[f'{a}_{axle}_{side}'] for side in SIDES]))
        for a in ('toe', 'camber')
        for axle in AXLES
    }
    return found | means


def is_vehicle(spec: ModelSpec) -> bool:
    """True where the figures of this module can be computed: tires at the four corners."""
    return {tire.name for tire in spec.tires} == set(CORNERS)


def standing(scene: Scene) -> Simulation:
    """The vehicle of a scene standing in equilibrium on a flat road, wheels straight, no torque."""
    model = dataclasses.replace(scene.model, road=RoadSpec())
    return Simulation(
        dataclasses.replace(
            scene,
            model=model,
            start=StartSettings(kind='equilibrium'),
            maneuver=Maneuver(),
            integrator=IntegratorSettings(penalty=1e6),
        )
    )


class Figures(NamedTuple):
    """Figures of a vehicle by name, and the reason for each that could not be found."""

    found: dict[str, float]
    failed: dict[str, str]


def all_figures(simulation: Simulation, wanted: Collection[str] | None = None) -> Figures:
    """All figures of a vehicle whose simulation stands at its start (see standing()), without modes where there are
    none of bodies alone (solver.analysis.modes); solver.analysis.typical_values has their texts and units. Figures of a
    bench or a drive that fails are missing.

    wanted: names; only what these follow from is computed then, and others come with it (None: all)."""
    spec = simulation.model.spec
    found, failed = mass_figures(spec), {}
    needed = None if wanted is None else {_origin(name) for name in wanted}
    if needed is not None:  # what is driven needs the ratio of the steering, a step the understeer gradient
        needed |= {STEADY} if STEP in needed else set()
        needed |= {BENCH} if needed & {STEADY, PARKED} else set()

    def more(names: tuple[str, ...], make: Callable[[], dict[str, float]]) -> None:
        if needed is not None and names not in needed:
            return
        try:
            found.update(make())
        except MbdError as error:
            failed.update(dict.fromkeys(names, str(error)))

    def modes() -> dict[str, float]:
        named = named_modes(simulation) if not spec.struts else {}
        ends = {f'{name.replace(" ", "_")}': mode for name, mode in named.items()}
        return {f'{key}_{what}': getattr(mode, what) for key, mode in ends.items() for what in ('frequency', 'damping')}

    more(MODES, modes)
    more(BENCH, lambda: kinematic_figures(Rig(spec)))
    more(STANDS, lambda: sag(simulation) | alignment(simulation))
    ratio = found.get('steering_ratio')
    if ratio is None:
        why = failed.get('steering_ratio', 'the steering has no ratio')
        return Figures(found, failed | dict.fromkeys((*STEADY, *STEP, *PARKED), why))
    more(STEADY, lambda: steady_figures(spec, ratio))
    if 'understeer_gradient' in found:
        gradient = found['understeer_gradient']
        more(STEP, lambda: step_figures(spec, ratio, gradient))
    else:
        failed.update(dict.fromkeys(STEP, failed.get('understeer_gradient', '')))
    more(PARKED, lambda: parking_figures(spec, ratio))
    return Figures(found, failed)


def _origin(name: str) -> tuple[str, ...]:
    """The group of figures, one of the constants of this module, that a figure is computed with; of a mass or a length
    the empty one."""
    for names in (STEADY, STEP, PARKED):
        if name in names:
            return names
    if name == 'hand_torque':
        return STEADY
    if name.endswith(('_frequency', '_damping')):
        return MODES
    if name.startswith(('sag_', 'toe_', 'camber_')):
        return STANDS
    return () if name in MASSES else BENCH


def figures(simulation: Simulation) -> dict[str, float]:
    """All figures of a vehicle by name; see all_figures(). Raises MbdError where one cannot be found."""
    found, failed = all_figures(simulation)
    for why in failed.values():
        raise SpecError(why)
    return found
