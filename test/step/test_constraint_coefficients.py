"""The coefficients m, c, k, f of the constraints: what they are, and that they cannot change the motion
(docs/formulation.md)."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from ensemble import median, neighbours

from solver.compiled.by_reference import Ref
from solver.elements.joint import JointSpec
from solver.elements.marker import Marker
from solver.errors import SpecError
from solver.files.scene import load_scene, load_scene_text
from solver.model.evaluate import evaluate_constraints, prepare
from solver.model.saddle import CONDENSED, effective_masses, new_saddle
from solver.model.state import kinematics_of
from solver.output.dependence import dense_jacobian
from solver.simulation import Simulation
from solver.step.constraint_coefficients import COUPLING, coefficients_of, constraint_coefficients, new_formulation

TIGHT = ['integrator.mode=tolerance', 'integrator.tolerance=1e-12', 'integrator.h=0.002']
ROUNDING = 1e-16 * COUPLING


def simulation(name: str, *settings: str) -> Simulation:
    return Simulation(load_scene(name, [f'integrator.{s}' for s in settings]))


def dense(sim: Simulation) -> tuple[np.ndarray, np.ndarray]:
    """(A (nc, 6 nb), M (6 nb, 6 nb) with the floor of the penalties) at the current state."""
    s, t = sim.state, sim.model.tables
    J = np.zeros((sim.model.n_entries + 1, 6, 6))
    evaluate_constraints(
        t, kinematics_of(s.q, s.v), s.angle, np.zeros(len(sim.channels.inputs)), True, np.zeros(sim.model.n_rows), J
    )
    M = np.zeros((6 * sim.model.n_bodies, 6 * sim.model.n_bodies))
    for b in range(sim.model.n_bodies):
        M[6 * b : 6 * b + 3, 6 * b : 6 * b + 3] = np.eye(3) / t.penalty_inverse_mass[b]
        M[6 * b + 3 : 6 * b + 6, 6 * b + 3 : 6 * b + 6] = np.linalg.inv(t.penalty_inverse_inertia[b])
    return dense_jacobian(sim.model, J), M


@pytest.mark.parametrize('name', ['pendulum', 'slider_crank', 'andrews'])
def test_the_isolated_mass_is_that_of_the_cheapest_motion_of_a_constraint(name):
    """m_R = 1 / (a_R M^-1 a_R^T), for every row."""
    sim = simulation(name)
    A, M = dense(sim)
    expected = 1.0 / np.einsum('ri,ri->r', A, np.linalg.solve(M, A.T).T)
    found = sim.constraint_coefficients()
    np.testing.assert_allclose([found[name].m for name in sim.model.row_names], expected, rtol=1e-12)


@pytest.mark.parametrize('name', ['pendulum', 'double_pendulum', 'slider_crank', 'bricard', 'four_bar'])
def test_the_coupled_mass_is_the_pseudo_inverse_of_the_constraints(name):
    """m_R = [(A M^-1 A^T)^+]_RR, with rows in units of their isolated mass where some are redundant.

    Tolerance: the finite penalty is off by 2 / (COUPLING s_min), its rounding by COUPLING times the unit round-off over
    s_min.
    """
    sim = simulation(name)
    sim.advance(3)  # away from special positions of the start
    A, M = dense(sim)
    N = A @ np.linalg.solve(M, A.T)
    isolated = 1.0 / np.diag(N)
    scaled = np.sqrt(isolated)[:, None] * N * np.sqrt(isolated)
    eigenvalues = np.linalg.eigvalsh(scaled)
    expected = isolated * np.diag(np.linalg.pinv(scaled, rcond=1e-10, hermitian=True))
    if eigenvalues[0] > 1e-9:  # nothing redundant: the units do not matter
        np.testing.assert_allclose(expected, np.diag(np.linalg.inv(N)), rtol=1e-10 / eigenvalues[0])
    smallest = eigenvalues[eigenvalues > 1e-9].min()
    found = sim.constraint_coefficients(coupled=True)
    tolerance = (2.0 / COUPLING + 10.0 * ROUNDING) / smallest
    assert tolerance < 1e-2
    np.testing.assert_allclose([found[name].m for name in sim.model.row_names], expected, rtol=tolerance)


@pytest.mark.parametrize('coupled', [False, True])
def test_rescaling_a_row_does_not_change_its_mass_times_its_square(coupled, rng):
    """phi_R -> s phi_R: m_R a_R^T a_R stays, row by row, for redundant constraints too."""
    sim = simulation('slider_crank')
    t = sim.model.tables
    before = sim.constraint_coefficients(coupled=coupled)
    scale = np.exp(rng.uniform(-3.0, 3.0, sim.model.n_rows))
    s = sim.state
    J = np.zeros((sim.model.n_entries + 1, 6, 6))
    evaluate_constraints(t, kinematics_of(s.q, s.v), s.angle, np.zeros(0), True, np.zeros(sim.model.n_rows), J)
    con = t.constraints
    for g in range(len(con.row) - 1):
        for e in range(con.entry[g], con.entry[g + 1]):
            J[e, : con.row[g + 1] - con.row[g]] *= scale[con.row[g] : con.row[g + 1], None]
    K, f = np.zeros((sim.model.n_slots + 1, 6, 6)), np.zeros((sim.model.n_bodies + 1, 6))
    formulation = new_formulation(sim.model)
    constraint_coefficients(
        t, CONDENSED, int(coupled), 0, J, K, K, f, Ref(new_saddle(sim.model, CONDENSED)), Ref(formulation)
    )
    expected = np.array([before[name].m for name in sim.model.row_names])
    np.testing.assert_allclose(formulation.values[:, 0] * scale**2, expected, rtol=1e3 * ROUNDING if coupled else 1e-13)


GUIDE = 'joints: {guide: {kind: prismatic, i: world, j: mass, at: [0, 0, 0], axis: [1, 0, 0]}}'
BLADE = 'contacts: {blade: {kind: knife_edge, i: world, j: mass}}'


def mass_on(constraint: str, stiffness: float, damping: float, *settings: str) -> Simulation:
    """A mass that a constraint lets move along x; a bushing acts across, along y, so the constraint works against
    it."""
    return Simulation(
        load_scene_text(
            f'mechanism:\n  gravity: [0, -9.81, 0]\n  bodies: {{mass: {{mass: 3, inertia: [1, 1, 1]}}}}\n  '
            f'{constraint}\n  bushings: {{soft: {{i: world, j: mass, at: [0, 0, 0], stiffness: [0, {stiffness}, 0, 0, '
            f'0, 0], damping: [0, {damping}, 0, 0, 0, 0]}}}}\n',
            overrides=[f'integrator.{s}' for s in settings],
        )
    )


def test_the_coefficients_of_a_guided_mass_are_those_one_writes_down():
    """Across the guide: m the mass, c and k those of the bushing, f the weight; by themselves and coupled alike."""
    sim = mass_on(GUIDE, 500.0, 7.0)
    for coupled in (False, True):
        found = sim.constraint_coefficients(coupled=coupled)
        rows = np.array([found[name] for name in sim.model.row_names if name in ('guide/x', 'guide/y')])
        across = rows[np.abs(rows[:, 2]) > 1.0]
        assert len(across) == 1, f'one of the two directions across is vertical: {rows}'
        tolerance = 10.0 / COUPLING
        np.testing.assert_allclose(across[0, :3], [3.0, 7.0, 500.0], rtol=tolerance)
        assert abs(across[0, 3]) == pytest.approx(3.0 * 9.81, rel=tolerance)


def test_a_blade_has_a_mass_and_a_damping_but_no_stiffness():
    """It holds a velocity, (m psidot)' + c psidot = 0: of the bushing beside it only the damping resists; f the
    weight."""
    sim = mass_on(BLADE, 500.0, 7.0)
    for coupled in (False, True):
        found = sim.constraint_coefficients(coupled=coupled)['blade/y']
        np.testing.assert_allclose(found, [3.0, 7.0, 0.0, -3.0 * 9.81], rtol=10.0 / COUPLING)


@pytest.mark.parametrize(('constraint', 'stiffness'), [(GUIDE, 500.0), (BLADE, 0.0)], ids=['guide', 'blade'])
def test_full_coefficients_weigh_a_position_with_stiffness_and_a_velocity_without(constraint, stiffness):
    """W/xi = m + s/(1 - am) (c gamma h + k beta h^2), the damping and stiffness of the bushing; s = 1 - af."""
    sim = mass_on(constraint, 500.0, 7.0, 'coefficients=full', 'h=0.05', 'penalty=1e6')
    sim.advance(1)
    c = sim.scheme
    expected = 3.0 + (1.0 - c.af) / (1.0 - c.am) * c.h * (7.0 * c.gamma + stiffness * c.beta * c.h)
    across = [name in ('blade/y', 'guide/x', 'guide/y') for name in sim.model.row_names]
    assert sim.last_step.W[across].max() / 1e6 == pytest.approx(expected, rel=1e-9)


def run(name: str, *settings: str, steps: int = 200) -> Simulation:
    sim = simulation(name, *[s.removeprefix('integrator.') for s in TIGHT], *settings)
    sim.advance(steps)
    return sim


@pytest.mark.parametrize('settings', [
    ('effective_mass=coupled',),
    ('coefficients=full',),
    ('coefficients=full', 'effective_mass=coupled', 'form=block'),
    ('mass_factor=3',),
    ('kind=m_alf', 'penalty=1e12'),
])  # fmt: skip
@pytest.mark.parametrize('name', ['double_pendulum', 'flyball_governor', 'four_bar'])
def test_no_coefficient_changes_the_motion(name, settings):
    """Converged steps agree to what the iteration leaves, the tolerance of 1e-12 per step over 200 steps, and rounding
    beside it."""
    one, other = run(name), run(name, *settings)
    assert one.totals()['stagnated'] == other.totals()['stagnated'] == 0
    a, b = one.snapshot(), other.snapshot()
    size = max(1.0, np.abs(a.twist).max())
    np.testing.assert_allclose(b.pose, a.pose, rtol=0, atol=1e-9)
    np.testing.assert_allclose(b.twist, a.twist, rtol=0, atol=1e-8 * size)


def test_the_coefficients_are_used_and_not_only_accepted():
    """A step with each setting multiplies its penalties by another mass: the isolated one, the coupled one, that with c
    and k."""
    settings = ('effective_mass=isolated',), ('effective_mass=coupled',), ('coefficients=full',), ('kind=m_alf',)
    weights = []
    for choice in settings:
        sim = simulation('flyball_governor', 'penalty=1e6', 'mode=fixed', *choice)
        sim.advance(1)
        weights.append(sim.last_step.W.copy() / 1e6)
        if choice == ('effective_mass=isolated',):
            expected = np.zeros(sim.model.n_rows)
            effective_masses(sim.model.tables, sim.last_step.J_stage, expected)
    isolated, coupled, full, unit = weights
    assert np.abs(isolated / expected - 1.0).max() < 1e-3  # the configuration moved a little since the matrix was made
    assert (coupled > 1.1 * isolated).any()
    assert (full >= isolated).all()
    assert (full > isolated).any()
    c = sim.scheme
    np.testing.assert_allclose(unit, c.beta * c.h**2, rtol=1e-15)


@pytest.mark.parametrize('mode', ['fixed', 'tolerance'])
@pytest.mark.parametrize('form', ['condensed', 'block'])
def test_a_tenth_of_the_masses_is_a_tenth_of_the_penalty(form, mode):
    """m/10 is xi/10: the same numbers, so the same bits but for the rounding of one product, which does not grow
    here."""
    one = simulation('slider_crank', f'form={form}', f'mode={mode}', 'mass_factor=0.125', 'penalty=1e6')
    other = simulation('slider_crank', f'form={form}', f'mode={mode}', 'penalty=125e3')
    for _ in range(5):
        a, b = one.advance(60), other.advance(60)
        assert a.pose.tobytes() == b.pose.tobytes()  # an eighth: a power of two, nothing is rounded
        assert a.reactions.tobytes() == b.reactions.tobytes()
    assert one.totals() == other.totals()


def test_a_factor_belongs_to_the_constraint_it_names():
    scene = load_scene('four_bar')
    joint = scene.model.joints[1].name
    row = prepare(scene.model).row_names[0]
    sim = Simulation(
        dataclasses.replace(scene, integrator=dataclasses.replace(scene.integrator, mass_factor={joint: 0.1, row: 3.0}))
    )
    named = dict(zip(sim.model.row_names, sim.scheme.factor, strict=True))
    assert all(
        value == {joint: 0.1}.get(name.rpartition('/')[0], 3.0 if name == row else 1.0) for name, value in named.items()
    )
    with pytest.raises(SpecError, match=r"mass_factor: the model has no constraint 'crnk'; did you mean"):
        simulation('slider_crank', 'mass_factor={crnk: 0.1}')


def test_coupled_masses_need_a_smaller_penalty_where_isolated_ones_stagnate():
    """Bricard's loop at the chapter's penalty of 1000: bodies hold each other, so a constraint by itself looks too
    light.

    With isolated masses the iteration never reaches the tolerance, with coupled ones it always does, in three
    iterations at most.
    """
    settings = ('mode=tolerance', 'penalty=1e3', 'h=0.001', 'augmentation=plain')
    coupled = simulation('bricard', *settings, 'effective_mass=coupled')
    coupled.advance(50)
    isolated = simulation('bricard', *settings)
    isolated.advance(50)
    assert isolated.totals()['stagnated'] == 50
    assert coupled.totals()['stagnated'] == 0
    assert coupled.totals()['iterations'] <= 150
    assert coupled.totals()['position_drift_max'] < 1e-10


@pytest.mark.slow
@pytest.mark.parametrize('penalty', [10.0, 1e3, 1e5])
def test_coupled_masses_pass_singular_positions_with_any_penalty(penalty):
    """The slider-crank for 3 s: a constraint that is about to lose its hold becomes heavy, so its penalty grows with
    the need.

    Every neighbour of the start keeps its branch and its energy (1e-3 J, the damped setting at 1 ms), and of most of
    them no step of 3000 stagnates: at a penalty of 1e5 rounding alone stops the iteration above the tolerance now and
    then. The tolerance is 1e-8 of turns in rad, whose residuals count times the length of this model, 1.22 m. Isolated
    masses with plain augmentations fail at 10.
    """
    settings = ('mode=tolerance', 'tolerance=1.22e-8', 'h=0.001', f'penalty={penalty}', 'effective_mass=coupled')
    stagnated = []
    for scene in neighbours(load_scene('slider_crank', [f'integrator.{s}' for s in settings])):
        sim = Simulation(scene)
        start = sim.snapshot().joint_position[:2]
        sim.advance(3000)
        turn = sim.snapshot().joint_position[:2] - start
        assert abs(2 * turn[0] + turn[1]) < 1e-2
        assert sim.totals()['energy_error_max'] < 1e-3
        stagnated.append(sim.totals()['stagnated'])
    assert median(stagnated) == 0, stagnated


def test_massless_bodies_have_coefficients():
    """A body without mass or inertia between two joints: finite, positive masses of both kinds."""
    scene = load_scene('pendulum')
    massless = dataclasses.replace(scene.model.bodies[0], name='pin', mass=0.0, inertia=(0.0,) * 6, com=(0.0, 0.0, 0.0))
    joints = (
        *scene.model.joints,
        JointSpec(name='held', kind='fixed', i=Marker(body=massless.name), j=Marker(body=scene.model.bodies[0].name)),
    )
    model = prepare(
        dataclasses.replace(scene.model, bodies=(*scene.model.bodies, massless), joints=joints, bushings=())
    )
    sim = Simulation(dataclasses.replace(scene, model=model.spec))
    for coupled in (False, True):
        found = coefficients_of(model, sim.state, np.zeros(0), sim.outputs, coupled=coupled)
        assert all(np.isfinite(row).all() and row.m > 0.0 for row in found.values())
