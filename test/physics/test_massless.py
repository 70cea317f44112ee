"""Bodies without mass or inertia: they run wherever constraints or stiffness determine their motion, in both forms of
the step."""

from __future__ import annotations

import numpy as np
import pytest
from ensemble import neighbours
from scipy.integrate import solve_ivp

from solver import simulation_of
from solver.errors import SpecError, StepError
from solver.files.scene import load_scene, load_scene_text
from solver.simulation import Simulation

FORMS = ('condensed', 'block')
MODES = ('fixed', 'tolerance')
REGULAR = 'start.coordinates.slide.rate=-1'  # the crank does not reach its singular position


def crank(weights: dict[str, float], *overrides: str) -> Simulation:
    """The slider-crank with some bodies scaled to a mass [kg], their inertia with it."""
    shape = {'rod': (5e-5, 1 / 12, 1 / 12), 'slider': (1e-4, 1e-4, 1e-4), 'ground': (1.0, 1.0, 1.0)}
    changes = [
        f'mechanism.bodies.{body}.{key}={value}'
        for body, m in weights.items()
        for key, value in (('mass', m), ('inertia', [m * x for x in shape[body]]))
    ]
    return simulation_of(load_scene('slider_crank', [*changes, *overrides]))


def settings(form: str, mode: str) -> list[str]:
    return [f'integrator.form={form}', f'integrator.mode={mode}', 'integrator.tolerance=1e-11']


@pytest.mark.parametrize('mode', MODES)
@pytest.mark.parametrize('form', FORMS)
@pytest.mark.parametrize('bodies', [('rod',), ('slider',), ('rod', 'slider', 'ground')], ids='-'.join)
def test_massless_bodies_are_the_limit_of_light_ones(bodies, form, mode):
    """Zero against 1e-9 kg: the motion agrees to 1e-7 m after 0.3 s, and the unique reactions to 1e-6 N."""
    light = crank(dict.fromkeys(bodies, 1e-9), REGULAR, *settings(form, mode))
    without = crank(dict.fromkeys(bodies, 0.0), REGULAR, *settings(form, mode))
    shared = [row in light.describe()['reactions_not_unique'] for row in light.model.row_names]
    a, b = light.advance(300), without.advance(300)
    np.testing.assert_allclose(b.pose, a.pose, rtol=0, atol=1e-7)
    np.testing.assert_allclose(b.twist, a.twist, rtol=0, atol=1e-6)
    np.testing.assert_allclose(b.reactions[~np.array(shared)], a.reactions[~np.array(shared)], rtol=0, atol=1e-6)


@pytest.mark.parametrize('form', FORMS)
def test_the_massless_slider_of_the_chapter_passes_singular_positions(form):
    """10 s at 1 ms, twelve passes, from every neighbour of the start: one branch, energy to 1e-3 J."""
    whole = crank({'slider': 0.0}, *settings(form, 'tolerance'), 'integrator.tolerance=1e-8', 'integrator.rho_inf=1')
    for scene in neighbours(whole.scene):
        s = simulation_of(scene)
        placed = s.snapshot().joint_position
        turn = s.advance(10_000).joint_position - placed
        assert abs(2 * turn[0] + turn[1]) < 1e-6
        assert abs(turn[0]) > 6 * np.pi
        assert s.totals()['energy_error_max'] < 1e-3


@pytest.mark.parametrize('form', FORMS)
def test_point_masses_need_no_inertia(form):
    """A01 in both forms: (0.986291751132, -0.165010853126) m at 1 s, to 1e-5 at 1 ms."""
    s = simulation_of(load_scene('pendulum', [f'integrator.form={form}']))
    bob = s.advance(1000)
    angle = bob.joint_position[0]
    np.testing.assert_allclose([-np.cos(angle), -np.sin(angle)], (0.986291751132, -0.165010853126), rtol=0, atol=1e-5)


KNOT = """
mechanism:
  bodies:
    knot: {mass: 0, inertia: [0, 0, 0], position: [0, 0, -0.5]}
    ball: {mass: 1, inertia: [0.01, 0.01, 0.01], position: [0, 0, -1]}
  joints:
    upper: {kind: prismatic, i: world, j: knot, axis: [0, 0, 1], at: [0, 0, 0]}
    lower: {kind: prismatic, i: world, j: ball, axis: [0, 0, 1], at: [0, 0, 0]}
  spring_dampers:
    first: {i: world, j: knot, free_length: 0.5, spring: 100}
    second: {i: knot, j: ball, free_length: 0.5, spring: 300}
"""


@pytest.mark.parametrize('form', FORMS)
def test_a_massless_knot_between_two_springs_makes_them_one(form):
    """Stiffness 100 300 / 400 = 75 N/m in series: x = -1 - (m g / 75) (1 - cos(sqrt(75) t)), the knot three quarters of
    it down."""
    s = simulation_of(
        load_scene_text(KNOT, overrides=[f'integrator.form={form}', 'integrator.rho_inf=1', 'integrator.h=1e-3'])
    )
    snapshot = s.advance(1000)
    stretch = 9.81 / 75 * (1 - np.cos(np.sqrt(75)))
    assert snapshot.pose[1, 2] == pytest.approx(-1 - stretch, abs=1e-5)
    assert snapshot.pose[0, 2] == pytest.approx(-0.5 - 0.75 * stretch, abs=1e-5)


@pytest.mark.parametrize('form', FORMS)
def test_a_motion_that_nothing_determines_is_refused_by_the_name_of_its_body(form):
    """A moment on a point mass turns it infinitely fast."""
    wound = """
mechanism:
  bodies:
    ball: {mass: 1, inertia: [0, 0, 0], position: [1, 0, 0]}
  applied_forces:
    hand: {marker: ball, torque: [0, 0, 1]}
"""
    s = simulation_of(load_scene_text(wound, overrides=[f'integrator.form={form}']))
    with pytest.raises(
        StepError, match=r"singular at body 'ball': .* neither inertia nor constraint nor stiffness; give the body mass"
    ):
        s.advance(1)


def of_bodies(bodies: str, rest: str, *overrides: str) -> Simulation:
    """A mechanism that is given as text, at 1 ms without numerical damping."""
    text = f'mechanism:\n  bodies:\n{bodies}{rest}'
    return simulation_of(load_scene_text(text, overrides=['integrator.h=1e-3', 'integrator.rho_inf=1', *overrides]))


@pytest.mark.parametrize('form', FORMS)
def test_a_point_mass_on_a_spring_swings_as_a_point(form):
    """z = -1 - (m g / k) (1 - cos(omega t)), omega = 10 rad/s: to the (omega h)^2 / 12 of the midpoint rule in
    phase."""
    s = of_bodies('    p: {mass: 1, inertia: [0, 0, 0], position: [0, 0, -1]}\n', """  spring_dampers:
    s: {i: world, j: p, free_length: 1, spring: 100}
""", f'integrator.form={form}')  # fmt: skip
    z = s.advance(1000).pose[0, 2]
    assert z == pytest.approx(-1 - 0.0981 * (1 - np.cos(10.0)), abs=0.0981 * 10.0 * (10.0 * 1e-3) ** 2 / 12 + 1e-9)


TWO = """  joints:
    upper: {kind: distance, i: world, j: a, length: 1}
    lower: {kind: distance, i: a, j: b, length: 1}
"""


def rods_and_points(first: str, second: str, form: str) -> np.ndarray:
    """Two balls on two rods without mass, from the horizontal at rest: their places after 1 s (2, 3) [m]."""
    bodies = (
        f'    a: {{mass: 1, inertia: {first}, position: [1, 0, 0]}}\n    b: {{mass: 2, inertia: {second}, '
        f'position: [2, 0, 0]}}\n'
    )
    return of_bodies(bodies, TWO, f'integrator.form={form}').advance(1000).pose[:2, :3].copy()


@pytest.mark.parametrize('form', FORMS)
def test_two_point_masses_on_rods_are_the_double_pendulum(form):
    """Against its two equations of motion, integrated to 1e-12: error of the midpoint rule, quartered by half the step
    elsewhere."""

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        a, b, wa, wb = y  # angles from the vertical, unit lengths, masses 1 and 2
        M = np.array([[3.0, 2.0 * np.cos(a - b)], [2.0 * np.cos(a - b), 2.0]])
        f = np.array(
            [
                -2.0 * wb * wb * np.sin(a - b) - 3.0 * 9.81 * np.sin(a),
                2.0 * wa * wa * np.sin(a - b) - 2.0 * 9.81 * np.sin(b),
            ]
        )
        return np.concatenate([[wa, wb], np.linalg.solve(M, f)])

    a, b = solve_ivp(rates, (0.0, 1.0), [np.pi / 2, np.pi / 2, 0.0, 0.0], rtol=1e-12, atol=1e-12).y[:2, -1]
    one = np.array([np.sin(a), 0.0, -np.cos(a)])
    wanted = np.array([one, one + [np.sin(b), 0.0, -np.cos(b)]])
    np.testing.assert_allclose(rods_and_points('[0, 0, 0]', '[0, 0, 0]', form), wanted, rtol=0, atol=2e-5)


@pytest.mark.parametrize('form', FORMS)
def test_the_inertia_of_what_nothing_turns_changes_no_motion(form):
    """Points on rods beside balls of any inertia on them: the same places, to the rounding of an iteration; one of both
    kinds, too."""
    points = rods_and_points('[0, 0, 0]', '[0, 0, 0]', form)
    np.testing.assert_allclose(rods_and_points('[0.3, 0.3, 0.3]', '[0, 0, 0]', form), points, rtol=0, atol=1e-9)
    np.testing.assert_allclose(rods_and_points('[5, 5, 5]', '[0.02, 0.03, 0.04]', form), points, rtol=0, atol=1e-9)


@pytest.mark.parametrize('form', FORMS)
@pytest.mark.parametrize(('mass', 'inertia'), [(0.6, '[0, 0.05, 0.05]'), (0.0, '[0, 0, 0]')], ids=['thin', 'massless'])
def test_rods_between_spherical_joints_do_not_turn_about_themselves(form, mass, inertia):
    """A pendulum whose rod, with no inertia about itself, and none at all, is held by two points: its swing is that of
    the compound pendulum, J theta'' = -M g l sin(theta), from 0.5 rad; the reference to 1e-12."""
    angle = 0.5
    c, s = float(np.cos(angle)), float(np.sin(angle))
    bodies = (
        f'    rod: {{mass: {mass}, inertia: {inertia}, position: [{0.5 * s}, 0, {-0.5 * c}], rpy: [0, '
        f'{np.pi / 2 - angle}, 0]}}\n    ball: {{mass: 1, inertia: [0, 0, 0], position: [{s}, 0, {-c}]}}\n'
    )
    joints = f"""  joints:
    a: {{kind: spherical, i: world, j: rod, at: [0, 0, 0]}}
    b: {{kind: spherical, i: rod, j: ball, at: [{s}, 0, {-c}]}}
"""
    x = of_bodies(bodies, joints, f'integrator.form={form}').advance(1000).pose[1, :3]
    J, moment = 1.0 + (0.05 + mass * 0.25 if mass else 0.0), (1.0 + 0.5 * mass) * 9.81
    theta = solve_ivp(
        lambda t, y: [y[1], -moment / J * np.sin(y[0])], (0.0, 1.0), [angle, 0.0], rtol=1e-12, atol=1e-12
    ).y[0, -1]
    np.testing.assert_allclose(x, [np.sin(theta), 0.0, -np.cos(theta)], rtol=0, atol=1e-5)


def test_a_point_mass_that_is_given_a_spin_is_refused():
    """It has none: named with its body and what to do."""
    body = '    p: {mass: 1, inertia: [0, 0, 0], angular_velocity: [0, 3, 0]}\n'
    with pytest.raises(
        SpecError,
        match=r"'p': angular_velocity = \[0.0, 3.0, 0.0\]: .* no moment of inertia .* leave that component out",
    ):
        of_bodies(body, '')


@pytest.mark.parametrize('mode', MODES)
@pytest.mark.parametrize('form', FORMS)
def test_rods_without_inertia_about_themselves_are_the_limit_of_thin_ones(form, mode):
    """Bricard's mechanism, whose hinges hold every rod about its axis: zero against 1e-9 kg m2, positions after 0.2 s
    to 1e-7 m."""

    def bricard(axial: float) -> np.ndarray:
        across = 1.0 / 12.0
        axes = {'rod1': 0, 'rod2': 1, 'rod3': 2, 'rod4': 0, 'rod5': 1}
        rods = [
            f'mechanism.bodies.{rod}.inertia={[axial if k == axis else across for k in range(3)]}'
            for rod, axis in axes.items()
        ]
        return simulation_of(load_scene('bricard', [*rods, *settings(form, mode)])).advance(200).pose

    np.testing.assert_allclose(bricard(0.0), bricard(1e-9), rtol=0, atol=1e-7)
