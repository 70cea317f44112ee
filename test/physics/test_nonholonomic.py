"""Rolling and sliding on a blade: positions are free, velocities are not."""

from __future__ import annotations

import numpy as np
import pytest
from convergence import FIELDS, error, orders, scene_of
from rolling_forms import (
    MASS,
    PRECESSION,
    RADIUS,
    STEADY_SPIN,
    TILT,
    chaplygin_sleigh,
    knife_edge,
    rolling_disc,
    spin_slopes,
)
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from solver import simulation_of
from solver.errors import StepError
from solver.files.scene import load_scene, load_scene_text
from solver.simulation import Simulation

TIMES = 0.08 * np.arange(1, 11)
MODES = {
    'tolerance': {'mode': 'tolerance', 'tolerance': 1e-12},
    'fixed': {'mode': 'fixed', 'iterations': 2},
    'one iteration': {'mode': 'fixed', 'iterations': 1},
}
PROBLEMS = {
    'rolling disc': rolling_disc(TIMES[-1]),
    'knife edge': knife_edge(),
    'sleigh': chaplygin_sleigh(TIMES[-1]),
}
STEPS = (4e-3, 2e-3, 1e-3)


@pytest.mark.parametrize('form', ['condensed', 'block'])
@pytest.mark.parametrize('mode', MODES)
@pytest.mark.parametrize('rho_inf', [1.0, 0.8, 0.0])
@pytest.mark.parametrize('name', PROBLEMS)
def test_errors_fall_with_the_square_of_the_step(name, rho_inf, mode, form):
    """Slope 2.0 +- 0.15 of the largest errors in positions, velocities and reactions over 0.8 s.

    Steeper with one iteration, where its error and that of the scheme may cancel for a while, and for the reaction of
    the knife edge with rho_inf = 0, whose h^2 term happens to vanish.
    """
    slopes, table = orders(PROBLEMS[name], STEPS, TIMES, rho_inf=rho_inf, form=form, **MODES[mode])
    assert table[-1].max() < 0.1, f'errors {table} are no small errors'
    message = f'errors {FIELDS} at {STEPS}:\n{table}'
    steeper = np.array([False, False, (name, rho_inf) == ('knife edge', 0.0)]) | (mode == 'one iteration')
    assert (slopes > 1.85).all(), message
    assert (slopes[~steeper] < 2.15).all(), message


def test_the_modified_formulation_rolls_as_well():
    """m_alf, h_R = lam_R - xi psi: at xi = 1e9 it finds the same motion (1e-9) and reactions (1e-6) as the effective
    masses do."""
    common = {'h': 1e-3, 'mode': 'tolerance', 'tolerance': 1e-11}
    a, b = (
        Simulation(scene_of(PROBLEMS['rolling disc'], kind=kind, penalty=xi, **common)).advance(500)
        for kind, xi in (('alf', 1e6), ('m_alf', 1e9))
    )
    np.testing.assert_allclose(b.pose, a.pose, rtol=0, atol=1e-9)
    np.testing.assert_allclose(b.reactions, a.reactions, rtol=0, atol=1e-6)


def test_disc_in_steady_motion_rolls_along_a_circle():
    """10 s: the centre moves at r |w3|, hence the contact in a circle of r |w3| / W + r cos(tilt); tilt and forces keep
    their values."""
    s = Simulation(scene_of(rolling_disc(0.1, nod=0.0), h=1e-3, rho_inf=1.0, mode='tolerance', tolerance=1e-10))
    circle = RADIUS * abs(STEADY_SPIN) / PRECESSION
    radius = circle + RADIUS * np.cos(TILT)
    for _ in range(100):
        snapshot = s.advance(100)
        axis = Rotation.from_quat(snapshot.pose[0, 3:]).apply([0, 0, 1])
        assert np.arccos(axis[2]) == pytest.approx(TILT, abs=1e-5)
        level = axis[:2] / np.linalg.norm(axis[:2])
        contact = snapshot.pose[0, :2] + RADIUS * np.cos(TILT) * level
        assert np.hypot(*(contact - [0.0, radius])) == pytest.approx(radius, abs=1e-4)
        assert snapshot.reactions[0] == pytest.approx(MASS * 9.81, abs=1e-3)
        assert np.hypot(*snapshot.reactions[1:3]) == pytest.approx(MASS * PRECESSION**2 * circle, abs=1e-3)


def constants(tilt: float, p: float, w3: float) -> np.ndarray:
    """(2,) spins p and w3 carried back along their linear equations to the tilt of 70 deg: constants of the rolling
    motion."""
    if tilt == TILT:
        return np.array([p, w3])
    return solve_ivp(lambda T, y: spin_slopes(T, *y), (tilt, TILT), [p, w3], rtol=1e-12, atol=1e-12).y[:, -1]


def test_rolling_disc_keeps_energy_and_both_constants_of_its_spins_over_ten_seconds():
    """A nodding disc at 1 ms: energy to 1e-4 of 11 J, both constants to 1e-4 rad/s, contact at rest to 1e-9 m/s, height
    to 1e-12 m."""
    s = simulation_of(load_scene('rolling_disc'))

    def now() -> tuple[float, np.ndarray]:
        snapshot = s.snapshot()
        R = Rotation.from_quat(snapshot.pose[0, 3:])
        axis, w = R.apply([0, 0, 1]), R.apply(snapshot.twist[0, 3:])
        tilt = np.arccos(axis[2])
        e1 = np.array([-axis[1], axis[0], 0.0]) / np.sin(tilt)
        return tilt, constants(tilt, w @ np.cross(axis, e1), w @ axis)

    _, start = now()
    tilts = []
    for _ in range(100):
        s.advance(100)
        tilt, kept = now()
        tilts.append(tilt)
        np.testing.assert_allclose(kept, start, rtol=0, atol=1e-4)
    assert np.ptp(tilts) > np.deg2rad(3), 'it does not nod'
    figures = s.totals()
    assert figures['energy_error_max'] < 1e-3
    assert figures['position_drift_max'] < 1e-12
    assert figures['velocity_drift_max'] < 1e-9


def test_knife_edge_travels_across_the_slope_and_never_farther_down_than_its_cycloid():
    """20 revolutions of the file's plate: at most g'/(2 w^2) + 1e-3 m downhill, 10 s across the slope exact to 1e-3
    m."""
    s = simulation_of(load_scene('knife_edge'))
    problem = knife_edge()
    x = []
    for _ in range(100):
        snapshot = s.advance(100)
        x.append(snapshot.pose[0, 0])
    assert max(x) < 4.905 / 8 + 1e-3
    assert error(snapshot, problem.exact(10.0))[0] < 1e-3


def test_sleigh_ends_up_straight_ahead_with_all_its_energy():
    """v -> sqrt(2 E/m), w -> 0: the blade does no work but stops the turning."""
    s = simulation_of(load_scene('chaplygin_sleigh'))
    snapshot = s.advance(5000)
    speed = np.sqrt(0.4**2 + (0.08 + 2 * 0.09) / 2 * 9)
    np.testing.assert_allclose(snapshot.twist[0], [speed, 0, 0, 0, 0, 0], atol=1e-3)


def test_rolling_takes_freedoms_of_velocity_but_not_of_position():
    """A disc on a plane: 5 places, 3 velocities; a plate on a blade: 3 places, 2 velocities."""
    for name, places, velocities in (('rolling_disc', 5, 3), ('knife_edge', 3, 2), ('pendulum', 1, 1)):
        counts = simulation_of(load_scene(name)).describe()
        assert (counts['position_dof'], counts['dof'], counts['redundant_constraints']) == (places, velocities, 0)


def test_assembly_lifts_the_disc_onto_the_plane_without_rolling_it():
    """Placed 0.1 m above: it is moved straight down or tipped, its contact is not carried along the plane by the
    rolling rows."""
    s = simulation_of(
        load_scene(
            'rolling_disc', ['start.kind=assemble', 'mechanism.bodies.disc.position=[0, 0.17101007166283436, 0.57]']
        )
    )
    assert abs(s.last_step.phi[0]) < 1e-11
    assert s.snapshot().pose[0, 0] == pytest.approx(0.0, abs=1e-12)
    assert abs(s.last_step.phi[1:]).max() < 1e-9


@pytest.mark.parametrize('kind', ['reference_kkt', 'reference_bdf', 'reference_radau', 'reference_ida'])
@pytest.mark.parametrize('name', PROBLEMS)
def test_reference_integrators_reach_the_closed_forms(kind, name):
    """Positions to 1e-5, velocities to 1e-4, reactions to 1e-3 over 0.8 s at tolerance 1e-9; drift of positions to
    1e-7."""
    problem = PROBLEMS[name]
    s = simulation_of(scene_of(problem, h=0.08, kind=kind, tolerance=1e-9))
    worst = np.zeros(3)
    for _ in range(10):
        snapshot = s.advance()
        worst = np.maximum(worst, error(snapshot, problem.exact(snapshot.t_ns * 1e-9)))
    assert (worst < (1e-5, 1e-4, 1e-3)).all(), worst
    assert s.totals()['position_drift_max'] < 1e-7


def test_a_wheel_with_its_weight_off_the_axle_finds_its_rest_on_a_slope():
    """Equilibrium under rolling rows, slope 0.1 rad: it rolls until its centre of mass is vertically above the contact
    point."""
    scene = load_scene(
        'rolling_disc',
        [
            'start.kind=equilibrium',
            'mechanism.gravity=[0.979367, 0, -9.760989]',
            'mechanism.bodies.disc={mass: 2, inertia: [0.125, 0.125, 0.25], com: [0, -0.1, 0], position: [0, 0, 0.5], '
            'rpy_deg: [90, 0, 0]}',
            'mechanism.joints={upright: {kind: perpendicular, i: {body: world, axis: [0, 1, 0]}, j: {body: disc, axis: '
            '[1, 0, 0]}}, '
            'straight: {kind: perpendicular, i: {body: world, axis: [0, 1, 0]}, j: {body: disc, axis: [0, 1, 0]}}}',
        ],
    )
    s = simulation_of(scene)
    snapshot = s.snapshot()
    R = Rotation.from_quat(snapshot.pose[0, 3:]).as_matrix()
    x, _, z = R @ [0, -0.1, 0]
    assert x / (z + RADIUS) == pytest.approx(0.979367 / -9.760989, abs=1e-9)
    assert z < 0.0
    # the search moves in steps, each without slip to first order
    assert snapshot.pose[0, 0] == pytest.approx(RADIUS * np.arctan2(-x, -z), rel=1e-2)
    np.testing.assert_allclose(snapshot.reactions[-3:], [2 * 9.760989, -2 * 0.979367, 0.0], atol=1e-9)


PLATE = """
mechanism:
  bodies:
    plate: {mass: 5, inertia: [1, 1, 1], position: [0, 0, -0.1]}
    disc:
      mass: 2
      inertia: [0.125, 0.125, 0.25]
      position: [0, 0.17101007166283436, 0.46984631039295416]
      rpy_deg: [70, 0, 0]
      velocity: [1.54, 0, 0]
      angular_velocity: [0.8, 1.41, -3.09]
  joints:
    bed: {kind: point_on_plane, i: world, j: plate, at: [0, 0, -0.1]}
    level_x: {kind: perpendicular, i: world, j: {body: plate, axis: [1, 0, 0]}}
    level_y: {kind: perpendicular, i: world, j: {body: plate, axis: [0, 1, 0]}}
  contacts:
    road: {kind: rolling, i: {body: plate, at: [0, 0, 0]}, j: disc, radius: 0.5}
integrator: {h: 1.0e-3, rho_inf: 1, mode: tolerance, tolerance: 1.0e-10}
"""


@pytest.mark.parametrize('form', ['condensed', 'block'])
def test_disc_and_the_sliding_plate_it_rolls_on_exchange_momentum_and_lose_none(form):
    """5 s on a free plate: horizontal momentum to 1e-9 N s, angular momentum about the vertical to 1e-5 N m s, energy
    to 1e-4 J."""
    s = simulation_of(load_scene_text(PLATE, overrides=[f'integrator.form={form}']))
    bodies = s.model.tables.bodies

    def momentum() -> tuple[np.ndarray, float]:
        q, v = s.state.q[:-1], s.state.v[:-1]
        spin = Rotation.from_quat(q[:, 3:]).apply(np.einsum('bij,bj->bi', bodies.inertia, v[:, 3:]))
        linear = bodies.mass[:, None] * v[:, :3]
        return linear.sum(0)[:2], float((np.cross(q[:, :3], linear) + spin)[:, 2].sum())

    (start, turning), plate = momentum(), []
    for _ in range(50):
        plate.append(s.advance(100).pose[0, :2])
        linear, angular = momentum()
        np.testing.assert_allclose(linear, start, rtol=0, atol=1e-9)
        assert angular == pytest.approx(turning, abs=1e-5)
    assert np.ptp(plate, axis=0).min() > 0.1, 'the plate does not take part'
    assert s.totals()['energy_error_max'] < 1e-4


def test_a_disc_that_falls_flat_is_named():
    """Without spin it lies down within half a second, and no finer step brings it further."""
    wheel = '{mass: 1, inertia: [0.0625, 0.125, 0.0625], position: [0, 0, 0.4388], rpy: [0.5, 0, 0]}'
    road = '{kind: rolling, i: world, j: {body: wheel, axis: [0, 1, 0]}, radius: 0.5}'
    scene = f'mechanism: {{bodies: {{wheel: {wheel}}}, contacts: {{road: {road}}}}}\nstart: {{kind: assemble}}'
    with pytest.raises(StepError, match="the disc of contact 'road' has fallen flat on its plane"):
        Simulation(load_scene_text(scene)).advance(1000)
