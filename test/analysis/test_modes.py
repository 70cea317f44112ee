"""Modes of the standing full car: the frequencies and dampings of the linearised model are those of a run that rings
down."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.optimize import least_squares

from solver.analysis.figures import standing
from solver.analysis.modes import LONG, Mode, eigenvalues, linearised, matrices_at_rest, modes, named_modes
from solver.files.scene import load_scene
from solver.levels import simulation_of
from solver.model.evaluate import evaluate_forces
from solver.model.state import kinematics_of
from solver.simulation import Simulation
from solver.start.newton import ConsistentState

AMPLITUDE = 1e-4  # m or rad of the largest component: within the smooth part of every law
EVERY, COUNT = 4, 300  # ms, samples


@pytest.fixture(scope='module')
def car() -> Simulation:
    """Without rolling resistance, which holds a standing wheel by dry friction and so has no part in a mode."""
    free = [
        f'vehicle.{axle}.tire={{<<: tires/205_55R16.tir, values: {{QSY1: 0, QSY3: 0, QSY4: 0}}}}'
        for axle in ('front', 'rear')
    ]
    return standing(load_scene('car_swept_steer', free))


def ring(car: Simulation, displacement: np.ndarray, velocity: np.ndarray, row: int) -> np.ndarray:
    """(COUNT,) displacement along row of the variations after a start moved by (6 nb,) variations and velocities."""
    car.reset()
    state, c = car.state, car.scheme
    start, u = ConsistentState(car.model), np.zeros(len(car.model.spec.inputs))
    rest = state.q.copy()
    state.q[:-1, :3] += displacement.reshape(-1, 6)[:, :3]
    turn = displacement.reshape(-1, 6)[:, 3:]
    for b, (x, y, z) in enumerate(0.5 * turn):
        i, j, k, w = state.q[b, 3:]
        state.q[b, 3:] += (
            w * x + j * z - k * y,
            w * y + k * x - i * z,
            w * z + i * y - j * x,
            -(i * x + j * y + k * z),
        )
        state.q[b, 3:] /= np.linalg.norm(state.q[b, 3:])
    # the contact of standing tires is a spring: it is stretched by what moves its wheel, however slowly
    slowly = np.vstack([displacement.reshape(-1, 6) / LONG, np.zeros(6)])
    kin = kinematics_of(rest, slowly)
    evaluate_forces(
        car.model.tables, kin, state.angle, state.z, LONG, u, False, start.f, start.Kq, start.Kv, start.z, start.outputs
    )
    state.z[:] = start.z
    start.assemble(state, u)
    state.v[:-1] = velocity.reshape(-1, 6)
    start.project_velocity(state, u)
    start.start_integrator(state, u, car.h, c.am, c.af)
    b, k = divmod(row, 6)
    out = np.empty(COUNT)
    for n in range(COUNT):
        q = car.state.q[b]
        if k < 3:
            out[n] = q[k] - rest[b, k]
        else:  # vector part of conj(q_rest) q
            p = rest[b, 3:]
            v = p[3] * q[3:6] - q[6] * p[:3] - np.cross(p[:3], q[3:6])
            out[n] = 2.0 * v[k - 3]
        car.advance(EVERY, audit=False)
    return out


@pytest.mark.slow
@pytest.mark.parametrize('name', ['bounce', 'pitch', 'roll', 'wheel hop front', 'wheel hop rear', 'engine bounce'])
def test_ring_down_has_frequency_and_damping_of_the_linear_mode(car: Simulation, name: str) -> None:
    """A start in the shape of the mode; a damped sine fitted to the run, from a first guess 15 % off, finds its
    eigenvalue to 1 %."""
    car.reset()
    linear = linearised(car.model, car.state, np.zeros(len(car.model.spec.inputs)))
    mode = named_modes(car)[name]
    s, X = eigenvalues(linear)
    index = int(np.argmin(np.abs(np.abs(s) / (2 * np.pi) - mode.frequency) + (s.imag <= 0.0)))
    value, shape = s[index], X[:, index]
    row = int(np.argmax((shape.conj() * (linear.M @ shape)).real))
    shape = shape * AMPLITUDE / shape[np.argmax(np.abs(shape))]
    motion = ring(car, shape.real, (value * shape).real, row) - ring(car, 0.0 * shape.real, 0.0 * shape.real, row)
    t = np.arange(COUNT) * EVERY * 1e-3
    used = t < 6.0 / -value.real  # what follows is below rounding and the other modes

    def misfit(x: np.ndarray) -> np.ndarray:
        basis = np.exp(x[0] * t) * np.array([np.cos(x[1] * t), np.sin(x[1] * t)])
        basis, y = basis[:, used], motion[used] / np.abs(motion).max()
        return basis.T @ np.linalg.lstsq(basis.T, y, rcond=None)[0] - y

    found = least_squares(misfit, (1.15 * value.real, 0.85 * value.imag), x_scale=(abs(value.real), value.imag)).x
    assert np.hypot(*found) == pytest.approx(abs(value), rel=0.01)
    assert -found[0] / np.hypot(*found) == pytest.approx(mode.damping, abs=0.01)


def test_bounce_and_pitch_are_two_modes_where_both_ends_vibrate_by_themselves() -> None:
    """The light car's: each has a third of its energy in the other motion, so both have a good part in both."""
    named = named_modes(standing(load_scene('light_car_straight')))
    bounce, pitch = named['bounce'], named['pitch']
    assert bounce.frequency < 0.9 * pitch.frequency
    assert bounce.share(['chassis'], ['z']) > pitch.share(['chassis'], ['z'])
    assert pitch.share(['chassis'], ['ry']) > bounce.share(['chassis'], ['ry'])


def named_modes_of(vehicle: str, *overrides: str) -> dict[str, Mode]:
    return named_modes(standing(load_scene('car_step_steer', [f'vehicle={vehicle}', *overrides])))


def test_no_mode_is_both_bounce_and_pitch() -> None:
    """The van has two modes with more than four tenths in bounce each, of which one is the pitch."""
    named = named_modes_of('docs/examples/van.yaml')
    assert named['bounce'].frequency < 0.9 * named['pitch'].frequency
    assert named['pitch'].share(['chassis'], ['ry']) > named['bounce'].share(['chassis'], ['ry'])


def test_a_load_on_the_roof_lowers_the_frequency_of_roll() -> None:
    """The pickup with the centre of mass of its body 0.44 m higher, which has the same springs and more to turn: the
    moment of inertia about an axis at the ground, 2194 kg (0.67 m)^2 + 821 kg m^2, grows by 1425 kg (1.2^2 - 0.76^2)
    m^2 to 1.68 times what it was, and gravity takes from the stiffness."""
    low = named_modes_of('vehicles/pickup_awd.yaml')['roll']
    high = named_modes_of('vehicles/pickup_awd.yaml', 'vehicle.chassis.com=[0.12, 0, 1.2]')['roll']
    assert high.frequency < low.frequency / np.sqrt(1.68)


def test_roll_on_standing_tires_is_the_lower_one_of_two_modes_that_sway_and_turn() -> None:
    """The formula student car's is more of a swaying than others."""
    roll = named_modes_of('vehicles/formula_student.yaml')['roll']
    assert roll.frequency < 4.5
    assert roll.share(['chassis'], ['y', 'rx']) > 0.8


def test_the_wheel_hop_of_a_live_axle_is_that_of_its_mass_on_tires_and_springs() -> None:
    """The pickup's: housing 92 kg, two wheels, and of the leaves what a bar carries whose ends stand still. At 4.6 kN
    the tire has 254 kN/m (270 at 7.5 kN, [Besselink2010] (4)), the spring 35.6. What the frame gives way by, a sixth of
    the energy, is left out."""
    hop = named_modes_of('vehicles/pickup_awd.yaml')['wheel hop rear']
    mass = 92 + 2 * 32 + 3 + 2 * 27 * 0.4
    assert hop.frequency == pytest.approx(np.sqrt(2 * (254e3 + 35.6e3) / mass) / (2 * np.pi), rel=1 / 6)
    assert hop.share(['axle_rear', 'wheel_rear_left', 'wheel_rear_right'], ['z']) > 0.6
    assert hop.share(['axle_rear'], ['rx']) < 0.01


def test_matrices_at_rest_are_those_of_a_mass_on_a_spring_and_damper() -> None:
    """1 kg, 100 N/m, 2 N s/m along z; the guide holds the other five directions. 10 rad/s, damping ratio 0.1."""
    simulation = simulation_of(load_scene('spring_mass'))
    M, C, K, A = matrices_at_rest(simulation)
    along = null_space(A)
    assert along.shape == (6, 1) and abs(along[2, 0]) == pytest.approx(1.0, abs=1e-12)
    assert [float((along.T @ X @ along)[0, 0]) for X in (M, C, K)] == pytest.approx([1.0, 2.0, 100.0], rel=1e-9)
    (mode,) = modes(simulation)
    assert (mode.frequency, mode.damping) == pytest.approx((10.0 / (2.0 * np.pi), 0.1), rel=1e-9)


def test_of_a_state_that_moves_a_warning_names_its_caller() -> None:
    simulation = simulation_of(load_scene('spring_mass'))
    simulation.advance(100)
    for ask in (modes, matrices_at_rest):
        with pytest.warns(UserWarning, match=r'bodies move by .* m/s or rad/s, which is left out') as told:
            ask(simulation)
        assert told[0].filename == __file__
