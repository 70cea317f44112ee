"""What no formula can fake: a mechanism moves in the same way wherever it is, however it is turned, mirrored or
measured; what is passive gains no energy; what was saved goes on with the same bits; a unit in the last place stays
about that.

Tolerance of a comparison: a run rounds the solution of its matrix, which has the penalties in it, so numbers of the
size one carry ROUNDING = 10 eps penalty (docs/formulation.md, Rounding), and a motion carries them on as far as it
carries on a perturbation of its start, which is measured. At a distance D every step rounds positions by eps D, and its
velocity by eps D / h: over n steps this walks to n^1.5 eps D.

Iterations go to a tolerance: after a fixed number of them something is left that is not rounding, and of scissors and
overconstrained linkages rounding decides what (which directions are combined first). What is saved and what is passive
is shown with the default.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from ensemble import EPS
from scipy.spatial.transform import Rotation
from transformed import Transformation, in_units, mirrored, placed_at

from mbd_sim_ros.lab.mechanisms.families import FAMILIES, draw
from mbd_sim_ros.lab.mechanisms.references import difference, measured
from mbd_sim_ros.lab.studies import crank
from solver.analysis.verdict import findings
from solver.files.scene import load_scene
from solver.inputs.maneuver import Maneuver
from solver.model.spec import ModelSpec
from solver.output.energy import exchanged
from solver.scene import Scene
from solver.simulation import Simulation
from solver.step.settings import IntegratorSettings

H, STEPS = 2e-3, 100
# s; what a step leaves unresolved at the start is judged by sizes in m and rad together (solver.start.newton)
FINER = {'springs': 2e-4}
EXACT = {'mode': 'tolerance', 'tolerance': 1e-12}
ROUNDING = 10 * EPS * IntegratorSettings().penalty
NUDGE = 1e-6  # relative, of start velocities and gravity
SEED = 7
QUICK = ('slider_crank', 'tree', 'springs', 'rolling')
MECHANISMS = [
    pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in ('slider_crank', *FAMILIES)
]
TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])


def scene(name: str, **settings: Any) -> Scene:
    """A mechanism by name: the slider-crank of the scenes, or one of a family."""
    h = FINER.get(name, H)
    if name == 'slider_crank':
        return crank.scene_at(np.pi / 4, h, settings)
    return draw(name, SEED).at(1.0, h=h, **settings)


def changed(given: Scene, change: Callable[[ModelSpec], ModelSpec]) -> Scene:
    return dataclasses.replace(given, model=change(given.model))


def end(given: Scene, steps: int = STEPS) -> np.ndarray:
    """q (1, nb + 1, 7) after so many steps."""
    s = Simulation(given)
    s.advance(steps)
    return s.state.q[None].copy()


def apart(q: np.ndarray, other: np.ndarray) -> float:
    return difference(measured(q), measured(other))


def nudged(given: Scene) -> Scene:
    def all_of(x: tuple[float, ...]) -> tuple[float, ...]:
        return tuple((1.0 + NUDGE) * c for c in x)

    bodies = tuple(
        b.replace(velocity=all_of(b.velocity), angular_velocity=all_of(b.angular_velocity)) for b in given.model.bodies
    )
    return dataclasses.replace(
        given, model=dataclasses.replace(given.model, bodies=bodies, gravity=all_of(given.model.gravity))
    )


def carried_on(given: Scene) -> float:
    """How much larger a perturbation of the start is in the end."""
    return max(1.0, apart(end(nudged(given)), end(given)) / NUDGE)


def moves_alike(given: Scene, t: Transformation, tolerance: float, scale: float = 1.0) -> None:
    there = end(changed(given, t.model))
    expected = t.there(end(given)[0])[None]
    found = apart(there / ([scale] * 3 + [1.0] * 4), expected / ([scale] * 3 + [1.0] * 4))
    assert found <= tolerance, f'{found:.2g} > {tolerance:.2g}'


@pytest.mark.parametrize('distance', [1.0, 1e3, 1e7])
@pytest.mark.parametrize('name', MECHANISMS)
def test_it_moves_alike_elsewhere(name: str, distance: float) -> None:
    given = scene(name, **EXACT)
    d = distance * np.array([0.6, -0.64, 0.48])
    moves_alike(given, placed_at(np.eye(3), d), (ROUNDING + STEPS**1.5 * EPS * distance) * carried_on(given))


@pytest.mark.parametrize('name', MECHANISMS)
def test_it_moves_alike_when_all_is_turned(name: str) -> None:
    given = scene(name, **EXACT)
    moves_alike(given, placed_at(TURN, np.zeros(3)), ROUNDING * carried_on(given))


@pytest.mark.parametrize('name', MECHANISMS)
def test_it_moves_alike_in_a_mirror(name: str) -> None:
    given = scene(name, **EXACT)
    moves_alike(given, mirrored(), ROUNDING * carried_on(given))


@pytest.mark.parametrize(('length', 'mass'), [(1e3, 1.0), (1.0, 1e3), (0.1, 1e-3)])
@pytest.mark.parametrize('name', MECHANISMS)
def test_it_moves_alike_in_other_units(name: str, length: float, mass: float) -> None:
    given = scene(name, **EXACT)
    moves_alike(given, in_units(length, mass), ROUNDING * carried_on(given), length)


@pytest.mark.parametrize(
    ('length', 'mass', 'time'),
    [(1e-3, 1e-9, 1.0), (1.0, 1e-12, 1.0), (1.0, 1.0, 3600.0), (1e-3, 1e-6, 1e-2), (50.0, 1e6, 37.0)],
    ids=['micrograms in mm', 'nanograms', 'hours', 'micro', 'crane'],
)
@pytest.mark.parametrize('name', ['tree', 'springs', 'bushings', 'rolling', 'space_loop', 'parallelogram'])
def test_the_same_mechanism_in_other_units_has_the_same_digits_and_verdict(
    name: str, length: float, mass: float, time: float
) -> None:
    """With the settings that everybody has: a fixed number of iterations, and no floor in any of its decisions that has
    a unit."""
    given, t = scene(name), in_units(length, mass, time)
    settings = dataclasses.replace(given.integrator, h=round(time * given.integrator.h, 9))
    there = dataclasses.replace(given, model=t.model(given.model), integrator=settings, duration=time * given.duration)
    runs = [Simulation(one) for one in (given, there)]
    for s in runs:
        s.advance(STEPS)
    scale = np.array([length] * 3 + [1.0] * 4)
    found = apart(runs[1].state.q[None] / scale, runs[0].state.q[None])
    assert found <= 1e-12 * carried_on(given)
    assert [f.quantity for f in findings(runs[0])] == [f.quantity for f in findings(runs[1])]


@pytest.mark.parametrize('name', MECHANISMS)
def test_a_unit_in_the_last_place_stays_small(name: str) -> None:
    given = scene(name, **EXACT)

    def nextafter(model: ModelSpec) -> ModelSpec:
        first = model.bodies[0]
        x, y, z = first.position
        w = first.angular_velocity
        moved = first.replace(
            position=(float(np.nextafter(x, 9.0)), y, z), angular_velocity=(float(np.nextafter(w[0], 9.0)), w[1], w[2])
        )
        return dataclasses.replace(model, bodies=(moved, *model.bodies[1:]))

    assert apart(end(changed(given, nextafter)), end(given)) <= ROUNDING * carried_on(given)


@pytest.mark.parametrize('name', MECHANISMS)
def test_saved_and_restored_it_goes_on_with_the_same_bits(name: str) -> None:
    given = scene(name)
    s = Simulation(given)
    s.advance(STEPS // 2)
    saved = s.save()
    ahead = s.advance(STEPS // 2).numbers
    s.restore(saved)
    assert (s.advance(STEPS // 2).numbers == ahead).all()
    other = Simulation(given)
    other.restore(saved)
    assert (other.advance(STEPS // 2).numbers == ahead).all()


def passive(model: ModelSpec) -> ModelSpec:
    """Without what may supply energy: drivers, loads and driven torques."""
    kept = {
        'couplers': tuple(c for c in model.couplers if c.input is None),
        'coordinate_forces': tuple(c for c in model.coordinate_forces if c.input is None),
        'applied_forces': (),
        'inputs': (),
    }
    return dataclasses.replace(model, **kept)


@pytest.mark.parametrize('name', MECHANISMS)
def test_what_is_passive_gains_no_energy(name: str) -> None:
    """Beyond what the method is off by, which falls with the square of the step: a fiftieth of a percent of what is
    exchanged at 1 ms, and what numbers written with six digits leave open of the kinetic energy."""
    gains = {}
    for h in (2e-3, 1e-3):
        given = scene(name)
        s = Simulation(
            dataclasses.replace(
                given, model=passive(given.model), maneuver=Maneuver(), integrator=IntegratorSettings(h=h)
            )
        )
        start = s.last_step.account.energy[0]
        highest = start
        for _ in range(round(0.5 / h)):
            s.advance()
            highest = max(highest, s.last_step.account.energy[0])
        gains[h] = (highest - start) / (exchanged(s.last_step.account) + 1e-6 * s.last_step.account.kinetic[1])
    assert gains[1e-3] < 2e-4
    assert gains[1e-3] < max(1e-9, 0.5 * gains[2e-3])


def car(name: str) -> Scene:
    """A car in a slalom at 80 km/h, from its design position: the search for an equilibrium ends before the last
    digits."""
    steering = '{kind: sine, amplitude: 0.6, frequency: 1.0, start: 0.05}'
    settings = f'integrator={{h: {H}, mode: tolerance, tolerance: 1.0e-12}}'
    return load_scene(
        name, ['start={speed_kmh: 80}', f'maneuver={{drive_torque: 150, steering: {steering}}}', settings]
    )


@pytest.mark.slow
@pytest.mark.parametrize('name', ['light_car_straight', 'car_lane_change'])
@pytest.mark.parametrize(('yaw_deg', 'distance'), [(0.0, 1e3), (143.0, 0.0), (0.0, 1e7)])
def test_a_car_drives_alike_elsewhere(name: str, yaw_deg: float, distance: float) -> None:
    given = car(name)
    t = placed_at(Rotation.from_euler('z', yaw_deg, degrees=True).as_matrix(), distance * np.array([0.6, -0.8, 0.0]))
    size = float(np.abs(Simulation(given).state.v).max())  # wheels turn with 70 rad/s: numbers are not of the size one
    moves_alike(given, t, (ROUNDING * size + STEPS**1.5 * EPS * distance) * carried_on(given))
