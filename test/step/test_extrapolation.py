"""Order four: whole steps extrapolated from h and h / 2, with fixed steps and with error control."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from closed_forms import driven_four_bar, falling_four_bar, heavy_body, pendulum, spring_mass, steady_top
from convergence import FIELDS, error, errors, orders, scene_of

from solver.errors import SceneError, SpecError
from solver.files.scene import load_scene
from solver.simulation import Simulation

TIMES = 0.08 * np.arange(1, 11)
FOURTH = {'order': 4, 'rho_inf': 1.0, 'mode': 'tolerance', 'tolerance': 1e-13}
PROBLEMS = {
    'pendulum of a point mass': (pendulum(), (16e-3, 8e-3, 4e-3), FIELDS),
    'spring and damper': (spring_mass(), (8e-3, 4e-3, 2e-3), FIELDS),
    'top in steady precession': (steady_top(), (4e-3, 2e-3, 1e-3), FIELDS),
    'heavy asymmetric body': (heavy_body(TIMES[-1]), (16e-3, 8e-3, 4e-3), FIELDS),
    'falling four-bar': (falling_four_bar(TIMES[-1]), (4e-3, 2e-3, 1e-3), FIELDS),
}


@pytest.mark.slow
@pytest.mark.parametrize('name', PROBLEMS)
def test_errors_fall_with_the_fourth_power_of_the_step(name: str) -> None:
    """Positions, velocities and multipliers against closed forms: slope 4 +- 0.3 of the largest error over 0.8 s.

    Projections in the metric of the step matrix instead of the masses, or solutions that begin without the velocities
    that belong to their step, make it 2 or 3.
    """
    problem, steps, fields = PROBLEMS[name]
    slopes, table = orders(problem, steps, TIMES, **FOURTH)
    judged = [FIELDS.index(f) for f in fields]
    np.testing.assert_allclose(slopes[judged], 4.0, rtol=0, atol=0.3, err_msg=f'errors {FIELDS} at {steps}:\n{table}')


def test_multipliers_of_a_prescribed_motion_are_those_of_the_equations() -> None:
    """Its positions and velocities are given, so accelerations and multipliers are exact to rounding at any step."""
    _, table = orders(driven_four_bar(6.0), (8e-3, 4e-3), TIMES, **FOURTH)
    assert table.max() < 1e-10


def test_three_iterations_are_enough_where_they_contract() -> None:
    """Mode fixed: two orders of magnitude better than second order at the same step."""
    second, fourth = (
        errors(pendulum(), 8e-3, TIMES[:5], rho_inf=1.0, mode='fixed', iterations=3, order=order) for order in (2, 4)
    )  # fmt: skip
    assert (fourth < 1e-2 * second).all()


@pytest.mark.slow
def test_error_control_keeps_the_extrapolated_state() -> None:
    """The estimate is that of the two steps, second order; what goes on is better: the error falls faster than the
    tolerance."""
    largest = []
    for tolerance in (1e-3, 1e-4, 1e-5):
        sim = Simulation(scene_of(pendulum(), h=0.08, step_policy='error', error_tolerance=tolerance, **FOURTH))
        worst = 0.0
        for _ in range(8):
            worst = max(worst, error(sim.advance(1), pendulum().exact(sim.k * sim.h))[0])
        largest.append(worst)
    slopes = np.log10(np.array(largest[:-1]) / largest[1:])
    # 2 where the steps follow it freely, 1 where the iteration does, whose tolerance follows too
    assert (slopes > 1.3).all(), largest
    assert largest[0] < 1e-4


def test_a_passive_system_neither_gains_nor_loses_energy() -> None:
    """The account follows the power over a step by Simpson's rule: a damped spring loses what it dissipates to the
    fourth order too."""
    found = []
    for h in (8e-3, 4e-3):
        sim = Simulation(scene_of(spring_mass(), h=h, **FOURTH))
        sim.advance(round(0.8 / h))
        found.append(sim.totals()['energy_error_max'])
    assert np.log2(found[0] / found[1]) > 2.7, found


@pytest.mark.parametrize('problem', [falling_four_bar(0.4), driven_four_bar(6.0)], ids=['free', 'driven'])
def test_one_call_of_many_steps_is_many_calls_of_one(problem) -> None:
    """Accelerations and multipliers are solved for where they are shown, or where a driver takes power: neither what is
    shown last nor the account of energy, with the places of its largest residuals, may tell how the steps were asked
    for.
    """
    whole, single = (Simulation(scene_of(problem, h=4e-3, **FOURTH)) for _ in range(2))
    shown = whole.advance(40)
    for _ in range(40):
        last = single.advance(1)
    assert shown.numbers.tobytes() == last.numbers.tobytes()
    assert whole.save() == single.save()  # with the account


def test_a_saved_state_goes_on_bit_by_bit() -> None:
    sims = [Simulation(scene_of(falling_four_bar(0.4), h=4e-3, **FOURTH)) for _ in range(2)]
    sims[0].advance(20)
    saved = sims[0].save()
    future = sims[0].advance(20)
    sims[1].restore(saved)
    assert sims[1].advance(20).numbers.tobytes() == future.numbers.tobytes()


@pytest.mark.parametrize(
    ('settings', 'says'),
    [
        (['order=4', 'rho_inf=0.8'], r'order = 4: needs integrator\.rho_inf: 1'),
        (['order=3', 'rho_inf=1'], r'order = 3: must be 2 or 4'),
    ],
)
def test_what_has_no_fourth_order_is_refused(settings: list[str], says: str) -> None:
    with pytest.raises(SceneError, match=says):
        load_scene('pendulum', [f'integrator.{s}' for s in settings])


def braked(**changes: object) -> dict:
    """A rotor of 0.1 kg m^2 at 30 rad/s under a brake of 1 N m: it loses 10 rad/s each second."""
    brake = {'coordinate': 'shaft', 'input': 'brake', 'gain': 1.0, 'stiffness': 500.0, **changes}
    return {
        'mechanism': {
            'gravity': [0.0, 0.0, 0.0],
            'bodies': {'rotor': {'mass': 1.0, 'inertia': [0.1, 0.1, 0.1], 'position': [0.0, 0.0, 0.0]}},
            'joints': {'shaft': {'kind': 'revolute', 'i': 'world', 'j': 'rotor', 'at': [0, 0, 0], 'axis': [0, 0, 1]}},
            'brakes': {'pads': brake},
        },
        'maneuver': {'signals': {'brake': 1.0}},
        'duration': 1.0,
        'start': {'coordinates': {'shaft': {'rate': 30.0}}},
    }


def run_of(tmp_path: Path, content: dict, *settings: str) -> Simulation:
    (tmp_path / 'scene.yaml').write_text(yaml.safe_dump(content))
    return Simulation(load_scene(str(tmp_path / 'scene.yaml'), [f'integrator.{s}' for s in settings]))


@pytest.mark.slow
@pytest.mark.parametrize('order', [2, 4])
def test_a_slipping_brake_takes_its_torque_and_shows_it(tmp_path: Path, order: int) -> None:
    """20 rad/s are left after 1 s, and 25 J are lost, one sample as the other."""
    run = run_of(tmp_path, braked(), f'order={order}', 'rho_inf=1')
    # energy, dissipation, wind-up, rate, torque, capacity
    shown = np.array([run.advance(1).elements[:6] for _ in range(1000)])
    assert run.snapshot().joint_velocity[0] == pytest.approx(20.0, abs=1e-9)
    np.testing.assert_allclose(shown[:, 4], -1.0, rtol=1e-12)
    lost = np.abs(shown[:, 1]) - shown[:, 3]
    # behind 20 relaxation times of the wind-up, which takes energy in: exp(-20) = 2e-9 W
    assert np.abs(lost[40:]).max() < 1e-8
    assert run.totals()['energy_error_max'] < 1e-3 * 25.0


def test_friction_whose_wind_up_a_step_does_not_resolve_has_no_fourth_order(tmp_path: Path) -> None:
    """It would grow by 5/3 in each step, and its sign decide about that of the torque: 28 rad/s were left after 1 s
    instead of 20."""
    with pytest.raises(
        SpecError, match=r"wind-up of Brake 'pads' relaxes in 0 s .* a damping of 0\.25 N m s/rad or more, or take"
    ):
        run_of(tmp_path, braked(damping=0.0), 'order=4', 'rho_inf=1')
    assert run_of(tmp_path, braked(damping=0.25), 'order=4', 'rho_inf=1').advance(1000).joint_velocity[
        0
    ] == pytest.approx(20.0, abs=1e-6)
